"""Motion from control: streaming without a seam, prior and posterior, which control moves the figure, bad input."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from tutorial_lib import data
from tutorial_lib.errors import CheckpointError, MotionError, TutorialError
from tutorial_lib.evaluate import evaluate
from tutorial_lib.generate import generate
from tutorial_lib.generate_control import (
    ControlStream,
    check_control,
    first_poses,
    generate_control_features,
    generate_from_control,
    posterior_code,
    prior_code,
    synthesize_control,
)
from tutorial_lib.motion import Motion
from tutorial_lib.motion.skeletons import COMMON_JOINTS
from tutorial_lib.recipes import Recipe, sets_of, trainer_for
from tutorial_lib.training.checkpoints import load_checkpoint
from tutorial_lib.training.systems import make_system

SIZES = {"control": (6, 9), "hidden": 8, "filters": 5}


def numbers(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def network(**values):
    return make_system("vae-lstm", 9, seed=0, **{**SIZES, "kernel": 7, **values}).model.eval()


@pytest.fixture(scope="module")
def clips():
    return sets_of(Recipe("vae-lstm", "samples/walking", hidden=8))[0]


@pytest.fixture(scope="module")
def checkpoint(clips, tmp_path_factory):
    """Hardly trained, but whole: what is tested here holds for any weights."""
    path = tmp_path_factory.mktemp("vae") / "walk.safetensors"
    options = {"filters": 8, "kernel": 5, "dropout": 0.0}
    recipe = Recipe("vae-lstm", "samples/walking", hidden=8, batch=64, length=40, steps=8, options=options)
    trainer_for(recipe, path, sets=[clips]).run(progress=False)
    return load_checkpoint(path)


@pytest.fixture(scope="module")
def control(checkpoint, clips):
    """Measured from a clip that was not trained on: (T, 3)."""
    representation = checkpoint.representation
    return representation.encode(clips[1][0])[:, representation.slices["control"]]


# --- streaming ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "values", [{}, {"cell": "ordinary"}, {"kernel": 25}, {"kernel": 5, "pooling": 3}, {"pooling": 1}]
)
@pytest.mark.parametrize("per_step", [False, True])
def test_pieces_are_the_whole(values, per_step):
    """Control in pieces of any size gives the frames that the network makes of all of it at once."""
    model = network(**values)
    stride = model.config.stride
    control = numbers(2, 101, 3)
    code = numbers(2, -(-101 // stride), 8) if per_step else numbers(2, 8)
    rest = control[:, -1:].expand(-1, -101 % stride, -1)  # the last control holds on
    with torch.no_grad():
        whole = model.synthesize(torch.cat((control, rest), 1), code)[:, :101]
    for chunk in (9, 64, 1000):
        torch.testing.assert_close(synthesize_control(model, control, code, chunk=chunk), whole)


def test_frames_go_out_as_soon_as_nothing_can_change_them():
    model = network()
    control, code = numbers(1, 130, 3), numbers(1, 8)
    whole = synthesize_control(model, control, code)
    stream, out = ControlStream(model, code), []
    for t in range(130):
        out.append(stream.feed(control[:, t : t + 1]))
        assert sum(part.shape[1] for part in out) == max(0, (t - stream.delay) // 4 * 4 + 4)
    torch.testing.assert_close(torch.cat((*out, stream.finish()), 1), whole)
    # the delay is needed: control that lies as far ahead changes a frame
    changed = control.clone()
    changed[:, 100:] += 1
    moved = (synthesize_control(model, changed, code) - whole).abs().amax((0, 2)) > 1e-7
    first = int(moved.nonzero()[0])
    assert 100 - stream.delay <= first <= 100 - stream.delay + 6


def test_less_overlap_would_show(monkeypatch):
    """The seams that the overlap is there against are real: with less of it, the frames are others."""
    model, control, code = network(), numbers(1, 120, 3), numbers(1, 8)
    whole = synthesize_control(model, control, code)
    stream = ControlStream(model, code)
    stream._halo = 1
    parts = [stream.feed(control[:, k : k + 20]) for k in range(0, 120, 20)]
    assert (torch.cat((*parts, stream.finish()), 1) - whole).abs().amax() > 1e-3


def test_no_joint_jumps_at_a_seam(checkpoint, control):
    """In metres and in the world: the largest step and change of step at seams is not above what is elsewhere."""
    chunk = 50
    motion = generate_from_control(checkpoint, control, chunk=chunk)[0]
    assert len(motion) == len(control)
    steps = np.diff(motion.positions, axis=0)  # (T - 1, J, 3)
    jerk = np.abs(np.diff(steps, axis=0)).max((1, 2))  # number t is about frame t + 1
    # a piece ends where the frames that are certain after so many fed ones end
    stream = ControlStream(checkpoint.model, numbers(1, 8))
    seams, total = [], 0
    for k in range(0, len(control), chunk):
        total += stream.feed(numbers(1, len(control[k : k + chunk]), 3)).shape[1]
        seams.append(total)
    at = np.unique([s for s in seams if 0 < s < len(control) - 1])
    assert len(at) >= 5
    elsewhere = np.delete(jerk, np.concatenate((at - 1, at - 2)))
    assert jerk[np.concatenate((at - 1, at - 2))].max() <= elsewhere.max()


def test_a_stream_that_is_over_takes_no_more():
    stream = ControlStream(network(), numbers(1, 8))
    with pytest.raises(TutorialError, match="without any control"):
        stream.finish()
    with pytest.raises(TutorialError, match=r"control of shape \(1, 5, 2\), expected \(1, frames, 3\)"):
        stream.feed(torch.zeros(1, 5, 2))
    stream.feed(torch.zeros(1, 5, 3))
    assert stream.finish().shape == (1, 5, 9)
    with pytest.raises(TutorialError, match="is finished"):
        stream.feed(torch.zeros(1, 5, 3))
    with pytest.raises(TutorialError, match="2 codes, one a step, for 5 steps"):
        synthesize_control(network(), torch.zeros(1, 20, 3), numbers(1, 2, 8))


# --- codes ----------------------------------------------------------------------------------------


def test_prior_codes_are_unit_gaussian_and_posterior_ones_are_not():
    model = network(hidden=64)
    generator = torch.Generator().manual_seed(0)
    code = prior_code(model, 500, generator)
    assert code.shape == (500, 64) and abs(code.mean()) < 0.02 and abs(code.std() - 1) < 0.02
    assert prior_code(model, 2, generator, steps=5).shape == (2, 5, 64)
    pose = numbers(1, 4, 6)
    mean, log_variance = model.infer(pose)
    drawn = torch.cat([posterior_code(model, pose.expand(500, -1, -1), generator) for _ in range(4)])
    assert (drawn.mean(0) - mean[0, 0]).abs().max() < 0.15
    torch.testing.assert_close(drawn.std(0), (log_variance[0, 0] / 2).exp(), rtol=0.1, atol=0)


def test_the_seed_decides(checkpoint, control):
    def made(**options):
        return np.stack([m.positions for m in generate_from_control(checkpoint, control[:40], count=3, **options)])

    one = made(seed=1)
    state = torch.get_rng_state()
    assert np.array_equal(one, made(seed=1)) and torch.equal(state, torch.get_rng_state())
    assert not np.allclose(one, made(seed=2)) and not np.allclose(one, made(seed=1, codes="per-step"))
    assert not np.allclose(one[0], one[1])  # each has a code of its own


def test_a_code_that_is_held_is_read_at_every_step(checkpoint, control):
    code = prior_code(checkpoint.model, 2, torch.Generator().manual_seed(6))
    normalizer = checkpoint.normalizer
    wanted = ((torch.tensor(control[:40]) - normalizer.mean[63:]) / normalizer.std[63:]).expand(2, -1, -1)
    with torch.no_grad():
        made = checkpoint.model.synthesize(wanted, torch.stack([code] * 10, 1))
    features = generate_control_features(checkpoint, np.stack([control[:40]] * 2), seed=6, codes="held")
    np.testing.assert_allclose(features, normalizer.invert(made).numpy(), atol=1e-4)


def test_a_start_decides_the_code(checkpoint, control, clips):
    test, other = clips[1][0], clips[0][0]
    pose = first_poses(checkpoint, [test, other], 2)
    assert pose.shape == (2, 4, 63)
    one = checkpoint.normalizer.apply(checkpoint.representation.encode(test[:4]))[:, :63]
    np.testing.assert_allclose(pose[0].numpy(), one, atol=1e-5)
    both = generate_from_control(checkpoint, control[:40], count=2, start=[test, other], seed=3)
    assert len(both) == 2 and not np.allclose(both[0].positions, both[1].positions)
    again = generate_from_control(checkpoint, control[:40], count=2, start=test, seed=3)
    np.testing.assert_allclose(again[0].positions, both[0].positions, atol=1e-6)


# --- which control moves the figure ---------------------------------------------------------------


def test_the_given_control_is_integrated_to_the_world(checkpoint, control):
    """The hip goes exactly where the control says; by the predicted control it goes where the network says."""
    representation = checkpoint.representation
    given = generate_from_control(checkpoint, control, place=(1.0, 2.0), heading=0.5)[0]
    zeros = np.zeros((len(control), representation.dim), np.float32)
    zeros[:, representation.slices["control"]] = control
    path = representation.decode_positions(zeros, start=(1.0, 2.0), heading=0.5)[:, 0]
    np.testing.assert_allclose(given.positions[:, 0, [0, 2]], path[:, [0, 2]], atol=1e-4)
    np.testing.assert_allclose(
        representation.encode(given)[1:, representation.slices["forward"]],
        control[1:, 1:2],
        atol=0.4,  # the hip's frame is told by the generated hips and shoulders, which need not face that way
    )
    predicted = generate_from_control(checkpoint, control, integrate="predicted", place=(1.0, 2.0), heading=0.5)[0]
    features = generate_control_features(checkpoint, control[None])[0]
    wanted = representation.decode(features, start=(1.0, 2.0), heading=0.5)
    np.testing.assert_allclose(predicted.positions, wanted.positions, atol=1e-6)
    assert np.abs(predicted.positions[-1, 0] - given.positions[-1, 0]).max() > 1e-3
    # poses are the same, only their place and heading differ
    np.testing.assert_allclose(predicted.positions[..., 1], given.positions[..., 1], atol=1e-6)


def test_many_at_once_are_as_one_at_a_time(checkpoint, control):
    controls = np.stack([control[:60], control[60:120], 0 * control[:60]])
    features = generate_control_features(checkpoint, controls, seed=4)
    assert features.shape == (3, 60, 66) and features.dtype == np.float32
    code = prior_code(checkpoint.model, 3, torch.Generator().manual_seed(4))
    normalizer = checkpoint.normalizer
    for k in range(3):
        wanted = (torch.tensor(controls[k : k + 1]) - normalizer.mean[63:]) / normalizer.std[63:]
        alone = normalizer.invert(synthesize_control(checkpoint.model, wanted, code[k : k + 1]))
        np.testing.assert_allclose(features[k], alone[0].numpy(), atol=1e-4)
    assert len(generate_from_control(checkpoint, controls)) == 3


@pytest.mark.parametrize("frames", [1, 3, 4, 5, 117])
def test_any_length(checkpoint, control, frames):
    motion = generate_from_control(checkpoint, control[:frames])[0]
    assert len(motion) == frames and motion.fps == 30 and motion.skeleton.names == COMMON_JOINTS


# --- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrong, told", [
    (np.zeros((50, 2)), r"control of shape \(50, 2\): the network follows \(frames, 3\), turning, forward, sideways"),
    (np.zeros(3), r"control of shape \(3,\)"),
    (np.zeros((0, 3)), r"control of shape \(0, 3\)"),
    (np.full((2, 5, 3), np.nan), "control: turning of frame 0 is nan"),
    (np.array([[0, 1, 0], [0, np.inf, 0]]), "control: forward of frame 1 is inf"),
    ([[0, 1, 0], [0, 1]], "control: expected numbers, an array .*, found list"),
    ("straight on", "control: expected numbers, an array .*, found str"),
    ([["a", "b", "c"]], "control: expected numbers, an array .*, found list"),
    (None, r"control of shape \(\)"),
])  # fmt: skip
def test_control_that_does_not_fit(checkpoint, wrong, told):
    with pytest.raises(MotionError, match=told) as caught:
        generate_from_control(checkpoint, wrong)
    assert "\n" not in str(caught.value)


def test_what_else_does_not_fit(checkpoint, control, clips, small_motion):
    with pytest.raises(MotionError, match="control at 60 frames per second, the network was trained at 30"):
        generate_from_control(checkpoint, control, fps=60.0)
    for fps, told in ((np.nan, "nan"), ("30", "'30'"), (True, "True")):
        with pytest.raises(MotionError, match=f"control at {told} frames per second, the network was trained at 30"):
            generate_from_control(checkpoint, control, fps=fps)
    assert check_control(checkpoint, control, fps=np.float32(30.0)).shape == control.shape
    assert check_control(checkpoint, control, fps=30.0).shape == control.shape
    with pytest.raises(MotionError, match="2 controls for 3 motions"):
        generate_from_control(checkpoint, np.stack([control, control]), count=3)
    with pytest.raises(MotionError, match="has 3 frames at 30 per second, the network's pooling makes one step of 4"):
        generate_from_control(checkpoint, control, start=clips[1][0][:3])
    with pytest.raises(MotionError, match="2 clips to start 3 motions from"):
        generate_from_control(checkpoint, control, count=3, start=[clips[1][0]] * 2)
    with pytest.raises(MotionError, match="'small' has 7 nodes .* was made for 21 with root 'Hips'"):
        generate_from_control(checkpoint, control, start=small_motion)
    renamed = dataclasses.replace(clips[1][0].skeleton, names=("Head2", *COMMON_JOINTS[1:]))
    other = Motion(renamed, 30.0, clips[1][0].positions)
    with pytest.raises(MotionError, match="node 0 is 'Head2' in the one and 'Hips' in the other"):
        generate_from_control(checkpoint, control, start=other)
    with pytest.raises(TutorialError, match="unknown integrate 'both': expected one of given, predicted"):
        generate_from_control(checkpoint, control, integrate="both")
    for count in (0, -1, 1.5, True):
        with pytest.raises(TutorialError, match=f"number of motions to generate .* 1 or more, not {count}"):
            generate_from_control(checkpoint, control, count=count)
    with pytest.raises(TutorialError, match="control for no motion at all"):
        generate_from_control(checkpoint, control[None][:0])
    for chunk in (0, -5, 2.5):
        with pytest.raises(TutorialError, match=f"chunk, must be a whole number of 1 or more, not {chunk}"):
            generate_from_control(checkpoint, control, chunk=chunk)
    with pytest.raises(TutorialError, match="expected codes 'one' or 'held' with it, not 'per-step'"):
        generate_from_control(checkpoint, control, start=clips[1][0], codes="per-step")
    with pytest.raises(TutorialError, match="unknown codes 'two': expected one of one, per-step, held"):
        generate_from_control(checkpoint, control, codes="two")


@pytest.mark.parametrize("values, told", [
    ({"place": np.zeros((3, 2))}, r"place of shape \(3, 2\) for 2 motions: expected \(x, z\) .*, or 2 of them"),
    ({"place": (1.0,)}, r"place of shape \(1,\) for 2 motions"),
    ({"place": "here"}, "place 'here': expected"),
    ({"place": [[0, 0], [1]]}, r"place \[\[0, 0\], \[1\]\]: expected"),
    ({"heading": np.zeros(3)}, r"heading of shape \(3,\) for 2 motions: expected a number in radians"),
])  # fmt: skip
def test_beginnings_that_do_not_fit(checkpoint, control, values, told):
    with pytest.raises(MotionError, match=told) as caught:
        generate_from_control(checkpoint, control[:20], count=2, **values)
    assert "\n" not in str(caught.value)


def test_beginnings_for_all_or_for_each(checkpoint, control):
    for place in ((1.0, 2.0), [[1.0, 2.0]], np.array([[1.0, 2.0]] * 2), (1.0, 0.5, 2.0)):
        for heading in (0.5, np.array([0.5]), np.array([0.5, 0.5])):
            made = generate_from_control(checkpoint, control[:20], count=2, place=place, heading=heading)
            np.testing.assert_allclose([m.positions[0, 0, ::2] for m in made], [[1.0, 2.0]] * 2, atol=1e-6)


def test_seeds_are_numpys_numbers_too(checkpoint, control):
    made, same = (generate_from_control(checkpoint, control[:20], seed=s)[0] for s in (np.int64(3), 3))
    np.testing.assert_array_equal(made.positions, same.positions)
    for seed in (-1, None, 0.5):
        with pytest.raises(TutorialError, match=f"the seed must be a whole number of 0 or more, not {seed!r}"):
            generate_from_control(checkpoint, control, seed=seed)


def test_each_kind_of_network_in_its_own_place(checkpoint, control, clips, tmp_path):
    with pytest.raises(CheckpointError, match="'vae-lstm', which follows a control signal .*walks a path"):
        generate(checkpoint, 10, seeds=clips[1])
    with pytest.raises(CheckpointError, match="follows a control signal"):
        evaluate(checkpoint, clips[1], count=2, frames=30)
    recipe = Recipe("lstm", "samples/walking", hidden=4, steps=1, batch=64, representation="hip-frame", joints="common")
    trainer_for(recipe, tmp_path / "x.safetensors", sets=[clips]).run(progress=False)
    with pytest.raises(CheckpointError, match="system 'lstm', which follows no control signal: expected 'vae-lstm'"):
        generate_from_control(load_checkpoint(tmp_path / "x.safetensors"), control)


def test_clips_of_other_joints_are_brought_to_the_networks(checkpoint, control):
    whole = data.load("samples/walking")[0]
    assert whole.skeleton.n_joints == 24
    assert first_poses(checkpoint, whole).shape == (1, 4, 63)


def test_a_network_that_diverges_is_told(checkpoint, control):
    broken = dataclasses.replace(checkpoint, model=network_of(checkpoint))
    with torch.no_grad():
        broken.model.decoder.second.bias.fill_(float("nan"))
    with pytest.raises(TutorialError, match="motion 1 of 2 left the finite numbers"):
        generate_from_control(broken, control[:20], count=2)


def network_of(checkpoint):
    model = type(checkpoint.model)(checkpoint.model.config)
    model.load_state_dict(checkpoint.model.state_dict())
    return model.requires_grad_(False).eval()
