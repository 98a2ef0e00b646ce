"""How far to trust a measurement: one short file per policy, for any filter on any model (see `base`).

make({"adaptation": "fuzzy", "fuzzy_memory": 0.98, ...}, site)
"""

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators.adaptation.base import MEMORY, SENSORS, Plain
from estimators.types import Site

_POLICIES = {"switched": "switched", "fuzzy": "fuzzy", "gate": "gating", "magnetic": "magnetic"}


def make(settings: Mapping[str, Any], site: Site) -> Any:
    """The policy that `settings["adaptation"]` names ("none" when it is not there), a NamedTuple.

    Only its module is imported: what is not used is not compiled.
    """
    name = settings.get("adaptation", "none")
    if name == "none":
        return Plain()
    return importlib.import_module(f"estimators.adaptation.{_POLICIES[name]}").make(settings, site)


def fresh() -> np.ndarray:
    """The memory of a policy that has seen nothing."""
    trust = np.zeros(MEMORY)
    trust[:SENSORS] = np.nan
    return trust
