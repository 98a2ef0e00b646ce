"""Certification sheets: what is shown with how many flights, and that a defect turns a row red."""

import json
import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from ahrs_sim.cli import main
from ahrs_sim.errors import InputError
from ahrs_sim.runs import certify, certify_sheet
from ahrs_sim.runs import pool as pools
from ahrs_sim.runs.pool import Span
from ahrs_sim.scenario import Gate

pytestmark = pytest.mark.usefixtures("pool_here")

LIMITS = """
title = "Motion table"
quantile = 0.5
confidence = 0.5
[flight.table]
duration_s = 70.0
motion = {kind = "sway", still_s = 35.0, roll_amplitude_deg = 20.0, roll_period_s = 4.0}
[row.still]
title = "at rest"
flight = "table"
times_s = [25.0, 35.0]
[row.sway]
title = "swaying"
flight = "table"
times_s = [30.0, 70.0]
skip_s = 5.0
[[requirement]]
rows = ["still", "sway"]
limit = {roll_p95_deg = 1.0, pitch_p95_deg = 1.0}
source = "test"
own = true
"""

WRONG = """
from dataclasses import replace
import estimators

class Mirrored:
    def __init__(self, site, sensors):
        self.inner = estimators.create("marg-ekf", site=site, sensors=sensors)
    def process(self, samples):
        return self.inner.process(replace(samples, gyro_b=-samples.gyro_b))
"""


@pytest.fixture
def limits(tmp_path: Path) -> Path:
    """A standard whose flights take a tenth of a second."""
    path = tmp_path / "limits.toml"
    path.write_text(LIMITS)
    return path


# ----------------------------------------------------------------------------------------------- what is shown


def test_fifty_nine_flights_are_the_least_that_bound_the_95_percent_quantile() -> None:
    values = np.arange(59.0)
    assert certify.bounds(values, 0.95, 0.95)[1] == 58.0
    assert certify.bounds(values[:58], 0.95, 0.95)[1] == math.inf
    assert certify.load().runs == 59
    assert certify.bounds(np.arange(93.0), 0.95, 0.95)[1] == 91.0  # Wilks: from 93 on the second largest will do
    assert certify.bounds(np.arange(92.0), 0.95, 0.95)[1] == 91.0


def test_one_flight_beyond_a_limit_shows_that_it_is_not_met() -> None:
    assert certify.bounds(np.array([3.0]), 0.95, 0.95) == (3.0, math.inf)
    low, high = certify.bounds(np.array([1.0, 2.0, 9.0]), 0.95, 0.95)
    assert (low, high) == (2.0, math.inf)  # one of three may well lie beyond the quantile
    assert certify.bounds(np.empty(0), 0.95, 0.95) == (-math.inf, math.inf)


@pytest.mark.parametrize(("n", "quantile", "confidence"), [(59, 0.95, 0.95), (120, 0.95, 0.95), (5, 0.5, 0.95)])
def test_bounds_hold_as_often_as_they_say(n: int, quantile: float, confidence: float) -> None:
    rng = np.random.default_rng(3)
    found = np.array([certify.bounds(rng.random(n), quantile, confidence) for _ in range(3000)])
    allowance = 3.0 * math.sqrt(confidence * (1.0 - confidence) / 3000)
    assert np.mean(found[:, 1] >= quantile) >= confidence - allowance
    assert np.mean(found[:, 0] <= quantile) >= confidence - allowance


def test_a_flight_without_attitude_exceeds_every_limit() -> None:
    row = {"r.roll_p95_deg": 0.5, "r.availability": 1.0}
    assert certify._value(row, "r", "roll_p95_deg") == 0.5
    assert certify._value({**row, "r.availability": 0.98}, "r", "roll_p95_deg") == math.inf
    assert certify._value({**row, "r.roll_p95_deg": math.nan}, "r", "roll_p95_deg") == math.inf
    assert certify._value({}, "r", "roll_p95_deg") == math.inf


def test_spans_follow_the_steps_of_the_flight() -> None:
    begins = {1: 0.0, 2: 40.0, 3: 62.5, 4: 90.0}
    assert Span("a", steps=(2, 3)).within(begins) == (40.0, 90.0)
    assert Span("a", steps=(3, 4), skip=5.0).within(begins) == (67.5, math.inf)
    assert Span("a", times=(10.0, 20.0), skip=2.0).within(begins) == (12.0, 20.0)
    assert Span("a", steps=(5, 6)).within(begins)[0] == math.inf  # not reached


# ----------------------------------------------------------------------------------------------- reading


def test_the_shipped_standard_is_whole() -> None:
    standard = certify.load()
    assert {r.row.flight for r in standard.requirements} == set(standard.flights)
    assert len({r.row.name for r in standard.requirements}) >= 20
    assert all(r.source for r in standard.requirements)
    chosen = certify.candidates(standard, ["marg-ckf-air@bmi088 + rm3100", "ins21@sbg"])
    assert list(chosen) == ["marg-ckf-air-bmi088-rm3100", "ins21-sbg"]
    plans = certify.plans(standard, chosen, 1, Gate())
    scenario = plans["vibration"].run(0).scenario()
    assert [s.name for s in scenario.suites] == ["bmi088-rm3100", "sbg"]
    assert all(s.settings["motor"]["idle_percent"] == 15.0 for s in scenario.suites)
    assert scenario.estimators[0].settings["aiding"] == "airspeed"


def _edit(change: tuple[str, str]) -> str:
    assert change[0] in LIMITS
    return LIMITS.replace(*change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("roll_p95_deg", "roll_p96_deg"), r"\[limit\]: roll_p96_deg: no such figure; did you mean 'roll_p95_deg'"),
        (("roll_p95_deg = 1.0", "roll_p95_deg = -1"), r"roll_p95_deg: -1 is out of range"),
        (('"still", "sway"', '"stil"'), r"rows: 'stil' is unknown; did you mean 'still'"),
        (('title = "at rest"\nflight = "table"', 'title = "x"\nflight = "tabel"'), r"flight: 'tabel' is unknown"),
        (("times_s = [25.0, 35.0]", ""), r"\[row.still\]: steps: give either steps"),
        (("times_s = [25.0, 35.0]", "times_s = [35.0, 25.0]"), r"times_s: \[35, 25\] does not go forwards"),
        (("times_s = [25.0, 35.0]", "steps = [1, 2]"), r"steps: \[1, 2\]: the steps of flight 'table' are 1 to 0"),
        (('source = "test"', ""), r"source: missing"),
        (("own = true", "ours = true"), r"ours: unknown key"),
        (("quantile", "quantil"), r"quantil: unknown key; did you mean 'quantile'"),
        (("limit = {roll_p95_deg = 1.0, pitch_p95_deg = 1.0}", "limit = {}"), r"limit: missing"),
    ],
)
def test_bad_limits_get_one_line(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(_edit(change))
    with pytest.raises(InputError, match=message) as caught:
        certify.load(str(path))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_bad_estimators_get_one_line(limits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, message in (
        ("marg-ekff@chr", "no estimator 'marg-ekff'"),
        ("marg-ekf@bmi08", "'bmi08' is unknown; did you mean 'bmi088'"),
    ):
        assert main(["certify", name, "--limits", str(limits), "--runs", "1", "-o", str(tmp_path / name)]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    assert main(["certify", "marg-ekf", "marg-ekf@chr", "--limits", str(limits)]) == 2
    assert "given twice" in capsys.readouterr().err


# ----------------------------------------------------------------------------------------------- flying


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(["certify", *arguments, "--runs", "1", "--workers", "1"])
    return code, capsys.readouterr().out


def test_a_planted_sign_error_turns_a_row_red(limits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text(WRONG)
    code, out = run(
        capsys, "marg-ekf@chr", f"{wrong}:Mirrored@chr", "--limits", str(limits), "-o", str(tmp_path / "o"), "--json"
    )
    assert code == 1
    right, mirrored = json.loads(out)["sheets"]
    assert right["passed"]
    results = {(row["row"], row["figure"]): row["result"] for row in mirrored["rows"]}
    assert results["still", "roll_p95_deg"] == "met"  # at rest a sign is nothing
    assert results["sway", "roll_p95_deg"] == "not met"


def test_outputs_agree_and_a_second_run_flies_nothing(
    limits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place, page, xml = tmp_path / "o", tmp_path / "sheet.html", tmp_path / "sheet.xml"
    where = ("marg-ekf@chr", "--limits", str(limits), "-o", str(place))
    code, text = run(capsys, *where)
    assert code == 0
    assert "marg-ekf-chr: passed: 4 met, 0 not met" in text
    files = {f: f.stat().st_mtime_ns for f in place.rglob("*.parquet")}
    assert files
    code, out = run(capsys, *where, "--json", "--html", str(page), "--junit", str(xml))
    assert code == 0
    assert {f: f.stat().st_mtime_ns for f in place.rglob("*.parquet")} == files
    rows = json.loads(out)["sheets"][0]["rows"]
    for row in rows:
        assert f"{row['found']:.2f}" in text
        assert row["found"] <= row["bound"] <= row["limit"]
        span = [25.0, 35.0] if row["row"] == "still" else [35.0, 70.0]
        assert span[0] <= row["worst_s"] <= span[1]
    suite = ElementTree.parse(xml).getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("4", "0")
    assert float(suite.get("time", "0")) > 0.0
    links = re.findall(r'href="([^"#]+)#t=([\d.]+)"', page.read_text())
    assert len(links) == 4
    for target, moment in links:
        assert (tmp_path / target).is_file()
        assert any(abs(float(moment) - row["worst_s"]) < 0.06 for row in rows)
    assert not list(tmp_path.rglob("*.mcap"))
    code, out = run(capsys, *where, "--markdown")
    assert "| at rest |" in out


def test_few_flights_show_nothing_met(limits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strict = tmp_path / "strict.toml"
    strict.write_text(LIMITS.replace("= 0.5\n", "= 0.95\n"))
    code, text = run(capsys, "marg-ekf@chr", "--limits", str(strict), "-o", str(tmp_path / "o"))
    assert code == 1
    assert "0 met, 0 not met, 4 not shown; 59 flights are the least" in text


def test_junit_names_flight_run_and_seed_of_a_failed_flight() -> None:
    errors = {"ordinary, run 3 (seed 4)": "estimator 'mine' ValueError: no (mine.py, line 7)"}
    sheets = [certify.Sheet(name, "marg-ekf", "chr_6dm", 59, (), errors) for name in ("mine", "other")]
    suite = ElementTree.fromstring(certify_sheet.junit(sheets, 6.0))
    cases = [(c.get("classname"), c.get("name"), c.get("time")) for c in suite.iter("testcase")]
    assert cases == [(name, "ordinary, run 3 (seed 4)", "3.000") for name in ("mine", "other")]
    assert {f.get("message") for f in suite.iter("failure")} == set(errors.values())


# ----------------------------------------------------------------------------------------------- the shipped flights


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, certify.Sheet]:
    """Three estimators on one flight of each kind, the median required instead of the 95 % quantile."""
    folder = tmp_path_factory.mktemp("certify")
    sampled = folder / "sampled.toml"
    shipped = Path(certify.__file__).with_name(certify.SHIPPED).read_text(encoding="utf-8")
    sampled.write_text(re.sub(r"(?m)^(quantile|confidence) = 0.95", r"\1 = 0.5", shipped))
    standard = certify.load(str(sampled))
    assert standard.runs == 1
    chosen = certify.candidates(standard, ["marg-ckf@chr", "ins21@sbg", "ins21-exact@ideal"])
    plans = certify.plans(standard, chosen, 1, Gate())
    with pools.local_pool(1) as pool:
        stores = certify.fly(plans, str(folder / "flights"), pool)
    return {s.estimator: s for s in certify.evaluate(standard, chosen, stores, 1)}


def _not_met(sheet: certify.Sheet) -> set[str]:
    assert not sheet.errors
    assert {f.result for f in sheet.findings} <= {certify.MET, certify.NOT_MET}
    return {f.requirement.row.name for f in sheet.findings if f.result == certify.NOT_MET}


@pytest.mark.long
@pytest.mark.parametrize("name", ["ins21-exact-ideal", "ins21-sbg"])
def test_a_navigator_meets_all_rows(name: str, sheets: dict[str, certify.Sheet]) -> None:
    assert not _not_met(sheets[name])


@pytest.mark.long
def test_an_unaided_filter_fails_in_turns(sheets: dict[str, certify.Sheet]) -> None:
    failed = _not_met(sheets["marg-ckf-chr"])
    assert {"standard_turn", "steep_turn", "shallow_bank", "long_steep_bank"} <= failed
    assert "static" not in failed
