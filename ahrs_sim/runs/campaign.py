"""`ahrs-sim campaign`: hundreds of flights of one scenario with varied seeds and values, as a Parquet data set.

    plan = Plan.make(scenario, runs=200, vary=["wind.speed_mps=uniform:0..8"])
    store = Store("out")
    with pool.local_pool(2) as processes:
        fly(plan, store, processes)
    print(campaign_report.text(campaign_report.make(store)))

Run k is the scenario with seed `seed + k` and values that depend on the campaign's seed, the key and k alone, so every
run can be flown again by itself, in any order, on any machine. Of a run one row per estimator is kept:

    run, seed             which flight
    vary.KEY              the values it had
    estimator             null when the run failed
    error                 why it failed, else null
    FIGURE, PHASE.FIGURE  what `compare` says: tilt_rmse_deg, straight.heading_p95_deg, ...; NaN: not known
    nees, nis             means per degree of freedom
    bands.tilt, .heading  RMSE (deg) of every `band_s` since the start, as lists

Files are only ever added, each whole or not at all; a campaign that was stopped goes on where its files end.
"""

import copy
import itertools
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.runs import pool as flights
from ahrs_sim.runs.pool import Outcome, Pool, Run, Span
from ahrs_sim.scenario import Gate, Scenario, code, parse, seeds
from ahrs_sim.scenario.table import Table, parse_toml

if TYPE_CHECKING:
    import pyarrow

_FOREIGN = Gate()
BATCH_RUNS, BATCH_S = 100, 20.0
"""A file is written after so many runs or seconds: what a kill can cost."""

_MOST_RUNS = 10_000_000

BANDS = 60
"""Spans of time for which the error is kept, about."""

DISTRIBUTIONS = {
    "uniform": "uniform:LOW..HIGH",
    "normal": "normal:MEAN,SIGMA",
    "choice": "choice:A,B,...",
    "grid": "grid:A,B,...",
    "lhs": "lhs:LOW..HIGH",
}
"""Kinds of variation and how they are written; grids combine all with all, `lhs` is one Latin hypercube of all such."""


# ----------------------------------------------------------------------------------------------- what is varied


@dataclass(frozen=True)
class Variation:
    """One `--vary KEY=KIND:NUMBERS`."""

    key: str
    kind: str
    values: tuple[Any, ...]

    @classmethod
    def read(cls, text: str) -> "Variation":
        """Read a variation from `wind.speed_mps=uniform:0..8`.

        Raises:
            InputError: it is not of one of the forms in `DISTRIBUTIONS`.
        """
        key, equals, distribution = text.partition("=")
        kind, colon, arguments = distribution.partition(":")
        if not (key and equals and colon):
            raise InputError(f"--vary {text}: write KEY=KIND:VALUES, e.g. wind.speed_mps={DISTRIBUTIONS['uniform']}")
        if kind not in DISTRIBUTIONS:
            raise InputError(f"--vary {text}: no distribution '{kind}'{nearest(kind, DISTRIBUTIONS)}")
        values: tuple[Any, ...]
        if kind in ("uniform", "lhs"):
            values = span(arguments, f"--vary {text}")
        else:
            values = tuple(_value(x) for x in arguments.split(","))
            if kind == "normal" and not (len(values) == 2 and all(map(_is_number, values)) and values[1] >= 0):
                raise InputError(f"--vary {text}: write {DISTRIBUTIONS['normal']}")
        return cls(key, kind, values)

    def draw(self, seed: int, run: int) -> Any:
        """Draw the value of a run, for kinds whose runs are independent."""
        rng = seeds.generator(seed, "campaign", self.key, str(run))
        if self.kind == "uniform":
            return float(rng.uniform(*self.values))
        if self.kind == "normal":
            return float(rng.normal(*self.values))
        return self.values[int(rng.integers(len(self.values)))]


def span(text: str, where: str) -> tuple[float, float]:
    """Read `LOW..HIGH`.

    Raises:
        InputError: it is not that, or empty.
    """
    low, dots, high = text.partition("..")
    try:
        numbers = float(low), float(high)
    except ValueError:
        numbers = math.nan, math.nan
    if not dots or not numbers[0] < numbers[1] or not all(map(math.isfinite, numbers)):
        raise InputError(f"{where}: '{text}' is not a range; write LOW..HIGH")
    return numbers


def _value(text: str) -> Any:
    """Read a number, true or false, else the text itself."""
    words = {"true": True, "false": False}
    if text in words:
        return words[text]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def put(data: dict[str, Any], key: str, value: Any) -> None:
    """Set `a.b.c` in nested tables; the number n in it is the n-th of a list: `step.3.bank_deg`.

    Raises:
        InputError: a part of the path is no table, or there is no such element.
    """
    *path, last = key.split(".")
    place: Any = data
    for part in path:
        if isinstance(place, list) and part.isdigit() and 1 <= int(part) <= len(place):
            place = place[int(part) - 1]
        elif isinstance(place, dict):
            place = place.setdefault(part, {})
        else:
            raise InputError(f"{key}: nothing called '{part}' there")
    if not isinstance(place, dict):
        raise InputError(f"{key}: '{last}' is not in a table")
    place[last] = value


# ----------------------------------------------------------------------------------------------- the plan


@dataclass(frozen=True)
class Plan:
    """Everything that a campaign is made of."""

    name: str
    where: str
    data: Mapping[str, Any]  # the scenario that all runs share
    seed: int
    runs: int
    vary: tuple[str, ...]
    band_s: float
    code: tuple[str, ...] = ()  # from outside, that estimators may run; never from a file
    spans: tuple[Span, ...] = ()  # summarised by themselves, too

    @classmethod
    def make(cls, scenario: Scenario, runs: int, vary: Sequence[str] = ()) -> "Plan":
        """Make a plan for a checked scenario.

        Raises:
            InputError: a variation that cannot be understood or does not fit the scenario.
        """
        band = max(1.0, math.ceil((scenario.duration or 600.0) / BANDS))
        plan = cls(scenario.name, scenario.where, scenario.data, scenario.seed, runs, tuple(vary), band)
        variations = plan._variations()
        varied = (str(x) for v in variations if v.key.endswith(".method") for x in v.values)
        plan = replace(plan, code=(*scenario.code, *filter(code.from_outside, varied)))
        keys = [v.key for v in variations]
        if twice := [k for k in keys if keys.count(k) > 1]:
            raise InputError(f"--vary {twice[0]}: given twice; keep one")
        if "seed" in keys:
            raise InputError("--vary seed: every run has its own seed already; choose the first with --seed")
        if runs:
            plan.run(0).scenario()
        return plan

    def _variations(self) -> list[Variation]:
        return [Variation.read(text) for text in self.vary]

    def values(self) -> Callable[[int], dict[str, Any]]:
        """Make the function from the number of a run to its varied values."""
        variations = self._variations()
        grids = [v for v in variations if v.kind == "grid"]
        cells = list(itertools.product(*(v.values for v in grids)))
        cubes = [v for v in variations if v.kind == "lhs"]
        hypercube = self._hypercube(cubes)

        def of(run: int) -> dict[str, Any]:
            drawn = {v.key: v.draw(self.seed, run) for v in variations if v.kind not in ("grid", "lhs")}
            drawn |= {v.key: x for v, x in zip(grids, cells[run % len(cells)], strict=True)}
            drawn |= {v.key: float(x) for v, x in zip(cubes, hypercube[run] if cubes else (), strict=True)}
            return {v.key: drawn[v.key] for v in variations}

        return of

    def _hypercube(self, cubes: Sequence[Variation]) -> np.ndarray:
        """Draw values (runs, len(cubes)): each span is cut into as many cells as there are runs, each used once."""
        if not cubes:
            return np.empty((0, 0))
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(len(cubes), rng=seeds.generator(self.seed, "campaign", "lhs"))
        low, high = zip(*(v.values for v in cubes), strict=True)
        return np.asarray(qmc.scale(sampler.random(self.runs), low, high))

    def run(self, number: int, values: Mapping[str, Any] | None = None) -> Run:
        """Make one run of the campaign."""
        data = copy.deepcopy(dict(self.data))
        for key, value in (self.values()(number) if values is None else values).items():
            put(data, key, value)
        data["seed"] = self.seed + number
        return Run(number, self.name, self.where, data, band_s=self.band_s, code=self.code, spans=self.spans)

    def manifest(self) -> dict[str, Any]:
        """Write the plan as plain data; the scenario as TOML, because JSON cannot hold it."""
        scenario = parse(dict(self.data), self.where, self.name, gate=Gate(self.code))
        spans = {"spans": [[s.name, *(s.steps or s.times), s.skip] for s in self.spans]}
        return (spans if self.spans else {}) | {
            "format": 1,
            "name": self.name,
            "seed": self.seed,
            "runs": self.runs,
            "vary": list(self.vary),
            "band_s": self.band_s,
            "scenario": scenario.toml(),
            "versions": _versions(),
        }

    @classmethod
    def from_manifest(cls, manifest: Mapping[str, Any], where: str) -> "Plan":
        """Read the plan kept in a manifest."""
        table = Table(dict(manifest), where)
        vary = table.value("vary")
        if not (isinstance(vary, list) and all(isinstance(text, str) for text in vary)):
            raise table.error("vary", "is not a list of texts")
        plan = cls(
            name=table.text("name"),
            where=where,
            data=parse_toml(table.text("scenario"), f"{where}: scenario"),
            seed=table.integer("seed", minimum=0),
            runs=table.integer("runs", minimum=0, maximum=_MOST_RUNS),
            vary=tuple(vary),
            band_s=table.number("band_s", minimum=1.0),
        )
        plan._variations()
        return plan


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {name: version(name) for name in ("ahrs-sim", "jsbsim", "numpy", "numba")}


# ----------------------------------------------------------------------------------------------- the data set


class Store:
    """A folder of results: `manifest.json`, `runs-*.parquet`, `logs/`. A local path, or any place that fsspec knows.

    Raises:
        InputError: pyarrow or fsspec is missing, or the place cannot be used.
    """

    def __init__(self, place: str) -> None:
        try:
            import pyarrow
        except ImportError:
            raise InputError("a campaign needs pyarrow: pip install 'ahrs-sim[campaign]'") from None
        assert pyarrow
        self.place = place.rstrip("/")
        self.remote: Any = None  # an fsspec file system
        self.root = self.place
        if "://" in place:
            try:
                import fsspec

                self.remote, self.root = fsspec.core.url_to_fs(self.place)
            except (ImportError, ValueError) as error:
                raise InputError(f"{place}: {error}; pip install 'ahrs-sim[campaign]' and the driver named") from None

    # -- files

    def _path(self, name: str) -> str:
        return f"{self.root}/{name}"

    def read(self, name: str) -> bytes | None:
        """Read a file; None when it is not there."""
        try:
            return self.remote.cat_file(self._path(name)) if self.remote else Path(self._path(name)).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{self._path(name)}: cannot be read: {error.strerror or error}") from None

    def write(self, name: str, data: bytes) -> None:
        """Write a whole file or none: object stores put at once, a local file is renamed when it is complete."""
        try:
            if self.remote:
                self.remote.makedirs(self.root, exist_ok=True)
                self.remote.pipe_file(self._path(name), data)
                return
            path = Path(self._path(name))
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f".{path.name}.part")
            part.write_bytes(data)
            os.replace(part, path)  # noqa: PTH105  (Path.replace says the same, less plainly)
        except OSError as error:
            raise InputError(f"{self._path(name)}: cannot be written: {error.strerror or error}") from None

    def files(self) -> list[str]:
        """List the data files, oldest first."""
        if self.remote:
            self.remote.invalidate_cache()
            found = self.remote.glob(self._path("runs-*.parquet"))
            return sorted(str(f).rsplit("/", 1)[-1] for f in found)
        return sorted(p.name for p in Path(self.root).glob("runs-*.parquet"))

    # -- plan

    def plan(self) -> Plan:
        """Read the plan of the campaign in this folder.

        Raises:
            InputError: there is none.
        """
        raw = self.read("manifest.json")
        if raw is None:
            raise InputError(f"{self.place}: no campaign there (no manifest.json)")
        return Plan.from_manifest(self._manifest(raw), f"{self.place}/manifest.json")

    def _manifest(self, raw: bytes) -> dict[str, Any]:
        try:
            manifest = json.loads(raw)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self._path('manifest.json')}: not JSON: {error}") from None
        if not isinstance(manifest, dict):
            raise InputError(f"{self._path('manifest.json')}: not the manifest of a campaign")
        return manifest

    def begin(self, plan: Plan) -> None:
        """Write the manifest.

        Raises:
            InputError: the folder already holds a different campaign.
        """
        self.write("manifest.json", json.dumps(self.check(plan), indent=1).encode())

    def check(self, plan: Plan) -> dict[str, Any]:
        """Check that the campaign here, if there is one, is the same; more runs may be asked for.

        Returns:
            The manifest of both.

        Raises:
            InputError: the folder already holds a different campaign.
        """
        raw = self.read("manifest.json")
        new = plan.manifest()
        if raw is not None:
            old = self._manifest(raw)
            runs = Plan.from_manifest(old, f"{self.place}/manifest.json").runs
            changed = [k for k in new if k not in ("runs", "versions") and new[k] != old.get(k)]
            if any(Variation.read(v).kind == "lhs" for v in plan.vary) and runs != new["runs"]:
                changed.append("runs (a Latin hypercube has a fixed number)")
            if changed:
                raise InputError(
                    f"{self.place}: already holds a different campaign ({changed[0]} differs); choose another -o"
                )
            if old.get("versions") != new["versions"]:
                raise InputError(f"{self.place}: was flown with other versions ({old.get('versions')}); start anew")
            new["runs"] = max(new["runs"], runs)
        return new

    # -- rows

    def add(self, number: int, outcomes: Sequence[Outcome], plan: Plan) -> None:
        """Append one file of runs."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        of = plan.values()
        rows = []
        for outcome in sorted(outcomes, key=lambda o: o.key):
            head = {"run": outcome.key, "seed": plan.seed + outcome.key}
            head |= {f"vary.{key}": value for key, value in of(outcome.key).items()}
            if outcome.error is not None:
                rows.append({**head, "estimator": None, "error": outcome.error})
            for name, figures in outcome.figures.items():
                rows.append({**head, "estimator": name, "error": None, **figures})
        names = dict.fromkeys(name for row in rows for name in row)
        kind = _arrow_types(plan, pa)
        columns = {}
        for name in names:
            values = [row.get(name) for row in rows]
            text = kind(name) == pa.string()
            columns[name] = pa.array([str(v) if text and v is not None else v for v in values], kind(name))
        sink = pa.BufferOutputStream()
        pq.write_table(pa.table(columns), sink)
        self.write(f"runs-{number:06d}.parquet", sink.getvalue().to_pybytes())

    def column_names(self) -> list[str]:
        """List all columns of the data set, in the order of their first appearance."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        names: dict[str, None] = {}
        for file in self.files():
            names |= dict.fromkeys(pq.read_schema(pa.BufferReader(self.read(file))).names)
        return list(names)

    def table(self, columns: Sequence[str] | None = None) -> "pyarrow.Table":
        """Read the data set, or some of its columns, by run and estimator; null where a file lacks a column."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        parts = []
        for file in self.files():
            source = pa.BufferReader(self.read(file))
            has = pq.read_schema(source).names
            wanted = [c for c in (columns if columns is not None else has) if c in has]
            source.seek(0)
            parts.append(pq.read_table(source, columns=wanted))
        if not parts:
            return pa.table({"run": pa.array([], pa.int64())})
        table = pa.concat_tables(parts, promote_options="permissive")
        keys = [(c, "ascending") for c in ("run", "estimator") if c in table.column_names]
        return table.sort_by(keys)

    def done(self) -> set[int]:
        """Find the numbers of the runs in the data set."""
        return set(self.table(["run"])["run"].to_pylist())


def _arrow_types(plan: Plan, pa: Any) -> Callable[[str], Any]:
    """Choose the type of a column by its name: the same in every file, whatever its values."""
    known = {"run": pa.int64(), "seed": pa.int64(), "estimator": pa.string(), "error": pa.string()}
    for variation in map(Variation.read, plan.vary):
        kinds = {type(v) for v in variation.values}
        kind = pa.string() if str in kinds else pa.bool_() if kinds == {bool} else pa.float64()
        known[f"vary.{variation.key}"] = kind
    return lambda name: known.get(name, pa.list_(pa.float32()) if name.startswith("bands.") else pa.float64())


# ----------------------------------------------------------------------------------------------- flying


def flown(plan: Plan, store: Store) -> int:
    """Count the runs of a plan that are in its store.

    Raises:
        InputError: the store holds a different campaign.
    """
    store.check(plan)
    return len(store.done().intersection(range(plan.runs)))


def fly(plan: Plan, store: Store, pool: Pool, progress: Callable[[int, int], None] = lambda done, all_: None) -> int:
    """Fly what is missing of a campaign into its store.

    Args:
        plan: what to fly.
        store: where the rows go; rows that are there are not flown again.
        pool: the workers.
        progress: called with the number of runs done and of all.

    Returns:
        How many runs were flown now.

    Raises:
        InputError: the store holds a different campaign, or no run can be flown as the scenario is.
    """
    store.check(plan)
    done = store.done()
    missing = [k for k in range(plan.runs) if k not in done]
    of = plan.values()
    if missing:
        flights.warm_up(pool, [plan.run(missing[0], of(missing[0]))])
    store.begin(plan)  # a plan of which no run can be flown leaves nothing
    if not missing:
        return 0
    number = 1 + max((int(name[5:-8]) for name in store.files()), default=-1)
    waiting: list[Outcome] = []
    written = time.monotonic()
    try:
        for count, outcome in enumerate(flights.fly_all(pool, (plan.run(k, of(k)) for k in missing)), 1):
            waiting.append(outcome)
            progress(plan.runs - len(missing) + count, plan.runs)
            if len(waiting) >= BATCH_RUNS or time.monotonic() - written > BATCH_S:
                batch, waiting = waiting, []
                store.add(number, batch, plan)
                number, written = number + 1, time.monotonic()
    finally:  # an interrupt keeps what has been flown
        if waiting:
            store.add(number, waiting, plan)
    return len(missing)


def keep_logs(plan: Plan, numbers: Sequence[int], folder: Path, pool: Pool) -> Iterator[tuple[int, Path, str | None]]:
    """Fly runs once more into logs: cheaper than keeping all of them, and the same to the byte.

    Yields:
        Number of the run, its log and what went wrong.
    """
    folder.mkdir(parents=True, exist_ok=True)
    of = plan.values()

    def again() -> Iterator[Run]:
        for k in numbers:
            run = plan.run(k, of(k))
            yield replace(run, band_s=None, log=str((folder / f"run-{k:06d}.mcap").absolute()))

    for outcome in flights.fly_all(pool, again()):
        yield outcome.key, folder / f"run-{outcome.key:06d}.mcap", outcome.error


def scenario_of(place: str, number: int, gate: Gate = _FOREIGN) -> Scenario:
    """Read the scenario of one run of a campaign, as it was flown; its code from outside runs as `gate` allows.

    Raises:
        InputError: no campaign there, or no such run in it.
    """
    plan = replace(Store(place).plan(), code=gate.allowed)
    if not 0 <= number < plan.runs:
        raise InputError(f"{place}: --run {number}: its runs are 0 to {plan.runs - 1}")
    run = plan.run(number)
    return parse(dict(run.data), run.where, run.name, gate=gate)
