"""Pose and motion errors and diversity on motions whose distance is known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tutorial_lib.clip_errors import (
    PAPER_FRAMES,
    at_paper_frames,
    frames_in_clip,
    joint_error,
    motion_errors,
    pose_errors,
    roll_out_clips,
    sample_diversity,
)
from tutorial_lib.errors import DataError, MotionError, TutorialError
from tutorial_lib.motion import Motion
from tutorial_lib.recipes import Recipe, sets_of, trainer_for
from tutorial_lib.representations import HipFrame, make_representation
from tutorial_lib.reproduce import published
from tutorial_lib.training.checkpoints import load_checkpoint

FPS = 30.0
RECIPE = Recipe("crbm", "samples/walking", joints="common", hidden=6, batch=4, length=12, steps=2)


@pytest.fixture(scope="module")
def walking() -> tuple[list[Motion], list[Motion]]:
    return sets_of(RECIPE)[0]


@pytest.fixture(scope="module")
def hip_frame(walking) -> HipFrame:
    return make_representation("hip-frame", walking[0][0].skeleton, FPS)


@pytest.fixture
def straight(hip_frame) -> np.ndarray:
    """Two clips of 31 frames that keep one pose and go straight on at 1 m/s; (2, 31, D)."""
    pose = np.random.default_rng(0).normal(size=hip_frame.dim)
    hip = slice(3 * hip_frame._hip, 3 * hip_frame._hip + 3)
    pose[hip] = 0, 0.9, 0
    features = np.tile(pose, (2, 31, 1))
    features[..., hip_frame.slices["control"]] = 0, 1, 0
    return features


def joint(representation: HipFrame, name: str) -> slice:
    k = representation.skeleton.names.index(name)
    return slice(3 * k, 3 * k + 3)


def both(function, representation, made, truth, **options):
    """Of arrays, and of tensors to the same numbers."""
    found = function(representation, made, truth, **options)
    assert isinstance(found, np.ndarray)
    tensors = function(representation, torch.tensor(made), torch.tensor(truth), **options)
    np.testing.assert_allclose(tensors.numpy(), found, rtol=1e-12)
    return found


def test_another_speed_is_an_error_of_the_motion_alone(hip_frame, straight):
    made = straight.copy()
    made[..., hip_frame.slices["forward"]] = 1.2
    made[1, :, hip_frame.slices["sideways"]] = 0.5
    frame = np.arange(31)
    expected = np.stack([0.2 * frame / FPS, np.hypot(0.2, 0.5) * frame / FPS])
    np.testing.assert_allclose(both(motion_errors, hip_frame, made, straight), expected, atol=1e-12)
    np.testing.assert_allclose(both(motion_errors, hip_frame, made, straight, squared=True), expected**2, atol=1e-12)
    assert (both(pose_errors, hip_frame, made, straight) == 0).all()


def test_turning_on_the_spot_moves_every_joint_about_the_hip(hip_frame, straight):
    straight[..., hip_frame.slices["control"]] = 0
    made = straight.copy()
    made[..., hip_frame.slices["turning"]] = 0.6
    joints = straight[0, 0, hip_frame.slices["joints"]].reshape(-1, 3)
    chord = 2 * np.hypot(joints[:, 0], joints[:, 2]).mean() * np.sin(0.6 * np.arange(31) / FPS / 2)
    np.testing.assert_allclose(both(motion_errors, hip_frame, made, straight), [chord, chord], atol=1e-12)
    assert (both(pose_errors, hip_frame, made, straight) == 0).all()


def test_a_raised_hand_is_an_error_of_both(hip_frame, straight):
    made = straight.copy()
    made[0, 10:, joint(hip_frame, "LeftHand")] += 0.3, 0, 0.4
    n = hip_frame.skeleton.n_joints
    expected = np.where(np.arange(31) >= 10, 0.5 / n, 0)
    for function in (pose_errors, motion_errors):
        np.testing.assert_allclose(both(function, hip_frame, made, straight), [expected, 0 * expected], atol=1e-12)
        squared = both(function, hip_frame, made, straight, squared=True)
        np.testing.assert_allclose(squared[0], expected / 2, atol=1e-12)  # 0.25 / n


def test_the_hip_is_the_frames_origin_whatever_a_network_says(hip_frame, straight):
    made = straight.copy()
    made[..., joint(hip_frame, "Hips").start] = 7.0  # its x; the height, after it, counts
    assert (both(pose_errors, hip_frame, made, straight) == 0).all()
    assert (both(motion_errors, hip_frame, made, straight) == 0).all()


def test_errors_of_what_is_not_finite_are_not_finite(hip_frame, straight):
    made = straight.copy()
    made[0, 5:] = np.nan
    found = both(motion_errors, hip_frame, made, straight)
    assert np.isnan(found[0, 5:]).all() and (found[0, :5] == 0).all() and (found[1] == 0).all()


def test_the_papers_frames_at_other_rates():
    assert frames_in_clip(30) == [35, 45, 60, 80, 105]
    assert frames_in_clip(60) == list(PAPER_FRAMES) == list(published.VAE_LSTM_FRAMES)
    assert frames_in_clip(25, [1, 60]) == [1, 25]
    errors = np.stack([np.arange(1.0, 121), np.arange(1.0, 121) + 4])  # frame number n has n, and n + 4
    found = at_paper_frames(errors, 30)
    assert found == {frame: (frame / 2 + 2, pytest.approx(2)) for frame in PAPER_FRAMES}  # sd 8^0.5, over 2^0.5
    with pytest.raises(TutorialError, match="with 105 frames or more, which are frame 210 at 60 per second"):
        at_paper_frames(errors[:, :104], 30)
    with pytest.raises(TutorialError, match="-1 frames per second"):
        frames_in_clip(-1)


def test_diversity_is_the_mean_distance_of_pairs():
    """Three samples of two joints; the second lies 1 m from the first at frame 1, the third 3 m beyond in one joint."""
    samples = np.zeros((3, 2, 2, 3))
    samples[1:, 1, :, 0] = 1
    samples[2, 1, 0, 0] = 4
    expected = [0, (1 + (4 + 1) / 2 + 3 / 2) / 3]
    np.testing.assert_allclose(sample_diversity(samples), expected)
    np.testing.assert_allclose(sample_diversity(torch.tensor(samples)), expected)
    np.testing.assert_allclose(sample_diversity(samples[[2, 0, 1]]), expected)
    with pytest.raises(TutorialError, match="S of at least 2"):
        sample_diversity(samples[:1])


def test_what_the_paper_prints():
    """The ratios that its text and this project's goals speak of."""
    one, two = published.VAE_LSTM_TABLE_1, published.VAE_LSTM_TABLE_2
    assert list(one) == list(two) and all(len(row) == 5 for row in (*one.values(), *two.values()))
    best = min(row[-1] for name, row in one.items() if "vae" not in name)
    assert best / one["vae-lstm"][-1] == pytest.approx(3.8, abs=0.05)
    ratios = [min(two[n][k] for n in two if "vae" not in n) / two["vae-lstm"][k] for k in range(5)]
    assert min(ratios) == pytest.approx(2.5, abs=0.05)
    assert max(p / v for p, v in zip(two["vae-lstm-prior"], two["vae-lstm"], strict=True)) < 1.55


# --- of a checkpoint ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def checkpoint(walking, tmp_path_factory):
    path = tmp_path_factory.mktemp("crbm") / "c.safetensors"
    trainer_for(RECIPE, path, sets=[walking]).run(progress=False)
    return load_checkpoint(path)


def test_clips_are_made_from_their_beginning_with_the_true_control(checkpoint, walking):
    run = roll_out_clips(checkpoint, walking[1], seed_frames=4, frames=20, count=5, given=("control",))
    dim, control = checkpoint.representation.dim, checkpoint.representation.slices["control"]
    assert run.made.shape == run.truth.shape == (5, 20, dim)
    assert np.array_equal(run.made[:, :4], run.truth[:, :4])
    assert np.array_equal(run.made[..., control], run.truth[..., control])
    assert (run.pose_errors()[:, :4] == 0).all() and (run.pose_errors()[:, 5:] > 0).all()
    np.testing.assert_allclose(run.motion_errors(), run.pose_errors(), atol=1e-9)  # the true path
    own = roll_out_clips(checkpoint, walking[1], seed_frames=10, frames=20, count=5)
    assert np.array_equal(own.truth, run.truth), "the same clips, however much of them is shown"
    assert not np.allclose(own.made[:, 10:, control], own.truth[:, 10:, control])
    assert (own.motion_errors()[:, :10] == 0).all() and (own.motion_errors(squared=True)[:, 10:] > 0).all()


def test_what_cannot_be_rolled_out(checkpoint, walking, hip_frame, straight):
    with pytest.raises(DataError, match="clips of 20 frames of which 20 are shown"):
        roll_out_clips(checkpoint, walking[1], seed_frames=20, frames=20)
    with pytest.raises(DataError, match="no clip is long enough"):
        roll_out_clips(checkpoint, walking[1], frames=100_000)
    with pytest.raises(MotionError, match="has no part 'speed' to be given: expected one of joints, control"):
        roll_out_clips(checkpoint, walking[1], frames=20, given=("speed",))
    with pytest.raises(MotionError, match="'positions' has root, joints: expected 'hip-frame'"):
        positions = make_representation("positions", hip_frame.skeleton, FPS)
        pose_errors(positions, np.zeros((2, 3, positions.dim)), np.zeros((2, 3, positions.dim)))
    with pytest.raises(MotionError, match=r"expects \(..., T, 66\)"):
        pose_errors(hip_frame, straight[..., :60], straight)
    with pytest.raises(TutorialError, match=r"made positions of shape \(2, 30, 21, 3\), true ones of \(2, 31, 21, 3\)"):
        motion_errors(hip_frame, straight[:, 1:], straight)
    with pytest.raises(TutorialError, match=r"expected \(..., T, J, 3\) both"):
        joint_error(np.zeros((4, 2)), np.zeros((4, 2)))
