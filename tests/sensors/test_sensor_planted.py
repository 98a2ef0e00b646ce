"""What the planted scenarios have that others lack is in their streams, and they are in the standard suite."""

from functools import cache

import numpy as np
import pytest

from ahrs_sim import scenario
from ahrs_sim.attitude import euler
from ahrs_sim.flight import Truth, open_flight
from ahrs_sim.runs import check_suite
from ahrs_sim.scenario.shipped import scenario_dir
from ahrs_sim.sensors import make_suite
from ahrs_sim.sensors.records import SuiteBlock

ON_TURNS = ("gnss_late", "gnss_lag", "gnss_start_up", "mag_turned", "motor_wires", "rough_clock")
PLANTED = (*ON_TURNS, "hover", "hand_launch", "piston")


@cache
def flown(name: str) -> Truth:
    flight = open_flight(scenario.load("short_turns" if name in ON_TURNS else name, estimators=[]))
    blocks = []
    while len(rows := flight.fly(4000)):
        blocks.append(rows)
    assert flight.error is None
    return Truth.concatenate(blocks)


@cache
def sensed(name: str) -> SuiteBlock:
    """Records of the CHR suite of a scenario, seed 1."""
    scene, truth = scenario.load(name, estimators=[]), flown(name)
    (component,) = (s for s in scene.suites if s.name == "chr")
    dt = float(truth.t[1] - truth.t[0])
    suite = make_suite(component, seed=scene.seed, dt=dt, epoch=scene.epoch, start_lla=truth.lla[0])
    blocks = [suite.sense(truth[i : i + 4000]) for i in range(0, len(truth), 4000)]
    return {k: type(v).concatenate([b[k] for b in blocks]) for k, v in blocks[0].items()}


def test_each_is_flown_by_the_standard_suite() -> None:
    names = {flight.name for flight in check_suite.load().flights}
    assert names >= {*PLANTED, "short_turns"}
    listed = {path.stem for path in scenario_dir().glob("*.toml") if 'title = "Planted' in path.read_text("utf-8")}
    assert listed == set(PLANTED) - {"piston"}


def behind(name: str, of_position: bool = False) -> float:
    """s by which GNSS velocities, or places, are behind the truth at their stamps, by least squares in turns."""
    truth, records = flown(name), sensed(name)
    record = records["fix"] if of_position else records["velocity"]
    t = record.stamp_ns * 1e-9
    turning = (t > 70.0) & (t < truth.t[-1] - 5.0)
    if of_position:
        values, true = np.radians(record.lla_deg[:, :2]), truth.lla[:, :2]
    else:
        values, true = record.vel_n[:, :2], truth.vel_n[:, :2]

    def misfit(delay: float) -> float:
        at = np.column_stack([np.interp(t - delay, truth.t, true[:, k]) for k in range(2)])
        off = (values - at)[turning]
        return float(np.sum((off - off.mean(axis=0)) ** 2))

    delays = np.arange(-0.2, 0.6, 0.01)
    return float(delays[np.argmin([misfit(d) for d in delays])])


def test_the_delay_is_that_of_the_scenario() -> None:
    assert behind("short_turns") == pytest.approx(0.0, abs=0.03)
    assert behind("gnss_late") == pytest.approx(0.3, abs=0.03)
    assert behind("gnss_late", of_position=True) == pytest.approx(0.3, abs=0.1)


def test_the_velocity_lags_and_the_place_does_not() -> None:
    assert behind("gnss_lag") == pytest.approx(0.3, abs=0.03)
    assert behind("gnss_lag", of_position=True) == pytest.approx(0.0, abs=0.1)


def test_fixes_come_home_after_switch_on() -> None:
    settling, settled = (sensed(name)["fix"] for name in ("gnss_start_up", "short_turns"))
    off = np.radians(settling.lla_deg - settled.lla_deg) * [6.37e6, 6.37e6 * np.cos(0.76), 180.0 / np.pi]
    t = settling.stamp_ns * 1e-9
    assert 10.0 < np.linalg.norm(off[0]) < 80.0
    assert np.linalg.norm(off, axis=1) == pytest.approx(np.linalg.norm(off[0]) * np.exp(-(t - t[0]) / 60.0), abs=0.01)
    standing = (sensed("gnss_start_up")["velocity"].vel_n - sensed("short_turns")["velocity"].vel_n)[t < 20.0]
    assert 0.1 < np.linalg.norm(standing, axis=1).max() < 1.5, "and a standing aircraft seems to move"


def heading_of_field(name: str) -> np.ndarray:
    """Direction of the horizontal field in body axes while it stands, rad."""
    mag = sensed(name)["mag"]
    return np.arctan2(mag.mag_b[:500, 1], mag.mag_b[:500, 0])


def test_the_magnetometer_is_sixty_degrees_off_and_its_norm_is_not() -> None:
    turned, right = sensed("mag_turned")["mag"].mag_b, sensed("short_turns")["mag"].mag_b
    off = np.degrees(np.mean(heading_of_field("mag_turned") - heading_of_field("short_turns")))
    assert abs((off + 180.0) % 360.0 - 180.0) == pytest.approx(60.0, abs=5.0)
    assert np.linalg.norm(turned, axis=1).mean() == pytest.approx(np.linalg.norm(right, axis=1).mean(), rel=0.03)


def test_the_field_follows_the_throttle() -> None:
    truth = flown("motor_wires")
    loud, quiet = sensed("motor_wires")["mag"], sensed("short_turns")["mag"]
    throttle = np.interp(loud.stamp_ns * 1e-9, truth.t, np.nan_to_num(truth.throttle))
    extra = loud.mag_b - quiet.mag_b
    at_full = np.linalg.lstsq(throttle[:, None], extra, rcond=None)[0][0]
    share = np.linalg.norm(at_full) / np.linalg.norm(quiet.mag_b, axis=1).mean()
    assert 0.05 < share < 0.2
    assert np.abs(extra - throttle[:, None] * at_full).max() < 1e-6, "nothing else has changed, but the filter's delay"
    assert throttle.max() > 0.9 and throttle[:500].max() == 0.0


def test_samples_come_when_they_like_and_one_in_fifty_does_not_come() -> None:
    truth, rough, even = flown("rough_clock"), sensed("rough_clock")["imu"], sensed("short_turns")["imu"]
    assert len(rough) / len(even) == pytest.approx(0.98, abs=0.006)
    steps = np.diff(rough.stamp_ns) * 1e-9
    assert steps.std() > 1.5e-3
    assert 0.018 < np.quantile(steps, 0.995) < 0.035
    assert (steps > 0.0).mean() > 0.99
    assert len(sensed("rough_clock")["imu_errors"]) == len(rough)
    assert len(truth) > 400 * 120


def test_a_hover_has_neither_course_nor_speed_and_shakes() -> None:
    truth, records = flown("hover"), sensed("hover")
    assert truth.t[-1] == pytest.approx(640.0)
    air = truth.t > 40.0
    metres = (truth.lla[air] - truth.lla[air].mean(axis=0)) * [6.37e6, 4.6e6, 1.0]
    assert 0.1 < np.linalg.norm(metres[:, :2], axis=1).max() < 4.0
    assert 0.05 < truth.vel_n[air].std(axis=0).max() < 0.5
    assert np.linalg.norm(truth.vel_n[air], axis=1).max() < 2.0
    assert truth.height_agl[air].mean() == pytest.approx(20.0, abs=1.0)
    assert np.abs(np.cross(truth.accel_b[air], [0.0, 0.0, -1.0])).max() < 2.0, "lift and a little drag"
    assert 0.3 < truth.throttle[air].min() < truth.throttle[air].max() < 0.8
    imu = records["imu"]
    flying = imu.stamp_ns * 1e-9 > 40.0
    calm = np.column_stack([np.interp(imu.stamp_ns * 1e-9, truth.t, truth.accel_b[:, k]) for k in range(3)])
    shake = (imu.accel_b - calm)[flying]
    assert np.all((shake.std(axis=0) > 1.0) & (shake.std(axis=0) < 5.0)), "m/s2 RMS of a sample"
    assert np.all(np.degrees(imu.gyro_b[flying]).std(axis=0) > 3.0)
    assert (imu.accel_b - calm)[imu.stamp_ns * 1e-9 < 15.0].std(axis=0).max() < 0.1, "not while its rotors stand"
    spectrum = np.abs(np.fft.rfft(shake[:8000, 2])) ** 2
    frequency = np.fft.rfftfreq(8000, 0.01)
    low = spectrum[(frequency > 2.0) & (frequency < 20.0)].sum() / spectrum[frequency > 0.1].sum()
    assert low > 0.3, "rotors of 92 Hz are at 8 Hz in samples of 100 Hz"


def test_a_piston_engine_shakes_in_flight() -> None:
    truth, imu = flown("piston"), sensed("piston")["imu"]
    t = imu.stamp_ns * 1e-9
    cruise = (t > 120.0) & (t < 160.0)
    late = 0.008  # s, of the unit's low-pass
    calm = np.column_stack([np.interp(t - late, truth.t, truth.accel_b[:, k]) for k in range(3)])
    rms = (imu.accel_b - calm)[cruise].std(axis=0)
    assert np.all((rms > 1.0) & (rms < 5.0))
    shaft = truth.rpm[(truth.t > 120.0) & (truth.t < 160.0)] / 60.0
    assert 20.0 < shaft.min() < shaft.max() < 200.0


def test_two_seconds_and_a_throw() -> None:
    truth, imu = flown("hand_launch"), sensed("hand_launch")["imu"]
    still = truth.t <= 2.0
    assert np.abs(truth.vel_n[still]).max() == 0.0
    assert np.linalg.norm(truth.vel_n[truth.t > 4.0], axis=1).min() == pytest.approx(14.0, abs=0.01)
    thrown = (truth.t > 2.0) & (truth.t < 4.0)
    assert 15.0 < truth.accel_b[thrown, 0].max() < 25.0
    assert not imu.saturated.any(), "a throw within the unit's 3 g"
    banks = np.degrees(euler(truth.q_nb)[:, 0])
    assert 25.0 < banks.max() < 40.0
    assert -40.0 < banks.min() < -25.0
