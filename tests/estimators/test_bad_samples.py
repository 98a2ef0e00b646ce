"""What bad samples do to every method of the catalogue: a typed error or coasting, never a NaN without a word."""

import functools

import numpy as np
import pytest
from synthetic import SITE, coordinated_turn, error_deg

from estimators import SampleError, Samples, SensorInfo, Status, create, describe

AIDED = [
    (name, aiding)
    for name, others in (("marg-ekf", ("airspeed", "gnss")), ("ins21", ("gnss+airspeed", "none")))
    for aiding in others
]
SLOW = {"ins-cal"}  # 61 states: as long as all others together
ENTRIES = [
    pytest.param(m.name, {}, id=m.name, marks=[pytest.mark.long] if m.name in SLOW else []) for m in describe() if m.own
]
ENTRIES += [pytest.param(name, {"aiding": aiding}, id=f"{name}-{aiding}") for name, aiding in AIDED]
ROWS = slice(1500, 1700)  # in flight, after alignment
METRES = 1.0 / 6.37e6  # rad


@functools.cache
def flight():
    """Standing, take-off run, turn, with all sensors."""
    samples, truth, _ = coordinated_turn(turn_s=20.0, ground_s=8.0)
    n = len(samples)
    place = np.cumsum(samples.vel_n, axis=0) * 0.01
    lla = SITE.lla + place * [METRES, METRES / np.cos(SITE.lla[0]), -1.0]
    a, b, c, d = truth.T
    heading = np.arctan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
    given = {name: getattr(samples, name) for name in Samples.__slots__}
    given |= {
        "lla": lla, "gnss_satellites": np.full(n, 8.0), "heading": heading, "heading_sigma": np.full(n, 3.5e-3),
        "heading_t": given["gnss_t"], "heading_new": given["gnss_new"], "alpha": np.full(n, 0.05), "beta": np.zeros(n),
    }  # fmt: skip
    return given, truth


def changed(change):
    """The flight's samples after `change(columns)`."""
    columns = {name: column.copy() for name, column in flight()[0].items()}
    change(columns)
    return Samples(**columns)


def fill(value, *names):
    def change(columns):
        for name in names or [n for n, c in columns.items() if c.dtype == float and n != "t"]:
            columns[name][ROWS] = value

    return change


def every_seventh(value):
    """Single samples of one sensor after the other."""

    def change(columns):
        names = [n for n, c in columns.items() if c.dtype == float and n != "t"]
        for k, row in enumerate(range(900, 3000, 7)):
            columns[names[k % len(names)]][row] = value

    return change


def stamps(*rows_and_shifts):
    def change(columns):
        for row, shift in rows_and_shifts:
            columns["t"][row] += shift

    return change


def repeated(columns):
    columns["t"][1500:1520] = columns["t"][1500]


def gap(start, seconds):
    def change(columns):
        for name in ("t", "gnss_t", "heading_t"):
            columns[name][start:] += seconds

    return change


def no_sigma(columns):
    columns["heading_sigma"][:] = 0.0


def from_the_future(columns):
    columns["gnss_t"][ROWS] += 30.0
    columns["heading_t"][ROWS] += 30.0


CHANGES = {
    "all missing": fill(np.nan),
    "gyro missing": fill(np.nan, "gyro_b"),
    "accelerometer missing": fill(np.nan, "accel_b"),
    "magnetometer missing": fill(np.nan, "mag_b"),
    "aids missing": fill(np.nan, "lla", "vel_n", "gnss_t", "heading", "heading_t", "airspeed"),
    "all infinite": fill(np.inf),
    "all huge": fill(1e200),
    "accelerometer zero": fill(0.0, "accel_b"),
    "magnetometer zero": fill(0.0, "mag_b"),
    "scattered NaN": every_seventh(np.nan),
    "scattered infinities": every_seventh(-np.inf),
    "repeated stamps": repeated,
    "backward stamps": stamps((1500, -0.3), (1700, -0.9)),
    "gap": gap(1500, 4.5),
    "gap while aligning": gap(300, 3.0),
    "no heading sigma": no_sigma,
    "aids from the future": from_the_future,
}


def run(samples, name, settings, sensors=None):
    return create(name, site=SITE, align_s=3.0, sensors=sensors, **settings).process(samples)


def assert_no_word_missing(estimates):
    """Once aligned every row has an attitude, or says that it is lost; every covariance is one."""
    aligned = estimates.status != Status.ALIGNING
    assert aligned[800:].all()
    valid = aligned & (estimates.status != Status.DIVERGED)
    for name in ("down_b", "gyro_bias", "att_cov"):
        column = getattr(estimates, name).reshape(len(valid), -1)
        known = np.isfinite(column)
        usual = known[valid][-1]  # a method without this quantity says so in every row
        assert (known[valid] == usual).all(), name
    np.testing.assert_allclose(np.linalg.norm(estimates.down_b[valid], axis=1), 1.0, atol=1e-9)
    P = estimates.att_cov[valid]
    np.testing.assert_allclose(P, P.transpose(0, 2, 1), rtol=1e-9, atol=1e-18)
    if np.isfinite(P).all():
        assert np.linalg.eigvalsh(P).min() > -1e-12


@pytest.mark.parametrize(("name", "settings"), ENTRIES)
def test_bad_values_and_stamps_coast(name, settings):
    """And afterwards the estimate is as good as that without the trouble, within some degrees."""
    good = run(changed(lambda columns: None), name, settings)
    assert_no_word_missing(good)
    truth = flight()[1]
    for title, change in CHANGES.items():
        try:
            estimates = run(changed(change), name, settings)
            assert_no_word_missing(estimates)
            tilt, tilt_before = (tilt_error(e, truth) for e in (estimates, good))
            assert tilt < tilt_before + 15.0
        except (AssertionError, SampleError) as error:
            raise AssertionError(f"{title}: {error}") from error


def tilt_error(estimates, truth):
    """deg, at the end."""
    a, b, c, d = truth[-1]
    down = np.array([2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d])
    return np.degrees(np.arccos(np.clip(down @ estimates.down_b[-1], -1, 1)))


@pytest.mark.parametrize(("name", "settings"), ENTRIES)
def test_perfect_sensors_are_taken(name, settings):
    """A data sheet of zeros: variances of zero would be singular."""
    zeros = {f: 0.0 for f in SensorInfo.__slots__ if f not in ("rate", "antenna_b")}
    zeros["field_error"] = (0.0, 0.0, 0.0)
    estimates = run(changed(no_sigma), name, settings, SensorInfo(**zeros))
    assert_no_word_missing(estimates)
    assert (estimates.status[800:] != Status.DIVERGED).all()


@pytest.mark.parametrize(("name", "settings"), ENTRIES)
def test_impossible_stamps_and_shapes_are_errors_and_change_nothing(name, settings):
    estimator = create(name, site=SITE, align_s=3.0, **settings)
    samples = changed(lambda columns: None)
    estimator.process(samples[:1000])
    for bad in (np.nan, np.inf, -5.0):
        broken = changed(lambda columns, bad=bad: columns["t"].__setitem__(1050, bad))
        with pytest.raises(SampleError, match="row 50"):
            estimator.process(broken[1000:1100])
    for column in Samples.__slots__[1:]:
        short = changed(lambda columns, column=column: columns.update({column: columns[column][:-1]}))
        with pytest.raises(SampleError, match=column):
            estimator.process(short)
    whole = run(samples, name, settings)
    np.testing.assert_array_equal(estimator.process(samples[1000:]).down_b, whole.down_b[1000:])


def test_the_flight_is_one():
    """What the others take for good samples is: a navigator holds it to a tenth of a degree."""
    estimates = run(changed(lambda columns: None), "ins21", {})
    assert error_deg(estimates.q_nb[-500:], flight()[1][-500:])[0].max() < 1.0
