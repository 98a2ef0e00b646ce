"""Filters, delays and clocks against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_sim.attitude import matrix
from ahrs_sim.errors import InputError
from ahrs_sim.sensors.sampling import BandLimit, Clock, Lag, divider

DT = 1 / 400


def response(band: BandLimit, frequency: float, every: int) -> complex:
    """Complex gain at `frequency`, from the settled tail of a sine."""
    n = 8000
    t = np.arange(n) * DT
    x = np.tile(np.sin(2 * np.pi * frequency * t)[:, None], 3)
    rows = slice(0, n, every)
    y = band.apply(x, rows, np.zeros(len(t[rows])))[:, 0]
    basis = np.column_stack([np.sin(2 * np.pi * frequency * t[rows]), np.cos(2 * np.pi * frequency * t[rows])])
    a, b = np.linalg.lstsq(basis[len(y) // 2 :], y[len(y) // 2 :], rcond=None)[0]
    return complex(a, b)


@pytest.mark.parametrize("cutoff", [20.0, 50.0, 140.0])
def test_low_pass_is_butterworth(cutoff: float) -> None:
    at_corner = response(BandLimit(cutoff, 0.0, DT, 1), cutoff, 1)
    assert abs(at_corner) == pytest.approx(np.sqrt(0.5), rel=1e-6)
    assert np.angle(at_corner) == pytest.approx(-np.pi / 2, abs=1e-6)
    warped = np.tan(np.pi * 5.0 * DT) / np.tan(np.pi * cutoff * DT)
    assert abs(response(BandLimit(cutoff, 0.0, DT, 4), 5.0, 4)) == pytest.approx(1 / np.sqrt(1 + warped**4), rel=1e-9)


@pytest.mark.parametrize(
    ("cutoff", "delay"), [(0.0, 0.0), (0.0, 0.0064), (50.0, 0.0064), (50.0, 0.0319), (50.0, 0.001)]
)
def test_total_delay_at_low_frequency(cutoff: float, delay: float) -> None:
    band = BandLimit(cutoff, delay, DT, 4)
    own = np.sqrt(2) / (2 / DT * np.tan(np.pi * cutoff * DT)) if cutoff else 0.0
    assert band.delay == pytest.approx(max(delay, own))
    assert -np.angle(response(band, 0.5, 4)) / np.pi == pytest.approx(band.delay, rel=2e-3, abs=1e-12)


def test_settled_on_the_first_value_and_exact_without_filter() -> None:
    x = np.full((40, 3), 3.7)
    np.testing.assert_allclose(BandLimit(30.0, 0.02, DT, 4).apply(x, slice(0, 40, 4), np.zeros(10)), 3.7, rtol=1e-13)
    ramp = np.arange(120.0).reshape(40, 3)
    assert np.array_equal(BandLimit(0.0, 0.0, DT, 4).apply(ramp, slice(0, 40, 4), np.zeros(10)), ramp[::4])
    late = BandLimit(0.0, 2.5 * DT, DT, 4).apply(ramp, slice(0, 40, 4), np.zeros(10))
    np.testing.assert_allclose(late[1:], ramp[4::4] - 7.5)
    early = BandLimit(0.0, 0.0, DT, 4, longest=DT).apply(ramp, slice(0, 40, 4), np.full(10, 0.5 * DT))
    np.testing.assert_allclose(early[1:], ramp[4::4] - 1.5)


@given(st.integers(1, 9), st.lists(st.integers(0, 12), min_size=1, max_size=20))
def test_clock_ticks_every_nth_row_whatever_the_blocks(every: int, lengths: list[int]) -> None:
    clock, at, ticks = Clock(every), 0, []
    for n in lengths:
        ticks += [at + i for i in range(n)[clock.rows(n)]]
        at += n
    assert ticks == list(range(0, at, every))


def test_lag_is_first_order() -> None:
    lag = Lag(0.2, DT)
    assert lag.apply(np.array([1.0]))[0] == 1.0
    y = lag.apply(np.full(400, 3.0))
    t = np.arange(1, 401) * DT
    np.testing.assert_allclose(y, 3.0 - 2.0 * np.exp(-t / 0.2), rtol=1e-12)


def test_divider_refuses_rates_that_do_not_divide() -> None:
    assert divider(100.0, DT, "x") == 4
    with pytest.raises(InputError, match=r"rate_hz = 300 .* take 400"):
        divider(300.0, DT, "x")


def test_rotation_is_yaw_then_pitch_then_roll() -> None:
    np.testing.assert_allclose(matrix(0, 0, np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(matrix(0, np.pi / 2, 0) @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(matrix(np.pi / 2, 0, 0) @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    c = matrix(0.3, -0.4, 2.0)
    np.testing.assert_allclose(c @ c.T, np.eye(3), atol=1e-15)
