"""Every manoeuvre completes and does what it says; what cannot be done ends the flight with a clear reason."""

import math

import numpy as np
import pytest
from flight_helpers import AIR, Flown, airborne, make, to_ned

from ahrs_sim.errors import InputError
from ahrs_sim.flight import open_flight
from ahrs_sim.flight.manoeuvres import MANOEUVRES, parse_steps
from ahrs_sim.scenario.table import Table


def steps(*tables):
    return [Table(table, f"f.toml: [[step]] {i + 1}") for i, table in enumerate(tables)]


def fly(*tables, **data):
    flown = Flown(airborne(*tables, **data))
    assert flown.error is None
    return flown


def offset(truth):
    """North and east of the start, (n, 2) m."""
    return (truth.lla[:, :2] - truth.lla[0, :2]) * [6.36e6, 6.36e6 * math.cos(truth.lla[0, 0])]


def turned(flown, rows):
    heading = np.unwrap(np.radians(flown.heading[rows]))
    return math.degrees(heading[-1] - heading[0])


# -- parsing, without an aircraft


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"do": "trun"}, "did you mean 'turn'"),
        ({}, "do: missing"),
        ({"do": "turn", "bank_dgr": 30.0}, "did you mean 'bank_deg'"),
        ({"do": "wait"}, "for_s: missing"),
        ({"do": "wait", "for_s": -1.0}, "out of range"),
        ({"do": "wait", "for_s": math.nan}, "finite"),
        ({"do": "wait", "for_s": "long"}, "finite"),
        ({"do": "turn", "timeout_s": 0.0}, "out of range"),
        ({"do": "turn", "bank_deg": 30.0, "rate_dps": 3.0}, "exclude"),
        ({"do": "turn", "through_deg": 90.0, "for_s": 3.0}, "exclude"),
        ({"do": "turn", "through_deg": 90.0, "bank_deg": -30.0}, "fix a sign"),
        ({"do": "turn", "bank_deg": 0.0}, "no turn"),
        ({"do": "orbit", "north_m": 1.0}, "belong together"),
        ({"do": "orbit", "turns": 0.0}, "no orbit"),
        ({"do": "doublet", "surface": "flaps"}, "aileron"),
        ({"do": "set", "property": "ap/motor-on"}, "value: missing"),
        ({"do": "land", "glide_deg": 50.0}, "out of range"),
    ],
)
def test_bad_steps_are_refused(table, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_steps(steps({"do": "wait", "for_s": 1.0}, table))
    assert "[[step]] 2" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_manoeuvre_has_a_time_out_and_a_duration():
    least = {"wait": {"for_s": 1.0}, "climb": {"to_height_m": 50.0}, "descend": {"to_height_m": 50.0}}
    least |= {"goto": {"north_m": 1.0, "east_m": 1.0}, "random": {"for_s": 60.0}}
    least |= {"survey": {"length_m": 500.0, "spacing_m": 50.0}}
    least |= {"doublet": {"surface": "rudder"}, "set": {"property": "x", "value": 1.0}}
    for name in MANOEUVRES:
        (step,) = parse_steps(steps({"do": name, **least.get(name, {})}))
        assert step.timeout > step.expected() >= 0.0
        (step,) = parse_steps(steps({"do": name, "timeout_s": 7.0, **least.get(name, {})}))
        assert step.timeout == 7.0
        assert type(step).__doc__


# -- flying


def test_run_up_on_the_brakes():
    run = {"do": "run_up", "throttle": 0.5, "for_s": 6.0}
    flown = Flown(make(step=[{"do": "wait", "for_s": 2.0}, run, {"do": "wait", "for_s": 3.0}]))
    assert flown.error is None
    up, truth = flown.during(2), flown.truth
    assert truth.rpm[up][-1] > 3500.0 and truth.rpm[-1] < 1000.0
    assert np.abs(truth.vel_n).max() < 0.1 and truth.on_ground.all()
    fast = Flown(make(step=[{**run, "throttle": 1.0}]))
    assert fast.error is not None and "brakes do not hold throttle 1" in fast.error


@pytest.mark.parametrize("through", [360.0, -180.0, 90.0])
def test_turn_holds_its_bank_and_ends_on_its_heading(through):
    flown = fly({"do": "turn", "bank_deg": 30.0, "through_deg": through}, {"do": "straight", "for_s": 6.0})
    rows = flown.during(1)
    middle = slice(rows.start + 800, rows.stop - 400)
    assert np.abs(flown.roll[middle] - math.copysign(30.0, through)).max() < 2.0
    assert np.abs(flown.truth.height_agl[middle] - 120.0).max() < 3.0
    assert turned(flown, rows) == pytest.approx(through, abs=12.0)
    assert (flown.heading[-1] - 320.0 - through) % 360.0 == pytest.approx(0.0, abs=2.0) or (
        flown.heading[-1] - 320.0 - through
    ) % 360.0 == pytest.approx(360.0, abs=2.0)


def test_turn_by_rate_and_by_time():
    flown = fly({"do": "turn", "rate_dps": -9.0, "for_s": 20.0})
    last = slice(-4000, None)
    assert turned(flown, last) / 10.0 == pytest.approx(-9.0, abs=0.5)
    assert flown.truth.t[-1] == pytest.approx(20.0, abs=0.03)


def test_a_coordinated_turn_has_no_sideslip_and_needs_more_lift():
    flown = fly({"do": "turn", "bank_deg": 45.0, "for_s": 15.0})
    force = flown.truth.accel_b[-2000:]
    assert force[:, 1].mean() == pytest.approx(0.0, abs=0.3)
    assert np.linalg.norm(force, axis=1).mean() == pytest.approx(9.81 / math.cos(math.radians(45.0)), rel=0.03)


def test_calibrate_is_two_minutes_in_place_and_ends_as_it_began():
    flown = fly({"do": "calibrate"}, {"do": "straight", "for_s": 5.0})
    assert flown.error is None
    rows = flown.during(1)
    assert flown.truth.t[rows][-1] == pytest.approx(120.0, abs=2.0)
    assert np.abs(flown.truth.height_agl - 120.0).max() < 6.0
    assert flown.roll[rows].max() == pytest.approx(60.0, abs=2.0)
    assert flown.roll[rows].min() == pytest.approx(-60.0, abs=2.0)
    assert flown.truth.airspeed[rows].min() < 17.5
    assert flown.truth.airspeed[-1] == pytest.approx(20.0, abs=0.7)
    gentle = fly({"do": "calibrate", "bank_deg": 30.0})
    assert np.abs(gentle.roll).max() < 33.0


def test_figure_eight_goes_both_ways_and_returns():
    flown = fly({"do": "figure_eight", "bank_deg": 45.0})
    rows = flown.during(1)
    assert flown.roll[rows].max() == pytest.approx(45.0, abs=3.0)
    assert flown.roll[rows].min() == pytest.approx(-45.0, abs=3.0)
    assert turned(flown, rows) == pytest.approx(0.0, abs=15.0)
    assert np.linalg.norm(offset(flown.truth)[-1]) < 60.0
    assert flown.roll[rows][:3000].max() > 40.0  # to the right first


@pytest.mark.parametrize("turns", [1.0, -1.5])
def test_orbit_keeps_its_circle_in_the_wind(turns):
    table = {"do": "orbit", "north_m": -50.0, "east_m": 100.0, "radius_m": 90.0, "turns": turns}
    flown = fly(table, wind={"speed_mps": 4.0, "from_deg": 270.0})
    around = offset(flown.truth) - [-50.0, 100.0]
    late = slice(-int(0.6 * 400 * abs(turns) * 2 * math.pi * 90.0 / 20.0), None)
    assert np.abs(np.linalg.norm(around[late], axis=1) - 90.0).max() < 12.0
    bearing = np.unwrap(np.arctan2(around[late, 1], around[late, 0]))
    assert math.copysign(1.0, bearing[-1] - bearing[0]) == math.copysign(1.0, turns)


def test_climb_and_descend():
    flown = fly({"do": "climb", "to_height_m": 150.0, "rate_mps": 3.0}, {"do": "descend", "to_height_m": 110.0})
    up, down = flown.during(1), flown.during(2)
    assert flown.truth.height_agl[up][-1] == pytest.approx(150.0, abs=1.5)
    assert flown.truth.height_agl[down][-1] == pytest.approx(110.0, abs=1.5)
    assert -flown.truth.vel_n[up, 2].max() < 0.5
    assert -flown.truth.vel_n[up.start + 2000, 2] == pytest.approx(3.0, abs=0.4)


def test_straight_turns_to_its_heading_and_holds_speed():
    flown = fly({"do": "straight", "heading_deg": 50.0, "for_s": 12.0, "airspeed_mps": 23.0})
    assert flown.heading[-1] == pytest.approx(50.0, abs=1.5)
    assert flown.truth.airspeed[-1] == pytest.approx(23.0, abs=0.7)
    assert np.abs(flown.roll[-800:]).max() < 2.0


def test_windup_turn_tightens():
    flown = fly({"do": "windup_turn", "bank_deg": -55.0, "rate_dps": 5.0, "hold_s": 2.0})
    assert flown.roll.min() == pytest.approx(-55.0, abs=3.0)
    assert flown.roll[400 * 6] == pytest.approx(-30.0, abs=5.0)
    assert np.linalg.norm(flown.truth.accel_b, axis=1).max() > 15.0


@pytest.mark.parametrize(("surface", "axis"), [("aileron", 0), ("elevator", 1), ("rudder", 2)])
def test_doublet_moves_its_axis_both_ways(surface, axis):
    quiet = fly({"do": "straight", "for_s": 1.0}).truth.rate_ib_b[:, axis]
    flown = fly({"do": "doublet", "surface": surface, "size": 0.4, "for_s": 1.0})
    rate = np.degrees(flown.truth.rate_ib_b[:, axis])
    assert rate[:200].max() > 8.0  # right, up, right first
    assert rate.min() < -8.0
    assert np.abs(np.degrees(quiet)).max() < 4.0
    assert np.ptp(flown.setpoints.surfaces[:, axis]) > 0.5
    assert np.abs(flown.roll[-100:]).max() < 6.0


def test_pull_up():
    flown = fly({"do": "pull_up", "pitch_deg": 35.0}, {"do": "straight", "for_s": 10.0})
    rows = flown.during(1)
    assert flown.pitch[rows].max() == pytest.approx(35.0, abs=6.0)
    assert np.linalg.norm(flown.truth.accel_b[rows], axis=1).max() > 13.0
    assert abs(flown.pitch[-1]) < 6.0


def test_loop_goes_through_inverted_and_returns():
    flown = fly({"do": "loop"}, {"do": "straight", "for_s": 12.0})
    rows = flown.during(1)
    up = to_ned(flown.truth.q_nb[rows], np.tile([0.0, 0.0, -1.0], (rows.stop - rows.start, 1)))[:, 2]
    assert up.max() > 0.95  # the aircraft's up points down
    assert np.abs(flown.pitch[rows]).max() > 80.0
    assert flown.truth.height_agl[rows].max() > flown.truth.height_agl[rows.start] + 15.0
    assert np.degrees(flown.truth.rate_ib_b[rows, 1]).max() > 60.0
    assert abs(flown.roll[-1]) < 3.0
    assert flown.heading[-1] % 360.0 == pytest.approx(320.0, abs=6.0)
    assert flown.truth.height_agl.min() > 60.0


@pytest.mark.parametrize("through", [360.0, -720.0])
def test_roll_goes_round(through):
    flown = fly({"do": "roll", "through_deg": through, "rate_dps": 150.0}, {"do": "straight", "for_s": 10.0})
    rows = flown.during(1)
    rolled = np.degrees(np.unwrap(np.radians(flown.roll)))
    assert rolled[-1] - rolled[0] == pytest.approx(through, abs=5.0)
    assert np.abs(np.degrees(flown.truth.rate_ib_b[rows, 0])).max() > 120.0
    assert flown.truth.height_agl.min() > 90.0


@pytest.mark.parametrize(("heading", "wind_from", "away"), [(320.0, 310.0, 140.0), (90.0, 40.0, 10.0)])
def test_approach_and_landing_from_elsewhere(heading, wind_from, away):
    start = {**AIR, "heading_deg": heading, "height_m": 80.0}
    wind = {"speed_mps": 4.0, "from_deg": wind_from, "turbulence": "light"}
    outbound = {"do": "straight", "heading_deg": away, "for_s": 15.0}
    last = {"do": "wait", "for_s": 1.0}
    flown = fly(outbound, {"do": "approach"}, {"do": "land"}, last, start=start, wind=wind, seed=2)
    truth = flown.truth
    touch = np.flatnonzero(truth.on_ground)[0]
    north, east = offset(truth)[[touch, -1]].T
    course = math.radians(heading)
    along = north * math.cos(course) + east * math.sin(course)
    cross = east * math.cos(course) - north * math.sin(course)
    assert np.abs(cross).max() < 12.0
    assert np.abs(along).max() < 180.0
    assert truth.vel_n[touch, 2] < 2.0
    assert np.linalg.norm(truth.vel_n[-1]) < 0.3
    assert abs((flown.heading[-1] - heading + 180.0) % 360.0 - 180.0) < 12.0
    assert truth.throttle[-1] == 0.0


def test_takeoff_climbs_along_the_runway():
    flown = Flown(make(step=[{"do": "wait", "for_s": 2.0, "motor": True}, {"do": "takeoff", "to_height_m": 25.0}]))
    assert flown.error is None
    truth = flown.truth
    off = np.flatnonzero(~truth.on_ground)[0]
    assert 10.0 < truth.airspeed[off] < 22.0
    assert truth.height_agl[-1] >= 25.0
    north, east = offset(truth)[-1]
    assert north > 40.0  # heading 0
    assert abs(east) < 10.0


def test_set_writes_a_property():
    flown = fly({"do": "set", "property": "ap/elevator-add-norm", "value": 0.05}, {"do": "straight", "for_s": 1.0})
    assert flown.flight._fdm["ap/elevator-add-norm"] == 0.05


# -- what goes wrong


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (airborne({"do": "set", "property": "ap/rol-cmd-rad", "value": 0.1}), "did you mean 'ap/roll-cmd-rad'"),
        (airborne({"do": "set", "property": "zzzz", "value": 0.1}), "does not exist"),
        (airborne({"do": "set", "property": "velocities/vt-fps", "value": 0.1}), "read only"),
        (make(aircraft="trianer", step=[{"do": "land"}]), "did you mean 'trainer'"),
        (make(script="c1732"), "did you mean"),
        (make(script="c1723", aircraft="trainer"), "flies 'c172x'"),
        (make(aircraft="weather-balloon", step=[{"do": "turn"}]), "cannot be flown by the autopilot"),
        (airborne({"do": "straight", "airspeed_mps": 70.0}), "flies 0 to 60 m/s, not 70"),
        (airborne({"do": "windup_turn", "bank_deg": 78.0}), "up to 75 deg"),
        (
            airborne(
                {"do": "straight"},
                wind={"gust": [{"at_s": 1.0, "speed_mps": 1.0}, {"at_s": 2.0, "speed_mps": 1.0}]},
            ),
            "move it",
        ),
    ],
)
def test_bad_input_is_found_before_the_flight(scene, message):
    with pytest.raises(InputError, match=message) as caught:
        open_flight(scene)
    assert "test.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_time_out():
    flown = Flown(airborne({"do": "straight", "for_s": 1.0}, {"do": "turn", "through_deg": 360.0, "timeout_s": 4.0}))
    assert flown.error is not None
    assert flown.error.startswith("step 2 (turn): not finished after 4 s: turned ")
    assert flown.truth.t[-1] == pytest.approx(5.0, abs=0.1)
    assert flown.events[-1].level == "error"
    assert flown.flight.done


def test_crash():
    dive = ({"do": "set", "property": "ap/pitch-cmd-rad", "value": -0.5},)
    dive += ({"do": "set", "property": "ap/vertical-mode", "value": 1.0}, {"do": "wait", "for_s": 60.0})
    flown = Flown(airborne(*dive, start={**AIR, "height_m": 50.0}))
    assert flown.error is not None
    assert "crash" in flown.error
    assert "step 3 (wait)" in flown.error
    assert flown.events[-1].level == "error"
    assert flown.truth.height_agl[-1] < 2.0
    assert np.isfinite(flown.truth.accel_b).all()


def test_numbers_out_of_bounds():
    flown = Flown(
        airborne(
            {"do": "wait", "for_s": 1.0},
            {"do": "set", "property": "atmosphere/wind-north-fps", "value": 1e300},
            {"do": "wait", "for_s": 5.0},
        )
    )
    assert flown.error is not None
    assert "not a number" in flown.error
    assert flown.truth.t[-1] == pytest.approx(1.0, abs=0.1)
    for name in ("q_nb", "vel_n", "accel_b", "airspeed"):
        assert np.isfinite(getattr(flown.truth, name)).all()


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (airborne({"do": "climb", "to_height_m": 50.0}), "use descend"),
        (airborne({"do": "takeoff"}), "in the air already"),
        (make(step=[{"do": "turn"}]), "take off first"),
        (airborne({"do": "loop", "entry_mps": 55.0, "timeout_s": 5.0}), "entry at 55"),
    ],
)
def test_what_cannot_be_done_says_why(scene, message):
    flown = Flown(scene)
    assert flown.error is not None
    assert message in flown.error
