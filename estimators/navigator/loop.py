"""The estimation loop: alignment, then row by row.

Attitude, velocity and place move at every row; the covariance in batches of `BATCH_S`, which end early where a fix or a
baseline arrives. Time stamps decide: dt is their difference. A row whose stamp repeats or goes back is left out (the
estimate stays, status COASTING); a gap is bridged by prediction in steps of at most `MAX_STEP`.
"""

import math

import numpy as np

from estimators.alignment import ALIGNMENT, LONGEST_GAP, MEAN_RATE, STILL, STRETCH, conclude, still_limits, take
from estimators.alignment import begin as begin_stretch
from estimators.earth import frame_rates
from estimators.earth import move as moved
from estimators.elementary import ceil
from estimators.jit import inner
from estimators.native import Address, Integer, Kernel, Number, Record, adapts, entry, record
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
    CARRY,
    FIELD,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_MATRIX,
    GYRO_SLOW,
    HARD_IRON,
    MAG_MATRIX,
    PARAMETERS,
    PHI,
    POS,
    VEL,
    WORK,
    Carry,
    Memory,
    N,
    Nominal,
    Parameters,
    Work,
)
from estimators.navigator.settings import VALUES
from estimators.navigator.start import configure, copy, start
from estimators.navigator.strapdown import Triple, advance, true_force, true_rate
from estimators.records import ESTIMATE, PLACE, SAMPLE, SHEET, Estimate, Sample, Sheet
from estimators.rotations import attitude_matrix, nav_vector, normalise, turn_nav, turned
from estimators.run import screen
from estimators.turned import is_lost, note_correction, note_force, turned_by
from estimators.types import MEASUREMENTS, Status

BATCH_S = 0.1
SOUND, ANEW, LOST = range(3)  # how a batch ends
WRONG_TILT = 0.15  # rad, that a wrong heading has made
MAX_STEP, MAX_STEPS = 0.5, 120  # s; a longer gap than a minute is bridged with longer steps
MAX_RATE, MAX_FORCE = 100.0, 2000.0  # rad/s, m/s2
JERK_TIME = 0.3  # s, over which the gyro's scatter between samples is averaged
STEADY = 0.3  # s, of the mean by which errors grow where the unit is shaken: what sampling folds down is out of it
SHAKEN2 = math.radians(2.0) ** 2  # (rad/s)^2, variance of the gyro between samples: that mean is half as long
SHAKEN_S = 0.07  # s: vibration makes the velocity wrong by its acceleration for about so long, back and forth
AID_TIMEOUT, MAG_TIMEOUT = 2.0, 2.0  # s
STILL_SPEED = 0.2  # m/s
FASTEST = 30.0  # rad/s: beyond, it is no rate
BLIND_PSD = 0.01  # rad2/s while gyro or accelerometer are missing: whatever happens meanwhile
_RUNNING, _COASTING, _DIVERGED = int(Status.RUNNING), int(Status.COASTING), int(Status.DIVERGED)


class Instance(Record):
    """A navigator to the loop: addresses of its parts, and where it is."""

    parameters: Address
    carry: Address
    work: Address
    stretch: Address
    alignment: Address
    settings: Address
    site: Address
    sensors: Address
    align_s: Number  # s
    wait_s: Number  # s
    begun: Integer  # 0: aligning
    begin: Address


INSTANCE = Instance.dtype


@entry("p")
def begin(own: Instance) -> None:
    """Begin to navigate with what the alignment says."""


@adapts(begin)
def _adapt_begin(owner: None, kernel: Kernel) -> Kernel:
    def body(pointer):  # type: ignore[no-untyped-def]
        own = record(pointer, INSTANCE)
        stretch, site, sensors = record(own.stretch, STRETCH), record(own.site, PLACE), record(own.sensors, SHEET)
        alignment, model, settings = (
            record(own.alignment, ALIGNMENT),
            record(own.parameters, PARAMETERS),
            record(own.settings, VALUES),
        )
        conclude(stretch, stretch.phase == STILL, site, sensors, alignment)
        configure(settings, site, sensors, model)
        start(model, settings, site, sensors, alignment, record(own.carry, CARRY), record(own.work, WORK))
        own.begun = 1

    return body


@entry("p")
def forget(own: Instance) -> None:
    """Forget everything seen: align anew."""


@inner
def _forget(own: Instance) -> None:
    begin_stretch(record(own.stretch, STRETCH))
    own.begun = 0


@adapts(forget)
def _adapt_forget(owner: None, kernel: Kernel) -> Kernel:
    def body(own):  # type: ignore[no-untyped-def]
        _forget(record(own, INSTANCE))

    return body


@entry("ppip", int)
def process(own: Instance, rows: np.ndarray, count: int, out: np.ndarray) -> int:  # type: ignore[empty-body]
    """As `estimators.run.process`."""


@adapts(process)
def _adapt_process(owner: None, kernel: Kernel) -> Kernel:
    def body(own, rows, count, out):  # type: ignore[no-untyped-def]
        a = record(own, INSTANCE)
        last = record(a.carry, CARRY).memory.last_t if a.begun != 0 else record(a.stretch, STRETCH).last_t
        bad = screen(rows, count, last, record(a.sensors, SHEET), False)
        if bad < 0:
            for k in range(count):
                _estimate(a, record(rows, SAMPLE, k), k, record(out, ESTIMATE, k))
        return bad

    return body


@inner
def _estimate(own: Instance, row: Sample, k: int, answer: Estimate) -> None:
    """Estimate row k of a block, or align with it."""
    stretch, carry = record(own.stretch, STRETCH), record(own.carry, CARRY)
    if row.t - (carry.memory.last_t if own.begun != 0 else stretch.last_t) > LONGEST_GAP:
        _forget(own)
    answer.t = row.t
    sensors = record(own.sensors, SHEET)
    if own.begun == 0:
        gyro, accel = still_limits(sensors)
        if not take(stretch, row, own.align_s, own.wait_s, gyro, accel, record(own.site, PLACE).gravity):
            return
        begin(own)
    _to_gyro_time(row, sensors)
    _step(record(own.parameters, PARAMETERS), carry, record(own.work, WORK), row, k, answer)


@inner
def _to_gyro_time(row: Sample, sensors: Sheet) -> None:
    """Make accelerometer and magnetometer as if they had been read with the gyro; in place."""
    turn_reading(row.gyro_b, row.accel_b, sensors.accel_delay - sensors.gyro_delay)
    turn_reading(row.gyro_b, row.mag_b, sensors.mag_delay - sensors.gyro_delay)
    row.gnss_t += sensors.accel_delay
    row.heading_t += sensors.gyro_delay


@inner
def _step(model: Parameters, carry: Carry, work: Work, row: Sample, k: int, answer: Estimate) -> None:
    """Estimate row k of a block."""
    nominal, memory, t = carry.nominal, carry.memory, row.t
    dt = t - memory.last_t
    if dt <= 0.0:
        answer.status = _COASTING
        report(model, carry, work, answer)
        return
    if math.isnan(dt):  # the first row of all
        memory.batch_t = t
        dt = 0.0
    memory.last_t = t
    read_inertial(t, row.gyro_b, row.accel_b, memory)
    f_n = predict(model, carry, work, dt, k)
    remember(model, nominal, memory, true_rate(nominal.c, memory.mean[0]), t)
    attitude_matrix(nominal.q, work.C)
    if row.mag_new and is_field(row.mag_b):
        add_field(model, nominal, carry.batch, work.C, row.mag_b)
    ended = SOUND
    due = row.gnss_new or (model.use_heading and row.heading_new)
    if due or t - memory.batch_t >= BATCH_S - 1e-6:
        ended = correct(model, carry, work, row, f_n, answer)
        note_end(work, carry.P, ended != SOUND, k)
    aided = t - memory.aid_t <= AID_TIMEOUT and t - memory.mag_t <= MAG_TIMEOUT
    answer.status = _RUNNING if aided and memory.good == 1.0 and dt <= MAX_STEP else _COASTING
    if ended == LOST:
        answer.status = _DIVERGED
        for i in range(MEASUREMENTS):
            answer.innovation[i] = answer.innovation_var[i] = math.nan
    report(model, carry, work, answer)


@inner
def read_inertial(t: float, gyro: np.ndarray, accel: np.ndarray, memory: Memory) -> None:
    """Mean rate and force of the step that ends with a row: of its two ends; the last good ones where it has none."""
    good = True
    for i in range(3):
        good &= abs(gyro[i]) < MAX_RATE and abs(accel[i]) < MAX_FORCE
    memory.good = 1.0 if good else 0.0
    if not good:
        return
    last, mean = memory.last, memory.mean
    dt = t - memory.good_t
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
    if fresh:
        # What turns too fast for the sampling (an impact, vibration): a sixth of the second differences' variance.
        share = min(dt / JERK_TIME, 1.0)
        memory.jerk += share * (square / 18.0 - memory.jerk)
        memory.shake += share * (shaken / 18.0 - memory.shake)
    memory.good_t = t


@inner
def predict(model: Parameters, carry: Carry, work: Work, dt: float, k: int) -> Triple:
    """Move the state to row k; the force there, in navigation axes (m/s2)."""
    nominal, batch, memory = carry.nominal, carry.batch, carry.memory
    good = memory.good == 1.0
    if good:
        watch_second(model, nominal.c, memory)
    w, f = true_rate(nominal.c, memory.mean[0]), true_force(nominal.c, memory.mean[1])
    f_n = nav_vector(nominal.q, f[0], f[1], f[2])
    rate2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    a2 = f_n[0] * f_n[0] + f_n[1] * f_n[1] + (f_n[2] + model.gravity) ** 2
    steps = 1 if dt <= MAX_STEP else min(MAX_STEPS, ceil(dt / MAX_STEP))
    part = dt / steps
    psd = model.gyro_psd + model.rate_noise * rate2 + model.jerk_share * part * memory.jerk
    if not good or dt > MAX_STEP:
        psd += BLIND_PSD
    force_psd = model.accel_psd + model.accel_noise2 * a2
    force_psd += min(model.shake_share * part * memory.shake, model.shake_most)
    keep_steady(memory, w, f_n, dt)
    for _ in range(steps):
        if part > 0.0:
            f_n = advance(model, nominal, batch, work.C, w, f, memory.steady, part)
            note_force(memory.turned, f_n[0], f_n[1], part)
            batch.gyro_variance += psd * part
            batch.force_variance += force_psd * part
        if steps > 1:
            move(model, nominal.c, carry.P, batch, work)
            note_motion(work, batch)
            for i in range(N):
                work.dx[i] = 0.0
            note_end(work, carry.P, False, k)
            clear(batch)
    # the rate that the gyro says beyond the Earth's, for standing still
    ie_n, ie_d, _, _, _ = frame_rates(nominal.lla, nominal.v)
    for i in range(3):
        batch.rate[i] += (w[i] - work.C[i, 0] * ie_n - work.C[i, 2] * ie_d) * part
    return f_n


@inner
def keep_steady(memory: Memory, w: Triple, f_n: Triple, dt: float) -> None:
    """Mean rate and force of the last moment, by which errors grow; of this row alone where nothing shakes."""
    steady, jerky = memory.steady, memory.jerk * memory.jerk
    span = STEADY * jerky / (jerky + SHAKEN2 * SHAKEN2)  # turning in a gust is none
    share = dt / (dt + span) if dt > 0.0 else 1.0
    for i in range(3):
        if math.isnan(steady[0, i] + steady[1, i]):
            steady[0, i], steady[1, i] = w[i], f_n[i]
        steady[0, i] += share * (w[i] - steady[0, i])
        steady[1, i] += share * (f_n[i] - steady[1, i])


@inner
def watch_second(model: Parameters, c: np.ndarray, memory: Memory) -> None:
    """Standstill detector: scatter and mean rate of each second."""
    t, second = memory.good_t, memory.second
    if not t - memory.second_t < 1.0:
        n = memory.count
        still = n >= 10.0
        for i in range(3):
            still = still and second[1, i] < n * model.still_rate**2 and second[1, 3 + i] < n * model.still_force**2
            still = still and abs(second[0, i] - c[GYRO_BIAS + i]) < MEAN_RATE
        memory.still = 1.0 if still else 0.0
        memory.second_t, memory.count = t, 0.0
        for i in range(6):
            second[0, i] = second[1, i] = 0.0
    memory.count += 1.0
    for i in range(6):
        value = memory.last[i // 3, i % 3]
        off = value - second[0, i]
        second[0, i] += off / memory.count
        second[1, i] += off * (value - second[0, i])
    for i in range(3):  # moved off in mid-second
        if abs(memory.last[0, i] - c[GYRO_BIAS + i]) > 5.0 * model.still_rate:
            memory.still = 0.0
    moving = t - memory.fix_t < 1.0 and memory.speed > STILL_SPEED + 3.0 * model.gnss_velocity
    if moving:  # a smooth acceleration scatters as little as standing
        memory.still = 0.0


@inner
def correct(model: Parameters, carry: Carry, work: Work, row: Sample, f_n: Triple, answer: Estimate) -> int:
    """End a batch: the covariance, then whatever has been measured; SOUND, or begun ANEW, or LOST and begun anew."""
    nominal, P, batch, memory, dx = carry.nominal, carry.P, carry.batch, carry.memory, work.dx
    t, anew = row.t, False
    move(model, nominal.c, P, batch, work)
    note_motion(work, batch)
    for i in range(N):
        dx[i] = 0.0
    if is_lost(memory.turned, t, math.isnan(memory.mag_t), model.gnss_velocity, model.field_off):
        set_heading(model, carry, dx, t)
        anew = True
    if row.gnss_new:
        take_fix(model, carry, work, row, f_n, answer)
    if memory.still < memory.was_still:
        for i in range(HARD_IRON, HARD_IRON + 3):
            P[i, i] += model.iron_step
    memory.was_still = memory.still
    take_field(model, carry, work, t, answer)
    if model.use_heading and row.heading_new:
        take_baseline(model, carry, work, row, answer)
    if memory.still == 1.0:
        take_standstill(model, carry, work, t, answer)
    symmetric(P)
    retract(nominal, dx)
    note_correction(memory.turned, dx[PHI + 2])
    correct_past(memory.past, t, dx)
    clear(batch)
    memory.batch_t = t
    if healthy(nominal, P):
        copy(nominal, carry.safe)
        return ANEW if anew else SOUND
    copy(carry.safe, nominal)
    for i in range(N):
        for j in range(N):
            P[i, j] = carry.P_restart[i, j]
    return LOST


@inner
def set_heading(model: Parameters, carry: Carry, dx: np.ndarray, t: float) -> None:
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


@inner
def retract(nominal: Nominal, dx: np.ndarray) -> None:
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


@inner
def healthy(nominal: Nominal, P: np.ndarray) -> bool:
    """Tell whether all states are finite and no variance is negative or infinite."""
    total, positive = nominal.q[3] * 0.0, True  # NaN when any is infinite or NaN
    for i in range(3):
        total += nominal.q[i] * 0.0 + nominal.v[i] * 0.0 + nominal.lla[i] * 0.0
    for i in range(N):
        total += nominal.c[i] * 0.0 + P[i, i] * 0.0
        positive &= P[i, i] >= 0.0
    return positive and total == 0.0


@inner
def report(model: Parameters, carry: Carry, work: Work, answer: Estimate) -> None:
    """Set the estimate to the state, turned and moved on to the time of the stamp."""
    nominal, P, memory = carry.nominal, carry.P, carry.memory
    c, C, q, ahead = nominal.c, work.C, (nominal.q[0], nominal.q[1], nominal.q[2], nominal.q[3]), model.accel_delay
    v_n, lla, a_n = nominal.v, nominal.lla, (0.0, 0.0, 0.0)
    if not math.isnan(memory.last[0, 0]):
        f = true_force(c, memory.last[1])
        f_n = nav_vector(q, f[0], f[1], f[2])
        a_n = (f_n[0], f_n[1], f_n[2] + model.gravity)
        w = true_rate(c, memory.last[0])
        q = turned(q, model.gyro_delay * w[0], model.gyro_delay * w[1], model.gyro_delay * w[2])
    moved(lla, ahead * v_n[0], ahead * v_n[1], ahead * v_n[2], answer.lla)
    for i in range(4):
        answer.q_nb[i] = q[i]
    attitude_matrix(answer.q_nb, C)
    for i in range(3):
        answer.down_b[i] = C[i, 2]
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += C[i, a] * P[PHI + a, PHI + b] * C[j, b]
            answer.att_cov[i, j] = answer.att_cov[j, i] = total
        bias, variance = 0.0, 0.0
        for a in (GYRO_BIAS + i, GYRO_FAST + i, GYRO_SLOW + i):
            bias += c[a]
            for b in (GYRO_BIAS + i, GYRO_FAST + i, GYRO_SLOW + i):
                variance += P[a, b]
        answer.gyro_bias[i], answer.gyro_bias_sigma[i] = bias, math.sqrt(max(variance, 0.0))
        answer.accel_bias[i] = c[ACCEL_BIAS + i]
        answer.accel_bias_sigma[i] = math.sqrt(max(P[ACCEL_BIAS + i, ACCEL_BIAS + i], 0.0))
        answer.vel_n[i] = v_n[i] + ahead * a_n[i]
        for j in range(3):
            answer.vel_cov[i, j], answer.pos_cov[i, j] = P[VEL + i, VEL + j], P[POS + i, POS + j]
        answer.vel_cov[i, i] += SHAKEN_S * SHAKEN_S * memory.shake
    answer.adaptation[0] = memory.still
    answer.adaptation[1] = memory.surprise
    answer.adaptation[2] = memory.turned.refused


@inner
def is_field(field_b: np.ndarray) -> bool:
    """Tell whether a reading (T) can be a field; zero on all axes is a dead sensor."""
    size = abs(field_b[0]) + abs(field_b[1]) + abs(field_b[2])
    return bool(0.0 < size < 3.0 * MAX_FIELD)


@inner
def turn_reading(gyro_b: np.ndarray, v: np.ndarray, tau: float) -> None:
    """Turn the reading v (3,) of a sensor that saw tau (s) earlier than the gyro to the axes of then; in place."""
    w = gyro_b
    if tau != 0.0 and abs(w[0]) + abs(w[1]) + abs(w[2]) < FASTEST:
        x, y, z = nav_vector(turned((1.0, 0.0, 0.0, 0.0), -tau * w[0], -tau * w[1], -tau * w[2]), v[0], v[1], v[2])
        v[0], v[1], v[2] = x, y, z
