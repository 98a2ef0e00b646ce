"""No adaptation: every measurement counts as the model says."""

from collections.abc import Mapping
from typing import Any

from estimators.adaptation.base import Trust as Trust
from estimators.native import Number, Record
from estimators.types import Site


class Parameters(Record):
    """None."""

    nothing: Number


def make(settings: Mapping[str, Any], site: Site) -> Parameters:
    """Make the parameters; no settings."""
    return Parameters.zeros()
