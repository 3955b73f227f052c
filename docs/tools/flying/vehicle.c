/* A vehicle with its policies for the flying page. Written by docs/tools/flying_page.py. */
@includes@

typedef double real;
#define R(x) ((real)(x))

@elementary@
static inline real q_min(real a, real b) { return a < b ? a : b; }
static inline real q_max(real a, real b) { return a > b ? a : b; }

#define MEMORY @memory@
static const real START_STATE[18] = {@state@}, START_MEMORY[MEMORY + 1] = {@memory_start@};
static const real SCALE[4] = {@scale@}, TARGET[26] = {@target@};
@functions@
@policies@
/* What the page reads and writes: the state, the tracking error (m), and the wind (N on the vehicle, N on the bob). */
static struct { real state[18], error[3], wind[6]; } data;
static real memory[MEMORY + 1], sample[11];
static int flying = -1; /* number of the policy */

static void copy(int count, const real *from, real *to) {
  for (int i = 0; i < count; ++i) to[i] = from[i];
}

real *data_of(void) { return data.state; }

void restart(void) {
  copy(18, START_STATE, data.state);
  copy(MEMORY, START_MEMORY, memory);
  measure(data.state, sample, data.error);
  flying = -1;
}

/* One control step. A policy that did not fly the step before begins anew. */
void advance(int policy) {
  real command[4], action[4], state[18], after[MEMORY + 1];
  int starts = policy != flying;
  flying = policy;
  switch (policy) {
@cases@
  }
  for (int i = 0; i < 4; ++i) action[i] = (float)(command[i] / SCALE[i] - (i == 0)); /* single, as in the environment */
  step(data.state, memory, action, data.wind, state, after);
  copy(18, state, data.state);
  copy(MEMORY, after, memory);
  measure(data.state, sample, data.error);
}
