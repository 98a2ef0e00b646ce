"""From Python: the functions give what the commands give, as frames with units, one time index and phases."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas
import pytest

import ahrs_sim
from ahrs_sim.cli import main
from ahrs_sim.errors import InputError
from ahrs_sim.review.frames import LogFrames

pytestmark = pytest.mark.usefixtures("pool_here")

SHORT = 'extends = "circuit"\nduration_s = 75.0\nestimators = ["ekf-chr", "ekf-sbg"]\n'


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("notebook") / "short.toml"
    path.write_text(SHORT)
    return path


@pytest.fixture(scope="module")
def log(scenario: Path) -> Iterator[LogFrames]:
    with ahrs_sim.fly(scenario, seed=3) as flown:
        yield flown


def _printed(capsys: pytest.CaptureFixture[str], *command: str) -> dict:
    assert main([*command]) == 0
    found = json.loads(capsys.readouterr().out)
    del found["log"]
    return found


@pytest.mark.long
def test_fly_replay_and_compare_give_what_the_commands_give(
    log: LogFrames, scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.mcap"
    flown = _printed(capsys, "fly", str(scenario), "--seed", "3", "-o", str(path), "--json")
    assert path.read_bytes() == log.path.read_bytes()
    table = log.accuracy()
    assert {**table, "log": ""} == {**flown, "log": ""}
    compared = _printed(capsys, "compare", str(path), "--from", "40", "--against", "ekf-sbg", "--json")
    assert {**ahrs_sim.compare(path, start=40.0, against="ekf-sbg"), "log": ""} == {**compared, "log": ""}
    main(["compare", str(path)])
    assert capsys.readouterr().out.strip() == str(table)


def test_replay_gives_what_the_command_gives(
    log: LogFrames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = _printed(capsys, "replay", str(log.path), "--estimator", "marg-ekf@sbg", "--json")
    with ahrs_sim.replay(log.path, estimators=["marg-ekf@sbg"]) as again:
        assert set(again.estimators) == {"ekf-chr", "ekf-sbg", "marg-ekf-sbg"}
        found = again.accuracy()["estimators"]
        assert found["marg-ekf-sbg"] == printed["estimators"]["marg-ekf-sbg"] == found["ekf-sbg"]
        temporary = again.path
        assert temporary.exists()
    assert not temporary.exists()
    kept = tmp_path / "kept.mcap"
    ahrs_sim.replay(log.path, kept, estimators=["ekf-chr"]).close()
    assert kept.exists()
    with pytest.raises(InputError, match="exists"):
        ahrs_sim.replay(log.path, kept, estimators=["ekf-chr"])


def test_all_estimators_have_one_index_with_the_phases(log: LogFrames) -> None:
    truth, errors = log.truth(), log.errors()
    assert errors.index.equals(truth.index)
    assert errors.index.equals(log.estimates().index)
    assert list(errors.columns.get_level_values("estimator").unique()) == ["ekf-chr", "ekf-sbg"]
    assert {"ground", "transient"} <= set(truth["phase"].unique())
    by_phase = (errors["ekf-chr"]["tilt"] ** 2).groupby(truth["phase"], observed=True).mean() ** 0.5
    table = log.accuracy().frame
    for phase, value in by_phase.items():
        assert value == pytest.approx(table.loc[("ekf-chr", phase), "tilt_rmse_deg"], rel=0.02)
    one = log.errors("ekf-chr")
    nearest = one.reindex(errors.index, method="nearest")["heading"]
    known = errors["ekf-chr"]["heading"].notna()
    assert known.mean() > 0.5
    assert (errors["ekf-chr"]["heading"][known] == nearest[known]).all()


def test_frames_have_units(log: LogFrames) -> None:
    assert log.truth().attrs["units"]["height"] == "m"
    assert log.errors("ekf-chr").attrs["units"] == {"t": "s", **dict.fromkeys(log.errors("ekf-chr").columns, "deg")}
    assert log.estimates().attrs["units"]["ekf-sbg", "gyro_bias_x"] == "deg/s"
    assert log.accuracy().frame.attrs["units"]["tilt_p95_deg"] == "deg"


def test_what_shows_itself(log: LogFrames) -> None:
    assert "estimators: ekf-chr, ekf-sbg" in repr(log)
    table = log.accuracy(against="ekf-chr")
    html = table._repr_html_()
    assert html.count("<table") == 1
    assert f"{table['estimators']['ekf-sbg']['tilt_rmse_deg']:.2f}" in html
    assert html.index("ekf-sbg") < html.index("ekf-chr")  # the more accurate one first
    pairs = table.paired
    assert pairs.loc[("ekf-sbg", "all", "tilt"), "change"] < 0
    with pytest.raises(InputError, match="against=NAME"):
        log.accuracy().paired  # noqa: B018


def test_unknown_names_are_one_line(log: LogFrames, tmp_path: Path) -> None:
    for ask in (log.errors, log.estimates):
        with pytest.raises(InputError, match="did you mean 'ekf-chr'"):
            ask("ekf-ch")
    with pytest.raises(InputError, match="no such scenario"):
        ahrs_sim.fly("circiut")
    with pytest.raises(InputError, match="no campaign there"):
        ahrs_sim.read_campaign(tmp_path)


@pytest.mark.long
def test_a_campaign_as_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "sway.toml", tmp_path / "out"
    path.write_text(
        'duration_s = 24.0\n[motion]\nkind = "sway"\nstill_s = 21.0\n[suite.chr]\ngrade = "chr_6dm"\n'
        'instruments = ["imu", "magnetometer"]\n[estimator.a]\nmethod = "marg-ekf"\nsuite = "chr"\n'
        '[estimator.b]\nmethod = "marg-ekf"\nsuite = "chr"\nnoise = "practical"\n'
    )
    command = ["campaign", str(path), "--runs", "6", "-o", str(out), "--workers", "1", "--against", "a", "--json"]
    assert main(command) == 0
    printed = json.loads(capsys.readouterr().out)
    campaign = ahrs_sim.read_campaign(out)
    runs = campaign.runs
    assert len(runs) == 12
    assert runs.attrs["units"]["tilt_rmse_deg"] == "deg"
    assert not any(isinstance(x, list) for x in runs.iloc[0])
    pivot = runs.pivot(index="run", columns="estimator", values="tilt_rmse_deg")
    wanted = printed["paired"]["estimators"]["b"]["tilt_rmse_deg"]
    assert (pivot["b"] - pivot["a"]).mean() == pytest.approx(wanted["change"])
    pairs = campaign.paired("a")
    assert pairs.loc[("b", "tilt_rmse_deg"), "low"] == wanted["low"]
    bands = campaign.bands("tilt")
    assert bands.columns.names == ["estimator", "run"]
    assert math.isnan(bands.loc[0.0, ("a", 0)])
    assert np.isfinite(bands.iloc[-1]).all()
    assert "6 of 6 runs" in repr(campaign)
    assert campaign._repr_html_().startswith("<pre>")
    assert isinstance(runs, pandas.DataFrame)
    for ask in (lambda: campaign.bands("tlit"), lambda: campaign.paired("c")):
        with pytest.raises(InputError, match=r"did you mean|known"):
            ask()
