"""The clips of ``data_samples/``: which there are, and writing them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...motion.bvh import write_bvh
from ...motion.clip import Motion
from ...motion.ground import circle, figure_of_eight
from .boxing import boxing
from .dancing import dancing
from .gait import running, walking

FPS = 30.0
DECIMALS = 2  # of centimetres and degrees: a tenth of a millimetre, a few tenths at the finger tips


def _weave(length: float, width: float, wave: float) -> np.ndarray:
    z = np.linspace(0.0, length, 300)
    return np.stack([width * np.sin(2 * np.pi * z / wave), z], -1)


def sample_clips() -> dict[str, list[Callable[[], Motion]]]:
    """For each style the makers of its clips, in order."""

    def walk(speed, path, seed):
        return lambda: walking(15.0, speed=speed, path=path, fps=FPS, seed=seed)

    def run(speed, path, seed):
        return lambda: running(14.0, speed=speed, path=path, fps=FPS, seed=seed)

    return {
        "walking": [
            walk(1.3, None, 1), walk(1.0, circle(2.2, 1.0), 2), walk(1.5, circle(-3.0, 1.0), 3),
            walk(1.2, figure_of_eight(2.6), 4), walk(1.7, _weave(28.0, 0.9, 8.0), 5),
        ],
        "running": [
            run(3.0, None, 1), run(2.4, circle(5.0, 1.0), 2), run(3.4, circle(-7.0, 1.0), 3),
            run(2.7, figure_of_eight(7.0), 4), run(3.8, _weave(60.0, 1.6, 18.0), 5),
        ],
        "boxing": [lambda seed=seed: boxing(20.0, fps=FPS, seed=seed) for seed in range(1, 6)],
        "dancing": [
            lambda seed=seed, tempo=tempo: dancing(20.0, fps=FPS, seed=seed, tempo=tempo)
            for seed, tempo in ((1, 112), (2, 104), (3, 120), (4, 96), (5, 116))
        ],
    }  # fmt: skip


def make_samples(folder: str | os.PathLike) -> list[Path]:
    """Write every sample clip as ``folder/style/NN.bvh``; the same files each time. Returns their paths."""
    paths = []
    for style, clips in sample_clips().items():
        for number, make in enumerate(clips, 1):
            path = Path(folder) / style / f"{number:02d}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bvh(make(), path, decimals=DECIMALS)
            paths.append(path)
    return paths


def benchmark(seconds: float = 60.0, repeats: int = 5) -> dict[str, float]:
    """Seconds of motion made in a second, for each style: the median of some runs."""
    factors = {}
    for make in (walking, running, boxing, dancing):
        make(1.0)  # the first call loads libraries
        took = []
        for seed in range(repeats):
            start = time.perf_counter()
            make(seconds, seed=seed)
            took.append(time.perf_counter() - start)
        factors[make.__name__] = seconds / float(np.median(took))
    return factors
