"""``Motion``, the one value that everything passes on: who moves, how fast it was sampled, where every joint is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import MotionError
from .rotations import quat_about_y, quat_inv, quat_mul, quat_normalize, quat_rotate, quat_slerp
from .skeleton import Skeleton
from .skeletons import standing_height


@dataclass(frozen=True, eq=False)
class Motion:
    """``T`` frames of a skeleton of ``J`` nodes; immutable, its arrays read-only.

    positions: ``(T, J, 3)`` metres in the world, y up.
    rotations: ``(T, J, 4)`` local unit quaternions where they are known, else None (a network that
        generates positions knows none; ``tutorial_lib.motion.ik`` recovers them).
    fps: frames per second.
    Raises ``MotionError`` for shapes that do not fit, values that are not finite and rates not above zero.
    """

    skeleton: Skeleton
    fps: float
    positions: np.ndarray
    rotations: np.ndarray | None = None
    name: str = ""

    def __post_init__(self):
        put = object.__setattr__
        put(self, "fps", float(self.fps))
        put(self, "positions", _read_only(self.positions))
        if self.rotations is not None:
            put(self, "rotations", _read_only(self.rotations))
        what = self._called or "motion: "
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise MotionError(f"{what}{self.fps} frames per second, expected a number above zero")
        nodes = self.skeleton.n_joints
        for label, array, width in (("positions", self.positions, 3), ("rotations", self.rotations, 4)):
            if array is None:
                continue
            if array.ndim != 3 or array.shape[1:] != (nodes, width) or len(array) == 0:
                raise MotionError(f"{what}{label} of shape {array.shape}, expected (T, {nodes}, {width}) with T >= 1")
            if not np.isfinite(array).all():
                frame, node, _ = np.argwhere(~np.isfinite(array))[0]
                raise MotionError(f"{what}{label} not finite at frame {frame}, joint {self.skeleton.names[node]!r}")
        if self.rotations is not None and len(self.rotations) != len(self.positions):
            raise MotionError(
                f"{what}{len(self.rotations)} frames of rotations for {len(self.positions)} frames of positions"
            )

    @classmethod
    def from_rotations(
        cls,
        skeleton: Skeleton,
        fps: float,
        root_positions: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray | None = None,
        name: str = "",
    ) -> Motion:
        """From the root's path ``(T, 3)`` and local rotations ``(T, J, 4)``, by forward kinematics.

        translations: ``(T, J, 3)`` metres in place of the skeleton's offsets, for bones that change.
        Raises ``MotionError`` for shapes that do not fit.
        """
        rotations = quat_normalize(np.asarray(rotations, dtype=np.float64))
        root_positions = np.asarray(root_positions, dtype=np.float64)
        if rotations.ndim != 3 or root_positions.shape != (len(rotations), 3):
            raise MotionError(
                f"rotations of shape {rotations.shape} with root positions of shape {root_positions.shape}: "
                f"expected (T, {skeleton.n_joints}, 4) and (T, 3)"
            )
        positions = skeleton.fk(rotations, root_positions, translations)
        return cls(skeleton, fps, positions, rotations, name)

    # -- size --------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def n_frames(self) -> int:
        """T."""
        return len(self.positions)

    @property
    def duration(self) -> float:
        """Seconds: T / fps."""
        return len(self) / self.fps

    @property
    def height(self) -> float:
        """Metres, of the skeleton standing (``standing_height``); no matter what this motion does."""
        return standing_height(self.skeleton)

    # -- parts and edits; each gives a new Motion ---------------------------------------------------------

    def __getitem__(self, frames: slice) -> Motion:
        """``motion[10:50]`` or ``motion[::4]``: some of its frames; a step of k divides the frame rate by k."""
        if not isinstance(frames, slice):
            raise MotionError(f"motion[{frames!r}]: expected a slice; for one pose take motion.positions[{frames!r}]")
        step = 1 if frames.step is None else frames.step
        if step < 1:
            raise MotionError(f"motion[::{step}]: expected a step of at least 1")
        if not range(*frames.indices(len(self))):
            raise MotionError(f"motion[{frames.start}:{frames.stop}]: no frame of the {len(self)} is in it")
        return self._with(
            positions=self.positions[frames],
            rotations=None if self.rotations is None else self.rotations[frames],
            fps=self.fps / step,
        )

    def resample(self, fps: float) -> Motion:
        """At ``fps`` frames a second. Whole ratios take frames as they are; others interpolate between two
        frames: rotations along the arc, positions along the line (the bones of a motion without rotations
        shorten by it, by less than a part in a thousand at 30 frames a second)."""
        if not (np.isfinite(fps) and fps > 0):
            raise MotionError(f"resample to {fps} frames per second: expected a number above zero")
        ratio, step = self.fps / fps, whole_ratio(self.fps, fps)
        if step:
            return self._with(
                positions=self.positions[::step],
                rotations=None if self.rotations is None else self.rotations[::step],
                fps=fps,
            )
        at = np.arange(int(np.floor((len(self) - 1) / ratio + 1e-9)) + 1) * ratio
        i = np.minimum(at.astype(int), len(self) - 1)
        j = np.minimum(i + 1, len(self) - 1)
        t = (at - i)[:, None, None]
        if self.rotations is None:
            return self._with(positions=(1 - t) * self.positions[i] + t * self.positions[j], fps=fps)
        rotations = quat_slerp(self.rotations[i], self.rotations[j], t)
        local = self.translations()
        local = (1 - t) * local[i] + t * local[j]
        positions = self.skeleton.fk(rotations, local[:, 0], local)
        return self._with(positions=positions, rotations=rotations, fps=fps)

    def rotate_y(self, angle: float) -> Motion:
        """Turned about the world's vertical axis by ``angle`` radians (positive: +z goes towards +x)."""
        turn = quat_about_y(np.float64(angle))
        rotations = self.rotations
        if rotations is not None:
            rotations = rotations.copy()
            rotations[:, 0] = quat_mul(turn, rotations[:, 0])
        return self._with(positions=quat_rotate(turn, self.positions), rotations=rotations)

    def translate(self, offset: Sequence[float]) -> Motion:
        """Moved by ``offset`` ``(3,)`` metres."""
        offset = np.asarray(offset, dtype=np.float64)
        if offset.shape != (3,):
            raise MotionError(f"translate by an offset of shape {offset.shape}: expected (x, y, z) in metres")
        return self._with(positions=self.positions + offset)

    def scaled(self, factor: float) -> Motion:
        """Every length ``factor`` times as long, the way that is travelled too."""
        if not (np.isfinite(factor) and factor > 0):
            raise MotionError(f"scale by {factor}: expected a number above zero")
        return self._with(skeleton=self.skeleton.scaled(factor), positions=self.positions * factor)

    def scaled_to(self, height: float) -> Motion:
        """Scaled so that the skeleton stands ``height`` metres tall (acRNN: 1.54 m)."""
        if self.height <= 0:
            raise MotionError(f"{self._called}scale to a height: the skeleton's rest pose has none")
        return self.scaled(height / self.height)

    def on_ground(self) -> Motion:
        """Moved up or down so that the ground is y = 0.

        The ground is where the lowest node is in the lowest hundredth of the frames: a single frame in which
        a marker slipped below the floor does not lift the whole clip.
        """
        return self.translate((0.0, -float(np.quantile(self.positions[:, :, 1].min(1), 0.01)), 0.0))

    def settled(self, seconds: float = 1.0) -> Motion:
        """Moved up and down in time so that the lowest node stays on the ground, y = 0, but for jumps.

        For generated motion whose height is added up from displacements, and drifts. What rises and comes down
        again within ``seconds`` is a jump and stays; a slower change of height is drift and goes. Nothing ends
        below the ground.
        """
        return self._with(positions=settled_positions(self.positions, self.fps, seconds))

    def without_end_sites(self) -> Motion:
        """Without the nodes that only mark the ends of bones."""
        keep = list(self.skeleton.joints)
        return self._with(
            skeleton=self.skeleton.subset(keep),
            positions=self.positions[:, keep],
            rotations=None if self.rotations is None else self.rotations[:, keep],
        )

    def with_name(self, name: str) -> Motion:
        """The same under another name."""
        return self._with(name=name)

    def translations(self) -> np.ndarray:
        """``(T, J, 3)`` metres: each node in its parent's frame; for rigid bones the skeleton's offsets again.

        The root's is its place in the world. Needs rotations.
        """
        if self.rotations is None:
            raise MotionError(f"motion {self.name!r} has positions alone: its local translations are not known")
        world = self.skeleton.world_rotations(self.rotations)
        parents = [max(p, 0) for p in self.skeleton.parents]
        local = quat_rotate(quat_inv(world[:, parents]), self.positions - self.positions[:, parents])
        local[:, 0] = self.positions[:, 0]
        return local

    @property
    def _called(self) -> str:
        """How a message about it begins, so that the one among many files is found."""
        return f"motion {self.name!r}: " if self.name else ""

    def _with(self, **changes) -> Motion:
        return dataclasses.replace(self, **changes)

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        kind = "rotations" if self.rotations is not None else "positions"
        return (
            f"Motion({name}{len(self)} frames at {self.fps:g} fps = {self.duration:.2f} s, "
            f"{self.skeleton.n_joints} nodes, {kind})"
        )


def as_list(motions: Motion | Sequence[Motion]) -> Sequence[Motion]:
    """One motion as a list of one; several as they are."""
    return [motions] if isinstance(motions, Motion) else motions


def some_names(motions: Sequence[Motion], most: int = 5) -> str:
    """The names of the first motions, for a message, and dots where there are more."""
    return ", ".join(repr(m.name) for m in motions[:most]) + (", ..." if len(motions) > most else "")


def _read_only(array: np.ndarray) -> np.ndarray:
    """``array`` as float64 that nobody can write to; copied unless it already is that."""
    array = np.asarray(array)
    if array.dtype != np.float64 or _can_change(array):
        array = array.astype(np.float64)
        array.setflags(write=False)
    return array


def _can_change(array: np.ndarray) -> bool:
    """Whether somebody may write to its memory: of a read-only view (``np.broadcast_to``) who has what it views."""
    while isinstance(array, np.ndarray):
        if array.flags.writeable:
            return True
        array = array.base
    return array is not None  # memory that is not numpy's: who writes there is not known


def whole_ratio(fps: float, rate: float) -> int:
    """``fps / rate`` where that is a whole number to a part in ten thousand (120 over 30 is 4), else 0.

    29.97 is not 30: taking every fourth frame of 120 for it would run a second late after a quarter of an hour.
    """
    ratio = fps / rate
    return round(ratio) if round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-4 * ratio else 0


def same_rate(fps: float, expected: float) -> bool:
    """Whether two frame rates are taken for one: within a thousandth, as files round them."""
    return abs(fps - expected) <= 1e-3 * expected


def settled_positions(positions: np.ndarray, fps: float, seconds: float = 1.0) -> np.ndarray:
    """``Motion.settled`` for an array ``(T, J, 3)``; what is not finite stays so, and spoils the frames about it."""
    from scipy.ndimage import grey_opening

    if not (np.isfinite(seconds) and seconds > 0):
        raise MotionError(f"settle over {seconds} seconds: expected a number above zero")
    # the opening cuts off peaks narrower than the window and follows everything else, from below
    ground = grey_opening(positions[:, :, 1].min(1), size=round(seconds * fps) | 1, mode="nearest")
    return positions - ground[:, None, None] * np.array([0.0, 1.0, 0.0])
