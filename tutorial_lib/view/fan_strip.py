"""Many futures of one past on paper: at each moment the poses of all, one over the other, and the ways they went.

As in figure 1 of "Dynamic Future Net" (Chen et al. 2020).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import TutorialError
from ..motion.clip import Motion
from . import palette
from .body import describe, facing
from .figure import NotebookFigure
from .strip import as_motions, draw_pose, extent, outlines

_TEXT = "#24292f"


def fan_colors(count: int) -> list[str]:
    """A colour for each of ``count`` futures: the palette's, and after its end the same ones darker."""
    return [palette.mix(palette.color(i), "#000000", min(0.7, 0.35 * (i // len(palette.COLORS)))) for i in range(count)]


def fan_strip(
    motions: Motion | Sequence[Motion],
    frames: int = 7,
    *,
    seed_frames: int = 0,
    colors: Sequence[str] | None = None,
    title: str = "",
    width: float = 10.0,
) -> NotebookFigure:
    """Motions that begin alike: at ``frames`` moments, evenly spaced, all their poses on one spot; right, the ways of
    their roots along the ground, seen from above.

    seed_frames: frames at the start that all share, drawn in grey; the first moment is the last of them.
    colors: ``"#rrggbb"`` for each motion; width: inches.
    Raises ``TutorialError`` for anything that is not motions of one frame rate, or fewer than two moments.
    """
    rows = as_motions(motions)
    if len({motion.fps for motion in rows}) > 1:
        rates = " and ".join(f"{fps:g}" for fps in sorted({motion.fps for motion in rows}))
        raise TutorialError(f"fan_strip: motions at {rates} frames a second, expected one rate")
    length = min(map(len, rows))
    if not 2 <= frames <= length - max(0, seed_frames - 1):
        raise TutorialError(f"fan_strip: {frames} moments of {length} frames, {seed_frames} of them shared")
    colors = fan_colors(len(rows)) if colors is None else list(colors)
    chosen = np.linspace(max(0, seed_frames - 1), length - 1, frames).round().astype(int).tolist()
    bodies = [describe(motion) for motion in rows]
    azimuth = facing(rows[0], bodies[0]) + 0.6
    drawn = [[outlines(m, b, f, azimuth) for f in chosen] for m, b in zip(rows, bodies, strict=True)]
    poses = [pose for row in drawn for pose in row]
    left, right = extent(poses, 0)
    tall = max(body.height for body in bodies)
    cell, low, high = right - left + 0.05 * tall, min(extent(poses, 1)[0], 0) - 0.05 * tall, 1.08 * tall
    high = max(high, extent(poses, 1)[1])
    above = 0.46  # inches for the moments' names
    map_width = min(0.26 * width, 2.4)
    strip_width = width - map_width - 0.15
    scale = strip_width / (cell * frames)
    tall_strip = max((high - low) * scale, 1.2)
    total = tall_strip + above + (0.26 if title else 0.04)
    figure = NotebookFigure(figsize=(width, total), dpi=100, facecolor="white")
    axes = figure.add_axes((0, above / total, strip_width / width, tall_strip / total))
    spare = (tall_strip / scale - (high - low)) / 2
    axes.set(xlim=(0, cell * frames), ylim=(low - spare, high + spare))
    axes.axis("off")
    axes.axhline(0, color="#c3cad3", linewidth=1.2, zorder=-1000)
    for k, frame in enumerate(chosen):
        shared = frame < seed_frames
        for i, (row, color) in enumerate(zip(drawn, colors, strict=True)):  # the first in front, the others its ghosts
            tone = palette.SEED if shared else palette.mix(color, "#ffffff", 0.4 if i else 0.0)
            tones = palette.sides(tone) if shared or not i else (tone,) * 3
            draw_pose(axes, row[k], tones, (k + 0.5) * cell - (left + right) / 2, order=-20.0 * i)
        after = (frame + 1 - seed_frames) / rows[0].fps
        says = f"frame {frame}\n" + ("the past" if shared else f"{after:.1f} s later")
        figure.text((k + 0.5) * strip_width / frames / width, (above - 0.05) / total, says, ha="center", va="top",
                    fontsize=8, color=_TEXT, linespacing=1.25)  # fmt: skip
    if title:
        figure.text(0.006, 1 - 0.04 / total, title, fontsize=10, va="top", color=_TEXT, parse_math=False)
    _ways(figure.add_axes(((strip_width + 0.15) / width, above / total, (map_width - 0.1) / width, tall_strip / total)),
          rows, bodies, colors, seed_frames)  # fmt: skip
    return figure


def _ways(axes, rows, bodies, colors, seed_frames) -> None:
    """Where the roots went, each from where its past ended: forwards at that moment is up."""
    at = max(0, seed_frames - 1)
    for motion, body, color in zip(rows, bodies, colors, strict=True):
        way = motion.positions[:, body.root, [0, 2]] - motion.positions[at, body.root, [0, 2]]
        turn = facing(motion[at : at + 1], body)
        c, s = np.cos(turn), np.sin(turn)
        across, ahead = c * way[:, 0] - s * way[:, 1], s * way[:, 0] + c * way[:, 1]
        axes.plot(-across[: at + 1], ahead[: at + 1], color=palette.SEED, linewidth=2, zorder=3)
        axes.plot(-across[at:], ahead[at:], color=color, linewidth=1.3)
        axes.scatter(-across[-1:], ahead[-1:], s=10, color=color, zorder=3)
    low, high = axes.get_ylim()
    span = max(1.0, high - low, np.ptp(axes.get_xlim()))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xticks([])
    axes.set_yticks([])
    metre = 1.0 if span > 2 else 0.5
    x, y = axes.get_xlim()[0], axes.get_ylim()[0]
    axes.plot([x, x + metre], [y, y], color=palette.GREY, linewidth=2, solid_capstyle="butt", clip_on=False)
    axes.annotate(f"{metre:g} m, seen from above", (x, y), xytext=(0, -4), textcoords="offset points", fontsize=7.5,
                  va="top", color=palette.GREY, annotation_clip=False)  # fmt: skip
    axes.spines[:].set_visible(False)
