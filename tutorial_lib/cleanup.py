"""What still goes wrong with motion made from positions, put right: bones change their length, feet slide, float, sink.

>>> clean = clean_up(motion)

is, one after the other,

1. :func:`rigid`: every bone brought to the skeleton's length, from the root outwards, where it points kept;
2. :func:`grounded`: a ground that drifts, for heights are added up from displacements, brought back to y = 0;
3. :func:`contact_stretches`: when each heel and toe stands on the ground;
4. :func:`planted`: each stretch pinned to one place, and the legs solved again to reach it;
5. 3 and 4 once more: a foot that slid shows only now how long it stands.

The result has rotations, and positions that follow from them by forward kinematics.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from . import metrics
from .chance import is_real
from .errors import MotionError
from .motion.clip import Motion
from .motion.ik import rotations_from_positions
from .motion.rotations import quat_between, quat_inv, quat_mul, quat_rotate
from .motion.skeleton import Skeleton
from .motion.skeletons import common_indices

PASSES = 2  # of finding contacts and planting feet
BLEND = 0.25  # seconds in which a foot comes to its place on the ground and leaves it
SHORTEST = 0.1  # seconds; a shorter touch is no contact, a shorter gap no lift
FARTHEST = 0.25  # metres; a foot that glides farther in one contact is given a new place
ROLL = 0.01  # metres above where it stands, from which on a heel rolls off
SWIVEL = 0.05  # metres; a heel that goes farther about its toe in one contact turns on purpose
LOW = 0.05  # metres above where it stands, below which a foot is not lifted to step on
GROUND_SECONDS = 1.0  # what rises and comes down within it is a jump and no drift
STRETCHED = 0.998  # of a leg's length: the farthest that a knee is straightened beyond what the motion has
_UP = np.array([0.0, 1.0, 0.0])
_SOFT = 0.005  # metres that a foot may sink
_COLLAPSED = 0.5  # of a bone's length; what is shorter in a frame has lost its direction, the more the shorter it is


@dataclasses.dataclass(frozen=True)
class Leg:
    """The four nodes of a leg, each the parent of the next."""

    hip: int
    knee: int
    ankle: int
    toe: int


def legs(skeleton: Skeleton) -> tuple[Leg, Leg]:
    """Left and right leg, by the known skeletons' names.

    Raises ``MotionError`` for an unknown skeleton, or one with nodes between hip, knee, ankle and toe.
    """
    at = common_indices(skeleton)
    both = tuple(Leg(*(at[side + part] for part in ("UpLeg", "Leg", "Foot", "Toe"))) for side in ("Left", "Right"))
    for leg in both:
        nodes = dataclasses.astuple(leg)
        for parent, child in zip(nodes, nodes[1:], strict=False):
            if skeleton.parents[child] != parent:
                raise MotionError(
                    f"clean-up: {skeleton.names[child]!r} hangs from {skeleton.names[skeleton.parents[child]]!r}, "
                    f"expected {skeleton.names[parent]!r}: a leg of hip, knee, ankle and toe"
                )
    return both


def clean_up(motion: Motion, *, level: bool = True, bridge: float = 0.0) -> Motion:
    """``motion`` with rigid bones and planted feet, in the steps that stand at the top of this module.

    level: whether to bring a drifting ground back to y = 0; without, the ground is y = 0 already.
    bridge: seconds, of :func:`contact_stretches`: for a walker, who lifts a foot to step on.
    Returns a motion of the same frames, rate, skeleton and name, with rotations.
    Raises ``MotionError`` for a skeleton whose legs are not known.
    """
    both = legs(motion.skeleton)
    motion = rigid(motion)
    if level:
        motion = grounded(motion)
    feet = [node for leg in both for node in (leg.ankle, leg.toe)]
    for _ in range(PASSES):
        motion = planted(motion, dict(zip(feet, contact_stretches(motion, feet, bridge), strict=True)))
    return motion


# -- bones -------------------------------------------------------------------------------------------------


def rigid(motion: Motion) -> Motion:
    """Every bone as long as the skeleton has it, pointing where it pointed; the root stays where it is.

    Joint by joint from the root outwards (``ik.rotations_from_positions``): bones that leave one joint together, as
    at the hips, are rigid among themselves too, so there the direction is the one that fits all of them best. Twists
    are the motion's own where it has rotations. A bone that shrinks to less than half has no sure direction left; there
    those of the frames about it count as well. A motion whose bones are right already is returned as it is.
    """
    if motion.rotations is not None:
        exact = motion.skeleton.fk(motion.rotations, motion.positions[:, 0])
        if np.abs(exact - motion.positions).max() < 1e-6:
            return motion
    positions = _with_directions(motion)
    rotations = rotations_from_positions(motion.skeleton, positions, motion.rotations)
    return Motion.from_rotations(motion.skeleton, motion.fps, motion.positions[:, 0], rotations, name=motion.name)


def _with_directions(motion: Motion) -> np.ndarray:
    """Positions ``(T, J, 3)`` with every bone as long as the skeleton's, each in its own direction."""
    x, skeleton = motion.positions.copy(), motion.skeleton
    for j, parent in enumerate(skeleton.parents):
        length = float(np.linalg.norm(skeleton.offsets[j]))
        if parent < 0:
            continue
        bone = motion.positions[:, j] - motion.positions[:, parent]
        trust = np.square(np.clip(_norm(bone) / max(_COLLAPSED * length, 1e-9), 0, 1))[:, None]
        ahead = _unit(bone)
        if (trust < 1).any():
            about = ndimage.gaussian_filter1d(trust * ahead, max(1.0, 0.1 * motion.fps), axis=0, mode="nearest")
            ahead = trust * ahead + (1 - trust) * _unit(about)
        x[:, j] = x[:, parent] + length * _unit(ahead)
    return x


# -- ground and contacts -----------------------------------------------------------------------------------


def grounded(motion: Motion, seconds: float = GROUND_SECONDS) -> Motion:
    """Moved up and down, slowly, so that the ground under the feet is at y = 0 throughout.

    The ground is found as in ``Motion.settled``, the lowest node without what rises and comes down again within
    ``seconds``, and then smoothed over as long (a Gaussian), so that no tremble of a foot shakes the whole body.
    """
    if not (is_real(seconds) and 0 <= seconds < np.inf):
        raise MotionError(f"grounded: a ground over {seconds!r} seconds, expected a number of 0 or more")
    size = max(1, round(seconds * motion.fps))
    ground = ndimage.grey_opening(motion.positions[:, :, 1].min(1), size=size | 1, mode="nearest")
    ground = ndimage.gaussian_filter1d(ground, size / 2, mode="nearest")
    return _raised(motion, -ground)


def _raised(motion: Motion, by: np.ndarray) -> Motion:
    return dataclasses.replace(motion, positions=motion.positions + by[:, None, None] * _UP)


def contact_stretches(motion: Motion, nodes: Sequence[int], bridge: float = 0.0) -> list[list[tuple[int, int]]]:
    """When each node stands on the ground: its stretches ``(first frame, last frame)``, in order.

    Hysteresis: a contact begins and ends where the rule of :func:`tutorial_lib.metrics.foot_contacts` holds loosely
    (less than 3 cm above the node's standing height, slower than 1 m/s along the ground), and somewhere inside it
    holds strictly (2 cm, 0.8 m/s). Gaps and touches shorter than ``SHORTEST`` are none. A foot that glides farther
    than ``FARTHEST`` in a touch gets several stretches, with ``BLEND`` seconds between them to move on; these may be
    shorter than ``SHORTEST``, a single frame where it glides fast.

    bridge: seconds; a gap that is no longer, in which the node stays below ``LOW``, and that begins and ends within
    ``FARTHEST``, is no lift either: it glided for a moment, as generated feet do.
    """
    if len(motion) < 2:
        return [[] for _ in nodes]
    nodes, fps, x = list(nodes), motion.fps, motion.positions
    standing = metrics.standing_heights(x, nodes)
    strict = metrics.foot_contacts(x, nodes, fps, standing, height=0.02, speed=0.8)
    loose = metrics.foot_contacts(x, nodes, fps, standing, height=0.03, speed=1.0)  # (T - 1, F) steps
    short, between = max(1, round(SHORTEST * fps)), max(1, round(BLEND * fps))
    found = []
    for k, node in enumerate(nodes):
        held = ndimage.binary_propagation(strict[:, k], mask=loose[:, k])
        stretches = _merged(_runs(held), short)
        if bridge > 0:
            stretches = _bridged(stretches, x[:, node], standing[k] + LOW, bridge * fps)
        stretches = [(a, b + 1) for a, b in stretches if b + 1 - a >= short]  # steps to frames
        along = x[:, node][:, [0, 2]]
        found.append([part for stretch in stretches for part in _split(along, *stretch, between)])
    return found


def _runs(held: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], held.astype(np.int8), [0]))))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def _merged(runs: list[tuple[int, int]], gap: int) -> list[tuple[int, int]]:
    merged: list[tuple[int, int]] = []
    for a, b in runs:
        if merged and a - merged[-1][1] - 1 < gap:
            merged[-1] = (merged[-1][0], b)
        else:
            merged.append((a, b))
    return merged


def _bridged(runs: list[tuple[int, int]], x: np.ndarray, low: float, gap: float) -> list[tuple[int, int]]:
    """Runs of steps, with those made one between which a node at ``x`` ``(T, 3)`` is not lifted."""
    joined: list[tuple[int, int]] = []
    for a, b in runs:
        if joined:
            end = joined[-1][1] + 1  # the frame after the last step
            near = np.linalg.norm((x[a] - x[end])[[0, 2]]) < FARTHEST
            if near and a - end <= gap and x[end : a + 1, 1].max() < low:
                joined[-1] = (joined[-1][0], b)
                continue
        joined.append((a, b))
    return joined


def _split(along: np.ndarray, first: int, last: int, between: int) -> list[tuple[int, int]]:
    """A stretch cut where the foot has gone farther than ``FARTHEST`` from where it began, ``between`` frames apart."""
    parts = []
    while first <= last:
        away = np.linalg.norm(along[first : last + 1] - along[first], axis=1) > FARTHEST
        if not away.any():
            parts.append((first, last))
            break
        end = first + int(away.argmax()) - 1
        parts.append((first, max(first, end - between)))
        first = parts[-1][1] + between + 1
    return parts


# -- feet --------------------------------------------------------------------------------------------------


def planted(motion: Motion, stretches: dict[int, list[tuple[int, int]]]) -> Motion:
    """Feet pinned to the ground where they stand, and the legs solved to reach them.

    stretches: for each ankle and toe of :func:`legs`, from :func:`contact_stretches`. motion: with rotations.

    Throughout a stretch its node stands at the stretch's median place on the ground; up and down the stretch is shifted
    as a whole to the node's standing height, for a heel may roll off. Before and after, the correction fades within
    ``BLEND`` seconds, so that no place jumps; the foot stops and starts as suddenly as a contact begins and ends. The
    foot is moved as a whole, by its toe where that stands, else by its ankle; where both stand and the heel is not yet
    ``ROLL`` above the ground, it is held as it is turned in the median.
    The root is lowered, smoothly and by as little as is needed, where a leg would be too short. Each leg is then
    solved by two-bone inverse kinematics (law of cosines): the knee stays in the plane in which it bends.
    Raises ``MotionError`` for a motion without rotations.
    """
    if motion.rotations is None:
        raise MotionError(f"motion {motion.name!r} has positions alone: its legs are turned, so make it rigid first")
    both, positions = legs(motion.skeleton), motion.positions
    goals = [_foot_goals(motion, leg, stretches) for leg in both]  # of ankle and toe, (T, 3) each
    lower = np.zeros(len(motion))
    limits = []
    for leg, (ankle, _) in zip(both, goals, strict=True):
        hip = positions[:, leg.hip]
        reach = np.maximum(STRETCHED * _leg_length(motion.skeleton, leg), _norm(positions[:, leg.ankle] - hip))
        limits.append(reach)
        along = np.square((ankle - hip)[:, [0, 2]]).sum(1)
        highest = ankle[:, 1] + np.sqrt(np.maximum(np.square(reach) - along, 0.0))  # where the hip may be
        lower = np.minimum(lower, highest - hip[:, 1])
    lower = _smooth_below(lower, max(1, round(BLEND / 2 * motion.fps)))

    world = motion.skeleton.world_rotations(motion.rotations)
    rotations = motion.rotations.copy()
    for leg, goal, reach in zip(both, goals, limits, strict=True):
        _solve_leg(motion.skeleton, leg, positions, world, goal, reach, lower, rotations)
    root = positions[:, 0] + lower[:, None] * _UP
    return Motion.from_rotations(motion.skeleton, motion.fps, root, rotations, name=motion.name)


def _foot_goals(motion: Motion, leg: Leg, stretches: dict[int, list[tuple[int, int]]]) -> tuple[np.ndarray, np.ndarray]:
    """Where ankle and toe shall be, ``(T, 3)`` each, as far from each other as they are.

    The toe goes where its own contact says, or else along with the ankle. As long as both stand, and until the heel
    rolls off, the foot is one solid thing; but not of who turns on the ball of a foot.
    """
    ankle, toe = motion.positions[:, leg.ankle], motion.positions[:, leg.toe]
    ankle_stands, toe_stands = metrics.standing_heights(motion.positions, [leg.ankle, leg.toe])
    by_ankle, _ = _pull(ankle, stretches[leg.ankle], motion.fps, ankle_stands)
    by_toe, held = _pull(toe, stretches[leg.toe], motion.fps, toe_stands)
    heel, low = ankle - toe, ankle[:, 1] < ankle_stands + ROLL
    flat = _on(stretches[leg.ankle], len(motion)) & _on(stretches[leg.toe], len(motion)) & low
    solid = [part for part in _runs(flat) if _turned(heel, *part) < SWIVEL]
    by_heel, _ = _pull(heel, solid, motion.fps)
    new_toe = toe + by_toe + (1 - held) * by_ankle
    new_ankle = new_toe + _norm(heel)[:, None] * _unit(heel + by_heel)
    lift = np.maximum(_sunk(new_ankle[:, 1]), _sunk(new_toe[:, 1]))[:, None] * _UP
    return new_ankle + lift, new_toe + lift


def _on(stretches: list[tuple[int, int]], frames: int) -> np.ndarray:
    """Which frames are in one of them: booleans ``(T,)``."""
    on = np.zeros(frames, bool)
    for first, last in stretches:
        on[first : last + 1] = True
    return on


def _turned(heel: np.ndarray, first: int, last: int) -> float:
    """How far a heel goes about the toe, ``(T, 3)`` from it: metres along the ground, from its median place."""
    along = heel[first : last + 1, [0, 2]]
    return float(_norm(along - np.median(along, axis=0)).max())


def _pull(
    x: np.ndarray, stretches: list[tuple[int, int]], fps: float, height: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """What a node at ``x`` ``(T, 3)`` must be moved by ``(T, 3)`` to stand still in each stretch, at its median place,
    and how firmly it is held ``(T, 1)``, 1 in contact and 0 far from it.

    height: of a node that stands. A heel rolls off while it hardly moves along: up and down it is then shifted as a
    whole, not held flat.
    """
    pull, held = np.zeros_like(x), np.zeros((len(x), 1))
    blend = max(1, round(BLEND * fps))
    for k, (first, last) in enumerate(stretches):
        inside = slice(first, last + 1)
        pull[inside] = np.median(x[inside], axis=0) - x[inside]
        if height is not None:
            pull[inside, 1] = height - np.quantile(x[inside, 1], 0.25)
        held[inside] = 1.0
        # between two contacts near each other the one's correction ends before the other begins
        before = blend if k == 0 else min(blend, first - stretches[k - 1][1])
        after = blend if k == len(stretches) - 1 else min(blend, stretches[k + 1][0] - last)
        for edge, way, frames in ((first, -1, before), (last, 1, after)):
            at = edge + way * np.arange(1, frames)
            at = at[(at >= 0) & (at < len(x))]
            if len(at):
                t = np.abs(at - edge)[:, None] / frames
                pull[at] += _fading(t) * pull[edge]
                held[at] = np.maximum(held[at], _fading(t))
    return pull, held


def _fading(t: np.ndarray) -> np.ndarray:
    """From 1 at t = 0 to 0 at t = 1, level at both ends."""
    return (1 - t) ** 2 * (1 + 2 * t)


def _sunk(height: np.ndarray) -> np.ndarray:
    """What lifts a node that sinks: nothing above the ground; below it, without a kink, all but ``_SOFT``."""
    return np.where(height < -2 * _SOFT, -height - _SOFT, np.square(np.minimum(height, 0.0)) / (4 * _SOFT))


def _smooth_below(curve: np.ndarray, frames: int) -> np.ndarray:
    """A smooth curve that lies nowhere above the one given: the least of ``frames`` to both sides, then their mean."""
    least = ndimage.minimum_filter1d(curve, 2 * frames + 1, mode="nearest")
    hann = np.hanning(2 * frames + 3)[1:-1]
    return ndimage.convolve1d(least, hann / hann.sum(), mode="nearest")


# -- legs --------------------------------------------------------------------------------------------------


def _leg_length(skeleton: Skeleton, leg: Leg) -> float:
    return float(np.linalg.norm(skeleton.offsets[[leg.knee, leg.ankle]], axis=1).sum())


def _solve_leg(skeleton, leg, positions, world, goal, reach, lower, rotations) -> None:
    """Write the leg's local rotations into ``rotations`` so that ankle and toe come to their ``goal``."""
    hip = positions[:, leg.hip]
    thigh, shin = positions[:, leg.knee] - hip, positions[:, leg.ankle] - positions[:, leg.knee]
    axis = bending_axis(thigh, shin, world[:, leg.hip])
    new_hip = hip + lower[:, None] * _UP
    ankle, toe = goal
    knee, ankle = two_bone(new_hip, ankle, thigh, shin, axis, reach)
    # the whole leg swings from where it pointed to where it points, then each bone turns to its own place
    swing = quat_between(thigh + shin, ankle - new_hip)
    upper = _aimed(quat_mul(swing, world[:, leg.hip]), quat_rotate(swing, thigh), knee - new_hip)
    under = _aimed(quat_mul(swing, world[:, leg.knee]), quat_rotate(swing, shin), ankle - knee)
    foot = _aimed(world[:, leg.ankle], positions[:, leg.toe] - positions[:, leg.ankle], toe - ankle)
    above = skeleton.parents[leg.hip]
    if above < 0:
        rotations[:, leg.hip] = upper
    else:
        rotations[:, leg.hip] = quat_mul(quat_inv(world[:, above]), upper)
    rotations[:, leg.knee] = quat_mul(quat_inv(upper), under)
    rotations[:, leg.ankle] = quat_mul(quat_inv(under), foot)


def _aimed(rotation: np.ndarray, ahead: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return quat_mul(quat_between(ahead, wanted), rotation)


def bending_axis(thigh: np.ndarray, shin: np.ndarray, world: np.ndarray) -> np.ndarray:
    """The axis about which a knee usually bends, ``(T, 3)`` unit vectors in the world, fixed to the thigh.

    thigh, shin: the bones, ``(T, 3)``; ``thigh x shin`` is as long as the knee is bent, so the mean over the motion is
    told by the frames that show it. world: the thigh's rotations in the world, ``(T, 4)``. A leg that is never bent
    is taken to bend about the thigh's own x axis.
    """
    usual = quat_rotate(quat_inv(world), np.cross(_unit(thigh), _unit(shin))).sum(0)
    usual = usual / np.linalg.norm(usual) if np.linalg.norm(usual) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return quat_rotate(world, usual)


def two_bone(
    hip: np.ndarray, ankle: np.ndarray, thigh: np.ndarray, shin: np.ndarray, axis: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    r"""Knee and ankle ``(T, 3)`` of a leg with its ankle at ``ankle``, or as near to it as the leg reaches.

    With the law of cosines: with d from hip to ankle, and n at right angles to it, the knee is
    :math:`l_1 (\cos\alpha\, d + \sin\alpha\, n)` from the hip, where

    .. math:: \cos\alpha = \frac{l_1^2 + |d|^2 - l_2^2}{2\, l_1 |d|}

    n is where the knee was, swung with the leg; a knee that must bend more than it did bends on about ``axis``, so
    that a straight leg, or one that a network has bent a little backwards, bends forwards.

    hip, ankle: where they shall be, ``(T, 3)`` metres. thigh, shin: the bones as they were, ``(T, 3)``. axis:
    :func:`bending_axis`. reach: the farthest that the ankle may be from the hip, ``(T,)``.
    """
    upper, lower, there = _norm(thigh), _norm(shin), ankle - hip
    far = _norm(there)
    near = np.abs(upper - lower) + 1e-6
    length = np.clip(far, near, np.maximum(np.minimum(reach, upper + lower), near))
    ahead = _unit(thigh + shin)
    d = np.where(far[:, None] > 1e-9, there / np.maximum(far, 1e-9)[:, None], ahead)
    cos = np.clip((upper**2 + length**2 - lower**2) / (2 * upper * length), -1, 1)
    sin = np.sqrt(1 - cos**2)
    swing = quat_between(ahead, d)
    was = _unit(thigh) - (_unit(thigh) * ahead).sum(1, keepdims=True) * ahead  # as long as the sine was
    was, usual = quat_rotate(swing, was), _unit(np.cross(d, quat_rotate(swing, axis)))
    n = _unit(was + np.maximum(sin - _norm(was), 1e-9)[:, None] * usual)
    return hip + upper[:, None] * (cos[:, None] * d + sin[:, None] * n), hip + length[:, None] * d


def _norm(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x, axis=-1)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(_norm(x), 1e-12)[..., None]
