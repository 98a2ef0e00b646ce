"""Other people's attitude filters in the same table: VQF, imufusion, turbo-ckf, attipy, smsfusion, three of `ahrs`.

    estimator = estimators.create("vqf", site=site, sensors=sensors, aiding="airspeed")

Each needs its own package (all of them: `pip install 'ahrs-sim[peers]'`) and is used as its authors show, with its own
defaults. They disagree on every convention; this is what each takes and gives:

    vqf        specific force, rad/s                 body to east, magnetic north, up
    imufusion  specific force in g, deg/s            body to magnetic north, east, down
    madgwick   minus specific force, rad/s           body to magnetic north, east, down
    mahony     specific force, rad/s                 body to east, magnetic north, up
    ahrs-ekf   minus specific force, rad/s           body to true north, east, down (it is given the field)
    turbo-ckf  minus specific force, rad/s           body to magnetic north, east, down
    attipy     specific force, rad/s, heading        body to north, east, down
    smsfusion  specific force, rad/s, heading        body to north, east, down

The declination is applied here, once, to those that know magnetic north only, and to the heading of the last two: that
of the field, levelled by the specific force. Those two take the velocity of GNSS, too (`aiding = "gnss"`), and the
field is then levelled by their own tilt; without it they assume, as their packages do, a velocity of 0 +- 10 m/s.

Limits, the same for all: a peer starts with the first row that has gyro, accelerometer and magnetometer; a slower
magnetometer is used as latched. A row whose gyro or accelerometer is missing, or whose time stamp does not advance,
leaves the estimate as it is (COASTING); a gap counts as `MAX_STEP`. VQF, attipy and smsfusion know a fixed rate only:
the nominal one.
"""

import importlib
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.world import gravity
from estimators.errors import SampleError, SettingError
from estimators.settings import Setting, checked
from estimators.types import Estimates, Samples, SensorInfo, Site, Status, blank

MAX_STEP = 0.5
"""s, longest step from one row to the next that a peer is given."""

BACKWARDS = 1.0
"""s: a time stamp that goes further back is another recording, not jitter."""

_NED = (1.0, 0.0, 0.0, 0.0)
_ENU = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)  # turns east-north-up vectors into north-east-down

AIDING: dict[str, Setting] = {
    "aiding": Setting("none", "what is taken off the accelerometer before the peer sees it", ("none", "airspeed")),
    "speed_filter": Setting(0.5, "s, time constant of the derivative of the airspeed", above=0.0),
    "speed_min": Setting(8.0, "m/s, below it the airspeed may be wind on the ground: not used", minimum=0.0),
}


class AirspeedAid:
    """Takes the acceleration of coordinated flight off the specific force: `f - w x (V, 0, 0) - (dV/dt, 0, 0)`.

    V is the true airspeed as latched, dV/dt its derivative through a first-order low pass. Where there is no airspeed,
    or one below `speed_min`, f stays as it is.
    """

    def __init__(self, speed_filter: float, speed_min: float) -> None:
        self._tau, self._least = speed_filter, speed_min
        self._t = self._smooth = math.nan

    def correct(self, samples: Samples) -> np.ndarray:
        """Corrected specific force (n, 3), m/s2."""
        speed, slope = np.where(samples.airspeed >= self._least, samples.airspeed, 0.0), np.zeros(len(samples))
        for k, (t, now) in enumerate(zip(samples.t.tolist(), samples.airspeed.tolist(), strict=True)):
            if not now >= self._least:
                self._smooth = math.nan
                continue
            if not math.isfinite(self._smooth):
                self._t, self._smooth = t, now
            slope[k] = (now - self._smooth) / self._tau
            if t > self._t:
                self._smooth += (now - self._smooth) * -math.expm1((self._t - t) / self._tau)
                self._t = t
        corrected = samples.accel_b.copy()
        corrected[:, 0] -= slope
        corrected[:, 1] -= samples.gyro_b[:, 2] * speed
        corrected[:, 2] += samples.gyro_b[:, 1] * speed
        return corrected


class Peer:
    """Base class of the peers: settings, missing rows, frames; one row of `Estimates` for each row of `Samples`."""

    NAME: ClassVar[str]
    PACKAGE: ClassVar[str]
    SOURCE: ClassVar[str]
    EARTH: ClassVar[tuple[float, float, float, float]]  # quaternion from its Earth axes to north-east-down
    MAGNETIC: ClassVar[bool] = True  # its north is magnetic
    SETTINGS: ClassVar[Mapping[str, Setting]] = AIDING

    velocity_n: np.ndarray
    """(m, 3) m/s, north, east, down, of the rows that `feed` runs: of GNSS, NaN where none has just come."""

    def __init__(self, *, site: Site | None = None, sensors: SensorInfo | None = None, **settings: Any) -> None:
        """Make a peer for a place and a grade of sensors.

        Raises:
            SettingError: an unknown setting or an impossible value, or the package is not installed.
        """
        self.site = site if site is not None else Site((0.0, 0.0, 0.0))
        self.sensors = sensors if sensors is not None else SensorInfo()
        self.settings = checked(self.NAME, self.SETTINGS, settings)
        try:
            self._package: Any = importlib.import_module(self.PACKAGE)
        except ImportError as error:
            raise SettingError(
                f"estimator '{self.NAME}' needs the package '{self.PACKAGE}': pip install 'ahrs-sim[peers]'"
            ) from error
        north, east, _ = self.site.mag_n
        half = 0.5 * math.atan2(east, north) if self.MAGNETIC else 0.0
        self._q_ne = attitude.product(np.array([math.cos(half), 0.0, 0.0, math.sin(half)]), np.array(self.EARTH))
        self.reset()

    def number(self, name: str) -> float:
        """Read a numeric setting."""
        return float(self.settings[name])

    def reset(self) -> None:
        """Forget everything seen."""
        self._t = math.nan  # of the last row used
        self._last: dict[str, np.ndarray] = {}
        self._aid: AirspeedAid | None = None
        if self.settings["aiding"] == "airspeed":
            self._aid = AirspeedAid(self.number("speed_filter"), self.number("speed_min"))

    def start(self, accel_b: np.ndarray, mag_b: np.ndarray) -> None:
        """Make the filter, at the first row that has everything."""
        raise NotImplementedError

    def feed(self, dt: np.ndarray, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray) -> dict[str, np.ndarray]:
        """Run rows through the filter.

        Args:
            dt: (m,) s since the row before.
            gyro_b: (m, 3) rad/s.
            accel_b: (m, 3) m/s2, specific force.
            mag_b: (m, 3) T; all of a block are NaN or none is.

        Returns:
            `q` (m, 4), from body to the filter's own Earth axes, and any other columns of `Estimates`.
        """
        raise NotImplementedError

    def process(self, samples: Samples) -> Estimates:
        """Estimate: one row for each row of samples; any block length gives the same.

        Raises:
            SampleError: a column of a wrong shape, or a time stamp that is not finite or more than a second back.
        """
        self._check(samples)
        n = len(samples)
        out = blank(Estimates, n)
        out["t"][:] = samples.t
        accel_b = self._aid.correct(samples) if self._aid is not None else samples.accel_b
        usable = np.isfinite(samples.gyro_b).all(axis=1) & np.isfinite(accel_b).all(axis=1)
        magnetic = np.isfinite(samples.mag_b).all(axis=1)
        velocity_n = np.where(samples.gnss_new[:, None], samples.vel_n, math.nan)
        if math.isnan(self._t):
            first = np.flatnonzero(usable & magnetic)
            if not len(first):
                return Estimates(**out)
            usable[: first[0]] = False
            self.start(accel_b[first[0]], samples.mag_b[first[0]])
            self._t = float(samples.t[first[0]]) - 1.0 / self.sensors.rate
        latest = np.maximum.accumulate(np.concatenate([[self._t], np.where(usable, samples.t, -np.inf)]))
        usable &= samples.t > latest[:-1]
        rows = np.flatnonzero(usable)
        columns: dict[str, np.ndarray] = {}
        if len(rows):
            dt = np.diff(np.concatenate([[self._t], samples.t[rows]]))
            self._t = float(samples.t[rows[-1]])
            columns = self._run(rows, dt, samples.gyro_b, accel_b, samples.mag_b, magnetic, velocity_n)
            out["status"][rows] = np.where(dt > MAX_STEP, Status.COASTING, Status.RUNNING)
            out["status"][rows[np.isnan(columns["q_nb"][:, 0])]] = Status.ALIGNING
        self._fill(out, rows, columns)
        return Estimates(**out)

    def _run(
        self,
        rows: np.ndarray,
        dt: np.ndarray,
        gyro_b: np.ndarray,
        accel_b: np.ndarray,
        mag_b: np.ndarray,
        magnetic: np.ndarray,
        velocity_n: np.ndarray,
    ) -> dict[str, np.ndarray]:
        """Run all usable rows, in stretches with and without a magnetometer."""
        cuts = np.flatnonzero(np.diff(magnetic[rows])) + 1
        parts = []
        for part in np.split(np.arange(len(rows)), cuts):
            k = rows[part]
            self.velocity_n = velocity_n[k]
            made = self.feed(np.minimum(dt[part], MAX_STEP), gyro_b[k], accel_b[k], mag_b[k])
            made["q_nb"] = attitude.product(self._q_ne, made.pop("q"))
            made["down_b"] = attitude.down(made["q_nb"])
            parts.append(made)
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _fill(self, out: dict[str, np.ndarray], rows: np.ndarray, columns: dict[str, np.ndarray]) -> None:
        """Write the rows that were run; the others repeat the one before them."""
        n = len(out["t"])
        source = np.zeros(n, int)
        source[rows] = np.arange(1, len(rows) + 1)
        source = np.maximum.accumulate(source)  # 0: the last row of the blocks before
        for name in columns or self._last:
            before = self._last.get(name)
            if before is None:
                before = np.full(columns[name].shape[1:], np.nan)
            known = np.concatenate([before[None], columns[name]]) if columns else before[None]
            out[name][:] = known[source]
            self._last[name] = known[-1]
        held = (out["status"] == Status.ALIGNING) & np.isfinite(out["q_nb"][:, 0])
        out["status"][held] = Status.COASTING

    def _check(self, samples: Samples) -> None:
        n = len(samples)
        for name in ("t", "gyro_b", "accel_b", "mag_b", "airspeed"):
            shape = (n, 3) if name.endswith("_b") else (n,)
            if getattr(samples, name).shape != shape:
                raise SampleError(f"{self.NAME}: {name} has shape {getattr(samples, name).shape}, expected {shape}")
        if n:
            before = np.fmax.accumulate(np.concatenate([[self._t], samples.t[:-1]]))
            bad = np.flatnonzero(~np.isfinite(samples.t) | (samples.t < before - BACKWARDS))
            if len(bad):
                raise SampleError(f"{self.NAME}: time stamp {samples.t[bad[0]]} in row {bad[0]} after {before[bad[0]]}")


class Vqf(Peer):
    """VQF (Laidig and Seel 2023): separate tilt and heading corrections, gyro bias, magnetic disturbance rejection."""

    SOURCE = "Laidig and Seel 2023"
    NAME, PACKAGE, EARTH = "vqf", "vqf", _ENU
    SETTINGS: ClassVar[Mapping[str, Setting]] = {
        **AIDING,
        "tau_acc": Setting(3.0, "s, time constant of the tilt correction", above=0.0),
        "tau_mag": Setting(9.0, "s, time constant of the heading correction", above=0.0),
        "motion_bias": Setting(True, "estimate the gyro bias in motion"),
        "rest_bias": Setting(True, "estimate the gyro bias at rest"),
        "mag_rejection": Setting(True, "reject magnetic disturbances"),
    }

    def start(self, accel_b: np.ndarray, mag_b: np.ndarray) -> None:
        """Make the filter."""
        self._filter = self._package.VQF(
            1.0 / self.sensors.rate,
            tauAcc=self.number("tau_acc"),
            tauMag=self.number("tau_mag"),
            motionBiasEstEnabled=self.settings["motion_bias"],
            restBiasEstEnabled=self.settings["rest_bias"],
            magDistRejectionEnabled=self.settings["mag_rejection"],
        )

    def feed(self, dt: np.ndarray, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray) -> dict[str, np.ndarray]:
        """Run rows through the filter."""
        gyro_b, accel_b = np.ascontiguousarray(gyro_b), np.ascontiguousarray(accel_b)
        if np.isfinite(mag_b[0, 0]):
            made = self._filter.updateBatch(gyro_b, accel_b, np.ascontiguousarray(mag_b))
            q = made["quat9D"]
        else:
            made = self._filter.updateBatch(gyro_b, accel_b)
            heading = 0.5 * float(self._filter.state["delta"])  # held: from the Earth axes of 6D to those of 9D
            q = attitude.product(np.array([math.cos(heading), 0.0, 0.0, math.sin(heading)]), made["quat6D"])
        sigma = np.repeat(made["biasSigma"][:, None], 3, axis=1)
        return {"q": q, "gyro_bias": made["bias"], "gyro_bias_sigma": sigma}


class Imufusion(Peer):
    """Fusion of x-io Technologies: Madgwick's revised filter, with acceleration and magnetic rejection and gyro bias.

    The defaults are those of the package, which are without rejection; its examples set both rejections to 10 deg and
    the time-out to 5 s. While the package says that it starts up (3 s) there is no attitude.
    """

    SOURCE = "Madgwick 2014, chapter 7; x-io Technologies"
    NAME, PACKAGE, EARTH = "imufusion", "imufusion", _NED
    SETTINGS: ClassVar[Mapping[str, Setting]] = {
        **AIDING,
        "gain": Setting(0.5, "rad/s, how fast the gyro is corrected", minimum=0.0),
        "acceleration_rejection": Setting(0.0, "deg, 0: none", minimum=0.0, maximum=90.0),
        "magnetic_rejection": Setting(0.0, "deg, 0: none", minimum=0.0, maximum=90.0),
        "rejection_timeout": Setting(0.0, "s", minimum=0.0),
        "gyroscope_range": Setting(0.0, "deg/s, 0: unknown", minimum=0.0),
        "bias": Setting(
            True, "take off the gyro bias found at rest, as the package's examples do; up to 3 deg/s is rest"
        ),
    }

    def start(self, accel_b: np.ndarray, mag_b: np.ndarray) -> None:
        """Make the filter."""
        package = self._package
        settings = package.AhrsSettings()
        settings.convention = package.CONVENTION_NED  # as a keyword it would be ignored
        settings.sample_rate = self.sensors.rate
        for name in ("gain", "gyroscope_range", "acceleration_rejection", "magnetic_rejection", "rejection_timeout"):
            setattr(settings, name, self.number(name))
        self._filter = package.Ahrs()
        self._filter.set_settings(settings)
        self._bias = package.Bias()
        at_rest = package.BiasSettings()
        at_rest.sample_rate = self.sensors.rate
        self._bias.set_settings(at_rest)

    def feed(self, dt: np.ndarray, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray) -> dict[str, np.ndarray]:
        """Run rows through the filter."""
        q, bias = np.empty((len(dt), 4)), np.full((len(dt), 3), np.nan)
        gyro, accel, mag = np.degrees(gyro_b), accel_b / gravity.STANDARD, 1e6 * mag_b  # deg/s, g, uT
        magnetic, unbiased = np.isfinite(mag[0, 0]), self.settings["bias"]
        for k in range(len(dt)):
            rate = gyro[k]
            if unbiased:
                rate = self._bias.update(rate)
                bias[k] = self._bias.get_offset()
            self._filter.set_sample_period(float(dt[k]))
            if magnetic:
                self._filter.update(rate, accel[k], mag[k])
            else:
                self._filter.update_no_magnetometer(rate, accel[k])
            q[k] = math.nan if self._filter.get_flags().startup else self._filter.get_quaternion()
        return {"q": q, "gyro_bias": np.radians(bias)}


class _OfAhrs(Peer):
    """A filter of the package `ahrs`: a function from quaternion and sample to the next quaternion."""

    PACKAGE = "ahrs"
    DOWNWARDS: ClassVar[float] = 1.0  # -1 when it takes the accelerometer for a sensor of gravity

    def start(self, accel_b: np.ndarray, mag_b: np.ndarray) -> None:
        """Make the filter, and its first attitude from the first sample, as the package does."""
        self._filter = self.make()
        q_nb = _from_vectors(-accel_b, mag_b)
        self._q = attitude.product(attitude.conjugate(np.array(self.EARTH)), q_nb)
        if not self.MAGNETIC:
            north, east, _ = self.site.mag_n
            half = 0.5 * math.atan2(east, north)
            self._q = attitude.product(np.array([math.cos(half), 0.0, 0.0, math.sin(half)]), self._q)

    def make(self) -> Any:
        """Make the filter object."""
        raise NotImplementedError

    def step(self, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray | None, dt: float) -> np.ndarray:
        """Compute the next quaternion (4,)."""
        if mag_b is None:
            return np.asarray(self._filter.updateIMU(self._q, gyro_b, accel_b, dt=dt))
        return np.asarray(self._filter.updateMARG(self._q, gyro_b, accel_b, mag_b, dt=dt))

    def more(self) -> dict[str, np.ndarray]:
        """Other columns of one row of `Estimates`, by name."""
        return {}

    def feed(self, dt: np.ndarray, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray) -> dict[str, np.ndarray]:
        """Run rows through the filter."""
        accel, magnetic = self.DOWNWARDS * accel_b, bool(np.isfinite(mag_b[0, 0]))
        rows: dict[str, list[np.ndarray]] = {"q": []}
        for k in range(len(dt)):
            # At a rate of exactly zero the package skips the whole update.
            rate = gyro_b[k] if gyro_b[k].any() else np.full(3, 1e-12)
            self._q = self.step(rate, accel[k], 1e9 * mag_b[k] if magnetic else None, float(dt[k]))
            rows["q"].append(self._q)
            for name, value in self.more().items():
                rows.setdefault(name, []).append(value)
        return {name: np.array(values) for name, values in rows.items()}


class Madgwick(_OfAhrs):
    """Madgwick's gradient descent (2010)."""

    SOURCE = "Madgwick 2010"
    NAME, EARTH, DOWNWARDS = "madgwick", _NED, -1.0
    SETTINGS: ClassVar[Mapping[str, Setting]] = {
        **AIDING,
        "gain": Setting(0.041, "rad/s, of the correction", minimum=0.0),
    }

    def make(self) -> Any:
        """Make the filter object."""
        return self._package.filters.Madgwick(gain=self.number("gain"))


class Mahony(_OfAhrs):
    """Mahony's complementary filter on SO(3) with gyro bias (2008)."""

    SOURCE = "Mahony, Hamel and Pflimlin 2008"
    NAME, EARTH = "mahony", _ENU
    SETTINGS: ClassVar[Mapping[str, Setting]] = {
        **AIDING,
        "k_p": Setting(1.0, "rad/s, proportional gain", minimum=0.0),
        "k_i": Setting(0.3, "rad/s2, integral gain (the gyro bias)", minimum=0.0),
    }

    def make(self) -> Any:
        """Make the filter object."""
        return self._package.filters.Mahony(k_P=self.number("k_p"), k_I=self.number("k_i"))

    def more(self) -> dict[str, np.ndarray]:
        """Read the gyro bias."""
        return {"gyro_bias": np.array(self._filter.b, float)}


class AhrsEkf(_OfAhrs):
    """The quaternion EKF of `ahrs`, with the local field as reference."""

    SOURCE = "package ahrs"
    NAME, EARTH, DOWNWARDS, MAGNETIC = "ahrs-ekf", _NED, -1.0, False
    SETTINGS: ClassVar[Mapping[str, Setting]] = {
        **AIDING,
        "gyro_sigma": Setting(0.3, "rad/s", above=0.0),
        "accel_sigma": Setting(0.5, "of the direction of gravity", above=0.0),
        "mag_sigma": Setting(0.8, "of the direction of the field", above=0.0),
    }

    def make(self) -> Any:
        """Make the filter object."""
        noises = [self.number(name) ** 2 for name in ("gyro_sigma", "accel_sigma", "mag_sigma")]
        return self._package.filters.EKF(frame="NED", magnetic_ref=list(self.site.mag_n), noises=noises)

    def step(self, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray | None, dt: float) -> np.ndarray:
        """Compute the next quaternion (4,)."""
        self._filter.mag = mag_b  # its measurement model looks here, not at the argument
        return np.asarray(self._filter.update(self._q, gyro_b, accel_b, mag_b, dt=dt))

    def more(self) -> dict[str, np.ndarray]:
        """Covariance of the rotation vector r in body axes, `q exp_q(r)`: `r = 2 E^T dq`."""
        E = 4.0 * attitude.by_rotation(self._q)
        return {"att_cov": E.T @ self._filter.P @ E}


class TurboCkf(Peer):
    """The lightweight cubature filter of Yamagishi and Jing (2026) as the package `turbo-ckf` has it.

    A quaternion, propagated with the gyro (their equations 3 to 5), and directions of gravity and field; no gyro bias.
    The variances of the directions are those of the package's example; of the gyro's it names none. Without a
    magnetometer it only propagates, as the package has no update without one.
    """

    SOURCE = "Yamagishi and Jing 2026"
    NAME, PACKAGE, EARTH = "turbo-ckf", "turbo_ckf", _NED
    SETTINGS: ClassVar[Mapping[str, Setting]] = {
        **AIDING,
        "gyro_sigma": Setting(0.01, "rad/s, of a sample", above=0.0),
        "accel_sigma": Setting(0.1, "of the direction of gravity", above=0.0),
        "mag_sigma": Setting(0.1, "of the direction of the field", above=0.0),
    }

    def start(self, accel_b: np.ndarray, mag_b: np.ndarray) -> None:
        """Make the filter, its first attitude from the first sample."""
        self._filter = self._package.TurboCKF(dim_x=4, dim_z=6, dt=1.0 / self.sensors.rate, hx=_unused, fx=_unused)
        self._filter.x = _from_vectors(-accel_b, mag_b)
        self._filter.P = 0.1 * np.eye(4)

    def feed(self, dt: np.ndarray, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray) -> dict[str, np.ndarray]:
        """Run rows through the filter."""
        package, ckf, q = self._package, self._filter, np.empty((len(dt), 4))
        variances = [self.number(name) ** 2 for name in ("gyro_sigma", "accel_sigma", "mag_sigma")]
        magnetic = bool(np.isfinite(mag_b[0, 0]))
        for k in range(len(dt)):
            ckf.Q = package.process_noise_from_quaternion(ckf.x, float(dt[k]), variances[0])
            ckf.predict_linear_model(package.transition_matrix_from_gyro(gyro_b[k], float(dt[k])))
            if magnetic and accel_b[k].any():
                ckf.update_paper_ahrs(np.concatenate([-accel_b[k], 1e6 * mag_b[k]]), variances[1], variances[2])
            ckf.normalize_state_quaternion()
            q[k] = ckf.x
        return {"q": q}


class _Mekf(Peer):
    """A multiplicative EKF that is given a heading and a velocity: what its two packages share.

    Both begin with a milliradian and a milliradian per second, for one who knows the attitude. Here the first sample
    gives it: they are given `start_sigma`, the gyro bias of the grade and a velocity of 0 +- 1 m/s.
    """

    EARTH, MAGNETIC = _NED, False
    SETTINGS: ClassVar[Mapping[str, Setting]] = {
        **AIDING,
        "aiding": Setting(
            "none", "airspeed: taken off the accelerometer; gnss: its velocity is given to the peer",
            ("none", "airspeed", "gnss"),
        ),
        "heading_sigma": Setting(0.05, "rad, of the heading from the field", above=0.0),
        "velocity_sigma": Setting(0.1, "m/s, of the velocity of GNSS, as in attipy's example", above=0.0),
        "start_sigma": Setting(0.1, "rad, of the attitude that the first sample gives", above=0.0),
    }  # fmt: skip

    def start(self, accel_b: np.ndarray, mag_b: np.ndarray) -> None:
        """Make the filter, its first attitude from the first sample."""
        north, east, _ = self.site.mag_n
        self._declination = math.atan2(east, north)
        half = 0.5 * self._declination
        turn = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        self._filter = self.make(attitude.product(turn, _from_vectors(-accel_b, mag_b)))

    def first(self) -> np.ndarray:
        """Variances (3, 3) at the start: attitude, gyro bias, velocity; SI."""
        sigmas = [self.number("start_sigma"), max(self.sensors.gyro_bias, 1e-3), 1.0]
        return np.repeat(np.square(sigmas)[:, None], 3, axis=1)

    def make(self, q_nb: np.ndarray) -> Any:
        """Make the filter object from its first attitude (4,)."""
        raise NotImplementedError

    def step(
        self, gyro_b: np.ndarray, accel_b: np.ndarray, heading: float | None, velocity_n: np.ndarray | None
    ) -> None:
        """Run one row: heading in rad, velocity (3,) in m/s, None where there is none."""
        raise NotImplementedError

    def now(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Read quaternion (4,), gyro bias (3,) rad/s and covariance (3, 3) rad2 of the attitude in body axes."""
        raise NotImplementedError

    def feed(self, dt: np.ndarray, gyro_b: np.ndarray, accel_b: np.ndarray, mag_b: np.ndarray) -> dict[str, np.ndarray]:
        """Run rows through the filter."""
        q, bias, cov = np.empty((len(dt), 4)), np.empty((len(dt), 3)), np.empty((len(dt), 3, 3))
        aided, magnetic = self.settings["aiding"] == "gnss", bool(np.isfinite(mag_b[0, 0]))
        for k in range(len(dt)):
            level = self.now()[0] if aided else _from_vectors(-accel_b[k], mag_b[k])
            heading = self._heading(level, mag_b[k]) if magnetic else None
            velocity_n = self.velocity_n[k] if aided and np.isfinite(self.velocity_n[k]).all() else None
            self.step(gyro_b[k], accel_b[k], heading, velocity_n)
            q[k], bias[k], cov[k] = self.now()
        return {"q": q, "gyro_bias": bias, "att_cov": cov}

    def _heading(self, level: np.ndarray, mag_b: np.ndarray) -> float:
        """Compute the true heading (rad) of the field, levelled by the tilt of a quaternion (4,)."""
        north, east, _ = attitude.to_nav(level[None], mag_b[None])[0]
        return float(attitude.euler(level[None])[0, 2]) - math.atan2(east, north) + self._declination


class Attipy(_Mekf):
    """The AHRS of AttiPy: a multiplicative EKF of attitude, gyro bias and velocity, with its own noise figures."""

    SOURCE = "package attipy, Solum"
    NAME, PACKAGE = "attipy", "attipy"

    def make(self, q_nb: np.ndarray) -> Any:
        """Make the filter object."""
        return self._package.AHRS(self.sensors.rate, q_nb, P=np.diag(self.first().ravel()), g=self.site.gravity)

    def step(
        self, gyro_b: np.ndarray, accel_b: np.ndarray, heading: float | None, velocity_n: np.ndarray | None
    ) -> None:
        """Run one row."""
        aids: dict[str, Any] = {}
        if self.settings["aiding"] == "gnss":
            aids = {"v_n": velocity_n, "v_var": np.full(3, self.number("velocity_sigma") ** 2)}
        if heading is not None:
            aids |= {"yaw": heading, "yaw_var": self.number("heading_sigma") ** 2}
        self._filter.update(accel_b, gyro_b, **aids)

    def now(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Read attitude, gyro bias and covariance."""
        return self._filter.q_nb, self._filter.bg_b, self._filter.P[:3, :3]


class Smsfusion(_Mekf):
    """The AHRS of smsfusion, with velocity of GNSS its aided INS: a multiplicative EKF with its own noise figures."""

    SOURCE = "package smsfusion, 4Subsea"
    NAME, PACKAGE = "smsfusion", "smsfusion"

    def make(self, q_nb: np.ndarray) -> Any:
        """Make the filter object."""
        package, x = self._package, self._package.constants.X0.copy()
        x[6:10] = q_nb
        cls = package.AidedINS if self.settings["aiding"] == "gnss" else package.AHRS
        turned, biased, moving = self.first()
        P = np.diag(np.concatenate([np.full(3, 1e6), moving, turned, biased]))
        return cls(self.sensors.rate, x, P, g=self.site.gravity)

    def step(
        self, gyro_b: np.ndarray, accel_b: np.ndarray, heading: float | None, velocity_n: np.ndarray | None
    ) -> None:
        """Run one row."""
        aids: dict[str, Any] = {}
        if velocity_n is not None:
            aids = {"vel": velocity_n, "vel_var": np.full(3, self.number("velocity_sigma") ** 2)}
        if heading is not None:
            aids |= {"head": heading, "head_var": self.number("heading_sigma") ** 2, "head_degrees": False}
        self._filter.update(accel_b, gyro_b, **aids)

    def now(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Read attitude, gyro bias and covariance."""
        return self._filter.quaternion(), self._filter.bias_gyro(), self._filter.P[6:9, 6:9]


def _unused(points: np.ndarray) -> np.ndarray:
    """Stand in for the functions that TurboCKF wants and its AHRS path does not call."""
    return points


def _from_vectors(down_b: np.ndarray, mag_b: np.ndarray) -> np.ndarray:
    """Quaternion from body to magnetic north, east, down (TRIAD); the identity where that fails."""
    from estimators.rotations import triad

    q = np.array([1.0, 0.0, 0.0, 0.0])
    triad(np.ascontiguousarray(down_b), np.ascontiguousarray(mag_b), np.array([1.0, 0.0, 0.0]), q)
    return q
