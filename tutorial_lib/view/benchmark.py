"""How big and how fast the player is: ``python -m tutorial_lib.view.benchmark``.

Sizes and build times are measured here; opening, decoding and frames a second in a headless Chromium without
a GPU, where one is found. Beside them stands matplotlib's ``to_jshtml``, measured on a short clip.
"""

from __future__ import annotations

import argparse
import base64
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..errors import TutorialError
from ..motion.clip import Motion
from ..motion.files import read_motion
from ..motion.rotations import quat_from_axis_angle
from ..motion.skeleton import Skeleton
from .player import Player

FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
PLAYER = "document.querySelector('[data-motion-player]').player"


# Every so manieth frame of a figure's decoded positions: float32, base64.
_POSITIONS = f"""([i, every]) => {{
  const c = {PLAYER}.characters[i], n = c.pose.length, frames = [];
  for (let f = 0; f < c.frames; f += every) frames.push(...c.positions.subarray(f * n, (f + 1) * n));
  const bytes = new Uint8Array(Float32Array.from(frames).buffer);
  let text = '';
  for (let k = 0; k < bytes.length; k += 8192) text += String.fromCharCode(...bytes.subarray(k, k + 8192));
  return btoa(text);
}}"""
_BELOW = "document.body.insertAdjacentHTML('beforeend', '<div style=height:5000px></div>'); scrollTo(0, 4000)"


def find_chromium() -> str | None:
    """Path of an installed Chromium or Chrome, or None."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@contextmanager
def open_chromium() -> Iterator[Any]:
    """A headless Chromium (a playwright ``Browser``); ``TutorialError`` where it or playwright is missing."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise TutorialError("no browser: playwright is not installed") from error
    path = find_chromium()
    if path is None:
        raise TutorialError("no browser: found neither chromium, chromium-browser nor google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


def stand_in(frames: int, fps: float = 30.0, seed: int = 0) -> Motion:
    """A figure of 57 nodes, fingers and all, that moves as restlessly as a dancer: noise below 3 Hz, and jitter."""
    names, parents, offsets = ["Hips"], [-1], [(0.0, 0.0, 0.0)]

    def grow(name: str, parent: str, *offset: float) -> None:
        names.append(name)
        parents.append(names.index(parent))
        offsets.append(offset)

    for name, parent, y in (
        ("Spine", "Hips", 0.1),
        ("Chest", "Spine", 0.2),
        ("Neck", "Chest", 0.2),
        ("Head", "Neck", 0.1),
    ):
        grow(name, parent, 0, y, 0)
    grow("Head_end", "Head", 0, 0.2, 0)
    for side, s in (("Left", 1), ("Right", -1)):
        grow(f"{side}Shoulder", "Chest", 0.05 * s, 0.15, 0)
        for name, parent, x in (
            ("Arm", "Shoulder", 0.13),
            ("ForeArm", "Arm", 0.28),
            ("Hand", "ForeArm", 0.25),
        ):
            grow(side + name, side + parent, x * s, 0, 0)
        for finger in range(5):
            grow(f"{side}Finger{finger}A", f"{side}Hand", 0.08 * s, 0, 0.02 * (2 - finger))
            grow(f"{side}Finger{finger}B", f"{side}Finger{finger}A", 0.04 * s, 0, 0)
            grow(f"{side}Finger{finger}C", f"{side}Finger{finger}B", 0.03 * s, 0, 0)
        grow(f"{side}UpLeg", "Hips", 0.1 * s, -0.05, 0)
        grow(f"{side}Leg", f"{side}UpLeg", 0, -0.42, 0)
        grow(f"{side}Foot", f"{side}Leg", 0, -0.4, 0)
        grow(f"{side}Toe", f"{side}Foot", 0, -0.06, 0.12)
        grow(f"{side}Toe_end", f"{side}Toe", 0, 0, 0.06)
    grow("Jaw", "Head", 0, 0.03, 0.08)
    grow("LeftEye", "Head", 0.03, 0.09, 0.09)
    grow("RightEye", "Head", -0.03, 0.09, 0.09)
    skeleton = Skeleton(tuple(names), tuple(parents), np.array(offsets))
    rng = np.random.default_rng(seed)
    seconds = np.arange(frames) / fps

    def wander(channels: int, size: float) -> np.ndarray:
        rate, phase = rng.uniform(0.1, 3.0, (2, 6, channels)) * np.array([1.0, 2.0])[:, None, None]
        waves = np.sin(2 * np.pi * rate * seconds[:, None, None] + phase) / rate**0.7
        return size * waves.sum(1) + rng.normal(scale=0.002 * size, size=(frames, channels))

    angles = wander(3 * len(names), 0.12).reshape(frames, -1, 3)
    size = np.linalg.norm(angles, axis=-1)
    rotations = quat_from_axis_angle(angles / np.maximum(size, 1e-12)[..., None], size)
    path = wander(3, 0.1) * (1, 0.2, 1) + (0, 0.95, 0)
    return Motion.from_rotations(skeleton, fps, path, rotations, name="stand-in")


def decoded_error(page: Any, player: Player) -> float:
    """Largest distance (m) between a joint as the page decoded it and as it was, over about 500 frames each."""
    worst = 0.0
    for i, motion in enumerate(player.motions):
        every = max(1, len(motion) // 500)
        text = page.evaluate(_POSITIONS, [i, every])
        seen = np.frombuffer(base64.b64decode(text), np.float32).reshape(-1, motion.positions.shape[1], 3)
        distance = np.linalg.norm(seen + motion.positions[0, 0] - motion.positions[::every], axis=-1)
        worst = max(worst, float(distance.max()))
    return worst


def in_browser(browser: Any, player: Player, seconds: float) -> dict[str, float]:
    """Open a saved player: seconds to its first picture, decoding error, frames a second, ms a drawing."""
    with tempfile.TemporaryDirectory() as folder:
        path = player.save(pathlib.Path(folder) / "player.html")
        page = browser.new_page(viewport={"width": 900, "height": 700})
        start = time.perf_counter()
        page.goto(path.as_uri())
        page.evaluate(f"{PLAYER}.ready")
        opened = time.perf_counter() - start
        error = decoded_error(page, player)
        page.evaluate(f"{PLAYER}.play()")
        page.wait_for_timeout(700)
        count = f"[{PLAYER}.drawn, performance.now()]"
        first, since = page.evaluate(count)
        page.wait_for_timeout(1000 * seconds)
        last, until = page.evaluate(count)
        draw = page.evaluate(f"{PLAYER}.drawMs")
        page.evaluate(_BELOW)
        page.wait_for_timeout(400)
        hidden = page.evaluate(f"{PLAYER}.drawn")
        page.wait_for_timeout(600)
        idle = page.evaluate(f"{PLAYER}.drawn") - hidden
        page.close()
    return {"open s": opened, "error mm": 1000 * error, "frames/s": 1000 * (last - first) / (until - since),
            "draw ms": draw, "off-screen frames": idle}  # fmt: skip


def jshtml(motion: Motion, frames: int = 30) -> tuple[float, float]:
    """Seconds and bytes that matplotlib's ``to_jshtml`` takes for the first ``frames`` frames."""
    from matplotlib.animation import FuncAnimation
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.2))
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    low, high = motion.positions[:frames].min((0, 1)), motion.positions[:frames].max((0, 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[2], high[2]), zlim=(low[1], high[1]))
    lines = [axes.plot([], [], [])[0] for _ in motion.skeleton.bones]

    def draw(f: int) -> list:
        for line, bone in zip(lines, motion.skeleton.bones, strict=True):
            x, y, z = motion.positions[f, bone].T
            line.set_data_3d(x, z, y)
        return lines

    start = time.perf_counter()
    page = FuncAnimation(figure, draw, frames=frames, interval=1000 / motion.fps).to_jshtml()
    return time.perf_counter() - start, len(page)


def _fresh_build(frames: int) -> float:
    """Seconds of the first build in a process of its own, imports of matplotlib and PIL among them."""
    code = (
        "import time; from tutorial_lib.view.benchmark import stand_in; from tutorial_lib.view import show;"
        f"m = stand_in({frames}); t = time.perf_counter(); p = show(m); p.html; p.png; print(time.perf_counter() - t)"
    )
    env = dict(
        os.environ,
        PYTHONPATH=os.pathsep.join(
            filter(None, [str(pathlib.Path(__file__).parents[2]), os.environ.get("PYTHONPATH")])
        ),
    )
    return float(
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, env=env).stdout
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; ``--help`` says what can be chosen."""
    parser = argparse.ArgumentParser(prog="python -m tutorial_lib.view.benchmark", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--motion",
        metavar="FILE",
        help="a motion file, repeated as often as needed, for the 57-node stand-in",
    )
    parser.add_argument("--frames", type=int, default=18000, help="frames of the long clip (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=3.0, help="how long each player plays (default: %(default)s)")
    parser.add_argument("--no-matplotlib", action="store_true", help="leave out to_jshtml")
    options = parser.parse_args(arguments)

    def clip(frames: int, at: int = 0) -> Motion:
        if not options.motion:
            return stand_in(frames, seed=at)
        read = clip.read = getattr(clip, "read", None) or read_motion(options.motion)
        positions = np.resize(np.roll(read.positions, -40 * at, axis=0), (frames, *read.positions.shape[1:]))
        return Motion(read.skeleton, read.fps, positions, name=read.name)

    try:
        long = clip(options.frames)
        cases = [
            (f"1 figure, {options.frames:,} frames", [long], {}),
            ("1 figure, 300 frames", [clip(300)], {}),
            ("4 figures with ghosts, 1,800 frames", [clip(1800, i) for i in range(4)], {"ghosts": True}),
            ("16 figures, 600 frames", [clip(600, i) for i in range(16)], {}),
        ]
        players = []
        print(f"{long.n_frames:,} frames at {long.fps:g} a second, {long.skeleton.n_joints} nodes ({long.name})\n")
        print(f"{'':36} {'build s':>8} {'MB':>8}")
        for name, motions, choices in cases:
            start = time.perf_counter()
            player = Player(motions, **choices)
            size = len(player.html)
            built = time.perf_counter() - start
            start = time.perf_counter()
            strip = f"film strip {len(player.png) / 1e3:.0f} kB, {time.perf_counter() - start:.2f} s"
            print(f"{name:36} {built:8.2f} {size / 1e6:8.3f}   {strip} more")
            players.append((name, player))
        if not options.motion:
            print(
                f"{'the first, in a fresh process':36} {_fresh_build(options.frames):8.2f}   with its strip and imports"
            )
        if not options.no_matplotlib:
            frames = min(30, len(long))
            seconds, size = jshtml(long, frames)
            times = len(long) / frames
            short, long_name = f"to_jshtml, {frames} frames (measured)", f"to_jshtml, {len(long):,} frames"
            print(f"{short:36} {seconds:8.2f} {size / 1e6:8.3f}")
            print(f"{long_name:36} {seconds * times:8.0f} {size * times / 1e6:8.0f}   extrapolated, not run")
        print()
        with open_chromium() as browser:
            heads = ("open s", "error mm", "frames/s", "draw ms", "off-screen")
            print(f"{f'Chromium {browser.version}, no GPU':36} " + "{:>8} {:>9} {:>9} {:>8} {:>11}".format(*heads))
            for name, player in players:
                values = in_browser(browser, player, options.seconds).values()
                print("{:36} {:8.2f} {:9.3f} {:9.1f} {:8.2f} {:11d}".format(name, *values))
    except TutorialError as error:
        print(f"error: {error}" if "no browser" not in str(error) else f"not measured in a browser: {error}")
        return 0 if "no browser" in str(error) else 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
