"""Metrics on motions whose error, standstill, slide and stretch are known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tutorial_lib import metrics
from tutorial_lib.errors import TutorialError
from tutorial_lib.motion import Skeleton, read_motion
from tutorial_lib.representations import make_representation


def both(array):
    """The same numbers as an array and as a tensor."""
    return (np.asarray(array, dtype=np.float64), torch.tensor(array, dtype=torch.float64))


def close(found, expected, **tolerance):
    np.testing.assert_allclose(np.asarray(found), expected, **(tolerance or {"rtol": 1e-9, "atol": 1e-12}))


# -- distance to the truth ---------------------------------------------------------------------------------


def test_frame_distance():
    for a in both([[[3.0, 4.0], [0, 0]]]):
        found = metrics.frame_distance(a, a * 0)
        assert type(found) is type(a)
        close(found, [[5, 0]])


def test_times_are_counted_from_the_seeds_last_frame():
    assert metrics.frames_at(metrics.PAPER_TIMES_MS, 25) == [2, 4, 6, 8, 10, 12, 14, 16]
    assert metrics.frames_at(metrics.PAPER_TIMES_MS, 30) == [2, 5, 7, 10, 12, 14, 17, 19]
    assert metrics.frames_at((80, 1), 60) == [5, 1]


def test_prediction_error_by_hand():
    """Frame t is off by (3t, 4t) for one seed and not at all for the other: 5 t / 2 on average."""
    t = np.arange(1, 21.0)
    off = np.stack([np.stack([3 * t, 4 * t], 1), np.zeros((20, 2))])
    truth = np.random.default_rng(0).normal(size=(2, 20, 2))
    for p, q in zip(both(truth + off), both(truth), strict=True):
        close(metrics.prediction_error(p, q, 25.0), 2.5 * np.arange(2, 17, 2))
        close(metrics.prediction_error(p, q, 25.0, times_ms=[400]), [25])


def test_prediction_errors_of_each_seed_and_what_their_mean_is_worth():
    t = np.arange(1, 21.0)
    off = np.stack([np.stack([3 * t, 4 * t], 1), np.zeros((20, 2)), np.stack([0 * t, t], 1)])
    for p, q in zip(both(off), both(off * 0), strict=True):
        each = metrics.prediction_errors(p, q, 25.0, times_ms=[80, 400])
        close(each, [[10, 50], [0, 0], [2, 10]])
        close(each.mean(0), metrics.prediction_error(p, q, 25.0, times_ms=[80, 400]))
        close(metrics.standard_error(each), np.sqrt(np.array([28.0, 700.0]) / 3))  # squares 36 + 16 + 4, over 2
        assert np.isnan(np.asarray(metrics.standard_error(each[:1]))).all()


def test_prediction_error_refuses():
    x = np.zeros((2, 10, 3))
    with pytest.raises(TutorialError, match="640 ms at 30 .* 19 frames.* have 10"):
        metrics.prediction_error(x, x, 30.0)
    with pytest.raises(TutorialError, match=r"\(2, 10, 3\) .* \(2, 10, 4\)"):
        metrics.prediction_error(x, np.zeros((2, 10, 4)), 30.0)
    with pytest.raises(TutorialError, match="3 and of 4"):
        metrics.frame_distance(x, np.zeros((2, 10, 4)))


# -- does it still move ------------------------------------------------------------------------------------


def test_motion_change_by_hand():
    x = np.array([[[0.0, 0], [3, 4], [3, 4]], [[1.0, 1], [1, 2], [1, 4]]])
    for f in both(x):
        close(metrics.frame_change(f), [[5, 0], [1, 2]])
        close(metrics.motion_change(f), [3, 1])
        close(metrics.motion_change(f[0]), [5, 0])
    with pytest.raises(TutorialError, match="at least 2"):
        metrics.motion_change(x[:, :1])


def test_moving_mean():
    curve = np.random.default_rng(0).normal(size=(3, 50))
    for c in both(curve):
        close(metrics.moving_mean(c, 7), np.stack([np.convolve(row, np.ones(7) / 7, "valid") for row in curve]))
    with_nan = curve[0].copy()
    with_nan[10] = np.nan
    assert np.flatnonzero(np.isnan(metrics.moving_mean(with_nan, 7))).tolist() == list(range(4, 11))
    with pytest.raises(TutorialError, match="51 .* 50"):
        metrics.moving_mean(curve, 51)


def test_freezing_time():
    """At 10 fps: moves by 1 a frame, by 0.01 from 3 s on; a pause from 1 to 1.5 s is too short to count."""
    change = np.ones((4, 100))
    change[0, 30:] = 0.01
    change[1, 10:15] = 0.0
    change[2, 30:] = 0.06
    change[3] = np.nan
    for c in both(change):
        # the mean over 1 s is below 0.05 first when all ten values are 0.01: one 1 more would make it 0.109
        found = metrics.freezing_time(c, 1.0, 10.0, fraction=0.05)
        assert type(found) is type(c)
        close(found, [3.0, np.inf, np.inf, np.inf])
        close(metrics.freezing_time(c, 1.0, 10.0, fraction=0.1), [3.0, np.inf, 3.0, np.inf])
        close(metrics.freezing_time(c, 1.0, 10.0, fraction=0.1, seconds=0.5), [3.0, 1.0, 3.0, np.inf])
        close(metrics.freezing_time(c[0], np.float64(1.0), np.float64(10.0)), 3.0)
        assert metrics.freezing_time(c, 0.05, 10.0)[0] == np.inf  # a slow truth
    with pytest.raises(TutorialError, match="100 .* at least 200 .* 20 s"):
        metrics.freezing_time(change, 1.0, 10.0, seconds=20)
    with pytest.raises(TutorialError, match="above zero"):
        metrics.freezing_time(change, 0.0, 10.0)


def test_stagnations_are_counted_and_recovered_from():
    change = np.ones(200)
    change[50:75] = 0
    change[120:131] = 0
    change[150:155] = 0  # half a second: too short
    for c in both(change):
        assert metrics.stagnations(c, 1.0, 10.0, fraction=0.05) == [(5.0, 2.5), (12.0, 1.1)]
    assert metrics.stagnations(np.ones(30), 1.0, 10.0) == []
    with pytest.raises(TutorialError, match="one motion"):
        metrics.stagnations(np.ones((2, 30)), 1.0, 10.0)


def test_pose_spread_and_being_stuck():
    """One node goes round the root, 1 m away, once in 2 s; then it trembles by a centimetre."""
    fps, rng = 10.0, np.random.default_rng(0)
    t = np.arange(200) / fps
    positions = np.zeros((200, 2, 3))
    positions[:, 0] = np.stack([5 * t, 0 * t, -t], 1)  # where the root goes is not the pose
    ring = np.stack([np.cos(np.pi * t), 0 * t, np.sin(np.pi * t)], 1)
    ring[100:] = ring[100] + rng.normal(scale=0.01, size=(100, 3))
    positions[:, 1] = positions[:, 0] + ring
    for p in both(positions):
        spread = metrics.pose_spread(p, fps, 4.0)
        assert type(spread) is type(p) and spread.shape == (161,)
        # of the two nodes one is at 1 m from its mean, the other at none
        close(spread[:60], np.sqrt(0.5), rtol=1e-6)
        window = ring[120:160]
        expected = np.sqrt(((window - window.mean(0)) ** 2).sum(1).mean() / 2)
        assert float(spread[120]) == pytest.approx(expected, rel=1e-6) and expected < 0.02
        stuck = metrics.stuck_time(p, np.sqrt(0.5), fps, fraction=0.25, seconds=4.0)
        assert 9.0 <= float(stuck) <= 10.0
        close(metrics.stuck_time(np.asarray(p)[:130], np.sqrt(0.5), fps, seconds=4.0), np.inf)
        gone = metrics.stuck_time(np.asarray(p) * np.nan, 1.0, fps, seconds=4.0)
        assert float(gone) == np.inf, "what is not finite is not stuck"
    with pytest.raises(TutorialError, match="above zero"):
        metrics.stuck_time(positions, 0.0, fps)
    with pytest.raises(TutorialError, match="300 values of a curve of 200"):
        metrics.pose_spread(positions, fps, 30.0)


# -- is it still a person ----------------------------------------------------------------------------------


def test_divergence_time():
    positions = np.zeros((4, 30, 3, 3))
    positions[:, :, 0] = (100, 0, 50)  # where the root is does not matter
    positions[:, :, 1] = (100, 1.0, 50)
    positions[:, :, 2] = (100, 1.0, 50)
    positions[1, 12, 2] = (100, 1.4, 50)  # far, but within 1.5 times
    positions[2, 12, 2] = (101.2, 1.0, 50)  # 1.56
    positions[3, 20, 1, 0] = np.nan
    for p in both(positions):
        assert float(metrics.reach(p[0])) == pytest.approx(1.0)
        close(metrics.divergence_time(p, 1.0, 10.0), [np.inf, np.inf, 1.2, 2.0])
        close(metrics.divergence_time(p, metrics.reach(p[:1]), 10.0, factor=1.3), [np.inf, 1.2, 1.2, 2.0])
        assert np.asarray(metrics.diverged(p, 1.0)).tolist() == [False, False, True, True]
        close(metrics.divergence_time(p[2], 1.0, 10.0), 1.2)


def test_pose_distance_is_the_best_turn_about_the_vertical():
    """Against turns tried one by one."""
    rng = np.random.default_rng(1)
    poses, x = rng.normal(size=(3, 4, 3)), rng.normal(size=(2, 5, 4, 3))
    flat, roots = x.reshape(-1, 4, 3), poses - poses[:, :1]
    angles = np.linspace(0, 2 * np.pi, 7200, endpoint=False)
    cos, sin = np.cos(angles), np.sin(angles)
    expected = []
    for pose in flat - flat[:, :1]:
        best = np.inf
        for p in roots:
            around = np.stack([np.outer(cos, p[:, 0]) + np.outer(sin, p[:, 2]), np.tile(p[:, 1], (7200, 1)),
                               np.outer(cos, p[:, 2]) - np.outer(sin, p[:, 0])], -1)  # fmt: skip
            best = min(best, np.sqrt(((around - pose) ** 2).sum(-1).mean(-1)).min())
        expected.append(best)
    for p, q in zip(both(x), both(poses), strict=True):
        found = metrics.pose_distance(p, q)
        assert type(found) is type(p)
        close(found, np.reshape(expected, (2, 5)), atol=1e-4)
    moved = roots @ np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]) + [4, 0.3, -2]  # a quarter turn, elsewhere
    close(metrics.pose_distance(moved, poses), [0, 0, 0], atol=2e-3)
    moved[1, 2, 0] = np.nan
    assert np.isinf(metrics.pose_distance(moved, poses)).tolist() == [False, True, False]
    with pytest.raises(TutorialError, match=r"\(3, 4, 3\) and .* \(3, 5, 3\)"):
        metrics.pose_distance(poses, np.zeros((3, 5, 3)))


def test_pose_range_holds_out_each_clip():
    """Poses of a stick that is 1, 1.1 and 1.5 m long: the last is 0.4 from its nearest, over two nodes."""
    clips = [np.array([[[0, 0, 0], [0, length, 0]]] * 3, dtype=float) for length in (1.0, 1.1, 1.5)]
    assert metrics.pose_range(clips) == pytest.approx(0.4 / np.sqrt(2), rel=1e-3)
    with pytest.raises(TutorialError, match="1 clip"):
        metrics.pose_range(clips[:1])


def test_range_exit_time():
    distance = np.full((4, 60), 0.9)
    distance[1, 20:] = 1.3
    distance[2, 20:24] = 5.0  # one of them lifts the mean of a second to 1.31
    distance[3, 30] = np.inf
    for d in both(distance):
        found = metrics.range_exit_time(d, 1.0, 10.0)
        assert type(found) is type(d)
        # of ten frames nine of 1.3 are needed: 0.9 + 9 * 1.3 is just above 12.5
        close(found, [np.inf, 1.9, 1.1, 2.1])
        close(metrics.range_exit_time(d[:3], 1.0, 10.0, factor=3.0), [np.inf] * 3)


# -- feet --------------------------------------------------------------------------------------------------


def stepping(slide: float, fps: float = 20.0) -> np.ndarray:
    """One foot: a second on the ground sliding at ``slide`` m/s, a second in the air at 3 m/s, and again."""
    x, y, place = [], [], 0.0
    for _ in range(2):
        for height, speed in ((0.08, slide), (0.3, 3.0)):
            for _ in range(int(fps)):
                x.append(place)
                y.append(height)
                place += speed / fps
    positions = np.zeros((len(x), 2, 3))
    positions[:, 1, 2], positions[:, 1, 1] = x, y
    return positions


def test_foot_skate():
    for p in both(np.stack([stepping(0.0), stepping(0.15)])):
        contact = np.asarray(metrics.foot_contacts(p, [1], 20.0))
        # steps between two frames on the ground; frame 19 to 20 lifts off
        assert np.flatnonzero(contact[1, :, 0]).tolist() == list(range(19)) + list(range(40, 59))
        found = metrics.foot_skate(p, [1], 20.0)
        assert type(found) is type(p)
        close(found, [0.0, 15.0], atol=1e-9)
        close(metrics.foot_skate(p[1], [1], 20.0), 15.0)
        # against the standing height of real clips, a figure that hovers 10 cm has no contact
        hovering = p + p.new_tensor([0, 0.1, 0]) if isinstance(p, torch.Tensor) else p + np.array([0, 0.1, 0])
        close(metrics.foot_skate(hovering, [1], 20.0, standing=metrics.standing_heights(p, [1])), [0, 0])
        close(metrics.standing_heights(p, [1]), [[0.08], [0.08]])


def test_a_swinging_foot_near_the_ground_does_not_slide():
    fast = np.zeros((40, 1, 3))
    fast[:, 0, 0] = np.arange(40) * 2.0 / 20  # 2 m/s at height zero
    assert metrics.foot_skate(fast, [0], 20.0) == 0
    close(metrics.foot_skate(fast, [0], 20.0, speed=3.0), 200)
    with pytest.raises(TutorialError, match="T >= 2"):
        metrics.foot_skate(fast[:1], [0], 20.0)


def test_feet_that_are_nowhere_do_not_count_as_standing_still():
    for p in both(np.stack([stepping(0.15), stepping(0.15), stepping(0.15)])):
        p[1, 70:] = np.nan
        p[2, 5, 1, 1] = np.inf
        close(metrics.foot_skate(p, [1], 20.0), [15.0, np.nan, np.nan])


def test_feet_that_are_nowhere_slide_no_known_way():
    whole, gone, far = (stepping(0.15) for _ in range(3))
    gone[70:] = np.nan
    far[20:30, 1, 1] = np.inf
    for p in both(np.stack([whole, gone, far])):
        truth = float(metrics.foot_slide(p[0], [1], 20.0))
        assert truth > 0
        for standing in (None, np.full((3, 1), 0.08)):
            close(metrics.foot_slide(p, [1], 20.0, standing), [truth, np.nan, np.nan])


def test_foot_joints_by_name():
    from tutorial_lib.motion.skeletons import COMMON_JOINTS, COMMON_PARENTS

    parents = tuple(-1 if p is None else COMMON_JOINTS.index(p) for p in COMMON_PARENTS.values())
    skeleton = Skeleton(COMMON_JOINTS, parents, np.ones((21, 3)))
    assert [COMMON_JOINTS[j] for j in metrics.foot_joints(skeleton)] == [
        "LeftFoot", "LeftToe", "RightFoot", "RightToe",
    ]  # fmt: skip
    with pytest.raises(TutorialError, match="unknown skeleton"):
        metrics.foot_joints(Skeleton(("a", "b"), (-1, 0), np.ones((2, 3))))


# -- bones -------------------------------------------------------------------------------------------------


def test_bone_length_drift():
    skeleton = Skeleton(("a", "b", "c", "d"), (-1, 0, 1, 2), np.array([[0, 0, 0], [0, 2, 0], [0, 1, 0], [0, 0, 0]]))
    rest = np.array([[0, 0, 0], [0, 2, 0], [0, 3, 0], [0, 3, 0.0]])
    longer = rest + [[0, 0, 0], [0, 0.2, 0], [0, 0.2, 0], [0, 0.2, 0]]  # first bone 10 % longer
    shorter = rest - [[0, 0, 0], [0, 0, 0], [0, 0.5, 0], [0, 0.5, 0]]  # second bone half
    for p in both(np.stack([np.stack([rest, longer, shorter])] * 2)):
        close(metrics.bone_lengths(p, skeleton)[0], [[2, 1, 0], [2.2, 1, 0], [2, 0.5, 0]])
        drift = metrics.bone_length_drift(p, skeleton)
        assert type(drift) is type(p)
        close(drift, [[0, 0.05, 0.25]] * 2)
        close(metrics.bone_length_drift(p[0], skeleton, reduce="max"), [0, 0.1, 0.5])
        from_second = metrics.bone_length_drift(p[:, 1:], skeleton, reference="first", reduce="max")
        close(from_second, [[0, 0.5]] * 2)
    with pytest.raises(TutorialError, match="'median'"):
        metrics.bone_length_drift(rest[None], skeleton, reduce="median")
    single = Skeleton(("a",), (-1,), np.zeros((1, 3)))
    for reduce in ("mean", "max"):
        with pytest.raises(TutorialError, match="none of 0 bones has a length in the skeleton"):
            metrics.bone_length_drift(np.zeros((4, 1, 3)), single, reduce=reduce)
        with pytest.raises(TutorialError, match="none of 3 bones has a length in the motion's first frame"):
            metrics.bone_length_drift(np.zeros((4, 4, 3)), skeleton, "first", reduce)
        assert np.isnan(metrics.bone_length_drift(np.full((4, 4, 3), np.nan), skeleton, "first", reduce)).all()


# -- the whole ---------------------------------------------------------------------------------------------


def test_on_a_rigid_figure(small_motion):
    """Forward kinematics keeps bones; a representation by positions gives them back."""
    r = make_representation("positions", small_motion.skeleton, 30)
    features = r.encode(small_motion)
    positions = r.decode_positions(features)
    assert metrics.bone_length_drift(positions, small_motion.skeleton, reduce="max").max() < 1e-5
    # the root's step and the others' relative steps, summed here joint by joint
    joints = small_motion.positions - small_motion.positions[:, :1]
    steps = np.diff(small_motion.positions[:, 0], axis=0)
    squares = (np.diff(joints, axis=0) ** 2).sum((1, 2))
    squares[1:] += (np.diff(steps, axis=0) ** 2).sum(1)
    close(metrics.motion_change(features), np.sqrt(squares), rtol=1e-4)


def test_gradients_pass():
    x = torch.randn(2, 25, 6, requires_grad=True)
    metrics.prediction_error(x, torch.zeros(2, 25, 6), 30.0).sum().backward()
    assert torch.isfinite(x.grad).all() and (x.grad[:, 1] != 0).all()


def test_real_walking_stands_still_nowhere_and_hardly_slides(real_clips):
    motion = read_motion(real_clips("cmu/walking/*.bvh")[0]).resample(30)
    r = make_representation("positions", motion.skeleton, 30)
    change = metrics.frame_change(r.encode(motion))
    assert metrics.freezing_time(change, change.mean(), 30.0) == np.inf
    reach = metrics.reach(motion.positions)
    assert 0.7 < reach < 1.5 and not metrics.diverged(motion.positions, reach)
    skate = metrics.foot_skate(motion.positions, metrics.foot_joints(motion.skeleton), 30.0)
    assert 0 < skate < 40  # ankles roll over standing toes


def test_a_foot_stands_where_it_is_lowest_for_a_twentieth_of_the_time():
    positions = np.full((100, 1, 3), 0.3)
    positions[:10, 0, 1] = 0.08
    close(metrics.standing_heights(positions, [0]), [0.08])


def test_foot_slide_by_hand():
    """Of 0.1 s at 20 fps, the shortest that is a step: a foot 2 cm a frame aside, 0, 1 and 2 cm above the ground."""
    x = np.zeros((9, 1, 3))
    x[:, 0, 2], x[:, 0, 1] = 0.02 * np.arange(9), [0.3, 0.3, 0.3, 0, 0.01, 0.02, 0.3, 0.3, 0.3]
    expected = 2 * (2 - 2 ** (0.005 / 0.025)) + 2 * (2 - 2 ** (0.015 / 0.025))  # each from half way up
    for p in both(x):
        close(metrics.foot_slide(p, [0], 20.0, np.zeros(1)), expected)
        assert np.isnan(float(metrics.foot_slide(p, [0], 20.0, np.zeros(1), shortest=0.15)))


def test_a_distance_that_is_not_a_number_is_out_of_range():
    distance = np.full(60, 0.9)
    distance[30] = np.nan
    close(metrics.range_exit_time(distance, 1.0, 10.0), 2.1)


def test_short_bones_are_bones():
    skeleton = Skeleton(("a", "b", "c"), (-1, 0, 1), np.array([[0, 0, 0], [0, 1.0, 0], [0, 0.02, 0]]))
    close(metrics.bone_length_drift(np.array([[[0, 0, 0], [0, 1, 0], [0, 1.03, 0]]]), skeleton), [0.25])


def test_pose_range_is_the_most_of_any_pose():
    stick = np.array([[[0, 0, 0], [0, 1.0, 0]]] * 4)
    odd = stick.copy()
    odd[2, 1, 1] = 1.4
    assert metrics.pose_range([stick, stick, odd]) == pytest.approx(0.4 / np.sqrt(2), rel=1e-3)


def test_a_statue_has_no_spread_after_it_moved():
    """Not NaN, which is not stuck, where rounding leaves the mean of squares below the square of the mean."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        positions = np.repeat(rng.normal(size=(1, 3, 3)), 40, 0)
        positions[0] += 3 * rng.normal(size=(3, 3))
        close(metrics.pose_spread(positions, 10.0, 0.7)[1:], 0, atol=1e-5)
        close(metrics.stuck_time(positions, 1.0, 10.0, seconds=0.7), 0.1)
