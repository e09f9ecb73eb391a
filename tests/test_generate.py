"""Synthesis, seeds and evaluation, with networks whose output is known beforehand."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import tracemalloc

import numpy as np
import pytest
import torch
from torch import nn

from tutorial_lib import metrics
from tutorial_lib.chance import seeded
from tutorial_lib.data.synthetic import sample_skeleton
from tutorial_lib.data.windows import Normalizer
from tutorial_lib.errors import CheckpointError, DataError, MotionError, TutorialError
from tutorial_lib.evaluate import Rollouts, evaluate, flaws, roll_out, summary, unseen
from tutorial_lib.generate import choose_seeds, choose_windows, generate, generate_features, prepare, stream, synthesize
from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.motion.clip import settled_positions
from tutorial_lib.representations import make_representation
from tutorial_lib.training.checkpoints import Checkpoint
from tutorial_lib.training.conditioning import Given, WanderingNoise
from tutorial_lib.training.systems import make_system


@dataclasses.dataclass(frozen=True)
class Sizes:
    dim: int


class Counting(nn.Module):
    """Its next frame is the last one plus one; its memory counts the frames it has read."""

    def __init__(self, dim: int):
        super().__init__()
        self.config = Sizes(dim)
        self.one = nn.Parameter(torch.ones(()))

    def forward(self, x, state=None):
        self.longest = max(getattr(self, "longest", 0), x.shape[1] if state is not None else 0)
        return x + self.one, (0 if state is None else state) + x.shape[1]


class Repeating(Counting):
    """Its next frame is the last one: a figure that stops in its tracks, or glides on."""

    def forward(self, x, state=None):
        return x + 0 * self.one, state


def checkpoint_for(motion: Motion, model=None, name="positions", normalizer=None, **kwargs) -> Checkpoint:
    representation = make_representation(name, motion.skeleton, motion.fps)
    model = make_system("lstm", representation.dim, hidden=8, seed=2).model if model is None else model
    return Checkpoint("lstm", model.eval(), representation, normalizer, {}, {"clips": []}, **kwargs)


# --- synthesis ------------------------------------------------------------------------------------


def test_output_follows_the_last_seed_frame():
    seed = torch.tensor([[[0.0], [5.0]], [[1.0], [2.0]]])
    out = synthesize(Counting(1), seed, 4)
    assert out.tolist() == [[[6.0], [7.0], [8.0], [9.0]], [[3.0], [4.0], [5.0], [6.0]]]
    assert synthesize(Counting(1), seed, 0).shape == (2, 0, 1)


def test_synthesis_equals_running_on_own_output_written_out():
    """Every output is put behind the input and the whole is read again from the start: slow, but plainly right."""
    model = make_system("lstm", 4, hidden=6, seed=1).model
    frames = torch.randn(3, 5, 4, generator=torch.Generator().manual_seed(0))
    out = synthesize(model, frames, 12)
    with torch.no_grad():
        for _ in range(12):
            frames = torch.cat([frames, model(frames)[0][:, -1:]], dim=1)
    torch.testing.assert_close(out, frames[:, 5:])


def test_batches_and_single_sequences_agree():
    model = make_system("lstm", 4, hidden=6, seed=1).model
    seed = torch.randn(2000, 3, 4, generator=torch.Generator().manual_seed(0))
    many = synthesize(model, seed, 6)
    assert many.shape == (2000, 6, 4)
    torch.testing.assert_close(many[1234:1235], synthesize(model, seed[1234:1235], 6))


def test_noise_is_on_what_is_read_and_not_on_what_comes_out(small_motion):
    """A network that adds one to what it reads: each step is one and what the noise was, the first is exact."""
    seed, noise = torch.zeros(2, 3, 4), WanderingNoise(0.3, 5.0, torch.Generator().manual_seed(4))
    out = synthesize(Counting(4), seed, 6, noise=noise)
    again = WanderingNoise(0.3, 5.0, torch.Generator().manual_seed(4))
    frame, expected = torch.ones(2, 4), []
    for _ in range(6):
        expected.append(frame)
        frame = again.disturb(frame) + 1
    torch.testing.assert_close(out, torch.stack(expected, 1))

    given = Given([1], torch.full((2, 6, 1), 7.0))
    held = synthesize(Counting(4), seed, 6, given=given, noise=WanderingNoise(0.3, 5.0, torch.Generator()))
    assert bool((held[..., 1] == 7).all()) and held[..., 0].diff().std() > 0.01

    checkpoint = checkpoint_for(small_motion)
    made = [generate(checkpoint, 30, seeds=[small_motion], seed=s, noise=n)[0].positions
            for s, n in ((0, 0.0), (0, 0.02), (0, 0.02))]  # fmt: skip
    assert np.array_equal(made[1], made[2]) and not np.allclose(made[0][12:], made[1][12:], atol=1e-5)
    assert np.allclose(made[0][:11], made[1][:11])  # the seed, and the frame that was made of the seed alone
    with pytest.raises(TutorialError, match="noise is a standard deviation of 0 or more, not -1"):
        generate(checkpoint, 5, seeds=[small_motion], noise=-1)


def test_stream_goes_on_without_growing():
    model = make_system("lstm", 4, hidden=6, seed=1).model
    seed = torch.zeros(1, 3, 4)
    frames = stream(model, seed)
    first = torch.stack(list(itertools.islice(frames, 50)), dim=1)
    torch.testing.assert_close(first, synthesize(model, seed, 50))
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in itertools.islice(frames, 1000):
        pass
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 50_000
    counting = Counting(4)
    next(itertools.islice(stream(counting, seed), 30, None))
    assert counting.longest == 1  # after the seed one frame is read at a time


def test_stream_leaves_gradients_as_they_are():
    frames = stream(make_system("lstm", 4, hidden=6).model, torch.zeros(1, 3, 4))
    for _ in range(3):
        assert not next(frames).requires_grad
        assert torch.is_grad_enabled()


@pytest.mark.parametrize("shape", [(3, 4), (0, 3, 4), (1, 0, 4)])
def test_impossible_seeds_are_refused(shape):
    with pytest.raises(TutorialError, match="a seed has shape"):
        synthesize(Counting(4), torch.zeros(shape), 1)
    with pytest.raises(TutorialError, match="0 or more"):
        synthesize(Counting(4), torch.zeros(1, 1, 4), -1)


# --- seeds ----------------------------------------------------------------------------------------


def test_windows_are_all_equally_likely_and_none_twice():
    lengths = [12, 5, 10, 11]  # 3, 0, 1 and 2 windows of 10
    all_six = {(0, 0), (0, 1), (0, 2), (2, 0), (3, 0), (3, 1)}
    assert set(choose_windows(lengths, frames=10, count=6, seed=1)) == all_six
    twelve = choose_windows(lengths, frames=10, count=12, seed=1)
    assert sorted(twelve) == sorted(2 * list(all_six))
    assert choose_windows(lengths, frames=10, count=4, seed=1) == choose_windows(lengths, frames=10, count=4, seed=1)
    first = [choose_windows(lengths, frames=10, seed=s)[0] for s in range(600)]
    assert all(60 < first.count(w) < 140 for w in all_six)


def test_clips_too_short_for_a_seed():
    with pytest.raises(DataError, match="a seed needs 10 frames, the longest of 2 clips has 9"):
        choose_windows([9, 3], frames=10)
    with pytest.raises(DataError, match="longest of 0 clips"):
        choose_windows([], frames=10)


def test_prepare_scales_resamples_and_grounds(small_motion):
    (made,) = prepare([small_motion], height=1.54, fps=15.0)
    assert made.fps == 15.0 and len(made) == 25 and made.height == pytest.approx(1.54)
    assert np.quantile(made.positions[..., 1].min(1), 0.01) == pytest.approx(0.0, abs=1e-9)


# --- with a checkpoint ----------------------------------------------------------------------------


def test_seed_frames_come_first_and_are_the_clips(small_motion):
    """A network that repeats its last frame: after the seed the pose stands, and glides on at its last speed."""
    checkpoint = checkpoint_for(small_motion, Repeating(21))
    made = generate(checkpoint, 20, seeds=[small_motion], seed_frames=10, count=3, seed=5)
    assert made.n_seed == 10 and len(made) == 3 and [len(m) for m in made] == [30] * 3
    windows = choose_windows([50], frames=10, count=3, seed=5)
    for motion, (_, start) in zip(made, windows, strict=True):
        truth = small_motion[start : start + 10].positions
        shift = truth[0, 0] - motion.positions[0, 0]
        np.testing.assert_allclose(motion.positions[:10] + shift, truth, atol=1e-5)
        body = motion.positions - motion.positions[:, :1]
        np.testing.assert_allclose(body[10:], np.broadcast_to(body[9], body[10:].shape), atol=1e-6)
        steps = np.diff(motion.positions[:, 0], axis=0)
        np.testing.assert_allclose(steps[9:], np.broadcast_to(steps[8], steps[9:].shape), atol=1e-5)
    assert [len(m) for m in made.without_seed()] == [20] * 3


@pytest.mark.parametrize("name", ["positions", "euler", "quaternion", "sixd"])
def test_every_representation_generates(small_motion, name):
    made = generate(checkpoint_for(small_motion, name=name), 15, seeds=[small_motion])
    assert made[0].skeleton == small_motion.skeleton and made[0].fps == 30.0 and len(made[0]) == 25
    again = generate(checkpoint_for(small_motion, name=name), 15, seeds=[small_motion])
    assert np.array_equal(made[0].positions, again[0].positions)


def test_normaliser_is_applied_and_undone():
    """With mean 10 and deviation 2 the network sees (x - 10) / 2 and adds one: two a frame in features."""
    skeleton = Skeleton(("a",), (-1,), np.zeros((1, 3)), ("ZXY",), frozenset())
    motion = Motion(skeleton, 30.0, np.zeros((12, 1, 3)))
    checkpoint = checkpoint_for(motion, Counting(3), normalizer=Normalizer(np.full(3, 10.0), np.full(3, 2.0)))
    out = generate_features(checkpoint, np.full((1, 4, 3), 5.0, dtype=np.float32), 3)
    np.testing.assert_allclose(out[0], [[7.0] * 3, [9.0] * 3, [11.0] * 3])


def test_seeds_at_other_rates_and_sizes_are_brought_to_the_networks(small_motion):
    checkpoint = checkpoint_for(small_motion, Repeating(21))
    other = small_motion.resample(60.0).scaled(2.5).translate((1, 2, 3))
    made = generate(checkpoint, 5, seeds=[other], seed=1)
    same = generate(checkpoint, 5, seeds=[small_motion], seed=1)
    np.testing.assert_allclose(made[0].positions, same[0].positions, atol=0.02)


def test_a_checkpoint_generates_from_its_own_seed(small_motion):
    own = torch.randn(2, 14, 21, generator=torch.Generator().manual_seed(0))
    checkpoint = checkpoint_for(small_motion, Repeating(21), seed_frames=own)
    made = generate(checkpoint, 5, count=4)
    assert len(made) == 4 and len({m.positions.tobytes() for m in made}) == 4
    with pytest.raises(CheckpointError, match="carries no seed"):
        generate(checkpoint_for(small_motion), 5)


def test_what_does_not_fit_is_told_with_both_sides(small_motion):
    checkpoint = checkpoint_for(small_motion)
    skeleton = Skeleton(("a", "b"), (-1, 0), np.eye(3)[:2], ("ZXY",) * 2, frozenset())
    other = Motion(skeleton, 30.0, np.zeros((20, 2, 3)), name="two sticks")
    with pytest.raises(MotionError, match="two sticks.*2 nodes.*7"):
        generate(checkpoint, 5, seeds=[other])
    with pytest.raises(CheckpointError, match=r"\(1, 10, 20\).*21"):
        generate(checkpoint, 5, seeds=np.zeros((1, 10, 20), np.float32))
    with pytest.raises(DataError, match="a seed needs 60 frames, the longest of 1 clips has 50"):
        generate(checkpoint, 5, seeds=[small_motion], seed_frames=60)
    with pytest.raises(TutorialError, match="1 or more"):
        generate(checkpoint, 0, seeds=[small_motion])
    plain = dataclasses.replace(checkpoint, representation=None)
    with pytest.raises(CheckpointError, match="no representation"):
        generate(plain, 5, seeds=[small_motion])


def test_seeds_and_counts_are_numpys_numbers_too(small_motion):
    for checkpoint in (checkpoint_for(small_motion), crbm_for(small_motion)):
        for s in np.arange(3):
            made = generate(checkpoint, np.int64(5), seeds=[small_motion], seed=s, count=np.int64(2))
            same = generate(checkpoint, 5, seeds=[small_motion], seed=int(s), count=2)
            assert [np.array_equal(a.positions, b.positions) for a, b in zip(made, same, strict=True)] == [True, True]
    noisy, same = (generate(checkpoint, 5, seeds=[small_motion], noise=x) for x in (np.float32(0.25), 0.25))
    assert np.array_equal(noisy[0].positions, same[0].positions)


@pytest.mark.parametrize("seed", [-1, None, 1.5, "1", True, 2**64, np.float64(1)])
def test_what_is_no_seed_is_told_in_one_line(small_motion, seed):
    checkpoint = checkpoint_for(small_motion)
    features = np.zeros((1, 10, 21), np.float32)
    for call in (
        lambda: generate(checkpoint, 5, seeds=[small_motion], seed=seed),
        lambda: generate_features(checkpoint, features, 5, seed=seed),
        lambda: crbm_for(small_motion).model.start(seed),
    ):
        with pytest.raises(TutorialError, match="the seed must be a whole number of 0 or more.*, not ") as caught:
            call()
        assert str(caught.value).endswith(f"not {seed!r}") and "\n" not in str(caught.value)
    assert len(generate(checkpoint, 5, seeds=[small_motion], seed=2**64 - 1)) == 1


@pytest.mark.parametrize("values", [{"n_frames": 5.5}, {"n_frames": True}, {"count": 1.5}, {"seed_frames": "10"}])
def test_counts_that_are_not_whole_are_told(small_motion, values):
    with pytest.raises(TutorialError, match="whole number"):
        generate(checkpoint_for(small_motion), **{"n_frames": 5, "seeds": [small_motion], **values})


def crbm_for(motion: Motion) -> Checkpoint:
    checkpoint = checkpoint_for(motion, make_system("crbm", 21, hidden=4, seed=0).model)
    return dataclasses.replace(checkpoint, system="crbm")


def test_output_that_is_not_finite_is_told():
    class Exploding(Counting):
        def forward(self, x, state=None):
            return x * 1e20 + 1e20 * self.one, state

    skeleton = Skeleton(("a",), (-1,), np.zeros((1, 3)), ("ZXY",), frozenset())
    motion = Motion(skeleton, 30.0, np.zeros((12, 1, 3)))
    with pytest.raises(TutorialError, match="motion 1 of 1 left the finite numbers 2 frames after its seed"):
        generate(checkpoint_for(motion, Exploding(3)), 10, seeds=[motion])


# --- evaluation -----------------------------------------------------------------------------------


@pytest.fixture
def gliding(small_skeleton) -> Motion:
    """A stiff figure that goes 0.1 m along x each frame: the features of all frames are the same."""
    rest = small_skeleton.rest_pose()
    path = np.zeros((200, 1, 3))
    path[:, 0, 0] = 0.1 * np.arange(200)
    return Motion(small_skeleton, 30.0, rest + path + [0, 1.0, 0], name="gliding")


def test_evaluation_of_a_network_that_is_right(small_motion, gliding):
    """The next frame of the stiff figure is its last one: seeds from it alone would have no error at all."""
    checkpoint = checkpoint_for(gliding, Repeating(21))
    with pytest.raises(TutorialError, match="true motion change"):  # nothing to compare standing still with
        evaluate(checkpoint, [gliding], count=4, frames=60)
    result = evaluate(checkpoint, [gliding, small_motion[:29]], count=2, frames=60, seed=1)
    errors = list(result["prediction_error"].values())  # one seed from either clip, or both from the long one
    assert max(errors) < 1.0
    assert json.loads(json.dumps(result)) == result


def test_evaluation_in_numbers(small_skeleton):
    """A figure that hops 0.1 m up and down in turns: a network that repeats its last frame is wrong by 0.2 at
    every odd frame and right at every even one, and its motion change is nothing."""
    hops = np.zeros((120, 1, 3))
    hops[1::2, 0, 1] = 0.1
    motion = Motion(small_skeleton, 30.0, small_skeleton.rest_pose() + hops + [0, 1.0, 0], name="hops")
    checkpoint = checkpoint_for(motion, Repeating(21))
    result = evaluate(checkpoint, [motion], count=5, frames=60)
    # frames 2, 5, 7, 10, 12, 14, 17, 19 after the seed; the displacement turns from +0.1 to -0.1 at each
    wanted = [0.0, 0.2, 0.2, 0.0, 0.0, 0.0, 0.2, 0.2]
    assert list(result["prediction_error"].values()) == pytest.approx(wanted, abs=1e-6)
    assert list(result["prediction_error"]) == ["80", "160", "240", "320", "400", "480", "560", "640"]
    change = result["motion_change"]
    assert change["true"] == pytest.approx(0.2 * 118 / 119, rel=1e-5)  # the first step repeats the second
    assert change["at"] == {"15": pytest.approx(0, abs=1e-7), "60": pytest.approx(0, abs=1e-7)}
    assert result["standstill"] == result["freezing"] == {"count": 5, "seconds": [0.0] * 5}  # shorter than 10 s
    assert result["divergence"]["count"] == 0 and result["divergence"]["seconds"] == [None] * 5
    assert result["foot_skate"] is None  # seven nodes with names nobody knows
    assert result["bone_drift"]["generated"] == pytest.approx(0, abs=1e-6)
    assert not result["trained_on_these_clips"]
    assert any("freezes, 2 s" in line and "5 of 5, at 0.0 s" in line for line in summary(result))


def test_one_motion_is_a_list_of_one(small_motion):
    checkpoint = checkpoint_for(small_motion)
    one, several = (generate(checkpoint, 5, seeds=seeds, count=2) for seeds in (small_motion, [small_motion]))
    assert all(np.array_equal(a.positions, b.positions) for a, b in zip(one, several, strict=True))
    clip = small_motion.with_name("a")
    one, several = (evaluate(checkpoint, clips, count=3, frames=60) for clips in (clip, [clip]))
    assert one == several and one["clips"] == ["a"] and unseen(checkpoint, clip) == [clip]


def test_a_figure_without_bones_is_evaluated_but_for_them():
    point = Skeleton(("a",), (-1,), np.zeros((1, 3)))
    clip = Motion(point, 30.0, np.random.default_rng(0).normal(size=(60, 1, 3)))
    result = evaluate(checkpoint_for(clip, Repeating(3)), [clip], count=2, frames=30)
    assert result["bone_drift"] == {"generated": None, "true": None} and result["motion_change"]["true"] > 0


def test_evaluation_sees_a_body_that_grows(small_skeleton, small_motion):
    """Counting adds a metre to every coordinate about the root and frame: it leaves human poses at once."""
    result = evaluate(checkpoint_for(small_motion, Counting(21)), [small_motion], count=3, frames=40)
    assert result["divergence"]["count"] == 3 and max(result["divergence"]["seconds"]) < 0.1
    assert result["standstill"]["count"] == result["freezing"]["count"] == 0
    assert result["motion_change"]["at"]["40"] == pytest.approx(math.sqrt(21), rel=1e-4)
    assert result["bone_drift"]["generated"] > 1.0


def test_evaluation_finds_the_feet_of_a_body_that_sinks():
    """A walker carried over the floor at 0.3 m/s slides by that; sinking 1 cm/s meanwhile does not hide it."""
    skeleton = sample_skeleton()
    seconds = np.arange(300)[:, None, None] / 30

    def standing(forward, down):
        return Motion(skeleton, 30.0, skeleton.rest_pose() + [0, 1, 0] + seconds * np.array([forward, down, 0.0]))

    sliding, sinking = standing(0.3, 0.0), standing(0.3, -0.01)
    for motion in (sliding, sinking):
        model = Repeating(3 * skeleton.n_joints)
        still = standing(0.0, 0.0)
        shaken = Motion(skeleton, 30.0, still.positions + 0.01 * np.sin(20 * seconds))  # something to be compared with
        result = evaluate(checkpoint_for(motion, model), [motion, shaken], count=2, frames=60, seed=3)
        assert 0 < result["foot_skate"]["true"] < 40 and np.isfinite(result["foot_skate"]["generated"])
    assert metrics.foot_skate(settled_positions(sinking.positions, 30), metrics.foot_joints(skeleton), 30) == (
        pytest.approx(30.0, rel=1e-3)
    )


def test_evaluation_refuses_clips_that_are_too_short(small_motion):
    with pytest.raises(DataError, match="no clip is long enough for a window of 29 frames"):
        evaluate(checkpoint_for(small_motion), [small_motion[:20]], frames=40)
    with pytest.raises(DataError, match="30 frames or more"):
        evaluate(checkpoint_for(small_motion), [small_motion], frames=10)


def test_unseen_clips_are_those_not_trained_on(small_motion):
    checkpoint = checkpoint_for(small_motion)
    checkpoint.provenance["clips"] = ["a"]
    clips = [small_motion.with_name(name) for name in ("a", "b")]
    assert [m.name for m in unseen(checkpoint, clips)] == ["b"]
    assert unseen(checkpoint, clips[:1]) == []
    named = dataclasses.replace(checkpoint, provenance={"clips": ["samples/walking/01"]})
    names = ("walking/01", "samples/walking/01", "running/01", "01x", "other/walking/02")
    assert [m.name for m in unseen(named, [small_motion.with_name(n) for n in names])] == list(names[2:])


# --- synthesis


class Rolling(Counting):
    """Its next frame is the last one, every number one place on: number 0 is what it read as number 3."""

    def forward(self, x, state=None):
        return x.roll(1, -1) + 0 * self.one, state


def test_what_is_given_is_read_without_noise():
    given = Given([3], torch.full((2, 8, 1), 7.0))
    noise = WanderingNoise(0.5, 5.0, torch.Generator().manual_seed(0))
    out = synthesize(Rolling(4), torch.zeros(2, 3, 4), 8, given=given, noise=noise)
    assert (out[:, 1:, 0] == 7).all() and (out[:, 2:, 1] != 7).any()


def test_noise_is_remembered_for_half_a_second(small_motion):
    checkpoint = checkpoint_for(small_motion, Counting(21))
    made = generate_features(checkpoint, np.zeros((2, 3, 21), np.float32), 6, noise=0.3, seed=4)
    noise = WanderingNoise(0.3, 15.0, seeded(4))  # at 30 frames a second
    expected = synthesize(Counting(21), torch.zeros(2, 3, 21), 6, noise=noise)
    np.testing.assert_allclose(made, expected.numpy(), atol=1e-6)


def test_a_network_in_training_is_put_into_evaluation():
    model = Counting(4).train()
    synthesize(model, torch.zeros(1, 3, 4), 2)
    assert not model.training


def test_a_seed_is_cut_before_it_is_encoded(small_motion):
    checkpoint = checkpoint_for(small_motion)
    features = choose_seeds(checkpoint, [small_motion], count=4, seed=5)
    for found, (_, start) in zip(features, choose_windows([50], count=4, seed=5), strict=True):
        cut = small_motion[start : start + 10]
        np.testing.assert_allclose(found, checkpoint.representation.encode(cut), atol=1e-5)


def test_the_seed_is_of_what_a_network_draws_too(small_motion):
    checkpoint = crbm_for(small_motion)
    one = checkpoint.representation.encode(small_motion[:10])[None]  # one window: nothing to choose
    first, again, other = (generate(checkpoint, 9, seeds=one, seed=s)[0].positions for s in (0, 0, 1))
    assert np.array_equal(first, again) and not np.allclose(first, other)


# --- evaluation


class Doubling(Counting):
    """All that it makes is its seed's last frame, twice as large."""

    def forward(self, x, state=None):
        return (2 if state is None else 1) * x + 0 * self.one, 1


class Pausing(Counting):
    """It stands still for four seconds, and goes on."""

    def forward(self, x, state=None):
        frame = 0 if state is None else state
        return x + (frame > 120) * self.one, frame + 1


class Growing(Counting):
    """Each frame is a twentieth larger than the one before."""

    def forward(self, x, state=None):
        return 1.05 * x + 0 * self.one, state


def test_what_is_made_is_held_against_the_clips(small_skeleton):
    """Twice as large as any clip: beyond 1.5 times their reach at once, on bones twice as long; clips are as they were.
    One clip of two is enough to have been trained on them."""
    hops = np.zeros((120, 1, 3))
    hops[1::2, 0, 1] = 0.1
    motion = Motion(small_skeleton, 30.0, small_skeleton.rest_pose() + hops + [0, 1.0, 0])
    checkpoint = checkpoint_for(motion, Doubling(21))
    checkpoint.provenance["clips"] = ["a"]
    clips = [motion.with_name(name) for name in ("a", "b")]
    result = evaluate(checkpoint, clips, count=4, frames=60)
    assert result["divergence"] == {"count": 4, "seconds": [0.0] * 4}
    assert result["bone_drift"] == {"generated": pytest.approx(1.0), "true": pytest.approx(0.0, abs=1e-6)}
    assert result["trained_on_these_clips"] and "some of them trained on" in summary(result)[0]
    assert "never trained on" in summary(evaluate(checkpoint, clips[1:], count=4, frames=60))[0]
    with pytest.raises(DataError, match="30 frames or more"):
        evaluate(checkpoint, clips, frames=29)


def test_a_pause_is_a_standstill_and_no_freezing(small_motion):
    result = evaluate(checkpoint_for(small_motion, Pausing(21)), [small_motion], count=2, frames=420)
    assert result["standstill"]["count"] == 2 and result["freezing"] == {"count": 0, "seconds": [None, None]}


def test_measures_are_of_the_frames_that_were_made(small_motion):
    checkpoint, options = checkpoint_for(small_motion, Growing(21)), {"count": 4, "frames": 60, "seed": 2}
    run, result = roll_out(checkpoint, small_motion, **options), evaluate(checkpoint, small_motion, **options)
    whole = np.concatenate([run.seeds, run.made], 1)  # (4, 10 + 60, 21)
    change = np.linalg.norm(np.diff(whole, axis=1), axis=-1)[:, 9:]  # the first is from the seed's last frame
    at = {"15": change[:, :15].mean(), "60": change[:, 45:].mean()}
    assert result["motion_change"]["at"] == pytest.approx(at, rel=1e-4)
    errors = np.linalg.norm(run.made[:, :19] - run.truth, axis=-1)[:, [1, 4, 6, 9, 11, 13, 16, 18]]
    of_the_mean = errors.std(0, ddof=1) / np.sqrt(4)
    np.testing.assert_allclose(list(result["prediction_error"].values()), errors.mean(0), rtol=1e-4)
    np.testing.assert_allclose(list(result["prediction_error_standard_error"].values()), of_the_mean, rtol=1e-4)
    # what was made goes on from where the seed has led to
    np.testing.assert_allclose(run.positions[:, 0, 0, 0], whole[:, 1:11, 0].sum(1), rtol=1e-4, atol=1e-6)
    assert not np.array_equal(roll_out(checkpoint, small_motion, **{**options, "seed": 3}).seeds, run.seeds)


def test_true_motion_is_that_of_the_reference(small_motion):
    """Every frame counts the same, and the farthest reach of all."""
    fast = dataclasses.replace(small_motion[10:50:4], fps=30.0)
    checkpoint = checkpoint_for(small_motion)
    run = roll_out(checkpoint, small_motion, reference=[small_motion, fast], count=2, frames=30)
    changes = [metrics.frame_change(checkpoint.representation.encode(m)) for m in (small_motion, fast)]
    assert changes[1].mean() > 1.5 * changes[0].mean()
    assert run.true_change == pytest.approx(np.concatenate(changes).mean(), rel=1e-5)
    assert run.reach == pytest.approx(max(metrics.reach(m.positions) for m in (small_motion, fast)), rel=1e-5)
    assert metrics.reach(fast.positions) < metrics.reach(small_motion.positions)


def test_feet_are_measured_on_the_ground_whatever_drifts():
    """Sliding at 0.3 m/s for five seconds, standing for five, and sinking by 1 cm/s all the while: 15 cm/s."""
    skeleton = sample_skeleton()
    t = np.arange(300)[:, None, None] / 30
    positions = skeleton.rest_pose() + np.minimum(t, 5) * [0.3, 0, 0] - t * [0, 0.01, 0]
    motion = Motion(skeleton, 30.0, positions)
    representation = make_representation("positions", skeleton, 30.0)
    x = representation.encode(motion)[None]
    found = flaws(Rollouts(representation, x[:, :10], x[:, 10:40], x[:, 10:], [motion], [motion]))["foot_skate"]
    assert found["true"] == pytest.approx(15, rel=0.05) and found["generated"] == pytest.approx(15, rel=0.05)


def test_a_clip_of_a_folder_is_the_catalogues(small_motion):
    checkpoint = dataclasses.replace(checkpoint_for(small_motion), provenance={"clips": ["walking/01"]})
    assert not unseen(checkpoint, small_motion.with_name("samples/walking/01"))
