"""Feet that stand and bones that keep their length: each step against what is known beforehand, and all together."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tutorial_lib import cleanup, data, metrics
from tutorial_lib.cleanup import (
    _smooth_below,
    bending_axis,
    clean_up,
    contact_stretches,
    grounded,
    legs,
    planted,
    rigid,
    two_bone,
)
from tutorial_lib.data.synthetic import sample_skeleton
from tutorial_lib.errors import MotionError
from tutorial_lib.motion import Motion, Skeleton, read_bvh, write_bvh
from tutorial_lib.motion.rotations import quat_about_y, quat_rotate

FPS = 30.0


@pytest.fixture(scope="module")
def walk() -> Motion:
    return data.load("samples/walking")[0][:240]


@pytest.fixture(scope="module")
def spoilt(walk) -> Motion:
    """The walk as a network might give it: its feet slide, its height drifts, its bones change their lengths."""
    t = np.arange(len(walk)) / FPS
    slide = np.stack([0.15 * np.sin(1.3 * t), 0.04 * t, 0.25 * t], axis=-1)
    root = walk.positions[:, :1]
    breathing = 1 + 0.06 * np.sin(2 * t + 1)[:, None, None]
    return Motion(walk.skeleton, FPS, root + breathing * (walk.positions - root) + slide[:, None], name="spoilt")


def jerk(motion: Motion) -> float:
    """The largest acceleration of any node, m/s^2."""
    return float(np.linalg.norm(np.diff(motion.positions, 2, axis=0), axis=-1).max() * motion.fps**2)


def statue(frames: int, height: float = 0.0) -> Motion:
    rest = sample_skeleton().rest_pose()
    pose = rest - [0, rest[:, 1].min() - height, 0]
    return Motion(sample_skeleton(), FPS, np.repeat(pose[None], frames, axis=0))


# --- two bones ------------------------------------------------------------------------------------


def solve(ankle, thigh=(0, -1.8, 2.4), shin=(0, -3.2, -2.4), axis=(1, 0, 0), reach=8.0):
    rows = [np.array([v], dtype=float) for v in ((0, 0, 0), ankle, thigh, shin, axis)]
    knee, end = two_bone(*rows, np.array([reach]))
    return knee[0], end[0]


def test_two_bones_of_three_and_four_stand_at_right_angles_over_five():
    """With 3, 4 and 5 the knee's foot on the line from hip to ankle is at 9/5, its distance from it 12/5."""
    knee, ankle = solve((0, -5, 0))
    np.testing.assert_allclose(knee, [0, -1.8, 2.4], atol=1e-12)
    np.testing.assert_allclose(ankle, [0, -5, 0], atol=1e-12)
    knee, ankle = solve((5, 0, 0))  # the leg swings sideways about z, the knee stays in front
    np.testing.assert_allclose(knee, [1.8, 0, 2.4], atol=1e-12)


def test_an_ankle_out_of_reach_is_met_as_nearly_as_the_leg_is_long():
    knee, ankle = solve((0, -9, 0), reach=6.5)
    np.testing.assert_allclose(ankle, [0, -6.5, 0], atol=1e-12)
    assert np.linalg.norm(knee) == pytest.approx(3) and np.linalg.norm(knee - ankle) == pytest.approx(4)
    _, ankle = solve((0, -0.2, 0))  # nearer than 4 - 3
    np.testing.assert_allclose(ankle, [0, -1, 0], atol=1e-5)


def test_a_straight_leg_bends_the_way_it_usually_does():
    knee, _ = solve((0, -5, 0), thigh=(0, -3, 0), shin=(0, -4, 0))
    np.testing.assert_allclose(knee, [0, -1.8, 2.4], atol=1e-6)
    backwards = solve((0, -5, 0), thigh=(0, -3, -0.01), shin=(0, -4, 0.01))[0]
    assert backwards[2] > 2.3  # a knee a little overstretched, as networks make them


def test_the_usual_bend_is_told_by_the_frames_that_show_it():
    thigh = np.array([[0, -1.0, 0]] * 3)
    shin = np.array([[0, -1, -0.5], [0, -1, 0], [0, -1, 1e-3]])
    axis = bending_axis(thigh, shin, np.array([[1.0, 0, 0, 0]] * 3))
    np.testing.assert_allclose(axis, [[1, 0, 0]] * 3, atol=1e-12)


# --- bones ----------------------------------------------------------------------------------------


def test_bones_get_their_length_and_keep_their_direction(spoilt):
    fixed = rigid(spoilt)
    skeleton = fixed.skeleton
    assert metrics.bone_length_drift(spoilt.positions, skeleton).mean() > 0.02
    assert metrics.bone_length_drift(fixed.positions, skeleton, reduce="max").max() < 1e-9
    np.testing.assert_allclose(fixed.positions[:, 0], spoilt.positions[:, 0], atol=1e-12)
    for p, j in skeleton.bones:  # all have changed by one factor, so no direction has to give way
        was, now = (x.positions[:, j] - x.positions[:, p] for x in (spoilt, fixed))
        cosine = (was * now).sum(1) / np.linalg.norm(was, axis=1) / np.linalg.norm(now, axis=1)
        assert cosine.min() > 1 - 1e-9, skeleton.names[j]


def test_right_bones_are_left_alone(walk):
    assert rigid(walk) is walk
    bare = dataclasses.replace(walk, rotations=None)
    np.testing.assert_allclose(rigid(bare).positions, walk.positions, atol=1e-9)


def test_a_bone_that_collapses_takes_its_direction_from_the_frames_about_it(walk):
    x = walk.positions.copy()
    j = walk.skeleton.index("LeftHand")
    p = walk.skeleton.parents[j]
    rng = np.random.default_rng(0)
    x[100:104, j] = x[100:104, p] + rng.normal(scale=1e-3, size=(4, 3))
    fixed = rigid(Motion(walk.skeleton, FPS, x))
    assert np.linalg.norm(fixed.positions[90:115, j] - walk.positions[90:115, j], axis=-1).max() < 0.05


# --- ground and contacts --------------------------------------------------------------------------


def test_a_slow_drift_of_the_ground_goes_and_a_jump_stays():
    t = np.arange(300) / FPS
    jump = np.where((t > 5) & (t < 5.5), 0.4 * np.sin(2 * np.pi * (t - 5)), 0)
    motion = statue(300)
    moved = Motion(motion.skeleton, FPS, motion.positions + (jump - 0.1 * t)[:, None, None] * [0, 1, 0])
    lowest = grounded(moved).positions[:, :, 1].min(1)
    assert np.abs(lowest - jump)[15:-15].max() < 0.06 and np.abs(lowest[t < 4]).max() < 0.06


def test_contacts_are_the_stretches_in_which_a_foot_was_held():
    motion = statue(90)
    left, right = legs(motion.skeleton)
    x = motion.positions.copy()
    swing = np.sin(np.pi * np.arange(16) / 15)
    x[30:46, left.toe, 1] += 0.3 * swing
    x[30:46, left.toe, 2] += np.linspace(0, 0.8, 16)
    x[46:, left.toe, 2] += 0.8
    x[60, right.toe, 1] += 0.2  # one frame is no lift
    left_toe, right_toe = contact_stretches(Motion(motion.skeleton, FPS, x), [left.toe, right.toe])
    assert left_toe == [(0, 30), (45, 89)] and right_toe == [(0, 89)]


def test_a_foot_that_glides_gets_places_to_step_to():
    motion = statue(120)
    toe = legs(motion.skeleton)[0].toe
    x = motion.positions + np.arange(120)[:, None, None] * np.array([0, 0, 0.5 / FPS])
    stretches = contact_stretches(Motion(motion.skeleton, FPS, x), [toe])[0]
    assert len(stretches) > 3
    for first, last in stretches:
        assert np.linalg.norm(x[last, toe] - x[first, toe]) <= 0.25 + 1e-9
    assert all(b[0] - a[1] > 4 for a, b in zip(stretches, stretches[1:], strict=False))


def test_a_foot_that_glides_for_a_moment_has_not_been_lifted():
    """In the middle of a stance it glides 12 cm in a quarter of a second: for a walker that is one stance; not if the
    foot was lifted, went farther, or took longer."""
    motion = statue(90)
    toe = legs(motion.skeleton)[0].toe

    def found(frames: int = 7, metres: float = 0.25, lift: float = 0.0, bridge: float = 0.3):
        x = motion.positions.copy()
        way = np.clip((np.arange(90) - 40) / frames, 0, 1)[:, None, None] * np.array([0, 0, metres])
        x[41 : 40 + frames, toe, 1] += lift
        return contact_stretches(Motion(motion.skeleton, FPS, x + way), [toe], bridge)[0]

    assert len(found(bridge=0.0)) == 2 and found(metres=0.24) == [(0, 89)]
    assert len(found(metres=0.4)) == 2 and len(found(lift=0.1)) == 2 and found(lift=0.03, metres=0.24) == [(0, 89)]
    assert len(found(frames=14, metres=0.24, lift=0.045)) == 2


def test_the_root_is_lowered_smoothly_and_enough():
    curve = np.zeros(60)
    curve[30], curve[33] = -0.2, -0.1
    smooth = _smooth_below(curve, 4)
    assert (smooth <= curve + 1e-12).all() and smooth.min() >= -0.2 - 1e-12
    assert np.abs(np.diff(smooth)).max() < 0.07 and smooth[:20].max() == smooth[50:].min() == 0


# --- all of it ------------------------------------------------------------------------------------


def test_feet_stand_bones_are_rigid_and_nothing_jumps(spoilt):
    clean = clean_up(spoilt)
    feet = metrics.foot_joints(spoilt.skeleton)
    before = metrics.foot_skate(grounded(spoilt).positions, feet, FPS)
    assert before > 20 and metrics.foot_skate(clean.positions, feet, FPS) < 0.3 * before
    assert metrics.bone_length_drift(clean.positions, clean.skeleton, reduce="max").max() < 1e-9
    assert clean.positions[:, feet, 1].min() > -0.005  # nothing sinks
    assert jerk(clean) < 1.5 * jerk(spoilt)
    assert (len(clean), clean.fps, clean.name, clean.skeleton) == (240, FPS, "spoilt", spoilt.skeleton)

    ready = grounded(rigid(spoilt))
    for leg in legs(spoilt.skeleton):  # a toe is at one place, to a tenth of a millimetre, as long as it stands
        for first, last in contact_stretches(ready, [leg.toe])[0]:
            assert np.ptp(clean.positions[first : last + 1, leg.toe][:, [0, 2]], axis=0).max() < 1e-4
        bend = []
        for x in (ready.positions, clean.positions):
            bend.append(np.cross(x[:, leg.knee] - x[:, leg.hip], x[:, leg.ankle] - x[:, leg.knee]))
        assert ((bend[0] * bend[1]).sum(1) > 0).all()  # knees bend their own way


def test_heels_stand_as_well_as_toes(spoilt):
    """As far as feet slide in a step, of real walkers 1.5 to 2.5 cm: heels that roll off are a part of it."""
    feet = metrics.foot_joints(spoilt.skeleton)
    before, after = (metrics.foot_slide(x.positions, feet, FPS) for x in (grounded(spoilt), clean_up(spoilt)))
    assert before > 6 and after < 1.2, (before, after)


@pytest.mark.parametrize("clip, frame", [(1, 192), (4, 177)])
def test_who_turns_on_the_ball_of_a_foot_still_does(clip, frame, monkeypatch):
    """A boxer's right foot turns by 36 degrees and more while it stands; held as it mostly stands it would not."""
    motion = data.load("samples/boxing")[clip].on_ground()
    leg = legs(motion.skeleton)[1]

    def heel(motion: Motion) -> np.ndarray:
        return (motion.positions[frame, leg.ankle] - motion.positions[frame, leg.toe])[[0, 2]]

    assert np.linalg.norm(heel(clean_up(motion)) - heel(motion)) < 0.005
    monkeypatch.setattr(cleanup, "SWIVEL", 1.0)
    assert np.linalg.norm(heel(clean_up(motion)) - heel(motion)) > 0.06


def test_a_foot_that_stands_flat_does_not_turn():
    """Its heel trembles about the toe by 2 cm, as generated feet do, less than somebody who turns."""
    motion = statue(90)
    leg = legs(motion.skeleton)[0]
    ankle, toe = motion.positions[:, leg.ankle], motion.positions[:, leg.toe]
    x, along = motion.positions.copy(), ankle - toe
    turn = quat_about_y(0.15 * np.sin(2 * np.pi * np.arange(90) / 25))
    x[:, leg.ankle] = toe + quat_rotate(turn, along)
    trembling = Motion(motion.skeleton, FPS, x)
    before, after = (
        np.ptp((m.positions[:, leg.ankle] - m.positions[:, leg.toe])[:, [0, 2]], axis=0).max()
        for m in (trembling, clean_up(trembling))
    )
    assert before > 0.03 and after < 1e-4, (before, after)


@pytest.mark.parametrize("name", ["walking", "dancing", "boxing"])
def test_good_motion_changes_little(name):
    motion = data.load(f"samples/{name}")[1][:300].on_ground()
    clean = clean_up(motion)
    moved = np.linalg.norm(clean.positions - motion.positions, axis=-1)
    assert moved.mean() < 0.01 and moved.max() < 0.1, (moved.mean(), moved.max())
    assert jerk(clean) < 1.4 * jerk(motion)
    upper = motion.skeleton.index("Head")  # the trunk only goes down where a leg is too short
    np.testing.assert_allclose((clean.positions - motion.positions)[:, upper, [0, 2]], 0, atol=1e-9)


def test_the_root_comes_down_to_where_the_feet_reach():
    """A figure with straight legs hovers 3 cm above where its feet are told to be."""
    ground, motion = statue(60), statue(60)
    height = ground.positions[:, :, 1].min()
    feet = [n for leg in legs(motion.skeleton) for n in (leg.ankle, leg.toe)]
    x = motion.positions.copy()
    x[20:40, :, 1] += 0.03
    hovering = rigid(Motion(motion.skeleton, FPS, x))
    clean = planted(hovering, {n: [(0, 59)] if n in feet else [] for n in feet})
    for leg in legs(motion.skeleton):
        np.testing.assert_allclose(np.ptp(clean.positions[:, leg.toe], axis=0)[[0, 2]], 0, atol=1e-4)
    assert metrics.bone_length_drift(clean.positions, clean.skeleton, reduce="max").max() < 1e-9
    assert clean.positions[:, :, 1].min() > height - 1e-3


@pytest.mark.parametrize(
    "motion",
    [
        statue(100),
        statue(2),
        statue(1),
        statue(40, height=2.0),
        Motion(
            sample_skeleton(), FPS, statue(40).positions + np.linspace(3, 0, 40)[:, None, None] ** 2 * [0.2, 1.0, 0.3]
        ),
        Motion(sample_skeleton(), FPS, np.zeros((30, sample_skeleton().n_joints, 3))),
        Motion(sample_skeleton(), FPS, np.random.default_rng(0).normal(size=(60, sample_skeleton().n_joints, 3))),
    ],
    ids=["statue", "two frames", "one frame", "hovers", "falls", "a point", "noise"],
)
def test_odd_input_gives_a_finite_rigid_motion(motion):
    clean = clean_up(motion)
    assert len(clean) == len(motion) and np.isfinite(clean.positions).all()
    assert metrics.bone_length_drift(clean.positions, clean.skeleton, reduce="max").max() < 1e-6


def test_a_statue_stays_as_it_is():
    motion = statue(60)
    np.testing.assert_allclose(clean_up(motion).positions, motion.positions, atol=2e-3)


def test_wrong_input_is_told(walk, small_motion):
    with pytest.raises(MotionError, match="unknown skeleton"):
        clean_up(small_motion)
    with pytest.raises(MotionError, match="not finite at frame 3"):
        x = walk.positions.copy()
        x[3, 0, 0] = np.nan
        clean_up(Motion(walk.skeleton, FPS, x))
    for seconds in (np.nan, -1, np.inf, "long"):
        with pytest.raises(MotionError, match=f"grounded: a ground over {seconds!r} seconds, expected a number"):
            grounded(walk, seconds)
    with pytest.raises(MotionError, match="positions alone"):
        planted(Motion(walk.skeleton, FPS, walk.positions), {})
    s = walk.skeleton
    j = s.index("LeftLeg")
    parents = list(s.parents)
    parents[j] = 0
    odd = Skeleton(s.names, tuple(parents), s.offsets, s.orders, s.end_sites)
    with pytest.raises(MotionError, match="'LeftLeg' hangs from .*expected 'LeftUpLeg'"):
        legs(odd)


def test_a_clean_motion_is_written_without_moving_bones(spoilt, tmp_path):
    """Only the root has position channels, so the bones are the OFFSETs of the file, which are the skeleton's."""
    clean = clean_up(spoilt)
    write_bvh(clean, tmp_path / "clean.bvh")
    assert (tmp_path / "clean.bvh").read_text().count("CHANNELS 6") == 1
    back = read_bvh(tmp_path / "clean.bvh", quiet=True)
    nodes = [back.skeleton.index(name) for name in clean.skeleton.names]
    np.testing.assert_allclose(
        np.linalg.norm(back.skeleton.offsets[nodes[1:]], axis=1), clean.skeleton.bone_lengths, atol=1e-6
    )
    np.testing.assert_allclose(back.positions[:, nodes], clean.positions, atol=1e-5)
