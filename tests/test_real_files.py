"""Every real clip that there is: it reads, and pybvh places its joints in the same spots."""

from __future__ import annotations

import warnings

import numpy as np
import pybvh
import pytest

from tutorial_lib.motion import read_amc, read_asf, read_motion
from tutorial_lib.motion.files import file_info


def pybvh_positions(path) -> np.ndarray | None:
    """``(T, J, 3)`` in the file's unit, None where pybvh does not read the file (it refuses position channels
    below the root)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            clip = pybvh.read_bvh_file(path)
        except ValueError:
            return None
        return clip.node_positions()


def test_every_bvh_file_reads_and_agrees_with_pybvh(real_clips):
    paths = real_clips("**/*.bvh")
    compared = 0
    for path in paths:
        info = file_info(path)
        motion = info.motion
        assert info.unit.startswith("cm (guessed") and info.up.startswith("y (guessed"), path
        assert 1.2 < motion.height < 1.9 and motion.fps in (30, 120), path
        assert len(info.lines()) == 9 and not any("not one that is known" in line for line in info.lines()), path
        want = pybvh_positions(path)
        if want is None:
            assert "bandai-namco" in path.parts, path
            continue
        compared += 1
        assert want.shape == motion.positions.shape, path
        assert np.abs(want - motion.positions * 100).max() < 1e-3, path  # cm
    assert compared


def test_bandai_namco_moves_its_second_joint(real_clips):
    """joint_Root stays where it is; Hips, below it, has the translation, and every bone has position channels."""
    for path in real_clips("bandai-namco/**/*.bvh")[::40]:
        motion = read_motion(path)
        s = motion.skeleton
        assert s.names[:2] == ("joint_Root", "Hips") and len(s.joints) == 22
        assert np.ptp(motion.positions[:, 0], axis=0).max() < 1e-9
        assert np.ptp(motion.positions[:, 1], axis=0).max() > 0.2
        assert 0.6 < np.median(motion.positions[:, 1, 1]) < 1.2  # the hips' height above the ground
        # the bones themselves are rigid: their position channels repeat one vector
        length = np.linalg.norm(motion.positions[:, s.bones[1:, 0]] - motion.positions[:, s.bones[1:, 1]], axis=-1)
        assert np.ptp(length, axis=0).max() < 1e-3


def test_every_asf_amc_file_reads(real_clips):
    for path in real_clips("cmu/asfamc/**/*.asf"):
        asf = read_asf(path)
        assert len(asf.bones) == 30 and asf.unit == pytest.approx(0.0254 / 0.45)
    for path in real_clips("cmu/asfamc/**/*.amc"):
        motion = read_amc(path)
        frames = sum(line.strip().isdigit() for line in path.read_text().splitlines())
        assert len(motion) == frames and motion.fps == 120
        assert 0.5 < np.median(motion.positions[:, 0, 1]) < 1.2  # metres, not inches and not 0.45 of them
        lowest = motion.positions[:, :, 1].min(1)
        assert -0.15 < np.median(lowest) < 0.15  # it stands on the ground
