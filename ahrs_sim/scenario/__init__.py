"""Scenarios: TOML files read and checked, seeds of their random streams, the shipped files.

scenario        Scenario: `load` a file, `parse` data that is already there
component       a table of a scenario; the estimator it describes
code            which code from outside a file may run
table           checked access to a TOML table, one-line errors with file and key
seeds           one random stream per name
shipped         folders of the shipped scenarios and aircraft
"""

from ahrs_sim.scenario.code import ANY, Gate
from ahrs_sim.scenario.component import Component, create_estimator, estimator_component
from ahrs_sim.scenario.scenario import (
    DEFAULT_ESTIMATORS,
    DEFAULT_SUITES,
    TURBULENCE,
    Gust,
    Scenario,
    Start,
    Wind,
    find,
    load,
    parse,
    short_name,
)

__all__ = [
    "ANY",
    "DEFAULT_ESTIMATORS",
    "DEFAULT_SUITES",
    "TURBULENCE",
    "Component",
    "Gate",
    "Gust",
    "Scenario",
    "Start",
    "Wind",
    "create_estimator",
    "estimator_component",
    "find",
    "load",
    "parse",
    "short_name",
]
