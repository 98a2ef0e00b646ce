"""Allan tables of a log that was not made for them."""

from pathlib import Path

from ahrs_sim.review import allan


def test_a_recording_that_is_not_at_rest_says_so(flown: Path) -> None:
    found = {c.sensor: c for c in allan.of_log(flown, ["/chr/imu/data_raw"])}
    assert found["gyro"].moved.startswith("not at rest: its means change by up to ")
    assert "deg/s, and the fits take that for noise" in allan.text([found["gyro"]])
    assert " mg, " in found["accelerometer"].moved
