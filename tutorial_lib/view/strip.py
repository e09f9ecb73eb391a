"""Poses side by side, as in figure 3 of the acRNN paper: a motion on paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..chance import is_whole
from ..errors import TutorialError
from ..motion.clip import Motion
from . import palette
from .body import Body, describe, facing, ground_height
from .figure import NotebookFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GROUND, _TEXT = "#c3cad3", "#24292f"
_LETTER = 0.085  # inches that a character of the smallest text takes


def pose_strip(
    motions: Motion | Sequence[Motion],
    frames: int | Sequence[int] | Sequence[Sequence[int]] = 8,
    *,
    labels: Sequence[str] | str | None = None,
    seed_frames: int | Sequence[int] = 0,
    colors: Sequence[str] | None = None,
    width: float = 10.0,
    row_height: float | None = None,
    azimuth: float | None = None,
) -> NotebookFigure:
    """Poses of one motion or several, one row each, on a ground line, each pose in its own place.

    frames: how many, evenly spaced from the first to the last of the longest motion; or which (of the
        first motion's frame rate; the others are shown at the same seconds, and blank after their end); or
        which of each motion, a list of its own frames for each row, as in figure 7 of the acRNN paper.
    labels: a name for each row; seed_frames: frames that were given, drawn in grey (see ``show``).
    colors: ``"#rrggbb"`` for each row; width: of the figure, and row_height: of a row at most, in
        inches; without, a row is as high as the figures are when they fill the width.
    azimuth: radians about y that the view is from, 0 from +z; without, half from the front of the first pose.
    Returns a matplotlib ``Figure`` that belongs to no window; raises ``TutorialError`` for frames that
    are not there.
    """
    rows = as_motions(motions)
    if labels is None:
        labels = [m.name for m in rows] if len(rows) > 1 else [""]
    labels = [labels] if isinstance(labels, str) else list(labels)
    seeds = as_seed_frames(seed_frames, len(rows))
    colors = list(colors) if colors is not None else [palette.color(i) for i in range(len(rows))]
    if not len(labels) == len(colors) == len(rows):
        raise TutorialError(f"pose_strip: {len(labels)} labels, {len(colors)} colours, expected {len(rows)} of each")
    chosen, shared = _frames(rows, frames)
    columns = max(map(len, chosen))
    bodies = [describe(m) for m in rows]
    if azimuth is None:
        azimuth = facing(rows[0], bodies[0]) + 0.6
    drawn = [[outlines(m, body, f, azimuth) for f in own]
             for m, body, own in zip(rows, bodies, chosen, strict=True)]  # fmt: skip

    poses = [pose for row in drawn for pose in row if pose]
    left, right = extent(poses, 0)
    bottom, top = extent(poses, 1)
    tall = max(body.height for body in bodies)
    cell, low, high = right - left + 0.12 * tall, min(bottom, 0.0) - 0.06 * tall, max(top, tall) + 0.05 * tall
    named = any(labels)
    # in inches: a row is as high as its width asks for, so that nothing is stretched and nothing cut off
    scale = min(width / (cell * columns), (row_height or np.inf) / (high - low))
    cell = width / columns / scale
    row_height, foot, head = (high - low) * scale, 0.42, 0.24 if named else 0.04
    between = 0.0 if shared else foot  # each row with its own numbers
    total = len(rows) * (row_height + head + between) + foot - between
    figure = NotebookFigure(figsize=(width, total), dpi=100, facecolor="white")
    for i, (row, label, color) in enumerate(zip(drawn, labels, colors, strict=True)):
        base = total - (i + 1) * (row_height + head) - i * between
        axes = figure.add_axes((0, base / total, 1, row_height / total))
        axes.set(xlim=(0, cell * columns), ylim=(low, high))
        axes.axis("off")
        axes.axhline(0, color=_GROUND, linewidth=1.2, zorder=0)
        for k, pose in enumerate(row):
            if pose:
                seeded = chosen[i][k] < seeds[i]
                draw_pose(
                    axes,
                    pose,
                    palette.sides(palette.SEED if seeded else color),
                    (k + 0.5) * cell - (left + right) / 2,
                )
        if label:
            figure.text(
                0.006,
                (base + row_height + head - 0.19) / total,
                label,
                color=color,
                fontsize=10,
                weight="bold",
                parse_math=False,  # a file's name may have dollars
            )
        if not shared or i == len(rows) - 1:
            _number(figure, shared or chosen[i], rows[0 if shared else i].fps, columns, (base - 0.03) / total)
    return figure


def film_strip_png(
    motions: Sequence[Motion],
    *,
    labels: Sequence[str] | None = None,
    seed_frames: int | Sequence[int] = 0,
    colors: Sequence[str] | None = None,
    rows: int = 4,
    frames: int = 8,
) -> bytes:
    """A small ``pose_strip`` (720 pixels wide) as a PNG file's bytes, of the first ``rows`` motions."""
    count = min(len(motions), rows)
    seeds = as_seed_frames(seed_frames, len(motions))
    names = list(labels or [m.name for m in motions])[:count] if len(motions) > 1 else None
    if names and len(motions) > count:
        names[-1] += f"   (and {len(motions) - count} more)"
    figure = pose_strip(
        motions[:count],
        frames,
        labels=names,
        seed_frames=seeds[:count],
        colors=colors[:count] if colors else None,
        width=7.2,
        row_height=1.3 if count == 1 else 0.9,
    )
    return figure.png()


def as_motions(motions: Motion | Sequence[Motion]) -> tuple[Motion, ...]:
    """One motion or several as a tuple; anything else raises a ``TutorialError``."""
    several = (motions,) if isinstance(motions, Motion) else tuple(motions) if hasattr(motions, "__iter__") else None
    if not several:
        raise TutorialError(f"expected a Motion or a list of them, found {type(motions).__name__} with nothing to show")
    for i, motion in enumerate(several):
        if not isinstance(motion, Motion):
            raise TutorialError(f"expected a Motion or a list of them, found {type(motion).__name__} at place {i}")
    return several


def as_seed_frames(seed_frames: int | Sequence[int], count: int) -> list[int]:
    """Seed frames of each of ``count`` motions."""
    each = one_each([seed_frames] * count if is_whole(seed_frames) else seed_frames, count, "seed_frames")
    for frames in each:
        if not is_whole(frames) or frames < 0:
            raise TutorialError(f"seed_frames {frames!r}, expected a whole number of 0 or more")
    return [int(frames) for frames in each]


def one_each(values: Sequence, count: int, what: str) -> list:
    """``values`` as a list, if there are ``count`` of them."""
    values = list(values)
    if len(values) != count:
        raise TutorialError(f"{len(values)} {what} for {count} motions, expected one for each")
    return values


def _number(figure: NotebookFigure, frames: Sequence[int], fps: float, columns: int, y: float) -> None:
    """Frame numbers and seconds below a row."""
    long = max(len(f"{f}") for f in frames) + 6 > figure.get_figwidth() / columns / _LETTER
    for k, f in enumerate(frames):
        text = f"{'' if long else 'frame '}{f}\n{f / fps:.2f} s"
        figure.text((k + 0.5) / columns, y, text, ha="center", va="top", fontsize=8, color=_TEXT,
                    linespacing=1.25)  # fmt: skip


def _frames(
    rows: Sequence[Motion], frames: int | Sequence[int] | Sequence[Sequence[int]]
) -> tuple[list[list[int | None]], list[int]]:
    """Each row's own frames (None after its end), and those of the first that all share, if they share them."""
    if not isinstance(frames, (int, np.integer)) and any(np.ndim(f) for f in frames):
        if len(frames) != len(rows) or not all(np.ndim(f) == 1 and len(f) for f in frames):
            raise TutorialError(
                f"pose_strip: {len(frames)} lists of frames, expected one, not empty, for each of {len(rows)} rows"
            )
        each = [[int(f) for f in own] for own in frames]
        for i, own in enumerate(each):
            for f in own:
                if not 0 <= f < len(rows[i]):
                    raise TutorialError(f"pose_strip: frame {f} of row {i}, expected 0 to {len(rows[i]) - 1}")
        return each, []
    shared = _shared_frames(rows, frames)
    return [[_at(m, f / rows[0].fps) for f in shared] for m in rows], shared


def _shared_frames(rows: Sequence[Motion], frames: int | Sequence[int]) -> list[int]:
    last = round(max((len(m) - 1) / m.fps for m in rows) * rows[0].fps)
    if isinstance(frames, (int, np.integer)):
        if frames < 1:
            raise TutorialError(f"pose_strip: {frames} frames, expected at least one")
        return sorted(set(np.linspace(0, last, int(frames)).round().astype(int).tolist()))
    chosen = [int(f) for f in frames]
    for f in chosen:
        if not 0 <= f <= last:
            raise TutorialError(f"pose_strip: frame {f}, expected 0 to {last}")
    if not chosen:
        raise TutorialError("pose_strip: an empty list of frames, expected at least one")
    return chosen


def _at(motion: Motion, seconds: float) -> int | None:
    """The frame at a time, None after the end."""
    frame = round(seconds * motion.fps)
    return frame if frame < len(motion) else None


def outlines(motion: Motion, body: Body, frame: int | None, azimuth: float) -> list[tuple[int, list[np.ndarray]]]:
    """Polygons (N, 2), in metres, of one pose seen from the side, far parts first: [(side, polygons), ...]."""
    if frame is None:
        return []
    at = motion.positions[frame]
    at = at - (at[body.root, 0], ground_height(motion, body), at[body.root, 2])
    c, s = np.cos(azimuth), np.sin(azimuth)
    flat = np.stack([c * at[:, 0] - s * at[:, 2], at[:, 1]], axis=1)
    near = s * at[:, 0] + c * at[:, 2]
    parts = []
    for i, bones in enumerate(body.groups):
        if not bones:
            continue
        shapes = [_capsule(flat[a], body.radius[a], flat[b], body.radius[b]) for a, b in bones]
        if i == 0 and body.torso:
            corners, r = flat[list(body.torso)], 0.026 * body.height
            shapes += [corners] + [_capsule(corners[k], r, corners[(k + 1) % 4], r) for k in range(4)]
        parts.append((near[[b for _, b in bones]].mean(), body.side[bones[0][1]], shapes))
    if body.head:
        a, b, k, r = body.head
        centre = flat[b] + k * (flat[b] - flat[a])
        parts.append((near[b] + 0.05 * body.height, 0, [_capsule(centre, r, centre, r)]))
    return [(side, shapes) for _, side, shapes in sorted(parts, key=lambda part: part[0])]


def _capsule(a: np.ndarray, r: float, b: np.ndarray, s: float, corners: int = 16) -> np.ndarray:
    """The outline (N, 2) of a limb: circles of radius r about a and s about b, and what lies between."""
    d = b - a
    length = float(np.hypot(*d))
    turn = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    if length <= abs(r - s):
        a, r = (a, r) if r > s else (b, s)
        return a + r * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    angle, half = np.arctan2(d[1], d[0]), np.arccos((r - s) / length)
    one = np.linspace(angle + half, angle - half + 2 * np.pi, corners // 2)
    two = np.linspace(angle - half, angle + half, corners // 2)
    return np.concatenate(
        [a + r * np.stack([np.cos(one), np.sin(one)], 1), b + s * np.stack([np.cos(two), np.sin(two)], 1)]
    )


def extent(poses: Sequence[list], axis: int) -> tuple[float, float]:
    """From where to where poses as ``outlines`` gives them reach, along x (0) or upwards (1), metres."""
    points = np.concatenate([shape[:, axis] for pose in poses for _, shapes in pose for shape in shapes])
    return float(points.min()), float(points.max())


def draw_pose(
    axes: Axes, pose: list[tuple[int, list[np.ndarray]]], tones: Sequence[str], x: float, *, order: float = 0.0,
    rim: str = "white",
) -> None:  # fmt: skip
    """Draw what ``outlines`` gave with its middle at ``x``, in tones for the body's middle, left and right.

    order: of several poses on one spot the higher ones are in front; rim: the colour that sets its parts off.
    """
    from matplotlib.collections import PolyCollection

    for part, (side, shapes) in enumerate(pose):
        moved = [shape + (x, 0) for shape in shapes]
        for z, style in ((0.0, {"edgecolors": rim, "linewidths": 1.6}), (0.5, {"edgecolors": "none"})):
            axes.add_collection(PolyCollection(moved, facecolors=tones[side], zorder=1 + order + part + z, **style))
