"""One network of ``reproduce acrnn``: trained to its end, measured, its long samples."""

from __future__ import annotations

import dataclasses
import pathlib
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import metrics, pretrained
from ..data.windows import evaluation_windows
from ..errors import DataError
from ..evaluate import flaws, roll_out, unseen
from ..generate import choose_windows, generate_features, prepare_for
from ..motion.clip import Motion
from ..recipes import Recipe, recipe_in, trainer_for
from ..threads import torch_threads
from ..training.checkpoints import Checkpoint, load_checkpoint, read_header
from .acrnn_plan import LONG_RUNS, Protocol
from .failures import Truth, failures
from .grid import Clips, Report, Run, clips_for, train, trained_with
from .results import rounded


def train_and_measure(
    run: Run, folder: pathlib.Path, protocol: Protocol, long: bool, report: Report
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any] | None]:
    """A run trained to its end and measured: what its split is like, the run's entry, its long samples if asked."""
    sets = clips_for(run.recipe)
    train(run, folder, report, sets)
    checkpoint = load_checkpoint(run.path(folder))
    train_clips, test_clips = sets[0]
    truth = Truth.of(train_clips, test_clips, checkpoint.representation)
    measured = {**_described(run, checkpoint), **measure(checkpoint, train_clips, test_clips, truth, protocol)}
    split = {
        "train": [m.name for m in train_clips],
        "test": [m.name for m in test_clips],
        "train_seconds": sum(m.duration for m in train_clips),
        "test_seconds": sum(m.duration for m in test_clips),
        "truth": truth.to_dict(),
        "last_frame": measured.pop("last_frame"),
    }
    long_one = long_samples(checkpoint, test_clips, truth, protocol) if long else None
    report(run.name, run.recipe.steps + 1)
    return split, measured, long_one


def _described(run: Run, checkpoint: Checkpoint) -> dict[str, Any]:
    options = run.recipe.options
    style, name = run.name.split("/")
    return {
        "style": style,
        "system": run.recipe.system,
        "label": name.removesuffix(f"-seed{run.recipe.seed}"),
        "seed": run.recipe.seed,
        "u": options.get("u"),
        "v": options.get("v"),
        **trained_with(run.recipe, checkpoint),
    }


CURVE_SMOOTH, CURVE_EVERY = 15, 5


def measure(
    checkpoint: Checkpoint,
    train_clips: Sequence[Motion],
    test_clips: Sequence[Motion],
    truth: Truth,
    protocol: Protocol,
) -> dict[str, Any]:
    """The measures of one network, see :mod:`tutorial_lib.reproduce.acrnn`; also ``last_frame``, which needs none."""
    run = roll_out(checkpoint, test_clips, reference=train_clips, count=protocol.seeds, frames=protocol.frames,
                   seed_frames=protocol.seed_frames)  # fmt: skip
    errors = run.errors()  # (seeds, times)
    change = run.change[:, : protocol.curve].mean(0)
    still = np.repeat(run.seeds[:, -1:], run.truth.shape[1], axis=1)
    return {
        "error": rounded(errors.mean(0)),
        "standard_error": rounded(metrics.standard_error(errors)),
        "errors": rounded(errors.T, 4),
        "motion_change": {
            "every": CURVE_EVERY,
            "smooth": CURVE_SMOOTH,
            "frames": len(change),
            "values": rounded(_smoothed(change)[::CURVE_EVERY], 3),
        },
        "failures": failures(run.seeds, run.made, run.representation, truth),
        **flaws(run),
        "last_frame": rounded(metrics.prediction_error(still, run.truth, run.fps)),
    }


def _smoothed(curve: np.ndarray) -> np.ndarray:
    """The running mean over ``CURVE_SMOOTH`` frames, centred, as long as the curve: at its ends over fewer."""
    half = CURVE_SMOOTH // 2
    return np.array([curve[max(0, t - half) : t + half + 1].mean() for t in range(len(curve))])


# --- long samples ---------------------------------------------------------------------------------


def long_samples(checkpoint: Checkpoint, clips: Sequence[Motion], truth: Truth, protocol: Protocol) -> dict[str, Any]:
    """Failures in long samples after seeds from clips; what :func:`failures` gives, and where the seeds are from."""
    seeds, _ = evaluation_windows(
        prepare_for(checkpoint, clips), checkpoint.representation,
        seed_frames=protocol.seed_frames, future_frames=0, count=protocol.long_samples,
    )  # fmt: skip
    return _long(checkpoint, seeds.numpy(), truth, protocol, "test clips")


def _long(checkpoint: Checkpoint, seeds: np.ndarray, truth: Truth, protocol: Protocol, origin: str) -> dict[str, Any]:
    made = generate_features(checkpoint, seeds, protocol.long_frames)
    return {"seeds": origin, **failures(seeds, made, checkpoint.representation, truth)}


def published() -> list[str]:
    """The shipped weights that stand for the runs of :data:`LONG_RUNS`, as far as they are there."""
    there = {row.name for row in pretrained.list()}
    names = [f"{system}-cmu-{style}" for style, system in (name.split("/") for name in LONG_RUNS)]
    return [name for name in names if name in there]


def measure_published(name: str, protocol: Protocol, report: Report) -> dict[str, dict[str, Any]]:
    """Long samples of shipped weights, from clips never trained on and from their own seeds."""
    checkpoint = pretrained.load(name)
    train_clips, test_clips = clips_for(recipe_in(read_header(pretrained.path(name))))[0]
    fresh = unseen(checkpoint, [*train_clips, *test_clips])  # in a folder of other clips the split is another
    if not fresh:
        raise DataError(f"{name}: was trained on all clips at hand, so there are none to take seeds from")
    test_clips = fresh
    truth = Truth.of(train_clips, test_clips, checkpoint.representation)
    found = {f"{name} (test clips)": long_samples(checkpoint, test_clips, truth, protocol)}
    own = np.asarray(checkpoint.seed_frames)
    windows = choose_windows([len(s) for s in own], frames=protocol.seed_frames, count=protocol.long_samples)
    seeds = np.stack([own[k][start : start + protocol.seed_frames] for k, start in windows])
    found[f"{name} (own seeds)"] = _long(checkpoint, seeds, truth, protocol, "own")
    return found


def seconds_of_measuring(recipe: Recipe, sets: Clips, protocol: Protocol) -> float:
    """How long :func:`measure` will take, from a shorter one with fresh weights."""
    trainer = trainer_for(recipe, sets=sets)
    representation = trainer.batches.representation
    checkpoint = Checkpoint(recipe.system, trainer.model.eval(), representation, trainer.batches.normalizer, {}, {})
    train_clips, test_clips = sets[0]
    short = dataclasses.replace(protocol, frames=min(protocol.frames, 100))
    with torch_threads(1):
        start = time.monotonic()
        truth = Truth.of(train_clips, test_clips, representation)
        fixed = time.monotonic()
        measure(checkpoint, train_clips, test_clips, truth, short)
        return fixed - start + (time.monotonic() - fixed) * protocol.frames / short.frames
