"""Whether `ins21` knows how far off it is: attitude, velocity, place and biases in turns, with both grades."""

import dataclasses

import numpy as np
import pytest

from ahrs_sim import attitude, scenario
from ahrs_sim.chain import Chain, site
from ahrs_sim.evaluation import consistency, metrics
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.records import ImuErrorsRecord
from estimators import create
from estimators.earth import apart
from estimators.types import Samples

START, END = 80.0, 330.0  # s: the climb, two minutes of turning each way
SEEDS = (11, 12, 13)


def flown(seed, name="turns", duration=END, **changes):
    """Truth, and by suite its data sheet, samples and true errors; `changes` add suites to the scenario's."""
    data = {k: v for k, v in scenario.load(name).data.items() if k != "catalogue"} | {"estimator": {}}
    data["suite"] = {**data["suite"], **changes}
    known = scenario.parse(data, name, name, seed=seed, duration=duration)
    flight = open_flight(known)
    place = site(flight.start_lla, known.epoch)
    suites = {
        c.name: make_suite(c, seed=seed, dt=flight.dt, epoch=known.epoch, start_lla=np.array(place.lla))
        for c in known.suites
    }
    blocks = []
    while len(block := flight.fly(10_000)):
        blocks.append(block)
    truth = Truth.concatenate(blocks)
    found = {}
    for name, suite in suites.items():
        chain = Chain(suite, {})
        records = chain.sense(truth)
        found[name] = (suite.info, chain.assemble(records), records["imu_errors"])
    return place, truth, found


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def at(t, times, values):
    return np.column_stack([np.interp(t, times, column) for column in values.T])


def nees(truth: Truth, errors: ImuErrorsRecord, samples: Samples, estimator) -> dict[str, float]:
    """Mean NEES per degree of freedom."""
    e = estimator.process(samples)
    assert not (e.adaptation[:, 2] == 1.0).any()  # a good magnetometer is never given up
    rows = np.flatnonzero((e.t >= START) & (e.t <= truth.t[-1]))[::10]
    t, thin = e.t[rows], slice(None, None, 4)
    q = attitude.interpolate(truth.t[thin], truth.q_nb[thin], t)
    vel_n = at(t, truth.t[thin], truth.vel_n[thin])
    lla, off = at(t, truth.t[thin], truth.lla[thin]), np.empty((len(t), 3))
    for k in range(len(t)):
        apart(e.lla[rows[k]], lla[k], off[k])
    stamps = errors.stamp_ns * 1e-9
    biases = {}
    for name, key in (("gyro bias", "gyro"), ("accelerometer bias", "accel")):
        true = at(t, stamps, getattr(errors, f"{key}_effective_bias"))
        biases[name] = ((getattr(e, f"{key}_bias")[rows] - true) / getattr(e, f"{key}_bias_sigma")[rows]) ** 2
    return {
        "attitude": float(np.nanmean(consistency.attitude_nees(e.q_nb[rows], e.att_cov[rows], q))) / 3.0,
        "velocity": float(np.nanmean(consistency.nees(e.vel_n[rows] - vel_n, e.vel_cov[rows]))) / 3.0,
        "position": float(np.nanmean(consistency.nees(off, e.pos_cov[rows]))) / 3.0,
        **{name: float(np.mean(values)) for name, values in biases.items()},
    }


@pytest.fixture(scope="module")
def figures():
    """NEES by suite and quantity, a row a seed."""
    found: dict[str, list[dict[str, float]]] = {"chr": [], "sbg": []}
    for seed in SEEDS:
        place, truth, suites = flown(seed)
        for name, rows in found.items():
            info, samples, errors = suites[name]
            rows.append(nees(truth, errors, samples, create("ins21", site=place, sensors=info, heading_aid=False)))
    return found


@pytest.mark.long
@pytest.mark.parametrize("suite", ["chr", "sbg"])
@pytest.mark.parametrize("quantity", ["attitude", "velocity", "position", "gyro bias", "accelerometer bias"])
def test_ins21_knows_how_far_off_it_is(figures, suite, quantity):
    mean = float(np.mean([row[quantity] for row in figures[suite]]))
    least = 0.4 if quantity == "velocity" else 0.5  # its sigma is cautious: 0.46, 0.51, 0.53 with the low-cost unit
    assert least < mean < 2.0, (quantity, [row[quantity] for row in figures[suite]])


@pytest.mark.long
def test_a_delay_that_nobody_declared_is_learnt():
    """Fixes 0.3 s late whose stamps do not say so: errors less than twice those with stamps that do."""
    late = {"grade": "chr_6dm", "gnss": {"latency_ms": 300.0, "undeclared_ms": 300.0}}
    known = {"grade": "chr_6dm", "gnss": {"latency_ms": 300.0}}
    place, truth, suites = flown(1, chr=known, late=late)
    errors = {}
    for name, given in (("chr", {}), ("late", {}), ("late", {"late_sigma": 0.0})):
        info, samples, _ = suites[name]
        e = create("ins21", site=place, sensors=info, heading_aid=False, **given).process(samples)
        rows = np.flatnonzero((e.t >= START) & (e.t <= truth.t[-1]))[::10]
        q = attitude.interpolate(truth.t[::4], truth.q_nb[::4], e.t[rows])
        errors[name, bool(given)] = float(np.sqrt(np.mean(attitude.rotation_vector(q, e.q_nb[rows]) ** 2)))
    assert errors["late", False] < 1.8 * errors["chr", False]
    assert errors["late", True] > 1.3 * errors["late", False]  # 1.49 here, 2.1 with seed 2: the worst fixes are refused


@pytest.mark.long
@pytest.mark.parametrize("name", ["ins21", "ins-cal"])
def test_what_shakes_in_a_hover_teaches_no_delay_and_no_heading(hover, name):
    """Ten minutes of rotors' vibration, folded down by the sampling: learnt from, it cost 4 deg of heading."""
    place, truth, info, samples = hover
    e = create(name, site=place, sensors=info, heading_aid=False).process(samples)
    rows = np.flatnonzero((e.t >= START) & (e.t <= truth.t[-1]))[::10]
    q = attitude.interpolate(truth.t[::4], truth.q_nb[::4], e.t[rows])
    error = np.degrees(metrics.attitude_errors(e.q_nb[rows], e.down_b[rows], q))
    nees = float(np.nanmean(consistency.attitude_nees(e.q_nb[rows], e.att_cov[rows], q))) / 3.0
    # 0.9 deg of tilt is what this accelerometer's errors make standing, and nothing shows them in a hover
    assert rms(error[:, 3]) < 1.6 and rms(error[:, 2]) < 2.0 and 0.5 < nees < 2.0


@pytest.fixture(scope="module")
def hover():
    place, truth, suites = flown(101, "hover", 640.0)
    info, samples, _ = suites["chr"]
    return place, truth, info, samples


@pytest.mark.long
@pytest.mark.parametrize("name", ["ins21", "ins-cal"])
def test_a_magnetometer_that_is_simply_wrong_costs_no_more_than_none(turned, name):
    """60 degrees off from the start: given up in the take-off run; errors at most 1.5 times those without any."""
    place, truth, info, samples = turned
    none = dataclasses.replace(samples, mag_b=np.full_like(samples.mag_b, np.nan))
    errors = []
    for seen in (samples, none):
        e = create(name, site=place, sensors=info, heading_aid=False).process(seen)
        rows = np.flatnonzero((e.t >= START) & (e.t <= truth.t[-1]))[::10]
        q = attitude.interpolate(truth.t[::4], truth.q_nb[::4], e.t[rows])
        errors.append(float(np.sqrt(np.mean(attitude.rotation_vector(q, e.q_nb[rows]) ** 2))))
        nees = float(np.nanmean(consistency.attitude_nees(e.q_nb[rows], e.att_cov[rows], q))) / 3.0
        assert (e.adaptation[rows, 2] == 1.0).all() == (seen is samples)
        assert seen is none or nees < 3.0
    assert errors[0] < 1.5 * errors[1]


@pytest.fixture(scope="module")
def turned():
    place, truth, suites = flown(1, chr={"grade": "chr_6dm", "magnetometer": {"turned_deg": 60.0}})
    info, samples, _ = suites["chr"]
    return place, truth, info, samples
