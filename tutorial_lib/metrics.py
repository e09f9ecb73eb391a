"""How far a generated motion is from the truth, whether it still moves, and what is wrong with it.

Every function takes numpy arrays or torch tensors and returns the same kind, on the same device. Features are
those of a representation, in its own units (normalised features first through ``Normalizer.invert``): an
error in metres and one in radians cannot be compared. Long batches such as (20, 18000, 171) are taken one
sequence at a time, so that little memory is needed beside them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from .errors import TutorialError
from .motion.rotations import Array, numpy_or_torch
from .motion.skeleton import Skeleton
from .motion.skeletons import common_indices

PAPER_TIMES_MS = (80, 160, 240, 320, 400, 480, 560, 640)  # acRNN, tables 1 and 2
FREEZING = {"fraction": 0.1, "seconds": 10.0}  # what stands still for less recovers (acRNN, figure 6)


def _each_sequence(function, values: torch.Tensor, inner: int) -> torch.Tensor:
    """``function`` of ``(..., *inner axes)``, one sequence at a time."""
    outer = values.shape[: values.ndim - inner]
    if not outer:
        return function(values)
    parts = [function(v) for v in values.reshape(-1, *values.shape[values.ndim - inner :])]
    if not parts:
        raise TutorialError(f"no sequences in an array of shape {tuple(values.shape)}")
    return torch.stack(parts).unflatten(0, outer)


# -- distance to the truth ---------------------------------------------------------------------------------


@numpy_or_torch
def frame_distance(a: Array, b: Array) -> Array:
    """Euclidean distance between frames ``(..., D)``: ``|a - b|_2`` over the channels, shape ``(...)``."""
    if a.shape[-1] != b.shape[-1]:
        raise TutorialError(f"frames of {a.shape[-1]} and of {b.shape[-1]} channels have no distance")
    return (a - b).norm(dim=-1)


def frames_at(times_ms: Sequence[float], fps: float) -> list[int]:
    """How many frames after the seed each time is: the nearest whole number, at least 1.

    At 30 fps, 80 ms are 2.4 frames: frame 2, at 67 ms. The frame right after the seed is number 1.
    """
    return [max(1, int(t * fps / 1000.0 + 0.5)) for t in times_ms]


@numpy_or_torch
def prediction_error(pred: Array, truth: Array, fps: float, times_ms: Sequence[float] = PAPER_TIMES_MS) -> Array:
    """acRNN, tables 1 and 2: the Euclidean distance to the ground truth at some times, averaged over seeds.

    ``error(t) = mean over seeds of |pred_t - truth_t|_2``

    pred, truth: ``(N, T, D)`` features, their first frame the one right after the seed. times_ms: after the
    seed's last frame; the nearest frame is taken (``frames_at``).
    Returns ``(len(times_ms),)`` in the features' units.
    Raises ``TutorialError`` where the shapes differ or there are too few frames.
    """
    return prediction_errors(pred, truth, fps, times_ms).mean(0)


@numpy_or_torch
def prediction_errors(pred: Array, truth: Array, fps: float, times_ms: Sequence[float] = PAPER_TIMES_MS) -> Array:
    """``prediction_error`` of each seed by itself: ``(N, len(times_ms))``; arguments and errors are the same.

    How far the seeds lie apart tells how much a mean over them is worth (``standard_error``).
    """
    times = [float(t) for t in times_ms]
    if pred.ndim != 3 or truth.ndim != 3 or pred.shape[::2] != truth.shape[::2]:
        raise TutorialError(
            f"prediction of shape {tuple(pred.shape)} and truth of shape {tuple(truth.shape)}: expected (N, T, D) both"
        )
    frames = frames_at(times, fps)
    have = min(pred.shape[1], truth.shape[1])
    if max(frames) > have:
        raise TutorialError(
            f"{max(times):g} ms at {fps:g} frames per second are {max(frames)} frames, prediction and truth have {have}"
        )
    index = [f - 1 for f in frames]
    return frame_distance(pred[:, index], truth[:, index])


@numpy_or_torch
def standard_error(values: Array) -> Array:
    """Of the mean of ``(N, ...)`` values over their first axis: ``s / sqrt(N)``, shape ``(...)``; NaN for N = 1.

    s is the sample's standard deviation (divided by N - 1). Means of two systems on the same seeds are compared by
    the standard error of the seeds' *differences*, which is mostly the smaller one.
    """
    return values.std(0, unbiased=True) / len(values) ** 0.5 if len(values) > 1 else values[0] * float("nan")


# -- does it still move ------------------------------------------------------------------------------------


@numpy_or_torch
def frame_change(features: Array) -> Array:
    """``c_t = |x_(t+1) - x_t|_2``: features ``(..., T, D)`` to ``(..., T - 1)``, each sequence for itself."""
    if features.ndim < 2 or features.shape[-2] < 2:
        raise TutorialError(f"features of shape {tuple(features.shape)}: expected (..., T, D) with T of at least 2")
    return _each_sequence(lambda x: (x[1:] - x[:-1]).norm(dim=-1), features, 2)


@numpy_or_torch
def motion_change(features: Array) -> Array:
    """acRNN, figures 2 and 9: the distance between successive frames, averaged over the sequences.

    features: ``(N, T, D)`` or ``(T, D)``. Returns ``(T - 1,)``, number t for the step from frame t to t + 1.
    """
    change = frame_change(features)
    return change.reshape(-1, change.shape[-1]).mean(0)


@numpy_or_torch
def moving_mean(curve: Array, window: int) -> Array:
    """The mean of each ``window`` successive values: ``(..., T)`` to ``(..., T - window + 1)``.

    Number t is the mean of values t to t + window - 1; draw it at ``t + (window - 1) / 2``.
    Raises ``TutorialError`` where the curve is shorter than the window.
    """
    if window < 1 or curve.shape[-1] < window:
        raise TutorialError(f"a mean over {window} values of a curve of {curve.shape[-1]}")
    # each window is summed by itself, so that a NaN stays in the windows that have it
    return curve.double().unfold(-1, window, 1).mean(-1).to(curve.dtype)


def _frozen(change: torch.Tensor, true_change: float, fps: float, fraction: float, seconds: float) -> torch.Tensor:
    fps, true_change = float(fps), float(true_change)
    frames = max(1, round(float(seconds) * fps))
    if true_change <= 0 or not np.isfinite(true_change):
        raise TutorialError(f"true motion change {true_change}: expected a number above zero")
    if change.shape[-1] < frames:
        raise TutorialError(
            f"{change.shape[-1]} motion changes at {fps:g} frames per second, "
            f"expected at least {frames} for a window of {seconds:g} s"
        )
    return _each_sequence(lambda c: moving_mean(c, frames) < fraction * true_change, change, 1)


@numpy_or_torch
def freezing_time(change: Array, true_change: float, fps: float, fraction: float = 0.1, seconds: float = 1.0) -> Array:
    """Seconds until a motion first stands still; infinity if it never does.

    Rule: it stands still from t on where the mean of its motion change over the ``seconds`` that follow is
    below ``fraction`` of the true motion change (the mean of ``frame_change`` of real clips at the same frame rate).

    change: ``(..., T)`` from ``frame_change``. Returns ``(...)``. Values that are not finite are no
    standstill; ``divergence_time`` finds them.
    Raises ``TutorialError`` where the motion is shorter than the window.
    """
    frozen = _frozen(change, true_change, fps, fraction, seconds)
    first = frozen.to(torch.uint8).argmax(-1).to(change.dtype) / fps
    return torch.where(frozen.any(-1), first, torch.full_like(first, float("inf")))


def stagnations(
    change: Array, true_change: float, fps: float, fraction: float = 0.1, seconds: float = 1.0
) -> list[tuple[float, float]]:
    """Each stretch of one motion that stands still: ``(start, duration)`` in seconds (acRNN, figure 6).

    change: ``(T,)``; the rule is ``freezing_time``'s, and windows that overlap or touch are one stretch,
    which lasts from the first one's start to the last one's end.
    """
    change = torch.as_tensor(change)
    if change.ndim != 1:
        raise TutorialError(f"motion changes of shape {tuple(change.shape)}: expected one motion, (T,)")
    starts = torch.nonzero(_frozen(change, true_change, fps, fraction, seconds)).flatten().tolist()
    length, stretches = max(1, round(float(seconds) * float(fps))), []
    for start in starts:
        if stretches and start <= stretches[-1][1]:
            stretches[-1][1] = start + length
        else:
            stretches.append([start, start + length])
    return [(a / fps, (b - a) / fps) for a, b in stretches]


@numpy_or_torch
def pose_spread(positions: Array, fps: float, seconds: float = 5.0) -> Array:
    """How much the pose varies within each ``seconds``: metres ``(..., T - n + 1)`` for windows of n frames.

    ``s_t = sqrt(mean over the window's frames and nodes of |x - mean pose of the window|^2)``, x relative to the root
    along the world's axes. A figure that trembles has a motion change but hardly a spread.
    positions: ``(..., T, J, 3)`` metres. Raises ``TutorialError`` where the motion is shorter than the window.
    """
    frames = max(1, round(float(seconds) * float(fps)))

    def spread(x: torch.Tensor) -> torch.Tensor:
        x = (x - x[:, :1]).double().flatten(1)  # (T, 3J)
        x = x - x[:1]  # small numbers, whose squares lose no digits
        mean = moving_mean(x.T, frames)  # (3J, T - n + 1)
        square = moving_mean(x.square().T, frames) - mean.square()
        return (square.sum(0).clamp(min=0) / (x.shape[1] / 3)).sqrt()

    return _each_sequence(spread, positions, 3).to(positions.dtype)


@numpy_or_torch
def stuck_time(positions: Array, true_spread: float, fps: float, fraction: float = 0.25, seconds: float = 5.0) -> Array:
    """Seconds until a motion first stays in one pose, trembling or not; infinity if it never does.

    Rule: it is stuck from t on where its ``pose_spread`` over the ``seconds`` that follow is below ``fraction`` of the
    true one (the mean ``pose_spread`` of real clips, each over its whole length). acRNN, figure 7: "slight motion
    occurs, but pose remains unaltered". Real clips of the acRNN's styles have no 5 s below half of the mean.

    positions: ``(..., T, J, 3)`` metres. Returns ``(...)``. Values that are not finite are not stuck.
    """
    if not (float(true_spread) > 0 and np.isfinite(float(true_spread))):
        raise TutorialError(f"true pose spread {float(true_spread)}: expected a number above zero")
    stuck = pose_spread(positions, fps, seconds) < fraction * float(true_spread)
    first = stuck.to(torch.uint8).argmax(-1).to(positions.dtype) / fps
    return torch.where(stuck.any(-1), first, torch.full_like(first, float("inf")))


# -- is it still a person ----------------------------------------------------------------------------------


@numpy_or_torch
def reach(positions: Array) -> Array:
    """The largest distance of any node from the root in ``(..., T, J, 3)`` positions: metres, shape ``()``.

    Taken over the training clips it is the range of human poses for ``divergence_time``.
    """
    return _each_sequence(_reach, positions, 3).amax()


def _reach(positions: torch.Tensor) -> torch.Tensor:
    return (positions - positions[..., :1, :]).square().sum(-1).amax(-1).sqrt()


@numpy_or_torch
def divergence_time(positions: Array, data_reach: float, fps: float, factor: float = 1.5) -> Array:
    """Seconds until a motion first leaves the range of human poses; infinity if it never does.

    Rule: a frame is outside where any node is farther from the root than ``factor`` times ``data_reach``
    (``reach`` of the training clips), or any coordinate is not finite.

    positions: ``(..., T, J, 3)`` metres, from ``Representation.decode_positions``. Returns ``(...)``.
    """

    def first(x: torch.Tensor) -> torch.Tensor:
        outside = ~(_reach(x) <= factor * float(data_reach)) | ~torch.isfinite(x).flatten(-2).all(-1)
        time = outside.to(torch.uint8).argmax().to(x.dtype) / fps
        return torch.where(outside.any(), time, torch.full_like(time, float("inf")))

    return _each_sequence(first, positions, 3)


def diverged(positions: Array, data_reach: float, factor: float = 1.5) -> Array:
    """Whether a motion leaves the range of human poses at all (``divergence_time``'s rule): booleans ``(...)``."""
    return divergence_time(positions, data_reach, 1.0, factor) < float("inf")


@numpy_or_torch
def pose_distance(positions: Array, poses: Array) -> Array:
    """How far each pose is from the nearest of some true ones, wherever both stand and face: metres ``(..., T)``.

    ``d_t = min over poses p and turns R about the vertical of sqrt(mean over nodes of |x_t - R p|^2)``, with x and p
    relative to their roots. The best turn has a closed form: with ``C = sum(x_x p_x + x_z p_z)`` and
    ``S = sum(x_x p_z - x_z p_x)`` over the nodes, the largest ``sum of x . R p`` is
    ``sqrt(C^2 + S^2) + sum(x_y p_y)``.

    positions: ``(..., T, J, 3)`` metres; poses: ``(P, J, 3)`` of the same skeleton. Frames that are not finite are
    infinitely far.
    Raises ``TutorialError`` where the numbers of nodes differ or there are no poses.
    """
    if poses.ndim != 3 or len(poses) == 0 or positions.shape[-2:] != poses.shape[-2:]:
        raise TutorialError(
            f"positions of shape {tuple(positions.shape)} and poses of shape {tuple(poses.shape)}: expected "
            "(..., T, J, 3) and (P, J, 3), P of at least 1"
        )
    px, py, pz = (poses - poses[:, :1]).float().unbind(-1)
    size = (px.square() + py.square() + pz.square()).sum(-1)  # (P,)

    def nearest(x: torch.Tensor) -> torch.Tensor:
        parts = []
        for part in (x - x[:, :1]).float().split(2000):  # (t, J, 3): a matrix of distances of bounded size
            xx, xy, xz = part.unbind(-1)
            turned = torch.hypot(xx @ px.T + xz @ pz.T, xx @ pz.T - xz @ px.T)
            square = part.square().sum((-2, -1))[:, None] + size - 2 * (turned + xy @ py.T)
            parts.append(square.amin(-1).clamp(min=0) / part.shape[-2])
        distance = torch.cat(parts).sqrt().to(x.dtype)
        return torch.where(torch.isfinite(distance), distance, torch.full_like(distance, float("inf")))

    return _each_sequence(nearest, positions, 3)


def pose_range(clips: Sequence[Array]) -> float:
    """How far true poses lie from the nearest pose of *other* clips at most, in metres: the range of human poses.

    Each clip ``(T, J, 3)`` in turn is held out and its poses are looked for among the others'
    (``pose_distance``); the largest distance of all is what a true motion nobody has seen may have.
    Raises ``TutorialError`` for fewer than two clips.
    """
    if len(clips) < 2:
        raise TutorialError(f"the range of poses of {len(clips)} clip: expected at least 2, each is held out in turn")
    clips = [np.asarray(clip) for clip in clips]
    others = [np.concatenate(clips[:k] + clips[k + 1 :]) for k in range(len(clips))]
    return max(float(pose_distance(clip, poses).max()) for clip, poses in zip(clips, others, strict=True))


@numpy_or_torch
def range_exit_time(
    distance: Array, data_range: float, fps: float, factor: float = 1.25, seconds: float = 1.0
) -> Array:
    """Seconds until a motion first stays outside the range of human poses; infinity if it never does.

    Rule: it is outside from t on where the mean of its ``pose_distance`` over the ``seconds`` that follow is above
    ``factor`` times ``data_range`` (``pose_range`` of true clips), or one of these is not finite. A stretched frame or
    two are none.

    distance: ``(..., T)``. Returns ``(...)``. Raises ``TutorialError`` where the motion is shorter than the window.
    """
    frames = max(1, round(float(seconds) * float(fps)))
    limit = factor * float(data_range)
    outside = _each_sequence(lambda d: ~(moving_mean(d, frames) <= limit), distance, 1)
    first = outside.to(torch.uint8).argmax(-1).to(distance.dtype) / fps
    return torch.where(outside.any(-1), first, torch.full_like(first, float("inf")))


# -- feet and bones ----------------------------------------------------------------------------------------


def foot_joints(skeleton: Skeleton) -> list[int]:
    """Left and right foot (the ankle) and toe, by the known skeletons' names; ``MotionError`` where unknown."""
    at = common_indices(skeleton)
    return [at[name] for name in ("LeftFoot", "LeftToe", "RightFoot", "RightToe")]


@numpy_or_torch
def standing_heights(positions: Array, feet: Sequence[int]) -> Array:
    """How high each foot node is when its foot stands: the 5 % quantile of its height over time.

    positions: ``(..., T, J, 3)``; returns ``(..., F)`` metres. An ankle stands some 8 cm above the ground and
    a toe's tip 1 cm, so each node has its own.
    """
    feet = [int(f) for f in feet]
    return _each_sequence(lambda x: x[:, feet, 1].quantile(0.05, dim=0), positions, 3)


@numpy_or_torch
def foot_contacts(
    positions: Array,
    feet: Sequence[int],
    fps: float,
    standing: Array | None = None,
    height: float = 0.025,
    speed: float = 1.0,
) -> Array:
    """Which foot node is on the ground in which step: booleans ``(..., T - 1, F)``.

    Rule: during the step from frame t to t + 1 a node is in contact where in both frames it is less than
    ``height`` metres above its standing height, and it moves along the ground by less than ``speed`` m/s. The
    height, 2.5 cm, is that of Zhang et al. 2018 (mode-adaptive networks, section on foot skating); the speed
    is ours: a swinging foot passes the ground this closely too, but at 2 to 5 m/s.

    positions: ``(..., T, J, 3)`` metres, T >= 2. feet: F nodes (``foot_joints``). standing: ``(..., F)``
    metres, by default ``standing_heights`` of the same positions; give those of real clips where a motion may hover.
    """
    return _feet(positions, feet, fps, standing, height, speed)[0]


def _feet(positions, feet, fps, standing, height, speed) -> tuple[torch.Tensor, torch.Tensor]:
    """Contacts ``(..., T - 1, F)`` and the ground speed ``(..., T - 1, F)`` in m/s."""
    if positions.ndim < 3 or positions.shape[-3] < 2:
        raise TutorialError(f"positions of shape {tuple(positions.shape)}: expected (..., T, J, 3) with T >= 2")
    feet = [int(f) for f in feet]
    if standing is None:
        standing = standing_heights(positions, feet)
    foot = positions[..., feet, :]
    above = foot[..., 1] - torch.as_tensor(standing, dtype=foot.dtype, device=foot.device)[..., None, :]
    low = (above[..., 1:, :] < height) & (above[..., :-1, :] < height)
    ground_speed = (foot[..., 1:, :, ::2] - foot[..., :-1, :, ::2]).norm(dim=-1) * fps
    return low & (ground_speed < speed), ground_speed


@numpy_or_torch
def foot_skate(
    positions: Array,
    feet: Sequence[int],
    fps: float,
    standing: Array | None = None,
    height: float = 0.025,
    speed: float = 1.0,
) -> Array:
    """How fast feet that stand slide: centimetres per second, averaged over all contacts; shape ``(...)``.

    ``mean of |horizontal velocity| over the foot nodes and steps in contact`` (``foot_contacts`` has the rule
    and the arguments). Zero where nothing touches the ground, NaN where feet are not at finite places. Real clips
    do not give zero, feet roll and markers tremble: compare with the real clips' own.
    """
    contact, ground_speed = _feet(positions, feet, fps, standing, height, speed)
    total = torch.where(contact, ground_speed, torch.zeros_like(ground_speed)).sum((-2, -1))
    skate = 100.0 * total / contact.sum((-2, -1)).clamp(min=1)
    return _where_feet_are(positions, feet, skate)  # not 0, as if no foot slid


@numpy_or_torch
def foot_slide(
    positions: Array,
    feet: Sequence[int],
    fps: float,
    standing: Array | None = None,
    height: float = 0.025,
    speed: float = 1.0,
    shortest: float = 0.1,
) -> Array:
    """How far a foot node slides along the ground in one step: centimetres, mean over all steps; shape ``(...)``.

    A step is a stretch of contact (``foot_contacts`` has the rule and the arguments) of ``shortest`` seconds or more,
    and the slide the length of the node's way along the ground in it. As Zhang et al. 2018 (mode-adaptive networks)
    have it, a movement counts the less the higher the node is, by ``2 - 2^(h / height)``: all of it on the ground,
    nothing ``height`` above it, for a foot that rolls off slides little. NaN where nothing touches the ground, or feet
    are not at finite places. Real clips do not give zero: compare with the real clips' own.
    """
    feet = [int(f) for f in feet]
    if standing is None:
        standing = standing_heights(positions, feet)
    contact, ground_speed = _feet(positions, feet, fps, standing, height, speed)  # (..., T - 1, F)
    above = positions[..., feet, 1] - torch.as_tensor(standing, dtype=positions.dtype)[..., None, :]
    above = ((above[..., 1:, :] + above[..., :-1, :]) / 2).clamp(0, height)
    way = torch.where(contact, (2 - 2 ** (above / height)) * ground_speed / fps, torch.zeros_like(ground_speed))
    each = contact.movedim(-1, 0)  # (F, ..., T - 1)
    long = torch.stack([_long_runs(c, shortest * fps) for c in each.reshape(-1, each.shape[-1])])
    long = long.reshape(each.shape).movedim(0, -1)
    begins = long & ~torch.cat((torch.zeros_like(long[..., :1, :]), long[..., :-1, :]), -2)
    steps = begins.sum((-2, -1))
    slide = 100.0 * (way * long).sum((-2, -1)) / torch.where(steps > 0, steps.to(way.dtype), float("nan"))
    return _where_feet_are(positions, feet, slide)  # not that of the steps beside the gap


def _where_feet_are(positions: torch.Tensor, feet: Sequence[int], measure: torch.Tensor) -> torch.Tensor:
    """``measure`` ``(...)``, NaN where the feet of a motion ``(..., T, J, 3)`` are not at finite places throughout."""
    finite = torch.isfinite(positions[..., [int(f) for f in feet], :]).flatten(-3).all(-1)
    return torch.where(finite, measure, torch.full_like(measure, float("nan")))


def _long_runs(held: torch.Tensor, least: float) -> torch.Tensor:
    """Booleans ``(T,)`` with only those runs of True that have ``least`` steps or more."""
    values, counts = torch.unique_consecutive(held, return_counts=True)
    return (values & (counts >= least)).repeat_interleave(counts)


@numpy_or_torch
def bone_lengths(positions: Array, skeleton: Skeleton) -> Array:
    """``(..., T, J, 3)`` positions to the length of each bone, ``(..., T, J - 1)`` metres, as
    ``skeleton.bones``."""
    parents, children = skeleton.bones[:, 0].tolist(), skeleton.bones[:, 1].tolist()
    return _each_sequence(lambda x: (x[:, children] - x[:, parents]).norm(dim=-1), positions, 3)


@numpy_or_torch
def bone_length_drift(positions: Array, skeleton: Skeleton, reference: str = "skeleton", reduce: str = "mean") -> Array:
    """How much bones have changed their length, frame by frame: ``(..., T)``, relative (0.1 is a tenth).

    ``drift_t = mean (or max) over bones of | |bone|_t - l | / l``, where l is the bone's length in the
    skeleton (``reference="skeleton"``) or in the motion's first frame (``"first"``). Bones of no length are left out.

    positions: ``(..., T, J, 3)`` metres.
    Raises ``TutorialError`` for another reference or reduction, or where no bone has a length.
    """
    if reference not in ("skeleton", "first") or reduce not in ("mean", "max"):
        raise TutorialError(f"bone drift by {reduce!r} against {reference!r}: expected mean or max, skeleton or first")

    def drift(x: torch.Tensor) -> torch.Tensor:
        lengths = bone_lengths(x, skeleton)
        wanted = lengths.new_tensor(skeleton.bone_lengths) if reference == "skeleton" else lengths[0]
        real = wanted > 1e-6
        if not real.any():
            if wanted.isnan().any():  # a first frame that is not finite
                return lengths.new_full((len(lengths),), float("nan"))
            where = "skeleton" if reference == "skeleton" else "motion's first frame"
            raise TutorialError(f"bone drift: none of {len(wanted)} bones has a length in the {where}, expected one")
        relative = (lengths[:, real] - wanted[real]).abs() / wanted[real]
        return relative.mean(-1) if reduce == "mean" else relative.amax(-1)

    return _each_sequence(drift, positions, 3)
