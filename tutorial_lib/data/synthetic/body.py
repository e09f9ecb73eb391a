"""The person: a 24-joint skeleton, and poses solved from where pelvis, trunk, feet and hands are.

Lengths are shares of the body height from Drillis and Contini (1966), as in figure 4.1 of Winter,
*Biomechanics and Motor Control of Human Movement*. Angles are radians; rotations inside this package
are matrices ``(T, 3, 3)``. The body looks along +z, its left is +x, y is up.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...errors import MotionError
from ...motion.clip import Motion
from ...motion.rotations import matrix_to_quat, quat_continuous
from ...motion.skeleton import Skeleton
from .signals import smooth, smooth_above

HEIGHT = 1.7
SIDES = ("Left", "Right")
_SIGN = {"Left": 1.0, "Right": -1.0}

# name, parent, offset from the parent as a share of the body height (left side; the right mirrors it)
_TREE = (
    ("Hips", None, (0.0, 0.0, 0.0)),
    ("Spine", "Hips", (0.0, 0.055, -0.004)),
    ("Chest", "Spine", (0.0, 0.088, -0.004)),
    ("Neck", "Chest", (0.0, 0.152, -0.004)),
    ("Head", "Neck", (0.0, 0.056, 0.010)),
    ("HeadTop", "Head", (0.0, 0.090, 0.004)),
    ("LeftShoulder", "Chest", (0.016, 0.118, 0.002)),
    ("LeftArm", "LeftShoulder", (0.089, 0.002, -0.008)),
    ("LeftForeArm", "LeftArm", (0.172, 0.0, 0.0)),
    ("LeftHand", "LeftForeArm", (0.146, 0.0, 0.0)),
    ("LeftHandTip", "LeftHand", (0.100, 0.0, 0.0)),
    ("LeftUpLeg", "Hips", (0.052, -0.029, 0.0)),
    ("LeftLeg", "LeftUpLeg", (0.0, -0.245, 0.0)),
    ("LeftFoot", "LeftLeg", (0.0, -0.246, 0.0)),
    ("LeftToe", "LeftFoot", (0.0, -0.027, 0.080)),
)
ANKLE_HEIGHT = 0.039 * HEIGHT
BALL_HEIGHT = ANKLE_HEIGHT - 0.027 * HEIGHT  # the ball's joint stands this high above the ground
BALL = np.array([0.0, -0.027, 0.080]) * HEIGHT  # from the ankle
HEEL = np.array([0.0, -0.039, -0.033]) * HEIGHT  # from the ankle: the point that strikes the ground
THIGH, SHANK = 0.245 * HEIGHT, 0.246 * HEIGHT
UPPER_ARM, FOREARM = 0.172 * HEIGHT, 0.146 * HEIGHT
HIP_DROP = 0.029 * HEIGHT
LEG = THIGH + SHANK


def sample_skeleton(height: float = HEIGHT) -> Skeleton:
    """The 24 joints of the sample motions, for a person of ``height`` metres, standing in a T-pose.

    The 21 common joints with ``HeadTop``, ``LeftHandTip`` and ``RightHandTip``; +z is forward,
    +x the left, +y up; there are no end sites.
    """
    if not (np.isfinite(height) and height > 0):
        raise MotionError(f"skeleton height {height}: expected a positive number of metres")
    middle = [row for row in _TREE if not row[0].startswith("Left")]
    arm = [row for row in _TREE if row[0].startswith("Left") and row[2][1] >= 0.0]
    leg = [row for row in _TREE if row[0].startswith("Left") and row[2][1] < 0.0]
    rows = middle + arm + _mirrored(arm) + leg + _mirrored(leg)
    names = [r[0] for r in rows]
    parents = [-1 if p is None else names.index(p) for _, p, _ in rows]
    offsets = np.array([o for *_, o in rows]) * height
    return Skeleton(names=tuple(names), parents=tuple(parents), offsets=offsets)


def _mirrored(rows):
    return [
        (name.replace("Left", "Right"), parent.replace("Left", "Right"), (-x, y, z)) for name, parent, (x, y, z) in rows
    ]


def rot_x(angle: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) about x: positive turns y towards z (leaning forward)."""
    return _rot(angle, 1, 2)


def rot_y(angle: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) about y: positive turns z towards x (to the left)."""
    return _rot(angle, 2, 0)


def rot_z(angle: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) about z: positive turns x towards y (the left side up)."""
    return _rot(angle, 0, 1)


def _rot(angle, i, j):
    angle = np.asarray(angle, float)
    m = np.zeros((*angle.shape, 3, 3))
    m[..., range(3), range(3)] = 1.0
    c, s = np.cos(angle), np.sin(angle)
    m[..., i, i] = m[..., j, j] = c
    m[..., j, i], m[..., i, j] = s, -s
    return m


def apply(m: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors ``v`` (..., 3) turned by matrices ``m`` (..., 3, 3)."""
    return (m @ np.asarray(v, float)[..., None])[..., 0]


def within(angle: np.ndarray, most: float) -> np.ndarray:
    """An angle softly kept between ``-most`` and ``most``; small ones hardly change."""
    return most * np.tanh(angle / most)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def _columns(x, y, z):
    return np.stack((x, y, z), -1)


@dataclass
class Foot:
    """One foot over T frames: a planted (or carried) sole and how far it rolls.

    base: (T, 3) where the ball would be if the foot were flat, minus its height: y is 0 on the ground.
    yaw: (T,) direction of the toes. pitch: (T,) toes up positive, rolling over the heel; toes down
    negative, rolling over the ball. toes: (T,) share of the roll that the toes do not follow, because
    they rest on the ground (1) or hang straight (0).
    """

    base: np.ndarray
    yaw: np.ndarray
    pitch: np.ndarray
    toes: np.ndarray

    def solve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ankle positions (T, 3), foot rotations and toe rotations (T, 3, 3), in the world."""
        up, down = split_roll(self.pitch)
        turn = rot_y(self.yaw)
        about_heel = turn @ rot_x(-up)
        foot = about_heel @ rot_x(-down)
        ball = np.array([0.0, BALL_HEIGHT, 0.0])
        heel = ball - BALL + HEEL  # from the base to the heel, flat
        ankle = self.base + apply(turn, heel) + apply(about_heel, ball - heel) - apply(foot, BALL)
        return ankle, foot, foot @ rot_x(down * self.toes)


def split_roll(pitch: np.ndarray, soft: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """The part of a pitch that rolls over the heel and the part over the ball, without a corner at 0."""
    up = pitch * np.exp(np.minimum(pitch, 0.0) / soft)
    return up, pitch - up


@dataclass
class Pose:
    """What the solver needs to know of T frames. Angles in radians, positions in metres.

    root: (T, 3) the pelvis; its height is an upper bound, lowered where a leg would not reach.
    pelvis: (T, 3, 3). feet: left and right. bend: (T, 3) trunk relative to the pelvis: forward, to the
    left side up, twist to the left. head: (T, 3, 3) in the world. shoulders: {side: (T, 2)} raised,
    and brought forward. Arms come later, when the chest is known: see ``Body.chest``.
    """

    root: np.ndarray
    pelvis: np.ndarray
    feet: tuple[Foot, Foot]
    bend: np.ndarray
    head: np.ndarray
    shoulders: dict[str, np.ndarray] = field(default_factory=dict)
    straight: float = 0.9985  # of the leg's length: the most that a knee straightens
    ankle: float = 0.45  # the most that an ankle bends, toes up, before the heel leaves the ground


class Body:
    """Solves a ``Pose`` from the ground up: legs, trunk and head at once, then arms, then a ``Motion``."""

    def __init__(self, pose: Pose, fps: float):
        self.skeleton = sample_skeleton()
        self.fps = fps
        self.n = len(pose.root)
        index = self.skeleton.index
        self.world = np.tile(np.eye(3), (self.n, self.skeleton.n_joints, 1, 1))
        self._index = {name: index(name) for name in self.skeleton.names}
        self._positions: dict[str, np.ndarray] = {}
        self.root = np.array(pose.root, float)
        self["Hips"] = pose.pelvis
        self._legs(pose)
        self._trunk(pose)

    def __getitem__(self, name: str) -> np.ndarray:
        """World rotation (T, 3, 3) of a joint already solved."""
        return self.world[:, self._index[name]]

    def __setitem__(self, name: str, rotation: np.ndarray) -> None:
        self.world[:, self._index[name]] = rotation

    def position(self, name: str) -> np.ndarray:
        """World position (T, 3) of a joint whose ancestors are solved."""
        j = self._index[name]
        parent = self.skeleton.parents[j]
        if parent < 0:
            return self.root
        above = self.skeleton.names[parent]
        return self.position(above) + self.world[:, parent] @ self.skeleton.offsets[j]

    # legs -------------------------------------------------------------------------------------------
    def _legs(self, pose: Pose) -> None:
        hips = {s: self["Hips"] @ self.skeleton.offsets[self._index[f"{s}UpLeg"]] for s in SIDES}
        feet = pose.feet
        for last in (False, True):
            solved = [foot.solve() for foot in feet]
            self.root = self._within_reach(pose.root, hips, [ankle for ankle, *_ in solved], pose.straight)
            bends = []
            for side, foot, (ankle, rotation, toe) in zip(SIDES, feet, solved, strict=True):
                bends.append(self._leg(side, self.root + hips[side], ankle, rotation, toe, foot.yaw))
            if not last:
                feet = tuple(self._lift_heel(foot, bend, pose.ankle) for foot, bend in zip(feet, bends, strict=True))

    def _within_reach(self, root, hips, ankles, share):
        """The pelvis lowered, smoothly, to where both legs reach their ankles."""
        excess = np.zeros(self.n)
        for side, ankle in zip(SIDES, ankles, strict=True):
            hip = root + hips[side]
            flat = ((hip - ankle)[:, (0, 2)] ** 2).sum(-1)
            top = ankle[:, 1] + np.sqrt(np.maximum((share * LEG) ** 2 - flat, 0.05))
            excess = np.maximum(excess, hip[:, 1] - top)
        lowered = root.copy()
        if excess.max() > 0:
            lowered[:, 1] -= smooth_above(excess, 0.05, self.fps)
        return lowered

    def _leg(self, side, hip, ankle, foot, toe, yaw):
        """Two-bone solution; the knee points between where pelvis and foot point. Returns the ankle's bend, toes up."""
        d = ankle - hip
        length = np.clip(np.linalg.norm(d, axis=-1), 0.25 * LEG, 0.9995 * LEG)
        ahead = np.stack((np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)), -1)
        pole = unit(0.45 * self["Hips"][:, :, 2] + 0.55 * ahead)
        d = unit(d)
        left = unit(np.cross(-d, pole))  # up x forward
        forward = np.cross(left, -d)
        a = np.arccos(np.clip((THIGH**2 + length**2 - SHANK**2) / (2 * THIGH * length), -1, 1))
        b = np.arccos(np.clip((SHANK**2 + length**2 - THIGH**2) / (2 * SHANK * length), -1, 1))
        frame = _columns(left, -d, forward)
        thigh, shank = frame @ rot_x(-a), frame @ rot_x(b)
        self[f"{side}UpLeg"], self[f"{side}Leg"] = thigh, shank
        self[f"{side}Foot"], self[f"{side}Toe"] = foot, toe
        local = np.swapaxes(shank, -1, -2) @ foot
        return np.arctan2(-local[:, 2, 1], local[:, 2, 2])

    def _lift_heel(self, foot: Foot, bend: np.ndarray, most: float) -> Foot:
        """Where the ankle bends more than ``most`` (toes up), the heel leaves the ground, softly."""
        excess = np.maximum(bend - most, 0.0)
        if excess.max() <= 0:
            return foot
        lift = smooth(smooth_above(excess, 0.04, self.fps), 0.02, self.fps)
        return Foot(foot.base, foot.yaw, foot.pitch - 1.25 * lift, foot.toes)

    # trunk and head -----------------------------------------------------------------------------------
    def _trunk(self, pose: Pose) -> None:
        forward, side, twist = pose.bend.T
        half = rot_y(0.5 * twist) @ rot_x(0.5 * forward) @ rot_z(0.5 * side)
        self["Spine"] = self["Hips"] @ half
        self["Chest"] = self["Spine"] @ half
        # neck and head share what is left between chest and gaze
        chest, head = self["Chest"], pose.head
        local = np.swapaxes(chest, -1, -2) @ head
        self["Neck"] = chest @ _part(local, 0.4)
        self["Head"] = self["HeadTop"] = head
        for side_name in SIDES:
            raised, ahead = pose.shoulders.get(side_name, np.zeros((self.n, 2))).T
            sign = _SIGN[side_name]
            self[f"{side_name}Shoulder"] = chest @ rot_y(-sign * ahead) @ rot_z(sign * raised)

    # arms ---------------------------------------------------------------------------------------------
    def set_arm(
        self,
        side: str,
        upper: np.ndarray,
        elbow: np.ndarray,
        pronation: np.ndarray | float = 0.0,
        wrist: np.ndarray | None = None,
    ) -> None:
        """An arm from its upper bone's world rotation (T, 3, 3), its elbow's bend and the palm's turn (T,).

        pronation turns the palm about the forearm; wrist: (T, 2) bend towards the palm, and to the thumb.
        """
        sign = _SIGN[side]
        fore = upper @ rot_y(-sign * elbow)
        turn = np.broadcast_to(np.asarray(pronation, float), (self.n,))
        half = rot_x(0.5 * turn)
        self[f"{side}Arm"] = upper
        self[f"{side}ForeArm"] = fore @ half
        hand = self[f"{side}ForeArm"] @ half
        if wrist is not None:
            hand = hand @ rot_z(-sign * wrist[:, 0]) @ rot_y(-sign * wrist[:, 1])
        self[f"{side}Hand"] = self[f"{side}HandTip"] = hand

    def reach(
        self,
        side: str,
        target: np.ndarray,
        elbow_towards: np.ndarray,
        pronation: np.ndarray | float = 0.0,
        wrist: np.ndarray | None = None,
    ) -> None:
        """An arm whose wrist goes to ``target`` (T, 3), or near where out of reach; the elbow points as told."""
        shoulder = self.position(f"{side}Arm")
        d = target - shoulder
        far = np.linalg.norm(d, axis=-1)
        arm = UPPER_ARM + FOREARM
        knee, most = 0.90 * arm, 0.985 * arm  # softly limited: no snap at full stretch
        length = np.where(far < knee, far, knee + (most - knee) * np.tanh((far - knee) / (most - knee)))
        length = np.maximum(length, 0.30 * arm)
        d = d / np.maximum(far, 1e-6)[:, None]
        pole = unit(elbow_towards - (elbow_towards * d).sum(-1, keepdims=True) * d)
        a = np.arccos(np.clip((UPPER_ARM**2 + length**2 - FOREARM**2) / (2 * UPPER_ARM * length), -1, 1))
        b = np.arccos(np.clip((FOREARM**2 + length**2 - UPPER_ARM**2) / (2 * FOREARM * length), -1, 1))
        u = np.cos(a)[:, None] * d + np.sin(a)[:, None] * pole
        hinge = np.cross(pole, d)
        self.set_arm(side, arm_frame(side, u, hinge), a + b, pronation, wrist)

    # result -------------------------------------------------------------------------------------------
    def motion(self, name: str) -> Motion:
        parents = np.array(self.skeleton.parents)
        above = self.world[:, np.maximum(parents, 0)].copy()
        above[:, 0] = np.eye(3)
        local = matrix_to_quat(np.swapaxes(above, -1, -2) @ self.world)
        return Motion.from_rotations(self.skeleton, self.fps, self.root, quat_continuous(local), name=name)


def arm_frame(side: str, direction: np.ndarray, hinge: np.ndarray) -> np.ndarray:
    """The upper arm's rotation from its direction and the elbow's axis, both (T, 3) and perpendicular."""
    sign = _SIGN[side]
    x, y = sign * direction, -sign * hinge
    return _columns(x, y, np.cross(x, y))


def hanging_arm(side: str, flexion: np.ndarray, abduction: np.ndarray, inward: np.ndarray) -> np.ndarray:
    """The upper arm's rotation (T, 3, 3) in the chest's frame: forward, sideways, turned inward; 0 hangs."""
    sign = _SIGN[side]
    down = np.array([[0.0, sign, 0.0], [-sign, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return rot_x(-flexion) @ rot_z(sign * abduction) @ rot_y(-sign * inward) @ down


def _part(rotation: np.ndarray, share: float) -> np.ndarray:
    """A rotation (T, 3, 3) about the same axis by a share of its angle (less than half a turn)."""
    cos = np.clip((np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2, -1, 1)
    angle = np.arccos(cos)
    axis = np.stack(
        (
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ),
        -1,
    )
    axis = unit(axis)
    k = np.zeros_like(rotation)
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    k -= np.swapaxes(k, -1, -2)
    s, c = np.sin(share * angle)[:, None, None], np.cos(share * angle)[:, None, None]
    return np.eye(3) + s * k + (1 - c) * (k @ k)
