"""The page of a report: what it holds comes back, fits its budget and asks nobody for anything."""

import base64
import dataclasses
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ahrs_sim import attitude, cli
from ahrs_sim.errors import InputError
from ahrs_sim.flight.truth import Event
from ahrs_sim.review import colors, compare, report
from ahrs_sim.review.traces import FlightTraces, finding, gather


def parts(page: str) -> tuple[dict[str, Any], bytes]:
    """Data and unpacked series of a page, as its program reads them."""
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    packed = re.search(r'<script type="text/plain" id="series">(.*?)</script>', page, re.DOTALL)
    assert data and packed
    return json.loads(data[1]), zlib.decompress(base64.b64decode(packed[1]))


def series(ref: dict[str, Any], packed: bytes) -> np.ndarray:
    """The values of a series, decoded step by step."""
    n = ref["n"]
    planes = np.frombuffer(packed, np.uint8, ref["planes"] * n, ref["at"]).reshape(-1, n).astype(np.int64)
    zigzag = sum(plane << (8 * i) for i, plane in enumerate(planes))
    coded = np.where(zigzag & 1, -((zigzag + 1) >> 1), zigzag >> 1)
    for _ in range(ref["order"]):
        coded = np.cumsum(coded)
    values = coded * ref["step"]
    for a, b in zip(ref["gaps"][::2], ref["gaps"][1::2], strict=True):
        values[a:b] = np.nan
    return np.asarray(values)


@pytest.fixture(scope="module")
def page(traces: FlightTraces) -> str:
    return report.page([traces])


def test_packing_keeps_values_and_gaps() -> None:
    rng = np.random.default_rng(1)
    smooth, noise = np.cumsum(np.cumsum(rng.normal(size=5000))) * 1e-3, rng.normal(size=700) * 50
    noise[[0, 1, 300, 699]] = np.nan
    packer = report._Packer()
    refs = [packer.add(values, 0.0, 0.01, 0.01) for values in (smooth, noise)]
    assert packer.add(np.full(5, np.nan), 0.0, 1.0, 1.0) is None
    packed = zlib.decompress(base64.b64decode(packer.packed()))
    for ref, values in zip(refs, (smooth, noise), strict=True):
        assert ref is not None
        assert series(ref, packed) == pytest.approx(values, abs=0.0051, nan_ok=True)


def test_a_coarser_grid_keeps_peaks() -> None:
    t = np.arange(0, 10, 0.01)
    values = np.zeros(len(t))
    values[[333, 667]] = 7.0, -9.0
    grid = report._gridded(t, values, 0.0, 0.1, 100)
    assert grid.max() == 7 and grid.min() == -9
    assert np.isnan(report._gridded(t[t < 5], values[t < 5], 0.0, 0.1, 100)[60:]).all()


def test_page_has_the_errors_of_the_log(page: str, traces: FlightTraces) -> None:
    data, packed = parts(page)
    (run,) = data["runs"]
    assert [e["name"] for e in run["estimators"]] == ["ekf-chr", "ekf-sbg"]
    for shown in run["estimators"]:
        trace = traces.estimators[shown["name"]]
        for k in range(4):  # roll, pitch, heading, tilt
            ref = shown["error"][k]
            values = series(ref, packed)
            at = np.rint((trace.t - ref["t0"]) / ref["dt"]).astype(int)
            known = np.isfinite(trace.error[:, k]) & (at < len(values))
            assert values[at[known]] == pytest.approx(np.degrees(trace.error[known, k]), abs=0.006)


def test_innovations_have_the_names_that_the_log_keeps(page: str) -> None:
    data, _ = parts(page)
    for shown in data["runs"][0]["estimators"]:
        names = shown["innovation_names"]
        assert names[:4] == ["accel_b.x", "accel_b.y", "accel_b.z", "mag_b.x"]
        drawn = [name for name, ref in zip(names, shown["innovation_low"], strict=True) if ref]
        assert len(drawn) >= 6
        assert "-" not in drawn


def test_page_agrees_with_compare(page: str, flown: Path) -> None:
    data, _ = parts(page)
    wanted = compare.compare(flown)["estimators"]
    for shown in data["runs"][0]["estimators"]:
        for key in ("tilt_rmse_deg", "heading_p95_deg", "roll_max_deg"):
            assert shown["summary"][key] == pytest.approx(wanted[shown["name"]][key], rel=1e-4)
        phases = wanted[shown["name"]]["phases"]
        assert shown["summary"]["phases"].keys() == phases.keys()
        for phase, values in shown["summary"]["phases"].items():
            assert values["tilt_rmse_deg"] == pytest.approx(phases[phase]["tilt_rmse_deg"], rel=0.02)


def test_page_is_complete_in_itself(page: str) -> None:
    assert not re.search(r"@[A-Z_]+@", page)
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)
    assert "The MIT License" in page
    assert re.findall(r"https?://[^\s\"']+", page.split('id="series"')[0]) == []
    data, _ = parts(page)
    assert data["runs"][0]["provenance"]["flight"]["seed"] == "1"
    assert "trainer" in data["runs"][0]["attachments"]["scenario.toml"]


def test_ten_estimators_for_ten_minutes_fit(traces: FlightTraces) -> None:
    rng = np.random.default_rng(3)
    n = 60_000
    t = np.arange(n) * 0.01
    model = next(iter(traces.estimators.values()))
    coarse = {
        f.name: np.resize(getattr(model, f.name), (6000, *getattr(model, f.name).shape[1:]))
        for f in dataclasses.fields(model)
        if f.name not in ("name", "suite", "t", "error") and len(getattr(model, f.name)) > 500
    } | {"coarse_t": np.arange(6000) * 0.1}
    many = {}
    for i in range(10):
        error = np.cumsum(rng.normal(size=(n, 5)), axis=0) * 2e-4 + rng.normal(size=(n, 5)) * 2e-4
        many[f"e{i}"] = dataclasses.replace(model, name=f"e{i}", t=t, error=error.astype(np.float32), **coarse)
    rows = np.arange(n) % len(traces.t)
    flight = dataclasses.replace(
        traces, t=t, q_nb=traces.q_nb[rows], truth_t=t, position=traces.position[rows], speed=traces.speed[rows],
        phase=traces.phase[rows], estimators=many,
    )  # fmt: skip
    assert len(report.page([flight]).encode()) < 3_000_000


@pytest.mark.parametrize("least", [1, 178])  # deg; angles beyond 180 go on at -180
def test_flights_of_a_campaign_become_bands(traces: FlightTraces, least: int) -> None:
    flights = []
    for k in range(5):
        error = attitude.wrap(np.radians(least + k))
        shifted = {n: dataclasses.replace(e, error=np.full_like(e.error, error)) for n, e in traces.estimators.items()}
        flights.append(dataclasses.replace(traces, estimators=shifted))
    data, packed = parts(report.page(flights))
    (run,) = data["runs"]
    assert run["kind"] == "campaign" and len(run["flights"]) == 5
    shown = run["estimators"][0]
    low, middle, high = (series(shown[key][0], packed) for key in ("low", "error", "high"))
    known = np.isfinite(low)
    assert (high - low)[known] == pytest.approx(4, abs=0.05)
    assert (middle - low)[known] == pytest.approx(2, abs=0.05)
    assert len(parts(report.page(flights[:3]))[0]["runs"]) == 3


def test_worst_window_and_finding(traces: FlightTraces) -> None:
    trace = traces.estimators["ekf-sbg"]
    error = np.full_like(trace.error, 1e-4)
    error[(trace.t > 70) & (trace.t < 80)] = 0.2
    wrong = dataclasses.replace(trace, error=error)
    worst = wrong.worst(traces)
    assert worst is not None
    assert worst.start == pytest.approx(70, abs=0.2)
    assert wrong.lost() == pytest.approx(70, abs=0.3)
    assert "11 deg wrong" in finding(traces, wrong)
    assert "first exceeded 5 deg and its own 3 sigma" in finding(traces, wrong)


def test_every_dash_has_a_reason(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compare", str(flown), "--to", "5"]) == 0
    assert "no attitude in these 5 s: ekf-chr, ekf-sbg; aligning takes" in capsys.readouterr().out
    result = compare.compare(flown)
    assert "no " not in compare.table(result)
    result["estimators"]["ekf-chr"] |= {"nees": None}
    result["estimators"]["ekf-sbg"] |= {"heading_rmse_deg": None}
    text = compare.table(result)
    assert "no NEES, because no covariance is reported (att_cov): ekf-chr" in text
    assert "no heading in the estimates, or none in what they are compared with: ekf-sbg" in text


def test_compare_against_an_estimator_of_the_log(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = compare.compare(flown, against="ekf-sbg")
    rows, difference = result["estimators"], result["paired"]["estimators"]["ekf-chr"]["tilt_rmse_deg"]
    expected = rows["ekf-chr"]["tilt_rmse_deg"] - rows["ekf-sbg"]["tilt_rmse_deg"]
    assert difference["change"] == pytest.approx(expected, abs=0.01)  # some seconds have one of the two only
    assert difference["low"] <= difference["change"] <= difference["high"]
    assert cli.main(["compare", str(flown), "--against", "ekf-sbg", "--all"]) == 0
    assert "less that of ekf-sbg on the same seconds" in capsys.readouterr().out
    assert cli.main(["compare", str(flown), str(flown), "--against", "ekf-sbg"]) == 0
    assert "over 2 logs" in capsys.readouterr().out
    assert cli.main(["compare", str(flown), "--against", "ekf-sgb"]) == 2
    assert "did you mean 'ekf-sbg'" in capsys.readouterr().err


def test_span_and_reference(flown: Path) -> None:
    part = gather(flown, reference="ekf-sbg", start=40.0, end=60.0)
    assert part.t[0] >= 40 and part.t[-1] <= 60
    assert np.nanmax(np.abs(part.estimators["ekf-sbg"].error)) < 1e-6
    with pytest.raises(InputError, match="--reference"):
        gather(flown, reference="nobody")
    with pytest.raises(InputError, match="--from/--to"):
        gather(flown, start=500.0)


def test_command_writes_page_and_figures(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    output = tmp_path / "out.html"
    assert cli.main(["compare", str(flown), "--report", str(output), "--png", str(tmp_path / "png")]) == 0
    assert output.stat().st_size > 100_000
    names = {p.name for p in (tmp_path / "png").iterdir()}
    assert names == {f"{flown.stem}-{n}.png" for n in ("attitude", "errors", "consistency", "worst", "track", "biases")}
    assert cli.main(["compare", str(flown), "--report", str(tmp_path / "no" / "out.html")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_what_a_log_says_stays_text(traces: FlightTraces) -> None:
    bad = "<!--<script>@SERIES@</script>@PROGRAM@\u2028"
    hostile = dataclasses.replace(traces, metadata={**traces.metadata, "flight": {"scenario": bad}, bad: {bad: bad}})
    page = report.page([hostile])
    data, _ = parts(page)
    assert data["title"] == bad
    assert data["runs"][0]["provenance"][bad] == {bad: bad}
    assert page.count("<script") == 4
    assert "<!--" not in page


def test_a_policy_allows_the_page_itself_and_nothing_else(page: str) -> None:
    import hashlib

    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    assert policy
    rules = dict(rule.strip().split(" ", 1) for rule in policy[1].split(";"))
    assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == "'none'"
    for rule, element in (("script-src", "script"), ("style-src", "style")):
        found = re.findall(f"<{element}>(.*?)</{element}>", page, re.DOTALL)
        digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in found]
        assert rules[rule].split() == [f"'sha256-{d}'" for d in digests]
        assert len(digests) == 2
    assert not re.search(r"\s(on\w+|style)=", page.partition("<body>")[2].partition("<script")[0])


def test_colours_are_distinct_for_a_whole_catalogue() -> None:
    for ground in (0, 1):
        assert len({colors.pair(i)[ground] for i in range(60)}) == 60


def test_a_finding_names_no_fault_of_another_suite(traces: FlightTraces) -> None:
    trace = traces.estimators["ekf-chr"]
    worst = trace.worst(traces)
    assert worst is not None
    reported = [Event(worst.start, "warning", "fault", f"jamming of {suite}/gnss sets in") for suite in ("chr", "sbg")]
    assert "chr/gnss" in finding(dataclasses.replace(traces, events=reported), trace)


def test_a_finding_names_sigma_only_where_there_is_one(traces: FlightTraces) -> None:
    trace = traces.estimators["ekf-sbg"]
    error = trace.error.copy()
    error[trace.t > 60.0, 0] = 0.2
    silent = dataclasses.replace(trace, error=error, sigma=np.full_like(trace.sigma, np.nan))
    text = finding(traces, silent)
    assert "first exceeded 5 deg at" in text and "sigma" not in text
