"""How far generated clips are from true ones: the pose alone, the motion in the world, and samples from each other.

These are the measures of the VAE-LSTM paper (Habibie et al. 2017, section 4.3, tables 1 and 2, figure 4). A clip is
compared from its first frame on, the frames that a network was shown included, so that models that are shown 60
frames, 4 or none can stand in one table.

The paper speaks of the mean squared error and prints no unit. Here an error is the mean distance of the joints, in
metres, or with ``squared`` their mean squared distance, in square metres: ratios of the one are about the square
of those of the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from .data.windows import evaluation_windows
from .errors import DataError, MotionError, TutorialError
from .generate import generate_features, prepare_for
from .metrics import standard_error
from .motion.clip import Motion
from .motion.rotations import Array, numpy_or_torch
from .representations import Representation
from .training.checkpoints import Checkpoint

PAPER_FRAMES = (70, 90, 120, 160, 210)  # tables 1 and 2, of clips of 240 frames
PAPER_FPS = 60.0
CLIP_FRAMES = 120  # the paper's 4 s at 30 frames a second


# --- between arrays -------------------------------------------------------------------------------


@numpy_or_torch
def joint_error(made: Array, truth: Array, squared: bool = False) -> Array:
    """The distance of joints, averaged over them: positions ``(..., T, J, 3)`` to ``(..., T)`` metres.

    ``e_t = mean over j of |made_tj - truth_tj|``, or of its square. Raises ``TutorialError`` where the shapes differ.
    """
    if made.shape != truth.shape or made.ndim < 3 or made.shape[-1] != 3:
        raise TutorialError(
            f"made positions of shape {tuple(made.shape)}, true ones of {tuple(truth.shape)}: expected "
            "(..., T, J, 3) both"
        )
    square = (made - truth).square().sum(-1)
    return (square if squared else square.sqrt()).mean(-1)


@numpy_or_torch
def pose_errors(representation: Representation, made: Array, truth: Array, squared: bool = False) -> Array:
    """How far poses are from the true ones "relative to the root of the character, ignoring both translation and
    rotation" (section 4.3; table 2, figure 4).

    made, truth: features ``(..., T, D)``, not normalised, of a representation that has its joints in the body's own
    frame, ``"hip-frame"`` or ``"body-frame"``. The frame is the representation's, on the ground below the hip: a
    wrong height is an error.
    Returns ``(..., T)``, see :func:`joint_error`. Raises ``MotionError`` for another representation or width.
    """
    return joint_error(*(_positions(representation, x, moving=False) for x in (made, truth)), squared)


@numpy_or_torch
def motion_errors(representation: Representation, made: Array, truth: Array, squared: bool = False) -> Array:
    """How far joints are from the true ones in the world, "taking into account" translation and rotation (table 1).

    Turning speed and velocities are added up from the first frame on, where both stand on one spot and face the same
    way. Arguments, result and errors are those of :func:`pose_errors`.
    """
    return joint_error(*(_positions(representation, x, moving=True) for x in (made, truth)), squared)


def _positions(representation: Representation, features: torch.Tensor, moving: bool) -> torch.Tensor:
    """Joints ``(..., T, J, 3)``, in the world or, not moving, in the body's frame."""
    if "control" not in representation.slices:
        raise MotionError(
            f"pose and motion errors are told apart by the control channels, and representation "
            f"{representation.name!r} has {', '.join(representation.slices)}: expected 'hip-frame' or 'body-frame'"
        )
    features = features.double().clone()
    if not moving and features.shape[-1] == representation.dim:
        features[..., representation.slices["control"]] = 0.0
    return representation.decode_positions(features)


def frames_in_clip(fps: float, frames: Sequence[int] = PAPER_FRAMES, frames_fps: float = PAPER_FPS) -> list[int]:
    """The numbers, from 1, of the frames of a clip that are at the times of ``frames`` of a clip at ``frames_fps``.

    The paper's frames 70, 90, 120, 160, 210 at 60 frames a second are 35, 45, 60, 80, 105 at 30. Frame 60 is the last
    of its 60 initial ones.
    """
    if not (fps > 0 and math.isfinite(fps)):
        raise TutorialError(f"{fps} frames per second, expected a number above zero")
    return [max(1, int(frame * fps / frames_fps + 0.5)) for frame in frames]


def at_paper_frames(errors: np.ndarray, fps: float, frames: Sequence[int] = PAPER_FRAMES) -> dict[int, tuple]:
    """Errors ``(K, T)`` of K clips at the paper's frames: {frame at 60 Hz: (mean, its standard error over clips)}.

    Raises ``TutorialError`` where the clips end before the last of the frames.
    """
    errors = np.asarray(errors, dtype=np.float64)
    at = frames_in_clip(fps, frames)
    if errors.ndim != 2 or errors.shape[1] < max(at):
        raise TutorialError(
            f"errors of shape {errors.shape}: expected (clips, frames) with {max(at)} frames or more, "
            f"which are frame {max(frames)} at {PAPER_FPS:g} per second"
        )
    chosen = errors[:, [k - 1 for k in at]]
    return {
        frame: (float(mean), float(error))
        for frame, mean, error in zip(frames, chosen.mean(0), standard_error(chosen), strict=True)
    }


@numpy_or_torch
def sample_diversity(positions: Array) -> Array:
    """How different samples are: the mean over all pairs of :func:`joint_error`, in metres, at each frame.

    positions: ``(S, T, J, 3)``, S samples of one situation such as one path. Returns ``(T,)``, zero where all are
    equal. Raises ``TutorialError`` for fewer than two samples.
    """
    if positions.ndim != 4 or positions.shape[-1] != 3 or len(positions) < 2:
        raise TutorialError(f"samples of shape {tuple(positions.shape)}: expected (S, T, J, 3) with S of at least 2")
    total = sum(
        joint_error(positions[k].expand_as(positions[:k]), positions[:k]).sum(0) for k in range(1, len(positions))
    )
    return total / (len(positions) * (len(positions) - 1) / 2)


# --- of a checkpoint that predicts frames ---------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ClipRollouts:
    """Clips that a network has made from their first frames, and the true ones; features, not normalised."""

    representation: Representation
    made: np.ndarray  # (K, T, D), the first seed_frames of each being the true ones
    truth: np.ndarray  # (K, T, D)
    seed_frames: int

    def pose_errors(self, squared: bool = False) -> np.ndarray:
        """(K, T), see :func:`pose_errors`."""
        return pose_errors(self.representation, self.made, self.truth, squared)

    def motion_errors(self, squared: bool = False) -> np.ndarray:
        """(K, T), see :func:`motion_errors`."""
        return motion_errors(self.representation, self.made, self.truth, squared)


def roll_out_clips(
    checkpoint: Checkpoint,
    motions: Sequence[Motion],
    *,
    seed_frames: int = 4,
    frames: int = CLIP_FRAMES,
    given: Sequence[str] = (),
    count: int = 20,
    seed: int = 0,
    progress: bool = False,
) -> ClipRollouts:
    """What a network that predicts the next frame makes of ``count`` clips of which it sees the beginning.

    Parameters
    ----------
    motions : clips to take them from, best ones never trained on; brought to the checkpoint's frame rate and size.
        They are spread over the clips as :func:`tutorial_lib.data.windows.evaluation_windows` says.
    seed_frames : that it is shown. In the paper 60 at 60 frames a second (30 at 30) where it predicts the control
        itself, table 1, and 4 where that is given, table 2.
    given : parts of each frame after these that are the true ones, ``("control",)``; nothing: it predicts all.
    count, seed : how many, and the number that chooses them and what a network draws.

    Raises :class:`DataError` if the clips are too short, and as
    :func:`tutorial_lib.generate.generate_features` does.
    """
    if not 1 <= seed_frames < frames:
        raise DataError(f"clips of {frames} frames of which {seed_frames} are shown: expected at least 1 and not all")
    prepared = prepare_for(checkpoint, motions)
    representation = checkpoint.representation
    start, rest = (
        part.numpy()
        for part in evaluation_windows(
            prepared,
            representation,
            seed_frames=seed_frames,
            future_frames=frames - seed_frames,
            count=count,
            seed=seed,
        )
    )
    if lacking := [part for part in given if part not in representation.slices]:
        raise MotionError(
            f"representation {representation.name!r} has no part {lacking[0]!r} to be given: expected one of "
            f"{', '.join(representation.slices)}"
        )
    true = {part: rest[..., representation.slices[part]] for part in given}
    made = generate_features(checkpoint, start, rest.shape[1], given=true, seed=seed, progress=progress)
    return ClipRollouts(representation, np.concatenate([start, made], 1), np.concatenate([start, rest], 1), seed_frames)
