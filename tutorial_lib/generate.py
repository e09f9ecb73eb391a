"""Synthesis: a trained network is shown a few seed frames and then lives on its own output."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from .chance import check_whole, is_whole, seeded, whole_seed
from .errors import CheckpointError, DataError, TutorialError
from .models.dynamic_future_net import DynamicFutureNet
from .models.future_stream import FutureStream
from .motion.clip import Motion, as_list
from .motion.retarget import to_common
from .motion.skeletons import COMMON_JOINTS, recognise, standing_height
from .representations import Representation
from .training.checkpoints import Checkpoint
from .training.conditioning import Given, WanderingNoise
from .training.progress import Progress
from .training.rollout import LSTMStream, has_fast_rollout
from .training.systems import SYSTEMS

SEED_FRAMES = 10  # acRNN, section 4: "initialized with 10 frames"
NOISE_SECONDS = 0.5  # for which noise on what is fed is remembered, about a gesture


def stream(
    model: nn.Module,
    seed: Tensor,
    *,
    state: Any = None,
    given: Given | None = None,
    noise: WanderingNoise | None = None,
    generator: torch.Generator | None = None,
) -> Iterator[Tensor]:
    """The frames that follow ``seed``, one at a time and without end; with ``given``, as far as that goes.

    The network reads the seed (B, T0, D), which warms up its memory; its prediction of the next frame is
    given out, (B, D), and is what it reads next. Only the memory and one frame are kept, however long it runs.
    The network is put into evaluation mode. ``state`` is the memory before the seed, ``noise`` is on what is read and
    not on what is given out; for them and for what the Dynamic Future Net has instead, ``generator``, see
    :func:`synthesize`.
    """
    _check_seed(seed)
    if given is not None:
        given.check(seed.shape[0], seed.shape[2])
    model.eval()
    if isinstance(model, DynamicFutureNet):
        if state is not None or given is not None or noise is not None:
            raise TutorialError(
                "the Dynamic Future Net reads none of its output: it takes no state, nothing given and no noise"
            )
        futures = FutureStream(model, len(seed), generator=generator)
        futures.read(seed)
        yield from futures.features()
    if generator is not None:
        raise TutorialError(f"a generator is for the Dynamic Future Net, not for {type(model).__name__}")
    with torch.no_grad():
        y, state = model(seed) if state is None else model(seed, state)  # (B, T0, D)
    frame = y[:, -1]  # (B, D): the first frame after the seed

    def read(frame: Tensor) -> Tensor:
        nonlocal state
        with torch.no_grad():  # in here, so that it does not reach into the caller's code at a yield
            y, state = model(frame[:, None], state)
        return y[:, 0]

    step = LSTMStream(model, state).step if has_fast_rollout(model) else read
    for t in itertools.count():
        if given is not None:
            if t == given.frames:
                return
            frame = given.put(frame, t)
        yield frame
        if noise is not None:
            frame = noise.disturb(frame)
            frame = frame if given is None else given.put(frame, t)  # what is given is exact
        frame = step(frame)


def synthesize(
    model: nn.Module,
    seed: Tensor,
    n_frames: int,
    *,
    state: Any = None,
    given: Given | None = None,
    noise: WanderingNoise | None = None,
    generator: torch.Generator | None = None,
    progress: bool = False,
) -> Tensor:
    """``n_frames`` frames that follow ``seed``.

    Parameters
    ----------
    model : called as ``model(x (B, T, D), state)`` -> ``(y, state)``, ``y[:, t]`` the prediction of frame t + 1.
    seed : (B, T0, D), in the network's own (normalised) features; B from 1 to thousands.
    n_frames : how many to make, 0 or more.
    state : memory before the seed, by default the network's own beginning; of one that draws its frames
        ``model.start(number)``, which says what it draws.
    given : channels that are not the network's to tell, of ``n_frames`` frames or more.
    noise : on each frame of its own that the network reads; those that it puts out are as it makes them.
    generator : of the Dynamic Future Net alone, on the CPU: of all that it draws; by default torch's global one. It
        reads none of its own frames, so that it takes no ``state``, nothing ``given`` and no ``noise``.
    progress : show a line with frames a second.

    Returns
    -------
    (B, n_frames, D), without the seed.
    """
    _check_seed(seed)
    check_whole("the number of frames to generate", n_frames, 0)
    if given is not None and given.frames < n_frames:
        raise TutorialError(f"{n_frames} frames to generate, the given channels have {given.frames}")
    batch, _, dim = seed.shape
    out = torch.empty(batch, n_frames, dim, dtype=seed.dtype, device=seed.device)
    bar = Progress(n_frames, unit="frame", title="generating", enabled=progress)
    for t, frame in zip(
        range(n_frames), stream(model, seed, state=state, given=given, noise=noise, generator=generator), strict=False
    ):
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
    representation = representation_of(checkpoint)
    wanted = representation.skeleton
    if wanted.names == COMMON_JOINTS:  # an unknown skeleton is told below, together with the one that was expected
        motions = [to_common(m) if recognise(m.skeleton) and not wanted.same_tree(m.skeleton) else m for m in motions]
    for motion in motions:  # before anything is scaled, so that the message is about the tree
        if not wanted.same_tree(motion.skeleton):
            representation.check_skeleton(motion)
    height = standing_height(wanted)
    prepared = prepare(motions, height=height if height > 0 else None, fps=representation.fps)
    for motion in prepared:
        representation.check(motion)
    return prepared


def check_predicts(checkpoint: Checkpoint) -> None:
    """Raise :class:`CheckpointError` unless the network goes on from seed frames, telling the next one or by chance."""
    kind = SYSTEMS[checkpoint.system]
    if not (kind.predicts or kind.futures):
        raise CheckpointError(
            f"the checkpoint is a {checkpoint.system!r}, which follows a control signal and goes on from no seed: "
            "expected a network that predicts the next frame; this one walks a path (tutorial_lib.walk, command: walk)"
        )


def representation_of(checkpoint: Checkpoint) -> Representation:
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
    if not (is_whole(count) and is_whole(frames) and count >= 1 and frames >= 1):
        raise TutorialError(
            f"the count and the length of seeds must be whole numbers of 1 or more, not {count!r} and {frames!r}"
        )
    windows = np.maximum(0, np.asarray(lengths, dtype=np.int64) - frames + 1)  # in each clip
    if windows.sum() == 0:
        raise DataError(
            f"a seed needs {frames} frames, the longest of {len(lengths)} clips has {max(lengths, default=0)}"
        )
    rng = np.random.default_rng(whole_seed(seed))
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


def given_parts(checkpoint: Checkpoint, parts: Mapping[str, np.ndarray | Tensor]) -> Given:
    """Named parts of a checkpoint's features as what its network is given.

    ``parts`` are slices of the representation, such as ``{"control": (K, F, 3)}`` of ``"hip-frame"``, in its own units,
    not normalised. Raises :class:`CheckpointError` for a part that the representation has not or of another width.
    """
    representation = representation_of(checkpoint)
    channels, values = [], []
    for name, value in parts.items():
        if name not in representation.slices:
            raise CheckpointError(
                f"the checkpoint's representation {representation.name!r} has no {name!r}: expected one of "
                f"{', '.join(representation.slices)}"
            )
        where = range(representation.dim)[representation.slices[name]]
        value = torch.as_tensor(value, dtype=torch.float32)
        if value.ndim != 3 or value.shape[-1] != len(where):
            raise CheckpointError(
                f"the given {name} has shape {tuple(value.shape)}, expected (sequences, frames, {len(where)})"
            )
        if values and value.shape[:2] != values[0].shape[:2]:
            raise CheckpointError(
                f"the given {name} has {value.shape[0]} sequences of {value.shape[1]} frames, what was given before it "
                f"{values[0].shape[0]} of {values[0].shape[1]}"
            )
        if checkpoint.normalizer is not None:
            mean, std = (checkpoint.normalizer.to_dict()[key][list(where)] for key in ("mean", "std"))
            value = (value - mean) / std
        channels += where
        values.append(value)
    if not values:
        raise CheckpointError("nothing is given: expected at least one part of the representation")
    return Given(channels, torch.cat(values, dim=-1))


def generate_features(
    checkpoint: Checkpoint,
    seeds: np.ndarray | Tensor,
    n_frames: int,
    *,
    given: Mapping[str, np.ndarray | Tensor] | None = None,
    noise: float = 0.0,
    seed: int = 0,
    progress: bool = False,
) -> np.ndarray:
    """``n_frames`` frames of features that follow each seed.

    ``seeds`` (K, T, D) and the result (K, n_frames, D) are in the representation, not normalised; the
    computation is on the device that the checkpoint's network is on. ``given`` : parts of each frame after the seed
    that are not the network's to tell, ``{"control": (K, n_frames, 3)}``, see :func:`given_parts` and
    :class:`~.training.conditioning.Given`. ``noise`` : deviation of what disturbs each frame of its own that a network
    reads, in the units that it reads, as the ``noise`` of its training
    (:class:`~.training.conditioning.WanderingNoise`). ``seed`` : of all chance, in that noise and in networks that
    draw. Raises :class:`TutorialError` for noise below 0, or for a network that reads none of its own frames.
    """
    check_predicts(checkpoint)
    futures, chance = SYSTEMS[checkpoint.system].futures, seeded(seed)
    if noise and futures:
        raise TutorialError(f"noise is not for system {checkpoint.system!r}, which reads none of its own frames")
    wandering = None
    if noise:
        wandering = WanderingNoise(noise, NOISE_SECONDS * representation_of(checkpoint).fps, chance)
    seeds = torch.as_tensor(seeds, dtype=torch.float32)
    width = checkpoint.model.config.dim
    if seeds.ndim != 3 or seeds.shape[-1] != width:
        raise CheckpointError(
            f"the seed has shape {tuple(seeds.shape)}, the network reads (sequences, frames, {width})"
        )
    if checkpoint.normalizer is not None:
        seeds = torch.as_tensor(checkpoint.normalizer.apply(seeds), dtype=torch.float32)
    device = next(checkpoint.model.parameters()).device
    start = getattr(checkpoint.model, "start", None)  # of networks that draw their frames
    made = synthesize(
        checkpoint.model, seeds.to(device), n_frames, progress=progress,
        state=None if start is None else start(seed), given=given_parts(checkpoint, given) if given else None,
        noise=wandering, generator=chance if futures else None,
    ).cpu()  # fmt: skip
    if checkpoint.normalizer is not None:
        made = checkpoint.normalizer.invert(made)
    made = made.float().numpy()
    for name, value in (given or {}).items():  # exactly, whatever normalising has rounded
        made[..., checkpoint.representation.slices[name]] = np.asarray(value, np.float32)[:, :n_frames]
    return made


def generate(
    checkpoint: Checkpoint,
    n_frames: int,
    *,
    seeds: Motion | Sequence[Motion] | np.ndarray | Tensor | None = None,
    count: int = 1,
    seed: int = 0,
    seed_frames: int = SEED_FRAMES,
    noise: float = 0.0,
    progress: bool = False,
) -> Generated:
    """Motions of any length from a checkpoint and something to start from.

    Parameters
    ----------
    n_frames : frames to make after the seed.
    seeds : clips to cut the seeds from: one :class:`Motion` or several, brought to the network's frame rate and size,
        or features (K, T, D). By default those that the checkpoint carries.
    count, seed : how many motions, and the number that chooses their seeds, and what a network draws that does.
    seed_frames : length of a seed.
    noise : disturbs what the network reads of its own output, so that it does not go round in a loop; see
        :func:`generate_features`. By default there is none, as in the paper.

    Each motion begins with its seed and starts at the origin. Two runs with the same arguments give the same motions.
    Raises :class:`CheckpointError` for a seed of another skeleton or width, or if there is none;
    :class:`TutorialError` if the network's output becomes infinite or NaN.
    """
    motions = generate_each(
        checkpoint, n_frames, seeds=seeds, count=count, seed=seed, seed_frames=seed_frames, noise=noise,
        progress=progress,
    )  # fmt: skip
    return Generated(list(motions), seed_frames)


def generate_each(
    checkpoint: Checkpoint,
    n_frames: int,
    *,
    seeds: Motion | Sequence[Motion] | np.ndarray | Tensor | None = None,
    count: int = 1,
    seed: int = 0,
    seed_frames: int = SEED_FRAMES,
    noise: float = 0.0,
    progress: bool = False,
) -> Iterator[Motion]:
    """:func:`generate`, the motions one by one: all are made before this returns, as single-precision features, but
    each becomes a :class:`Motion`, twice as large, only when its turn comes."""
    check_predicts(checkpoint)
    representation = representation_of(checkpoint)
    check_whole("the number of frames to generate", n_frames)
    features = choose_seeds(checkpoint, seeds, count=count, seed=seed, frames=seed_frames)
    made = generate_features(checkpoint, features, n_frames, noise=noise, seed=seed, progress=progress)
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


def choose_seeds(
    checkpoint: Checkpoint,
    seeds: Motion | Sequence[Motion] | np.ndarray | Tensor | None = None,
    *,
    count: int = 1,
    seed: int = 0,
    frames: int = SEED_FRAMES,
) -> np.ndarray:
    """What generation starts from: features ``(count, frames, D)``, not normalised, of random windows of ``seeds``.

    Arguments and errors are those of :func:`generate`.
    """
    representation = representation_of(checkpoint)
    if seeds is None:
        seeds = checkpoint.seed_frames
        if seeds is None:
            raise CheckpointError("the checkpoint carries no seed of its own: give it clips to start from")
        if seeds.shape[1] < frames:
            raise DataError(
                f"a seed of {frames} frames was asked for, the checkpoint's own seeds have {seeds.shape[1]}: "
                "give it clips to start from"
            )
    seeds = as_list(seeds)
    clips = prepare_for(checkpoint, seeds) if len(seeds) and isinstance(seeds[0], Motion) else seeds
    chosen = choose_windows([len(clip) for clip in clips], frames=frames, count=count, seed=seed)
    windows = [clips[k][start : start + frames] for k, start in chosen]
    # a window is cut before it is encoded, as in training: what is continuous in time starts with the window
    return np.stack(
        [representation.encode(w) if isinstance(w, Motion) else np.asarray(w, np.float32) for w in windows]
    )  # (count, frames, D)
