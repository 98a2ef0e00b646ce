"""Layouts of viewers that open our logs without editing."""

from importlib import resources
from pathlib import Path
from typing import Any


def describe() -> list[dict[str, Any]]:
    """Name and path of every layout, and which viewers import it."""
    folder = Path(str(resources.files(__name__)))
    return [
        {"name": path.stem, "path": str(path), "for": "Foxglove and Lichtblick: Layouts, Import from file"}
        for path in sorted(folder.glob("*.json"))
    ]
