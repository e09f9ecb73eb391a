"""ASF/AMC files, against a calculation of their definition with plain matrices, and against the same clip as BVH."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tutorial_lib.motion import COMMON_JOINTS, Motion, read_amc, read_asf, read_bvh, read_motion, to_common, write_bvh
from tutorial_lib.motion.files import file_info

INCH = 0.0254
ASF = """:version 1.10
:name test
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name upper
    direction 0 1 0
    length 9.0
    axis 30 -20 50 XYZ   # a comment
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-inf inf)
  end
  begin
    id 2
    name lower
    direction 3 0 4
    length 4.5
    axis 10 20 -40 XYZ
    dof rx rz
    limits (-1 2) (-3 4)
  end
  begin
    id 3
    name tip
    direction 0 0 -1
    length 1.8
    axis 0 0 90 XYZ
  end
:hierarchy
  begin
    root upper
    upper lower
    lower tip
  end
"""
AMC = """# made for a test
:FULLY-SPECIFIED
:DEGREES
1
root 0 0 0 0 0 0
upper 0 0 0
lower 0 0
2
root 1 2 4 10 -20 130
upper 35 67 -81
lower 8 -75
"""


def pair(tmp_path, asf: str = ASF, amc: str = AMC):
    (tmp_path / "01.asf").write_text(asf)
    (tmp_path / "01_01.amc").write_text(amc)
    return tmp_path / "01_01.amc"


# -- the definition, once more, in plain numpy ---------------------------------------------------------------


def matrix(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array(
        {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
    )


def about(axes: str, degrees) -> np.ndarray:
    """Turns about fixed axes, the first listed first: its matrix stands rightmost."""
    m = np.eye(3)
    for axis, angle in zip(axes, degrees, strict=True):
        m = matrix(axis, angle) @ m
    return m


def by_definition(asf: str, amc: str) -> dict[str, np.ndarray]:
    """Where each bone starts, ``(T, 3)`` metres, and the last ones end; for files of degrees and order XYZ."""
    scale = INCH / float(re.search(r"length\s+(\S+)\s+angle", asf)[1])
    bones = {}
    for block in re.findall(r"begin\s+id(.*?)\n\s*end", asf, re.S):
        name = re.search(r"name\s+(\S+)", block)[1]
        direction = np.array(re.search(r"direction\s+(\S+)\s+(\S+)\s+(\S+)", block).groups(), float)
        length = float(re.search(r"length\s+(\S+)", block)[1]) * scale
        axis = about("xyz", np.array(re.search(r"axis\s+(\S+)\s+(\S+)\s+(\S+)\s+XYZ", block).groups(), float))
        dof = re.search(r"dof((?:\s+r[xyz])+)", block)
        bones[name] = (direction / np.linalg.norm(direction) * length, axis, dof[1].split() if dof else [])
    tree = [line.split() for line in asf.split(":hierarchy")[1].splitlines() if line.split()[1:]]
    order = re.search(r"order\s+((?:[TR][XYZ]\s+)+)", asf)[1].lower().split()

    frames, places = [], {}
    for line in amc.splitlines():
        words = line.split()
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif frames and words:
            frames[-1][words[0]] = np.array(words[1:], float)
    for frame in frames:
        values = dict(zip(order, frame["root"], strict=True))
        turning = [d[1] for d in order if d[0] == "r"]
        ends = {"root": np.array([values.get(f"t{a}", 0.0) for a in "xyz"]) * scale}
        turns = {"root": about("".join(turning), [values[f"r{a}"] for a in turning])}
        places.setdefault("root", []).append(ends["root"])
        for parent, *children in tree:
            for child in children:
                vector, c, dof = bones[child]
                m = about("".join(d[1] for d in dof), frame.get(child, []))
                turns[child] = turns[parent] @ c @ m @ np.linalg.inv(c)
                ends[child] = ends[parent] + turns[child] @ vector
                places.setdefault(child, []).append(ends[parent])
                places.setdefault(child + "_end", []).append(ends[child])
    return {name: np.array(p) for name, p in places.items()}


def agrees(motion: Motion, want: dict[str, np.ndarray]) -> float:
    """The largest distance in metres; every node of the motion must be in ``want``."""
    return max(float(np.abs(motion.positions[:, j] - want[n]).max()) for j, n in enumerate(motion.skeleton.names))


# -- reading -------------------------------------------------------------------------------------------------


def test_rest_by_hand(tmp_path):
    """A 9 / 0.45 inch bone upwards, then 10 inches along (3, 0, 4), then 4 backwards."""
    m = read_motion(pair(tmp_path))
    inches = m.positions[0] / INCH
    assert m.skeleton.names == ("root", "upper", "lower", "tip", "tip_end") and m.fps == 120 and m.name == "01_01"
    assert np.allclose(inches, [[0, 0, 0], [0, 0, 0], [0, 20, 0], [6, 20, 8], [6, 20, 4]])
    assert np.allclose(m.skeleton.rest_pose(), m.positions[0]) and m.skeleton.end_sites == {4}
    assert np.allclose(m.rotations[0], [1, 0, 0, 0])


def test_one_axis_by_hand(tmp_path):
    """With axis 0 0 90 a bone's own x is the world's y: rx turns about the world's y."""
    asf = ASF.replace("axis 10 20 -40 XYZ", "axis 0 0 90 XYZ")
    m = read_motion(pair(tmp_path, asf, AMC.replace("lower 0 0", "lower 90 0")))
    # (6, 0, 8) inches a quarter turn about y, z to x: (8, 0, -6)
    assert np.allclose(m.positions[0, 3] / INCH, [8, 20, -6])


def test_a_frame_agrees_with_the_definition(tmp_path):
    assert agrees(read_motion(pair(tmp_path)), by_definition(ASF, AMC)) < 1e-12
    bare = read_amc(tmp_path / "01_01.amc", end_sites=False)
    assert bare.skeleton.names == ("root", "upper", "lower", "tip")


@pytest.mark.parametrize("order", ["RZ RY RX TZ TX TY", "TY RX TX RZ TZ RY", "RY RZ RX TX TY TZ"])
def test_the_roots_order_is_the_files(tmp_path, order):
    asf = ASF.replace("TX TY TZ RX RY RZ", order)
    assert agrees(read_motion(pair(tmp_path, asf)), by_definition(asf, AMC)) < 1e-12


@pytest.mark.parametrize("dof", ["rz rx", "ry rz", "rz ry"])
def test_degrees_of_freedom_in_any_order(tmp_path, dof):
    asf = ASF.replace("dof rx rz", f"dof {dof}")
    assert agrees(read_motion(pair(tmp_path, asf)), by_definition(asf, AMC)) < 1e-12


def test_axis_orders(tmp_path):
    """``axis a b c ZYX`` turns about z first: the same as the matrix of an XYZ axis that is worked out here."""
    m = read_motion(pair(tmp_path, ASF.replace("axis 30 -20 50 XYZ", "axis 30 -20 50 ZYX")))
    c = about("zyx", [30, -20, 50])
    turn = about("xyz", [10, -20, 130]) @ c @ about("xyz", [35, 67, -81]) @ np.linalg.inv(c)
    start = np.array([1, 2, 4]) / 0.45
    assert np.allclose(m.positions[1, 2] / INCH, start + turn @ [0, 20, 0])


def test_radians_in_either_file(tmp_path):
    want = read_motion(pair(tmp_path)).positions

    def radians(words: str) -> str:
        return " ".join(f"{np.radians(float(w)):.17g}" for w in words.split())

    amc = AMC.replace(":DEGREES", ":RADIANS")
    for line, head, angles in (
        ("root 1 2 4 10 -20 130", "root 1 2 4", "10 -20 130"),
        ("upper 35 67 -81", "upper", "35 67 -81"),
        ("lower 8 -75", "lower", "8 -75"),
    ):
        amc = amc.replace(line, f"{head} {radians(angles)}")
    assert np.allclose(read_motion(pair(tmp_path, amc=amc)).positions, want)
    asf = ASF.replace("angle deg", "angle rad").replace("30 -20 50", radians("30 -20 50"))
    asf = asf.replace("10 20 -40", radians("10 20 -40")).replace("0 0 90", radians("0 0 90"))
    assert np.allclose(read_motion(pair(tmp_path, asf)).positions, want)  # the AMC says :DEGREES itself
    assert np.allclose(read_motion(pair(tmp_path, asf, amc.replace(":RADIANS\n", ""))).positions, want)


def test_limits_units_and_the_hierarchy(tmp_path):
    asf = read_asf(pair(tmp_path).with_name("01.asf"))
    assert asf.unit == pytest.approx(INCH / 0.45) and asf.order == ("tx", "ty", "tz", "rx", "ry", "rz")
    assert list(asf.bones) == ["upper", "lower", "tip"] and asf.bones["tip"].parent == "lower"
    assert np.allclose(np.degrees(asf.bones["upper"].limits), [(-160, 20), (-70, 70), (-np.inf, np.inf)])
    assert np.allclose(np.degrees(asf.bones["lower"].limits), [(-1, 2), (-3, 4)])
    assert asf.bones["lower"].length == pytest.approx(10 * INCH) and asf.bones["tip"].dof == ()
    (tmp_path / "rad.asf").write_text(re.sub(r"angle deg", "angle rad", ASF))
    assert np.allclose(read_asf(tmp_path / "rad.asf").bones["lower"].limits, [(-1, 2), (-3, 4)])


def test_bones_listed_before_their_parents(tmp_path):
    head, *blocks = re.split(r"(?=  begin\n    id)", ASF.split(":hierarchy")[0])
    asf = head + "".join(reversed(blocks)) + ":hierarchy" + ASF.split(":hierarchy")[1]
    assert agrees(read_motion(pair(tmp_path, asf)), by_definition(ASF, AMC)) < 1e-12


def test_root_position_is_where_it_starts(tmp_path):
    m = read_motion(pair(tmp_path, ASF.replace("position 0 0 0", "position 9 0 -9")))
    assert np.allclose(m.positions - read_motion(pair(tmp_path)).positions, np.array([20, 0, -20]) * INCH)


def test_another_line_end_rate_and_place(tmp_path):
    want = read_motion(pair(tmp_path)).positions
    path = pair(tmp_path, ASF.replace("\n", "\r\n"), "\ufeff" + AMC.replace("\n", "\r\n"))
    assert np.array_equal(read_motion(path).positions, want)
    (tmp_path / "elsewhere").mkdir()
    other = path.rename(tmp_path / "elsewhere" / "x.AMC")
    m = read_motion(other, asf=tmp_path / "01.asf", fps=60)
    assert m.fps == 60 and np.array_equal(m.positions, want)
    lines = file_info(other, asf=tmp_path / "01.asf").lines()
    assert any("5.644 cm (from 01.asf)" in line for line in lines)


def test_amc_written_as_bvh(tmp_path):
    m = read_motion(pair(tmp_path))
    write_bvh(m, tmp_path / "x.bvh")
    assert np.abs(read_bvh(tmp_path / "x.bvh", unit="cm", up="y").positions - m.positions).max() < 1e-7


# -- the database's own files --------------------------------------------------------------------------------


def test_cmu_files_agree_with_the_definition(real_clips):
    for path in real_clips("cmu/asfamc/*/*.amc"):
        asf = path.with_name(f"{path.parent.name}.asf").read_text()
        m = read_motion(path)
        assert len(m) > 100 and m.skeleton.n_joints == 31 + len(m.skeleton.end_sites)
        assert 1.4 < m.height < 2.0
        amc = path.read_text().splitlines()
        # a hundred lines from some place on are enough for the slow calculation
        starts = [n for n, line in enumerate(amc) if line.strip().isdigit()]
        for frame in (0, len(starts) // 2):
            part = "\n".join(amc[starts[frame] : starts[frame + 3]])
            assert agrees(m[frame : frame + 3], by_definition(asf, part)) < 1e-9


def test_cmu_amc_and_its_conversion_show_the_same_walk(real_clips):
    """02_01.amc and walking/01.bvh are one clip, the second converted by others through exponential maps.

    Trunk and legs are within 1.3 cm. Neck and arms hang in a chain of their own in the converted file, whose
    offsets leave out the upper chest (it is 12 cm shorter there), so those are compared from the shoulder on.
    """
    files = (real_clips(name)[0] for name in ("cmu/asfamc/02/02_01.amc", "cmu/walking/01.bvh"))
    amc, bvh = (to_common(read_motion(path)) for path in files)
    assert len(amc) == len(bvh) == 343 and amc.fps == bvh.fps
    far = np.linalg.norm(amc.positions - bvh.positions, axis=-1).max(0)
    legs = [j for j, n in enumerate(COMMON_JOINTS) if n.endswith(("Leg", "Foot", "Toe"))]
    assert far[0] < 1e-4 and far[[1, 2]].max() < 0.005 and far[legs].max() < 0.013
    for side in ("Left", "Right"):
        shoulder, *arm = (COMMON_JOINTS.index(side + n) for n in ("Arm", "ForeArm", "Hand"))
        one, other = (m.positions[:, arm] - m.positions[:, [shoulder]] for m in (amc, bvh))
        assert np.linalg.norm(one - other, axis=-1).max() < 0.013
