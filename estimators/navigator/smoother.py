"""Afterwards: what the whole flight says of every moment of it.

Modified Bryson-Frazier form of the fixed-interval smoother (Bierman 1973): backwards through what the filter has noted
of each batch, no inverse of a covariance; in a linear model the same as Rauch-Tung-Striebel. With l and L (N,), (N, N)
zero behind the last batch,

    smoothed = filtered - P l,    its covariance P - P L P                       at the end of a batch
    l <- l - h (K l + r / s),    L <- (I - K h)^T L (I - K h) + h^T h / s       back over a number (h, K, r, s)
    l <- F^T l,                  L <- F^T L F                                   back over the motion

The error that is smoothed is that about the filter's own state, which takes every correction at once: the innovations
r carry these already. Memory is bounded: the filter runs once to the end, its state kept every `CHUNK` rows, then once
more chunk by chunk from the last, and each chunk is smoothed before the one ahead of it.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from estimators.alignment import pieces
from estimators.earth import move as moved
from estimators.jit import njit
from estimators.native import argument, record
from estimators.navigator.layout import (
    ACCEL_BIAS,
    COUPLED,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_SLOW,
    MOVING,
    NOTED_BATCH,
    NOTED_NUMBER,
    PHI,
    POS,
    SMOOTHED,
    VEL,
    N,
    NotedNumber,
    Tape,
    tape,
)
from estimators.navigator.loop import MAX_STEP, MAX_STEPS
from estimators.navigator.navigator import Navigator
from estimators.rotations import attitude_matrix, turn_nav
from estimators.types import Estimates, Samples

CHUNK = 1000  # rows


class Behind(NamedTuple):
    """Carries the information from later batches."""

    lam: np.ndarray  # (N,) the l above
    L: np.ndarray  # (N, N)


class Smoothed(NamedTuple):
    """Corrections by batch."""

    row: np.ndarray  # (batches,) int64, with which it ends
    delta: np.ndarray  # (batches, SMOOTHED) at the end of a batch, to the filtered state
    before: np.ndarray  # (batches, SMOOTHED) to the state before the batch's own correction
    cov: np.ndarray  # (batches, 3, 3, 3) of phi, velocity and place, navigation axes
    bias_var: np.ndarray  # (batches, 6) of the biases of gyro and accelerometer


@njit
def backwards(tape: Tape, behind: Any, out: Any, scratch: np.ndarray) -> None:
    """Smooth all batches of a tape, from its last to its first."""
    lam, L = behind.lam, behind.L
    end = tape.number
    for step in range(tape.batch):
        b = tape.batch - 1 - step
        batch = record(tape.batches, NOTED_BATCH, b)
        if batch.lost != 0:  # what comes later knows nothing of before
            for i in range(N):
                lam[i] = 0.0
                for j in range(N):
                    L[i, j] = 0.0
        conclude_batch(batch.P, lam, L, out.delta[b], out.cov[b], out.bias_var[b], scratch)
        for i in range(SMOOTHED):
            out.before[b, i] = out.delta[b, i] + batch.dx[i]
        for number in range(end - 1, batch.first - 1, -1):
            over_number(lam, L, record(tape.numbers, NOTED_NUMBER, number), scratch[0])
        end = batch.first
        over_motion(lam, L, batch.F, batch.keep, scratch)


@njit
def conclude_batch(
    P: np.ndarray, lam: np.ndarray, L: np.ndarray, delta: np.ndarray, cov: np.ndarray, bias_var: np.ndarray,
    scratch: np.ndarray,
) -> None:  # fmt: skip
    """`delta = -P l`, and of `P - P L P` what is reported."""
    for i in range(SMOOTHED):
        total = 0.0
        for j in range(N):
            total += P[i, j] * lam[j]
        delta[i] = -total
    for a in range(15):  # rotation, velocity, place, the sum of the terms of the gyro's bias, the accelerometer's bias
        rows = scratch[a]
        for j in range(N):
            if a < 9:
                rows[j] = P[PHI + a, j]
            elif a < 12:
                rows[j] = P[GYRO_BIAS + a - 9, j] + P[GYRO_FAST + a - 9, j] + P[GYRO_SLOW + a - 9, j]
            else:
                rows[j] = P[ACCEL_BIAS + a - 12, j]
        product = scratch[15 + a]
        for j in range(N):
            product[j] = 0.0
        for k in range(N):
            factor, line = rows[k], L[k]
            for j in range(N):
                product[j] += factor * line[j]
    for kind in range(3):
        for a in range(3 * kind, 3 * kind + 3):
            for b in range(3 * kind, a + 1):
                total = P[a, b]
                for j in range(N):
                    total -= scratch[15 + a, j] * scratch[b, j]
                cov[kind, a % 3, b % 3] = cov[kind, b % 3, a % 3] = total
    for a in range(3):
        total, other = 0.0, P[ACCEL_BIAS + a, ACCEL_BIAS + a]
        for at in (GYRO_BIAS + a, GYRO_FAST + a, GYRO_SLOW + a):
            total += scratch[9 + a, at]
        for j in range(N):
            total -= scratch[24 + a, j] * scratch[9 + a, j]
            other -= scratch[27 + a, j] * scratch[12 + a, j]
        bias_var[a], bias_var[3 + a] = total, other


@njit
def over_number(lam: np.ndarray, L: np.ndarray, number: NotedNumber, u: np.ndarray) -> None:
    """Back over a number."""
    slope, gain = number.slope, number.gain
    inverse = 1.0 / number.variance
    along, square = 0.0, 0.0
    for i in range(N):
        total, line = 0.0, L[i]
        for j in range(N):
            total += line[j] * gain[j]
        u[i] = total * inverse
        along += gain[i] * lam[i]
        square += gain[i] * u[i]
    share = (along + number.innovation) * inverse
    square = (square + 1.0) * inverse
    for i in range(N):
        if slope[i] != 0.0:
            lam[i] -= slope[i] * share
            for j in range(N):
                part = slope[i] * (u[j] - square * slope[j])
                L[i, j] -= part
                if slope[j] == 0.0:
                    L[j, i] = L[i, j]
                else:
                    L[i, j] -= u[i] * slope[j]


@njit
def over_motion(lam: np.ndarray, L: np.ndarray, F: np.ndarray, keep: np.ndarray, scratch: np.ndarray) -> None:
    """Back over the motion of a batch: F for the moving components, `keep` for the others."""
    T = scratch  # (N, N) = L F
    for i in range(N):
        line, row = T[i], L[i]
        for j in range(N):
            line[j] = 0.0 if j < MOVING else row[j] * keep[j]
        for k in range(MOVING):
            factor = row[k]
            if factor != 0.0:
                for j in range(COUPLED):
                    line[j] += factor * F[k, j]
    for i in range(N):
        row = L[i]
        for j in range(N):
            row[j] = 0.0 if i < MOVING else T[i, j] * keep[i]
        if i < COUPLED:
            for k in range(MOVING):
                factor = F[k, i]
                if factor != 0.0:
                    for j in range(N):
                        row[j] += factor * T[k, j]
    for i in range(N):
        for j in range(i):
            L[i, j] = L[j, i] = 0.5 * (L[i, j] + L[j, i])
    for j in range(COUPLED):
        total = 0.0 if j < MOVING else keep[j] * lam[j]
        for k in range(MOVING):
            total += F[k, j] * lam[k]
        scratch[0, j] = total
    for j in range(N):
        lam[j] = scratch[0, j] if j < COUPLED else keep[j] * lam[j]


@njit
def correct_rows(
    t: np.ndarray, smoothed: Any, q: np.ndarray, down: np.ndarray, cov: np.ndarray, gyro: np.ndarray,
    gyro_sigma: np.ndarray, accel: np.ndarray, accel_sigma: np.ndarray, lla: np.ndarray, vel: np.ndarray,
    vel_cov: np.ndarray, pos_cov: np.ndarray,
) -> None:  # fmt: skip
    """Apply the corrections to estimates, straight between the ends of batches; rows of NaN stay."""
    delta, C, turned, place = np.empty(SMOOTHED), np.empty((3, 3)), np.empty(4), np.empty(3)
    ends, count, at = smoothed.row, smoothed.row.shape[0], 0
    for k in range(t.shape[0]):
        while at < count - 1 and (ends[at] < k or ends[at + 1] <= k):
            at += 1
        early = max(at - 1, 0)
        if ends[at] <= k or at == 0:
            share, early = 1.0, at
        else:
            span = t[ends[at]] - t[ends[early]]
            share = (t[k] - t[ends[early]]) / span if span > 0.0 else 1.0
        for i in range(SMOOTHED):
            now = smoothed.delta[early, i]
            delta[i] = now if early == at else now + share * (smoothed.before[at, i] - now)
        if math.isnan(q[k, 0]):
            continue
        turn_nav((q[k, 0], q[k, 1], q[k, 2], q[k, 3]), delta[PHI], delta[PHI + 1], delta[PHI + 2], turned)
        attitude_matrix(turned, C)
        q[k] = turned
        for i in range(3):
            down[k, i] = C[i, 2]
            vel[k, i] += delta[VEL + i]
            gyro[k, i] += delta[GYRO_BIAS + i] + delta[GYRO_FAST + i] + delta[GYRO_SLOW + i]
            accel[k, i] += delta[ACCEL_BIAS + i]
            gyro_sigma[k, i] = math.sqrt(max(smoothed.bias_var[at, i], 0.0))
            accel_sigma[k, i] = math.sqrt(max(smoothed.bias_var[at, 3 + i], 0.0))
            for j in range(3):
                vel_cov[k, i, j], pos_cov[k, i, j] = smoothed.cov[at, 1, i, j], smoothed.cov[at, 2, i, j]
                total = 0.0
                for a in range(3):
                    for b in range(3):
                        total += C[i, a] * smoothed.cov[at, 0, a, b] * C[j, b]
                cov[k, i, j] = total
        moved((lla[k, 0], lla[k, 1], lla[k, 2]), delta[POS], delta[POS + 1], delta[POS + 2], place)
        lla[k] = place


def smooth(navigator: Navigator, samples: Samples) -> Estimates:
    """Smoothed estimates of a whole recording, one row for each row of samples.

    Rows before the alignment are NaN as the filter's; what only a filter has (status, innovations) is kept.

    Args:
        navigator: of any state; it is reset, and left at the end of the recording.
        samples: the recording.

    Raises:
        SampleError: as `Navigator.process`.
    """
    parts = [_smooth(navigator, samples[first:end]) for first, end, _ in pieces(samples.t, math.nan)]
    return Estimates.concatenate(parts)


def _smooth(navigator: Navigator, samples: Samples) -> Estimates:
    """Smooth a recording without a gap after which the navigator aligns anew."""
    navigator.reset()
    states, room = [], 0
    for first in range(0, len(samples), CHUNK):
        states.append(navigator.state())
        room = max(room, _batches(samples.t[first : first + CHUNK]))
        navigator.process(samples[first : first + CHUNK])
    states.append(navigator.state())
    behind = Behind(np.zeros(N), np.zeros((N, N)))
    memory = tape(room)
    estimates, smoothed = [], []
    for k in range(len(states) - 2, -1, -1):
        navigator.restore(states[k])
        chunk = samples[k * CHUNK : (k + 1) * CHUNK]
        memory[0].batch = memory[0].number = 0
        estimates.append(navigator.process(chunk, memory[0]))
        smoothed.append(_backwards(memory[0], memory[1]["row"], behind, k * CHUNK))
    navigator.restore(states[-1])
    if not estimates:
        return navigator.process(samples)
    whole = Estimates.concatenate(estimates[::-1])
    corrections = Smoothed(*(np.concatenate(parts[::-1]) for parts in zip(*smoothed, strict=True)))
    columns = {f.name: getattr(whole, f.name).copy() for f in dataclasses.fields(Estimates)}
    if len(corrections.row):
        correct_rows(samples.t, corrections, *(columns[name] for name in REPORTED))
    return Estimates(**columns)


REPORTED = (
    "q_nb", "down_b", "att_cov", "gyro_bias", "gyro_bias_sigma", "accel_bias", "accel_bias_sigma", "lla", "vel_n",
    "vel_cov", "pos_cov",
)  # fmt: skip
"""What a smoother changes."""


def _batches(t: np.ndarray) -> int:
    """Count the batches that rows of these times may end: one each, and those that bridge gaps."""
    return len(t) + MAX_STEPS * (1 + int(np.count_nonzero(np.diff(t) > MAX_STEP)))


def _backwards(noted: Any, row: np.ndarray, behind: Behind, first: int) -> Smoothed:
    count = int(noted.batch)
    out = Smoothed(
        first + row[:count],
        np.zeros((count, SMOOTHED)),
        np.zeros((count, SMOOTHED)),
        np.zeros((count, 3, 3, 3)),
        np.zeros((count, 6)),
    )
    backwards(argument(noted), behind, out, np.zeros((N, N)))
    return out
