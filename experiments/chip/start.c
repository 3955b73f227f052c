/* Start of a program on the chip: floating-point unit on, memory set, stack painted, main called. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

extern uint32_t top_of_stack, data_in_flash, data_begin, data_end, bss_begin, bss_end;
extern void initialise_monitor_handles(void);
extern int main(void);

#define SYSTICK ((volatile uint32_t *)0xE000E010) /* control, reload, current */
#define PAINT 0xA5A5A5A5u

/* The linker puts this function in the place of the step (--wrap); it times the step. */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
uint32_t JOIN(__real_, STEP)(void *supervisor, const void *measurement, const void *reference, void *command);
static uint32_t most_ticks;
uint32_t JOIN(__wrap_, STEP)(void *supervisor, const void *measurement, const void *reference, void *command) {
  uint32_t begin = SYSTICK[2], passed, status;
  status = JOIN(__real_, STEP)(supervisor, measurement, reference, command);
  passed = (begin - SYSTICK[2]) & 0xFFFFFF;
  if (passed > most_ticks) most_ticks = passed;
  return status;
}

/* Stack is painted below the present one, and read again: what was used of it. */
static volatile uint32_t *painted(void) { return &top_of_stack - 8192; }
static void stack_paint(void) {
  volatile uint32_t here, *word = painted();
  while (word < &here - 64) *word++ = PAINT;
}
static void report(void) {
  volatile uint32_t *word = painted();
  while (*word == PAINT) ++word;
  printf("ticks %lu stack %lu\n", (unsigned long)most_ticks, (unsigned long)((&top_of_stack - word) * 4));
}

void _init(void) {}
void _fini(void) {}
void reset(void) {
  *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20;
  for (uint32_t *to = &data_begin, *from = &data_in_flash; to < &data_end;) *to++ = *from++;
  for (uint32_t *to = &bss_begin; to < &bss_end;) *to++ = 0;
  initialise_monitor_handles();
  SYSTICK[1] = 0xFFFFFF;
  SYSTICK[2] = 0;
  SYSTICK[0] = 5;
  stack_paint();
  int result = main();
  report();
  exit(result);
}
__attribute__((section(".vectors"))) void *vectors[] = {&top_of_stack, reset};
