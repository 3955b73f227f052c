/* See @name@.h. The functions with numbered variables are read from the equations of the package quadpend_gym. */
#include "@name@.h"

typedef @name@_real real;
#define R(x) ((real)(x))

@elementary@
static inline real q_min(real a, real b) { return a < b ? a : b; }
static inline real q_max(real a, real b) { return a > b ? a : b; }

#define KALMAN @kalman@
#define ADRC @adrc@
#define NETWORK @network@
#define MEMORY @memory@
#define EXTRA @extra@
#define ESTIMATE @estimate@ /* numbers of an estimate of the vehicle */
#define PARTS @parts@ /* periods and parts of one that are predicted through */

static const real SCALE[4] = {@scale@};
@tables@
@functions@
static void copy(int count, const real *from, real *to) {
  for (int i = 0; i < count; ++i) to[i] = from[i];
}

/* Return whether all numbers are finite and smaller than a limit. */
static int is_bounded(int count, const real *x, real limit) {
  for (int i = 0; i < count; ++i) {
    if (!(x[i] < limit && x[i] > -limit)) return 0;
  }
  return 1;
}

/* In the environment, observations and actions have single precision. */
static real single(real x) { return (real)(float)x; }

static void limit(real *action) {
  for (int i = 0; i < 4; ++i) action[i] = single(q_min(q_max(action[i], R(-1)), R(1)));
}

#if PARTS > 0
static void predict(real *estimate, const real *action, int first, int end) {
  static void (*const advance[PARTS])(const real *, const real *, real *) = {@advances@};
  real next[ESTIMATE];
  for (int k = first; k < end; ++k) {
    advance[k](estimate, action, next);
    copy(ESTIMATE, next, estimate);
  }
}
#endif

#if NETWORK
static void dense(int inputs, int outputs, const float *weights, const float *biases, const real *x, real *y) {
  for (int i = 0; i < outputs; ++i) {
    real sum = biases[i];
    for (int j = 0; j < inputs; ++j) sum += weights[i * inputs + j] * x[j];
    y[i] = sum;
  }
}

static void network(const real *inputs, real *output) {
@layers@
}
#endif

void @name@_reset(@name@_policy *policy) { policy->running = 0; }

/* Estimate the state, and choose the action. */
static void act(@name@_policy *policy, int is_sample) {
  const @name@_measurement *sample = &policy->sample;
  real observed[27], next[MEMORY], extra[EXTRA];
  real *memory = policy->memory, *action = policy->action;
  observe(sample->position, sample->quaternion, sample->direction, policy->target.derivatives[0], policy->target.yaw,
          observed);
  for (int i = 0; i < 27; ++i) observed[i] = single(observed[i]);
  if (!policy->running) {
    begin(observed, memory);
    for (int i = 0; i < 4; ++i) action[i] = 0;
    for (int i = 0; i < EXTRA; ++i) policy->extra[i] = 0;
    policy->running = 1;
    policy->age = 0;
  } else {
#if KALMAN
    predict(memory, action, 0, 1);
    if (is_sample) {
      correct(memory, observed, gains[gain_rows[policy->age]], next);
    } else {
      miss(memory, observed, next);
    }
    if (policy->age < (int)sizeof gain_rows - 1) ++policy->age;
#else
    (void)is_sample;
#if ADRC
    real plant[MEMORY];
    release(memory, plant);
    predict(plant, action, 0, 1);
    correct(memory, plant, observed, next);
#else
    correct(memory, observed, next);
#endif
#endif
    copy(MEMORY, next, memory);
  }
#if ESTIMATE
  real later[ESTIMATE];
  copy(ESTIMATE, memory, later);
  predict(later, action, 1, PARTS);
#else
  const real *later = memory;
#endif
#if NETWORK
  real seen[INPUTS];
  inputs(observed, memory, later, action, policy->extra, seen, extra);
  copy(EXTRA, extra, policy->extra);
  network(seen, policy->output);
#endif
  law(memory, later, policy->extra, policy->output, action, extra);
  copy(EXTRA, extra, policy->extra);
  limit(action);
}

void @name@_applied(@name@_policy *policy, const @name@_command *command) {
  policy->action[0] = command->thrust / SCALE[0] - 1;
  for (int i = 0; i < 3; ++i) policy->action[1 + i] = command->@turning@[i] / SCALE[1 + i];
  limit(policy->action);
}

void @name@_step(@name@_policy *policy, const @name@_measurement *measurement, const @name@_reference *reference,
                 @name@_command *command) {
  const real largest = R(1e6); /* of a measurement or a reference */
  int is_sample = measurement && is_bounded(3, measurement->position, largest) &&
                  is_bounded(4, measurement->quaternion, 2) && is_bounded(3, measurement->direction, 2);
  int is_target = is_bounded(21, reference->derivatives[0], largest) && is_bounded(3, reference->yaw, largest);
  if (is_sample) policy->sample = *measurement;
  if (is_target) policy->target = *reference;
  if (policy->running || (is_sample && is_target)) {
    act(policy, is_sample);
    if (!(is_bounded(MEMORY, policy->memory, R(1e15)) && is_bounded(EXTRA, policy->extra, R(1e15)) &&
          is_bounded(@checked@, policy->memory, R(@limit@)) && is_bounded(4, policy->action, 2))) {
      policy->running = 0; /* begin again with the next sample */
    }
  }
  real action[4] = {0, 0, 0, 0};
  if (policy->running) copy(4, policy->action, action);
  command->thrust = SCALE[0] * (1 + action[0]);
  for (int i = 0; i < 3; ++i) command->@turning@[i] = SCALE[1 + i] * action[1 + i];
}
