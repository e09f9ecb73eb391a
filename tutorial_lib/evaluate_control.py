"""How well a network follows control: does it walk, stay on the path and stand on its feet, and what does it cost."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from . import metrics
from .clip_errors import pose_errors
from .control import control_of, find_strides, path_deviation, prepared_path, smooth_control
from .evaluate import jsonable, unseen
from .generate import prepare_for
from .generate_control import generate_control_features, generate_from_control
from .motion.clip import Motion
from .motion.ground import PREPARED
from .threads import torch_threads
from .training.checkpoints import Checkpoint
from .walk import gait_to_walk, plan_walk, planted_feet, walk

PACES = (1.3, 3.0)  # m/s: walking and running
ALIKE = 0.25  # a clip is of a pace if its speed is within this share of it
CROWD = 64
SECONDS = 10.0  # of motion whose making is timed


def evaluate_control(
    checkpoint: Checkpoint,
    motions: Sequence[Motion],
    *,
    paths: Sequence[str] = tuple(PREPARED),
    paces: Sequence[float] = PACES,
    count: int = 4,
    seed: int = 0,
) -> dict[str, Any]:
    """What somebody does whom the network moves, beside what the people in some clips do.

    motions: clips, best never trained on (:func:`tutorial_lib.evaluate.unseen`); they are brought to the network's rate
    and size. paths: prepared ones, each gone along by ``count`` people at each of the ``paces`` (m/s) that the clips
    which it was trained on have.

    Returns a dict, ready for JSON, with

    - ``pose_error``: metres, mean over the joints, from the clips' true poses when it is given their control
    - ``clips``, ``trained_on_these_clips``; ``true``: {pace: :func:`gait_of` of the clips at about this pace}
    - ``walks``: rows of ``path``, ``pace`` and what :func:`measured_walk` gives
    - ``ms``: {people at once: :func:`cost`}

    Raises ``CheckpointError`` for a network that follows no control or brings no sway.
    """
    most = gait_to_walk(checkpoint).limits.speed
    paces = [pace for pace in paces if pace <= most] or [most]
    clips = prepare_for(checkpoint, motions)
    found = [{"path": path, "pace": pace, **measured_walk(checkpoint, path, pace, count=count, seed=seed)}
             for pace in paces for path in paths]  # fmt: skip
    return jsonable({
        "system": checkpoint.system,
        "representation": checkpoint.representation.name,
        "fps": checkpoint.representation.fps,
        "clips": [motion.name for motion in motions],
        "trained_on_these_clips": len(unseen(checkpoint, motions)) < len(motions),
        "pose_error": np.mean([_pose_error(checkpoint, clip, seed) for clip in clips]),
        "people": count,
        "true": {f"{pace:g}": gait_of(of_pace(clips, pace)) for pace in paces},
        "walks": found,
        "ms": {count: cost(checkpoint, count) for count in (1, CROWD)},
    })  # fmt: skip


def _pose_error(checkpoint: Checkpoint, clip: Motion, seed: int) -> float:
    representation = checkpoint.representation
    true = representation.encode(clip)
    made = generate_control_features(checkpoint, true[None, :, representation.slices["control"]], seed=seed)[0]
    return float(pose_errors(representation, made, true).mean())


def of_pace(clips: Sequence[Motion], pace: float) -> list[Motion]:
    """Those clips whose speed, without the sway, is about ``pace`` on average."""

    def speed(clip: Motion) -> float:
        return float(np.hypot(*smooth_control(control_of(clip), clip.fps)[:, 1:].T).mean())

    return [clip for clip in clips if abs(speed(clip) / pace - 1) <= ALIKE]


# --- one walk -------------------------------------------------------------------------------------


def measured_walk(
    checkpoint: Checkpoint, path: str, pace: float, *, count: int = 4, seed: int = 0, codes: str = "held"
) -> dict[str, Any]:
    """``count`` people on a prepared path, mean over them.

    seconds: that it takes them. deviation: how far they go from the path, in metres, ``mean`` and ``max``, ``drift``
    with the hip's sway taken out, and ``covered``, the share of it that they pass; ``predicted``: the mean, moved as
    the network says itself that they moved. ``before`` the clean-up and ``after`` it: :func:`gait_of` them.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of turns at which people slow down
        planned = plan_walk(checkpoint, path, pace, count=count, seed=seed)
        motions = walk(checkpoint, path, pace, count=count, seed=seed, codes=codes, clean=False)
    asked = {"seed": seed, "codes": codes, "place": planned.start, "heading": planned.heading}
    alone = generate_from_control(checkpoint, planned.control, integrate="predicted", **asked)
    each, lost = ([path_deviation(m, prepared_path(path)) for m in some] for some in (motions, alone))
    return {
        "seconds": motions[0].duration,
        "deviation": {
            "mean": float(np.mean([d.mean for d in each])),
            "max": float(np.mean([d.max for d in each])),
            "drift": float(np.mean([d.mean_drift for d in each])),
            "covered": float(np.mean([d.covered for d in each])),
            "predicted": float(np.mean([d.mean for d in lost])),
        },
        "before": gait_of(motions),
        "after": gait_of([planted_feet(motion) for motion in motions]),
    }


def gait_of(motions: Sequence[Motion]) -> dict[str, float | None]:
    """How some people walk, mean over them; None where nobody does.

    step_length: metres; cadence: steps a minute (:class:`tutorial_lib.control.Strides`). slide: centimetres that a
    standing foot slides in one step (:func:`tutorial_lib.metrics.foot_slide`). contact: share of the time in which a
    foot stands; who glides along has no contact, and none of its sliding counts. Each is first put on the ground.
    """
    rows = []
    for motion in motions:
        strides, settled = find_strides(motion), motion.settled()
        feet = metrics.foot_joints(motion.skeleton)
        at = settled.positions, feet, settled.fps
        rows.append((strides.step_length or np.nan, strides.cadence or np.nan, metrics.foot_slide(*at),
                     metrics.foot_contacts(*at).any(-1).mean()))  # fmt: skip
    names = ("step_length", "cadence", "slide", "contact")
    columns = zip(*rows, strict=True) if rows else [[]] * len(names)
    return jsonable({name: _mean(column) for name, column in zip(names, columns, strict=True)})


def _mean(values: Sequence[float]) -> float:
    values = np.array(values, dtype=float)
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else float("nan")


# --- cost -----------------------------------------------------------------------------------------


def cost(checkpoint: Checkpoint, count: int, seconds: float = SECONDS, repeats: int = 5) -> float:
    """Milliseconds of CPU time in which ``count`` people are moved for a second: control to positions in the world.

    With one thread; the median of some runs of ``seconds`` of motion, after a first one that is not counted. With the
    paper's sizes a second of one person takes ten million multiplications, 6.5 in the decoder and 3 in the control
    encoder, so that a crowd costs what arithmetic costs, each as much as the other; one person alone costs two or
    three times that, of calls.
    """
    fps = checkpoint.representation.fps
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of people who have only walked more slowly
        planned = plan_walk(checkpoint, np.array([[0.0, 0.0], [0.0, 1.3 * seconds]]), 1.3, count=count)
    control = planned.control[:, : round(seconds * fps)]
    spent = []
    with torch_threads(1):
        for _ in range(repeats + 1):
            start = time.process_time()
            generate_from_control(checkpoint, control, codes="held", place=planned.start, heading=planned.heading)
            spent.append(1000 * (time.process_time() - start) * fps / control.shape[1])
    return float(np.median(spent[1:]))


# --- told -----------------------------------------------------------------------------------------


def summary(result: dict[str, Any]) -> list[str]:
    """The result of :func:`evaluate_control` as lines for a terminal."""

    def number(value: float | None, scale: float = 1.0, form: str = ".1f") -> str:
        return "none" if value is None else format(scale * value, form)

    def told(gait: dict[str, float | None]) -> str:
        return (
            f"steps of {number(gait['step_length'], 100, '.0f')} cm, {number(gait['cadence'], 1, '.0f')} a minute, "
            f"contact {number(gait['contact'], 100, '.0f')} %, slide {number(gait['slide'])} cm a step"
        )

    seen = "some of them trained on" if result["trained_on_these_clips"] else "never trained on"
    lines = [
        f"{len(result['clips'])} clips {seen}; {result['people']} people on each path",
        f"pose error          {number(result['pose_error'], 100, '.2f')} cm, given the clips' control",
    ]
    for pace, gait in result["true"].items():
        walked = gait["step_length"] is not None
        lines.append(f"clips at {pace + ' m/s':<11}{told(gait) if walked else 'none'}")
    for row in result["walks"]:
        off = row["deviation"]["mean"]
        lines.append(
            f"{row['path']} at {row['pace']:g} m/s: {told(row['before'])}, "
            f"{number(row['after']['slide'])} after the clean-up; {number(off, 100)} cm from the path"
        )
    ms = ", ".join(f"{value:.1f} ms for {count}" for count, value in result["ms"].items())
    return [*lines, f"a second of motion  {ms} at once"]
