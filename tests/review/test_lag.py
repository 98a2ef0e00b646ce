"""Lags against known ones."""

import json
import math

import numpy as np
import pytest

from ahrs_sim import cli
from ahrs_sim.review import lag

RATE = 100.0


def motion(t):
    """Roll, pitch, heading (n, 3) of banking to and fro and a heading that goes round, rad."""
    roll = 0.5 * np.tanh(3 * np.sin(0.31 * t)) + 0.05 * np.sin(2.7 * t)
    pitch = 0.1 * np.sin(0.8 * t) + 0.03 * np.sin(5.1 * t)
    heading = 2.0 + 0.25 * t + 0.8 * np.sin(0.23 * t)
    return np.column_stack([roll, pitch, np.mod(heading + np.pi, 2 * np.pi) - np.pi])


@pytest.mark.parametrize("known", [0.0, 0.0037, 0.0234, -0.012, 0.15])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_known_delay_is_found(known, noise):
    t = np.arange(0, 200, 1 / RATE)
    rng = np.random.default_rng(1)
    estimate = motion(t - known) + noise * rng.standard_normal((len(t), 3)) + [0.02, -0.01, 0.05]
    attitude, rate = lag.lags(t, motion(t), estimate)
    assert attitude == pytest.approx(known, abs=5e-4)
    assert rate == pytest.approx(known, abs=5e-4 if noise == 0.0 else 2e-3)


def test_gaps_stamps_and_missing_rows_do_not_matter():
    rng = np.random.default_rng(2)
    t = np.arange(0, 300, 1 / RATE) + rng.uniform(-5e-4, 5e-4, 30000)
    t = np.delete(t, slice(7000, 9000))
    truth, estimate = motion(t), motion(t - 0.03)
    estimate[:2500] = np.nan  # aligning
    estimate[12000:12100] = np.nan
    assert lag.lags(t, truth, estimate) == (pytest.approx(0.03, abs=1e-3), pytest.approx(0.03, abs=1e-3))


def test_a_slow_error_is_no_lag_and_a_method_without_heading_has_one():
    t = np.arange(0, 300, 1 / RATE)
    estimate = motion(t - 0.02)
    estimate[:, 0] -= 0.3 * (1 - np.exp(-t / 60.0))  # levels out
    estimate[:, 2] = np.nan
    assert lag.lags(t, motion(t), estimate)[0] == pytest.approx(0.02, abs=2e-3)


def test_a_low_pass_lags_by_its_time_constant():
    t = np.arange(0, 200, 1 / RATE)
    truth = motion(t)
    truth[:, 2] = np.unwrap(truth[:, 2])
    estimate = truth.copy()
    for k in range(1, len(t)):
        estimate[k] = estimate[k - 1] + (truth[k] - estimate[k - 1]) * -math.expm1(-1 / RATE / 0.05)
    assert lag.lags(t, truth, estimate)[0] == pytest.approx(0.045, abs=0.006)  # less half a step: input held


def test_without_motion_it_cannot_be_told():
    t = np.arange(0, 60, 1 / RATE)
    still = np.zeros((len(t), 3))
    noisy = 1e-3 * np.random.default_rng(3).standard_normal((len(t), 3))
    assert all(map(math.isnan, lag.lags(t, still, noisy)))
    assert all(map(math.isnan, lag.lags(t, motion(t), 0.5 * np.random.default_rng(4).standard_normal((len(t), 3)))))


@pytest.mark.long
def test_the_command_shows_it(tmp_path, capsys):
    log = tmp_path / "flight.mcap"
    options = ["--estimator", "marg-ckf@sbg", "--estimator", "sekf@chr", "--duration", "110", "--quiet"]
    assert cli.main(["fly", "figure_eights", *options, "-o", str(log)]) == 0
    assert cli.main(["compare", str(log), "--lag", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["estimators"]
    assert abs(found["marg-ckf-sbg"]["attitude_lag_ms"]) < 60.0
    assert found["sekf-chr"]["attitude_lag_ms"] is not None, "it has no heading"
    assert cli.main(["compare", str(log), "--lag"]) == 0
    assert "lag, ms" in capsys.readouterr().out
