"""What is to be flown: a TOML file read and checked, the seeds of its random streams, the shipped files.

scenario        Scenario: `load` a file, `parse` data that is already there
table           checked access to a TOML table, one-line errors with file and key
seeds           one random stream per name
shipped         folders of the shipped scenarios and aircraft
"""

from ahrs_sim.scenario.scenario import (
    DEFAULT_ESTIMATORS,
    DEFAULT_SUITES,
    TURBULENCE,
    Component,
    Gust,
    Scenario,
    Start,
    Wind,
    find,
    load,
    parse,
)

__all__ = [
    "DEFAULT_ESTIMATORS",
    "DEFAULT_SUITES",
    "TURBULENCE",
    "Component",
    "Gust",
    "Scenario",
    "Start",
    "Wind",
    "find",
    "load",
    "parse",
]
