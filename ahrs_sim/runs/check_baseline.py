"""Baselines of `ahrs-sim check`: JSON beside the suite, changed by `renew` only, which keeps the reason."""

import datetime
import json
import math
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np

from ahrs_sim.errors import CheckError, InputError
from ahrs_sim.runs.check_suite import Suite

Figures = dict[str, dict[str, dict[str, list[float]]]]
"""By flight, estimator and figure: a value a seed, NaN where there is none."""


@dataclass(frozen=True)
class Found:
    """Figures of the flights of a suite, and why the others failed."""

    figures: Figures
    errors: dict[str, str]  # by flight and seed
    seconds: dict[str, float] = field(default_factory=dict)  # by flight: all its seeds, one after the other


def read(suite: Suite) -> dict[str, Any]:
    """Read the baseline of a suite.

    Raises:
        InputError: there is none yet, or it is damaged.
    """
    try:
        baseline = json.loads(suite.baseline.read_text(encoding="utf-8"))
        _check_baseline(baseline)
    except FileNotFoundError:
        raise InputError(f"{suite.baseline}: no baseline yet; make it with --renew --why 'first baseline'") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{suite.baseline}: not a baseline ({error}); restore it, or move it away and renew") from None
    return dict(baseline)


def _check_baseline(baseline: Any) -> None:
    """Check that a baseline has the form that `renew` writes.

    Raises:
        KeyError, TypeError, ValueError: it has not.
    """
    if not isinstance(baseline, dict) or not all(isinstance(entry, dict) for entry in _list(baseline["history"])):
        raise TypeError("no tables in it")
    for name, flight in _table(baseline["flights"]).items():
        seeds = _list(flight["seeds"])
        if not all(isinstance(seed, int) for seed in seeds):
            raise TypeError(f"seeds of {name}")
        for figures in _table(flight["estimators"]).values():
            for figure, values in _table(figures).items():
                if len(_list(values)) != len(seeds) or not all(x is None or isinstance(x, int | float) for x in values):
                    raise ValueError(f"{figure} of {name}")
                np.array(values, float)  # or it does not fit into a float


def _table(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("something is no table")
    return value


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise TypeError("something is no list")
    return value


def renew(suite: Suite, found: Found, why: str) -> None:
    """Make what was found the baseline, with the reason in its history.

    Raises:
        CheckError: a flight has failed.
        InputError: the file cannot be written.
    """
    if found.errors:
        where, error = next(iter(found.errors.items()))
        raise CheckError(f"{suite.baseline}: not renewed: {where}: {error}")
    history = read(suite)["history"] if suite.baseline.exists() else []
    now = datetime.datetime.now(datetime.UTC).date().isoformat()
    history.append({"date": now, "version": version("ahrs-sim"), "why": why})
    data = {
        "history": history,
        "flights": {
            f.name: {
                "seeds": list(f.seeds),
                "estimators": {
                    estimator: {name: [_rounded(v) for v in values] for name, values in figures.items()}
                    for estimator, figures in found.figures[f.name].items()
                },
            }
            for f in suite.flights
        },
    }
    part = suite.baseline.with_suffix(".part")
    try:
        part.write_text(_dumps(data), encoding="utf-8")
        part.replace(suite.baseline)
    except OSError as error:
        raise InputError(f"{suite.baseline}: cannot be written: {error.strerror or error}") from None


def _rounded(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None


def _dumps(data: dict[str, Any]) -> str:
    """JSON with a line per figure: what a renewal has changed can be read in a diff."""
    lists: dict[str, str] = {}

    def mark(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: mark(v) for k, v in value.items()}
        if isinstance(value, list) and not any(isinstance(x, dict) for x in value):
            lists[f"list {len(lists)}"] = json.dumps(value)
            return f"list {len(lists) - 1}"
        return value

    lines = json.dumps({k: v if k == "history" else mark(v) for k, v in data.items()}, indent=1).splitlines()
    for i, line in enumerate(lines):
        head, _, tail = line.rpartition(': "list ')
        if head:
            number, _, comma = tail.partition('"')
            lines[i] = f"{head}: {lists[f'list {number}']}{comma}"
    return "\n".join(lines) + "\n"
