"""The picture at the top of the README: ``python docs/moving.py`` writes docs/moving.gif, from shipped weights alone.

Three networks, each in its own colour: one that was always fed the truth in training, and stops; one that was
auto-conditioned, and trained longer, and does not; and one that walks a figure of eight. All as they were generated,
on the floor.
"""

from __future__ import annotations

import argparse
import pathlib

from PIL import Image, ImageDraw, ImageFont

from tutorial_lib import pretrained
from tutorial_lib.atomic import atomic_write
from tutorial_lib.cleanup import grounded
from tutorial_lib.generate import generate
from tutorial_lib.motion import Motion
from tutorial_lib.motion.ground import prepared_path
from tutorial_lib.view import palette
from tutorial_lib.view.body import describe, facing
from tutorial_lib.view.strip import outlines
from tutorial_lib.walk import walk

OUT = pathlib.Path(__file__).with_name("moving.gif")
FRAMES, FPS = 112, 12.5  # a GIF counts in hundredths of a second
START = 8.0  # seconds after the seed: the first of the three has four left
WIDTH, HEIGHT, FINER = 220, 204, 3  # pixels of a cell, and how much finer it is drawn before it is made small
METRES = 2.15  # up a cell
INK, GROUND = "#24292f", "#c3cad3"


def networks() -> list[tuple[str, str, Motion]]:
    """A caption, a colour and a motion for each cell."""
    seconds = START + FRAMES / FPS
    cells = []
    for name, caption, color in (
        ("lstm-cmu-martial", "always fed the truth: it freezes", palette.VERMILLION),
        ("aclstm-cmu-martial", "auto-conditioned: it goes on", palette.BLUE),
    ):
        made = generate(pretrained.load(name), round(30 * seconds), seed=3).without_seed()[0]
        cells.append((caption, color, grounded(made)))
    eight = walk(pretrained.load("vae-lstm-cmu"), prepared_path("figure of eight"), 1.3, seed=1)[0]
    return [*cells, ("control: it walks a path", palette.GREEN, eight)]


def cell(caption: str, color: str, motion: Motion, second: float, azimuth: float, font) -> Image.Image:
    """One pose on its ground, seen from the side."""
    image = Image.new("RGB", (WIDTH * FINER, HEIGHT * FINER), "white")
    draw = ImageDraw.Draw(image)
    scale = HEIGHT * FINER / METRES
    floor = (HEIGHT - 30) * FINER
    draw.line([(0, floor), (WIDTH * FINER, floor)], fill=GROUND, width=FINER)
    body = describe(motion)
    frame = round(second * motion.fps) % len(motion)
    for side, shapes in outlines(motion, body, frame, azimuth):
        for shape in shapes:
            points = [(WIDTH * FINER / 2 + x * scale, floor - y * scale) for x, y in shape]
            draw.polygon(points, fill=palette.sides(color)[side])
    draw.text((WIDTH * FINER / 2, floor + 15 * FINER), caption, fill=INK, font=font, anchor="mm")
    return image.resize((WIDTH, HEIGHT), Image.LANCZOS)


def colors_of(bases: list[str]) -> Image.Image:
    """All tones that are drawn, and each half way to white for the edges: fewer would mix the figures' colours."""
    tones = [INK, *(tone for base in bases for tone in palette.sides(base))]
    tones = ["#ffffff", GROUND, *tones, *(palette.mix(tone, "#ffffff", 0.5) for tone in tones)]
    image = Image.new("P", (1, 1))
    image.putpalette(b"".join(bytes.fromhex(tone[1:]) for tone in tones))
    return image


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    font = ImageFont.load_default(12 * FINER)
    cells = networks()
    azimuths = [facing(motion, describe(motion)) + 0.6 for _, _, motion in cells]
    pictures = []
    for k in range(FRAMES):
        picture = Image.new("RGB", (WIDTH * len(cells), HEIGHT), "white")
        for i, ((caption, color, motion), azimuth) in enumerate(zip(cells, azimuths, strict=True)):
            start = START if i < 2 else 0.0
            picture.paste(cell(caption, color, motion, start + k / FPS, azimuth, font), (i * WIDTH, 0))
        pictures.append(picture)
    colors = colors_of([color for _, color, _ in cells])
    small = [picture.quantize(palette=colors, dither=Image.Dither.NONE) for picture in pictures]
    with atomic_write(OUT) as temporary:
        small[0].save(
            temporary, "GIF", save_all=True, append_images=small[1:], duration=round(1000 / FPS), loop=0, optimize=True
        )
    print(f"wrote {OUT} ({OUT.stat().st_size / 1000:.0f} kB)")


if __name__ == "__main__":
    main()
