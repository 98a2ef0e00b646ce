"""Grade files and overrides: what they must say, and one clear line when they do not."""

from importlib import resources

import numpy as np
import pytest
from sensor_helpers import suite

from ahrs_sim.errors import InputError
from ahrs_sim.sensors import grades
from ahrs_sim.sensors.grade import MARKS, Grade, load, names, parse
from ahrs_sim.sensors.suite import SECTIONS
from ahrs_sim.sensors.triad import GyroFigures, InertialFigures


def test_shipped_grades_are_whole() -> None:
    assert {"chr_6dm", "sbg_ig500", "road_mems", "ideal"} <= set(names())
    for name in names():
        rows = list(load(name, SECTIONS).rows())
        assert rows
        assert all(entry.source and entry.mark in MARKS for _, entry in rows)
    assert {row["grade"] for row in grades()} == set(names())


def test_what_was_not_read_is_not_quoted() -> None:
    """A part whose figures come from memory says so at its head, and marks them; the others have none."""
    folder = resources.files("ahrs_sim.sensors") / "grades"
    for name in names():
        text = (folder / f"{name}.toml").read_text(encoding="utf-8")
        remembered = text.count('mark = "remembered"')
        assert ("# Marked `remembered`:" in text) == (remembered > 0), name
        assert "as remembered" not in text, name


def test_the_two_units_of_the_paper_say_what_their_papers_show() -> None:
    """The IG-500's delays are in no public paper; the CHR-6dm's owner can calibrate it."""
    delays = {part: entry for part, entry in load("sbg_ig500", SECTIONS).rows() if entry.key == "delay_ms"}
    assert set(delays) == {"gyro", "accelerometer", "magnetometer"}
    assert all(entry.mark == "inferred" and "not verified" in entry.source for entry in delays.values())
    assert "calibrated on the bench" in load("chr_6dm", SECTIONS).title


def test_a_dozen_units_from_the_shop_state_what_matters() -> None:
    imus = [name for name in names() if "imu" in load(name, SECTIONS) and name not in ("chr_6dm", "road_mems", "ideal")]
    assert len(imus) >= 13
    for name in imus:
        for section in ("gyro", "accelerometer"):
            stated = load(name, SECTIONS).layer[section]
            assert {"noise_density", "bias_floor", "turn_on_bias", "scale", "misalignment"} <= set(stated)


def test_grades_of_parts_make_one_suite() -> None:
    made = suite("bmi088 + bench_calibration + rm3100 + zed_f9p + ms4525do")
    assert made.has == ("imu", "magnetometer", "gnss", "air_data")
    gyro = made.grade.figures("gyro", GyroFigures)
    np.testing.assert_allclose(gyro.noise_density, np.radians(0.014))
    np.testing.assert_allclose(gyro.turn_on_bias, np.radians(0.05))
    assert made.grade.calibration == "bench_calibration"
    assert load("stim300", SECTIONS).calibration is None
    alone = load("bmi088", SECTIONS)
    np.testing.assert_allclose(alone.figures("gyro", GyroFigures).turn_on_bias, np.radians(1.0))
    assert load(str(alone.calibration), SECTIONS).layer


def test_units_are_converted_and_vectors_broadcast() -> None:
    grade = load("chr_6dm", SECTIONS)
    gyro = grade.figures("gyro", GyroFigures)
    np.testing.assert_allclose(gyro.noise_density, np.radians([0.03] * 3))
    np.testing.assert_allclose(gyro.bias_floor, np.radians(80.0) / 3600.0)
    assert gyro.g_sensitivity == pytest.approx(np.radians(0.03) / 9.80665)
    accel = grade.figures("accelerometer", InertialFigures)
    np.testing.assert_allclose(accel.noise_density, np.array([0.15, 0.15, 0.30]) * 9.80665e-3)
    np.testing.assert_allclose(accel.vibration_rectification, 0.5e-3 / 9.80665)


def test_another_unit_of_the_same_figure_replaces_it() -> None:
    grade = load("chr_6dm", SECTIONS, {"gyro": {"noise_density_dph_rthz": 360.0}})
    assert grade.figures("gyro", GyroFigures).noise_density[0] == pytest.approx(np.radians(0.1))
    entry = {e.key: e for s, e in grade.rows() if s == "gyro"}["noise_density_dph_rthz"]
    assert (entry.source, entry.mark) == ("scenario", "chosen")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"grade": "chr_6dn"}, r"grade: 'chr_6dn' is unknown; did you mean 'chr_6dm'"),
        ({"grade": "rm3100"}, r'grade: rm3100 has no imu; put it together with one: "bmi088 \+ rm3100"'),
        ({"grade": "bmi088 + rm3110"}, r"grade: 'rm3110' is unknown; did you mean 'rm3100'"),
        ({"gyros": {"scale_percent": 1}}, r"gyros: unknown key; did you mean 'gyro'"),
        (
            {"gyro": {"noise_densty_dps_rthz": 1}},
            r"\[gyro\] noise_densty_dps_rthz: unknown key; did you mean 'noise_dens",
        ),
        ({"gyro": {"noise_density_mg_rthz": 1}}, r"\[gyro\] noise_density_mg_rthz: unknown key"),
        ({"gyro": {"range_dps": 1, "range_dph": 2}}, r"range_dph: stated already as range_dps"),
        ({"gyro": {"range_dps": "wide"}}, r"'wide' is neither a finite number"),
        ({"gyro": {"range_dps": [1, 2]}}, r"give one number or 3"),
        ({"gyro": {"quantum_dps": [1, 2, 3]}}, r"give one number"),
        ({"gyro": {"quantum_dps": -1}}, r"must be >= 0"),
        ({"gyro": 5}, r"gyro: is not a table"),
        ({"gyro": {"range_dps": {"valeu": 1}}}, r"unknown key 'valeu'; did you mean 'value'"),
        ({"rate_hz": 300.0}, r"\[imu\]: rate_hz = 300 does not divide"),
        ({"instruments": ["imu", "magnetometre"]}, r"no 'magnetometre'; did you mean 'magnetometer'"),
        ({"instruments": ["gnss"]}, r"needs its imu"),
        ({"position_m": [1, 2]}, r"position_m: \[1, 2\] is not a list of 3"),
        ({"rate": 5}, r"rate: unknown key"),
    ],
)
def test_bad_suite_tables_get_one_line(settings: dict, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        suite(settings.pop("grade", "chr_6dm"), **settings)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("test.toml: [suite.chr]")


def test_figures_of_a_grade_file_need_source_and_mark() -> None:
    with pytest.raises(InputError, match="needs a source and a mark"):
        parse({"gyro": {"range_dps": 5}}, SECTIONS, "x.toml")
    with pytest.raises(InputError, match="needs a source and a mark"):
        parse({"gyro": {"range_dps": {"value": 5, "source": "s", "mark": "guessed"}}}, SECTIONS, "x.toml")


def test_extends(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "grades"
    folder.mkdir()
    figure = '{value = %s, source = "s", mark = "quoted"}'
    (folder / "a.toml").write_text(f'title = "A"\n[gyro]\nrange_dps = {figure % 5}\nquantum_dps = {figure % 1}\n')
    (folder / "b.toml").write_text(f'title = "B"\nextends = "a"\n[gyro]\nrange_dps = {figure % 7}\n')
    (folder / "c.toml").write_text('title = "C"\nextends = "c"\n')
    monkeypatch.setattr("ahrs_sim.sensors.grade.resources.files", lambda _: tmp_path)
    grade: Grade = load("b", SECTIONS)
    assert grade.title == "B"
    np.testing.assert_allclose(grade.figures("gyro", GyroFigures).range, np.radians(7))
    assert grade.figures("gyro", GyroFigures).quantum == pytest.approx(np.radians(1))
    with pytest.raises(InputError, match="circle"):
        load("c", SECTIONS)


def test_specification_names_sources_and_what_was_drawn() -> None:
    s = suite("chr_6dm", gyro={"scale_percent": 2.0})
    flat = s.specification()
    assert flat["gyro.scale_percent"] == "2 (chosen: scenario)"
    assert flat["gyro.noise_density_dps_rthz"].startswith("0.03 (quoted: GP9")
    drawn = np.array([float(x) for x in flat["drawn.gyro.turn_on_bias"].split()])
    assert np.array_equal(drawn, s.drawn()["gyro.turn_on_bias"])
    assert s.info.gyro_noise == pytest.approx(np.radians(0.03))
    assert s.info.antenna_b == (-0.3, 0.0, -0.1)
    assert suite("sbg_ig500").info.accel_delay == pytest.approx(0.0319)
    assert suite("sbg_ig500").info.gyro_delay == pytest.approx(0.0064)
