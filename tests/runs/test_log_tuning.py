"""Tuning on a log: planted noises are found, knobs are checked, the command prints what can be pasted."""

import json
import tomllib

import numpy as np
import pytest

from ahrs_sim import attitude, cli, pipeline, scenario
from ahrs_sim.errors import CheckError, InputError
from ahrs_sim.evaluation.metrics import History
from ahrs_sim.runs import log_tuning
from ahrs_sim.runs.log_tuning import Recorded, tune
from estimators import Samples, SensorInfo, Site

SITE = Site((0.76, 0.02, 150.0), gravity=9.805, mag_n=(2.3e-5, 4e-7, 4.0e-5))
RATE = 100.0
PERFECT = SensorInfo(
    gyro_noise=0.0, gyro_bias=1e-6, gyro_instability=1e-9, gyro_scale=1e-9, gyro_misalignment=0.0,
    gyro_scale_factor=0.0, accel_noise=0.0, accel_bias=1e-6, accel_scale=1e-9, accel_misalignment=0.0,
    accel_scale_factor=0.0, mag_bias=1e-9, gnss_vel=1.0, gnss_pos=1.0,
)  # fmt: skip
WHITE = {
    "heading_aid": False, "scale_share": 0.0, "force_share": 0.0, "turn_share": 0.0, "accel_share": 0.0,
    "jerk_share": 0.0, "shake_share": 0.0, "gnss_time": 0.0, "position_share": 0.5, "mag_sigma": 0.02,
    "mag_share": 0.0, "norm_scale": 1e3, "dip_scale": 1e3, "late_sigma": 0.0,
}  # fmt: skip
GYRO, ACCEL, VELOCITY = 0.01, 0.5, 0.1  # rad/s/sqrt(Hz), m/s2/sqrt(Hz), m/s


def weaving(seed: int, seconds: float = 600.0) -> Recorded:
    """A weaving flight with white noises of known size, after half a minute of standing."""
    rng = np.random.default_rng(seed)
    n = round(RATE * seconds)
    t = np.arange(n) / RATE
    go = np.clip((t - 30.0) / 20.0, 0.0, 1.0)
    yaw = 0.3 + 1.5 * np.sin(0.1 * np.maximum(t - 50.0, 0.0)) * go
    roll = 0.4 * np.cos(0.1 * np.maximum(t - 50.0, 0.0)) * np.clip((t - 50.0) / 10.0, 0.0, 1.0)
    speed = 20.0 * go * go * (3.0 - 2.0 * go)
    vel = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), 0.0 * t])
    q = attitude.from_euler(np.column_stack([roll, 0.0 * t, yaw]))
    rate = np.vstack([np.zeros(3), attitude.rotation_vector(q[:-1], q[1:]) * RATE])
    C = np.moveaxis(np.array(_rows(q)), 2, 0)  # C_nb
    force = np.einsum("nji,nj->ni", C, np.gradient(vel, 1.0 / RATE, axis=0) - [0.0, 0.0, SITE.gravity])
    field = np.einsum("nji,j->ni", C, np.array(SITE.mag_n))
    moving = (t > 30.0)[:, None]  # nothing but a little noise while it aligns
    sigma = np.sqrt(RATE / 2.0)
    new = np.arange(n) % 20 == 0
    fix = np.maximum.accumulate(np.where(new, np.arange(n), 0))
    noise = VELOCITY * rng.standard_normal((n, 3)) * (1.0, 1.0, 1.5)
    place = np.cumsum(vel, axis=0) / RATE
    wander = 0.5 * rng.standard_normal((n, 3))
    lla = np.array(SITE.lla) + (place + wander) / np.array([6.37e6, 6.37e6 * np.cos(SITE.lla[0]), -1.0])
    samples = Samples.make(
        t, rate + moving * GYRO * sigma * rng.standard_normal((n, 3)) + 1e-5 * rng.standard_normal((n, 3)),
        force + moving * ACCEL * sigma * rng.standard_normal((n, 3)) + 1e-4 * rng.standard_normal((n, 3)),
        mag_b=field + 2e-7 * rng.standard_normal((n, 3)), mag_new=np.arange(n) % 2 == 0,
        vel_n=(vel + noise)[fix], lla=lla[fix], gnss_t=t[fix], gnss_new=new,
    )  # fmt: skip
    return Recorded(samples, SITE, PERFECT, "ins21", WHITE, History(t, q))


def _rows(q):
    a, b, c, d = q.T
    return [
        [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
    ]


@pytest.fixture(scope="module")
def flown():
    return weaving(1)


@pytest.mark.long
def test_planted_noises_are_found(flown):
    found = tune(flown, ["gyro_noise=1e-4..0.1", "accel_noise=0.02..5", "velocity_share=0.01..1"])
    assert found.settings["gyro_noise"] == pytest.approx(GYRO, rel=0.2)
    assert found.settings["accel_noise"] == pytest.approx(ACCEL, rel=0.2)
    assert found.settings["velocity_share"] == pytest.approx(VELOCITY, rel=0.2)
    assert found.low > 0.0
    assert abs(found.nis_after - 1.0) < abs(found.nis_before - 1.0)


@pytest.mark.long
def test_errors_against_a_reference_fall(flown):
    found = tune(flown, ["gyro_noise=1e-4..0.1", "velocity_share=0.01..1"], log_tuning.ERROR)
    assert found.after < found.before


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("gyro_nois", "did you mean 'gyro_noise'"),
        ("states", "is not a number"),
        ("shake_share", "give limits"),
        ("gyro_noise=1", "write gyro_noise=LOW..HIGH"),
        ("gyro_noise=2..1", "must rise"),
    ],
)
def test_a_setting_that_cannot_be_tuned_is_one_line(flown, setting, message):
    with pytest.raises(InputError, match=message):
        tune(flown, [setting])


def test_too_short_and_without_reference(flown):
    short = Recorded(flown.samples[:3000], SITE, PERFECT, "ins21", WHITE)
    with pytest.raises(CheckError, match="it takes four"):
        tune(short, ["gyro_noise"])
    with pytest.raises(InputError, match="neither truth nor reference"):
        tune(short, ["gyro_noise"], log_tuning.ERROR)


def test_command_on_a_log_of_ours(tmp_path, capsys):
    known = scenario.load("takeoff", estimators=["ins21@chr"], duration=95.0)
    pipeline.fly(known, tmp_path / "flown.mcap")
    asked = ["tune", str(tmp_path / "flown.mcap"), "--estimator", "ins21@chr", "--setting", "velocity_share=0.2..3"]
    code = cli.main(asked)
    printed = capsys.readouterr()
    assert code == 0, printed.err
    pasted = tomllib.loads(printed.out.partition("\n\n")[0])
    assert 0.2 <= pasted["estimator"]["ins21"]["velocity_share"] <= 3.0
    assert cli.main([*asked, "--json", "--objective", "error"]) == 0
    assert json.loads(capsys.readouterr().out)["objective"] == "error"
    assert cli.main(["tune", str(tmp_path / "flown.mcap"), "--estimator", "ins22@chr"]) == 2
