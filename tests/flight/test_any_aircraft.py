"""Aircraft that are not ours: analysed, flown by the one autopilot, refused in one line where that is not possible."""

import math
import re
import shutil

import numpy as np
import pytest
from flight_helpers import Flown, make

from ahrs_sim import pipeline, scenario
from ahrs_sim.attitude import euler
from ahrs_sim.cli import main
from ahrs_sim.errors import InputError
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.flight import gains, open_flight
from ahrs_sim.flight.design import design, from_text
from ahrs_sim.flight.fdm import library_dir

AIR = {"on_ground": False, "height_m": 1000.0, "heading_deg": 320.0}
TURNS = [
    {"do": "straight", "for_s": 5.0},
    {"do": "turn", "bank_deg": 30.0, "for_s": 45.0},
    {"do": "turn", "bank_deg": -30.0, "for_s": 45.0},
]


def turns(aircraft: str, **data) -> Flown:
    flown = Flown(make(aircraft=aircraft, step=TURNS, start=AIR, **data))
    assert flown.error is None
    return flown


def steady(flown: Flown, step: int) -> slice:
    """The rows of a turn once it has been entered."""
    rows = flown.during(step)
    return slice(rows.start + 400 * 20, rows.stop)


def test_what_is_found_of_a_cessna_is_plausible():
    found = design("c172p", "test")
    assert 22.0 < found.stall < 27.0  # 48 KCAS in its handbook, clean
    assert 50.0 < found.fastest < 75.0  # 120 kt in level flight, in the handbook
    assert found.stall < found.approach < found.cruise < found.fastest
    assert found.powered
    assert found.refusals == {}
    alphas = [row.alpha for row in found.rows]
    assert alphas == sorted(alphas, reverse=True)
    middle = found.rows[3]
    assert 3.0 < math.hypot(*middle.modes["short period"]) < 10.0
    assert -middle.modes["Dutch roll"][0] > 0.1
    assert 2.0 < middle.climb < 10.0


def test_margins_are_kept_loaded_and_light():
    found = design("c172p", "test")
    for row in found.rows:
        for margins in (row.margins, row.margins_light):
            for gain, phase, _ in margins.values():
                assert gain >= gains.GAIN_MARGIN
                assert phase >= gains.PHASE_MARGIN
        assert row.damping >= gains.DAMPING


@pytest.mark.long
def test_a_design_is_cached_and_read_back(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = design("T38", "test")
    (file,) = (tmp_path / "ahrs_sim").iterdir()
    assert from_text(file.read_text()) == first
    file.write_text(file.read_text().replace('"mass": ', '"mass": 1'))  # the next one comes from the file
    assert design("T38", "test").mass != first.mass
    file.write_text("{ half a file")
    assert design("T38", "test") == first


@pytest.mark.parametrize("aircraft", ["c172p", "737", "f16"])
def test_turns(aircraft):
    flown = turns(aircraft)
    speed = flown.truth.airspeed
    for step, bank in ((2, 30.0), (3, -30.0)):
        rows = steady(flown, step)
        assert np.abs(flown.roll[rows] - bank).max() < 3.0
        assert np.abs(flown.truth.height_agl[rows] - 1000.0).max() < 30.0
        assert np.abs(speed[rows] / speed[0] - 1.0).max() < 0.05


def test_a_glider_holds_its_speed_and_sinks():
    flown = turns("SGS")
    for step, bank in ((2, 30.0), (3, -30.0)):
        rows = steady(flown, step)
        assert np.abs(flown.roll[rows] - bank).max() < 3.0
        assert np.abs(flown.truth.airspeed[rows] / flown.truth.airspeed[0] - 1.0).max() < 0.08
    assert 0.5 < flown.truth.vel_n[:, 2].mean() < 4.0


def test_the_same_flight_twice_is_the_same():
    step = [{"do": "turn", "bank_deg": 30.0, "for_s": 5.0}]
    first, second = (Flown(make(aircraft="c172p", step=step, start=AIR), block=b) for b in (2000, 333))
    for name in ("q_nb", "lla", "accel_b"):
        assert np.array_equal(getattr(first.truth, name), getattr(second.truth, name))


def test_it_flies_on_an_estimate():
    """An attitude that is off in roll by 5 deg: the bank that is held is, too."""
    flight = open_flight(make(aircraft="c172p", step=[{"do": "turn", "bank_deg": 20.0, "for_s": 30.0}], start=AIR))
    off = math.radians(5.0) / 2.0
    last = None
    while len(rows := flight.fly(8)):
        a, b, c, d = rows.q_nb[-1]
        cos, sin = math.cos(off), math.sin(off)
        flight.feedback(
            np.array([a * cos - b * sin, a * sin + b * cos, c * cos + d * sin, d * cos - c * sin]), rows.rate_ib_b[-1]
        )
        last = rows
    assert flight.error is None
    assert last is not None
    a, b, c, d = last.q_nb[-1]
    roll = math.degrees(math.atan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c)))
    assert roll == pytest.approx(15.0, abs=1.0)


@pytest.mark.long
def test_a_real_estimator_flies_a_cessna():
    """It takes over in level flight and turns on what its sensors say; the bank is as good as the estimate is."""
    steps = [
        {"do": "straight", "for_s": 45.0},
        {"do": "hand_over"},
        {"do": "turn", "bank_deg": 20.0, "for_s": 30.0},
    ]
    kept = []

    class Kept(Accuracy):
        def add_truth(self, t, q_nb, vel_n, on_ground):
            kept.append((t, q_nb))
            super().add_truth(t, q_nb, vel_n, on_ground)

    accuracy = Kept(["mine"])
    mine = {"method": "marg-ckf", "suite": "sbg", "aiding": "airspeed"}
    suites = {"sbg": {"grade": "sbg_ig500"}}
    data = {"aircraft": "c172p", "start": AIR, "step": steps, "suite": suites, "estimator": {"mine": mine}, "seed": 2}
    pipeline.fly(make(pilot={"attitude": "mine"}, **data), None, accuracy=accuracy)
    t, q_nb = (np.concatenate(column) for column in zip(*kept, strict=True))
    turn = t > accuracy.begins[3] + 15.0
    roll = np.degrees(euler(q_nb[turn])[:, 0])
    error = accuracy.result(low=float(t[turn][0]))["estimators"]["mine"]["roll_max_deg"]
    assert 0.05 < error < 2.0
    assert np.abs(roll - 20.0).max() < error + 0.5
    assert np.abs(roll - 20.0).max() > 0.05  # on the truth it holds 20 deg to a hundredth


def test_an_aircraft_of_ones_own_by_path(tmp_path):
    mine = tmp_path / "hangar" / "mine"
    shutil.copytree(library_dir() / "aircraft" / "c172p", mine)
    (mine / "c172p.xml").rename(mine / "mine.xml")
    for name in ("hangar/mine", "hangar/mine/mine.xml", str(mine)):
        made = make(aircraft=name, step=TURNS, start=AIR)
        object.__setattr__(made, "where", str(tmp_path / "scenario.toml"))
        flight = open_flight(made)
        assert "aircraft/mine/mine.xml" in flight.attachments()
        assert "design.json" in flight.attachments()
    flown = Flown(made)
    assert flown.error is None
    assert np.abs(flown.roll[steady(flown, 2)] - 30.0).max() < 3.0


def script(folder, **changed):
    """A script of JSBSim's beside a scenario, with other attributes of its aircraft."""
    text = (library_dir() / "scripts" / "c1721.xml").read_text()
    attributes = {"aircraft": "c172r", "initialize": "reset00", **changed}
    use = " ".join(f'{k}="{v}"' for k, v in attributes.items())
    (folder / "scripts").mkdir(exist_ok=True)
    (folder / "scripts" / "mine.xml").write_text(re.sub(r"<use [^>]*>", f"<use {use}/>", text))


def scripted(folder, **data):
    made = make(duration_s=2.0, **{"script": "scripts/mine.xml", **data})
    object.__setattr__(made, "where", str(folder / "scenario.toml"))
    return made


def test_a_script_of_ones_own_by_path(tmp_path):
    """Flies as the same script of JSBSim's, and goes into the log; with an aircraft of one's own, too."""
    script(tmp_path)
    theirs, mine = Flown(make(script="c1721", duration_s=2.0)), Flown(scripted(tmp_path))
    np.testing.assert_array_equal(mine.truth.q_nb, theirs.truth.q_nb)
    np.testing.assert_array_equal(mine.truth.lla, theirs.truth.lla)
    files = mine.flight.attachments()
    assert "scripts/mine.xml" in files
    assert "aircraft/c172r/c172r.xml" in files
    own = tmp_path / "hangar" / "mine"
    shutil.copytree(library_dir() / "aircraft" / "c172r", own)
    (own / "c172r.xml").rename(own / "mine.xml")
    script(tmp_path, aircraft="mine")
    flown = Flown(scripted(tmp_path, aircraft="hangar/mine"))
    np.testing.assert_array_equal(flown.truth.q_nb, theirs.truth.q_nb)
    assert {"scripts/mine.xml", "aircraft/mine/mine.xml"} <= set(flown.flight.attachments())


@pytest.mark.parametrize(
    ("changed", "data", "message"),
    [
        ({}, {"script": "scripts/gone.xml"}, "script: 'scripts/gone.xml': there is no file"),
        ({}, {"script": "c17231"}, "script: 'c17231' is unknown"),
        ({"initialize": "../../../etc/passwd"}, {}, "initialize '../../../etc/passwd' must be a name"),
        ({"aircraft": "../c172r"}, {}, "aircraft '../c172r' must be a name"),
        ({}, {"aircraft": "c172p"}, "flies 'c172r', not 'c172p'"),
        ({}, {"aircraft": "hangar/mine"}, "there is no file or folder"),
    ],
)
def test_what_a_script_may_not_do_is_refused_in_one_line(tmp_path, changed, data, message):
    script(tmp_path, **changed)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        open_flight(scripted(tmp_path, **data))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("aircraft", "step", "message"),
    [
        ("ball", {"do": "straight"}, "no glide is found"),
        ("no/such/folder", {"do": "straight"}, "there is no file or folder"),
        ("737", {"do": "turn", "bank_deg": 60.0, "airspeed_mps": 95.0}, r"has up to \d+ deg at 95 m/s.*or at \d+ m/s"),
        ("737", {"do": "straight", "airspeed_mps": 30.0}, r"flies \d+ to \d+ m/s, not 30"),
        ("SGS", {"do": "takeoff"}, "no engine"),
        ("737", {"do": "orbit", "radius_m": 90.0}, "deg of bank"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(aircraft, step, message):
    with pytest.raises(InputError, match=message) as caught:
        open_flight(make(aircraft=aircraft, step=[step], start=AIR))
    assert "\n" not in str(caught.value)
    assert "test.toml" in str(caught.value)


# Nose wheel, tail wheel and fighter; `ahrs-sim check` flies an airliner. The others differ from these in numbers
# (docs/aircraft.md has all of them).
KINDS = ("c172p", "J3Cub", "f16")
OTHERS = ("OV10", "A320", "737", "A4", "F80C", "T37", "T38", "XB-70", "c182")


@pytest.mark.long
@pytest.mark.parametrize("aircraft", [*KINDS, *(pytest.param(name, marks=pytest.mark.exhaustive) for name in OTHERS)])
def test_circuit_from_standing_to_standing(aircraft):
    flown = Flown(scenario.parse({**scenario.load("airfield").data, "aircraft": aircraft}, "airfield.toml", "airfield"))
    assert flown.error is None
    truth = flown.truth
    assert truth.on_ground[0]
    assert truth.on_ground[-1]
    assert truth.height_agl.max() > 300.0
    assert np.linalg.norm(truth.vel_n[-1]) < 0.5
    known = design(aircraft, "test")
    off = int(np.flatnonzero(~truth.on_ground & (truth.airspeed > known.stall))[0])
    assert truth.airspeed[off] < 1.5 * known.stall


@pytest.mark.parametrize("aircraft", ["f16", "T38"])
def test_five_g(aircraft):
    start = {**AIR, "height_m": 3000.0, "airspeed_mps": 0.95 * design(aircraft, "test").fastest}
    step = {"do": "windup_turn", "load_g": 5.0, "rate_dps": 8.0, "hold_s": 4.0}
    flown = Flown(make(aircraft=aircraft, step=[step], start=start))
    assert flown.error is None
    load = np.linalg.norm(flown.truth.accel_b[-800:], axis=1) / 9.81
    assert np.median(load) == pytest.approx(5.0, abs=0.4)


def test_the_command_prints_the_design(capsys):
    assert main(["aircraft", "c172p"]) == 0
    text = capsys.readouterr().out
    for word in ("stall", "cruise", "Dutch roll", "margins", "bank held", "853 kg"):
        assert word in text
    assert main(["aircraft", "c172p", "--json"]) == 0
    assert from_text(capsys.readouterr().out) == design("c172p", "test")
    assert main(["aircraft", "ball"]) == 2
    assert "no glide is found" in capsys.readouterr().err
