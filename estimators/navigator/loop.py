"""The estimation loop: row by row through a block.

Attitude, velocity and place move at every row; the covariance in batches of `BATCH_S`, which end early where a fix or a
baseline arrives. Time stamps decide: dt is their difference. A row whose stamp repeats or goes back is left out (the
estimate stays, status COASTING); a gap is bridged by prediction in steps of at most `MAX_STEP`.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from estimators.alignment import MEAN_RATE
from estimators.earth import frame_rates
from estimators.earth import move as moved
from estimators.elementary import ceil
from estimators.jit import njit
from estimators.navigator.aids import (
    MAX_FIELD,
    add_field,
    remember,
    take_baseline,
    take_field,
    take_fix,
    take_standstill,
)
from estimators.navigator.covariance import clear, move, note_end, note_motion, symmetric
from estimators.navigator.history import correct as correct_past
from estimators.navigator.layout import (
    ACCEL_BIAS,
    ACCEL_MATRIX,
    COUNT,
    FIELD,
    FORCE_VARIANCE,
    GOOD,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_MATRIX,
    GYRO_SLOW,
    GYRO_VARIANCE,
    HARD_IRON,
    IS_STILL,
    JERK,
    MAG_MATRIX,
    PHI,
    POS,
    SHAKE,
    SPEED,
    SURPRISE,
    T_AID,
    T_BATCH,
    T_GNSS,
    T_GOOD,
    T_LAST,
    T_MAG,
    T_SECOND,
    VEL,
    WAS_STILL,
    Batch,
    Memory,
    N,
    Nominal,
)
from estimators.navigator.strapdown import Triple, advance, true_force, true_rate
from estimators.rotations import attitude_matrix, nav_vector, normalise, turn_nav, turned
from estimators.turned import is_lost, note_correction, note_force, turned_by
from estimators.types import MEASUREMENTS, Status

BATCH_S = 0.1
SOUND, ANEW, LOST = range(3)  # how a batch ends
WRONG_TILT = 0.15  # rad, that a wrong heading has made
MAX_STEP, MAX_STEPS = 0.5, 120  # s; a longer gap than a minute is bridged with longer steps
MAX_RATE, MAX_FORCE = 100.0, 2000.0  # rad/s, m/s2
JERK_TIME = 0.3  # s, over which the gyro's scatter between samples is averaged
AID_TIMEOUT, MAG_TIMEOUT = 2.0, 2.0  # s
STILL_SPEED = 0.2  # m/s
FASTEST = 30.0  # rad/s: beyond, it is no rate
BLIND_PSD = 0.01  # rad2/s while gyro or accelerometer are missing: whatever happens meanwhile
_RUNNING, _COASTING, _DIVERGED = int(Status.RUNNING), int(Status.COASTING), int(Status.DIVERGED)


class Carry(NamedTuple):
    """Everything that goes on from row to row."""

    nominal: Nominal
    P: np.ndarray  # (N, N)
    P_restart: np.ndarray  # (N, N), when the filter is lost
    batch: Batch
    memory: Memory
    safe: np.ndarray  # (10 + N,) nominal state when the covariance was last sound


@njit
def run(model: Any, carry: Any, work: Any, rows: Any, out: Any, first: int) -> None:
    """Rows `first` to the end of samples into estimates."""
    nominal, P, batch, memory = carry.nominal, carry.P, carry.batch, carry.memory
    for k in range(first, rows.t.shape[0]):
        t = rows.t[k]
        dt = t - memory.clock[T_LAST]
        if dt <= 0.0:
            out.status[k] = _COASTING
            report(model, nominal, P, memory, work, out, k)
            continue
        if math.isnan(dt):  # the first row of all
            memory.clock[T_BATCH] = t
            dt = 0.0
        memory.clock[T_LAST] = t
        read_inertial(t, rows.gyro_b[k], rows.accel_b[k], memory)
        f_n = predict(model, carry, work, dt, k)
        remember(model, nominal, memory, true_rate(nominal.c, memory.mean[0]), t)
        attitude_matrix(nominal.q, work.C)
        if rows.mag_new[k] and is_field(rows.mag_b[k]):
            add_field(model, nominal, batch, work.C, rows.mag_b[k])
        ended = SOUND
        due = rows.gnss_new[k] or (model.use_heading and rows.heading_new[k])
        if due or t - memory.clock[T_BATCH] >= BATCH_S - 1e-6:
            ended = correct(model, carry, work, rows, k, f_n, out)
            note_end(work.tape, work, P, ended != SOUND, k)
        aided = t - memory.clock[T_AID] <= AID_TIMEOUT and t - memory.clock[T_MAG] <= MAG_TIMEOUT
        out.status[k] = _RUNNING if aided and memory.seen[GOOD] == 1.0 and dt <= MAX_STEP else _COASTING
        if ended == LOST:
            out.status[k] = _DIVERGED
            for i in range(MEASUREMENTS):
                out.innovation[k, i] = out.innovation_var[k, i] = math.nan
        report(model, nominal, P, memory, work, out, k)


@njit
def read_inertial(t: float, gyro: np.ndarray, accel: np.ndarray, memory: Any) -> None:
    """Mean rate and force of the step that ends with a row: of its two ends; the last good ones where it has none."""
    good = True
    for i in range(3):
        good &= abs(gyro[i]) < MAX_RATE and abs(accel[i]) < MAX_FORCE
    memory.seen[GOOD] = 1.0 if good else 0.0
    if not good:
        return
    last, mean = memory.last, memory.mean
    dt = t - memory.clock[T_GOOD]
    fresh = dt < 0.1
    square, shaken = 0.0, 0.0
    for i in range(3):
        step = gyro[i] - last[0, i] if fresh else 0.0
        square += (step - memory.step[0, i]) ** 2
        memory.step[0, i] = step
        step = accel[i] - last[1, i] if fresh else 0.0
        shaken += (step - memory.step[1, i]) ** 2
        memory.step[1, i] = step
        mean[0, i] = 0.5 * (gyro[i] + last[0, i]) if fresh else gyro[i]
        mean[1, i] = 0.5 * (accel[i] + last[1, i]) if fresh else accel[i]
        last[0, i], last[1, i] = gyro[i], accel[i]
    if (
        fresh
    ):  # what turns too fast for the sampling (an impact, vibration): a sixth of the second differences' variance
        share = min(dt / JERK_TIME, 1.0)
        memory.seen[JERK] += share * (square / 18.0 - memory.seen[JERK])
        memory.seen[SHAKE] += share * (shaken / 18.0 - memory.seen[SHAKE])
    memory.clock[T_GOOD] = t


@njit
def predict(model: Any, carry: Any, work: Any, dt: float, k: int) -> Triple:
    """Move the state to row k; the force there, in navigation axes (m/s2)."""
    nominal, batch, memory = carry.nominal, carry.batch, carry.memory
    good = memory.seen[GOOD] == 1.0
    if good:
        watch_second(model, nominal.c, memory)
    w, f = true_rate(nominal.c, memory.mean[0]), true_force(nominal.c, memory.mean[1])
    f_n = nav_vector(nominal.q, f[0], f[1], f[2])
    rate2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    a2 = f_n[0] * f_n[0] + f_n[1] * f_n[1] + (f_n[2] + model.gravity) ** 2
    steps = 1 if dt <= MAX_STEP else min(MAX_STEPS, ceil(dt / MAX_STEP))
    part = dt / steps
    psd = model.gyro_psd + model.rate_noise * rate2 + model.jerk_share * part * memory.seen[JERK]
    if not good or dt > MAX_STEP:
        psd += BLIND_PSD
    force_psd = model.accel_psd + model.accel_noise2 * a2
    force_psd += min(model.shake_share * part * memory.seen[SHAKE], model.shake_most)
    for _ in range(steps):
        if part > 0.0:
            f_n = advance(model, nominal, batch, work.C, w, f, part)
            note_force(memory.turned, f_n[0], f_n[1], part)
            batch.total[GYRO_VARIANCE] += psd * part
            batch.total[FORCE_VARIANCE] += force_psd * part
        if steps > 1:
            move(model, nominal.c, carry.P, batch, work)
            note_motion(work.tape, work, batch.F)
            for i in range(N):
                work.dx[i] = 0.0
            note_end(work.tape, work, carry.P, False, k)
            clear(batch)
    # the rate that the gyro says beyond the Earth's, for standing still
    ie_n, ie_d, _, _, _ = frame_rates(nominal.lla, nominal.v)
    for i in range(3):
        batch.rate[i] += (w[i] - work.C[i, 0] * ie_n - work.C[i, 2] * ie_d) * part
    return f_n


@njit
def watch_second(model: Any, c: np.ndarray, memory: Any) -> None:
    """Standstill detector: scatter and mean rate of each second."""
    t, second, seen = memory.clock[T_GOOD], memory.second, memory.seen
    if not t - memory.clock[T_SECOND] < 1.0:
        n = seen[COUNT]
        still = n >= 10.0
        for i in range(3):
            still = still and second[1, i] < n * model.still[0] ** 2 and second[1, 3 + i] < n * model.still[1] ** 2
            still = still and abs(second[0, i] - c[GYRO_BIAS + i]) < MEAN_RATE
        seen[IS_STILL] = 1.0 if still else 0.0
        memory.clock[T_SECOND], seen[COUNT] = t, 0.0
        for i in range(6):
            second[0, i] = second[1, i] = 0.0
    seen[COUNT] += 1.0
    for i in range(6):
        value = memory.last[i // 3, i % 3]
        off = value - second[0, i]
        second[0, i] += off / seen[COUNT]
        second[1, i] += off * (value - second[0, i])
    for i in range(3):  # moved off in mid-second
        if abs(memory.last[0, i] - c[GYRO_BIAS + i]) > 5.0 * model.still[0]:
            seen[IS_STILL] = 0.0
    moving = t - memory.clock[T_GNSS] < 1.0 and seen[SPEED] > STILL_SPEED + 3.0 * model.gnss_velocity
    if moving:  # a smooth acceleration scatters as little as standing
        seen[IS_STILL] = 0.0


@njit
def correct(model: Any, carry: Any, work: Any, rows: Any, k: int, f_n: Triple, out: Any) -> int:
    """End a batch: the covariance, then whatever has been measured; SOUND, or begun ANEW, or LOST and begun anew."""
    nominal, P, batch, memory, dx = carry.nominal, carry.P, carry.batch, carry.memory, work.dx
    t, anew = rows.t[k], False
    move(model, nominal.c, P, batch, work)
    note_motion(work.tape, work, batch.F)
    for i in range(N):
        dx[i] = 0.0
    if is_lost(memory.turned, t, math.isnan(memory.clock[T_MAG]), model.gnss_velocity, model.field_off):
        set_heading(model, carry, dx, t)
        anew = True
    if rows.gnss_new[k]:
        take_fix(model, nominal, memory, P, work, rows, k, f_n, out)
    if memory.seen[IS_STILL] < memory.seen[WAS_STILL]:
        for i in range(HARD_IRON, HARD_IRON + 3):
            P[i, i] += model.iron_step
    memory.seen[WAS_STILL] = memory.seen[IS_STILL]
    take_field(model, memory, P, batch, work, t, out, k)
    if model.use_heading and rows.heading_new[k]:
        take_baseline(model, nominal, memory, P, work, rows, k, out)
    if memory.seen[IS_STILL] == 1.0:
        take_standstill(model, nominal, memory, P, batch, work, t, out, k)
    symmetric(P)
    retract(nominal, dx)
    note_correction(memory.turned, dx[PHI + 2])
    correct_past(memory.history, t, dx)
    clear(batch)
    memory.clock[T_BATCH] = t
    if healthy(nominal, P):
        store(nominal, carry.safe)
        return ANEW if anew else SOUND
    recover(nominal, carry.safe)
    for i in range(N):
        for j in range(N):
            P[i, j] = carry.P_restart[i, j]
    return LOST


@njit
def set_heading(model: Any, carry: Any, dx: np.ndarray, t: float) -> None:
    """Turn to the heading that motion shows; what a wrong one has taught is forgotten, but for place and gyro bias."""
    P, c = carry.P, carry.nominal.c
    turn, sigma = turned_by(carry.memory.turned, t, model.gnss_velocity)
    for i in range(N):
        for j in range(N):
            P[i, j] = carry.P_restart[i, j]
        if i >= ACCEL_BIAS:
            c[i] = 0.0
    dx[PHI + 2] = turn
    P[PHI, PHI] = P[PHI + 1, PHI + 1] = WRONG_TILT**2
    P[PHI + 2, PHI + 2] = sigma * sigma


@njit
def retract(nominal: Any, dx: np.ndarray) -> None:
    """Correct the state by the error dx (N,)."""
    q, lla = nominal.q, nominal.lla
    turn_nav((q[0], q[1], q[2], q[3]), dx[PHI], dx[PHI + 1], dx[PHI + 2], q)
    normalise(q)
    for i in range(3):
        nominal.v[i] += dx[VEL + i]
    moved((lla[0], lla[1], lla[2]), dx[POS], dx[POS + 1], dx[POS + 2], lla)
    for i in range(9, N):
        if not (GYRO_MATRIX <= i < HARD_IRON or MAG_MATRIX <= i < FIELD):
            nominal.c[i] += dx[i]
    for at in (GYRO_MATRIX, ACCEL_MATRIX, MAG_MATRIX):  # (I + M) (I + E)
        for i in range(0, 9, 3):
            x, y, z = nominal.c[at + i], nominal.c[at + i + 1], nominal.c[at + i + 2]
            for j in range(3):
                nominal.c[at + i + j] += dx[at + i + j] + x * dx[at + j] + y * dx[at + 3 + j] + z * dx[at + 6 + j]


@njit
def healthy(nominal: Any, P: np.ndarray) -> bool:
    """Tell whether all states are finite and no variance is negative or infinite."""
    total = 0.0
    for part in (nominal.q, nominal.v, nominal.lla, nominal.c):
        for i in range(part.shape[0]):
            total += part[i] * 0.0  # NaN when any is infinite or NaN
    positive = True
    for i in range(N):
        total += P[i, i] * 0.0
        positive &= P[i, i] >= 0.0
    return positive and total == 0.0


@njit
def store(nominal: Any, safe: np.ndarray) -> None:
    """`safe` = the state."""
    safe[0:4] = nominal.q
    safe[4:7] = nominal.v
    safe[7:10] = nominal.lla
    safe[10:] = nominal.c


@njit
def recover(nominal: Any, safe: np.ndarray) -> None:
    """The state = `safe`."""
    nominal.q[:] = safe[0:4]
    nominal.v[:] = safe[4:7]
    nominal.lla[:] = safe[7:10]
    nominal.c[:] = safe[10:]


@njit
def report(model: Any, nominal: Any, P: np.ndarray, memory: Any, work: Any, out: Any, k: int) -> None:
    """Row k of estimates from the state, turned and moved on to the time of the stamp."""
    c, C, q, ahead = nominal.c, work.C, (nominal.q[0], nominal.q[1], nominal.q[2], nominal.q[3]), model.accel_delay
    v_n, lla, a_n = nominal.v, nominal.lla, (0.0, 0.0, 0.0)
    if not math.isnan(memory.last[0, 0]):
        f = true_force(c, memory.last[1])
        f_n = nav_vector(q, f[0], f[1], f[2])
        a_n = (f_n[0], f_n[1], f_n[2] + model.gravity)
        w = true_rate(c, memory.last[0])
        q = turned(q, model.gyro_delay * w[0], model.gyro_delay * w[1], model.gyro_delay * w[2])
    moved(lla, ahead * v_n[0], ahead * v_n[1], ahead * v_n[2], out.lla[k])
    for i in range(4):
        out.q_nb[k, i] = q[i]
    attitude_matrix(out.q_nb[k], C)
    for i in range(3):
        out.down_b[k, i] = C[i, 2]
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += C[i, a] * P[PHI + a, PHI + b] * C[j, b]
            out.att_cov[k, i, j] = out.att_cov[k, j, i] = total
        bias, variance = 0.0, 0.0
        for a in (GYRO_BIAS + i, GYRO_FAST + i, GYRO_SLOW + i):
            bias += c[a]
            for b in (GYRO_BIAS + i, GYRO_FAST + i, GYRO_SLOW + i):
                variance += P[a, b]
        out.gyro_bias[k, i], out.gyro_bias_sigma[k, i] = bias, math.sqrt(max(variance, 0.0))
        out.accel_bias[k, i] = c[ACCEL_BIAS + i]
        out.accel_bias_sigma[k, i] = math.sqrt(max(P[ACCEL_BIAS + i, ACCEL_BIAS + i], 0.0))
        out.vel_n[k, i] = v_n[i] + ahead * a_n[i]
        for j in range(3):
            out.vel_cov[k, i, j], out.pos_cov[k, i, j] = P[VEL + i, VEL + j], P[POS + i, POS + j]
    out.adaptation[k, 0] = memory.seen[IS_STILL]
    out.adaptation[k, 1] = memory.seen[SURPRISE]
    out.adaptation[k, 2] = memory.turned.refused


@njit
def is_field(field_b: np.ndarray) -> bool:
    """Tell whether a reading (T) can be a field; zero on all axes is a dead sensor."""
    size = abs(field_b[0]) + abs(field_b[1]) + abs(field_b[2])
    return bool(0.0 < size < 3.0 * MAX_FIELD)


@njit
def turn_readings(gyro_b: np.ndarray, vector_b: np.ndarray, tau: float) -> None:
    """Turn the readings (n, 3) of a sensor that saw tau (s) earlier than the gyro to the axes of then; in place."""
    for k in range(vector_b.shape[0]):
        w, v = gyro_b[k], vector_b[k]
        if abs(w[0]) + abs(w[1]) + abs(w[2]) < FASTEST:
            x, y, z = nav_vector(turned((1.0, 0.0, 0.0, 0.0), -tau * w[0], -tau * w[1], -tau * w[2]), v[0], v[1], v[2])
            v[0], v[1], v[2] = x, y, z
