"""Every kind of fault in one flight, from scenario to log."""

from pathlib import Path

from ahrs_sim import pipeline, scenario
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.sensors.faults import KINDS


def test_every_kind_of_fault_flies_and_shows_in_the_log(tmp_path: Path) -> None:
    scene = scenario.load("faults", estimators=["ckf-chr"])
    kinds = [fault.settings["kind"] for fault in scene.faults]
    assert set(kinds) == set(KINDS)
    pipeline.fly(scene, tmp_path / "a.mcap")
    with FlightReader(tmp_path / "a.mcap") as log:
        events = [e for e in log.events() if e.name == "fault"]
        begun = [(e.t, e.text.split()[0]) for e in events if e.text.endswith("sets in")]
        assert begun == [(40.0 + 10 * i, kind) for i, kind in enumerate(kinds)]
        assert sum(e.text.endswith("ends") for e in events) == len(kinds)
        imu = log.record("chr", "imu")
        assert len(imu) == 200 * 100 + 1 - 500
        assert imu.saturated.any()
