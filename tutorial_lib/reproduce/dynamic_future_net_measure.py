"""One network of ``reproduce dynamic-future-net``: trained to its end and measured."""

from __future__ import annotations

import pathlib
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from .. import metrics, pretrained
from ..actions import accuracy, train_classifier, transitions
from ..data.windows import evaluation_windows
from ..diversity import (
    band_coverage,
    mean_distance,
    mean_distance_band,
    nearest_window,
    pairwise_distance,
    windows_of,
)
from ..generate import SEED_FRAMES, generate_features, prepare_for
from ..generate_control import generate_control_features
from ..generate_futures import Futures, generate_futures, reconstruct, reconstruct_sequences
from ..metrics import foot_joints, foot_slide
from ..models.dynamic_future_net import STAGES
from ..motion.clip import Motion, settled_positions
from ..recipes import Recipe, recipe_in, trainer_for
from ..representations import BodyFrame, Representation
from ..training.checkpoints import Checkpoint, load_checkpoint, read_header
from ..view.latent_plot import main_directions
from .dynamic_future_net_plan import NETWORKS, SHIPPED, Network, Plan, Protocol, name_of, sets_for
from .failures import Truth, failures
from .grid import Report, Run, clips_for, one_thread, train
from .results import rounded

CURVE = 4  # frames between those at which a band is kept
DATA_POSES = 4000  # of each action, from which the data's band is taken
DATA_WINDOWS = 4000  # of the training clips, in which a copy is looked for

Clips = Mapping[str, Sequence[Motion]]  # of each action


def train_and_measure(run: Run, folder: pathlib.Path, plan: Plan, report: Report) -> dict[str, Any]:
    """A run trained to its end, and its entry in the result."""
    sets = sets_for(run)
    train(run, folder, report, sets)
    entry = entry_of(load_checkpoint(run.path(folder)), run.recipe, name_of(run), sets, plan.protocol)
    report(run.name, run.recipe.steps + 1)
    return entry


def measure_published(name: str, protocol: Protocol, report: Report) -> dict[str, Any]:
    """The entry of weights that come with the library, on the clips that were kept out when they were trained."""
    recipe = recipe_in(read_header(pretrained.path(name)))
    return entry_of(pretrained.load(name), recipe, SHIPPED, clips_for(recipe), protocol)


def entry_of(checkpoint: Checkpoint, recipe: Recipe, name: str, sets: Sequence[tuple[list[Motion], list[Motion]]],
             protocol: Protocol) -> dict[str, Any]:  # fmt: skip
    """What the result says of a trained network."""
    network = NETWORKS[name]
    clips = [{action: prepare_for(checkpoint, part[k]) for action, part in zip(network.actions, sets, strict=True)}
             for k in (0, 1)]  # fmt: skip
    return {
        "label": name,
        "title": network.title,
        "system": network.system,
        "actions": network.actions,
        "train_seconds": sum(m.duration for each in clips[0].values() for m in each),
        "recipe": recipe.to_dict(),
        "parameters": checkpoint.n_parameters,
        "seconds": checkpoint.training["seconds"],
        "loss": checkpoint.training["loss"],
        **measure(checkpoint, *clips, network, protocol),
    }


def measure(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips, network: Network,
            protocol: Protocol) -> dict[str, Any]:  # fmt: skip
    """All that is told of one network. Clips are of its size and frame rate, as ``generate.prepare_for`` makes them."""
    if network.system == "vae-lstm":
        return {"fan": vae_fan(checkpoint, test_clips, protocol)}
    if network.system == "aclstm":
        return {"stability": stability(checkpoint, train_clips, test_clips, protocol)[0],
                "fan": deterministic_fan(checkpoint, test_clips, protocol)}  # fmt: skip
    found, windows = stability(checkpoint, train_clips, test_clips, protocol)
    return {
        "stability": found,
        "copies": copies(checkpoint.representation, train_clips, test_clips, windows, protocol),
        "fan": fan(checkpoint, train_clips, test_clips, protocol, network),
        "data": {action: data_fan(checkpoint.representation, clips, protocol) for action, clips in train_clips.items()},
        "transitions": changes(checkpoint, train_clips, test_clips, protocol) if network.joint else None,
        "reconstruction": reconstruction(checkpoint, test_clips),
        "paths": latent_paths(checkpoint, train_clips, test_clips, protocol) if network.figures else None,
    }


def joints_of(representation: Representation, features: np.ndarray) -> np.ndarray:
    """The poses ``(..., T, 3 J)`` in features that have the joints in the body's frame."""
    return features[..., representation.slices["joints"]]


def encoded(representation: Representation, clips: Sequence[Motion]) -> list[np.ndarray]:
    """Features (T, D) of each clip."""
    return [representation.encode(clip) for clip in clips]


def prefixes_of(representation: Representation, clips: Sequence[Motion], count: int, frames: int) -> np.ndarray:
    """(count, frames, D): beginnings spread over the clips."""
    return evaluation_windows(clips, representation, seed_frames=frames, future_frames=0, count=count)[0].numpy()


# --- stability ------------------------------------------------------------------------------------


def stability(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips,
              protocol: Protocol) -> tuple[dict[str, Any], np.ndarray]:  # fmt: skip
    """Motions of 900 frames by the rules of :mod:`.failures`, from prefixes of each action; and the motions' features.

    True motion is what all training clips of the network are: a joint network may change its action.
    """
    representation = checkpoint.representation
    truth = Truth.of(*([m for clips in each.values() for m in clips] for each in (train_clips, test_clips)),
                     representation)  # fmt: skip
    frames = protocol.prefix if checkpoint.system == "dynamic-future-net" else SEED_FRAMES
    found, everything = {}, []
    for action, clips in test_clips.items():
        prefixes = prefixes_of(representation, clips, protocol.stable, frames)
        made = generate_features(checkpoint, prefixes, protocol.frames)
        found[action] = {
            **failures(prefixes, made, representation, truth),
            "foot_slide": {"generated": _slide(representation, made),
                           "true": _slide(representation, encoded(representation, clips))},
            "bone_drift": float(max(metrics.bone_length_drift(representation.decode_positions(x),
                                                              representation.skeleton, reduce="max").max()
                                    for x in made)),
        }  # fmt: skip
        everything.append(made)
    return found, np.concatenate(everything)


def _slide(representation: Representation, motions: Sequence[np.ndarray]) -> float:
    """Centimetres a step, mean over features (T, D); each put on the ground first. NaN where nothing touches it."""
    feet, fps = foot_joints(representation.skeleton), representation.fps
    each = [foot_slide(settled_positions(representation.decode_positions(x), fps), feet, fps) for x in motions]
    return float(np.nanmean(each)) if np.isfinite(each).any() else float("nan")


# --- copies ---------------------------------------------------------------------------------------


def copies(representation: Representation, train_clips: Clips, test_clips: Clips, made: np.ndarray,
           protocol: Protocol) -> dict[str, Any]:  # fmt: skip
    """How near generated windows come to the training clips, and how near windows of the clips kept out do.

    ``{"generated": quartiles, "held_out": quartiles}`` in metres; windows of a clip kept out that a network has
    begun with are not in what it made.
    """

    def windows(clips: Sequence[np.ndarray], stride: int) -> np.ndarray:
        return np.concatenate([windows_of(joints_of(representation, x), protocol.window, stride) for x in clips
                               if len(x) >= protocol.window])  # fmt: skip

    trained = [x for clips in train_clips.values() for x in encoded(representation, clips)]
    held = [x for clips in test_clips.values() for x in encoded(representation, clips)]
    stride = max(1, sum(map(len, trained)) // DATA_WINDOWS)
    among = windows(trained, stride)
    found = {"window": protocol.window}
    for name, clips, every in (("generated", made, 2 * protocol.window), ("held_out", held, protocol.window // 3)):
        distance = nearest_window(windows(clips, every), among)
        found[name] = rounded(np.quantile(distance, (0.25, 0.5, 0.75)))
    return found


# --- the fan --------------------------------------------------------------------------------------


def fan(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips, protocol: Protocol,
        network: Network) -> dict[str, Any]:  # fmt: skip
    """Thousands of futures of one prefix of each action: section 6.3, figures 8 and 9.

    For each prefix ``pairwise`` distance and ``band`` (mean, deviation) every :data:`CURVE` frames, the data's band of
    all that the network has learnt and of that action alone, the share of their areas that is covered, and the seconds
    that it took. Where figures are wanted also some of the latent z and s at two times, in their two main directions.
    """
    representation = checkpoint.representation
    poses = {action: _some(np.concatenate([joints_of(representation, x) for x in encoded(representation, clips)]),
                           DATA_POSES) for action, clips in train_clips.items()}  # fmt: skip
    least = min(map(len, poses.values()))  # so that each action counts the same
    whole = mean_distance_band(np.concatenate([_some(x, least) for x in poses.values()])[:, None])
    at = np.arange(CURVE - 1, protocol.fan_frames, CURVE)
    found: dict[str, Any] = {"frames": (at + 1).tolist(), "data": _band(whole), "prefixes": {}}
    for action, clips in test_clips.items():
        prefix = prefixes_of(representation, clips, 1, protocol.prefix)
        start = time.process_time()
        made = generate_futures(
            checkpoint, protocol.fan_frames, prefix=prefix, count=protocol.fan if network.many else protocol.pairs
        )
        seconds = time.process_time() - start
        features = joints_of(representation, made.features(slice(CURVE - 1, None, CURVE)))  # (K, n, P)
        own = mean_distance_band(poses[action][:, None])
        entry = {
            "motions": len(made),
            "seconds": round(seconds, 2),
            **compared(features, whole, protocol),
            "own": {"data": _band(own), "coverage": compared(features, own, protocol)["coverage"]},
        }
        if network.figures:
            entry["latent"] = latent_points(made, protocol)
        found["prefixes"][action] = entry
    return found


def compared(poses: np.ndarray, data: Any, protocol: Protocol) -> dict[str, Any]:
    """Futures ``(K, n, P)`` of one prefix: pairwise distance, band, and how much of the data's band they cover."""
    band = mean_distance_band(poses)
    low, high, data_low, data_high = (
        edge for b in (band, data) for edge in (b.mean - b.deviation, b.mean + b.deviation)
    )
    distance = mean_distance(poses[:, -1:])[:, 0]
    return {
        "pairwise": rounded(pairwise_distance(poses[: protocol.pairs])),
        "band": [rounded(band.mean), rounded(band.deviation)],
        "coverage": float(band_coverage(low, high, data_low, data_high)),
        "spread": rounded(np.quantile(distance, (0.05, 0.5, 0.95))),
    }


def _band(band: Any) -> list[float]:
    return [float(band.mean[0]), float(band.deviation[0])]


def _some(values: np.ndarray, count: int) -> np.ndarray:
    """Evenly thinned to ``count`` at most."""
    return values[np.linspace(0, len(values) - 1, min(count, len(values))).astype(int)]


def latent_points(made: Futures, protocol: Protocol) -> dict[str, Any]:
    """Figure 8: ``{"z" or "s": {frame: points (n, 2)}}`` of some of the motions."""
    found = {}
    for name, values in (("z", made.made.code), ("s", made.made.current)):
        there = np.stack([values[:, t - 1].numpy() for t in protocol.at])  # (times, K, C)
        mean, main = main_directions(there)
        found[name] = {str(t): rounded((x[: protocol.points] - mean) @ main, 3)
                       for t, x in zip(protocol.at, there, strict=True)}  # fmt: skip
    return found


def data_fan(representation: Representation, clips: Sequence[Motion], protocol: Protocol) -> dict[str, Any] | None:
    """What the data themselves do after beginnings that are alike, for a fan to be held against.

    Of places spread over the clips the ``protocol.similar`` that begin most alike (the prefix's frames, no two within
    half a second of each other) are followed: pairwise distance, and the mean distance to their mean (corrected for so
    few), at ``protocol.at``. ``alike``: how far from the first the last of them begins, metres a joint. None where
    clips are too short.
    """
    length, gap = protocol.prefix + protocol.fan_frames, round(representation.fps / 2)
    each = [windows_of(joints_of(representation, x), length, 2) for x in encoded(representation, clips)
            if len(x) >= length]  # fmt: skip
    if not each:
        return None
    windows = np.concatenate(each)
    clip = np.repeat(np.arange(len(each)), [len(w) for w in each])
    place = 2 * np.concatenate([np.arange(len(w)) for w in each])
    begin = torch.from_numpy(windows[:, : protocol.prefix].reshape(len(windows), -1))
    scale = (3 / begin.shape[1]) ** 0.5
    found, alike = [], []
    for k in _some(np.arange(len(windows)), 32):
        distance = torch.cdist(begin[k : k + 1], begin)[0].numpy() * scale
        kept: list[int] = []
        for j in np.argsort(distance):
            if all(clip[j] != clip[i] or abs(place[j] - place[i]) > gap for i in kept):
                kept.append(int(j))
            if len(kept) == protocol.similar:
                break
        if len(kept) < 2:
            return None
        after = windows[kept][:, [protocol.prefix + t - 1 for t in protocol.at]]
        unbiased = (len(kept) / (len(kept) - 1)) ** 0.5
        found.append([pairwise_distance(after), mean_distance_band(after).mean * unbiased])
        alike.append(distance[kept[-1]])
    pairwise, band = np.mean(found, axis=0)
    return {"pairwise": rounded(pairwise), "band": rounded(band), "alike": float(np.mean(alike))}


# --- beside it ------------------------------------------------------------------------------------


def deterministic_fan(checkpoint: Checkpoint, test_clips: Clips, protocol: Protocol) -> dict[str, Any]:
    """What a network that predicts the next frame makes of one prefix, several times: poses in the body's frame."""
    representation, found = checkpoint.representation, {}
    body = BodyFrame(representation.skeleton, representation.fps)
    for action, clips in test_clips.items():
        prefix = prefixes_of(representation, clips, 1, protocol.prefix)
        made = generate_features(checkpoint, np.repeat(prefix, 4, 0), protocol.fan_frames)
        poses = np.stack([joints_of(body, body.encode_arrays(x, None)) for x in representation.decode_positions(made)])
        found[action] = {"pairwise": rounded(pairwise_distance(poses[:, [t - 1 for t in protocol.at]]), 3)}
    return {"prefixes": found}


def vae_fan(checkpoint: Checkpoint, test_clips: Clips, protocol: Protocol) -> dict[str, Any]:
    """Prior samples of the VAE-LSTM along the control of one test window of each action, a code each and one a step."""
    representation, found = checkpoint.representation, {}
    count = min(protocol.fan, 256)
    length = protocol.fan_frames - protocol.fan_frames % checkpoint.model.config.stride
    for action, clips in test_clips.items():
        clip = max(clips, key=len)
        features = representation.encode(clip)
        control = np.resize(features[:, representation.slices["control"]], (length, 3))  # short ones over again
        many, entry = np.broadcast_to(control, (count, *control.shape)), {}
        for codes in ("one", "per-step"):
            poses = joints_of(representation, generate_control_features(checkpoint, many, codes=codes))
            at = [min(t, length) - 1 for t in protocol.at]
            entry[codes] = rounded(pairwise_distance(poses[:, at]), 3)
        found[action] = {"pairwise": entry["one"], "pairwise, a code a step": entry["per-step"]}
    return {"prefixes": found}


# --- actions, reconstruction, paths ---------------------------------------------------------------


def changes(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips, protocol: Protocol) -> dict[str, Any]:
    """How often one action becomes another in motions of 600 frames, a quarter of them begun with each."""
    representation = checkpoint.representation
    known = {action: encoded(representation, clips) for action, clips in train_clips.items()}
    classifier = train_classifier(known, steps=protocol.lessons)
    prefixes = [prefixes_of(representation, clips, max(1, min(protocol.many // len(test_clips), sum(
                    max(0, len(m) - protocol.prefix + 1) for m in clips))), protocol.prefix)
                for clips in test_clips.values()]  # fmt: skip
    each = protocol.many // len(test_clips)
    prefixes = np.concatenate([np.resize(x, (each, *x.shape[1:])) for x in prefixes])
    made = generate_futures(checkpoint, protocol.many_frames, prefix=prefixes)
    found = transitions(classifier, made.features(), representation.fps)
    return {
        "actions": found.actions,
        "accuracy": accuracy(classifier, {a: encoded(representation, clips) for a, clips in test_clips.items()}),
        "motions": found.motions,
        "frames": protocol.many_frames,
        "counts": found.counts.tolist(),
        "kinds": found.kinds,
        "changed": found.changed,
        "share": rounded(found.share),
    }


def reconstruction(checkpoint: Checkpoint, test_clips: Clips) -> dict[str, float]:
    """Stages 1 and 2 alone: mean distance of a joint in the world, centimetres, on clips kept out."""
    found = {}
    for stage, function in (("pose", reconstruct), ("future", reconstruct_sequences)):
        off = []
        for clips in test_clips.values():
            for clip in clips:
                made = function(checkpoint, clip)
                gap = (made.positions - made.positions[:, :1]) - (clip.positions - clip.positions[:, :1])[: len(made)]
                off.append(np.linalg.norm(gap, axis=-1).mean())
        found[stage] = 100 * float(np.mean(off))
    return found


@torch.no_grad()
def latent_paths(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips, protocol: Protocol) -> dict[str, Any]:
    """Figures 6 and 7 in the two main directions of the training clips' codes: paths of a clip of each action, and of
    futures of one prefix."""
    network, representation = checkpoint.model, checkpoint.representation
    codes = {action: network.pose.encode(torch.from_numpy(encoded(representation, clips[:1])[0])).numpy()
             for action, clips in train_clips.items()}  # fmt: skip
    mean, main = main_directions(np.concatenate(list(codes.values())))

    def drawn(path: np.ndarray) -> list:
        return rounded((path - mean) @ main, 3)

    futures = {}
    for action, clips in test_clips.items():
        prefix = prefixes_of(representation, clips, 1, protocol.prefix)
        made = generate_futures(checkpoint, protocol.fan_frames, prefix=prefix, count=protocol.paths)
        futures[action] = [drawn(made.codes(k).numpy()[protocol.prefix - 1 :]) for k in range(len(made))]
    frames = protocol.fan_frames
    return {"clips": {action: drawn(path[:frames]) for action, path in codes.items()}, "futures": futures}


# --- cost -----------------------------------------------------------------------------------------


def seconds_of_measuring(run: Run, plan: Plan) -> float:
    """How long measuring a network takes about: making its fans, from a few frames of some with fresh weights, twice
    over for all that is done with them."""
    network, sets, protocol = NETWORKS[name_of(run)], sets_for(run), plan.protocol
    if not network.futures:
        return 10.0
    trainer = trainer_for(run.recipe, sets=sets)
    trainer.model.stages_done.fill_(len(STAGES))
    checkpoint = Checkpoint(run.recipe.system, trainer.model.eval(), trainer.batches.representation, None, {}, {})
    count, frames = min(256, protocol.fan), min(16, protocol.fan_frames)
    with one_thread():
        start = time.monotonic()
        generate_futures(checkpoint, frames, count=count)
        each = (time.monotonic() - start) / (count * frames)
    return 2 * each * (protocol.fan if network.many else protocol.pairs) * protocol.fan_frames * len(network.actions)
