"""Where the shipped aircraft and scenarios lie: in a checkout at its root, in an installed wheel inside the package."""

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def _folder(name: str) -> Path:
    inside = _PACKAGE / "_data" / name
    return inside if inside.is_dir() else _PACKAGE.parent / name


def aircraft_dir() -> Path:
    """Find the folder of our own aircraft."""
    return _folder("aircraft")


def scenario_dir() -> Path:
    """Find the folder of the shipped scenarios."""
    return _folder("scenarios")
