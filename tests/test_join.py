"""Clips joined without a seam: lengths, continuity, bones, and which place is chosen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tutorial_lib import data
from tutorial_lib.data.windows import WindowSampler
from tutorial_lib.errors import MotionError, TutorialError
from tutorial_lib.metrics import bone_length_drift
from tutorial_lib.motion import join as module
from tutorial_lib.motion.clip import Motion
from tutorial_lib.motion.join import SEARCH, join, playlist
from tutorial_lib.motion.retarget import to_common
from tutorial_lib.motion.skeleton import Skeleton
from tutorial_lib.recipes import Recipe, trainer_for
from tutorial_lib.representations import make_representation


@pytest.fixture(scope="module")
def walks() -> list[Motion]:
    return data.load("samples/walking")


def fastest(motion: Motion) -> float:
    """The largest way of any joint from one frame to the next, metres."""
    return float(np.linalg.norm(np.diff(motion.positions, axis=0), axis=-1).max())


def test_nothing_jumps_and_bones_keep_their_length(walks):
    whole = join(walks[:3], blend=0.3)
    assert fastest(whole) < 1.5 * max(fastest(clip) for clip in walks[:3])
    assert bone_length_drift(whole.positions, whole.skeleton).max() < 1e-9
    size = round(0.3 * walks[0].fps)
    left_out = sum(len(clip) for clip in walks[:3]) - len(whole)
    assert (
        2 * size <= left_out <= 2 * size + 4 * 1.5 * walks[0].fps
    )  # each join: a blend, and at most 1.5 s on both sides


def test_clips_go_on_in_the_direction_and_at_the_place_where_the_last_one_ended(walks):
    first, second = walks[0], walks[1].rotate_y(2.0).translate((5.0, 0.0, -3.0))
    whole = join([first, second])
    np.testing.assert_allclose(whole.positions[:30], first.positions[:30])  # the first stays where it is
    way = np.diff(whole.positions[:, 0, [0, 2]], axis=0)
    way = way[np.linalg.norm(way, axis=1) > 1e-4]
    turn = np.angle((way[1:, 0] + 1j * way[1:, 1]) / (way[:-1, 0] + 1j * way[:-1, 1]))
    assert np.abs(turn).max() < 0.5  # nobody walks off at an angle of two radians


def test_a_clip_cut_in_two_is_put_together_again(walks):
    """The frames that both halves have are the most alike of all, so they are where the halves are joined."""
    clip, size = walks[0], round(0.3 * walks[0].fps)
    half = len(clip) // 2
    whole = join([clip[: half + size], clip[half:].rotate_y(1.0).translate((2.0, 0.0, 1.0))], blend=0.3)
    assert len(whole) == len(clip)
    np.testing.assert_allclose(whole.positions, clip.positions, atol=1e-6)
    np.testing.assert_allclose(np.abs((whole.rotations * clip.rotations).sum(-1)), 1.0, atol=1e-9)


def test_motion_without_rotations(walks):
    bare = [Motion(clip.skeleton, clip.fps, clip.positions) for clip in walks[:2]]
    whole = join(bare)
    assert whole.rotations is None
    assert fastest(whole) < 1.5 * max(fastest(clip) for clip in bare)


def test_one_clip_is_itself(walks):
    whole = join(walks[:1])
    np.testing.assert_array_equal(whole.positions, walks[0].positions)


def test_a_playlist_has_every_clip_and_other_orders(walks):
    seconds = 3 * sum(clip.duration for clip in walks)
    whole = playlist(walks, seconds=seconds, seed=1)
    assert 0.6 * seconds < whole.duration < 1.5 * seconds
    again, other = playlist(walks, seconds=seconds, seed=1), playlist(walks, seconds=seconds, seed=2)
    np.testing.assert_array_equal(whole.positions, again.positions)
    assert len(other) != len(whole) or not np.array_equal(other.positions, whole.positions)
    for clip in walks:  # a stretch from its middle, about the root and seen from no side, is in it
        k = len(clip) // 2
        heights = whole.positions[:, :, 1] - clip.positions[k, :, 1]
        assert np.abs(heights).max(1).min() < 1e-6


@pytest.mark.parametrize("count", [2, 3])
def test_no_clip_follows_itself(walks, monkeypatch, count):
    monkeypatch.setattr(module, "join", lambda motions, **_: motions)
    for seed in range(5):
        order = [clip.name for clip in playlist(walks[:count], seconds=500, seed=seed)]
        assert len(order) >= 30 and all(a != b for a, b in zip(order, order[1:], strict=False)), (seed, order)
    assert len({clip.name for clip in playlist(walks[:1], seconds=60)}) == 1, "but for one that is alone"


def test_the_seconds_of_a_playlist_are_the_clips_own(walks, monkeypatch):
    """What the joins leave is shorter, by a blend and the two searches at most in each."""
    clips = [clip[:90] for clip in walks]
    whole = playlist(clips, seconds=60, seed=0)
    assert 60 - 19 * (0.3 + 2 * SEARCH) < whole.duration < 50
    monkeypatch.setattr(module, "join", lambda motions, **_: motions)
    assert sum(clip.duration for clip in playlist(clips, seconds=60, seed=0)) == pytest.approx(60)


def test_a_playlist_says_which_clips_it_leaves_out(walks):
    short = walks[1][:20].with_name("short")
    with pytest.warns(UserWarning, match="1 of 3 clips left out, too short for three blends of 0.3 s: 'short'$"):
        whole = playlist([walks[0], short, walks[2]], seconds=1, seed=1)
    np.testing.assert_array_equal(whole.positions, playlist([walks[0], walks[2]], seconds=1, seed=1).positions)


def test_what_cannot_be_joined(walks):
    with pytest.raises(MotionError, match="no clips"):
        join([])
    with pytest.raises(MotionError, match="another skeleton"):
        join([walks[0], to_common(walks[1])])
    with pytest.raises(MotionError, match="60 frames a second"):
        join([walks[0], walks[1].resample(60)])
    nearly = dataclasses.replace(walks[1], fps=30.003)  # as a file with a rounded frame time has it
    assert join([walks[0], nearly]).fps == 30
    with pytest.raises(MotionError, match="30.3 frames a second"):
        join([walks[0], dataclasses.replace(walks[1], fps=30.3)])
    for wrong in (np.nan, -0.1, np.inf, None, "long"):
        with pytest.raises(MotionError, match=f"join: a blend of {wrong!r} seconds, expected a number of 0 or more"):
            join(walks[:2], blend=wrong)
        with pytest.raises(MotionError, match=f"playlist: a blend of {wrong!r} seconds"):
            playlist(walks[:2], seconds=10, blend=wrong)
    for wrong in (np.nan, -0.1, None):
        with pytest.raises(MotionError, match=f"join: a search of {wrong!r} seconds, expected a number of 0 or more"):
            join(walks[:2], search=wrong)
    assert len(join(walks[:2], search=np.inf)) > 300, "as far as a third of a clip"
    for wrong in (np.nan, np.inf, 0, -5, None, "long"):
        with pytest.raises(MotionError, match=f"playlist of {wrong!r} seconds: expected a number above 0"):
            playlist(walks[:2], seconds=wrong)
    with pytest.raises(MotionError, match="expected .* to blend"):
        join([walks[0], walks[1][:20]], blend=0.5)
    with pytest.raises(MotionError, match="none of 1 clips"):
        playlist([walks[0][:10]], seconds=10)


def test_a_recipe_trains_on_joined_clips(tmp_path):
    recipe = Recipe("lstm", "samples/walking", join=0.3, steps=2, hidden=4, batch=2, length=20)
    trainer = trainer_for(recipe, tmp_path / "a.safetensors").run(progress=False)
    clips = trainer_for(Recipe("lstm", "samples/walking", steps=2, hidden=4, batch=2, length=20))
    assert trainer.batches.n_windows > 2 * clips.batches.n_windows  # they go on and on
    resumed = trainer_for(recipe, tmp_path / "a.safetensors")
    assert resumed.finished and resumed.settings["join"] == 0.3
    with pytest.raises(TutorialError, match="join must be between 0 and 10 seconds, not -1"):
        Recipe("lstm", "samples/walking", join=-1)


def test_windows_reach_over_the_seams(walks):
    """A window longer than any clip can be had from joined ones."""
    length = round(30 * max(clip.duration for clip in walks)) + 30
    whole = playlist(walks, seconds=60)
    sampler = WindowSampler([whole], make_representation("positions", whole.skeleton, 30.0), length=length, batch=2)
    assert sampler.sample().shape[:2] == (2, length)


def test_a_blend_is_slow_at_both_ends():
    """Two who stand, one with an arm 1 m higher: over the blend it rises by t^2 (3 - 2 t)."""
    skeleton = Skeleton(("a", "b"), (-1, 0), np.array([[0, 0, 0], [0, 1.0, 0]]))
    low, high = (Motion(skeleton, 30.0, np.tile([[0, 0, 0], [0, y, 0]], (60, 1, 1))) for y in (1.0, 2.0))
    heights = join([low, high], blend=0.3).positions[:, 1, 1] - 1
    between = heights[(heights > 1e-9) & (heights < 1 - 1e-9)]
    t = (np.arange(9) + 0.5) / 9
    np.testing.assert_allclose(between, t * t * (3 - 2 * t))


def test_a_clip_is_not_left_before_it_was_entered(walks):
    """Clips as short as can be, entered late and left early, one after another: nobody steps back in time."""
    for first in range(0, 60, 6):
        parts = [walks[0][k : k + 27] for k in (first, first + 31, first + 12, first + 22)]
        assert fastest(join(parts, blend=0.3)) < 1.5 * fastest(walks[0]), first
