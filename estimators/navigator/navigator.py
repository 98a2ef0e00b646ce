"""The navigator as an object of the catalogue: alignment, then the loop, block by block."""

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any, cast

import numpy as np

from estimators import native
from estimators.alignment import ALIGNING, NO_HEADING, STILL, Alignment, Stretch, align, concluded, limits, pieces
from estimators.errors import EstimationError, SampleError
from estimators.jit import JIT, on_disk
from estimators.native import Record, argument, loaded, passed
from estimators.navigator.aids import LEVEL, UP, Z_BASELINE, Z_FIELD, Z_PLACE, Z_VELOCITY
from estimators.navigator.covariance import clear
from estimators.navigator.history import History
from estimators.navigator.layout import (
    ACCEL_BIAS,
    ACCEL_MATRIX,
    BASELINE,
    CLOCKS,
    COUNT,
    COUPLED,
    FAST_TIME,
    FIELD,
    GOOD,
    GYRO_BIAS,
    GYRO_FAST,
    GYRO_MATRIX,
    GYRO_SLOW,
    HARD_IRON,
    IS_STILL,
    JERK,
    LATE,
    MAG_MATRIX,
    MOVING,
    PHI,
    POS,
    SEEN,
    SHAKE,
    SLOW_TIME,
    T_LAST,
    TOTALS,
    VEL,
    WANDER,
    WAS_STILL,
    Answers,
    Batch,
    Memory,
    N,
    Nominal,
    Parameters,
    Rows,
    Work,
)
from estimators.navigator.loop import Carry, run, store, turn_readings
from estimators.records import pack
from estimators.rotations import attitude_matrix
from estimators.run import BACKWARDS
from estimators.turned import NOTES, Turned, begin
from estimators.types import Estimates, Samples, SensorInfo, Site, blank

FLICKER = 1.29  # sigma of a Gauss-Markov term one decade wide, over the floor of the Allan deviation
SCALE_TIME = 5.0  # s, how long a rate lasts
STATE_VERSION = 3
ALIGNMENT_SHARE = 4.0  # alignment and calibration states come from the same readings: it counts as this much wider


class Navigator:
    """An estimator of the catalogue.

    Args:
        name: for messages.
        settings: checked settings.
        site: place and field.
        sensors: data sheet figures.
    """

    def __init__(self, name: str, settings: Mapping[str, Any], site: Site, sensors: SensorInfo) -> None:
        self.name, self.settings, self.site, self.sensors = name, dict(settings), site, sensors
        self._model = parameters(settings, site, sensors)
        self._limits, self._align = limits(sensors), loaded(align, "alignment")
        self._work = Work.make()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen: align anew."""
        self._stretch = Stretch.make()
        self._carry: Carry | None = None

    def prepare(self) -> None:
        """Compile, or load from the disk, everything that `process` will need; forgets everything seen."""
        if JIT and not run.signatures and not on_disk(run):
            for listener in native.listeners:
                listener()
        nothing = _rows(Samples(**blank(Samples, 0)), self.sensors)
        alignment = concluded(Stretch.make(), False, self.site, self.sensors)
        carry = start(self._model, self.settings, self.site, self.sensors, alignment)
        run(self._model, carry, self._work, nothing, Answers(**blank(Estimates, 0)), 0)
        self.reset()

    @property
    def measurements(self) -> dict[str, slice]:
        """The columns of its innovations by the names of what is measured, as those of the other navigators."""
        places = {"gnss.vel_n": (Z_VELOCITY, 3), "gnss.place_n": (Z_PLACE, 3), "field.mag_b": (Z_FIELD, 3)}
        places["baseline.heading"] = Z_BASELINE, 1
        return {name: slice(first, first + rows) for name, (first, rows) in places.items()}

    @property
    def notes(self) -> Mapping[int, tuple[str, str]]:
        """Return what is worth an event: by column of `adaptation`, the texts for becoming 1 and 0 again."""
        return NOTES

    def process(self, samples: Samples, work: Work | None = None) -> Estimates:
        """One row of estimates for each row of samples; `work` takes notes for a smoother.

        Raises:
            SampleError: a column of a wrong shape, a time stamp that is not finite or more than a second back.
                Nothing of the block has been used then.
        """
        rows = _rows(samples, self.sensors)
        last = float(self._stretch.last_t if self._carry is None else self._carry.memory.clock[T_LAST])
        self._check_stamps(rows.t, last)
        out = blank(Estimates, len(rows.t))
        out["t"][:] = rows.t
        for first, end, anew in pieces(rows.t, last):
            if anew:
                self.reset()
            part = slice(first, end)
            self._process(samples[part], Rows(*(c[part] for c in rows)), {k: c[part] for k, c in out.items()}, work)
        return Estimates(**out)

    def _process(self, samples: Samples, rows: Rows, out: dict[str, np.ndarray], work: Work | None) -> None:
        """Estimate rows without a long gap into estimates."""
        done = 0
        if self._carry is None:
            wait = self.settings["align_s"], self.settings["wait_s"]
            limits_ = *wait, *self._limits, self.site.gravity
            records = pack(samples)  # kept by a name: what is passed is its address
            done = self._align(*passed(self._stretch, records), len(rows.t), *limits_)
            if self._stretch.phase != ALIGNING:
                alignment = concluded(self._stretch, self._stretch.phase == STILL, self.site, self.sensors)
                self._carry = start(self._model, self.settings, self.site, self.sensors, alignment)
        if done < len(rows.t):
            assert self._carry is not None
            run(self._model, self._carry, work or self._work, rows, Answers(**out), done)

    def _check_stamps(self, t: np.ndarray, last: float) -> None:
        before = np.fmax.accumulate(np.concatenate([[last], t]))[:-1]
        bad = np.flatnonzero(~np.isfinite(t) | (t < before - BACKWARDS))
        if len(bad):
            k = int(bad[0])
            raise SampleError(f"{self.name}: time stamp {t[k]} s in row {k} after {before[k]} s")

    def state(self) -> dict[str, Any]:
        """Copy everything that goes on from block to block.

        `name`, `version` and `settings` (a hash, of place and sensors too) say whose it is; `stretch` is the
        alignment's; `filter` None or the arrays of `loop.Carry` by name, `nominal.q`, `P`, ...
        """
        kept = None if self._carry is None else {name: array.copy() for name, array in _arrays(self._carry)}
        return {**self._owner(), "stretch": self._stretch.data.copy(), "filter": kept}

    def _owner(self) -> dict[str, Any]:
        known = f"{sorted(self.settings.items())} {self.site} {self.sensors}"
        return {
            "name": self.name,
            "version": STATE_VERSION,
            "settings": hashlib.sha256(known.encode()).hexdigest()[:16],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a copy made by `state` of an estimator of the same name, settings, place and sensors.

        Raises:
            EstimationError: a state of another estimator, or one that is damaged. The estimator is as it was then.
        """
        for key, own in self._owner().items():
            if state.get(key) != own:
                raise EstimationError(
                    f"{self.name}: cannot go on from a state whose {key} is '{state.get(key)}', not '{own}'"
                )
        stretch, kept, carry = Stretch.make(), state.get("filter"), None
        self._copy("stretch", state.get("stretch"), stretch.data)
        if kept is not None:
            alignment = concluded(Stretch.make(), False, self.site, self.sensors)  # any: the shapes are what counts
            carry = start(self._model, self.settings, self.site, self.sensors, alignment)
            for name, array in _arrays(carry):
                self._copy(name, kept.get(name) if isinstance(kept, Mapping) else None, array)
        self._stretch, self._carry = stretch, carry

    def _copy(self, name: str, value: Any, to: np.ndarray) -> None:
        if not isinstance(value, np.ndarray) or value.shape != to.shape or value.dtype != to.dtype:
            found = f"{value.dtype}{value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
            raise EstimationError(f"{self.name}: the state's {name} is {found}, expected {to.dtype}{to.shape}")
        to[...] = value


def _arrays(part: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of nested NamedTuples with their names."""
    for key in part._fields:
        value = getattr(part, key)
        if isinstance(value, np.ndarray):
            yield f"{name}{key}", value
        elif isinstance(value, np.void | Record):  # a record: the array that it is a view of
            yield f"{name}{key}", cast("np.ndarray", value.base if JIT else value.data)
        else:
            yield from _arrays(value, f"{name}{key}.")


def _rows(samples: Samples, sensors: SensorInfo) -> Rows:
    """Contiguous columns, accelerometer and magnetometer as if they had been read with the gyro.

    Raises:
        SampleError: a column whose shape does not fit the time stamps.
    """
    n, columns = len(samples.t), {}
    for f in fields(Samples):
        column, shape = getattr(samples, f.name), (n, *f.metadata["shape"])
        if np.shape(column) != shape:
            raise SampleError(f"Samples: {f.name} has shape {np.shape(column)}, expected {shape}")
        columns[f.name] = np.ascontiguousarray(column, f.metadata["dtype"])
    for name, delay in (("accel_b", sensors.accel_delay), ("mag_b", sensors.mag_delay)):
        if delay != sensors.gyro_delay:
            columns[name] = columns[name].copy()
            turn_readings(columns["gyro_b"], columns[name], delay - sensors.gyro_delay)
    columns["gnss_t"] = columns["gnss_t"] + sensors.accel_delay
    columns["heading_t"] = columns["heading_t"] + sensors.gyro_delay
    return Rows(*(columns[name] for name in Rows._fields))


def parameters(settings: Mapping[str, Any], site: Site, sensors: SensorInfo) -> Parameters:
    """Return the constant parameters of a flight, from settings (see the catalogue), place and data sheet."""
    flicker = FLICKER * sensors.gyro_instability
    gyro = sensors.gyro_noise**2 / 2.0  # single-sided density d: variance d^2/2 per second
    gyro += 2.0 * flicker**2 * 1.1  # the terms of 1 s and 0.1 s
    accel = sensors.accel_noise**2 / 2.0
    white = settings["position_share"]
    position = max(sensors.gnss_pos, 1e-3)
    wander = position * math.sqrt(max(1.0 - white**2, 0.0))
    baseline = sensors.heading * math.sqrt(max(1.0 - settings["heading_share"] ** 2, 0.0))
    decay, walk, settled = np.zeros(N), np.zeros(N), np.zeros(N)
    walk[POS : POS + 3] = 1e-6
    walk[GYRO_BIAS : GYRO_BIAS + 3] = (flicker**2 + sensors.gyro_drift**2) / settings["bias_time"]
    walk[ACCEL_BIAS : ACCEL_BIAS + 3] = (
        2.0 * (FLICKER * sensors.accel_instability) ** 2 + sensors.accel_drift**2
    ) / settings["bias_time"]
    for at, time, sigma in (
        (GYRO_FAST, FAST_TIME, np.full(3, flicker)),
        (GYRO_SLOW, SLOW_TIME, np.full(3, flicker)),
        (WANDER, settings["position_time"], wander * np.array([1.0, 1.0, UP])),
        (BASELINE, settings["heading_time"], np.array([baseline])),
    ):
        decay[at : at + len(sigma)] = 1.0 / time
        settled[at : at + len(sigma)] = sigma**2
    walk[HARD_IRON : HARD_IRON + 3] = sensors.mag_wander**2 / settings["iron_time"]
    return Parameters(
        gravity=float(site.gravity),
        origin=np.array(site.lla, float),
        mag_n=np.array(site.mag_n, float),
        antenna_b=np.array(sensors.antenna_b, float),
        gyro_delay=sensors.gyro_delay,
        accel_delay=sensors.accel_delay,
        gyro_psd=gyro + settings["gyro_noise"] ** 2 / 2.0 + 1e-12,
        rate_noise=2.0 * SCALE_TIME * (settings["scale_share"] * sensors.gyro_scale) ** 2,
        jerk_share=settings["jerk_share"],
        accel_psd=accel + settings["accel_noise"] ** 2 / 2.0,
        shake_share=settings["shake_share"],
        shake_most=settings["shake_most"] ** 2 / 2.0,
        accel_noise2=settings["accel_share"] ** 2 / 2.0,
        decay=decay,
        walk=walk,
        settled=settled,
        iron_step=sensors.mag_wander**2,
        still=np.array(limits(sensors)),
        gnss_velocity=max(settings["velocity_share"] * LEVEL * sensors.gnss_vel, 1e-3),
        gnss_position=max(white * position, 1e-3),
        gnss_time=settings["gnss_time"],
        mag_noise=max(sensors.mag_noise, 1e-9),
        mag_floor=settings["mag_floor"] * math.hypot(*site.mag_n),
        baseline_share=settings["heading_share"],
        surprise=settings["surprise"],
        field_off=settings["field_off"],
        use_heading=bool(settings["heading_aid"]),
    )


def deviations(settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment) -> np.ndarray:
    """First sigmas (N,) of the error state."""
    sigma = np.zeros(N)
    still = alignment.still
    sigma[PHI : PHI + 3] = np.minimum(ALIGNMENT_SHARE * alignment.sigma_n, NO_HEADING) if still else alignment.sigma_n
    sigma[VEL : VEL + 3] = 3.0 if np.isfinite(alignment.vel_n).all() else 30.0 if alignment.moving else 0.1
    sigma[POS : POS + 3] = 100.0
    sigma[GYRO_BIAS : GYRO_BIAS + 3] = max(sensors.gyro_bias, 1e-5)
    sigma[ACCEL_BIAS : ACCEL_BIAS + 3] = max(sensors.accel_bias, 1e-4)
    off = ~np.eye(3, dtype=bool).ravel()
    for at, scale, beside in (
        (GYRO_MATRIX, sensors.gyro_scale_factor, sensors.gyro_misalignment),
        (ACCEL_MATRIX, sensors.accel_scale_factor, sensors.accel_misalignment),
        (MAG_MATRIX, math.hypot(sensors.mag_scale_factor, sensors.soft_iron),
         math.hypot(sensors.mag_misalignment, sensors.soft_iron / math.sqrt(2.0))),
    ):  # fmt: skip
        sigma[at : at + 9] = np.where(off, beside, scale)
    sigma[HARD_IRON : HARD_IRON + 3] = math.hypot(sensors.mag_bias, sensors.mag_wander)
    sigma[FIELD : FIELD + 3] = sensors.field_error
    sigma[BASELINE + 1 : BASELINE + 3] = sensors.heading_mount
    sigma[LATE] = settings["late_sigma"]
    sigma[:] *= np.where(np.isin(np.arange(N), np.r_[GYRO_MATRIX:WANDER]), settings["prior_share"], 1.0)
    return sigma


def start(
    model: Parameters, settings: Mapping[str, Any], site: Site, sensors: SensorInfo, alignment: Alignment
) -> Carry:
    """The first state and its covariance."""
    sigma = deviations(settings, site, sensors, alignment)
    P = np.diag(sigma**2 + model.settled)
    C = np.empty((3, 3))
    attitude_matrix(alignment.q_nb, C)
    c = np.zeros(N)
    if alignment.still:  # the mean rate is the sum of all terms of the bias
        earth = 7.292115e-5 * np.array([math.cos(site.lla[0]), 0.0, -math.sin(site.lla[0])])
        learnt_bias(P, c, alignment.gyro_bias - C @ earth, alignment.gyro_bias_sigma)
    restart = sigma.copy()
    restart[PHI : PHI + 3], restart[VEL : VEL + 3] = 0.5, 10.0
    known = bool(np.isfinite(alignment.vel_n).all())
    nominal = Nominal(
        q=alignment.q_nb.copy(),
        v=alignment.vel_n.copy() if known else np.zeros(3),
        lla=alignment.lla.copy() if np.isfinite(alignment.lla).all() else np.array(site.lla, float),
        c=c,
    )
    batch = Batch(
        np.zeros((MOVING, COUPLED)), np.zeros(TOTALS), np.zeros(3), np.zeros(2), np.zeros((3, N)), np.zeros(3)
    )
    clear(batch)
    turned = argument(Turned.zeros())
    begin(turned)
    seen = np.full(SEEN, np.nan)
    seen[[IS_STILL, WAS_STILL, COUNT, JERK, SHAKE]], seen[GOOD] = 0.0, 1.0
    memory = Memory(
        clock=np.full(CLOCKS, np.nan),
        last=np.full((2, 3), np.nan),
        mean=np.zeros((2, 3)),
        step=np.zeros((2, 3)),
        second=np.zeros((2, 6)),
        seen=seen,
        turned=turned,
        history=History.make(),
    )
    safe = np.zeros(10 + N)
    store(nominal, safe)
    return Carry(nominal, P, np.diag(restart**2 + model.settled), batch, memory, safe)


def learnt_bias(P: np.ndarray, c: np.ndarray, rate: np.ndarray, sigma: np.ndarray) -> None:
    """Condition the terms of the gyro's bias on their sum, measured standing."""
    for i in range(3):
        at = np.array([GYRO_BIAS, GYRO_FAST, GYRO_SLOW]) + i
        prior = P[np.ix_(at, at)]
        variance = prior.sum() + sigma[i] ** 2
        gain = prior.sum(axis=1) / variance
        c[at] = gain * rate[i]
        P[np.ix_(at, at)] = prior - np.outer(gain, gain) * variance
