"""`ahrs-sim aircraft`: what is found of an aircraft before it flies."""

import argparse
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ahrs_sim.cli.common import Commands

if TYPE_CHECKING:
    from ahrs_sim.flight.design import Design, Row

MODES = ("short period", "phugoid", "Dutch roll", "roll", "spiral")


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("aircraft", help="print trims, modes, gains, margins and envelope of an aircraft")
    command.add_argument(
        "name", help="one of `ahrs-sim list aircraft`, or the path of a JSBSim model's folder or XML file"
    )
    command.add_argument("--json", action="store_true", help="print JSON")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Print what is found of an aircraft."""
    from ahrs_sim.flight.design import design

    found = design(arguments.name, "command line")
    print(found.text() if arguments.json else _text(found))


def _text(design: "Design") -> str:
    """Lay the design out as tables; degrees and m/s."""
    engines = f"{design.engines} engine{'s' if design.engines != 1 else ''}" if design.powered else "no thrust"
    lines = [
        f"{design.name}: {design.mass:.0f} kg, {design.area:.1f} m2, span {design.span:.1f} m, {engines}, "
        f"{len(design.wheels)} wheels",
        f"stall {design.stall:.1f}, approach {design.approach:.1f}, cruise {design.cruise:.1f}, fastest "
        f"{design.fastest:.1f} m/s (calibrated; clean, at 1000 m, as loaded)",
        "",
        "trim and envelope, per airspeed; angles in deg, controls -1 to 1",
        *_table(
            ("m/s", "alpha", "pitch", "elevator", "aileron", "rudder", "throttle", "climb m/s", "bank held", "bank"),
            [_trim(design, row) for row in design.rows],
        ),
        "",
        "modes without autopilot: rad/s and damping ratio, or time constant (negative: it grows)",
        *_table(("m/s", *MODES), [_modes(row) for row in design.rows]),
        "",
        "gains of the inner loops (alpha, q, integral; p, integral; sideslip, r, integral) and of the outer ones, 1/s",
        *_table(
            (
                "m/s",
                "alpha",
                "q",
                "int q",
                "aileron p",
                "int p",
                "rudder beta",
                "rudder r",
                "int side",
                "bank",
                "pitch",
            ),
            [_gains(row) for row in design.rows],
        ),
        "",
        "margins of the loops broken at each control, as loaded / with a fifth of the fuel: dB, deg",
        *_table(("m/s", *design.rows[0].margins, "damping"), [_margins(row) for row in design.rows]),
    ]
    lines += [f"\ncannot {what}: {why}" for what, why in design.refusals.items()]
    return "\n".join(lines)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(x) for x in column) for column in zip(head, *rows, strict=True)]
    return ["  ".join(f"{x:>{w}s}" for x, w in zip(row, widths, strict=True)) for row in (head, *rows)]


def _trim(design: "Design", row: "Row") -> list[str]:
    angles = [f"{math.degrees(x):.1f}" for x in (row.alpha, row.theta)]
    controls = [f"{x:.3f}" for x in (row.elevator, row.aileron, row.rudder, row.throttle)]
    climb = row.climb if design.powered else row.airspeed * math.sin(row.slope)
    banks = [f"{math.degrees(design.bank_limit(row.airspeed, steady=x)):.0f}" for x in (True, False)]
    return [f"{row.airspeed:.1f}", *angles, *controls, f"{climb:.1f}", *banks]


def _modes(row: "Row") -> list[str]:
    cells = []
    for real, imaginary in (row.modes.get(name, (0.0, 0.0)) for name in MODES):
        size = math.hypot(real, imaginary)
        cells.append(f"{size:.2f}, {-real / size:.2f}" if imaginary else f"{-1.0 / real:.2f} s" if real else "-")
    return [f"{row.airspeed:.1f}", *cells]


def _gains(row: "Row") -> list[str]:
    pitch, aileron, rudder = row.longitudinal, row.lateral[0], row.lateral[1]
    values = (pitch[0], pitch[1], pitch[3], aileron[1], aileron[5], rudder[0], rudder[2], rudder[6])
    return [f"{row.airspeed:.1f}", *(f"{x:.3f}" for x in values), f"{row.bank_gain:.2f}", f"{row.pitch_gain:.2f}"]


def _margins(row: "Row") -> list[str]:
    cells = []
    for name, (gain, phase, _) in row.margins.items():
        light_gain, light_phase, _ = row.margins_light[name]
        cells.append(f"{gain:.0f}, {phase:.0f} / {light_gain:.0f}, {light_phase:.0f}")
    return [f"{row.airspeed:.1f}", *cells, f"{row.damping:.2f}"]
