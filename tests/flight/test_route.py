"""Waypoints, racetracks, survey lines and random manoeuvres."""

import math

import numpy as np
import pytest
from flight_helpers import AIR, Flown, airborne

from ahrs_sim.errors import InputError
from ahrs_sim.flight.manoeuvres import parse_steps
from ahrs_sim.scenario.table import Table

WIND = {"speed_mps": 4.0, "from_deg": 250.0}


def fly(*tables, **data) -> Flown:
    flown = Flown(airborne(*tables, **data))
    assert flown.error is None
    return flown


def place(truth) -> np.ndarray:
    """North and east of the start, (n, 2) m."""
    return (truth.lla[:, :2] - truth.lla[0, :2]) * [6.36e6, 6.385e6 * math.cos(truth.lla[0, 0])]


def closest(flown: Flown, north: float, east: float) -> float:
    return float(np.linalg.norm(place(flown.truth) - [north, east], axis=1).min())


def test_goto_reaches_its_waypoints_in_the_wind():
    flown = fly(
        {"do": "goto", "north_m": 600.0, "east_m": 500.0, "height_m": 150.0, "airspeed_mps": 22.0},
        {"do": "goto", "north_m": -300.0, "east_m": 200.0, "radius_m": 15.0},
        wind=WIND,
    )
    assert closest(flown, 600.0, 500.0) < 30.0
    assert closest(flown, -300.0, 200.0) < 16.0
    assert flown.truth.height_agl[-1] == pytest.approx(150.0, abs=2.0)


def test_goto_by_latitude_and_longitude():
    north, east = 400.0, -350.0
    latitude = 43.57 + math.degrees(north / 6.36e6)
    longitude = 1.47 + math.degrees(east / (6.385e6 * math.cos(math.radians(43.57))))
    flown = fly({"do": "goto", "latitude_deg": latitude, "longitude_deg": longitude, "radius_m": 15.0})
    assert closest(flown, north, east) < 17.0


@pytest.mark.parametrize("left", [False, True])
def test_hold_flies_a_racetrack(left):
    table = {"do": "hold", "north_m": 300.0, "east_m": 0.0, "course_deg": 0.0, "leg_s": 20.0, "times": 2, "left": left}
    flown = fly(table, wind={"speed_mps": 3.0, "from_deg": 0.0})
    where = place(flown.truth)
    near = np.linalg.norm(where - [300.0, 0.0], axis=1) < 25.0
    passes = np.count_nonzero(np.diff(near.astype(int)) == 1)
    assert passes == 3  # once on arrival, once a round
    late = where[len(where) // 3 :]
    side = np.median(late[np.abs(late[:, 1]) > 60.0, 1])  # the outbound leg lies on the side of the turns
    assert math.copysign(1.0, side) == (-1.0 if left else 1.0)
    turned = np.unwrap(np.radians(flown.heading))
    assert math.degrees(turned[-1] - turned[0]) * (-1.0 if left else 1.0) == pytest.approx(720.0, abs=120.0)


def test_survey_follows_its_lines_over_their_whole_length():
    table = {
        "do": "survey",
        "north_m": 200.0,
        "east_m": 100.0,
        "course_deg": 90.0,
        "length_m": 400.0,
        "spacing_m": 50.0,
    }
    flown = fly({**table, "lines": 3}, wind=WIND)
    north, east = place(flown.truth).T
    heading = flown.heading % 360.0
    for line, (across, course) in enumerate([(0.0, 90.0), (-50.0, 270.0), (-100.0, 90.0)]):
        on = (np.abs(north - 200.0 - across) < 12.0) & (np.abs((heading - course + 180.0) % 360.0 - 180.0) < 40.0)
        for x in np.linspace(100.0, 500.0, 41):
            assert np.any(on & (np.abs(east - x) < 10.0)), (line, x)


@pytest.mark.long
def test_random_flight_stays_within_its_limits_and_follows_its_seed():
    table = {"do": "random", "for_s": 400.0, "bank_deg": 40.0, "low_m": 80.0, "high_m": 180.0, "within_m": 1500.0}
    first = fly(table, seed=3)
    assert first.truth.t[-1] == pytest.approx(400.0, abs=0.1)
    assert np.abs(first.roll).max() < 45.0
    assert first.roll.max() > 15.0
    assert first.roll.min() < -15.0
    assert 70.0 < first.truth.height_agl.min() < first.truth.height_agl.max() < 190.0
    assert np.linalg.norm(place(first.truth), axis=1).max() < 2500.0
    again, other = fly({**table, "for_s": 60.0}, seed=3), fly({**table, "for_s": 60.0}, seed=4)
    n = len(again.truth.t)
    assert np.array_equal(again.truth.q_nb[: n - 50], first.truth.q_nb[: n - 50])
    assert not np.array_equal(other.truth.q_nb[:n], again.truth.q_nb[:n])


@pytest.mark.long
def test_random_flight_of_another_aircraft():
    start = {**AIR, "height_m": 3000.0}
    start.pop("airspeed_mps")
    flown = fly({"do": "random", "for_s": 300.0}, aircraft="737", start=start, seed=2)
    assert 1400.0 < flown.truth.height_agl.min() < flown.truth.height_agl.max() < 4600.0
    assert np.ptp(flown.truth.airspeed) > 5.0


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"do": "goto"}, "give north_m and east_m"),
        ({"do": "goto", "north_m": 1.0}, "belong together"),
        ({"do": "goto", "north_m": 1.0, "east_m": 1.0, "latitude_deg": 4.0, "longitude_deg": 1.0}, "exclude"),
        ({"do": "hold", "leg_s": 0.0}, "out of range"),
        ({"do": "survey", "spacing_m": 50.0}, "length_m: missing"),
        ({"do": "random"}, "for_s: missing"),
        ({"do": "random", "for_s": 5.0, "low_m": 100.0, "high_m": 50.0}, "not above low_m"),
        ({"do": "windup_turn", "load_g": 3.0, "bank_deg": 60.0}, "exclude"),
        ({"do": "windup_turn", "left": True}, "belongs to load_g"),
    ],
)
def test_bad_steps_are_refused(table, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_steps([Table(table, "f.toml: [[step]] 1")])
    assert "\n" not in str(caught.value)


def test_a_waypoint_that_no_turn_meets_ends_with_a_reason():
    flown = Flown(airborne({"do": "goto", "north_m": 0.0, "east_m": 30.0, "radius_m": 0.5, "timeout_s": 60.0}))
    assert flown.error is not None
    assert "goto" in flown.error
