"""From a finished training run to weights that can be passed on: half precision, own seeds, measured, accounted for."""

from __future__ import annotations

import copy
import dataclasses
import datetime
import hashlib
import os
import pathlib
import re
import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from .. import __version__, metrics, pretrained
from ..errors import CheckpointError
from ..evaluate import evaluate
from ..evaluate_control import evaluate_control
from ..generate import SEED_FRAMES, choose_windows, generate_features, prepare_for
from ..motion.clip import Motion
from ..recipes import clips_of, recipe_in
from ..training.checkpoints import Checkpoint, load_checkpoint, read_header, save_checkpoint
from ..training.systems import SYSTEMS
from . import SUFFIX

N_SEEDS = 20
FRAMES = 30  # of each seed: 1 s, of which a run reads 10 from a place of its choice
ALONE = (5.0, 60.0)  # seconds after the captured seed between which a network's own motion is cut out
MOVING = 0.4  # of the clips' motion change; what moves less is standing or on its way there
APART = 0.02  # metres, root mean square over joints; nearer to a training clip would be a copy of it


def publish(
    run: str | os.PathLike,
    name: str,
    *,
    clips: tuple[Sequence[Motion], Sequence[Motion]] | None = None,
    folder: str | os.PathLike | None = None,
    frames: int = 900,
    count: int = 20,
    device: str | torch.device = "cpu",
    progress: bool = False,
) -> pathlib.Path:
    """Write ``folder/NAME.safetensors``, by default into the library, from the finished run in the checkpoint ``run``.

    The weights are rounded to half precision first, and everything else is done with the rounded ones: they make the
    seeds (:func:`own_seeds`) and they are measured (:func:`tutorial_lib.evaluate.evaluate`, ``count`` seeds and
    ``frames`` frames from the clips kept out, or from the training clips where none were, which the result then says).
    A network that follows control needs no seed and brings the sway of its clips; it is measured by
    :func:`tutorial_lib.evaluate_control.evaluate_control`.

    clips: those trained on and those kept out; by default they are loaded as the run's recipe says.
    Returns the path. Raises ``CheckpointError`` for a run that is not finished, clips that are not its own, weights
    beyond half precision's range, or a network that makes no motion of its own; ``DataError`` for clips not at hand.
    """
    if not re.fullmatch(r"[a-z0-9]+([.-][a-z0-9]+)*", name):
        raise CheckpointError(f"weights called {name!r}: expected small letters, digits and dashes, as in aclstm-walk")
    header = read_header(run)
    status = header["training"].get("status")
    if header["resumable"] or status != "finished":
        raise CheckpointError(f"{run}: the run is {status or 'of unknown status'}, expected a finished one")
    checkpoint = rounded(load_checkpoint(run, device=device))
    train, test = clips_of(recipe_in(header)) if clips is None else ([*clips[0]], [*clips[1]])
    for kind, key, given in (("trained on", "clips", train), ("kept out", "test_clips", test)):
        theirs, mine = set(checkpoint.provenance.get(key) or ()), {motion.name for motion in given}
        if theirs != mine:
            odd = sorted(theirs ^ mine)[0]
            raise CheckpointError(
                f"{run}: has {len(theirs)} clips {kind}, given were {len(mine)}; {odd} is only in "
                f"{'the run' if odd in theirs else 'those given'}"
            )
    if SYSTEMS[checkpoint.system].controlled:
        seeds, about = None, {}
        measured = evaluate_control(checkpoint, test or train)
    else:
        seeds, about = own_seeds(checkpoint, train, progress=progress)
        measured = evaluate(checkpoint, test or train, count=count, frames=frames, progress=progress)
        about = {"seeds": about}
    origin = {
        **checkpoint.provenance,
        "metrics": measured,
        "clips_sha256": clips_hash(prepare_for(checkpoint, train)),
        **about,
        "published": {
            "name": name,
            "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
            "tutorial_lib": __version__,
            "precision": "float16",
        },
    }
    file = pathlib.Path(pretrained.FOLDER if folder is None else folder) / f"{name}{SUFFIX}"
    save_checkpoint(
        file,
        system=checkpoint.system,
        model=checkpoint.model,
        representation=checkpoint.representation,
        normalizer=checkpoint.normalizer,
        training=_without_folders(checkpoint.training),
        provenance=_without_folders(origin),
        seed_frames=seeds,
        sway=checkpoint.sway,
        half=True,
    )
    return file


def rounded(checkpoint: Checkpoint) -> Checkpoint:
    """The same with its weights as half precision has them, in single precision: what a published file loads as."""
    model = copy.deepcopy(checkpoint.model)
    with torch.no_grad():
        for key, weight in model.named_parameters():
            half = weight.half()
            if not torch.isfinite(half).all():
                raise CheckpointError(
                    f"{checkpoint.path}: the weights {key} reach {weight.abs().max():.3g}, half precision ends at 65504"
                )
            weight.copy_(half.float())
    return dataclasses.replace(checkpoint, model=model)


def own_seeds(
    checkpoint: Checkpoint,
    clips: Sequence[Motion],
    *,
    count: int = N_SEEDS,
    frames: int = FRAMES,
    seed: int = 0,
    progress: bool = False,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Short pieces of motion that the network made itself, to start from where no data is at hand.

    The network is started from ``4 count`` windows of the clips and runs alone for a minute. Of each run one window
    of ``frames`` frames is taken that moves (``MOVING``), is a human pose (``metrics.diverged``) and is no
    copy of a clip: at random between 5 and 60 s after the captured seed, where the network has long lived on its own
    output; if it stands still by then, as a vanilla network does, the last window before. The captured seed itself
    is never in the output that windows are cut from, and a window nearer than ``APART`` to any window of the
    clips (:func:`nearest_captured`) is left out: so no captured motion is passed on, not even one learnt by heart.

    Returns features ``(K, frames, D)`` float32, not normalised, with ``1 <= K <= count``, late ones first, and what is
    to be said of them in the provenance. Raises ``CheckpointError`` where there is no such window.
    """
    representation = checkpoint.representation
    prepared = prepare_for(checkpoint, clips)
    fps = representation.fps
    chosen = choose_windows([len(clip) for clip in prepared], frames=SEED_FRAMES, count=4 * count, seed=seed)
    started = np.stack([representation.encode(prepared[k][at : at + SEED_FRAMES]) for k, at in chosen])
    made = generate_features(checkpoint, started, round(ALONE[1] * fps), progress=progress)  # (N, F, D)
    true_change = np.concatenate([metrics.frame_change(representation.encode(clip)) for clip in prepared]).mean()
    moving = metrics.moving_mean(metrics.frame_change(made), frames - 1) >= MOVING * true_change  # (N, F - frames + 1)
    reach = max(float(metrics.reach(clip.positions)) for clip in prepared)

    rng = np.random.default_rng(seed)
    late, early, distances = [], [], {}
    for k in range(len(made)):
        places = np.flatnonzero(moving[k])
        alone = places[places >= ALONE[0] * fps]
        soon = places[(places < ALONE[0] * fps) & (places >= SEED_FRAMES)][::-1]
        for kind, starts in ((late, rng.permutation(alone)), (early, soon)):
            at = next((at for at in starts[:5].tolist() if _usable(made[k, at : at + frames], representation, prepared,
                                                                   reach, distances, (k, at))), None)  # fmt: skip
            if at is not None:
                kind.append((k, at))
                break
    windows = (late + early)[:count]
    if not windows:
        raise CheckpointError(
            f"{checkpoint.path}: of {len(made)} runs none has {frames / fps:g} s of moving, human motion of its own "
            f"to start from; expected some within {ALONE[1]:g} s"
        )
    seconds = sorted(at / fps for _, at in windows)
    about = {
        "count": len(windows),
        "frames": frames,
        "made_by": "the network itself, half-precision weights",
        "true_motion_change": float(true_change),  # of the training clips, in the representation
        "seconds_after_the_captured_seed": [round(seconds[0], 2), round(seconds[-1], 2)],
        "nearest_captured_motion_m": round(min(distances[w] for w in windows), 4),
    }
    return np.stack([made[k, at : at + frames] for k, at in windows]), about


def _usable(window, representation, clips, reach, distances, key) -> bool:
    positions = representation.decode_positions(window)
    if not np.isfinite(positions).all() or bool(metrics.diverged(positions, reach)):
        return False
    distances[key] = nearest_captured(positions, clips)
    return distances[key] >= APART


def nearest_captured(positions: np.ndarray, clips: Sequence[Motion]) -> float:
    """How near a short motion ``(T, J, 3)`` comes to any ``T`` frames of the clips: metres, root mean square over
    frames and joints of the poses about the root, turned about the vertical as fits best; infinity if all are shorter.

    For poses w and x with horizontal parts as complex numbers, ``min over turns |w - x|^2 =
    |w|^2 + |x|^2 - 2 (sum of w_y x_y + |sum of w_xz conj(x_xz)|)``, summed over the window.
    """
    window = positions - positions[:, :1]
    frames, joints = window.shape[:2]
    across, up = window[..., 0] + 1j * window[..., 2], window[..., 1]
    nearest = np.inf
    for clip in clips:
        n = len(clip) - frames + 1
        if n < 1:
            continue
        poses = clip.positions - clip.positions[:, :1]
        horizontal = across @ (poses[..., 0] - 1j * poses[..., 2]).T  # (T, N)
        vertical, size = up @ poses[..., 1].T, np.square(poses).sum((1, 2))
        shared = sum(horizontal[t, t : t + n] for t in range(frames))
        level = sum(vertical[t, t : t + n] for t in range(frames))
        theirs = sum(size[t : t + n] for t in range(frames))
        square = np.square(window).sum() + theirs - 2 * (level + np.abs(shared))
        nearest = min(nearest, float(np.sqrt(max(square.min(), 0.0) / (frames * joints))))
    return nearest


def clips_hash(clips: Sequence[Motion]) -> str:
    """SHA-256 of names and positions, to the millimetre so that another computer's rounding does not change it."""
    digest = hashlib.sha256()
    for clip in sorted(clips, key=lambda clip: clip.name):
        digest.update(f"{clip.name}\0{len(clip)}\0".encode())
        digest.update(np.round(clip.positions * 1000.0).astype("<i4").tobytes())
    return digest.hexdigest()


def _without_folders(value: Any) -> Any:
    """Absolute paths cut to their last part, also inside a command: whose folders they were is nobody's business."""
    if isinstance(value, dict):
        return {key: _without_folders(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_folders(item) for item in value]
    if not isinstance(value, str) or "/" not in value:
        return value
    if os.path.isabs(value):
        return pathlib.PurePath(value).name
    try:
        words = shlex.split(value)
    except ValueError:  # not a command
        return value
    short = [pathlib.PurePath(word).name if os.path.isabs(word) else word for word in words]
    return value if short == words else shlex.join(short)
