"""Ready-made maps for what other programs export: `--map preset:NAME`, or `preset = "NAME"` in a map of one's own."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.scenario.table import Table, overlay, read_toml

PREFIX = "preset:"
_FOLDER = Path(__file__).parent / "maps"


def names() -> list[str]:
    """List the shipped maps."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def describe() -> list[dict[str, str]]:
    """List name and purpose of each map."""
    return [{"name": name, "text": _file(name).read_text(encoding="utf-8").splitlines()[0][2:]} for name in names()]


def read(path: Path) -> Table:
    """Read a map: `preset:NAME`, or a file, whose `preset` key names the map that it builds on.

    Raises:
        InputError: no such file or preset.
    """
    if str(path).startswith(PREFIX):
        return _preset(str(path)[len(PREFIX) :], "--map")
    table = read_toml(path)
    if not table.has("preset"):
        return table
    base = _preset(table.text("preset"), f"{table.where}: preset")
    own = {k: v for k, v in table.data.items() if k != "preset"}
    return Table(overlay(base.data, own), table.where)


def fitting(path: Path) -> str | None:
    """Find the map whose files and columns are those of `path`, a folder or a table of text; None: none fits."""
    from ahrs_sim.recordings.sources import looks_like_text

    if not path.is_dir() and not looks_like_text(path):
        return None
    # Old forms ask for more; an iPhone's files look like an Android's.
    order = sorted(names(), key=lambda name: (name.endswith("-ios"), not name.endswith("-old")))
    return next((name for name in order if _fits(path, _preset(name, "").data["csv"])), None)


def _file(name: str) -> Path:
    return _FOLDER / f"{name}.toml"


def _preset(name: str, where: str) -> Table:
    if name not in names():
        raise InputError(f"{where}: no map 'preset:{name}'{nearest(name, names())}")
    return Table(read_toml(_file(name)).data, f"{PREFIX}{name}")


def _fits(path: Path, csv: Mapping[str, Any]) -> bool:
    """Test whether the columns that a map needs, and its times, are in the files that it names."""
    from ahrs_sim.recordings.sources.text import header_of

    needed = False
    for kind in (v for v in csv.values() if isinstance(v, dict) and "column" not in v and not v.get("optional")):
        for entry in (v for v in kind.values() if isinstance(v, dict) and "columns" in v):
            pattern = entry.get("file", kind.get("file"))
            if (pattern is None) == path.is_dir():
                return False
            file = next(_matching(path, pattern), None) if pattern else path
            found = header_of(file) if file else None
            columns = [*entry["columns"], csv["time"]["column"]]
            if found is None or any(found.place(c) < 0 for c in columns):
                return False
            needed = True
    return needed


def _matching(folder: Path, pattern: str) -> Iterator[Path]:
    for one in pattern.split("|"):
        yield from (p for p in sorted(folder.glob(one)) if p.is_file())
