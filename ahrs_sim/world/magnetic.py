"""The Earth's magnetic field: World Magnetic Model at the flight's place and date.

The model is evaluated at the corners of a fixed lattice and interpolated in between, so a value depends on its place
alone and not on the rest of the block. The lattice is fine enough for 0.1 nT.
"""

import datetime
import math
import warnings
from functools import lru_cache

import numpy as np

from ahrs_sim.errors import InputError

_CELL = np.array([math.radians(0.05), math.radians(0.05), 1000.0])  # rad, rad, m
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
FIRST, LAST = 2025.0, 2030.0
"""Validity of WMM2025, decimal years."""


class MagneticField:
    """The field at one date.

    Raises:
        InputError: the date is outside the model's validity.
    """

    def __init__(self, epoch: datetime.datetime) -> None:
        self.year = decimal_year(epoch)
        if not FIRST <= self.year <= LAST:
            raise InputError(f"epoch: {epoch:%Y-%m-%d} is outside WMM2025; choose a date from 2025 to 2029")
        self._cells: dict[tuple[int, ...], np.ndarray] = {}  # field at the corners

    def at(self, lla: np.ndarray) -> np.ndarray:
        """Field (n, 3) T in NED at `lla` (n, 3) (rad, rad, m above the ellipsoid)."""
        scaled: np.ndarray = lla / _CELL
        cells: np.ndarray = np.floor(scaled)
        if len(cells) == 0:
            return np.empty((0, 3))
        first = cells[0]
        if (cells == first).all():  # the rule: a block of a few seconds stays in one cell
            return self._interpolate(scaled - first, self._corners(first))
        field = np.empty_like(scaled)
        for cell in np.unique(cells, axis=0):
            rows = (cells == cell).all(axis=1)
            field[rows] = self._interpolate(scaled[rows] - cell, self._corners(cell))
        return field

    def _corners(self, cell: np.ndarray) -> np.ndarray:
        """Field (8, 3) T at the corners of a cell, (3,) whole numbers."""
        key = tuple(cell.astype(int).tolist())
        if key not in self._cells:
            lla = (np.array(key) + _CORNERS) * _CELL
            lla[:, 0] = np.clip(lla[:, 0], -0.5 * math.pi, 0.5 * math.pi)
            lla[:, 1] = (lla[:, 1] + math.pi) % (2.0 * math.pi) - math.pi
            self._cells[key] = wmm(lla, self.year)
        return self._cells[key]

    @staticmethod
    def _interpolate(fraction: np.ndarray, corners: np.ndarray) -> np.ndarray:
        """Trilinear: `fraction` (n, 3) in [0, 1) between `corners` (8, 3)."""
        x, y, z = (fraction[:, i : i + 1] for i in range(3))
        low = corners[0] + z * (corners[1] - corners[0])
        low = low + y * (corners[2] + z * (corners[3] - corners[2]) - low)
        high = corners[4] + z * (corners[5] - corners[4])
        high = high + y * (corners[6] + z * (corners[7] - corners[6]) - high)
        field: np.ndarray = low + x * (high - low)
        return field


def field_n(lla: np.ndarray, epoch: datetime.datetime) -> np.ndarray:
    """Field (n, 3) T in NED at `lla` (n, 3) on the day of `epoch`.

    Raises:
        InputError: the date is outside the model's validity.
    """
    return _field(epoch).at(lla)


_field = lru_cache(maxsize=8)(MagneticField)


def wmm(lla: np.ndarray, year: float) -> np.ndarray:
    """World Magnetic Model 2025, exact: (n, 3) T in NED at `lla` (n, 3) for a decimal `year`."""
    from wmm import wmm_calc  # lazily: a flight on recorded data needs none

    model = wmm_calc()
    model.setup_env(np.degrees(lla[:, 0]), np.degrees(lla[:, 1]), lla[:, 2] / 1000.0, unit="km", msl=False)
    model.setup_time(dyear=np.full(len(lla), year))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns near the magnetic poles, where a compass is weak but the field right
        return np.stack([model.get_Bx(), model.get_By(), model.get_Bz()], axis=-1) * 1e-9


def decimal_year(date: datetime.datetime) -> float:
    """2026-07-02 12:00 -> 2026.5."""
    date = date.astimezone(datetime.UTC) if date.tzinfo else date.replace(tzinfo=datetime.UTC)
    first = datetime.datetime(date.year, 1, 1, tzinfo=datetime.UTC)
    last = datetime.datetime(date.year + 1, 1, 1, tzinfo=datetime.UTC)
    return date.year + (date - first) / (last - first)
