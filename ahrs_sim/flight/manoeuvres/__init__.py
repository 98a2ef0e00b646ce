"""The manoeuvres a scenario can ask for: one small class each, all of one shape.

A `[[step]]` table names a manoeuvre (`do = "turn"`) and its parameters. `parse_steps` makes objects of them before any
aircraft exists, so that bad input is found first. In flight the pilot calls `begin` once and `step` 50 times a second
until it returns True; a manoeuvre only changes set-points of the autopilot. Heights are above the ground at the start,
angles to the right and upwards are positive.

Every manoeuvre takes `timeout_s`, after which it has failed; those that fly also `airspeed_mps`, a new speed to hold.
"""

from collections.abc import Sequence

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.flight.manoeuvres.base import Failure, Manoeuvre
from ahrs_sim.flight.manoeuvres.ordinary import Climb, Descend, FigureEight, HandOver, Orbit, Set, Straight, Turn, Wait
from ahrs_sim.flight.manoeuvres.route import Calibrate, Goto, Hold, Random, Survey
from ahrs_sim.flight.manoeuvres.runway import Approach, Land, RunUp, Takeoff
from ahrs_sim.flight.manoeuvres.violent import Doublet, Loop, PullUp, Roll, WindupTurn
from ahrs_sim.scenario import seeds
from ahrs_sim.scenario.table import Table

__all__ = ["MANOEUVRES", "Failure", "HandOver", "Manoeuvre", "parse_steps"]

MANOEUVRES: dict[str, type[Manoeuvre]] = {
    cls.name: cls
    for cls in (
        Wait, RunUp, Takeoff, Climb, Descend, Straight, Turn, Orbit, FigureEight, WindupTurn, Doublet, PullUp, Loop,
        Roll, Approach, Land, Goto, Hold, Survey, Random, Calibrate, HandOver, Set,
    )
}  # fmt: skip
"""Every manoeuvre by the name a scenario uses."""


def parse_steps(tables: Sequence[Table], seed: int = 0) -> tuple[Manoeuvre, ...]:
    """Make manoeuvres from a scenario's `[[step]]` tables; what is random in them follows from its seed.

    Raises:
        InputError: an unknown manoeuvre or key, or a value out of range.
    """
    steps = []
    for number, table in enumerate(tables, 1):
        name = table.text("do")
        if name not in MANOEUVRES:
            raise InputError(f"{table.where}: do: '{name}' is unknown{nearest(name, MANOEUVRES)}")
        steps.append(MANOEUVRES[name](table))
        steps[-1].random = seeds.generator(seed, "step", str(number))
    return tuple(steps)
