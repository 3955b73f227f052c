#ifdef QUADPEND_NO_LIBM
/* Methods of quadpend_gym/core/elementary.py. Errors are a few units in the last place, of the result or of 1. */
#include <stdint.h>
#ifdef QUADPEND_DOUBLE
typedef union { double x; int64_t bits; } q_bits;
#define Q_HALF_ROOT 0x1ff7a3bea91d9b1bLL
#define Q_BIAS 1023
#define Q_FRACTION 52
#else
typedef union { float x; int32_t bits; } q_bits;
#define Q_HALF_ROOT 0x1fbd1df5
#define Q_BIAS 127
#define Q_FRACTION 23
#endif

static inline real q_abs(real x) { return x < 0 ? -x : x; }

static inline real q_floor(real x) {
  if (!(x < R(1e9) && x > R(-1e9))) return x;
  real whole = (real)(int32_t)x;
  return whole > x ? whole - 1 : whole;
}

static inline real q_sqrt(real x) {
  q_bits root;
  if (!(x > R(1e-30))) return 0;
  root.x = x;
  root.bits = Q_HALF_ROOT + root.bits / 2;
  for (int i = 0; i < 4; ++i) root.x = R(0.5) * (root.x + x / root.x);
  return root.x;
}

static real q_turned(real x, real quarters) { /* sin(x + quarters pi/2) */
  real k = q_floor(x * R(0.63661977236758134) + R(0.5)), r = (x - k * R(1.5703125)) - k * R(4.8382679489661923e-4);
  real z = r * r, quadrant = k + quarters - 4 * q_floor(R(0.25) * (k + quarters)), s, c;
  s = R(2.75573137070700676789e-06) + z * (R(-2.50507602534068634195e-08) + z * R(1.58969099521155010221e-10));
  s = R(8.33333333332248946124e-03) + z * (R(-1.98412698298579493134e-04) + z * s);
  s = r + r * z * (R(-1.66666666666666324348e-01) + z * s);
  c = R(-2.75573143513906633035e-07) + z * (R(2.08757232129817482790e-09) + z * R(-1.13596475577881948265e-11));
  c = R(-1.38888888888741095749e-03) + z * (R(2.48015872894767294178e-05) + z * c);
  c = 1 - R(0.5) * z + z * z * (R(4.16666666666666019037e-02) + z * c);
  if (quadrant == 1) return c;
  if (quadrant == 2) return -s;
  return quadrant == 3 ? -c : s;
}
static inline real q_sin(real x) { return q_turned(x, 0); }
static inline real q_cos(real x) { return q_turned(x, 1); }

static inline real q_atan2(real y, real x) {
  real width = q_abs(x), height = q_abs(y), low = width < height ? width : height, high = width + height - low, t, z, p, q;
  int shifted = low > R(0.66) * high;
  if (!(high > 0)) return 0;
  t = shifted ? (low - high) / (low + high) : low / high;
  z = t * t;
  p = R(-1.615753718733365076637e01) + z * R(-8.750608600031904122785e-01);
  p = R(-6.485021904942025371773e01) + z * (R(-1.228866684490136173410e02) + z * (R(-7.500855792314704667340e01) + z * p));
  q = R(4.328810604912902668951e02) + z * (R(1.650270098316988542046e02) + z * (R(2.485846490142306297962e01) + z));
  q = R(1.945506571482613964425e02) + z * (R(4.853903996359136964868e02) + z * q);
  t += t * (z * p / q);
  if (shifted) t += R(0.78539816339744831);
  if (height > width) t = R(1.5707963267948966) - t;
  if (x < 0) t = R(3.1415926535897932) - t;
  return y < 0 ? -t : t;
}

static inline real q_exp(real x) {
  q_bits power;
  real limited = x > 87 ? 87 : x > -87 ? x : -87, k = q_floor(limited * R(1.4426950408889634) + R(0.5)), y = 1;
  real r = (limited - k * R(0.693145751953125)) - k * R(1.4286068203094172e-06);
  for (int i = 13; i > 0; --i) y = 1 + y * r / (real)i;
  power.bits = (int32_t)k + Q_BIAS;
  power.bits <<= Q_FRACTION;
  return y * power.x;
}

static inline real q_tanh(real x) {
  real rest = 2 / (1 + q_exp(2 * q_abs(x)));
  return x < 0 ? rest - 1 : 1 - rest;
}
#else
#include <math.h>
#ifdef QUADPEND_DOUBLE
#define Q(function) function
#else
#define Q(function) function##f
#endif
#define q_abs Q(fabs)
#define q_floor Q(floor)
#define q_sqrt Q(sqrt)
#define q_sin Q(sin)
#define q_cos Q(cos)
#define q_atan2 Q(atan2)
#define q_exp Q(exp)
#define q_tanh Q(tanh)
#endif
