"""Fly the circuit with the filters of the paper and the practical ones; renew the README's table and picture.

python docs/circuit.py
"""

import re
import tempfile
import textwrap
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from ahrs_sim import attitude, pipeline, scenario
from ahrs_sim.evaluation import metrics, phases
from ahrs_sim.log.flight_reader import FlightReader
from ahrs_sim.review import compare, figures

HERE = Path(__file__).parent
TWO_ANTENNAS = {
    f"{name}-2ant": {"method": name.partition("-chr")[0].partition("-sbg")[0], "suite": name[-3:], "heading_aid": True}
    for name in ("air-ins-chr", "ins21-chr", "ins21-sbg")
}
ROWS = (  # what each row is, and what it uses besides gyro and accelerometer
    ("ins21-*", "inertial navigator with GNSS velocity and position, magnetometer"),
    ("air-ins-chr", "inertial navigator with airspeed and magnetometer, no GNSS"),
    ("ckf-air-chr", "cubature Kalman filter with airspeed and magnetometer, no GNSS"),
    ("ekf-*, ckf-*, cdkf-*", "the filters of a paper, with magnetometer, as it has them"),
    ("*-chr, *-sbg", "on the low-cost unit, on the better one"),
)
CONDITIONS = (
    "One flight of scenario `circuit` (seed 1): CHR-6dm and SBG IG-500 grades with every error of their data sheets, "
    "electric motor's vibration, wind 4 m/s with the gusts that MIL-F-8785C gives it at that height; from the first "
    "estimate on, standing included."
)
SHOWN = {"ckf-chr": "CKF of the paper", "ckf-air-chr": "CKF, airspeed aided", "ins21-chr": "ins21, GNSS aided"}


def main() -> None:
    """Renew both."""
    plain = scenario.load("circuit")
    data = plain.data | {"estimator": plain.data["estimator"] | TWO_ANTENNAS}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "circuit.mcap"
        pipeline.fly(scenario.parse(data, "circuit", "circuit"), log)
        table(compare.compare(log))
        picture(log)


def table(result: dict) -> None:
    """Put what `make fly` prints, and the rows with two antennas, between the README's two marks."""
    rows = result["estimators"]
    shown = result | {"estimators": {name: v for name, v in rows.items() if name not in TWO_ANTENNAS}}
    antennas = result | {"estimators": {name: rows[name] for name in TWO_ANTENNAS}}
    parts = ["```text", compare.table(shown), "```", "", "| | |", "|---|---|"]
    parts += [f"| `{name}` | {text} |" for name, text in ROWS]
    parts += [
        "",
        *textwrap.wrap(CONDITIONS, 120),
        "",
        "With the heading of two GNSS antennas besides (`heading_aid = true`):",
        "",
    ]
    parts += ["```text", *compare.table(antennas).splitlines()[1:], "```"]
    readme = HERE.parent / "README.md"
    text = re.sub(
        r"(<!-- circuit: begin -->\n).*?(<!-- circuit: end -->)",
        lambda m: m[1] + "\n".join(parts) + "\n" + m[2],
        readme.read_text(),
        flags=re.DOTALL,
    )
    readme.write_text(text)


def picture(log: Path) -> None:
    """Roll, tilt error and ground track."""
    with FlightReader(log) as reader:
        truth = reader.truth()
        estimates = {name: reader.estimates(name) for name in SHOWN}
    figure = plt.figure(figsize=(11, 5.2), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[2.2, 1])
    roll, tilt, track = (figure.add_subplot(g) for g in (grid[0, 0], grid[1, 0], grid[:, 1]))
    roll.plot(truth.t, np.degrees(attitude.euler(truth.q_nb)[:, 0]), color="black", lw=1.5, label="truth")
    for (name, title), color in zip(SHOWN.items(), ("tab:red", "tab:orange", "tab:blue"), strict=True):
        e = estimates[name]
        errors = metrics.attitude_errors(e.q_nb, e.down_b, attitude.interpolate(truth.t, truth.q_nb, e.t))
        roll.plot(e.t, np.degrees(attitude.euler(e.q_nb)[:, 0]), color=color, lw=0.8, label=title)
        tilt.semilogy(e.t, np.degrees(errors[:, 3]), color=color, lw=0.8)
    roll.set_ylabel("roll, deg")
    tilt.set_ylabel("tilt error, deg")
    tilt.set_ylim(0.02, 90)
    tilt.set_xlabel("time, s")
    roll.sharex(tilt)
    phase = phases.classify(truth.t, truth.q_nb, truth.vel_n, truth.on_ground)
    for axes in (roll, tilt):
        axes.margins(x=0)
        figures.shade(axes, truth.t, phase)
    handles, labels = (a + b for a, b in zip(roll.get_legend_handles_labels(), figures.shades(phase), strict=True))
    figure.legend(handles, labels, loc="outside upper left", fontsize=8, ncols=len(labels))
    north = (truth.lla[:, 0] - truth.lla[0, 0]) * 6.37e6
    east = (truth.lla[:, 1] - truth.lla[0, 1]) * 6.37e6 * np.cos(truth.lla[0, 0])
    dots = track.scatter(east, north, c=truth.height_agl, s=1, cmap="viridis")
    figure.colorbar(dots, ax=track, label="height, m", location="bottom", shrink=0.8)
    track.set_aspect("equal")
    track.set_title("ground track", fontsize=10)
    track.set_xlabel("east, m")
    track.set_ylabel("north, m")
    for axes in (roll, tilt, track):
        axes.grid(alpha=0.3)
    figure.savefig(HERE / "circuit.png", dpi=100)


if __name__ == "__main__":
    main()
