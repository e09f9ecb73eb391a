"""How good a checkpoint is: prediction errors, whether its motion goes on, and what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from . import metrics
from .data.windows import evaluation_windows
from .errors import DataError, MotionError
from .generate import SEED_FRAMES, generate_features, prepare_for
from .motion.clip import Motion, settled_positions
from .training.checkpoints import Checkpoint

CHANGE_FRAMES = (15, 60, 150, 300, 600, 900)  # frames after the seed at which motion change is told
CHANGE_WINDOW = 15  # steps up to that frame that are averaged


def unseen(checkpoint: Checkpoint, motions: Sequence[Motion]) -> list[Motion]:
    """The clips that the checkpoint was not trained on, by their names; may be empty.

    A clip is known by the end of its name: ``samples/walking/01``, as the catalogue has it, is ``walking/01``, as
    a folder of files has it.
    """
    trained_on = ["/" + name for name in checkpoint.provenance.get("clips") or ()]

    def seen(name: str) -> bool:
        return any(other.endswith("/" + name) or ("/" + name).endswith(other) for other in trained_on)

    return [motion for motion in motions if not seen(motion.name)]


def evaluate(
    checkpoint: Checkpoint,
    motions: Sequence[Motion],
    *,
    count: int = 20,
    frames: int = 900,
    seed_frames: int = SEED_FRAMES,
    seed: int = 0,
    progress: bool = False,
) -> dict[str, Any]:
    """Measures of ``frames`` generated frames after each of ``count`` seeds, beside those of the clips.

    The protocol is the acRNN paper's (section 4): 20 random seeds of 10 frames from test clips, errors as
    Euclidean distance in the representation, averaged. What each measure is stands in
    :mod:`tutorial_lib.metrics`.

    Parameters
    ----------
    motions : clips to take seeds and the truth from, best ones never trained on (:func:`unseen`). They are
        brought to the checkpoint's frame rate and size first.

    Returns
    -------
    dict, ready for JSON, with

    - ``prediction_error``: {milliseconds: distance} at 80 ... 640 ms
    - ``motion_change``: ``true`` (mean of the clips) and ``at`` {frame after the seed: mean of the steps up to it}
    - ``freezing``: how many motions froze, and the seconds after which each did (``None``: never)
    - ``divergence``: the same for leaving the range of poses, here that of the clips given
    - ``foot_skate``: cm/s of standing feet, generated and true, both settled on the ground first; ``None`` for an
      unknown skeleton
    - ``bone_drift``: mean relative change of the bones' lengths, generated and true

    Measures of generated motion that is no longer finite are ``None``.
    Raises :class:`DataError` if the clips are too short, ``MotionError`` if their skeleton is another.
    """
    prepared = prepare_for(checkpoint, motions)
    representation = checkpoint.representation
    fps = representation.fps
    horizon = max(metrics.frames_at(metrics.PAPER_TIMES_MS, fps))
    if frames < max(horizon, round(fps)):
        raise DataError(f"evaluation takes {max(horizon, round(fps))} frames or more (1 s), not {frames}")
    seeds, truth = evaluation_windows(prepared, representation, seed_frames=seed_frames, future_frames=horizon,
                                      count=count, seed=seed)  # fmt: skip
    made = generate_features(checkpoint, seeds, frames, progress=progress)  # (count, frames, D)
    error = metrics.prediction_error(made[:, :horizon], truth.numpy(), fps)

    true_features = [representation.encode(motion) for motion in prepared]
    true_change = _weighted([(metrics.frame_change(x).mean(), len(x) - 1) for x in true_features if len(x) > 1])
    change = metrics.frame_change(np.concatenate([seeds.numpy()[:, -1:], made], axis=1))  # (count, frames)
    at = {
        frame: change[:, max(0, frame - CHANGE_WINDOW) : frame].mean()
        for frame in (*(f for f in CHANGE_FRAMES if f < frames), frames)
    }

    # the seed goes along, so that all motions stand on the ground in the same way, and is cut off again
    positions = representation.decode_positions(np.concatenate([seeds.numpy(), made], axis=1))[:, seed_frames:]
    true_positions = [motion.positions for motion in prepared]
    reach = max(float(metrics.reach(x)) for x in true_positions)
    skeleton = representation.skeleton
    try:
        feet = metrics.foot_joints(skeleton)
        # a height that drifts would leave most steps out, so all motions are put on the ground first
        skates = [metrics.foot_skate(settled_positions(x, fps), feet, fps) for x in positions]
        true_skates = [
            (metrics.foot_skate(settled_positions(x, fps), feet, fps), len(x)) for x in true_positions if len(x) > 1
        ]
        skate = {
            "generated": np.mean(skates),
            "true": _weighted(true_skates),
            "unit": "cm/s",
        }
    except MotionError:
        skate = None
    freezing = metrics.freezing_time(change, true_change, fps)
    divergence = metrics.divergence_time(positions, reach, fps)
    return _jsonable({
        "system": checkpoint.system,
        "representation": representation.name,
        "fps": fps,
        "seeds": count,
        "seed_frames": seed_frames,
        "frames": frames,
        "clips": [motion.name for motion in motions],
        "trained_on_these_clips": len(unseen(checkpoint, motions)) < len(motions),
        "prediction_error": dict(zip(metrics.PAPER_TIMES_MS, error, strict=True)),
        "motion_change": {"true": true_change, "at": at},
        "freezing": {"count": int(np.isfinite(freezing).sum()), "seconds": freezing},
        "divergence": {"count": int(np.isfinite(divergence).sum()), "seconds": divergence},
        "foot_skate": skate,
        "bone_drift": {
            "generated": metrics.bone_length_drift(positions, skeleton).mean(),
            "true": _weighted([(metrics.bone_length_drift(x, skeleton).mean(), len(x)) for x in true_positions]),
        },
    })  # fmt: skip


def summary(result: dict[str, Any]) -> list[str]:
    """The result of :func:`evaluate` as lines for a terminal."""
    change, drift, skate = result["motion_change"], result["bone_drift"], result["foot_skate"]
    true = change["true"]

    def number(value: float | None, form: str = ".3g") -> str:
        return "not finite" if value is None else format(value, form)

    lines = [
        f"{result['seeds']} seeds of {result['seed_frames']} frames from {len(result['clips'])} clips"
        + (", some of them trained on" if result["trained_on_these_clips"] else " never trained on")
        + f"; {result['frames']} frames at {result['fps']:g} per second",
        "prediction error    " + "  ".join(f"{ms} ms {number(e)}" for ms, e in result["prediction_error"].items()),
        f"motion change       true {number(true)} a frame; after "
        + "  ".join(f"{frame}: {number(c)}" + (f" ({c / true:.0%})" if c is not None else "")
                    for frame, c in change["at"].items()),
    ]  # fmt: skip
    for name, word in (("freezing", "stands still"), ("divergence", "leaves human poses")):
        times = [t for t in result[name]["seconds"] if t is not None]
        when = f", at {np.median(times):.1f} s in the middle" if times else ""
        lines.append(f"{word:<19} {result[name]['count']} of {result['seeds']}{when}")
    if skate is not None:
        lines.append(f"foot skate          {number(skate['generated'])} cm/s, true {number(skate['true'])}")
    lines.append(f"bone drift          {number(drift['generated'], '.2%')}, true {number(drift['true'], '.2%')}")
    return lines


def _weighted(pairs: Sequence[tuple[float, int]]) -> float:
    """The mean over frames of all clips, from each clip's mean and number of frames."""
    total = sum(n for _, n in pairs)
    return float(sum(float(mean) * n for mean, n in pairs) / total)


def _jsonable(value: Any) -> Any:
    """Plain numbers; infinity and NaN, which JSON has not, become ``None``."""
    if isinstance(value, dict):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_jsonable(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
