"""Time of one filter step against filterpy's on the same model and data, one thread, measured in turns in one run.

    python benchmarks/filter_speed.py [--repeat N]

Each figure is the best of many short stretches, so that other work on the machine disturbs little; the ratio is what
counts. Compilation (or loading from the disk cache) is timed apart. Without filterpy only our own times are printed.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

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
        from filterpy.kalman import CubatureKalmanFilter, ExtendedKalmanFilter
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

    ckf = prepared(CubatureKalmanFilter(10, 9, DT, h, f), column=True)
    ekf = prepared(ExtendedKalmanFilter(10, 9), column=False)

    def run_ckf(rows: int) -> float:
        start = time.perf_counter()
        for k in range(rows):
            ckf.predict()  # type: ignore[attr-defined]
            ckf.update(z[k][:, None])  # type: ignore[attr-defined]
        return time.perf_counter() - start

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

    return {"ekf": run_ekf, "ckf": run_ckf}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=40, help="stretches of 200 steps of each filter")
    repeat = parser.parse_args().repeat
    data = samples(STRETCH * (repeat + 2))
    names = {"ekf": "marg-ekf", "ckf": "marg-ckf", "cdkf": "marg-cdkf"}
    ours, best, single = {}, {}, {}
    for key, name in names.items():
        start = time.perf_counter()
        ours[key] = create(name, site=SITE, align_s=1.0)
        ours[key].process(data[:STRETCH])
        print(f"{name}: ready after {time.perf_counter() - start:.2f} s (compiled, or loaded from the disk cache)")
        best[key] = single[key] = float("inf")
    others = peers()
    if not others:
        print("filterpy is not installed: no ratios")
    peer_best = dict.fromkeys(others, float("inf"))
    for i in range(1, repeat + 1):
        block = data[i * STRETCH : (i + 1) * STRETCH]
        for key, estimator in ours.items():
            start = time.perf_counter()
            estimator.process(block)
            best[key] = min(best[key], (time.perf_counter() - start) / STRETCH)
        for key, run in others.items():
            rows = STRETCH // 4
            peer_best[key] = min(peer_best[key], run(rows) / rows)
    tail = data[(repeat + 1) * STRETCH :]
    for key, estimator in ours.items():
        for k in range(STRETCH):
            row = tail[k : k + 1]
            start = time.perf_counter()
            estimator.process(row)
            single[key] = min(single[key], time.perf_counter() - start)
    print(f"{'filter':<8}{'us/step':>9}{'one-sample call, us':>21}{'filterpy us/step':>18}{'ratio':>8}")
    for key in names:
        peer = peer_best.get(key)
        right = f"{1e6 * peer:>18.1f}{peer / best[key]:>8.0f}" if peer else f"{'-':>18}{'-':>8}"
        print(f"{key:<8}{1e6 * best[key]:>9.2f}{1e6 * single[key]:>21.1f}{right}")


if __name__ == "__main__":
    main()
