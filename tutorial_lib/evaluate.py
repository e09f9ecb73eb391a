"""How good a checkpoint is: prediction errors, whether its motion goes on, and what is wrong with it."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import metrics
from .data.windows import evaluation_windows
from .errors import DataError, MotionError
from .generate import SEED_FRAMES, generate_features, prepare_for
from .motion.clip import Motion, as_list, settled_positions
from .representations import Representation
from .training.checkpoints import Checkpoint

CHANGE_FRAMES = (15, 60, 150, 300, 600, 900)  # frames after the seed at which motion change is told
CHANGE_WINDOW = 15  # steps up to that frame that are averaged


def unseen(checkpoint: Checkpoint, motions: Motion | Sequence[Motion]) -> list[Motion]:
    """The clips that the checkpoint was not trained on, by their names; may be empty.

    A clip is known by the end of its name: ``samples/walking/01``, as the catalogue has it, is ``walking/01``, as
    a folder of files has it.
    """
    trained_on = ["/" + name for name in checkpoint.provenance.get("clips") or ()]

    def seen(name: str) -> bool:
        return any(other.endswith("/" + name) or ("/" + name).endswith(other) for other in trained_on)

    return [motion for motion in as_list(motions) if not seen(motion.name)]


@dataclass(frozen=True)
class Rollouts:
    """What a checkpoint made after seeds from clips, and the true motion that it is measured against.

    Features are in the representation, not normalised, float32.
    """

    representation: Representation
    seeds: np.ndarray  # (K, T0, D)
    truth: np.ndarray  # (K, H, D): what really came after each seed, at least as far as 640 ms
    made: np.ndarray  # (K, F, D)
    clips: Sequence[Motion]  # that the seeds are from, at the representation's frame rate and size
    reference: Sequence[Motion]  # that the true motion change and the range of poses are taken from

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self.representation.fps

    @property
    def frames(self) -> int:
        """F, how many frames follow each seed."""
        return self.made.shape[1]

    @functools.cached_property
    def change(self) -> np.ndarray:
        """(K, F) motion change; the first is the step from the seed's last frame."""
        return metrics.frame_change(np.concatenate([self.seeds[:, -1:], self.made], axis=1))

    @functools.cached_property
    def true_change(self) -> float:
        """Mean motion change of the reference."""
        features = [self.representation.encode(motion) for motion in self.reference]
        return _weighted([(metrics.frame_change(x).mean(), len(x) - 1) for x in features if len(x) > 1])

    @functools.cached_property
    def positions(self) -> np.ndarray:
        """(K, F, J, 3) metres; the seed goes along, so that all stand on the ground alike, and is cut off again."""
        whole = np.concatenate([self.seeds, self.made], axis=1)
        return self.representation.decode_positions(whole)[:, self.seeds.shape[1] :]

    @functools.cached_property
    def reach(self) -> float:
        """Of the reference's poses, metres (:func:`tutorial_lib.metrics.reach`)."""
        return max(float(metrics.reach(motion.positions)) for motion in self.reference)

    def errors(self) -> np.ndarray:
        """(K, 8) distance to the truth at 80 ... 640 ms."""
        return metrics.prediction_errors(self.made[:, : self.truth.shape[1]], self.truth, self.fps)


def roll_out(
    checkpoint: Checkpoint,
    motions: Motion | Sequence[Motion],
    *,
    reference: Motion | Sequence[Motion] | None = None,
    count: int = 20,
    frames: int = 900,
    seed_frames: int = SEED_FRAMES,
    seed: int = 0,
    progress: bool = False,
) -> Rollouts:
    """``frames`` frames after each of ``count`` seeds, which are spread over the clips; see :func:`evaluate`.

    reference : clips that tell what true motion is, by default ``motions`` themselves; they too are brought to the
        checkpoint's frame rate and size.
    Raises as :func:`evaluate` does.
    """
    prepared = prepare_for(checkpoint, as_list(motions))
    others = prepared if reference is None else prepare_for(checkpoint, as_list(reference))
    representation = checkpoint.representation
    fps = representation.fps
    horizon = max(metrics.frames_at(metrics.PAPER_TIMES_MS, fps))
    if frames < max(horizon, round(fps)):
        raise DataError(f"evaluation takes {max(horizon, round(fps))} frames or more (1 s), not {frames}")
    seeds, truth = evaluation_windows(prepared, representation, seed_frames=seed_frames, future_frames=horizon,
                                      count=count, seed=seed)  # fmt: skip
    made = generate_features(checkpoint, seeds, frames, progress=progress)
    return Rollouts(representation, seeds.numpy(), truth.numpy(), made, prepared, others)


def evaluate(
    checkpoint: Checkpoint,
    motions: Motion | Sequence[Motion],
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
    motions : clips, or one, to take seeds and the truth from, best ones never trained on (:func:`unseen`). They are
        brought to the checkpoint's frame rate and size first.

    Returns
    -------
    dict, ready for JSON, with

    - ``prediction_error``: {milliseconds: distance} at 80 ... 640 ms
    - ``prediction_error_standard_error``: the same for the standard error of that mean over the seeds
    - ``motion_change``: ``true`` (mean of the clips) and ``at`` {frame after the seed: mean of the steps up to it}
    - ``standstill``: how many motions stood still for 1 s, and after how many seconds each first did (``None``: never)
    - ``freezing``: the same for 10 s, or the whole motion where that is shorter (``metrics.FREEZING``)
    - ``divergence``: the same for leaving the range of poses, here that of the clips given
    - ``foot_skate``: cm/s of standing feet, generated and true, both settled on the ground first; ``None`` for an
      unknown skeleton
    - ``bone_drift``: mean relative change of the bones' lengths, generated and true

    Measures of generated motion that is no longer finite are ``None``.
    Raises :class:`DataError` if the clips are too short, ``MotionError`` if their skeleton is another.
    """
    motions = as_list(motions)
    run = roll_out(
        checkpoint, motions, count=count, frames=frames, seed_frames=seed_frames, seed=seed, progress=progress
    )
    fps, change, errors = run.fps, run.change, run.errors()
    at = {
        frame: change[:, max(0, frame - CHANGE_WINDOW) : frame].mean()
        for frame in (*(f for f in CHANGE_FRAMES if f < frames), frames)
    }
    standstill = metrics.freezing_time(change, run.true_change, fps)
    rule = {**metrics.FREEZING, "seconds": min(metrics.FREEZING["seconds"], frames / fps)}
    freezing = metrics.freezing_time(change, run.true_change, fps, **rule)
    divergence = metrics.divergence_time(run.positions, run.reach, fps)
    return jsonable({
        "system": checkpoint.system,
        "representation": run.representation.name,
        "fps": fps,
        "seeds": count,
        "seed_frames": seed_frames,
        "frames": frames,
        "clips": [motion.name for motion in motions],
        "trained_on_these_clips": len(unseen(checkpoint, motions)) < len(motions),
        "prediction_error": dict(zip(metrics.PAPER_TIMES_MS, errors.mean(0), strict=True)),
        "prediction_error_standard_error": dict(
            zip(metrics.PAPER_TIMES_MS, metrics.standard_error(errors), strict=True)
        ),
        "motion_change": {"true": run.true_change, "at": at},
        "standstill": {"count": int(np.isfinite(standstill).sum()), "seconds": standstill},
        "freezing": {"count": int(np.isfinite(freezing).sum()), "seconds": freezing},
        "divergence": {"count": int(np.isfinite(divergence).sum()), "seconds": divergence},
        **flaws(run),
    })  # fmt: skip


def flaws(run: Rollouts) -> dict[str, Any]:
    """``foot_skate`` and ``bone_drift``, generated and true, as :func:`evaluate` gives them."""
    fps, skeleton = run.fps, run.representation.skeleton

    def drift(positions: np.ndarray) -> float:
        bones = (skeleton.bone_lengths > 0).any()  # a figure of one node has none that could change
        return metrics.bone_length_drift(positions, skeleton).mean() if bones else math.nan

    true_positions = [motion.positions for motion in run.clips]
    try:
        feet = metrics.foot_joints(skeleton)
        # a height that drifts would leave most steps out, so all motions are put on the ground first
        skates = [metrics.foot_skate(settled_positions(x, fps), feet, fps) for x in run.positions]
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
    return {
        "foot_skate": skate,
        "bone_drift": {
            "generated": drift(run.positions),
            "true": _weighted([(drift(x), len(x)) for x in true_positions]),
        },
    }


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
        "standard error      "
        + "  ".join(f"{ms} ms {number(e, '.2g')}" for ms, e in result["prediction_error_standard_error"].items()),
        f"motion change       true {number(true)} a frame; after "
        + "  ".join(f"{frame}: {number(c)}" + (f" ({c / true:.0%})" if c is not None else "")
                    for frame, c in change["at"].items()),
    ]  # fmt: skip
    frozen = min(metrics.FREEZING["seconds"], result["frames"] / result["fps"])
    for name, word in (
        ("standstill", "stands still, 1 s"), ("freezing", f"freezes, {frozen:g} s"),
        ("divergence", "leaves human poses"),
    ):  # fmt: skip
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


def jsonable(value: Any) -> Any:
    """Plain numbers; infinity and NaN, which JSON has not, become ``None``."""
    if isinstance(value, dict):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [jsonable(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
