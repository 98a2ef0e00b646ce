"""Fly every aircraft of JSBSim with the one autopilot and write what it did: `python docs/aircraft.py`.

With names it flies those anew and takes the others from the last time on this machine; with `classes` alone it flies
the estimators in an aircraft of each class, and leaves the other tables as they are. Some twenty seconds an aircraft
and core.
"""

import math
import multiprocessing
import pickle
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from ahrs_sim import scenario as scenarios
from ahrs_sim.errors import InputError
from ahrs_sim.flight import Truth, open_flight
from ahrs_sim.flight.design import Design, design
from ahrs_sim.flight.fdm import aircraft
from ahrs_sim.runs import pool
from ahrs_sim.runs.pool import Run, Span
from ahrs_sim.scenario.shipped import scenario_dir

RESULTS = Path.home() / ".cache" / "ahrs_sim" / "aircraft-page"
PAGE = Path(__file__).with_suffix(".md")
JOBS = 4  # aircraft at a time
RATE = 200.0  # Hz
HEIGHT = 2000.0  # m, of the turns
BANK = 30.0  # deg
TURN = 45.0  # s, each way
ENTRY = 20.0  # s, after which a turn is steady
LOAD = 5.0  # g, of the wind-up turn
STRONG = 25.0  # m/s of climb at cruise, of an aircraft that is asked to pull as much
LIMITS = (3.0, 30.0, 5.0)  # deg, m, %

CLASSES = {
    "glider": "SGS", "light single": "c172p", "light twin": "c310", "business jet": "global5000", "airliner": "737",
    "fighter": "f16",
}  # fmt: skip
SEEDS = (1, 2, 3)
# The pitot tube of the suites ends at 106 m/s; these aircraft have one that does not.
TUBE = {"air_data": {"diff_range_pa": 100e3}}
SUITES = {"chr": {"grade": "chr_6dm", **TUBE}, "sbg": {"grade": "sbg_ig500", **TUBE}}
ESTIMATORS = {
    "marg-ckf, chr": {"method": "marg-ckf", "suite": "chr"},
    "marg-ckf with airspeed, sbg": {"method": "marg-ckf", "suite": "sbg", "aiding": "airspeed"},
    "ins21, chr": {"method": "ins21", "suite": "chr"},
    "ins21, sbg": {"method": "ins21", "suite": "sbg"},
}


def fly(data: dict[str, Any]) -> tuple[Truth, list[Any], str | None]:
    """Fly a scenario; truth, events and what ended it early."""
    flight = open_flight(scenarios.parse({"seed": 1, "rate_hz": RATE, **data}, "docs/aircraft.py", "aircraft"))
    blocks, events = [], []
    while len(rows := flight.fly(2000)):
        blocks.append(rows)
        flight.take_setpoints()
        events += flight.take_events()
    return Truth.concatenate(blocks), events + flight.take_events(), flight.error


def roll_deg(truth: Truth) -> np.ndarray:
    """Bank angle, (n,) deg."""
    a, b, c, d = truth.q_nb.T
    return np.degrees(np.arctan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c)))


def turns(name: str, known: Design) -> dict[str, Any]:
    """Turn both ways; the worst of bank (deg), height (m) and airspeed (%) once the turn is steady."""
    steps: list[dict[str, Any]] = [{"do": "straight", "for_s": 10.0}]
    steps += [{"do": "turn", "bank_deg": sign * BANK, "for_s": TURN} for sign in (1.0, -1.0)]
    truth, events, error = fly({"aircraft": name, "start": {"on_ground": False, "height_m": HEIGHT}, "step": steps})
    if error:
        return {"error": error}
    roll = roll_deg(truth)
    begin = [event.t for event in events if event.text.endswith("(turn) begins")]
    steady = [(truth.t > t + ENTRY) & (truth.t < t + TURN - 0.1) for t in begin]
    off = [np.abs(roll[rows] - sign * BANK).max() for rows, sign in zip(steady, (1.0, -1.0), strict=True)]
    both = steady[0] | steady[1]
    calibrated = truth.airspeed[both] / truth.airspeed[0]
    if not known.powered:  # what it does hold on the way down is the calibrated airspeed
        calibrated = calibrated * np.sqrt(truth.pressure[both] / truth.pressure[0])
    return {
        "bank": max(off),
        "height": np.abs(truth.height_agl[both] - HEIGHT).max() if known.powered else math.nan,
        "speed": 100.0 * np.abs(calibrated - 1.0).max(),
        "sink": float(truth.vel_n[both, 2].mean()),
    }


def circuit(name: str) -> dict[str, Any]:
    """Fly the scenario `airfield`; how it took off and touched down."""
    data = tomllib.loads((scenario_dir() / "airfield.toml").read_text(encoding="utf-8"))
    truth, _, error = fly(data | {"aircraft": name})
    if error:
        return {"error": error}
    off = int(np.flatnonzero(~truth.on_ground)[0])
    down = int(np.flatnonzero(~truth.on_ground)[-1])
    return {"off": truth.airspeed[off], "down": truth.airspeed[down], "sink": truth.vel_n[down, 2]}


def windup(name: str, known: Design) -> dict[str, Any]:
    """Tighten a turn to `LOAD`, where the wing carries it; the load factor that was reached."""
    bank = math.acos(1.0 / LOAD)
    speed = 0.95 * known.fastest
    climbs = known.at(known.cruise, lambda row: row.climb)
    if known.bank_limit(speed, steady=False) < bank or climbs < STRONG:
        return {}
    step = {"do": "windup_turn", "load_g": LOAD, "rate_dps": 6.0, "hold_s": 4.0}
    start = {"on_ground": False, "height_m": 3000.0, "airspeed_mps": speed}
    truth, _, error = fly({"aircraft": name, "start": start, "step": [step]})
    loads = np.linalg.norm(truth.accel_b, axis=1) / 9.80665
    return {"error": error} if error else {"load": float(np.percentile(loads, 98.0)), "from": speed}


def class_flights(name: str) -> dict[str, tuple[dict[str, Any], Span]]:
    """What estimators see of an aircraft: the turns, and the wind-up turn of a fighter; with the part that counts."""
    start = {"on_ground": False, "height_m": HEIGHT}
    align = {"do": "straight", "for_s": 60.0}
    both: list[dict[str, Any]] = [{"do": "turn", "bank_deg": sign * BANK, "for_s": 60.0} for sign in (1.0, -1.0)]
    flights = {"turns": ({"start": start, "step": [align, *both]}, Span("part", steps=(2, 3)))}
    if name == CLASSES["fighter"]:
        fast = {**start, "height_m": 3000.0, "airspeed_mps": 0.95 * design(name, "docs/aircraft.py").fastest}
        tight = {"do": "windup_turn", "load_g": LOAD, "rate_dps": 6.0, "hold_s": 4.0}
        after = {"do": "straight", "for_s": 20.0}
        flights["windup"] = ({"start": fast, "step": [align, tight, after]}, Span("part", steps=(2, 3)))
    return flights


def estimated(kind: str) -> dict[str, Any]:
    """The 95th percentile of tilt and heading error (deg), mean over the seeds, by flight and estimator."""
    name = CLASSES[kind]
    names = {f"e{i}": title for i, title in enumerate(ESTIMATORS)}
    row: dict[str, Any] = {"kind": kind, "name": name}
    for flight, (data, span) in class_flights(name).items():
        found: dict[str, list[tuple[float, float]]] = {title: [] for title in names.values()}
        for seed in SEEDS:
            data |= {"aircraft": name, "seed": seed, "rate_hz": RATE, "suite": SUITES}
            data["estimator"] = {short: ESTIMATORS[title] for short, title in names.items()}
            outcome = pool.fly(Run(seed, f"{name} {flight}", "docs/aircraft.py", data, spans=(span,)))
            if outcome.error:
                sys.exit(f"{name}, {flight}: {outcome.error}")
            for short, title in names.items():
                figures = outcome.figures[short]
                found[title].append((figures["part.tilt_p95_deg"], figures["part.heading_p95_deg"]))
        row[flight] = {title: np.mean(values, axis=0).tolist() for title, values in found.items()}
    (RESULTS / f"class {kind}.pickle").write_bytes(pickle.dumps(row))
    return row


def classes(rows: list[dict[str, Any]]) -> list[str]:
    """The table of estimators by class of aircraft."""
    table = [f"| class | aircraft | {' | '.join(ESTIMATORS)} |", f"|---|---|{'---|' * len(ESTIMATORS)}"]
    for flight, title in (("turns", ""), ("windup", f", {LOAD:.0f} g")):
        for row in rows:
            if flight in row:
                cells = [f"{row[flight][e][0]:.1f} / {row[flight][e][1]:.1f}" for e in ESTIMATORS]
                table.append(f"| {row['kind']}{title} | {row['name']} | {' | '.join(cells)} |")
    return table


def report(name: str) -> dict[str, Any]:
    """All that is found and flown of an aircraft; kept for the next time."""
    row = fly_all(name)
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.pickle").write_bytes(pickle.dumps(row))
    return row


def fly_all(name: str) -> dict[str, Any]:
    """All that is found and flown of an aircraft."""
    row: dict[str, Any] = {"name": name}
    try:
        known = design(name, "docs/aircraft.py")
    except InputError as error:
        return row | {"refused": re.sub(r".*autopilot: (.*?); take another.*|.*JSBSim cannot load", r"\1", str(error))}
    row["design"] = known
    flights = {"turns": lambda: turns(name, known), "circuit": lambda: circuit(name)}
    for what, run in {**flights, "windup": lambda: windup(name, known)}.items():
        try:
            row[what] = run()
        except InputError as error:
            row[what] = {"error": re.sub(r"^docs/aircraft.py: (\[\[step\]\] \d+: do: )?", "", str(error))}
    return row


def turned(row: dict[str, Any]) -> bool:
    """Whether the turns were held within the limits; a glider has no height to hold."""
    found = row.get("turns", {})
    values = [found.get(x, math.inf) for x in ("bank", "height", "speed")]
    return all(value <= limit or math.isnan(value) for value, limit in zip(values, LIMITS, strict=True))


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    known: Design = row["design"]
    found, round_, up = row["turns"], row["circuit"], row["windup"]
    cells = [row["name"], f"{known.mass:.0f}", f"{known.engines if known.powered else 'glides'}"]
    cells += [f"{x:.0f}" for x in (known.stall, known.cruise, known.fastest)]
    if "error" in found:
        cells += ["no", "", ""]
    else:
        height = f"{found['height']:.1f}" if known.powered else f"sinks {found['sink']:.1f} m/s"
        cells += [f"{found['bank']:.1f}", height, f"{found['speed']:.1f}"]
    cells += ["no"] if "error" in round_ else [f"{round_['off']:.0f}, {round_['down']:.0f}, {round_['sink']:.1f}"]
    cells += [f"{up['load']:.1f}" if "load" in up else "no" if "error" in up else ""]
    return "| " + " | ".join(cells) + " |"


def reasons(row: dict[str, Any]) -> list[str]:
    """What an aircraft did not do, and why."""
    out = [f"{what}: {row[what]['error']}" for what in ("turns", "circuit", "windup") if row[what].get("error")]
    if not turned(row) and "error" not in row["turns"]:
        out.append("turns: not within the limits")
    return out


def page(rows: list[dict[str, Any]], by_class: list[dict[str, Any]]) -> str:
    """The page; tables of which nothing is known stay as they are."""
    flown = [row for row in rows if "design" in row]
    table = [
        "| aircraft | kg | engines | stall | cruise | fastest | bank, deg | height, m | speed, % | circuit | load, g |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
        *(line(row) for row in flown),
    ]
    powered = sum(turned(row) and row["design"].powered for row in flown)
    gliders = sum(turned(row) and not row["design"].powered for row in flown)
    landed = sum("error" not in row["circuit"] for row in flown)
    pulled = [row["name"] for row in flown if row["windup"].get("load", 0.0) >= LOAD - 0.3]
    counts = (
        f"{powered} aircraft with thrust and {gliders} without hold the turns within {LIMITS[0]:.0f} deg, "
        f"{LIMITS[1]:.0f} m and {LIMITS[2]:.0f} %; {landed} fly the circuit from take-off to standstill; "
        f"{len(pulled)} reach {LOAD:.0f} g in a wind-up turn."
    )
    missing = [f"* **{row['name']}**: {reason}." for row in flown for reason in reasons(row)]
    refused = [f"* **{row['name']}**: {row['refused'].strip().rstrip('.')}." for row in rows if "refused" in row]
    text = PAGE.read_text(encoding="utf-8")
    parts = {"flown": [counts, "", *table], "not flown": missing, "refused": refused, "classes": classes(by_class)}
    known = {"classes": by_class}
    for mark, lines in ((mark, lines) for mark, lines in parts.items() if known.get(mark, rows)):
        text = re.sub(
            rf"(<!-- {mark} -->\n).*?(<!-- end {mark} -->)",
            lambda m, lines=lines: m[1] + "\n".join(lines) + "\n" + m[2],
            text,
            flags=re.DOTALL,
        )
    return text


def main() -> None:
    """Fly them."""
    everyone = sorted((name for name in aircraft() if name != "trainer"), key=str.lower)
    wanted = sys.argv[1:] or ["classes", *everyone]
    RESULTS.mkdir(parents=True, exist_ok=True)
    with multiprocessing.get_context("spawn").Pool(JOBS, maxtasksperchild=1) as workers:
        for row in workers.imap_unordered(report, [name for name in wanted if name != "classes"]):
            text = [line(row), *reasons(row)] if "design" in row else [f"{row['name']}: {row['refused']}"]
            print("\n    ".join(text), flush=True)
        for row in workers.imap_unordered(estimated, CLASSES if "classes" in wanted else ()):
            print(*classes([row])[2:], sep="\n", flush=True)
    kept = [
        [RESULTS / f"{name}.pickle" for name in names] for names in (everyone, [f"class {kind}" for kind in CLASSES])
    ]
    if wanted == ["classes"]:
        kept[0] = []
    rows, by_class = ([pickle.loads(p.read_bytes()) for p in paths if p.is_file()] for paths in kept)
    PAGE.write_text(page(rows, by_class), encoding="utf-8")


if __name__ == "__main__":
    main()
