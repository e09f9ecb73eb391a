"""Planned steps: where each foot stands, when it moves, and where the weight is between them."""

from __future__ import annotations

import numpy as np

from . import body
from .body import Foot
from .signals import Track, bump, smooth


class PlannedFoot:
    """One foot: planted at a place, and carried to the next by steps told in the order of time."""

    def __init__(self, place: np.ndarray, yaw: float, heel: float = 0.0):
        """place: (2,) x and z of the ball in metres; yaw: of the toes; heel: radians that it is raised."""
        self.place, self.yaw = Track(place), Track(yaw)
        self.heel = Track(heel)
        self._steps: list[tuple[float, float, float, float]] = []

    def free_from(self) -> float:
        """The time from which this foot may move again."""
        return self._steps[-1][1] if self._steps else -np.inf

    def step(
        self, start: float, end: float, place: np.ndarray, yaw: float, lift: float = 0.05, roll: float = 0.35
    ) -> None:
        """Carry the foot; lift: metres at the top; roll: radians that the toes hang while it leaves."""
        start = max(start, self.free_from() + 0.02)
        end = max(end, start + 0.12)
        self.place.move(start, end, place)
        self.yaw.move(start, end, yaw)
        self._steps.append((start, end, lift, roll))

    def pivot(self, start: float, end: float, yaw: float, heel: float = 0.15) -> None:
        """Turn on the ball: it stays, the heel is raised a little and comes round."""
        start = max(start, self.free_from() + 0.02)
        end = max(end, start + 0.12)
        self.yaw.move(start, end, yaw)
        self._steps.append((start, end, 0.0, heel))

    def foot(self, t: np.ndarray) -> Foot:
        """The planned foot over the times ``t`` (T,)."""
        place = self.place(t)
        base = np.stack([place[:, 0], np.zeros(len(t)), place[:, 1]], -1)
        pitch = -self.heel(t)
        toes = np.ones(len(t))
        if self._steps:
            start, end, lift, roll = np.array(self._steps).T
            k = np.clip(np.searchsorted(start, t, side="right") - 1, 0, None)
            tau = np.clip((t - start[k]) / (end[k] - start[k]), 0.0, 1.0)
            base[:, 1] = lift[k] * bump(tau**0.85)
            carried = lift[k] > 0
            # the heel leaves first and the toes hang; the other way round, a little, before landing
            pitch = pitch - roll[k] * np.where(carried, bump(tau**0.7) - 0.25 * bump(tau**2.2), bump(tau))
            toes = 1.0 - np.where(carried, bump(tau), 0.0)
        return Foot(base, self.yaw(t), pitch, toes)


class Weight:
    """The share of the weight on the left foot over time, and the point on the ground under the pelvis."""

    def __init__(self, share: float = 0.5):
        self.share = Track(share)

    def shift(self, start: float, end: float, share: float) -> None:
        self.share.move(start, end, share)

    def under(self, t: np.ndarray, left: Foot, right: Foot, fps: float, lag: float = 0.09) -> np.ndarray:
        """x and z (T, 2) under the pelvis: between the feet's middles, by weight, smooth in time."""
        middles = [
            foot.base[:, ::2] - 0.55 * body.BALL[2] * np.stack([np.sin(foot.yaw), np.cos(foot.yaw)], -1)
            for foot in (left, right)
        ]
        share = self.share(t)[:, None]
        return smooth(share * middles[0] + (1 - share) * middles[1], lag, fps)


def forward_of(yaw: float | np.ndarray) -> np.ndarray:
    """The unit vector (..., 2), x and z, that looks along ``yaw``."""
    return np.stack([np.sin(yaw), np.cos(yaw)], -1)


def left_of(yaw: float | np.ndarray) -> np.ndarray:
    """The unit vector (..., 2), x and z, to the left of ``yaw``."""
    return np.stack([np.cos(yaw), -np.sin(yaw)], -1)
