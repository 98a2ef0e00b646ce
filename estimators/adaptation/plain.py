"""No adaptation: every measurement counts as the model says."""

from typing import Any

from estimators.adaptation.base import Trust as Trust
from estimators.native import Number, Record
from estimators.records import Place


class Parameters(Record):
    """None."""

    nothing: Number


def configure(settings: Any, site: Place, policy: Parameters) -> None:
    """Set the parameters; no settings."""
    policy.nothing = 0.0
