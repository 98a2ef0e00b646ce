"""Rotation kernels: group axioms and derivatives, over random rotations."""

import math

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from synthetic import from_euler as naive_from_euler
from synthetic import matrix_bn

from estimators import rotations as rot

settings.register_profile("kernels", deadline=None, max_examples=60)
settings.load_profile("kernels")

unit = st.floats(-1.0, 1.0, allow_nan=False)
small = st.floats(-4.0, 4.0, allow_nan=False)
vectors = st.tuples(small, small, small).map(np.array)
quaternions = (
    st.tuples(unit, unit, unit, unit)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)


def out(kernel, *arguments, shape=4):
    result = np.empty(shape)
    kernel(*arguments, result)
    return result


@given(quaternions, quaternions, quaternions)
def test_multiplication_is_associative_and_matches_matrices(p, q, r):
    pq = out(rot.multiply, p, q)
    np.testing.assert_allclose(out(rot.multiply, pq, r), out(rot.multiply, p, out(rot.multiply, q, r)), atol=1e-14)
    np.testing.assert_allclose(matrix_bn(pq), matrix_bn(q) @ matrix_bn(p), atol=1e-14)  # C_bn of a product, reversed
    conjugate = q * [1, -1, -1, -1]
    np.testing.assert_allclose(out(rot.multiply, q, conjugate), [1, 0, 0, 0], atol=1e-15)


@given(quaternions, vectors)
def test_to_body_and_to_nav_are_inverse_rotations(q, v):
    body = out(rot.to_body, q, *v, shape=3)
    np.testing.assert_allclose(body, matrix_bn(q) @ v, atol=1e-13)
    np.testing.assert_allclose(out(rot.to_nav, q, *body, shape=3), v, atol=1e-13)
    np.testing.assert_allclose(out(rot.attitude_matrix, q, shape=(3, 3)), matrix_bn(q), atol=1e-15)


@given(quaternions, vectors)
def test_the_derivative_of_to_body_is_a_difference(q, v):
    J, h = out(rot.to_body_by_q, q, *v, shape=(3, 4)), 1e-6
    for i in range(4):
        step = h * np.eye(4)[i]
        difference = (out(rot.to_body, q + step, *v, shape=3) - out(rot.to_body, q - step, *v, shape=3)) / (2 * h)
        np.testing.assert_allclose(J[:, i], difference, atol=1e-8)


@given(quaternions, vectors)
def test_rotation_between_undoes_turn(q, r):
    assume(np.linalg.norm(r) < math.pi - 1e-3)
    turned = out(rot.turn, q, *r)
    assert abs(np.linalg.norm(turned) - 1.0) < 1e-14
    np.testing.assert_allclose(out(rot.rotation_between, q, turned, shape=3), r, atol=1e-9)
    half = out(rot.turn, out(rot.turn, q, *(0.5 * r)), *(0.5 * r))
    np.testing.assert_allclose(half, turned, atol=1e-14)


@given(st.floats(0.0, 0.5))
def test_the_series_of_the_exponential_meets_the_closed_form(angle):
    angle = math.sqrt(angle)
    cosine, sine, slope = rot.exp_terms(angle**2)
    assert abs(cosine - math.cos(angle / 2)) < 1e-15
    exact = math.sin(angle / 2) / angle if angle > 1e-4 else 0.5 - angle**2 / 48
    assert abs(sine - exact) < 1e-14
    if angle > 0.1:
        assert abs(slope - (0.5 * math.cos(angle / 2) - math.sin(angle / 2) / angle) / angle**2) < 1e-12
    else:
        assert abs(slope + 1 / 24) < 2e-5


@given(st.floats(-3.1, 3.1), st.floats(-1.55, 1.55), st.floats(-3.1, 3.1))
def test_euler_angles_go_both_ways(roll, pitch, yaw):
    q = out(rot.from_euler, roll, pitch, yaw)
    np.testing.assert_allclose(q, naive_from_euler(roll, pitch, yaw), atol=1e-15)
    np.testing.assert_allclose(rot.euler(q), (roll, pitch, yaw), atol=1e-7)


@given(quaternions)
def test_from_matrix_is_exact_everywhere(q):
    back = out(rot.from_matrix, matrix_bn(q))
    assert back[0] >= 0.0
    np.testing.assert_allclose(back * np.sign(back @ q), q, atol=1e-13)


@given(quaternions, st.floats(0.1, 3.0), st.floats(-0.6, 0.6), st.floats(-2.0, 2.0))
def test_triad_finds_the_attitude(q, strength, declination, dip):
    mag_n = strength * np.array([math.cos(declination), math.sin(declination), dip])
    C, found = matrix_bn(q), np.empty(4)
    assert rot.triad(9.8 * C[:, 2], C @ mag_n, mag_n, found)
    np.testing.assert_allclose(matrix_bn(found), C, atol=1e-12)


def test_triad_refuses_what_gives_no_heading():
    found = np.full(4, 7.0)
    down, field = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 4e-5])
    assert not rot.triad(down, field, np.array([2e-5, 0.0, 4e-5]), found)
    assert not rot.triad(np.zeros(3), np.array([2e-5, 0, 0]), np.array([2e-5, 0.0, 4e-5]), found)
    assert (found == 7.0).all()


@given(st.floats(-50.0, 50.0))
def test_wrap_is_the_same_direction_in_half_open_interval(angle):
    wrapped = rot.wrap(angle)
    assert -math.pi < wrapped <= math.pi
    assert abs(math.remainder(wrapped - angle, 2 * math.pi)) < 1e-12
