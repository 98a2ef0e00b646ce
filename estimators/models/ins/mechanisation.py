"""Strapdown mechanisation: how the state moves, and how it and its errors go together."""

import math

import numpy as np

from estimators.earth import GRAVITY_GRADIENT, apart, frame_rates, move
from estimators.elementary import atan2
from estimators.jit import inner
from estimators.models.ins.detectors import watch_jerks, watch_second
from estimators.models.ins.layout import BA, BG, HI, P_, PHI, SG, WIND, Kept, Motion, Shared, State, V
from estimators.native import local
from estimators.plausible import MAX_FORCE, MAX_RATE, plausible
from estimators.records import Sample
from estimators.rotations import (
    attitude_matrix,
    nav_vector,
    normalise,
    rotation_between,
    turn_nav,
    turned,
)
from estimators.turned import note_correction, note_force

STEADY = 0.3  # s, over which an acceleration that lasts is averaged
MISSING = 0.25  # s without the IMU after which the last rate and force say little of what was missed


def load(model: Shared, row: Sample, x: State, memory: Kept, u: Motion) -> None:
    """Mean rate and force of the step, and their noise; what a wrong heading has taught is forgotten before it."""
    w, f = row.gyro_b, row.accel_b
    good = True
    for i in range(3):
        good &= plausible(w[i], MAX_RATE) and plausible(f[i], MAX_FORCE)
    memory.good = good
    before = memory.t
    fresh = math.isfinite(memory.t) and row.t - memory.t < 0.1
    dt = row.t - memory.t if fresh else 0.0
    if good:
        watch_jerks(row, memory, dt)
    for i in range(3):  # the samples at both ends of the step; the last good ones while there are none
        if good:
            u.rate_b[i] = 0.5 * (w[i] + memory.rate_b[i]) if fresh else w[i]
            u.accel_b[i] = 0.5 * (f[i] + memory.accel_b[i]) if fresh else f[i]
            memory.rate_b[i], memory.accel_b[i] = w[i], f[i]
    if good:
        memory.t = row.t
    if memory.reopened:
        memory.gnss.late = math.nan  # a wrong heading looks like a delay
        for i in range(3):
            x.accel_bias[i] = 0.0
            if model.states > SG:
                x.gyro_scale[i] = x.hard_iron[i] = 0.0
    rate2 = 0.0
    for i in range(3):
        rate2 += (u.rate_b[i] - x.gyro_bias[i]) ** 2
    u.gyro_psd = model.gyro_psd + model.rate_noise * rate2 + model.jerk_share * dt * memory.jerky
    north, east, down = acceleration(model, x, u)
    memory.acceleration_n[0], memory.acceleration_n[1], memory.acceleration_n[2] = north, east, down
    for i in range(3):
        if math.isfinite(memory.acceleration_n[i]):
            memory.steady_n[i] += min(dt / STEADY, 1.0) * (memory.acceleration_n[i] - memory.steady_n[i])
    note_turned(x, memory)
    note_force(memory.turned, north, east, dt)
    u.accel_psd = model.accel_psd + model.accel_noise2 * (north * north + east * east + down * down)
    u.accel_psd += min(model.shake_share * dt * memory.shaky, model.shake_most)
    u.reopened, memory.reopened = (1.0 if memory.reopened else 0.0), False
    for i in range(6):
        u.changed[i] = 0.0
        u.opened2[i] = memory.gnss.opens2[i]
        memory.gnss.opens2[i] = 0.0
    if not good or row.t - before > MISSING:  # whatever happens meanwhile: 0.1 rad/s/sqrt(Hz), 2 m/s2/sqrt(Hz)
        u.gyro_psd += 0.01
        u.accel_psd += 4.0
    if good:
        watch_second(model, row, x, memory, u)


@inner
def acceleration(model: Shared, x: State, u: Motion) -> tuple[float, float, float]:
    """Acceleration over the ground, m/s2 NED."""
    f, b = u.accel_b, x.accel_bias
    north, east, down = nav_vector(x.q_nb, f[0] - b[0], f[1] - b[1], f[2] - b[2])
    return north, east, down + model.gravity


@inner
def note_turned(x: State, memory: Kept) -> None:
    """Note by how much the last row's measurements have turned the heading."""
    q, p = x.q_nb, memory.q_nb  # q (x) p*: scalar and vertical part
    scalar = q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3]
    vertical = q[3] * p[0] - q[0] * p[3] + q[2] * p[1] - q[1] * p[2]
    if vertical != 0.0 and math.isfinite(scalar):
        note_correction(memory.turned, 2.0 * atan2(vertical if scalar > 0.0 else -vertical, abs(scalar)))


def propagate(model: Shared, x: State, u: Motion, dt: float, out: State) -> None:
    """Integrate rate and force over dt; the constants stay."""
    for i in range(3):
        out.gyro_bias[i], out.accel_bias[i] = x.gyro_bias[i], x.accel_bias[i]
        out.gyro_scale[i], out.hard_iron[i], out.wind_n[i] = x.gyro_scale[i], x.hard_iron[i], x.wind_n[i]
    w, f, e, b, s = u.rate_b, u.accel_b, x.gyro_bias, x.accel_bias, x.gyro_scale
    place, (north, east, down) = (x.lla[0], x.lla[1], x.lla[2]), (x.vel_n[0], x.vel_n[1], x.vel_n[2])
    ie_n, ie_d, en_n, en_e, en_d = frame_rates(place, (north, east, down))
    # attitude in two halves; the middle one turns the force
    hx, hy, hz = 0.5 * dt * (w[0] - e[0]), 0.5 * dt * (w[1] - e[1]), 0.5 * dt * (w[2] - e[2])
    if model.states > SG:
        hx, hy, hz = hx * (1.0 - s[0]), hy * (1.0 - s[1]), hz * (1.0 - s[2])
    half = turned(x.q_nb, hx, hy, hz)
    turn_nav(turned(half, hx, hy, hz), -(ie_n + en_n) * dt, -en_e * dt, -(ie_d + en_d) * dt, out.q_nb)
    force_n, force_e, force_d = nav_vector(half, f[0] - b[0], f[1] - b[1], f[2] - b[2])
    # velocity with Coriolis' acceleration, place with the mean velocity
    wn, we, wd = 2.0 * ie_n + en_n, en_e, 2.0 * ie_d + en_d
    gravity = model.gravity - GRAVITY_GRADIENT * (x.lla[2] - model.origin[2])
    v = out.vel_n
    v[0] = north + (force_n - (we * down - wd * east)) * dt
    v[1] = east + (force_e - (wd * north - wn * down)) * dt
    v[2] = down + (force_d + gravity - (wn * east - we * north)) * dt
    move(place, 0.5 * (north + v[0]) * dt, 0.5 * (east + v[1]) * dt, 0.5 * (down + v[2]) * dt, out.lla)


def transition(model: Shared, x: State, u: Motion, dt: float, F: np.ndarray) -> None:
    """First order in dt; Earth rate, Coriolis and curvature terms are left out."""
    for a in range(9):
        for k in range(min(HI, model.states)):
            F[a, k] = 0.0
        F[a, a] = 1.0
    w, f, b = u.rate_b, u.accel_b, x.accel_bias
    C = local(3, 3)
    attitude_matrix(x.q_nb, C)  # C_bn: its rows are the body axes in NED
    north, east, down = nav_vector(x.q_nb, (f[0] - b[0]) * dt, (f[1] - b[1]) * dt, (f[2] - b[2]) * dt)
    for a in range(3):
        F[P_ + a, V + a] = dt
        for i in range(3):
            F[PHI + a, BG + i] = -C[i, a] * dt
            F[V + a, BA + i] = -C[i, a] * dt
            if model.states > SG:
                F[PHI + a, SG + i] = -C[i, a] * (w[i] - x.gyro_bias[i]) * dt
    F[V, PHI + 1], F[V, PHI + 2] = down, -east
    F[V + 1, PHI], F[V + 1, PHI + 2] = -down, north
    F[V + 2, PHI], F[V + 2, PHI + 1] = east, -north


def process_noise(model: Shared, x: State, u: Motion, dt: float, P: np.ndarray) -> None:
    """Noise of the step; walks of place and constants."""
    for i in range(3):
        P[PHI + i, PHI + i] += u.gyro_psd * dt
        P[V + i, V + i] += u.accel_psd * dt
        P[P_ + i, P_ + i] += model.place_walk[i] * dt
    for i in range(6):
        P[V + i, V + i] += u.opened2[i]
    for i in range(9, model.states):
        P[i, i] += model.walks[i - 9] * dt
    if u.reopened != 0.0:
        for i in range(model.states):
            P[i, i] += model.opened[i]
    for i in range(6):  # bounded: rates that come and go bring the same bias again, not another on top
        P[BG + i, BG + i] += max(min(u.changed[i], 40.0 * u.changed[i] - P[BG + i, BG + i]), 0.0)


def retract(model: Shared, x: State, dx: np.ndarray, out: State) -> None:
    """Turn about navigation axes, move by metres, add the rest."""
    turn_nav(x.q_nb, dx[PHI], dx[PHI + 1], dx[PHI + 2], out.q_nb)
    move((x.lla[0], x.lla[1], x.lla[2]), dx[P_], dx[P_ + 1], dx[P_ + 2], out.lla)
    for i in range(3):
        out.vel_n[i] = x.vel_n[i] + dx[V + i]
        out.gyro_bias[i] = x.gyro_bias[i] + dx[BG + i]
        out.accel_bias[i] = x.accel_bias[i] + dx[BA + i]
        if model.states > SG:
            out.gyro_scale[i] = x.gyro_scale[i] + dx[SG + i]
            out.hard_iron[i] = x.hard_iron[i] + dx[HI + i]
        if model.states > WIND:
            out.wind_n[i] = x.wind_n[i] + dx[WIND + i]


def difference(model: Shared, x: State, origin: State, out: np.ndarray) -> None:
    """Rotation, velocity and metres from `origin` to x."""
    a, b, metres = origin.q_nb, x.q_nb, local(3)
    rotation_between((a[0], -a[1], -a[2], -a[3]), (b[0], -b[1], -b[2], -b[3]), out)  # x* = origin* (x) exp_q(-phi)
    apart((x.lla[0], x.lla[1], x.lla[2]), (origin.lla[0], origin.lla[1], origin.lla[2]), metres)
    for i in range(3):
        out[PHI + i] = -out[PHI + i]
        out[V + i] = x.vel_n[i] - origin.vel_n[i]
        out[P_ + i] = metres[i]


def constrain(model: Shared, x: State) -> None:
    """Normalise the quaternion."""
    normalise(x.q_nb)
