"""Elementary functions of the kernels, from additions, products and quotients alone: the same bits on every machine.

The last digit of `sin` differs from one C library to the next. What is computed here is what exported code computes, on
any processor with IEEE 754 doubles. The largest errors found are 0.9 units of the last place (sin and cos of angles
below 1e6 rad, exp), 1.3 (atan2, hypot) and 2 (tan).

Kernels and constants of sine, cosine, arc tangent and exponential are those of FreeBSD's msun (k_sin.c, k_cos.c,
e_rem_pio2.c, s_atan.c, e_atan2.c, e_exp.c), written anew without access to bits:

    Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.
    Developed at SunPro, a Sun Microsystems, Inc. business. Permission to use, copy, modify, and distribute this
    software is freely granted, provided that this notice is preserved.
"""

import math

from estimators.jit import njit

_PIO4 = math.pi / 4
_PIO2_1, _PIO2_2, _PIO2_3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21
_PIO2_3T = 8.47842766036889956997e-32  # pi/2 less those three, of 33 bits each
_LARGEST = 1e6  # rad: beyond, the quadrant is taken from a remainder that has lost digits
_LN2_HI, _LN2_LO, _LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10, 0.6931471805599453
_PI_LO = 1.2246467991473531772e-16
_UP, _DOWN = 2.0**600, 2.0**-600


@njit
def _sine(x: float, y: float) -> float:
    """Sine of x + y, x at most pi/4 and y its tail."""
    z = x * x
    w = z * z
    r = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06)
    r += z * w * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    v = z * x
    return x - ((z * (0.5 * y - v * r) - y) - v * -1.66666666666666324348e-01)


@njit
def _cosine(x: float, y: float) -> float:
    """Cosine of x + y, likewise."""
    z = x * x
    w = z * z
    r = z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05))
    r += w * w * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
    half = 0.5 * z
    w = 1.0 - half
    return w + (((1.0 - w) - half) + (z * r - x * y))


@njit
def _reduced(x: float) -> tuple[int, float, float]:
    """Quadrant of x, and what is left of it with its tail."""
    if -_PIO4 <= x <= _PIO4:
        return 0, x, 0.0
    if not abs(x) < _LARGEST:
        x = modulo(x, 2.0 * math.pi)
    n = int(x * 6.36619772367581382433e-01 + (0.5 if x > 0.0 else -0.5))
    f = float(n)
    a = x - f * _PIO2_1
    b = f * _PIO2_2
    c = a - b
    lost = (a - c) - b  # of the difference, exactly
    b = f * _PIO2_3 + (f * _PIO2_3T - lost)
    y = c - b
    return n & 3, y, (c - y) - b


@njit
def sin(x: float) -> float:
    """Sine of x (rad)."""
    if not math.isfinite(x):
        return math.nan
    quadrant, y, tail = _reduced(x)
    value: float = _sine(y, tail) if quadrant % 2 == 0 else _cosine(y, tail)
    return -value if quadrant >= 2 else value


@njit
def cos(x: float) -> float:
    """Cosine of x (rad)."""
    if not math.isfinite(x):
        return math.nan
    quadrant, y, tail = _reduced(x)
    value: float = _cosine(y, tail) if quadrant % 2 == 0 else _sine(y, tail)
    return -value if quadrant in (1, 2) else value


@njit
def tan(x: float) -> float:
    """Tangent of x (rad)."""
    slope: float = sin(x) / cos(x)
    return slope


@njit
def _arc(x: float) -> float:
    """Arc tangent of x, not negative."""
    high, low = 0.0, 0.0
    if x >= 2.4375:
        high, low, x = 1.57079632679489655800, 6.12323399573676603587e-17, -1.0 / x
    elif x >= 1.1875:
        high, low, x = 9.82793723247329054082e-01, 1.39033110312309984516e-17, (x - 1.5) / (1.0 + 1.5 * x)
    elif x >= 0.6875:
        high, low, x = 7.85398163397448278999e-01, 3.06161699786838301793e-17, (x - 1.0) / (x + 1.0)
    elif x >= 0.4375:
        high, low, x = 4.63647609000806093515e-01, 2.26987774529616870924e-17, (2.0 * x - 1.0) / (2.0 + x)
    z = x * x
    w = z * z
    odd = 4.97687799461593236017e-02 + w * 1.62858201153657823623e-02
    odd = 9.09088713343650656196e-02 + w * (6.66107313738753120669e-02 + w * odd)
    odd = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * odd))
    even = -5.83357013379057348645e-02 + w * -3.65315727442169155270e-02
    even = w * (
        -1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01 + w * (-7.69187620504482999495e-02 + w * even))
    )
    return high - ((x * (odd + even) - low) - x)


@njit
def atan2(y: float, x: float) -> float:
    """Angle (rad) of the point (x, y), in [-pi, pi]; signs of zeros count."""
    if math.isnan(x) or math.isnan(y):
        return math.nan
    if math.isinf(x) and math.isinf(y):
        y, x = math.copysign(1.0, y), math.copysign(1.0, x)
    beside = abs(y) > 1e18 * abs(x)  # a right angle to the last digit
    angle = 0.5 * math.pi if beside else 0.0 if y == 0.0 else _arc(abs(y / x))
    if math.copysign(1.0, x) < 0.0 and not beside:
        angle = math.pi - (angle - _PI_LO)
    return math.copysign(angle, y)


@njit
def asin(x: float) -> float:
    """Angle (rad) whose sine is x, at most 1 in size."""
    angle: float = atan2(x, math.sqrt((1.0 - x) * (1.0 + x)))
    return angle


@njit
def _power_of_two(k: int) -> float:
    """Two to the power k, at most 1023 in size."""
    value, base = 1.0, 2.0 if k > 0 else 0.5
    for bit in range(10):
        if (abs(k) >> bit) & 1:
            value *= base
        base *= base
    return value


@njit
def exp(x: float) -> float:
    """Exponential of x."""
    if math.isnan(x):
        return x
    if x > 709.782712893383973096:
        return math.inf
    if x < -745.13321910194110842:
        return 0.0
    k, high, low = 0, x, 0.0
    if abs(x) > 0.5 * _LN2:
        k = int(x * 1.44269504088896338700 + (0.5 if x > 0.0 else -0.5))
        high, low = x - k * _LN2_HI, k * _LN2_LO
    x = high - low
    t = x * x
    c = 6.61375632143793436117e-05 + t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08)
    c = x - t * (1.66666666666666019037e-01 + t * (-2.77777777770155933842e-03 + t * c))
    y = 1.0 - ((low - (x * c) / (2.0 - c)) - high)
    half = k // 2
    value: float = y * _power_of_two(half) * _power_of_two(k - half)
    return value


@njit
def hypot(x: float, y: float) -> float:
    """Length of (x, y); neither overflows nor vanishes for what can be represented."""
    x, y = abs(x), abs(y)
    if math.isinf(x) or math.isinf(y):
        return math.inf
    scale = 1.0
    if max(x, y) > 1e150:
        scale = _UP
    elif max(x, y) < 1e-150:
        scale = _DOWN
    x, y = x / scale, y / scale
    return scale * math.sqrt(x * x + y * y)


@njit
def ceil(x: float) -> int:
    """The least integer not below x, small enough to be one."""
    whole = int(x)
    return whole + 1 if whole < x else whole


@njit
def modulo(x: float, m: float) -> float:
    """X - m floor(x / m), m positive: exact but for the sign's, as Python's %."""
    if not math.isfinite(x):
        return math.nan
    r, step = abs(x), m
    while step <= 0.5 * r:
        step *= 2.0
    while step >= m:
        if r >= step:
            r -= step
        step *= 0.5
    if x < 0.0 and r > 0.0:
        r = m - r
    return r
