"""Control from a path along the ground: how somebody goes along it who has legs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..chance import is_real, numbers_of
from ..errors import MotionError
from ..motion.ground import GroundPath, braked, check_path, path_length
from ..representations import measure_control
from .signals import LIMITS, LONGEST_TIME, Limits, check_fps, tell

_TOLD = 0.9  # a speed that falls below this share of the one asked for is told
_SPOT = 1e-4  # m; a curve that turns within less than this is turned on the spot


@dataclass(frozen=True, eq=False)
class PathControl:
    """What :func:`path_control` makes of a path.

    control: ``(T, 3)``; with ``start`` (x, z) in metres and ``heading`` in radians, :func:`integrate_control` and
    ``HipFrame.decode`` bring it back to the path. place ``(T, 2)`` and angle ``(T,)``: where the body is asked to be
    and to face at each frame. path: ``(N, 2)`` the points as given. note: what was limited and where, empty if nothing.
    """

    control: np.ndarray
    fps: float
    start: tuple[float, float]
    heading: float
    place: np.ndarray = field(repr=False)
    angle: np.ndarray = field(repr=False)
    path: np.ndarray = field(repr=False)
    note: str = ""


def path_control(
    points: Sequence,
    pace: float | Sequence[float] = 1.3,
    fps: float = 30.0,
    *,
    rounding: float | None = None,
    rest: bool = False,
    limits: Limits = LIMITS,
) -> PathControl:
    """The control of somebody who walks a path, facing along it.

    points: ``(N, 2)`` x and z in metres, drawn or computed. They are resampled every 2 cm and blurred by a Gaussian of
        ``rounding`` metres along the path (None: 0.2 + 0.1 s times the pace: the faster, the rounder, and a line drawn
        by hand shakes). A path that ends where it began, and as it began, is round there, too; it is walked once.
    pace: m/s, a number or one a point, in between them by distance.
    fps: frames per second of the control.
    rest: start and end standing; otherwise the first and last frame are in full motion.
    limits: of speed, turning, force to the side and acceleration. In turns the pace falls as they ask; where it falls
        by more than a tenth one warning (also ``.note``) names the worst place, what was asked and what is given. A
        pace that nobody can go (60 m/s) is limited so as well.
    Raises ``MotionError`` for no path (fewer than two points, all on one spot, not finite, of another shape, longer
    than 10 km), a pace not above zero or not one a point, and what would last for more than an hour.
    """
    planned = _planned(points, pace, fps, rounding, rest, limits)
    tell(planned.note)
    return planned


def control_from_path(
    points: Sequence,
    pace: float | Sequence[float] = 1.3,
    fps: float = 30.0,
    *,
    rounding: float | None = None,
    rest: bool = False,
    limits: Limits = LIMITS,
) -> np.ndarray:
    """The control ``(T, 3)`` alone of :func:`path_control`, which says what the arguments are."""
    planned = _planned(points, pace, fps, rounding, rest, limits)
    tell(planned.note)
    return planned.control


def _planned(points, pace, fps, rounding, rest, limits) -> PathControl:
    points, fps = check_path(points), check_fps(fps)
    pace = _checked_pace(pace, len(points))
    rounding = 0.2 + 0.1 * min(float(np.mean(pace)), limits.speed) if rounding is None else rounding
    if not (is_real(rounding) and 0 <= rounding <= 10):
        raise MotionError(f"path: rounding {rounding!r}, expected metres from 0 to 10")
    curve = GroundPath(points, float(rounding), closed=_goes_on(points))
    s, place, angle = curve.samples
    if curve.length < 1e-6:
        raise MotionError(f"path of {len(points)} points: rounded by {rounding:g} m nothing is left of it")

    # how fast: as asked for, or as a person turns, speeds up and slows down
    step, turn = np.diff(s), np.abs(np.diff(angle))
    bend = turn / np.maximum(step, _SPOT)  # rad/m between samples
    bend = np.maximum(np.append(bend, 0), np.append(0, bend))  # at a sample: the sharper of its two sides
    with np.errstate(divide="ignore"):
        reasons = np.stack([
            np.full(len(s), limits.speed), limits.turning / bend, np.sqrt(limits.sideways / bend)
        ])  # fmt: skip
    given = np.r_[0.0, np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()]  # metres at the points given
    asked = np.interp(s * given[-1] / s[-1], given, pace)
    allowed = np.minimum(asked, reasons.min(0))
    if rest:
        allowed[[0, -1]] = 0.0
    speed = braked(allowed, s, limits.acceleration)

    # when: speed changes evenly between samples; on one spot turning takes the time
    seconds = np.maximum(2 * step / np.maximum(speed[1:] + speed[:-1], 1e-12), turn / limits.turning)
    clock = np.r_[0.0, seconds.cumsum()]
    if clock[-1] > LONGEST_TIME:
        raise MotionError(
            f"path of {s[-1]:.4g} m lasts {clock[-1]:.3g} s at this pace: expected at most {LONGEST_TIME:g} s"
        )
    frames = np.arange(math.floor(clock[-1] * fps + 1e-6) + 1) / fps
    k = np.clip(np.searchsorted(clock, frames, side="right") - 1, 0, len(step) - 1)
    into = np.clip((frames - clock[k]) / np.maximum(seconds[k], 1e-12), 0.0, 1.0)  # share of the time of the piece
    begin, end = speed[k], speed[k + 1]
    mean = begin + end
    way = np.where(mean > 0, into * (2 * begin + (end - begin) * into) / np.where(mean > 0, mean, 1.0), into)
    place = place[k] + way[:, None] * (place[k + 1] - place[k])
    angle = angle[k] + way * (angle[k + 1] - angle[k])
    return PathControl(
        measure_control(place, angle, fps),
        fps,
        (float(place[0, 0]), float(place[0, 1])),
        float(angle[0]),
        place,
        angle,
        points,
        _limited_note(s, asked, reasons, points, given, limits),
    )


def _goes_on(points: np.ndarray) -> bool:
    """Whether a path ends where it began and as it began, within 5 cm and 60 degrees: a circle, not a way back."""
    if path_length(points) < 0.5 or np.linalg.norm(points[-1] - points[0]) >= 0.05:
        return False
    away = [np.linalg.norm(points - points[i], axis=1) > 0.1 for i in (0, -1)]
    first, last = points[away[0].argmax()] - points[0], points[-1] - points[len(points) - 1 - away[1][::-1].argmax()]
    return bool(first @ last > 0.5 * np.linalg.norm(first) * np.linalg.norm(last))


def _limited_note(s, asked, reasons, points, given, limits) -> str:
    """The one line on what was limited: the place where most was taken away."""
    share = reasons.min(0) / asked
    worst = int(share.argmin())
    if share[worst] >= _TOLD:
        return ""
    why = (
        f"people go at up to {limits.speed:g} m/s",
        f"people turn at up to {limits.turning:g} rad/s",
        f"people lean into a turn at up to {limits.sideways:g} m/s2",
    )[int(reasons[:, worst].argmin())]
    metre = s[worst] * given[-1] / s[-1]
    point = int(np.abs(given - metre).argmin())
    x, z = points[point]
    return (
        f"path: at {metre:.2f} of {given[-1]:.2f} m, near point {point} ({x:.2f}, {z:.2f}), {asked[worst]:.3g} m/s "
        f"were asked for and {reasons[:, worst].min():.2g} are given: {why}; "
        f"{np.mean(share < _TOLD):.0%} of the path is slower than asked for"
    )


def _checked_pace(pace, count: int) -> np.ndarray:
    values = numbers_of(pace, "pace")
    if values.ndim > 1 or (values.ndim == 1 and len(values) != count):
        raise MotionError(f"pace of shape {values.shape}: expected a number or one for each of {count} points")
    values = np.broadcast_to(values, (count,))
    bad = ~(np.isfinite(values) & (values > 0))
    if bad.any():
        at = f" at point {int(bad.argmax())}" if np.ndim(pace) else ""
        raise MotionError(f"pace {values[bad.argmax()]:g} m/s{at}: expected a number above zero")
    return values
