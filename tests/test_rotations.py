"""Rotations, against scipy and against values worked out by hand; never only by round trips."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from tutorial_lib.errors import TutorialError
from tutorial_lib.motion import rotations as R

RNG = np.random.default_rng(11)
Q = Rotation.random(200, random_state=3).as_quat()[:, [3, 0, 1, 2]]  # scipy puts w last
HALF = np.sqrt(0.5)


def scipy_of(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.asarray(q, dtype=np.float64)[..., [1, 2, 3, 0]].reshape(-1, 4))


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """The largest angle between two lists of rotations, by scipy."""
    return float((scipy_of(a).inv() * scipy_of(b)).magnitude().max())


def matrix_about(axis: str, angle: float) -> np.ndarray:
    """The textbook matrix of a turn about one axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array(
        {
            "X": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "Y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "Z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
    )


# -- goldens by hand -----------------------------------------------------------------------------------------


def test_a_quarter_turn_about_each_axis_by_hand():
    about_z = np.array([HALF, 0, 0, HALF])
    assert np.allclose(R.quat_rotate(about_z, np.array([1.0, 0, 0])), [0, 1, 0])
    about_x = np.array([HALF, HALF, 0, 0])
    assert np.allclose(R.quat_rotate(about_x, np.array([0, 1.0, 0])), [0, 0, 1])
    assert np.allclose(R.quat_about_y(np.pi / 2), [HALF, 0, HALF, 0])
    assert np.allclose(R.quat_rotate(R.quat_about_y(np.pi / 2), np.array([0, 0, 1.0])), [1, 0, 0])  # +z to +x
    assert np.allclose(R.quat_from_axis_angle(np.array([1.0, 0, 0]), np.pi / 2), about_x)
    # x first, then z: (0, 1, 0) -> (0, 0, 1) -> (0, 0, 1); z first, then x: (0, 1, 0) -> (-1, 0, 0) -> (-1, 0, 0)
    assert np.allclose(R.quat_rotate(R.quat_mul(about_z, about_x), np.array([0, 1.0, 0])), [0, 0, 1])
    assert np.allclose(R.quat_rotate(R.quat_mul(about_x, about_z), np.array([0, 1.0, 0])), [-1, 0, 0])


def test_euler_angles_multiply_from_the_left_as_in_bvh():
    a = np.radians([30.0, -50.0, 110.0])
    want = matrix_about("Z", a[0]) @ matrix_about("X", a[1]) @ matrix_about("Y", a[2])
    assert np.allclose(R.quat_to_matrix(R.euler_to_quat(a, "ZXY")), want, atol=1e-15)


def test_sixd_is_the_first_two_columns():
    m = matrix_about("Z", 0.3) @ matrix_about("X", 0.7)
    d = R.quat_to_sixd(R.matrix_to_quat(m))
    assert np.allclose(d, [m[0, 0], m[1, 0], m[2, 0], m[0, 1], m[1, 1], m[2, 1]])


# -- scipy ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", R.EULER_ORDERS)
def test_every_euler_order_agrees_with_scipy(order):
    angles = RNG.uniform(-np.pi, np.pi, (300, 3))
    want = Rotation.from_euler(order, angles)  # capital letters: intrinsic
    assert (scipy_of(R.euler_to_quat(angles, order)).inv() * want).magnitude().max() < 1e-12
    back = R.quat_to_euler(Q, order)
    assert np.allclose(back, scipy_of(Q).as_euler(order), atol=1e-9)


def test_products_matrices_vectors_agree_with_scipy():
    a, b = Q[:100], Q[100:]
    v = RNG.normal(size=(100, 3))
    assert angle_between(R.quat_mul(a, b), (scipy_of(a) * scipy_of(b)).as_quat()[:, [3, 0, 1, 2]]) < 1e-12
    assert np.allclose(R.quat_rotate(a, v), scipy_of(a).apply(v))
    assert np.allclose(R.quat_to_matrix(a), scipy_of(a).as_matrix())
    assert angle_between(R.matrix_to_quat(scipy_of(a).as_matrix()), a) < 1e-12
    assert np.allclose(R.quat_angle(a, b), (scipy_of(a).inv() * scipy_of(b)).magnitude())
    assert np.allclose(R.quat_mul(a, R.quat_inv(a)), [1, 0, 0, 0])


def test_matrix_to_quat_at_half_turns():
    axes = np.concatenate((np.eye(3), RNG.normal(size=(20, 3))))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for angle in (np.pi, np.pi - 1e-9, 0.0, 1e-9):
        want = Rotation.from_rotvec(axes * angle)
        got = R.matrix_to_quat(want.as_matrix())
        assert (scipy_of(got).inv() * want).magnitude().max() < 1e-7


def test_slerp_agrees_with_scipy_and_takes_the_shorter_arc():
    for a, b in zip(Q[:20], Q[20:40], strict=True):
        t = np.linspace(0, 1, 7)
        want = Slerp([0, 1], scipy_of(np.stack((a, b))))(t).as_quat()[:, [3, 0, 1, 2]]
        assert angle_between(R.quat_slerp(a[None], b[None], t[:, None]), want) < 1e-7
        assert angle_between(R.quat_slerp(a[None], -b[None], t[:, None]), want) < 1e-7
    assert np.allclose(R.quat_slerp(Q[0], Q[0], 0.5), Q[0])


def test_euler_at_gimbal_lock_gives_the_same_rotation_with_a_zero_last_angle():
    for order in R.EULER_ORDERS:
        for sign in (1, -1):
            angles = RNG.uniform(-3, 3, (50, 3))
            angles[:, 1] = sign * np.pi / 2
            q = R.euler_to_quat(angles, order)
            back = R.quat_to_euler(q, order)
            assert np.allclose(back[:, 1], sign * np.pi / 2, atol=1e-7)
            assert np.allclose(back[:, 2], 0, atol=1e-9)
            assert angle_between(R.euler_to_quat(back, order), q) < 1e-9


@pytest.mark.parametrize("dtype, within", [(np.float64, 1e-13), (np.float32, 1e-5)])
@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3])
def test_euler_near_gimbal_lock_in_either_precision(dtype, within, off):
    angles = RNG.uniform(-3, 3, (300, 3))
    angles[:, 1] = (np.pi / 2 - off) * np.sign(angles[:, 2])
    for order in ("ZXY", "XZY"):
        q = R.quat_normalize(R.euler_to_quat(angles.astype(dtype), order))
        back = R.quat_to_euler(q, order)
        assert back.dtype == dtype
        assert R.quat_angle(q, R.euler_to_quat(back, order)).max() < within


def test_euler_of_quaternions_of_any_length_and_sign():
    want = R.quat_to_euler(Q, "ZYX")
    assert np.allclose(R.quat_to_euler(-Q, "ZYX"), want, atol=1e-9)
    assert np.allclose(R.quat_to_euler(3.0 * Q, "ZYX"), want, atol=1e-9)
    assert (np.abs(want) <= np.array([np.pi, np.pi / 2, np.pi]) + 1e-12).all()


# -- edges ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype, within", [(np.float64, 1e-12), (np.float32, 2e-6)])
def test_quat_between_at_every_angle_also_opposite(dtype, within):
    u = RNG.normal(size=(200, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    side = np.cross(u, RNG.normal(size=(200, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    for angle in [0, 1e-8, 1e-3, 1, 2, np.pi - 1e-2, *(np.pi - 10.0 ** -np.arange(3, 18)), np.pi]:
        v = np.cos(angle) * u + np.sin(angle) * side
        q = R.quat_between(u.astype(dtype), v.astype(dtype))
        assert np.abs(R.quat_rotate(q, u.astype(dtype)) - v).max() < within
        assert np.allclose(R.quat_angle(q, np.array([1, 0, 0, 0], dtype)), angle, atol=3e-4)  # the smallest turn
        axis_along_u = np.abs((q[:, 1:] * u).sum(1)).max()
        assert axis_along_u < 20 * within  # no twist


def test_quat_between_exactly_opposite_axes():
    for dtype in (np.float32, np.float64):
        for axis in np.eye(3, dtype=dtype):
            assert np.allclose(R.quat_rotate(R.quat_between(axis, -axis), axis), -axis, atol=1e-6)


def test_zero_vectors_and_quaternions_give_no_rotation():
    none = [1.0, 0, 0, 0]
    assert np.array_equal(R.quat_between(np.zeros(3), np.array([1.0, 0, 0])), none)
    assert np.array_equal(R.quat_between(np.array([1.0, 0, 0]), np.zeros(3)), none)
    assert np.array_equal(R.quat_normalize(np.zeros((2, 4))), [none, none])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_degenerate_sixd_is_still_a_rotation(dtype):
    x = RNG.normal(size=(50, 3))
    cases = [
        np.zeros((1, 6)),
        np.concatenate((x, x), 1),
        np.concatenate((x, -3 * x), 1),
        np.concatenate((x, 0 * x), 1),
        np.concatenate((0 * x, x), 1),
        np.concatenate((np.eye(3), np.eye(3)), 1),
    ]
    for d in cases:
        q = R.sixd_to_quat(d.astype(dtype))
        assert np.allclose(np.linalg.norm(q, axis=-1), 1, atol=1e-6)


def test_sixd_of_a_skewed_pair_is_gram_schmidt():
    q = R.sixd_to_quat(np.array([2.0, 0, 0, 5, 3, 0]))  # x along x; what is left of the second is along y
    assert np.allclose(q, [1, 0, 0, 0])
    assert angle_between(R.sixd_to_quat(4.0 * R.quat_to_sixd(Q)), Q) < 1e-12


def test_signs_follow_in_time():
    turn = R.quat_from_axis_angle(np.array([0, 0, 1.0]), np.linspace(0, 12, 100))[:, None]
    flipped = turn * np.where(RNG.random((100, 1, 1)) < 0.5, -1, 1)
    smooth = R.quat_continuous(flipped)
    assert (smooth[1:] * smooth[:-1]).sum(-1).min() > 0.99
    assert np.array_equal(smooth[0], flipped[0])
    assert angle_between(smooth, turn) < 1e-7
    batch = R.quat_continuous(np.stack((flipped, flipped[::-1])))
    assert np.array_equal(batch[0], smooth)


def test_unknown_order_is_told_in_one_line():
    for order in ("XYX", "zxy", "XY", "ABC", ""):
        with pytest.raises(TutorialError, match="expected one of XYZ"):
            R.euler_to_quat(np.zeros(3), order)


# -- numpy and torch -----------------------------------------------------------------------------------------

V = RNG.normal(size=(200, 3))
CALLS = {
    "mul": (R.quat_mul, Q, Q[::-1].copy()),
    "inv": (R.quat_inv, Q),
    "normalize": (R.quat_normalize, 2 * Q),
    "rotate": (R.quat_rotate, Q, V),
    "between": (R.quat_between, V, V[::-1].copy()),
    "axis_angle": (R.quat_from_axis_angle, V / np.linalg.norm(V, axis=1, keepdims=True), V[:, 0].copy()),
    "about_y": (R.quat_about_y, V[:, 0].copy()),
    "angle": (R.quat_angle, Q, Q[::-1].copy()),
    "continuous": (R.quat_continuous, Q.reshape(50, 4, 4)),
    "slerp": (R.quat_slerp, Q, Q[::-1].copy(), V[:, :1].copy()),
    "to_matrix": (R.quat_to_matrix, Q),
    "from_matrix": (R.matrix_to_quat, scipy_of(Q).as_matrix()),
    "to_sixd": (R.quat_to_sixd, Q),
    "from_sixd": (R.sixd_to_quat, np.concatenate((V, V[::-1]), 1)),
    "to_euler": (lambda q: R.quat_to_euler(q, "ZXY"), Q),
    "from_euler": (lambda a: R.euler_to_quat(a, "ZXY"), V),
}


@pytest.mark.parametrize("name", CALLS)
def test_numpy_and_torch_give_the_same(name):
    function, *arrays = CALLS[name]
    want = function(*arrays)
    assert isinstance(want, np.ndarray) and want.dtype == np.float64
    got = function(*(torch.from_numpy(a) for a in arrays))
    assert isinstance(got, torch.Tensor) and np.array_equal(got.numpy(), want)
    single = function(*(a.astype(np.float32) for a in arrays))
    assert single.dtype == np.float32 and np.abs(single - want).max() < 2e-4


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CALLS)
def test_read_only_and_reversed_arrays_and_leading_axes(name):
    function, *arrays = CALLS[name]
    want = function(*arrays)
    reversed_twice = [a[::-1].copy()[::-1] for a in arrays]
    for a in reversed_twice:
        a.setflags(write=False)
    assert np.array_equal(function(*reversed_twice), want)
    deep = function(*(np.stack((a, a))[None] for a in arrays))
    assert deep.shape == (1, 2, *want.shape) and np.array_equal(deep[0, 1], want)


EDGES = {
    "equal": Q[:1],
    "none": np.array([[1.0, 0, 0, 0]]),
    "zero": np.zeros((1, 4)),
    "half turn": np.array([[0.0, 1, 0, 0]]),
    "gimbal lock": R.euler_to_quat(np.array([[0.4, np.pi / 2, 0.1], [0.4, -np.pi / 2, 0.1]]), "ZXY"),
}


@pytest.mark.parametrize("edge", EDGES)
def test_gradients_are_finite_at_the_edges(edge):
    q = EDGES[edge]
    functions = {
        "normalize": R.quat_normalize,
        "euler": lambda x: R.quat_to_euler(x, "ZXY"),
        "sixd": lambda x: R.sixd_to_quat(torch.cat((x[..., 1:], x[..., 1:]), -1)),
        "slerp": lambda x: R.quat_slerp(x, x.detach(), 0.5),
        "slerp opposite": lambda x: R.quat_slerp(x, -x.detach(), 0.3),
        "angle": lambda x: R.quat_angle(x, x.detach()),
        "between equal": lambda x: R.quat_between(x[..., 1:], x.detach()[..., 1:]),
        "between opposite": lambda x: R.quat_between(x[..., 1:], -x.detach()[..., 1:]),
        "matrix": lambda x: R.matrix_to_quat(R.quat_to_matrix(x)),
    }
    for name, function in functions.items():
        for dtype in (torch.float32, torch.float64):
            x = torch.tensor(q, dtype=dtype, requires_grad=True)
            y = function(x)
            y.sum().backward()
            assert torch.isfinite(y).all() and torch.isfinite(x.grad).all(), name


def test_gradients_agree_with_differences():
    q = torch.tensor(Q[:5], requires_grad=True)
    v = torch.tensor(V[:5], requires_grad=True)
    for function in (R.quat_rotate, R.quat_mul):
        other = v if function is R.quat_rotate else torch.tensor(Q[5:10], requires_grad=True)
        assert torch.autograd.gradcheck(function, (q, other))
    for function in (lambda x: R.quat_to_euler(x, "XZY"), R.quat_to_sixd, R.quat_normalize):
        assert torch.autograd.gradcheck(function, (q,))
    assert torch.autograd.gradcheck(R.quat_between, (v, torch.tensor(V[5:10], requires_grad=True)))
    assert torch.autograd.gradcheck(lambda x: R.quat_slerp(x, torch.tensor(Q[5:10]), 0.3), (q,))
    assert torch.autograd.gradcheck(
        R.sixd_to_quat, (torch.tensor(np.concatenate((V[:5], V[5:10]), 1)).requires_grad_(),)
    )
