"""Colours that everybody can tell apart: the palette of Okabe and Ito (2008), used by player, strips and plots."""

from __future__ import annotations

BLUE = "#0072B2"
VERMILLION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREY = "#5A5F66"

#: One colour a motion or curve, in this order, then from the start again.
COLORS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
#: Frames that a network was given, before its own: no hue, so that it goes with every colour above.
SEED = GREY
#: The player's background and the grid's major and minor lines, on a light page and on a dark one.
LIGHT_SCENE = ("#fbfcfe", "#d3dae3", "#eaeef3")
DARK_SCENE = ("#161a20", "#343c47", "#222830")


def color(index: int) -> str:
    """The colour of the motion or curve with this index, as ``"#rrggbb"``."""
    return COLORS[index % len(COLORS)]


def mix(first: str, second: str, amount: float) -> str:
    """``first`` with the share ``amount`` (0 to 1) of ``second`` in it; all colours as ``"#rrggbb"``."""
    pairs = zip(bytes.fromhex(first[1:]), bytes.fromhex(second[1:]), strict=True)
    return "#" + bytes(round(a + amount * (b - a)) for a, b in pairs).hex()


def sides(base: str) -> tuple[str, str, str]:
    """Tones of one colour for the middle of a body, its left (lighter) and its right (darker)."""
    return base, mix(base, "#ffffff", 0.35), mix(base, "#000000", 0.28)
