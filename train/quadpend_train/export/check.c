/* Golden vectors of @name@.c: inputs of @steps@ control steps, and what the Python policy commanded; and the statuses of
 * the supervisor for a slow vehicle whose samples are damaged. See docs/deploy.md.
 *
 *     cc -std=c99 -O2 @name@.c @name@_check.c -lm -o check && ./check */
#include "@name@.h"

#include <stdio.h>

#ifndef TOLERANCE
#ifdef QUADPEND_DOUBLE
#define TOLERANCE @tolerance_double@
#else
#define TOLERANCE @tolerance@
#endif
#endif

typedef @name@_real real;
#define R(x) ((real)(x))

/* Position, quaternion, direction, age; seven derivatives of the reference, yaw reference, pole; command. */
static const real vectors[@steps@][41] = {
@vectors@
};
static const real range[4] = {@ranges@}; /* of the command */

static const real *copy(int count, const real *from, real *to) {
  for (int i = 0; i < count; ++i) to[i] = from[i];
  return from + count;
}

static real largest_error(void) {
  @name@_policy policy;
  @name@_measurement measurement;
  @name@_reference reference;
  @name@_command command;
  real worst = 0;
  @name@_reset(&policy);
  for (int k = 0; k < @steps@; ++k) {
    const real *expected = copy(3, vectors[k], measurement.position);
    expected = copy(4, expected, measurement.quaternion);
    expected = copy(3, expected, measurement.direction);
    expected = copy(1, expected, &measurement.age);
    expected = copy(21, expected, reference.derivatives[0]);
    expected = copy(3, expected, reference.yaw);
    expected = copy(2, expected, reference.pole);
    @name@_step(&policy, &measurement, &reference, &command);
    for (int i = 0; i < 4; ++i) {
      real found = i == 0 ? command.thrust : command.@turning@[i - 1], error = (found - expected[i]) / range[i];
      if (!(error <= worst && -error <= worst)) worst = error < 0 ? -error : error;
    }
    command.thrust = expected[0];
    copy(3, expected + 1, command.@turning@);
    @name@_applied(&policy, &command); /* rounding must not grow over the steps */
  }
  return worst;
}

enum { MISSING = 1, REPEATED, NO_NUMBER, NO_QUATERNION, NEGATIVE, OLD, FAR, JUMPS, LIES };
#define INVALID (@name@_BLIND | @name@_INVALID)
#define KILLED (@name@_RESTARTED | @name@_POLE_TILT | @name@_KILLED)
static const struct {
  int from, to, damage;
  uint32_t status;
} expected_statuses[] = {
  {20, 24, MISSING, @name@_BLIND},        {30, 32, REPEATED, @name@_BLIND | @name@_FROZEN},
  {40, 40, FAR, @name@_BLIND | @name@_OUTLIER}, {45, 45, NO_NUMBER, INVALID},
  {50, 50, NO_QUATERNION, INVALID},       {55, 55, NEGATIVE, INVALID},
  {60, 60, OLD, @name@_BLIND},            {65, 65, JUMPS, @name@_REFERENCE},
  {66, 66, 0, @name@_REFERENCE},          {80, 84, LIES, @name@_BLIND | @name@_OUTLIER},
  {85, 85, LIES, KILLED},                 {86, @steps@ - 1, LIES, @name@_KILLED},
};

/* Return the first step in which the supervisor does not say what it should, or the number of steps. */
static int first_fault(void) {
  const uint32_t other = @name@_INNOVATION | @name@_SATURATED | @name@_CAUTION | @name@_REFERENCE; /* in any step */
  const @name@_command hover = {range[0] / 2, {0, 0, 0}};
  const real set_point[3] = {1, 0, 3};
  @name@_supervisor supervisor;
  real infinite = 2;
  for (int i = 0; i < 12; ++i) infinite *= infinite;
  @name@_supervisor_reset(&supervisor);
  for (int k = 0; k < @steps@; ++k) {
    real height = supervisor.limits.height[0] + 2, moved = (real)k * R(1e-4);
    @name@_measurement measurement = {{moved, 0, height}, {1, 0, 0, 0}, {0, 0, 1}, 0};
    @name@_reference reference = {{{0, 0, height}}, {0, 0, 0}, @name@_POLE};
    @name@_command command;
    uint32_t expected = 0, status;
    int damage = 0;
    for (size_t i = 0; i < sizeof expected_statuses / sizeof *expected_statuses; ++i) {
      if (k < expected_statuses[i].from || k > expected_statuses[i].to) continue;
      expected = expected_statuses[i].status;
      damage = expected_statuses[i].damage;
    }
    if (damage == REPEATED) measurement.position[0] = supervisor.sample[0];
    if (damage == NO_NUMBER) measurement.direction[1] = infinite - infinite;
    if (damage == NO_QUATERNION) measurement.quaternion[0] = 0;
    if (damage == NEGATIVE) measurement.age = R(-0.01);
    if (damage == OLD) measurement.age = R(0.05);
    if (damage == FAR) measurement.position[1] = 1;
    if (damage == JUMPS) reference.derivatives[0][0] = R(0.3);
    if (damage == LIES) measurement.direction[0] = 1, measurement.direction[2] = 0;
    supervisor.request = k < 5 ? @name@_HOLD : @name@_FLY;
    if (k == 70) @name@_go_to(&supervisor, set_point, 1);
    status = @name@_supervise(&supervisor, damage == MISSING ? NULL : &measurement,
                              k < 70 || k > 78 ? &reference : NULL, &command);
    @name@_applied(&supervisor.policy, &hover);
    if ((status & expected) != expected || (status & ~(expected | other))) return k;
    if (supervisor.stage == @name@_HOLD && command.thrust != hover.thrust) return k;
    if (supervisor.stage == @name@_KILL && (command.thrust != 0 || command.@turning@[0] != 0)) return k;
  }
  return @steps@;
}

int main(void) {
  real worst = largest_error();
  int fault = first_fault(), is_passed = worst <= TOLERANCE && fault == @steps@;
  printf("%s: largest error %.2g of the range of the command, supervisor right in %d of %d steps\n",
         is_passed ? "passed" : "failed", (double)worst, fault, @steps@);
  return !is_passed;
}
