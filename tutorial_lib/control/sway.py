r"""The sway of a gait: how hip and shoulders move about the way that somebody goes, once a stride.

Control that is measured from a clip sways with every step, control that is made from a path does not. A network that
was trained on the first (Habibie et al., section 4.1) has learnt to read from it where in the stride the body is: on
smooth control it glides along with its feet hardly moving. So the sway is learnt too, from the same clips, and given
to the smooth control of a path before the network sees it:

.. math:: o(t) = \sum_{n=1}^{N} a_n(v, \omega) \cos n\varphi(t) + b_n(v, \omega) \sin n\varphi(t), \qquad
          \dot\varphi = 2 \pi f(v)

o is how far the hip is to the left and ahead of the way, and how far the body is turned from it; v the speed and
:math:`\omega` the turning along the way, f the strides a second. Offsets, not speeds, are fitted and added, so that
nobody drifts from the path by them. A gait is taken to be even: seen in a mirror it is the same, half a stride later.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from ..chance import check_whole, is_real, numbers_of
from ..errors import MotionError
from ..motion.clip import Motion, same_rate
from ..representations import heading, heading_joints, integrate_control, measure_control
from .signals import LIMITS, SWAY_BLUR, Limits, NoGait, blurred, check_control, check_fps, limits_of
from .strides import find_strides

HARMONICS = 4  # of the stride
KNOTS = np.arange(0.0, 5.01, 0.4)  # m/s; between two of them all is linear in the speed
SMOOTH = 1e-3  # weight of the second differences from knot to knot, and, a tenth of it, of the first
SLOWEST = 0.3  # m/s; slower frames are of somebody who stops, and are not fitted
TURNING_SEEN = 1.2  # rad/s; faster turns are not fitted, and sway as one of this
LEAST = 0.4  # s of walking in a clip
RIDGE = 0.02  # of what a rad/s of turning adds
CHANNELS = ("left", "ahead", "heading")


class Swaying(NamedTuple):
    """Control with the sway of a gait, ``(T, 3)`` or ``(P, T, 3)``; with ``start`` ``(..., 2)``, x and z, and
    ``heading`` ``(...)`` of the first frame, :func:`integrate_control` brings it back to the way."""

    control: np.ndarray
    start: np.ndarray
    heading: np.ndarray


@dataclass(frozen=True, eq=False)
class Sway:
    """The sway of one gait, even on both sides, and how fast its people go and turn.

    speeds: ``(K,)`` m/s, rising from 0. frequency: ``(K,)`` strides a second at these. offsets:
    ``(K, 2, 3, 2 N)``: at each speed, straight on and what a rad/s of turning adds, for the three channels (metres to
    the left, metres ahead, radians to the left) the coefficients of cos and sin of 1 to N times the phase. spread:
    share by which the frequency differs from one walk to another (standard deviation). residual: ``(3,)`` what of the
    clips' sway, as speeds, is not explained, as a share of it (root mean square). limits: of the clips
    (:func:`limits_of`): for more than that a network should not be asked.
    Raises ``MotionError`` for shapes that do not fit, numbers that are none or not finite, and speeds that do not rise.
    """

    speeds: np.ndarray
    frequency: np.ndarray
    offsets: np.ndarray
    spread: float
    residual: np.ndarray
    limits: Limits = LIMITS

    def __post_init__(self):
        for name in ("speeds", "frequency", "offsets", "residual"):
            object.__setattr__(self, name, np.array(numbers_of(getattr(self, name), f"sway: {name}")))
        count = len(self.speeds) if self.speeds.ndim == 1 else 0
        fits = self.frequency.shape == (count,) and self.offsets.shape[:3] == (count, 2, 3) and count >= 2
        if not (fits and self.offsets.ndim == 4 and self.offsets.shape[-1] % 2 == 0 and self.residual.shape == (3,)):
            raise MotionError(
                f"sway at {count} speeds with frequencies {self.frequency.shape} and offsets {self.offsets.shape}: "
                "expected K speeds, (K,) and (K, 2, 3, 2 N)"
            )
        for name in ("speeds", "frequency", "offsets"):
            if not np.isfinite(getattr(self, name)).all():
                raise MotionError(f"sway: {name} not finite, expected numbers")
        if not (np.diff(self.speeds) > 0).all():
            raise MotionError(f"sway: speeds {self.speeds.tolist()}, expected rising ones")
        if not (is_real(self.spread) and 0 <= self.spread < np.inf):
            raise MotionError(f"sway: spread {self.spread!r}, expected a number of 0 or more")
        if not isinstance(self.limits, Limits):
            raise MotionError(f"sway: limits {self.limits!r}, expected Limits")

    # -- use ---------------------------------------------------------------------------------------------

    def added_to(
        self, control: np.ndarray, fps: float, phase: float | np.ndarray = 0.0, tempo: float | np.ndarray = 1.0,
        *, start: Sequence[float] = (0.0, 0.0), heading: float = 0.0,
    ) -> Swaying:  # fmt: skip
        """Smooth control ``(T, 3)`` as somebody walks it, or as ``P`` people do.

        phase: radians, in the first frame, 0 with the left foot ahead. tempo: times the usual frequency. Both a number,
        or ``(P,)``. start, heading: where the way begins (x, z) and where it leads to at first, radians.
        """
        control = check_control(control)
        way, angle = integrate_control(control, check_fps(fps), start, heading)
        speed, turning = np.hypot(control[:, 1], control[:, 2]), np.clip(control[:, 0], -TURNING_SEEN, TURNING_SEEN)
        hats = _hats(speed, self.speeds)  # (T, K)
        rate = hats @ self.frequency
        run = np.r_[0.0, 2 * np.pi / fps * (rate[1:] + rate[:-1]).cumsum() / 2]
        at = np.asarray(phase)[..., None] + np.asarray(tempo)[..., None] * run  # (..., T)
        straight, turned = np.einsum("tk,kwcn->wtcn", hats, self.offsets)
        amplitude = straight + turning[:, None, None] * turned  # (T, 3, 2 N)
        offset = np.einsum("tcn,...tn->...tc", amplitude, _waves(at, self.offsets.shape[-1] // 2))
        place, facing = way + _turned(offset[..., :2], angle), angle + offset[..., 2]
        return Swaying(measure_control(place, facing, fps), place[..., 0, :], facing[..., 0])

    # -- storing -----------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it, rounded to a hundredth of a millimetre."""
        return {
            "speeds": self.speeds.round(3).tolist(),
            "frequency": self.frequency.round(4).tolist(),
            "offsets": self.offsets.round(5).tolist(),
            "spread": round(float(self.spread), 4),
            "residual": self.residual.round(3).tolist(),
            "limits": {name: round(value, 3) for name, value in asdict(self.limits).items()},
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Sway:
        """The inverse of :meth:`to_dict`. ``MotionError`` for what is none."""
        try:
            return cls(**{**values, "limits": Limits(**values["limits"])})
        except (TypeError, ValueError, KeyError):
            raise MotionError("sway: expected speeds, frequency, offsets, spread, residual and limits") from None


def fit_sway(motions: Iterable[Motion], fps: float = 30.0, harmonics: int = HARMONICS) -> Sway:
    """The sway of the people in some clips, by least squares.

    Way and heading of each clip are blurred in time (``smooth_control``); what the hip and the body do beside that, in
    the frame of the way, is fitted by waves of the stride's phase (:func:`find_strides`), from which the same blur has
    been taken, so that what the blur leaves of the sway is not missing. Their speeds are fitted, which a network sees,
    and in which the corners that a blur cuts weigh little. Amplitudes and frequency are linear in the speed between
    knots 0.4 m/s apart, smoothed by differences from knot to knot, and nobody sways who stands.
    Raises :class:`NoGait`, a ``MotionError``, where nobody walks for 0.4 s (``LEAST``) in any clip, slow frames and
    sharp turns not counted, and where no clip is long enough for its limits.
    """
    fps = check_fps(fps)
    check_whole("the harmonics of a sway", harmonics)
    motions = list(motions)
    rows = [row for motion in motions if (row := _swaying(motion, fps, harmonics)) is not None]
    if not rows:
        raise NoGait(
            f"fit_sway: nobody walks in these clips: expected steps of 10 cm and more, for {LEAST:g} s in one of them"
        )
    speed, turning, rate, wanted, waves = (np.concatenate(column) for column in list(zip(*rows, strict=True))[:5])
    hats = _hats(speed, KNOTS)
    top = min(len(KNOTS), max(2, int(np.searchsorted(KNOTS, speed.max())) + 1))  # who is faster than all sways alike
    hats = np.c_[hats[:, : top - 1], hats[:, top - 1 :].sum(1)]
    smooth = _smoothing(top) * np.sqrt(len(speed) * SMOOTH)
    frequency = np.linalg.lstsq(np.r_[hats, smooth], np.r_[rate, np.zeros(len(smooth))], rcond=None)[0]

    offsets, residual = np.zeros((top, 2, 3, 2 * harmonics)), np.zeros(3)
    still = 1e3 * np.sqrt(len(speed)) * np.eye(1, top)  # no amplitude at no speed
    for c, name in enumerate(CHANNELS):
        columns, regular = [], []
        for n in range(2 * harmonics):
            even = (n // 2 + 1) % 2 == 0  # forward speed changes twice a stride, sides once; turning mixes them
            w = int(even != (name == "ahead"))
            columns.append((w, n))
            factor = turning if w else 1.0
            regular.append(hats * (factor * waves[:, n])[:, None])
        design = np.concatenate(regular, 1)
        ridge = np.sqrt(len(speed) * RIDGE) * np.eye(top)
        penalty = _block_diagonal([np.r_[smooth, still, w * ridge] for w, _ in columns])
        solved = np.linalg.lstsq(
            np.r_[design, penalty], np.r_[wanted[:, c], np.zeros(len(penalty))], rcond=None
        )[0].reshape(len(columns), top)  # fmt: skip
        for (w, n), values in zip(columns, solved, strict=True):
            offsets[:, w, c, n] = values
        residual[c] = np.sqrt(np.square(wanted[:, c] - design @ solved.ravel()).mean() / np.square(wanted[:, c]).mean())
    usual = hats @ frequency
    each = np.array([np.mean(row[2]) / np.mean(part) for row, part in zip(rows, _parts(usual, rows), strict=True)])
    spread = float(np.sqrt(np.square(each - 1).mean()))
    return Sway(KNOTS[:top], frequency, offsets, spread, residual, limits_of(motions, fps))


def _swaying(motion: Motion, fps: float, harmonics: int) -> tuple[np.ndarray, ...] | None:
    """Of the frames of a clip in which somebody walks: speed, turning, strides a second; and, as they change a second,
    the three offsets ``(n, 3)`` and the waves ``(n, 2 N)``, both without what a blur leaves."""
    if not same_rate(motion.fps, fps):
        motion = motion.resample(fps)
    strides = find_strides(motion)
    place = motion.positions[:, heading_joints(motion.skeleton)[0]][:, [0, 2]]
    angle = np.unwrap(heading(motion.skeleton, motion.positions))
    way, facing = blurred(place, fps, SWAY_BLUR), blurred(angle[:, None], fps, SWAY_BLUR)[:, 0]
    along = measure_control(way, facing, fps)
    offset = np.c_[_turned(place - way, -facing), angle - facing]
    speed, turning = np.hypot(along[:, 1], along[:, 2]), along[:, 0]
    known = np.isfinite(strides.phase)
    used = known & (speed > SLOWEST) & (np.abs(turning) < TURNING_SEEN)
    if used.sum() < LEAST * fps:
        return None
    phase = _gone_on(strides.phase, known)
    waves = _waves(phase, harmonics)
    waves = waves - blurred(waves, fps, SWAY_BLUR)
    rate, offset, waves = (fps * np.gradient(values, axis=0) for values in (phase / (2 * np.pi), offset, waves))
    return speed[used], turning[used], rate[used], offset[used], waves[used]


def _gone_on(phase: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``phase`` filled where it is not ``known``: in gaps evenly, at both ends as fast as it goes there."""
    at = np.flatnonzero(known)
    frames = np.arange(len(phase))
    filled = np.interp(frames, at, phase[known])
    rate = np.diff(phase)[np.isfinite(np.diff(phase))].mean()
    return filled + rate * (np.minimum(frames - at[0], 0) + np.maximum(frames - at[-1], 0))


def _waves(phase: np.ndarray, harmonics: int) -> np.ndarray:
    """cos and sin of 1 to N times the phase, by turns: ``(..., 2 N)``."""
    turns = np.asarray(phase)[..., None] * np.arange(1, harmonics + 1)
    return np.stack([np.cos(turns), np.sin(turns)], -1).reshape(*turns.shape[:-1], -1)


def _hats(speed: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Shares ``(T, K)`` of the knots in each speed, which sum to one: linear in between, held beyond the last."""
    return np.stack([np.interp(speed, knots, one) for one in np.eye(len(knots))], -1)


def _smoothing(count: int) -> np.ndarray:
    """Rows that are small where neighbours are alike: first and second differences."""
    first = np.diff(np.eye(count), axis=0)
    return np.r_[np.sqrt(0.1) * first, np.diff(first, axis=0)]


def _block_diagonal(blocks: list[np.ndarray]) -> np.ndarray:
    width = blocks[0].shape[1]
    whole = np.zeros((sum(len(block) for block in blocks), width * len(blocks)))
    row = 0
    for k, block in enumerate(blocks):
        whole[row : row + len(block), k * width : (k + 1) * width] = block
        row += len(block)
    return whole


def _parts(values: np.ndarray, rows: list) -> list[np.ndarray]:
    return np.split(values, np.cumsum([len(row[0]) for row in rows])[:-1])


def _turned(offset: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(left, ahead) ``(..., 2)`` of somebody who faces ``angle`` to x and z in the world."""
    left, ahead = offset[..., 0], offset[..., 1]
    sin, cos = np.sin(angle), np.cos(angle)
    return np.stack([left * cos + ahead * sin, ahead * cos - left * sin], -1)
