"""What the tests share: the real clips where there are some, a small random skeleton, quiet defaults."""

from __future__ import annotations

import os
import pathlib

import numpy as np
import pytest

from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.motion.rotations import quat_normalize
from tutorial_lib.threads import torch_threads


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Sums are in the same order in every process, and tests do not slow down beside other load."""
    with torch_threads(1):
        yield


@pytest.fixture(scope="session")
def real_data() -> pathlib.Path:
    """The folder of real clips that TUTORIAL_DATA names; tests that need one are skipped without."""
    folder = os.environ.get("TUTORIAL_DATA")
    if not folder:
        pytest.skip("TUTORIAL_DATA is not set: no real clips here")
    return pathlib.Path(folder)


@pytest.fixture(scope="session")
def real_clips(real_data):
    """``real_clips("cmu/walking/*.bvh")``: the real files of that name, at least one; the test is skipped without.

    Which clips a folder holds is its owner's business: a test names the kind, not the file.
    """

    def find(pattern: str) -> list[pathlib.Path]:
        return sorted(real_data.glob(pattern)) or pytest.skip(f"no {pattern} in TUTORIAL_DATA")

    return find


@pytest.fixture
def small_skeleton() -> Skeleton:
    """Seven nodes, three of them end sites, three Euler orders."""
    return Skeleton(
        ("root", "spine", "spine_end", "leg", "shin", "shin_end", "leg_end"),
        (-1, 0, 1, 0, 3, 4, 3),
        np.array([[0, 0, 0], [0, 0.5, 0], [0, 0.3, 0.1], [0.1, -0.1, 0], [0, -0.4, 0], [0, -0.4, 0], [0.1, 0, 0]]),
        ("ZYX", "ZXY", "ZXY", "XYZ", "ZXY", "ZXY", "ZXY"),
        frozenset({2, 5, 6}),
    )


@pytest.fixture
def small_motion(small_skeleton: Skeleton) -> Motion:
    """Fifty smooth frames of the small skeleton at 30 frames a second."""
    rng = np.random.default_rng(7)
    steps = rng.normal(scale=0.05, size=(50, small_skeleton.n_joints, 4)).cumsum(0)
    steps[:, sorted(small_skeleton.end_sites)] = 0.0
    rotations = quat_normalize(steps + np.array([1.0, 0, 0, 0]))
    root = rng.normal(scale=0.02, size=(50, 3)).cumsum(0) + np.array([0.0, 0.9, 0.0])
    return Motion.from_rotations(small_skeleton, 30.0, root, rotations, name="small")


@pytest.fixture
def fails(capsys):
    """Run a command that must fail: one line on standard error, status 2; gives the line."""

    from tutorial_lib.cli import main

    def run(*arguments) -> str:
        capsys.readouterr()
        try:
            status = main([str(a) for a in arguments])
        except SystemExit as end:  # argparse
            status = end.code
        out, err = capsys.readouterr()
        lines = [
            line
            for line in err.splitlines()
            if not line.startswith(("note:", "lstm:", "generating:", "writing:", "planting feet:"))
        ]
        assert status == 2 and len(lines) == 1 and lines[0].startswith("error: "), (status, err)
        assert "Traceback" not in out + err
        return lines[0]

    return run


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium for the tests of one file; they are skipped where there is none."""
    from browser import chromium

    with chromium() as opened:
        yield opened


@pytest.fixture
def closed_afterwards(browser):
    """Pages left open would go on playing beside the next test's."""
    yield
    for context in browser.contexts:
        context.close()
