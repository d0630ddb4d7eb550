"""Rotations in CasADi."""

from __future__ import annotations

import casadi as ca


def exponential(omega: ca.SX) -> ca.SX:
    """Unit quaternion (4,), scalar first, of exp(hat(omega)) for a rotation vector (3,) in rad.

    The angle is ``sqrt(|omega|^2 + 1e-12)``: smooth through zero, no branch; the quaternion has unit length to
    1e-13 and its first derivatives are right to 1e-10.
    """
    half = 0.5 * ca.sqrt(ca.dot(omega, omega) + 1e-12)
    return ca.vertcat(ca.cos(half), (0.5 * ca.sin(half) / half) * omega)


def compose(p: ca.SX, q: ca.SX) -> ca.SX:
    """Quaternion product p q: the rotation q in the frame that p rotates to."""
    a, b = p[1:], q[1:]
    return ca.vertcat(p[0] * q[0] - ca.dot(a, b), p[0] * b + q[0] * a + ca.cross(a, b))


def rotation_matrix(q: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) of a unit quaternion (4,). ``q`` is the quaternion, scalar first."""
    scalar, x, y, z = q[0], q[1], q[2], q[3]
    twice = 2.0 * q
    sx, sy, sz = twice[1] * scalar, twice[2] * scalar, twice[3] * scalar
    xx, yy, zz = twice[1] * x, twice[2] * y, twice[3] * z
    xy, xz, yz = twice[1] * y, twice[1] * z, twice[2] * z
    return ca.vertcat(
        ca.horzcat(1.0 - yy - zz, xy - sz, xz + sy),
        ca.horzcat(xy + sz, 1.0 - xx - zz, yz - sx),
        ca.horzcat(xz - sy, yz + sx, 1.0 - xx - yy),
    )


def rotation_about_y(angle: ca.SX) -> ca.SX:
    """Rotation matrix about the fixed y axis by ``angle`` (scalar) in rad."""
    c, s = ca.cos(angle), ca.sin(angle)
    matrix = ca.SX(3, 3)
    matrix[1, 1] = 1.0
    matrix[0, 0] = matrix[2, 2] = c
    matrix[0, 2] = s
    matrix[2, 0] = -s
    return matrix


def turning_coefficients(omega: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """t^2, a = (1 - cos t) / t^2 and b = (t - sin t) / t^3 of a rotation vector (3,) in rad, with t = |omega|.

    exp(hat(omega)) turns by dexp(omega) omega_t = omega_t + a omega x omega_t + b omega x (omega x omega_t) in the
    frame before it. t is smoothed at zero as ``exponential`` does. ``omega`` is this vector.
    """
    square = ca.dot(omega, omega) + 1e-12
    half = 0.5 * ca.sqrt(square)
    ratio = ca.sin(half) / half
    return square, 0.5 * ratio * ratio, (1.0 - ratio * ca.cos(half)) / square
