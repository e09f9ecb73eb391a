"""Ways along the ground: given or prepared points, a smooth curve through them, how far from them somebody is.

A path is an array ``(N, 2)`` of x and z in metres, seen from above: x to the left and z ahead of somebody who
faces +z. Headings are radians from +z, positive to the left, towards +x.
"""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ..chance import is_real, is_whole
from ..errors import MotionError

# How people slow down where a path turns; both as the sample walkers and runners do it. Measured, with a stride's
# sway taken out: CMU and Bandai-Namco walkers turn at up to 1.4 rad/s on a curve and 4 on the spot, with up to
# 1.7 m/s2 to the side; people who start or stop running change their speed by up to 2.8 m/s2, walkers by 1.2.
TURNING_LIMIT = 2.6  # rad/s
SIDEWAYS_LIMIT = 3.0  # m/s2, towards the inside of the turn
BRAKE = 2.0  # m/s2, along the path
LONGEST = 10_000.0  # metres of a path; longer ones are in other units

_STEP = 0.02  # metres between the points of the resampled path
_SHORTEST = 0.05  # metres
_SAME = 1e-9  # metres; points nearer to each other are one
_MOST_TURNS = 10_000


def check_path(path) -> np.ndarray:
    """The points as an array (N, 2), or a one-line error."""
    try:
        points = np.asarray(path, float)
    except (TypeError, ValueError):
        raise MotionError("path: expected numbers, an array (N, 2) of x and z in metres") from None
    if points.ndim != 2 or points.shape[1] != 2:
        raise MotionError(f"path of shape {points.shape}: expected (N, 2), x and z in metres")
    if not np.isfinite(points).all():
        raise MotionError(f"path: point {int(np.argmin(np.isfinite(points).all(1)))} is not finite, expected metres")
    length = path_length(points)
    if len(points) < 2 or length < _SHORTEST:
        raise MotionError(f"path of {len(points)} points: expected at least two, 5 cm apart or more")
    if length > LONGEST:
        raise MotionError(f"path of {length:.3g} m: expected at most {LONGEST:g}, coordinates in metres")
    return points


def path_length(points: np.ndarray) -> float:
    """Metres from the first of ``(N, 2)`` points to the last, along all of them."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=-1).sum())


class GroundPath:
    """A curve on the ground, asked for by the distance walked along it.

    A closed path (its ends within 5 cm) is followed round and round; an open one goes straight on
    where it ends, and came straight to where it begins.
    """

    def __init__(self, points: np.ndarray, rounding: float, closed: bool | None = None):
        """points: (N, 2) x and z in metres; rounding: metres of blur that take the sharp corners off; closed: whether
        to go round and round (None: where the ends meet)."""
        given, points = len(points), _resampled(points)
        apart = np.linalg.norm(points - points[0], axis=1) > _SAME
        if not apart.any():
            raise MotionError(
                f"path of {given} points: goes to and fro within {100 * _STEP:g} cm, nothing is left of it"
            )
        meet = len(points) > 25 and np.linalg.norm(points[0] - points[-1]) < 0.05
        self._closed = bool(meet) if closed is None else closed
        if self._closed:
            points = points[:-1]
            pad = int(4 * rounding / _STEP) + 2
            wrapped = np.concatenate(
                [points[np.arange(-pad, 0) % len(points)], points, points[np.arange(pad) % len(points)]]
            )
            points = _blurred(wrapped, rounding)[pad:-pad]
            points = np.concatenate([points, points[:1]])
        else:
            run = int(4 * rounding / _STEP) + 2
            steps = _STEP * np.arange(1, run + 1)[:, None]
            # a path may turn back within a step: then two samples are one, and the next ones tell the direction
            first = points[0] - points[apart.argmax()]
            apart = np.linalg.norm(points[::-1] - points[-1], axis=1) > _SAME
            last = points[-1] - points[::-1][apart.argmax()]
            before = points[0] + steps[::-1] * first / np.linalg.norm(first)
            after = points[-1] + steps * last / np.linalg.norm(last)
            points = _blurred(np.concatenate([before, points, after]), rounding)[run:-run]
        self._points = points
        self._s = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
        d = np.gradient(points, axis=0) if not self._closed else _wrapped_gradient(points)
        if not self._closed:
            for end, ahead in ((0, -first), (-1, last)):
                if np.linalg.norm(d[end]) <= _SAME:
                    d[end] = ahead
        heading = np.unwrap(np.arctan2(d[:, 0], d[:, 1]))
        if self._closed:
            n, turn = len(heading) - 1, heading[-1] - heading[0]
            pad = np.arange(-n, 2 * n + 1)
            wound = heading[pad % n] + turn * np.floor(pad / n)
            self._heading = _blurred(wound, 0.1)[n : 2 * n + 1]
        else:
            self._heading = _blurred(heading, 0.1)

    @property
    def length(self) -> float:
        return float(self._s[-1])

    @property
    def samples(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (N,), points (N, 2) and headings (N,) of the curve's samples; between them it is straight and
        turns evenly. Where it comes back on itself two may lie on one spot."""
        return self._s, self._points, self._heading

    def position(self, s: np.ndarray) -> np.ndarray:
        """x and z (..., 2) at the distances ``s`` (...)."""
        on, rest, _ = self._split(s)
        place = np.stack([np.interp(on, self._s, self._points[:, k]) for k in (0, 1)], -1)
        heading = np.interp(on, self._s, self._heading)
        return place + rest[..., None] * np.stack([np.sin(heading), np.cos(heading)], -1)

    def heading(self, s: np.ndarray) -> np.ndarray:
        """The direction (...) in radians from +z towards +x, without jumps, at the distances ``s``."""
        on, _, rounds = self._split(s)
        return np.interp(on, self._s, self._heading) + rounds * (self._heading[-1] - self._heading[0])

    def curvature(self, s: np.ndarray) -> np.ndarray:
        """Radians of turn per metre, left positive."""
        return (self.heading(s + 0.05) - self.heading(s - 0.05)) / 0.1

    def _split(self, s):
        s = np.asarray(s, float)
        if self._closed:
            rounds = np.floor(s / self.length)
            return s - rounds * self.length, np.zeros_like(s), rounds
        on = np.clip(s, 0.0, self.length)
        return on, s - on, np.zeros_like(s)


def braked(limit: np.ndarray, s: np.ndarray, brake: float = BRAKE) -> np.ndarray:
    """The highest speeds (N,) at the places ``s`` that nowhere exceed ``limit`` (N,), with at most ``brake`` m/s2
    before and after: ``v(s)^2 <= v(s')^2 + 2 brake |s - s'|``."""
    square = limit**2
    after = np.minimum.accumulate(square - 2 * brake * s) + 2 * brake * s
    before = np.minimum.accumulate((square + 2 * brake * s)[::-1])[::-1] - 2 * brake * s
    return np.sqrt(np.maximum(np.minimum(after, before), 0.0))


# -- how far from a path -------------------------------------------------------------------------------------


def path_offset(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """How far ``(T, 2)`` points are from a path ``(N, 2)``, metres ``(T,)``: positive to the left of its direction.

    The distance is to the nearest place of the line, not to the nearest of its points. Where that is a corner, left is
    to the left of both pieces' directions, taken together: outside of a sharp one each alone would be wrong somewhere.
    """
    points, path = np.asarray(points, float), check_path(path)
    along = np.diff(path, axis=0)  # (S, 2)
    kept = (along**2).sum(-1) > 0
    (x, z), (dx, dz) = path[:-1][kept].T, along[kept].T
    square = dx**2 + dz**2
    unit = along[kept] / np.sqrt(square)[:, None]
    # at each point of the path (S + 1, 2), if it is a corner sharper than 90 degrees: its two directions' sum, else 0
    before, after = np.concatenate([unit[-1:], unit]), np.concatenate([unit, unit[:1]])
    corner = (before + after) * ((before * after).sum(1) < 0)[:, None]
    if not np.allclose(path[0], path[-1], rtol=0, atol=_SAME):
        corner[[0, -1]] = 0.0
    out = np.empty(len(points))
    rows = max(1, 50_000 // len(x))  # what the processor's cache holds
    for i in range(0, len(points), rows):
        px, pz = points[i : i + rows, :1] - x, points[i : i + rows, 1:] - z  # (T, S): from the pieces' starts
        share = np.clip((px * dx + pz * dz) / square, 0.0, 1.0)
        distance = (px - share * dx) ** 2 + (pz - share * dz) ** 2
        nearest = distance.argmin(1)
        at = np.arange(len(nearest)), nearest
        cross = dz[nearest] * px[at] - dx[nearest] * pz[at]  # x is to the left of z
        for end in (0, 1):
            to = corner[nearest + end]
            over = to[:, 1] * (px[at] - end * dx[nearest]) - to[:, 0] * (pz[at] - end * dz[nearest])
            cross = np.where((share[at] == end) & (np.abs(to).sum(1) > _SAME), over, cross)  # 0 too for a turn back
        out[i : i + rows] = np.sqrt(distance[at]) * np.where(cross < 0, -1.0, 1.0)
    return out


# -- prepared paths ------------------------------------------------------------------------------------------


def circle(radius: float = 2.0, turns: float = 1.0) -> np.ndarray:
    """A circle, or some ``turns`` of it, (N, 2): from the origin along +z, to the left for a positive radius.

    N is 200, or of more than one turn 199 for each, and one.
    """
    known = is_real(radius) and is_real(turns)
    if not (known and np.isfinite(radius) and radius != 0 and 0 < turns <= _MOST_TURNS):
        raise MotionError(
            f"circle of radius {radius!r} m and {turns!r} turns: expected a radius other than 0, turns above 0 and at "
            f"most {_MOST_TURNS}"
        )
    a = np.linspace(0.0, 2 * np.pi * turns, max(200, int(np.ceil(199 * turns)) + 1))
    return np.stack([radius * (1 - np.cos(a)), abs(radius) * np.sin(a)], -1)


def figure_of_eight(size: float = 4.0) -> np.ndarray:
    """A figure of eight (300, 2) that is 2 ``size`` metres long and ``size`` wide, from its crossing at the origin."""
    if not (np.isfinite(size) and size > 0):
        raise MotionError(f"figure of eight of size {size} m: expected a number above zero")
    a = np.linspace(0.0, 2 * np.pi, 300)
    return np.stack([size * np.sin(2 * a) / 2, size * np.sin(a)], -1)


def zigzag(legs: int = 5, leg: float = 3.0, turn: float = np.pi / 2, radius: float = 1.0) -> np.ndarray:
    """A zigzag (N, 2) of ``legs`` straight pieces of ``leg`` metres from corner to corner, from the origin towards +z.

    turn: radians at each corner, by turns to the right and to the left. radius: metres; the corners are arcs of it, so
    that somebody can walk them.
    """
    cut = radius * np.tan(turn / 2) if 0 <= turn < np.pi else np.nan  # from a corner to where its arc begins
    if not (is_whole(legs) and legs >= 1 and np.isfinite([leg, cut]).all() and 0 <= 2 * cut < leg):
        raise MotionError(
            f"zigzag of {legs} legs of {leg} m with corners of {turn:.3g} rad and radius {radius} m: expected "
            "a whole number of one leg or more, radians below pi, and legs longer than the corners at their ends take"
        )
    pieces = []  # (metres, heading at its start, heading at its end)
    for k in range(legs):
        side = 1 if k % 2 == 0 else -1
        ends = (k > 0) + (k < legs - 1)
        pieces.append((leg - ends * cut, side * turn / 2, side * turn / 2))
        if k < legs - 1:
            pieces.append((radius * turn, side * turn / 2, -side * turn / 2))
    points = [np.zeros((1, 2))]
    for metres, start, end in pieces:
        n = max(1, int(np.ceil(metres / 0.05)))
        heading = start + (end - start) * (np.arange(n) + 0.5) / n
        chord = metres / n * np.sinc((end - start) / (2 * np.pi * n))  # shorter than its arc
        points.append(points[-1][-1] + chord * np.stack([np.sin(heading), np.cos(heading)], -1).cumsum(0))
    return np.concatenate(points)


#: The paths that lessons, tests and the canvas share.
PREPARED: dict[str, Callable[[], np.ndarray]] = {
    "circle": circle,
    "figure of eight": figure_of_eight,
    "zigzag": zigzag,
}


def prepared_path(name: str) -> np.ndarray:
    """The prepared path ``(N, 2)`` of this name, "figure-of-eight" will do, too; ``MotionError`` names them all."""
    found = str(name).lower().replace("-", " ").replace("_", " ")
    if found not in PREPARED:
        raise MotionError(f"no prepared path {name!r}: expected one of {', '.join(PREPARED)}")
    return PREPARED[found]()


def read_path(file: str | os.PathLike) -> np.ndarray:
    """The points ``(N, 2)`` in a file: a line each, x and z in metres, parted by a comma or by spaces.

    Empty lines and what follows a ``#`` are passed over, and so is a first line of two names without a digit. Raises
    ``MotionError``, which names file and line, for what is no path, ``OSError`` for a file that cannot be read.
    """
    # "sig": the mark that Excel and Notepad put before the first number is no part of it
    points, lines = [], pathlib.Path(file).read_bytes().decode("utf-8-sig", errors="replace").splitlines()
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            if number == 1 and len(words) == 2 and not any(c.isdigit() for c in "".join(words)):
                continue  # names; with a digit it is a point with a slip of the pen, not to be lost
            values = []
        if words and len(values) != 2:
            told = line.strip()[:40]
            raise MotionError(f"{file}: line {number} is {told!r}, expected two numbers, x and z in metres")
        if values:
            points.append(values)
    try:
        return check_path(points or np.zeros((0, 2)))
    except MotionError as error:
        raise MotionError(f"{file}: {error}") from None


def _blurred(signal, metres):
    """A signal (N, ...) along the path, blurred by a Gaussian of that standard deviation, the ends held."""
    return gaussian_filter1d(signal, metres * (1 / _STEP), axis=0, mode="nearest") if metres > 0 else signal


def _resampled(points):
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], steps > _SAME])]
    s = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    at = np.linspace(0.0, s[-1], max(3, int(np.ceil(s[-1] / _STEP)) + 1))
    return np.stack([np.interp(at, s, points[:, k]) for k in (0, 1)], -1)


def _wrapped_gradient(points):
    d = np.empty_like(points)
    d[1:-1] = points[2:] - points[:-2]
    d[0] = d[-1] = points[1] - points[-2]
    return d
