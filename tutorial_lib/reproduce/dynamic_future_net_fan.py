"""Fans of futures in ``reproduce dynamic-future-net``: how far apart they are, where they go in the latent space, what
the data and other networks do in their place."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from ..data.windows import evaluation_windows
from ..diversity import Band, band_coverage, mean_distance, mean_distance_band, pairwise_distance, windows_of
from ..generate import generate_features
from ..generate_control import generate_control_features
from ..generate_futures import Futures, generate_futures
from ..motion.clip import Motion
from ..representations import BodyFrame, Representation
from ..training.checkpoints import Checkpoint
from ..view.latent_plot import main_directions
from .dynamic_future_net_plan import Network, Protocol
from .results import rounded

CURVE = 4  # frames between those at which a band is kept
DATA_POSES = 4000  # of each action, from which the data's band is taken

Clips = Mapping[str, Sequence[Motion]]  # of each action


def joints_of(representation: Representation, features: np.ndarray) -> np.ndarray:
    """The poses ``(..., T, 3 J)`` in features that have the joints in the body's frame."""
    return features[..., representation.slices["joints"]]


def world_of(representation: Representation, features: np.ndarray) -> np.ndarray:
    """The same joints ``(..., T, 3 J)`` in the world: before the first frame all stand in one place and face one way,
    and where they go and turn to from there is in it."""
    before = np.concatenate((features[..., :1, :], features), -2)  # no step leads to the first frame of a motion
    return representation.decode_positions(before)[..., 1:, :, :].reshape(*features.shape[:-1], -1)


def encoded(representation: Representation, clips: Sequence[Motion]) -> list[np.ndarray]:
    """Features (T, D) of each clip."""
    return [representation.encode(clip) for clip in clips]


def prefixes_of(representation: Representation, clips: Sequence[Motion], count: int, frames: int) -> np.ndarray:
    """(count, frames, D): beginnings spread over the clips."""
    return evaluation_windows(clips, representation, seed_frames=frames, future_frames=0, count=count)[0].numpy()


# --- the fan --------------------------------------------------------------------------------------


def fan(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips, protocol: Protocol,
        network: Network) -> dict[str, Any]:  # fmt: skip
    """Thousands of futures of one prefix of each action: section 6.3, figures 8 and 9.

    For each prefix ``pairwise`` distance and ``band`` (mean, deviation) every :data:`CURVE` frames, the data's band of
    all that the network has learnt and of that action alone, the share of their areas that is covered, the pairwise
    distance in the ``world`` at ``protocol.at``, and the seconds that it took. Where figures are wanted also some of
    the latent z and s at two times, in their two main directions.
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
        curve = joints_of(representation, made.features(slice(CURVE - 1, None, CURVE)))  # (K, n, P)
        own = mean_distance_band(poses[action][:, None])
        entry = {
            "motions": len(made),
            "seconds": round(seconds, 2),
            **compared(curve, whole, protocol),
            "own": {"data": _band(own), "coverage": compared(curve, own, protocol)["coverage"]},
            "world": apart_in_the_world(representation, made.features(motions=slice(protocol.pairs)), protocol),
        }
        if network.figures:
            entry["latent"] = latent_points(made, protocol)
        found["prefixes"][action] = entry
    return found


def compared(poses: np.ndarray, data: Band, protocol: Protocol) -> dict[str, Any]:
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


def apart_in_the_world(representation: Representation, features: np.ndarray, protocol: Protocol) -> list[float]:
    """Pairwise distance at ``protocol.at`` of motions ``(K, T, D)`` that go on from one place."""
    world = world_of(representation, features)
    return rounded(pairwise_distance(world[:, [t - 1 for t in protocol.at]]))


def _band(band: Band) -> list[float]:
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
    half a second of each other) are followed: pairwise distance, the mean distance to their mean (corrected for so
    few) and the pairwise distance in the ``world``, at ``protocol.at``. ``alike``: how far from the first the last of
    them begins, metres a joint. None where clips are too short.
    """
    length, gap = protocol.prefix + protocol.fan_frames, round(representation.fps / 2)
    each = [windows_of(x, length, 2) for x in encoded(representation, clips) if len(x) >= length]
    if not each:
        return None
    features = np.concatenate(each)
    windows = joints_of(representation, features)
    clip = np.repeat(np.arange(len(each)), [len(w) for w in each])
    place = 2 * np.concatenate([np.arange(len(w)) for w in each])
    begin = torch.from_numpy(windows[:, : protocol.prefix].reshape(len(windows), -1))
    scale = (3 / begin.shape[1]) ** 0.5
    found, alike, world = [], [], []
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
        world.append(apart_in_the_world(representation, features[kept, protocol.prefix :], protocol))
    pairwise, band = np.mean(found, axis=0)
    return {"pairwise": rounded(pairwise), "band": rounded(band), "world": rounded(np.mean(world, axis=0)),
            "alike": float(np.mean(alike))}  # fmt: skip


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
