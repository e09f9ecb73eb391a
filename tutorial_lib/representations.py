"""What a network is fed: a ``Motion`` as ``(T, D)`` features, and back.

========== =========================================== ======= ======================= ==================
name       features of a frame                         D       lost by ``encode``      source
========== =========================================== ======= ======================= ==================
positions  root displacement, positions about the root 3J      starting place          acRNN, section 3
hip-frame  positions in the body's frame on the        3J + 3  starting place (not the VAE-LSTM, section
           ground; turning, forward, sideways speed            height) and heading     4.1; Holden 2016
body-frame hip-frame, and rising speed                 3J + 4  starting place (not the Dynamic Future Net,
                                                               height) and heading     section 4
euler      root displacement, local Euler angles       3 + 3n  starting place          students' choice
quaternion root displacement, local quaternions        3 + 4n  starting place          Pavllo 2018
sixd       root displacement, local 6D rotations       3 + 6n  starting place          Zhou 2019
========== =========================================== ======= ======================= ==================

J counts nodes with end sites, n those that can turn. ``decode(encode(m), **origin(m))`` is ``m`` again, to
float32. What moves the figure (displacement, speeds) describes the step from the frame before to this one;
the first frame has none before it and repeats the second's. ``decode`` adds the steps up from the second
frame on.

The formulas stand once, in torch; every function takes numpy arrays or tensors and any leading axes.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch

from .errors import MotionError, TutorialError
from .motion.clip import Motion, same_rate
from .motion.rotations import (
    Array,
    euler_to_quat,
    numpy_or_torch,
    quat_about_y,
    quat_continuous,
    quat_mul,
    quat_normalize,
    quat_to_euler,
    quat_to_sixd,
    sixd_to_quat,
)
from .motion.skeleton import Skeleton
from .motion.skeletons import KNOWN_SKELETONS

RIGID_TOLERANCE = 1e-3  # metres by which a bone may differ from its offset before rotations cannot tell it


# -- building blocks ---------------------------------------------------------------------------------------


def _turn(x: torch.Tensor, z: torch.Tensor, sin: torch.Tensor, cos: torch.Tensor):
    """``(x, z)`` turned about the vertical by an angle with this sine and cosine; positive takes +z to +x."""
    return cos * x + sin * z, cos * z - sin * x


def _with_first(steps: torch.Tensor) -> torch.Tensor:
    """Steps ``(..., T - 1, C)`` between frames as ``(..., T, C)``: nothing is known of the step that led to
    the first frame, so it repeats the second's (T = 1: zero)."""
    first = steps[..., :1, :] if steps.shape[-2] else steps.new_zeros(*steps.shape[:-2], 1, steps.shape[-1])
    return torch.cat((first, steps), -2)


def _displacements(path: torch.Tensor) -> torch.Tensor:
    """``(..., T, C)`` places to the steps that led to them."""
    return _with_first(path[..., 1:, :] - path[..., :-1, :])


def _add_up(steps: torch.Tensor) -> torch.Tensor:
    """The inverse of ``_displacements``, for a path that starts at zero: the first step is not taken."""
    return torch.cat((torch.zeros_like(steps[..., :1, :]), steps[..., 1:, :]), -2).cumsum(-2)


def _place(positions: torch.Tensor, start) -> torch.Tensor:
    """``(..., T, J, 3)`` with the root at zero in frame 0, moved to ``start`` ``(..., 3)`` or ``(..., 2)`` = x, z.

    Without a height the lowest node of the first frame comes to stand on the ground.
    """
    start = torch.as_tensor(start, dtype=positions.dtype, device=positions.device)
    if start.shape[-1:] == (2,):
        x, z = start.unbind(-1)
        y = -positions[..., 0, :, 1].amin(-1)
        start = torch.stack(torch.broadcast_tensors(x, y, z), -1)
    elif start.shape[-1:] != (3,):
        raise MotionError(f"start of shape {tuple(start.shape)}: expected (x, z) or (x, y, z) in metres")
    return positions + start[..., None, None, :]


@numpy_or_torch
def euler_continuous(angles: Array) -> Array:
    """Euler angles ``(..., T, n, 3)`` without jumps in time: each frame written as near the last as can be.

    A rotation has two triples, ``(a, b, c)`` and ``(a + pi, pi - b, c + pi)``, and each angle may grow by
    whole turns. With the distance ``3 - cos(da) - cos(db) - cos(dc)``, which whole turns do not change, the
    second is the nearer one where ``cos(da) + cos(dc) + cos(b) cos(b') < 0`` (b' of the frame before).
    Swapping both frames keeps the distance, so the swaps of a whole sequence are a running parity and no loop
    is needed.
    """
    step = angles[..., 1:, :, :] - angles[..., :-1, :, :]
    cos_b = angles[..., 1].cos()
    agree = step[..., 0].cos() + step[..., 2].cos() + cos_b[..., 1:, :] * cos_b[..., :-1, :]
    swap = (agree < -1e-6).cumsum(-2) % 2 == 1
    other = angles[..., 1:, :, :] * angles.new_tensor([1.0, -1.0, 1.0]) + math.pi
    path = torch.cat((angles[..., :1, :, :], torch.where(swap[..., None], other, angles[..., 1:, :, :])), -3)
    turns = torch.round((path[..., 1:, :, :] - path[..., :-1, :, :]) / (2 * math.pi)).cumsum(-3)
    return torch.cat((path[..., :1, :, :], path[..., 1:, :, :] - 2 * math.pi * turns), -3)


_HEADING_JOINTS = ("Hips", "LeftUpLeg", "RightUpLeg", "LeftArm", "RightArm")


def heading_joints(skeleton: Skeleton) -> tuple[int, int, int, int, int]:
    """The nodes that are the hip, left and right upper leg, left and right upper arm.

    Raises ``MotionError`` naming what is missing where the skeleton has no such names.
    """
    names = set(skeleton.names)
    needed = [[table[joint] for joint in _HEADING_JOINTS] for table in KNOWN_SKELETONS.values()]
    for wanted in needed:
        if names.issuperset(wanted):
            return tuple(skeleton.names.index(name) for name in wanted)
    nearest = min(needed, key=lambda wanted: len(set(wanted) - names))
    raise MotionError(
        "heading: the body's direction comes from hips and shoulders, and this skeleton "
        f"({', '.join(skeleton.names[:4])}, ...) has no {', '.join(n for n in nearest if n not in names)}"
    )


def _facing(skeleton: Skeleton, positions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sine and cosine of the heading, ``(..., T)`` each."""
    _, left_leg, right_leg, left_arm, right_arm = heading_joints(skeleton)
    left = positions[..., left_leg, :] - positions[..., right_leg, :]
    left = left + positions[..., left_arm, :] - positions[..., right_arm, :]
    across = left[..., [0, 2]]  # its shadow on the ground
    length = across.norm(dim=-1)
    flat = length < 1e-6  # hips and shoulders exactly above each other: no direction, take +z
    length = torch.where(flat, torch.ones_like(length), length)
    sin = torch.where(flat, torch.zeros_like(length), -across[..., 1] / length)
    cos = torch.where(flat, torch.ones_like(length), across[..., 0] / length)
    return sin, cos


@numpy_or_torch
def heading(skeleton: Skeleton, positions: Array) -> Array:
    """Where the body faces, ``(..., T)`` radians in (-pi, pi], from ``(..., T, J, 3)`` positions in metres.

    Zero is +z, positive turns to the body's left (towards +x). Holden et al. 2016, section 4: the vectors
    across the hips and across the shoulders are added and crossed with the vertical. Holden also smooths the
    direction over time; here each frame stands for itself, so that a window of a clip is encoded as the clip is.
    Raises ``MotionError`` where the skeleton has no hips or shoulders of a known name.
    """
    return torch.atan2(*_facing(skeleton, positions))


@numpy_or_torch
def measure_control(place: Array, heading: Array, fps: float) -> Array:
    """What moves a body along the ground: turning, forward and sideways speed ``(..., T, 3)``, rad/s and m/s.

    place: ``(..., T, 2)`` x and z in metres; heading: ``(..., T)`` radians, 0 along +z, positive to the left
    (towards +x). Turning and sideways are positive to the left. The velocity of the step from the frame before is
    told in this frame's directions. The inverse of :func:`integrate_control`.
    """
    sin, cos = heading.sin(), heading.cos()
    return _speeds(place, sin, cos, fps)


def _speeds(place: torch.Tensor, sin: torch.Tensor, cos: torch.Tensor, fps: float) -> torch.Tensor:
    steps = place[..., 1:, :] - place[..., :-1, :]
    sideways, forward = _turn(steps[..., 0], steps[..., 1], -sin[..., 1:], cos[..., 1:])
    turning = torch.atan2(*_turn(sin[..., 1:], cos[..., 1:], -sin[..., :-1], cos[..., :-1]))
    return _with_first(torch.stack((turning, forward, sideways), -1) * fps)


@numpy_or_torch
def integrate_control(
    control: Array, fps: float, start: Sequence[float] = (0.0, 0.0), heading: float = 0.0
) -> tuple[Array, Array]:
    """Place ``(..., T, 2)`` (x, z, metres) and heading ``(..., T)`` (radians) of a body moved by a control
    ``(..., T, 3)`` as :func:`measure_control` tells it: the speeds added up from the second frame on.

    start: where the first frame is, ``(..., 2)``, or ``(..., 3)`` with a height that is not looked at; heading:
    where it faces, ``(...)``. Differentiable; NaN goes through. Raises ``MotionError`` for other shapes.
    """
    if control.ndim < 2 or control.shape[-1] != 3 or control.shape[-2] < 1:
        raise MotionError(
            f"control of shape {tuple(control.shape)}: expected (..., T, 3), turning, forward and sideways speed"
        )
    turning, forward, sideways = (control / fps).unbind(-1)
    heading = torch.as_tensor(heading, dtype=control.dtype, device=control.device)
    angle = heading[..., None] + _add_up(turning[..., None]).squeeze(-1)
    place = _add_up(torch.stack(_turn(sideways, forward, angle.sin(), angle.cos()), -1))  # (..., T, 2)
    start = torch.as_tensor(start, dtype=control.dtype, device=control.device)
    if start.shape[-1:] not in ((2,), (3,)):
        raise MotionError(f"start of shape {tuple(start.shape)}: expected (x, z) or (x, y, z) in metres")
    return place + start[..., None, [0, -1]], angle


# -- the representations -----------------------------------------------------------------------------------


class Representation(ABC):
    """How a ``Motion`` of one skeleton at one frame rate becomes ``(T, D)`` features, and back.

    skeleton, fps: what it was made for.
    dim: D.
    labels: D names, one a channel, such as ``"head.y"``.
    slices: where the named parts lie, ``"root"`` or ``"control"`` (what moves the figure) and ``"joints"``.
    parts: the names of these slices, known without a skeleton.
    uses_rotations: whether ``encode_arrays`` reads rotations (and of the positions only the root's).
    Two are equal when class, skeleton and frame rate are.
    """

    name: str
    parts: tuple[str, ...] = ("root", "joints")
    uses_rotations: bool = False

    def __init__(self, skeleton: Skeleton, fps: float):
        if not (np.isfinite(fps) and fps > 0):
            raise TutorialError(f"representation {self.name!r}: {fps} frames per second, expected a number above zero")
        self.skeleton = skeleton
        self.fps = float(fps)
        self.labels, self.slices = self._layout()
        self.dim = len(self.labels)

    # what each representation says for itself

    @abstractmethod
    def _layout(self) -> tuple[tuple[str, ...], dict[str, slice]]:
        """Labels and slices."""

    @abstractmethod
    def _encode(self, positions: torch.Tensor, rotations: torch.Tensor | None) -> torch.Tensor:
        """``(..., T, J, 3)`` and ``(..., T, J, 4)`` to ``(..., T, D)``."""

    @abstractmethod
    def _decode(self, features: torch.Tensor, start, heading) -> tuple[torch.Tensor, torch.Tensor | None]:
        """``(..., T, D)`` to positions ``(..., T, J, 3)`` and local rotations ``(..., T, J, 4)`` or None."""

    # what every caller uses

    def encode(self, motion: Motion) -> np.ndarray:
        """The features of a motion, ``(T, D)`` float32.

        Raises ``MotionError`` where the motion's skeleton or frame rate is not the representation's, and for
        representations by rotations where it has none or its bones change their length.
        """
        self.check(motion)
        return self.encode_arrays(motion.positions, motion.rotations).astype(np.float32)

    def decode(
        self, features: Array, *, start: Sequence[float] = (0.0, 0.0), heading: float = 0.0, name: str = ""
    ) -> Motion:
        """The motion that features ``(T, D)`` describe; any finite numbers give one.

        start: where the first frame's root (in ``"hip-frame"`` the hip) is, metres: ``(x, y, z)``, or
            ``(x, z)`` for the height at which the lowest node of the first frame stands on the ground. ``"hip-frame"``
            has the height in its features and takes x and z alone.
        heading: radians by which all of it is turned about the vertical through the start.
            ``"hip-frame"`` has lost the heading, so there it is the first frame's.
        Raises ``MotionError`` for features of another width or not finite.
        """
        if isinstance(features, torch.Tensor):
            features = features.detach().cpu().numpy()
        features = np.asarray(features, dtype=np.float64)
        if features.ndim != 2:
            raise MotionError(f"features of shape {features.shape}: expected (T, {self.dim})")
        self._check_features(features)
        if not np.isfinite(features).all():
            frame, channel = np.argwhere(~np.isfinite(features))[0]
            raise MotionError(f"features not finite at frame {frame}, {self.labels[channel]}: nothing to decode there")
        positions, rotations = self._decode(torch.from_numpy(features.copy()), start, heading)
        rotations = None if rotations is None else rotations.numpy()
        return Motion(self.skeleton, self.fps, positions.numpy(), rotations, name)

    @numpy_or_torch
    def encode_arrays(self, positions: Array, rotations: Array | None = None) -> Array:
        """``(..., T, J, 3)`` metres, and where ``uses_rotations`` also ``(..., T, J, 4)`` local unit
        quaternions, to features ``(..., T, D)`` of the same type; frames are taken to be ``1 / fps`` seconds apart.

        Where ``uses_rotations``, positions may be those of the root alone, ``(..., T, 1, 3)``.
        """
        nodes = self.skeleton.n_joints
        wanted = (1, nodes) if self.uses_rotations else (nodes,)
        if positions.ndim < 3 or positions.shape[-1] != 3 or positions.shape[-2] not in wanted:
            raise MotionError(f"positions of shape {tuple(positions.shape)}: expected (..., T, {nodes}, 3)")
        if self.uses_rotations and (rotations is None or tuple(rotations.shape[-2:]) != (nodes, 4)):
            found = "no rotations" if rotations is None else f"rotations of shape {tuple(rotations.shape)}"
            raise MotionError(f"{found}: representation {self.name!r} expects (..., T, {nodes}, 4)")
        return self._encode(positions, rotations)

    @numpy_or_torch
    def decode_positions(self, features: Array, start: Sequence[float] = (0.0, 0.0), heading: float = 0.0) -> Array:
        """Features ``(..., T, D)`` to positions ``(..., T, J, 3)`` in metres; differentiable.

        start and heading as in ``decode``, and they broadcast over the leading axes: ``(..., 2 or 3)`` and
        ``(...)``. NaN goes through, so that a network that diverged can be measured.
        """
        self._check_features(features)
        return self._decode(features, start, heading)[0]

    def origin(self, motion: Motion) -> dict:
        """What ``encode`` loses of a motion, as arguments of ``decode``: ``{"start": ..., "heading":
        ...}``."""
        return {"start": tuple(float(v) for v in motion.positions[0, 0]), "heading": 0.0}

    def check(self, motion: Motion) -> None:
        """Raise ``MotionError`` unless ``encode`` can take this motion; the message names both sides."""
        if not same_rate(motion.fps, self.fps):
            raise MotionError(
                f"{_called(motion)} runs at {motion.fps:g} frames per second, the representation "
                f"{self.name!r} at {self.fps:g}: expected motion.resample({self.fps:g})"
            )
        self.check_skeleton(motion)

    def check_skeleton(self, motion: Motion) -> None:
        """The part of ``check`` that does not depend on the frame rate."""
        mine, other = self.skeleton, motion.skeleton
        if mine.same_tree(other):
            return
        if mine.names != other.names and mine.n_joints == other.n_joints:
            j = next(j for j in range(mine.n_joints) if mine.names[j] != other.names[j])
            detail = f": node {j} is {other.names[j]!r} in the one and {mine.names[j]!r} in the other"
        else:
            detail = " in another tree" if mine.names == other.names else ""
        raise MotionError(
            f"{_called(motion)} has {other.n_joints} nodes with root {other.names[0]!r}, the representation "
            f"{self.name!r} was made for {mine.n_joints} with root {mine.names[0]!r}{detail}"
        )

    def _check_features(self, features) -> None:
        if features.ndim < 2 or features.shape[-1] != self.dim or features.shape[-2] < 1:
            raise MotionError(
                f"features of shape {tuple(features.shape)}: representation {self.name!r} of "
                f"{self.skeleton.n_joints} nodes expects (..., T, {self.dim}) with T >= 1"
            )

    def config(self) -> dict:
        """JSON-able; ``representation_from_config`` is its inverse."""
        return {"name": self.name, "fps": self.fps, "skeleton": self.skeleton.to_dict()}

    def __eq__(self, other) -> bool:
        return type(self) is type(other) and (self.fps, self.skeleton) == (other.fps, other.skeleton)

    def __hash__(self) -> int:
        return hash((self.name, self.fps, self.skeleton))

    def __repr__(self) -> str:
        return f"Representation({self.name!r}, {self.skeleton.n_joints} nodes, {self.fps:g} fps, D = {self.dim})"


def _called(motion: Motion) -> str:
    return f"motion {motion.name!r}" if motion.name else "the motion"


class Positions(Representation):
    """acRNN, section 3, "Data Representation": D = 3 J.

    Root displacement ``r_t - r_(t-1)`` in metres, all three coordinates; then for every other node
    ``j_t - r_t`` in metres along the world's axes, nodes in the skeleton's order. The speed lies in the
    displacement: at another frame rate the numbers change. Only the starting place is lost.
    """

    name = "positions"

    def _layout(self):
        labels = [f"root.d{a}" for a in "xyz"] + [f"{n}.{a}" for n in self.skeleton.names[1:] for a in "xyz"]
        return tuple(labels), {"root": slice(0, 3), "joints": slice(3, len(labels))}

    def _encode(self, positions, rotations):
        root = positions[..., :1, :]
        features = positions - root
        features[..., 0, :] = _displacements(root.squeeze(-2))
        return features.flatten(-2)

    def _decode(self, features, start, heading):
        nodes = features.unflatten(-1, (-1, 3))
        around = torch.cat((torch.zeros_like(nodes[..., :1, :]), nodes[..., 1:, :]), -2)
        positions = around + _add_up(features[..., :3])[..., None, :]
        return _place(_turned(positions, heading), start), None


def _turned(positions: torch.Tensor, heading) -> torch.Tensor:
    """``(..., T, J, 3)`` turned about the vertical through the origin by ``heading`` ``(...)`` radians."""
    heading = torch.as_tensor(heading, dtype=positions.dtype, device=positions.device)
    if heading.ndim == 0 and float(heading) == 0.0:
        return positions
    heading = heading[..., None, None]
    x, z = _turn(positions[..., 0], positions[..., 2], heading.sin(), heading.cos())
    return torch.stack((x, positions[..., 1], z), -1)


class HipFrame(Representation):
    """VAE-LSTM, section 4.1 (after Holden et al. 2016): D = 3 J + 3, 66 for its 21 joints.

    Every node's position in metres in a frame that stands on the ground below the hip and is turned with the
    body (``heading``): x to the body's left, y up from the ground, z forward; the hip's own x and z are
    always zero and stay in, as in the paper's count. Then the turning speed in rad/s (positive to the left),
    and the hip's forward and sideways velocity in m/s (positive to the left), in this frame's directions. The
    papers do not say which frame's directions; the frame before would do as well. Speeds are per second, so
    they do not depend on the frame rate. The starting place on the ground and the heading are lost, the
    height is not.
    """

    name = "hip-frame"
    parts = ("joints", "control", "turning", "forward", "sideways")

    def __init__(self, skeleton: Skeleton, fps: float):
        self._hip = heading_joints(skeleton)[0]
        super().__init__(skeleton, fps)

    def _layout(self):
        labels = [f"{n}.{a}" for n in self.skeleton.names for a in "xyz"] + ["turning", "forward", "sideways"]
        n = len(labels)
        slices = {"joints": slice(0, n - 3), "control": slice(n - 3, n)}
        slices |= {label: slice(n - 3 + k, n - 2 + k) for k, label in enumerate(labels[-3:])}
        return tuple(labels), slices

    def _encode(self, positions, rotations):
        sin, cos = _facing(self.skeleton, positions)  # (..., T)
        hip = positions[..., self._hip, :][..., [0, 2]]  # (..., T, 2)
        x, z = (positions[..., 2 * k] - hip[..., k, None] for k in (0, 1))
        x, z = _turn(x, z, -sin[..., None], cos[..., None])  # (..., T, J)
        joints = torch.stack((x, positions[..., 1], z), -1).flatten(-2)
        return torch.cat((joints, _speeds(hip, sin, cos, self.fps)), -1)

    def _decode(self, features, start, heading):
        joints = features[..., : self.dim - 3].unflatten(-1, (-1, 3))  # (..., T, J, 3)
        path, angle = integrate_control(features[..., self.dim - 3 :], self.fps, start, heading)
        sin, cos = angle.sin(), angle.cos()
        # the hip is the frame's origin by definition, whatever a network wrote there
        at_hip = torch.zeros(self.skeleton.n_joints, dtype=torch.bool, device=features.device)
        at_hip[self._hip] = True
        x, z = (joints[..., k].masked_fill(at_hip, 0.0) for k in (0, 2))
        x, z = _turn(x, z, sin[..., None], cos[..., None])
        return torch.stack((x + path[..., :1], joints[..., 1], z + path[..., 1:]), -1), None

    def origin(self, motion: Motion) -> dict:
        """The hip's place ``(x, z)`` and the heading of the first frame."""
        hip = motion.positions[0, self._hip]
        return {
            "start": (float(hip[0]), float(hip[2])),
            "heading": float(heading(self.skeleton, motion.positions[:1])[0]),
        }


class BodyFrame(HipFrame):
    """Dynamic Future Net, section 4: D = 3 J + 4, its 76 for 24 joints, 67 for the 21 common ones.

    ``HipFrame``'s numbers, and one more: how fast the hip rises, m/s. The paper counts "3D joint positions, 4 for the
    global translation and rotation velocity" and tells of x-z velocity and turning; the fourth is read as the change
    of height. Joints are "relative to the root" there. Here the root's height is in the joints, as in ``HipFrame``, so
    that ``decode`` needs to add up no heights, which would drift: it takes no notice of the rising speed.
    """

    name = "body-frame"
    parts = (*HipFrame.parts, "rising", "velocity")

    def __init__(self, skeleton: Skeleton, fps: float):
        self._ground = HipFrame(skeleton, fps)
        super().__init__(skeleton, fps)

    @property
    def hip(self) -> int:
        """The node that stands above the frame's origin."""
        return self._hip

    def _layout(self):
        labels, slices = super()._layout()
        n = len(labels)
        return (*labels, "rising"), {**slices, "rising": slice(n, n + 1), "velocity": slice(n - 3, n + 1)}

    def _encode(self, positions, rotations):
        height = positions[..., self._hip, 1:2]  # (..., T, 1)
        rising = _displacements(height) * self.fps
        return torch.cat((self._ground._encode(positions, rotations), rising), -1)

    def _decode(self, features, start, heading):
        return self._ground._decode(features[..., :-1], start, heading)

    def decode_turned(
        self,
        features: Array,
        rotations: Array,
        *,
        start: Sequence[float] = (0.0, 0.0),
        heading: float = 0.0,
        name: str = "",
    ) -> Motion:
        """``decode`` for features ``(T, D)`` of which the rotations are known: a motion with rotations, bones rigid.

        rotations: ``(T, J, 4)`` local ones, the root's in the body's frame, as forward kinematics gave the features'
        joints. The rest as for ``decode``.
        """  # fmt: skip
        motion = self.decode(features, start=start, heading=heading)
        control = np.asarray(features, dtype=np.float64)[:, self.slices["control"]]
        _, angle = integrate_control(control, self.fps, heading=heading)  # (T,)
        rotations = np.array(rotations, dtype=np.float64)
        rotations[:, 0] = quat_mul(quat_about_y(angle), rotations[:, 0])
        return Motion.from_rotations(self.skeleton, self.fps, motion.positions[:, 0], rotations, name=name)


class _Rotations(Representation):
    """Root displacement in metres along the world's axes, then the local rotation of every node that can turn.

    Bones are the skeleton's: they keep their length whatever a network says. Only the starting place is lost.
    """

    uses_rotations = True
    _channels: tuple[str, ...]

    def __init__(self, skeleton: Skeleton, fps: float):
        self._joints = list(skeleton.joints)
        # where each node's rotation stands in the features; end sites take the identity put behind them
        place = {j: k for k, j in enumerate(self._joints)}
        self._scatter = [place.get(j, len(self._joints)) for j in range(skeleton.n_joints)]
        super().__init__(skeleton, fps)

    @abstractmethod
    def _from_quat(self, q: torch.Tensor) -> torch.Tensor:
        """Unit quaternions ``(..., T, n, 4)`` to ``(..., T, n, C)``, continuous in time."""

    @abstractmethod
    def _to_quat(self, values: torch.Tensor) -> torch.Tensor:
        """Any numbers ``(..., T, n, C)`` to unit quaternions ``(..., T, n, 4)``."""

    def _layout(self):
        labels = [f"root.d{a}" for a in "xyz"]
        for j in self._joints:
            labels += [f"{self.skeleton.names[j]}.{c}" for c in self._channels_of(j)]
        return tuple(labels), {"root": slice(0, 3), "joints": slice(3, len(labels))}

    def _channels_of(self, joint: int) -> Sequence[str]:
        return self._channels

    def _encode(self, positions, rotations):
        values = self._from_quat(rotations[..., self._joints, :])
        return torch.cat((_displacements(positions[..., 0, :]), values.flatten(-2)), -1)

    def _decode(self, features, start, heading):
        turning = self._to_quat(features[..., 3:].unflatten(-1, (len(self._joints), -1)))
        still = turning.new_tensor([1.0, 0.0, 0.0, 0.0]).expand(*turning.shape[:-2], 1, 4)
        rotations = torch.cat((turning, still), -2)[..., self._scatter, :]
        positions = self.skeleton.fk(rotations, _add_up(features[..., :3]))
        heading = torch.as_tensor(heading, dtype=features.dtype, device=features.device)
        root = quat_mul(quat_about_y(heading)[..., None, :], rotations[..., 0, :])
        rotations = torch.cat((root[..., None, :], rotations[..., 1:, :]), -2)
        return _place(_turned(positions, heading), start), rotations

    def check_skeleton(self, motion: Motion) -> None:
        super().check_skeleton(motion)
        if motion.rotations is None:
            raise MotionError(
                f"{_called(motion)} has positions alone, the representation {self.name!r} needs rotations: "
                "expected a motion from a file, or rotations recovered with tutorial_lib.motion.ik"
            )
        rigid = self.skeleton.fk(motion.rotations, motion.positions[:, 0])
        if np.abs(rigid - motion.positions).max() <= RIGID_TOLERANCE:
            return
        found = motion.translations()[:, 1:]
        off = np.linalg.norm(found - self.skeleton.offsets[1:], axis=-1).max(0)
        j = 1 + int(np.argmax(off >= min(RIGID_TOLERANCE, off.max())))  # the first in the tree that moves
        raise MotionError(
            f"{_called(motion)}: joint {self.skeleton.names[j]!r} leaves its place on the bone by up to "
            f"{100 * off[j - 1]:.2g} cm; representation {self.name!r} needs rigid bones of the skeleton "
            "that it was made for: expected to_common(motion), a rigid copy by Motion.from_rotations, or "
            "'positions'"
        )


class Euler(_Rotations):
    """Euler angles in radians, each joint in its own order, D = 3 + 3 n; unwrapped in time
    (``euler_continuous``).

    Any numbers decode. Near gimbal lock (the middle angle at a quarter turn) the first and last angle may still
    run fast: that is the representation's weakness, and lesson 1 shows it.
    """

    name = "euler"

    def __init__(self, skeleton: Skeleton, fps: float):
        by_order: dict[str, list[int]] = {}
        for k, j in enumerate(skeleton.joints):
            by_order.setdefault(skeleton.orders[j], []).append(k)
        self._by_order = by_order
        back = np.argsort([k for ks in by_order.values() for k in ks])
        self._back = None if len(by_order) == 1 else back.tolist()
        super().__init__(skeleton, fps)

    def _channels_of(self, joint: int) -> Sequence[str]:
        return self.skeleton.orders[joint]

    def _each_order(self, function, values: torch.Tensor) -> torch.Tensor:
        parts = [function(values[..., ks, :], order) for order, ks in self._by_order.items()]
        return parts[0] if self._back is None else torch.cat(parts, -2)[..., self._back, :]

    def _from_quat(self, q):
        return euler_continuous(self._each_order(quat_to_euler, q))

    def _to_quat(self, values):
        return self._each_order(euler_to_quat, values)


class Quaternion(_Rotations):
    """Unit quaternions w, x, y, z; D = 3 + 4 n. Signs are continuous in time, the first frame's w not negative.

    Decoding normalises; four zeros give no rotation.
    """

    name = "quaternion"
    _channels = tuple("wxyz")

    def _from_quat(self, q):
        q = quat_continuous(q)
        return q * torch.where(q[..., :1, :, :1] < 0, -1.0, 1.0).to(q.dtype)

    def _to_quat(self, values):
        return quat_normalize(values)


class SixD(_Rotations):
    """The rotation matrix's first two *columns*, one after the other (Zhou et al. 2019); D = 3 + 6 n.

    The alternative, which some codes use, is its first two rows: the columns of the inverse rotation.
    Decoding orthonormalises by Gram-Schmidt; columns that are zero or parallel fall back on the axes.
    """

    name = "sixd"
    _channels = ("m00", "m10", "m20", "m01", "m11", "m21")

    def _from_quat(self, q):
        return quat_to_sixd(q)

    def _to_quat(self, values):
        return sixd_to_quat(values)


REPRESENTATIONS: dict[str, type[Representation]] = {
    c.name: c for c in (Positions, HipFrame, BodyFrame, Euler, Quaternion, SixD)
}


def make_representation(name: str, skeleton: Skeleton, fps: float) -> Representation:
    """The representation called ``name`` for a skeleton and a frame rate.

    name: ``"positions"``, ``"hip-frame"``, ``"body-frame"``, ``"euler"``, ``"quaternion"`` or ``"sixd"``.
    Raises ``TutorialError`` for another name, ``MotionError`` where ``"hip-frame"`` finds no hips and shoulders.
    """
    if name not in REPRESENTATIONS:
        raise TutorialError(f"unknown representation {name!r}: expected one of {', '.join(REPRESENTATIONS)}")
    return REPRESENTATIONS[name](skeleton, fps)


def representation_from_config(config: dict) -> Representation:
    """The representation that ``config()`` described; ``TutorialError`` says what is missing."""
    missing = [key for key in ("name", "fps", "skeleton") if not isinstance(config, dict) or key not in config]
    if missing:
        raise TutorialError(f"representation's description without {', '.join(missing)}: expected name, fps, skeleton")
    return make_representation(config["name"], Skeleton.from_dict(config["skeleton"]), config["fps"])
