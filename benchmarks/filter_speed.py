"""Time of one filter step against filterpy's and pyins', one thread, measured in turns in one run.

    python benchmarks/filter_speed.py [--repeat N] [--no-cold]

Each figure is the best of many short stretches, so that other work on the machine disturbs little; the ratio is what
counts. `marg-*` stand still with every sensor new in every row (the full update); filterpy has the same model and data.
`ins*` fly turns on a low-cost suite (field at 50 Hz, GNSS at 5 Hz); pyins (MIT, version 1, from its repository: it is
not in the package index) navigates on the same samples with its feedback filter: 15 states, the same GNSS, no field,
covariance ten times a second as is its default. Without these packages only our own times are printed. Last, in
processes of their own: compilation of the whole catalogue with an empty cache, and the same again from the disk.
"""

import argparse
import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy: the peers' linear algebra

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np

import estimators
from estimators import Samples, Site, create

SITE = Site((0.76, 0.02, 150.0), mag_n=(2.3e-5, 4e-7, 4.0e-5))
G, M = np.array([0.0, 0.0, -SITE.gravity]), np.array(SITE.mag_n)
DT, STRETCH = 0.01, 200


def samples(n: int) -> Samples:
    """Standing still with noise, every sensor new in every row: the full update each step."""
    rng = np.random.default_rng(1)
    return Samples.make(
        np.arange(n) * DT,
        rng.normal(0, 3.7e-3, (n, 3)),
        G + rng.normal(0, 0.02, (n, 3)),
        mag_b=M + rng.normal(0, 5e-7, (n, 3)),
        mag_new=np.ones(n, bool),
    )


def rotation(q: np.ndarray) -> np.ndarray:
    """C_bn(q)."""
    a, b, c, d = q
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)],
            [2 * (b * c - a * d), a * a - b * b + c * c - d * d, 2 * (c * d + a * b)],
            [2 * (b * d + a * c), 2 * (c * d - a * b), a * a - b * b - c * c + d * d],
        ]
    )


def f(x: np.ndarray, dt: float) -> np.ndarray:
    """State after dt, as a careful user of filterpy would write it."""
    x = x.reshape(-1)
    p, q, r = x[4:7]
    norm = np.sqrt(p * p + q * q + r * r) + 1e-300
    half = 0.5 * norm * dt
    omega = np.array([[0, -p, -q, -r], [p, 0, r, -q], [q, -r, 0, p], [r, q, -p, 0]])
    moved = x.copy()
    moved[:4] = np.cos(half) * x[:4] + np.sin(half) / norm * (omega @ x[:4])
    return moved


def h(x: np.ndarray) -> np.ndarray:
    """Nine measurements."""
    x = x.reshape(-1)
    C = rotation(x[:4])
    return np.concatenate([C @ G, C @ M, x[4:7] + x[7:]])


def h_slope(x: np.ndarray) -> np.ndarray:
    """Their Jacobian (9, 10)."""
    a, b, c, d = x.reshape(-1)[:4]
    H = np.zeros((9, 10))
    for row, v in ((0, G), (3, M)):
        p, q, r = v
        one, two = a * p + d * q - c * r, b * p + c * q + d * r
        three, four = c * p - b * q + a * r, d * p - a * q - b * r
        H[row : row + 3, :4] = 2 * np.array(
            [[one, two, -three, -four], [-four, three, two, -one], [three, four, one, two]]
        )
    H[6:, 4:7] = H[6:, 7:] = np.eye(3)
    return H


def peers() -> dict[str, Callable[[int], float]]:
    """Filterpy's filters: name -> (rows -> seconds)."""
    try:
        from filterpy.kalman import (
            CubatureKalmanFilter,
            ExtendedKalmanFilter,
            MerweScaledSigmaPoints,
            UnscentedKalmanFilter,
        )
    except ImportError:
        return {}
    Q = np.diag([1e-12] * 4 + [1.4e-5] * 3 + [1e-12] * 3)
    R = np.diag([4e-4] * 3 + [2.5e-13] * 3 + [1.4e-5] * 3)
    block = samples(STRETCH)
    z = np.hstack([block.accel_b, block.mag_b, block.gyro_b])

    def prepared(filter_: object, column: bool) -> object:
        filter_.x = np.eye(10)[0].reshape((10, 1) if column else 10)  # type: ignore[attr-defined]
        filter_.P, filter_.Q, filter_.R = 1e-4 * np.eye(10), Q, R  # type: ignore[attr-defined]
        return filter_

    def run_points(filter_: object, column: bool) -> Callable[[int], float]:
        def run(rows: int) -> float:
            start = time.perf_counter()
            for k in range(rows):
                filter_.predict()  # type: ignore[attr-defined]
                filter_.update(z[k][:, None] if column else z[k])  # type: ignore[attr-defined]
            return time.perf_counter() - start

        return run

    ckf = prepared(CubatureKalmanFilter(10, 9, DT, h, f), column=True)
    points = MerweScaledSigmaPoints(10, alpha=1.0, beta=2.0, kappa=0.0)
    ukf = prepared(UnscentedKalmanFilter(10, 9, DT, h, f, points), column=False)
    ekf = prepared(ExtendedKalmanFilter(10, 9), column=False)

    def run_ekf(rows: int) -> float:
        start = time.perf_counter()
        for k in range(rows):
            x = ekf.x  # type: ignore[attr-defined]
            F = np.eye(10)
            half = 0.5 * DT * x[4:7]
            F[:4, :4] += np.array(
                [[0, -half[0], -half[1], -half[2]], [half[0], 0, half[2], -half[1]],
                 [half[1], -half[2], 0, half[0]], [half[2], half[1], -half[0], 0]]
            )  # fmt: skip
            a, b, c, d = x[:4]
            F[:4, 4:7] = 0.5 * DT * np.array([[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]])
            ekf.x = f(x, DT)  # type: ignore[attr-defined]
            ekf.P = F @ ekf.P @ F.T + Q  # type: ignore[attr-defined]
            ekf.update(z[k], h_slope, h)  # type: ignore[attr-defined]
        return time.perf_counter() - start

    return {"marg-ekf": run_ekf, "marg-ckf": run_points(ckf, True), "marg-ukf": run_points(ukf, False)}


def navigator() -> Callable[[Samples, np.ndarray], float] | None:
    """Pyins' extended Kalman filter: (samples, q_nb at the first) -> seconds; None when it is not installed."""
    try:
        import pandas as pd
        from pyins import filters, inertial_sensor, measurements, strapdown, transform
        from scipy.spatial.transform import Rotation
    except ImportError:
        return None

    def run(part: Samples, q_nb: np.ndarray) -> float:
        t, new = part.t, part.gnss_new
        place = np.hstack([np.degrees(part.lla[:, :2]), part.lla[:, 2:]])
        attitude = transform.mat_to_rph(Rotation.from_quat(np.roll(q_nb, -1)).as_matrix())
        names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
        first = int(np.flatnonzero(new)[0])
        start = pd.Series(np.hstack([place[first], part.vel_n[first], attitude]), index=names, name=t[0])
        axes = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
        readings = pd.DataFrame(np.hstack([part.gyro_b, part.accel_b]), index=t, columns=axes)
        # a fix counts at the row that brings it
        fixes = pd.DataFrame(np.hstack([place, part.vel_n])[new], index=t[new], columns=names[:6])
        gyro = inertial_sensor.EstimationModel(bias_sd=3e-3, noise=1e-3, bias_walk=1e-5)
        accel = inertial_sensor.EstimationModel(bias_sd=0.05, noise=0.05, bias_walk=1e-4)
        aids = [measurements.Position(fixes, 5.0), measurements.NedVelocity(fixes, 0.15)]
        began = time.perf_counter()
        increments = strapdown.compute_increments_from_imu(readings, "rate")
        filters.run_feedback_filter(start, 5.0, 0.5, 2.0, 5.0, increments, gyro, accel, aids)
        return time.perf_counter() - began

    return run


def flown(stretches: int) -> Samples:
    """A low-cost suite in turns at 30 degrees of bank, after a minute of standing."""
    from ahrs_sim.papers import bench

    flight = {"motion": {"kind": "weave"}, "duration_s": 64.0 + stretches * STRETCH * DT, "rate_hz": 200.0}
    return bench.measure(bench.fly(flight, "weave"), {"grade": "chr_6dm"}, seed=1).samples


def catalogue(cache: str) -> float:
    """Seconds for every method to be ready, in a process with this disk cache; what Python and NumPy need is not in."""
    code = (
        "import sys, time, numpy as np, numba, scipy.linalg\n"
        "start = time.perf_counter()\n"
        f"sys.path.insert(0, {os.path.dirname(__file__)!r})\n"  # noqa: PTH120
        "import estimators, filter_speed\n"
        "for m in estimators.describe():\n"
        "    if m.own: estimators.create(m.name, site=filter_speed.SITE, align_s=1.0)"
        ".process(filter_speed.samples(filter_speed.STRETCH))\n"
        "print(time.perf_counter() - start)"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    return float(done.stdout)


OURS: dict[str, tuple[str, dict[str, str]]] = {
    **{name: (name, {}) for name in ("marg-ekf", "marg-ckf", "marg-cdkf", "marg-ukf")},
    "ins15": ("ins15", {}),
    "ins15, ukf": ("ins15", {"filter": "ukf"}),
    "ins21": ("ins21", {}),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=40, help="stretches of 200 steps of each filter")
    parser.add_argument("--no-cold", action="store_true", help="leave the compilation of the catalogue out")
    arguments = parser.parse_args()
    repeat = arguments.repeat
    standing, moving = samples(STRETCH * (repeat + 2)), flown(repeat + 2)
    first = int(np.searchsorted(moving.t, 62.0))
    ours, best, single = {}, {}, {}
    for key, (method, settings) in OURS.items():
        start = time.perf_counter()
        ours[key] = create(method, site=SITE, align_s=1.0, **settings)
        ours[key].process(moving[:first] if method.startswith("ins") else standing[:STRETCH])
        print(f"{key}: ready after {time.perf_counter() - start:.2f} s (compiled, or loaded from the disk cache)")
        best[key] = single[key] = float("inf")
    others = peers()
    if not others:
        print("filterpy is not installed: no ratios")
    peer_best = dict.fromkeys(others, float("inf"))
    navigate = navigator()
    if navigate is None:
        print("pyins is not installed: no ratios of the navigators")

    def part(key: str, i: int) -> Samples:
        if key.startswith("ins"):
            return moving[first + (i - 1) * STRETCH : first + i * STRETCH]
        return standing[i * STRETCH : (i + 1) * STRETCH]

    for i in range(1, repeat + 1):
        for key, estimator in ours.items():
            block = part(key, i)
            start = time.perf_counter()
            estimates = estimator.process(block)
            best[key] = min(best[key], (time.perf_counter() - start) / STRETCH)
        if navigate is not None:  # the last estimator is a navigator
            seconds = navigate(block, estimates.q_nb[0]) / (STRETCH - 1)
            for key in OURS:
                if key.startswith("ins"):
                    peer_best[key] = min(peer_best.get(key, float("inf")), seconds)
        for key, run in others.items():
            rows = STRETCH // 4
            peer_best[key] = min(peer_best[key], run(rows) / rows)
    for key, estimator in ours.items():
        tail = part(key, repeat + 1)
        for k in range(STRETCH):
            row = tail[k : k + 1]
            start = time.perf_counter()
            estimator.process(row)
            single[key] = min(single[key], time.perf_counter() - start)
    print(f"{'filter':<12}{'us/step':>9}{'one-sample call, us':>21}{'peer us/step':>18}{'ratio':>8}")
    for key in OURS:
        peer = peer_best.get(key)
        right = f"{1e6 * peer:>18.1f}{peer / best[key]:>8.0f}" if peer else f"{'-':>18}{'-':>8}"
        print(f"{key:<12}{1e6 * best[key]:>9.2f}{1e6 * single[key]:>21.1f}{right}")
    if arguments.no_cold:
        return
    with tempfile.TemporaryDirectory(prefix="ahrs_sim-") as cache:
        count = sum(method.own for method in estimators.describe())
        print(f"whole catalogue, {count} methods: compiled in {catalogue(cache):.1f} s, ", end="", flush=True)
        print(f"from the disk cache in {min(catalogue(cache) for _ in range(3)):.2f} s")


if __name__ == "__main__":
    main()
