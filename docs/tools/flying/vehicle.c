/* A vehicle with its policies for the flying page. Written by docs/tools/flying_page.py. */
@includes@

typedef double real;
#define R(x) ((real)(x))

@elementary@
static inline real q_min(real a, real b) { return a < b ? a : b; }
static inline real q_max(real a, real b) { return a > b ? a : b; }

#define MEMORY @memory@
static const real START_STATE[18] = {@state@}, START_MEMORY[MEMORY] = {@memory_start@};
static const real SCALE[4] = {@scale@}, POLE[2] = {@pole@}; /* the pole that the policies believe */
@functions@
@policies@
/* What the page reads: the state and the tracking error (m). What it writes: the wind (N on the vehicle, N on the bob), the
 * hand, the target (m), whether a sample arrives, the loop and the parameters. */
static struct { real state[18], error[3], wind[6], hand[4], target[3], sees, loop[@loop@], parameters[9]; } data;
static real memory[MEMORY], sample[11], reference[26];
static int flying = -1; /* number of the policy */

static void copy(int count, const real *from, real *to) {
  for (int i = 0; i < count; ++i) to[i] = from[i];
}

real *data_of(void) { return data.state; }

/* At rest at the target. */
void restart(void) {
  copy(18, START_STATE, data.state);
  copy(3, data.target, data.state);
  copy(MEMORY, START_MEMORY, memory);
  flying = -1;
}

/* One control step. A policy that did not fly the step before begins anew. */
void advance(int policy) {
  real command[4], action[4], state[18], after[MEMORY];
  int starts = policy != flying;
  flying = policy;
  measure(data.state, data.parameters, data.target, sample, data.error);
  copy(3, data.target, reference);
  copy(2, POLE, reference + 24);
  switch (policy) {
@cases@
  }
  for (int i = 0; i < 4; ++i) action[i] = (float)(command[i] / SCALE[i] - (i == 0)); /* single, as in the environment */
  step(data.state, memory, action, data.wind, data.parameters, data.loop, data.hand, state, after);
  copy(18, state, data.state);
  copy(MEMORY, after, memory);
  measure(data.state, data.parameters, data.target, sample, data.error);
}
