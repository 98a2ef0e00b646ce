"""Reproductions of the attitude papers: their tools, and quick runs of each."""

import json

import numpy as np
import pytest

from ahrs_sim import attitude, cli, papers
from ahrs_sim.papers import Claim, Outcome, Reproduction, bench, fuzzy, switched


def test_a_motion_is_measured_and_estimated_without_a_log():
    flown = bench.fly({"motion": {"kind": "constant"}, "duration_s": 25.0, "rate_hz": 100.0}, "still")
    measured = bench.measure(flown, {"grade": "ideal"}, 1)
    estimates = measured.estimate("marg-ekf", align_s=10.0)
    assert len(estimates) == len(measured.samples) == 2501
    error = measured.errors(estimates)
    assert np.isnan(error[0]).all() and np.abs(error[-1]).max() < 1e-3
    slow = bench.thinned(measured, 5)
    assert np.diff(slow.samples.t).mean() == pytest.approx(0.05)
    rest, turned = bench.turned(measured.create("marg-ekf", align_s=10.0), measured.samples, 30.0)
    assert len(rest) < len(measured.samples)
    headings = [attitude.euler(q[None])[0, 2] for q in (turned.state()["filter"]["x"][:4], flown.truth.q_nb[0])]
    assert np.degrees(headings[0] - headings[1]) == pytest.approx(30.0, abs=0.1)


def test_seeds_differ_and_repeat():
    flown = bench.fly({"motion": {"kind": "constant"}, "duration_s": 2.0, "rate_hz": 100.0}, "still")
    a, b, c = (bench.measure(flown, {"grade": "chr_6dm"}, seed).samples.gyro_b for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_times():
    t, error = np.arange(5.0) + 10.0, np.array([9.0, 1.0, 9.0, 2.0, 1.0])
    assert bench.time_until(t, error, 5.0) == 3.0 and bench.time_first(t, error, 5.0) == 1.0
    assert np.isnan(bench.time_until(t, error + 9.0, 5.0)) and np.isnan(bench.time_first(t, error + 9.0, 5.0))


def test_printed_noise_read_as_variances():
    """Paper 002: 10 deg/h, 10 ug and 1e-13 T as (rad/s)^2, (m/s2)^2 and T^2 of a sample at 100 Hz."""
    flown = bench.fly({"motion": {"kind": "constant"}, "duration_s": 100.0, "rate_hz": 100.0}, "still")
    noisy, mean = bench.measure(flown, fuzzy._VARIANCES, 1).samples, flown.truth
    assert np.degrees((noisy.gyro_b - mean.rate_ib_b).std()) == pytest.approx(0.399, rel=0.02)
    assert (noisy.accel_b - mean.accel_b).std() / 9.80665 == pytest.approx(1.01e-3, rel=0.02)
    assert noisy.mag_b.std(axis=0).mean() == pytest.approx(0.316e-6, rel=0.03)


def test_the_stepped_regime_covers_every_minute():
    faults = fuzzy.regime("stepped")
    assert [f["variance_factor"] for f in faults[::2]] == [5.0, 10.0, 20.0]
    assert fuzzy.regime("constant") == []


def test_the_page_and_the_command(monkeypatch, capsys, tmp_path):
    made = Reproduction("fuzzy", "title", "source", "conditions", [Claim("a", 1.0, 1.0, "", Outcome.REPRODUCED)])
    monkeypatch.setattr(papers, "run_all", lambda chosen, quick, workers: iter([made]))
    page = tmp_path / "papers.md"
    assert cli.main(["papers", "fuzzy", "--markdown", str(page)]) == 0
    assert "fuzzy: title" in capsys.readouterr().out
    assert page.read_text().startswith("# The papers, reproduced") and page.read_text().count("\n## ") == 1
    kept = "\n\n## emitter\n\n```text\nas it was\n```\n"
    page.write_text(page.read_text().replace("title. source.", "before").rstrip() + kept)
    assert cli.main(["papers", "fuzzy", "--markdown", str(page)]) == 0
    assert page.read_text().endswith(kept) and page.read_text().count("\n## ") == 2
    assert "title. source." in page.read_text() and "before" not in page.read_text()
    capsys.readouterr()
    assert cli.main(["papers", "fuzzy", "--quick", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["claims"][0]["outcome"] == "reproduced"
    assert cli.main(["papers", "fuzy"]) == 2
    assert "did you mean 'fuzzy'" in capsys.readouterr().err


def test_the_bias_is_compared_with_what_the_gyro_has():
    flown = bench.fly({"motion": {"kind": "constant"}, "duration_s": 25.0, "rate_hz": 100.0}, "still")
    measured = bench.measure(flown, {"grade": "ideal"}, 1, switched._FAULTS)
    assert switched.true_bias(measured, measured.samples.t[500:]) == pytest.approx(switched.BIAS, abs=1e-6)
    low_cost = bench.measure(flown, {"grade": "chr_6dm"}, 1, switched._FAULTS)
    assert np.abs(switched.true_bias(low_cost, low_cost.samples.t[500:]) - switched.BIAS).max() > 1e-3


def test_what_is_taken_from_the_accelerometer():
    flown = bench.fly({"motion": {"kind": "road", "still_s": 5.0}, "duration_s": 60.0, "rate_hz": 100.0}, "laps")
    drive = bench.measure(flown, {"grade": "ideal"}, 1)
    off = [np.abs(np.linalg.norm(d.samples.accel_b, axis=1) / 9.8 - 1.0) for d in (drive, switched.plumb(drive))]
    assert off[0].max() > 0.02 and off[1].max() < 0.01
    norms = [np.linalg.norm(d.samples.accel_b, axis=1) for d in (drive, switched.interrupted(drive))]
    ratio = norms[1] / norms[0]
    assert set(ratio.round(6)) == {1.0, 1.1}
    driving = drive.samples.t > switched.STILL
    assert not (ratio[~driving] > 1.05).any()
    assert np.mean(ratio[driving] > 1.05) == pytest.approx(12.5 / 23.0, abs=0.15)


@pytest.mark.long
@pytest.mark.parametrize("name", ["cubature", "adaptive_ins", "fuzzy", "switched"])
def test_quick_reproduction(name):
    result = papers.run(name, quick=True)
    json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert len(result.claims) > 5
    for claim in result.claims:
        assert claim.outcome in (Outcome.REPRODUCED, Outcome.OWN) or claim.reason, claim.what
    if name == "fuzzy":
        found = {c.what: c for c in result.claims if c.what.startswith("As variances, (")}
        assert found["As variances, (i) constant noise, adaptive: heading, at most"].outcome == Outcome.REPRODUCED
        assert found["As variances, (ii) variance x20, adaptive: heading, at most"].outcome == Outcome.REPRODUCED
        thousand = [c for what, c in found.items() if "(iii)" in what]
        assert [c.outcome for c in thousand] == [Outcome.REPRODUCED]
    if name == "cubature":
        shaken = [str(c.ours) for c in result.claims if c.what.startswith("R from the ground")]
        tilt = [float(text.split("/")[0]) for text in shaken]
        assert tilt[0] > 2.0 * max(tilt[1:]), "with the engine's vibration in R the error is another"
    if name == "switched":
        implied = {c.what: c for c in result.claims if c.what.startswith("5 +- 0.8 m/s, SEKF")}
        assert (
            implied["5 +- 0.8 m/s, SEKF: largest error"].outcome != Outcome.NOT
        )  # the reason for a bias that is not learned
        left = {c.what.partition("RMS: ")[2]: float(str(c.ours).split()[0]) for c in result.claims}
        assert max(left["standing"], left["standing, refused as long as in the bends"]) < 0.02
        assert min(left["steady speed"], left["steady speed, gravity alone, never switched"]) > 0.03
        assert left["the same, correction over 2.4 s instead of 24 s"] < 0.02
