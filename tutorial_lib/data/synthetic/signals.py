"""Smooth signals in time: noise of a few slow waves, key frames, steps between values."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d


def noise(
    rng: np.random.Generator, t: np.ndarray, sd: float, low: float = 0.05, high: float = 0.6, waves: int = 6
) -> np.ndarray:
    """A smooth random signal over the times ``t`` (T,) in seconds, with standard deviation ``sd``.

    A sum of sine waves with random phases, their frequencies between ``low`` and ``high`` hertz.
    """
    frequency = low * (high / low) ** rng.random((waves, 1))
    phase = 2 * np.pi * rng.random((waves, 1))
    return sd * np.sqrt(2.0 / waves) * np.sin(2 * np.pi * frequency * t + phase).sum(0)


def ease(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 with no velocity or acceleration at either end (minimum jerk, Flash and Hogan 1985)."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


def bump(x: np.ndarray) -> np.ndarray:
    """0 at 0 and 1, and 1 halfway, with no velocity at the ends; 0 elsewhere."""
    x = np.clip(x, 0.0, 1.0)
    return 16.0 * x**2 * (1.0 - x) ** 2


def smooth(signal: np.ndarray, seconds: float, fps: float) -> np.ndarray:
    """The signal (T, ...) blurred in time by a Gaussian of that standard deviation, the ends held."""
    return gaussian_filter1d(signal, seconds * fps, axis=0, mode="nearest") if seconds > 0 else signal


def smooth_above(signal: np.ndarray, seconds: float, fps: float) -> np.ndarray:
    """A smooth signal (T,) that is nowhere below the given one: its moving maximum, blurred within reach."""
    reach = max(1, int(round(2.5 * seconds * fps)))
    return gaussian_filter1d(
        maximum_filter1d(signal, 2 * reach + 1, mode="nearest"), reach / 2.5, truncate=2.5, mode="nearest"
    )


class Track:
    """Key frames ``(time, value)`` with eased moves between them; values are numbers or vectors.

    ``move(start, end, value)`` holds the last value until ``start`` and arrives at ``end``.
    Moves are told in the order of time; one that starts before the last one ended starts at that end.
    """

    def __init__(self, value: float | np.ndarray):
        self._last = np.asarray(value, float)
        self._rows: list[tuple[float, float, np.ndarray, np.ndarray]] = []
        self._first = self._last

    @property
    def last(self) -> np.ndarray:
        return self._last

    def move(self, start: float, end: float, value: float | np.ndarray) -> None:
        if self._rows:
            start = max(start, self._rows[-1][1])
        end = max(end, start + 1e-3)
        value = np.asarray(value, float)
        self._rows.append((start, end, self._last, value))
        self._last = value

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """The values (T, ...) at the times ``t`` (T,)."""
        if not self._rows:
            return np.broadcast_to(self._first, (len(t), *self._first.shape)).copy()
        a, b, x = self.moves(t)
        return a + (b - a) * x.reshape(-1, *[1] * self._first.ndim)

    def moves(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For the times ``t``: values (T, ...) where the move started and where it ends, and the share done (T,).

        The track must have a move.
        """
        start, end = np.array([row[:2] for row in self._rows]).T
        a, b = (np.stack([row[k] for row in self._rows]) for k in (2, 3))
        k = np.clip(np.searchsorted(start, t, side="right") - 1, 0, None)
        return a[k], b[k], ease((t - start[k]) / (end[k] - start[k]))
