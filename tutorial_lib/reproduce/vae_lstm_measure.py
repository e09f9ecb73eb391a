"""One network of ``reproduce vae-lstm``: trained to its end and measured as in tables 1 and 2 of the paper."""

from __future__ import annotations

import dataclasses
import math
import pathlib
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from .. import metrics
from ..clip_errors import ClipRollouts, frames_in_clip, motion_errors, pose_errors, roll_out_clips
from ..data.windows import evaluation_windows
from ..generate import prepare_for
from ..generate_control import features_from_code, generate_control_features, posterior_code
from ..motion.clip import Motion, settled_positions
from ..recipes import Recipe, trainer_for
from ..representations import Representation
from ..threads import torch_threads
from ..training.checkpoints import Checkpoint, load_checkpoint
from .cost import validated
from .grid import Clips, Report, Run, clips_for, train, trained_with
from .results import rounded
from .vae_lstm_beyond import beyond
from .vae_lstm_plan import SYSTEMS, VAE, Protocol, name_of

# How a network that predicts frames is asked: frames shown, and what of the rest it is given.
PREDICTED, GIVEN, GIVEN_LONG = "predicted control", "true control", "true control, 30 frames shown"
# And the VAE-LSTM, which is always given the true control: where its code is from.
PRIOR, POSTERIOR, PER_STEP, HELD = "prior", "posterior of 4 frames", "prior, a code a step", "prior, one code held"
CODES = {PRIOR: "one", PER_STEP: "per-step", HELD: "held"}


def train_and_measure(
    run: Run, folder: pathlib.Path, protocol: Protocol, report: Report
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any] | None]:
    """A run trained to its end and measured: what its split is like, the run's entry, and of the VAE-LSTM what the
    paper has not."""
    sets = clips_for(run.recipe)
    train(run, folder, report, sets)
    checkpoint = load_checkpoint(run.path(folder))
    train_clips, test_clips = ([motion for part in sets for motion in part[k]] for k in (0, 1))
    name = name_of(run)
    measured = {
        "label": name,
        "title": SYSTEMS[name].title,
        "seed": run.recipe.seed,
        **trained_with(run.recipe, checkpoint),
        "ways": measure(checkpoint, test_clips, protocol),
    }
    split = split_of(checkpoint, train_clips, test_clips, protocol)
    more = beyond(checkpoint, train_clips, test_clips, protocol) if name == VAE else None
    report(run.name, run.recipe.steps + 1)
    return split, measured, more


def measure(checkpoint: Checkpoint, clips: Sequence[Motion], protocol: Protocol) -> dict[str, dict[str, Any]]:
    """All ways in which a network is asked, each with its :func:`errors_of`."""
    return {way: errors_of(made, protocol) for way, made in rollouts(checkpoint, clips, protocol).items()}


def rollouts(
    checkpoint: Checkpoint, clips: Sequence[Motion], protocol: Protocol, ways: Sequence[str] | None = None
) -> dict[str, ClipRollouts]:
    """What a network makes of the test clips, in the ways named, by default all that it can be asked in.

    All networks are asked for the same windows of the clips.
    """
    if checkpoint.system == "vae-lstm":
        known = (PRIOR, POSTERIOR, PER_STEP, HELD)
        return {way: _follow(checkpoint, clips, protocol, way) for way in known if ways is None or way in ways}
    known = {
        PREDICTED: (protocol.shown, ()),
        GIVEN: (protocol.start, ("control",)),
        GIVEN_LONG: (protocol.shown, ("control",)),
    }
    return {
        way: roll_out_clips(checkpoint, clips, seed_frames=shown, frames=protocol.frames, given=given,
                            count=protocol.clips)
        for way, (shown, given) in known.items() if ways is None or way in ways
    }  # fmt: skip


def _follow(checkpoint: Checkpoint, clips: Sequence[Motion], protocol: Protocol, way: str) -> ClipRollouts:
    """The VAE-LSTM along the true control of the test windows; the control in what it makes is its own."""
    representation, stride = checkpoint.representation, checkpoint.model.config.stride
    truth = windows(prepare_for(checkpoint, clips), representation, protocol)
    control = truth[..., representation.slices["control"]]
    if way != POSTERIOR:
        made = generate_control_features(checkpoint, control, codes=CODES[way])
        return ClipRollouts(representation, made, truth, 0)
    first = checkpoint.normalizer.apply(torch.from_numpy(truth[:, :stride]))
    pose, _ = checkpoint.model.split(first)
    code = posterior_code(checkpoint.model, pose, torch.Generator().manual_seed(0))
    return ClipRollouts(representation, features_from_code(checkpoint, control, code), truth, stride)


def windows(clips: Sequence[Motion], representation: Representation, protocol: Protocol) -> np.ndarray:
    """(clips, frames, D): the test windows, features of clips that are prepared already."""
    first, rest = evaluation_windows(clips, representation, seed_frames=1, future_frames=protocol.frames - 1,
                                     count=protocol.clips)  # fmt: skip
    return torch.cat((first, rest), 1).numpy()


def errors_of(made: ClipRollouts, protocol: Protocol) -> dict[str, Any]:
    """Pose error, motion error, and motion error were the control the true one, of clips that were made.

    Each as ``error`` (metres) and ``squared`` (square metres) at the paper's frames, means over the clips, with their
    standard errors; ``clips``, the error of each clip there. ``curve``: the pose error at every frame.
    ``foot_skate``: cm/s, moving as the true control says.
    """
    representation = made.representation
    control = representation.slices["control"]
    moved = made.made.copy()
    moved[..., control] = made.truth[..., control]
    at = [k - 1 for k in frames_in_clip(representation.fps, protocol.at)]

    def told(function, features: np.ndarray) -> dict[str, Any]:
        plain, square = (function(representation, features, made.truth, squared) for squared in (False, True))
        return {
            "error": rounded(plain[:, at].mean(0)),
            "standard_error": rounded(metrics.standard_error(plain[:, at])),
            "squared": rounded(square[:, at].mean(0)),
            "squared_standard_error": rounded(metrics.standard_error(square[:, at])),
            "clips": rounded(plain[:, at], 4),
        }

    return {
        "shown": made.seed_frames,
        "pose": told(pose_errors, made.made),
        "motion": told(motion_errors, made.made),
        "motion_given": told(motion_errors, moved),
        "curve": rounded(pose_errors(representation, made.made, made.truth).mean(0), 4),
        "foot_skate": _skate(representation, moved),
    }


def _skate(representation: Representation, features: np.ndarray) -> float:
    """Centimetres a second, mean over clips (K, T, D); each put on the ground first."""
    feet, positions = metrics.foot_joints(representation.skeleton), representation.decode_positions(features)
    fps = representation.fps
    return float(np.mean([metrics.foot_skate(settled_positions(x, fps), feet, fps) for x in positions]))


# --- what needs no network ------------------------------------------------------------------------


def split_of(
    checkpoint: Checkpoint, train_clips: Sequence[Motion], test_clips: Sequence[Motion], protocol: Protocol
) -> dict[str, Any]:
    """The clips of a split, and what holding a pose would do on the test windows."""
    train_clips, test_clips = (prepare_for(checkpoint, clips) for clips in (train_clips, test_clips))
    representation = checkpoint.representation
    truth = windows(test_clips, representation, protocol)
    mean = np.concatenate([representation.encode(motion) for motion in train_clips]).mean(0)
    return {
        "train": [m.name for m in train_clips],
        "test": [m.name for m in test_clips],
        "train_seconds": sum(m.duration for m in train_clips),
        "test_seconds": sum(m.duration for m in test_clips),
        "long_enough": sum(len(m) >= protocol.frames for m in test_clips),
        "foot_skate": _skate(representation, truth),
        "references": {
            name: {way: errors_of(made, protocol) for way, made in held(representation, truth, mean, protocol).items()}
            for name, mean in (("mean pose", mean), ("last pose", None))
        },
    }


def held(
    representation: Representation, truth: np.ndarray, frame: np.ndarray | None, protocol: Protocol
) -> dict[str, ClipRollouts]:
    """Windows after whose first frames one frame is held, the last of them where ``frame`` is None.

    With its own control, which moves and turns on as that frame did, and with the true one.
    """
    control, found = representation.slices["control"], {}
    for way, shown in ((PREDICTED, protocol.shown), (GIVEN, protocol.start)):
        made = truth.copy()
        made[:, shown:] = truth[:, shown - 1 : shown] if frame is None else frame
        if way == GIVEN:
            made[..., control] = truth[..., control]
        found[way] = ClipRollouts(representation, made, truth, shown)
    return found


# --- before and for learning rates ----------------------------------------------------------------


def validation_error(run: Run, folder: pathlib.Path, protocol: Protocol, report: Report) -> float:
    """The geometric mean of table 1's motion error and table 2's pose error, each averaged over the times, on clips
    set aside from the training clips; of the VAE-LSTM from the prior."""

    def error(checkpoint: Checkpoint, aside: list[Motion]) -> float:
        first, second = (PRIOR, PRIOR) if checkpoint.system == "vae-lstm" else (PREDICTED, GIVEN)
        made = rollouts(checkpoint, aside, protocol, (first, second))
        motion, pose = errors_of(made[first], protocol)["motion"], errors_of(made[second], protocol)["pose"]
        both: Mapping[str, Any] = {"motion": motion["error"], "pose": pose["error"]}
        if any(value is None for errors in both.values() for value in errors):
            return math.inf
        return math.sqrt(np.mean(both["motion"]) * np.mean(both["pose"]))

    return validated(run, folder, report, error)


def seconds_of_measuring(recipe: Recipe, sets: Clips, protocol: Protocol) -> float:
    """How long measuring a network will take at least, from fewer clips and samples with fresh weights."""
    trainer = trainer_for(recipe, sets=sets)
    checkpoint = Checkpoint(recipe.system, trainer.model.eval(), trainer.batches.representation,
                            trainer.batches.normalizer, {}, {}, sway=trainer.sway)  # fmt: skip
    train_clips, test_clips = ([motion for part in sets for motion in part[k]] for k in (0, 1))
    short = dataclasses.replace(protocol, clips=min(protocol.clips, 3), samples=8, pairs=2, paths=protocol.paths[:1])
    with torch_threads(1):
        start = time.monotonic()
        measure(checkpoint, test_clips, short)
        split_of(checkpoint, train_clips, test_clips, short)
        if recipe.system == "vae-lstm":
            beyond(checkpoint, train_clips, test_clips, short)
        return time.monotonic() - start
