"""Control from clips and from sliders, and what people can do at all."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from ..chance import is_real, is_whole, numbers_of
from ..errors import MotionError
from ..motion.clip import Motion, same_rate
from ..motion.ground import BRAKE, SIDEWAYS_LIMIT, TURNING_LIMIT
from ..representations import HipFrame, integrate_control, measure_control

SWAY_BLUR = 0.35  # s, standard deviation of a Gaussian that leaves a seventh of a walker's sway
LONGEST_TIME = 3600.0  # s of one control
_PACKAGE = __name__.partition(".")[0]


class NoGait(MotionError):
    """Clips that no gait can be learnt from: nobody walks in them, or none is long enough."""


@dataclass(frozen=True)
class Limits:
    """What people can do: no control made here exceeds it (turning by a few per cent at most, where speed changes).

    But for acceleration: only the pace along a path is held to it (:func:`path_control`), and there only a path that is
    rounded (with ``rounding`` 0 the step round a corner is a jump). Sliders change as suddenly as they are told to.
    speed: m/s. The fastest running of the CMU and Bandai-Namco clips is 4.0 and 4.4.
    turning: rad/s; sideways: m/s2 towards the inside of a turn, speed times turning; acceleration: m/s2 along the path.
    ``motion.ground`` says where those are from. :func:`limits_of` measures all four of clips.
    Raises ``MotionError`` for what is not a number above zero.
    """

    speed: float = 4.5
    turning: float = TURNING_LIMIT
    sideways: float = SIDEWAYS_LIMIT
    acceleration: float = BRAKE

    def __post_init__(self):
        for one in fields(self):
            value = getattr(self, one.name)
            if not (is_real(value) and math.isfinite(value) and value > 0):
                raise MotionError(f"limits: {one.name} {value!r}, expected a number above zero")
            object.__setattr__(self, one.name, float(value))


LIMITS = Limits()


# -- from clips ----------------------------------------------------------------------------------------------


def control_of(motion: Motion, fps: float | None = None) -> np.ndarray:
    """The control ``(T, 3)`` float32 of a clip, as ``HipFrame`` measures it; the clip resampled to ``fps`` if need be.

    Raises ``MotionError`` where the skeleton has no hips and shoulders to tell a direction by.
    """
    fps = motion.fps if fps is None else check_fps(fps)
    if not same_rate(motion.fps, fps):
        motion = motion.resample(fps)
    frame = HipFrame(motion.skeleton, motion.fps)
    return frame.encode(motion)[:, frame.slices["control"]]


def smooth_control(control: np.ndarray, fps: float, seconds: float = SWAY_BLUR) -> np.ndarray:
    """A control ``(..., T, 3)`` without the sway of each stride: place and heading are blurred, then measured again.

    Measured control sways, since hip and shoulders do; one made from a path does not. Holden et al. 2016 (section 4)
    smooth the direction over time for the same reason. seconds: standard deviation of the Gaussian.
    """
    control, seconds = numbers_of(control, "control"), _check_seconds("smooth_control: a blur", seconds)
    place, angle = integrate_control(control, check_fps(fps))
    if place.shape[-2] < 2 or seconds * fps == 0:
        return control.copy()
    return measure_control(blurred(place, fps, seconds), blurred(angle[..., None], fps, seconds)[..., 0], fps)


def blurred(values: np.ndarray, fps: float, seconds: float = SWAY_BLUR) -> np.ndarray:
    """``(..., T, C)`` blurred over time by a Gaussian, going on at both ends as it came."""
    pad = min(math.ceil(4 * seconds * fps), 20 * values.shape[-2])
    around = [(0, 0)] * (values.ndim - 2) + [(pad, pad), (0, 0)]
    wide = np.pad(values, around, mode="reflect", reflect_type="odd")
    return gaussian_filter1d(wide, seconds * fps, axis=-2)[..., pad:-pad, :]


def limits_of(motions: Iterable[Motion], fps: float = 30.0, quantile: float = 0.99) -> Limits:
    """What the people in some clips do, a stride's sway taken out: the ``quantile`` of each of the four limits.

    A network can be asked for what it was trained on. Raises :class:`NoGait`, a ``MotionError``, where no clip is
    longer than twice what the blur spoils at an end, 0.8 s in all.
    """
    fps = check_fps(fps)
    if not (is_real(quantile) and 0 <= quantile <= 1):
        raise MotionError(f"limits_of: quantile {quantile!r}, expected a number from 0 to 1")
    edge = math.ceil(SWAY_BLUR * fps)  # what lies beyond the clip's ends shows up to here
    rows = []
    for motion in motions:
        turning, forward, sideways = smooth_control(control_of(motion, fps), fps)[edge:-edge].T
        if len(turning) > 1:
            speed = np.hypot(forward, sideways)
            inside = speed * np.abs(turning)
            rows.append(np.stack([speed, np.abs(turning), inside, np.abs(np.gradient(speed, 1 / fps))], -1))
    if not rows:
        raise NoGait(f"limits_of: no clip of more than {2 * edge + 1} frames at {fps:g} frames per second")
    return Limits(*(max(float(v), 1e-3) for v in np.quantile(np.concatenate(rows), quantile, axis=0)))


# -- from sliders --------------------------------------------------------------------------------------------


def constant_control(
    frames: int,
    *,
    turning: float = 0.0,
    forward: float = 1.3,
    sideways: float = 0.0,
    fps: float = 30.0,
    limits: Limits = LIMITS,
) -> np.ndarray:
    """The same control at every frame, ``(frames, 3)``: rad/s, m/s, m/s. Limited as :func:`limit_control` does."""
    if not (is_whole(frames) and 1 <= frames <= LONGEST_TIME * 1000):
        raise MotionError(f"control of {frames!r} frames: expected a whole number above zero")
    one = {"turning": turning, "forward": forward, "sideways": sideways}
    values = [numbers_of(value, name) for name, value in one.items()]
    for name, value in zip(one, values, strict=True):
        if value.ndim:
            raise MotionError(f"{name} of shape {value.shape}: expected a number")
    control, note = _limited(np.repeat([values], frames, 0), check_fps(fps), limits)
    tell(note)
    return control


def piecewise_control(
    pieces: Sequence[tuple[float, float, float, float]], fps: float = 30.0, *, blend: float = 0.5,
    limits: Limits = LIMITS,
) -> np.ndarray:  # fmt: skip
    """One constant control after another, ``(T, 3)``: pieces of (seconds, turning, forward, sideways).

    blend: seconds in which one goes over into the next, evenly. Limited as :func:`limit_control` does.
    """
    fps, blend = check_fps(fps), _check_seconds("piecewise_control: a blend", blend)
    table = numbers_of(pieces, "pieces")
    if table.ndim != 2 or table.shape[1] != 4 or not len(table):
        raise MotionError(f"pieces of shape {table.shape}: expected rows of (seconds, turning, forward, sideways)")
    for row, seconds in enumerate(table[:, 0]):
        if not 1 <= seconds * fps <= LONGEST_TIME * fps:
            raise MotionError(
                f"piece {row} of {seconds:g} s: expected at least one frame and at most {LONGEST_TIME:g} s"
            )
    ends = np.round(table[:, 0].cumsum() * fps).astype(int)
    control = np.repeat(table[:, 1:], np.diff(ends, prepend=0), 0)
    if blend > 0:
        control = uniform_filter1d(control, max(1, round(blend * fps)), axis=0, mode="nearest")
    control, note = _limited(control, fps, limits)
    tell(note)
    return control


def limit_control(control: np.ndarray, fps: float, limits: Limits = LIMITS) -> np.ndarray:
    """A control ``(T, 3)`` within the limits of speed, turning and force to the side (acceleration is left as it is).

    One warning names the frame where most was taken away. Raises ``MotionError`` for other shapes and for numbers that
    are not finite.
    """
    control, note = _limited(control, check_fps(fps), limits)
    tell(note)
    return control


def _limited(control, fps, limits) -> tuple[np.ndarray, str]:
    control = check_control(control)
    turning = np.clip(control[:, 0], -limits.turning, limits.turning)
    speed = np.hypot(control[:, 1], control[:, 2])
    with np.errstate(divide="ignore"):
        most = np.minimum(limits.speed, limits.sideways / np.abs(turning))
    share = np.minimum(1.0, most / np.maximum(speed, 1e-12))
    result = np.column_stack([turning, control[:, 1] * share, control[:, 2] * share])
    kept = np.minimum(share, np.abs(turning) / np.maximum(np.abs(control[:, 0]), 1e-12))
    kept[control[:, 0] == 0] = share[control[:, 0] == 0]
    worst = int(kept.argmin())
    if kept[worst] >= 1 - 1e-9:
        return result, ""
    return result, (
        f"control: at frame {worst} ({worst / fps:.2f} s) {speed[worst]:.3g} m/s and {control[worst, 0]:.3g} rad/s "
        f"were asked for, {speed[worst] * share[worst]:.3g} m/s and {turning[worst]:.3g} rad/s are given: people go at "
        f"up to {limits.speed:g} m/s, turn at up to {limits.turning:g} rad/s and lean into a turn at up to "
        f"{limits.sideways:g} m/s2"
    )


def check_control(control: np.ndarray) -> np.ndarray:
    """A control as an array ``(T, 3)`` float64, or a one-line ``MotionError``."""
    control = numbers_of(control, "control")
    if control.ndim != 2 or control.shape[1] != 3 or not len(control):
        raise MotionError(f"control of shape {control.shape}: expected (T, 3), turning, forward and sideways speed")
    if not np.isfinite(control).all():
        frame, channel = np.argwhere(~np.isfinite(control))[0]
        raise MotionError(f"control not finite at frame {frame}, {('turning', 'forward', 'sideways')[channel]}")
    return control


# -- checks --------------------------------------------------------------------------------------------------


def check_fps(fps) -> float:
    if not (is_real(fps) and math.isfinite(fps) and 1 <= fps <= 1000):
        raise MotionError(f"control: {fps!r} frames per second, expected 1 to 1000")
    return float(fps)


def _check_seconds(what: str, seconds) -> float:
    if not (is_real(seconds) and 0 <= seconds <= LONGEST_TIME):
        raise MotionError(f"{what} of {seconds!r} s, expected 0 to {LONGEST_TIME:g}")
    return float(seconds)


def tell(note: str) -> None:
    """One warning, of the line in which the user's call stands, where something was limited.

    That line is the first outside of this package, however deep inside it the limit is. It is told each time: Python's
    own note of what a line has warned of, which would keep the second time silent, is not kept.
    """
    if not note:
        return
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == _PACKAGE:
        frame = frame.f_back
    module = frame.f_globals.get("__name__")
    warnings.warn_explicit(note, UserWarning, frame.f_code.co_filename, frame.f_lineno, module, registry={})
