"""Test bench for aircraft attitude and heading reference systems.

    log = ahrs_sim.fly("circuit", duration=120.0)           # a log as pandas frames
    log.accuracy()                                          # the table that `ahrs-sim fly` prints
    more = ahrs_sim.replay(log.path, estimators=["ins21@chr"])
    ahrs_sim.compare(more.path, against="ekf-chr")

The functions do what the commands of the same name do, with the same results to the last digit.
"""

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import tempfile

    from ahrs_sim.review.frames import AccuracyTable, CampaignFrames, LogFrames

__all__ = ["fly", "replay", "compare", "read_log", "read_campaign"]

# What pandas, JSBSim and Numba load is loaded when a function is called: `import ahrs_sim` takes no time.


def fly(
    scenario: str | Path,
    output: str | Path | None = None,
    *,
    seed: int | None = None,
    duration: float | None = None,
    estimators: Sequence[str] = (),
    pilot: str | None = None,
    force: bool = False,
    progress: Callable[[float, float | None], None] = lambda t, end: None,
) -> "LogFrames":
    """Fly a scenario into a log, as `ahrs-sim fly`.

    Args:
        scenario: path of a TOML file, or the name of a shipped scenario.
        output: the log; None: a temporary one that goes with the object returned.
        seed, duration, pilot: instead of the file's (duration in s).
        estimators: only these of the scenario, or `METHOD@SUITE`; none: all of the scenario.
        force: replace an existing log.
        progress: called with the time reached and the expected end (None: unknown), s.

    Raises:
        InputError: something in the scenario is wrong, or the output cannot be written.
        FlightError: the flight did not reach its end; the log, if it has a name, is complete up to there.
    """
    from ahrs_sim import pipeline
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.review.frames import LogFrames

    loaded = scenarios.load(str(scenario), seed=seed, duration=duration, estimators=estimators, pilot=pilot)
    path, folder = _place(output, f"{loaded.name}-seed{loaded.seed}.mcap")
    pipeline.fly(loaded, path, force=force, progress=progress)
    return LogFrames(path, loaded.notes, folder)


def replay(
    recording: str | Path,
    output: str | Path | None = None,
    *,
    estimators: Sequence[str] = (),
    map_file: str | Path | None = None,
    calibrate: Sequence[str] = ("auto",),
    sync: bool = False,
    reference: str | None = None,
    date: datetime.datetime | None = None,
    skip: float | None = None,
    until: float | None = None,
    smooth: bool = False,
    allow_code: Sequence[str] = (),
    force: bool = False,
    progress: Callable[[float, float | None], None] = lambda t, end: None,
) -> "LogFrames":
    """Run estimators on a log or on a recording of a real vehicle, as `ahrs-sim replay`.

    Args:
        recording: a log of `fly`, or any recording that docs/replay.md names.
        output: the new log; None: a temporary one that goes with the object returned.
        estimators: only these of the log's scenario or the map, `METHOD@SUITE`, or `METHOD` for a recording.
        map_file: what topics and axes of a recording mean.
        calibrate: "mag", "gyro", "none"; "auto": the magnetometer, where the rest of the data agrees.
        sync: shift a recording's reference to the time of its gyro.
        reference: topic of a recording's reference attitude.
        date: of a recording whose times are no dates.
        skip, until: estimators see only what was measured in this span, s from the beginning.
        smooth: also what can be smoothed over the whole recording, as `NAME_smoothed`.
        allow_code: code from outside that the recording or the map may run.
        force: replace an existing log.
        progress: called with the time reached and the end, s.

    Raises:
        InputError: the recording cannot be read, or something asked for is not in it.
        FlightError: an estimator from outside failed; the log, if it has a name, is complete.
    """
    from ahrs_sim import playback
    from ahrs_sim.review.frames import LogFrames
    from ahrs_sim.scenario import Gate

    path, folder = _place(output, f"{Path(recording).stem}.mcap")
    notes = playback.replay(
        Path(recording),
        path,
        estimators=estimators,
        map_file=Path(map_file) if map_file is not None else None,
        calibrate=calibrate,
        sync=sync,
        reference=reference,
        date=date,
        skip=skip,
        until=until,
        smooth=smooth,
        gate=Gate(tuple(allow_code)),
        force=force,
        progress=progress,
    )
    return LogFrames(path, notes, folder)


def compare(
    log: str | Path,
    *,
    reference: str | None = None,
    start: float | None = None,
    end: float | None = None,
    align: str | None = None,
    sync: bool = False,
    against: str | None = None,
) -> "AccuracyTable":
    """Compute the accuracy of every estimator in a log, as `ahrs-sim compare`.

    Args:
        log: path of the log.
        reference: an estimator or any topic with orientations; None: the truth, else the reference of a recording.
        start, end: only samples in this span, s of flight.
        align: "heading" or "frames": remove a constant rotation of each estimator before comparing.
        sync: remove a constant delay of each estimator before comparing.
        against: an estimator: also paired differences of all others from it.

    Raises:
        InputError: no log, no truth or estimator in it, or an unknown name.
    """
    from ahrs_sim.review.compare import compare as figures
    from ahrs_sim.review.frames import AccuracyTable

    options: dict[str, Any] = {"reference": reference, "start": start, "end": end, "align": align}
    return AccuracyTable(figures(Path(log), **options, sync=sync, against=against))


def read_log(path: str | Path) -> "LogFrames":
    """Open a log as pandas frames: `read_log(path)["/chr/imu/mag"]`, `.truth()`, `.errors("ekf-chr")`.

    Args:
        path: a log of ours, or any ROS 2 bag in MCAP.

    Raises:
        InputError: not a log.
    """
    from ahrs_sim.review.frames import LogFrames

    return LogFrames(path)


def read_campaign(place: str | Path) -> "CampaignFrames":
    """Open what `ahrs-sim campaign` has flown as pandas frames: `.runs`, `.bands("tilt")`, `.paired("ekf-chr")`.

    Args:
        place: its folder, or fsspec address.

    Raises:
        InputError: no campaign there, or pyarrow is missing.
    """
    from ahrs_sim.review.frames import CampaignFrames

    return CampaignFrames(place)


def _place(output: str | Path | None, name: str) -> "tuple[Path, tempfile.TemporaryDirectory[str] | None]":
    """Choose the file of a log: the one asked for, or `name` in a folder that goes when nobody has it any more."""
    if output is not None:
        return Path(output), None
    import tempfile

    folder = tempfile.TemporaryDirectory(prefix="ahrs_sim-", ignore_cleanup_errors=True)
    return Path(folder.name) / name, folder
