"""Flights whose autopilot flies on an estimate."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import attitude
from ahrs_sim.cli import main
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.review.compare import compare as figures_of


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "ahrs_sim", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def fly(*arguments: str | Path) -> int:
    return main(["fly", *map(str, arguments), "--quiet"])


CLOSED = """
extends = "circuit"
duration_s = 100.0
[suite.chr]
rate_hz = 50.0
[pilot]
attitude = "pilot-chr"
[estimator.pilot-chr]
method = "marg-ckf"
suite = "chr"
aiding = "{}"
"""


@pytest.mark.long
def test_the_aircraft_flies_on_an_estimate(tmp_path: Path) -> None:
    scene, log = tmp_path / "closed.toml", tmp_path / "closed.mcap"
    scene.write_text(CLOSED.format("airspeed"))
    assert fly(scene, "-o", log, "--estimator", "pilot-chr") == 0
    closed = figures_of(log)
    assert closed["to_s"] == pytest.approx(100, abs=0.1)
    assert closed["estimators"]["pilot-chr"]["tilt_rmse_deg"] < 3.0
    opened = tmp_path / "open.mcap"
    scene.write_text(CLOSED.format("airspeed").replace("attitude", "#"))
    assert fly(scene, "-o", opened, "--estimator", "pilot-chr") == 0
    with FlightReader(log) as a, FlightReader(opened) as b:
        flown, on_truth = a.truth(), b.truth()
    standing = slice(0, 5000)
    assert flown[standing].lla.tobytes() == on_truth[standing].lla.tobytes(), "the loop matters only once it moves"
    assert np.abs(flown.height_agl - on_truth.height_agl).max() < 10
    assert np.abs(flown.height_agl - on_truth.height_agl).max() > 0.01, "the estimate's errors are flown"


def by_step(reader: FlightReader) -> np.ndarray:
    """Height (steps, 400), m, at equal shares of every step: steps end when the pilot is content, sooner or later."""
    truth, events = reader.truth(), reader.events()
    begin = [e.t for e in events if e.text.endswith("begins")]
    spans = zip(begin, [*begin[1:], truth.t[-1]], strict=True)
    return np.array([np.interp(np.linspace(*span, 400), truth.t, truth.height_agl) for span in spans])


CIRCUIT = """
extends = "closed_loop"
[suite.chr]
rate_hz = 50.0
"""


@pytest.fixture(scope="module")
def heights_on_the_truth(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Height by step of the closed loop's circuit, flown on the truth, once for all estimators."""
    folder = tmp_path_factory.mktemp("truth")
    scene, log = folder / "truth.toml", folder / "truth.mcap"
    scene.write_text(CIRCUIT)
    assert fly(scene, "-o", log, "--pilot", "truth", "--estimator", "ckf-air-chr") == 0
    with FlightReader(log) as reader:
        return by_step(reader)


@pytest.mark.long
@pytest.mark.parametrize(
    ("pilot", "steps"),
    [
        ("ins21-chr", 20),  # the whole circuit, from take-off to standing still again
        # Above a filter with airspeed flies a take-off and a turn; here up to the end of the turns to both sides.
        pytest.param("ckf-air-chr", 8, marks=pytest.mark.exhaustive),
        pytest.param("ckf-air-chr", 20, marks=pytest.mark.exhaustive),
    ],
)
def test_closed_loop_on_estimates_flies_as_on_the_truth(
    tmp_path: Path, heights_on_the_truth: np.ndarray, pilot: str, steps: int
) -> None:
    """At 50 Hz, the rate of the autopilot; the loop works sample by sample, and costs as many."""
    scene, log = tmp_path / "closed.toml", tmp_path / "closed.mcap"
    scene.write_text(CIRCUIT if steps == 20 else f"duration_s = 270.0\n{CIRCUIT}")
    assert fly(scene, "-o", log, "--pilot", pilot, "--estimator", pilot) == 0
    with FlightReader(log) as reader:
        heights, reference = by_step(reader)[:steps], heights_on_the_truth[:steps]
    figures = figures_of(log)["estimators"][pilot]
    # Gusts near the ground are those of the height above it: the airspeed that aids the filter gusts as well (1.5 deg).
    limit = {"ins21-chr": 1.2, "ckf-air-chr": 1.8}[pilot]
    assert figures["tilt_rmse_deg"] < limit
    assert figures["phases"]["turning"]["tilt_rmse_deg"] < limit
    assert figures["phases"]["turning"]["samples"] > (10000 if steps == 20 else 2500)
    assert heights.shape == reference.shape == (steps, 400)
    off = np.abs(heights - reference).max()
    assert 0.01 < off < 10.0, "the estimate's errors are flown"


@pytest.mark.long
def test_the_papers_filter_crashes_in_its_first_turn(tmp_path: Path) -> None:
    """Straight and level it flies on; in a turn it sees no bank, and the autopilot banks on and on."""
    log = tmp_path / "turn.mcap"
    done = run("fly", "closed_loop_turn", "--pilot", "ckf-chr", "--estimator", "ckf-chr", "-o", log, "--quiet")
    assert done.returncode == 1
    assert re.search(r"crash at .* in step 7 \(turn\)", done.stderr)
    with FlightReader(log) as reader:
        truth, estimate = reader.truth(), reader.estimates("ckf-chr")
        turn = next(e.t for e in reader.events() if e.text == "step 7 (turn) begins")
    at = {}
    for name, t, q_nb in (("flown", truth.t, truth.q_nb), ("estimated", estimate.t, estimate.q_nb)):
        at[name] = np.interp(turn + 1.7, t, np.degrees(attitude.euler(q_nb)[:, 0]))
    assert at["flown"] > 60.0
    assert at["estimated"] < 30.0, "the bank asked for is not reached, so it banks on"


@pytest.mark.long
def test_a_crash_ends_the_flight_with_an_event_and_a_whole_log(tmp_path: Path) -> None:
    """The unaided filter takes the acceleration of the take-off for a pitch of tens of degrees."""
    scene, log = tmp_path / "closed.toml", tmp_path / "closed.mcap"
    scene.write_text(CLOSED.format("none"))
    done = run("fly", scene, "-o", log, "--quiet")
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "crash" in done.stderr
    assert "closed.toml" in done.stderr
    with FlightReader(log) as reader:
        events = reader.events()
    assert events[-1].level == "error"
    assert "crash" in events[-1].text
    assert figures_of(log)["to_s"] > 60
