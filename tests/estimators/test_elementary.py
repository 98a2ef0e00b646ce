"""Elementary functions of the kernels: against those of a C library in extended precision, and in corner cases."""

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest

import estimators
from estimators import elementary

RNG = np.random.default_rng(1)
SMALL, LARGE = RNG.uniform(-0.8, 0.8, 2000), RNG.uniform(-1e6, 1e6, 2000)
NEAR = np.arange(1, 2001) * (0.5 * math.pi)  # the worst of the reduction
ANGLES = np.concatenate([SMALL, RNG.uniform(-7.0, 7.0, 2000), LARGE, NEAR])
PLANE = RNG.normal(size=(2, 4000)) * 10.0 ** RNG.uniform(-6, 6, (2, 4000))


def worst(function, reference, *columns):
    """The largest error in units of the last place."""
    found = np.array([function(*row) for row in zip(*(c.tolist() for c in columns), strict=True)], np.longdouble)
    expected = reference(*(c.astype(np.longdouble) for c in columns))
    return float(np.max(np.abs(found - expected) / np.spacing(np.abs(expected.astype(float)))))


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="no longer type than double here")
@pytest.mark.parametrize(
    ("name", "reference", "columns", "most"),
    [
        ("sin", np.sin, (ANGLES,), 0.9),
        ("cos", np.cos, (ANGLES,), 0.9),
        ("tan", np.tan, (ANGLES,), 2.0),
        ("asin", np.arcsin, (RNG.uniform(-1.0, 1.0, 4000),), 2.5),
        ("atan2", np.arctan2, tuple(PLANE), 1.4),
        ("hypot", np.hypot, tuple(PLANE), 1.4),
        ("exp", np.exp, (RNG.uniform(-700.0, 700.0, 4000),), 0.9),
    ],
)
def test_the_last_digit_is_right_or_next_to_it(name, reference, columns, most):
    assert worst(getattr(elementary, name), reference, *columns) < most


def test_remainders_are_exact():
    for x in LARGE * 1e3:
        assert elementary.modulo(x, 2.0 * math.pi) == x % (2.0 * math.pi)


def test_corners():
    special = (0.0, -0.0, 1.0, -1.0, 1e300, -1e-300, math.inf, -math.inf, math.nan)
    for y, x in itertools.product(special, special):
        np.testing.assert_array_equal(elementary.atan2(y, x), math.atan2(y, x))
        assert math.copysign(1.0, elementary.atan2(y, x)) == math.copysign(1.0, math.atan2(y, x)) or math.isnan(x + y)
    for name in ("sin", "cos", "tan"):
        for x in (math.inf, -math.inf, math.nan):
            assert math.isnan(getattr(elementary, name)(x))
    assert math.copysign(1.0, elementary.sin(-0.0)) == -1.0
    assert elementary.hypot(3e300, 4e300) == 5e300
    assert elementary.hypot(3e-300, 4e-300) == pytest.approx(5e-300, rel=1e-15)
    assert elementary.hypot(math.inf, math.nan) == math.inf
    assert elementary.exp(710.0) == math.inf
    assert elementary.exp(-746.0) == 0.0
    assert elementary.exp(-740.0) == pytest.approx(math.exp(-740.0), rel=1e-2)  # subnormal
    assert [elementary.ceil(x) for x in (2.0, 2.1, -2.1, 0.0)] == [2, 3, -2, 0]


def test_kernels_use_no_others():
    """What a C library gives would not be the same everywhere; the papers' emitter and what runs once may."""
    root = Path(estimators.__file__).parent
    free = {"elementary.py", "catalogue.py", "locate.py", "emitter.py", "gaussian_sum.py", "navigator.py"}
    pattern = re.compile(r"math\.(sin|cos|tan|asin|acos|atan2?|exp|log|hypot|pow|fmod)\(")
    for path in sorted(root.rglob("*.py")):
        lines = path.read_text(encoding="utf-8").splitlines()
        found = [line for line in lines if pattern.search(line) and not line.startswith("_AHEAD")]
        assert path.name in free or not found, (path.name, found)
