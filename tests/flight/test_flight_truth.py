"""The truth of a JSBSim flight: consistent with itself over the whole circuit, reproducible, independent of blocks."""

import dataclasses
import re
import tomllib

import numpy as np
import pytest
from flight_helpers import (
    Flown,
    airborne,
    attitude_residual_deg,
    euler_deg,
    make,
    position_residual,
    product,
    to_ned,
    velocity_residual,
)

from ahrs_sim import scenario
from ahrs_sim.flight import jsbsim_flight, open_flight
from ahrs_sim.flight.truth import Truth
from ahrs_sim.log import topics
from ahrs_sim.world.gravity import gravity_n, j2_gravity_n


@pytest.fixture(scope="module")
def circuit():
    flown = Flown(scenario.load("circuit"))
    assert flown.error is None
    return flown


IMU = next(route for route in topics.TRUTH if route.topic == "/truth/imu")


def same(a: Truth, b: Truth) -> bool:
    return all(getattr(a, f.name).tobytes() == getattr(b, f.name).tobytes() for f in dataclasses.fields(a))


@pytest.mark.long
def test_circuit_is_an_ordinary_flight(circuit):
    truth = circuit.truth
    assert 560.0 < truth.t[-1] < 700.0
    assert truth.t[0] == 0.0
    assert np.diff(truth.t) == pytest.approx(1 / 400, abs=1e-9)
    assert truth.on_ground[0]
    assert truth.on_ground[-1]
    assert 125.0 < truth.height_agl.max() < 140.0
    flying = truth.height_agl > 20.0
    assert truth.airspeed[flying].min() > 13.0
    assert truth.airspeed[flying].max() < 30.0
    assert np.abs(circuit.roll).max() > 44.0
    # it stops where it began, on the runway's line, and stands
    home = np.linalg.norm((truth.lla[-1] - truth.lla[0]) * [6.37e6, 4.62e6, 1.0])
    assert home < 150.0
    assert np.abs(truth.vel_n[-400:]).max() < 0.01
    assert np.linalg.norm(truth.q_nb, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert np.abs(np.degrees(truth.beta[flying])).max() < 12.0


def test_gyro_reproduces_the_attitude(circuit):
    assert attitude_residual_deg(circuit.truth).max() < 0.005


def test_specific_force_and_gravity_reproduce_the_velocity(circuit):
    truth = circuit.truth
    off = np.abs(velocity_residual(truth, j2_gravity_n(truth.lla))).max(axis=1)
    # while a wheel strikes, force changes by several g in one step and the trapezium rule itself is the error
    strikes = np.flatnonzero(np.abs(np.diff(truth.accel_b, axis=0)).max(axis=1) > 2.0)
    smooth = np.ones(len(truth), bool)
    for strike in strikes:
        smooth[max(0, strike - 1) : strike + 80] = False
    assert smooth.mean() > 0.99
    assert off[smooth].max() < 0.01
    assert off[-1] < 0.01
    # with the normal gravity of navigators instead of JSBSim's: its smaller terms are left
    assert np.abs(velocity_residual(truth, gravity_n(truth.lla))).max(axis=1)[smooth].max() < 0.06


def test_velocity_reproduces_the_position(circuit):
    assert np.abs(position_residual(circuit.truth)).max() < 0.05


def test_angular_acceleration_is_the_derivative_of_the_rate(circuit):
    truth = circuit.truth
    flying = truth.height_agl > 5.0
    derivative = np.gradient(truth.rate_ib_b, circuit.flight.dt, axis=0)
    off = (derivative - truth.rate_dot_b)[flying]
    assert np.sqrt(np.mean(off**2)) < 0.1 * np.sqrt(np.mean(truth.rate_dot_b[flying] ** 2))


def test_standing_feels_gravity_and_the_turning_earth(circuit):
    truth = circuit.truth
    for rows in (slice(0, 400 * 39), slice(-400 * 10, None)):  # before and after the flight: no shaking on the wheels
        force = to_ned(truth.q_nb[rows], truth.accel_b[rows])
        assert force.mean(axis=0) == pytest.approx([0, 0, -j2_gravity_n(truth.lla[:1])[0, 2]], abs=2e-3)
        assert np.linalg.norm(truth.accel_b[rows].mean(axis=0)) == pytest.approx(9.81, abs=0.01)
        assert np.abs(np.diff(truth.accel_b[rows, 1])).max() < 0.2
    assert np.abs(truth.rate_ib_b[: 400 * 39].mean(axis=0)).max() < 1.2 * 7.3e-5
    assert np.abs(circuit.truth.rpm[: 400 * 39]).max() == 0.0
    assert circuit.truth.rpm[400 * 55] > 50.0


def test_an_off_centre_imu_reads_the_lever_arm():
    """Specific force at a point from the rigid body's formula equals that from the point's own motion."""
    truth = Flown(airborne({"do": "windup_turn"}, {"do": "roll"}, {"do": "straight", "for_s": 5.0})).truth
    arm = np.array([0.3, -0.2, 0.1])
    lever = np.cross(truth.rate_dot_b, arm) + np.cross(truth.rate_ib_b, np.cross(truth.rate_ib_b, arm))
    at_point = dataclasses.replace(
        truth,
        accel_b=truth.accel_b + lever,
        vel_n=truth.vel_n + to_ned(truth.q_nb, np.cross(truth.rate_ib_b, arm)),
    )
    assert np.abs(lever).max() > 1.0
    off = velocity_residual(at_point, j2_gravity_n(truth.lla))
    assert np.abs(off).max() < 0.03
    assert np.abs(velocity_residual(dataclasses.replace(at_point, accel_b=truth.accel_b), 0 * off)).max() > 1.0


STEPS = ({"do": "turn", "through_deg": 90.0}, {"do": "doublet", "surface": "elevator"})
ROUGH = {"speed_mps": 5.0, "from_deg": 300.0, "turbulence": "moderate", "gust": [{"at_s": 1.0, "speed_mps": 3.0}]}


def test_blocks_do_not_matter():
    whole = Flown(airborne(*STEPS, wind=ROUGH, seed=3), block=10**5)
    for block in (4, 997):
        parts = Flown(airborne(*STEPS, wind=ROUGH, seed=3), block=block)
        assert same(whole.truth, parts.truth)
        assert whole.events == parts.events
        assert np.array_equal(whole.setpoints.surfaces, parts.setpoints.surfaces)


def test_one_seed_one_flight():
    first, again, other = (Flown(airborne(*STEPS, wind=ROUGH, seed=seed)).truth for seed in (3, 3, 4))
    assert same(first, again)
    n = min(len(first), len(other))
    assert np.abs(first.wind_n[:n] - other.wind_n[:n]).max() > 0.5


def test_turbulence_has_the_strength_of_the_standard():
    """MIL-F-8785C: sigma_w = 0.1 W20, sigma_u from it and the height."""
    wind = {"speed_mps": 4.0, "from_deg": 0.0, "turbulence": "light"}
    truth = Flown(airborne({"do": "straight", "for_s": 80.0}, wind=wind, seed=1)).truth
    height = 120.0 / 0.3048
    sigma_w = 0.1 * 7.62
    sigma_u = sigma_w / (0.177 + 0.000823 * height) ** 0.4
    assert truth.wind_n[:, 2].std() == pytest.approx(sigma_w, rel=0.4)
    assert truth.wind_n[:, :2].std(axis=0) == pytest.approx([sigma_u, sigma_u], rel=0.5)
    assert truth.wind_n[:, :2].mean(axis=0) == pytest.approx([-4.0, 0.0], abs=1.6)  # gusts of 15 s average out slowly


def test_a_gust_comes_and_goes():
    gust = {"at_s": 2.0, "speed_mps": 5.0, "rise_s": 1.0, "from_deg": 90.0}
    flown = Flown(airborne({"do": "straight", "for_s": 8.0}, wind={"gust": [gust]}))
    east = flown.truth.wind_n[:, 1]
    assert east.min() == pytest.approx(-5.0, abs=1e-3)  # from the east
    assert np.abs(east[flown.truth.t < 1.99]).max() < 1e-6
    assert np.abs(east[flown.truth.t > 5.1]).max() < 1e-6
    assert [e.t for e in flown.events if "gust" in e.text] == [pytest.approx(2.0)]


def test_the_start_in_the_air_is_where_it_was_asked_for():
    scene = airborne({"do": "straight", "for_s": 3.0}, wind={"speed_mps": 6.0, "from_deg": 200.0})
    flown = Flown(scene)
    truth = flown.truth
    assert truth.height_agl[0] == pytest.approx(120.0, abs=1.0)
    assert truth.airspeed[0] == pytest.approx(20.0, abs=1.0)
    assert flown.heading[0] % 360.0 == pytest.approx(320.0, abs=2.0)
    away = (truth.lla[0, :2] - [scene.start.latitude, scene.start.longitude]) * 6.37e6
    assert np.abs(away).max() < 40.0  # flown in on a heading, so the wind has moved it a little
    tilted = Flown(airborne({"do": "straight", "for_s": 5.0}, start={"on_ground": False, "roll_deg": 40.0}))
    assert tilted.roll[0] == pytest.approx(40.0, abs=1e-6)


def test_duration_cuts_the_flight():
    flown = Flown(airborne({"do": "straight", "for_s": 60.0}, duration_s=2.5))
    assert flown.truth.t[-1] == pytest.approx(2.5)
    assert flown.error is None
    assert flown.flight.done
    assert flown.flight.expected_duration == pytest.approx(2.5)


def test_any_aircraft_of_jsbsim_stands():
    flown = Flown(make(aircraft="c172p", step=[{"do": "wait", "for_s": 2.0}], rate_hz=200.0))
    assert flown.flight.dt == pytest.approx(1 / 200)
    assert np.linalg.norm(flown.truth.accel_b[-1]) == pytest.approx(9.81, abs=0.05)
    assert "aircraft/c172p/c172p.xml" in flown.flight.attachments()


def test_a_script_of_jsbsim_flies(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flown = Flown(make(script="c1723", duration_s=40.0))
    assert flown.error is None
    assert flown.truth.t[-1] == pytest.approx(40.0)
    assert flown.truth.height_agl[-1] > 20.0
    assert attitude_residual_deg(flown.truth).max() < 0.005
    assert {"scripts/c1723.xml", "aircraft/c172x/c172x.xml"} <= set(flown.flight.attachments())
    assert (flown.setpoints.step == -1).all()
    assert list(tmp_path.iterdir()) == []  # the script asks JSBSim to write files; nobody else did


def test_the_aircraft_is_kept_for_the_log():
    files = open_flight(airborne({"do": "straight"})).attachments()
    assert {"aircraft/trainer/trainer.xml", "aircraft/trainer/autopilot.xml"} <= set(files)
    assert any("Engines" in name for name in files)
    assert b"<fdm_config" in files["aircraft/trainer/trainer.xml"]


def test_setpoints_say_what_the_pilot_wants():
    flown = Flown(airborne({"do": "turn", "bank_deg": 25.0, "for_s": 8.0, "airspeed_mps": 21.0}))
    wanted = flown.setpoints
    assert np.diff(wanted.t) == pytest.approx(0.02)
    assert np.degrees(wanted.roll[10]) == pytest.approx(25.0)
    assert wanted.airspeed[10] == 21.0
    assert np.isnan(wanted.heading[10])
    assert wanted.altitude[10] == pytest.approx(270.0)
    assert np.isfinite(wanted.surfaces).all()
    assert np.abs(wanted.surfaces).max() <= 1.0


@pytest.mark.parametrize("error_deg", [0.0, 5.0])
def test_the_aircraft_flies_on_an_estimate(error_deg):
    """An estimate whose roll is wrong by 5 degrees makes it bank by 5 degrees less."""
    flight = open_flight(airborne({"do": "turn", "bank_deg": 20.0, "for_s": 8.0}))
    half = np.radians(error_deg) / 2.0
    tilt = np.array([[np.cos(half), np.sin(half), 0.0, 0.0]])
    roll = 0.0
    while len(rows := flight.fly(4)):
        flight.feedback(product(rows.q_nb[-1:], tilt)[0], rows.rate_ib_b[-1])
        roll = euler_deg(rows.q_nb)[0][-1]
    flight.feedback(np.full(4, np.nan), np.zeros(3))  # no estimate: ignored
    assert flight.error is None
    assert roll == pytest.approx(20.0 - error_deg, abs=0.6)


def test_before_the_hand_over_it_flies_on_the_truth():
    turn = {"do": "turn", "bank_deg": 20.0, "for_s": 6.0}
    flight = open_flight(airborne(turn, {"do": "hand_over"}, turn))
    tilt = np.array([[np.cos(np.radians(2.5)), np.sin(np.radians(2.5)), 0.0, 0.0]])
    roll = []
    while len(rows := flight.fly(4)):
        flight.feedback(product(rows.q_nb[-1:], tilt)[0], rows.rate_ib_b[-1])
        roll.append((rows.t[-1], euler_deg(rows.q_nb)[0][-1]))
    t, roll = np.array(roll).T
    assert roll[(t > 4.0) & (t < 6.0)] == pytest.approx(20.0, abs=0.6)
    assert roll[t > 10.0] == pytest.approx(15.0, abs=0.6)


def test_circuit_says_its_lineup():
    text = scenario.find("circuit").read_text(encoding="utf-8")
    data = tomllib.loads(text)
    papers, practical = (
        ["ekf-chr", "ckf-chr", "cdkf-chr", "ekf-sbg"],
        ["ckf-air-chr", "air-ins-chr", "ins21-chr", "ins21-sbg"],
    )
    assert list(data["estimator"]) == papers + practical
    assert set(data["suite"]) == {"chr", "sbg"}


def test_how_far_the_logged_rate_of_the_truth_carries():
    """At 100 Hz a trapezium of the rate loses tenths of a degree in rough manoeuvres, at 400 Hz nothing to speak of."""
    truth = Flown(airborne({"do": "windup_turn"}, {"do": "roll"}, {"do": "straight", "for_s": 10.0}, wind=ROUGH)).truth
    every, fourth = (attitude_residual_deg(rows).max() for rows in (truth, truth[::4]))
    assert every < 0.01 < 5.0 * every < fourth < 0.5


def test_the_description_of_the_log_says_how_far_its_rate_carries(circuit):
    stated = re.search(r"at 100 Hz .* back to ([.0-9]+) deg over the circuit; .* = 400.* \(([.0-9]+) deg\)", IMU.about)
    at_100_hz, at_400_hz = (attitude_residual_deg(rows).max() for rows in (circuit.truth[::4], circuit.truth))
    assert (float(stated[1]), float(stated[2])) == (round(at_100_hz, 2), round(at_400_hz, 3))


def test_a_script_that_trims_begins_after_it():
    """JSBSim's trim puts the aircraft back to its initial conditions: no row of the truth has both sides of that."""
    flown = Flown(make(script="c172_cruise_8K", duration_s=12.0))
    truth = flown.truth
    assert flown.flight.error is None
    north = np.diff(truth.lla[:, 0]) * 6.37e6
    assert np.abs(north - 0.5 * np.diff(truth.t) * (truth.vel_n[1:, 0] + truth.vel_n[:-1, 0])).max() < 0.1
    assert truth.t[0] == 0.0
    assert any("the script trims at" in event.text for event in flown.events)


def test_a_script_that_jumps_later_ends_there(monkeypatch):
    monkeypatch.setattr(jsbsim_flight, "TRIMMED_BY", 0.0)
    flown = Flown(make(script="c172_cruise_8K", duration_s=40.0))
    assert "the script moves the aircraft by" in (flown.flight.error or "")
    assert "duration_s" in flown.flight.error


def test_a_rocket_on_its_pad_feels_its_weight():
    truth = Flown(make(script="J2460", duration_s=2.0)).truth
    assert truth.on_ground.all()
    np.testing.assert_allclose(np.linalg.norm(truth.accel_b, axis=1), 9.792, atol=2e-3)
    np.testing.assert_allclose(truth.accel_b[:, 0], 9.792, atol=2e-3)  # nose up
