"""From records to samples."""

import dataclasses

import numpy as np
import pytest
from sensor_helpers import fault, run, suite, wild

from ahrs_sim.sensors import Assembler
from ahrs_sim.sensors.records import FixRecord, HeadingRecord, ImuRecord, VelocityRecord
from estimators.types import Samples, blank

NS = 10**9


def imu(t: np.ndarray) -> ImuRecord:
    made = blank(ImuRecord, len(t))
    made["stamp_ns"][:] = made["arrival_ns"][:] = np.round(np.asarray(t) * NS)
    made["gyro_b"][:] = made["accel_b"][:] = 0.0
    return ImuRecord(**made)


def fixes(
    stamps: list[float], arrivals: list[float], good: list[bool] | None = None
) -> tuple[FixRecord, VelocityRecord]:
    fix, velocity = blank(FixRecord, len(stamps)), blank(VelocityRecord, len(stamps))
    for columns in (fix, velocity):
        columns["stamp_ns"][:] = np.round(np.array(stamps) * NS)
        columns["arrival_ns"][:] = np.round(np.array(arrivals) * NS)
    fix["lla_deg"][:] = np.array(stamps)[:, None]
    velocity["vel_n"][:] = np.array(stamps)[:, None]
    fix["satellites"][:] = 7
    if good is not None:
        fix["fix"][~np.array(good)] = -1
        fix["lla_deg"][~np.array(good)] = np.nan
        velocity["vel_n"][~np.array(good)] = np.nan
    return FixRecord(**fix), VelocityRecord(**velocity)


def test_latched_by_arrival() -> None:
    fix, velocity = fixes([0.0, 0.2, 0.4], [0.1, 0.305, 9.0])
    t = np.arange(0.0, 0.6, 0.1)
    s = Assembler().assemble({"imu": imu(t), "fix": fix, "velocity": velocity})
    np.testing.assert_array_equal(s.t, np.round(t * NS).astype(np.int64) * 1e-9)
    assert s.gnss_new.tolist() == [False, True, False, False, True, False]
    np.testing.assert_allclose(s.gnss_t, [np.nan, 0, 0, 0, 0.2, 0.2])
    np.testing.assert_allclose(s.lla[1], [0, 0, 0])
    np.testing.assert_allclose(s.lla[4], [np.radians(0.2), np.radians(0.2), 0.2])
    np.testing.assert_allclose(s.vel_n[5], 0.2)
    assert np.isnan(s.gnss_satellites[0])
    assert s.gnss_satellites[1] == 7
    assert np.isnan(s.heading).all()
    assert not s.heading_new.any()


def test_no_fix_is_missing_not_old() -> None:
    fix, velocity = fixes([0.0, 0.2], [0.0, 0.2], [True, False])
    s = Assembler().assemble({"imu": imu(np.arange(0, 0.4, 0.1)), "fix": fix, "velocity": velocity})
    assert s.gnss_new.tolist() == [True, False, False, False]
    assert np.isnan(s.lla[2:]).all()
    assert np.isnan(s.vel_n[2:]).all()
    assert (s.gnss_satellites == 7).all()


def test_half_a_solution() -> None:
    fix, velocity = fixes([0.0, 0.2], [0.0, 0.2])
    s = Assembler().assemble({"imu": imu(np.arange(0, 0.4, 0.1)), "fix": fix[:1], "velocity": velocity})
    assert s.gnss_new.tolist() == [True, False, True, False]
    assert np.isnan(s.lla[2:]).all()
    np.testing.assert_allclose(s.vel_n[2:], 0.2)
    np.testing.assert_allclose(s.gnss_t[2:], 0.2)


def test_heading_without_solution_is_not_new() -> None:
    made = blank(HeadingRecord, 2)
    made["stamp_ns"][:] = made["arrival_ns"][:] = [0, NS // 10]
    made["heading"][:] = [1.0, np.nan]
    s = Assembler().assemble({"imu": imu(np.arange(0, 0.3, 0.1)), "heading": HeadingRecord(**made)})
    assert s.heading_new.tolist() == [True, False, False]
    np.testing.assert_allclose(s.heading, [1.0, np.nan, np.nan])


@pytest.mark.parametrize("block", [1, 4, 53])
def test_blocks_of_any_length_give_the_same_samples(block: int) -> None:
    flight = wild(1600)
    faults = [
        fault(sensor="imu", kind="delay", latency_s=0.055, at_s=1.0, for_s=0.4),
        fault(sensor="gnss", kind="delay", latency_s=0.4, at_s=0.4, for_s=0.8),
        fault(sensor="imu", kind="dropout", at_s=2.0, for_s=0.5),
    ]

    def samples(size: int) -> Samples:
        s, a = suite("chr_6dm", faults=faults), Assembler()
        return Samples.concatenate([a.assemble(s.sense(flight[i : i + size])) for i in range(0, 1600, size)])

    whole, pieces = samples(1600), samples(block)
    for f in dataclasses.fields(Samples):
        assert getattr(whole, f.name).tobytes() == getattr(pieces, f.name).tobytes(), f.name


def test_samples_of_a_flight() -> None:
    flight = wild(4000)
    out = run(suite("ideal"), flight)
    s = Assembler().assemble(out)
    assert len(s) == len(out["imu"])
    assert np.array_equal(s.gyro_b, out["imu"].gyro_b)
    assert s.mag_new.all()
    assert np.array_equal(np.flatnonzero(s.air_new), np.arange(0, 1000, 2))
    np.testing.assert_allclose(s.airspeed[s.air_new], flight.airspeed[::8], rtol=1e-9)
    np.testing.assert_allclose(s.lla[s.gnss_new], flight.lla[::80], rtol=1e-6)
    replayed = Assembler().assemble({name: records for name, records in out.items() if name != "imu_errors"})
    assert np.array_equal(replayed.lla, s.lla)
