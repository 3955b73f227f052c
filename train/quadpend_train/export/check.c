/* Golden vectors of @name@.c: inputs of @steps@ control steps and what the Python policy commanded. See docs/deploy.md.
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

int main(void) {
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
  printf("%s: largest error %.2g of the range of the command\n", worst <= TOLERANCE ? "passed" : "failed", (double)worst);
  return !(worst <= TOLERANCE);
}
