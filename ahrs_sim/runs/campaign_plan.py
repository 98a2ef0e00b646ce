"""The plan of a campaign: run k is the scenario with seed `seed + k` and values by seed, key and k alone."""

import copy
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.runs import sources
from ahrs_sim.runs.pool import Run, Span
from ahrs_sim.runs.variation import Variation, put
from ahrs_sim.scenario import Gate, Scenario, code, parse, seeds
from ahrs_sim.scenario.table import Table, parse_toml

_MOST_RUNS = 10_000_000

BANDS = 60
"""Spans of time for which the error is kept, about."""


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
            "sources": sources.digests(scenario, self.code),
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
