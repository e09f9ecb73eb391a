"""BVH files, against numbers by hand, matrices and pybvh."""

from __future__ import annotations

import warnings

import numpy as np
import pybvh
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tutorial_lib.errors import MotionError, MotionFileError
from tutorial_lib.motion import Motion, Skeleton, read_bvh, read_motion, write_bvh
from tutorial_lib.motion.files import file_info
from tutorial_lib.motion.rotations import EULER_ORDERS, quat_angle, quat_normalize
from tutorial_lib.motion.skeletons import KNOWN_SKELETONS, recognise

ARM = """HIERARCHY
ROOT hip
{
	OFFSET 0 0 0
	CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
	JOINT arm
	{
		OFFSET 10 0 0
		CHANNELS 3 Zrotation Xrotation Yrotation
		End Site
		{
			OFFSET 0 20 0
		}
	}
}
MOTION
Frames: 2
Frame Time: 0.0083333
1 2 3 0 0 0 0 0 0
1 2 3 90 0 0 0 90 0
"""
# frame 2 by hand: the arm lies along x, turned to y: (1, 2 + 10, 3). The end lies along the arm's y; the arm's own
# quarter turn about its x takes that to its z, and the hip's turn about z leaves it there: (1, 12, 3 + 20).
ARM_AT = np.array([[[1, 2, 3], [11, 2, 3], [11, 22, 3]], [[1, 2, 3], [1, 12, 3], [1, 12, 23]]])


def read(tmp_path, text: str | bytes, name: str = "clip.bvh", **options) -> Motion:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_bvh(path, **({"unit": "m", "up": "y"} | options))


def by_pybvh(path) -> tuple[list[str], np.ndarray]:
    """pybvh's node names and world positions, in the file's unit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        clip = pybvh.read_bvh_file(path)
        return [node.name for node in clip.nodes], clip.node_positions()


# -- reading -------------------------------------------------------------------------------------------------


def test_an_arm_by_hand(tmp_path):
    m = read(tmp_path, ARM)
    assert m.skeleton.names == ("hip", "arm", "arm_end") and m.skeleton.parents == (-1, 0, 1)
    assert m.skeleton.end_sites == {2} and m.fps == 120 and m.name == "clip"
    assert np.allclose(m.positions, ARM_AT)
    without = read(tmp_path, ARM, end_sites=False)
    assert without.skeleton.names == ("hip", "arm") and np.allclose(without.positions, ARM_AT[:, :2])
    assert np.allclose(read(tmp_path, ARM, unit="mm").positions, ARM_AT / 1000)
    assert np.allclose(read(tmp_path, ARM, unit="in").positions, ARM_AT * 0.0254)


SAME = {
    "CRLF": ARM.replace("\n", "\r\n"),
    "CR": ARM.replace("\n", "\r"),
    "mixed line ends": ARM.replace("\n", "\r\n", 5),
    "byte order mark": "\ufeff" + ARM,
    "tabs between numbers": ARM.replace("1 2 3 90 0 0 0 90 0", "\t1\t2\t3\t90\t0 \t 0\t0\t90\t0\t"),
    "blank lines": ARM.replace("\n", "\n\n \t\n"),
    "lower case": ARM.lower().replace("zrot", "zRot"),
    "upper case": ARM.upper().replace("HIP", "hip").replace("ARM", "arm"),
    "braces on the joint's line": ARM.replace("hip\n{", "hip {").replace("arm\n\t{", "arm{").replace("Site\n", "Site "),
    "closing braces together": ARM.replace("20 0\n\t\t}\n\t}\n}", "20 0 }}}"),
    "HIERARCHY on the root's line": ARM.replace("HIERARCHY\n", "HIERARCHY "),
    "scientific": ARM.replace("10 0 0\n", "1.0e+01 0E0 -0.0e-5\n").replace(" 90 0 0 0", " 9.e1 0 .0 +0"),
    "no newline at the end": ARM.rstrip("\n"),
    "spaces around colons": ARM.replace("Frames: 2", "FRAMES : 2").replace("Frame Time:", "frame  time :"),
    "no space after colons": ARM.replace("Frames: 2", "Frames:2").replace("Time: ", "Time:\t"),
    "trailing blank lines": ARM + "\n\n   \n",
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", SAME)
def test_the_same_in_another_spelling(tmp_path, name):
    m = read(tmp_path, SAME[name])
    assert m.skeleton.names == ("hip", "arm", "arm_end") and m.fps == 120
    assert np.allclose(m.positions, ARM_AT)


def test_names_of_all_kinds(tmp_path):
    for name in ("upper  arm of  him", "mixamorig:Arm", "arm.001", "Überarm", "腕", "OFFSET", "MOTION", "End"):
        m = read(tmp_path, ARM.replace("arm", name))
        assert m.skeleton.names[1] == " ".join(name.split())
    latin = read(tmp_path, ARM.replace("arm", "Überarm").encode("latin-1"), "Ümläut datei.bvh")
    assert latin.skeleton.names[1] == "Überarm" and latin.name == "Ümläut datei"


def test_an_end_sites_name_gives_way_to_a_joints(tmp_path):
    text = ARM.replace(
        "\t\tEnd Site", "\t\tEnd Site\n{ OFFSET 0 1 0 }\nJOINT arm_end\n{ OFFSET 0 0 1 CHANNELS 0 }\nEnd Site"
    )
    text = text.replace("OFFSET 0 0 1 CHANNELS 0", "OFFSET 0 0 1\nCHANNELS 0\n")
    m = read(tmp_path, text)
    assert m.skeleton.names == ("hip", "arm", "arm_end_", "arm_end", "arm_end__")


@pytest.mark.parametrize("order", EULER_ORDERS)
def test_channels_in_any_order(tmp_path, order):
    """Each joint's own order of rotations, positions before, after or between them: against scipy's matrices."""
    rng = np.random.default_rng(4)
    root_channels = ["Yposition", f"{order[0]}rotation", "Zposition", f"{order[1]}rotation", f"{order[2]}rotation"]
    root_channels.append("Xposition")
    values = rng.uniform(-180, 180, (5, 9))
    arm_order = order[::-1]
    text = ARM.split("MOTION")[0]
    text = text.replace("Xposition Yposition Zposition Zrotation Xrotation Yrotation", " ".join(root_channels))
    text = text.replace("3 Zrotation Xrotation Yrotation", "3 " + " ".join(f"{a}rotation" for a in arm_order))
    rows = "\n".join(" ".join(map(repr, map(float, row))) for row in values)
    m = read(tmp_path, f"{text}MOTION\nFrames: 5\nFrame Time: 0.04\n{rows}\n")
    assert m.fps == 25 and m.skeleton.orders[:2] == (order, arm_order)
    root = values[:, [5, 0, 2]]
    hip = Rotation.from_euler(order, values[:, [1, 3, 4]], degrees=True).as_matrix()
    arm = Rotation.from_euler(arm_order, values[:, 6:], degrees=True).as_matrix()
    elbow = root + hip @ [10, 0, 0]
    end = elbow + (hip @ arm) @ [0, 20, 0]
    assert np.allclose(m.positions, np.stack((root, elbow, end), 1), atol=1e-9)


def test_position_channels_on_any_joint(tmp_path):
    text = ARM.replace("3 Zrotation Xrotation Yrotation", "5 Zposition Xposition Zrotation Xrotation Yrotation")
    text = text.replace("90 0 0 0 90 0", "90 0 0  7 4  0 90 0").replace("1 2 3 0 0 0 0 0 0", "1 2 3 0 0 0 7 4 0 0 0")
    m = read(tmp_path, text)
    # the arm's place in the hip's frame is (4, its OFFSET's 0, 7); frame 2 turns that about z
    assert np.allclose(m.positions[:, 1], [[5, 2, 10], [1, 6, 10]])
    assert np.allclose(m.skeleton.offsets[1], [10, 0, 0])


@pytest.mark.parametrize("channels, order", [("1 Yrotation", "Y"), ("2 Xrotation Zrotation", "XZ"), ("0", "")])
def test_fewer_than_three_rotations(tmp_path, channels, order):
    values = [30.0, -40.0][: len(order)]
    text = ARM.replace("3 Zrotation Xrotation Yrotation", channels)
    head = text.split("MOTION")[0]
    m = read(tmp_path, f"{head}MOTION\nFrames: 1\nFrame Time: 1\n0 0 0 0 0 0 {' '.join(map(str, values))}\n")
    turn = Rotation.from_euler(order, values, degrees=True).as_matrix().reshape(3, 3) if order else np.eye(3)
    assert np.allclose(m.positions[0, 2], [10, 0, 0] + turn @ [0, 20, 0])
    assert m.skeleton.orders[1][: len(order)] == order


def test_a_root_without_position_channels_stays_at_its_offset(tmp_path):
    text = (
        ARM.replace("6 Xposition Yposition Zposition", "3")
        .replace("1 2 3 ", "")
        .replace("OFFSET 0 0 0", "OFFSET 1 2 3")
    )
    assert np.allclose(read(tmp_path, text).positions, ARM_AT)


@pytest.mark.parametrize(
    "frame_time, fps",
    [
        ("0.00833333", 120),
        ("0.008333", 120),
        ("0.0333333", 30),
        ("0.033333", 30),
        ("0.01667", 60),
        ("0.0333667", 1 / 0.0333667),  # 29.97: television's rate is no misprint
        ("0.03", 1 / 0.03),
        ("1", 1),
        ("2.5", 0.4),
    ],
)
def test_frame_rates(tmp_path, frame_time, fps):
    assert read(tmp_path, ARM.replace("0.0083333", frame_time)).fps == fps


# -- what a file does not tell -------------------------------------------------------------------------------

BODY = {  # metres, y up, facing z: a figure of 1.7 m with every common joint
    "Hips": (0, 0.95, 0), "Spine": (0, 0.1, 0), "Chest": (0, 0.2, 0), "Neck": (0, 0.25, 0), "Head": (0, 0.1, 0),
    "LeftShoulder": (0.05, 0.2, 0), "LeftArm": (0.12, 0, 0), "LeftForeArm": (0.28, 0, 0), "LeftHand": (0.25, 0, 0),
    "RightShoulder": (-0.05, 0.2, 0), "RightArm": (-0.12, 0, 0), "RightForeArm": (-0.28, 0, 0),
    "RightHand": (-0.25, 0, 0),
    "LeftUpLeg": (0.1, -0.05, 0), "LeftLeg": (0, -0.42, 0), "LeftFoot": (0, -0.4, 0), "LeftToe": (0, -0.06, 0.14),
    "RightUpLeg": (-0.1, -0.05, 0), "RightLeg": (0, -0.42, 0), "RightFoot": (0, -0.4, 0), "RightToe": (0, -0.06, 0.14),
}  # fmt: skip


def body_text(per_metre: float, z_up: bool, prefix: str = "") -> str:
    parents = {j: p for j, p in zip(KNOWN_SKELETONS["common"], common_parents(), strict=True)}
    lines = ["HIERARCHY"]

    def node(name, depth):
        x, y, z = np.array(BODY[name]) * per_metre
        x, y, z = (x, -z, y) if z_up else (x, y, z)
        lines.append(f"{'JOINT' if depth else 'ROOT'} {prefix}{name}\n{{\nOFFSET {x} {y} {z}")
        lines.append("CHANNELS 3 Zrotation Xrotation Yrotation")
        children = [c for c, p in parents.items() if p == name]
        for child in children:
            node(child, depth + 1)
        if not children:
            lines.append("End Site\n{\nOFFSET 0 0 0\n}")
        lines.append("}")

    node("Hips", 0)
    return "\n".join(lines) + f"\nMOTION\nFrames: 1\nFrame Time: 0.04\n{'0 ' * 63}\n"


def common_parents() -> list[str | None]:
    from tutorial_lib.motion.skeletons import COMMON_PARENTS

    return list(COMMON_PARENTS.values())


@pytest.mark.parametrize("prefix", ["", "mixamorig:"])  # a skeleton that is known, one that is not
@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("unit, per_metre", [("m", 1), ("cm", 100), ("mm", 1000), ("in", 1 / 0.0254)])
def test_unit_and_up_axis_are_guessed_from_the_body(tmp_path, capsys, unit, per_metre, up, prefix):
    text = body_text(per_metre, up == "z", prefix)
    m = read(tmp_path, text, unit=None, up=None)
    said = capsys.readouterr().out
    assert said.count("\n") == 1 and f"unit {unit!r}, up axis {up!r}" in said and "clip.bvh" in said
    head, foot, toe = (m.positions[0, m.skeleton.index(prefix + n)] for n in ("Head", "LeftFoot", "LeftToe"))
    assert head[1] == pytest.approx(1.6, abs=0.01) and foot[1] == pytest.approx(0.08, abs=0.01)
    assert toe[2] - foot[2] == pytest.approx(0.14)  # faces +z either way
    assert np.allclose(m.skeleton.fk(m.rotations, m.positions[:, 0]), m.positions)
    read(tmp_path, text, unit=None, up=None, quiet=True)
    read(tmp_path, text, unit=unit, up=up)
    assert capsys.readouterr().out == ""
    info = "\n".join(file_info(tmp_path / "clip.bvh").lines())
    assert f"{unit} (guessed" in info and f"{up} (guessed" in info and "25 frames per second" in info


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("names", [
    {"Foot": "Ankle", "UpLeg": "Hip", "Leg": "Knee"},  # Biovision's
    {"Foot": "End", "UpLeg": "Hip", "Leg": "Shin"},  # toes alone
    {"Foot": "End", "Toe": "Tip", "UpLeg": "Hip", "Leg": "Knee"},
    {"Foot": "End", "Toe": "Tip"},  # legs alone
])  # fmt: skip
def test_which_end_is_up_is_seen_from_any_joint_below(tmp_path, names, up):
    text = body_text(100, up == "z")
    for old, new in names.items():
        text = text.replace(old, new)
    m = read(tmp_path, text, unit=None, up=None, quiet=True)
    assert recognise(m.skeleton) is None
    assert m.positions[0, m.skeleton.index("Head"), 1] == pytest.approx(1.6, abs=0.01)
    assert f"  up axis    {up} (guessed from the body's pose)" in file_info(tmp_path / "clip.bvh").lines()


def test_an_up_axis_that_was_not_guessed_is_not_said_to_be(tmp_path, capsys):
    read(tmp_path, body_text(100, False).replace("Head", "Top"), unit=None, up=None)
    assert "unit 'cm', up axis 'y' (guessed from the body, y taken as usual)" in capsys.readouterr().out
    lines = file_info(tmp_path / "clip.bvh").lines()
    assert "  up axis    y (not told by the file, taken as usual)" in lines
    read(tmp_path, ARM, up=None)
    assert capsys.readouterr().out == "clip.bvh: read as unit 'm', up axis 'y' (y taken as usual)\n"
    assert "  up axis    z" in file_info(tmp_path / "clip.bvh", up="z").lines()


def test_z_up_rotations_turn_with_the_world(tmp_path):
    """(x, y, z) with z up is (x, z, -y) with y up: for every frame of a moving arm."""
    m = read(tmp_path, ARM, up="z")
    x, y, z = np.moveaxis(ARM_AT, -1, 0)
    assert np.allclose(m.positions, np.stack((x, z, -y), -1))
    assert np.allclose(m.skeleton.fk(m.rotations, m.positions[:, 0]), m.positions)


@pytest.mark.filterwarnings("error")
def test_a_body_without_size_has_some_unit(tmp_path):
    text = ARM.replace("OFFSET 10 0 0", "OFFSET 0 0 0").replace("OFFSET 0 20 0", "OFFSET 0 0 1e-300")
    assert len(read(tmp_path, text, unit=None, up=None, quiet=True)) == 2


def test_options_that_are_none_of_the_known(tmp_path):
    for options in ({"unit": "parsec"}, {"up": "x"}):
        with pytest.raises(MotionError, match="expected"):
            read(tmp_path, ARM, **options)
    assert np.allclose(read_motion(tmp_path / "clip.bvh", unit="m", up="y", quiet=True).positions, ARM_AT)


# -- writing -------------------------------------------------------------------------------------------------


def on(skeleton: Skeleton, motion: Motion) -> np.ndarray:
    """``motion``'s positions at the nodes of ``skeleton``, by name."""
    return motion.positions[:, [motion.skeleton.index(name) for name in skeleton.names]]


def test_written_from_rotations_it_reads_back_and_pybvh_agrees(tmp_path, small_motion):
    path = tmp_path / "deep" / "folder" / "out.bvh"
    write_bvh(small_motion, path)
    m = read_bvh(path, unit="cm", up="y")
    assert m.skeleton.names == small_motion.skeleton.names and m.skeleton.orders == small_motion.skeleton.orders
    assert m.skeleton.end_sites == small_motion.skeleton.end_sites and m.fps == small_motion.fps
    assert np.abs(m.positions - small_motion.positions).max() < 1e-7
    assert quat_angle(m.rotations, small_motion.rotations).max() < 1e-7
    names, positions = by_pybvh(path)
    assert len(names) == 7 and np.abs(positions / 100 - small_motion.positions).max() < 1e-7
    text = path.read_text()
    assert "CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation" in text
    assert (
        "CHANNELS 3 Xrotation Yrotation Zrotation" in text and text.count("position") == 3 and "-0.000000 " not in text
    )


def test_writing_what_the_file_said(tmp_path):
    """The numbers of the arm again: writing is not only the inverse of reading."""
    write_bvh(read(tmp_path, ARM), tmp_path / "out.bvh", unit="m", decimals=3)
    lines = (tmp_path / "out.bvh").read_text().splitlines()
    assert lines[-1] == "1.000 2.000 3.000 90.000 0.000 0.000 0.000 90.000 0.000"
    assert lines[-3] == "Frame Time: 0.008333333333" and "\t\tOFFSET 10.000 0.000 0.000" in lines


def test_bones_that_move_get_position_channels(tmp_path, small_motion):
    t = small_motion.translations()
    t[:, 4, 1] += np.linspace(0, 0.3, len(t))
    m = Motion.from_rotations(small_motion.skeleton, 30, small_motion.positions[:, 0], small_motion.rotations, t)
    write_bvh(m, tmp_path / "x.bvh")
    back = read_bvh(tmp_path / "x.bvh", unit="cm", up="y")
    assert (tmp_path / "x.bvh").read_text().count("CHANNELS 6") == 2
    assert np.abs(back.positions - m.positions).max() < 1e-7


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_written_from_positions_alone(tmp_path, small_motion, noise):
    shape = small_motion.positions.shape
    positions = small_motion.positions + np.random.default_rng(3).normal(scale=noise, size=shape)
    m = Motion(small_motion.skeleton, 30, positions)
    write_bvh(m, tmp_path / "p.bvh")
    back = read_bvh(tmp_path / "p.bvh", unit="cm", up="y")
    assert back.skeleton.names == m.skeleton.names
    error = np.abs(back.positions - positions)
    assert error[:, list(m.skeleton.joints)].max() < 1e-4  # every joint where it was given
    assert error.max() < (1e-4 if noise == 0 else 0.1)  # an end site cannot move in a BVH file


def test_positions_alone_without_end_sites_open_elsewhere(tmp_path, small_motion):
    bare = small_motion.without_end_sites()
    m = Motion(bare.skeleton, 30, bare.positions)
    write_bvh(m, tmp_path / "p.bvh")
    _, positions = by_pybvh(tmp_path / "p.bvh")
    assert positions.shape[1] == 6  # four joints, and an end site for each of the two last ones
    back = read_bvh(tmp_path / "p.bvh", unit="cm", up="y", end_sites=False)
    assert back.skeleton.names == bare.skeleton.names
    assert np.abs(back.positions - m.positions).max() < 1e-4


def test_a_write_that_fails_leaves_the_old_file(tmp_path, small_motion, monkeypatch):
    path = tmp_path / "x.bvh"
    path.write_text("old")

    def fail(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savetxt", fail)
    with pytest.raises(MotionError, match=r"x.bvh: cannot be written \(No space left on device\)"):
        write_bvh(small_motion, path)
    assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["x.bvh"]


def test_where_nothing_can_be_written(tmp_path, small_motion):
    (tmp_path / "folder.bvh").mkdir()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "folder.bvh", tmp_path / "file" / "x.bvh"):
        with pytest.raises(MotionError, match="cannot be written") as caught:
            write_bvh(small_motion, path)
        assert "\n" not in str(caught.value)
    with pytest.raises(MotionError, match="unit 'furlong'"):
        write_bvh(small_motion, tmp_path / "x.bvh", unit="furlong")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.bvh"]


def test_names_that_no_file_can_hold(tmp_path):
    names = ("a\nb", "a b", "{x}", "", "\x00", "Überarm", " ")
    s = Skeleton(names, (-1, 0, 1, 2, 3, 4, 5), np.ones((7, 3)))
    q = np.tile([1.0, 0, 0, 0], (2, 7, 1))
    write_bvh(Motion.from_rotations(s, 30, np.zeros((2, 3)), q), tmp_path / "n.bvh")
    m = read_bvh(tmp_path / "n.bvh", unit="cm", up="y", end_sites=False)
    assert m.skeleton.names == ("a b", "a b_", "(x)", "joint", "_", "Überarm", "joint_")


def test_a_chain_longer_than_pythons_stack(tmp_path):
    n = 1500
    s = Skeleton(tuple(f"j{i}" for i in range(n)), tuple(range(-1, n - 1)), np.tile([0.0, 0.01, 0], (n, 1)))
    q = np.tile([1.0, 0, 0, 0], (1, n, 1))
    write_bvh(Motion.from_rotations(s, 30, np.zeros((1, 3)), q), tmp_path / "long.bvh")
    assert read_bvh(tmp_path / "long.bvh", unit="cm", up="y", end_sites=False).positions[0, -1, 1] == pytest.approx(
        14.99
    )


# -- any skeleton, any motion --------------------------------------------------------------------------------

NAMES = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Z"), exclude_characters="{}"), min_size=1, max_size=6
)


@st.composite
def motions(draw) -> Motion:
    n = draw(st.integers(1, 8))
    parents = [-1] + [draw(st.integers(0, j - 1)) for j in range(1, n)]
    leaves = [j for j in range(1, n) if j not in parents]
    ends = draw(st.sets(st.sampled_from(leaves))) if leaves else set()
    names = draw(st.lists(NAMES, min_size=n, max_size=n, unique=True))
    orders = [draw(st.sampled_from(EULER_ORDERS)) for _ in range(n)]
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    frames = draw(st.integers(1, 5))
    lock = draw(st.booleans())
    q = quat_normalize(rng.normal(size=(frames, n, 4)))
    if lock:
        q = np.round(q)  # quarter and half turns: gimbal lock everywhere
    q = quat_normalize(q)
    q[:, sorted(ends)] = [1, 0, 0, 0]
    t = None
    skeleton = Skeleton(tuple(names), tuple(parents), rng.normal(size=(n, 3)), tuple(orders), frozenset(ends))
    if draw(st.booleans()):
        t = np.tile(skeleton.offsets, (frames, 1, 1))
        moving = [j for j in range(n) if j not in ends]
        t[:, moving] += rng.normal(size=(frames, len(moving), 3))
    fps = draw(st.sampled_from([24, 30, 60, 120, 30 / 1.001, 12.5]))
    return Motion.from_rotations(skeleton, fps, rng.normal(scale=3, size=(frames, 3)), q, t)


def depth_first(skeleton: Skeleton) -> list[int]:
    """Nodes in the order in which a file has them."""
    order, todo = [], [0]
    while todo:
        j = todo.pop()
        order.append(j)
        todo += reversed(skeleton.children[j])
    return order


@settings(max_examples=120, deadline=None, derandomize=True)
@given(motion=motions())
def test_any_motion_survives_its_file(tmp_path_factory, motion):
    path = tmp_path_factory.mktemp("any") / "x.bvh"
    write_bvh(motion, path)
    back = read_bvh(path, unit="cm", up="y")
    order = depth_first(motion.skeleton)
    # nodes by place, for ends are renamed after their joint; the file's own new ends have length zero
    new = [j for j in back.skeleton.end_sites if not back.skeleton.offsets[j].any()]
    kept = [j for j in range(back.skeleton.n_joints) if j not in new]
    assert len(kept) == motion.skeleton.n_joints
    assert np.abs(back.positions[:, kept] - motion.positions[:, order]).max() < 5e-7
    assert quat_angle(back.rotations[:, kept], motion.rotations[:, order]).max() < 1e-6
    assert back.fps == pytest.approx(motion.fps, rel=1e-8)
    for j, k in zip(order, kept, strict=True):
        if j not in motion.skeleton.end_sites:
            assert back.skeleton.names[k] == motion.skeleton.names[j]
            assert back.skeleton.orders[k] == motion.skeleton.orders[j]
    if path.read_text(encoding="utf-8").count("CHANNELS 6") == 1:  # pybvh refuses position channels below the root
        _, positions = by_pybvh(path)
        assert np.abs(positions / 100 - back.positions).max() < 1e-6


def test_reading_is_for_bvh_and_amc_alone(tmp_path):
    for name in ("x.fbx", "x.bvh.gz", "x", "x.txt"):
        (tmp_path / name).write_text(ARM)
        with pytest.raises(MotionFileError, match="expected one of .bvh, .amc"):
            read_motion(tmp_path / name)
    (tmp_path / "X.BVH").write_text(ARM)
    assert len(read_motion(tmp_path / "X.BVH")) == 2
