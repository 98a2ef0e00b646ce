"""What calibration states bring: `ins-cal` on held-out seeds without each group of states.

    python benchmarks/calibration.py [--seeds 101..106] [--jobs 2] [--markdown docs/calibration.md]

Flies `turns` and `circuit` as `turns_accuracy.py` does, CHR grade and GNSS alone, and runs every variant on the same
samples. A group of states is left out by a sigma of zero in the data sheet; nothing else is changed, so NEES says what
the filter then does not know. Figures are RMS over flights from 80 s on.
"""

import argparse
import dataclasses
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import turns_accuracy

import estimators

SCENARIOS, SUITE = ("turns", "circuit"), "chr"
GROUPS: dict[str, dict[str, Any]] = {
    "all": {},
    "without the gyro's matrix": {"gyro_scale_factor": 0.0, "gyro_misalignment": 0.0},
    "without the accelerometer's matrix": {"accel_scale_factor": 0.0, "accel_misalignment": 0.0},
    "without the magnetometer's matrix": {"mag_scale_factor": 0.0, "mag_misalignment": 0.0, "soft_iron": 0.0},
    "without hard iron": {"mag_bias": 0.0, "mag_wander": 0.0},
    "without the field's own error": {"field_error": (0.0, 0.0, 0.0)},
    "without the walk of biases": {"gyro_drift": 0.0, "accel_drift": 0.0, "accel_instability": 0.0},
}
GROUPS["without any of the matrices"] = {
    key: value for name, group in GROUPS.items() if "matrix" in name for key, value in group.items()
}


def flight(name: str, seed: int) -> dict[str, dict[str, Any]]:
    """Figures of a flight by group of states that is left out."""
    truth, suites = turns_accuracy.sensed(turns_accuracy.windy(name, seed, None), (SUITE,))
    sent, found = suites[SUITE], {}
    for group, changed in GROUPS.items():
        sheet = dataclasses.replace(sent.sheet, **changed)
        made = estimators.create("ins-cal", site=sent.place, sensors=sheet, heading_aid=False).process(sent.samples)
        found[group] = turns_accuracy.figures_of(made, truth, sent, turns_accuracy.START, math.inf, True)
    return found


def lines(flown: dict[int, list[dict[str, Any]]]) -> list[str]:
    """Make the table, markdown."""
    made = ["| | tilt / heading | NEES |", "|---|---|---|"]
    for group in GROUPS:
        tilt, heading, _, nees, _ = turns_accuracy.summary(flown, group) or (math.nan,) * 5
        made.append(f"| {group} | {tilt:.2f} / {heading:.2f} | {nees:.1f} |")
    return made


HEAD = """# What calibration states bring

Made by `python benchmarks/calibration.py --seeds {seeds} --markdown docs/calibration.md`; do not edit.

`ins-cal` on the CHR grade with GNSS alone, `turns` and `circuit`, whole flights, wind 5 m/s, seeds {seeds}. RMS over
flights from 80 s on, tilt / heading in degrees; NEES is a mean per degree of freedom, 1 for a consistent filter. What
it reaches beside other estimators, smoothed and with two antennas, is in [accuracy.md](accuracy.md).

"""


def main() -> int:
    """Fly, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="101..106", help="FIRST..LAST")
    parser.add_argument("--jobs", type=int, default=2, help="flights at the same time")
    parser.add_argument("--markdown", type=Path, help="write the page there")
    arguments = parser.parse_args()
    first, _, last = arguments.seeds.partition("..")
    seeds = range(int(first), int(last or first) + 1)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        waiting = {seed: [pool.submit(flight, name, seed) for name in SCENARIOS] for seed in seeds}
        flown = {seed: [done.result() for done in flights] for seed, flights in waiting.items()}
    page = HEAD.format(seeds=arguments.seeds) + "\n".join(lines(flown)) + "\n"
    print(page)
    if arguments.markdown:
        arguments.markdown.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
