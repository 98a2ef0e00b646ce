"""Runs of two states of the sources are not mixed in one campaign."""

import json
import shutil
import time
from pathlib import Path

import pytest

from ahrs_sim import scenario
from ahrs_sim.errors import InputError
from ahrs_sim.flight.fdm import library_dir
from ahrs_sim.runs import sources
from ahrs_sim.runs.campaign_plan import Plan
from ahrs_sim.runs.campaign_store import Store
from ahrs_sim.scenario import Gate
from ahrs_sim.scenario.code import ANY

MOTION = """
seed = 3
duration_s = 24.0
[start]
latitude_deg = 43.0
altitude_m = 150.0
[motion]
kind = "sway"
[suite.chr]
grade = "chr_6dm"
[estimator.own]
method = "{method}"
suite = "chr"
"""
FLIGHT = """
aircraft = "hangar/mine"
duration_s = 4.0
[start]
on_ground = false
height_m = 500.0
[suite.chr]
grade = "chr_6dm"
[estimator.ekf]
method = "marg-ekf"
suite = "chr"
[[step]]
do = "straight"
for_s = 4.0
"""
FILTER = "class Own: pass\n"


def plan(path: Path, runs: int = 2) -> Plan:
    return Plan.make(scenario.load(str(path), gate=Gate(ANY)), runs)


def test_a_campaign_goes_on_with_the_same_sources_only(tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(MOTION.format(method="marg-ekf"))
    store = Store(str(tmp_path / "out"))
    store.begin(plan(path))
    store.check(plan(path, 3))
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    now = manifest["sources"]["estimators"]
    manifest["sources"]["estimators"] = "0123456789abcdef"
    store.write("manifest.json", json.dumps(manifest).encode())
    with pytest.raises(InputError) as refused:
        store.begin(plan(path))
    assert str(refused.value) == (
        f"{tmp_path / 'out'}: its flights were flown with other sources (estimators 0123456789abcdef, now {now}); "
        "go on with those, or start anew: choose another -o, or remove this folder"
    )
    manifest["sources"]["estimators"] = now
    manifest["versions"]["jsbsim"] = "1.0.0"
    store.write("manifest.json", json.dumps(manifest).encode())
    with pytest.raises(InputError, match=r"with other versions \(jsbsim 1\.0\.0, now "):
        store.check(plan(path))
    del manifest["sources"], manifest["versions"]
    store.write("manifest.json", json.dumps(manifest).encode())
    with pytest.raises(InputError, match="it has not noted which"):
        store.check(plan(path))


@pytest.mark.parametrize("method", ["digested.py:Own", "digested:Own", "lib:digested.py"])  # no other test's module
def test_an_estimator_from_outside_counts(method: str, tmp_path: Path) -> None:
    path, own = tmp_path / "flight.toml", tmp_path / "digested.py"
    path.write_text(MOTION.format(method=method))
    own.write_text(FILTER)
    loaded = scenario.load(str(path), gate=Gate(ANY))
    before = sources.digests(loaded, (method,))
    assert sources.digests(loaded, (method,)) == before
    own.write_text(FILTER + "\n")
    after = sources.digests(loaded, (method,))
    assert {name for name in after if after[name] != before[name]} == {method}


def test_an_aircraft_of_ones_own_counts(tmp_path: Path) -> None:
    path, model = tmp_path / "flight.toml", tmp_path / "hangar" / "mine" / "mine.xml"
    path.write_text(FLIGHT)
    shutil.copytree(library_dir() / "aircraft" / "c172p", model.parent)
    (model.parent / "c172p.xml").rename(model)
    loaded = scenario.load(str(path))
    before = sources.digests(loaded, ())
    model.write_text(model.read_text().replace('<wingarea unit="FT2"> 174', '<wingarea unit="FT2"> 175'))
    after = sources.digests(loaded, ())
    assert {name for name in after if after[name] != before[name]} == {"aircraft"}


def test_a_grade_of_ones_own_counts(tmp_path: Path) -> None:
    path, own = tmp_path / "flight.toml", tmp_path / "own.toml"
    path.write_text(MOTION.format(method="marg-ekf").replace('"chr_6dm"', '"own.toml"'))
    made = []
    for bias in (0.1, 0.2):
        own.write_text(
            f'title = "own"\nextends = "chr_6dm"\n[gyro]\n'
            f'turn_on_bias_dps = {{value = {bias}, source = "measured", mark = "chosen"}}\n'
        )
        made.append(sources.digests(scenario.load(str(path)), ()))
    assert {name for name in made[1] if made[0][name] != made[1][name]} == {"own.toml"}


def test_digests_cost_little(tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(MOTION.format(method="marg-ekf"))
    loaded = scenario.load(str(path))
    sources.digests(loaded, ())
    begin = time.process_time()
    sources.digests(loaded, ())
    assert time.process_time() - begin < 0.1
