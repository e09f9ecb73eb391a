"""Channels that are given at synthesis: replaced exactly, read at the next step, and nothing else changed."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tutorial_lib.data.windows import Normalizer
from tutorial_lib.errors import CheckpointError, TutorialError
from tutorial_lib.generate import generate_features, given_parts, stream, synthesize
from tutorial_lib.motion.skeletons import COMMON_JOINTS
from tutorial_lib.recipes import Recipe, sets_of
from tutorial_lib.representations import make_representation
from tutorial_lib.training.checkpoints import Checkpoint
from tutorial_lib.training.conditioning import Given
from tutorial_lib.training.systems import SYSTEMS, make_system

PREDICTING = [name for name, kind in SYSTEMS.items() if kind.predicts]


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize("system", PREDICTING)
def test_given_channels_are_replaced_and_read_at_the_next_step(system, batch):
    model = make_system(system, 5, hidden=6, seed=2).model.eval()
    seed, values = random(batch, 4, 5, seed=1), random(batch, 7, 2, seed=3)
    made = synthesize(model, seed, 7, given=Given([3, 1], values))
    assert torch.equal(made[..., [3, 1]], values)
    with torch.no_grad():  # written out: predict, replace, read
        y, state = model(seed)
        for t in range(7):
            frame = y[:, -1].clone()
            frame[:, 3], frame[:, 1] = values[:, t, 0], values[:, t, 1]
            torch.testing.assert_close(made[:, t], frame, msg=lambda text, t=t: f"frame {t}: {text}")
            y, state = model(frame[:, None], state)


@pytest.mark.parametrize("system", PREDICTING)
def test_a_frame_does_not_depend_on_what_is_given_in_it(system):
    """The rest of frame t was predicted from what was given before t; the frame after it knows."""
    model = make_system(system, 5, hidden=6, seed=2).model
    seed, values = random(2, 4, 5, seed=1), random(2, 7, 2, seed=3)
    other = values.clone()
    other[:, 3] += 5.0
    one, two = (synthesize(model, seed, 7, given=Given([3, 4], v)) for v in (values, other))
    torch.testing.assert_close(one[:, :4, :3], two[:, :4, :3])
    assert not torch.allclose(one[:, 4, :3], two[:, 4, :3])


def test_own_values_given_back_change_nothing_and_a_stream_ends_with_them():
    model, seed = make_system("erd", 5, hidden=6, seed=2).model, random(2, 4, 5, seed=1)
    own = synthesize(model, seed, 7)
    torch.testing.assert_close(synthesize(model, seed, 7, given=Given([0, 2], own[..., [0, 2]])), own)
    assert len(list(stream(model, seed, given=Given([0], own[..., :1])))) == 7


@pytest.fixture(scope="module")
def checkpoint() -> Checkpoint:
    recipe = Recipe("crbm", "samples/walking", joints="common", hidden=6)
    representation = make_representation("hip-frame", sets_of(recipe)[0][0][0].skeleton, 30)
    assert representation.skeleton.names == COMMON_JOINTS
    model = make_system("crbm", representation.dim, hidden=6, seed=1).model.eval()
    normalizer = Normalizer(random(representation.dim), random(representation.dim, seed=1).abs() + 0.5)
    return Checkpoint("crbm", model, representation, normalizer, {}, {"clips": []})


def test_parts_of_a_checkpoints_representation_are_given_in_its_own_units(checkpoint):
    dim, where = checkpoint.representation.dim, checkpoint.representation.slices["control"]
    seeds, control = random(2, 4, dim, seed=5).numpy(), 9 * random(2, 6, 3, seed=6).numpy()
    made = generate_features(checkpoint, seeds, 6, given={"control": control}, seed=4)
    assert made.dtype == np.float32 and np.array_equal(made[..., where], control)
    again = generate_features(checkpoint, seeds, 6, given={"control": control}, seed=4)
    other = generate_features(checkpoint, seeds, 6, given={"control": control}, seed=5)
    assert np.array_equal(made, again) and not np.array_equal(made, other)  # a network that draws
    with torch.no_grad():  # by hand, in normalised features
        model, normalizer = checkpoint.model, checkpoint.normalizer
        y, state = model(normalizer.apply(torch.tensor(seeds)), model.start(4))
        for t in range(6):
            frame = normalizer.invert(y[:, -1])
            frame[:, where] = torch.tensor(control[:, t])
            np.testing.assert_allclose(made[:, t], frame.numpy(), rtol=1e-4, atol=1e-4)
            y, state = model(normalizer.apply(frame)[:, None], state)


def test_some_of_the_control_may_be_given(checkpoint):
    control = random(1, 5, 3, seed=6).numpy()
    seeds, slices = random(1, 4, checkpoint.representation.dim).numpy(), checkpoint.representation.slices
    made = generate_features(checkpoint, seeds, 5, given={"sideways": control[..., 2:], "turning": control[..., :1]})
    assert np.array_equal(made[..., slices["sideways"]], control[..., 2:])
    assert np.array_equal(made[..., slices["turning"]], control[..., :1])
    assert not np.allclose(made[..., slices["forward"]], control[..., 1:2])


# --- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels, shape, told", [
    ([0, 1], (2, 5, 3), r"shape \(2, 5, 3\) for 2 channels: expected \(sequences, frames, 2\)"),
    ([0, 1], (5, 2), r"shape \(5, 2\) for 2 channels"),
    ([1, 1], (2, 5, 2), "expected different numbers of 0 or more"),
    ([-1], (2, 5, 1), "expected different numbers of 0 or more"),
])  # fmt: skip
def test_what_cannot_be_given(channels, shape, told):
    with pytest.raises(TutorialError, match=told):
        Given(channels, torch.zeros(shape))


def test_what_does_not_fit_is_told(checkpoint):
    model, seed = make_system("erd", 5, hidden=6).model, random(2, 4, 5)
    holes = torch.zeros(2, 5, 1)
    holes[1, 2] = float("nan")
    with pytest.raises(TutorialError, match="not finite at frame 3"):
        Given([0], holes)
    with pytest.raises(TutorialError, match="6 frames to generate, the given channels have 5"):
        synthesize(model, seed, 6, given=Given([0], torch.zeros(2, 5, 1)))
    with pytest.raises(TutorialError, match="for 3 sequences .* the seed has 2 sequences of 5 numbers"):
        synthesize(model, seed, 5, given=Given([0], torch.zeros(3, 5, 1)))
    with pytest.raises(TutorialError, match=r"channels \[5\], the seed has"):
        synthesize(model, seed, 5, given=Given([5], torch.zeros(2, 5, 1)))
    with pytest.raises(CheckpointError, match="'hip-frame' has no 'speed': expected one of joints, control"):
        given_parts(checkpoint, {"speed": np.zeros((1, 5, 1))})
    with pytest.raises(CheckpointError, match=r"control has shape \(1, 5, 2\), expected \(sequences, frames, 3\)"):
        given_parts(checkpoint, {"control": np.zeros((1, 5, 2))})
    with pytest.raises(CheckpointError, match="1 sequences of 4 frames, what was given before it 1 of 5"):
        given_parts(checkpoint, {"turning": np.zeros((1, 5, 1)), "forward": np.zeros((1, 4, 1))})
    with pytest.raises(CheckpointError, match="nothing is given"):
        given_parts(checkpoint, {})
