"""Synthesis: a trained network is shown a few seed frames and then lives on its own output."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from .errors import CheckpointError, DataError, TutorialError
from .motion.clip import Motion
from .motion.retarget import to_common
from .motion.skeletons import standing_height
from .representations import Representation
from .training.checkpoints import Checkpoint
from .training.progress import Progress
from .training.rollout import LSTMStream, has_fast_rollout

SEED_FRAMES = 10  # acRNN, section 4: "initialized with 10 frames"


def stream(model: nn.Module, seed: Tensor) -> Iterator[Tensor]:
    """The frames that follow ``seed``, one at a time and without end.

    The network reads the seed (B, T0, D), which warms up its memory; its prediction of the next frame is
    given out, (B, D), and is what it reads next. Only the memory and one frame are kept, however long it runs.
    The network is put into evaluation mode.
    """
    _check_seed(seed)
    model.eval()
    with torch.no_grad():
        y, state = model(seed)  # (B, T0, D)
        frame = y[:, -1:]  # (B, 1, D): the first frame after the seed
    if has_fast_rollout(model):
        fast, frame = LSTMStream(model, state), frame[:, 0]
        while True:
            yield frame
            frame = fast.step(frame)
    while True:
        yield frame[:, 0]
        with torch.no_grad():  # inside the loop, so that it does not reach into the caller's code at a yield
            frame, state = model(frame, state)


def synthesize(model: nn.Module, seed: Tensor, n_frames: int, *, progress: bool = False) -> Tensor:
    """``n_frames`` frames that follow ``seed``.

    Parameters
    ----------
    model : called as ``model(x (B, T, D), state)`` -> ``(y, state)``, ``y[:, t]`` the prediction of frame t + 1.
    seed : (B, T0, D), in the network's own (normalised) features; B from 1 to thousands.
    n_frames : how many to make, 0 or more.
    progress : show a line with frames a second.

    Returns
    -------
    (B, n_frames, D), without the seed.
    """
    _check_seed(seed)
    if n_frames < 0:
        raise TutorialError(f"the number of frames to generate must be 0 or more, not {n_frames}")
    batch, _, dim = seed.shape
    out = torch.empty(batch, n_frames, dim, dtype=seed.dtype, device=seed.device)
    bar = Progress(n_frames, unit="frame", title="generating", enabled=progress)
    for t, frame in zip(range(n_frames), stream(model, seed), strict=False):
        out[:, t] = frame
        bar.update()
    bar.close()
    return out


def _check_seed(seed: Tensor) -> None:
    if seed.ndim != 3 or seed.shape[0] < 1 or seed.shape[1] < 1:
        raise TutorialError(f"a seed has shape (sequences, frames, numbers), not {tuple(seed.shape)}")


# --- with a checkpoint: from motions to motions ---------------------------------------------------


def prepare(motions: Sequence[Motion], *, height: float | None = None, fps: float | None = None) -> list[Motion]:
    """Clips as a network is trained on them: on the ground, ``height`` metres tall, at ``fps``.

    acRNN, section 3, scales every skeleton to 1.54 m; ``None`` leaves the size, or the rate, as it is.
    """
    prepared = []
    for motion in motions:
        if fps is not None and motion.fps != fps:
            motion = motion.resample(fps)
        if height is not None:
            motion = motion.scaled_to(height)
        prepared.append(motion.on_ground())
    return prepared


def prepare_for(checkpoint: Checkpoint, motions: Sequence[Motion]) -> list[Motion]:
    """Clips at the frame rate and of the size that a checkpoint was trained with, on the common joints if those were.

    Raises :class:`CheckpointError` if the checkpoint has no representation, ``MotionError`` naming both sides if
    a clip's skeleton is not the one that the network was trained on.
    """
    representation = _representation(checkpoint)
    if checkpoint.training.get("joints") == "common":
        motions = [m if representation.skeleton.same_tree(m.skeleton) else to_common(m) for m in motions]
    for motion in motions:  # before anything is scaled, so that the message is about the tree
        if not representation.skeleton.same_tree(motion.skeleton):
            representation.check_skeleton(motion)
    height = standing_height(representation.skeleton)
    prepared = prepare(motions, height=height if height > 0 else None, fps=representation.fps)
    for motion in prepared:
        representation.check(motion)
    return prepared


def _representation(checkpoint: Checkpoint) -> Representation:
    if checkpoint.representation is None:
        raise CheckpointError("the checkpoint has no representation: its output cannot be turned into motion")
    return checkpoint.representation


def choose_windows(
    lengths: Sequence[int], *, frames: int = SEED_FRAMES, count: int = 1, seed: int = 0
) -> list[tuple[int, int]]:
    """``count`` random windows of ``frames`` frames from clips of these lengths: (clip, first frame) each.

    Every window of every clip is equally likely, and none is taken twice before all have been taken.
    Raises :class:`DataError` if no clip is long enough.
    """
    if count < 1 or frames < 1:
        raise TutorialError(f"the count and the length of seeds must be 1 or more, not {count} and {frames}")
    windows = np.maximum(0, np.asarray(lengths, dtype=np.int64) - frames + 1)  # in each clip
    if windows.sum() == 0:
        raise DataError(
            f"a seed needs {frames} frames, the longest of {len(lengths)} clips has {max(lengths, default=0)}"
        )
    rng = np.random.default_rng(seed)
    picks = np.concatenate([rng.permutation(windows.sum()) for _ in range(-(-count // windows.sum()))])[:count]
    ends = windows.cumsum()
    clips = np.searchsorted(ends, picks, side="right")
    starts = picks - (ends - windows)[clips]
    return list(zip(clips.tolist(), starts.tolist(), strict=True))


@dataclass(frozen=True)
class Generated:
    """Motions that a network made; the first ``n_seed`` frames of each are the seed that it was shown."""

    motions: list[Motion]
    n_seed: int

    def __iter__(self) -> Iterator[Motion]:
        return iter(self.motions)

    def __len__(self) -> int:
        return len(self.motions)

    def __getitem__(self, index: int) -> Motion:
        return self.motions[index]

    def without_seed(self) -> list[Motion]:
        """What the network made alone."""
        return [motion[self.n_seed :] for motion in self.motions]


def generate_features(
    checkpoint: Checkpoint, seeds: np.ndarray | Tensor, n_frames: int, *, progress: bool = False
) -> np.ndarray:
    """``n_frames`` frames of features that follow each seed.

    ``seeds`` (K, T, D) and the result (K, n_frames, D) are in the representation, not normalised; the
    computation is on the device that the checkpoint's network is on.
    """
    seeds = torch.as_tensor(seeds, dtype=torch.float32)
    width = checkpoint.model.config.dim
    if seeds.ndim != 3 or seeds.shape[-1] != width:
        raise CheckpointError(
            f"the seed has shape {tuple(seeds.shape)}, the network reads (sequences, frames, {width})"
        )
    if checkpoint.normalizer is not None:
        seeds = torch.as_tensor(checkpoint.normalizer.apply(seeds), dtype=torch.float32)
    device = next(checkpoint.model.parameters()).device
    made = synthesize(checkpoint.model, seeds.to(device), n_frames, progress=progress).cpu()
    if checkpoint.normalizer is not None:
        made = checkpoint.normalizer.invert(made)
    return np.asarray(made, dtype=np.float32)


def generate(
    checkpoint: Checkpoint,
    n_frames: int,
    *,
    seeds: Sequence[Motion] | np.ndarray | Tensor | None = None,
    count: int = 1,
    seed: int = 0,
    seed_frames: int = SEED_FRAMES,
    progress: bool = False,
) -> Generated:
    """Motions of any length from a checkpoint and something to start from.

    Parameters
    ----------
    n_frames : frames to make after the seed.
    seeds : clips to cut the seeds from: :class:`Motion` values, brought to the network's frame rate and size,
        or features (K, T, D). By default those that the checkpoint carries.
    count, seed : how many motions, and the number that chooses their seeds.
    seed_frames : length of a seed.

    Each motion begins with its seed and starts at the origin. Two runs with the same arguments give the same motions.
    Raises :class:`CheckpointError` for a seed of another skeleton or width, or if there is none;
    :class:`TutorialError` if the network's output becomes infinite or NaN.
    """
    motions = generate_each(
        checkpoint, n_frames, seeds=seeds, count=count, seed=seed, seed_frames=seed_frames, progress=progress
    )
    return Generated(list(motions), seed_frames)


def generate_each(
    checkpoint: Checkpoint,
    n_frames: int,
    *,
    seeds: Sequence[Motion] | np.ndarray | Tensor | None = None,
    count: int = 1,
    seed: int = 0,
    seed_frames: int = SEED_FRAMES,
    progress: bool = False,
) -> Iterator[Motion]:
    """:func:`generate`, the motions one by one: all are made before this returns, as single-precision features, but
    each becomes a :class:`Motion`, twice as large, only when its turn comes."""
    representation = _representation(checkpoint)
    if n_frames < 1:
        raise TutorialError(f"the number of frames to generate must be 1 or more, not {n_frames}")
    if seeds is None:
        seeds = checkpoint.seed_frames
        if seeds is None:
            raise CheckpointError("the checkpoint carries no seed of its own: give it clips to start from")
        if seeds.shape[1] < seed_frames:
            raise DataError(
                f"a seed of {seed_frames} frames was asked for, the checkpoint's own seeds have {seeds.shape[1]}: "
                "give it clips to start from"
            )
    clips = prepare_for(checkpoint, seeds) if len(seeds) and isinstance(seeds[0], Motion) else seeds
    chosen = choose_windows([len(clip) for clip in clips], frames=seed_frames, count=count, seed=seed)
    windows = [clips[k][start : start + seed_frames] for k, start in chosen]
    # a window is cut before it is encoded, as in training: what is continuous in time starts with the window
    features = np.stack(
        [representation.encode(w) if isinstance(w, Motion) else np.asarray(w, np.float32) for w in windows]
    )  # (count, seed_frames, D)
    made = generate_features(checkpoint, features, n_frames, progress=progress)
    for k, rest in enumerate(made):
        bad = ~np.isfinite(rest).all(axis=-1)  # (n_frames,)
        if bad.any():
            raise TutorialError(
                f"motion {k + 1} of {count} left the finite numbers {int(bad.argmax()) + 1} frames after its seed"
            )
    return (
        representation.decode(np.concatenate([start, rest]), name=f"{checkpoint.system}-{k}")
        for k, (start, rest) in enumerate(zip(features, made, strict=True), start=1)
    )
