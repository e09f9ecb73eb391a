"""How long reading a BVH file and its forward kinematics take, beside pybvh in the same run.

    python tests/benchmark_reading.py [FILE] [--rounds N]

Without FILE: ``cmu/indian/04.bvh`` of the folder that TUTORIAL_DATA names, else a made-up file of the same
size (57 nodes, 3,144 frames). The two take turns, so that whatever else the machine does hits both; medians
are printed. Nothing passes or fails by time: that belongs to the machine.
"""

from __future__ import annotations

import argparse
import os
import pathlib
import statistics
import tempfile
import time
import warnings

import numpy as np
import pybvh

from tutorial_lib.motion import Motion, Skeleton, read_motion, write_bvh
from tutorial_lib.motion.rotations import euler_to_quat


def made_up(path: pathlib.Path, frames: int = 3144) -> pathlib.Path:
    """A figure with as many nodes (43 joints, 14 end sites) and frames as ``cmu/indian/04.bvh``."""
    chains = (4, 4, 5, 5, 3, 3, 3, 3, 3, 3, 2, 2, 1, 1)  # joints of each limb; each ends in an end site
    names, parents, ends = ["hip"], [-1], set()
    for limb, length in enumerate(chains):
        parent = 0
        for k in range(length):
            parents.append(parent)
            parent = len(names)
            names.append(f"limb{limb}_{k}")
        ends.add(len(names))
        parents.append(parent)
        names.append(f"limb{limb}_end")
    rng = np.random.default_rng(0)
    skeleton = Skeleton(tuple(names), tuple(parents), rng.normal(scale=0.15, size=(len(names), 3)), (), frozenset(ends))
    angles = 0.5 * np.sin(np.arange(frames)[:, None, None] / 40 + rng.uniform(0, 6, (1, len(names), 3)))
    root = np.cumsum(rng.normal(scale=0.003, size=(frames, 3)), 0)
    write_bvh(Motion.from_rotations(skeleton, 120, root, euler_to_quat(angles, "ZXY")), path)
    return path


def compare(path: pathlib.Path, rounds: int) -> dict[str, float]:
    """Median seconds of each over ``rounds`` turns; prints them, their ratio and the largest difference."""

    def ours() -> np.ndarray:
        return read_motion(path, unit="cm", up="y").positions

    def theirs() -> np.ndarray:
        return pybvh.read_bvh_file(path).node_positions()

    seconds: dict[str, list[float]] = {"tutorial_lib": [], "pybvh": []}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mine, other = ours(), theirs()  # also the warm-up
        for turn in range(rounds):
            # whoever goes first finds the caches colder: that changes too
            pair = [("tutorial_lib", ours), ("pybvh", theirs)]
            for name, function in pair[:: 1 if turn % 2 else -1]:
                start = time.perf_counter()
                function()
                seconds[name].append(time.perf_counter() - start)
    median = {name: statistics.median(times) for name, times in seconds.items()}
    print(f"{path}: {mine.shape[1]} nodes, {len(mine)} frames, {path.stat().st_size / 1e6:.1f} MB, {rounds} rounds")
    for name, times in seconds.items():
        print(f"  {name:13} median {median[name]:.3f} s   (fastest {min(times):.3f}, slowest {max(times):.3f})")
    print(f"  ratio         {median['tutorial_lib'] / median['pybvh']:.2f}   (below 1: tutorial_lib is faster)")
    print(f"  difference    {np.abs(mine * 100 - other).max():.1e} cm in world joint positions")
    return median


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", nargs="?", type=pathlib.Path)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    real = pathlib.Path(os.environ.get("TUTORIAL_DATA", "")) / "cmu" / "indian" / "04.bvh"
    if options.file or (os.environ.get("TUTORIAL_DATA") and real.is_file()):
        compare(options.file or real, options.rounds)
        return
    with tempfile.TemporaryDirectory() as folder:
        compare(made_up(pathlib.Path(folder) / "made_up.bvh"), options.rounds)


if __name__ == "__main__":
    main()
