"""Skeletons and forward kinematics, against numbers by hand and 4x4 matrices."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tutorial_lib.errors import MotionError
from tutorial_lib.motion import Skeleton
from tutorial_lib.motion.rotations import quat_from_axis_angle

HALF = np.sqrt(0.5)
ABOUT_Z = [HALF, 0, 0, HALF]  # a quarter turn: x to y
ABOUT_X = [HALF, HALF, 0, 0]  # y to z
NONE = [1.0, 0, 0, 0]


@pytest.fixture
def arm() -> Skeleton:
    """Shoulder, elbow one metre along x, wrist half a metre further."""
    return Skeleton(("shoulder", "elbow", "wrist"), (-1, 0, 1), [[9, 9, 9], [1, 0, 0], [0.5, 0, 0]])


def random_rotations(skeleton: Skeleton, *axes: int, seed: int = 0) -> np.ndarray:
    n = int(np.prod(axes)) * skeleton.n_joints
    q = Rotation.random(n, random_state=seed).as_quat()[:, [3, 0, 1, 2]]
    return q.reshape(*axes, skeleton.n_joints, 4)


def by_matrices(skeleton, rotations, root, translations=None) -> np.ndarray:
    """The same by homogeneous 4x4 matrices, joint by joint, one pose."""
    world, positions = [], np.zeros((skeleton.n_joints, 3))
    for j, p in enumerate(skeleton.parents):
        local = np.eye(4)
        local[:3, :3] = Rotation.from_quat(rotations[j][[1, 2, 3, 0]]).as_matrix()
        place = skeleton.offsets[j] if translations is None else translations[j]
        local[:3, 3] = root if p < 0 else place
        world.append(local if p < 0 else world[p] @ local)
        positions[j] = world[j][:3, 3]
    return positions


# -- forward kinematics --------------------------------------------------------------------------------------


def test_three_joints_by_hand(arm):
    root = np.array([0.0, 2.0, 0.0])
    straight = arm.fk(np.array([NONE, NONE, NONE]), root)
    assert np.allclose(straight, [[0, 2, 0], [1, 2, 0], [1.5, 2, 0]])
    raised = arm.fk(np.array([ABOUT_Z, NONE, NONE]), root)
    assert np.allclose(raised, [[0, 2, 0], [0, 3, 0], [0, 3.5, 0]])
    # the elbow turns in the raised arm's frame: its own x to y, which is the world's y to -x
    bent = arm.fk(np.array([ABOUT_Z, ABOUT_Z, NONE]), root)
    assert np.allclose(bent, [[0, 2, 0], [0, 3, 0], [-0.5, 3, 0]])
    # a turn about x leaves the arm, which lies along x; then its y is the world's z, where the elbow sends the wrist
    rolled = arm.fk(np.array([ABOUT_X, ABOUT_Z, NONE]), root)
    assert np.allclose(rolled, [[0, 2, 0], [1, 2, 0], [1, 2, 0.5]])
    # the wrist's own rotation moves nothing
    assert np.allclose(arm.fk(np.array([ABOUT_X, ABOUT_Z, ABOUT_X]), root), rolled)


def test_translations_broadcast_to_the_rotations(small_motion):
    m = small_motion
    translations, turned = m.translations(), m.rotations[:, ::-1]
    found = m.skeleton.fk(np.stack([m.rotations, turned]), m.positions[:, 0], translations)
    for one, rotations in zip(found, (m.rotations, turned), strict=True):
        assert np.allclose(one, m.skeleton.fk(rotations, m.positions[:, 0], translations))


def test_translations_replace_offsets_but_not_the_roots_place(arm):
    t = np.array([[7.0, 7, 7], [0, 0, 2], [0.5, 0, 0]])
    got = arm.fk(np.array([NONE, ABOUT_Z, NONE]), np.array([0.0, 2, 0]), t)
    assert np.allclose(got, [[0, 2, 0], [0, 2, 2], [0, 2.5, 2]])


def test_a_tree_agrees_with_4x4_matrices(small_skeleton):
    q = random_rotations(small_skeleton, 6)
    root = np.random.default_rng(1).normal(size=(6, 3))
    t = np.random.default_rng(2).normal(size=(6, small_skeleton.n_joints, 3))
    plain, moved = small_skeleton.fk(q, root), small_skeleton.fk(q, root, t)
    for f in range(6):
        assert np.allclose(plain[f], by_matrices(small_skeleton, q[f], root[f]), atol=1e-12)
        assert np.allclose(moved[f], by_matrices(small_skeleton, q[f], root[f], t[f]), atol=1e-12)


def test_nodes_in_any_order_of_depth():
    """Siblings with children of their own, listed across each other."""
    skeleton = Skeleton(tuple("abcdefg"), (-1, 0, 0, 2, 1, 3, 4), np.random.default_rng(0).normal(size=(7, 3)))
    q = random_rotations(skeleton, 1)[0]
    assert np.allclose(skeleton.fk(q, np.zeros(3)), by_matrices(skeleton, q, np.zeros(3)), atol=1e-12)


def test_any_leading_axes_and_both_kinds_of_array(small_skeleton):
    q = random_rotations(small_skeleton, 2, 3)
    root = np.random.default_rng(1).normal(size=(2, 3, 3))
    want = small_skeleton.fk(q, root)
    assert want.shape == (2, 3, 7, 3) and want.dtype == np.float64
    assert np.allclose(want[1, 2], small_skeleton.fk(q[1, 2], root[1, 2]))
    assert np.allclose(small_skeleton.fk(q, root[0, 0]), small_skeleton.fk(q, root[:1, :1] + 0 * root))
    tensor = small_skeleton.fk(torch.tensor(q), torch.tensor(root))
    assert isinstance(tensor, torch.Tensor) and np.array_equal(tensor.numpy(), want)
    single = small_skeleton.fk(torch.tensor(q, dtype=torch.float32), torch.tensor(root, dtype=torch.float32))
    assert single.dtype == torch.float32 and np.allclose(single.numpy(), want, atol=1e-5)


def test_gradient_of_forward_kinematics(small_skeleton):
    q = torch.tensor(random_rotations(small_skeleton, 2), requires_grad=True)
    root = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    t = torch.randn(2, 7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert torch.autograd.gradcheck(small_skeleton.fk, (q, root))
    assert torch.autograd.gradcheck(small_skeleton.fk, (q, root, t))


def test_world_and_local_rotations_are_inverse(small_skeleton):
    q = random_rotations(small_skeleton, 4)
    world = small_skeleton.world_rotations(q)
    turn = [Rotation.from_quat(q[0, j][[1, 2, 3, 0]]) for j in range(7)]
    want = (turn[0] * turn[3] * turn[4]).as_quat()[[3, 0, 1, 2]]  # root, leg, shin
    assert np.allclose(np.abs(world[0, 4] @ want), 1)
    assert np.allclose(np.abs((small_skeleton.local_rotations(world) * q).sum(-1)), 1)


def test_shapes_that_do_not_fit_are_told(arm):
    with pytest.raises(MotionError, match=r"rotations of shape \(2, 4\).*expected \(..., 3, 4\)"):
        arm.fk(np.zeros((2, 4)), np.zeros(3))
    with pytest.raises(MotionError, match="root positions"):
        arm.fk(np.zeros((3, 4)), np.zeros(2))
    with pytest.raises(MotionError, match="translations"):
        arm.fk(np.zeros((3, 4)), np.zeros(3), np.zeros((2, 3)))


# -- the value -----------------------------------------------------------------------------------------------


def test_structure(small_skeleton):
    assert small_skeleton.n_joints == 7 and small_skeleton.joints == (0, 1, 3, 4)
    assert small_skeleton.bones.tolist() == [[0, 1], [1, 2], [0, 3], [3, 4], [4, 5], [3, 6]]
    assert small_skeleton.children == ((1, 3), (2,), (), (4, 6), (5,), (), ())
    assert small_skeleton.index("shin") == 4
    assert np.allclose(small_skeleton.bone_lengths[[0, 3]], [0.5, 0.4])
    assert np.allclose(small_skeleton.rest_pose()[5], [0.1, -0.9, 0])
    with pytest.raises(MotionError, match="no joint 'knee'.*root, spine"):
        small_skeleton.index("knee")


def test_equal_by_value_and_through_json(small_skeleton):
    other = Skeleton.from_dict(json.loads(json.dumps(small_skeleton.to_dict())))
    assert other == small_skeleton and hash(other) == hash(small_skeleton)
    assert other.scaled(2.0) != other and other.scaled(2.0).same_tree(other)
    assert len({other, small_skeleton, other.scaled(2.0)}) == 2


def test_nothing_in_it_can_be_changed(small_skeleton):
    given = np.zeros((1, 3))
    one = Skeleton(("a",), (-1,), given)
    given[:] = 5
    assert np.array_equal(one.offsets, np.zeros((1, 3)))
    with pytest.raises(ValueError):
        small_skeleton.offsets[0] = 1
    for shared in (small_skeleton.bones, small_skeleton.bone_lengths):  # kept, and handed out again and again
        with pytest.raises(ValueError, match="read-only"):
            shared *= 100
    with pytest.raises(AttributeError):
        small_skeleton.names = ()


def test_subset_keeps_the_rest_pose(small_skeleton):
    part = small_skeleton.subset([0, 4, 5, 1])
    assert part.names == ("root", "spine", "shin", "shin_end") and part.parents == (-1, 0, 0, 2)
    assert part.end_sites == {3} and part.orders == ("ZYX", "ZXY", "ZXY", "ZXY")
    assert np.allclose(part.rest_pose(), small_skeleton.rest_pose()[[0, 1, 4, 5]])
    with pytest.raises(MotionError, match="root"):
        small_skeleton.subset([1, 2])


@pytest.mark.parametrize(
    "changes, told",
    [
        ({"names": ("a", "a")}, "'a' stands twice"),
        ({"names": ("a",)}, "expected J, J, J"),
        ({"names": (), "parents": (), "offsets": np.zeros((0, 3)), "orders": ()}, "at least 1"),
        ({"parents": (0, 0)}, "expected parent -1"),
        ({"parents": (-1, 1)}, "earlier node"),
        ({"parents": (-1, -1)}, "earlier node"),
        ({"offsets": np.array([[0, 0, 0], [0, np.nan, 0]])}, "'b' is not finite"),
        ({"orders": ("ZXY", "ZZY")}, "Euler order 'ZZY'"),
        ({"end_sites": {0}}, "leaves"),
        ({"end_sites": {2}}, "leaves"),
    ],
)
def test_what_is_no_skeleton(changes, told):
    parts = {"names": ("a", "b"), "parents": (-1, 0), "offsets": np.zeros((2, 3)), "orders": ("ZXY", "ZXY")}
    with pytest.raises(ValueError, match=told) as caught:
        Skeleton(**(parts | changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bad", [{}, {"names": None}, {"offsets": "x"}, {"parents": ["x", "y"]}, {"orders": 3}])
def test_what_is_no_description(small_skeleton, bad):
    description = small_skeleton.to_dict() | bad if bad else {}
    with pytest.raises(MotionError):
        Skeleton.from_dict(description)


def test_a_long_chain():
    n = 3000
    chain = Skeleton(tuple(f"j{i}" for i in range(n)), tuple(range(-1, n - 1)), np.tile([0.0, 0.001, 0], (n, 1)))
    q = quat_from_axis_angle(np.array([0, 0, 1.0]), np.full(n, 2 * np.pi / n))
    end = chain.fk(q, np.zeros(3))[-1]
    assert np.abs(end).max() < 0.01  # once round a circle
