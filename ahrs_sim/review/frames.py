"""Logs, accuracies and campaigns as pandas frames, which `ahrs_sim.read_log`, `fly`, `compare`... return.

Every frame has the units of its columns in `attrs["units"]`. Angles are in degrees, times in seconds of flight. Frames
of all estimators together have one index, the times of the logged truth.
"""

import html
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pandas

from ahrs_sim import attitude
from ahrs_sim.errors import InputError, nearest
from ahrs_sim.evaluation import metrics, phases
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.review import compare, export

if TYPE_CHECKING:
    from ahrs_sim.runs.campaign import Plan

_ANGLES = {"roll": "deg", "pitch": "deg", "heading": "deg"}
_BIASES = {f"gyro_bias_{axis}": "deg/s" for axis in "xyz"}
_TRUTH = {**_ANGLES, "north": "m", "east": "m", "height": "m", "airspeed": "m/s"}


class LogFrames(Mapping[str, pandas.DataFrame]):
    """Maps the topics of a log to frames with index `t`, s of flight, each read on first use.

    Also `truth`, `estimates`, `errors` and `accuracy`; `metadata`, `events`, `estimators`. Closes as a context manager
    or by `close`.

    Args:
        path: the log.
        notes: remarks of the command that made it, a line each.
        folder: temporary folder of the log, removed with this object.

    Raises:
        InputError: not a log.
    """

    def __init__(
        self,
        path: str | Path,
        notes: Sequence[str] = (),
        folder: "tempfile.TemporaryDirectory[str] | None" = None,
    ) -> None:
        self._log = FlightReader(path)
        self._folder = folder
        self.path = Path(path)
        self.notes = tuple(notes)

    def __getitem__(self, topic: str) -> pandas.DataFrame:
        """Return all messages of a topic as a frame.

        Raises:
            KeyError: no such topic.
            InputError: it cannot be read.
        """
        if topic not in self._log.topics:
            raise KeyError(topic)
        frame = export.frame(self._log, self._log.read(topic)).set_index("t")
        frame.attrs["units"] = export.units(self._log, topic)
        return frame

    def __iter__(self) -> Iterator[str]:
        return iter(self._log.topics)

    def __len__(self) -> int:
        return len(self._log.topics)

    def __repr__(self) -> str:
        first, last = self._log.time_range_ns
        named = ", ".join(self.estimators) or "none"
        name = self.path if self._folder is None else self.path.name
        return f"{name}: {(last - first) / 1e9:.1f} s, {len(self)} topics, estimators: {named}"

    def close(self) -> None:
        """Close the file, and remove its temporary folder if it has one."""
        self._log.close()
        if self._folder is not None:
            self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def estimators(self) -> list[str]:
        """List the names of the estimators."""
        return self._log.estimators

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Return seeds, versions, specifications and settings, by metadata record."""
        return self._log.metadata

    @property
    def events(self) -> pandas.DataFrame:
        """Return the events of the flight: columns level, name, text."""
        return self["/events"][["level", "name", "text"]]

    def truth(self) -> pandas.DataFrame:
        """Read roll, pitch, heading (deg), north, east, height (m), airspeed (m/s), on_ground and phase."""
        from ahrs_sim.world import wgs84

        truth = self._log.truth()
        offset = wgs84.offset_n(truth.lla, truth.lla[0]) if len(truth) else np.empty((0, 3))
        frame = pandas.DataFrame(
            {
                **_angles(truth.q_nb),
                "north": offset[:, 0],
                "east": offset[:, 1],
                "height": -offset[:, 2],
                "airspeed": truth.airspeed,
                "on_ground": truth.on_ground,
            },
            index=pandas.Index(truth.t, name="t"),
        )
        number = np.full(len(truth), -1)
        if len(truth) > 1:
            number = phases.classify(truth.t, truth.q_nb, truth.vel_n, truth.on_ground).astype(int)
        frame["phase"] = pandas.Categorical.from_codes(number, pandas.Index(phases.PHASES))
        return _with_units(frame, _TRUTH)

    def estimates(self, name: str | None = None) -> pandas.DataFrame:
        """Make the frame of estimates: roll, pitch and heading (deg), gyro biases (deg/s), status.

        Args:
            name: of an estimator; None: all, with columns (estimator, quantity) at the times of `truth`.

        Raises:
            InputError: no such estimator.
        """
        if name is None:
            return self._together(self.estimates)
        e = self._log.estimates(self._known(name))
        bias = np.degrees(e.gyro_bias)
        columns = {name: bias[:, k] for k, name in enumerate(_BIASES)}
        frame = pandas.DataFrame({**_angles(e.q_nb), **columns, "status": e.status}, index=pandas.Index(e.t, name="t"))
        return _with_units(frame, {**_ANGLES, **_BIASES})

    def errors(self, name: str | None = None) -> pandas.DataFrame:
        """Compute errors against the truth, deg: roll, pitch, heading, tilt, total.

        Args:
            name: of an estimator; None: all, with columns (estimator, measure) at the times of `truth`.

        Raises:
            InputError: no such estimator, or no truth.
        """
        if name is None:
            return self._together(self.errors)
        e, truth = self._log.estimates(self._known(name)), self._log.truth()
        errors = np.degrees(metrics.attitude_errors(e.q_nb, e.down_b, attitude.interpolate(truth.t, truth.q_nb, e.t)))
        frame = pandas.DataFrame(errors, columns=list(metrics.MEASURES), index=pandas.Index(e.t, name="t"))
        return _with_units(frame, dict.fromkeys(metrics.MEASURES, "deg"))

    def accuracy(self, **options: Any) -> "AccuracyTable":
        """Compute the table that `ahrs-sim compare` prints; options as those of `ahrs_sim.compare`."""
        return AccuracyTable(compare.compare(self.path, **options))

    def _known(self, name: str) -> str:
        if name not in self.estimators:
            raise InputError(f"{self.path}: no estimator '{name}'{nearest(name, self.estimators)}")
        return name

    def _together(self, one: Any) -> pandas.DataFrame:
        """Join the frames of all estimators at the times of the truth: the nearest sample, within half a period."""
        t = self._log.truth().t
        frames = {name: one(name) for name in self.estimators}
        found = {name: _nearest_rows(frame, t) for name, frame in frames.items()}
        joined = pandas.concat(found, axis=1, names=["estimator", "quantity"])
        return _with_units(
            joined, {(name, k): unit for name, f in frames.items() for k, unit in f.attrs["units"].items()}
        )


def _nearest_rows(frame: pandas.DataFrame, t: np.ndarray) -> pandas.DataFrame:
    period = float(np.median(np.diff(frame.index))) if len(frame) > 1 else 0.0
    found = frame.reindex(t, method="nearest", tolerance=0.51 * period)
    return found.rename_axis("t")


def _angles(q_nb: np.ndarray) -> dict[str, np.ndarray]:
    roll, pitch, heading = np.degrees(attitude.euler(q_nb)).T
    return {"roll": roll, "pitch": pitch, "heading": np.mod(heading, 360.0)}


def _with_units(frame: pandas.DataFrame, units: Mapping[Any, str]) -> pandas.DataFrame:
    frame.attrs["units"] = {"t": "s", **units}
    return frame


class AccuracyTable(Mapping[str, Any]):
    """Maps names to the figures of `ahrs-sim compare --json`; prints as the table, as text and in a notebook."""

    def __init__(self, result: Mapping[str, Any]) -> None:
        self._result = dict(result)

    def __getitem__(self, key: str) -> Any:
        return self._result[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._result)

    def __len__(self) -> int:
        return len(self._result)

    def __repr__(self) -> str:
        return compare.table(self._result)

    def _repr_html_(self) -> str:
        against = "the truth" if self["reference"] == "truth" else self["reference"]
        title = f"RMS error against {against}, {self['from_s']:.0f} to {self['to_s']:.0f} s, deg"
        figures = self.frame
        spans = [p for p in (*phases.PHASES[:3], "all") if p in figures.index.get_level_values("phase")]
        columns = {
            (measure, "whole flight" if phase == "all" else phase): figures[f"{measure}_rmse_deg"].xs(phase, level=1)
            for measure in ("tilt", "heading")
            for phase in spans
        }
        best_first = figures["tilt_rmse_deg"].xs("all", level=1).sort_values().index
        shown = pandas.DataFrame(columns).reindex(best_first)
        shown.index.name = None
        table = shown.to_html(float_format=lambda x: f"{x:.2f}", na_rep="-")
        return f"<p>{html.escape(title)}</p>\n{table}"

    @property
    def frame(self) -> pandas.DataFrame:
        """Return every figure, a row per estimator and phase (`all`: the whole flight); unknown ones are NaN."""
        rows = {
            (name, phase): {k: v for k, v in cells.items() if not isinstance(v, dict | list)}
            for name, values in self["estimators"].items()
            for phase, cells in {"all": values, **values["phases"]}.items()
        }
        index = pandas.MultiIndex.from_tuples(rows, names=["estimator", "phase"])
        return _with_units(*_degrees(pandas.DataFrame(list(rows.values()), index=index).astype(float)))

    @property
    def paired(self) -> pandas.DataFrame:
        """Return the differences from the estimator `against`, a row per estimator, phase and measure.

        Raises:
            InputError: the comparison was made without `against`.
        """
        if "paired" not in self._result:
            raise InputError("compare: no pairs without against=NAME; name an estimator of the log")
        rows: _Differences = {
            (name, phase, measure.removesuffix("_rmse_deg")): cells or {}
            for name, values in self["paired"]["estimators"].items()
            for phase, figures in {"all": values, **values["phases"]}.items()
            for measure, cells in figures.items()
            if measure != "phases"
        }
        return _differences(rows, ["estimator", "phase", "measure"])


_Differences = dict[tuple[str, ...], Mapping[str, Any]]


def _differences(rows: _Differences, names: list[str]) -> pandas.DataFrame:
    """Make a frame of the dictionaries of `paired.Difference.plain`."""
    columns = ["change", "low", "high", "smaller", "pairs", "result"]
    frame = pandas.DataFrame(list(rows.values()), columns=columns)
    frame.index = pandas.MultiIndex.from_tuples(rows, names=names)
    frame[columns[:3]] = frame[columns[:3]].astype(float)
    return _with_units(frame, dict.fromkeys(columns[:3], "deg"))


def _degrees(frame: pandas.DataFrame) -> tuple[pandas.DataFrame, dict[Any, str]]:
    return frame, {name: "deg" for name in frame.columns if str(name).endswith("_deg")}


class CampaignFrames:
    """Reads a campaign as frames: `runs`, `bands`, `paired`; prints as its report.

    Args:
        place: folder or fsspec address.

    Raises:
        InputError: no campaign there.
    """

    def __init__(self, place: str | Path) -> None:
        from ahrs_sim.runs.campaign import Store

        self._store = Store(str(place))
        self._store.plan()

    @property
    def plan(self) -> "Plan":
        """Return scenario, seed, number of runs and varied values."""
        return self._store.plan()

    @property
    def runs(self) -> pandas.DataFrame:
        """Read a row per run and estimator with the columns of docs/regression.md; a failed run has its error."""
        columns = [c for c in self._store.column_names() if not c.startswith("bands.")]
        frame = self._store.table(columns).to_pandas()
        return _with_units(*_degrees(frame))

    def bands(self, measure: str = "tilt") -> pandas.DataFrame:
        """Read RMS errors (deg) over time: index `t`, the start of each band in s; columns (estimator, run).

        Raises:
            InputError: no bands of this measure.
        """
        column = f"bands.{measure}"
        if column not in (names := self._store.column_names()):
            known = [name.removeprefix("bands.") for name in names if name.startswith("bands.")]
            raise InputError(f"{self._store.place}: no bands of '{measure}'{nearest(measure, known)}")
        rows = self._store.table(["run", "estimator", column]).to_pylist()
        series = {(r["estimator"], r["run"]): pandas.Series(r[column]) for r in rows if r[column] is not None}
        frame = pandas.concat(series, axis=1, names=["estimator", "run"]).astype(float)
        frame.index = pandas.Index(frame.index * self.plan.band_s, name="t")
        return _with_units(frame, dict.fromkeys(frame.columns, "deg"))

    def paired(self, against: str, metric: str = "tilt_rmse_deg") -> pandas.DataFrame:
        """Compute differences of a figure from another estimator's in the same runs, a row per estimator and figure.

        Raises:
            InputError: no such estimator.
        """
        found = self.report(metric, against=against).get("paired", {"estimators": {}})["estimators"]
        rows: _Differences = {(name, figure): d or {} for name, values in found.items() for figure, d in values.items()}
        return _differences(rows, ["estimator", "figure"])

    def report(self, metric: str = "tilt_rmse_deg", **options: Any) -> dict[str, Any]:
        """Make the report as `ahrs-sim campaign --json` does; options as those of `campaign_report.make`."""
        from ahrs_sim.runs import campaign_report

        return campaign_report.make(self._store, metric, **options)

    def __repr__(self) -> str:
        from ahrs_sim.runs import campaign_report

        return campaign_report.text(self.report())

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"
