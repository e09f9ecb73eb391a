"""Somebody walks a path: the path's control, the sway of the gait on it, the network, and feet that stand.

>>> checkpoint = pretrained.load("vae-lstm-samples")
>>> walkers = walk(checkpoint, "figure of eight", pace=1.3, count=10)        # ten people, all different
>>> print(path_deviation(walkers[0], prepared_path("figure of eight")))
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence

import numpy as np

from .chance import is_whole, whole_seed
from .cleanup import clean_up
from .control import PathControl, Sway, path_control, prepared_path
from .errors import CheckpointError, MotionError
from .generate import representation_of
from .generate_control import control_network, generate_from_control
from .motion.clip import Motion
from .training.checkpoints import Checkpoint
from .training.progress import Progress

BRIDGE = 0.3  # s; a walker's foot is in the air for longer


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedWalk:
    """What the network is asked for, of ``K`` people on one path.

    way: the path's own control, smooth, with ``way.note`` on what was limited. control: ``(K, T, 3)`` with the sway of
    a gait. start: ``(K, 2)`` x and z in metres; heading: ``(K,)`` radians, of the first frame.
    """

    way: PathControl
    control: np.ndarray
    start: np.ndarray
    heading: np.ndarray


def walk(
    checkpoint: Checkpoint,
    path: str | Sequence,
    pace: float | Sequence[float] = 1.3,
    *,
    count: int = 1,
    seed: int = 0,
    codes: str = "held",
    sway: Sway | bool = True,
    clean: bool = True,
    rest: bool = False,
    progress: bool = False,
) -> list[Motion]:
    """People who walk a path, ``count`` of them, all different.

    path: ``(N, 2)`` x and z in metres, or the name of a prepared one ("circle", "figure of eight", "zigzag").
    pace: m/s, a number or one a point; where the path turns, people slow down, and one warning says where the most.
    seed: decides codes, the phase in which each begins, and the tempo; the same arguments give the same motions.
    codes: as in :func:`~tutorial_lib.generate_control.generate_from_control`. By default each person keeps a code for
        the whole way, for who has one code at the start is like everybody else a second later.
    sway: the checkpoint's own (True), another, or none at all (False): then the network sees the smooth control of the
        path, which it has never seen in training, and glides.
    clean: plant the feet and keep the bones' lengths (:func:`planted_feet`); without, what the network gave.
    rest: begin and end standing. progress: whether to show a bar.

    Raises ``MotionError`` for a path, pace or count that nobody can walk (:func:`~tutorial_lib.control.path_control`
    says which) and ``CheckpointError`` for a network that follows no control, or that brings no sway.
    """
    planned = plan_walk(checkpoint, path, pace, count=count, seed=seed, sway=sway, rest=rest)
    motions = generate_from_control(
        checkpoint, planned.control, fps=planned.way.fps, seed=seed, codes=codes, place=planned.start,
        heading=planned.heading,
    )  # fmt: skip
    motions = [motion.with_name(f"walk-{k}") for k, motion in enumerate(motions, start=1)]
    if not clean:
        return motions
    with contextlib.closing(Progress(count, unit="person", title="planting feet", enabled=progress)) as bar:
        for k, motion in enumerate(motions):
            motions[k] = planted_feet(motion)
            bar.update()
    return motions


def planted_feet(motion: Motion) -> Motion:
    """A walker cleaned up: :func:`~tutorial_lib.cleanup.clean_up` for somebody who lifts a foot to step on."""
    return clean_up(motion, level=False, bridge=BRIDGE)


def plan_walk(
    checkpoint: Checkpoint,
    path: str | Sequence,
    pace: float | Sequence[float] = 1.3,
    *,
    count: int = 1,
    seed: int = 0,
    sway: Sway | bool = True,
    rest: bool = False,
) -> PlannedWalk:
    """The control of :func:`walk`, whose arguments these are, as the network sees it."""
    if not (is_whole(count) and count >= 1):
        raise MotionError(f"{count!r} people: expected a whole number of 1 or more")
    gait = gait_to_walk(checkpoint, sway)
    fps = representation_of(checkpoint).fps
    limits = {} if gait is None else {"limits": gait.limits}
    way = path_control(prepared_path(path) if isinstance(path, str) else path, pace, fps, rest=rest, **limits)
    if gait is None:
        alike = np.repeat(way.control[None], count, 0)
        return PlannedWalk(way, alike, np.repeat([way.start], count, 0), np.repeat(way.heading, count))
    rng = np.random.default_rng(whole_seed(seed))
    phase = rng.uniform(0, 2 * np.pi, count)
    tempo = 1 + gait.spread * np.clip(rng.standard_normal(count), -2, 2)
    return PlannedWalk(way, *gait.added_to(way.control, fps, phase, tempo, start=way.start, heading=way.heading))


def gait_to_walk(checkpoint: Checkpoint, sway: Sway | bool = True) -> Sway | None:
    """The sway that :func:`walk` takes for what it was given; ``CheckpointError`` where the network can have none."""
    control_network(checkpoint)
    if isinstance(sway, Sway):
        return sway
    if not sway:
        return None
    if checkpoint.sway is None:
        raise CheckpointError(
            f"{checkpoint.path}: brings no sway of a gait to walk with: expected a vae-lstm that was trained on "
            "walking (in Python also sway=, one of control.fit_sway, or False to walk without)"
        )
    return checkpoint.sway
