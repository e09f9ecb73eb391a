"""How far somebody went from the path that was asked for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..chance import numbers_of
from ..errors import MotionError
from ..metrics import moving_mean
from ..motion.clip import Motion
from ..motion.ground import check_path, path_length, path_offset
from ..representations import heading_joints
from .signals import check_fps

STRIDE = 1.1  # s; hip and shoulders sway once a stride, and 0.9 to 1.1 strides a second are walked
PASSED = 0.3  # m; a place of the path is passed by somebody who comes as near as this


@dataclass(frozen=True, eq=False)
class PathDeviation:
    """How far from a path somebody went.

    offset: ``(T,)`` metres from the path at each frame, positive to its left. A hip sways about a path that is walked
    well, some 2 to 4 cm to either side; ``drift`` ``(T,)`` is the offset's mean over the stride around each frame, from
    which the sway is gone (the offset is averaged, not the place, which would cut every corner).
    covered: share of the path that was passed within 0.3 m. Nearness alone cannot tell: who stands still at
    the start is near the path all the time.
    """

    offset: np.ndarray
    drift: np.ndarray
    covered: float

    @property
    def distance(self) -> np.ndarray:
        """``(T,)`` metres to the nearest place of the path."""
        return np.abs(self.offset)

    @property
    def mean(self) -> float:
        return float(self.distance.mean())

    @property
    def max(self) -> float:
        return float(self.distance.max())

    @property
    def mean_drift(self) -> float:
        return float(np.abs(self.drift).mean())

    def __str__(self) -> str:
        return (
            f"{100 * self.mean:.1f} cm from the path on average, {100 * self.max:.1f} at most, "
            f"{100 * self.mean_drift:.1f} without the hip's sway; {self.covered:.0%} of the path passed"
        )


def path_deviation(root: Motion | np.ndarray, path: Sequence, fps: float | None = None) -> PathDeviation:
    """How far a motion's hip, or places ``(T, 2)`` or ``(T, 3)`` of it, went from a path ``(N, 2)``, seen from above.

    path: what was asked for: the points drawn, whose corners somebody rounds, or ``PathControl.place``.
    fps: of places; a motion has its own. Without it a stride is taken to be 33 frames.
    Raises ``MotionError`` for no path, and for places of another shape or not finite.
    """
    path = check_path(path)
    if isinstance(root, Motion):
        place, fps = root.positions[:, heading_joints(root.skeleton)[0]], root.fps
    else:
        place = numbers_of(root, "root")
    if place.ndim != 2 or place.shape[1] not in (2, 3) or not len(place) or not np.isfinite(place).all():
        raise MotionError(f"root of shape {place.shape}: expected (T, 2) or (T, 3), places in metres, all finite")
    place = place[:, [0, -1]]
    offset = path_offset(place, path)
    window = max(1, round(STRIDE * (30.0 if fps is None else check_fps(fps))))
    edge = min(window, len(offset)) // 2
    drift = moving_mean(offset, min(window, len(offset)))
    drift = np.pad(drift, (edge, len(offset) - len(drift) - edge), mode="edge")
    if path_length(place) < 0.05:
        covered = 0.0
    else:
        at = np.r_[0.0, np.linalg.norm(np.diff(path, axis=0), axis=1).cumsum()]
        every = np.linspace(0.0, at[-1], max(20, min(2000, math.ceil(at[-1] / 0.05))))
        dense = np.stack([np.interp(every, at, path[:, c]) for c in (0, 1)], -1)
        covered = float(np.mean(np.abs(path_offset(dense, place)) <= PASSED))
    return PathDeviation(offset, drift, covered)
