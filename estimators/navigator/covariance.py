"""How sure the navigator is: the covariance moved batch by batch, and measurements taken in one number at a time."""

import math

import numpy as np

from estimators.elementary import exp
from estimators.jit import inner
from estimators.native import record
from estimators.navigator.layout import (
    COUPLED,
    MOVING,
    NOTED_BATCH,
    NOTED_NUMBER,
    NUMBERS,
    PHI,
    SMOOTHED,
    TAPE,
    VEL,
    Batch,
    N,
    Parameters,
    Tape,
    Work,
)


@inner
def clear(batch: Batch) -> None:
    """Begin a batch: the transition is the identity."""
    for i in range(MOVING):
        for k in range(COUPLED):
            batch.F[i, k] = 1.0 if i == k else 0.0
    batch.seconds = batch.gyro_variance = batch.force_variance = batch.fields = 0.0
    for i in range(3):
        batch.field[i] = batch.rate[i] = 0.0
        batch.read[i % 2] = 0.0
        for k in range(N):
            batch.field_slope[i, k] = 0.0


@inner
def move(model: Parameters, c: np.ndarray, P: np.ndarray, batch: Batch, work: Work) -> None:
    """`P = F P F^T + Q` over a batch, and what decays in the constants c; both halves of P."""
    F, G, seconds = batch.F, work.G, batch.seconds
    for i in range(MOVING):
        for j in range(N):
            G[i, j] = 0.0
        for k in range(COUPLED):
            factor = F[i, k]
            if factor != 0.0:
                for j in range(N):
                    G[i, j] += factor * P[k, j]
    for i in range(MOVING):
        for j in range(i + 1):
            total = 0.0
            for k in range(COUPLED):
                total += G[i, k] * F[j, k]
            P[i, j] = P[j, i] = total
        for j in range(MOVING, N):
            P[i, j] = P[j, i] = G[i, j]
    for i in range(3):
        P[PHI + i, PHI + i] += batch.gyro_variance
        P[VEL + i, VEL + i] += batch.force_variance
    for i in range(6, N):
        if model.decay[i] > 0.0:
            keep = work.keep[i] = exp(-model.decay[i] * seconds)
            c[i] *= keep
            for j in range(N):
                P[i, j] *= keep
                P[j, i] = P[i, j]
            P[i, i] = keep * P[i, i] + (1.0 - keep * keep) * model.settled[i]
        P[i, i] += model.walk[i] * seconds


@inner
def nis(P: np.ndarray, work: Work, rows: int) -> float:
    """Normalised innovation squared of the `rows` (at most 3) measurements in `work`, per degree of freedom."""
    S, at, by = work.S, work.at, work.by
    for a in range(rows):
        for b in range(a + 1):
            total = work.variance[a] if a == b else 0.0
            for k in range(work.terms[a]):
                part = 0.0
                for m in range(work.terms[b]):
                    part += P[at[a, k], at[b, m]] * by[b, m]
                total += by[a, k] * part
            S[a, b] = total
    total = 0.0
    for a in range(rows):  # Cholesky factor in place, and L^-1 (residual) along with it
        for b in range(a):
            for k in range(b):
                S[a, b] -= S[a, k] * S[b, k]
            S[a, b] /= S[b, b]
        r, pivot = work.residual[a], S[a, a]
        for k in range(work.terms[a]):
            r -= by[a, k] * work.dx[at[a, k]]
        for k in range(a):
            r -= S[a, k] * work.gain[k]
            pivot -= S[a, k] * S[a, k]
        S[a, a] = math.sqrt(pivot)
        work.gain[a] = r / S[a, a]
        total += work.gain[a] * work.gain[a]
    return total / rows


@inner
def absorb(P: np.ndarray, work: Work, row: int) -> tuple[float, float]:
    """Condition P and `work.dx` on measurement `row`; its innovation, given those before it, and the variance of it."""
    gain, dx, at, by = work.gain, work.dx, work.at[row], work.by[row]
    r, variance = work.residual[row], work.variance[row]
    for j in range(N):
        gain[j] = 0.0
    for k in range(work.terms[row]):
        factor, line = by[k], P[at[k]]
        for j in range(N):
            gain[j] += factor * line[j]
    for k in range(work.terms[row]):
        variance += by[k] * gain[at[k]]
        r -= by[k] * dx[at[k]]
    inverse = 1.0 / variance
    for i in range(N):
        share, line = gain[i] * inverse, P[i]
        dx[i] += share * r
        for j in range(N):
            line[j] -= share * gain[j]
    note_number(record(work.tape, TAPE), work, row, r, variance)
    return r, variance


@inner
def note_number(tape: Tape, work: Work, row: int, innovation: float, variance: float) -> None:
    """Put the number that was just taken in on the tape."""
    n = tape.number
    if n < NUMBERS * tape.room:
        noted = record(tape.numbers, NOTED_NUMBER, n)
        for j in range(N):
            noted.slope[j], noted.gain[j] = 0.0, work.gain[j]
        for k in range(work.terms[row]):
            noted.slope[work.at[row, k]] += work.by[row, k]
        noted.innovation, noted.variance = innovation, variance
        tape.number = n + 1


@inner
def note_motion(work: Work, batch: Batch) -> None:
    """Put the transition of a batch on the tape, before its numbers."""
    tape = record(work.tape, TAPE)
    if tape.batch < tape.room:
        noted = record(tape.batches, NOTED_BATCH, tape.batch)
        for i in range(MOVING):
            for k in range(COUPLED):
                noted.F[i, k] = batch.F[i, k]
        for i in range(N):
            noted.keep[i] = work.keep[i]
        noted.first = tape.number


@inner
def note_end(work: Work, P: np.ndarray, lost: bool, row: int) -> None:
    """Put the end of a batch, with a row of the block, on the tape."""
    tape = record(work.tape, TAPE)
    if tape.batch < tape.room:
        noted = record(tape.batches, NOTED_BATCH, tape.batch)
        noted.row, noted.lost = row, 1 if lost else 0
        for i in range(SMOOTHED):
            noted.dx[i] = work.dx[i]
            for j in range(N):
                noted.P[i, j] = P[i, j]
        tape.batch += 1


@inner
def symmetric(P: np.ndarray) -> None:
    """Make both halves of P the same to the last bit."""
    for i in range(N):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
