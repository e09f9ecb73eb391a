"""Synthesis of many futures: a trained Dynamic Future Net goes on from one beginning, or from none, by chance.

>>> fan = generate_futures(checkpoint, 128, prefix=clip[:20], count=8, seed=1)      # eight futures of one past
>>> fan.motion(0)                                                                  # with rotations: bones are rigid
>>> dances = generate_futures(checkpoint, 900, count=3)                             # from the prior alone
>>> steered = generate_futures(checkpoint, 300, prefix=clip[:20], future=future_of(checkpoint, dance, start=60))
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .chance import check_whole, seeded
from .errors import CheckpointError, MotionError, TutorialError
from .generate import prepare_for
from .models.dynamic_future_net import DynamicFutureNet
from .models.future_stream import LEAST_PREFIX, FutureStream, Imagined, ImposedFuture
from .motion.clip import Motion
from .representations import BodyFrame
from .training.checkpoints import Checkpoint
from .training.progress import Progress

PREFIX_FRAMES = 20  # section 6.1: "8 to 20-frame motion prefix"
CHUNK = 32  # frames made at once; a longer motion is made in such pieces, which nothing in it shows


@dataclass(frozen=True)
class Futures:
    """K generated motions of n frames, in the network's own numbers; motions are made of them when asked for.

    Each begins with its prefix of P frames (0: from the prior alone) as the network has it: as decoded from its code,
    with rigid bones like the rest, not the clip itself.
    """

    network: DynamicFutureNet
    prefix: Tensor  # (1 or K, P, C) codes
    made: Imagined  # codes z_t (K, n, C), current states s_t (K, n, S), future states f_t (K, n, F)

    def __len__(self) -> int:
        return len(self.made.code)

    @property
    def n_prefix(self) -> int:
        """P."""
        return self.prefix.shape[1]

    def codes(self, index: int) -> Tensor:
        """``(P + n, C)`` z_t of one motion, prefix and all."""
        prefix = self.prefix[index if len(self.prefix) > 1 else 0]
        return torch.cat((prefix, self.made.code[index]))

    @torch.no_grad()
    def motion(self, index: int) -> Motion:
        """One of them, prefix and all, with rotations; it starts at the origin and faces +z."""
        if not 0 <= index < len(self):
            raise TutorialError(f"no motion {index} among {len(self)}")
        pose_code = self.network.pose
        pose = pose_code.decode(self.codes(index))
        features = pose_code.features(pose).cpu().numpy()  # (P + n, D)
        return self.network.representation.decode_turned(
            features, pose.rotations.cpu().numpy(), name=f"future-{index + 1}"
        )

    def __iter__(self) -> Iterator[Motion]:
        return (self.motion(k) for k in range(len(self)))

    @torch.no_grad()
    def features(self, frames: slice = slice(None), motions: slice = slice(None)) -> np.ndarray:
        """Features ``(K', n', D)`` of some of the n generated frames of some of the K motions, float32; positions in
        the body's frame are among them."""
        codes, pose = self.made.code[motions, frames], self.network.pose
        parts = codes.split(max(1, 65_536 // max(1, codes.shape[1])))  # thousands at once need no more memory
        return torch.cat([pose.features(pose.decode(part)).cpu() for part in parts]).numpy()


def generate_futures(
    checkpoint: Checkpoint,
    n_frames: int,
    *,
    prefix: Motion | Sequence[Motion] | np.ndarray | Tensor | None = None,
    count: int = 1,
    seed: int = 0,
    temperature: float = 1.0,
    future: ImposedFuture | None = None,
    progress: bool = False,
) -> Futures:
    """``count`` motions that go on from a prefix, each in its own way.

    Parameters
    ----------
    n_frames : frames to make after the prefix, of each motion.
    prefix : how all of them begin, 8 frames or more (the paper has 8 to 20, and 20 are enough); or several, one for
        each motion, all of one length; brought to the network's frame rate, size and joints. Or features of such,
        ``(1 or K, P, D)``. ``None``: nothing is known, and they begin anywhere the prior likes.
    count : how many, one or thousands at once; of several prefixes their number.
    seed : of all chance; the same gives the same motions.
    temperature : how far both priors are strayed from; 1 as it was learnt, 0 not at all.
    future : a future to impose on all of them for a while.

    Raises :class:`CheckpointError` for a checkpoint of another system or one that is not trained in all stages,
    ``MotionError`` for a prefix that is too short or of a skeleton that is not the network's, ``TutorialError`` for
    other numbers that cannot be.
    """
    network = network_of(checkpoint)
    check_whole("the number of frames to generate", n_frames)
    if isinstance(prefix, (np.ndarray, Tensor)):
        prefixes = torch.as_tensor(prefix, dtype=torch.float32)
    else:
        prefixes = [prefix] if isinstance(prefix, Motion) else list(prefix or ())
    if len(prefixes) > 1:
        if count not in (1, len(prefixes)):
            raise TutorialError(f"{count} motions asked for and {len(prefixes)} prefixes given: expected one for each")
        count = len(prefixes)
    device = next(network.parameters()).device
    stream = FutureStream(network, count, temperature=temperature, generator=seeded(seed), imposed=future)
    codes = torch.zeros(1, 0, network.config.code, device=device)
    if len(prefixes):
        features = prefixes if isinstance(prefixes, Tensor) else _features(checkpoint, prefixes)
        read = stream.read(features.to(device))
        codes = read if len(prefixes) > 1 else read[:1]
    pieces, bar = [], Progress(n_frames, unit="frame", title="generating", enabled=progress)
    for start in range(0, n_frames, CHUNK):
        pieces.append(stream.take(min(CHUNK, n_frames - start)))
        bar.update(pieces[-1].code.shape[1])
    bar.close()
    return Futures(network, codes, Imagined(*(torch.cat(parts, 1) for parts in zip(*pieces, strict=True))))


def network_of(checkpoint: Checkpoint) -> DynamicFutureNet:
    """The network of a checkpoint, ready to generate; ``CheckpointError`` if it is another or not trained through."""
    if not isinstance(checkpoint.model, DynamicFutureNet):
        raise CheckpointError(f"the checkpoint is a {checkpoint.system!r}: expected a 'dynamic-future-net'")
    if len(checkpoint.model.done) < 3:
        done = " and ".join(checkpoint.model.done) or "nothing"
        raise CheckpointError(
            f"the network has been trained in {done} so far: to generate it needs pose, future and dynamics"
        )
    return checkpoint.model


def _features(checkpoint: Checkpoint, motions: Sequence[Motion]) -> Tensor:
    """Clips as the network reads them: ``(K, T, D)``."""
    representation: BodyFrame = checkpoint.representation
    shortest = min(motions, key=len)
    if len(shortest) < LEAST_PREFIX:
        raise MotionError(
            f"a prefix of {len(shortest)} frames ({shortest.name or 'the motion'}): the network's past is "
            f"{LEAST_PREFIX} or more"
        )
    clips = prepare_for(checkpoint, motions)
    if (left := min(map(len, clips))) < LEAST_PREFIX:
        raise MotionError(
            f"a prefix of {len(shortest)} frames at {shortest.fps:g} a second ({shortest.name or 'the motion'}) is one "
            f"of {left} at the network's {representation.fps:g}: its past is {LEAST_PREFIX} or more"
        )
    if len({len(clip) for clip in clips}) > 1:
        lengths = ", ".join(str(len(clip)) for clip in clips)
        raise MotionError(
            f"prefixes of {lengths} frames at {representation.fps:g} a second: expected all of one length"
        )
    return torch.from_numpy(np.stack([representation.encode(clip) for clip in clips]))


def future_of(checkpoint: Checkpoint, motion: Motion, *, start: int = 0, frames: int | None = None) -> ImposedFuture:
    """What comes next in a clip, frame for frame, as a future to impose on another motion.

    start : frames after the prefix at which it begins. frames : how long it lasts; by default as long as the clip has a
    future, its length less the horizon. Raises ``MotionError`` for a clip not longer than the horizon.
    """
    network = network_of(checkpoint)
    clip = prepare_for(checkpoint, [motion])[0]
    if len(clip) <= network.config.horizon:
        raise MotionError(
            f"{clip.name or 'the motion'} has {len(clip)} frames, no more than the {network.config.horizon} that the "
            "network looks ahead"
        )
    features = torch.from_numpy(checkpoint.representation.encode(clip)).to(next(network.parameters()).device)
    return ImposedFuture(start, summaries=network.summarize(features)[:frames])


def reconstruct(checkpoint: Checkpoint, motion: Motion) -> Motion:
    """Stage 1 alone: a clip encoded and decoded, frame by frame, where the clip is.

    To be looked at beside the clip. Raises ``CheckpointError`` where stage 1 is not trained yet.
    """
    clip, features, network = _clip(checkpoint, motion, "pose")
    return _decoded(network, network.pose.encode(features), clip)


def reconstruct_sequences(checkpoint: Checkpoint, motion: Motion) -> Motion:
    """Stage 2: a clip cut into stretches of H frames, each told by its one summary and the code before it.

    Begins with the clip's first frame; what does not fill a stretch at the end is left out. Raises
    ``CheckpointError`` where stage 2 is not trained yet, ``MotionError`` for a clip not longer than the horizon.
    """
    clip, features, network = _clip(checkpoint, motion, "future")
    horizon = network.config.horizon
    if len(clip) <= horizon:
        raise MotionError(f"{clip.name or 'the motion'} has {len(clip)} frames, the horizon is {horizon}")
    with torch.no_grad():
        codes = network.pose.encode(features)
        sequences = network.future.sequences(codes[None])[0, ::horizon]  # (N, H + 1, C)
        unrolled = network.future.decode(network.future.encode(sequences), sequences[:, 0])
    return _decoded(network, torch.cat((codes[:1], unrolled.flatten(0, 1))), clip)


def _clip(checkpoint: Checkpoint, motion: Motion, stage: str) -> tuple[Motion, Tensor, DynamicFutureNet]:
    network = checkpoint.model
    if not isinstance(network, DynamicFutureNet) or stage not in network.done:
        raise CheckpointError(f"a network with stage {stage!r} trained is needed, this is {checkpoint.system!r} with "
                              f"{' and '.join(getattr(network, 'done', ())) or 'none'}")  # fmt: skip
    clip = prepare_for(checkpoint, [motion])[0]
    features = torch.from_numpy(checkpoint.representation.encode(clip)).to(next(network.parameters()).device)
    return clip, features, network


@torch.no_grad()
def _decoded(network: DynamicFutureNet, codes: Tensor, clip: Motion) -> Motion:
    """Codes ``(T, C)`` as a motion that starts where ``clip`` does."""
    pose = network.pose.decode(codes)
    features = network.pose.features(pose).cpu().numpy()
    origin = network.representation.origin(clip)
    return network.representation.decode_turned(features, pose.rotations.cpu().numpy(), **origin, name=clip.name)
