"""The data set of a campaign: a manifest and Parquet files that are only ever added, each whole or not at all."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ahrs_sim.errors import InputError
from ahrs_sim.runs.campaign_plan import Plan
from ahrs_sim.runs.pool import Outcome
from ahrs_sim.runs.variation import Variation

if TYPE_CHECKING:
    import pyarrow


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
            changed = [k for k in new if k not in ("runs", "versions", "sources") and new[k] != old.get(k)]
            if any(Variation.read(v).kind == "lhs" for v in plan.vary) and runs != new["runs"]:
                changed.append("runs (a Latin hypercube has a fixed number)")
            if changed:
                raise InputError(
                    f"{self.place}: already holds a different campaign ({changed[0]} differs); choose another -o"
                )
            if other := _other(old, new, "versions") or _other(old, new, "sources"):
                raise InputError(
                    f"{self.place}: its flights were flown with other {other}; go on with those, or start anew: "
                    "choose another -o, or remove this folder"
                )
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


def _other(old: Mapping[str, Any], new: Mapping[str, Any], kind: str) -> str:
    """Name what differs in a table of two manifests; empty when nothing does."""
    was, now = old.get(kind), new[kind]
    if not isinstance(was, dict):
        return f"{kind} (it has not noted which)"
    changed = [name for name in {**was, **now} if was.get(name) != now.get(name)]
    if not changed:
        return ""
    shown = [f"{name} {was.get(name, 'none')}, now {now.get(name, 'none')}" for name in changed]
    return f"{kind} ({'; '.join(shown)})"


def _arrow_types(plan: Plan, pa: Any) -> Callable[[str], Any]:
    """Choose the type of a column by its name: the same in every file, whatever its values."""
    known = {"run": pa.int64(), "seed": pa.int64(), "estimator": pa.string(), "error": pa.string()}
    for variation in map(Variation.read, plan.vary):
        kinds = {type(v) for v in variation.values}
        kind = pa.string() if str in kinds else pa.bool_() if kinds == {bool} else pa.float64()
        known[f"vary.{variation.key}"] = kind
    return lambda name: known.get(name, pa.list_(pa.float32()) if name.startswith("bands.") else pa.float64())
