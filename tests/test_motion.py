"""``Motion``: immutable, cut, resampled, turned, scaled."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from tutorial_lib.errors import MotionError
from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.motion.ik import rotations_from_positions, with_rotations
from tutorial_lib.motion.rotations import quat_angle, quat_from_axis_angle, quat_rotate

ONE = Skeleton(("a", "b"), (-1, 0), [[0, 0, 0], [1, 0, 0]])


def spinning(frames: int = 61, fps: float = 60.0) -> Motion:
    """A one-metre bone about z, one radian a second; its root walks along x at 2 m/s."""
    time = np.arange(frames) / fps
    q = np.zeros((frames, 2, 4))
    q[:, 1, 0] = 1
    q[:, 0] = quat_from_axis_angle(np.array([0, 0, 1.0]), time)
    root = np.stack((2 * time, 0 * time, 0 * time), -1)
    return Motion.from_rotations(ONE, fps, root, q, name="spin")


def spin_at(time: np.ndarray) -> np.ndarray:
    return np.stack((2 * time + np.cos(time), np.sin(time), 0 * time), -1)


def test_size_and_names():
    m = spinning()
    assert len(m) == m.n_frames == 61 and m.duration == 61 / 60 and m.with_name("x").name == "x"
    assert np.allclose(m.positions[:, 1], spin_at(np.arange(61) / 60))
    assert "61 frames at 60 fps" in repr(m) and "rotations" in repr(m)
    assert pickle.loads(pickle.dumps(m)).skeleton == ONE


def test_height_of_a_skeleton_that_nobody_knows():
    """Upright at rest by its vertical, however far the arms reach; lying by its length, also where it is not flat."""

    def rest(*ends):
        names = ("root", *"abcdef"[: len(ends)])
        return Motion(Skeleton(names, (-1,) + (0,) * len(ends), [[0, 0, 0], *ends]), 30, np.zeros((2, len(names), 3)))

    top, foot = [0, 0.9, 0], [0, -0.8, 0]
    upright = rest(top, foot, [1.1, 0.5, 0], [-1.1, 0.5, 0])
    assert upright.height == pytest.approx(1.7)
    assert rest([0.9, 0.01, 0], [-0.8, 0, 0]).height == pytest.approx(1.7)  # bones along x, a little out of line
    assert rest([0.5, 0.1, 0.9], [-0.5, 0, -0.8]).height == pytest.approx(1.7)
    assert rest([0.9, 0, 0], [-0.8, 0, 0]).scaled_to(1.54).height == pytest.approx(1.54)


def test_nothing_in_it_can_be_changed(small_motion):
    with pytest.raises(ValueError):
        small_motion.positions[0, 0, 0] = 1
    with pytest.raises(ValueError):
        small_motion.rotations[0, 0, 0] = 1
    with pytest.raises(AttributeError):
        small_motion.fps = 3
    given = np.zeros((1, 2, 3))
    m = Motion(ONE, 30, given)
    given[:] = 1
    assert not m.positions.any()
    pose = np.zeros((2, 3))  # a view that is read-only itself, of what is not
    m = Motion(ONE, 30, np.broadcast_to(pose, (5, 2, 3)))
    pose[:] = 1
    assert not m.positions.any()
    memory = bytearray(48)
    m = Motion(ONE, 30, np.frombuffer(memoryview(memory).toreadonly()).reshape(1, 2, 3))
    memory[:] = np.ones(6).tobytes()
    assert not m.positions.any()
    assert np.shares_memory(small_motion.positions, small_motion[10:20].positions), "what is safe is not copied"


def test_a_motion_without_a_height_is_told_by_its_name():
    point = Motion(Skeleton(("a",), (-1,), np.zeros((1, 3))), 30, np.zeros((2, 1, 3)))
    with pytest.raises(MotionError, match="^scale to a height: the skeleton's rest pose has none"):
        point.scaled_to(1.54)
    with pytest.raises(MotionError, match="^motion 'walks/07': scale to a height: the skeleton's rest pose has none"):
        point.with_name("walks/07").scaled_to(1.54)


def test_slices(small_motion):
    part = small_motion[10:20]
    assert len(part) == 10 and np.array_equal(part.positions, small_motion.positions[10:20])
    assert np.array_equal(part.rotations, small_motion.rotations[10:20]) and part.fps == 30
    assert small_motion[::4].fps == 7.5 and len(small_motion[::4]) == 13
    for bad in (slice(5, 5), slice(60, 70), slice(None, None, -1), slice(None, None, 0), 3):
        with pytest.raises(MotionError):
            small_motion[bad]


@pytest.mark.parametrize("fps, frames", [(30.0, 31), (20.0, 21), (120.0, 121), (25.0, 26), (29.97, 30)])
def test_resampling_keeps_time(fps, frames):
    """Time is not stretched: frame i is the pose at i / fps, between two frames along the arc."""
    m = spinning().resample(fps)
    assert len(m) == frames and m.fps == fps
    time = np.arange(frames) / fps
    assert np.abs(m.positions[:, 1] - spin_at(time)).max() < 1e-12
    assert np.allclose(np.linalg.norm(m.positions[:, 1] - m.positions[:, 0], axis=-1), 1)


def test_resampling_positions_alone():
    m = spinning()
    m = Motion(m.skeleton, m.fps, m.positions).resample(25)
    assert np.abs(m.positions[:, 1] - spin_at(np.arange(26) / 25)).max() < 1e-4  # the chord of a 1/60 rad arc


def test_turning_about_the_vertical(small_motion):
    m = small_motion.rotate_y(np.pi / 2)
    x, y, z = np.moveaxis(small_motion.positions, -1, 0)
    assert np.allclose(m.positions, np.stack((z, y, -x), -1))
    root = m.positions[:, 0]
    assert np.allclose(m.skeleton.fk(m.rotations, root), m.positions)
    assert np.allclose(small_motion.rotate_y(0.7).rotate_y(-0.7).positions, small_motion.positions)


def test_moving_and_scaling(small_motion):
    assert np.allclose(small_motion.translate((1, 2, 3)).positions - small_motion.positions, [1, 2, 3])
    m = small_motion.scaled_to(1.54)
    assert m.height == pytest.approx(1.54)
    assert np.allclose(m.positions, small_motion.positions * 1.54 / small_motion.height)
    assert np.allclose(m.skeleton.fk(m.rotations, m.positions[:, 0]), m.positions)
    for bad in (1.0, (1, 2), np.zeros((50, 3))):
        with pytest.raises(MotionError, match=r"expected \(x, y, z\)"):
            small_motion.translate(bad)
    for bad in (0, -1, np.nan, np.inf):
        with pytest.raises(MotionError):
            small_motion.scaled(bad)
        with pytest.raises(MotionError):
            small_motion.resample(bad)
    with pytest.raises(MotionError, match="none"):
        Motion(Skeleton(("a",), (-1,), np.zeros((1, 3))), 30, np.zeros((2, 1, 3))).scaled_to(1.0)


def test_on_the_ground():
    positions = np.full((1000, 2, 3), 5.0)
    positions[7, 1, 1] = -3.0  # one slipped marker
    assert Motion(ONE, 30, positions).on_ground().positions[0, 0, 1] == pytest.approx(0, abs=0.1)


def test_without_end_sites(small_motion):
    m = small_motion.without_end_sites()
    assert m.skeleton.names == ("root", "spine", "leg", "shin") and not m.skeleton.end_sites
    assert np.array_equal(m.positions, small_motion.positions[:, [0, 1, 3, 4]])
    assert np.allclose(m.skeleton.fk(m.rotations, m.positions[:, 0]), m.positions)


def test_translations_of_rigid_bones_are_the_offsets(small_motion):
    t = small_motion.translations()
    assert np.allclose(t[:, 1:], small_motion.skeleton.offsets[1:])
    assert np.allclose(t[:, 0], small_motion.positions[:, 0])
    with pytest.raises(MotionError, match="positions alone"):
        Motion(ONE, 30, np.zeros((1, 2, 3))).translations()


@pytest.mark.parametrize(
    "fps, positions, rotations, told",
    [
        (0, np.zeros((1, 2, 3)), None, "above zero"),
        (np.nan, np.zeros((1, 2, 3)), None, "above zero"),
        (30, np.zeros((0, 2, 3)), None, "T >= 1"),
        (30, np.zeros((1, 3, 3)), None, r"expected \(T, 2, 3\)"),
        (30, np.zeros((2, 3)), None, r"expected \(T, 2, 3\)"),
        (30, np.array([[[0, 0, 0], [0, np.inf, 0]]]), None, "frame 0, joint 'b'"),
        (30, np.zeros((1, 2, 3)), np.ones((2, 2, 4)), "2 frames of rotations for 1"),
        (30, np.zeros((1, 2, 3)), np.ones((1, 2, 3)), r"expected \(T, 2, 4\)"),
    ],
)
def test_what_is_no_motion(fps, positions, rotations, told):
    with pytest.raises(MotionError, match=told) as caught:
        Motion(ONE, fps, positions, rotations, "x")
    assert "\n" not in str(caught.value)


def test_rotations_and_root_positions_of_different_lengths(small_motion):
    m = small_motion
    with pytest.raises(MotionError, match=r"\(5, 7, 4\) with root positions of shape \(50, 3\)"):
        Motion.from_rotations(m.skeleton, 30, m.positions[:, 0], m.rotations[:5])


# -- rotations from positions --------------------------------------------------------------------------------


def test_recovered_rotations_point_every_bone(small_motion):
    skeleton, positions = small_motion.skeleton, small_motion.positions
    q = rotations_from_positions(skeleton, positions)
    assert np.abs(skeleton.fk(q, positions[:, 0]) - positions).max() < 1e-9
    assert np.allclose(q[:, sorted(skeleton.end_sites)], [1, 0, 0, 0])


def test_recovered_rotations_have_no_twist_about_the_bone():
    """A swing's axis is perpendicular to the bone it swings: no part of it turns about the bone."""
    chain = Skeleton(tuple("abcd"), (-1, 0, 1, 2), [[0, 0, 0], [0.3, 0.1, 0], [0, 0.4, 0.2], [0.1, 0, 0.5]])
    rng = np.random.default_rng(5)
    true = rng.normal(size=(40, 4, 4))
    m = Motion.from_rotations(chain, 30, np.zeros((40, 3)), true)
    q = rotations_from_positions(chain, m.positions)
    assert np.abs(chain.fk(q, m.positions[:, 0]) - m.positions).max() < 1e-9
    for j in range(3):
        bone = chain.offsets[j + 1] / np.linalg.norm(chain.offsets[j + 1])
        assert np.abs(q[:, j, 1:] @ bone).max() < 1e-9
    assert np.allclose(q[:, 3], [1, 0, 0, 0])  # nothing hangs from it: nothing is known, nothing added
    kept = rotations_from_positions(chain, m.positions, reference=m.rotations)
    assert quat_angle(kept, m.rotations).max() < 1e-7  # twist from the reference: all of it is back


def test_joints_in_one_place_and_folded_bones_stay_finite():
    s = Skeleton(tuple("abcd"), (-1, 0, 1, 0), [[0, 0, 0], [0, 0, 0], [0, 1, 0], [1, 0, 0]])
    positions = np.zeros((3, 4, 3))
    positions[1, 2] = [0, -1, 0]
    positions[2, 2:] = [[0, 0, 1], [0, 1, 0]]
    q = rotations_from_positions(s, positions)
    assert np.isfinite(q).all() and np.allclose(np.linalg.norm(q, axis=-1), 1)
    assert np.allclose(quat_rotate(q[2, 0], np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("positions", "reference", "told"),
    [
        (np.zeros((3, 1, 3)), None, r"positions of shape \(3, 1, 3\), expected \(T, 2, 3\)"),
        (np.zeros((2, 3)), None, r"positions of shape \(2, 3\), expected"),
        (np.zeros(6), None, r"positions of shape \(6,\), expected"),
        (1.0, None, r"positions of shape \(\), expected"),
        ([[1], [2, 3]], None, "positions: expected numbers, found list"),
        (np.array([[[0.0] * 3] * 2, [[0, 0, 0], [0, np.nan, 1]]]), None, "positions not finite at frame 1"),
        (np.zeros((5, 2, 3)), np.ones((4, 2, 4)), "reference rotations of 4 frames for positions of 5"),
        (np.zeros((5, 2, 3)), np.ones((5, 2, 3)), r"reference rotations of shape \(5, 2, 3\), expected \(T, 2, 4\)"),
        (np.zeros((5, 2, 3)), np.ones((2, 4)), r"reference rotations of shape \(2, 4\), expected"),
        (np.zeros((1, 2, 3)), np.full((1, 2, 4), np.nan), "reference rotations not finite at frame 0"),
    ],
)
def test_what_no_rotations_can_be_recovered_from(positions, reference, told):
    with pytest.raises(MotionError, match=told) as error:
        rotations_from_positions(ONE, positions, reference)
    assert "\n" not in str(error.value)


def test_one_pose_may_be_the_reference_of_all_frames(small_motion):
    pose = np.tile([1.0, 0, 0, 0], (1, small_motion.skeleton.n_joints, 1))
    one, each = (
        rotations_from_positions(small_motion.skeleton, small_motion.positions, reference)
        for reference in (pose, np.repeat(pose, len(small_motion), 0))
    )
    np.testing.assert_array_equal(one, each)


def test_bones_take_their_mean_length(small_motion):
    m = Motion(small_motion.skeleton, 30, small_motion.positions * 1.1)
    got = with_rotations(m)
    assert np.allclose(got.skeleton.bone_lengths, 1.1 * m.skeleton.bone_lengths)
    assert np.array_equal(got.positions, m.positions)
    assert with_rotations(small_motion) is small_motion


def test_settled_undoes_a_drift_and_keeps_a_jump(small_motion):
    m = small_motion.translate([0, 2, 0])
    jump = np.zeros(len(m))
    jump[20:26] = 0.3
    frames = np.arange(len(m))
    still = np.repeat(m.positions[:1], len(m), axis=0)

    def moved(height):
        return Motion(m.skeleton, 30, still + height[:, None, None] * np.array([0.0, 1.0, 0.0]))

    lowest = moved(jump).settled().positions[:, :, 1].min(1)
    assert np.allclose(lowest, jump)
    lowest = moved(jump - 0.002 * frames).settled(0.5).positions[:, :, 1].min(1)
    assert np.abs(lowest - jump).max() < 0.03  # half a second of the drift
    for drift in (-0.014, 0.01):  # metres a frame, as a network that stands still may drift
        assert np.abs(moved(drift * frames).settled(0.5).positions[:, :, 1].min(1)[8:-8]).max() < 1e-9
    assert np.array_equal(moved(jump).settled().positions[..., [0, 2]], still[..., [0, 2]])
    for seconds in (0.2, 0.5, 1.0):  # a fall by a metre, over even and odd numbers of frames: never into the ground
        assert moved((frames < 20) * 1.0).settled(seconds).positions[:, :, 1].min() > -1e-9
    with pytest.raises(MotionError, match="above zero"):
        m.settled(0)


@pytest.mark.parametrize(
    "fps, to, frames, expected", [(50.0, 24.0, 126, 61), (100.0, 24.0, 126, 31), (25.0, 24.0, 126, 121)]
)
def test_resampling_keeps_the_last_frame_whatever_rounding_says(fps, to, frames, expected):
    """Of 125 steps just 60, 30 or 120 are made: 59.99999999999999 to a processor."""
    m = spinning(frames, fps)
    made = m.resample(to)
    assert len(made) == expected
    assert np.allclose(made.positions[-1], m.positions[-1])
