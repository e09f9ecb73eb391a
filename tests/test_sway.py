"""Strides are found where they are, and the sway of a gait is what was put into it."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from tutorial_lib import data, recipes
from tutorial_lib.control import (
    NoGait,
    Sway,
    constant_control,
    control_of,
    find_strides,
    fit_sway,
    integrate_control,
    path_control,
    path_deviation,
    prepared_path,
    smooth_control,
)
from tutorial_lib.errors import MotionError, TutorialError
from tutorial_lib.metrics import foot_joints, foot_slide
from tutorial_lib.motion import Motion
from tutorial_lib.motion.mirror import mirrored
from tutorial_lib.motion.retarget import to_common

FPS = 30.0


@pytest.fixture(scope="module")
def walks() -> list[Motion]:
    return [to_common(motion) for motion in data.load("samples/walking")]


@pytest.fixture(scope="module")
def sway(walks) -> Sway:
    return fit_sway([*walks, *(to_common(motion) for motion in data.load("samples/running"))])


def still(frames: int, motion: Motion) -> Motion:
    """Somebody who stands, in the first pose of a clip."""
    return Motion(motion.skeleton, motion.fps, np.repeat(motion.positions[:1], frames, 0))


def pendulum(motion: Motion, frames: int = 300, hertz: float = 0.9, reach: float = 0.35) -> Motion:
    """Somebody who stands, but for the feet, which swing past each other as known."""
    x = still(frames, motion).positions.copy()
    left, _, right, _ = foot_joints(motion.skeleton)
    hip = x[:, 0]
    swing = reach * np.cos(2 * np.pi * hertz * np.arange(frames) / FPS)
    facing = control_facing(motion)
    for node, side in ((left, 1), (right, -1)):
        x[:, node] = hip + side * swing[:, None] * facing - np.array([0, 0.8, 0])
    return dataclasses.replace(motion, positions=x, rotations=None)


def control_facing(motion: Motion) -> np.ndarray:
    from tutorial_lib.representations import heading

    angle = heading(motion.skeleton, motion.positions)[0]
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


# --- strides --------------------------------------------------------------------------------------


def test_steps_are_found_where_they_are(walks):
    found = find_strides(pendulum(walks[0]))
    assert found.steps == 17 and found.cadence == pytest.approx(108, abs=0.5)
    assert found.step_length == pytest.approx(0.7, abs=0.005)
    np.testing.assert_allclose(np.diff(found.times), 1 / 1.8, atol=0.01)
    assert (found.left[:-1] != found.left[1:]).all() and not found.left[0], "the first peak is the right foot's"
    known = np.isfinite(found.phase)
    true = 2 * np.pi * 0.9 * np.arange(300) / FPS
    off = np.angle(np.exp(1j * (found.phase - true)))[known]
    assert known.sum() > 250 and np.abs(off).max() < 0.12
    np.testing.assert_allclose(found.frequency[known][2:-2], 0.9, atol=0.03)


def test_the_sample_walkers_steps_make_their_way(walks):
    """Length times number is the way: what a figure that glides does not have."""
    for walk in walks:
        strides = find_strides(walk)
        speed = np.hypot(*smooth_control(control_of(walk), FPS)[:, 1:].T).mean()
        assert strides.step_length * strides.cadence / 60 == pytest.approx(speed, rel=0.12)


def test_who_stands_makes_no_step(walks):
    for motion in (still(90, walks[0]), still(2, walks[0])):
        strides = find_strides(motion)
        assert strides.steps == 0 and strides.step_length == 0 and strides.cadence == 0
        assert np.isnan(strides.phase).all() and len(strides.frequency) == len(motion)
    one, other = pendulum(walks[0], 120), still(90, walks[0])
    pause = dataclasses.replace(one, positions=np.concatenate([one.positions, other.positions, one.positions]))
    strides = find_strides(pause)
    assert np.isnan(strides.phase[130:200]).all() and np.isfinite(strides.phase[[60, 260]]).all()
    assert strides.cadence == pytest.approx(108, abs=1), "the pause is no slow step"


# --- sway -----------------------------------------------------------------------------------------


def test_sway_gives_back_what_a_clip_does(walks, sway):
    """Smooth control of a clip, and the sway on it: nearer to what was measured than without, in every channel."""
    steady = [walk for walk in walks if not walk.name.endswith("04")]  # its pace changes, and the cadence lags behind
    for walk in steady:
        measured, strides = control_of(walk), find_strides(walk)
        first = int(np.flatnonzero(np.isfinite(strides.phase))[0])
        part = slice(first, first + 75)
        smooth = smooth_control(measured, FPS)[part]
        made = sway.added_to(smooth, FPS, strides.phase[first]).control
        off, before = (np.sqrt(np.square(x - measured[part]).mean(0)) for x in (made, smooth))
        assert (off < 0.8 * before).all(), (walk.name, off / before)
        assert off[0] < 0.4 * before[0], "turning, the largest"


def test_nobody_drifts_by_swaying(sway):
    way = path_control(prepared_path("figure of eight"), 1.3, FPS, limits=sway.limits)
    made = sway.added_to(way.control, FPS, np.array([0.0, 1.0, 4.0]), start=way.start, heading=way.heading)
    assert made.control.shape == (3, *way.control.shape) and made.start.shape == (3, 2)
    for k in range(3):
        place, _ = integrate_control(made.control[k], FPS, made.start[k], made.heading[k])
        assert np.abs(place - way.place).max() < 0.05, "to the end of the way"
        assert path_deviation(place, way.path, FPS).mean < 0.04
    alone = sway.added_to(way.control, FPS, 1.0, start=way.start, heading=way.heading)
    np.testing.assert_allclose(alone.control, made.control[1], atol=1e-9)


def test_a_gait_is_even(walks, sway):
    """In a mirror it is the same, half a stride later; and so are clips that are mirrored."""
    control = constant_control(60, turning=0.4, forward=1.2)
    one = sway.added_to(control, FPS, 0.3).control
    other = sway.added_to(control * [-1, 1, -1], FPS, 0.3 + np.pi).control
    np.testing.assert_allclose(other, one * [-1, 1, -1], atol=1e-9)
    again = fit_sway([mirrored(walk) for walk in walks])
    direct = fit_sway(walks)
    np.testing.assert_allclose(again.offsets, direct.offsets, atol=2e-3)


def test_pace_and_tempo_are_in_the_frequency(walks, sway):
    slow, fast = (np.interp(v, sway.speeds, sway.frequency) for v in (1.2, 3.0))
    assert 0.8 < slow < 1.0 < 1.3 < fast < 1.5, "strides a second of walkers and runners"
    control = constant_control(300, forward=1.2)
    usual, quick = (sway.added_to(control, FPS, 0.0, tempo).control[:, 0] for tempo in (1.0, 1.1))
    peaks = [np.argmax(np.abs(np.fft.rfft(x, 3000))) / 100 for x in (usual, quick)]
    assert peaks[0] == pytest.approx(slow, abs=0.02) and peaks[1] == pytest.approx(1.1 * slow, abs=0.02)


def test_who_stands_does_not_sway(sway):
    made = sway.added_to(constant_control(30, forward=0.0), FPS)
    assert np.abs(made.control).max() < 0.01


def test_storing_and_bad_input(walks, sway):
    again = Sway.from_dict(json.loads(json.dumps(sway.to_dict())))
    control = constant_control(60, forward=1.3)
    np.testing.assert_allclose(again.added_to(control, FPS).control, sway.added_to(control, FPS).control, atol=1e-2)
    assert dataclasses.asdict(again.limits) == pytest.approx(dataclasses.asdict(sway.limits), abs=1e-3)
    with pytest.raises(MotionError, match="nobody walks in these clips: expected steps of 10 cm"):
        fit_sway([still(200, walks[0])])
    with pytest.raises(MotionError, match="nobody walks"):
        fit_sway([])
    for values in ({}, {**sway.to_dict(), "speeds": [1.0]}, {**sway.to_dict(), "limits": {"speed": -1}}):
        with pytest.raises(MotionError) as caught:
            Sway.from_dict(values)
        assert "\n" not in str(caught.value)
    with pytest.raises(MotionError, match=r"control of shape \(5, 2\)"):
        sway.added_to(np.zeros((5, 2)), FPS)


def quicker(motion: Motion, factor: float) -> Motion:
    """As fast along the ground, with more and shorter steps: a smaller body in quicker motion."""
    return Motion(motion.skeleton, factor * motion.fps, motion.positions / factor)


def test_how_much_tempo_differs_is_the_spread(walks):
    """Two walkers at one speed, one a tenth quicker: each is 0.05 / 1.05 from their mean."""
    straight = walks[0]
    assert fit_sway([straight]).spread == pytest.approx(0, abs=1e-6)
    assert fit_sway([straight, quicker(straight, 1.1)]).spread == pytest.approx(0.05 / 1.05, abs=0.003)


def test_what_is_left_of_one_even_walk_is_little_and_of_many_more(walks):
    one, many = fit_sway(walks[:1]).residual, fit_sway(walks).residual
    assert (one > 0.01).all() and (one < 0.1).all() and (2 * one < many).all() and (many < 0.5).all(), (one, many)


def test_faster_turns_than_were_seen_sway_as_the_fastest_seen(sway):
    """What the sway adds in the first frame, with the way beginning at the origin."""
    at = [sway.added_to(constant_control(30, turning=w, forward=1.2), FPS, 0.7) for w in (0.6, 1.2, 2.4)]
    np.testing.assert_allclose(at[1].start, at[2].start, atol=1e-12)
    assert at[1].heading == pytest.approx(at[2].heading, abs=1e-12)
    assert np.linalg.norm(at[0].start - at[1].start) > 5e-4


def test_who_runs_faster_than_the_last_knot_sways_too():
    """4.8 m/s, which the sample runners' fastest frames pass at 39 frames a second."""
    clips = [dataclasses.replace(clip, fps=39.0) for clip in data.load("samples/running")]
    found = fit_sway(clips)
    assert found.speeds[-1] == pytest.approx(4.8) and found.limits.speed > 4.8
    assert np.isfinite(found.added_to(constant_control(30, forward=4.5), FPS).control).all()
    assert recipes._sway_of(clips, FPS).speeds[-1] == pytest.approx(4.8), "a vae-lstm brings it"


def test_a_recipe_goes_without_a_sway_only_where_no_gait_can_be_had(walks, small_motion, monkeypatch):
    assert recipes._sway_of([still(200, walks[0])], FPS) is None and recipes._sway_of([small_motion], FPS) is None
    with pytest.raises(NoGait, match="nobody walks"):
        fit_sway([still(200, walks[0])])

    def broken(*_):
        raise MotionError("something else")

    monkeypatch.setattr("tutorial_lib.control.sway.fit_sway", broken)
    with pytest.raises(MotionError, match="something else"):
        recipes._sway_of(walks, FPS)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"spread": "x"}, "sway: spread 'x', expected a number of 0 or more"),
        ({"spread": np.nan}, "sway: spread nan"),
        ({"frequency": [np.nan, 1.0]}, "sway: frequency not finite"),
        ({"frequency": ["a", 1.0]}, "sway: frequency: expected numbers"),
        ({"speeds": [1.0, 0.0]}, r"sway: speeds \[1.0, 0.0\], expected rising ones"),
        ({"speeds": [0.0, 0.0]}, "expected rising ones"),
        ({"speeds": 1.0}, "sway at 0 speeds"),
        ({"offsets": np.full((2, 2, 3, 4), np.inf)}, "sway: offsets not finite"),
        ({"limits": None}, "sway: limits None, expected Limits"),
    ],
)
def test_what_is_no_sway(wrong, told):
    fits = {"speeds": [0.0, 1.0], "frequency": [0.5, 1.0], "offsets": np.zeros((2, 2, 3, 4)), "spread": np.float32(0),
            "residual": np.zeros(3)}  # fmt: skip
    kept = Sway(**fits).to_dict()
    with pytest.raises(MotionError, match=told) as error:
        Sway(**{**fits, **wrong})
    assert "\n" not in str(error.value)
    with pytest.raises(MotionError, match="sway: expected speeds, frequency") as error:
        Sway.from_dict({**kept, **wrong})


@pytest.mark.parametrize("harmonics", [0, 1.5, None])
def test_harmonics_that_are_none(walks, harmonics):
    with pytest.raises(TutorialError, match="the harmonics of a sway must be a whole number of 1 or more"):
        fit_sway(walks[:1], harmonics=harmonics)


# --- sliding feet, in centimetres a step -----------------------------------------------------------


def drawn(motion: Motion, speed: float, lift: float = 0.0, frames: int = 61) -> np.ndarray:
    """Positions of somebody who stands, and is drawn along the ground at ``speed`` m/s with the feet ``lift`` above
    where they stood in the first half second."""
    x = still(frames, motion).positions.copy()
    feet = foot_joints(motion.skeleton)
    x[:, feet, 1] = 0.0
    x[15:, :, 1] += lift
    return x + np.arange(frames)[:, None, None] / FPS * np.array([0.0, 0.0, speed])


def test_a_slide_is_the_way_of_a_foot_that_stands(walks):
    feet = foot_joints(walks[0].skeleton)
    assert float(foot_slide(drawn(walks[0], 0.1), feet, FPS)) == pytest.approx(20.0, abs=0.01)  # 2 s, one step
    assert float(foot_slide(drawn(walks[0], 0.0), feet, FPS)) == 0.0
    assert np.isnan(foot_slide(drawn(walks[0], 3.0), feet, FPS)), "too fast: no contact"
    whole = np.stack([drawn(walks[0], 0.1), drawn(walks[0], 0.2), drawn(walks[0], 3.0)])
    np.testing.assert_allclose(foot_slide(whole, feet, FPS), [20, 40, np.nan], atol=0.01)


def test_a_foot_that_rolls_off_slides_less(walks):
    """Half as high as counts it slides by 2 - sqrt(2) of its way."""
    feet = foot_joints(walks[0].skeleton)
    found = float(foot_slide(drawn(walks[0], 0.1, lift=0.0125), feet, FPS))
    share = 2 - 2**0.5
    assert found == pytest.approx(20 * (14.5 + 45.5 * share) / 60, abs=0.15)


def test_steps_are_counted_each(walks):
    """Twice lifted: three steps, of a third of the way each; a touch of two frames is none."""
    feet = foot_joints(walks[0].skeleton)
    x = drawn(walks[0], 0.1, frames=91)
    x[20:30, :, 1] += 0.2
    x[50:60, :, 1] += 0.2
    stands = (19 + 19 + 30) / 30 * 10
    assert float(foot_slide(x, feet, FPS, standing=np.zeros(4))) == pytest.approx(stands / 3, abs=0.2)
    x[63:, :, 1] += 0.2  # the last step is now from frame 60 to 62
    assert float(foot_slide(x, feet, FPS, standing=np.zeros(4))) == pytest.approx((19 + 19) / 30 * 10 / 2, abs=0.2)


def walker(motion: Motion, hertz: float = 0.9, seconds: float = 12.0, fps: float = FPS, size: float = 1.0,
           speed: float = 1.2, swing=None) -> Motion:  # fmt: skip
    """Somebody stiff who goes along z, but for the feet and a sway that is known: 3 cm to the left and 0.1 rad with the
    stride's sine, 1 cm ahead with twice its cosine, and a centimetre aside that is not the stride's."""
    t = np.arange(round(seconds * fps)) / fps
    phase = 2 * np.pi * hertz * t
    left = size * (0.03 * np.sin(phase) + 0.01 * np.sin(2 * np.pi * 1.37 * t))
    ahead, angle = size * 0.01 * np.cos(2 * phase), size * 0.1 * np.sin(phase)
    x, _, z = control_facing(motion)
    pose = motion.rotate_y(-np.arctan2(x, z)).positions[0]
    pose = pose - pose[0] * [1, 0, 1]
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    body = np.stack(
        [c * pose[:, 0] + s * pose[:, 2], np.tile(pose[:, 1], (len(t), 1)), c * pose[:, 2] - s * pose[:, 0]], -1
    )
    apart = 0.35 * np.cos(phase) if swing is None else swing(t)
    foot, _, other, _ = foot_joints(motion.skeleton)
    for node, side in ((foot, 0.5), (other, -0.5)):
        along = 2 * side * apart
        body[:, node] = np.stack([s[:, 0] * along, 0 * t + 0.1, c[:, 0] * along], -1)
    body += np.stack([left, 0 * t, speed * t + ahead], -1)[:, None]
    return Motion(motion.skeleton, fps, body)


def test_the_sway_found_is_the_one_put_in(walks):
    sway = fit_sway([walker(walks[0]), walker(walks[0], 1.0)])
    at = [np.interp(1.2, sway.speeds, sway.offsets[:, 0, c, n]) for c, n in ((0, 1), (1, 2), (2, 1))]
    assert at == pytest.approx([0.03, 0.01, 0.1], rel=0.06)
    assert np.interp(1.2, sway.speeds, sway.frequency) == pytest.approx(0.95, abs=0.02)
    assert sway.spread == pytest.approx(0.05 / 0.95, rel=0.1), "of 0.9 and 1.0 strides a second"
    assert fit_sway([walker(walks[0])]).spread < 0.01


def test_what_is_not_explained_is_a_share_and_the_rate_of_a_clip_does_not_matter(walks):
    usual, wide, fast = (
        fit_sway([walker(walks[0], **values)]) for values in ({}, {"size": 2.0}, {"fps": 60.0, "seconds": 12.02})
    )
    assert 0.2 < usual.residual[0] < 0.7, "a centimetre beside three"
    assert wide.residual[0] == pytest.approx(usual.residual[0], rel=0.05)
    np.testing.assert_allclose(fast.offsets[3], usual.offsets[3], atol=2e-3)


def test_who_swings_their_feet_on_the_spot_does_not_walk(walks):
    assert find_strides(walker(walks[0], speed=0.0)).steps > 10
    with pytest.raises(MotionError, match="nobody walks"):
        fit_sway([walker(walks[0], speed=0.0)])


def test_who_turns_faster_than_was_seen_sways_no_more():
    offsets = np.zeros((2, 2, 3, 2))
    offsets[:, 1, 2, 0] = 0.1  # radians with the cosine, of a rad/s of turning
    sway = Sway(np.array([0.0, 5.0]), np.ones(2), offsets, 0.0, np.zeros(3))
    for turning, seen in ((0.6, 0.6), (-2.4, -1.2), (2.4, 1.2)):
        control = np.tile([turning, 1.0, 0.0], (20, 1))
        assert float(sway.added_to(control, FPS).heading) == pytest.approx(0.1 * seen)


def test_a_step_that_is_hardly_one_is_none(walks):
    """The right foot passes by 3 cm only: five centimetres are needed, and all peaks on the left are one step."""
    shuffling = walker(walks[0], swing=lambda t: 0.1 + 0.115 * np.cos(2 * np.pi * 0.9 * t))
    assert find_strides(shuffling).steps == 1
    longest = walker(walks[0], swing=lambda t: (0.1 + 0.01 * t / 12) + 0.115 * np.cos(2 * np.pi * 0.9 * t))
    assert find_strides(longest).times[0] > 10, "the longest of them"


def test_steps_more_than_0_9_seconds_apart_are_no_walk(walks):
    slow = find_strides(walker(walks[0], hertz=0.4))
    assert slow.steps > 5 and np.isnan(slow.phase).all() and slow.cadence == 0
