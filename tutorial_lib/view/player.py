"""``show``: a motion that moves in the page, without a kernel and without a network.

The player is ``player.js``, drawn on a 2D canvas. Its output is one self-contained piece of HTML; before it
goes a film strip as a picture of its own, for pages in which no script may run.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..chance import is_real
from ..errors import TutorialError
from ..motion.clip import Motion
from . import palette
from .body import Body, describe, facing, footprints, ground_height
from .codec import STEP, encode_positions
from .page import PageOutput, filled_element, page_file
from .strip import as_motions, as_seed_frames, film_strip_png, one_each

LAYOUTS = ("side by side", "overlay", "as is")
GHOST_TIMES = (-0.6, -0.4, -0.2, 0.2)  # seconds from the frame shown
KEYS = """Space  play, pause
← →  one frame (Shift: one second)
Home End  first, last frame
, .  slower, faster    + −  zoom
f follow  g ghosts  t trails  l loop  o overlay
r  reset the view
drag  orbit    Shift + drag, two fingers  move
wheel (after a click), pinch  zoom"""
_HINT = "The moving figure needs its script: open this notebook as a trusted one, or in a browser."


def show(
    motions: Motion | Sequence[Motion],
    *,
    labels: Sequence[str] | str | None = None,
    seed_frames: int | Sequence[int] = 0,
    ghosts: bool | Sequence[float] = False,
    layout: str = "side by side",
    overlay: bool = False,
    follow: bool = True,
    trails: bool = True,
    loop: bool = True,
    speed: float = 1.0,
    autoplay: bool = False,
    colors: Sequence[str] | None = None,
    title: str = "",
    width: int = 720,
    height: int = 420,
    strip: bool = True,
) -> Player:
    """A player for one motion or several, to be the last line of a cell, or to be saved with ``.save(path)``.

    Motions may differ in skeleton, length and frame rate: they run by the second, a shorter one holds its
    last frame, and frames are counted, from 0, at the rate of the first.

    labels: a name for each; without, the motions' own names.
    seed_frames: how many frames at the start were given to a network; they have a colour of their own.
        One number for all, or one for each.
    ghosts: faint figures before and after the frame shown; True, or their times in seconds from it.
    layout: ``"side by side"`` (each starts from its own spot in a row along x), ``"overlay"`` (all start
        from one spot, all but the first translucent; ``overlay=True`` says the same), or ``"as is"``.
    follow: the camera goes along; trails: footprints, and the last second of the feet's way.
    speed: 1 is as it was; autoplay: start without being asked.
    colors: ``"#rrggbb"`` for each motion; width, height: of the player, in pixels of the page.
    strip: put a film strip (PNG) before the player, for pages where no script runs.

    A motion that does not stand on y = 0 is drawn standing on the grid. Raises ``TutorialError`` for
    anything that is not a motion, and for labels, seed frames or colours that do not fit their number.
    """
    return Player(
        motions, labels=labels, seed_frames=seed_frames, ghosts=ghosts, layout="overlay" if overlay else layout,
        follow=follow, trails=trails, loop=loop, speed=speed, autoplay=autoplay, colors=colors, title=title,
        width=width, height=height, strip=strip,
    )  # fmt: skip


class Player(PageOutput):
    """What ``show`` returns: displays itself in a notebook, ``html`` is its page part, ``save`` writes a page.

    ``spec`` (JSON-able) and ``payload`` (bytes) are what ``mount`` in ``player.js`` takes. ``step`` is the
    payload's resolution in metres (see ``codec``); all else is ``show``'s.
    """

    def __init__(
        self,
        motions: Motion | Sequence[Motion],
        *,
        labels: Sequence[str] | str | None = None,
        seed_frames: int | Sequence[int] = 0,
        ghosts: bool | Sequence[float] = False,
        layout: str = "side by side",
        follow: bool = True,
        trails: bool = True,
        loop: bool = True,
        speed: float = 1.0,
        autoplay: bool = False,
        colors: Sequence[str] | None = None,
        title: str = "",
        width: int = 720,
        height: int = 420,
        strip: bool = True,
        step: float = STEP,
    ):
        self.motions = as_motions(motions)
        count = len(self.motions)
        if labels is None:
            labels = [m.name or "motion" for m in self.motions]
            if len(set(labels)) < count:
                labels = [str(i + 1) for i in range(count)]
        self.labels = [str(x) for x in one_each([labels] if isinstance(labels, str) else labels, count, "labels")]
        self.seed_frames = as_seed_frames(seed_frames, count)
        if colors is None:
            colors = [palette.color(i) for i in range(count)]
        self.colors = one_each(colors, count, "colors")
        if layout not in LAYOUTS:
            raise TutorialError(f"show: layout {layout!r}, expected one of {', '.join(map(repr, LAYOUTS))}")
        for what, value in (("speed", speed), ("width", width), ("height", height)):
            if not (is_real(value) and math.isfinite(value) and value > 0):
                raise TutorialError(f"show: {what} {value!r}, expected a number above zero")
        try:
            times = GHOST_TIMES if isinstance(ghosts, bool) else tuple(float(t) for t in ghosts)
            if not all(map(math.isfinite, times)):
                raise ValueError
        except (TypeError, ValueError):
            raise TutorialError(f"show: ghosts {ghosts!r}, expected True, False or seconds") from None
        self.picture = strip
        first = self.motions[0]
        length = max((len(m) - 1) / m.fps for m in self.motions)
        bodies = [describe(m) for m in self.motions]
        tallest = max(body.height for body in bodies)
        self.title = title or f"{', '.join(self.labels)}: {round(length * first.fps) + 1} frames, {length:.1f} s"
        self.spec: dict[str, Any] = {
            "title": self.title,
            "fps": first.fps,
            "frames": round(length * first.fps) + 1,
            "width": int(width),
            "height": int(height),
            "style": page_file("player.css"),
            "keys": KEYS,
            "start": {
                "azimuth": _azimuth(first, bodies[0], count),
                "speed": speed,
                "loop": bool(loop),
                "follow": bool(follow),
                "trails": bool(trails),
                "ghosts": ghosts is not False,
                "overlay": layout == "overlay",
            },
            "autoplay": bool(autoplay),
            "ghostTimes": list(times),
            "scene": [palette.LIGHT_SCENE, palette.DARK_SCENE],
            "tones": [_tones(palette.SEED)],
            "bodies": [],
            "characters": [],
        }
        payload = bytearray()
        starts = [m.positions[0, body.root] for m, body in zip(self.motions, bodies, strict=True)]
        right = math.copysign(1, math.cos(self.spec["start"]["azimuth"]))  # as seen: the first stands on the left
        spots = _spots(starts, layout, 0.85 * tallest * right)
        for motion, body, label, color, seed, start, spot in zip(
            self.motions, bodies, self.labels, self.colors, self.seed_frames, starts, spots, strict=True
        ):
            encoded = encode_positions(motion.positions, motion.skeleton.parents, step=step)
            drawn = _body_spec(body, motion.skeleton.parents)
            if drawn not in self.spec["bodies"]:
                self.spec["bodies"].append(drawn)
            tones = _tones(color)
            if tones not in self.spec["tones"]:
                self.spec["tones"].append(tones)
            x, y, z = encoded.origin
            self.spec["characters"].append({
                "name": label,
                "tones": self.spec["tones"].index(tones),
                "fps": motion.fps,
                "frames": encoded.frames,
                "seed": seed,
                "step": encoded.step,
                "spot": spot,
                "shift": [round(v, 5) for v in (x - start[0], y - ground_height(motion, body), z - start[2])],
                "bytes": [len(payload), len(payload) + len(encoded.data)],
                "body": self.spec["bodies"].index(drawn),
                "prints": [[side, a, b, *(round(v, 2) for v in (hx - x, hz - z, tx - x, tz - z))]
                           for side, a, b, hx, hz, tx, tz in footprints(motion, body)],
            })  # fmt: skip
            payload += encoded.data
        self.payload = bytes(payload)

    @functools.cached_property
    def png(self) -> bytes:
        """The film strip, a PNG file's bytes."""
        return film_strip_png(self.motions, labels=self.labels, seed_frames=self.seed_frames, colors=self.colors)

    @functools.cached_property
    def html(self) -> str:
        """Self-contained HTML: an element and the script that fills every copy of it on the page."""
        return filled_element("player", "mount", self.spec, self.payload, scripts=["page.js", "player.js"], hint=_HINT)

    @property
    def alt(self) -> str:
        """What the film strip shows, in words."""
        return f"Film strip of {self.title}"

    def __repr__(self) -> str:
        return f"<Player: {self.title}>"


def _tones(color: str) -> list[tuple[str, str, str]]:
    """A colour's tones for middle, left and right on a light page, and on a dark one."""
    if not isinstance(color, str) or not re.fullmatch("#[0-9a-fA-F]{6}", color):
        raise TutorialError(f"colour {color!r}, expected six hexadecimal digits as in '#0072B2'")
    return [palette.sides(color), palette.sides(palette.mix(color, "#ffffff", 0.2))]


def _spots(starts: Sequence[np.ndarray], layout: str, step: float) -> list[tuple[float, float]]:
    """Where on the ground (x, z) each motion starts: in rows along x, or as the motions themselves say."""
    count = len(starts)
    if layout == "as is":
        return [(round(s[0] - starts[0][0], 4), round(s[2] - starts[0][2], 4)) for s in starts]
    columns = count if count <= 6 else math.ceil(math.sqrt(2 * count))
    spots = []
    for i in range(count):
        row, in_row = i // columns, min(columns, count - i // columns * columns)
        spots.append((round((i % columns - (in_row - 1) / 2) * step, 3), round(-row * step, 3)))
    return spots


def _azimuth(motion: Motion, body: Body, count: int) -> float:
    """From where to look (radians about y, 0 from +z): one figure from half the side, several across their row."""
    turn = facing(motion, body)
    if count == 1:
        return round(turn + 0.6, 3)
    return round((0.0 if math.cos(turn) >= -0.2 else math.pi) + 0.15, 3)


def _body_spec(body: Body, parents: Sequence[int]) -> dict[str, Any]:
    bones, groups = [], []
    for group in body.groups:
        groups.append((body.side[group[0][1]] if group else 0, len(bones), len(bones) + len(group)))
        bones += group
    return {
        "parents": list(parents),
        "root": body.root,
        "height": round(body.height, 3),
        "radius": [round(float(r), 4) for r in body.radius],
        "side": list(body.side),
        "bones": bones,
        "groups": groups,  # (side, first bone, end), the trunk first
        "torso": list(body.torso),
        "head": body.head and (*body.head[:2], *(round(v, 4) for v in body.head[2:])),
        "feet": list(body.feet),
    }
