"""The way along the ground: a smooth curve through given points, or a gentle random one."""

from __future__ import annotations

import numpy as np

from ...errors import MotionError
from .signals import noise, smooth

_STEP = 0.02  # metres between the points of the resampled path


class GroundPath:
    """A curve on the ground, asked for by the distance walked along it.

    A closed path (its ends within 5 cm) is followed round and round; an open one goes straight on
    where it ends, and came straight to where it begins.
    """

    def __init__(self, points: np.ndarray, rounding: float):
        """points: (N, 2) x and z in metres; rounding: metres of blur that take the sharp corners off."""
        points = _resampled(points)
        self._closed = len(points) > 25 and np.linalg.norm(points[0] - points[-1]) < 0.05
        if self._closed:
            points = points[:-1]
            pad = int(4 * rounding / _STEP) + 2
            wrapped = np.concatenate(
                [points[np.arange(-pad, 0) % len(points)], points, points[np.arange(pad) % len(points)]]
            )
            points = smooth(wrapped, rounding, 1 / _STEP)[pad:-pad]
            points = np.concatenate([points, points[:1]])
        else:
            run = int(4 * rounding / _STEP) + 2
            steps = _STEP * np.arange(1, run + 1)[:, None]
            first, last = points[0] - points[1], points[-1] - points[-2]
            before = points[0] + steps[::-1] * first / np.linalg.norm(first)
            after = points[-1] + steps * last / np.linalg.norm(last)
            points = smooth(np.concatenate([before, points, after]), rounding, 1 / _STEP)[run:-run]
        self._points = points
        self._s = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
        d = np.gradient(points, axis=0) if not self._closed else _wrapped_gradient(points)
        heading = np.unwrap(np.arctan2(d[:, 0], d[:, 1]))
        if self._closed:
            n, turn = len(heading) - 1, heading[-1] - heading[0]
            pad = np.arange(-n, 2 * n + 1)
            wound = heading[pad % n] + turn * np.floor(pad / n)
            self._heading = smooth(wound, 0.1, 1 / _STEP)[n : 2 * n + 1]
        else:
            self._heading = smooth(heading, 0.1, 1 / _STEP)

    @property
    def length(self) -> float:
        return float(self._s[-1])

    def position(self, s: np.ndarray) -> np.ndarray:
        """x and z (..., 2) at the distances ``s`` (...)."""
        on, rest, _ = self._split(s)
        place = np.stack([np.interp(on, self._s, self._points[:, k]) for k in (0, 1)], -1)
        heading = np.interp(on, self._s, self._heading)
        return place + rest[..., None] * np.stack([np.sin(heading), np.cos(heading)], -1)

    def heading(self, s: np.ndarray) -> np.ndarray:
        """The direction (...) in radians from +z towards +x, without jumps, at the distances ``s``."""
        on, _, rounds = self._split(s)
        return np.interp(on, self._s, self._heading) + rounds * (self._heading[-1] - self._heading[0])

    def curvature(self, s: np.ndarray) -> np.ndarray:
        """Radians of turn per metre, left positive."""
        return (self.heading(s + 0.05) - self.heading(s - 0.05)) / 0.1

    def _split(self, s):
        s = np.asarray(s, float)
        if self._closed:
            rounds = np.floor(s / self.length)
            return s - rounds * self.length, np.zeros_like(s), rounds
        on = np.clip(s, 0.0, self.length)
        return on, s - on, np.zeros_like(s)


def check_path(path) -> np.ndarray:
    """The points as an array (N, 2), or a one-line error."""
    try:
        points = np.asarray(path, float)
    except (TypeError, ValueError):
        raise MotionError("path: expected numbers, an array (N, 2) of x and z in metres") from None
    if points.ndim != 2 or points.shape[1] != 2:
        raise MotionError(f"path of shape {points.shape}: expected (N, 2), x and z in metres")
    if not np.isfinite(points).all():
        raise MotionError(f"path: point {int(np.argmin(np.isfinite(points).all(1)))} is not finite, expected metres")
    if len(points) < 2 or np.linalg.norm(np.diff(points, axis=0), axis=1).sum() < 0.05:
        raise MotionError(f"path of {len(points)} points: expected at least two, 5 cm apart or more")
    return points


def random_path(rng: np.random.Generator, length: float, speed: float) -> np.ndarray:
    """Points (N, 2) of a wandering path of that length in metres, with turns that suit the speed."""
    s = np.arange(0.0, length + 4.0, 0.1)
    slow = max(speed, 1.0)
    turn = noise(rng, s, 0.22 / slow, 0.02 / slow, 0.12 / slow)  # radians per metre
    limit = 0.55 / slow
    heading = np.cumsum(limit * np.tanh(turn / limit)) * 0.1
    heading += rng.uniform(-np.pi, np.pi)
    d = np.stack([np.sin(heading), np.cos(heading)], -1) * 0.1
    return d.cumsum(0) - d[0]


def _resampled(points):
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], steps > 1e-9])]
    s = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    at = np.linspace(0.0, s[-1], max(3, int(np.ceil(s[-1] / _STEP)) + 1))
    return np.stack([np.interp(at, s, points[:, k]) for k in (0, 1)], -1)


def _wrapped_gradient(points):
    d = np.empty_like(points)
    d[1:-1] = points[2:] - points[:-2]
    d[0] = d[-1] = points[1] - points[-2]
    return d
