"""Control signals: what a path, a clip or a slider asks for, what people can do, and the way back to the world."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tutorial_lib.control import (
    LIMITS,
    Limits,
    circle,
    constant_control,
    control_from_path,
    control_of,
    figure_of_eight,
    integrate_control,
    limit_control,
    limits_of,
    measure_control,
    path_control,
    path_deviation,
    piecewise_control,
    prepared_path,
    smooth_control,
    zigzag,
)
from tutorial_lib.data import load
from tutorial_lib.errors import MotionError
from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.motion.ground import PREPARED, check_path, path_length, path_offset
from tutorial_lib.representations import HipFrame

FPS = 30.0


@pytest.fixture(scope="module")
def walks():
    return load("samples/walking")


@pytest.fixture(autouse=True)
def unexpected_warnings_fail():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


# -- paths ---------------------------------------------------------------------------------------------------


def test_circle_turns_by_pace_over_radius_to_its_side():
    for radius, pace in ((2.0, 1.3), (-3.0, 1.0), (5.0, 2.0)):
        control = control_from_path(circle(radius), pace, FPS, rounding=0.05)
        assert control[:, 0] == pytest.approx(pace / radius, rel=2e-3), "positive to the left"
        assert control[:, 1] == pytest.approx(pace, rel=1e-3)
        assert np.abs(control[:, 2]).max() < 0.02, "sideways: half a frame's turn at most"
        assert len(control) == pytest.approx(2 * np.pi * abs(radius) / pace * FPS, abs=1.5)


def test_left_is_towards_x_for_somebody_who_faces_z():
    """Against a picture in the mind, not against the formulas: +z is ahead, +x is left."""
    control = control_from_path([(0, 0), (0, 3), (3, 3)], 0.7, FPS)
    assert control[:, 0].max() > 0.5 and control[:, 0].min() > -1e-6
    place, angle = integrate_control(np.array([[0.0, 1.0, 0.5]] * 3), 1.0)
    assert place.tolist() == [[0, 0], [0.5, 1], [1, 2]] and angle.tolist() == [0, 0, 0]


def test_straight_line_is_walked_at_the_pace_and_nothing_else():
    planned = path_control([(1, 2), (4, 6)], 1.25, 60.0)
    assert planned.control[:, [0, 2]] == pytest.approx(0, abs=1e-9)
    assert planned.control[:, 1] == pytest.approx(1.25)
    assert planned.start == pytest.approx((1, 2)) and planned.heading == pytest.approx(np.arctan2(3, 4))
    assert len(planned.control) == 5 / 1.25 * 60 + 1 and planned.place[-1] == pytest.approx([4, 6])


@pytest.mark.parametrize("name", PREPARED)
@pytest.mark.parametrize("rest", [False, True])
def test_prepared_paths_come_back_and_nobody_is_asked_for_more_than_people_do(name, rest):
    path = prepared_path(name)
    planned = path_control(path, 1.3, FPS, rest=rest)
    place, angle = integrate_control(planned.control, FPS, planned.start, planned.heading)
    assert np.abs(place - planned.place).max() < 1e-9 and np.abs(angle - planned.angle).max() < 1e-9
    away = path_deviation(place, path, FPS)
    assert away.mean < 0.03 and away.max < 0.08 and away.covered == 1.0, "what rounding takes off"
    assert planned.note == "" and len(planned.control) / FPS == pytest.approx(path_length(path) / 1.3, rel=0.2)
    assert np.abs(planned.control[:, 0]).max() < 1.5, "rad/s, as people walk curves"


def test_a_body_in_hip_frame_features_follows_the_path(walks):
    """HipFrame's own decoding puts the hip where integrate_control says."""
    clip = walks[0].resample(FPS)
    frame = HipFrame(clip.skeleton, FPS)
    planned = path_control(figure_of_eight(), 1.3, FPS)
    features = frame.encode(clip)[: len(planned.control)]
    planned_short = planned.control[: len(features)]
    features = np.concatenate([features[:, :-3], planned_short], 1)
    moved = frame.decode(features, start=planned.start, heading=planned.heading)
    assert path_deviation(moved, planned.place).max < 1e-3


def test_rest_begins_and_ends_standing_with_the_acceleration_allowed():
    limits = Limits(acceleration=0.8)
    moving, resting = (control_from_path([(0, 0), (0, 6)], 1.5, FPS, rest=rest, limits=limits) for rest in (0, 1))
    assert moving[:, 1] == pytest.approx(1.5)
    assert resting[[1, -1], 1].max() < 0.06 and resting[:, 1].max() == pytest.approx(1.5)
    assert np.abs(np.diff(resting[:, 1])).max() * FPS <= 0.8 * 1.001
    # v = a t to the pace, and the same again to stand: 6 m = 1.5 t - 1.5^2 / 0.8
    assert len(resting) / FPS == pytest.approx((6 + 1.5**2 / 0.8) / 1.5, abs=0.05)


def test_pace_of_every_point():
    control = control_from_path([(0, 0), (0, 5), (0, 10)], [1.0, 2.0, 1.0], FPS, limits=Limits(acceleration=5))
    place, _ = integrate_control(control, FPS)
    assert control[:, 1] == pytest.approx(2 - np.abs(place[:, 1] - 5) / 5, abs=0.02)


def test_a_tight_corner_is_taken_slowly_and_told_with_its_place():
    path = [(0, 0), (0, 4), (0, 8), (4, 8)]
    with pytest.warns(UserWarning) as told:
        planned = path_control(path, 3.0, FPS)
    assert len(told) == 1, "one warning"
    line = str(told[0].message)
    assert line == planned.note and "\n" not in line and told[0].filename == __file__
    assert "near point 2 (0.00, 8.00), 3 m/s were asked for" in line
    assert abs(float(line.split("at ")[1].split(" of")[0]) - 8) < 0.2
    speed = np.hypot(*planned.control[:, 1:].T)
    assert f"and {speed.min():.2g} are given" in line
    assert np.linalg.norm(planned.place[speed.argmin()] - [0, 8]) < 0.4
    assert speed[:10] == pytest.approx(3.0) and speed[-10:] == pytest.approx(3.0)


def test_sixty_metres_a_second_are_limited_and_a_turn_back_is_made_on_the_spot():
    with pytest.warns(UserWarning, match=r"60 m/s were asked for and 4.5 are given: people go at up to 4.5 m/s"):
        assert control_from_path([(0, 0), (0, 50)], 60, FPS)[:, 1] == pytest.approx(4.5)
    with pytest.warns(UserWarning, match=r"near point 1 .* people turn at up to 2.6 rad/s"):
        back = path_control([(0, 0), (0, 4), (0, 0)], 2.0, FPS)
    assert np.abs(back.control[:, 0]).max() <= 2.6 + 1e-6
    assert abs(back.angle[-1] - back.angle[0]) == pytest.approx(np.pi, abs=1e-3)
    assert np.hypot(*back.control[:, 1:].T).min() < 0.1


@pytest.mark.parametrize("rounding", [0, None])
def test_a_path_that_turns_back_within_a_step_begins_and_ends_in_a_direction(rounding):
    """Resampled every 2 cm its first two points are one, and its last two."""
    there = [(0, 0), (0, 0.01), (0, 0), (0, 1), (0, 1.01), (0, 1)]
    for path in (there[:4], there[2:], there):
        for points, along in ((path, 1), (path[::-1], -1)):
            planned = path_control(points, 1.0, FPS, rounding=rounding)
            assert np.isfinite(planned.control).all() and planned.place[-1] == pytest.approx(points[-1], abs=0.05)
            assert np.cos(planned.angle[[0, -1]]) == pytest.approx(along, abs=1e-3), "along +z, or back"
    with pytest.raises(MotionError, match="path of 7 points: goes to and fro within 2 cm, nothing is left of it"):
        path_control([(0, 0), (0, 0.01)] * 3 + [(0, 0)], 1.0, FPS)


points = st.lists(st.tuples(*[st.floats(-8, 8)] * 2), min_size=2, max_size=12)


@settings(max_examples=60, deadline=None)
@given(points=points, pace=st.floats(0.2, 20), fps=st.sampled_from([12.5, 30.0, 60.0]), rest=st.booleans())
def test_any_path_gives_finite_control_within_the_limits(points, pace, fps, rest):
    if path_length(np.array(points)) < 0.05:
        with pytest.raises(MotionError):
            path_control(points, pace, fps)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        planned = path_control(points, pace, fps, rest=rest)
    control = planned.control
    assert control.shape == (len(planned.place), 3) and np.isfinite(control).all()
    speed = np.hypot(*control[:, 1:].T)
    assert speed.max() <= min(pace, LIMITS.speed) * 1.001
    assert np.abs(control[:, 0]).max() <= LIMITS.turning * 1.001
    assert (speed * np.abs(control[:, 0])).max() <= LIMITS.sideways * 1.02
    place, _ = integrate_control(control, fps, planned.start, planned.heading)
    assert np.abs(place - planned.place).max() < 1e-6
    # along the path nobody speeds up faster than allowed; chords of a bend are shorter than the bend
    straight = np.abs(control[:, 0]) < 1e-3
    faster = np.abs(np.diff(speed))[straight[1:] & straight[:-1]] * fps
    assert not len(faster) or faster.max() <= LIMITS.acceleration * 1.01
    assert bool(planned.note) or np.all(speed[1:] >= 0.5 * pace) or rest


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ([], "shape (0,): expected (N, 2)"),
        ([(1, 2)], "path of 1 points: expected at least two"),
        ([(1, 2)] * 5, "path of 5 points: expected at least two, 5 cm apart"),
        ([(0, 0), (np.nan, 1), (2, 2)], "point 1 is not finite"),
        ([(0, 0), (0, np.inf)], "point 1 is not finite"),
        ([(0, 0, 0), (1, 1, 1)], "shape (2, 3): expected (N, 2)"),
        ([(0, 0), (1,)], "expected numbers"),
        ("north", "expected numbers"),
        ([(0, 0), (0, 1e9)], "path of 1e+09 m: expected at most 10000"),
    ],
)
def test_bad_paths_are_refused_in_one_line(path, says):
    for use in (lambda: control_from_path(path), lambda: path_deviation(np.zeros((5, 2)), path)):
        with pytest.raises(MotionError) as error:
            use()
        assert says in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("choices", "says"),
    [
        (dict(pace=0), "pace 0 m/s: expected a number above zero"),
        (dict(pace=-1.3), "pace -1.3 m/s"),
        (dict(pace=np.nan), "pace nan m/s"),
        (dict(pace=np.inf), "pace inf m/s"),
        (dict(pace="fast"), "pace: expected numbers, found str"),
        (dict(pace=[1, 2]), "pace of shape (2,): expected a number or one for each of 3 points"),
        (dict(pace=[1, 0, 1]), "pace 0 m/s at point 1"),
        (dict(pace=1e-6), "lasts 7e+06 s at this pace: expected at most 3600 s"),
        (dict(fps=0), "0 frames per second"),
        (dict(fps=np.nan), "nan frames per second"),
        (dict(fps=None), "None frames per second"),
        (dict(rounding=-1), "rounding -1"),
        (dict(rounding=np.nan), "rounding nan"),
    ],
)
def test_bad_choices_are_refused_in_one_line(choices, says):
    with pytest.raises(MotionError) as error:
        path_control([(0, 0), (0, 4), (0, 7)], **choices)
    assert says in str(error.value) and "\n" not in str(error.value)


def test_prepared_paths_are_what_they_are_called():
    ring = circle(3.0)
    assert np.hypot(ring[:, 0] - 3, ring[:, 1]) == pytest.approx(3) and ring[1, 1] > 0
    eight = figure_of_eight(4.0)
    assert np.ptp(eight, axis=0) == pytest.approx([4, 8], abs=0.01) and eight[[0, -1]] == pytest.approx(0, abs=1e-9)
    for turn, radius in ((np.pi / 2, 1.0), (1.0, 0.3), (np.pi / 2, 0.0)):
        path = zigzag(4, 3.0, turn, radius)
        corners = np.cumsum([[3 * s * np.sin(turn / 2), 3 * np.cos(turn / 2)] for s in (1, -1, 1, -1)], 0)
        assert path[-1] == pytest.approx(corners[-1], abs=1e-9)
        # an arc of radius r passes r (1 / cos(turn / 2) - 1) inside its corner
        missed = [np.abs(path_offset(corners[:3], path)), radius * (1 / np.cos(turn / 2) - 1)]
        assert missed[0] == pytest.approx(missed[1], abs=2e-3)
    assert len(circle()) == len(circle(2.0, 0.3)) == 200, "the prepared ones stay as they were"
    rounds = circle(2.0, 100)
    assert np.abs(path_length(rounds) / (400 * np.pi) - 1) < 1e-3 and len(rounds) == 19901
    for bad in (
        lambda: zigzag(2.5), lambda: zigzag(np.inf), lambda: zigzag(np.nan), lambda: circle(2.0, np.inf),
        lambda: circle(2.0, 1e9), lambda: circle("wide"),
        lambda: circle(0.0), lambda: figure_of_eight(-1), lambda: zigzag(0), lambda: zigzag(3, 1.0, radius=2.0),
        lambda: zigzag(turn=4.0), lambda: prepared_path("spiral"),
    ):  # fmt: skip
        with pytest.raises(MotionError, match="expected"):
            bad()


# -- clips ---------------------------------------------------------------------------------------------------


def test_measured_control_leads_back_to_the_hips_own_way(walks):
    for clip in walks:
        control = control_of(clip)
        frame = HipFrame(clip.skeleton, clip.fps)
        assert np.array_equal(control, frame.encode(clip)[:, -3:])
        origin = frame.origin(clip)
        place, _ = integrate_control(control.astype(float), clip.fps, origin["start"], origin["heading"])
        hip = clip.positions[:, clip.skeleton.names.index("Hips")][:, [0, 2]]
        assert np.abs(place - hip).max() < 1e-3
    halved = control_of(walks[0], 15.0)
    assert abs(len(halved) - len(walks[0]) / 2) <= 1 and halved[:, 1].mean() == pytest.approx(1.3, abs=0.1)


def test_a_sample_walker_is_near_its_path_and_sways_about_it(walks):
    """The second clip was made to walk a circle of 2.2 m, left about."""
    away = path_deviation(walks[1], circle(2.2))
    assert 0.005 < away.mean < 0.1 and away.covered > 0.95
    wobble = away.offset - away.drift
    assert 0.005 < wobble[20:-20].std() < 0.05 and np.abs(wobble[20:-20].mean()) < 0.005
    assert "cm from the path" in str(away)


def test_smoothing_takes_the_sway_and_leaves_the_way(walks):
    control = control_of(walks[1]).astype(float)
    smooth = smooth_control(control, FPS)
    assert smooth[:, 0].std() < 0.5 * control[:, 0].std()
    assert smooth.mean(0) == pytest.approx(control.mean(0), abs=0.03)
    both = np.stack([control, control[::-1]])
    assert np.allclose(smooth_control(both, FPS)[0], smooth)
    straight = constant_control(50)
    assert smooth_control(straight, FPS) == pytest.approx(straight, abs=1e-9), "nothing slows at the ends"
    assert smooth_control(straight[:1], FPS).shape == (1, 3)


def test_limits_are_measured_of_clips(walks):
    found = limits_of(walks)
    assert 1.5 < found.speed < 1.9 and 0.5 < found.turning < 2.0 and found.sideways < 3.0
    with pytest.warns(UserWarning, match="path: at"):
        slow = control_from_path(figure_of_eight(), 3.0, FPS, limits=found)
    assert np.abs(slow[:, 0]).max() <= found.turning * 1.001
    with pytest.raises(MotionError, match="no clip of more than"):
        limits_of([walks[0][:10]])
    for bad in (0, -1, np.nan, "fast", None):
        with pytest.raises(MotionError, match="limits: turning"):
            Limits(turning=bad)


def test_a_quantile_of_what_was_measured(walks):
    half, most = limits_of(walks, quantile=0.5), limits_of(walks, quantile=1)
    smooth = np.concatenate([smooth_control(control_of(clip), FPS)[11:-11] for clip in walks])  # 0.35 s off the ends
    assert half.speed == pytest.approx(np.median(np.hypot(*smooth[:, 1:].T)), rel=1e-6)
    assert most.turning == pytest.approx(np.abs(smooth[:, 0]).max(), rel=1e-6) and most.turning > 1.2 * half.turning


def test_numbers_of_numpy_are_numbers_and_truth_is_none():
    given = Limits(np.float32(2), np.float64(2), np.int64(3))
    assert given == Limits(2.0, 2.0, 3.0) and type(given.speed) is type(given.sideways) is float
    path = [(0, 0), (0, 4)]
    plain = control_from_path(path, 1.3, 30.0, rounding=0.5)
    assert np.array_equal(plain, control_from_path(path, np.float64(1.3), np.int64(30), rounding=np.float32(0.5)))
    assert len(constant_control(np.int32(4))) == 4
    for use in (
        lambda: Limits(speed=True), lambda: control_from_path(path, rounding=True), lambda: constant_control(True),
        lambda: control_from_path(path, fps=True),
    ):  # fmt: skip
        with pytest.raises(MotionError, match="True"):
            use()


# -- sliders -------------------------------------------------------------------------------------------------


def test_sliders():
    control = constant_control(60, turning=0.5, forward=1.0)
    assert control.shape == (60, 3) and (control == [0.5, 1.0, 0.0]).all()
    place, _ = integrate_control(constant_control(378, turning=0.5, forward=1.0), FPS)  # a turn takes 4 pi s
    middle = np.array([2.0, 0.0])  # a circle of 2 m, to the left
    assert np.linalg.norm(place - middle, axis=1) == pytest.approx(2.0, abs=0.03)
    pieces = piecewise_control([(2, 0, 1.0, 0), (1, 1.0, 1.0, 0), (2, 0, 0.5, 0.2)], FPS)
    assert pieces.shape == (150, 3)
    assert pieces[[0, 75, -1]] == pytest.approx(np.array([[0, 1, 0], [1, 1, 0], [0, 0.5, 0.2]]))
    assert np.abs(np.diff(pieces[:, 0])).max() <= 1.0 / (0.5 * FPS) + 1e-9, "half a second to change"


def test_sliders_are_limited_with_one_warning_that_names_the_frame():
    with pytest.warns(UserWarning, match=r"at frame 0 \(0.00 s\) 60 m/s and 0 rad/s were asked for, 4.5 m/s"):
        assert constant_control(3, forward=60)[:, 1] == pytest.approx(4.5)
    wild = np.tile([0.0, 1.0, 0.0], (20, 1))
    wild[7] = [30.0, 3.0, 0.0]
    with pytest.warns(UserWarning, match="at frame 7") as told:
        tamed = limit_control(wild, FPS)
    assert len(told) == 1 and tamed[7, 0] == 2.6 and tamed[7, 1] == pytest.approx(3.0 / 2.6)
    assert np.array_equal(np.delete(tamed, 7, 0), np.delete(wild, 7, 0))
    assert np.array_equal(limit_control(tamed, FPS), tamed)


def test_a_limit_is_told_at_the_callers_line_each_time():
    """As Python shows warnings when nobody has asked it for more: each line's first, that is."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("default")
        for _ in range(2):
            constant_control(3, forward=60)
        control_from_path([(0, 0), (0, 9)], 60)
    line = test_a_limit_is_told_at_the_callers_line_each_time.__code__.co_firstlineno
    assert [(one.filename, one.lineno - line) for one in told] == [(__file__, 5), (__file__, 5), (__file__, 6)]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: constant_control(5, forward="a"), "forward: expected numbers, found str"),
        (lambda: constant_control(5, turning=[1, 2]), "turning of shape (2,): expected a number"),
        (lambda: piecewise_control([(1, 0, 1, 0)], blend=np.nan), "a blend of nan s, expected 0 to 3600"),
        (lambda: piecewise_control([(1, 0, 1, 0)], blend=np.inf), "a blend of inf s"),
        (lambda: piecewise_control([(1, 0, 1, 0)], blend=-0.5), "a blend of -0.5 s"),
        (lambda: smooth_control(np.zeros((9, 3)), 30, np.nan), "smooth_control: a blur of nan s, expected 0 to 3600"),
        (lambda: smooth_control(np.zeros((9, 3)), 30, -1), "a blur of -1 s"),
        (lambda: smooth_control(np.zeros((9, 3)), 30, "long"), "a blur of 'long' s"),
        (lambda: smooth_control([[1, 2], [3]], 30), "control: expected numbers"),
        (lambda: limits_of([], fps=np.nan), "nan frames per second"),
        (lambda: limits_of([], quantile=1.5), "limits_of: quantile 1.5, expected a number from 0 to 1"),
        (lambda: limits_of([], quantile=-0.1), "quantile -0.1"),
        (lambda: limits_of([], quantile=np.nan), "quantile nan"),
        (lambda: constant_control(0), "control of 0 frames"),
        (lambda: constant_control(2.5), "control of 2.5 frames"),
        (lambda: constant_control(5, turning=np.nan), "not finite at frame 0, turning"),
        (lambda: piecewise_control([]), "expected rows of (seconds, turning, forward, sideways)"),
        (lambda: piecewise_control([(1, 2, 3)]), "shape (1, 3)"),
        (lambda: piecewise_control([(1, 0, 1, 0), (-1, 0, 1, 0)]), "piece 1 of -1 s"),
        (lambda: limit_control(np.zeros((4, 2)), 30), "control of shape (4, 2): expected (T, 3)"),
        (lambda: limit_control("abc", 30), "control: expected numbers"),
        (lambda: integrate_control(np.zeros((4, 66)), 30.0), "control of shape (4, 66): expected (..., T, 3)"),
        (lambda: integrate_control(np.zeros((4, 3)), 30.0, (0.0,)), "start of shape (1,)"),
        (lambda: path_deviation(np.zeros((4, 5)), [(0, 0), (1, 1)]), "root of shape (4, 5)"),
        (lambda: path_deviation(np.full((4, 2), np.nan), [(0, 0), (1, 1)]), "all finite"),
    ],
)
def test_bad_control_is_refused_in_one_line(call, says):
    with pytest.raises(MotionError) as error:
        call()
    assert says in str(error.value) and "\n" not in str(error.value)


def test_control_of_a_skeleton_without_hips(small_motion):
    with pytest.raises(MotionError, match="hips and shoulders"):
        control_of(small_motion)


# -- distance from a path ------------------------------------------------------------------------------------


def test_offset_is_from_the_line_and_has_a_side():
    path = np.array([(0.0, 0.0), (0.0, 10.0)])  # two points far apart, along +z
    offset = path_offset(np.array([(0.2, 5.0), (-0.3, 5.0), (0.0, 11.0), (0.0, 2.0), (3.0, 14.0)]), path)
    assert offset == pytest.approx([0.2, -0.3, 1.0, 0.0, 5.0])
    rng = np.random.default_rng(0)
    path, places = rng.normal(size=(9, 2)).cumsum(0), rng.normal(size=(50, 2)) * 3
    share = np.linspace(0, 1, 2001)[:, None]
    dense = np.concatenate([a + share * (b - a) for a, b in zip(path[:-1], path[1:], strict=True)])
    brute = np.linalg.norm(places[:, None] - dense, axis=-1).min(1)
    assert np.abs(path_offset(places, path)) == pytest.approx(brute, abs=1e-3)
    assert np.array_equal(check_path(np.repeat(path, 2, 0))[::2], path)
    assert np.abs(path_offset(places, np.repeat(path, 2, 0))) == pytest.approx(brute, abs=1e-3), "points given twice"


def test_outside_of_a_sharp_corner_is_one_side():
    """The path turns left by 135 degrees: to the right of it is the outside, all round the corner."""
    path = np.array([(0.0, -5.0), (0.0, 0.0), (5.0, -5.0)])
    outside = np.array([(1.0, 1.0), (-1.0, 0.5), (0.0, 1.0), (-0.5, -0.2)])
    assert (path_offset(outside, path) < 0).all()
    mirrored = path * [-1, 1]
    assert (path_offset(outside * [-1, 1], mirrored) > 0).all()
    assert path_offset(outside[:2], path) == pytest.approx([-(2**0.5), -(1.25**0.5)])
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    ring = 0.5 * np.stack([np.sin(angle), np.cos(angle)], -1)  # about the corner: changes sides where the path is met
    assert np.abs(np.diff(np.sign(path_offset(ring, path)))).sum() == 4
    closed = np.concatenate([path, path[:1]])
    corner = closed[2] + ring
    inside = (corner[:, 0] + corner[:, 1] < 0) & (corner[:, 1] > -5)
    assert ((path_offset(corner, closed) > 0) == inside).all()
    begins = closed[[1, 2, 3, 1]]  # the same, begun in the sharp corner
    np.testing.assert_allclose(path_offset(ring, begins), path_offset(ring, closed), atol=1e-12)


def test_passed_is_within_thirty_centimetres():
    z = np.linspace(0, 10, 300)
    for away, covered in ((0.25, 1.0), (0.35, 0.0)):
        assert path_deviation(np.stack([np.full(300, away), z], -1), [(0, 0), (0, 10)], FPS).covered == covered


def test_drift_is_of_the_stride_around_each_frame():
    """Somebody who steps aside at one frame: half of it has come into the mean there, none 0.6 s before."""
    z = np.linspace(0, 10, 301)
    aside = path_deviation(np.stack([np.where(z < 5, 0.0, 0.2), z], -1), [(0, 0), (0, 10)], FPS).drift
    assert aside[149:152] == pytest.approx(0.1, abs=0.01)
    assert aside[:133] == pytest.approx(0, abs=1e-9) and aside[168:] == pytest.approx(0.2, abs=1e-9)


def test_deviation_does_not_praise_who_stands_still():
    line = [(0, 0), (0, 10)]
    standing = path_deviation(np.zeros((90, 2)), line, FPS)
    assert standing.mean == 0 and standing.covered < 0.05
    beside = np.stack([np.full(300, 0.5), np.linspace(0, 10, 300)], -1)
    assert path_deviation(beside, line).mean == pytest.approx(0.5) and path_deviation(beside, line).covered == 0
    t = np.arange(300) / FPS
    swaying = np.stack([0.03 * np.sin(2 * np.pi / 1.1 * t), t], -1)
    away = path_deviation(np.insert(swaying, 1, 0.9, axis=1), line, FPS)  # with a height
    assert away.mean == pytest.approx(0.03 * 2 / np.pi, abs=1e-3) and away.mean_drift < 0.002 and away.covered > 0.99
    assert len(away.drift) == 300 and path_deviation(swaying[:5], line).drift.shape == (5,)


def test_measure_and_integrate_are_inverse_for_leading_axes():
    rng = np.random.default_rng(1)
    control = rng.normal(size=(4, 2, 20, 3))
    control[..., 0, :] = control[..., 1, :]
    start, heading = rng.normal(size=(4, 2, 2)), rng.normal(size=(4, 2))
    place, angle = integrate_control(control, 10.0, start, heading)
    assert place[..., 0, :] == pytest.approx(start) and angle[..., 0] == pytest.approx(heading)
    assert measure_control(place, angle, 10.0) == pytest.approx(control)


# -- paths


def test_what_falls_by_more_than_a_tenth_is_told():
    """On a circle of 1.5 m 3 m/s2 to the side are 2.12 m/s: asked for 2.6, a fifth is taken away everywhere."""
    with pytest.warns(UserWarning, match="lean into a turn .*; 100% of the path is slower than asked for"):
        control = control_from_path(circle(1.5), 2.6, FPS, rounding=0.05)
    assert control[:, 1] == pytest.approx(np.sqrt(3 * 1.5), rel=0.01)
    assert path_control(circle(1.5), 2.2, FPS, rounding=0.05).note == "", "4 % are not worth a word"


def test_the_pace_of_a_point_is_that_of_the_rounded_path_there():
    path = [(0, 0), (0, 3), (3, 3)]
    control = control_from_path(path, [1.0, 1.0, 2.0], FPS, rounding=0.5)
    assert control[-1, 1] == pytest.approx(2.0, abs=0.03), "the last point's, though corners are cut"


# -- clips


def going(walk: Motion, way: np.ndarray, angle: np.ndarray) -> Motion:
    """Somebody stiff who is at ``way`` (T, 2) and faces ``angle`` (T,), in the first pose of a clip."""
    pose = walk.positions[0] - walk.positions[0, [0]] * [1, 0, 1]
    facing = np.arctan2(*_forward(walk))
    c, s = np.cos(angle - facing)[:, None], np.sin(angle - facing)[:, None]
    x, z = c * pose[:, 0] + s * pose[:, 2], c * pose[:, 2] - s * pose[:, 0]
    y = np.broadcast_to(pose[:, 1], x.shape)
    return Motion(walk.skeleton, FPS, np.stack([x + way[:, :1], y, z + way[:, 1:]], -1))


def _forward(walk: Motion) -> np.ndarray:
    at = {name: walk.skeleton.names.index(name) for name in ("LeftUpLeg", "RightUpLeg", "LeftArm", "RightArm")}
    p = walk.positions[0]
    left = p[at["LeftUpLeg"]] - p[at["RightUpLeg"]] + p[at["LeftArm"]] - p[at["RightArm"]]
    return np.cross(left, (0, 1, 0))[[0, 2]]


def test_each_limit_is_measured_in_its_own_unit(walks):
    t = np.arange(240) / FPS
    faster = going(walks[0], np.stack([0 * t, 0.25 * t**2], -1), 0 * t)  # to 4 m/s, by 0.5 m/s2
    found = limits_of([faster])
    assert found.acceleration == pytest.approx(0.5, rel=0.02) and found.speed == pytest.approx(3.8, rel=0.03)
    assert found.turning < 0.01 and found.sideways < 0.01
    assert limits_of([faster], quantile=0.5).speed == pytest.approx(2.0, rel=0.02), "the middle, not the most"
    angle = 0.5 * t
    ring = limits_of([going(walks[0], 2 * np.stack([1 - np.cos(angle), np.sin(angle)], -1), angle)])
    assert (ring.speed, ring.turning, ring.sideways) == pytest.approx((1.0, 0.5, 0.5), rel=0.06)
    assert ring.acceleration < 0.05
    swaying = going(walks[0], np.stack([0 * t, 1.2 * t], -1), 0.2 * np.sin(2 * np.pi * t))
    assert limits_of([swaying]).turning < 0.25, "1.26 rad/s of a stride's sway are not turning"


# -- sliders


def test_a_step_aside_is_limited_as_a_step_ahead():
    with pytest.warns(UserWarning, match="5 m/s .* 4.5 m/s"):
        control = constant_control(3, forward=3.0, sideways=4.0)
    assert control == pytest.approx(np.array([[0, 2.7, 3.6]] * 3))


def test_short_pieces_last_as_long_as_they_say_together():
    assert len(piecewise_control([(0.05, 0, 1.0, 0)] * 20, FPS)) == 30  # a frame and a half each


# -- distance from a path


def test_passed_is_within_30_cm():
    line, z = [(0, 0), (0, 10)], np.linspace(0, 10, 300)
    covered = [path_deviation(np.stack([np.full(300, x), z], -1), line).covered for x in (0.25, 0.35)]
    assert covered == [1.0, 0.0]


def test_drift_is_of_the_stride_around_a_frame_and_has_no_sign_in_its_mean():
    t = np.arange(600) / FPS
    aside = np.stack([np.linspace(-0.5, 0.5, 600), t], -1)
    away = path_deviation(aside, [(0, 0), (0, 20)], FPS)
    assert away.drift[50:-50] == pytest.approx(away.offset[50:-50], abs=1e-9)
    assert away.mean_drift == pytest.approx(0.25, abs=0.01)


def test_the_hip_is_what_goes_along_a_path_not_the_root(walks):
    """Of a body with a node on the ground before the hips that stays behind."""
    walk, line = walks[0], np.stack([0 * np.arange(2.0), 3 * np.arange(2.0)], -1)
    old = walk.skeleton
    skeleton = Skeleton(("floor", *old.names), (-1, *(p + 1 for p in old.parents)), np.zeros((len(old.names) + 1, 3)))
    body = Motion(skeleton, walk.fps, np.concatenate([np.full((len(walk), 1, 3), 9.0), walk.positions], 1))
    assert path_deviation(body, line).mean == pytest.approx(path_deviation(walk, line).mean)
