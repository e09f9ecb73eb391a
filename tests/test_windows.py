"""Splits, windows and normalisation, on clips whose features say which frame and which angle they are."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
import torch

from tutorial_lib.data.windows import Normalizer, WindowSampler, evaluation_windows, split_clips
from tutorial_lib.errors import DataError, MotionError, TutorialError
from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.representations import make_representation

CLOCK = Skeleton(("root", "hand"), (-1, 0), np.array([[0, 0, 0], [1.0, 0, 0]]))


def clock(frames: int, fps: float = 120.0, first: int = 0, name: str = "clock") -> Motion:
    """The hand's height is the frame's number, its x is 1: features tell where and how turned a window is.

    The root goes 1 cm along z each frame.
    """
    t = np.arange(first, first + frames, dtype=float)
    root = np.stack([0 * t, 0 * t, 0.01 * t], 1)
    return Motion(CLOCK, fps, np.stack([root, root + np.stack([0 * t + 1, t, 0 * t], 1)], 1), name=name)


POSITIONS = make_representation("positions", CLOCK, 30)


def frames_of(batch: torch.Tensor) -> np.ndarray:
    return batch[..., 4].numpy().round().astype(int)


# -- split -------------------------------------------------------------------------------------------------


def test_split_is_by_clip_and_repeatable():
    clips = [clock(5, name=str(k)) for k in range(10)]
    train, test = split_clips(clips, 0.3, seed=4)
    assert len(test) == 3 and sorted(m.name for m in train + test) == sorted(m.name for m in clips)
    assert [m.name for m in train] == sorted(m.name for m in train)
    assert [m.name for m in split_clips(clips, 0.3, seed=4)[1]] == [m.name for m in test]
    assert len({tuple(m.name for m in split_clips(clips, 0.3, seed=s)[1]) for s in range(10)}) > 3


@pytest.mark.parametrize("fraction, n_test", [(0.001, 1), (0.999, 2)])
def test_each_side_has_a_clip(fraction, n_test):
    train, test = split_clips([clock(5)] * 3, fraction)
    assert (len(train), len(test)) == (3 - n_test, n_test)


def test_split_refuses():
    with pytest.raises(DataError, match="1 clip .* at least 2"):
        split_clips([clock(5)])
    with pytest.raises(DataError, match="between 0 and 1"):
        split_clips([clock(5)] * 3, 1.0)


# -- normalisation -----------------------------------------------------------------------------------------


def test_normalizer_by_hand():
    parts = [np.array([[[1.0, 5, 0.2]], [[3, 5, 0.2]]]), torch.tensor([[5.0, 5, 0.2], [7, 5, 0.2]])]
    n = Normalizer.fit(parts, floor=0.5)
    np.testing.assert_allclose(n.mean, [4, 5, 0.2], rtol=1e-6)
    np.testing.assert_allclose(n.std, [np.sqrt(5), 0.5, 0.5], rtol=1e-6)
    x = torch.tensor([[4 + np.sqrt(5), 6.0, 0.2]], dtype=torch.float32)
    torch.testing.assert_close(n.apply(x), torch.tensor([[1.0, 2.0, 0.0]]))
    torch.testing.assert_close(n.invert(n.apply(x)), x)
    np.testing.assert_allclose(n.apply(x.numpy()), n.apply(x).numpy())
    assert isinstance(n.apply(x.numpy()), np.ndarray)


def test_normalizer_far_from_zero():
    """Positions far from the origin lose no digits to the sum of squares."""
    x = 1e6 + np.random.default_rng(0).normal(size=(5000, 2))
    np.testing.assert_allclose(Normalizer.fit(np.split(x, 10)).std, x.std(0), rtol=1e-5)


def test_normalizer_is_saved_and_compared():
    n = Normalizer([0.1, 0.2], [1.0, 2.0])
    saved = n.to_dict()
    assert Normalizer.from_dict(saved) == n and n != Normalizer.identity(2)
    saved["mean"][0] = 9
    assert n.mean[0] == torch.tensor(0.1)
    x = np.random.default_rng(0).normal(size=(4, 2)).astype(np.float32)
    np.testing.assert_array_equal(Normalizer.identity(2).apply(x), x)


def test_normalizer_refuses():
    for mean, std in (([0.0], [1.0, 1.0]), ([0.0], [0.0]), ([np.nan], [1.0])):
        with pytest.raises(TutorialError, match="expected"):
            Normalizer(mean, std)
    with pytest.raises(TutorialError, match="width 3 .* 2 channels"):
        Normalizer.identity(2).apply(np.zeros((4, 3)))
    with pytest.raises(TutorialError, match="width 3 after features of 2"):
        Normalizer.fit([np.zeros((4, 2)), np.zeros((4, 3))])
    with pytest.raises(TutorialError, match="no features"):
        Normalizer.fit([])
    with pytest.raises(TutorialError, match="without std"):
        Normalizer.from_dict({"mean": torch.zeros(2)})


# -- windows -----------------------------------------------------------------------------------------------


def test_every_fourth_frame_in_every_phase():
    sampler = WindowSampler([clock(70)], POSITIONS, length=5, batch=400, seed=1)
    batch = sampler.sample()
    assert batch.shape == (400, 5, 6) and batch.dtype == torch.float32
    frames = frames_of(batch)
    assert (np.diff(frames, axis=1) == 4).all()
    # 70 frames, a window spans 17: starts 0 to 53, each of them drawn
    assert sampler.n_windows == 54 and set(frames[:, 0]) == set(range(54))
    # the root's step: 4 frames of 1 cm, in the first frame of the window too
    np.testing.assert_allclose(np.linalg.norm(batch[..., :3], axis=-1), 0.04, atol=1e-6)


def test_each_window_is_turned_once_and_evenly():
    batch = WindowSampler([clock(70)], POSITIONS, length=5, batch=2000, seed=2).sample().numpy()
    angle = np.arctan2(-batch[..., 5], batch[..., 3])  # the hand's x and z; turning takes x to -z
    assert np.abs(np.ptp(np.unwrap(angle, axis=1), axis=1)).max() < 1e-4
    quarters = np.histogram(angle[:, 0], bins=4, range=(-np.pi, np.pi))[0]
    assert (np.abs(quarters - 500) < 100).all()  # 5 standard deviations
    # the root's way is turned by the same angle: z goes to x
    np.testing.assert_allclose(batch[:, 1, 0], 0.04 * np.sin(angle[:, 1]), atol=1e-5)
    np.testing.assert_allclose(batch[:, 1, 2], 0.04 * np.cos(angle[:, 1]), atol=1e-5)
    still = WindowSampler([clock(70)], POSITIONS, length=5, batch=50, rotate=False).sample()
    np.testing.assert_allclose(still[..., 3], 1, atol=1e-6)


def test_several_rates():
    sampler = WindowSampler([clock(2000)], POSITIONS, length=5, batch=3000, rates=(30, 60, 120), seed=3)
    strides = np.diff(frames_of(sampler.sample()), axis=1)
    assert (strides == strides[:, :1]).all()
    values, counts = np.unique(strides[:, 0], return_counts=True)
    assert values.tolist() == [1, 2, 4] and (np.abs(counts - 1000) < 130).all()


def test_a_rate_that_is_no_whole_part_is_resampled():
    batch = WindowSampler([clock(200, fps=100.0)], POSITIONS, length=6, batch=50, rotate=False).sample()
    np.testing.assert_allclose(np.diff(batch[..., 4], axis=1), 100 / 30, rtol=1e-4)


def test_every_start_is_equally_likely_over_clips():
    clips = [clock(20, 30.0), clock(110, 30.0, first=1000)]  # 10 and 100 starts
    frames = frames_of(WindowSampler(clips, POSITIONS, length=11, batch=11000, seed=5).sample())
    assert abs((frames[:, 0] < 1000).sum() - 1000) < 150  # 5 standard deviations
    counts = np.bincount(frames[:, 0])
    assert (counts[:10] > 50).all() and (counts[1000:1100] > 50).all() and counts.sum() == 11000
    assert frames[frames[:, 0] < 1000].max() == 19 and frames.max() == 1109


@pytest.mark.parametrize("name", ["positions", "euler", "quaternion", "sixd"])
def test_a_window_is_the_clips_own_encoding(name, small_motion):
    r = make_representation(name, small_motion.skeleton, 30)
    cut = small_motion[:20]
    batch = WindowSampler([cut], r, length=20, batch=3, rotate=False).sample()
    for window in batch:
        np.testing.assert_allclose(window, r.encode(cut), atol=1e-5)
    # turned: all representations of the same draw are the same motion
    turned = WindowSampler([small_motion], r, length=20, batch=8, seed=6).sample()
    positions = make_representation("positions", small_motion.skeleton, 30)
    same = WindowSampler([small_motion], positions, length=20, batch=8, seed=6).sample()
    np.testing.assert_allclose(r.decode_positions(turned), positions.decode_positions(same), atol=1e-4)


def test_normalised_windows():
    n = Normalizer(torch.arange(6.0), torch.full((6,), 2.0))
    plain, scaled = (
        WindowSampler([clock(70)], POSITIONS, length=5, batch=4, normalizer=x, seed=1).sample() for x in (None, n)
    )
    torch.testing.assert_close(scaled, n.apply(plain))


def test_state_goes_on_exactly():
    sampler = WindowSampler([clock(500)], POSITIONS, length=5, batch=8, seed=7)
    sampler.sample()
    state = json.loads(json.dumps(sampler.state_dict()))
    expected = [sampler.sample() for _ in range(3)]
    again = WindowSampler([clock(500)], POSITIONS, length=5, batch=8, seed=99)
    again.load_state_dict(state)
    for batch in expected:
        assert torch.equal(again.sample(), batch)
    before = again.state_dict()
    theirs = again.sample(np.random.default_rng(1))  # another generator leaves the sampler's own alone
    assert again.state_dict() == before
    assert torch.equal(again.sample(np.random.default_rng(1)), theirs)
    assert not torch.equal(again.sample(), theirs)


def test_a_generator_of_numpys_is_drawn_from():
    rng = np.random.default_rng(7)
    sampler, seeded = (WindowSampler([clock(70)], POSITIONS, length=5, batch=4, seed=seed) for seed in (rng, 7))
    assert sampler.rng is rng and torch.equal(sampler.sample(), seeded.sample())


def test_short_clips_are_left_out_with_one_warning():
    clips = [clock(16, name="short"), clock(17, first=100, name="long")]  # needed: 4 * 4 + 1 frames
    with pytest.warns(UserWarning, match="1 of 2 clips left out.* 5 frames: 'short'$") as warned:
        sampler = WindowSampler(clips, POSITIONS, length=5, batch=50)
    assert len(warned) == 1
    assert frames_of(sampler.sample()).min() == 100
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # at 60 fps the short one has windows too
        frames = frames_of(WindowSampler(clips, POSITIONS, length=5, batch=50, rates=(30, 60)).sample())
    assert frames.min() < 100


def test_rates_without_a_window_are_left_out_with_a_warning():
    clips = [clock(61, name="short"), clock(90, name="long")]
    told = "^rate 3 left out: no clip is long enough for a window of 5 frames at 3 frames .* 'long', has 3$"
    with pytest.warns(UserWarning, match=told) as warned:
        sampler = WindowSampler(clips, POSITIONS, length=5, batch=50, rates=(3, 30, 3))
    assert len(warned) == 1
    assert torch.equal(sampler.sample(), WindowSampler(clips, POSITIONS, length=5, batch=50, rates=(30,)).sample())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        WindowSampler([*clips, clock(161)], POSITIONS, length=5, batch=50, rates=(3, 30))  # one clip is enough
        WindowSampler(clips, POSITIONS, length=5, batch=50, rates=(3, 30), pad=True)


def test_refuses_what_it_cannot_sample():
    def make(clips, length=5, batch=2, representation=POSITIONS, **more):
        return WindowSampler(clips, representation, length=length, batch=batch, **more)

    with pytest.raises(DataError, match="40 frames at 30 .* 'b', has 18"):
        make([clock(40, name="a"), clock(70, name="b")], length=40)
    with pytest.raises(DataError, match="no clips"):
        make([])
    with pytest.raises(DataError, match="0 frames"):
        make([clock(70)], length=0)
    for size in (np.nan, 10.5, -1, None, True):
        told = rf"{size} frames in batches of 2: expected whole numbers, at least 1 of each"
        with pytest.raises(DataError, match=told):
            make([clock(70)], length=size)
        with pytest.raises(DataError, match=f"5 frames in batches of {size}: expected whole numbers"):
            make([clock(70)], batch=size)
    assert make([clock(70)], length=np.int64(5)).sample().shape[:2] == (2, 5)
    with pytest.raises(DataError, match="above zero"):
        make([clock(70)], rates=(30, -1))
    with pytest.raises(DataError, match="4 channels .* 6"):
        make([clock(70)], normalizer=Normalizer.identity(4))
    other = Skeleton(("root", "foot"), (-1, 0), CLOCK.offsets)
    with pytest.raises(MotionError, match="'foot' .* 'hand'"):
        make([Motion(other, 30, clock(70).positions)])
    with pytest.raises(MotionError, match="positions alone"):
        make([clock(70)], representation=make_representation("sixd", CLOCK, 30))
    with pytest.raises(DataError, match="state"):
        make([clock(70)]).load_state_dict({"generator": {"bit_generator": "MT19937"}})


# -- evaluation --------------------------------------------------------------------------------------------


def test_evaluation_windows_are_whole_spread_and_the_same_each_time():
    clips = [clock(400), clock(400, first=1000), clock(20, first=5000), clock(400, first=2000)]
    seeds, truths = evaluation_windows(clips, POSITIONS, seed_frames=10, future_frames=20, count=20, seed=3)
    assert seeds.shape == (20, 10, 6) and truths.shape == (20, 20, 6) and seeds.dtype == torch.float32
    frames = frames_of(torch.cat([seeds, truths], 1))
    assert (np.diff(frames, axis=1) == 4).all()
    assert len(set(frames[:, 0])) == 20
    # 71 starts a clip; a third of the windows from each that is long enough
    assert np.bincount(frames[:, 0] // 1000).tolist() in ([7, 7, 6], [7, 6, 7], [6, 7, 7])
    np.testing.assert_allclose(seeds[..., 3], 1, atol=1e-6)  # not turned
    again = evaluation_windows(clips, POSITIONS, seed_frames=10, future_frames=20, count=20, seed=3)
    assert torch.equal(again[0], seeds) and torch.equal(again[1], truths)
    other = evaluation_windows(clips, POSITIONS, seed_frames=10, future_frames=20, count=20, seed=4)
    assert not torch.equal(other[0], seeds)


def test_all_evaluation_windows_there_are():
    seeds, truths = evaluation_windows([clock(14, 30.0)], POSITIONS, seed_frames=5, future_frames=0, count=10)
    assert sorted(frames_of(seeds)[:, 0]) == list(range(10)) and truths.shape == (10, 0, 6)


def test_evaluation_refuses():
    with pytest.raises(DataError, match="30 frames at 30 .* 'clock', has 25"):
        evaluation_windows([clock(100)], POSITIONS, seed_frames=10, future_frames=20, count=1)
    with pytest.raises(DataError, match="20 windows .* 6 different"):
        evaluation_windows([clock(120)], POSITIONS, seed_frames=10, future_frames=15, count=20)
    with pytest.raises(DataError, match="no clips"):
        evaluation_windows([], POSITIONS, seed_frames=10, future_frames=20, count=1)
    with pytest.raises(DataError, match="at least 1"):
        evaluation_windows([clock(100)], POSITIONS, seed_frames=0, future_frames=20, count=1)
