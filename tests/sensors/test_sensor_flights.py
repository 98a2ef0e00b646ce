"""Every kind of fault in one flight, from scenario to log."""

from pathlib import Path

from ahrs_sim import pipeline, scenario
from ahrs_sim.log.record import FlightReader
from ahrs_sim.sensors.faults import KINDS

FAULTS = [
    {"sensor": "imu", "kind": "dropout"},
    {"sensor": "gyro", "kind": "freeze"},
    {"sensor": "accelerometer", "kind": "spike", "every_s": 0.5, "size_mg": 900.0},
    {"sensor": "gyro", "kind": "bias", "size_dps": [1.0, 0.0, 0.0]},
    {"sensor": "gyro", "kind": "drift", "size_dps": 0.1},
    {"sensor": "magnetometer", "kind": "noise", "sigma_factor": 1000.0},
    {"sensor": "accelerometer", "kind": "saturation", "size_g": 0.5},
    {"sensor": "gnss", "kind": "delay", "latency_s": 0.4},
    {"sensor": "magnetometer", "kind": "nan"},
    {"sensor": "heading", "kind": "wrong_fix", "size_deg": 11.0},
    {"sensor": "gnss", "kind": "jamming"},
    {"sensor": "gnss", "kind": "satellites", "count": 5},
    {"sensor": "magnetometer", "kind": "dipole", "moment_am2": [0.0, 0.0, 30.0], "distance_m": 2.0, "speed_mps": 3.0},
    {"sensor": "magnetometer", "kind": "field_step", "size_ut": 5.0},
    {"sensor": "magnetometer", "kind": "field_burst", "size_ut": 5.0, "frequency_hz": 3.0},
]


def test_every_kind_of_fault_flies_and_shows_in_the_log(tmp_path: Path) -> None:
    assert {f["kind"] for f in FAULTS} == set(KINDS)
    faults = [{"suite": "chr", "at_s": 1.0 + i, "for_s": 2.0, **f} for i, f in enumerate(FAULTS)]
    scene = scenario.parse(
        {
            "duration_s": 20.0,
            "motion": {"kind": "sway", "still_s": 5.0},
            "suite": {"chr": {"grade": "chr_6dm"}},
            "estimator": {"ekf": {"method": "marg-ekf", "suite": "chr"}},
            "fault": faults,
        },
        "faults",
        "test.toml",
    )
    pipeline.fly(scene, tmp_path / "a.mcap")
    with FlightReader(tmp_path / "a.mcap") as log:
        events = [e for e in log.events() if e.name == "fault"]
        begun = [(e.t, e.text.split()[0]) for e in events if e.text.endswith("sets in")]
        assert begun == [(1.0 + i, f["kind"]) for i, f in enumerate(FAULTS)]
        assert sum(e.text.endswith("ends") for e in events) == len(FAULTS)
        imu = log.record("chr", "imu")
        assert len(imu) == 20 * 100 + 1 - 200
        assert imu.saturated.any()
