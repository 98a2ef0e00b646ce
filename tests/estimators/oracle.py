"""Textbook filters on `np.linalg`, dense and slow, straight from the formulas: what the compiled filters must equal."""

import numpy as np


class Marg:
    """The model of Han 2013 with additive noise, dense: f, h and their Jacobians by complex step."""

    def __init__(self, gravity, mag_n):
        self.G, self.M = np.array([0.0, 0.0, -gravity]), np.array(mag_n)

    @staticmethod
    def W(q):
        a, b, c, d = q
        return np.array(
            [
                [a * a + b * b - c * c - d * d, 2 * b * c + 2 * a * d, 2 * b * d - 2 * a * c],
                [2 * b * c - 2 * a * d, a * a - b * b + c * c - d * d, 2 * c * d + 2 * a * b],
                [2 * b * d + 2 * a * c, 2 * c * d - 2 * a * b, a * a - b * b - c * c + d * d],
            ]
        )

    def f(self, x, dt):
        p, q, r = x[4:7]
        norm = np.sqrt(p * p + q * q + r * r + 1e-40)
        omega = np.array([[0, -p, -q, -r], [p, 0, r, -q], [q, -r, 0, p], [r, q, -p, 0]])
        half = 0.5 * norm * dt
        return np.concatenate([np.cos(half) * x[:4] + np.sin(half) / norm * (omega @ x[:4]), x[4:]])

    def h(self, x):
        W = self.W(x[:4])
        return np.concatenate([W @ self.G, W @ self.M, x[4:7] + x[7:10]])


def slope(function, x):
    """Jacobian by complex step: exact to rounding."""
    columns = []
    for i in range(len(x)):
        moved = x.astype(complex)
        moved[i] += 1e-30j
        columns.append(function(moved).imag / 1e-30)
    return np.array(columns).T


def update(x, P, y, Pyy, Pxy, z, used):
    rows = np.flatnonzero(used)
    S, C = Pyy[np.ix_(rows, rows)], Pxy[:, rows]
    K = np.linalg.solve(S, C.T).T
    return x + K @ (z - y)[rows], P - K @ S @ K.T


class Ekf:
    def predict(self, f, x, P):
        F = slope(f, x)
        return f(x), F @ P @ F.T

    def project(self, h, x, P):
        H = slope(h, x)
        return h(x), H @ P @ H.T, P @ H.T


def iterate(h, x, P, z, R, used, steps):
    """Gauss-Newton from the prior (x, P), dense, without stopping early: Bell and Cathey 1993."""
    rows, moved = np.flatnonzero(used), x
    for _ in range(steps):
        H = slope(h, moved)[rows]
        K = np.linalg.solve(H @ P @ H.T + R[np.ix_(rows, rows)], H @ P).T
        moved = x + K @ (z[rows] - h(moved)[rows] + H @ (moved - x))
    return moved, P - K @ H @ P


class Ckf:
    """Han 2013, eq. (2)-(12) as printed."""

    def points(self, x, P):
        n = len(x)
        S = np.linalg.cholesky(P)
        return np.array([x + np.sqrt(n) * S[:, i] for i in range(n)] + [x - np.sqrt(n) * S[:, i] for i in range(n)])

    def predict(self, f, x, P):
        X = np.array([f(p) for p in self.points(x, P)])
        m = X.mean(0)
        return m, (X - m).T @ (X - m) / len(X)

    def project(self, h, x, P):
        X = self.points(x, P)
        Y = np.array([h(p) for p in X])
        y = Y.mean(0)
        return y, (Y - y).T @ (Y - y) / len(X), (X - x).T @ (Y - y) / len(X)


class Cdkf:
    """Norgaard, Poulsen and Ravn 2000, second order, h = sqrt(3)."""

    h2 = 3.0

    def _moments(self, function, x, P):
        n, h = len(x), np.sqrt(self.h2)
        S = np.linalg.cholesky(P)
        centre = function(x)
        plus = np.array([function(x + h * S[:, i]) for i in range(n)])
        minus = np.array([function(x - h * S[:, i]) for i in range(n)])
        mean = (self.h2 - n) / self.h2 * centre + (plus + minus).sum(0) / (2 * self.h2)
        first, second = plus - minus, plus + minus - 2 * centre
        cov = first.T @ first / (4 * self.h2) + (self.h2 - 1) / (4 * self.h2**2) * second.T @ second
        return mean, cov, S @ first / (2 * h)

    def predict(self, f, x, P):
        return self._moments(f, x, P)[:2]

    def project(self, h, x, P):
        return self._moments(h, x, P)


def run(method, model, x, P, Q_rate, R, samples, last):
    """States (rows, n) after each row, from (x, P) valid at `last`: predict, update, normalise."""
    states = []
    for k in range(len(samples)):
        dt, last = samples.t[k] - last, samples.t[k]
        x, P = method.predict(lambda v, dt=dt: model.f(v, dt), x, P)
        z = np.concatenate([samples.accel_b[k], samples.mag_b[k], samples.gyro_b[k]])
        used = np.isfinite(z)
        used[3:6] &= samples.mag_new[k]
        y, Pyy, Pxy = method.project(model.h, x, P + Q_rate * dt)
        x, P = update(x, P + Q_rate * dt, y, Pyy + R, Pxy, np.nan_to_num(z), used)
        x[:4] /= np.linalg.norm(x[:4])
        P = (P + P.T) / 2
        states.append(x)
    return np.array(states), P
