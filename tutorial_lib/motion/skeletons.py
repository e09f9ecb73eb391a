"""The skeletons that the data sets use, told by their joints' names, and the common one of 21 joints."""

from __future__ import annotations

import numpy as np

from ..errors import MotionError
from .skeleton import Skeleton

# name: parent; the joints that every full-body skeleton has, in the order of the VAE-LSTM's 21
COMMON_PARENTS = {
    "Hips": None, "Spine": "Hips", "Chest": "Spine", "Neck": "Chest", "Head": "Neck",
    "LeftShoulder": "Chest", "LeftArm": "LeftShoulder", "LeftForeArm": "LeftArm", "LeftHand": "LeftForeArm",
    "RightShoulder": "Chest", "RightArm": "RightShoulder", "RightForeArm": "RightArm", "RightHand": "RightForeArm",
    "LeftUpLeg": "Hips", "LeftLeg": "LeftUpLeg", "LeftFoot": "LeftLeg", "LeftToe": "LeftFoot",
    "RightUpLeg": "Hips", "RightLeg": "RightUpLeg", "RightFoot": "RightLeg", "RightToe": "RightFoot",
}  # fmt: skip
COMMON_JOINTS = tuple(COMMON_PARENTS)

_TRUNK = ("Hips", "Spine", "Chest", "Neck", "Head")
_SIDES = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "Toe")


def _table(centre: tuple[str, ...], left: tuple[str, ...], right: tuple[str, ...]) -> dict[str, str]:
    names = dict(zip(_TRUNK, centre, strict=True))
    for side, source in (("Left", left), ("Right", right)):
        names |= {side + part: name for part, name in zip(_SIDES, source, strict=True)}
    return {joint: names[joint] for joint in COMMON_JOINTS}


def _acrnn_side(s: str) -> tuple[str, ...]:
    return tuple(s + part for part in ("Collar", "Shldr", "ForeArm", "Hand", "Thigh", "Shin", "Foot", "Foot_end"))


def _bandai_side(s: str) -> tuple[str, ...]:
    parts = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toes")
    return tuple(f"{part}_{s}" for part in parts)


def _cmu_bvh_side(s: str) -> tuple[str, ...]:
    parts = ("clavicle_base", "clavicle", "humerus", "radius", "femur", "tibia", "foot", "toes")
    return tuple(s + part for part in parts)


def _cmu_side(s: str) -> tuple[str, ...]:
    parts = ("clavicle", "humerus", "radius", "wrist", "femur", "tibia", "foot", "toes")
    return tuple(s + part for part in parts)


# Which node of each known skeleton is which common joint. A table fits a skeleton that has all its names;
# the first that fits is taken.
KNOWN_SKELETONS: dict[str, dict[str, str]] = {
    "common": {joint: joint for joint in COMMON_JOINTS},
    "acrnn": _table(("hip", "abdomen", "chest", "neck", "head"), _acrnn_side("l"), _acrnn_side("r")),
    "bandai-namco": _table(("Hips", "Spine", "Chest", "Neck", "Head"), _bandai_side("L"), _bandai_side("R")),
    # CMU's 38-joint conversion names the arms' and the trunk's joints after the bone that ends there ...
    "cmu-bvh": _table(("root", "lowerback", "upperback", "lowerneck", "head"), _cmu_bvh_side("l"), _cmu_bvh_side("r")),
    # ... and CMU's own ASF/AMC files after the bone that begins there
    "cmu": _table(("root", "upperback", "thorax", "lowerneck", "head"), _cmu_side("l"), _cmu_side("r")),
}


def recognise(skeleton: Skeleton) -> str | None:
    """The name of the first of ``KNOWN_SKELETONS`` whose joints ``skeleton`` has, None if there is none."""
    names = set(skeleton.names)
    return next((k for k, table in KNOWN_SKELETONS.items() if names.issuperset(table.values())), None)


def common_indices(skeleton: Skeleton) -> dict[str, int]:
    """For each of ``COMMON_JOINTS`` the node of ``skeleton`` that is it, by name.

    Raises ``MotionError`` for a skeleton that is not known, with what is missing from the nearest table.
    """
    kind = recognise(skeleton)
    if kind is None:
        names = set(skeleton.names)
        near, table = min(KNOWN_SKELETONS.items(), key=lambda item: len(set(item[1].values()) - names))
        missing = [n for n in table.values() if n not in names]
        raise MotionError(
            f"unknown skeleton ({', '.join(skeleton.names[:6])}, ...): nearest is {near}, which would also have "
            f"{', '.join(missing[:6])}{', ...' if len(missing) > 6 else ''}"
        )
    index = {name: j for j, name in enumerate(skeleton.names)}
    return {joint: index[name] for joint, name in KNOWN_SKELETONS[kind].items()}


def standing_height(skeleton: Skeleton) -> float:
    """Metres from the lowest to the highest node when the figure stands (acRNN section 3: "in neutral pose").

    Where the rest pose is that neutral pose, its vertical extent. Some files' rest poses are not (Bandai-Namco's
    bones all lie along x); for those the straightened length of a leg and of the trunk up to the head, or, of a
    skeleton whose joints are not known by name, the rest pose's largest extent.
    """
    rest = skeleton.rest_pose()
    extent = float(np.ptp(rest[:, 1]))
    if recognise(skeleton) is None:
        largest = float(np.ptp(rest, axis=0).max())
        return extent if extent > 0.5 * largest else largest  # arms held out may span more than a body is high
    at = common_indices(skeleton)
    bones = ("LeftUpLeg", "LeftLeg"), ("LeftLeg", "LeftFoot"), *zip(_TRUNK, _TRUNK[1:], strict=False)
    chain = sum(float(np.linalg.norm(rest[at[a]] - rest[at[b]])) for a, b in bones)
    return extent if extent > 0.8 * chain else chain
