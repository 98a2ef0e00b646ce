"""Run estimators on what was recorded: a log of ours or a bag of a real vehicle, in blocks and bounded memory.

    recording -> records -> samples -> estimates -> log

From the records on it is the path of a flight: on a log of ours the same estimators give the same bytes again.
"""

import datetime
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ahrs_sim import plugins
from ahrs_sim import scenario as scenarios
from ahrs_sim.attitude import down
from ahrs_sim.chain import Chain, described, recorded_chains
from ahrs_sim.errors import FlightError, InputError
from ahrs_sim.log.flight_log import EstimateTopics
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.log.mcap.writer import CarriedChannel, Listener, LogWriter
from ahrs_sim.log.topics import INSTRUMENTS, REFERENCE
from ahrs_sim.recordings.sources import is_mcap
from ahrs_sim.scenario import Component, Gate
from ahrs_sim.scenario.table import parse_toml
from ahrs_sim.sensors.records import SuiteBlock, within
from estimators.types import Estimates, SensorInfo, Site, blank

if TYPE_CHECKING:
    from ahrs_sim.recordings.outcome import Outcome
    from ahrs_sim.smoothing import Smoothing

SCENARIO = "scenario.toml"

_FOREIGN = Gate()
_HOLD_S = 1.5
"""How much older than the estimates already written a record, a reference or an estimate may still be, s."""


REFERENCES = ("/truth/imu", "/truth/state", "/truth/air", REFERENCE.topic)
"""Topics without which there is nothing to compare estimates with."""


@dataclass
class Recording:
    """A recording as a replay needs it."""

    site: Site
    sensors: Mapping[str, SensorInfo]  # by suite
    estimators: Sequence[Component]
    blocks: Iterable[dict[str, SuiteBlock]]  # by suite, in the order of arrival
    epoch_ns: int  # zero of the records' times
    duration: float  # s
    carried: FlightReader | None  # whose messages go along
    written: Mapping[str, Sequence[str]] = field(default_factory=dict)  # suites of which the records go along instead
    has_reference: bool = False
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # for the new log
    recorded: Sequence[str] = ()  # estimators whose attitudes come with the records


def replay(
    path: Path,
    output: Path,
    *,
    estimators: Sequence[str] = (),
    map_file: Path | None = None,
    calibrate: Sequence[str] = ("auto",),
    sync: bool = False,
    reference: str | None = None,
    date: datetime.datetime | None = None,
    skip: float | None = None,
    until: float | None = None,
    only_estimates: bool = False,
    smooth: bool = False,
    force: bool = False,
    live: Listener | None = None,
    gate: Gate = _FOREIGN,
    progress: Callable[[float, float | None], None] = lambda t, end: None,
) -> list[str]:
    """Run estimators on a recording into a new log.

    Args:
        path: a log of ours, or any bag (`ahrs_sim.recordings.sources`).
        output: the new log: the messages of an MCAP, else the measurements as suite `bag`, and the new estimates
            instead of those of the same name; the reference attitude of a bag as `/reference/imu`.
        estimators: only these of the log's scenario or the map, `METHOD@SUITE`, or `METHOD` for a bag; none: all of
            the scenario or the map, else what fits a bag's sensors.
        map_file: what topics and axes of a bag mean.
        calibrate: "mag", "gyro": from the bag's own data; "auto": the magnetometer, where there is one.
        sync: shift a bag's reference to the time of its gyro.
        reference: topic of a bag's reference attitude.
        date: of a bag whose times are no dates.
        skip, until: estimators see only what was measured in this span, s from the beginning.
        only_estimates: carry nothing along but the truth.
        smooth: write what can be smoothed a second time, as `/est/NAME_smoothed`.
        force: replace an existing log.
        live: is given every message of the new log, too (see `ahrs_sim.log.live`).
        gate: what code from outside the recording or the map may run, besides that of `estimators`.
        progress: called with the time reached and the end, s.

    Returns:
        What the user should know, line by line.

    Raises:
        InputError: the recording cannot be read, or something asked for is not in it.
        FlightError: an estimator from outside failed; the log is complete.
    """
    if output.exists() and path.exists() and output.samefile(path):
        raise InputError(f"{output}: is the recording itself; choose another -o")
    span = (0.0 if skip is None else skip), (math.inf if until is None else until)
    if span[0] >= span[1]:
        raise InputError(f"--skip {span[0]:g} --until {span[1]:g}: nothing is left between them")
    prefixes = REFERENCES if only_estimates else ("",)
    foreign = not is_mcap(path)
    if not foreign:
        with FlightReader(path) as log:
            foreign = not is_flight(log)
            if not foreign:
                if map_file or set(calibrate) - {"auto"} or sync or reference or date:
                    unneeded = "--map, --calibrate, --sync, --reference or --date"
                    raise InputError(f"{path}: a log of ours needs no {unneeded}; leave them out")
                _run(
                    _cut(of_flight(log, estimators, gate=gate), *span), output, prefixes, force, progress, live, smooth
                )
                return []
    from ahrs_sim.recordings.mapping import SUITE
    from ahrs_sim.recordings.recording import open_bag

    asked: Any = {
        "map_file": map_file,
        "calibrate": calibrate,
        "sync": sync,
        "reference": reference,
        "date": date,
        "span": span,
    }
    with open_bag(path, names=estimators, gate=gate, **asked) as bag:
        reader = getattr(bag.source, "reader", None)
        records = [i for i in bag.instruments if i in INSTRUMENTS]
        recording = Recording(
            site=bag.site,
            sensors={SUITE: bag.sensors},
            estimators=bag.estimators,
            blocks=bag.blocks(),
            epoch_ns=bag.source.epoch_ns,
            duration=bag.source.duration,
            carried=reader,
            written={} if reader or only_estimates else {SUITE: records},
            has_reference="reference" in bag.converter.chosen,
            metadata={"replay": bag.metadata},
            recorded=[name for name in bag.recorded if name not in {c.name for c in bag.estimators}],
        )
        outcome = _run(recording, output, prefixes, force, progress, live, smooth)
        return bag.notes + bag.counted() + outcome.lines(suspected=bag.suspected)


def _cut(recording: Recording, skip: float, until: float) -> Recording:
    """Drop what was measured outside of the span (s)."""
    if skip >= recording.duration:
        raise InputError(f"--skip {skip:g}: the recording has {recording.duration:.1f} s")
    if skip > 0.0 or until < math.inf:
        recording.blocks = (
            {suite: within(block, skip * 1e9, until * 1e9) for suite, block in blocks.items()}
            for blocks in recording.blocks
        )
    return recording


def accuracy(
    output: Path, *, start: float | None = None, end: float | None = None, align: str | None = None
) -> dict[str, Any] | None:
    """Compute errors of the estimates in a log made by `replay`; None when it has no truth and no reference."""
    with FlightReader(output) as log:
        if "/truth/imu" not in log.topics and REFERENCE.topic not in log.topics:
            return None
    from ahrs_sim.review import compare

    return compare.compare(output, start=start, end=end, align=align)


def unknown(output: Path, result: Mapping[str, Any]) -> list[str]:
    """Say why figures of a log made by `replay` are missing, a line each; `Outcome` does where there is no attitude."""
    rows = result["estimators"]
    silent = [name for name, values in rows.items() if values["tilt_rmse_deg"] is None]
    lines = []
    for name, values in rows.items():
        if name in silent:
            continue
        if values["heading_rmse_deg"] is None:
            lines.append(f"{name}: no heading in its estimates, or none in the reference")
        elif values.get("nees") is None:
            lines.append(f"{name}: no NEES: it states no covariance")
    if not silent:
        return lines
    with FlightReader(output) as log:
        lines += [
            f"{name}: none of its attitudes is within the time of the reference"
            for name in silent
            if np.isfinite(log.estimates(name).down_b).any()
        ]
    return lines


def evaluate(
    path: Path,
    *,
    estimators: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
    gate: Gate = _FOREIGN,
    progress: Callable[[float, float | None], None] = lambda t, end: None,
) -> dict[str, Any] | None:
    """Evaluate estimators on a log of ours as `replay` and `accuracy` do, without a new log.

    None: not a log of ours, or one without the truth, or an estimator from outside is among them.

    Raises:
        InputError: as `replay`, or there is nothing between start and end.
    """
    from ahrs_sim.evaluation.accuracy import Accuracy
    from ahrs_sim.review import compare

    if not is_mcap(path):
        return None
    topics = compare.TRUTH_TOPICS
    with FlightReader(path) as log:
        if not is_flight(log) or any(topic not in log.topics for topic in topics):
            return None

        def truth(messages: Mapping[str, np.ndarray]) -> None:
            compare.read_truth_into(errors, log, messages)

        recording = of_flight(log, estimators, truth, *topics, gate=gate)
        errors = Accuracy([c.name for c in recording.estimators])
        chains = recorded_chains(recording.estimators, recording.site, recording.sensors)
        if any(isinstance(e, plugins.Guarded) for chain in chains.values() for e in chain.estimators.values()):
            return None  # may fail, which a log keeps
        for blocks in recording.blocks:
            reached = 0.0
            for suite, chain in chains.items():
                samples = chain.assemble(blocks[suite])
                for name, estimates in chain.estimate(samples):
                    errors.add_estimates(name, estimates)
                if len(samples):
                    reached = max(reached, float(samples.t[-1]))
            progress(reached, recording.duration)
    low, high = -math.inf if start is None else start, math.inf if end is None else end
    return compare.result_of(errors, path, "truth", low, high)


def is_flight(log: FlightReader) -> bool:
    """Test for a log of ours, which has its scenario."""
    return SCENARIO in log.attachments and "site" in log.metadata


def of_flight(
    log: FlightReader,
    names: Sequence[str] = (),
    beside: Callable[[dict[str, np.ndarray]], None] | None = None,
    *topics: str,
    gate: Gate = _FOREIGN,
) -> Recording:
    """Open a log of ours: scenario, site and data sheets from attachments and metadata; `FlightReader.suite_blocks`.

    Raises:
        InputError: an unknown estimator, or the log does not tell what estimators need.
    """
    data = parse_toml(log.attachment(SCENARIO).decode(errors="replace"), f"{log.path}: damaged: {SCENARIO}")
    scenario = scenarios.parse(data, str(log.path), log.path.stem, estimators=names, gate=gate)
    components = scenario.estimators
    suites = list(dict.fromkeys(str(c.settings["suite"]) for c in components))
    if not components:
        raise InputError(f"{log.path}: its scenario has no estimators; name one with --estimator METHOD@SUITE")
    first, last = log.time_range_ns
    return Recording(
        site=_known(log, "site", Site),
        sensors={suite: _known(log, f"sensors {suite}", SensorInfo) for suite in suites},
        estimators=components,
        blocks=log.suite_blocks(suites, beside, *topics),
        epoch_ns=log.epoch_ns,
        duration=(last - first) / 1e9,
        carried=log,
    )


def _known(log: FlightReader, name: str, cls: Any) -> Any:
    """Read a `Site` or `SensorInfo` from its metadata record (`pipeline.exactly`)."""
    try:
        values = {k: tuple(map(float, v.split())) for k, v in log.metadata[name].items()}
        plain = {f: getattr(cls, f, None) for f in cls.__dataclass_fields__}
        triples = ("lla", "mag_n", "antenna_b", "field_error")
        return cls(**{k: v if k in triples else v[0] for k, v in values.items() if k in plain})
    except (KeyError, ValueError, IndexError, TypeError):
        raise InputError(
            f"{log.path}: its metadata say nothing usable of '{name}'; fly the scenario again with this version"
        ) from None


def _run(
    recording: Recording,
    output: Path,
    prefixes: tuple[str, ...],
    force: bool,
    progress: Callable[[float, float | None], None],
    live: Listener | None,
    smooth: bool,
) -> "Outcome":
    from ahrs_sim.recordings.outcome import Outcome  # loads the alignment's kernels

    chains = recorded_chains(recording.estimators, recording.site, recording.sensors)
    names = [*(c.name for c in recording.estimators), *recording.recorded]
    smoothing = _smoothing(chains) if smooth else None
    outcome = Outcome(chains)
    with LogWriter(output, epoch_ns=recording.epoch_ns, force=force, listener=live) as writer:
        passing = _CarryOver(recording, writer, prefixes)
        topics = EstimateTopics(writer, recording.epoch_ns, names)
        afterwards = EstimateTopics(writer, recording.epoch_ns, smoothing.names if smoothing else [])
        made = {name: estimator for chain in chains.values() for name, estimator in chain.estimators.items()}
        for component in recording.estimators:
            writer.metadata(f"estimator {component.name}", described(component, made[component.name]))
        writer.start()
        for blocks in recording.blocks:
            reached = 0.0
            for suite, block in blocks.items():
                passing.records(suite, block)
                for name in recording.recorded:
                    topics.write(name, _as_estimates(block.pop(f"recorded {name}")))
                if "reference" in block:
                    reference: Any = block["reference"]
                    known = np.isfinite(reference.q_nb).all(axis=1)
                    topics.reference(reference.stamp_ns[known] / 1e9, reference.q_nb[known])
                samples = chains[suite].assemble(block)
                for name, estimates in chains[suite].estimate(samples):
                    topics.write(name, estimates)
                    topics.turning(name, chains[suite].turning(name, samples, estimates))
                    outcome.add(name, estimates)
                if smoothing:
                    smoothing.keep(suite, samples)
                if len(samples):
                    reached = max(reached, float(samples.t[-1]))
            progress(reached, recording.duration)
            if not smoothing:  # what is smoothed comes last and belongs to the beginning: all waits for it
                passing.advance(recording.epoch_ns + round((reached - _HOLD_S) * 1e9))
        for name, estimates in smoothing.smoothed() if smoothing else ():
            afterwards.write(name, estimates)
        passing.rest()
    if failed := plugins.failures(e for chain in chains.values() for e in chain.estimators.values()):
        raise FlightError(f"{failed}; the log is complete: {output}")
    return outcome


def _smoothing(chains: dict[str, Chain]) -> "Smoothing":
    from ahrs_sim.smoothing import Smoothing  # loads the navigator's kernels

    return Smoothing(chains)


def _as_estimates(record: Any) -> Estimates:
    """Make estimates of attitudes that the recording's own estimator has written."""
    known = np.isfinite(record.q_nb).all(axis=1)
    columns = blank(Estimates, int(known.sum()))
    columns["t"], columns["q_nb"] = record.stamp_ns[known] / 1e9, record.q_nb[known]
    columns["down_b"] = down(columns["q_nb"])
    return Estimates(**columns)


class _CarryOver:
    """Carries over what goes from the recording into the new log beside the estimates."""

    def __init__(self, recording: Recording, writer: LogWriter, prefixes: tuple[str, ...]) -> None:
        self._writer, self._epoch_ns = writer, recording.epoch_ns
        self._records = {
            (suite, i): INSTRUMENTS[i][1].channel(writer, f"/{suite}")
            for suite, kinds in recording.written.items()
            for i in kinds
        }
        self._reference = REFERENCE.channel(writer) if recording.has_reference else None
        self._carried: dict[int, CarriedChannel] = {}
        self._blocks: Iterator[tuple[int, dict[int, list[np.ndarray]]]] = iter(())
        self._floor = np.iinfo(np.int64).max  # ns: all before has been passed on
        metadata = dict(recording.metadata)
        if (log := recording.carried) is not None:
            ours = tuple(f"/est/{c.name}/" for c in recording.estimators)
            ours += (REFERENCE.topic,) if recording.has_reference else ()
            chosen = [t for t in log.topics if t.startswith(prefixes) and not t.startswith(ours)]
            for number, (channel, schema) in log.carried(chosen).items():
                self._carried[number] = writer.carry(channel, schema)
            self._blocks = log.raw_blocks(self._carried)
            self._floor = -1 if self._carried else self._floor
            metadata = {**{k: v for k, v in log.metadata.items() if k != "log"}, **metadata}
            for name in log.attachments:
                writer.attach(name, log.attachment(name), "application/octet-stream")
        for name, values in metadata.items():
            writer.metadata(name, values)

    def records(self, suite: str, block: SuiteBlock) -> None:
        """Write records in place of messages that cannot be carried over, and the reference."""
        for instrument, records in block.items():
            is_reference = instrument == "reference"
            channel = self._reference if is_reference else self._records.get((suite, instrument))
            if channel is None or not len(records):
                continue
            route = REFERENCE if is_reference else INSTRUMENTS[instrument][1]
            columns = route.columns(records)
            arrival, stamp = self._epoch_ns + records.arrival_ns, self._epoch_ns + records.stamp_ns
            if is_reference:
                known = np.isfinite(columns["orientation"]).all(axis=1)
                columns, arrival, stamp = {"orientation": columns["orientation"][known]}, arrival[known], stamp[known]
            self._writer.write(channel, arrival, stamp, **columns)

    def _next(self) -> bool:
        floor, found = next(self._blocks, (None, {}))
        for number, batches in found.items():
            for rows in batches:
                self._writer.pass_on(self._carried[number], rows)
        self._floor = np.iinfo(np.int64).max if floor is None else floor
        return floor is not None

    def advance(self, t_ns: int) -> None:
        """Carry over what is older than `t_ns`, up to which estimates have been written."""
        while self._floor < t_ns:
            self._next()
        self._writer.advance(min(t_ns, self._floor))

    def rest(self) -> None:
        """Carry over all that is left."""
        while self._next():
            self._writer.advance(self._floor)
