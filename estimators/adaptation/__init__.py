"""How far to trust a measurement: one short file per policy, for any filter on any model (see `base`)."""

import importlib
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from estimators.settings import Setting

if TYPE_CHECKING:
    from estimators.adaptation.base import BoundPolicy

_POLICIES = {"none": "plain", "switched": "switched", "fuzzy": "fuzzy", "gate": "gating", "magnetic": "magnetic"}


def settings(default: str = "none", **values: float) -> dict[str, Setting]:
    """Settings of all policies, for any method; `values` are defaults of this one that differ."""
    known = {"adaptation": Setting(default, "how far measurements are trusted", tuple(_POLICIES))}
    for name in _POLICIES.values():
        known |= getattr(importlib.import_module(f"estimators.adaptation.{name}"), "SETTINGS", {})
    return known | {name: replace(known[name], default=value) for name, value in values.items()}


def make(settings: Mapping[str, Any]) -> "BoundPolicy":
    """Make the policy that `settings["adaptation"]` names ("none" when it is not there)."""
    from estimators.adaptation.base import BoundPolicy

    module = importlib.import_module(f"estimators.adaptation.{_POLICIES[settings.get('adaptation', 'none')]}")
    return BoundPolicy(module)
