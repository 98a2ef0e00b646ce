"""Error budgets: a planted error comes out on top, every figure of a grade has its place, bad input is one line."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import cli
from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError
from ahrs_sim.runs import budget
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.suite import SECTIONS

# Figures that say how a sensor works and not how wrong it is, and instruments that no attitude comes from.
KEPT: dict[str, tuple[str, ...]] = {
    "imu": ("rate", "warm_up", "warm_up_time", "lost"),
    "gyro": ("range", "bandwidth", "antialias"),
    "accelerometer": ("range", "bandwidth", "antialias"),
    "motor": ("reference", "harmonics", "idle"),
    "magnetometer": ("rate", "range", "bandwidth", "antialias"),
    "gnss": ("rate", "fix_type", "wander_time", "start_up_time", "antenna", "mask", "shadow", "reacquisition"),
    "heading": ("rate", "baseline", "baseline_yaw", "wander_time", "wrong_fix_time", "reacquisition"),
    "air_data": ("rate", "diff_range", "wander_time", "vanes"),
    "interferometer": (
        "rate", "latency", "frequency", "baseline", "phase_noise", "rate_noise", "bearing_noise", "emitter_north",
        "emitter_east",
    ),
}  # fmt: skip


def short(tmp_path: Path, planted: str = "", seconds: float = 45.0) -> scenarios.Scenario:
    """Bank to and fro with an IMU, a magnetometer and a pitot tube."""
    path = tmp_path / "flight.toml"
    path.write_text(
        f"""extends = "figure_eights"
duration_s = {seconds}
[suite.chr]
grade = "chr_6dm"
instruments = ["imu", "magnetometer", "air_data"]
{planted}
[estimator.mine]
method = "marg-ekf"
suite = "chr"
aiding = "airspeed"
"""
    )
    return scenarios.load(str(path))


@pytest.mark.parametrize(
    ("planted", "name", "measure"),
    [
        ("magnetometer.turn_on_bias_mgauss = 50.0", "hard iron", 1),
        ("gyro.turn_on_bias_dps = 0.0\ngyro.scale_percent = 30.0", "gyro scale", 1),
    ],
)
@pytest.mark.long
def test_a_planted_error_comes_out_on_top(tmp_path, planted, name, measure):
    made = budget.make(short(tmp_path, planted), "mine")
    first, second = made.lines[:2]
    assert first.name == name
    assert first.share > 0.5
    assert first.share > 3 * second.share
    others = [line.alone[measure] for line in made.lines[1:]]
    assert first.alone[measure] > 2 * max(others)
    assert first.without[measure] < 0.6 * made.total.alone[measure]
    assert made.floor.alone[measure] < 0.3 * made.total.alone[measure]
    names = [line.name for line in made.lines]
    assert ("gyro turn-on bias" in names) == (name == "hard iron"), "a figure of zero is no error"
    assert "GNSS velocity" not in names, "the suite has no receiver"
    assert name in made.text().splitlines()[5]
    assert made.as_json()["terms"][0]["alone_heading_rmse_deg"] == pytest.approx(math.degrees(first.alone[1]))


@pytest.mark.long
def test_several_seeds_are_one_sum(tmp_path):
    flight = short(tmp_path, seconds=12.0)
    one, two = (
        budget.make(dataclasses.replace(flight, seed=s, data={**flight.data, "seed": s}), "mine") for s in (4, 5)
    )
    both = budget.make(dataclasses.replace(flight, seed=4, data={**flight.data, "seed": 4}), "mine", seeds=2, workers=1)
    expected = np.sqrt((np.square(one.total.alone) + np.square(two.total.alone)) / 2)
    np.testing.assert_allclose(both.total.alone, expected, rtol=1e-3)  # rows differ by a sample or two
    assert both.seeds == (4, 5)


def test_every_figure_is_an_error_or_kept():
    errors = {section: set(KEPT.get(section, ())) for section in SECTIONS}
    for name, figures in budget.TERMS.items():
        for section, fields in figures.items():
            assert not errors[section] & set(fields), f"{name}: counted twice"
            errors[section] |= set(fields)
    assert errors == {s: {f.name for f in dataclasses.fields(section.figures)} for s, section in SECTIONS.items()}


def test_all_errors_off_leaves_none(tmp_path):
    flight = short(tmp_path, "gyro.noise_density_dph_rthz = 300.0\nmounting_error_deg = [0.0, 0.3, 0.0]")
    (carried,) = (s for s in flight.suites if s.name == "chr")
    fit = {"seed": 1, "dt": 0.0025, "epoch": flight.epoch, "start_lla": np.zeros(3)}
    whole = make_suite(carried, **fit)
    assert budget._stated(carried, whole, "gyro noise") == "noise_density_dph_rthz 300"
    bare = budget._switched_off(carried, list(budget.TERMS), whole.grade)
    layer = make_suite(bare, **fit).grade.layer
    for figures in budget.TERMS.values():
        for section, fields in figures.items():
            assert not any(np.any(layer[section][f].value) for f in fields if f in layer.get(section, {}))
    assert bare.settings["mounting_error_deg"] == [0.0, 0.0, 0.0]
    assert make_suite(carried, **fit).grade.layer["gyro"]["noise_density"].value == 300.0, "the scenario is untouched"


def test_bad_input_is_one_line(tmp_path, capsys):
    flight = short(tmp_path)
    with pytest.raises(InputError, match="no such estimator"):
        budget.make(flight, "mien")
    with pytest.raises(InputError, match="no such suite"):
        budget.make(flight, "mine", suite="sgb")
    with pytest.raises(InputError, match="another --from"):
        budget.make(short(tmp_path, seconds=8.0), "mine", start=100.0)
    assert cli.main(["budget", "turns", "--estimator", "marg-ekf"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_command_prints_and_draws(tmp_path, capsys):
    short(tmp_path, seconds=12.0)
    picture = tmp_path / "budget.png"
    assert cli.main(["budget", str(tmp_path / "flight.toml"), "--estimator", "mine", "--png", str(picture)]) == 0
    assert "hard iron" in capsys.readouterr().out
    assert picture.read_bytes().startswith(b"\x89PNG")
