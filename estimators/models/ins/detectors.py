"""What the IMU says of the motion besides: how jerky it is, and whether the vehicle stands."""

import math

from estimators.alignment import MEAN_RATE
from estimators.jit import inner
from estimators.models.ins.layout import Kept, Motion, Shared, State
from estimators.records import Sample

JERKY_TIME = 0.3  # s, over which the gyro's scatter between samples is averaged


@inner
def watch_jerks(row: Sample, memory: Kept, dt: float) -> None:
    """High-frequency variances (an impact, vibration): 1/6 of the variance of second differences, averaged."""
    square, shaken = 0.0, 0.0
    for i in range(3):
        step = row.gyro_b[i] - memory.rate_b[i] if dt > 0.0 else 0.0
        square += (step - memory.step_b[i]) ** 2
        memory.step_b[i] = step
        step = row.accel_b[i] - memory.accel_b[i] if dt > 0.0 else 0.0
        shaken += (step - memory.shock_b[i]) ** 2
        memory.shock_b[i] = step
    share = min(dt / JERKY_TIME, 1.0)
    memory.jerky += share * (square / 18.0 - memory.jerky)
    memory.shaky += share * (shaken / 18.0 - memory.shaky)


@inner
def watch_second(model: Shared, row: Sample, x: State, memory: Kept, u: Motion) -> None:
    """Standstill detector: scatter and mean rate of each second; what its change does to the biases."""
    if not row.t - memory.second_t < 1.0:  # the second is over: what was it?
        n = memory.count
        still = n >= 10.0
        for i in range(3):
            still = still and memory.spread[i] < n * model.still_rate**2
            still = still and memory.spread[3 + i] < n * model.still_force**2
            still = still and abs(memory.mean[i] - x.gyro_bias[i]) < MEAN_RATE
        memory.is_still = still
        if n > 0.0:
            change_biases(model, memory, u)
        memory.second_t, memory.count = row.t, 0.0
        for i in range(6):
            memory.mean[i] = memory.spread[i] = 0.0
    memory.count += 1.0
    for i in range(6):
        value = row.gyro_b[i] if i < 3 else row.accel_b[i - 3]
        off = value - memory.mean[i]
        memory.mean[i] += off / memory.count
        memory.spread[i] += off * (value - memory.mean[i])
    for i in range(3):  # moved off in mid-second
        if abs(row.gyro_b[i] - x.gyro_bias[i]) > 5.0 * model.still_rate:
            memory.is_still = False


@inner
def change_biases(model: Shared, memory: Kept, u: Motion) -> None:
    """Inflate the bias noise at each change of rate or force: misalignment and scale make a new bias of it."""
    for part in range(2):
        total = 0.0
        for i in range(3 * part, 3 * part + 3):
            step = memory.mean[i] - memory.before[i]
            u.changed[i] = step * step if math.isfinite(step) else 0.0
            total += u.changed[i]
            memory.before[i] = memory.mean[i]
        for i in range(3 * part, 3 * part + 3):
            own = u.changed[i]
            u.changed[i] = model.beside2[part] * (total - own) + model.along2[part] * own
