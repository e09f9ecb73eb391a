"""Rotations recovered from positions: for motion that a network gave as points."""

from __future__ import annotations

import numpy as np

from ..chance import numbers_of
from ..errors import MotionError
from .clip import Motion
from .rotations import matrix_to_quat, quat_between, quat_mul, quat_rotate
from .skeleton import Skeleton

_ZERO = 1e-6  # metres; a bone shorter than this has no direction


def rotations_from_positions(
    skeleton: Skeleton, positions: np.ndarray, reference: np.ndarray | None = None
) -> np.ndarray:
    """Local rotations ``(T, J, 4)`` that point every bone of ``skeleton`` as ``positions`` ``(T, J, 3)`` have it.

    Joint by joint from the root: where several bones leave a joint, the rotation that fits them best
    (Kabsch 1976); where one does, the smallest turn that points it right. What positions cannot tell is the
    turn about a bone's own axis, its twist: it is taken from ``reference`` (local rotations ``(T, J, 4)``)
    where given, or ``(1, J, 4)``, one pose for all frames; else none is added to the parent's.
    Raises ``MotionError`` for other shapes and for what is not finite.
    """
    nodes = skeleton.n_joints
    positions = _numbers("positions", positions, (nodes, 3))
    frames = len(positions)
    guide = None
    if reference is not None:
        reference = _numbers("reference rotations", reference, (nodes, 4))
        if len(reference) not in (1, frames):
            raise MotionError(f"reference rotations of {len(reference)} frames for positions of {frames}")
        guide = skeleton.world_rotations(reference)
    world = np.zeros((frames, nodes, 4))
    world[..., 0] = 1.0
    for j, parent in enumerate(skeleton.parents):
        if guide is not None:
            world[:, j] = guide[:, j]
        elif parent >= 0:
            world[:, j] = world[:, parent]
        bones = [] if j in skeleton.end_sites else _bones_from(skeleton, j)
        if not bones:
            continue
        ends = [end for end, _ in bones]
        rest = np.stack([vector for _, vector in bones])
        seen = positions[:, ends] - positions[:, j : j + 1]
        if len(bones) > 1 and np.linalg.matrix_rank(rest, tol=1e-3 * np.abs(rest).max()) > 1:
            world[:, j] = _fit(rest, seen)
        else:
            ahead = quat_rotate(world[:, j], rest[0])
            world[:, j] = quat_mul(quat_between(ahead, seen[:, 0]), world[:, j])
    return skeleton.local_rotations(world)


def _numbers(what: str, values: np.ndarray, last: tuple[int, int]) -> np.ndarray:
    values = numbers_of(values, what)
    if values.ndim != 3 or values.shape[1:] != last:
        raise MotionError(f"{what} of shape {values.shape}, expected (T, {last[0]}, {last[1]})")
    if not np.isfinite(values).all():
        bad = int(np.argmin(np.isfinite(values).all((1, 2))))
        raise MotionError(f"{what} not finite at frame {bad}")
    return values


def _bones_from(skeleton: Skeleton, j: int) -> list[tuple[int, np.ndarray]]:
    """The bones that leave joint j: (node at the end, vector at rest). Joints at the same place are passed over."""
    bones = []
    for child in skeleton.children[j]:
        if np.linalg.norm(skeleton.offsets[child]) > _ZERO:
            bones.append((child, skeleton.offsets[child]))
        else:
            bones += _bones_from(skeleton, child)
    return bones


def _fit(rest: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Rotations ``(T, 4)`` that turn vectors ``rest`` ``(K, 3)`` nearest to ``seen`` ``(T, K, 3)``: Kabsch's SVD."""
    u, _, vt = np.linalg.svd(np.einsum("tki,kj->tij", seen, rest))
    flip = np.ones((len(seen), 3))
    flip[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))  # a rotation, never a mirror image
    return matrix_to_quat((u * flip[:, None, :]) @ vt)


def with_rotations(motion: Motion) -> Motion:
    """``motion`` with rotations recovered from its positions, and bones as long as they are on average.

    Its positions stay as they are; a motion that has rotations is returned as it is.
    """
    if motion.rotations is not None:
        return motion
    skeleton, positions = motion.skeleton, motion.positions
    parents = [max(p, 0) for p in skeleton.parents]
    lengths = np.linalg.norm(positions - positions[:, parents], axis=-1).mean(0)
    at_rest = np.linalg.norm(skeleton.offsets, axis=-1)
    factor = np.where(at_rest > _ZERO, lengths / np.maximum(at_rest, _ZERO), 1.0)
    factor[0] = 1.0
    skeleton = Skeleton(
        skeleton.names, skeleton.parents, skeleton.offsets * factor[:, None], skeleton.orders, skeleton.end_sites
    )
    return Motion(skeleton, motion.fps, positions, rotations_from_positions(skeleton, positions), motion.name)
