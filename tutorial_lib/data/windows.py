"""From clips to batches: split by clip, windows with the paper's augmentation, normalisation."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence

import numpy as np
import torch

from ..chance import is_whole, whole_seed
from ..errors import DataError, TutorialError
from ..motion.clip import Motion, some_names, whole_ratio
from ..motion.rotations import Array, quat_about_y, quat_mul
from ..representations import Representation


def split_clips(
    motions: Sequence[Motion], test_fraction: float = 0.2, seed: int = 0
) -> tuple[list[Motion], list[Motion]]:
    """Training and test clips; whole clips, never windows of one clip on both sides.

    Neighbouring windows are nearly equal, so a split by window would test on what was trained on.
    The same seed gives the same split; each side keeps the order and has at least one clip.
    Raises ``DataError`` for fewer than two clips or a fraction that is not between 0 and 1.
    """
    motions = list(motions)
    if not 0.0 < test_fraction < 1.0:
        raise DataError(f"test fraction {test_fraction}: expected a number between 0 and 1")
    if len(motions) < 2:
        raise DataError(f"{len(motions)} clip to split into training and test clips: expected at least 2")
    n_test = min(max(round(len(motions) * test_fraction), 1), len(motions) - 1)
    test = set(np.random.default_rng(whole_seed(seed)).permutation(len(motions))[:n_test].tolist())
    return (
        [m for k, m in enumerate(motions) if k not in test],
        [m for k, m in enumerate(motions) if k in test],
    )


class Normalizer:
    """``(x - mean) / std``, channel by channel; saved with the weights that were trained under it.

    mean, std: ``(D,)``, kept as float32 tensors; std above zero.
    Raises ``TutorialError`` for shapes that do not fit or values that are not finite.
    """

    def __init__(self, mean: Array, std: Array):
        self.mean, self.std = (torch.as_tensor(v, dtype=torch.float32).detach().clone().cpu() for v in (mean, std))
        if self.mean.ndim != 1 or self.mean.shape != self.std.shape:
            raise TutorialError(
                f"normalizer: mean of shape {tuple(self.mean.shape)} and std of shape "
                f"{tuple(self.std.shape)}, expected (D,) both"
            )
        if not (torch.isfinite(self.mean).all() and torch.isfinite(self.std).all() and (self.std > 0).all()):
            raise TutorialError("normalizer: expected finite means and standard deviations above zero")

    @classmethod
    def fit(cls, features: Iterable[Array], floor: float = 1e-3) -> Normalizer:
        """From arrays ``(..., D)``, over all but their last axis.

        floor: the smallest standard deviation, so that a channel that never changes (the hip's own place in
            ``"hip-frame"``) is not blown up: in metres a millimetre.
        For representations along the world's axes, fit on windows that a ``WindowSampler`` drew, so that the
        random rotation is in the statistics.
        """
        count, total, squares, shift = 0, 0.0, 0.0, None
        for array in features:
            x = np.asarray(array, dtype=np.float64)
            x = x.reshape(-1, x.shape[-1])
            if shift is None:
                shift = x.mean(0)  # sums about a value near the mean lose no digits
            if x.shape[1:] != shift.shape:
                raise TutorialError(f"normalizer: features of width {x.shape[-1]} after features of {len(shift)}")
            x = x - shift
            count, total, squares = count + len(x), total + x.sum(0), squares + (x * x).sum(0)
        if shift is None or count == 0:
            raise TutorialError("normalizer: no features to fit on")
        mean = total / count
        return cls(shift + mean, np.maximum(np.sqrt(np.maximum(squares / count - mean * mean, 0.0)), floor))

    @classmethod
    def identity(cls, dim: int) -> Normalizer:
        """Changes nothing: the acRNN trains on metres as they are."""
        return cls(torch.zeros(dim), torch.ones(dim))

    @property
    def dim(self) -> int:
        """D."""
        return len(self.mean)

    def apply(self, x: Array) -> Array:
        """Features ``(..., D)`` to normalised ones; numpy or torch, on the device where they are."""
        mean, std = self._like(x)
        return (x - mean) / std

    def invert(self, x: Array) -> Array:
        """The inverse of ``apply``."""
        mean, std = self._like(x)
        return x * std + mean

    def _like(self, x):
        if x.shape[-1] != self.dim:
            raise TutorialError(f"features of width {x.shape[-1]} for a normalizer of {self.dim} channels")
        if isinstance(x, torch.Tensor):
            return self.mean.to(x), self.std.to(x)
        return self.mean.numpy(), self.std.numpy()

    def to_dict(self) -> dict[str, torch.Tensor]:
        """``{"mean": (D,), "std": (D,)}``; ``Normalizer.from_dict`` is its inverse."""
        return {"mean": self.mean.clone(), "std": self.std.clone()}

    @classmethod
    def from_dict(cls, tensors: dict[str, torch.Tensor]) -> Normalizer:
        """From what ``to_dict`` gave; a ``TutorialError`` says what is missing."""
        missing = [key for key in ("mean", "std") if key not in tensors]
        if missing:
            raise TutorialError(f"normalizer without {' and '.join(missing)}: expected mean and std")
        return cls(tensors["mean"], tensors["std"])

    def __eq__(self, other) -> bool:
        return isinstance(other, Normalizer) and torch.equal(self.mean, other.mean) and torch.equal(self.std, other.std)

    __hash__ = None

    def __repr__(self) -> str:
        return f"Normalizer({self.dim} channels)"


class WindowSampler:
    """Draws batches of windows from clips, augmented as acRNN, section 3, "Training", says: "We sample
    sequences at multiple frame-rates as well as rotate the sequence randomly in order to increase the training size".

    motions: clips at any frame rate, of the representation's skeleton.
    length: frames of a window. batch: windows drawn at once.
    rates: frames per second at which windows are taken, by default the representation's alone. A rate above the
        representation's gives slower motion, one below it faster motion: the frames count as ``1 / fps`` of the
        representation apart all the same. Where a clip's rate is a multiple (30 from 120) every fourth frame is taken,
        from any first one, so nothing is interpolated and all frames are used; else the clip is resampled once, here.
    rotate: turn each window about the vertical by a random angle, before it is encoded.
    normalizer: applied to what ``sample`` returns.
    seed: an integer, or a ``numpy.random.Generator`` to draw from.
    pad: clips too short for a window are lengthened at both ends with their first and last pose, so that a window may
        begin or end with someone standing still in it (VAE-LSTM, section 4.1); else they are left out.
    groups: for each clip the number of the data set that it is from. Each data set is then drawn from equally often,
        however long it is; by default all clips are one.

    Every start of a window in a group is equally likely (between frame rates, in proportion to seconds). Clips too
    short for any window are left out with one warning, or with ``pad`` are in every one of their windows whole; a rate
    at which no clip is long enough is left out with a warning as well.
    Raises ``DataError`` where no clip of a group is long enough, ``MotionError`` where a clip does not fit the
    representation.
    """

    def __init__(
        self,
        motions: Sequence[Motion],
        representation: Representation,
        *,
        length: int,
        batch: int,
        rates: Sequence[float] | None = None,
        rotate: bool = True,
        normalizer: Normalizer | None = None,
        seed: int | np.random.Generator = 0,
        groups: Sequence[int] | None = None,
        pad: bool = False,
    ):
        if not all(is_whole(size) and size >= 1 for size in (length, batch)):
            raise DataError(
                f"windows of {length!r} frames in batches of {batch!r}: expected whole numbers, at least 1 of each"
            )
        if normalizer is not None and normalizer.dim != representation.dim:
            raise DataError(
                f"normalizer of {normalizer.dim} channels for the representation {representation.name!r} of "
                f"{representation.dim}"
            )
        rates = [representation.fps] if rates is None else [float(r) for r in rates]
        if not rates or not all(np.isfinite(r) and r > 0 for r in rates):
            raise DataError(f"frame rates {rates}: expected numbers above zero")
        self.representation, self.normalizer = representation, normalizer
        self.length, self.batch, self.rotate, self.rates = int(length), int(batch), bool(rotate), tuple(rates)
        self.pad = bool(pad)
        self.rng = seed if isinstance(seed, np.random.Generator) else np.random.default_rng(whole_seed(seed))
        motions = list(motions)
        groups = [0] * len(motions) if groups is None else list(groups)
        if len(groups) != len(motions):
            raise DataError(f"groups of {len(groups)} clips for {len(motions)} clips")
        self._gather(motions, groups)

    def _gather(self, motions: list[Motion], groups: list[int]) -> None:
        """All clips behind each other in one buffer, and a table of where windows may start in it."""
        positions, rotations, table, too_short, size = [], [], [], [], 0
        drawn_at = set()  # rates
        for motion, group in zip(motions, groups, strict=True):
            self.representation.check_skeleton(motion)
            rows_before, stored = len(table), {}
            for rate in self.rates:
                stride = whole_ratio(motion.fps, rate)
                clip, stride = (motion, stride) if stride else (motion.resample(rate), 1)
                whole = stride * (self.length - 1) + 1  # frames that a window spans
                if self.pad and len(clip) < whole:
                    clip = padded(clip, 2 * whole - len(clip))
                starts = len(clip) - whole + 1
                if starts < 1:
                    continue
                if (clip.fps, len(clip)) not in stored:
                    stored[clip.fps, len(clip)] = size
                    size += len(clip)
                    where = slice(0, 1) if self.representation.uses_rotations else slice(None)
                    positions.append(torch.tensor(clip.positions[:, where], dtype=torch.float32))
                    if self.representation.uses_rotations:
                        rotations.append(torch.tensor(clip.rotations, dtype=torch.float32))
                drawn_at.add(rate)
                table.append((stored[clip.fps, len(clip)], starts, stride, starts / clip.fps, group))
            if len(table) == rows_before:
                too_short.append(motion)
        drawn_from = {row[-1] for row in table}
        for group in dict.fromkeys(groups) or [None]:
            if group not in drawn_from:
                lacking = [m for m, g in zip(motions, groups, strict=True) if g == group]
                raise DataError(_too_short(lacking, self.length, max(self.rates)))
        if too_short:
            warnings.warn(
                f"{len(too_short)} of {len(motions)} clips left out, too short for a window of "
                f"{self.length} frames: {some_names(too_short)}",
                stacklevel=3,
            )
        for rate in dict.fromkeys(self.rates):  # no error: sets of short clips are trained at the rates that they have
            if rate not in drawn_at:
                warnings.warn(f"rate {rate:g} left out: {_too_short(motions, self.length, rate)}", stacklevel=3)
        self._positions = torch.cat(positions)
        self._rotations = torch.cat(rotations) if rotations else None
        offsets, starts, strides, seconds, of = (np.array(column) for column in zip(*table, strict=True))
        self._offsets, self._starts, self._strides = offsets, starts, strides
        if len(drawn_from) > 1:
            for group in drawn_from:
                seconds[of == group] /= seconds[of == group].sum()
        self._cumulative = np.cumsum(seconds) / np.sum(seconds)

    @property
    def n_windows(self) -> int:
        """How many different windows there are, rotation aside."""
        return int(self._starts.sum())

    def sample(self, generator: np.random.Generator | None = None) -> torch.Tensor:
        """A batch ``(batch, length, D)`` of float32 features; from ``generator`` or the sampler's own."""
        which, where, angle = (self.rng if generator is None else generator).random((3, self.batch))
        row = np.searchsorted(self._cumulative, which, side="right").clip(max=len(self._starts) - 1)
        first = self._offsets[row] + (where * self._starts[row]).astype(np.int64)
        frames = torch.from_numpy(first[:, None] + self._strides[row][:, None] * np.arange(self.length))
        positions = self._positions[frames]  # (B, L, J, 3)
        rotations = None if self._rotations is None else self._rotations[frames]
        if self.rotate:
            angle = torch.from_numpy(2 * math.pi * angle).float()
            sin, cos, zero, one = angle.sin(), angle.cos(), torch.zeros_like(angle), torch.ones_like(angle)
            matrix = torch.stack((cos, zero, -sin, zero, one, zero, sin, zero, cos), -1).view(-1, 3, 3)
            positions = (positions.flatten(1, 2) @ matrix).view(positions.shape)  # rows: the transposed rotation
            if rotations is not None:
                rotations[:, :, 0] = quat_mul(quat_about_y(angle)[:, None], rotations[:, :, 0])
        features = self.representation.encode_arrays(positions, rotations)
        return features if self.normalizer is None else self.normalizer.apply(features)

    def state_dict(self) -> dict:
        """JSON-able state of the sampler's own random numbers: loaded again, ``sample`` goes on as it would have."""
        return {"generator": self.rng.bit_generator.state}

    def load_state_dict(self, state: dict) -> None:
        """Go on from ``state_dict()``; ``DataError`` where it is the state of another kind of generator."""
        try:
            self.rng.bit_generator.state = state["generator"]
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"state of a window sampler: {error!r}, expected what state_dict() gave") from None

    def __repr__(self) -> str:
        rates = ", ".join(f"{r:g}" for r in self.rates)
        return (
            f"WindowSampler({self.n_windows} windows of {self.length} frames at {rates} fps, "
            f"batch {self.batch}, {'rotated, ' if self.rotate else ''}{self.representation!r})"
        )


def padded(motion: Motion, frames: int) -> Motion:
    """``motion`` lengthened to ``frames`` frames, half of them before it in its first pose, half after it in its last.

    VAE-LSTM, section 4.1. A motion as long as that is returned as it is.
    """
    lacking = max(0, frames - len(motion))
    index = np.arange(-(lacking // 2), len(motion) + lacking - lacking // 2).clip(0, len(motion) - 1)
    rotations = None if motion.rotations is None else motion.rotations[index]
    return Motion(motion.skeleton, motion.fps, motion.positions[index], rotations, motion.name)


def _too_short(motions: Sequence[Motion], length: int, rate: float) -> str:
    if not motions:
        return "no clips to take windows from"
    frames = [int((len(m) - 1) * rate / m.fps + 1e-3) + 1 for m in motions]
    longest = int(np.argmax(frames))
    return (
        f"no clip is long enough for a window of {length} frames at {rate:g} frames per second: the longest, "
        f"{motions[longest].name!r}, has {frames[longest]}"
    )


def evaluation_windows(
    motions: Sequence[Motion],
    representation: Representation,
    *,
    seed_frames: int,
    future_frames: int,
    count: int,
    seed: int = 0,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Seeds and what really came after them, from test clips: neither rotated nor normalised.

    acRNN, tables 1 and 2: ``seed_frames=10``, ``count=20``. The windows are taken at the representation's frame
    rate, spread over the clips: all possible starts, clip after clip, are cut into ``count`` equal stretches
    and one start is drawn from each. Windows may overlap; no two are the same.
    Returns float32 ``(count, seed_frames, D)`` and ``(count, future_frames, D)``.
    Raises ``DataError`` where clips are too short or have fewer windows than asked for.
    """
    length = seed_frames + future_frames
    if seed_frames < 1 or future_frames < 0 or count < 1:
        raise DataError(f"{count} seeds of {seed_frames} frames with {future_frames} to follow: expected at least 1")
    clips = []
    for motion in motions:
        clip = motion.resample(representation.fps)
        representation.check(clip)
        clips.append(clip)
    features = []
    for k, first in evaluation_places(clips, length, count=count, seed=seed):
        rotations = clips[k].rotations
        rotations = None if rotations is None else rotations[first : first + length]
        features.append(representation.encode_arrays(clips[k].positions[first : first + length], rotations))
    windows = torch.from_numpy(np.stack(features).astype(np.float32))
    return windows[:, :seed_frames].contiguous(), windows[:, seed_frames:].contiguous()


def evaluation_places(clips: Sequence[Motion], length: int, *, count: int, seed: int = 0) -> list[tuple[int, int]]:
    """Where :func:`evaluation_windows` takes its windows: (clip, first frame) of each of ``count``, all different.

    length: frames of a window, at the clips' own rate. Raises :class:`DataError` where clips are too short or have
    fewer windows than asked for.
    """
    starts = np.array([max(len(clip) - length + 1, 0) for clip in clips], dtype=np.int64)
    total = int(starts.sum())
    if total == 0:
        raise DataError(_too_short(clips, length, clips[0].fps if clips else 0))
    if total < count:
        raise DataError(f"{count} windows of {length} frames asked for: these clips have {total} different ones")
    edges = np.arange(count + 1) * total // count
    chosen = np.random.default_rng(whole_seed(seed)).integers(edges[:-1], edges[1:])
    ends = np.cumsum(starts)
    which = np.searchsorted(ends, chosen, side="right")
    return [(int(k), int(start - (ends[k] - starts[k]))) for k, start in zip(which, chosen, strict=True)]
