"""A named table of a scenario (suite, estimator, fault), and the estimator that one describes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ahrs_sim.errors import InputError
from ahrs_sim.scenario.code import Gate, from_outside
from ahrs_sim.scenario.table import Table

if TYPE_CHECKING:
    from ahrs_sim.plugins import Processes
    from estimators.types import SensorInfo, Site


@dataclass(frozen=True)
class Component:
    """A named table (suite, estimator, fault) whose settings are checked by what is made from it."""

    name: str
    settings: Mapping[str, Any]
    where: str  # file and table, for messages
    code: str = ""  # from outside, that its method may run: what a gate has let pass

    def table(self) -> Table:
        """Wrap the settings for checked access."""
        return Table(dict(self.settings), self.where)


def estimator_component(name: str, settings: Mapping[str, Any], where: str, gate: Gate) -> Component:
    """Make the component of an `[estimator.NAME]` table.

    Raises:
        InputError: it has no method, or one that the gate does not let pass.
    """
    method = Table(dict(settings), where).text("method")
    gate.check_estimator(settings, where)
    return Component(name, settings, where, method if from_outside(method) else "")


def create_estimator(component: Component, site: "Site", sensors: "SensorInfo") -> "Processes":
    """Create the estimator that an `[estimator.NAME]` table describes.

    Code from outside comes guarded: see `ahrs_sim.plugins`.

    Raises:
        InputError: an unknown method or setting: where, which, what to do; a library that cannot be used.
    """
    import estimators
    from ahrs_sim import plugins

    method = str(component.settings["method"])
    if method != component.code:  # whoever made the component without a gate cannot run code from outside
        Gate().check(method, component.where)
    settings = {k: v for k, v in component.settings.items() if k not in ("method", "suite")}
    try:
        if from_outside(method):
            folder = Path(component.where.partition(":")[0]).parent
            return plugins.create(component.name, method, folder, site=site, sensors=sensors, settings=settings)
        return estimators.create(method, site=site, sensors=sensors, **settings)
    except estimators.SettingError as error:
        raise InputError(f"{component.where}: {error}") from None
