"""Rotations in bulk against SciPy and against the kernels that the estimators use."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ahrs_sim import attitude
from estimators import rotations

P = Rotation.random(200, rng=1)
Q = Rotation.random(200, rng=2)
V = np.random.default_rng(3).normal(size=(200, 3))


def quaternions(rotation: Rotation) -> np.ndarray:
    return np.asarray(rotation.as_quat(scalar_first=True))


def same(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """How close quaternions are, either sign: 1."""
    return np.abs(np.sum(p * q, axis=1))


def test_product_and_conjugate_are_scipys() -> None:
    assert same(attitude.product(quaternions(P), quaternions(Q)), quaternions(P * Q)) == pytest.approx(1.0)
    assert same(attitude.conjugate(quaternions(P)), quaternions(P.inv())) == pytest.approx(1.0)
    one = quaternions(P)[0]
    assert attitude.product(one, quaternions(Q)) == pytest.approx(attitude.product(one[None], quaternions(Q)))


def test_vectors_turn_as_scipys_and_back() -> None:
    turned = attitude.to_nav(quaternions(P), V)
    assert turned == pytest.approx(P.apply(V))
    assert attitude.to_body(quaternions(P), turned) == pytest.approx(V)
    down = attitude.to_body(quaternions(P), np.tile([0.0, 0.0, 1.0], (200, 1)))
    assert attitude.down(quaternions(P)) == pytest.approx(down)


def test_rotation_vectors_are_scipys() -> None:
    wanted = (P.inv() * Q).as_rotvec()
    assert attitude.rotation_vector(quaternions(P), quaternions(Q)) == pytest.approx(wanted, abs=1e-9)
    assert same(attitude.product(quaternions(P), attitude.exponential(wanted)), quaternions(Q)) == pytest.approx(1.0)
    assert attitude.rotation_vector(quaternions(P), -quaternions(P)) == pytest.approx(np.zeros((200, 3)), abs=1e-9)


def test_matrices_are_scipys() -> None:
    for r in [*(P.as_rotvec()[:20]), np.zeros(3), np.array([1e-10, 0.0, -2e-10])]:
        assert attitude.rotation_matrix(r) == pytest.approx(Rotation.from_rotvec(r).as_matrix(), abs=1e-12)
    crossed = np.einsum("nij,nj->ni", attitude.cross_matrices(V), V[::-1])
    assert crossed == pytest.approx(np.cross(V, V[::-1]))


def test_euler_angles_go_round() -> None:
    angles = np.random.default_rng(4).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (200, 3))
    q = attitude.from_euler(angles)
    assert attitude.euler(q) == pytest.approx(angles)
    assert np.column_stack(attitude.roll_pitch(attitude.down(q))) == pytest.approx(angles[:, :2])
    assert attitude.matrix(*angles[0]) @ V[0] == pytest.approx(attitude.to_nav(q[:1], V[:1])[0])


def test_kernels_are_the_same() -> None:
    q, out = quaternions(P), np.empty(4)
    for k in range(20):
        assert np.array(rotations.euler(q[k])) == pytest.approx(attitude.euler(q[k : k + 1])[0])
        rotations.multiply(q[k], quaternions(Q)[k], out)
        assert out == pytest.approx(attitude.product(q[k], quaternions(Q)[k]))
        assert np.array(rotations.nav_vector(q[k], *V[k])) == pytest.approx(attitude.to_nav(q, V)[k])


def test_slope_by_rotation_is_a_difference() -> None:
    q, step = quaternions(P)[0], 1e-6
    slope = (attitude.product(q, attitude.exponential(step * np.eye(3))) - q) / step
    assert attitude.by_rotation(q) == pytest.approx(slope.T, abs=1e-6)


def test_wrapping_keeps_pi() -> None:
    assert attitude.wrap(np.array([np.pi, -np.pi, 3 * np.pi, 0.1 - 2 * np.pi])) == pytest.approx(
        [np.pi, np.pi, np.pi, 0.1]
    )
