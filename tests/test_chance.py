"""Seeds: whole numbers of Python or numpy, the same chance from both, and one line for what is none."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tutorial_lib.chance import seeded
from tutorial_lib.data import synthetic
from tutorial_lib.data.windows import WindowSampler, evaluation_windows, split_clips
from tutorial_lib.errors import TutorialError
from tutorial_lib.motion.join import playlist
from tutorial_lib.representations import make_representation
from tutorial_lib.training.systems import make_system
from tutorial_lib.training.trainer import TrainingConfig


def test_numpy_seeds_are_the_same_seeds():
    assert torch.equal(torch.rand(3, generator=seeded(5)), torch.rand(3, generator=seeded(np.int64(5))))
    a, b = (make_system("lstm", 3, hidden=4, seed=seed).model.readout.weight for seed in (5, np.int64(5)))
    assert torch.equal(a, b)
    config = TrainingConfig(steps=np.int64(3), seed=np.int64(5))
    assert config == TrainingConfig(steps=3, seed=5) and type(config.steps) is type(config.seed) is int


@pytest.mark.parametrize("seed", [-1, None, 1.5, True, "7", 2**64])
def test_what_is_no_seed_is_told_in_one_line(seed, small_motion):
    representation = make_representation("positions", small_motion.skeleton, small_motion.fps)
    for attempt in (
        lambda: seeded(seed),
        lambda: make_system("lstm", 3, hidden=4, seed=seed),
        lambda: TrainingConfig(seed=seed),
        lambda: split_clips([small_motion] * 3, 0.5, seed),
        lambda: WindowSampler([small_motion], representation, length=4, batch=2, seed=seed),
        lambda: evaluation_windows([small_motion], representation, seed_frames=2, future_frames=2, count=2, seed=seed),
        lambda: playlist([small_motion], seconds=5, blend=0.1, seed=seed),
        *(
            lambda make=make: make(1.0, seed=seed)
            for make in (synthetic.walking, synthetic.running, synthetic.boxing, synthetic.dancing)
        ),
    ):
        with pytest.raises(TutorialError, match=r"the seed must be a whole number of 0 or more.*, not ") as told:
            attempt()
        assert "\n" not in str(told.value)
