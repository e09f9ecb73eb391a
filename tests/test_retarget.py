"""Known skeletons told by name, and mapped to the common one of 21 joints."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tutorial_lib.errors import MotionError
from tutorial_lib.motion import COMMON_JOINTS, Motion, Skeleton, common_indices, read_motion, recognise, to_common
from tutorial_lib.motion.retarget import common_skeleton
from tutorial_lib.motion.rotations import quat_angle
from tutorial_lib.motion.skeletons import COMMON_PARENTS, KNOWN_SKELETONS

INDEX = {name: j for j, name in enumerate(COMMON_JOINTS)}
PARENTS = tuple(INDEX[p] if p else -1 for p in COMMON_PARENTS.values())
SIDES = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "Toe")
T_POSE = {  # metres; a body that faces +z, its left at +x, arms out
    "Hips": (0, 0.95, 0), "Spine": (0, 0.1, 0), "Chest": (0, 0.2, 0), "Neck": (0, 0.25, 0), "Head": (0, 0.1, 0),
    "LeftShoulder": (0.05, 0.2, 0), "LeftArm": (0.12, 0, 0), "LeftForeArm": (0.28, 0, 0), "LeftHand": (0.25, 0, 0),
    "RightShoulder": (-0.05, 0.2, 0), "RightArm": (-0.12, 0, 0), "RightForeArm": (-0.28, 0, 0),
    "RightHand": (-0.25, 0, 0),
    "LeftUpLeg": (0.1, -0.05, 0), "LeftLeg": (0, -0.42, 0), "LeftFoot": (0, -0.4, 0),
    "LeftToe": (0, -0.07, 0.07 * 0.866 / 0.5),
    "RightUpLeg": (-0.1, -0.05, 0), "RightLeg": (0, -0.42, 0), "RightFoot": (0, -0.4, 0),
    "RightToe": (0, -0.07, 0.07 * 0.866 / 0.5),
}  # fmt: skip
OFFSETS = np.array([T_POSE[name] for name in COMMON_JOINTS])


def body(kind: str, turn: Rotation | None = None) -> Skeleton:
    """The T-posed body under another data set's names, its rest pose turned as a whole."""
    offsets = OFFSETS if turn is None else turn.apply(OFFSETS)
    return Skeleton(tuple(KNOWN_SKELETONS[kind][name] for name in COMMON_JOINTS), PARENTS, offsets)


def moving(skeleton: Skeleton, frames: int = 20) -> Motion:
    rng = np.random.default_rng(2)
    q = np.array([1.0, 0, 0, 0]) + rng.normal(scale=0.3, size=(frames, 21, 4))
    return Motion.from_rotations(skeleton, 30, rng.normal(size=(frames, 3)), q, name="m")


# -- by name -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KNOWN_SKELETONS)
def test_recognised_by_names_and_mapped(kind):
    skeleton = body(kind)
    assert recognise(skeleton) == kind
    assert common_indices(skeleton) == INDEX
    backwards = Skeleton(("x", *skeleton.names), (-1, *(p + 1 for p in PARENTS)), np.zeros((22, 3)))
    assert common_indices(backwards) == {n: j + 1 for n, j in INDEX.items()}


def test_an_unknown_skeleton_is_told_in_one_line(small_motion):
    assert recognise(small_motion.skeleton) is None
    for call in (lambda: common_indices(small_motion.skeleton), lambda: to_common(small_motion)):
        with pytest.raises(MotionError, match="unknown skeleton .root, spine") as caught:
            call()
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
    names = tuple(n for n in body("acrnn").names if n != "lHand")
    with pytest.raises(MotionError, match="nearest is acrnn, which would also have lHand"):
        common_indices(Skeleton(names, (-1,) + (0,) * 19, np.zeros((20, 3))))


@pytest.mark.filterwarnings("error")
def test_a_body_without_width_is_told(small_motion):
    flat = Skeleton(body("acrnn").names, PARENTS, np.zeros((21, 3)))
    with pytest.raises(MotionError, match="^the skeleton's rest pose is flat: expected"):
        to_common(Motion(flat, 30, np.zeros((1, 21, 3))))


def test_a_skeleton_that_cannot_be_is_told_with_its_motions_name(small_motion):
    flat = Skeleton(body("acrnn").names, PARENTS, np.zeros((21, 3)))
    with pytest.raises(MotionError, match="^motion 'walks/07': the skeleton's rest pose is flat"):
        to_common(Motion(flat, 30, np.zeros((1, 21, 3)), name="walks/07"))
    with pytest.raises(MotionError, match="^motion 'walks/08': unknown skeleton .root, spine"):
        to_common(small_motion.with_name("walks/08"))


# -- one rest pose for all -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KNOWN_SKELETONS)
@pytest.mark.parametrize("turn", [None, Rotation.from_euler("xyz", [0.3, 2.0, -1.0])])
def test_any_rest_pose_becomes_the_same(kind, turn):
    """However the data set's rest pose lies, the common one faces +z with its left at +x."""
    skeleton, turns = common_skeleton(body(kind, turn))
    assert skeleton.names == COMMON_JOINTS and skeleton.parents == PARENTS
    want = np.vstack((np.zeros(3), OFFSETS[1:]))
    assert np.allclose(skeleton.offsets, want, atol=1e-4)
    if turn is not None:
        assert np.allclose(quat_angle(turns, turn.as_quat()[[3, 0, 1, 2]]), 0, atol=2e-3)


@pytest.mark.parametrize("kind", KNOWN_SKELETONS)
def test_positions_stay_and_rotations_agree(kind):
    m = moving(body(kind, Rotation.from_euler("xyz", [0.3, 2.0, -1.0])))
    c = to_common(m)
    assert c.skeleton.names == COMMON_JOINTS and c.fps == 30 and c.name == "m"
    assert np.array_equal(c.positions, m.positions)
    assert np.abs(c.skeleton.fk(c.rotations, c.positions[:, 0]) - c.positions).max() < 1e-6


def test_without_rotations_bones_point_right_too():
    m = moving(body("common"))
    c = to_common(Motion(m.skeleton, m.fps, m.positions))
    assert np.abs(c.skeleton.fk(c.rotations, c.positions[:, 0]) - c.positions).max() < 1e-6


def test_in_the_rest_pose_nothing_is_turned():
    skeleton = body("bandai-namco", Rotation.from_euler("y", 1.0))
    q = np.tile([1.0, 0, 0, 0], (1, 21, 1))
    turned = to_common(Motion.from_rotations(skeleton, 30, np.zeros((1, 3)), q))
    back = [np.cos(0.5), 0, np.sin(0.5), 0]
    assert np.allclose(quat_angle(turned.rotations[0, 0], np.array(back)), 0, atol=1e-5)
    assert np.allclose(quat_angle(turned.rotations[0, 1:], np.array([1.0, 0, 0, 0])), 0, atol=2e-3)


def test_the_sources_twist_is_kept():
    """A forearm turned about its own axis: no position shows it, the source's rotation does."""
    q = np.tile([1.0, 0, 0, 0], (1, 21, 1))
    for name in ("LeftForeArm", "LeftHand"):
        q[0, INDEX[name]] = [np.cos(0.4), np.sin(0.4), 0, 0]
    m = Motion.from_rotations(body("common"), 30, np.zeros((1, 3)), q)
    assert quat_angle(to_common(m).rotations, q).max() < 1e-6
    lost = to_common(Motion(m.skeleton, 30, m.positions))
    assert quat_angle(lost.rotations[0, INDEX["LeftForeArm"]], q[0, INDEX["LeftForeArm"]]) == pytest.approx(0.8)


# -- the real data sets --------------------------------------------------------------------------------------

# clips, their skeleton's name, and how far rigid bones may miss the flexible ones of the source, in metres
CLIPS = {
    "cmu/indian/*.bvh": ("acrnn", 1e-6),
    "cmu/martial/*.bvh": ("acrnn", 1e-6),
    "cmu/salsa/*.bvh": ("acrnn", 1e-6),
    "cmu/walking/*.bvh": ("cmu-bvh", 0.03),
    "cmu/running/*.bvh": ("cmu-bvh", 0.03),
    "cmu/asfamc/02/*.amc": ("cmu", 0.03),
    "bandai-namco/run/*.bvh": ("bandai-namco", 1e-6),
    "bandai-namco/walk/*.bvh": ("bandai-namco", 1e-6),
}


@pytest.mark.parametrize("clip", CLIPS)
def test_real_clips(real_clips, clip):
    kind, within = CLIPS[clip]
    m = read_motion(real_clips(clip)[0])
    assert recognise(m.skeleton) == kind
    c = to_common(m)
    at = common_indices(m.skeleton)
    assert np.array_equal(c.positions, m.positions[:, [at[n] for n in COMMON_JOINTS]])
    assert np.abs(c.skeleton.fk(c.rotations, c.positions[:, 0]) - c.positions).max() < within
    # the T-pose: faces +z, left at +x, head on top, both sides alike to the body's own centimetre
    rest = dict(zip(COMMON_JOINTS, c.skeleton.rest_pose() - c.skeleton.offsets[0], strict=True))
    assert rest["LeftHand"][0] > 0.5 > -0.5 > rest["RightHand"][0] and rest["Head"][1] > 0.4
    assert rest["LeftToe"][2] > rest["LeftFoot"][2] + 0.05 and rest["LeftFoot"][1] < -0.6
    for side in SIDES:
        assert np.abs(rest["Left" + side] * [-1, 1, 1] - rest["Right" + side]).max() < 0.015
    # seen in motion, its hips face where it goes: the T-pose is not back to front
    hips = c.skeleton.world_rotations(c.rotations)[:, 0]
    x, z = 2 * (hips[:, 1] * hips[:, 3] + hips[:, 0] * hips[:, 2]), 1 - 2 * (hips[:, 1] ** 2 + hips[:, 2] ** 2)
    across = c.positions[:, INDEX["LeftUpLeg"]] - c.positions[:, INDEX["RightUpLeg"]]
    assert (across[:, 0] * z - across[:, 2] * x > 0).all()  # left is to the left of the way the hips face
    if "walk" in clip or "run" in clip:
        way = c.positions[-1, 0] - c.positions[0, 0]
        assert way[0] * x.mean() + way[2] * z.mean() > 0.5 * np.linalg.norm(way)


@pytest.mark.parametrize("group", ["cmu/indian", "cmu/martial", "cmu/salsa", "bandai-namco/run"])
def test_all_clips_of_a_data_set_have_one_skeleton(real_clips, group):
    paths = real_clips(f"{group}/*.bvh")
    if len(paths) < 2:
        pytest.skip(f"a single clip in {group}")
    skeletons = [common_skeleton(read_motion(p).skeleton)[0] for p in paths[:: max(1, len(paths) // 5)]]
    for s in skeletons[1:]:
        assert s.same_tree(skeletons[0]) and np.abs(s.offsets - skeletons[0].offsets).max() < 1e-9


@pytest.mark.parametrize("turn", [None, Rotation.from_euler("xyz", [0.3, 2.0, -1.0])])
def test_shoulders_that_begin_in_one_point_leave_it_to_the_arms(turn):
    """As CMU's do: the chest's own frame is then told by the arms."""
    offsets = OFFSETS.copy()
    for side in ("Left", "Right"):
        offsets[INDEX[side + "Arm"], 0] += offsets[INDEX[side + "Shoulder"], 0]
        offsets[INDEX[side + "Shoulder"], 0] = 0.0
    plain = body("cmu-bvh")
    source = Skeleton(plain.names, PARENTS, offsets if turn is None else turn.apply(offsets))
    skeleton, turns = common_skeleton(source)
    assert np.allclose(skeleton.offsets, np.vstack((np.zeros(3), offsets[1:])), atol=1e-4)
    if turn is not None:
        assert quat_angle(turns[INDEX["Chest"]], turn.as_quat()[[3, 0, 1, 2]]) < 2e-3
