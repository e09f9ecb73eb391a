"""What the VAE-LSTM paper does not measure: many samples of one path, the line between two codes, steps and sliding
feet, how far somebody goes from a path, and what a second of motion costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from ..cleanup import clean_up
from ..clip_errors import frames_in_clip, joint_error, sample_diversity
from ..data.windows import evaluation_windows
from ..evaluate_control import cost, gait_of, measured_walk
from ..generate import prepare_for
from ..generate_control import features_from_code, generate_control_features, prior_code
from ..motion.clip import Motion
from ..representations import Representation
from ..training.checkpoints import Checkpoint
from .results import rounded
from .vae_lstm_plan import Protocol

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
        "speed": {"ms": {str(count): cost(checkpoint, count, protocol.seconds) for count in (1, protocol.samples)}},
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


# --- walking --------------------------------------------------------------------------------------


def walk(checkpoint: Checkpoint, name: str, protocol: Protocol) -> dict[str, Any]:
    """:func:`tutorial_lib.evaluate_control.measured_walk` of a few people on a prepared path."""
    return measured_walk(checkpoint, name, protocol.pace, count=WALKS)


def steps(checkpoint: Checkpoint, truth: np.ndarray, control: np.ndarray) -> dict[str, Any]:
    """:func:`tutorial_lib.evaluate_control.gait_of` some test windows, of true motion and of prior samples, ``before``
    and ``after`` the clean-up."""
    representation = checkpoint.representation
    made = generate_control_features(checkpoint, control)
    made[..., representation.slices["control"]] = control
    some = np.linspace(0, len(truth) - 1, min(CLEANED, len(truth))).astype(int)
    found = {}
    for name, features in (("true", truth), ("made", made)):
        motions = [representation.decode(x) for x in features[some]]
        found[name] = {"before": gait_of(motions), "after": gait_of([clean_up(motion) for motion in motions])}
    return found
