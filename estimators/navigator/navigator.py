"""The navigator as an object of the catalogue."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimators.alignment import Alignment
from estimators.estimator import Compiled
from estimators.native import joined, passed, supplied
from estimators.navigator import loop
from estimators.navigator.aids import Z_BASELINE, Z_FIELD, Z_PLACE, Z_VELOCITY
from estimators.navigator.layout import WORK, Carry, Parameters, Work, tape
from estimators.navigator.settings import SETTINGS
from estimators.records import Place, Sheet, pack_settings
from estimators.turned import NOTES
from estimators.types import Estimates, Samples, SensorInfo, Site


class Navigator(Compiled):
    """An estimator of the catalogue.

    Args:
        name: for messages.
        settings: checked settings.
        site: place and field.
        sensors: data sheet figures.
    """

    def __init__(self, name: str, settings: Mapping[str, Any], site: Site, sensors: SensorInfo) -> None:
        super().__init__(name, settings, site, sensors, (loop.process, loop.forget, loop.begin), "navigator")
        self._no_tape, self._carry = tape(), Carry.zeros()
        self._work = Work.make(self._no_tape[0])

    @property
    def measurements(self) -> dict[str, slice]:
        """The columns of its innovations by the names of what is measured, as those of the other navigators."""
        places = {"gnss.vel_n": (Z_VELOCITY, 3), "gnss.place_n": (Z_PLACE, 3), "field.mag_b": (Z_FIELD, 3)}
        places["baseline.heading"] = Z_BASELINE, 1
        return {name: slice(first, first + rows) for name, (first, rows) in places.items()}

    @property
    def notes(self) -> Mapping[int, tuple[str, str]]:
        """Return what is worth an event: by column of `adaptation`, the texts for becoming 1 and 0 again."""
        return NOTES

    def process(self, samples: Samples, noted: Any = None) -> Estimates:
        """As `Compiled.process`; `noted`, a tape of `layout.tape`, takes notes for a smoother."""
        self._work.tape = passed(noted or self._no_tape[0])[0]
        try:
            return super().process(samples)
        finally:
            self._work.tape = passed(self._no_tape[0])[0]

    def assemble(self) -> tuple[dict[str, Any], Any]:
        """Make all parts by name, and the record of the addresses of those that the loop takes."""
        parts = {
            "parameters": Parameters.zeros(), "carry": self._carry, "work": self._work, "stretch": self._stretch,
            "alignment": Alignment.zeros(), "settings": pack_settings(SETTINGS, self.settings),
            "site": Place.from_site(self.site), "sensors": Sheet.from_info(self.sensors),
        }  # fmt: skip
        numbers = {"align_s": self.settings["align_s"], "wait_s": self.settings["wait_s"], "begun": 0}
        numbers["begin"] = supplied(loop.begin, None, None, "navigator")
        return {**parts, "tape": self._no_tape[0]}, joined(loop.Instance, parts, numbers)

    def work_size(self) -> int:
        """Bytes of the part `work` that are needed."""
        return WORK.itemsize

    def row_length(self) -> int:
        """The least length of rows (`native.CAPACITY`): it has none."""
        return 8

    def last_t(self) -> float:
        """Time (s) of the last row after the alignment."""
        return float(self._carry.memory.last_t)

    def kept(self) -> dict[str, np.ndarray]:
        """The arrays and records of `layout.Carry`."""
        return {name: self._carry.data[name] for name in Carry.dtype.names or ()}
