"""Faults hit exactly the named samples, several at once, and bad tables get one clear line."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from sensor_helpers import DT, fault, quaternion, run, same, suite, truth, wild

from ahrs_sim.errors import InputError
from ahrs_sim.sensors.faults import check_suites, dipole
from estimators.types import Columns

FLIGHT = wild(4000)  # 10 s
AT = {"at_s": 2.0, "for_s": 3.0}
RECORD = {"gyro": ("imu", "gyro_b"), "accelerometer": ("imu", "accel_b"), "magnetometer": ("mag", "mag_b"),
          "position": ("fix", "lla_deg"), "velocity": ("velocity", "vel_n"), "heading": ("heading", "heading"),
          "diff_pressure": ("diff_pressure", "pressure"), "static_pressure": ("static_pressure", "pressure"),
          "interferometer": ("interferometer", "phase")}  # fmt: skip
EMITTER = {"interferometer": {"rate_hz": 20}}


def flown(*faults: dict, grade: str = "chr_6dm", **settings: Any) -> dict:
    return run(suite(grade, faults=[fault(**f) for f in faults], **EMITTER, **settings), FLIGHT)


CLEAN = flown()


def slots(records: Any) -> np.ndarray:
    """Time of each sample's slot: the IMU's stamps run a little ahead of theirs."""
    return np.round(records.stamp_ns * 1e-9, 3)


def named(records: Any) -> np.ndarray:
    return (slots(records) >= 2.0) & (slots(records) < 5.0)


def changed(a: Any, b: Any, column: str) -> np.ndarray:
    x, y = getattr(a, column), getattr(b, column)
    differs = ~((x == y) | (np.isnan(x) & np.isnan(y)))
    return differs.any(axis=1) if differs.ndim > 1 else differs


def others_untouched(out: dict, *hit: str) -> None:
    for name, records in out.items():
        if name not in hit:
            assert same(records, CLEAN[name]), name


SIZES = {"gyro": {"size_dps": 5.0}, "accelerometer": {"size_mg": 500.0}, "magnetometer": {"size_ut": 5.0},
         "position": {"size_m": 20.0}, "velocity": {"size_mps": 3.0}, "heading": {"size_deg": 5.0},
         "diff_pressure": {"size_pa": 50.0}, "static_pressure": {"size_hpa": 2.0},
         "interferometer": {"size_deg": 30.0}}  # fmt: skip


@pytest.mark.parametrize("kind", ["bias", "drift", "noise", "freeze", "nan", "spike"])
@pytest.mark.parametrize("sensor", list(RECORD))
def test_values_change_in_the_named_samples_only(sensor: str, kind: str) -> None:
    size = SIZES[sensor] if kind in ("bias", "drift", "noise", "spike") else {}
    every = {"every_s": 0.01} if kind == "spike" else {}
    out = flown({"sensor": sensor, "kind": kind, **AT, **size, **every})
    record, column = RECORD[sensor]
    hit = changed(out[record], CLEAN[record], column)
    expected = named(CLEAN[record])
    assert not hit[~expected].any()
    missing = np.isnan(getattr(CLEAN[record], column)).reshape(len(expected), -1).any(axis=1)
    # A drift starts from zero; a frozen or noisy value may by chance be the true one.
    allowed = 3 if kind in ("drift", "noise") else 0
    if kind == "freeze":  # as often as the clean value, which has quanta, happens to be the held one
        values, clean = (getattr(r, column)[expected & ~missing] for r in (out[record], CLEAN[record]))
        assert (values == values[0]).all()
        allowed = np.count_nonzero((clean == values[0]).reshape(len(clean), -1).all(axis=1))
        assert allowed < 0.1 * len(clean)
    assert np.count_nonzero(~hit[expected & ~missing]) <= allowed
    related = {
        "gyro": ("imu",),
        "diff_pressure": ("diff_pressure", "air"),
        "static_pressure": ("static_pressure", "air"),
    }
    others_untouched(out, *related.get(sensor, (record,)))


def test_bias_and_drift_have_their_size() -> None:
    size = [1.0, 0.0, -2.0]
    out = flown({"sensor": "gyro", "kind": "bias", "size_dps": size, **AT}, grade="ideal")
    clean = flown(grade="ideal")
    difference = np.degrees(out["imu"].gyro_b - clean["imu"].gyro_b)
    np.testing.assert_allclose(difference[named(clean["imu"])], np.tile(size, (300, 1)), atol=1e-9)
    out = flown({"sensor": "static_pressure", "kind": "drift", "size_pa": 10.0, **AT}, grade="ideal")
    t = slots(clean["static_pressure"])
    difference = out["static_pressure"].pressure - clean["static_pressure"].pressure
    np.testing.assert_allclose(difference[(t >= 2) & (t < 5)], 10.0 * (t[(t >= 2) & (t < 5)] - 2.0), atol=1e-6)


def test_spikes() -> None:
    once = flown({"sensor": "accelerometer", "kind": "spike", "at_s": 2.003, "size_mps2": 9.0}, grade="ideal")
    clean = flown(grade="ideal")
    hit = np.flatnonzero(changed(once["imu"], clean["imu"], "accel_b"))
    assert slots(clean["imu"])[hit].tolist() == [2.01]
    many = flown({"sensor": "accelerometer", "kind": "spike", "every_s": 0.5, "size_mps2": 9.0, **AT}, grade="ideal")
    hit = np.flatnonzero(changed(many["imu"], clean["imu"], "accel_b"))
    np.testing.assert_allclose(slots(clean["imu"])[hit], [2.0, 2.5, 3.0, 3.5, 4.0, 4.5])


@pytest.mark.parametrize(("key", "value", "ratio"), [("sigma_factor", 3.0, 3.0), ("variance_factor", 20.0, 20**0.5)])
def test_noise_factor_of_sigma_or_variance(key: str, value: float, ratio: float) -> None:
    flight = truth(40_000)
    settings = {"gyro": {"noise_density_dps_rthz": 0.1}, "instruments": ["imu"]}
    faults = [fault(sensor="gyro", kind="noise", at_s=50.0, **{key: value})]
    clean, out = (run(suite("ideal", faults=f, **settings), flight)["imu"].gyro_b for f in ([], faults))
    np.testing.assert_allclose(out[:5000], clean[:5000])
    np.testing.assert_allclose(out[5000:], ratio * clean[5000:], rtol=1e-12)


def test_noise_by_the_minute() -> None:
    """Variance x1, x5, x10, x20, one stretch each, and x1000 of the magnetometer's."""
    steps = [fault(sensor="accelerometer", kind="noise", variance_factor=float(v), at_s=10.0 * i, for_s=10.0)
             for i, v in ((1, 5), (2, 10), (3, 20))]  # fmt: skip
    steps.append(fault(sensor="magnetometer", kind="noise", variance_factor=1000.0, at_s=20.0))
    settings = {"accelerometer": {"noise_density_mg_rthz": 0.1}, "magnetometer": {"noise_density_mgauss_rthz": 0.1}}
    out = run(suite("ideal", faults=steps, instruments=["imu", "magnetometer"], **settings), truth(16_000))
    variance = [np.var(out["imu"].accel_b[i : i + 1000] - [0, 0, -9.81]) for i in range(0, 4000, 1000)]
    np.testing.assert_allclose(np.array(variance) / variance[0], [1, 5, 10, 20], rtol=0.15)
    mag = out["mag"].mag_b - out["mag"].mag_b[:2000].mean(axis=0)
    assert np.var(mag[2000:]) / np.var(mag[:2000]) == pytest.approx(1000, rel=0.15)


def test_saturation_limits_and_flags() -> None:
    out = flown({"sensor": "gyro", "kind": "saturation", "size_dps": 20.0, **AT}, grade="ideal")["imu"]
    clean = flown(grade="ideal")["imu"]
    beyond = (np.abs(clean.gyro_b) > np.radians(20.0)).any(axis=1)
    assert np.array_equal(out.saturated, beyond & named(clean))
    assert np.abs(out.gyro_b[named(clean)]).max() <= np.radians(20.0) * (1 + 1e-12)


@pytest.mark.parametrize(
    ("sensor", "records"),
    [
        ("imu", ("imu", "imu_errors")),
        ("magnetometer", ("mag",)),
        ("gnss", ("fix", "velocity")),
        ("velocity", ("velocity",)),
        ("heading", ("heading",)),
        ("air_data", ("diff_pressure", "static_pressure", "air")),
        ("static_pressure", ("static_pressure",)),
        ("interferometer", ("interferometer",)),
    ],
)
def test_dropout_and_delay_of_messages(sensor: str, records: tuple[str, ...]) -> None:
    out = flown({"sensor": sensor, "kind": "dropout", **AT})
    for name in records:
        kept = slots(CLEAN[name])[~named(CLEAN[name])]
        np.testing.assert_array_equal(slots(out[name]), kept)
    others_untouched(out, *records)
    out = flown({"sensor": sensor, "kind": "delay", "latency_s": 0.25, **AT})
    for name in records:
        assert np.array_equal(out[name].stamp_ns, CLEAN[name].stamp_ns[: len(out[name])])
        late = (out[name].arrival_ns - CLEAN[name].arrival_ns[: len(out[name])]) * 1e-9
        hit = named(CLEAN[name][: len(out[name])])
        np.testing.assert_allclose(late[hit], 0.25, atol=1e-9)
        assert (np.diff(out[name].arrival_ns) >= 0).all()
        after = slots(out[name]) > 5.3
        assert (late[after] == 0).all()
    others_untouched(out, *records)


def test_jamming_takes_position_velocity_and_heading() -> None:
    settings = {"gnss": {"reacquisition_s": 0.0}, "heading": {"reacquisition_s": 0.0}}
    out = flown({"sensor": "gnss", "kind": "jamming", **AT}, grade="ideal", **settings)
    assert np.array_equal(out["fix"].fix < 0, named(out["fix"]))
    assert np.array_equal(out["fix"].satellites == 0, named(out["fix"]))
    assert np.array_equal(np.isnan(out["velocity"].vel_n[:, 0]), named(out["velocity"]))
    assert np.array_equal(np.isnan(out["heading"].heading), named(out["heading"]))


def test_wrong_fix() -> None:
    out = flown({"sensor": "heading", "kind": "wrong_fix", "size_deg": 11.0, **AT}, grade="ideal")["heading"]
    clean = flown(grade="ideal")["heading"]
    error = np.degrees(np.angle(np.exp(1j * (out.heading - clean.heading))))
    np.testing.assert_allclose(error, np.where(named(clean), 11.0, 0.0), atol=1e-9)


def test_magnetic_disturbances() -> None:
    flight = truth(4000, q_nb=quaternion(yaw=np.pi / 2))
    settings = {"instruments": ["imu", "magnetometer"]}
    clean = run(suite("ideal", **settings), flight)["mag"]

    def added(**f: Any) -> np.ndarray:
        out = run(suite("ideal", faults=[fault(sensor="magnetometer", **f)], **settings), flight)["mag"]
        return out.mag_b - clean.mag_b

    hit = named(clean)
    step = added(kind="field_step", size_ut=[1.0, 2.0, 3.0], **AT)
    # Facing east, north is on the left.
    np.testing.assert_allclose(step[hit], np.tile([2e-6, -1e-6, 3e-6], (hit.sum(), 1)), atol=1e-16)
    assert not step[~hit].any()
    burst = added(kind="field_burst", size_ut=[0.0, 0.0, 4.0], frequency_hz=5.0, **AT)
    t = slots(clean)[hit] - 2.0
    np.testing.assert_allclose(burst[hit][:, 2], 4e-6 * np.sin(10 * np.pi * t), atol=1e-12)
    passed = added(kind="dipole", moment_am2=[0.0, 0.0, 10.0], distance_m=2.0, speed_mps=4.0, **AT)
    along = 4.0 * (slots(clean)[hit] - 3.5)
    r = np.hypot(along, 2.0)
    np.testing.assert_allclose(passed[hit][:, 2], -1e-7 * 10.0 / r**3, rtol=1e-9, atol=1e-18)
    assert not passed[~hit].any()
    on_axis = dipole(np.array([0.0, 0.0, 5.0]), np.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(on_axis, [[0, 0, 2e-7 * 5.0 / 8.0]], rtol=1e-12)


def test_several_at_once_and_events() -> None:
    faults = [
        {"sensor": "gyro", "kind": "bias", "size_dps": 1.0, **AT},
        {"sensor": "gyro", "kind": "drift", "size_dps": 1.0, "at_s": 3.0, "for_s": 1.0},
        {"sensor": "magnetometer", "kind": "nan", "at_s": 4.0},
    ]
    out, clean = flown(*faults, grade="ideal"), flown(grade="ideal")
    t = slots(clean["imu"])
    expected = np.where(named(clean["imu"]), 1.0, 0.0) + np.where((t >= 3) & (t < 4), t - 3.0, 0.0)
    np.testing.assert_allclose(np.degrees(out["imu"].gyro_b - clean["imu"].gyro_b)[:, 0], expected, atol=1e-9)
    for block in (4000, 4, 33):
        s = suite("chr_6dm", faults=[fault(**f) for f in faults])
        events = []
        for i in range(0, 4000, block):
            s.sense(FLIGHT[i : i + block])
            events += s.take_events()
        assert [(e.t, e.level, e.name) for e in events] == [
            (2.0, "warning", "fault"), (3.0, "warning", "fault"), (4.0, "info", "fault"), (4.0, "warning", "fault"),
            (5.0, "info", "fault"),
        ]  # fmt: skip
        assert events[0].text == "bias of chr/gyro sets in"


def test_blocks_of_any_length_give_the_same_bytes_under_faults() -> None:
    every = [
        {"sensor": "imu", "kind": "dropout", "at_s": 0.5, "for_s": 0.2},
        {"sensor": "imu", "kind": "delay", "latency_s": 0.07, "at_s": 1.0, "for_s": 0.3},
        {"sensor": "gyro", "kind": "freeze", "at_s": 1.5, "for_s": 0.5},
        {"sensor": "accelerometer", "kind": "noise", "size_mg": 50.0, "at_s": 1.0, "for_s": 1.0},
        {"sensor": "gyro", "kind": "spike", "every_s": 0.13, "size_dps": 30.0, "at_s": 0.3},
        {
            "sensor": "magnetometer",
            "kind": "dipole",
            "moment_am2": [1, 2, 3],
            "distance_m": 1.0,
            "speed_mps": 2.0,
            **AT,
        },
        {"sensor": "gnss", "kind": "jamming", "at_s": 1.0, "for_s": 1.0},
        {"sensor": "gnss", "kind": "delay", "latency_s": 0.5, "at_s": 2.5, "for_s": 1.0},
        {"sensor": "air_data", "kind": "freeze", "at_s": 1.0, "for_s": 0.4},
        {"sensor": "heading", "kind": "wrong_fix", "size_deg": 9.0, "at_s": 0.1, "for_s": 0.5},
    ]
    flight = FLIGHT[:1600]
    made = [run(suite("chr_6dm", faults=[fault(**f) for f in every]), flight, b) for b in (0, 4, 1, 29)]
    for other in made[1:]:
        for name, records in made[0].items():
            assert same(records, other[name]), name


def test_faults_of_other_suites_are_left_alone() -> None:
    f = fault(suite="sbg", sensor="gyro", kind="bias", size_dps=9.0, at_s=0.0)
    out = run(suite("chr_6dm", faults=[f], **EMITTER), FLIGHT)
    others_untouched(out)
    with pytest.raises(InputError, match=r"suite: 'sbh' is unknown; did you mean 'sbg'"):
        check_suites([fault(suite="sbh")], ["chr", "sbg"])
    check_suites([f, fault(sensor="gyro")], ["chr", "sbg"])
    # A fault for every suite passes over one that lacks the sensor.
    everywhere = fault(sensor="heading", kind="nan", at_s=0.0)
    assert suite("chr_6dm", faults=[everywhere], instruments=["imu"]).instruments == ("imu", "imu_errors")


@pytest.mark.parametrize(("table", "message"), [
    ({"kind": "bias", "at_s": 1.0}, r"sensor: missing"),
    ({"sensor": "gyroo", "kind": "bias", "at_s": 1.0}, r"'gyroo' is unknown; did you mean 'gyro'"),
    ({"sensor": "gyro", "kind": "byas", "at_s": 1.0}, r"'byas' is unknown; did you mean 'bias'"),
    ({"sensor": "gyro", "kind": "bias"}, r"at_s: missing"),
    ({"sensor": "gyro", "kind": "bias", "at_s": -1.0, "size_dps": 1}, r"at_s: -1 is out of range"),
    ({"sensor": "gyro", "kind": "bias", "at_s": float("nan"), "size_dps": 1}, r"at_s: nan is not a finite number"),
    ({"sensor": "gyro", "kind": "bias", "at_s": 1.0, "for_s": 0.0, "size_dps": 1}, r"for_s: 0 is out of range"),
    ({"sensor": "gyro", "kind": "bias", "at_s": 1.0}, r"size_dps: missing; bias needs a size"),
    ({"sensor": "gyro", "kind": "bias", "at_s": 1.0, "size_mg": 1.0}, r"size_mg: is no size of this sensor"),
    ({"sensor": "gyro", "kind": "bias", "at_s": 1.0, "size_dps": [1, 2]}, r"is not a list of 3"),
    ({"sensor": "imu", "kind": "bias", "at_s": 1.0, "size_dps": 1}, r"bias needs one sensor of gyro, accelerometer"),
    ({"sensor": "gyro", "kind": "bias", "at_s": 1.0, "size_dps": 1, "sise": 2}, r"sise: unknown key"),
    ({"sensor": "gyro", "kind": "noise", "at_s": 1.0}, r"give one of variance_factor, sigma_factor or a size"),
    ({"sensor": "gyro", "kind": "noise", "at_s": 1.0, "variance_factor": 2.0, "sigma_factor": 2.0}, r"give one of"),
    ({"sensor": "gyro", "kind": "noise", "at_s": 1.0, "variance_factor": -2.0}, r"-2 is out of range"),
    ({"sensor": "gyro", "kind": "dropout", "at_s": 1.0}, r"shares its message; say sensor = \"imu\""),
    ({"sensor": "gyro", "kind": "jamming", "at_s": 1.0}, r"say sensor = \"gnss\""),
    ({"sensor": "gyro", "kind": "dipole", "at_s": 1.0}, r"say sensor = \"magnetometer\""),
    ({"sensor": "gyro", "kind": "wrong_fix", "at_s": 1.0}, r"sensor = \"heading\""),
    ({"sensor": "velocity", "kind": "saturation", "at_s": 1.0, "size_mps": 1.0}, r"velocity has no range"),
    ({"sensor": "gnss", "kind": "satellites", "at_s": 1.0}, r"count: missing"),
    ({"sensor": "imu", "kind": "delay", "at_s": 1.0}, r"latency_s: missing"),
    ({"sensor": "magnetometer", "kind": "dipole", "at_s": 1.0, "moment_am2": [0, 0, 1]}, r"for_s: missing"),
    ({"sensor": "magnetometer", "kind": "dipole", "at_s": 1.0, "for_s": 1.0, "moment_am2": [0, 0, 1], "speed_mps": 1},
     r"less than 0.1 m"),
    ({"suite": "chr", "sensor": "interferometer", "kind": "nan", "at_s": 1.0}, r"suite 'chr' has no interferometer"),
])  # fmt: skip
def test_bad_tables_get_one_line(table: dict, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        suite("chr_6dm", faults=[fault(**table)])
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("test.toml: [[fault]] 1")


def test_dt_of_the_helpers() -> None:
    assert len(FLIGHT) * DT == 10.0
    assert dataclasses.is_dataclass(Columns)
