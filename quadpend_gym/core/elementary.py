"""Sine, cosine, arcsine, arctangent, logarithm and selection without branches or library calls.

A compiler can therefore vectorise a loop that calls them. `quadpend_gym.engines` replaces them by CasADi's functions.

| function | method | error |
|---|---|---|
| `sincos` | Cody–Waite reduction to [−π/4, π/4] in three parts of π/2, minimax polynomials | ≤ 2 ulp for abs(x) ≤ 10⁵ |
| `arcsin` | rational function of x²; for x > ½ the identity arcsin x = π/2 − 2 arcsin √((1−x)/2) | ≤ 2 ulp on [0, 1] |
| `arctan2` | ratio t of the coordinates in [0, 1], (t−1)/(t+1) for t > 0.66, rational function of t² | ≤ 2 ulp |
| `log`    | x = 2ᵏ·m with m in [√½, √2), series in s = (m−1)/(m+1) | ≤ 2 ulp for normal x > 0 |

The coefficients are those of FDLIBM (Sun Microsystems, 1993); those of the arctangent are from Cephes (Moshier, 1989).
``tests/quadpend_gym/core/test_elementary.py`` measures the errors.
"""

import numpy as np

from quadpend_gym.core.jit import inlined

_TWO_OVER_PI = 0.6366197723675814
# π/2 as a sum. The first two terms have 33 significant bits, so the product k·term is exact for k < 2²⁰.
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10


@inlined
def select(condition: bool, chosen: float, other: float) -> float:
    """Return `chosen` if the condition holds, else `other`; `quadpend_gym.engines` cannot read ``if`` on a variable."""
    return chosen if condition else other


@inlined
def sincos(x: float) -> tuple[float, float]:
    """Return (sin x, cos x) for x in rad."""
    k = np.rint(x * _TWO_OVER_PI)
    rest = x - k * _HALF_PI[0]
    middle = k * _HALF_PI[1]
    reduced = rest - middle
    # Rounding loses a part of `middle` in `reduced`; subtract this part together with the last term.
    r = reduced - (k * _HALF_PI[2] - ((rest - reduced) - middle))
    z = r * r
    s = 1.58969099521155010221e-10
    s = z * s - 2.50507602534068634195e-08
    s = z * s + 2.75573137070700676789e-06
    s = z * s - 1.98412698298579493134e-04
    s = z * s + 8.33333333332248946124e-03
    s = z * s - 1.66666666666666324348e-01
    s = r + r * z * s
    c = -1.13596475577881948265e-11
    c = z * c + 2.08757232129817482790e-09
    c = z * c - 2.75573143513906633035e-07
    c = z * c + 2.48015872894767294178e-05
    c = z * c - 1.38888888888741095749e-03
    c = z * c + 4.16666666666666019037e-02
    c = 1.0 - 0.5 * z + z * z * c
    quadrant = k - 4.0 * np.floor(0.25 * k)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quadrant >= 2.0 else sine
    cosine = -cosine if (quadrant == 1.0) | (quadrant == 2.0) else cosine
    return sine, cosine


@inlined
def arcsin(x: float) -> float:
    """Return the arcsine of x in rad, for x in [0, 1]."""
    steep = x > 0.5
    z = 0.5 * (1.0 - x) if steep else x * x
    y = np.sqrt(z) if steep else x
    p = 3.47933107596021167570e-05
    p = z * p + 7.91534994289814532176e-04
    p = z * p - 4.00555345006794114027e-02
    p = z * p + 2.01212532134862925881e-01
    p = z * p - 3.25565818622400915405e-01
    p = z * p + 1.66666666666666657415e-01
    q = 7.70381505559019352791e-02
    q = z * q - 6.88283971605453293030e-01
    q = z * q + 2.02094576023350569471e00
    q = z * q - 2.40339491173441421878e00
    q = z * q + 1.0
    rest = y * (z * p / q)
    quarter = 0.25 * np.pi
    return float(quarter - ((2.0 * y - quarter) + 2.0 * rest)) if steep else float(y + rest)


@inlined
def arctan2(y: float, x: float) -> float:
    """Return the angle of the point (x, y) from the x axis, rad in [−π, π]; 0 for the origin."""
    width, height = abs(x), abs(y)
    steep = height > width
    low, high = width if steep else height, height if steep else width
    high = high if high > 0.0 else 1.0
    shifted = low > 0.66 * high
    t = (low - high if shifted else low) / (low + high if shifted else high)
    z = t * t
    p = -8.750608600031904122785e-01
    p = z * p - 1.615753718733365076637e01
    p = z * p - 7.500855792314704667340e01
    p = z * p - 1.228866684490136173410e02
    p = z * p - 6.485021904942025371773e01
    q = z + 2.485846490142306297962e01
    q = z * q + 1.650270098316988542046e02
    q = z * q + 4.328810604912902668951e02
    q = z * q + 4.853903996359136964868e02
    q = z * q + 1.945506571482613964425e02
    angle = t + t * (z * p / q)
    angle = angle + 3.061616997868383e-17 if shifted else angle
    angle = 0.25 * np.pi + angle if shifted else angle
    angle = 0.5 * np.pi - angle if steep else angle
    angle = np.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@inlined
def log(x: float) -> float:
    """Return the natural logarithm of x, a positive normal number (not a subnormal one)."""
    bits = np.float64(x).view(np.int64)
    # The constant is bits(1) − bits(√½), with the bits of a float read as an integer; it puts m into [√½, √2).
    k = ((bits + 0x95F619980C433) >> 52) - 1023
    m = np.int64(bits - (k << 52)).view(np.float64)
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    p = 1.479819860511658591e-01
    p = z * p + 1.531383769920937332e-01
    p = z * p + 1.818357216161805012e-01
    p = z * p + 2.222219843214978396e-01
    p = z * p + 2.857142874366239149e-01
    p = z * p + 3.999999999940941908e-01
    p = z * p + 6.666666666666735130e-01
    half_square = 0.5 * f * f
    return float(k * _LN2_HIGH - ((half_square - (s * (half_square + z * p) + k * _LN2_LOW)) - f))
