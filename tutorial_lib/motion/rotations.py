"""Rotations as quaternions, matrices, Euler angles and 6D vectors.

Conventions, and their alternatives
    Quaternions ``(..., 4)`` are ``w, x, y, z`` (scipy and ROS put w last) and rotate vectors
    actively: ``quat_rotate(q, v)`` is ``q v q*``. ``quat_mul(a, b)`` turns by ``b`` first, then ``a``.
    Matrices ``(..., 3, 3)`` act on column vectors. Angles are radians.
    Euler angles ``(..., 3)`` with an order such as ``"ZXY"`` are intrinsic, as in BVH: the matrix is
    ``R_Z(a0) R_X(a1) R_Y(a2)``, the first angle turning the outermost axis.
    6D vectors ``(..., 6)`` are the first two *columns* of the matrix, one after the other
    (Zhou et al. 2019, "On the continuity of rotation representations"); some codes take rows.

Every function takes numpy arrays or torch tensors, any leading axes, and returns the same kind;
with tensors it is differentiable. There is one implementation, in torch.
"""

from __future__ import annotations

import functools
import math
from typing import TypeVar

import numpy as np
import torch

from ..errors import TutorialError

Array = TypeVar("Array", np.ndarray, torch.Tensor)
_AXES = {"X": 0, "Y": 1, "Z": 2}
EULER_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")


def numpy_or_torch(function):
    """Let a function written for tensors take and give numpy arrays too (without copying)."""

    @functools.wraps(function)
    def wrapper(*args, **kwargs):
        if any(isinstance(a, torch.Tensor) for a in (*args, *kwargs.values())):
            return function(*args, **kwargs)
        args = [_tensor(a) for a in args]
        kwargs = {k: _tensor(a) for k, a in kwargs.items()}
        with torch.no_grad():
            result = function(*args, **kwargs)
        return tuple(r.numpy() for r in result) if isinstance(result, tuple) else result.numpy()

    return wrapper


def _tensor(value):
    if isinstance(value, np.ndarray | np.floating | list | tuple):
        array = np.asarray(value)
        if array.dtype.kind in "iuf":
            array = array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)
            if not array.flags.writeable or any(s < 0 for s in array.strides):
                array = array.copy()  # torch warns about read-only memory and refuses negative strides
            return torch.from_numpy(array)
    return value


def _tensor_of(angle, like: torch.Tensor | None = None) -> torch.Tensor:
    """An angle that may also be a plain number."""
    if isinstance(angle, torch.Tensor):
        return angle
    return torch.tensor(angle, dtype=torch.float64) if like is None else like.new_tensor(angle)


Parts = tuple[torch.Tensor, ...]


def mul_parts(a: Parts, b: Parts) -> Parts:
    """The quaternion product, component by component: Hamilton's ``(w, x, y, z)`` of ``a b``."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def rotate_parts(q: Parts, v: Parts) -> Parts:
    """A vector turned by a unit quaternion, component by component: ``v + w t + u x t`` with ``t = 2 u x v``."""
    (w, x, y, z), (vx, vy, vz) = q, v
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


@numpy_or_torch
def quat_mul(a: Array, b: Array) -> Array:
    """The rotation ``b`` followed by ``a``; ``(..., 4)`` each, broadcast."""
    return torch.stack(mul_parts(a.unbind(-1), b.unbind(-1)), -1)


@numpy_or_torch
def quat_inv(q: Array) -> Array:
    """The opposite rotation of unit quaternions ``(..., 4)``."""
    return q * q.new_tensor([1.0, -1.0, -1.0, -1.0])


@numpy_or_torch
def quat_normalize(q: Array) -> Array:
    """Unit quaternions; a quaternion of length zero (a network's output may be) gives no rotation."""
    norm = q.norm(dim=-1, keepdim=True)
    tiny = norm < 1e-8
    identity = q.new_tensor([1.0, 0.0, 0.0, 0.0]).expand_as(q)
    return torch.where(tiny, identity, q / torch.where(tiny, torch.ones_like(norm), norm))


@numpy_or_torch
def quat_rotate(q: Array, v: Array) -> Array:
    """Vectors ``v`` ``(..., 3)`` turned by unit quaternions ``q`` ``(..., 4)``, broadcast."""
    return torch.stack(rotate_parts(q.unbind(-1), v.unbind(-1)), -1)


@numpy_or_torch
def quat_between(u: Array, v: Array) -> Array:
    """The smallest rotation that turns direction ``u`` into direction ``v``; ``(..., 3)`` each.

    Opposite directions turn about any perpendicular axis; a zero vector gives no rotation.
    """
    u, v = torch.broadcast_tensors(u, v)
    un, vn = (a.norm(dim=-1, keepdim=True) for a in (u, v))
    safe = (un > 1e-12) & (vn > 1e-12)
    u, v = (a / torch.where(safe, n, torch.ones_like(n)) for a, n in ((u, un), (v, vn)))
    dot, middle = (u * v).sum(-1, keepdim=True), u + v
    cross = torch.linalg.cross(u, middle)  # u x v; near opposite directions far more exact than that
    # half-way construction: (1 + u.v, u x v) normalised
    q = torch.cat((1.0 + dot, cross), -1)
    # near opposite directions that is rounding noise: cos and sin of the half angle from lengths instead, and
    # where even the axis is lost any perpendicular one, from the coordinate axis least aligned with u
    length = cross.norm(dim=-1, keepdim=True)
    lost = length < 4 * torch.finfo(u.dtype).eps
    other = torch.linalg.cross(u, torch.zeros_like(u).scatter_(-1, u.abs().argmin(-1, keepdim=True), 1.0))
    axis = torch.where(lost, _unit(other, other), cross / torch.where(lost, torch.ones_like(length), length))
    halves = torch.cat((middle.norm(dim=-1, keepdim=True), axis * (u - v).norm(dim=-1, keepdim=True)), -1)
    q = torch.where(dot < -0.9, halves, q)
    identity = q.new_tensor([1.0, 0.0, 0.0, 0.0]).expand_as(q)
    return quat_normalize(torch.where(safe, q, identity))


@numpy_or_torch
def quat_from_axis_angle(axis: Array, angle: Array) -> Array:
    """Unit axes ``(..., 3)`` and angles ``(...)`` in radians to quaternions ``(..., 4)``."""
    half = (_tensor_of(angle, axis) * 0.5)[..., None]
    vector = axis * half.sin()
    return torch.cat((half.cos().expand(*vector.shape[:-1], 1), vector), -1)


@numpy_or_torch
def quat_about_y(angle: Array) -> Array:
    """Rotations about the vertical by ``angle`` ``(...)``; positive turns +z towards +x (to the left)."""
    half = _tensor_of(angle) * 0.5
    zero = torch.zeros_like(half)
    return torch.stack((half.cos(), zero, half.sin(), zero), -1)


@numpy_or_torch
def quat_angle(a: Array, b: Array) -> Array:
    """The angle between rotations ``(..., 4)``, in ``[0, pi]`` radians: shape ``(...)``."""
    d = quat_mul(quat_inv(a), b)
    return 2.0 * torch.atan2(d[..., 1:].norm(dim=-1), d[..., 0].abs())


@numpy_or_torch
def quat_continuous(q: Array) -> Array:
    """Signs chosen so that neighbours in time agree; time is the third axis from the end of ``(..., T, J, 4)``.

    ``q`` and ``-q`` are the same rotation; a network or an interpolation needs the sequence without flips.
    """
    dots = (q[..., 1:, :, :] * q[..., :-1, :, :]).sum(-1, keepdim=True)
    signs = torch.where(dots < 0, -1.0, 1.0).to(q.dtype).cumprod(-3)
    return torch.cat((q[..., :1, :, :], q[..., 1:, :, :] * signs), -3)


@numpy_or_torch
def quat_slerp(a: Array, b: Array, t: Array) -> Array:
    """Between ``a`` (``t = 0``) and ``b`` (``t = 1``) along the shorter arc; ``t`` broadcasts to ``(..., 1)``."""
    dot = (a * b).sum(-1, keepdim=True)
    b = torch.where(dot < 0, -b, b)
    angle = 2.0 * torch.atan2((a - b).norm(dim=-1, keepdim=True), (a + b).norm(dim=-1, keepdim=True))
    sin = torch.sin(angle)
    near = sin < 1e-6
    sin = torch.where(near, torch.ones_like(sin), sin)
    wa = torch.where(near, 1.0 - t, torch.sin((1.0 - t) * angle) / sin)
    wb = torch.where(near, t + torch.zeros_like(sin), torch.sin(t * angle) / sin)
    return quat_normalize(wa * a + wb * b)


@numpy_or_torch
def quat_to_matrix(q: Array) -> Array:
    """Unit quaternions ``(..., 4)`` to matrices ``(..., 3, 3)``."""
    w, x, y, z = q.unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, -1).reshape(*q.shape[:-1], 3, 3)


@numpy_or_torch
def matrix_to_quat(m: Array) -> Array:
    """Matrices ``(..., 3, 3)`` to unit quaternions ``(..., 4)``.

    Of the four algebraically equal formulas (Shepperd 1978) the one that divides by the largest
    component is taken, element by element.
    """
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    s01, s02, s12 = (m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2])
    d0, d1, d2 = (m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1])
    candidates = torch.stack(  # row k is 4 * q[k] * q
        (
            torch.stack((1 + m00 + m11 + m22, d0, d1, d2), -1),
            torch.stack((d0, 1 + m00 - m11 - m22, s01, s02), -1),
            torch.stack((d1, s01, 1 - m00 + m11 - m22, s12), -1),
            torch.stack((d2, s02, s12, 1 - m00 - m11 + m22), -1),
        ),
        -2,
    )
    largest = candidates.diagonal(dim1=-2, dim2=-1).argmax(-1)
    row = candidates.gather(-2, largest[..., None, None].expand(*largest.shape, 1, 4)).squeeze(-2)
    return quat_normalize(row)


def check_order(order: str) -> str:
    """``order`` itself if it names each axis once, e.g. ``"ZXY"``; else a ``TutorialError``."""
    if order not in EULER_ORDERS:
        raise TutorialError(f"Euler order {order!r}: expected one of {', '.join(EULER_ORDERS)}")
    return order


def _axes(order: str) -> tuple[int, int, int, float]:
    """The axes' numbers, and +1 for an even permutation of x, y, z, -1 for an odd one."""
    i, j, k = (_AXES[a] for a in check_order(order))
    return i, j, k, 1.0 if (i + 1) % 3 == j else -1.0


@numpy_or_torch
def euler_to_quat(angles: Array, order: str) -> Array:
    """Intrinsic Euler angles ``(..., 3)`` in radians, listed as in ``order``, to quaternions ``(..., 4)``."""
    i, j, k, sign = _axes(order)
    ca, cb, cc = (angles * 0.5).cos().unbind(-1)
    sa, sb, sc = (angles * 0.5).sin().unbind(-1)
    # (ca + sa e_i)(cb + sb e_j)(cc + sc e_k) multiplied out, with e_i e_j = sign e_k
    parts = [ca * cb * cc - sign * sa * sb * sc, None, None, None]
    parts[1 + i] = sa * cb * cc + sign * ca * sb * sc
    parts[1 + j] = ca * sb * cc - sign * sa * cb * sc
    parts[1 + k] = ca * cb * sc + sign * sa * sb * cc
    return torch.stack(parts, -1)


@numpy_or_torch
def quat_to_euler(q: Array, order: str) -> Array:
    """Quaternions ``(..., 4)`` to intrinsic Euler angles ``(..., 3)``; the middle one lies in [-pi/2, pi/2].

    At the middle angle's limits (gimbal lock) the last angle is zero. Exact near those limits too, in single
    precision as in double: half the sum and half the difference of the outer angles are found one by one
    (Bernardes and Viollet 2022, "Quaternion to Euler angles conversion", for intrinsic orders).
    """
    i, j, k, sign = _axes(order)
    w, qi, qj, qk = q[..., 0], q[..., 1 + i], q[..., 1 + j], sign * q[..., 1 + k]
    size = q.norm(dim=-1)
    # from the product in euler_to_quat: w +- qj and qi +- qk have a common factor cos(b/2) +- sin(b/2)
    up, half_sum, up_locked = _polar(w + qj, qi + qk, size)
    down, half_difference, down_locked = _polar(w - qj, qi - qk, size)
    half_sum = torch.where(up_locked, half_difference, half_sum)
    half_difference = torch.where(down_locked, half_sum, half_difference)
    b = 2.0 * torch.atan2(up, down) - math.pi / 2
    a, c = half_sum + half_difference, sign * (half_sum - half_difference)
    a, c = (x - 2 * math.pi * torch.round(x / (2 * math.pi)) for x in (a, c))
    return torch.stack((a, b.clamp(-math.pi / 2, math.pi / 2), c), -1)


def _polar(x: torch.Tensor, y: torch.Tensor, size: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Radius and angle of ``(x, y)``, and where it is rounding noise: there both are zero, their gradients too."""
    square = x * x + y * y
    noise = square <= (16 * torch.finfo(x.dtype).eps * size) ** 2
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    radius = torch.where(noise, zero, torch.where(noise, one, square).sqrt())
    return radius, torch.atan2(torch.where(noise, zero, y), torch.where(noise, one, x)), noise


@numpy_or_torch
def quat_to_sixd(q: Array) -> Array:
    """Quaternions ``(..., 4)`` to the matrix's first two columns ``(..., 6)`` (Zhou et al. 2019)."""
    m = quat_to_matrix(q)
    return torch.cat((m[..., :, 0], m[..., :, 1]), -1)


@numpy_or_torch
def sixd_to_quat(d: Array) -> Array:
    """Any six numbers ``(..., 6)`` to a rotation ``(..., 4)``, by Gram-Schmidt (Zhou et al. 2019, eq. 15).

    Vectors too short or too parallel to define a rotation fall back on the coordinate axes, never NaN.
    """
    x, y = d[..., :3], d[..., 3:]
    ex, ey, ez = (d.new_tensor(e).expand_as(x) for e in ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]))
    x = _unit(x, ex)
    size = y.norm(dim=-1, keepdim=True)
    y = y - (x * y).sum(-1, keepdim=True) * x
    parallel = y.norm(dim=-1, keepdim=True) < 8 * torch.finfo(y.dtype).eps * size
    y = torch.where(parallel, torch.zeros_like(y), y)  # what is left of parallel vectors is rounding noise
    aligned = x[..., 1:2].abs() > 0.9
    fallback = torch.where(aligned, ez, ey)
    fallback = fallback - (x * fallback).sum(-1, keepdim=True) * x
    y = _unit(y, fallback / fallback.norm(dim=-1, keepdim=True))
    return matrix_to_quat(torch.stack((x, y, torch.linalg.cross(x, y)), -1))


def _unit(v: torch.Tensor, fallback: torch.Tensor) -> torch.Tensor:
    norm = v.norm(dim=-1, keepdim=True)
    tiny = norm < 1e-8
    return torch.where(tiny, fallback, v / torch.where(tiny, torch.ones_like(norm), norm))
