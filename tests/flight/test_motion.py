"""Motions from a formula satisfy the same kinematics as a flight."""

import numpy as np
import pytest
from flight_helpers import Flown, attitude_residual_deg, make, position_residual, velocity_residual
from hypothesis import given
from hypothesis import strategies as st

from ahrs_sim.errors import InputError
from ahrs_sim.flight import motion, open_flight
from ahrs_sim.world.gravity import gravity_n

MOTIONS = [
    {"kind": "constant", "roll_deg": 20.0, "heading_dps": 40.0},
    {"kind": "constant", "roll_deg": 5.0, "pitch_dps": 10.0, "roll_dps": 7.0},
    {"kind": "sway"},
    {"kind": "sway", "still_s": 5.0, "roll_amplitude_deg": 30.0, "roll_period_s": 3.0},
    {"kind": "line", "climb_mps": 2.0, "leg": [{"for_s": 10.0, "accel_mps2": 2.0}, {"for_s": 5.0, "accel_mps2": -3.0}]},
    {"kind": "road", "still_s": 5.0},
    {"kind": "road", "still_s": 5.0, "road": "country"},
    {"kind": "weave", "still_s": 2.0, "speed_mps": 20.0, "period_s": 20.0, "swings": 1},
    {"kind": "hover", "still_s": 2.0, "height_m": 5.0},
]


@pytest.mark.parametrize("table", MOTIONS)
def test_kinematics(table):
    flown = Flown(make(motion=dict(table), duration_s=40.0, start={"heading_deg": 30.0}))
    truth = flown.truth
    assert len(truth) == 16001
    assert attitude_residual_deg(truth).max() < 5e-4
    assert np.abs(velocity_residual(truth, gravity_n(truth.lla))).max() < 1e-4
    assert np.abs(position_residual(truth)).max() < 1e-4
    derivative = np.gradient(truth.rate_ib_b, flown.flight.dt, axis=0)[1:-1]
    assert np.abs(derivative - truth.rate_dot_b[1:-1]).max() < 5e-3
    assert np.linalg.norm(truth.q_nb, axis=1) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("table", MOTIONS)
def test_blocks_do_not_matter(table):
    whole = Flown(make(motion=dict(table), duration_s=8.0), block=10**5).truth
    parts = Flown(make(motion=dict(table), duration_s=8.0), block=397).truth
    for name in ("t", "lla", "vel_n", "q_nb", "rate_ib_b", "rate_dot_b", "accel_b"):
        assert getattr(whole, name).tobytes() == getattr(parts, name).tobytes()


def test_sway_is_the_motion_of_the_experiment():
    flown = Flown(make(motion={"kind": "sway"}, duration_s=60.0))
    t = flown.truth.t
    assert flown.roll == pytest.approx(10.0 + np.sin(np.pi / 15.0 * t), abs=1e-9)
    assert flown.pitch == pytest.approx(10.0 + np.sin(np.pi / 10.0 * t), abs=1e-9)
    assert flown.heading == pytest.approx(30.0 + 5.0 * np.sin(np.pi / 20.0 * t), abs=1e-9)


def test_line_speeds_up_and_brakes():
    flown = Flown(make(motion=dict(MOTIONS[4]), duration_s=30.0, start={"heading_deg": 90.0}))
    speed = flown.truth.vel_n[:, 1]
    assert speed[[0, 4000, 6200, -1]] == pytest.approx([20.0, 39.5, 25.0, 25.0], abs=0.01)
    assert flown.truth.accel_b[2000, 0] == pytest.approx(2.0, abs=0.01)
    assert flown.truth.height_agl[-1] == pytest.approx(60.0, abs=1e-6)
    assert not flown.truth.on_ground.any()


def test_the_car_drives_laps():
    flown = Flown(make(motion={"kind": "road", "rough_deg": 0.0, "still_s": 10.0}, duration_s=110.0))
    truth = flown.truth
    speed = np.linalg.norm(truth.vel_n, axis=1)
    distance = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / 400.0)])
    lap = 2.0 * (84.39 + np.pi * 36.5)
    one, two = (int(np.searchsorted(distance, 40.0 + k * lap)) for k in (0, 1))
    assert np.abs((truth.lla[one] - truth.lla[two]) * [6.37e6, 4.6e6, 1.0]).max() < 0.05
    # it goes where it points, and leans out of the bends
    assert flown.heading[speed > 1.0] == pytest.approx(
        np.degrees(np.arctan2(truth.vel_n[:, 1], truth.vel_n[:, 0]))[speed > 1.0], abs=1e-6
    )
    assert flown.roll.min() < -1.0
    assert flown.roll.max() < 0.1  # every bend goes to the right
    assert np.abs(truth.accel_b[:3900, :2]).max() < 1e-5
    assert truth.accel_b[:, 0].min() < -1.0


def test_one_seed_one_road():
    roads = [Flown(make(motion=dict(MOTIONS[6]), seed=seed, duration_s=20.0)).truth.q_nb for seed in (1, 1, 2)]
    assert np.array_equal(roads[0], roads[1])
    assert np.abs(roads[0] - roads[2]).max() > 1e-3


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "kind: missing"),
        ({"kind": "swai"}, "did you mean 'sway'"),
        ({"kind": "sway", "rol_mean_deg": 1.0}, "did you mean 'roll_mean_deg'"),
        ({"kind": "sway", "roll_period_s": 0.0}, "out of range"),
        ({"kind": "line", "leg": [{"accel_mps2": 1.0}]}, "for_s: missing"),
        ({"kind": "line", "leg": [{"for_s": 0.1, "accel_mps2": 1.0}]}, "shorter than ease_s"),
        ({"kind": "road", "road": "moon"}, "unknown"),
    ],
)
def test_bad_motions_are_refused(table, message):
    with pytest.raises(InputError, match=message):
        open_flight(make(motion=table))


def test_nobody_flies_a_motion():
    scene = make(motion={"kind": "sway"}, pilot={"attitude": "ekf-chr"})
    with pytest.raises(InputError, match="not flown"):
        open_flight(scene)
    flight = open_flight(make(motion={"kind": "sway"}))
    assert flight.attachments() == {}
    assert len(flight.take_setpoints()) == 0
    assert flight.expected_duration == motion.DEFAULT_DURATION


@given(st.floats(-3.0, 3.0))
def test_jets_know_their_derivatives(t):
    def f(x):
        now = motion.Jet(np.array([x]), np.ones(1), np.zeros(1))
        return motion.sin(now * now) * motion.cos(now + 0.3) - 2.0 * motion.smooth_step(now, 2.0) * now

    h = 1e-4
    before, here, after = (f(t + s) for s in (-h, 0.0, h))
    assert here.d == pytest.approx((after.x - before.x) / (2 * h), abs=1e-5)
    assert here.dd == pytest.approx((after.d - before.d) / (2 * h), abs=1e-4)
    ramp = [motion.smooth_ramp(motion.Jet(np.array([t + s]), np.ones(1), np.zeros(1)), 2.0) for s in (-h, 0.0, h)]
    assert ramp[1].d == pytest.approx((ramp[2].x - ramp[0].x) / (2 * h), abs=1e-6)
    assert ramp[1].dd == pytest.approx((ramp[2].d - ramp[0].d) / (2 * h), abs=1e-6)


def test_a_weave_is_coordinated_and_ends_straight():
    table = {"kind": "weave", "still_s": 5.0, "period_s": 40.0, "swings": 2, "bank_deg": 40.0}
    truth = Flown(make(motion=table, duration_s=120.0, start={"heading_deg": 30.0})).truth
    begun = 5.0 + 25.0 / 1.5
    flying, swinging = truth.t > begun, (truth.t > begun + 10.0) & (truth.t < begun + 30.0)
    assert np.abs(truth.accel_b[flying, 1]).max() < 0.02, "the ball stays in the middle"
    assert np.abs(truth.accel_b[swinging, 2]).max() == pytest.approx(9.805 / np.cos(np.radians(40.0)), rel=0.01)
    after = truth.t > begun + 80.0
    assert np.degrees(np.arctan2(truth.vel_n[after, 1], truth.vel_n[after, 0])) == pytest.approx(30.0, abs=1e-6)
    assert truth.airspeed[after] == pytest.approx(25.0)
