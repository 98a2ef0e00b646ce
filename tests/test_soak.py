"""Hours in the air: nobody drifts away, nobody's covariance decays.

One hour, of which the second half is compared with the first; two with AHRS_SIM_EXHAUSTIVE=1.
"""

import os

import numpy as np
import pytest

import estimators
from ahrs_sim import attitude
from ahrs_sim import scenario as scenarios
from ahrs_sim.chain import site
from ahrs_sim.evaluation import metrics
from ahrs_sim.flight import open_flight
from ahrs_sim.scenario import create_estimator as create
from ahrs_sim.sensors import Assembler, make_suite
from estimators import Status

HOURS = 2.0 if os.environ.get("AHRS_SIM_EXHAUSTIVE") else 1.0
RATE = 25.0  # Hz, of the IMU: what matters is the time, and the steps are as long as a filter may get
BLOCK_S = 100.0
FLIGHT = f"""
duration_s = {HOURS * 3600.0}
rate_hz = 50.0
catalogue = "chr"
[motion]
kind = "weave"
straight_s = 60.0
[suite.chr]
grade = "chr_6dm"
rate_hz = {RATE}
magnetometer.rate_hz = {RATE}
air_data.rate_hz = {RATE}
"""


@pytest.mark.long
def test_hours_with_the_catalogue(tmp_path):
    """Half of the time in banks of 30 deg, sensors of the low-cost grade, every method of ours."""
    path = tmp_path / "soak.toml"
    path.write_text(FLIGHT)
    names = {m.name for m in estimators.describe() if m.own}
    scenario = scenarios.load(str(path))
    flight = open_flight(scenario)
    place = site(flight.start_lla, scenario.epoch)
    fit = {"seed": 1, "dt": flight.dt, "epoch": scenario.epoch, "start_lla": np.array(place.lla)}
    suite = make_suite(scenario.suites[0], **fit)
    flying = {e.name: create(e, place, suite.info) for e in scenario.estimators if e.settings["method"] in names}
    assert len(flying) >= len(names)
    assembler = Assembler()
    rms = {name: [] for name in flying}
    while len(truth := flight.fly(round(BLOCK_S / flight.dt))):
        samples = assembler.assemble(suite.sense(truth))
        reference = attitude.interpolate(truth.t, truth.q_nb, samples.t)
        for name, estimator in flying.items():
            estimates = estimator.process(samples)
            at = f"{name}, {truth.t[0]:.0f} s"
            assert (estimates.status != Status.DIVERGED).all(), at
            aligned = estimates.status != Status.ALIGNING
            assert np.isfinite(estimates.down_b[aligned]).all(), at
            P = estimator.state()["filter"]["P"]
            if np.array_equal(P, np.tril(P)):  # square-root forms carry its factor
                P = P @ P.T
            assert np.array_equal(P, P.T), at
            spread = np.sqrt(np.diag(P))
            assert (spread > 0.0).all(), at
            assert np.linalg.eigvalsh(P / np.outer(spread, spread)).min() > 0.0, at
            errors = metrics.statistics(metrics.attitude_errors(estimates.q_nb, estimates.down_b, reference))
            rms[name].append((errors["tilt_rmse_deg"], errors["heading_rmse_deg"]))
    assert truth.t.size == 0 and len(rms[name]) == HOURS * 3600.0 / BLOCK_S + 1
    for name, values in rms.items():
        tilt, heading = np.array(values[1:-1]).T
        hour = len(tilt) // 2
        assert np.mean(tilt[hour:]) < 1.3 * np.mean(tilt[:hour]) + 0.2, name
        if np.isfinite(heading).all():
            assert np.mean(heading[hour:]) < 1.3 * np.mean(heading[:hour]) + 0.5, name
