"""The shipped scenarios fly."""

import numpy as np
import pytest
from flight_helpers import Flown

from ahrs_sim import scenario
from ahrs_sim.flight import open_flight
from ahrs_sim.scenario.shipped import scenario_dir

NAMES = sorted(path.stem for path in scenario_dir().glob("*.toml"))


@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_opens_and_begins(name):
    flight = open_flight(scenario.load(name))
    assert (flight.expected_duration is None) == (name == "airfield")  # of another aircraft it is not known
    assert len(flight.fly(100)) == 100
    assert flight.error is None


FLOWN = [n for n in NAMES if not n.startswith("closed_loop")]  # which need an estimator
# Seed 4 here, for `ahrs-sim check` flies them with others; of "airfield", which test_any_aircraft flies, not more.
SEEDS = [(n, 4) for n in FLOWN] + [pytest.param(n, 1, marks=pytest.mark.exhaustive) for n in FLOWN if n != "airfield"]


@pytest.mark.long
@pytest.mark.parametrize(("name", "seed"), SEEDS)
def test_every_scenario_completes(name, seed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flown = Flown(scenario.load(name, seed=seed))
    assert flown.error is None
    assert np.isfinite(flown.truth.accel_b).all()
    expected = flown.flight.expected_duration
    assert (expected is None) == (name == "airfield")
    if expected is not None:
        assert flown.truth.t[-1] == pytest.approx(expected, rel=0.2)
    assert list(tmp_path.iterdir()) == []  # JSBSim's script saves its state half-way; not here


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_it_lands_from_anywhere(seed):
    random = np.random.default_rng(seed)
    heading = random.uniform(-180.0, 180.0)
    start = {"on_ground": False, "height_m": random.uniform(50.0, 150.0), "heading_deg": heading}
    wind = {"speed_mps": random.uniform(0.0, 6.0), "from_deg": heading + random.uniform(-60.0, 60.0)}
    wind["turbulence"] = ["none", "light", "moderate"][seed % 3]
    steps = [
        {"do": "straight", "heading_deg": random.uniform(0.0, 360.0), "for_s": random.uniform(5.0, 60.0)},
        {"do": "approach"},
        {"do": "land"},
    ]
    flown = Flown(scenario.parse({"seed": seed, "start": start, "wind": wind, "step": steps}, "test.toml", "test"))
    assert flown.error is None
    assert np.abs((flown.truth.lla[-1] - flown.truth.lla[0])[:2] * 6.37e6).max() < 3000.0
    assert flown.truth.on_ground[-1]
