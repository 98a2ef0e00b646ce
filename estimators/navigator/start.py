"""What is constant during a flight, and the first state: from settings, place, data sheet and alignment."""

import math

import numpy as np

from estimators.alignment import NO_HEADING, Alignment, still_limits
from estimators.elementary import cos, hypot, sin
from estimators.jit import inner
from estimators.native import Record, local
from estimators.navigator.aids import LEVEL, UP
from estimators.navigator.covariance import clear
from estimators.navigator.layout import (
    ACCEL_BIAS,
    ACCEL_MATRIX,
    BASELINE,
    FAST_TIME,
    FIELD,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_MATRIX,
    GYRO_SLOW,
    HARD_IRON,
    LATE,
    MAG_MATRIX,
    PHI,
    POS,
    SLOW_TIME,
    VEL,
    WANDER,
    Carry,
    Memory,
    N,
    Nominal,
    Parameters,
    Work,
)
from estimators.past import SLOTS, WIDTH
from estimators.records import Place, Sheet
from estimators.rotations import attitude_matrix
from estimators.turned import begin as begin_turned

FLICKER = 1.29  # sigma of a Gauss-Markov term one decade wide, over the floor of the Allan deviation
SCALE_TIME = 5.0  # s, how long a rate lasts
ALIGNMENT_SHARE = 4.0  # alignment and calibration states come from the same readings: it counts as this much wider
EARTH_RATE = 7.292115e-5  # rad/s
LOST_ANGLE, LOST_SPEED = 0.5, 10.0  # rad, m/s: sigmas when the filter begins anew


@inner
def configure(settings: Record, site: Place, sensors: Sheet, out: Parameters) -> None:
    """Set the parameters that are constant during a flight; settings: see the catalogue."""
    flicker = FLICKER * sensors.gyro_instability
    gyro = sensors.gyro_noise**2 / 2.0  # single-sided density d: variance d^2/2 per second
    gyro += 2.0 * flicker**2 * 1.1  # the terms of 1 s and 0.1 s
    out.gravity = site.gravity
    for i in range(3):
        out.origin[i], out.mag_n[i], out.antenna_b[i] = site.lla[i], site.mag_n[i], sensors.antenna_b[i]
    out.gyro_delay, out.accel_delay = sensors.gyro_delay, sensors.accel_delay
    out.gyro_psd = gyro + settings.gyro_noise**2 / 2.0 + 1e-12
    out.rate_noise = 2.0 * SCALE_TIME * (settings.scale_share * sensors.gyro_scale) ** 2
    out.jerk_share = settings.jerk_share
    out.accel_psd = sensors.accel_noise**2 / 2.0 + settings.accel_noise**2 / 2.0
    out.shake_share, out.shake_most = settings.shake_share, settings.shake_most**2 / 2.0
    out.accel_noise2 = settings.accel_share**2 / 2.0
    out.iron_step = sensors.mag_wander**2
    out.still_rate, out.still_force = still_limits(sensors)
    out.gnss_velocity = max(settings.velocity_share * LEVEL * sensors.gnss_vel, 1e-3)
    out.gnss_position = max(settings.position_share * max(sensors.gnss_pos, 1e-3), 1e-3)
    out.gnss_time = settings.gnss_time
    out.mag_noise = max(sensors.mag_noise, 1e-9)
    mag_n = site.mag_n
    strength = math.sqrt(mag_n[0] * mag_n[0] + mag_n[1] * mag_n[1] + mag_n[2] * mag_n[2])
    out.mag_floor, out.mag_shake = settings.mag_floor * strength, settings.mag_shake * strength
    out.baseline_share = settings.heading_share
    out.surprise, out.field_off, out.use_heading = settings.surprise, settings.field_off, settings.heading_aid
    _wander(settings, sensors, flicker, out)


@inner
def _wander(settings: Record, sensors: Sheet, flicker: float, out: Parameters) -> None:
    """How the constants change: decay, walk, and the variance that what decays settles at."""
    for i in range(N):
        out.decay[i] = out.walk[i] = out.settled[i] = 0.0
    position = max(sensors.gnss_pos, 1e-3)
    wander = position * math.sqrt(max(1.0 - settings.position_share**2, 0.0))
    baseline = sensors.heading * math.sqrt(max(1.0 - settings.heading_share**2, 0.0))
    for i in range(3):
        out.walk[POS + i] = 1e-6
        out.walk[GYRO_BIAS + i] = (flicker**2 + sensors.gyro_drift**2) / settings.bias_time
        accel = 2.0 * (FLICKER * sensors.accel_instability) ** 2 + sensors.accel_drift**2
        out.walk[ACCEL_BIAS + i] = accel / settings.bias_time
        out.walk[HARD_IRON + i] = sensors.mag_wander**2 / settings.iron_time
        out.decay[GYRO_FAST + i], out.settled[GYRO_FAST + i] = 1.0 / FAST_TIME, flicker**2
        out.decay[GYRO_SLOW + i], out.settled[GYRO_SLOW + i] = 1.0 / SLOW_TIME, flicker**2
        out.decay[WANDER + i] = 1.0 / settings.position_time
        out.settled[WANDER + i] = (wander * UP if i == 2 else wander) ** 2
    out.decay[BASELINE], out.settled[BASELINE] = 1.0 / settings.heading_time, baseline**2


@inner
def _deviations(settings: Record, sensors: Sheet, alignment: Alignment, sigma: np.ndarray) -> None:
    """`sigma` (N,) = first sigmas of the error state."""
    for i in range(N):
        sigma[i] = 0.0
    known = math.isfinite(alignment.vel_n[0] * alignment.vel_n[1] * alignment.vel_n[2])
    for i in range(3):
        wide = min(ALIGNMENT_SHARE * alignment.sigma_n[i], NO_HEADING)
        sigma[PHI + i] = wide if alignment.still else alignment.sigma_n[i]
        sigma[VEL + i] = 3.0 if known else 30.0 if alignment.moving else 0.1
        sigma[POS + i] = 100.0
        sigma[GYRO_BIAS + i] = max(sensors.gyro_bias, 1e-5)
        sigma[ACCEL_BIAS + i] = max(sensors.accel_bias, 1e-4)
        sigma[HARD_IRON + i] = settings.prior_share * hypot(sensors.mag_bias, sensors.mag_wander)
        sigma[FIELD + i] = settings.prior_share * sensors.field_error[i]
    soft = sensors.soft_iron / math.sqrt(2.0)
    for i in range(9):
        scale = i % 4 == 0  # on the diagonal
        gyro = sensors.gyro_scale_factor if scale else sensors.gyro_misalignment
        accel = sensors.accel_scale_factor if scale else sensors.accel_misalignment
        mag = hypot(sensors.mag_scale_factor, sensors.soft_iron) if scale else hypot(sensors.mag_misalignment, soft)
        sigma[GYRO_MATRIX + i] = settings.prior_share * gyro
        sigma[ACCEL_MATRIX + i] = settings.prior_share * accel
        sigma[MAG_MATRIX + i] = settings.prior_share * mag
    sigma[BASELINE + 1] = sigma[BASELINE + 2] = sensors.heading_mount
    sigma[LATE] = settings.late_sigma


@inner
def start(
    model: Parameters, settings: Record, site: Place, sensors: Sheet, alignment: Alignment, carry: Carry, work: Work
) -> None:
    """Set the first state and its covariance."""
    sigma, nominal, P = work.dx, carry.nominal, carry.P
    _deviations(settings, sensors, alignment, sigma)
    for i in range(N):
        again = LOST_ANGLE if PHI <= i < PHI + 3 else LOST_SPEED if VEL <= i < VEL + 3 else sigma[i]
        for j in range(N):
            P[i, j] = carry.P_restart[i, j] = 0.0
        P[i, i] = sigma[i] * sigma[i] + model.settled[i]
        carry.P_restart[i, i] = again * again + model.settled[i]
        nominal.c[i], work.keep[i] = 0.0, 1.0
    if alignment.still:
        _learn_bias(site, alignment, P, nominal.c)
    moves = math.isfinite(alignment.vel_n[0] * alignment.vel_n[1] * alignment.vel_n[2])
    placed = math.isfinite(alignment.lla[0] * alignment.lla[1] * alignment.lla[2])
    nominal.q[3] = alignment.q_nb[3]
    for i in range(3):
        nominal.q[i] = alignment.q_nb[i]
        nominal.v[i] = alignment.vel_n[i] if moves else 0.0
        nominal.lla[i] = alignment.lla[i] if placed else site.lla[i]
    clear(carry.batch)
    _forget(carry.memory)
    copy(nominal, carry.safe)


@inner
def _learn_bias(site: Place, alignment: Alignment, P: np.ndarray, c: np.ndarray) -> None:
    """Condition the terms of the gyro's bias on their sum, the mean rate of the alignment less the Earth's."""
    C, at, prior, gain = local(3, 3), (GYRO_BIAS, GYRO_FAST, GYRO_SLOW), local(3), local(3)
    attitude_matrix(alignment.q_nb, C)
    north, down = EARTH_RATE * cos(site.lla[0]), EARTH_RATE * -sin(site.lla[0])
    for i in range(3):
        for a in range(3):
            prior[a] = P[at[a] + i, at[a] + i]
        sigma = alignment.gyro_bias_sigma[i]
        variance = prior[0] + prior[1] + prior[2] + sigma * sigma
        rate = alignment.gyro_bias[i] - (C[i, 0] * north + C[i, 2] * down)
        for a in range(3):
            gain[a] = prior[a] / variance
            c[at[a] + i] = gain[a] * rate
        for a in range(3):
            for b in range(3):
                P[at[a] + i, at[b] + i] -= gain[a] * gain[b] * variance


@inner
def _forget(memory: Memory) -> None:
    """Begin with nothing seen."""
    memory.last_t = memory.good_t = memory.batch_t = memory.second_t = math.nan
    memory.aid_t = memory.fix_t = memory.mag_t = memory.wrong_baseline_t = math.nan
    for i in range(6):
        memory.last[i // 3, i % 3] = memory.steady[i // 3, i % 3] = math.nan
        memory.mean[i // 3, i % 3] = memory.step[i // 3, i % 3] = 0.0
        memory.second[0, i] = memory.second[1, i] = 0.0
    memory.speed = memory.surprise = math.nan
    memory.still = memory.was_still = memory.count = memory.jerk = memory.shake = 0.0
    memory.good = memory.field_noise = memory.speed_noise = 1.0
    begin_turned(memory.turned)
    memory.past.newest = math.nan
    for i in range(SLOTS):
        memory.past.t[i] = math.nan
        for j in range(WIDTH):
            memory.past.values[i, j] = math.nan


@inner
def copy(given: Nominal, to: Nominal) -> None:
    """Copy the state."""
    to.q[3] = given.q[3]
    for i in range(3):
        to.q[i], to.v[i], to.lla[i] = given.q[i], given.v[i], given.lla[i]
    for i in range(N):
        to.c[i] = given.c[i]
