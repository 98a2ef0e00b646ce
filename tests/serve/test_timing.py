"""Answers matched with samples: what counts, and how late it was."""

import numpy as np

from ahrs_sim import attitude
from ahrs_sim.evaluation.consistency import euler_sigma
from ahrs_sim.serve.book import Book
from ahrs_sim.serve.protocols import Answer
from ahrs_sim.serve.readings import SWITCHED_ON_NS
from ahrs_sim.serve.timing import Timing, histogram
from estimators import Status

MS = 1_000_000
Q = attitude.from_euler(np.radians([[20.0, -10.0, 135.0]]))[0]


def book(samples: int = 10) -> tuple[Book, Timing]:
    timing = Timing()
    made = Book(MS, timing)
    for k in range(samples):  # every 10 ms, on the real clock as well, 1 ms late
        made.sent(10 * MS * k - SWITCHED_ON_NS, 0.01 * k + 0.001, 0.01 * k)
    return made, timing


def test_an_answer_is_an_estimate_of_its_sample() -> None:
    made, timing = book()
    sigma = np.radians([1.0, 2.0, 3.0])
    for k in (4, 6, 7):
        made.received(
            Answer(10 * MS * k - SWITCHED_ON_NS + MS // 2, 1.001 * Q, sigma), 0.01 * k + 0.003, 0.01 * k + 0.004
        )
    rows = made.take()
    np.testing.assert_allclose(rows.t, [0.0, 0.01, 0.02, 0.03, 0.04, 0.06, 0.07], atol=1e-12)
    assert list(rows.status) == [Status.ALIGNING] * 4 + [Status.RUNNING] * 3
    np.testing.assert_allclose(rows.arrival[4:], [0.044, 0.064, 0.074], atol=1e-12)
    np.testing.assert_allclose(rows.q_nb[4:], [Q] * 3, atol=1e-12)
    np.testing.assert_allclose(euler_sigma(rows.q_nb, rows.att_cov)[4:], [sigma] * 3, rtol=1e-9)
    np.testing.assert_allclose(timing.latency, 0.002)
    np.testing.assert_allclose(timing.spacing, 0.0, atol=1e-12)
    np.testing.assert_allclose(timing.lateness, 0.001)
    assert timing.result()["answers"] == 3 and len(made.take()) == 0


def test_answers_that_do_not_count_are_counted() -> None:
    made, timing = book(300)
    newest = 2990 * MS - SWITCHED_ON_NS
    made.received(Answer(newest - 2500 * MS, Q), 3.0, 3.0)  # late
    made.received(Answer(newest - 100 * MS, 2.0 * Q), 3.0, 3.0)  # no rotation
    made.received(Answer(newest - 100 * MS, np.full(4, np.nan)), 3.0, 3.0)  # none yet
    made.received(Answer(newest - 100 * MS, Q), 3.0, 3.0)
    made.received(Answer(newest - 110 * MS, Q), 3.0, 3.0)  # older than the one before
    made.received(Answer(7, Q), 3.0, 3.0)  # of another clock: as of the newest sample
    rows = made.take()
    np.testing.assert_allclose(rows.t[-2:], [2.89, 2.99], atol=1e-12)
    result = timing.result()
    assert [result[k] for k in ("late", "damaged", "repeated", "foreign", "answers")] == [1, 1, 1, 1, 2]
    text = "\n".join(timing.lines())
    assert "300 samples sent, 2 answers" in text and text.count("1 answers") == 4


def test_nothing_came() -> None:
    made, timing = book(300)
    rows = made.take()
    assert len(rows) == 99 and np.isnan(rows.q_nb).all()  # no answer to these counts any more
    assert timing.lines()[0] == "300 samples sent, 0 answers" and "latency_s" not in timing.result()


def test_histogram() -> None:
    lines = histogram([0.0003, 0.0015, 0.0016, 0.0045])
    assert [int(line.split()[3]) for line in lines] == [1, 0, 2, 0, 1]
    assert lines[2].count("#") == 2 * lines[0].count("#") and lines[2].split()[:3] == ["1", "to", "2"]
    assert histogram([0.0])[0].split()[3] == "1"
