"""What corrects the state: a fix, the field, the baseline of a dual antenna, standing still.

Each fills the slopes of at most three numbers at a time and has them taken in. All are linearised at the state before
the first of a row; the sum of the corrections is applied at the end of the row.
"""

import math

import numpy as np

from estimators.earth import apart, move
from estimators.elementary import atan2
from estimators.jit import inner
from estimators.native import local
from estimators.navigator.covariance import absorb, nis
from estimators.navigator.history import ANGLES, CARRIED
from estimators.navigator.layout import (
    BASELINE,
    FIELD,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_SLOW,
    HARD_IRON,
    LATE,
    MAG_MATRIX,
    PHI,
    POS,
    VEL,
    WANDER,
    Batch,
    Carry,
    Memory,
    Nominal,
    Parameters,
    Work,
)
from estimators.navigator.strapdown import Triple
from estimators.past import WIDTH, keep, recall
from estimators.records import Estimate, Sample
from estimators.rotations import nav_vector, wrap, yaw
from estimators.turned import carried, note_fix, refuse_field

Z_VELOCITY, Z_PLACE, Z_FIELD, Z_BASELINE = 0, 3, 6, 9  # in the innovations
MAX_FIELD, MAX_SPEED = 0.01, 2000.0  # T, m/s: beyond is no measurement
STILL_SPEED = 0.05  # m/s
WRONG_FIX = 20.0  # s, for which a baseline that contradicts what it has said is left out: a wrong ambiguity
USUAL, MOST = 1.4, 20.0  # innovation squared over its variance, above which a noise is raised; by how much at most
NOISE_TIME = 20.0  # s, in which it follows
SHAKEN2 = math.radians(1.0) ** 2  # (rad/s)^2, variance of the gyro between samples: more is vibration
MANOEUVRE = 1.0  # m/s2, the least acceleration that shows a delay where there is some
UP = 1.5  # satellites are all above: vertical errors are larger by about that
LEVEL = math.sqrt(3.0 / (2.0 + UP**2))  # of a data sheet's sigma, the mean over the axes: north and east


@inner
def put(work: Work, row: int, column: int, value: float) -> None:
    """Add a term to the slope of measurement `row`."""
    k = work.terms[row]
    work.at[row, k], work.by[row, k] = column, value
    work.terms[row] = k + 1


@inner
def begin(work: Work, row: int, residual: float, variance: float) -> None:
    """A measurement: measured minus predicted, its variance; no slope yet."""
    work.residual[row], work.variance[row], work.terms[row] = residual, variance, 0


@inner
def take(model: Parameters, memory: Memory, P: np.ndarray, work: Work, rows: int, first: int, answer: Estimate) -> None:
    """Take in the measurements of `work`; what surprises too much counts as noisier, as by a heavy-tailed error."""
    surprise = nis(P, work, rows)
    memory.surprise = surprise
    if surprise > model.surprise:
        for i in range(rows):
            work.variance[i] *= surprise / model.surprise
    for i in range(rows):
        r, variance = absorb(P, work, i)
        if first >= 0:
            answer.innovation[first + i], answer.innovation_var[first + i] = r, variance


@inner
def followed(memory: Memory, raised: float, dt: float, times: float) -> float:
    """The factor on a noise, after dt (s), that brings the innovation just taken in, `times` as large, to its size."""
    excess = min(times * memory.surprise, MOST) - USUAL
    share = min(dt, 1.0) / NOISE_TIME if dt > 0.0 else 0.0
    return float(min(max(raised * (1.0 + share * excess), 1.0), MOST))


@inner
def remember(model: Parameters, nominal: Nominal, memory: Memory, w: Triple, t: float) -> None:
    """Keep what late measurements are compared with."""
    a, q, now = model.antenna_b, nominal.q, local(WIDTH)
    swing = nav_vector(q, w[1] * a[2] - w[2] * a[1], w[2] * a[0] - w[0] * a[2], w[0] * a[1] - w[1] * a[0])
    lever = nav_vector(q, a[0], a[1], a[2])
    for i in range(3):
        now[i] = nominal.v[i] + swing[i]
    move(nominal.lla, lever[0], lever[1], lever[2], now[3:6])
    now[6] = yaw(q)
    now[CARRIED], now[CARRIED + 1] = carried(memory.turned, swing[0], swing[1])
    keep(memory.past, t, now)


@inner
def take_fix(model: Parameters, carry: Carry, work: Work, row: Sample, f_n: Triple, answer: Estimate) -> None:
    """Velocity and place of the antenna, compared with those kept from the time when they were true."""
    c, P, memory, then, off = carry.nominal.c, carry.P, carry.memory, local(WIDTH), local(3)
    t, vel_n, lla = row.t, row.vel_n, row.lla
    true_t = row.gnss_t - c[LATE]
    if not recall(memory.past, true_t, ANGLES, then):
        return
    tau = t - true_t
    a_n = (f_n[0], f_n[1], f_n[2] + model.gravity)
    time2 = model.gnss_time * model.gnss_time
    speed = True
    for i in range(3):
        speed &= abs(vel_n[i]) < MAX_SPEED
    if speed:
        steady, raised = memory.steady[1], memory.speed_noise
        lasting = steady[0] ** 2 + steady[1] ** 2 + (steady[2] + model.gravity) ** 2 - memory.shake
        shown = memory.jerk < SHAKEN2 or lasting > MANOEUVRE**2
        for i in range(3):
            wide = UP if i == 2 else 1.0
            noise = raised * (wide * model.gnss_velocity) ** 2 + time2 * a_n[i] * a_n[i]
            begin(work, i, vel_n[i] - then[i], noise)
            put(work, i, VEL + i, 1.0)
            if shown:  # else what shakes the accelerometer would go for a delay
                put(work, i, LATE, -steady[i] - (model.gravity if i == 2 else 0.0))
        take(model, memory, P, work, 3, Z_VELOCITY, answer)
        memory.speed_noise = followed(memory, raised, t - memory.fix_t, 1.0)
        memory.aid_t = memory.fix_t = t
        note_fix(memory.turned, true_t, vel_n[0], vel_n[1], then[CARRIED], then[CARRIED + 1])
        memory.speed = math.sqrt(vel_n[0] ** 2 + vel_n[1] ** 2 + vel_n[2] ** 2)
    if abs(lla[0]) < 1.58 and abs(lla[1]) < 6.3 and abs(lla[2]) < 1e6:
        apart(lla, then[3:6], off)
        for i in range(3):
            wide = UP if i == 2 else 1.0
            noise = (wide * model.gnss_position) ** 2 + time2 * then[i] * then[i]
            begin(work, i, off[i] - c[WANDER + i], noise)
            put(work, i, POS + i, 1.0)
            put(work, i, VEL + i, -tau)
            put(work, i, WANDER + i, 1.0)
            put(work, i, LATE, -then[i])
        if abs(off[0]) + abs(off[1]) + abs(off[2]) < 1e6:
            take(model, memory, P, work, 3, Z_PLACE, answer)


@inner
def add_field(model: Parameters, nominal: Nominal, batch: Batch, C: np.ndarray, field_b: np.ndarray) -> None:
    """Add a reading of the magnetometer (T) to the batch: what it is off, and how that depends on the state."""
    c, u, B = nominal.c, local(3), local(3)
    for i in range(3):
        B[i] = model.mag_n[i] + c[FIELD + i]
        batch.read[0] += C[i, 0] * field_b[i]
        batch.read[1] += C[i, 1] * field_b[i]
    for i in range(3):
        u[i] = C[i, 0] * B[0] + C[i, 1] * B[1] + C[i, 2] * B[2]
    for i in range(3):
        a = i * 3 + MAG_MATRIX
        slope = batch.field_slope[i]
        row = (c[a] + (i == 0), c[a + 1] + (i == 1), c[a + 2] + (i == 2))  # of I + M
        batch.field[i] += field_b[i] - (row[0] * u[0] + row[1] * u[1] + row[2] * u[2] + c[HARD_IRON + i])
        north = row[0] * C[0, 0] + row[1] * C[1, 0] + row[2] * C[2, 0]
        east = row[0] * C[0, 1] + row[1] * C[1, 1] + row[2] * C[2, 1]
        down = row[0] * C[0, 2] + row[1] * C[1, 2] + row[2] * C[2, 2]
        slope[PHI] += east * B[2] - down * B[1]  # C_bn exp(-phi) B = C_bn (B + B x phi)
        slope[PHI + 1] += down * B[0] - north * B[2]
        slope[PHI + 2] += north * B[1] - east * B[0]
        slope[FIELD] += north
        slope[FIELD + 1] += east
        slope[FIELD + 2] += down
        for j in range(3):
            for k in range(3):
                slope[MAG_MATRIX + 3 * j + k] += row[j] * u[k]
    batch.fields += 1.0


@inner
def take_field(model: Parameters, carry: Carry, work: Work, t: float, answer: Estimate) -> None:
    """The mean of the readings of a batch, all three components, unless motion contradicts it."""
    P, batch, memory = carry.P, carry.batch, carry.memory
    n = batch.fields
    if n == 0.0:
        return
    turn = atan2(model.mag_n[1], model.mag_n[0]) - atan2(batch.read[1], batch.read[0])  # as if nothing were learnt
    if refuse_field(memory.turned, t, wrap(turn), model.gnss_velocity, model.field_off):
        return
    raised = memory.field_noise
    once = model.mag_floor**2 + (model.mag_shake * memory.jerk) ** 2
    for i in range(3):
        begin(work, i, batch.field[i] / n, raised * raised * (model.mag_noise**2 / n + once))
        for j in range(3):
            put(work, i, PHI + j, batch.field_slope[i, PHI + j] / n)
            put(work, i, FIELD + j, batch.field_slope[i, FIELD + j] / n)
        for j in range(MAG_MATRIX, MAG_MATRIX + 9):
            put(work, i, j, batch.field_slope[i, j] / n)
        put(work, i, HARD_IRON + i, 1.0)
    take(model, memory, P, work, 3, Z_FIELD, answer)
    # what its innovations have too much is no white noise: it is raised by as much again
    memory.field_noise = followed(memory, raised, t - memory.mag_t, raised)
    memory.mag_t = t


@inner
def take_baseline(model: Parameters, carry: Carry, work: Work, row: Sample, answer: Estimate) -> None:
    """Azimuth of the dual antenna's baseline, compared with the yaw kept from the time when it was true."""
    c, C, P, memory, then = carry.nominal.c, work.C, carry.P, carry.memory, local(WIDTH)
    heading, reported = row.heading, row.heading_sigma
    if not (abs(heading) < 100.0 and 0.0 < reported < 10.0):
        return
    if not recall(memory.past, row.heading_t, ANGLES, then):
        return
    north, east, down = C[0, 0], C[0, 1], C[0, 2]
    horizontal2 = north * north + east * east
    if horizontal2 < 0.03:  # points up or down
        return
    yaw_share = (north * C[1, 1] - east * C[1, 0]) / horizontal2
    pitch_share = -(north * C[2, 1] - east * C[2, 0]) / horizontal2
    predicted = then[6] + c[BASELINE] + c[BASELINE + 1] * yaw_share + c[BASELINE + 2] * pitch_share
    sigma = model.baseline_share * reported
    begin(work, 0, wrap(heading - predicted), sigma * sigma)
    put(work, 0, PHI, -down * north / horizontal2)
    put(work, 0, PHI + 1, -down * east / horizontal2)
    put(work, 0, PHI + 2, 1.0)
    put(work, 0, BASELINE, 1.0)
    put(work, 0, BASELINE + 1, yaw_share)
    put(work, 0, BASELINE + 2, pitch_share)
    if nis(P, work, 1) <= model.surprise:
        memory.wrong_baseline_t = row.t
    elif row.t - memory.wrong_baseline_t < WRONG_FIX:
        return
    take(model, memory, P, work, 1, Z_BASELINE, answer)


@inner
def take_standstill(model: Parameters, carry: Carry, work: Work, t: float, answer: Estimate) -> None:
    """No velocity, and no rate but the Earth's."""
    P, batch, memory, v = carry.P, carry.batch, carry.memory, carry.nominal.v
    seconds = batch.seconds
    if not seconds > 0.0:
        return
    for i in range(3):
        begin(work, i, -v[i], STILL_SPEED**2)
        put(work, i, VEL + i, 1.0)
    take(model, memory, P, work, 3, -1, answer)
    for i in range(3):
        begin(work, i, batch.rate[i] / seconds, 4.0 * model.gyro_psd / seconds)
        for column in (GYRO_BIAS, GYRO_FAST, GYRO_SLOW):
            put(work, i, column + i, 1.0)
    take(model, memory, P, work, 3, -1, answer)
    memory.aid_t = t
