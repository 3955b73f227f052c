/* @title@
 *
 * @description@
 * Written by `quadpend export`. C99 without allocation; @name@_policy and the stack of a step are all the memory.
 *
 * Frames: the world has x, y horizontal and z up; the body has x forward, y left and z up along the thrust.
 * All units are SI units and radians.
 *
 *     @name@_policy policy;
 *     @name@_reset(&policy);                                        before each flight
 *     @name@_step(&policy, &measurement, &reference, &command);     every @name@_PERIOD seconds
 *
 * or, with the supervisor:
 *
 *     @name@_supervisor supervisor;
 *     @name@_supervisor_reset(&supervisor);                                    before each flight
 *     supervisor.request = @name@_FLY;                                         the switch of the pilot
 *     status = @name@_supervise(&supervisor, &measurement, NULL, &command);   every @name@_PERIOD seconds
 *
 * Numbers are float, or double with -DQUADPEND_DOUBLE. With -DQUADPEND_NO_LIBM nothing of math.h is used.
 */
#ifndef @name@_H
#define @name@_H

#include <stdint.h>

#define @name@_PERIOD @period@ /* s */
#define @name@_LATENCY @latency@ /* s, from a step until its command acts, for which the policy is designed */
#define @name@_INTERFACE "@interface@"
#define @name@_VEHICLE "@vehicle@"

#define @name@_POLE {@pole@} /* m and kg: the pole for which the policy is designed */

#ifdef QUADPEND_DOUBLE
typedef double @name@_real;
#else
typedef float @name@_real;
#endif

typedef struct {
  @name@_real position[3];   /* of the vehicle's centre, m, world frame */
  @name@_real quaternion[4]; /* attitude, body to world, order w, x, y, z, of length 1 */
  @name@_real direction[3];  /* unit vector along the pole, from its foot to its top, world frame */
  @name@_real age;           /* time since it was measured, beyond the usual delay, s; 0: it is new */
} @name@_measurement;

/* What the tracked point (x + l r_x, y + l r_y, z) follows: (x, y, z) is the vehicle's centre of mass, r the direction of
 * the pole, l the distance of its centre of mass from the joint. The point is the pole's centre of
 * mass if the joint is at the vehicle's centre of mass. */
typedef struct {
  @name@_real derivatives[7][3]; /* position (m), velocity, ..., sixth derivative (m/s^6), world frame */
  @name@_real yaw[3];            /* yaw (rad), its rate and acceleration */
  @name@_real pole[2];           /* what you believe: l (m) and the mass (kg), such as @name@_POLE */
} @name@_reference;

typedef struct {
  @name@_real thrust;    /* of all rotors, N, in [0, @most_thrust@] */
  @name@_real @turning@[3]; /* about the body's x, y, z, @turning_unit@, within +-{@limits@} */
} @name@_command;

/* The memory of a flight. Its fields are private. */
typedef struct {
  @name@_measurement sample; /* the latest one */
  @name@_reference target;   /* the latest one */
  @name@_real memory[@memory@], extra[@extra@], action[4], output[4], verdict[2];
  int running;
} @name@_policy;

void @name@_reset(@name@_policy *policy);

/* One control step. A measurement that is NULL, or has a number that is not finite, is a missing sample: @missing@.
 * A reference that is not finite, or has a pole without length or mass, is replaced by the latest one. Before the first
 * sample the command is that of hover. */
void @name@_step(@name@_policy *policy, const @name@_measurement *measurement, const @name@_reference *reference,
                 @name@_command *command);

/* Call this after a step if another command acts than the one of the step. */
void @name@_applied(@name@_policy *policy, const @name@_command *command);

/* The supervisor steps the policy, reports a status in each step, and kills: then thrust and @turning@ are 0 until a reset.
 * docs/deploy.md has the table of statuses and limits. */

enum { /* bits of a status. Those from AGE on kill in flight */
  @name@_BLIND = 1 << 0,      /* no sample was used in this step: it is missing, old, or one of the next three */
  @name@_INVALID = 1 << 1,    /* impossible numbers: not finite, no unit length, a negative age */
  @name@_FROZEN = 1 << 2,     /* the numbers of the sample before, with age 0 */
  @name@_OUTLIER = 1 << 3,    /* too far from the prediction */
  @name@_RESTARTED = 1 << 4,  /* more than @most_refused@ outliers in a row: the estimate begins anew at this sample */
  @name@_INNOVATION = 1 << 5, /* measured less predicted is larger than usual: a force, or less thrust */
  @name@_SATURATED = 1 << 6,  /* a command is at its bound */
  @name@_REFERENCE = 1 << 7,  /* not finite, a jump, faster than set points may be, or for another pole */
  @name@_CAUTION = 1 << 8,    /* tilt, distance or speed is beyond the share `caution` of its limit */
  @name@_AGE = 1 << 9,        /* blind for longer than the limit; the next ones too are limits */
  @name@_DIVERGED = 1 << 10,  /* the memory of the policy left its range */
  @name@_POLE_TILT = 1 << 11,
  @name@_BODY_TILT = 1 << 12,
  @name@_DISTANCE = 1 << 13,
  @name@_HEIGHT = 1 << 14,
  @name@_SPEED = 1 << 15,
  @name@_REQUEST = 1 << 16, /* the kill is requested, or the request is unknown */
  @name@_KILLED = 1 << 17   /* until a reset; `cause` has the status of the step of the kill */
};

enum { /* requests, and stages; after a kill the stage is KILL */
  @name@_OFF,  /* thrust 0 */
  @name@_HOLD, /* thrust of hover, for a vehicle that is held by hand; nothing is estimated or integrated */
  @name@_FLY,  /* begins at rest where the vehicle is, with the first usable sample within the limits */
  @name@_KILL
};

typedef struct {
  @name@_real pole_tilt, body_tilt; /* from upright and from level, rad */
  @name@_real distance;             /* of the tracked point from its reference, m */
  @name@_real height[2];            /* of the vehicle's centre, lowest and highest, m */
  @name@_real speed;                /* of the vehicle's centre, m/s */
  @name@_real age;                  /* time without a usable sample, s */
  @name@_real caution;              /* share of tilts, distance and speed beyond which the status is CAUTION */
  @name@_real innovation[3];        /* of position (m), angles (rad) and pole (1), mean of 50 ms; of Kalman observers */
  @name@_real set_point[2];         /* speed (m/s) and acceleration (m/s^2) of the profile to a set point */
  @name@_real yaw[2];               /* and of its yaw, rad/s and rad/s^2 */
} @name@_limits;

#define @name@_LIMITS \
  {@supervised@}

typedef struct {
  int request;           /* write it */
  @name@_limits limits; /* write them; @name@_LIMITS after a reset */
  int stage;             /* read this and what follows */
  uint32_t status, cause;
  @name@_real blind, innovation, saturated; /* s without a usable sample, share of its limit, s at a bound */
  @name@_reference reference;               /* of this step; write its pole, which profiles to set points believe */
  /* private: */
  @name@_policy policy;
  @name@_real sample[10], used[10], velocity[10]; /* latest sample, latest usable one with its derivative */
  @name@_real means[3][3], goal[4];               /* of innovations; set point x, y, z, yaw */
  @name@_real input[3][4], profile[7][4];         /* input of the lags and their output, with derivatives */
  int samples, refused, is_refused;
} @name@_supervisor;

void @name@_supervisor_reset(@name@_supervisor *supervisor);

/* One control step; returns its status. A `reference` that is NULL is the profile to the set point. */
uint32_t @name@_supervise(@name@_supervisor *supervisor, const @name@_measurement *measurement,
                          const @name@_reference *reference, @name@_command *command);

/* Go to a position of the tracked point (m) and a yaw (rad), at any time in flight; the first set point is where the flight
 * begins. One that is not finite or not between the limits of height is refused with the status REFERENCE. */
void @name@_go_to(@name@_supervisor *supervisor, const @name@_real position[3], @name@_real yaw);

#endif
