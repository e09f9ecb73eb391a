"""What a skeleton looks like: how thick its limbs are, where its head and feet are, which side is which.

All of it follows from lengths and the tree; names are asked only for left, right, head and eyes. So a
skeleton that nobody has seen before is drawn as a person, too.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ..motion.clip import Motion

MIDDLE, LEFT, RIGHT = 0, 1, 2


@dataclass(frozen=True)
class Body:
    """Drawing instructions for one skeleton; lengths in metres."""

    height: float
    root: int  # the pelvis: where the body is; above it in the tree there may be a mark on the ground
    radius: np.ndarray  # (J,) of the limb at each node
    side: tuple[int, ...]  # of each node: MIDDLE, LEFT or RIGHT
    groups: tuple[tuple[tuple[int, int], ...], ...]  # bones drawn as one shape: trunk, each arm, each leg
    torso: tuple[int, ...]  # left shoulder, left hip, right hip, right shoulder; or empty
    head: tuple[int, int, float, float] | None  # nodes a, b, k, radius: centre = b + k (b - a)
    feet: tuple[tuple[int, int], ...]  # (ankle, toe) of each foot


def describe(motion: Motion) -> Body:
    """The body of a motion's skeleton; what is up and what is down is asked of the motion itself.

    (Zero rotations need not be a standing pose: in some files they are a heap.)
    """
    parents, names = motion.skeleton.parents, motion.skeleton.names
    up = motion.positions[:, :, 1].mean(axis=0)
    length = np.concatenate([[0.0], motion.skeleton.bone_lengths])
    side = node_sides(names, parents)
    head_node = _head_node(names)
    hidden = _below(parents, head_node)  # a circle stands for all that lies inside the head
    reach = np.zeros(len(parents))  # way along the limb to its farthest tip
    for j in range(len(parents) - 1, 0, -1):
        reach[parents[j]] = max(reach[parents[j]], reach[j] + length[j])
    height = motion.height or float(reach[0]) or 1.0
    radius = np.maximum(0.038 * np.sqrt(reach * height), 0.0045 * height)
    radius = np.where(np.array(side) == MIDDLE, np.maximum(radius, 0.022 * height), radius)  # the neck

    root = _pelvis(motion)
    shapes: dict[int, list[tuple[int, int]]] = {0: []}  # the trunk first
    shape_of = {root: 0}
    for j, p in enumerate(parents):
        if j > root and j not in hidden:
            shape_of[j] = shape_of[p] if side[j] == side[p] else j
            shapes.setdefault(shape_of[j], []).append((p, j))
    if not any(shapes.values()):
        shapes[0].append((root, root))  # a point
    limbs = {start: bones for start, bones in shapes.items() if bones and side[start] != MIDDLE}
    joints = {start: _first_long_bone(bones, length) for start, bones in limbs.items()}
    torso = _torso(joints, side, up)
    return Body(
        height=height,
        root=root,
        radius=radius,
        side=side,
        groups=tuple(tuple(bones) for bones in shapes.values()),
        torso=torso,
        head=_head(head_node, motion, length, hidden, torso, height),
        feet=_feet(parents, side, up, length, hidden),
    )


def node_sides(names: tuple[str, ...], parents: tuple[int, ...]) -> tuple[int, ...]:
    """MIDDLE, LEFT or RIGHT for each node: a name has a side when its mirror image is a name, too."""
    known = {name.lower() for name in names}
    patterns = [("left", "right"), (r"(?<![a-z])l(?=[a-z])", "r"), (r"(?<![a-z])l(?![a-z])", "r")]

    def mirrored(name: str, swap: list[tuple[str, str]]) -> bool:
        return any(re.search(p, name) and re.sub(p, q, name, count=1) in known for p, q in swap)

    back = [("right", "left"), (r"(?<![a-z])r(?=[a-z])", "l"), (r"(?<![a-z])r(?![a-z])", "l")]
    sides: list[int] = []
    for name, parent in zip(names, parents, strict=True):
        name = name.lower()
        inherited = sides[parent] if parent >= 0 else MIDDLE
        own = LEFT if mirrored(name, patterns) else RIGHT if mirrored(name, back) else MIDDLE
        sides.append(inherited or own)
    return tuple(sides)


def _head_node(names: tuple[str, ...]) -> int:
    """Index of the first node named as the head, or -1."""
    return next((j for j, name in enumerate(names) if "head" in name.lower()), -1)


def _below(parents: tuple[int, ...], top: int) -> set[int]:
    below: set[int] = set()
    for j, p in enumerate(parents):
        if p >= 0 and (p == top or p in below):
            below.add(j)
    return below


def _pelvis(motion: Motion) -> int:
    """The first node, or the one that moves away from it where the first only marks a place on the ground."""
    node, children = 0, motion.skeleton.children
    while len(children[node]) == 1 and children[children[node][0]]:
        distance = np.linalg.norm(motion.positions[:, children[node][0]] - motion.positions[:, node], axis=1)
        if max(float(np.ptp(distance)), float(distance.min()) - 0.3 * motion.height) <= 0.05 * motion.height:
            break
        node = children[node][0]
    return node


def _first_long_bone(bones: list[tuple[int, int]], length: np.ndarray) -> int:
    """Where the upper arm or the thigh begins: a limb's longest bone, or the one before if about as long."""
    parent, longest = max(bones, key=lambda bone: length[bone[1]])
    before = [bone for bone in bones if bone[1] == parent and length[parent] >= 0.8 * length[longest]]
    return before[0][0] if before else parent


def _torso(joints: dict[int, int], side: tuple[int, ...], up: np.ndarray) -> tuple[int, ...]:
    ends = {
        s: sorted((j for start, j in joints.items() if side[start] == s), key=lambda j: up[j]) for s in (LEFT, RIGHT)
    }
    if len(ends[LEFT]) != 2 or len(ends[RIGHT]) != 2:
        return ()
    return ends[LEFT][1], ends[LEFT][0], ends[RIGHT][0], ends[RIGHT][1]


def _head(
    head: int, motion: Motion, length: np.ndarray, inside: set[int], torso: tuple[int, ...], height: float
) -> tuple[int, int, float, float] | None:
    """A circle on the neck's line: in the middle of the head's bone where there is one, else about its joint.

    The joint called head is the base of the skull in some skeletons and the crown in others; how far it
    is from the shoulders tells.
    """
    parents, at = motion.skeleton.parents, motion.positions
    if head < 0 or parents[head] < 0:
        return None
    neck = parents[head]
    while parents[neck] >= 0 and np.linalg.norm(at[0, head] - at[0, neck]) < 0.02 * height:
        neck = parents[neck]
    span = float(np.linalg.norm(at[:, head] - at[:, neck], axis=1).mean())
    if span == 0:
        return None
    size = 0.062 * height
    centre = 0.75 * size
    tips = [length[j] for j in inside if j in motion.skeleton.end_sites and parents[j] == head]
    if tips and max(tips) > size:
        centre = min(max(tips) / 2, 1.2 * size)
    elif torso:
        shoulders = (at[:, torso[0]] + at[:, torso[3]]) / 2
        if np.linalg.norm(at[:, head] - shoulders, axis=1).mean() > 0.11 * height:
            centre = -0.6 * size
    return neck, head, centre / span, size


def _feet(
    parents: tuple[int, ...], side: tuple[int, ...], up: np.ndarray, length: np.ndarray, hidden: set[int]
) -> tuple[tuple[int, int], ...]:
    """(ankle, toe) on each side: the tip that is lowest on average and the start of the foot it ends."""
    tips = [j for j in range(len(parents)) if j not in parents and j not in hidden and parents[j] >= 0]
    feet = []
    for s in (LEFT, RIGHT) if any(side) else (MIDDLE,):
        own = sorted((j for j in tips if side[j] == s), key=lambda j: up[j])
        for toe in own[: 1 if any(side) else 2]:
            ankle = parents[toe]
            while parents[ankle] >= 0 and length[ankle] < 0.6 * length.max():  # up to the shin's lower end
                ankle = parents[ankle]
            feet.append((ankle, toe))
    return tuple(feet)


def facing(motion: Motion, body: Body) -> float:
    """Where the figure faces in its first frame: radians about y, 0 along +z; 0 where it has no sides."""
    if not body.torso:
        return 0.0
    left, right = (motion.positions[0, body.torso[i]] for i in (1, 2))
    across = left - right
    return math.atan2(-across[2], across[0]) if np.hypot(across[0], across[2]) > 0 else 0.0


def ground_height(motion: Motion, body: Body) -> float:
    """Height (m) that the motion's ground is drawn at: 0, unless it plainly stands elsewhere."""
    lowest = float(np.quantile(motion.positions[:, :, 1].min(axis=1), 0.1))
    return 0.0 if abs(lowest) <= 0.06 * body.height else lowest


def footprints(motion: Motion, body: Body) -> list[tuple[int, int, int, float, float, float, float]]:
    """Where feet stood: (side, first frame, last frame, ankle x, ankle z, toe x, toe z), in metres.

    A foot stands while its toe is within 3 % of the body height of its usual lowest place and moves
    along the ground at less than 0.3 m/s, for at least 0.1 s.
    """
    prints = []
    for ankle, toe in body.feet:
        path = motion.positions[:, toe]
        if len(path) < 3:
            continue
        low = path[:, 1] < np.quantile(path[:, 1], 0.1) + 0.03 * body.height
        speed = np.linalg.norm(np.gradient(path[:, [0, 2]], axis=0), axis=1) * motion.fps
        standing = np.concatenate([[False], low & (speed < 0.3), [False]])
        edges = np.flatnonzero(np.diff(standing.astype(int)))
        for first, last in edges.reshape(-1, 2):
            if last - first >= 0.1 * motion.fps:
                middle = (first + last) // 2
                heel, tip = motion.positions[middle, ankle], path[middle]
                prints.append((body.side[toe], int(first), int(last) - 1, heel[0], heel[2], tip[0], tip[2]))
    return sorted(prints, key=lambda mark: mark[1])
