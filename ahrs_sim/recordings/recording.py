"""A recording of others ready for a replay: topics chosen, axes checked, calibrated, place and field known."""

import dataclasses
import datetime
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

import estimators as library
from ahrs_sim.errors import InputError
from ahrs_sim.recordings import calibration as calibrating
from ahrs_sim.recordings import checks, choosing, clocks, frames, inertial, mapping, presets, survey
from ahrs_sim.recordings.choosing import RECORDED, Choice
from ahrs_sim.recordings.convert import Calibration, Converter
from ahrs_sim.recordings.installation import Installation, find
from ahrs_sim.recordings.mapping import SUITE, Map
from ahrs_sim.recordings.sources import DATES_FROM_NS, Source, open_source
from ahrs_sim.scenario import Component, Gate, code, estimator_component, short_name
from ahrs_sim.sensors.records import SuiteBlock, within
from ahrs_sim.world import gravity, magnetic
from estimators.types import SensorInfo, Site

_FOREIGN = Gate()
_UNKNOWN_PLACE = (math.radians(45.0), 0.0, 0.0)
_NO_FIELD = Site(_UNKNOWN_PLACE).mag_n
_SELDOM_HZ = 0.9
"""Rate of an IMU below which nothing can be made of it."""

_METHODS = (("ins21", "gnss"), ("air-ins", "airspeed"), ("hand-ins", "none"))
"""By what there is to aid them: the estimator, and the aiding of a general one in its stead."""


@dataclass
class Bag:
    """A recording ready for a replay; closes as a context manager."""

    source: Source
    site: Site
    sensors: SensorInfo
    estimators: Sequence[Component]
    converter: Converter
    metadata: dict[str, str]
    notes: list[str]
    span: tuple[float, float]  # s, what estimators see
    seen: survey.Survey
    mag_b: np.ndarray  # (n, 3) T, of the survey, calibrated and in FRD
    mapping: Map
    has_place: bool
    suspected: bool  # a wrong unit, axis or delay

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.source.close()

    @property
    def recorded(self) -> list[str]:
        """Names of the estimators whose attitudes came with the recording."""
        return [k.removeprefix(RECORDED) for k in self.converter.chosen if k.startswith(RECORDED)]

    @property
    def instruments(self) -> list[str]:
        """Kinds of records that come."""
        kinds = [k for k in self.converter.chosen if k != "accel" and not k.startswith(RECORDED)]
        return [*kinds, "air"] if "diff_pressure" in kinds and "air" not in kinds else kinds

    def installation(self) -> Installation:
        """Find how its sensors are installed, as far as the recording shows it."""
        dip = magnetic.dip(np.array(self.site.mag_n)) if self.has_place else None
        return find(self.seen, self.mag_b, self.mapping, self.site.gravity, dip)

    def blocks(self) -> Iterator[dict[str, SuiteBlock]]:
        """Yield records by suite, in order; once."""
        topics = [c.topic.name for c in self.converter.chosen.values()]
        for block in self.converter.records(self.source.blocks(topics)):
            yield {SUITE: within(block, *_nanoseconds(self.span))}

    def counted(self) -> list[str]:
        """List what was wrong with the messages, after the last block."""
        return [f"{what}: {n}" for what, n in sorted(self.converter.counts.items()) if n]


def open_bag(
    path: Path,
    *,
    map_file: Path | None,
    calibrate: Sequence[str] = (),
    sync: bool = False,
    names: Sequence[str] = (),
    span: tuple[float, float] = (0.0, math.inf),
    gate: Gate = _FOREIGN,
    reference: str | None = None,
    date: datetime.datetime | None = None,
) -> Bag:
    """Open a recording, choose its topics, look at it once.

    Args:
        path: an MCAP, db3, CSV or ULog file.
        map_file: the user's map.
        calibrate: "mag": fit hard and soft iron and keep what helps, "auto": where the map has none; "gyro": take the
            bias of standing stretches out.
        sync: shift the reference attitude so that it agrees with the gyro in time.
        names: estimators: of the map, or methods of the catalogue; none: all of the map, else one that fits.
        span: s from the beginning; what was measured outside of it is left out.
        gate: what code from outside may run besides that of `names`.
        reference: topic of the reference attitude, before what the map says.
        date: of the recording, before what the map or its times say.

    Raises:
        InputError: the file, the map or something asked for is wrong.
    """
    gate = gate.also(code.named(names))
    preset = presets.fitting(path) if map_file is None else None
    map_ = mapping.load(Path(f"{presets.PREFIX}{preset}") if preset else map_file, gate)
    if reference is not None:
        map_ = dataclasses.replace(map_, topics={**map_.topics, "reference": reference})
    map_ = dataclasses.replace(map_, date=date or map_.date)
    source = open_source(path, map_.table)
    if preset:
        source.notes.insert(0, f"files and columns are those of --map {presets.PREFIX}{preset}")
    try:
        return _opened(source, map_, calibrate, sync, names, span, gate)
    except InputError as error:
        source.close()
        raise type(error)("; ".join([str(error), *source.notes[:2]])) from None
    except BaseException:
        source.close()
        raise


def _opened(
    source: Source,
    map_: Map,
    calibrate: Sequence[str],
    sync: bool,
    names: Sequence[str],
    span: tuple[float, float],
    gate: Gate,
) -> Bag:
    chosen, seen, clock, notes = _looked(source, map_, span)
    seen, held = _moving_reference(seen, map_, notes)
    place = _place(seen, map_)
    model = _field(place, source, map_, notes)
    norm = float(np.linalg.norm(model)) if model is not None else None
    lla = place or _UNKNOWN_PLACE
    track = inertial.track(seen, gravity_at(lla), lever=True)
    calibration, kept, left = _calibrated(seen, map_, chosen, calibrate, norm, track, notes)
    axes = map_.mag_axes(chosen["mag"].body if "mag" in chosen else "FLU")
    mag_b = map_.corrected((seen.mag - calibration.hard_iron) @ (axes @ calibration.soft_iron).T)
    if model is None:
        model = survey.field_at_rest(seen, mag_b)
        if model is not None:
            notes.append(
                f"no position: heading is from magnetic north, field {_vector(model * 1e6)} uT from the data"
                if not map_.place.get("declination_deg")
                else "no position: field from the data, declination from the map"
            )
            model = _turned(model, map_.place.get("declination_deg"))
    reference = chosen.get("reference")
    delay = survey.reference_delay(seen) if reference else None
    assumed = checks.Assumed(
        body=chosen["imu"].body,
        reference=(reference.body, reference.world) if reference else None,
        mag_axes=axes,
        mag_b=mag_b,
        field_n=model if place else None,
        delay=delay or 0.0,
    )
    suspected = checks.suspicions(seen, assumed, track)
    notes += [f"check: {line}" for line in [*suspected, *checks.missing(chosen, seen)]]
    map_ = _synchronised(delay, map_, sync, notes) if reference else map_
    site = Site(
        lla=lla,
        gravity=gravity_at(lla) if place else gravity.STANDARD,
        mag_n=_NO_FIELD if model is None else (float(model[0]), float(model[1]), float(model[2])),
    )
    figures = {"rate": seen.rate} | (map_.correction.sheet({}) if map_.correction else {})
    if math.isfinite(left):
        figures["mag_bias"] = math.hypot(SensorInfo().mag_bias, left)
    sensors = SensorInfo(**{**figures, **map_.sensors})
    components = _estimators(map_, names, chosen, str(source.path), gate)
    if names or map_.estimators:
        notes += [f"check: {line}" for line in checks.unaided(components, chosen)]
    components = _soon_aligned(components, seen, notes)
    metadata = {
        "source": source.path.name,
        **{f"topic {k}": f"{c.topic.name} {c.body} {c.world}" for k, c in chosen.items()},
    }
    metadata |= kept | {f"site {k}": _exact(v) for k, v in dataclasses.asdict(site).items()}
    metadata |= {f"note {i + 1}": note for i, note in enumerate(notes)}
    return Bag(
        source=source,
        site=site,
        sensors=sensors,
        estimators=components,
        converter=Converter(
            chosen, map_, calibration, source.epoch_ns, choosing.first_height(source, chosen), clock, held
        ),
        metadata=metadata,
        notes=notes,
        span=span,
        seen=seen,
        mag_b=mag_b,
        mapping=map_,
        has_place=place is not None,
        suspected=bool(suspected),
    )


def _looked(
    source: Source, map_: Map, span: tuple[float, float]
) -> tuple[dict[str, Choice], survey.Survey, clocks.Clocks, list[str]]:
    """Choose topics by kind and survey their messages within a span (s); return clocks and notes as well."""
    path = source.path
    passed: list[str] = []
    chosen = choosing.choose(source, map_, passed)
    chosen |= choosing.recorded(source, chosen.get("reference"))
    topics = [c.topic.name for c in chosen.values()]
    nothing = Calibration(np.zeros(3), np.eye(3), map_.gyro_bias)
    clock = clocks.examine(source, chosen, map_.stamps, {k for k, shift in map_.shifts.items() if shift}, span)
    first = Converter(chosen, map_, nothing, source.epoch_ns, choosing.first_height(source, chosen), clock)
    seen = survey.look(within(b, *_nanoseconds(span)) for b in _magnetometer_as_is(first, source, topics))
    if not len(seen.t) and (span[0] > 0.0 or span[1] < math.inf):
        raise InputError(f"{path}: --skip/--until: no message of {chosen['imu'].topic.name} is left")
    if not len(seen.t):
        raise InputError(f"{path}: {chosen['imu'].topic.name} has no usable message; check stamps and [time] stamps")
    if not seen.rate >= _SELDOM_HZ:
        raise InputError(
            f"{path}: {chosen['imu'].topic.name}: messages come less than once a second, too seldom for an attitude; "
            "is the unit of their times right? ([csv] time, unit)"
        )
    notes = [*choosing.described(chosen, clock.duration(source.duration)), *passed, *source.notes]
    notes += clock.notes
    return chosen, seen, clock, notes


def _moving_reference(
    seen: survey.Survey, map_: Map, notes: list[str]
) -> tuple[survey.Survey, list[tuple[float, float]]]:
    """Leave out where the reference stays while the gyro turns; return the spans (s of its own stamps) as well."""
    held = survey.held(seen)
    if not held:
        return seen, []
    seconds, times = sum(end - start for start, end in held), f", {len(held)} times" if len(held) > 1 else ""
    notes.append(
        f"reference: the very same for {seconds:.1f} s while the gyro turns, left out there: tracking lost, or not "
        f"begun (from {held[0][0]:.1f} s on{times})"
    )
    shift = map_.shifts["reference"] / 1e9
    return survey.without_held(seen, held), [(start - shift, end - shift) for start, end in held]


def _nanoseconds(span: tuple[float, float]) -> tuple[float, float]:
    """Convert a span (s) to ns; one from 0 begins with the very first message, stamped before it was logged."""
    return 1e9 * span[0] if span[0] > 0.0 else -math.inf, 1e9 * span[1]


def _magnetometer_as_is(converter: Converter, source: Source, topics: list[str]) -> Iterator[SuiteBlock]:
    """Turn the magnetometer of records back into the axes of its messages."""
    choice = converter.chosen.get("mag")
    axes = converter.mapping.mag_axes(choice.body) if choice else np.eye(3)
    for block in converter.records(source.blocks(topics)):
        if "mag" in block:
            mag: Any = block["mag"]
            block["mag"] = dataclasses.replace(mag, mag_b=mag.mag_b @ axes)
        yield block


def _place(seen: survey.Survey, map_: Map) -> tuple[float, float, float] | None:
    given = map_.place
    if "latitude_deg" in given:
        return math.radians(given["latitude_deg"]), math.radians(given["longitude_deg"]), given.get("altitude_m", 0.0)
    if seen.lla is None:
        return None
    latitude, longitude, height = (float(x) for x in seen.lla)
    return latitude, longitude, given.get("altitude_m", height)


def _field(place: tuple[float, float, float] | None, source: Source, map_: Map, notes: list[str]) -> np.ndarray | None:
    """Compute the field of the place (3,) T in NED, by the model of the date; None without a place."""
    if place is None:
        return None
    lla, middle = np.array([place]), 0.5 * (magnetic.FIRST + magnetic.LAST)
    date = map_.date
    if date is None and source.epoch_ns >= DATES_FROM_NS:
        date = datetime.datetime.fromtimestamp(source.epoch_ns / 1e9, datetime.UTC)
    year = middle if date is None else magnetic.decimal_year(date)
    if date is None:
        notes.append(
            f"the time starts at {source.epoch_ns / 1e9:.0f} s, which is no date: field of {middle:.1f} "
            "(--date, [time] date)"
        )
    if magnetic.FIRST <= year <= magnetic.LAST:
        field = magnetic.wmm(lla, min(year, magnetic.LAST - 0.01))[0]
    elif magnetic.IGRF_FIRST <= year < magnetic.FIRST:
        field = magnetic.igrf(lla, year)[0]
        notes.append(f"{year:.1f} is before WMM2025: field by IGRF-14")
    else:
        # The model says how the field changes; years away it is off by some tenths of a degree, not by degrees.
        ends = [magnetic.wmm(lla, y)[0] for y in (magnetic.FIRST, magnetic.LAST - 0.01)]
        years = min(max(year - magnetic.LAST, -25.0), 25.0)
        field = ends[1] + years * (ends[1] - ends[0]) / (magnetic.LAST - 0.01 - magnetic.FIRST)
        notes.append(
            f"{year:.1f} is {year - magnetic.LAST:.1f} years after WMM2025: field extrapolated with the model's "
            "secular variation ([place] declination_deg)"
        )
    field = _turned(field, map_.place.get("declination_deg"))
    declination = math.degrees(math.atan2(field[1], field[0]))
    notes.append(f"field of the place {_vector(field * 1e6)} uT NED, declination {declination:.2f} deg")
    return field


def _turned(field: np.ndarray, declination_deg: float | None) -> np.ndarray:
    if declination_deg is None:
        return field
    level, angle = math.hypot(field[0], field[1]), math.radians(declination_deg)
    return np.array([level * math.cos(angle), level * math.sin(angle), field[2]])


def _calibrated(
    seen: survey.Survey,
    map_: Map,
    chosen: Mapping[str, Choice],
    calibrate: Sequence[str],
    norm: float | None,
    track: inertial.Track | None,
    notes: list[str],
) -> tuple[Calibration, dict[str, str], float]:
    """Calibrate: what to take out of the sensors, the same as texts, and the sigma (T) of hard iron left (NaN)."""
    calibration, left = Calibration(map_.hard_iron, map_.soft_iron, map_.gyro_bias), math.nan
    if "mag" in calibrate and "mag" not in chosen:
        raise InputError("--calibrate mag: no magnetometer in this recording; leave it out")
    if "mag" in calibrate or ("auto" in calibrate and "mag" in chosen and not map_.has_iron):
        trial = calibrating.try_mag(seen, map_.mag_axes(chosen["mag"].body), norm, track)
        notes.append(f"magnetometer calibration {trial.line}")
        left = trial.left
        if (fit := trial.fit) is not None:
            calibration = dataclasses.replace(calibration, hard_iron=fit.hard_iron, soft_iron=fit.soft_iron)
            sigma = _vector(fit.hard_sigma * 1e6)
            notes.append(f"hard iron {_vector(fit.hard_iron * 1e6)} uT +- {sigma}; lines for a map:")
            notes.append(f"  [magnetometer]\n  hard_iron = {_list(fit.hard_iron / map_.mag_unit)}")
            notes.append(f"  soft_iron = {_list(fit.soft_iron.round(6) + 0.0)}")
    if "gyro" in calibrate:
        found = calibrating.gyro_bias(seen)
        if found is None:
            raise InputError("--calibrate gyro: the recording never stands still for a second; leave it out")
        bias_b, seconds = found
        axes = map_.mount @ frames.to_frd(chosen["imu"].body)
        calibration = dataclasses.replace(calibration, gyro_bias=map_.gyro_bias + axes.T @ bias_b)
        notes.append(f"gyro_bias = {_list(calibration.gyro_bias)} rad/s from {seconds:.1f} s of standing")
    kept = {
        "hard_iron_t": _exact(calibration.hard_iron),
        "soft_iron": _exact(calibration.soft_iron),
        "gyro_bias_radps": _exact(calibration.gyro_bias),
    }
    return calibration, kept, left


def gravity_at(lla: tuple[float, float, float]) -> float:
    """Normal gravity (m/s2) at a place (rad, rad, m)."""
    return float(gravity.normal_gravity(np.array([lla]))[0])


def _synchronised(delay: float | None, map_: Map, sync: bool, notes: list[str]) -> Map:
    if delay is None or abs(delay) < 5e-4:
        return map_
    if not sync:
        notes.append(f"the reference is {delay:+.3f} s later than the gyro (--sync shifts it; [time] reference_s)")
        return map_
    notes.append(f"reference shifted by {-delay:+.3f} s to agree with the gyro")
    shifts = {**map_.shifts, "reference": map_.shifts["reference"] - round(delay * 1e9)}
    return dataclasses.replace(map_, shifts=shifts)


def _estimators(
    map_: Map, names: Sequence[str], chosen: Mapping[str, Choice], where: str, gate: Gate
) -> tuple[Component, ...]:
    ours = {c.name: c for c in map_.estimators}
    if not names and ours:
        return tuple(ours.values())
    has = {"gnss": "velocity" in chosen, "airspeed": "air" in chosen or "diff_pressure" in chosen, "none": True}
    if not names:
        method, aiding = next(m for m in _METHODS if has[m[1]])
        known = method in library.names()
        settings = {"method": method} if known else {"method": "marg-ekf", "aiding": aiding}
        name = settings["method"]
        return (Component(name, {**settings, "suite": SUITE}, where),)
    found = {}
    for name in names:
        method, _, suite = name.rpartition("@") if "@" in name else (name, "", "")
        if suite not in ("", SUITE):
            raise InputError(f"{where}: --estimator {name}: a bag is one suite, '{SUITE}'; leave @{suite} out")
        plain = short_name(method)
        found[plain] = ours.get(name) or estimator_component(plain, {"method": method, "suite": SUITE}, where, gate)
    return tuple(found.values())


def _soon_aligned(components: Sequence[Component], seen: survey.Survey, notes: list[str]) -> tuple[Component, ...]:
    """Shorten the alignment of estimators where the recording would be over before it is."""
    seconds = float(seen.t[-1] - seen.t[0])
    methods = {m.name: m.settings.get("align_s") for m in library.describe() if m.own}
    made = []
    for c in components:
        setting = methods.get(str(c.settings["method"]))
        short = max(1.0, math.floor(seconds / 3.0))
        if setting is not None and "align_s" not in c.settings and float(setting.default) > seconds - 1.0:
            notes.append(f"{c.name}: align_s = {short:g}: the recording has no more than {seconds:.1f} s")
            made.append(dataclasses.replace(c, settings={**c.settings, "align_s": short}))
        else:
            made.append(c)
    return tuple(made)


def _vector(values: np.ndarray) -> str:
    return "(" + " ".join(f"{x:.1f}" if abs(x) >= 9.95 else f"{x:.2f}" for x in values) + ")"


def _list(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{x:.6g}" for x in values.ravel()) + "]"


def _exact(values: object) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(np.asarray(values)))
