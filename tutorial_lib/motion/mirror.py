"""A motion seen in a mirror: who turned left turns right. For augmentation, and to ask whether a gait is even."""

from __future__ import annotations

import numpy as np

from ..errors import MotionError
from .bvh import END_SUFFIX
from .clip import Motion
from .skeleton import Skeleton

# How the known skeletons call the two sides: at the beginning of a name, or at its end.
_WORDS, _LETTERS = ("Left", "Right"), ("l", "r")  # a name in a letter may be one in the middle: lowerback, root
_BEGINNINGS, _ENDS = (_WORDS, _LETTERS), (("_L", "_R"),)
_ACROSS = np.array([-1.0, 1.0, 1.0])  # of a place or a bone
_TURNED = np.array([1.0, 1.0, -1.0, -1.0])  # of a quaternion: M R M for the mirror M


def mirrored(motion: Motion) -> Motion:
    """``motion`` mirrored at the plane x = 0, left joints in the place of right ones: who faced +z still does.

    Its skeleton is the mirror image of the motion's, which is the same where a body is even. Mirrored twice it is the
    motion again. Raises ``MotionError`` for a skeleton whose joints are not told apart by left and right.
    """
    other = other_side(motion.skeleton)
    skeleton = motion.skeleton
    image = Skeleton(
        skeleton.names,
        skeleton.parents,
        skeleton.offsets[other] * _ACROSS,
        tuple(skeleton.orders[j] for j in other),
        skeleton.end_sites,
    )
    rotations = None if motion.rotations is None else motion.rotations[:, other] * _TURNED
    return Motion(image, motion.fps, motion.positions[:, other] * _ACROSS, rotations, motion.name)


def other_side(skeleton: Skeleton) -> list[int]:
    """For each node the one on the other side, by its name; a node in the middle is its own.

    Raises ``MotionError`` where there are no sides, where they do not hang together alike, or where one that is told to
    be left or right for sure has no partner.
    """
    index = {name: j for j, name in enumerate(skeleton.names)}
    other = [next((index[n] for n in _swapped(name) if n in index), j) for j, name in enumerate(skeleton.names)]
    for j, name in enumerate(skeleton.names):
        side = _without_end(name)[0]
        if other[j] == j and (side.startswith(_WORDS) or any(side.endswith(end) for end in _ENDS)):
            above = skeleton.parents[j]
            hangs = f", which hangs from {skeleton.names[above]!r}," if above >= 0 else ""
            raise MotionError(f"no mirror image: {name!r}{hangs} has no partner on the other side")
    if other == list(range(len(other))):
        raise MotionError(
            f"no mirror image: none of {len(other)} nodes ({', '.join(skeleton.names[:4])}, ...) is told to be left or "
            "right; expected names such as LeftFoot and RightFoot"
        )
    for j, parent in enumerate(skeleton.parents):
        if parent < 0:
            continue
        alone = other[j] == j and other[parent] != parent
        if alone or other[other[j]] != j or skeleton.parents[other[j]] < 0:
            raise MotionError(
                f"no mirror image: {skeleton.names[j]!r}, which hangs from {skeleton.names[parent]!r}, has no partner "
                "on the other side"
            )
        if skeleton.parents[other[j]] != other[parent]:
            raise MotionError(
                f"no mirror image: {skeleton.names[j]!r} hangs from {skeleton.names[parent]!r}, but "
                f"{skeleton.names[other[j]]!r} from {skeleton.names[skeleton.parents[other[j]]]!r}"
            )
    return other


def _swapped(name: str) -> list[str]:
    """What the same joint of the other side may be called."""
    found = []
    name, end = _without_end(name)
    for left, right in _BEGINNINGS:
        for a, b in ((left, right), (right, left)):
            if name.startswith(a):
                found.append(b + name.removeprefix(a) + end)
    for left, right in _ENDS:
        for a, b in ((left, right), (right, left)):
            if name.endswith(a):
                found.append(name.removesuffix(a) + b + end)
    return found


def _without_end(name: str) -> tuple[str, str]:
    """A name, of an end site that of its joint, where the side stands, and what follows it there."""
    bare = name.rstrip("_")  # the reader adds some where a joint has an end's name already
    end = name[len(bare) - len(END_SUFFIX) :] if bare.endswith(END_SUFFIX) else ""
    return name.removesuffix(end), end
