"""The magnetic field."""

import datetime
import math

import numpy as np
import pytest

from ahrs_sim.errors import InputError
from ahrs_sim.world import magnetic
from ahrs_sim.world.magnetic import MagneticField, decimal_year, field_n, wmm

EPOCH = datetime.datetime(2026, 6, 1, 10, tzinfo=datetime.UTC)

# NOAA, WMM2025 test values: year, height km, latitude, longitude, X, Y, Z in nT
PUBLISHED = [
    (2025.0, 0.0, 80.0, 0.0, 6521.6, 145.9, 54791.5),
    (2025.0, 0.0, 0.0, 120.0, 39677.8, -109.6, -10580.2),
    (2025.0, 0.0, -80.0, 240.0, 6117.5, 15751.9, -52022.5),
    (2025.0, 100.0, 80.0, 0.0, 6216.0, 92.4, 52598.8),
    (2025.0, 100.0, 0.0, 120.0, 37688.6, -96.2, -10152.1),
    (2025.0, 100.0, -80.0, 240.0, 5907.6, 14780.3, -49540.7),
    (2027.5, 0.0, 80.0, 0.0, 6500.8, 294.5, 54869.4),
    (2027.5, 0.0, 0.0, 120.0, 39701.6, -167.4, -10381.8),
    (2027.5, 0.0, -80.0, 240.0, 6200.7, 15730.3, -51783.7),
    (2027.5, 100.0, 80.0, 0.0, 6196.7, 233.8, 52670.5),
    (2027.5, 100.0, 0.0, 120.0, 37711.5, -148.7, -9969.8),
    (2027.5, 100.0, -80.0, 240.0, 5984.0, 14760.1, -49317.7),
]


@pytest.mark.parametrize("row", PUBLISHED)
def test_published_values(row):
    year, height, latitude, longitude, *field = row
    longitude = (longitude + 180.0) % 360.0 - 180.0
    lla = np.array([[np.radians(latitude), np.radians(longitude), 1000.0 * height]])
    assert wmm(lla, year)[0] * 1e9 == pytest.approx(field, abs=0.06)


@pytest.mark.parametrize("centre", [(43.57, 1.47), (-75.0, 179.99), (0.01, -0.01), (88.9, 10.0)])
def test_interpolation_is_as_good_as_the_model(centre):
    random = np.random.default_rng(1)
    lla = np.column_stack(
        [
            np.radians(centre[0] + random.uniform(-0.1, 0.1, 40)),
            (np.radians(centre[1] + random.uniform(-0.1, 0.1, 40)) + np.pi) % (2 * np.pi) - np.pi,
            random.uniform(0.0, 3000.0, 40),
        ]
    )
    assert np.abs(field_n(lla, EPOCH) - wmm(lla, decimal_year(EPOCH))).max() < 0.1e-9


def test_a_value_depends_on_its_place_alone():
    random = np.random.default_rng(2)
    lla = np.column_stack([np.full(200, 0.76), 0.0256 + random.uniform(0, 2e-3, 200), random.uniform(0, 1500, 200)])
    together = MagneticField(EPOCH).at(lla)
    apart = np.concatenate([MagneticField(EPOCH).at(lla[i : i + 7]) for i in range(0, 200, 7)])
    assert together.tobytes() == apart.tobytes()
    assert MagneticField(EPOCH).at(lla[:0]).shape == (0, 3)


def test_a_date_without_a_model_is_refused():
    with pytest.raises(InputError, match="2025 to 2029"):
        field_n(np.zeros((1, 3)), datetime.datetime(2019, 1, 1, tzinfo=datetime.UTC))


def test_decimal_year():
    assert decimal_year(datetime.datetime(2026, 7, 2, 12, tzinfo=datetime.UTC)) == pytest.approx(2026.5)
    assert decimal_year(datetime.datetime(2028, 12, 31, 23, 59)) < 2029.0


@pytest.mark.parametrize(
    ("year", "latitude", "longitude", "field"),
    [  # test values of the World Magnetic Models 2015 and 2020 (NOAA NCEI), at the ellipsoid, nT
        (2015.0, 80.0, 0.0, (6627.1, -445.9, 54432.3)),
        (2015.0, 0.0, 120.0, (39518.2, 392.9, -11252.4)),
        (2015.0, -80.0, 240.0, (5797.3, 15761.1, -52919.1)),
        (2020.0, 80.0, 0.0, (6570.4, -146.3, 54606.0)),
        (2020.0, 0.0, 120.0, (39624.3, 109.9, -10932.5)),
        (2020.0, -80.0, 240.0, (5940.6, 15772.1, -52480.8)),
    ],
)
def test_igrf_agrees_with_the_models_of_its_years(
    year: float, latitude: float, longitude: float, field: tuple[float, float, float]
) -> None:
    lla = np.array([[np.radians(latitude), np.radians(longitude), 0.0]])
    assert magnetic.igrf(lla, year)[0] * 1e9 == pytest.approx(field, abs=60.0)


def test_igrf_goes_on_from_epoch_to_epoch() -> None:
    lla = np.array([[0.8, 0.1, 500.0], [-0.5, 2.0, 0.0]])
    for year in (1995.0, 2000.0, 2020.0, 2025.0):
        np.testing.assert_allclose(magnetic.igrf(lla, year - 1e-6), magnetic.igrf(lla, year), atol=1e-12)
    assert np.abs(magnetic.igrf(lla, 2026.5) - magnetic.wmm(lla, 2026.5)).max() < 1e-7
    middle = 0.5 * (magnetic.igrf(lla, 2010.0) + magnetic.igrf(lla, 2015.0))
    np.testing.assert_allclose(magnetic.igrf(lla, 2012.5), middle, atol=1e-11)
    with pytest.raises(InputError, match="outside of IGRF-14"):
        magnetic.igrf(lla, 1899.0)


def test_dip() -> None:
    assert magnetic.dip(np.array([2e-5, 0.0, 2e-5])) == pytest.approx(math.pi / 4)
    assert magnetic.dip(np.array([0.0, 0.0, -5e-5])) == pytest.approx(-math.pi / 2)
    assert magnetic.dip(np.zeros(3)) == 0.0
    assert magnetic.dip(np.array([0.0, 0.0, 1e-200])) == pytest.approx(math.pi / 2)  # its square is no number
