/* See @name@.h. The functions with numbered variables are read from the equations of the package quadpend_gym. */
#include "@name@.h"

typedef @name@_real real;
#define R(x) ((real)(x))

@elementary@
static inline real q_min(real a, real b) { return a < b ? a : b; }
static inline real q_max(real a, real b) { return a > b ? a : b; }

#define SEEN 37 /* numbers of a sample and a reference */
#define READ @read@ /* numbers of the observation that a network reads */
#define KALMAN @kalman@
#define ADRC @adrc@
#define NETWORK @network@
#define MEMORY @memory@
#define EXTRA @extra@
#define ESTIMATE @estimate@ /* numbers of an estimate of the vehicle */
#define PARTS @parts@ /* periods and parts of one that are predicted through */

static const real SCALE[4] = {@scale@};
static const real UNITS[SEEN] = {@units@}; /* of the observation */
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
static void act(@name@_policy *policy) {
  const @name@_measurement *sample = &policy->sample;
  const @name@_reference *target = &policy->target;
  real observed[SEEN], next[MEMORY], extra[EXTRA];
  real *memory = policy->memory, *action = policy->action;
  copy(3, sample->position, observed);
  copy(4, sample->quaternion, observed + 3);
  copy(3, sample->direction, observed + 7);
  observed[10] = sample->age;
  copy(21, target->derivatives[0], observed + 11);
  copy(3, target->yaw, observed + 32);
  copy(2, target->pole, observed + 35);
  for (int i = 0; i < SEEN; ++i) observed[i] = single(observed[i] / UNITS[i]);
#if NETWORK
  real read[READ];
  observe(observed, read);
  for (int i = 0; i < READ; ++i) read[i] = single(read[i]);
#endif
#if KALMAN || ADRC
  const real *seen_now = observed;
#else
  const real *seen_now = read;
#endif
  if (!policy->running) {
    begin(seen_now, memory);
    for (int i = 0; i < 4; ++i) action[i] = 0;
    for (int i = 0; i < EXTRA; ++i) policy->extra[i] = 0;
    policy->verdict[0] = policy->verdict[1] = 0;
    policy->running = 1;
  } else {
#if KALMAN
    int held = (int)(memory[HELD] + R(0.5)), row = (int)(memory[AGE] + R(0.5)); /* as `gain_row` of the package */
    if (held > 0 && row >= EARLY) {
      row = held > COASTS ? FIRST_COAST + COASTS - 1 : FIRST_COAST + held - 1;
    } else if (row >= FIRST_COAST) {
      row = FIRST_COAST - 1;
    }
    predict(memory, action, 0, 1);
    judge(memory, memory, seen_now, next, policy->verdict);
    copy(MEMORY, next, memory);
    if (policy->verdict[0] > 0) {
      miss(memory, seen_now, next);
    } else if (policy->verdict[1] > 0) {
      begin_anew(memory, seen_now, next);
    } else {
      correct(memory, seen_now, gains[gain_rows[row]], next);
    }
#elif ADRC
    real plant[MEMORY];
    release(memory, plant);
    predict(plant, action, 0, 1);
    judge(plant, memory, seen_now, next, policy->verdict);
    copy(MEMORY, next, plant);
    correct(memory, plant, seen_now, policy->verdict, next);
    if (policy->verdict[1] > 0) {
      copy(MEMORY, next, memory);
      begin_anew(memory, seen_now, next);
    }
#else
    correct(memory, seen_now, next);
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
  inputs(read, memory, later, action, policy->extra, seen, extra);
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
                  is_bounded(4, measurement->quaternion, 2) && is_bounded(3, measurement->direction, 2) &&
                  is_bounded(1, &measurement->age, largest);
  int is_target = is_bounded(21, reference->derivatives[0], largest) && is_bounded(3, reference->yaw, largest) &&
                  is_bounded(2, reference->pole, largest) && reference->pole[0] > 0 && reference->pole[1] > 0;
  policy->sample.age += R(@period@);
  if (is_sample) policy->sample = *measurement;
  if (is_target) policy->target = *reference;
  if (policy->running || (is_sample && is_target)) {
    act(policy);
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
