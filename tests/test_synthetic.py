"""The sample motions: feet that stand, joints in human limits, published gait figures, the committed files.

Everything is measured from joint positions and rotations, not asked of the planner.
"""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

from tutorial_lib.data import synthetic
from tutorial_lib.data.synthetic.__main__ import main
from tutorial_lib.data.synthetic.samples import sample_clips
from tutorial_lib.errors import TutorialError
from tutorial_lib.motion.bvh import read_bvh
from tutorial_lib.motion.rotations import quat_to_euler, quat_to_matrix
from tutorial_lib.motion.skeletons import COMMON_JOINTS

SAMPLES = pathlib.Path(__file__).parent.parent / "data_samples"
SECONDS = 24.0
STRAIGHT = [(0, 0), (0, 200)]
BALL = 0.0204  # metres: the height of the toe joint of a foot that stands flat


def _clips():
    for speed in (0.6, 1.3, 2.0, 4.0):
        yield f"walking {speed}", "walking", dict(speed=speed)
    for speed in (0.6, 2.0, 3.0, 4.0):
        yield f"running {speed}", "running", dict(speed=speed)
    for seed in (0, 1, 2):
        yield f"boxing {seed}", "boxing", dict(seed=seed)
        yield f"dancing {seed}", "dancing", dict(seed=seed, tempo=96 + 16 * seed)


@pytest.fixture(scope="module", params=list(_clips()), ids=lambda row: row[0])
def clip(request):
    _, style, kwargs = request.param
    return style, getattr(synthetic, style)(SECONDS, **kwargs)


def _joint(motion, name):
    return motion.positions[:, motion.skeleton.index(name)]


def _runs(mask):
    """Starts and ends of the stretches of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2], edges[1::2], strict=True))


def _contacts(motion, side, longest_gap=0.004):
    """The stretches of frames in which the ball of a foot is at its standing height."""
    height = _joint(motion, f"{side}Toe")[:, 1]
    return [(a, b) for a, b in _runs(height < BALL + longest_gap) if b - a >= 2]


def _flexion(motion, name):
    """Degrees about the joint's x axis, the rest taken off: hip and ankle backwards, knee bending."""
    turn = motion.rotations[:, motion.skeleton.index(name)]
    return np.degrees(quat_to_euler(turn, "XZY"))


def test_skeleton_is_the_common_one_with_head_and_hand_tips():
    skeleton = synthetic.sample_skeleton()
    assert skeleton.n_joints == 24 and not skeleton.end_sites
    assert set(skeleton.names) - set(COMMON_JOINTS) == {"HeadTop", "LeftHandTip", "RightHandTip"}
    rest = skeleton.rest_pose()
    left, right = ([skeleton.index(n) for n in skeleton.names if n.startswith(side)] for side in ("Left", "Right"))
    np.testing.assert_allclose(rest[left] * [-1, 1, 1], rest[right])
    assert (rest[left, 0] > 0).all() and rest[skeleton.index("LeftToe"), 2] > 0.1
    head_to_ball = rest[skeleton.index("HeadTop"), 1] - rest[skeleton.index("LeftToe"), 1]
    assert head_to_ball + BALL == pytest.approx(1.7, abs=0.01)
    np.testing.assert_allclose(synthetic.sample_skeleton(0.85).offsets, skeleton.offsets / 2)


def test_bones_keep_their_length_and_all_is_finite(clip):
    _, motion = clip
    assert len(motion) == SECONDS * 30 and np.isfinite(motion.positions).all()
    bones = motion.skeleton.bones
    length = np.linalg.norm(motion.positions[:, bones[:, 1]] - motion.positions[:, bones[:, 0]], axis=-1)
    np.testing.assert_allclose(
        length, np.linalg.norm(motion.skeleton.offsets[bones[:, 1]], axis=-1)[None].repeat(len(motion), 0), atol=1e-9
    )


def test_feet_that_stand_do_not_slide(clip):
    _, motion = clip
    for side in ("Left", "Right"):
        contacts = _contacts(motion, side)
        assert len(contacts) >= 8
        for a, b in contacts:
            way = _joint(motion, f"{side}Toe")[a:b, ::2]
            assert np.linalg.norm(way[:, None] - way[None], axis=-1).max() < 0.01
        # the whole foot stands: ankle at rest too while the sole is flat
        flat = _joint(motion, f"{side}Foot")[:, 1] < 0.0663 + 0.002
        for a, b in _runs(flat):
            if b - a >= 3:
                way = _joint(motion, f"{side}Foot")[a:b, ::2]
                assert np.linalg.norm(way[:, None] - way[None], axis=-1).max() < 0.015


def test_the_ground_is_not_entered(clip):
    _, motion = clip
    assert motion.positions[..., 1].min() > BALL - 0.01
    # the heel, which is no joint: 3.3 % of the height behind the ankle and 3.9 % below
    for side in ("Left", "Right"):
        foot = motion.skeleton.index(f"{side}Foot")
        turn = np.eye(3)[None]
        for j in _chain(motion.skeleton, foot):
            turn = turn @ quat_to_matrix(motion.rotations[:, j])
        heel = motion.positions[:, foot] + turn @ (1.7 * np.array([0, -0.039, -0.033]))
        assert heel[:, 1].min() > -0.01


def _chain(skeleton, j):
    chain = []
    while j >= 0:
        chain.append(j)
        j = skeleton.parents[j]
    return chain[::-1]


def test_joints_stay_within_human_limits(clip):
    _, motion = clip
    for side in ("Left", "Right"):
        hip, knee, ankle = (_flexion(motion, f"{side}{name}") for name in ("UpLeg", "Leg", "Foot"))
        assert -hip[:, 0].max() > -35 and -hip[:, 0].min() < 125
        assert np.abs(hip[:, 1:]).max() < 45
        assert knee[:, 0].min() > 0 and knee[:, 0].max() < 140  # bends one way only
        assert np.abs(knee[:, 1:]).max() < 1e-6  # a hinge
        assert -ankle[:, 0].max() > -50 and -ankle[:, 0].min() < 35
        assert np.abs(ankle[:, 1:]).max() < 35
        fore = quat_to_matrix(motion.rotations[:, motion.skeleton.index(f"{side}ForeArm")])
        bend = np.degrees(np.arctan2(-fore[:, 2, 0] * (-1 if side == "Left" else 1), fore[:, 0, 0]))
        assert bend.min() > 0 and bend.max() < 150
        assert np.abs(fore[:, 1, 0]).max() < 1e-6  # the elbow too
    for name, most in dict(Spine=30, Chest=30, Neck=40, Head=50, LeftShoulder=45, RightShoulder=45).items():
        w = motion.rotations[:, motion.skeleton.index(name), 0]
        assert np.degrees(2 * np.arccos(np.clip(np.abs(w), 0, 1))).max() < most


def test_motion_has_no_jumps(clip):
    style, motion = clip
    velocity = np.diff(motion.positions, axis=0) * motion.fps
    acceleration = np.diff(velocity, axis=0) * motion.fps
    speed = np.linalg.norm(velocity, axis=-1)
    assert speed.max() < 14
    trunk = [motion.skeleton.index(n) for n in ("Hips", "Chest", "Head")]
    assert np.linalg.norm(acceleration[:, trunk], axis=-1).max() < 80  # m/s2, a slip of the head
    assert np.linalg.norm(acceleration, axis=-1).max() < 450  # a foot of a race walker
    # at ten times the rate the same person moves, so nothing hides between the frames
    fine = getattr(synthetic, style)(3.0, fps=300.0, seed=4)
    steps = np.linalg.norm(np.diff(fine.positions, axis=0), axis=-1) * 300
    assert np.abs(np.diff(steps, axis=0)).max() < 2.0


@pytest.mark.parametrize("style", ["walking", "running", "boxing", "dancing"])
def test_same_seed_same_motion_and_another_another(style):
    make = getattr(synthetic, style)
    first, again, other = make(4.0, seed=3), make(4.0, seed=3), make(4.0, seed=4)
    np.testing.assert_array_equal(first.positions, again.positions)
    np.testing.assert_array_equal(first.rotations, again.rotations)
    assert np.abs(first.positions - other.positions).max() > 0.1


@pytest.mark.parametrize(
    "style, speed",
    [
        ("walking", 0.6),
        ("walking", 1.3),
        ("walking", 2.0),
        ("walking", 4.0),
        ("running", 0.6),
        ("running", 2.5),
        ("running", 4.0),
    ],
)
def test_the_speed_asked_for(style, speed):
    motion = getattr(synthetic, style)(30.0, speed=speed, path=STRAIGHT)
    hips = _joint(motion, "Hips")
    way = np.linalg.norm(hips[-1] - hips[0]) / (len(motion) - 1) * 30
    assert way == pytest.approx(speed, rel=0.05)


def test_feet_on_the_ground_walking_and_flight_running():
    for speed in (0.6, 1.3, 2.0, 4.0):
        motion = synthetic.walking(20.0, speed=speed, fps=120.0, path=STRAIGHT)
        assert not _in_flight(motion).any()
    for speed, least in ((0.6, 0.02), (2.0, 0.04), (3.0, 0.08), (4.0, 0.10)):
        motion = synthetic.running(20.0, speed=speed, fps=120.0, path=STRAIGHT)
        flights = _runs(_in_flight(motion))[1:-1]
        steps = 20.0 * 2 * 1.3
        assert len(flights) > 0.8 * steps
        assert np.median([b - a for a, b in flights]) / 120 > least  # seconds


def _in_flight(motion):
    """Both soles off the ground: neither the ball nor the heel of either foot touches it."""
    lowest = []
    for side in ("Left", "Right"):
        foot = motion.skeleton.index(f"{side}Foot")
        turn = np.eye(3)[None]
        for j in _chain(motion.skeleton, foot):
            turn = turn @ quat_to_matrix(motion.rotations[:, j])
        heel = motion.positions[:, foot] + turn @ (1.7 * np.array([0, -0.039, -0.033]))
        lowest += [heel[:, 1], _joint(motion, f"{side}Toe")[:, 1] - BALL]
    return np.min(lowest, 0) > 0.003


def test_walking_agrees_with_published_gait():
    """At 1.3 m/s: cadence, stance and joint ranges as in Winter 2009 and Perry and Burnfield 2010."""
    motion = synthetic.walking(40.0, speed=1.3, fps=120.0, path=STRAIGHT)
    contacts = _contacts(motion, "Left")[1:-1]
    starts = np.array([a for a, _ in contacts])
    stride = np.diff(starts) / 120
    assert 1.8 < 2 / stride.mean() < 2.0  # steps a second
    assert 0.01 < stride.std() / stride.mean() < 0.05  # no two strides alike
    # the ball stands a little shorter than the foot, whose heel comes first
    stance = np.mean([b - a for a, b in contacts[:-1]]) / 120 / stride.mean()
    assert 0.50 < stance < 0.62
    knee, hip, ankle = (_flexion(motion, f"Left{name}")[:, 0] for name in ("Leg", "UpLeg", "Foot"))
    assert 58 < np.percentile(knee, 99.5) < 72
    assert 36 < np.ptp(np.percentile(-hip, [1, 99])) < 54
    assert -32 < np.percentile(-ankle, 1) < -12 and 8 < np.percentile(-ankle, 99) < 26
    hips = _joint(motion, "Hips")
    assert 0.03 < np.ptp(np.percentile(hips[:, 1], [1, 99])) < 0.06
    sway = hips[:, 0] - np.convolve(hips[:, 0], np.ones(130) / 130, "same")
    assert 0.02 < np.ptp(np.percentile(sway[200:-200], [2, 98])) < 0.07
    # arms swing against the legs
    arm = _joint(motion, "LeftHand")[:, 2] - hips[:, 2]
    leg = _joint(motion, "LeftFoot")[:, 2] - hips[:, 2]
    assert np.corrcoef(arm, leg)[0, 1] < -0.7


def test_running_agrees_with_published_gait():
    """At 3 m/s, as in Novacheck 1998 and Cavagna et al. 1988."""
    motion = synthetic.running(40.0, speed=3.0, fps=120.0, path=STRAIGHT)
    contacts = _contacts(motion, "Left")[1:-1]
    stride = np.mean(np.diff([a for a, _ in contacts])) / 120
    assert 2.6 < 2 / stride < 3.0
    assert 0.25 < np.mean([b - a for a, b in contacts]) / 120 / stride < 0.42
    assert 80 < np.percentile(_flexion(motion, "LeftLeg")[:, 0], 99.5) < 115
    assert 0.05 < np.ptp(np.percentile(_joint(motion, "Hips")[:, 1], [1, 99])) < 0.11


@pytest.mark.parametrize("style, speed", [("walking", 1.2), ("running", 2.5)])
def test_the_path_is_followed(style, speed):
    z = np.linspace(0, 40, 400)
    path = np.stack([1.0 * np.sin(z / 3), z], -1)
    motion = getattr(synthetic, style)(12.0, speed=speed, path=path)
    hips = _joint(motion, "Hips")[:, ::2]
    away = np.linalg.norm(hips[:, None] - path[None], axis=-1).min(1)
    assert away.max() < 0.15 and np.median(away) < 0.08  # lean and sway, and blunted bends


def test_a_closed_path_goes_round_and_a_corner_is_turned():
    a = np.linspace(0, 2 * np.pi, 100)
    ring = np.stack([2 * np.sin(a), 2 * np.cos(a)], -1)
    hips = _joint(synthetic.walking(30.0, speed=1.4, path=ring), "Hips")[:, ::2]
    assert np.abs(np.linalg.norm(hips, axis=1) - 2).max() < 0.12
    turns = np.unwrap(np.arctan2(hips[:, 0], hips[:, 1]))
    assert abs(turns[-1] - turns[0]) > 2 * 2 * np.pi
    corner = synthetic.walking(8.0, speed=1.2, path=[(0, 0), (0, 4), (4, 4)])
    hips = _joint(corner, "Hips")[:, ::2]
    assert np.linalg.norm(hips - [0, 4], axis=1).min() < 0.35
    hair_pin = synthetic.running(8.0, speed=4.0, path=[(0, 0), (0, 12), (0.2, 0)])
    assert np.linalg.norm(np.diff(_joint(hair_pin, "Head"), 2, axis=0), axis=1).max() * 900 < 60


@pytest.mark.parametrize("style", ["boxing", "dancing"])
def test_dance_and_boxing_do_not_repeat(style):
    """No lag between 1 and 10 s at which the hands do again what they did."""
    motion = getattr(synthetic, style)(60.0, seed=1)
    root = _joint(motion, "Hips")
    hands = np.concatenate([_joint(motion, f"{side}Hand") - root for side in ("Left", "Right")], 1)
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=1)
    x = (speed - speed.mean()) / speed.std()
    again = [np.mean(x[:-lag] * x[lag:]) for lag in range(30, 300)]
    assert max(again) < 0.5
    assert speed.mean() * 30 > 0.5  # and hardly a rest


@pytest.mark.parametrize("kwargs", [
    dict(speed=0.5), dict(speed=4.1), dict(speed=float("nan")), dict(path=[]), dict(path=[(0, 0)]),
    dict(path=[(0, 0), (np.nan, 1)]), dict(path=[(0, 0, 0), (1, 1, 1)]), dict(path=[(1, 1), (1, 1)]),
    dict(path="north"), dict(fps=0), dict(fps=float("inf")),
])  # fmt: skip
def test_bad_arguments_are_told_in_one_line(kwargs):
    for make in (synthetic.walking, synthetic.running):
        with pytest.raises(TutorialError) as error:
            make(2.0, **kwargs)
        assert "expected" in str(error.value) and "\n" not in str(error.value)


def test_bad_lengths_and_tempos():
    for make in (synthetic.walking, synthetic.running, synthetic.boxing, synthetic.dancing):
        for seconds in (0, -1, float("nan"), 1e9):
            with pytest.raises(TutorialError, match="seconds"):
                make(seconds)
        assert len(make(0.04)) == 1
    with pytest.raises(TutorialError, match="tempo"):
        synthetic.dancing(2.0, tempo=300)


def test_committed_samples_are_what_the_generator_makes():
    clips = sample_clips()
    assert {p.relative_to(SAMPLES).as_posix() for p in SAMPLES.glob("*/*.bvh")} == {
        f"{style}/{k:02d}.bvh" for style, made in clips.items() for k in range(1, len(made) + 1)
    }
    for style, made in clips.items():
        seconds = 0.0
        for k, make in enumerate(made, 1):
            motion, file = make(), read_bvh(SAMPLES / style / f"{k:02d}.bvh", unit="cm", up="y")
            assert file.fps == 30
            seconds += file.duration
            same = file.without_end_sites() if file.skeleton.end_sites else file
            assert same.skeleton.names == motion.skeleton.names
            np.testing.assert_allclose(same.positions, motion.positions, atol=1e-3)  # metres
        assert 60 <= seconds <= 120
    assert sum(p.stat().st_size for p in SAMPLES.rglob("*.bvh")) < 6e6


def test_the_command_writes_the_same_files(tmp_path, capsys, monkeypatch):
    from tutorial_lib.data.synthetic import samples

    one = {style: made[:1] for style, made in sample_clips().items()}
    monkeypatch.setattr(samples, "sample_clips", lambda: one)
    main(["--out", str(tmp_path)])
    assert "4 clips" in capsys.readouterr().out
    for path in sorted(tmp_path.glob("*/*.bvh")):
        committed = (SAMPLES / path.relative_to(tmp_path)).read_text().split()
        written = path.read_text().split()
        assert len(written) == len(committed) and written[:20] == committed[:20]
