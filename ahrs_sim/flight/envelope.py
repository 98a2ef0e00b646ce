"""What an aircraft cannot do is found before it flies: speeds, banks and steps outside its envelope."""

import math
from collections.abc import Sequence

from ahrs_sim.errors import InputError
from ahrs_sim.flight.design import Design
from ahrs_sim.flight.manoeuvres import Manoeuvre

TRAINER_FASTEST = 60.0  # m/s
TRAINER_BANK = math.radians(75.0)


def check(steps: Sequence[Manoeuvre], design: Design | None, airspeed: float) -> None:
    """Look at the steps in order, with the airspeed that each will have.

    Args:
        steps: of a scenario.
        design: of the aircraft; None: it is our trainer.
        airspeed: m/s, at the start; 0: on the ground, whence it goes on to cruise.

    Raises:
        InputError: a step that the aircraft cannot fly, and what it could.
    """
    speed = airspeed or (design.cruise if design else 20.0)
    for step in steps:
        if design is not None and step.name in design.refusals:
            raise InputError(f"{step.where}: do: '{design.name}' cannot {step.name}: {design.refusals[step.name]}")
        if step.new_airspeed is not None:
            speed = step.new_airspeed
            _speed(step, design, speed)
        if design is not None:
            if step.patient:
                step.timeout *= max(1.0, design.cruise / 20.0)
            _bank(step, design, speed)
        elif step.steepest(speed) > TRAINER_BANK and step.name == "windup_turn":
            raise InputError(f"{step.where}: bank_deg: our trainer turns with up to 75 deg; take less")


def _speed(step: Manoeuvre, design: Design | None, speed: float) -> None:
    low, high = (1.1 * design.stall, design.fastest) if design else (0.0, TRAINER_FASTEST)
    if not low <= speed <= high:
        name = design.name if design else "trainer"
        raise InputError(
            f"{step.where}: airspeed_mps: '{name}' flies {low:.0f} to {high:.0f} m/s, not {speed:g}; take one between"
        )


def _bank(step: Manoeuvre, design: Design, speed: float) -> None:
    wanted = step.steepest(speed)
    limit = design.bank_limit(speed, steady=step.steady)
    if wanted <= limit + 1e-6:
        return
    enough = [row.airspeed for row in design.rows if design.bank_limit(row.airspeed, steady=step.steady) >= wanted]
    other = f", or at {min(enough):.0f} m/s and more" if enough and min(enough) > speed else ""
    raise InputError(
        f"{step.where}: do: '{step.name}' needs {math.degrees(wanted):.0f} deg of bank, '{design.name}' has up to "
        f"{math.degrees(limit):.0f} deg at {speed:.0f} m/s; fly it with less{other}"
    )
