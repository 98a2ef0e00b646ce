"""Where an emitter is: the Gaussian sum on the emitter model, look by look (Baseline 2021, section 3.2.4).

locator = EmitterLocator(coarse_bearing=math.radians(50.0), every=9)
fixes = locator.process(looks)
"""

import math
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from estimators.errors import SampleError, SettingError
from estimators.filters import ekf
from estimators.filters.base import FilterHandle, Method
from estimators.filters.gaussian_sum import Bank, mean_and_covariance, reduce_bank, step
from estimators.filters.work import Work
from estimators.jit import njit
from estimators.models.base import Handle
from estimators.models.emitter import PHASE, RATE, Emitter, bound, hypotheses, look_noise
from estimators.native import argument
from estimators.types import Columns, Status, blank, column

_RUNNING, _COASTING, _DIVERGED = int(Status.RUNNING), int(Status.COASTING), int(Status.DIVERGED)


@dataclass(frozen=True, slots=True)
class Looks(Columns):
    """Holds interferometer and navigation measurements, one row per look; a missing phase or rate is NaN."""

    t: np.ndarray = column()  # (n,) s
    position: np.ndarray = column(2)  # (n, 2) m, of the aircraft
    velocity: np.ndarray = column(2)  # (n, 2) m/s
    heading: np.ndarray = column()  # (n,) rad, direction of the baseline
    heading_rate: np.ndarray = column()  # (n,) rad/s
    phase: np.ndarray = column()  # (n,) rad, modulo 2 pi
    phase_rate: np.ndarray = column()  # (n,) rad/s


@dataclass(frozen=True, slots=True)
class Fixes(Columns):
    """Holds the emitter's position, one row per look; NaN before the first fix."""

    t: np.ndarray = column()  # (n,) s
    status: np.ndarray = column(dtype=np.uint8)  # (n,) `Status`
    position: np.ndarray = column(2)  # (n, 2) m, mean of the sum
    covariance: np.ndarray = column(2, 2)  # (n, 2, 2) m2, of the sum
    terms: np.ndarray = column(dtype=np.int64)  # (n,) how many are left
    weight: np.ndarray = column()  # (n,) of the heaviest
    output: np.ndarray = column(2)  # (n, 2) m, the fix at which the range has changed least up to now (paper, step 4)


class _Out(NamedTuple):
    """The columns of `Fixes` that are filled row by row."""

    status: np.ndarray
    position: np.ndarray
    covariance: np.ndarray
    terms: np.ndarray
    weight: np.ndarray
    output: np.ndarray


class _Track(NamedTuple):
    """Carries what the locator keeps from look to look beside the bank of filters."""

    clock: np.ndarray  # (1,) s, last look
    last: np.ndarray  # (2,) m, last fix
    change: np.ndarray  # (1,) m, least change of range so far
    output: np.ndarray  # (2,) m, the fix after it


class _Limits(NamedTuple):
    merge: float  # sigmas
    prune: float  # weight
    phase: float  # rad


@njit
def _select(track: _Track, x: np.ndarray, u: np.ndarray) -> None:
    """Keep fix x as the output when the range has changed less than ever (Baseline 2021, step 4)."""
    before = math.hypot(track.last[0] - u[0], track.last[1] - u[1])
    change = abs(math.hypot(x[0] - u[0], x[1] - u[1]) - before)
    better = change < track.change[0]
    if better:
        track.change[0] = change
    for a in range(2):
        track.last[a] = x[a]
        if better:
            track.output[a] = x[a]


@njit
def _run(
    method: FilterHandle,
    model: Handle,
    emitter: Emitter,
    bank: Bank,
    track: _Track,
    work: Work,
    limits: _Limits,
    t: np.ndarray,
    u: np.ndarray,
    z: np.ndarray,
    out: _Out,
    first: int,
) -> int:
    """Looks `first` to the last into `out`; returns the rows done, fewer than there are when the bank is lost."""
    used, noise = np.zeros(2, np.bool_), np.zeros((2, 2))
    for k in range(first, t.shape[0]):
        usable = t[k] > track.clock[0]
        for i in range(u.shape[1]):
            usable &= math.isfinite(u[k, i])
        for i in range(2):
            used[i] = usable and math.isfinite(z[k, i])
        if used[PHASE]:
            noise[0, 0] = 0.0
            look_noise(emitter, bank.x[0], u[k], noise)
            used[PHASE] = noise[0, 0] <= limits.phase * limits.phase
        status = _COASTING
        if used[PHASE] or used[RATE]:
            if not step(method, model, bank, work, u[k], z[k], used, t[k] - track.clock[0]):
                return k
            track.clock[0] = t[k]
            reduce_bank(bank, limits.merge, limits.prune)
            status = _RUNNING
        mean_and_covariance(bank, out.position[k], out.covariance[k])
        if status == _RUNNING:
            _select(track, out.position[k], u[k])
        heaviest = bank.log_weight[0]
        for i in range(1, bank.alive[0]):
            heaviest = max(heaviest, bank.log_weight[i])
        out.status[k] = status
        out.terms[k] = bank.alive[0]
        out.weight[k] = math.exp(heaviest)
        for a in range(2):
            out.output[k, a] = track.output[a]
    return len(t)


class EmitterLocator:
    """Locates one emitter from looks in blocks of any size.

    The first look with a phase rate makes the hypotheses and is not used again. A look whose navigation is missing or
    whose time stamp does not advance leaves the fix as it is (COASTING). When no hypothesis is left, the
    rest is NaN (DIVERGED) until `reset`.
    """

    def __init__(
        self,
        *,
        coarse_bearing: float,
        coarse_sigma: float = math.radians(5.0),
        every: int = 9,
        bearing_sigma: float = math.radians(1.0),
        merge_below: float = 1.0,
        prune_below: float = 1e-5,
        phase_limit: float = 1.5,
        method: Method | None = None,
        **emitter: float,
    ) -> None:
        """Settings, with the paper's values (section 4.1.1) as defaults.

        Args:
            coarse_bearing: of the emitter, from the amplitudes, rad.
            coarse_sigma: its standard deviation, rad.
            every: the paper's q, one hypothesis for so many possible bearings.
            bearing_sigma: of one hypothesis, rad.
            merge_below: two terms closer than so many sigmas are merged. (The paper's 3 km, its eq. (30) is lost.)
            prune_below: terms with a smaller weight are dropped.
            phase_limit: rad; a phase is left out when its error, heading and position included, has a larger sigma,
                because modulo 2 pi it then says nothing, and the filter would not know.
            method: the filter of each term, by default the paper's EKF.
            emitter: settings of `models.emitter.Emitter.make`.

        Raises:
            SettingError: a setting is unknown or has an impossible value.
        """
        positive = {
            "coarse_sigma": coarse_sigma, "every": every, "bearing_sigma": bearing_sigma,
            "prune_below": prune_below, "phase_limit": phase_limit,
        }  # fmt: skip
        for name, value in positive.items():
            if not value > 0:
                raise SettingError(f"emitter: {name} = {value} must be positive")
        if not math.isfinite(coarse_bearing):
            raise SettingError(f"emitter: coarse_bearing = {coarse_bearing} must be finite")
        if not merge_below >= 0.0:
            raise SettingError(f"emitter: merge_below = {merge_below} must not be negative")
        try:
            self.model = Emitter.make(**emitter)
        except TypeError as error:
            raise SettingError(f"emitter: {str(error).split(') ', 1)[-1]}") from None
        self._hypotheses: dict[str, Any] = {
            "coarse": coarse_bearing, "coarse_sigma": coarse_sigma, "every": int(every), "bearing_sigma": bearing_sigma
        }  # fmt: skip
        self._limits = _Limits(float(merge_below), float(prune_below), float(phase_limit))
        self._method = method or Method(ekf, ekf.make({}))
        self._bound = bound(self.model, self._method)
        self._work = Work.zeros()
        self.reset()

    def reset(self) -> None:
        """Forget all looks."""
        self.bank: Bank | None = None
        self._lost = False
        self._track = _Track(np.zeros(1), np.zeros(2), np.full(1, math.inf), np.full(2, math.nan))

    def process(self, looks: Looks) -> Fixes:
        """A fix for every look.

        Raises:
            SampleError: a column of a wrong shape, or a time stamp that is not finite.
        """
        for field in fields(Looks):
            column_, expected = getattr(looks, field.name), (len(looks), *field.metadata["shape"])
            if np.shape(column_) != expected:
                raise SampleError(f"Looks: {field.name} has shape {np.shape(column_)}, expected {expected}")
        if not np.isfinite(looks.t).all():
            raise SampleError("Looks: a time stamp is not finite")
        fixes = Fixes(**blank(Fixes, len(looks)))
        fixes.t[:] = looks.t
        u = np.ascontiguousarray(np.column_stack([looks.position, looks.velocity, looks.heading, looks.heading_rate]))
        z = np.ascontiguousarray(np.column_stack([looks.phase, looks.phase_rate]))
        out = _Out(fixes.status, fixes.position, fixes.covariance, fixes.terms, fixes.weight, fixes.output)
        done, begun = 0, len(looks)
        if self.bank is None and not self._lost:
            begun = done = self._begin(looks.t, u, z)
        if self.bank is not None:
            t = np.ascontiguousarray(looks.t, float)
            handles = argument(self._method.handle), argument(self._bound.handle)
            memory = self.model, self.bank, self._track, argument(self._work), self._limits
            done = _run(*handles, *memory, t, u, z, out, done)
            if done < len(looks):
                self.bank, self._lost = None, True
        fixes.status[begun : begun + 1] = _RUNNING  # the look that made the terms
        if self._lost:
            fixes.status[done:] = _DIVERGED
            for lost in (fixes.position, fixes.covariance, fixes.weight, fixes.output):
                lost[done:] = math.nan
            fixes.terms[done:] = 0
        return fixes

    def _begin(self, t: np.ndarray, u: np.ndarray, z: np.ndarray) -> int:
        """Make the bank from the first look that can; returns its row, or their number when none can."""
        for k in np.flatnonzero(np.isfinite(u).all(axis=1) & np.isfinite(z[:, RATE])):
            means, covariances = hypotheses(self.model, z[k, PHASE], z[k, RATE], u[k], **self._hypotheses)
            if len(means):
                self.bank = Bank.make(means, covariances)
                self._track.clock[0] = t[k]  # so that `_run` reports this look, but does not use it again
                self._track.last[:] = self._track.output[:] = means.mean(axis=0)
                return int(k)
        return len(t)
