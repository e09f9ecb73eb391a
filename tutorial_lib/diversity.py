"""How many ways generated motions go: how far apart they are, how much of what the data do they do, and if they copy.

Chen et al., "Dynamic Future Net" (MM 2020), section 6.3, has the first two. Every function takes numpy arrays or torch
tensors and returns the same kind. Poses are joints in the body's own frame, flattened, in metres: the "joints" part
of the ``"body-frame"`` features, ``(K, T, 3 J)`` for K motions of T frames. Distances between poses are Euclidean over
the whole pose, as the paper has them: 1 m is 0.22 m a joint where 21 joints all differ alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from .errors import TutorialError
from .motion.rotations import Array, numpy_or_torch


def _check_poses(poses: torch.Tensor, least: int) -> None:
    if poses.ndim != 3 or len(poses) < least or poses.shape[1] < 1:
        raise TutorialError(
            f"poses of shape {tuple(poses.shape)}: expected (motions, frames, numbers), {least} motions or more"
        )


@numpy_or_torch
def pairwise_distance(poses: Array) -> Array:
    """Average pairwise distance: the mean over all pairs of motions of the distance of their poses, frame by frame.

    poses: ``(K, T, P)``. Returns ``(T,)`` in metres, zero where all are equal.
    Raises ``TutorialError`` for fewer than two motions.
    """
    _check_poses(poses, 2)
    return torch.stack([torch.pdist((x - x.mean(0)).contiguous()).mean() for x in poses.unbind(1)])


@numpy_or_torch
def mean_distance(poses: Array) -> Array:
    """How far each motion is from the mean of all at that time: ``(K, T, P)`` to ``(K, T)`` metres (section 6.3)."""
    _check_poses(poses, 1)
    return (poses - poses.mean(0)).norm(dim=-1)


class Band(NamedTuple):
    """Figure 9: mean and standard deviation over motions of :func:`mean_distance`, ``(T,)`` each, in metres.

    The deviation is that of these K motions (over K, not K - 1)."""

    mean: Array
    deviation: Array


def mean_distance_band(poses: Array) -> Band:
    """The band of K motions ``(K, T, P)``, frame by frame. For that of a data set, which has no time, take its poses as
    N motions of one frame, ``(N, 1, P)``."""
    distance = mean_distance(poses)
    # numpy divides by K unless it is told, torch by K - 1
    deviation = distance.std(0, correction=0) if isinstance(distance, torch.Tensor) else distance.std(0)
    return Band(distance.mean(0), deviation)


@numpy_or_torch
def band_coverage(low: Array, high: Array, data_low: Array, data_high: Array) -> Array:
    """Share of the area of the data's band that lies in the band of generated motions: a number, 0 to 1.

    All four are ``(T,)``, or plain numbers, as the data's are, which have no time; a band's edges are one deviation
    below and above its mean.
    Raises ``TutorialError`` for a band of the data without area.
    """
    edges = (low, high, data_low, data_high)
    like = next((x for x in edges if isinstance(x, torch.Tensor)), torch.zeros((), dtype=torch.float64))
    low, high, data_low, data_high = (torch.as_tensor(x, dtype=like.dtype, device=like.device)
                                      if isinstance(x, (int, float)) else x for x in edges)  # fmt: skip
    shared = (torch.minimum(high, data_high) - torch.maximum(low, data_low)).clamp(min=0)
    area = (data_high - data_low).expand_as(shared)
    if not bool((area >= 0).all()) or not float(area.sum()) > 0:
        raise TutorialError("the data's band has no area: expected poses that differ")
    return shared.sum() / area.sum()


@numpy_or_torch
def nearest_window(windows: Array, others: Array) -> Array:
    """How near each of N short motions is to the nearest of M others: ``(N,)`` metres, root mean square over frames
    and joints.

    windows ``(N, T, P)``, others ``(M, T, P)``. A copy has 0. Raises ``TutorialError`` where their shapes do not fit.
    """
    _check_poses(windows, 1)
    _check_poses(others, 1)
    if windows.shape[1:] != others.shape[1:]:
        raise TutorialError(
            f"windows of {windows.shape[1]} frames of {windows.shape[2]} numbers have no distance from others of "
            f"{others.shape[1]} frames of {others.shape[2]}"
        )
    others, scale = others.flatten(1), (3.0 / (windows.shape[1] * windows.shape[2])) ** 0.5
    centre = others.mean(0)
    parts = [torch.cdist(part - centre, others - centre).amin(1) for part in windows.flatten(1).split(512)]
    return torch.cat(parts) * scale


def windows_of(frames: Array, length: int, stride: int = 1) -> Array:
    """All stretches of ``length`` frames that begin ``stride`` apart: ``(..., T, P)`` to ``(..., N, length, P)``.

    Of a numpy array a read-only view, which needs no memory of its own; of a tensor a copy.
    Raises ``TutorialError`` where there are fewer frames than that.
    """
    # windows overlap: who wrote to one of a view would change its neighbours, and the frames that were given
    windows = _windows_of(frames, length, stride)
    if isinstance(windows, np.ndarray):
        windows.setflags(write=False)
        return windows
    return windows.clone()  # a tensor cannot be made read-only


@numpy_or_torch
def _windows_of(frames: Array, length: int, stride: int) -> Array:
    if length < 1 or stride < 1 or frames.ndim < 2 or frames.shape[-2] < length:
        raise TutorialError(f"windows of {length} frames, {stride} apart, of frames of shape {tuple(frames.shape)}")
    return frames.unfold(-2, length, stride).transpose(-1, -2)
