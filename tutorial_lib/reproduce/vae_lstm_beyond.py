"""What the VAE-LSTM paper does not measure: sliding feet, many samples of one path, the line between two codes, how
far somebody goes from a path, and what a second of motion costs."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from .. import metrics
from ..cleanup import clean_up
from ..clip_errors import frames_in_clip, joint_error, sample_diversity
from ..control import path_control, path_deviation, prepared_path
from ..data.windows import evaluation_windows
from ..generate import prepare_for
from ..generate_control import features_from_code, generate_control_features, generate_from_control, prior_code
from ..motion.clip import Motion
from ..representations import Representation
from ..training.checkpoints import Checkpoint
from .results import rounded
from .vae_lstm_plan import Protocol

SHORTEST = 0.1  # s; a shorter touch of the ground is no step
WALKS = 4  # samples of each prepared path
CLEANED = 6  # test windows whose feet are cleaned up


def beyond(
    checkpoint: Checkpoint, train_clips: Sequence[Motion], test_clips: Sequence[Motion], protocol: Protocol
) -> dict[str, Any]:
    """All of it, for one network: ``diversity``, ``interpolation``, ``paths``, ``steps``, ``speed``."""
    representation = checkpoint.representation
    test_clips = prepare_for(checkpoint, test_clips)
    first, rest = evaluation_windows(test_clips, representation, seed_frames=1, future_frames=protocol.frames - 1,
                                     count=protocol.clips)  # fmt: skip
    truth = torch.cat((first, rest), 1).numpy()  # (K, T, D)
    control = truth[..., representation.slices["control"]]
    return {
        "diversity": diversity(checkpoint, control[0], protocol),
        "interpolation": interpolation(checkpoint, control[0], protocol),
        "paths": {name: walk(checkpoint, name, protocol) for name in protocol.paths},
        "steps": steps(checkpoint, truth, control),
        "speed": speed(checkpoint, control[0], protocol),
    }


def moved(representation: Representation, features: np.ndarray, control: np.ndarray) -> np.ndarray:
    """(..., T, J, 3) metres: what was made, moving as ``control`` (..., T, 3) says."""
    features = features.copy()
    features[..., representation.slices["control"]] = control
    return representation.decode_positions(features)


# --- samples --------------------------------------------------------------------------------------


def diversity(checkpoint: Checkpoint, control: np.ndarray, protocol: Protocol) -> dict[str, Any]:
    """How different ``protocol.samples`` prior samples of one control (T, 3) are, metres, for each use of the codes.

    ``given``: all moving as they were told; ``predicted``: as they say themselves. At the paper's frames.
    """
    representation = checkpoint.representation
    at = [k - 1 for k in frames_in_clip(representation.fps, protocol.at)]
    many, found = np.broadcast_to(control, (protocol.samples, *control.shape)), {}
    for codes in ("one", "per-step", "held"):
        made = generate_control_features(checkpoint, many, codes=codes)
        given, predicted = (
            sample_diversity(x) for x in (moved(representation, made, many), representation.decode_positions(made))
        )
        found[codes] = {"given": rounded(given[at]), "predicted": rounded(predicted[at]), "mean": float(given.mean())}
    return {"samples": protocol.samples, "codes": found}


def interpolation(checkpoint: Checkpoint, control: np.ndarray, protocol: Protocol) -> dict[str, Any]:
    """How the motion changes along the straight line between two codes of the prior, mean over ``protocol.pairs``.

    ends: metres between the motions of both ends at the paper's frames. change: metres from each of the
    ``protocol.codes`` codes to the next, mean over frames. length: the sum of these against the distance of the ends:
    1 where the motion goes straight from one to the other. largest: the largest of these changes against their mean:
    what jumps has a large one. For one code that starts the motion, and for one that is held.
    """
    representation, model = checkpoint.representation, checkpoint.model
    at = [k - 1 for k in frames_in_clip(representation.fps, protocol.at)]
    n, frames = protocol.codes, len(control)
    generator = torch.Generator().manual_seed(0)
    one, other = prior_code(model, protocol.pairs, generator), prior_code(model, protocol.pairs, generator)
    share = torch.linspace(0, 1, n)[:, None, None]
    line = (one + share * (other - one)).flatten(0, 1)  # (n pairs, H)
    many, found = np.broadcast_to(control, (len(line), *control.shape)), {}
    for codes in ("one", "held"):
        each = line if codes == "one" else line[:, None].expand(-1, -(-frames // model.config.stride), -1)
        made = moved(representation, features_from_code(checkpoint, many, each), many)
        made = made.reshape(n, protocol.pairs, *made.shape[1:])  # (n, pairs, T, J, 3)
        ends, change = (
            joint_error(made[-1], made[0]),
            joint_error(made[1:], made[:-1]).mean(-1),
        )  # (pairs, T), (n-1, ..)
        found[codes] = {
            "ends": rounded(ends.mean(0)[at]),
            "change": rounded(change.mean(1)),
            "length": float((change.sum(0) / ends.mean(-1)).mean()),
            "largest": float((change.max(0) / change.mean(0)).mean()),
        }
    return {"pairs": protocol.pairs, "codes": found}


# --- feet and paths -------------------------------------------------------------------------------


def walk(checkpoint: Checkpoint, name: str, protocol: Protocol) -> dict[str, Any]:
    """Prior samples on a prepared path, mean over a few: how far they go from it, in metres, and how their feet do.

    given, predicted: the deviation moving as told, or as the network says that it moves. stride: metres that the left
    foot swings about the hip, two standard deviations. slide: see :func:`slide`, moving as told.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of turns at which people slow down
        planned = path_control(prepared_path(name), protocol.pace, checkpoint.representation.fps)
    found: dict[str, Any] = {"seconds": len(planned.control) / planned.fps}
    for integrate in ("given", "predicted"):
        motions = generate_from_control(checkpoint, planned.control, fps=planned.fps, count=WALKS, integrate=integrate,
                                        place=planned.start, heading=planned.heading)  # fmt: skip
        each = [path_deviation(motion, planned.path) for motion in motions]
        found[integrate] = {k: float(np.mean([getattr(d, k) for d in each]))
                            for k in ("mean", "max", "mean_drift", "covered")}  # fmt: skip
        if integrate == "given":
            found["stride"] = float(np.mean([stride(checkpoint.representation.encode(m), checkpoint.representation)
                                             for m in motions]))  # fmt: skip
            found["slide"] = {"before": slide(motions[:1]), "after": slide([clean_up(motions[0])])}
    return found


def steps(checkpoint: Checkpoint, truth: np.ndarray, control: np.ndarray) -> dict[str, Any]:
    """Stride and slide on the test windows: of true motion and of prior samples, before and after the clean-up."""
    representation = checkpoint.representation
    made = generate_control_features(checkpoint, control)
    made[..., representation.slices["control"]] = control
    some = np.linspace(0, len(truth) - 1, min(CLEANED, len(truth))).astype(int)
    true_motions, motions = ([representation.decode(x) for x in features[some]] for features in (truth, made))
    return {
        "stride": {"true": stride(truth, representation), "made": stride(made, representation)},
        "slide": {
            "true": slide(true_motions),
            "true after": slide([clean_up(motion) for motion in true_motions]),
            "before": slide(motions),
            "after": slide([clean_up(motion) for motion in motions]),
        },
    }


def stride(features: np.ndarray, representation: Representation) -> float:
    """How far the left foot swings forth and back about the hip in features (..., T, D): two standard deviations, m."""
    foot = metrics.foot_joints(representation.skeleton)[0]
    still = features.copy()
    still[..., representation.slices["control"]] = 0.0  # nobody moves: the body's own frame
    forward = representation.decode_positions(still)[..., foot, 2]
    return float(2 * forward.std(-1).mean())


def slide(motions: Sequence[Motion]) -> float | None:
    """Centimetres that a foot node slides along the ground in one step, mean over the steps of all motions.

    A step is a stretch of contact (:func:`tutorial_lib.metrics.foot_contacts`) of 0.1 s or more, the slide the
    length of its way. None where nothing touches the ground.
    """
    ways = []
    for motion in motions:
        motion = motion.settled()
        feet = metrics.foot_joints(motion.skeleton)
        contact = metrics.foot_contacts(motion.positions, feet, motion.fps)  # (T - 1, F)
        way = np.linalg.norm(np.diff(motion.positions[:, feet][..., [0, 2]], axis=0), axis=-1)  # (T - 1, F)
        for held, moved_by in zip(contact.T, way.T, strict=True):
            edges = np.flatnonzero(np.diff(np.r_[False, held, False].astype(int)))
            for first, last in zip(edges[::2], edges[1::2], strict=True):
                if last - first >= SHORTEST * motion.fps:
                    ways.append(100 * moved_by[first:last].sum())
    return float(np.mean(ways)) if ways else None


# --- cost -----------------------------------------------------------------------------------------


def speed(checkpoint: Checkpoint, control: np.ndarray, protocol: Protocol) -> dict[str, Any]:
    """Milliseconds of CPU time for a second of motion, features and positions: {number of characters: ms}.

    With the threads that torch has, one in this command; the median of five.
    """
    fps = checkpoint.representation.fps
    long = np.resize(control, (round(protocol.seconds * fps), control.shape[-1]))
    found = {}
    for count in (1, protocol.samples):
        many, spent = np.broadcast_to(long, (count, *long.shape)), []
        for _ in range(6):
            start = time.process_time()
            made = generate_control_features(checkpoint, many)
            moved(checkpoint.representation, made, many)
            spent.append(1000 * (time.process_time() - start) / protocol.seconds)
        found[str(count)] = float(np.median(spent[1:]))  # the first keeps the decoder's weights
    return {"ms": found}
