"""A way along the ground for a sample clip: a gentle random one. The rest is in ``motion.ground``."""

from __future__ import annotations

import numpy as np

from .signals import noise


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
