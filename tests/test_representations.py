"""Representations: values worked out by hand or by scipy, exact inverses, what turning does, bad input."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tutorial_lib import data
from tutorial_lib.errors import TutorialError
from tutorial_lib.motion import Motion, Skeleton, read_motion, to_common
from tutorial_lib.motion.rotations import quat_normalize
from tutorial_lib.motion.skeletons import COMMON_JOINTS, COMMON_PARENTS
from tutorial_lib.representations import (
    REPRESENTATIONS,
    euler_continuous,
    heading,
    make_representation,
    representation_from_config,
)

ALL = tuple(REPRESENTATIONS)
IN_THE_BODYS_FRAME = ("hip-frame", "body-frame")
BY_ROTATION = ("euler", "quaternion", "sixd")


def person() -> Skeleton:
    """The 21 common joints in a T-pose that faces +z, left at +x."""
    bones = {
        "Hips": (0, 0.9, 0), "Spine": (0, 0.1, 0), "Chest": (0, 0.2, 0), "Neck": (0, 0.2, 0), "Head": (0, 0.1, 0),
        "Shoulder": (0.05, 0.15, 0), "Arm": (0.1, 0, 0), "ForeArm": (0.25, 0, 0), "Hand": (0.25, 0, 0),
        "UpLeg": (0.1, 0, 0), "Leg": (0, -0.4, 0), "Foot": (0, -0.4, 0), "Toe": (0, -0.05, 0.15),
    }  # fmt: skip
    offsets = []
    for joint in COMMON_JOINTS:
        x, y, z = bones[joint.removeprefix("Left").removeprefix("Right")]
        offsets.append((-x if joint.startswith("Right") else x, y, z))
    parents = [-1 if p is None else COMMON_JOINTS.index(p) for p in COMMON_PARENTS.values()]
    orders = ("ZYX",) + ("ZXY",) * 10 + ("XYZ",) * 10
    return Skeleton(COMMON_JOINTS, tuple(parents), np.array(offsets), orders)


def wandering(skeleton: Skeleton, frames: int, seed: int, size: float = 0.1) -> Motion:
    """Every joint turns at random, smoothly enough for a sign or a turn to be followed."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(1, skeleton.n_joints, 4))
    q = q + size * rng.normal(size=(frames, skeleton.n_joints, 4)).cumsum(0)
    q[:, sorted(skeleton.end_sites)] = (1, 0, 0, 0)
    root = rng.normal(size=3) + rng.normal(scale=0.03, size=(frames, 3)).cumsum(0)
    return Motion.from_rotations(skeleton, 30.0, root, quat_normalize(q), name="wandering")


def about_y(vectors: np.ndarray, angle: float) -> np.ndarray:
    return Rotation.from_euler("y", angle).apply(vectors.reshape(-1, 3).copy()).reshape(vectors.shape)


# -- values known beforehand -------------------------------------------------------------------------------


def test_positions_by_hand():
    skeleton = Skeleton(("root", "a", "b"), (-1, 0, 1), np.array([[0, 0, 0], [0, 1, 0], [0, 1, 0]]))
    positions = np.array(
        [
            [[1, 2, 3], [1, 3, 3], [1, 4, 3]],
            [[1.5, 2, 3], [1.5, 3, 4], [0, 0, 0]],
            [[1.5, 2.25, 2], [2, 2.25, 2], [1.5, 2.25, 3]],
        ]
    )
    expected = [
        [0.5, 0, 0, 0, 1, 0, 0, 2, 0],  # the second frame's step stands in for the unknown first
        [0.5, 0, 0, 0, 1, 1, -1.5, -2, -3],
        [0, 0.25, -1, 0.5, 0, 0, 0, 0, 1],
    ]
    r = make_representation("positions", skeleton, 30)
    np.testing.assert_allclose(r.encode(Motion(skeleton, 30, positions)), expected, atol=1e-7)
    assert r.labels == ("root.dx", "root.dy", "root.dz", "a.x", "a.y", "a.z", "b.x", "b.y", "b.z")
    assert r.slices == {"root": slice(0, 3), "joints": slice(3, 9)}
    np.testing.assert_allclose(r.decode(expected, start=(1, 2, 3)).positions, positions, atol=1e-12)


def test_dimensions():
    skeleton = person()
    dims = {name: make_representation(name, skeleton, 30).dim for name in ALL}
    assert dims == {"positions": 63, "hip-frame": 66, "body-frame": 67, "euler": 66, "quaternion": 87, "sixd": 129}
    for name in ALL:
        r = make_representation(name, skeleton, 30)
        assert len(r.labels) == len(set(r.labels)) == r.dim


def test_end_sites_are_nodes_but_do_not_turn(small_skeleton):
    assert make_representation("positions", small_skeleton, 30).dim == 21
    assert make_representation("quaternion", small_skeleton, 30).dim == 3 + 4 * 4


def test_walking_a_circle_turns_at_the_known_speed():
    """A stiff figure on a circle of 2 m at 0.5 rad/s to its left, facing where it goes, at 30 fps."""
    skeleton, fps, radius, omega = person(), 30.0, 2.0, 0.5
    theta = 0.4 + omega * np.arange(400) / fps  # more than a whole turn
    rest = skeleton.rest_pose()
    # facing (sin, cos); on a left turn the centre lies to the left, (cos, -sin) of the heading
    centre = np.array([1.0, 0.0, -2.0])
    place = centre + radius * np.stack([-np.cos(theta), 0 * theta, np.sin(theta)], 1)
    positions = np.stack([about_y(rest, a) + p for a, p in zip(theta, place, strict=True)])
    motion = Motion(skeleton, fps, positions)
    r = make_representation("hip-frame", skeleton, fps)
    features = r.encode(motion)
    half = omega / fps / 2
    chord = 2 * radius * np.sin(half) * fps
    np.testing.assert_allclose(features[:, r.slices["turning"]], omega, rtol=1e-5)
    np.testing.assert_allclose(features[:, r.slices["forward"]], chord * np.cos(half), rtol=1e-5)
    np.testing.assert_allclose(features[:, r.slices["sideways"]], -chord * np.sin(half), atol=1e-5)
    joints = features[:, r.slices["joints"]].reshape(400, 21, 3)
    np.testing.assert_allclose(joints, np.broadcast_to(rest, joints.shape), atol=1e-6)
    np.testing.assert_allclose(np.unwrap(heading(skeleton, positions)), theta, atol=1e-9)
    again = r.decode(features, start=(place[0, 0], place[0, 2]), heading=theta[0])
    np.testing.assert_allclose(again.positions, positions, atol=1e-4)


def test_a_step_to_the_left_is_sideways():
    skeleton = person()
    positions = np.stack([skeleton.rest_pose(), skeleton.rest_pose() + [0.1, 0, 0]])
    r = make_representation("hip-frame", skeleton, 10)
    np.testing.assert_allclose(r.encode(Motion(skeleton, 10, positions))[:, -3:], [[0, 0, 1], [0, 0, 1]], atol=1e-6)


def test_rotations_against_scipy(small_motion):
    skeleton = small_motion.skeleton
    joints = skeleton.joints
    oracle = {j: Rotation.from_quat(small_motion.rotations[:, j], scalar_first=True) for j in joints}

    def joint_features(name):
        r = make_representation(name, skeleton, 30)
        f = r.encode(small_motion)
        steps = np.diff(small_motion.positions[:, 0], axis=0)
        np.testing.assert_allclose(f[:, :3], np.concatenate([steps[:1], steps]), atol=1e-7)
        return f[:, 3:].reshape(len(f), len(joints), -1)

    euler, quaternion, sixd = (joint_features(name) for name in BY_ROTATION)
    for k, j in enumerate(joints):
        again = Rotation.from_euler(skeleton.orders[j], euler[:, k].astype(float))
        assert (again * oracle[j].inv()).magnitude().max() < 1e-6
        expected = oracle[j].as_quat(scalar_first=True)
        sign = np.sign((expected * quaternion[:, k]).sum(1, keepdims=True))
        np.testing.assert_allclose(quaternion[:, k], sign * expected, atol=1e-6)
        matrix = oracle[j].as_matrix()
        np.testing.assert_allclose(sixd[:, k, :3], matrix[:, :, 0], atol=1e-6)
        np.testing.assert_allclose(sixd[:, k, 3:], matrix[:, :, 1], atol=1e-6)


def test_euler_labels_name_each_joints_own_order(small_skeleton):
    labels = make_representation("euler", small_skeleton, 30).labels
    assert labels[3:9] == ("root.Z", "root.Y", "root.X", "spine.Z", "spine.X", "spine.Y")


@pytest.mark.parametrize("order, axis", [("ZXY", "z"), ("ZXY", "x"), ("ZXY", "y"), ("XYZ", "y"), ("ZYX", "y")])
def test_somersaults_stay_continuous(order, axis):
    """Three whole turns about one axis: that angle runs on to 6 pi, through gimbal lock too; the others rest."""
    skeleton = Skeleton(("root", "a"), (-1, 0), np.array([[0, 0, 0], [0, 1, 0]]), (order, order))
    angle = np.linspace(0.01, 6 * np.pi, 300)
    turning = Rotation.from_euler(axis, angle[:, None]).as_quat(scalar_first=True)
    turning[::2] *= -1  # q and -q are the same rotation, and files hold either
    q = np.stack([turning, np.tile([1.0, 0, 0, 0], (300, 1))], 1)
    motion = Motion.from_rotations(skeleton, 30, np.zeros((300, 3)), q)
    euler = make_representation("euler", skeleton, 30).encode(motion)[:, 3:6]
    expected = np.zeros((300, 3))
    expected[:, order.index(axis.upper())] = angle
    np.testing.assert_allclose(euler, expected, atol=1e-4)
    quaternion = make_representation("quaternion", skeleton, 30).encode(motion)[:, 3:7]
    assert quaternion[0, 0] > 0
    np.testing.assert_allclose(quaternion[:, 0], np.cos(angle / 2), atol=1e-6)


def test_euler_continuous_keeps_the_rotation():
    rng = np.random.default_rng(3)
    raw = rng.uniform(-np.pi, np.pi, size=(2, 60, 4, 3))
    smooth = euler_continuous(raw)
    a, b = (Rotation.from_euler("ZXY", x.reshape(-1, 3)) for x in (raw, smooth))
    assert (a.inv() * b).magnitude().max() < 1e-7
    np.testing.assert_array_equal(smooth[:, 0], raw[:, 0])


# -- there and back ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
@settings(max_examples=8, deadline=None)
@given(frames=st.integers(1, 40), seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 0.05, 1.0]))
def test_decode_undoes_encode(name, frames, seed, size):
    motion = wandering(person(), frames, seed, size)
    r = make_representation(name, motion.skeleton, motion.fps)
    features = r.encode(motion)
    assert features.shape == (frames, r.dim) and features.dtype == np.float32
    again = r.decode(features, **r.origin(motion), name=motion.name)
    np.testing.assert_allclose(again.positions, motion.positions, atol=1e-4)
    assert (again.skeleton, again.fps, again.name) == (motion.skeleton, motion.fps, motion.name)
    if name in BY_ROTATION:
        a, b = (Rotation.from_quat(m.rotations.reshape(-1, 4), scalar_first=True) for m in (again, motion))
        assert (a.inv() * b).magnitude().max() < 1e-4


@pytest.mark.parametrize("name", ALL)
def test_what_is_lost_is_the_start_alone(name):
    """A motion moved over the ground (and for hip-frame turned) has the same features."""
    motion = wandering(person(), 20, 1)
    moved = motion.translate((3.0, 0.0, -2.0))
    if name in IN_THE_BODYS_FRAME:
        moved = moved.rotate_y(2.2)
    r = make_representation(name, motion.skeleton, motion.fps)
    np.testing.assert_allclose(r.encode(moved), r.encode(motion), atol=1e-5)


@pytest.mark.parametrize("name", ALL)
def test_start_and_heading(name):
    motion = wandering(person(), 12, 2)
    r = make_representation(name, motion.skeleton, motion.fps)
    features = r.encode(motion)
    plain = r.decode(features)
    hip = plain.positions[0, 0]
    np.testing.assert_allclose(hip[[0, 2]], 0, atol=1e-12)
    if name not in IN_THE_BODYS_FRAME:  # the lowest node of the first frame stands on the ground
        assert abs(plain.positions[0, :, 1].min()) < 1e-9
        high = r.decode(features, start=(0, 5, 0))
        np.testing.assert_allclose(high.positions[0, 0], (0, 5, 0), atol=1e-12)
    turned = r.decode(features, start=(1, -1), heading=0.7)
    np.testing.assert_allclose(turned.positions, about_y(plain.positions, 0.7) + [1, 0, -1], atol=1e-9)
    if name in BY_ROTATION:  # rotations and positions of the result belong together
        fk = turned.skeleton.fk(turned.rotations, turned.positions[:, 0])
        np.testing.assert_allclose(fk, turned.positions, atol=1e-9)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("clips", ["cmu/martial", "cmu/indian", "cmu/walking", "bandai-namco/walk"])
def test_real_clips(name, clips, real_clips):
    motion = read_motion(real_clips(f"{clips}/*.bvh")[0])[:1200]
    if "bandai" in clips and name in BY_ROTATION:
        motion = to_common(motion)  # its hip slides along the bone from the root
    r = make_representation(name, motion.skeleton, motion.fps)
    if motion.skeleton.names[0] == "hip" and name == "positions":
        assert r.dim == 171
    features = r.encode(motion)
    again = r.decode(features, **r.origin(motion))
    assert np.abs(again.positions - motion.positions).max() < 1e-4
    if name == "euler":  # no jumps: 0.5 rad at 120 fps would be 3,400 degrees a second
        jumps = np.abs(np.diff(features[:, 3:], axis=0)).max()
        assert jumps < np.pi


# -- turning the world -------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.5, np.pi, -2.0])
def test_turning_a_motion_turns_its_features(angle):
    motion = wandering(person(), 30, 5)
    turned = motion.rotate_y(angle)
    encode = {n: make_representation(n, motion.skeleton, 30).encode for n in ALL}
    vectors = encode["positions"](motion).reshape(30, 21, 3)
    np.testing.assert_allclose(encode["positions"](turned).reshape(30, 21, 3), about_y(vectors, angle), atol=1e-5)
    np.testing.assert_allclose(encode["hip-frame"](turned), encode["hip-frame"](motion), atol=1e-4)
    for name, width in zip(BY_ROTATION, (3, 4, 6), strict=True):  # only the root's step and rotation change
        a, b = encode[name](motion), encode[name](turned)
        np.testing.assert_allclose(b[:, 3 + width :], a[:, 3 + width :], atol=1e-6)
        np.testing.assert_allclose(b[:, :3], about_y(a[:, :3], angle), atol=1e-6)
        assert np.abs(b[:, 3 : 3 + width] - a[:, 3 : 3 + width]).max() > 0.1


# -- arrays and tensors ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_torch_and_numpy_agree_in_batches(name):
    motions = [wandering(person(), 9, seed) for seed in range(6)]
    p, q = (np.stack([getattr(m, k) for m in motions]).reshape(2, 3, 9, 21, -1) for k in ("positions", "rotations"))
    r = make_representation(name, motions[0].skeleton, 30)
    arrays = r.encode_arrays(p, q)
    tensors = r.encode_arrays(torch.tensor(p), torch.tensor(q))
    assert isinstance(arrays, np.ndarray) and arrays.shape == (2, 3, 9, r.dim) and arrays.dtype == np.float64
    np.testing.assert_array_equal(arrays, tensors.numpy())
    one = r.encode(motions[4])
    np.testing.assert_allclose(arrays[1, 1], one, atol=1e-6)
    back = r.decode_positions(arrays)
    np.testing.assert_array_equal(back, r.decode_positions(tensors).numpy())
    np.testing.assert_allclose(back[1, 1], r.decode(arrays[1, 1]).positions, atol=1e-12)
    assert r.decode_positions(tensors.float()).dtype == torch.float32
    starts = np.arange(18.0).reshape(2, 3, 3)
    placed = r.decode_positions(arrays, start=starts)
    np.testing.assert_allclose(placed[1, 0, 0, 0, [0, 2]], starts[1, 0, [0, 2]], atol=1e-9)
    if r.uses_rotations:
        np.testing.assert_array_equal(r.encode_arrays(p[..., :1, :], q), arrays)


@pytest.mark.parametrize("name", ALL)
def test_gradients_flow_through_decode_positions(name, small_motion):
    motion = wandering(person(), 3, 8) if name in IN_THE_BODYS_FRAME else small_motion[:3]
    r = make_representation(name, motion.skeleton, 30)
    noise = 0.01 * np.random.default_rng(1).normal(size=(3, r.dim))
    features = torch.tensor(r.encode(motion) + noise, dtype=torch.float64, requires_grad=True)
    start = torch.tensor([0.1, 1.0, 0.2], dtype=torch.float64)

    def few(x):  # finite differences; a few nodes are enough
        return r.decode_positions(x, start=start)[:, [0, 4, 6]]

    assert torch.autograd.gradcheck(few, features, atol=1e-5)


@pytest.mark.parametrize("name", ALL)
def test_whatever_a_network_says_is_decoded(name):
    r = make_representation(name, person(), 30)
    rng = np.random.default_rng(0)
    for features in (np.zeros((5, r.dim)), np.ones((5, r.dim)), 1e3 * rng.normal(size=(50, r.dim))):
        motion = r.decode(features)
        assert np.isfinite(motion.positions).all()
        if name in BY_ROTATION:
            bones = np.linalg.norm(motion.positions[:, 1:] - motion.positions[:, list(r.skeleton.parents[1:])], axis=-1)
            np.testing.assert_allclose(bones, np.tile(r.skeleton.bone_lengths, (len(bones), 1)), atol=1e-6)
    gone = torch.full((4, r.dim), float("nan"))
    assert r.decode_positions(gone).isnan().any()  # measured by metrics, so passed on


# -- description and bad input -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_config_survives_json(name):
    r = make_representation(name, person(), 29.97)
    again = representation_from_config(json.loads(json.dumps(r.config())))
    assert again == r and hash(again) == hash(r)
    assert again != make_representation(name, person(), 30)
    assert again != make_representation(name, person().scaled(1.1), 29.97)
    assert again != make_representation("quaternion" if name != "quaternion" else "sixd", person(), 29.97)


def refuses(*words):
    """The error is one line that names all of this."""
    return pytest.raises(TutorialError, match="(?s)^(?!.*\n)" + "".join(f"(?=.*{w})" for w in words))


def test_errors_name_both_sides(small_skeleton, small_motion):
    r = make_representation("positions", person(), 30)
    with refuses("'small'", "7 nodes", "21"):
        r.encode(small_motion)
    motion = wandering(person(), 4, 0)
    with refuses("'wandering'", "60", "30", "resample"):
        make_representation("positions", person(), 60).encode(motion)
    other = Skeleton(("Pelvis",) + COMMON_JOINTS[1:], person().parents, person().offsets)
    with refuses("'Pelvis'", "'Hips'"):
        make_representation("positions", other, 30).encode(motion)
    for bad in (np.zeros((4, 62)), np.zeros((0, 63)), np.zeros(63)):
        with refuses("63"):
            r.decode(bad)
    nan = np.zeros((4, 63))
    nan[2, 4] = np.nan
    with refuses("frame 2", "Spine.y"):
        r.decode(nan)
    with refuses(r"\(2, 5, 3\)", "21"):
        r.encode_arrays(np.zeros((2, 5, 3)))
    with refuses("'sixd'", "no rotations"):
        make_representation("sixd", person(), 30).encode_arrays(np.zeros((2, 21, 3)))
    with refuses("start"):
        r.decode(np.zeros((2, 63)), start=(1.0,))
    with refuses("start"):
        make_representation("hip-frame", person(), 30).decode(np.zeros((2, 66)), start=(1.0,))


def test_rotations_that_are_not_there_or_not_enough():
    motion = wandering(person(), 6, 0)
    r = make_representation("quaternion", motion.skeleton, 30)
    with refuses("'wandering'", "positions alone"):
        r.encode(Motion(motion.skeleton, 30, motion.positions, name="wandering"))
    stretched = motion.positions.copy()
    knee = COMMON_JOINTS.index("LeftLeg")
    stretched[3, knee] += (0, -0.05, 0)
    with refuses("'LeftLeg'", "5 cm", "rigid"):
        r.encode(Motion(motion.skeleton, 30, stretched, motion.rotations))
    with refuses("rigid"):
        make_representation("quaternion", motion.skeleton.scaled(1.5), 30).encode(motion)
    # by positions, people of other sizes are welcome
    make_representation("positions", motion.skeleton.scaled(1.5), 30).encode(motion)


def test_unknown_names(small_skeleton):
    with refuses("'polar'", "hip-frame"):
        make_representation("polar", person(), 30)
    with refuses("heading", "root, spine", "no "):
        make_representation("hip-frame", small_skeleton, 30)
    with refuses("above zero"):
        make_representation("positions", person(), 0)
    with refuses("without fps"):
        representation_from_config({"name": "positions", "skeleton": {}})
    with refuses("offsets"):
        representation_from_config({"name": "positions", "fps": 30, "skeleton": {"names": ["a"], "parents": [-1]}})


def test_hip_frame_needs_no_toes():
    """Only hips and shoulders tell the heading: a skeleton without the rest still has one."""
    motion = wandering(person(), 5, 0)
    keep = [j for j, n in enumerate(COMMON_JOINTS) if "Toe" not in n and "Hand" not in n]
    less = Motion(motion.skeleton.subset(keep), 30, motion.positions[:, keep])
    assert make_representation("hip-frame", less.skeleton, 30).encode(less).shape == (5, 3 * len(keep) + 3)


@pytest.mark.parametrize("name", REPRESENTATIONS)
def test_the_parts_are_the_slices(name):
    skeleton = data.load("samples/walking")[0].skeleton
    made = make_representation(name, skeleton, 30.0)
    assert set(made.parts) == set(made.slices) and all(made.labels[part] for part in made.slices.values())


def test_a_rate_that_is_nearly_right_is_not():
    motion = wandering(person(), 20, 1)
    r = make_representation("positions", person(), 30)
    r.check(motion.resample(29.98))
    with refuses("runs at 29", "30"):
        r.check(motion.resample(29.0))


def test_who_has_no_direction_faces_z():
    """Hips and shoulders exactly above each other."""
    positions = np.zeros((2, 21, 3))
    positions[..., 1] = person().rest_pose()[:, 1]
    np.testing.assert_array_equal(heading(person(), positions), [0, 0])


def test_a_bone_that_moves_by_half_a_centimetre_is_not_rigid():
    motion = wandering(person(), 6, 0)
    stretched = motion.positions.copy()
    stretched[3, COMMON_JOINTS.index("LeftLeg")] += (0, -0.005, 0)
    with refuses("'LeftLeg'", "0.5 cm"):
        make_representation("quaternion", motion.skeleton, 30).encode(
            Motion(motion.skeleton, 30, stretched, motion.rotations)
        )


def test_a_motion_by_rotations_keeps_its_name():
    r = make_representation("body-frame", person(), 30)
    motion = wandering(person(), 4, 0)
    assert r.decode_turned(r.encode(motion), motion.rotations, name="a").name == "a"
