
/* The supervisor; see @name@.h */

#define KILLS (~(uint32_t)(@name@_AGE - 1))
#define LAG R(6)       /* 1/s, of each of six first-order lags in series, which filter the input of the profile */
#define CLOSING R(4)   /* 1/s, of the input near the set point */
#define BRAKING R(0.8) /* share of the acceleration that the input plans for braking */
#define JUMP R(0.01)   /* m and rad, of a reference beside what its derivatives say */
#define POLE_SHARE R(0.1)
#define REMEMBERED R(0.04) /* s, time constant of means of innovations and velocities */

static const real GATES[3][3] = {@gates@}; /* see `samples.judge` of the package: m, rad and 1, in s */
static const int PARTS_OF_SAMPLE[4] = {0, 3, 7, 10}; /* position, quaternion, direction */
static const real PERIOD = R(@period@);

static real length(int count, const real *x) {
  real square = 0;
  for (int i = 0; i < count; ++i) square += x[i] * x[i];
  return q_sqrt(square);
}

/* Return an angle from -pi to pi. */
static real wrapped(real angle) {
  return angle - R(6.2831853071795865) * q_floor(angle * R(0.15915494309189534) + R(0.5));
}

static int is_unit(int count, const real *x) {
  real size = is_bounded(count, x, 2) ? length(count, x) : 0;
  return size > R(0.95) && size < R(1.05);
}

static int is_possible(const @name@_reference *x) {
  return is_bounded(21, x->derivatives[0], R(1e6)) && is_bounded(3, x->yaw, R(1e6)) && is_bounded(2, x->pole, R(1e6)) &&
         x->pole[0] > 0 && x->pole[1] > 0;
}

/* Write the tracked point of the latest usable sample. */
static void tracked_point(const @name@_supervisor *s, real *point) {
  for (int i = 0; i < 3; ++i) point[i] = s->used[i] + (i < 2 ? s->reference.pole[0] * s->used[7 + i] : 0);
}

void @name@_supervisor_reset(@name@_supervisor *s) {
  static const @name@_limits limits = @name@_LIMITS;
  static const real pole[2] = @name@_POLE;
  *s = (@name@_supervisor){0};
  s->limits = limits;
  copy(2, pole, s->reference.pole);
}

/* Return what is wrong with a sample, and write how far each part is from what is expected, as a share of its gate. */
static uint32_t check_sample(@name@_supervisor *s, const @name@_measurement *seen, real *share) {
  real x[10], off[4], change = 0;
  share[0] = share[1] = share[2] = 0;
  s->blind = q_min(s->blind + PERIOD, R(1e6));
  if (!seen) return @name@_BLIND;
  if (!(is_bounded(3, seen->position, R(1e6)) && is_unit(4, seen->quaternion) && is_unit(3, seen->direction) &&
        seen->age >= 0 && seen->age < R(1e6)))
    return @name@_BLIND | @name@_INVALID;
  if (seen->age > 0) {
    s->blind = q_max(s->blind, seen->age);
    return @name@_BLIND;
  }
  copy(3, seen->position, x);
  copy(4, seen->quaternion, x + 3);
  copy(3, seen->direction, x + 7);
  for (int i = 0; i < 10; ++i) change += q_abs(x[i] - s->sample[i]);
  copy(10, x, s->sample);
  if (change == 0) return @name@_BLIND | @name@_FROZEN;
  if (!s->samples) return 0;
  real t = s->blind, turned = 0;
  for (int i = 3; i < 7; ++i) turned += x[i] * s->used[i];
  for (int part = 0; part < 3; ++part) {
    int first = PARTS_OF_SAMPLE[part], count = PARTS_OF_SAMPLE[part + 1] - first;
    real sign = part == 1 && turned < 0 ? R(-1) : R(1);
    for (int i = 0; i < count; ++i) off[i] = sign * x[first + i] - s->used[first + i] - t * s->velocity[first + i];
    real gate = GATES[part][0] + t * (GATES[part][1] + R(0.5) * t * GATES[part][2]);
    share[part] = (part == 1 ? 2 : 1) * length(count, off) / gate;
  }
  return 0;
}

/* Store a sample and the velocity, which a jump does not change, with which the next one is compared. */
static void accept(@name@_supervisor *s, int is_jump) {
  real turned = 0, gain = s->samples && !is_jump ? s->blind / (s->blind + REMEMBERED) : 0;
  for (int i = 3; i < 7; ++i) turned += s->sample[i] * s->used[i];
  for (int i = 0; i < 10; ++i) {
    real sign = i > 2 && i < 7 && turned < 0 ? R(-1) : R(1), before = sign * s->used[i], speed = sign * s->velocity[i];
    s->velocity[i] = speed + gain * ((s->sample[i] - before) / s->blind - speed);
  }
  copy(10, s->sample, s->used);
  s->samples = 1;
  s->blind = 0;
}

/* Return which limits the latest usable sample exceeds. */
static uint32_t check_limits(const @name@_supervisor *s) {
  const @name@_limits *most = &s->limits;
  const real *q = s->used + 3;
  real point[3], height = s->used[2];
  tracked_point(s, point);
  for (int i = 0; i < 3; ++i) point[i] -= s->reference.derivatives[0][i];
  real pole_tilt = q_atan2(length(2, s->used + 7), s->used[9]);
  real body_tilt = 2 * q_atan2(length(2, q + 1), q_sqrt(q[0] * q[0] + q[3] * q[3]));
  const real found[4] = {pole_tilt, body_tilt, length(3, point), length(3, s->velocity)};
  const real limits[4] = {most->pole_tilt, most->body_tilt, most->distance, most->speed};
  static const uint32_t bits[4] = {@name@_POLE_TILT, @name@_BODY_TILT, @name@_DISTANCE, @name@_SPEED};
  uint32_t status = height > most->height[0] && height < most->height[1] ? 0 : @name@_HEIGHT;
  for (int i = 0; i < 4; ++i) { /* a limit that is not a number is exceeded */
    if (!(found[i] <= limits[i])) status |= bits[i];
    if (!(found[i] <= most->caution * limits[i])) status |= @name@_CAUTION;
  }
  return status;
}

/* Return x^(6) of the output x of the lags for their input u: sum of C(6, k) x^(k) / LAG^k = u. */
static const real BINOMIAL[7] = {1, 6, 15, 20, 15, 6, 1};
static real sixth_derivative(const real *x, real u) {
  real sum = u - x[0], power = 1;
  for (int k = 1; k < 6; ++k) sum -= BINOMIAL[k] * x[k] / (power *= LAG);
  return sum * power * LAG;
}

/* Begin the profile at a reference, with the input for which the lags have these derivatives. */
static void begin_profile(@name@_supervisor *s, const @name@_reference *from) {
  for (int i = 0; i < 4; ++i) {
    for (int k = 0; k < 7; ++k) s->profile[k][i] = i < 3 ? from->derivatives[k][i] : k < 3 ? from->yaw[k] : 0;
    real power = 1;
    s->input[0][i] = s->input[1][i] = s->input[2][i] = 0;
    for (int k = 0; k < 7; ++k, power /= LAG) {
      s->input[0][i] += BINOMIAL[k] * power * s->profile[k][i];
      if (k < 6) s->input[1][i] += BINOMIAL[k] * power * s->profile[k + 1][i];
    }
    s->goal[i] = s->input[0][i];
  }
}

/* Advance some of x, y, z and yaw by a period. The input moves to the set point within the limits of speed and
 * acceleration. The impulse response of the lags is positive with an integral of 1, so their output keeps these limits. */
static void advance_profile(@name@_supervisor *s, int first, int count, const real *limits) {
  real left[3], change[3], *speed = s->input[1] + first, *acceleration = s->input[2] + first;
  real fastest = q_max(limits[0], 0), most = q_max(limits[1], 0); /* 0 for what is not a number */
  for (int i = 0; i < count; ++i) left[i] = s->goal[first + i] - s->input[0][first + i];
  real distance = length(count, left), braking = BRAKING * most, linear = braking / (CLOSING * CLOSING);
  real wished = CLOSING * distance;
  if (distance > linear) wished = q_sqrt(2 * braking * (distance - R(0.5) * linear));
  wished = distance > 0 ? q_min(wished, fastest) / distance : 0;
  for (int i = 0; i < count; ++i) change[i] = wished * left[i] - speed[i];
  real size = length(count, change), share = size > most * PERIOD ? most * PERIOD / size : 1;
  for (int i = 0; i < count; ++i) acceleration[i] = share * change[i] / PERIOD;
  for (int axis = first; axis < first + count; ++axis) {
    real x[13], *input[3] = {&s->input[0][axis], &s->input[1][axis], &s->input[2][axis]};
    for (int k = 0; k < 6; ++k) x[k] = s->profile[k][axis];
    for (int k = 0; k < 7; ++k) x[6 + k] = sixth_derivative(x + k, k < 3 ? *input[k] : 0);
    for (int k = 0; k < 6; ++k) { /* Taylor series */
      real sum = x[k + 7];
      for (int i = 6; i >= 0; --i) sum = x[k + i] + sum * PERIOD / (real)(i + 1);
      s->profile[k][axis] = sum;
    }
    *input[0] += PERIOD * (*input[1] + R(0.5) * PERIOD * *input[2]);
    *input[1] += PERIOD * *input[2];
    for (int k = 0; k < 6; ++k) x[k] = s->profile[k][axis];
    s->profile[6][axis] = sixth_derivative(x, *input[0]);
  }
}

void @name@_go_to(@name@_supervisor *s, const real position[3], real yaw) {
  if (s->stage != @name@_FLY || !is_bounded(3, position, R(1e6)) || !is_bounded(1, &yaw, R(1e6)) ||
      !(position[2] > s->limits.height[0] && position[2] < s->limits.height[1])) {
    s->is_refused = 1;
    return;
  }
  copy(3, position, s->goal);
  s->goal[3] = s->input[0][3] + wrapped(yaw - s->input[0][3]);
}

/* Return what is doubtful in a reference, and make it that of this step. */
static uint32_t advance_reference(@name@_supervisor *s, const @name@_reference *wanted) {
  @name@_reference *now = &s->reference;
  const @name@_limits *most = &s->limits;
  const real pole[2] = @name@_POLE;
  uint32_t status = 0;
  if (!wanted) {
    advance_profile(s, 0, 3, most->set_point);
    advance_profile(s, 3, 1, most->yaw);
    for (int k = 0; k < 7; ++k) copy(3, s->profile[k], now->derivatives[k]);
    for (int k = 0; k < 3; ++k) now->yaw[k] = s->profile[k][3];
    return is_possible(now) ? 0 : @name@_REFERENCE;
  }
  if (!is_possible(wanted)) return @name@_REFERENCE;
  real off[3], turn = wanted->yaw[0] - now->yaw[0] - PERIOD * now->yaw[1];
  for (int i = 0; i < 3; ++i) {
    off[i] = wanted->derivatives[0][i] - now->derivatives[0][i] - PERIOD * now->derivatives[1][i];
    if (i < 2 && q_abs(wanted->pole[i] / pole[i] - 1) > POLE_SHARE) status = @name@_REFERENCE;
  }
  if (length(3, off) > JUMP || q_abs(turn) > JUMP || !(length(3, wanted->derivatives[1]) <= most->set_point[0]) ||
      !(length(3, wanted->derivatives[2]) <= most->set_point[1]) || !(q_abs(wanted->yaw[1]) <= most->yaw[0]) ||
      !(q_abs(wanted->yaw[2]) <= most->yaw[1]))
    status = @name@_REFERENCE;
  *now = *wanted;
  begin_profile(s, now);
  return status;
}

/* Begin anew with the latest sample: the reference is at rest where the vehicle is, or the given one. */
static void initialise(@name@_supervisor *s, const @name@_reference *wanted) {
  const real *q = s->used + 3;
  real point[3];
  tracked_point(s, point);
  for (int k = 0; k < 7; ++k) {
    for (int i = 0; i < 3; ++i) s->reference.derivatives[k][i] = k == 0 ? point[i] : 0;
  }
  s->reference.yaw[0] = q_atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]));
  s->reference.yaw[1] = s->reference.yaw[2] = 0;
  if (wanted && is_possible(wanted)) s->reference = *wanted;
  begin_profile(s, &s->reference);
  for (int i = 0; i < 9; ++i) s->means[i / 3][i % 3] = 0;
  s->innovation = s->saturated = 0;
  @name@_reset(&s->policy);
}

/* Return the status of a sample that is refused or accepted. */
static uint32_t accept_or_refuse(@name@_supervisor *s, int is_far, int restarts) {
  if (is_far) return @name@_BLIND | @name@_OUTLIER;
  s->refused = 0;
  accept(s, restarts);
  return restarts ? @name@_RESTARTED : 0;
}

/* Step the policy, and return what is wrong. `far` is the largest distance of a sample as a share of its gate. */
static uint32_t step_policy(@name@_supervisor *s, const @name@_measurement *seen, real far, @name@_command *command) {
  int was_running = s->policy.running, is_saturated = 0;
  @name@_step(&s->policy, seen, &s->reference, command);
  uint32_t status = was_running && !s->policy.running ? @name@_DIVERGED : 0;
  s->innovation = 5 * far;
#if KALMAN
  const real *innovation = s->policy.memory + INNOVATION, gain = PERIOD / (PERIOD + REMEMBERED);
  s->innovation = 0;
  for (int part = 0; part < 3; ++part) {
    for (int i = 0; i < 3; ++i) s->means[part][i] += gain * (innovation[6 * part + i] - s->means[part][i]);
    s->innovation = q_max(s->innovation, length(3, s->means[part]) / s->limits.innovation[part]);
  }
#endif
  for (int i = 0; i < 4; ++i) is_saturated |= q_abs(s->policy.action[i]) >= 1;
  s->saturated = is_saturated ? s->saturated + PERIOD : 0;
  return status | (s->innovation <= 1 ? 0 : @name@_INNOVATION) | (is_saturated ? @name@_SATURATED : 0);
}

uint32_t @name@_supervise(@name@_supervisor *s, const @name@_measurement *seen, const @name@_reference *wanted,
                          @name@_command *command) {
  real share[3];
  uint32_t status = check_sample(s, seen, share);
  real far = q_max(q_max(share[0], share[1]), share[2]);
  int is_new = !(status & @name@_BLIND), flew = s->stage == @name@_FLY, has_observer = KALMAN || ADRC;
  int is_far = is_new && !(far <= 1) && !(flew && has_observer), restarts = is_far && ++s->refused > @most_refused@;
  is_far = is_far && !restarts;
  if (s->is_refused || (wanted && !is_possible(wanted))) status |= @name@_REFERENCE;
  s->is_refused = 0;
  if (s->request < @name@_OFF || s->request >= @name@_KILL) {
    status |= @name@_REQUEST;
  } else if (s->request != @name@_FLY && s->stage != @name@_KILL) { /* released */
    s->stage = s->request;
    flew = 0;
  }
  command->thrust = s->stage == @name@_HOLD ? SCALE[0] : 0;
  for (int i = 0; i < 3; ++i) command->@turning@[i] = 0;
  if (!flew && is_new) status |= accept_or_refuse(s, is_far, restarts);
  if (!flew && s->stage != @name@_KILL) {
    initialise(s, wanted);
    if (!(status & @name@_BLIND)) status |= check_limits(s);
    if (s->request == @name@_FLY && !(status & (@name@_BLIND | KILLS))) {
      s->stage = @name@_FLY;
      status |= step_policy(s, seen, 0, command);
    }
  } else if (flew) {
    status |= advance_reference(s, wanted);
    status |= step_policy(s, is_far || (status & @name@_INVALID) ? 0 : seen, far, command);
    if (has_observer) {
      is_far = s->policy.verdict[0] > 0;
      restarts = s->policy.verdict[1] > 0;
    }
    if (is_new) status |= accept_or_refuse(s, is_far, restarts);
    if (!(status & @name@_BLIND)) status |= check_limits(s);
  }
  if (!(s->blind <= s->limits.age)) status |= @name@_AGE;
  if (s->stage != @name@_KILL && ((status & @name@_REQUEST) || (s->stage == @name@_FLY && (status & KILLS)))) {
    s->stage = @name@_KILL;
    s->cause = status | @name@_KILLED;
  }
  if (s->stage == @name@_KILL) {
    status |= @name@_KILLED;
    command->thrust = 0;
    for (int i = 0; i < 3; ++i) command->@turning@[i] = 0;
  }
  return s->status = status;
}
