"""One network of ``reproduce side-by-side``: trained to its end and measured by the same measures as all others."""

from __future__ import annotations

import dataclasses
import math
import pathlib
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import metrics
from ..clip_errors import joint_error, sample_diversity
from ..evaluate_control import measured_walk
from ..motion.clip import Motion, settled_positions
from ..motion.skeleton import Skeleton
from ..pretrained import publish
from ..recipes import Recipe, trainer_for
from ..representations import Representation, make_representation
from ..threads import torch_threads
from ..training.checkpoints import Checkpoint, load_checkpoint
from .failures import Truth, failures
from .grid import Clips, Report, Run, clips_for, train, trained_with
from .results import mean_of, rounded
from .side_by_side_plan import SYSTEMS, Protocol, name_of
from .side_by_side_rollouts import control_for, follows_control, go_on, windows_of

BLOCK = 90  # frames, three seconds, over which the motion change of the long run is averaged
FUTURE_TIMES = (0.5, 1.0, 2.0)  # s after the seed at which futures are compared
CM = 100.0


def train_and_measure(
    run: Run, folder: pathlib.Path, protocol: Protocol, report: Report
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A run trained to its end and measured: what its split is like, and the run's entry."""
    sets = clips_for(run.recipe)
    train(run, folder, report, sets)
    checkpoint = publish.rounded(load_checkpoint(run.path(folder)))  # as it is passed on
    train_clips, test_clips = ([m for part in sets for m in part[k]] for k in (0, 1))
    truth = Truth.of(train_clips, test_clips, _common(train_clips[0].skeleton, run.recipe.fps))
    name = name_of(run)
    measured = {
        "label": name,
        "title": SYSTEMS[name].title,
        "seed": run.recipe.seed,
        **trained_with(run.recipe, checkpoint),
        "core_seconds": core_seconds(run.recipe, sets),
        **measure(checkpoint, test_clips, truth, protocol),
    }
    split = split_of(train_clips, test_clips, truth, protocol)
    report(run.name, run.recipe.steps + 1)
    return split, measured


def _common(skeleton: Skeleton, fps: float) -> Representation:
    """The acRNN's representation, in metres: what motion change and the rules of failing are told in."""
    return make_representation("positions", skeleton, fps)


def measure(checkpoint: Checkpoint, clips: Sequence[Motion], truth: Truth, protocol: Protocol) -> dict[str, Any]:
    """The measures of one network after the same beginnings, all taken on joint positions in the world.

    ``error``, ``pose_error``: see :func:`errors_of`. ``moves``: motion change as a share of the true one, mean of every
    three seconds. ``speed``: m/s of the root. ``failures``: by rule. ``flaws``: see :func:`flaws_of`. ``futures``: see
    :func:`futures_of`. ``paths``: of one that follows a control what
    :func:`~tutorial_lib.evaluate_control.measured_walk` tells of prepared paths, else None. ``ms``: milliseconds a
    frame.
    """
    seed_frames, horizon = protocol.seed_frames, horizon_of(protocol)
    windows = windows_of(clips, seed_frames + horizon, protocol.seeds, checkpoint.representation.fps)
    starts, skeleton, fps = [w[:seed_frames] for w in windows], windows[0].skeleton, windows[0].fps
    control = control_for(windows, clips, seed_frames + protocol.frames) if follows_control(checkpoint) else None
    made = go_on(checkpoint, starts, protocol.frames, control=control)  # (K, S + F, J, 3)
    common = _common(skeleton, fps)
    features = common.encode_arrays(made)
    change = metrics.frame_change(features[:, seed_frames - 1 :])  # (K, F)
    alone = made[:, seed_frames:]
    return {
        **errors_of(alone[:, :horizon], np.stack([w.positions for w in windows])[:, seed_frames:], fps),
        "moves": rounded(blocks(change).mean(0) / truth.change, 3),
        "speed": root_speed(alone, fps),
        "failures": failures(features[:, :seed_frames], features[:, seed_frames:], common, truth),
        "flaws": flaws_of(alone, skeleton, fps),
        "futures": futures_of(checkpoint, windows, clips, protocol),
        "paths": None if control is None else {name: measured_walk(checkpoint, name, protocol.pace)
                                               for name in protocol.paths},
        "ms": milliseconds(checkpoint, starts[:1], control, protocol),
    }  # fmt: skip


def horizon_of(protocol: Protocol, fps: float = 30.0) -> int:
    """Frames after a seed of which the truth must be known."""
    return max(metrics.frames_at(metrics.PAPER_TIMES_MS, fps))


def blocks(change: np.ndarray) -> np.ndarray:
    """``(K, F)`` to the means of each three seconds, ``(K, F // 90)``; of less than that, one of all."""
    size = min(BLOCK, change.shape[1])
    whole = change.shape[1] // size * size
    return change[:, :whole].reshape(len(change), -1, size).mean(-1)


def root_speed(positions: np.ndarray, fps: float) -> float:
    """Metres a second along the ground, mean over ``(K, T, J, 3)``."""
    return float(np.linalg.norm(np.diff(positions[:, :, 0, ::2], axis=1), axis=-1).mean() * fps)


def errors_of(made: np.ndarray, truth: np.ndarray, fps: float) -> dict[str, Any]:
    """Mean distance of a joint from the true one at 80 ... 640 ms, in cm: positions ``(K, H, J, 3)`` both.

    ``error``: in the world. ``pose_error``: about the root, along the world's axes. Both with the standard error over
    the seeds, and ``errors``, the first for each seed.
    """
    at = [frame - 1 for frame in metrics.frames_at(metrics.PAPER_TIMES_MS, fps)]
    world = CM * joint_error(made, truth)[:, at]  # (K, 8)
    pose = CM * joint_error(made - made[:, :, :1], truth - truth[:, :, :1])[:, at]
    return {
        "error": rounded(world.mean(0)),
        "standard_error": rounded(metrics.standard_error(world)),
        "errors": rounded(world.T, 4),
        "pose_error": rounded(pose.mean(0)),
        "pose_standard_error": rounded(metrics.standard_error(pose)),
    }


def flaws_of(positions: np.ndarray, skeleton: Skeleton, fps: float) -> dict[str, float]:
    """What is wrong with motions ``(K, T, J, 3)``.

    ``foot_slide``: cm that a standing foot slides in one step, each motion put on the ground first; mean over the
    motions that set a foot on it, whose share is ``steps``. ``bones``: how much bones change their length, per
    cent against the motion's own first frame.
    """
    feet = metrics.foot_joints(skeleton)
    slides = np.array([float(metrics.foot_slide(settled_positions(x, fps), feet, fps)) for x in positions])
    walk = np.isfinite(slides)
    return {
        "foot_slide": float(slides[walk].mean()) if walk.any() else math.nan,
        "steps": float(walk.mean()),
        "bones": 100 * float(metrics.bone_length_drift(positions, skeleton, reference="first").mean()),
    }


def futures_of(
    checkpoint: Checkpoint, windows: Sequence[Motion], clips: Sequence[Motion], protocol: Protocol
) -> dict[str, Any]:
    """``protocol.futures`` motions from each seed, drawn anew each time: how far they are from each other.

    place, pose: mean distance of a joint between two futures of one seed, cm, at ``FUTURE_TIMES``: in the world, and in
    the body's own frame. best: the error at 640 ms of that future which is nearest to what came, mean over
    the seeds. A system that draws nothing makes the same motion each time.
    """
    fps, seed_frames, frames = windows[0].fps, protocol.seed_frames, protocol.future_frames
    many = [window for window in windows for _ in range(protocol.futures)]
    control = None
    if follows_control(checkpoint):
        control = np.repeat(control_for(windows, clips, seed_frames + frames), protocol.futures, axis=0)
    starts = [window[:seed_frames] for window in many]
    made = go_on(checkpoint, starts, frames, control=control, prior=True, seed=1)[:, seed_frames:]
    hip = make_representation("hip-frame", windows[0].skeleton, fps)
    pose = hip.encode_arrays(made)[..., hip.slices["joints"]].reshape(made.shape)
    at = [min(frames, round(seconds * fps)) - 1 for seconds in FUTURE_TIMES]
    apart = {
        name: rounded(CM * np.mean([sample_diversity(each)[at] for each in _by_seed(x, protocol)], axis=0))
        for name, x in (("place", made), ("pose", pose))
    }
    last = horizon_of(protocol, fps)
    true = np.stack([w.positions[last + seed_frames - 1] for w in windows])[:, None]  # (K, 1, J, 3)
    error = np.linalg.norm(_by_seed(made, protocol)[:, :, last - 1] - true, axis=-1).mean(-1)  # (K, futures)
    return {**apart, "best": float(CM * error.min(1).mean()), "mean": float(CM * error.mean())}


def _by_seed(positions: np.ndarray, protocol: Protocol) -> np.ndarray:
    return positions.reshape(-1, protocol.futures, *positions.shape[1:])


def milliseconds(
    checkpoint: Checkpoint, start: Sequence[Motion], control: np.ndarray | None, protocol: Protocol
) -> float:
    """CPU time of one frame of one character, features and positions, with the threads that torch has: the median of
    three. It depends on the machine."""
    told = None if control is None else np.resize(control[:1], (1, len(start[0]) + protocol.timed, 3))
    spent = []
    for _ in range(4):
        begin = time.process_time()
        go_on(checkpoint, start, protocol.timed, control=told)
        spent.append(1000 * (time.process_time() - begin) / protocol.timed)
    return float(np.median(spent[1:]))


def core_seconds(recipe: Recipe, sets: Clips, steps: int = 30) -> float:
    """CPU time that training by a recipe takes with the threads that torch has, from a run of a few of its steps.

    The clock on the wall tells as much of what else the machine did. Stages have their shares of the few, too.
    """
    steps = min(steps, recipe.steps)
    trainer = trainer_for(dataclasses.replace(recipe, steps=steps), sets=sets)
    begin = time.process_time()
    trainer.run(progress=False, live_plot=False)
    return (time.process_time() - begin) * recipe.steps / steps


# --- what needs no network ------------------------------------------------------------------------


def split_of(
    train_clips: Sequence[Motion], test_clips: Sequence[Motion], truth: Truth, protocol: Protocol, fps: float = 30.0
) -> dict[str, Any]:
    """The clips of a split, what true motion is like, and the errors of two predictors that have learnt nothing."""
    seed_frames, horizon = protocol.seed_frames, horizon_of(protocol, fps)
    windows = np.stack([w.positions for w in windows_of(test_clips, seed_frames + horizon, protocol.seeds, fps)])
    last, true = windows[:, seed_frames - 1 : seed_frames], windows[:, seed_frames:]
    step = (last - windows[:, seed_frames - 2 : seed_frames - 1])[:, :, :1]  # (K, 1, 1, 3) of the root
    gone = step * np.arange(1, horizon + 1)[:, None, None]
    clips = [clip.resample(fps).on_ground() for clip in test_clips]
    flaws = [flaws_of(clip.positions[None], clip.skeleton, fps) for clip in clips]
    return {
        "train": [m.name for m in train_clips],
        "test": [m.name for m in test_clips],
        "train_seconds": sum(m.duration for m in train_clips),
        "test_seconds": sum(m.duration for m in test_clips),
        "truth": truth.to_dict(),
        "true": {
            "speed": float(np.mean([root_speed(clip.positions[None], fps) for clip in clips])),
            **{name: mean_of(each[name] for each in flaws) for name in flaws[0]},
        },
        "references": {
            "last pose held": errors_of(np.broadcast_to(last, true.shape), true, fps),
            "last pose, gliding on": errors_of(last + gone, true, fps),
        },
    }


def seconds_of_measuring(recipe: Recipe, sets: Clips, protocol: Protocol) -> float:
    """How long measuring a network will take at least, from a shorter one with fresh weights, which walk no path."""
    trainer = trainer_for(recipe, sets=sets)
    checkpoint = Checkpoint(recipe.system, trainer.model.eval(), trainer.batches.representation,
                            trainer.batches.normalizer, {}, {})  # fmt: skip
    train_clips, test_clips = ([m for part in sets for m in part[k]] for k in (0, 1))
    short = dataclasses.replace(protocol, frames=min(protocol.frames, 90), futures=2, timed=10, paths=())
    with torch_threads(1):
        start = time.monotonic()
        truth = Truth.of(train_clips, test_clips, _common(train_clips[0].skeleton, recipe.fps))
        split_of(train_clips, test_clips, truth, short, recipe.fps)
        fixed = time.monotonic()
        measure(checkpoint, test_clips, truth, short)
        return fixed - start + (time.monotonic() - fixed) * protocol.frames / short.frames
