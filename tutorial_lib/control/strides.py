"""Strides: where in its stride somebody is, how long the steps are and how many there are in a minute."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import find_peaks

from ..metrics import foot_joints
from ..motion.clip import Motion
from ..representations import heading, heading_joints

APART = 0.10  # m; feet that part by less make no step
SLOWEST = 0.9  # s between two steps; longer ones are not of one walk


@dataclass(frozen=True, eq=False)
class Strides:
    """The steps of a motion of ``T`` frames.

    A step is told by the moment at which one foot is farthest ahead of the other along the body's heading: there the
    feet of a walker are both on the ground, those of a runner far apart in the air. A stride is two steps.

    times: ``(N,)`` seconds of these moments. left: ``(N,)`` whether the left foot is ahead. lengths: ``(N,)`` metres
    from foot to foot. phase: ``(T,)`` radians, 0 where the left foot is ahead and pi where the right one is, rising by
    2 pi a stride; NaN where nobody walks.
    """

    times: np.ndarray
    left: np.ndarray
    lengths: np.ndarray
    phase: np.ndarray
    fps: float

    @property
    def steps(self) -> int:
        """N."""
        return len(self.times)

    @property
    def step_length(self) -> float:
        """Metres from foot to foot, mean over the steps; 0 without a step."""
        return float(self.lengths.mean()) if self.steps else 0.0

    @property
    def cadence(self) -> float:
        """Steps a minute while walking; 0 without two steps in a row."""
        rising = np.diff(self.phase)
        rising = rising[np.isfinite(rising)]
        return float(60 * self.fps * rising.mean() / np.pi) if len(rising) else 0.0

    @property
    def frequency(self) -> np.ndarray:
        """``(T,)`` strides a second, NaN where nobody walks."""
        if len(self.phase) < 2:
            return np.full(len(self.phase), np.nan)
        return np.gradient(self.phase) * self.fps / (2 * np.pi)


def find_strides(motion: Motion) -> Strides:
    """The steps of ``motion``; none where no foot passes the other by 10 cm.

    Raises ``MotionError`` for a skeleton whose feet, hips and shoulders are not known.
    """
    ahead = feet_apart(motion)
    silent = Strides(np.zeros(0), np.zeros(0, bool), np.zeros(0), np.full(len(motion), np.nan), motion.fps)
    if len(motion) < 3:
        return silent
    found = []
    for side in (1.0, -1.0):
        at, _ = find_peaks(side * ahead, height=APART / 2, prominence=APART)
        found += [(k + _vertex(side * ahead[k - 1 : k + 2]), side, side * ahead[k]) for k in at]
    found = _alternating(sorted(found))
    if not found:
        return silent
    frames, sides, lengths = (np.array(column) for column in zip(*found, strict=True))
    phase, first = np.full(len(motion), np.nan), 0
    breaks = np.flatnonzero(np.diff(frames) > SLOWEST * motion.fps) + 1
    for end in (*breaks.tolist(), len(frames)):  # each walk without a stop
        if end - first >= 2:
            at = frames[first:end]
            turns = np.pi * (np.arange(end - first) + (sides[first] < 0))
            inside = np.arange(np.ceil(at[0]), np.floor(at[-1]) + 1)
            phase[inside.astype(int)] = PchipInterpolator(at, turns)(inside)
        first = end
    return Strides(frames / motion.fps, sides > 0, lengths, phase, motion.fps)


def feet_apart(motion: Motion) -> np.ndarray:
    """How far the left ankle is ahead of the right one, along the body's heading: metres ``(T,)``."""
    heading_joints(motion.skeleton)  # an unknown skeleton is told by its name
    left, _, right, _ = foot_joints(motion.skeleton)
    apart = motion.positions[:, left] - motion.positions[:, right]
    angle = heading(motion.skeleton, motion.positions)
    return apart[:, 0] * np.sin(angle) + apart[:, 2] * np.cos(angle)


def _vertex(three: np.ndarray) -> float:
    """Where between its neighbours, -0.5 to 0.5, the parabola through a highest value is highest."""
    curve = three[0] - 2 * three[1] + three[2]
    return 0.0 if curve >= 0 else float(np.clip((three[0] - three[2]) / (2 * curve), -0.5, 0.5))


def _alternating(peaks: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """(frame, side, length) of steps to the left and to the right by turns: of two on one side the longer one stays."""
    kept: list[tuple[float, float, float]] = []
    for peak in peaks:
        if kept and kept[-1][1] == peak[1]:
            if peak[2] > kept[-1][2]:
                kept[-1] = peak
        else:
            kept.append(peak)
    return kept
