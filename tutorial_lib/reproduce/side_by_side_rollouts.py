"""One beginning for every system: what each makes of it, as joint positions in the world.

The systems speak different languages, some of the root's steps and some of a body that turns. Here all of them are
translated into the one that all can be translated to, places of joints in metres, each motion standing where its
beginning stands.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..data.windows import evaluation_places
from ..errors import DataError, MotionError
from ..generate import generate_features, prepare, representation_of
from ..generate_control import generate_control_features
from ..motion.clip import Motion
from ..motion.join import playlist
from ..representations import Representation, make_representation
from ..training.checkpoints import Checkpoint
from ..training.systems import SYSTEMS


def follows_control(checkpoint: Checkpoint) -> bool:
    """Whether a network goes where it is told and from no seed: the VAE-LSTM."""
    kind = SYSTEMS[checkpoint.system]
    return not (kind.predicts or kind.futures)


def windows_of(clips: Sequence[Motion], frames: int, count: int, fps: float = 30.0, seed: int = 0) -> list[Motion]:
    """``count`` pieces of ``frames`` frames, spread over the clips as ``evaluation_windows`` spreads them."""
    clips = prepare(clips, fps=fps)
    return [clips[k][first : first + frames] for k, first in evaluation_places(clips, frames, count=count, seed=seed)]


def control_for(windows: Sequence[Motion], clips: Sequence[Motion], frames: int) -> np.ndarray:
    """``(K, frames, 3)`` turning, forward and sideways speed: of each window, then of walking that goes on.

    Clips end after a few seconds, so what follows the window is the control of the clips joined without end, each
    window's from another place.
    """
    hip = make_representation("hip-frame", windows[0].skeleton, windows[0].fps)
    where = hip.slices["control"]
    own = np.stack([hip.encode(window)[:, where] for window in windows])  # (K, W, 3)
    if frames <= own.shape[1]:
        return own[:, :frames]
    lacking = frames - own.shape[1]
    seconds = (lacking + 30 * len(windows)) / hip.fps
    endless = hip.encode(playlist(prepare(clips, fps=hip.fps), seconds=seconds))[1:, where]
    rest = np.stack([np.resize(np.roll(endless, -30 * k, axis=0), (lacking, 3)) for k in range(len(windows))])
    return np.concatenate([own, rest], axis=1)


def go_on(
    checkpoint: Checkpoint,
    starts: Sequence[Motion],
    frames: int,
    *,
    control: np.ndarray | None = None,
    prior: bool = False,
    seed: int = 0,
) -> np.ndarray:
    """What a network makes of some beginnings: ``(K, S + frames, J, 3)`` metres in the world, the S frames first.

    Parameters
    ----------
    starts : K motions of S frames each, at the network's rate, on its joints and of its size
        (:func:`~tutorial_lib.generate.prepare_for`). Each motion stands where its start stands and faces as it does.
    control : for a network that follows one, ``(K, S + frames, 3)`` from the start's first frame on. Its code is drawn
        from the posterior of the start's first four frames, or with ``prior`` from the prior; it goes where it says
        itself. Its S first frames are its own too.
    seed : of all chance.

    Not finite where a network diverges. Raises ``MotionError`` for starts of different lengths, or of another skeleton
    or rate than the network's, and ``DataError`` for a network that follows a control without one.
    """
    if len({len(start) for start in starts}) != 1:
        raise MotionError(f"beginnings of {sorted({len(start) for start in starts})} frames: expected one length")
    representation = representation_of(checkpoint)
    for start in starts:
        representation.check(start)
    if follows_control(checkpoint):
        length = len(starts[0]) + frames
        if control is None or control.shape[:2] != (len(starts), length):
            found = "none" if control is None else f"shape {control.shape}"
            raise DataError(
                f"{checkpoint.system!r} follows a control: expected ({len(starts)}, {length}, 3), not {found}"
            )
        features = generate_control_features(checkpoint, control, start=None if prior else starts, seed=seed)
    else:
        begun = np.stack([representation.encode(start) for start in starts])
        features = np.concatenate([begun, generate_features(checkpoint, begun, frames, seed=seed)], axis=1)
    return placed(representation, features, starts)


def placed(representation: Representation, features: np.ndarray, starts: Sequence[Motion]) -> np.ndarray:
    """Features ``(K, T, D)`` as ``(K, T, J, 3)`` metres, each from where its start is."""
    return np.stack([
        representation.decode_positions(x.astype(np.float64), **representation.origin(start))
        for x, start in zip(features, starts, strict=True)
    ])  # fmt: skip


def motions_of(positions: np.ndarray, start: Motion, names: Sequence[str]) -> list[Motion]:
    """Positions ``(K, T, J, 3)`` as motions to be watched, standing on the ground; cut where they are not finite.

    Raises ``MotionError`` where nothing of one is finite.
    """
    found = []
    for x, name in zip(positions, names, strict=True):
        good = np.isfinite(x).all(axis=(1, 2))
        x = x if good.all() else x[: int(good.argmin())]
        found.append(Motion(start.skeleton, start.fps, x, name=name).settled())
    return found
