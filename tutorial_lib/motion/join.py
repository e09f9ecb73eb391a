"""Clips one after another, without a seam: a recording that never ends.

A network that has learnt where every clip ends, and nothing after it, has learnt where to stop. Joined clips always
go on. As in a motion graph (Kovar, Gleicher and Pighin, "Motion graphs", 2002), one clip is left and the next
entered where their poses are most alike, and the two are blended over a moment.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from ..chance import is_real, whole_seed
from ..errors import MotionError
from .clip import Motion, same_rate, some_names
from .rotations import quat_slerp

SEARCH = 1.5  # seconds at the end of one clip, and at the beginning of the next, in which the best place is looked for
SEARCH_FPS = 30.0  # at which places are compared


def join(motions: Sequence[Motion], *, blend: float = 0.3, search: float = SEARCH, name: str = "") -> Motion:
    """All motions as one, each turned and moved so that it begins where the one before it is left.

    Parameters
    ----------
    motions : clips of one skeleton and one frame rate.
    blend : seconds over which two clips overlap and are blended: rotations along the arc, so that bones keep their
        length, or positions along the line where a clip has no rotations.
    search : seconds at an end and at a beginning among which the two places most alike are found; no more than a
        third of a clip. What lies beyond them, often somebody standing still, is left out.

    Returns a motion at the same frame rate. Raises ``MotionError`` for no clips, clips of different skeletons or
    rates, or clips shorter than three blends.
    """
    _check_blend("join", blend)
    if not (is_real(search) and search >= 0):
        raise MotionError(f"join: a search of {search!r} seconds, expected a number of 0 or more")
    if not motions:
        raise MotionError("join: no clips, expected at least one")
    first = motions[0]
    size = max(2, round(blend * first.fps))
    for motion in motions:
        if not motion.skeleton.same_tree(first.skeleton):
            raise MotionError(f"join: {motion.name!r} has another skeleton than {first.name!r}")
        if not same_rate(motion.fps, first.fps):
            raise MotionError(f"join: {motion.name!r} has {motion.fps:g} frames a second, {first.name!r} {first.fps:g}")
        if len(motion) < 3 * size:
            raise MotionError(
                f"join: {motion.name!r} has {len(motion)} frames, expected {3 * size} to blend over {size} at both ends"
            )
    turned = all(motion.rotations is not None for motion in motions)
    positions, rotations = [], []
    current, start = first, 0  # what was entered last, in its place in the world, and its first frame not used yet
    for following in motions[1:]:
        leave, enter, angle = _best_place(current, following, size, search, start)
        following = following.rotate_y(angle)
        way = current.positions[leave, 0] - following.positions[enter, 0]
        following = following.translate((way[0], 0.0, way[2]))
        blended = _blended(current[leave : leave + size], following[enter : enter + size], turned)
        for part in (current[start:leave] if leave > start else None, blended):
            if part is not None:
                positions.append(part.positions)
                rotations.append(part.rotations)
        current, start = following, enter + size
    positions.append(current.positions[start:])
    rotations.append(None if current.rotations is None else current.rotations[start:])
    return Motion(
        first.skeleton, first.fps, np.concatenate(positions), np.concatenate(rotations) if turned else None, name
    )


def _best_place(one: Motion, other: Motion, size: int, search: float, start: int) -> tuple[int, int, float]:
    """Frame to leave ``one`` at, frame to enter ``other`` at, and by how much to turn ``other``.

    Compared are the ``size`` frames that will be blended, poses about the root, turned about the vertical as fits
    best: with horizontal parts as complex numbers, ``min over turns |w - x|^2 =
    |w|^2 + |x|^2 - 2 (w_y x_y + |sum of w_xz conj(x_xz)|)``.
    """
    step = max(1, round(one.fps / SEARCH_FPS))
    at = np.arange(0, size, step)  # frames within the blend that are compared
    last = len(one) - size
    leaves = np.arange(max(start, last - round(min(search, one.duration / 3) * one.fps)), last + 1, step)
    enters = np.arange(0, min(round(min(search, other.duration / 3) * one.fps), len(other) - 2 * size) + 1, step)

    def windows(motion: Motion, firsts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = (motion.positions - motion.positions[:, :1])[firsts[:, None] + at]  # (N, S, J, 3)
        flat = poses.reshape(len(firsts), -1, 3)
        return flat[..., 0] + 1j * flat[..., 2], flat[..., 1]

    (w, w_up), (x, x_up) = windows(one, leaves), windows(other, enters)
    shared = w @ x.conj().T  # (leaves, enters)
    square = (np.abs(w) ** 2 + w_up**2).sum(1)[:, None] + (np.abs(x) ** 2 + x_up**2).sum(1)
    distance = square - 2 * (np.abs(shared) + w_up @ x_up.T)
    i, j = np.unravel_index(distance.argmin(), distance.shape)
    # x + iz turns the other way about the vertical than an angle counts
    return int(leaves[i]), int(enters[j]), float(-np.angle(shared[i, j]))


def _blended(one: Motion, other: Motion, turned: bool) -> Motion:
    """From the first to the second over their length, slow at both ends."""
    t = (np.arange(len(one)) + 0.5) / len(one)
    t = (t * t * (3 - 2 * t))[:, None, None]
    if not turned:
        return Motion(one.skeleton, one.fps, (1 - t) * one.positions + t * other.positions)
    rotations = quat_slerp(one.rotations, other.rotations, t)
    local = (1 - t) * one.translations() + t * other.translations()
    return Motion(one.skeleton, one.fps, one.skeleton.fk(rotations, local[:, 0], local), rotations)


def playlist(motions: Sequence[Motion], *, seconds: float, blend: float = 0.3, seed: int = 0) -> Motion:
    """The clips joined in random order, over and over: so many seconds of clips or more, and each at least once.

    The seconds are the clips' own, before :func:`join` cuts them where they meet: what comes is shorter, by a blend and
    at most twice ``SEARCH`` at every join, of clips of three seconds by a third.
    Each round is another order, so that a clip is followed by different ones; never by itself where there are others.
    Clips shorter than three blends are left out with one warning; ``MotionError`` if none is left, and for seconds that
    are not a number above 0.
    """
    _check_blend("playlist", blend)
    if not (is_real(seconds) and 0 < seconds < np.inf):
        raise MotionError(f"playlist of {seconds!r} seconds: expected a number above 0")
    usable, too_short = [], []
    for motion in motions:
        (usable if len(motion) >= 3 * max(2, round(blend * motion.fps)) else too_short).append(motion)
    if not usable:
        raise MotionError(f"playlist: none of {len(motions)} clips is as long as three blends of {blend:g} s")
    if too_short:
        warnings.warn(
            f"{len(too_short)} of {len(motions)} clips left out, too short for three blends of {blend:g} s: "
            f"{some_names(too_short)}",
            stacklevel=2,
        )
    rng, order, total = np.random.default_rng(whole_seed(seed)), [], 0.0
    while not order or total < seconds:
        turn = rng.permutation(len(usable)).tolist()
        if order and turn[0] == order[-1] and len(turn) > 1:
            turn.append(turn.pop(0))
        order += turn
        total += sum(usable[k].duration for k in turn)
    return join([usable[k] for k in order], blend=blend, name="playlist")


def _check_blend(where: str, blend: float) -> None:
    if not (is_real(blend) and 0 <= blend < np.inf):
        raise MotionError(f"{where}: a blend of {blend!r} seconds, expected a number of 0 or more")
