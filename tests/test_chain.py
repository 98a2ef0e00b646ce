"""The loop from records to estimates: events of estimators."""

import numpy as np

from ahrs_sim.chain import Chain
from estimators.types import Estimates, Samples, blank


class Scripted:
    """Reports what it is given in column 2 of `adaptation`."""

    def __init__(self, flags):
        self.notes = {2: ("gone", "back")}
        self.flags = list(flags)

    def process(self, samples):
        columns = blank(Estimates, len(samples))
        columns["t"][:] = samples.t
        columns["adaptation"][:, 2] = self.flags.pop(0)
        return Estimates(**columns)


def test_what_an_estimator_notes_is_an_event_when_it_changes():
    chain = Chain(None, {"one": Scripted([0.0, np.nan, 1.0, 1.0, 0.0])})
    events = []
    for t in range(5):
        samples = Samples.make(np.array([float(t)]), np.zeros((1, 3)), np.zeros((1, 3)))
        list(chain.estimate(samples))
        events += chain.take_events()
    assert [(e.t, e.level, e.name, e.text) for e in events] == [
        (2.0, "warning", "one", "gone"),
        (4.0, "info", "one", "back"),
    ]
