"""What estimators reach on real recordings, and what the calibration of the magnetometer does to that.

    python benchmarks/recordings.py FOLDER

FOLDER has `thor_flight75/thor_flight75.mcap` and `broad/broad_01_*.mcap`, `_21_`, `_28_` in it. Prints the table of
docs/replay.md, RMSE in degrees with `--sync`: everything as it comes, with NEES per degree of freedom; and beside its
total that without a calibration of the magnetometer, and with the whole fit taken out whatever it is worth. `ins-cal`
is smoothed as well.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from ahrs_sim import playback
from ahrs_sim.recordings.calibration import fit_mag, turns
from ahrs_sim.recordings.recording import open_bag

RUNS = (
    ("thor_flight75/thor_flight75.mcap", "ins21", (240.0, 575.0), None),
    ("thor_flight75/thor_flight75.mcap", "ins-cal", (240.0, 575.0), None),
    ("thor_flight75/thor_flight75.mcap", "air-ins", (240.0, 575.0), None),
    ("broad/broad_01_*.mcap", "hand-ins", (None, None), "heading"),
    ("broad/broad_21_*.mcap", "hand-ins", (None, None), "heading"),
    ("broad/broad_28_*.mcap", "hand-ins", (None, None), "heading"),
)


def figures(
    path: Path,
    method: str,
    span: tuple[float | None, float | None],
    align: str | None,
    calibrate: Sequence[str],
    map_file: Path | None = None,
) -> dict[str, dict[str, float]]:
    """Errors of one estimator on one recording, `ins-cal` smoothed as well: by name."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.mcap"
        playback.replay(
            path,
            out,
            estimators=[method],
            calibrate=calibrate,
            sync=True,
            only_estimates=True,
            map_file=map_file,
            smooth=method == "ins-cal",
        )
        result = playback.accuracy(out, start=span[0], end=span[1], align=align)
    assert result is not None
    return {name: values for name, values in result["estimators"].items() if name.startswith(method)}


def whole_fit(path: Path, map_file: Path) -> bool:
    """Write a map with hard and soft iron of the whole recording; False: there is too little turning."""
    with open_bag(path, map_file=None, calibrate=["none"]) as bag:
        axes = bag.mapping.mag_axes(bag.converter.chosen["mag"].body)
        field = sum(x * x for x in bag.site.mag_n) ** 0.5
        fit = fit_mag(bag.seen.mag, turns(bag.seen, axes), field if bag.has_place else None)
    if fit is None:
        return False
    hard, soft = ([float(x) for x in values.ravel()] for values in (fit.hard_iron, fit.soft_iron))
    map_file.write_text(f"[magnetometer]\nhard_iron = {hard}\nsoft_iron = {soft}\n")
    return True


def main() -> None:
    """Replay all and print the table."""
    print("| recording | estimator | roll | pitch | heading | total | NEES | not calibrated | whole fit |")
    print("|---" * 9 + "|")
    for pattern, method, span, align in RUNS:
        path = next(iter(sorted(Path(sys.argv[1]).glob(pattern))))
        found = figures(path, method, span, align, ["auto"])
        without = figures(path, method, span, align, ["none"])
        with tempfile.TemporaryDirectory() as folder:
            map_file = Path(folder) / "map.toml"
            fitted = whole_fit(path, map_file)
            forced = figures(path, method, span, align, ["none"], map_file) if fitted else without
        for name, values in found.items():
            angles = " | ".join(f"{values[f'{a}_rmse_deg']:.2f}" for a in ("roll", "pitch", "heading", "total"))
            others = " | ".join(f"{one[name]['total_rmse_deg']:.2f}" for one in (without, forced))
            nees = "" if values["nees"] is None else f"{values['nees']:.1f}"
            print(f"| {path.stem} | `{name}` | {angles} | {nees} | {others} |", flush=True)


if __name__ == "__main__":
    main()
