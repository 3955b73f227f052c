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
 * Numbers are float, or double with -DQUADPEND_DOUBLE. With -DQUADPEND_NO_LIBM nothing of math.h is used.
 */
#ifndef @name@_H
#define @name@_H

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
  @name@_real memory[@memory@], extra[@extra@], action[4], output[4];
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

#endif
