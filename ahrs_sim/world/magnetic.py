"""The Earth's magnetic field: World Magnetic Model at the flight's place and date.

The model is evaluated at the corners of a fixed lattice and interpolated in between, so a value depends on its place
alone and not on the rest of the block. The lattice is fine enough for 0.1 nT.
"""

import datetime
import itertools
import math
import warnings
from functools import lru_cache

import numpy as np

from ahrs_sim.errors import InputError

_CELL = np.array([math.radians(0.05), math.radians(0.05), 1000.0])  # rad, rad, m
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
FIRST, LAST = 2025.0, 2030.0
"""Validity of WMM2025, decimal years."""

IGRF_FIRST, IGRF_LAST = 1900.0, 2030.0
"""Validity of IGRF-14, decimal years."""


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
        """Compute field (n, 3) T in NED at `lla` (n, 3) (rad, rad, m above the ellipsoid)."""
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
        """Compute field (8, 3) T at the corners of a cell, (3,) whole numbers."""
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
    """Compute field (n, 3) T in NED at `lla` (n, 3) on the day of `epoch`.

    Raises:
        InputError: the date is outside the model's validity.
    """
    return _field(epoch).at(lla)


_field = lru_cache(maxsize=8)(MagneticField)


def dip(field_n: np.ndarray) -> float:
    """Compute the dip (rad) of a field (3,) in NED: its angle below the horizon; 0 of no field."""
    north, east, down = (float(x) for x in field_n)
    return math.atan2(down, math.hypot(north, east))


def wmm(lla: np.ndarray, year: float) -> np.ndarray:
    """World Magnetic Model 2025, exact: (n, 3) T in NED at `lla` (n, 3) for a decimal `year`."""
    from wmm import wmm_calc  # lazily: a flight on recorded data needs none

    model = wmm_calc()
    model.setup_env(np.degrees(lla[:, 0]), np.degrees(lla[:, 1]), lla[:, 2] / 1000.0, unit="km", msl=False)
    model.setup_time(dyear=np.full(len(lla), year))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns near the magnetic poles, where a compass is weak but the field right
        return np.stack([model.get_Bx(), model.get_By(), model.get_Bz()], axis=-1) * 1e-9


def igrf(lla: np.ndarray, year: float) -> np.ndarray:
    """International Geomagnetic Reference Field 14: (n, 3) T in NED at `lla` (n, 3) for a decimal `year`, 1900 to 2030.

    Between its epochs, five years apart, the coefficients change evenly (Alken et al. 2021, eq. 2).

    Raises:
        InputError: the year is outside of the model.
    """
    from geomaglib import legendre, magmath, sh_vars, util

    epochs = _igrf_coefficients()
    known = [epoch for epoch in epochs if epoch <= year]
    if not known or year > IGRF_LAST:
        raise InputError(f"{year:.1f} is outside of IGRF-14, {IGRF_FIRST:.0f} to {IGRF_LAST:.0f}")
    degree, terms = epochs[known[-1]]
    later = min((epoch for epoch in epochs if epoch > year), default=None)
    if later is None:
        g, h = terms[:, 0] + (year - known[-1]) * terms[:, 2], terms[:, 1] + (year - known[-1]) * terms[:, 3]
    else:
        share = (year - known[-1]) / (later - known[-1])
        degree, after = epochs[later] if epochs[later][0] > degree else (degree, epochs[later][1])
        size = (degree + 1) * (degree + 2) // 2
        before = np.zeros((size, 4))
        before[: len(terms)] = terms
        mixed = before[:, :2] + share * (after[:size, :2] - before[:, :2])
        g, h = mixed[:, 0], mixed[:, 1]
    latitude, longitude = np.degrees(lla[:, 0]), np.degrees(lla[:, 1])
    radius, geocentric = (np.array(x) for x in util.geod_to_geoc_lat(latitude, lla[:, 2] / 1000.0))
    harmonics = sh_vars.comp_sh_vars(longitude, radius, geocentric, degree)
    functions = legendre.Flattened_Chaos_Legendre1(degree, 90.0 - geocentric)
    field = magmath.mag_SPH_summation(degree, harmonics, g, h, functions, geocentric)
    return np.stack(magmath.rotate_magvec(*field, geocentric, latitude), axis=-1) * 1e-9


def igrf_terms(since: float) -> list[tuple[float, float, int, list[list[float]]]]:
    """List IGRF-14 from one of its epochs to the next: both years, the degree, and its terms.

    A term is degree, order, g and h in nT at the first year, and their change a year.
    """
    epochs, listed = _igrf_coefficients(), []
    for year, later in itertools.pairwise(epoch for epoch in epochs if epoch >= since):
        degree = max(epochs[year][0], epochs[later][0])
        terms = []
        for n in range(1, degree + 1):
            for m in range(n + 1):
                k = n * (n + 1) // 2 + m
                g, h, g_later, h_later = (
                    float(rows[k, i]) if k < len(rows) else 0.0
                    for rows in (epochs[year][1], epochs[later][1])
                    for i in (0, 1)
                )
                terms.append([n, m, g, h, (g_later - g) / (later - year), (h_later - h) / (later - year)])
        listed.append((year, later, degree, terms))
    return listed


@lru_cache(maxsize=1)
def _igrf_coefficients() -> dict[float, tuple[int, np.ndarray]]:
    """Read by epoch: degree, and g, h and their change a year (k, 4) in nT, in the order of degree and order."""
    from importlib.resources import files

    found: dict[float, tuple[int, np.ndarray]] = {}
    rows: list[list[float]] = []
    for line in (files("geomaglib") / "cof" / "IGRF14_sv.COF").read_text(encoding="ascii").splitlines():
        words = line.split()
        if words[0][1:].startswith("GRF"):
            rows = [[0.0, 0.0, 0.0, 0.0]]
            epoch, degree = float(words[1]), int(words[2])
        else:
            rows.append([float(x) for x in words[2:6]])
            found[epoch] = degree, np.array(rows)
    return found


def decimal_year(date: datetime.datetime) -> float:
    """2026-07-02 12:00 -> 2026.5."""
    date = date.astimezone(datetime.UTC) if date.tzinfo else date.replace(tzinfo=datetime.UTC)
    first = datetime.datetime(date.year, 1, 1, tzinfo=datetime.UTC)
    last = datetime.datetime(date.year + 1, 1, 1, tzinfo=datetime.UTC)
    return date.year + (date - first) / (last - first)
