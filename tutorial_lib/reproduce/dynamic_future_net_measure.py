"""One network of ``reproduce dynamic-future-net``: trained to its end and measured."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import pathlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from .. import metrics, pretrained
from ..actions import accuracy, train_classifier, transitions
from ..diversity import nearest_window, windows_of
from ..evaluate import jsonable
from ..generate import SEED_FRAMES, generate_features, prepare_for
from ..generate_futures import generate_futures, reconstruct, reconstruct_sequences
from ..metrics import foot_joints, foot_slide
from ..models.dynamic_future_net import STAGES
from ..motion.clip import Motion, settled_positions
from ..motion.mirror import mirrored
from ..recipes import Recipe, recipe_in, trainer_for
from ..representations import BodyFrame, Representation
from ..threads import torch_threads
from ..training.checkpoints import Checkpoint, load_checkpoint, read_header
from .dynamic_future_net_fan import (
    Clips,
    data_fan,
    deterministic_fan,
    encoded,
    fan,
    joints_of,
    latent_paths,
    prefixes_of,
    vae_fan,
)
from .dynamic_future_net_plan import NETWORKS, SHIPPED, Network, Plan, Protocol, name_of, sets_for
from .failures import Truth, failures
from .grid import Report, Run, clips_for, train, trained_with
from .results import rounded, write_result

Sets = Sequence[tuple[list[Motion], list[Motion]]]  # (training clips, test clips) of each action

MEASURES = 2  # one more whenever more is measured: what was kept before is measured again
DATA_WINDOWS = 4000  # of the training clips at one rate and on one side, in which a copy is looked for


def train_and_measure(run: Run, folder: pathlib.Path, plan: Plan, report: Report) -> dict[str, Any]:
    """A run trained to its end, and its entry in the result."""
    sets = sets_for(run)
    train(run, folder, report, sets)
    path = run.path(folder)
    entry = kept(path, path.with_suffix(".json"), plan.protocol, sets,
                 lambda: entry_of(load_checkpoint(path), run.recipe, name_of(run), sets, plan.protocol))  # fmt: skip
    report(run.name, run.recipe.steps + 1)
    return entry


def measure_published(name: str, folder: pathlib.Path, protocol: Protocol, report: Report) -> dict[str, Any]:
    """The entry of weights that come with the library, on the clips that were kept out when they were trained."""
    path = pretrained.path(name)
    recipe = recipe_in(read_header(path))
    sets = clips_for(recipe)
    return kept(path, folder / f"{name}.json", protocol, sets,
                lambda: entry_of(pretrained.load(name), recipe, SHIPPED, sets, protocol))  # fmt: skip


def kept(weights: pathlib.Path, path: pathlib.Path, protocol: Protocol, sets: Sets,
         measured: Callable[[], dict[str, Any]]) -> dict[str, Any]:  # fmt: skip
    """What was measured of the same weights in the same way on the same clips, if ``path`` has it; else it is
    measured and kept there.

    Thousands of motions take minutes of each network: a command that was stopped need not make them again.
    """
    there = found_in(weights, path, protocol, sets)
    if there is None:
        there = jsonable(measured())
        write_result({**_asked(weights, protocol, sets), "entry": there}, path)
    return there


def found_in(weights: pathlib.Path, path: pathlib.Path, protocol: Protocol, sets: Sets) -> dict[str, Any] | None:
    """What :func:`kept` has in ``path`` of these weights, this protocol and these clips; None if nothing."""
    with contextlib.suppress(OSError, ValueError, TypeError):
        there, asked = json.loads(path.read_text(encoding="utf-8")), _asked(weights, protocol, sets)
        if {key: there.get(key) for key in asked} == asked and isinstance(there.get("entry"), dict):
            return there["entry"]
    return None


def _asked(weights: pathlib.Path, protocol: Protocol, sets: Sets) -> dict[str, Any]:
    return {"weights": hashlib.sha256(weights.read_bytes()).hexdigest(),
            "clips": [[[motion.name for motion in part] for part in each] for each in sets],
            "protocol": jsonable(dataclasses.asdict(protocol)),
            "measures": MEASURES}  # fmt: skip


def entry_of(checkpoint: Checkpoint, recipe: Recipe, name: str, sets: Sets,
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
        **trained_with(recipe, checkpoint),
        **measure(checkpoint, *clips, network, protocol),
    }


def measure(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips, network: Network,
            protocol: Protocol) -> dict[str, Any]:  # fmt: skip
    """All that is told of one network. Clips are of its size and frame rate, as ``generate.prepare_for`` makes them."""
    if network.system == "vae-lstm":
        return {"fan": vae_fan(checkpoint, test_clips, protocol)}
    truth = truth_of(checkpoint, train_clips, test_clips)
    if network.system == "aclstm":
        return {"stability": stability(checkpoint, truth, test_clips, protocol)[0],
                "fan": deterministic_fan(checkpoint, test_clips, protocol)}  # fmt: skip
    found, windows = stability(checkpoint, truth, test_clips, protocol)
    return {
        "stability": found,
        "stability_short": stability(checkpoint, truth, test_clips, protocol, prefix=protocol.short_prefix)[0],
        "copies": copies(checkpoint, train_clips, test_clips, windows, protocol),
        "fan": fan(checkpoint, train_clips, test_clips, protocol, network),
        "data": {action: data_fan(checkpoint.representation, clips, protocol) for action, clips in train_clips.items()},
        "transitions": changes(checkpoint, train_clips, test_clips, protocol) if network.joint else None,
        "reconstruction": reconstruction(checkpoint, test_clips),
        "paths": latent_paths(checkpoint, train_clips, test_clips, protocol) if network.figures else None,
    }


# --- stability ------------------------------------------------------------------------------------


def truth_of(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips) -> Truth:
    """True motion is what all training clips of the network are: a joint network may change its action. If it was shown
    their mirror images, these poses are true, too: who boxes with the other hand in front has not left what people do.
    """
    representation = checkpoint.representation
    truth = Truth.of(*([m for clips in each.values() for m in clips] for each in (train_clips, test_clips)),
                     representation)  # fmt: skip
    if checkpoint.training.get("mirror"):
        others = mirrored(Motion(representation.skeleton, representation.fps, truth.poses)).positions
        truth = dataclasses.replace(truth, poses=np.concatenate((truth.poses, others)))
    return truth


def stability(checkpoint: Checkpoint, truth: Truth, test_clips: Clips, protocol: Protocol,
              prefix: int | None = None) -> tuple[dict[str, Any], np.ndarray]:  # fmt: skip
    """Motions of 900 frames by the rules of :mod:`.failures`, from prefixes of each action; and the motions' features.

    ``prefix``: how many frames a Dynamic Future Net is given, by default those of the protocol.
    """
    representation = checkpoint.representation
    frames = (prefix or protocol.prefix) if checkpoint.system == "dynamic-future-net" else SEED_FRAMES
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


def copies(checkpoint: Checkpoint, train_clips: Clips, test_clips: Clips, made: np.ndarray,
           protocol: Protocol) -> dict[str, Any]:  # fmt: skip
    """How near generated windows come to what the network has learnt from, and how near windows of the clips kept out
    do: also to what it was shown slower, faster or mirrored, for a copy of that is a copy.

    made: features (K, T, D), as many motions begun with each action as with any other. ``{"generated": quartiles,
    "held_out": quartiles}`` in metres; of windows kept out each action counts the same, as it does of those generated,
    however long its clips are. Windows of a clip kept out that a network has begun with are not in what it made.
    """
    representation = checkpoint.representation

    def windows(clips: Sequence[np.ndarray], stride: int) -> np.ndarray:
        return np.concatenate([windows_of(joints_of(representation, x), protocol.window, stride) for x in clips
                               if len(x) >= protocol.window])  # fmt: skip

    trained = [clip for clips in train_clips.values() for clip in clips]
    stride = max(1, sum(map(len, trained)) // DATA_WINDOWS)
    asked = [windows(made, 2 * protocol.window),
             *(windows(encoded(representation, clips), protocol.window // 3) for clips in test_clips.values()
               if any(len(m) >= protocol.window for m in clips))]  # fmt: skip
    nearest = [np.full(len(each), np.inf, np.float32) for each in asked]
    for shown in ways_shown(trained, checkpoint.training):
        among = windows(encoded(representation, shown), stride)
        nearest = [np.minimum(near, nearest_window(each, among)) for near, each in zip(nearest, asked, strict=True)]
    generated, *held = nearest
    alike = np.concatenate([np.quantile(each, np.linspace(0, 1, 1001)) for each in held])  # as many of each action
    quartiles = {name: rounded(np.quantile(each, (0.25, 0.5, 0.75)))
                 for name, each in (("generated", generated), ("held_out", alike))}  # fmt: skip
    return {"window": protocol.window, **quartiles}


def ways_shown(clips: Sequence[Motion], training: Mapping[str, Any]) -> Iterator[list[Motion]]:
    """Clips as a training with these settings draws its windows from them: at each of its rates, all told at the clips'
    own, and mirrored."""
    sides = [list(clips), [mirrored(clip) for clip in clips]] if training.get("mirror") else [list(clips)]
    for side in sides:
        for rate in training.get("rates") or [clips[0].fps]:
            taken = [clip.resample(rate) for clip in side]
            yield [Motion(m.skeleton, clip.fps, m.positions, m.rotations, m.name)
                   for m, clip in zip(taken, side, strict=True)]  # fmt: skip


def elsewhere(train_clips: Clips, protocol: Protocol) -> dict[str, list[float]]:
    """How near windows of the training clips of each action come to others of that action a second away or more:
    quartiles in metres, a yardstick for :func:`copies` that needs no network. Clips are prepared already."""
    found = {}
    for action, clips in train_clips.items():
        representation = BodyFrame(clips[0].skeleton, clips[0].fps)
        each = [windows_of(joints_of(representation, x), protocol.window) for x in encoded(representation, clips)
                if len(x) >= protocol.window]  # fmt: skip
        distances, gap = [], round(representation.fps) + protocol.window
        stride = max(1, sum(map(len, each)) // DATA_WINDOWS)
        for k, windows in enumerate(each):
            for at in range(0, len(windows), max(2 * protocol.window, len(windows) // 20)):
                others = [w[::stride] for j, w in enumerate(each) if j != k]
                others += [windows[: max(0, at - gap) : stride], windows[at + gap :: stride]]
                others = np.concatenate(others)
                if len(others):
                    distances.append(float(nearest_window(windows[at : at + 1], others)[0]))
        found[action] = rounded(np.quantile(distances, (0.25, 0.5, 0.75))) if distances else None
    return found


# --- actions and reconstruction -------------------------------------------------------------------


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


# --- cost -----------------------------------------------------------------------------------------


def seconds_of_measuring(run: Run, folder: pathlib.Path, plan: Plan) -> float:
    """How long measuring a network takes about: making its fans, from a few frames of some with fresh weights, twice
    over for all that is done with them. Nothing where it is kept already."""
    network, sets, protocol = NETWORKS[name_of(run)], sets_for(run), plan.protocol
    path = run.path(folder)
    if path.exists() and found_in(path, path.with_suffix(".json"), protocol, sets) is not None:
        return 0.0
    if not network.futures:
        return 10.0
    trainer = trainer_for(run.recipe, sets=sets)
    trainer.model.stages_done.fill_(len(STAGES))
    checkpoint = Checkpoint(run.recipe.system, trainer.model.eval(), trainer.batches.representation, None, {}, {})
    count, frames = min(256, protocol.fan), min(16, protocol.fan_frames)
    with torch_threads(1):
        start = time.monotonic()
        generate_futures(checkpoint, frames, count=count)
        each = (time.monotonic() - start) / (count * frames)
    return 2 * each * (protocol.fan if network.many else protocol.pairs) * protocol.fan_frames * len(network.actions)
