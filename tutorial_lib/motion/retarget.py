"""Any known skeleton as the common one of 21 joints, so that data sets can be mixed and compared."""

from __future__ import annotations

import numpy as np

from ..errors import MotionError
from .clip import Motion
from .ik import rotations_from_positions
from .rotations import matrix_to_quat, quat_between, quat_mul, quat_rotate
from .skeleton import Skeleton
from .skeletons import COMMON_JOINTS, COMMON_PARENTS, common_indices

# Where each bone points in the common rest pose, a T-pose that faces +z with its left at +x.
# Hips and Chest carry several bones; theirs keep the shape that the source's body has.
_T_POSE = {
    "Chest": (0, 1, 0), "Head": (0, 1, 0),
    "LeftArm": (1, 0, 0), "LeftForeArm": (1, 0, 0), "LeftHand": (1, 0, 0),
    "RightArm": (-1, 0, 0), "RightForeArm": (-1, 0, 0), "RightHand": (-1, 0, 0),
    "LeftLeg": (0, -1, 0), "LeftFoot": (0, -1, 0), "LeftToe": (0, -0.5, 0.866),
    "RightLeg": (0, -1, 0), "RightFoot": (0, -1, 0), "RightToe": (0, -0.5, 0.866),
}  # fmt: skip
# joints with several bones: (left and right, up), which tell how the joint's own frame lies in the body;
# shoulders that start in one point (CMU) leave it to the arms
_FRAMES = {
    "Hips": ((("LeftUpLeg", "RightUpLeg"),), "Spine"),
    "Chest": ((("LeftShoulder", "RightShoulder"), ("LeftArm", "RightArm")), "Neck"),
}


def to_common(motion: Motion) -> Motion:
    """``motion`` on the 21 common joints, rooted at the hips.

    Joints are found by name; their positions are taken over exactly. Rotations are given against one rest
    pose for all data sets (a T-pose facing +z): bones point just where they did, and the twist about a bone
    is the source's own where it has rotations, none where it has not. Bones that join over several of the
    source's (the spine) may change length a little: the skeleton has their length at rest.
    Raises ``MotionError`` for a skeleton that is not known.
    """
    try:
        at = common_indices(motion.skeleton)
        skeleton, turns = common_skeleton(motion.skeleton)
    except MotionError as error:  # a skeleton does not know in which of many motions it is
        raise MotionError(f"motion {motion.name!r}: {error}" if motion.name else str(error)) from None
    nodes = [at[joint] for joint in COMMON_JOINTS]
    positions = motion.positions[:, nodes]
    reference = None
    if motion.rotations is not None:
        world = motion.skeleton.world_rotations(motion.rotations)[:, nodes]
        reference = skeleton.local_rotations(quat_mul(world, turns))
    rotations = rotations_from_positions(skeleton, positions, reference)
    return Motion(skeleton, motion.fps, positions, rotations, motion.name)


def common_skeleton(source: Skeleton) -> tuple[Skeleton, np.ndarray]:
    """The common skeleton with ``source``'s bone lengths, and ``(21, 4)`` rotations.

    The rotation of a joint takes vectors of the common joint's frame to the source joint's frame.
    """
    at = common_indices(source)
    rest = {joint: source.rest_pose()[j] for joint, j in at.items()}
    index = {joint: k for k, joint in enumerate(COMMON_JOINTS)}
    turns = np.zeros((len(COMMON_JOINTS), 4))
    offsets = np.zeros((len(COMMON_JOINTS), 3))
    for joint, parent in COMMON_PARENTS.items():
        k = index[joint]
        turns[k] = turns[index[parent]] if parent else (1.0, 0.0, 0.0, 0.0)
        if joint in _FRAMES:
            pairs, up = _FRAMES[joint]
            across = (rest[left] - rest[right] for left, right in pairs)
            left = next((a for a in across if np.linalg.norm(a) > 1e-6), np.zeros(3))
            turns[k] = _frame(left, rest[up] - rest[joint])
        else:
            child = next((c for c, p in COMMON_PARENTS.items() if p == joint and c in _T_POSE), None)
            if child is not None:
                turns[k] = _swing(turns[k], np.array(_T_POSE[child], dtype=np.float64), rest[child] - rest[joint])
        if parent:
            vector = rest[joint] - rest[parent]
            inverse = turns[index[parent]] * (1, -1, -1, -1)
            offsets[k] = quat_rotate(inverse, vector)
    parents = tuple(index[p] if p else -1 for p in COMMON_PARENTS.values())
    return Skeleton(COMMON_JOINTS, parents, offsets), turns


def _frame(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The rotation whose x axis is ``left`` and whose y axis is nearest to ``up``."""
    z = np.cross(left, up)
    if np.linalg.norm(z) < 1e-9:
        raise MotionError(
            "the skeleton's rest pose is flat: expected hips and shoulders with a width and a trunk above"
        )
    x, z = left / np.linalg.norm(left), z / np.linalg.norm(z)
    return matrix_to_quat(np.stack((x, np.cross(z, x), z), -1))


def _swing(turn: np.ndarray, direction: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """``turn`` with the smallest addition that takes ``direction`` to where ``seen`` points."""
    return quat_mul(quat_between(quat_rotate(turn, direction), seen), turn)
