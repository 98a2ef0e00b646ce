"""Estimates meet their reference however both are cut into blocks."""

import numpy as np
import pytest

from ahrs_sim import attitude
from ahrs_sim.evaluation import metrics, phases
from ahrs_sim.evaluation.accuracy import Accuracy
from ahrs_sim.evaluation.decimate import Decimator, RowDecimator, take
from ahrs_sim.evaluation.evaluator import Comparison, Evaluator
from ahrs_sim.evaluation.metrics import Measure
from estimators.types import Estimates, blank

RATE = 0.3  # rad/s of heading


def attitudes(t: np.ndarray, offset: float = 0.0) -> np.ndarray:
    """Turning about down."""
    half = 0.5 * (RATE * t + offset)
    return np.column_stack([np.cos(half), np.zeros((len(t), 2)), np.sin(half)])


def estimates(t: np.ndarray, offset: float) -> Estimates:
    q_nb = attitudes(t, offset)
    return Estimates(**{**blank(Estimates, len(t)), "t": t, "q_nb": q_nb, "down_b": attitude.down(q_nb)})


class Sink:
    """Keeps what it is given."""

    def __init__(self) -> None:
        self.t: dict[str, list[float]] = {}
        self.heading: dict[str, list[float]] = {}

    def __call__(self, name: str, pair: Comparison) -> None:
        self.t.setdefault(name, []).extend(pair.estimates.t)
        self.heading.setdefault(name, []).extend(pair.errors()[:, Measure.HEADING])


@pytest.mark.parametrize(("reference_rows", "estimate_rows"), [(1, 1), (7, 3), (3, 50), (1000, 1000)])
def test_blocks_do_not_matter(reference_rows: int, estimate_rows: int) -> None:
    """Estimates come before, with or after their reference: each is compared once, in order, with its own instant."""
    t_ref, t = np.arange(0.0, 4.0, 0.01), np.arange(0.005, 3.9, 0.02)
    sink = Sink()
    evaluator = Evaluator(sink)
    q_ref, a, b = attitudes(t_ref), estimates(t, 0.1), estimates(t, -0.2)
    done = {"a": 0, "b": 0}
    for k in range(0, len(t_ref), reference_rows):
        evaluator.add_reference(t_ref[k : k + reference_rows], q_ref[k : k + reference_rows])
        for name, block, ahead in (("a", a, 0.5), ("b", b, -0.3)):
            while done[name] < len(t) and t[done[name]] < evaluator.reached + ahead:
                evaluator.add(name, block[done[name] : done[name] + estimate_rows])
                done[name] += estimate_rows
    for name, error in (("a", 0.1), ("b", -0.2)):
        assert sink.t[name] == t[: len(sink.t[name])].tolist()
        assert len(sink.t[name]) > 0.9 * len(t)
        assert sink.heading[name] == pytest.approx([error] * len(sink.t[name]), abs=1e-6)
    assert len(sink.t["a"]) == len(t)


def test_rows_that_wait_too_long_are_dropped() -> None:
    sink, t = Sink(), np.arange(0.0, 3.0, 0.1)
    evaluator = Evaluator(sink, hold_s=0.45)
    evaluator.add("a", estimates(t, 0.0))
    evaluator.add_reference(np.arange(0.0, 4.0, 0.1), attitudes(np.arange(0.0, 4.0, 0.1)))
    assert sink.t["a"] == pytest.approx([2.5, 2.6, 2.7, 2.8, 2.9])


def test_a_complete_reference_needs_no_waiting() -> None:
    sink, t = Sink(), np.arange(0.0, 3.0, 0.1)
    history = metrics.History(t[5:20], attitudes(t[5:20]))
    Evaluator(sink, against={"a": history}).add("a", estimates(t, 0.1))
    known = np.isfinite(sink.heading["a"])
    assert len(known) == len(t)
    assert np.flatnonzero(known).tolist() == list(range(5, 20))


@pytest.mark.parametrize("cut", [1, 3, 1000])
def test_decimators_take_the_same_rows_however_a_stream_is_cut(cut: int) -> None:
    t = np.arange(0.0, 10.0, 0.0025)
    by_time, by_row = Decimator(10.0), RowDecimator(40.2)
    times: list[float] = []
    rows: list[int] = []
    for k in range(0, len(t), cut):
        block = t[k : k + cut]
        times += block[by_time.rows(block)].tolist()
        rows += (k + by_row.rows(len(block))).tolist()
    assert times == pytest.approx(np.arange(100) / 10)
    assert rows == list(range(0, len(t), 40))


def test_take_keeps_the_type_of_a_block() -> None:
    block = estimates(np.arange(5.0), 0.0)
    assert take(block, block.t > 2.5).t.tolist() == [3.0, 4.0]
    assert isinstance(take(block, np.array([0])), Estimates)


def test_phases_are_not_known_without_the_truth() -> None:
    assert phases.at(np.empty(0), np.empty(0, int), np.array([1.0, 2.0])).tolist() == [-1, -1]


def test_a_part_of_a_flight_has_its_figures_and_worst_moment() -> None:
    """The heading runs away by 0.02 rad/s from 4 s on; what lies outside of the part does not count."""
    t = np.arange(0.0, 12.0, 0.01)
    wrong = estimates(t, 0.0)
    off = np.where(t > 4.0, 0.02 * (t - 4.0), 0.0)
    wrong.q_nb[:] = np.column_stack(
        [np.cos(0.5 * (RATE * t + off)), np.zeros((len(t), 2)), np.sin(0.5 * (RATE * t + off))]
    )
    wrong.down_b[:] = attitude.down(wrong.q_nb)
    accuracy = Accuracy(["a"])
    accuracy.add_truth(t, attitudes(t), np.zeros((len(t), 3)), np.zeros(len(t), bool))
    accuracy.add_steps(t[::2], (t[::2] // 5.0).astype(np.int32))
    accuracy.add_estimates("a", wrong)
    assert accuracy.begins == {1: 0.0, 2: 5.0, 3: 10.0}
    part = accuracy.part(5.0, 10.0)["a"]
    assert part["heading_worst_s"] == pytest.approx(10.0)
    assert part["heading_max_deg"] == pytest.approx(np.degrees(0.12), abs=1e-3)
    assert part["availability"] == 1.0
    nothing = accuracy.part(np.inf, np.inf)["a"]
    assert nothing["availability"] == 0.0
    assert "heading_worst_s" not in nothing
