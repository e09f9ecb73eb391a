"""Any motion file by its suffix, and what ``info`` tells of it."""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass

from ..errors import MotionFileError
from .asf_amc import asf_beside, read_amc
from .bvh import read_bvh_with_guess
from .clip import Motion
from .skeletons import recognise

SUFFIXES = (".bvh", ".amc")


def read_motion(path: str | os.PathLike, *, end_sites: bool = True, **options) -> Motion:
    """A ``Motion`` in metres, y up, from a ``.bvh`` file or an ``.amc`` file with its ``.asf`` beside it.

    options: what ``read_bvh`` or ``read_amc`` takes. Nothing is printed; ``file_info`` tells what was guessed.
    Raises ``MotionFileError`` for another suffix and for whatever is wrong inside.
    """
    return file_info(path, end_sites=end_sites, **options).motion


@dataclass(frozen=True)
class FileInfo:
    """What a motion file holds, and what had to be guessed to read it."""

    path: pathlib.Path
    motion: Motion
    unit: str
    up: str

    def lines(self) -> list[str]:
        """The text of ``python -m tutorial_lib info``."""
        motion, skeleton = self.motion, self.motion.skeleton
        ends = len(skeleton.end_sites)
        return [
            str(self.path),
            f"  joints     {skeleton.n_joints - ends}" + (f", and {ends} end sites" if ends else ""),
            f"  frames     {len(motion)}",
            f"  rate       {motion.fps:g} frames per second",
            f"  seconds    {motion.duration:.2f}",
            f"  height     {motion.height:.2f} m",
            f"  units      {self.unit}",
            f"  up axis    {self.up}",
            f"  skeleton   {recognise(skeleton) or 'not one that is known by name'}",
        ]


def file_info(path: str | os.PathLike, *, end_sites: bool = True, **options) -> FileInfo:
    """Read ``path`` and say what it holds; raises as ``read_motion`` does."""
    path = pathlib.Path(path)
    suffix = path.suffix.lower()
    options.pop("quiet", None)  # nothing is printed anyway
    if suffix == ".bvh":
        motion, guess = read_bvh_with_guess(path, end_sites=end_sites, **options)
        unit = guess.unit + (" (guessed from the body's size)" if guess.unit_guessed else "")
        up = guess.up + (" (guessed from the body's pose)" if guess.up_guessed else "")
        up += " (not told by the file, taken as usual)" if guess.up_assumed else ""
        return FileInfo(path, motion, unit, up)
    if suffix == ".amc":
        skeleton_file = pathlib.Path(options.pop("asf", None) or asf_beside(path))
        motion, unit = read_amc(path, skeleton_file, end_sites=end_sites, with_unit=True, **options)
        return FileInfo(path, motion, f"{unit} (from {skeleton_file.name})", "y (as CMU's files have it)")
    raise MotionFileError(path, f"suffix {path.suffix!r}, expected one of {', '.join(SUFFIXES)}")
