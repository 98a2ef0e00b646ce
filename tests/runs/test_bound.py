"""The Cramer-Rao bound: against least squares, against the filters, and what it does with better sensors."""

import json

import numpy as np
import pytest

from ahrs_sim import cli, pipeline, scenario
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.flight.truth import Truth
from ahrs_sim.runs import bound
from ahrs_sim.scenario import Component
from ahrs_sim.sensors import make_suite
from estimators.types import Site, blank

SITE = Site((0.76, 0.02, 150.0), gravity=9.805, mag_n=(2.3e-5, 4e-7, 4.0e-5))
FIX = ("magnetometer", "gnss")


def flying(seconds: float, turn: float = 0.0) -> Truth:
    """Level flight at 20 m/s, turning without bank (a car's turn) at `turn` rad/s; 100 Hz."""
    n = round(100 * seconds) + 1
    columns = blank(Truth, n)
    t = np.arange(n) / 100.0
    yaw = turn * t
    columns["t"][:] = t
    columns["q_nb"][:] = np.column_stack([np.cos(yaw / 2), 0 * t, 0 * t, np.sin(yaw / 2)])
    columns["vel_n"][:] = 20.0 * np.column_stack([np.cos(yaw), np.sin(yaw), 0 * t])
    columns["rate_ib_b"][:] = (0.0, 0.0, turn)
    columns["accel_b"][:] = (0.0, 20.0 * turn, -SITE.gravity)
    columns["temperature"][:], columns["rpm"][:], columns["throttle"][:] = 288.0, 0.0, 0.0
    return Truth(**columns)


def suite(**changes):
    import datetime

    settings = {"grade": "chr_6dm", **changes}
    epoch = datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC)
    return make_suite(Component("chr", settings, "test"), seed=1, dt=0.01, epoch=epoch, start_lla=np.array(SITE.lla))


def along(truth: Truth, made, aids=FIX) -> bound.Bound:
    blocks = (truth[k : k + 10] for k in range(1, len(truth) - 9, 10))
    return bound.along(blocks, made, {"it": aids}, SITE)["it"]


def test_recursion_is_least_squares_of_the_whole():
    """A linear-Gaussian model: P of the recursion against the information of all states of all times at once."""
    rng = np.random.default_rng(3)
    n, steps = 4, 12
    F = np.eye(n) + 0.3 * rng.standard_normal((n, n))
    Q, variance = np.diag(rng.uniform(0.1, 0.5, n)), np.array([0.3, 0.7])
    H = [rng.standard_normal((2, n)) for _ in range(steps)]
    P = np.eye(n)
    for k in range(steps):
        P = F @ P @ F.T + Q if k else P
        bound.condition(P, H[k], variance)
    whole = np.zeros((n * steps, n * steps))
    whole[:n, :n] = np.eye(n)
    for k in range(steps):
        own = slice(n * k, n * k + n)
        whole[own, own] += H[k].T @ np.diag(1.0 / variance) @ H[k]
        if k:
            both = np.hstack([-F, np.eye(n)])
            pair = slice(n * k - n, n * k + n)
            whole[pair, pair] += both.T @ np.linalg.inv(Q) @ both
    np.testing.assert_allclose(P, np.linalg.inv(whole)[-n:, -n:], rtol=1e-9, atol=1e-12)


def test_gyro_noise_alone_walks():
    """Without any aid the heading is what white noise and the prior of the bias make of it."""
    nothing = {"turn_on_bias_dps": 0.0, "bias_floor_dph": 0.0, "temperature_drift_dps_per_k": 0.0,
               "scale_percent": 0.0, "misalignment_deg": 0.0, "g_sensitivity_dps_per_g": 0.0}  # fmt: skip
    made = suite(gyro={**nothing, "noise_density_dps_rthz": 0.1})
    found = along(flying(100.0), made, ())
    prior = np.pi / np.sqrt(3.0)
    walk = np.radians(0.1) ** 2 / 2.0 * found.t
    np.testing.assert_allclose(found.heading**2, prior**2 + walk - walk[0] + walk[0], rtol=1e-3)


def test_turns_show_what_straight_flight_does_not_and_better_sensors_are_better():
    straight, turning = along(flying(120.0), suite()), along(flying(120.0, 0.2), suite())
    better = along(flying(120.0, 0.2), suite(accelerometer={"misalignment_deg": 0.05, "turn_on_bias_mg": 0.5}))
    assert turning.tilt[-1] < 0.8 * straight.tilt[-1]
    assert better.tilt[-1] < 0.8 * turning.tilt[-1]
    more = along(flying(120.0, 0.2), suite(), (*FIX, "heading"))
    assert more.heading[-1] < 0.9 * turning.heading[-1]


@pytest.mark.long
def test_no_filter_is_below_it():
    data = {k: v for k, v in scenario.load("turns").data.items() if k != "catalogue"}
    methods = {m: {"method": m, "suite": "chr", "heading_aid": False} for m in ("ins15", "ins21", "ins-cal")}
    squares: dict[str, list[float]] = {m: [] for m in methods}
    for seed in (1, 2, 3):
        flown = scenario.parse({**data, "estimator": methods}, "turns", "turns", seed=seed, duration=300.0)
        accuracy = Accuracy(list(methods))
        pipeline.fly(flown, None, accuracy=accuracy)
        for name, figures in accuracy.result(low=80.0)["estimators"].items():
            squares[name].append(figures["tilt_rmse_deg"] ** 2 + figures["heading_rmse_deg"] ** 2)
    flown = scenario.parse({**data, "estimator": {}}, "turns", "turns", seed=1, duration=300.0)
    tilt, heading = np.degrees(bound.make(flown, "chr")["magnetometer, GNSS"].rms(80.0))
    for name, values in squares.items():
        # errors of a flight are all but one draw of some five constants: their mean square scatters by a half
        assert np.mean(values) > 0.5 * (tilt**2 + heading**2), name


def test_command(capsys):
    assert cli.main(["bound", "takeoff", "--suite", "chr", "--duration", "70", "--json", "--from", "60"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == list(bound.AIDS)
    assert 0.01 < found["magnetometer, GNSS, two antennas"]["tilt_rms_deg"] < 1.0
    assert cli.main(["bound", "takeoff", "--suite", "chro"]) == 2
    assert "did you mean 'chr'" in capsys.readouterr().err
    with pytest.raises(InputError, match="no such suite"):
        bound.make(scenario.load("takeoff"), "none")


@pytest.mark.long
def test_calibrate_shows_more_than_turns_of_as_long() -> None:
    """Bound of tilt and heading on a plain flight afterwards; the goal's 0.3 deg of tilt is below what any shows."""
    after = [{"do": "turn", "bank_deg": 30.0, "for_s": 20.0}, {"do": "turn", "bank_deg": -30.0, "for_s": 20.0}]
    turns = [{"do": "turn", "bank_deg": bank, "for_s": 30.0} for bank in (30.0, -30.0, 30.0, -30.0)]
    found = {}
    for name, steps in (("turns", turns), ("calibrate", [{"do": "calibrate"}])):
        data = {**scenario.load("circuit").data, "step": [*steps, *after], "estimator": {}}
        data |= {"suite": {"chr": {"grade": "chr_6dm"}}, "start": {"on_ground": False, "height_m": 120.0}}
        bounds = bound.make(scenario.parse(data, name, name), "chr", aids={"it": FIX})
        found[name] = np.degrees(bounds["it"].rms(low=122.0))
    assert np.all(found["calibrate"] < 0.97 * found["turns"])
    assert found["calibrate"] == pytest.approx([0.36, 0.31], abs=0.04)
