"""Samples that exported code is run on: all sensors on a swinging flight, which need no simulator."""

import numpy as np

from estimators.types import Samples, Site


def swinging(seconds: float = 40.0) -> tuple[Samples, Site]:
    """Samples of a swinging flight with all sensors, and its place."""
    rng, n = np.random.default_rng(3), int(100 * seconds)
    site, t = Site((0.76, 0.02, 150.0), 9.805, (2.3e-5, 4e-7, 4.0e-5)), np.arange(n) / 100.0
    swing = np.clip((t - 8.0) / 2.0, 0.0, 1.0)[:, None]
    rate = swing * 0.3 * np.cos(np.outer(t, [0.9, 0.7, 0.4])) + rng.normal(0, 0.002, (n, 3))
    force = (
        np.array([0.0, 0.0, -site.gravity]) + swing * np.sin(np.outer(t, [0.5, 0.9, 0.3])) + rng.normal(0, 0.02, (n, 3))
    )
    velocity = swing * np.column_stack([15.0 + np.sin(t), 3.0 * np.cos(t), 0.3 * np.sin(t)])
    place = np.array(site.lla) + np.cumsum(velocity, 0) / 100.0 * [1.57e-7, 2.2e-7, -1.0]
    every, k = 20, np.arange(n)
    return Samples.make(
        t, rate, force, mag_b=np.array(site.mag_n) + rng.normal(0, 3e-7, (n, 3)), mag_new=k % 2 == 0,
        lla=np.where(k[:, None] < 5, np.nan, place), vel_n=velocity + rng.normal(0, 0.05, (n, 3)), gnss_t=t - 0.1,
        gnss_satellites=np.full(n, 9.0), gnss_new=k % every == 5, airspeed=np.linalg.norm(velocity, axis=1),
        air_new=k % 5 == 0, heading=0.1 * np.sin(t), heading_sigma=np.full(n, 0.01), heading_t=t - 0.05,
        heading_new=k % every == 7,
    ), site  # fmt: skip
