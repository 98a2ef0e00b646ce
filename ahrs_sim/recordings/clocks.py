"""The clocks behind the stamps of a recording: which steps they make, and what is to be taken off so that none is left.

A message has two times, that of its header and that of the log. Latency makes the log's the later one, by an amount
that comes and goes; a clock that is set makes the difference jump and stay. Which of the two was set is shown by which
of them jumps from one message to the next.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from ahrs_sim.errors import InputError
from ahrs_sim.log.mcap.reader import stamps
from ahrs_sim.recordings.choosing import Choice
from ahrs_sim.recordings.sources import Source

STEP_NS = 10**9
"""A difference of the clocks that jumps by more than this, and stays there, is a step."""

OTHER_CLOCK_NS = 10 * 10**9
"""Stamps further from the log's clock than this belong to another one."""

LONGEST_BACK_NS = 600 * 10**9
"""The longest step back of the recorder's clock that is bridged: messages are held back for so long."""

_SAME_NS = 3 * 10**8  # steps of two sensors that differ by less are one, of the board's clock
_NEAR_NS = 20 * 10**9  # and are no further apart than this
_RATE = 0.02  # share by which a simulation's clock runs faster or slower than the log's
_AROUND, _FAR = (
    50,
    50_000,
)  # messages before and after a step of which the interval is taken, and the difference at most
_LEAST = 10  # messages that show that a difference stays
_GREATEST_NS = 2**61  # no step is greater: a damaged stamp


@dataclass
class Clock:
    """Holds the offset to subtract from the times of a topic, ns."""

    at: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  # (m,) log times of steps
    header: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int64))  # (m + 1,) before, between and after
    log: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int64))  # (m + 1,) likewise, of the log's times
    offset: int = 0  # ns, of the header's clock besides, throughout
    unset: bool = False  # no header has a time: the log's times stand for them

    def times(self, header: np.ndarray, log: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Remove the steps from times (n,) ns by header and by log."""
        part = np.searchsorted(self.at, log, "right")
        steady = log - self.log[part]
        return (steady if self.unset else header - self.header[part] - self.offset), steady


@dataclass
class Clocks:
    """The clocks of a recording by kind of measurement, and what is to be said of them."""

    by_kind: dict[str, Clock] = field(default_factory=dict)
    by_log: bool = False  # the IMU's headers are of another clock: the log's times are used for all
    apart: bool = False  # headers are not compared with the log's times, whose clock is another one or was set back
    hold_ns: int = 0  # by how much the recorder's clock was set back: so much later messages may come
    notes: list[str] = field(default_factory=list)

    def duration(self, logged: float) -> float:
        """Compute the time (s) that a recording took whose log times span `logged` s, steps of that clock included."""
        stepped = int(self.of("imu").log[-1]) if "imu" in self.by_kind else 0
        return logged - stepped / 1e9 + self.hold_ns / 1e9

    def of(self, kind: str) -> Clock:
        """Return the clock of a kind."""
        return self.by_kind.setdefault(kind, Clock())


def examine(
    source: Source,
    chosen: Mapping[str, Choice],
    stated: str | None = None,
    shifted: Collection[str] = (),
    span: tuple[float, float] = (0.0, math.inf),
) -> Clocks:
    """Read the stamps of all chosen topics once and find the steps in them.

    Args:
        source: the recording.
        chosen: topics by kind.
        stated: "header" or "log" where the map says whose times are to be used.
        shifted: kinds whose stamps the map shifts: their offsets are known.
        span: s from the beginning, of what will be used.

    Raises:
        InputError: the clocks go back in a way that cannot be bridged.
    """
    clocks = Clocks(by_log=stated == "log")
    if source.one_clock:
        return clocks
    times = _read(source, chosen)
    coarse = [k for k, (header, log) in times.items() if stated is None and coarse_stamps(header, log)]
    for kind, (header, log) in times.items():
        unset = not len(header) or kind in coarse
        clocks.by_kind[kind] = Clock(unset=True) if unset else _steps(kind, header, log, clocks)
    _share(clocks)
    _describe(clocks, source.epoch_ns)
    for kind in sorted(times, key=lambda k: k != "imu"):
        if len(times[kind][0]) and kind not in coarse and stated is None:
            _offset(kind, *times[kind], clocks, kind in shifted)
    if "imu" in times and not len(times["imu"][0]) and stated is None:
        clocks.by_log = True
    if coarse:
        text = f"check: header stamps of {', '.join(coarse)} repeat or stand still"
        clocks.notes.append(f"{text}: times of the log are used ([time] stamps)")
    if clocks.by_log and clocks.hold_ns:
        raise InputError(f"{source.path}: the recorder's clock was set back, and headers are of another clock")
    if clocks.by_log and stated is None:
        clocks.notes.append("header stamps are of another clock: times of the log are used ([time] stamps)")
    if "imu" in times and len(times["imu"][0]) and "imu" not in coarse:
        t = clocks.of("imu").times(*times["imu"])[clocks.by_log] - source.epoch_ns
        _twice(t[(t >= 1e9 * span[0]) & (t <= 1e9 * span[1])], str(source.path))
    return clocks


def _read(source: Source, chosen: Mapping[str, Choice]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Header and log times (n,) ns of messages that have both, by kind, in the order of the log."""
    found: dict[str, list[np.ndarray]] = {kind: [] for kind in chosen}
    for block in source.blocks([c.topic.name for c in chosen.values()]):
        for kind, choice in chosen.items():
            array = block[choice.topic.name]
            pair = np.stack([stamps(array), array["log_time"].astype(np.int64)])
            found[kind].append(pair[:, pair[0] != 0])
    joined = {kind: np.concatenate([*pairs, np.empty((2, 0), np.int64)], axis=1) for kind, pairs in found.items()}
    return {kind: (pair[0], pair[1]) for kind, pair in joined.items()}


def coarse_stamps(header: np.ndarray, log: np.ndarray) -> bool:
    """Test for stamps (n,) ns that repeat, as whole seconds do, or hardly advance, while messages come evenly."""
    if len(header) < _LEAST:
        return False
    own, there = (np.diff(np.sort(x)).astype(float) for x in (header, log))
    usual, own_usual = (float(np.median(x)) for x in (there, own))
    even = float(np.quantile(there, 0.2)) > 0.3 * usual > 0.0  # gaps apart
    still = own_usual < 0.1 * usual and own.sum() > 0.5 * there.sum()  # else it is a simulation that runs slowly
    return bool(even and (np.mean(own == 0.0) > 0.4 or still))


def _jumps(difference: np.ndarray) -> np.ndarray:
    size = np.abs(np.diff(difference))
    found: np.ndarray = np.flatnonzero((size > STEP_NS) & (size < _GREATEST_NS))
    return found


def _steps(kind: str, header: np.ndarray, log: np.ndarray, clocks: Clocks) -> Clock:
    """Find the clock of one kind: where one of its times jumps against the other and stays."""
    difference = header - log
    jumps = _jumps(difference)
    if len(jumps) > 4:  # times before and after a step back may lie over each other
        order = np.argsort(header, kind="stable")
        again = _jumps(difference[order])
        if len(again) == 1:
            back = int(np.abs(np.diff(difference[order])[again[0]]))
            if back < LONGEST_BACK_NS:
                clocks.hold_ns, clocks.apart = max(clocks.hold_ns, back), True
                return Clock()
    at, of_header, of_log = [], [0], [0]
    for k in jumps.tolist():
        size, in_header = _step(header, log, difference, k)
        if size:
            at.append(int(log[k + 1]))
            of_header.append(of_header[-1] + (size if in_header else 0))
            of_log.append(of_log[-1] - (0 if in_header else size))
    if len(at) > 4 and kind == "imu" and not clocks.by_log:
        raise InputError(
            f"stamps of the IMU jump {len(at)} times against the log's times, first by "
            f'{(of_header[1] - of_log[1]) / 1e9:+.1f} s; [time] stamps = "log" in a map takes the log\'s'
        )
    if len(at) > 4:
        return Clock()  # messages whose stamps cannot be are left out one by one
    made = Clock(np.array(at, np.int64), np.array(of_header, np.int64), np.array(of_log, np.int64))
    part = np.searchsorted(made.at, log, "right")
    # the stretch whose clock is the log's is right; the first one where there is none
    levels = [abs(float(np.median((difference + made.log[part])[part == i]))) for i in range(len(at) + 1)]
    right = int(np.argmin(levels)) if min(levels) < OTHER_CLOCK_NS else 0
    made.header = made.header - made.header[right]
    return made


def _step(header: np.ndarray, log: np.ndarray, difference: np.ndarray, k: int) -> tuple[int, bool]:
    """Size (ns) of the step after message k, 0 when there is none, and whether it is of the header's clock."""
    usual = [float(np.median(np.diff(x[max(0, k - _AROUND) : k + 2 + _AROUND]))) for x in (header, log)]
    jump = abs(float(difference[k + 1] - difference[k]))
    reach = int(np.clip(3.0 * jump / max(usual[0], 1e6), 50, _FAR))  # what a link held back comes all at once after
    before, after = difference[max(0, k + 1 - reach) : k + 1], difference[k + 1 : k + 1 + reach]
    size = int(after.max()) - int(before.max())  # latency makes the difference smaller only
    if abs(size) <= STEP_NS or min(len(before), len(after)) < _LEAST:
        return 0, True
    by_header, by_log = (float(x[k + 1] - x[k]) - u for x, u in zip((header, log), usual, strict=True))
    if abs(by_header) < abs(by_log):
        return size, False
    return (round(by_header) if abs(by_header - size) < _SAME_NS else size), True


def _share(clocks: Clocks) -> None:
    """Give steps of several sensors that are one step of their board's clock the size that the IMU shows."""
    if "imu" not in clocks.by_kind:
        return
    imu = clocks.by_kind["imu"]
    sizes = np.diff(imu.header)
    for kind, clock in clocks.by_kind.items():
        if kind == "imu" or not len(clock.at):
            continue
        own = np.diff(clock.header)
        for i, (at, size) in enumerate(zip(clock.at, own, strict=True)):
            same = np.flatnonzero((np.abs(sizes - size) < _SAME_NS) & (np.abs(imu.at - at) < _NEAR_NS) & (size != 0))
            if len(same):
                own[i] = sizes[same[0]]
        right = int(np.flatnonzero(clock.header == 0)[0])
        levels = np.r_[0, np.cumsum(own)]
        clock.header = levels - levels[right]


def _describe(clocks: Clocks, epoch_ns: int) -> None:
    """Say which clocks step, when and by how much."""
    if clocks.hold_ns:
        clocks.notes.append(
            f"check: the recorder's clock was set back by {clocks.hold_ns / 1e9:.1f} s: "
            "messages are put in the order of their headers"
        )
    found: dict[tuple[str, int], list[tuple[str, float]]] = {}
    for kind, clock in clocks.by_kind.items():
        steady = clock.at - clock.log[1:]
        for at, of_header, of_log in zip(steady, np.diff(clock.header), np.diff(clock.log), strict=True):
            whose = "header stamps" if of_header else "log's times"
            key = next((k for k in found if k[0] == whose and abs(k[1] - of_header - of_log) < _SAME_NS), None)
            found.setdefault(key or (whose, int(of_header + of_log)), []).append((kind, (at - epoch_ns) / 1e9))
    for (whose, size), where in found.items():
        kinds = ", ".join(dict.fromkeys(kind for kind, _ in where))
        clocks.notes.append(
            f"check: {whose} of {kinds} step by {size / 1e9:+.3f} s at {min(t for _, t in where):.1f} s: taken back"
        )


def _offset(kind: str, header: np.ndarray, log: np.ndarray, clocks: Clocks, shifted: bool) -> None:
    """Find out how far the clock of a kind is from the log's; the IMU's comes first."""
    clock = clocks.of(kind)
    by_header, steady = clock.times(header, log)
    off = float(np.median(by_header - steady))
    if kind == "imu" and abs(off) > OTHER_CLOCK_NS and not shifted:
        span = float(steady[-1] - steady[0])
        if span > 5e9 and abs(float(by_header[-1] - by_header[0]) / span - 1.0) > _RATE:
            clocks.apart = True
            clock.offset = int(by_header[0] - steady[0])
            share = float(by_header[-1] - by_header[0]) / span
            clocks.notes.append(f"header stamps run at {share:.2f} of the log's clock, a simulation's: they are used")
        else:
            clocks.by_log = True
    elif clocks.apart and not clocks.hold_ns:
        clock.offset = clocks.of("imu").offset
    elif not (clocks.by_log or shifted or clocks.hold_ns) and (abs(off) > OTHER_CLOCK_NS or off > STEP_NS):
        clock.offset = round(off / 1e9) * 10**9
        clocks.notes.append(
            f"check: {kind}: its stamps are {clock.offset * 1e-9:+.0f} s off the log's clock "
            "(GPS time for UTC: 18 s): taken back"
        )


def _twice(t: np.ndarray, where: str) -> None:
    """Refuse times (n,) ns of which two stretches lie over each other: both clocks were set back.

    There the rate is twice what it is before and after, and the messages of the two do not alternate evenly.
    """
    seconds = t[(t >= 0) & (t < 10**15)] // 10**9
    if len(seconds) < 100:
        return
    count = np.bincount(seconds)
    usual = float(np.quantile(count[count > 0], 0.25))
    double = np.flatnonzero(np.abs(count / usual - 2.0) < 0.15)
    if len(double) < 3 or len(double) != double[-1] - double[0] + 1:
        return
    around = np.r_[count[: double[0]][-4:-1], count[double[-1] + 2 :][:3]]
    inside = np.diff(np.sort(t[(seconds > double[0]) & (seconds < double[-1])]).astype(float))
    uneven = float(np.median(np.abs(inside / max(float(np.median(inside)), 1.0) - 1.0))) > 0.1
    if len(around) >= 4 and (np.abs(around / usual - 1.0) < 0.15).all() and uneven:
        first, last = double[0] - 1, double[-1] + 2
        raise InputError(
            f"{where}: the clock goes back by {len(double)} s: from {first} to {last} s there are messages of two "
            f"times; --until {first} or --skip {last} leaves them out"
        )
