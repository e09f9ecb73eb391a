"""ASF/AMC files: Acclaim's skeleton and motion, as the CMU database gives them.

The ASF file has for each bone a direction and a length at rest, in the world's axes; an ``axis``, the frame
in which its angles are meant; and its degrees of freedom. The AMC file has one block a frame with their values.
A bone's local rotation is ``C M C^-1``, with ``C`` from the axis and ``M`` from the frame's angles, so that rest
is no rotation at all and the skeleton's offsets are the rest pose, as in BVH.
"""

from __future__ import annotations

import os
import pathlib
import re
from dataclasses import dataclass, field

import numpy as np

from ..errors import MotionFileError
from .bvh import END_SUFFIX
from .clip import Motion
from .rotations import euler_to_quat, quat_inv, quat_mul
from .skeleton import Skeleton
from .textfile import number, numbers, read_text, shown, whole

INCH = 0.0254
_DOFS = {"rx": "X", "ry": "Y", "rz": "Z"}
_ROOT_DOFS = {"tx", "ty", "tz", *_DOFS}


@dataclass
class Bone:
    """A bone of an ASF file: ``direction`` ``(3,)`` unit, ``length`` metres, ``axis`` a quaternion ``(4,)``,
    ``dof`` its angles in the AMC's order, ``limits`` in radians, one pair for each (often exceeded in real files)."""

    name: str
    line: int
    direction: np.ndarray | None = None
    length: float | None = None
    axis: np.ndarray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    dof: tuple[str, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()
    parent: str = ""


@dataclass
class Asf:
    """An ASF skeleton: ``bones`` by name with parents before children, the root's ``order`` of channels, its ``axis``,
    ``position`` in metres and ``orientation``; ``unit`` metres and ``angle`` radians per unit of the files."""

    bones: dict[str, Bone]
    order: tuple[str, ...]
    axis: np.ndarray
    position: np.ndarray
    orientation: np.ndarray
    unit: float
    angle: float

    def skeleton(self, end_sites: bool = True) -> Skeleton:
        """Nodes where bones begin, named after them, and, if asked for, ends of the bones that nothing follows."""
        names, parents, offsets, ends = ["root"], [-1], [np.zeros(3)], set()
        for bone in self.bones.values():
            before = self.bones.get(bone.parent)
            names.append(bone.name)
            parents.append(names.index(bone.parent))
            offsets.append(before.direction * before.length if before else np.zeros(3))
        followed = {bone.parent for bone in self.bones.values()}
        for bone in self.bones.values():
            if end_sites and bone.name not in followed:
                ends.add(len(names))
                parents.append(names.index(bone.name))
                name = bone.name + END_SUFFIX
                while name in self.bones:
                    name += "_"
                names.append(name)
                offsets.append(bone.direction * bone.length)
        return Skeleton(tuple(names), tuple(parents), np.array(offsets), end_sites=frozenset(ends))


def asf_beside(path: str | os.PathLike) -> pathlib.Path:
    """The ASF file that belongs to an AMC file: ``02.asf`` for ``02_01.amc``, or the only one in the folder."""
    path = pathlib.Path(path)
    if not path.exists():
        raise MotionFileError(path, "no such file, expected a motion file there")
    skeletons = sorted(p for p in path.parent.glob("*") if p.suffix.lower() == ".asf")
    for candidate in skeletons:
        if candidate.stem in (path.stem, path.stem.rpartition("_")[0]):
            return candidate
    if len(skeletons) == 1:
        return skeletons[0]
    want = f"{path.stem.rpartition('_')[0] or path.stem}.asf"
    raise MotionFileError(path, f"{len(skeletons)} ASF files beside it, none called {want}: expected its skeleton")


def read_asf(path: str | os.PathLike) -> Asf:
    """Read an ASF skeleton. Raises ``MotionFileError`` with the line for anything malformed."""
    text = read_text(path)
    sections = _sections(path, text.lines)
    units = {words[0].lower(): (n, words) for n, words in sections.get("units", [])}
    length = _unit_value(path, units, "length")
    # CMU: "length 0.45" means that lengths are to be divided by 0.45 to have inches
    unit = INCH / length
    angle = _angle(path, *units["angle"]) if "angle" in units else np.pi / 180
    order, axis, position, orientation = _read_root(path, sections, unit, angle)
    bones = _read_bones(path, sections, unit, angle)
    return Asf(_read_hierarchy(path, sections, bones), order, axis, position, orientation, unit, angle)


def read_amc(
    path: str | os.PathLike,
    asf: str | os.PathLike | None = None,
    *,
    fps: float = 120.0,
    end_sites: bool = True,
    with_unit: bool = False,
) -> Motion | tuple[Motion, str]:
    """Read an AMC motion with its ASF skeleton (None: ``asf_beside``) as a ``Motion`` in metres, y up.

    fps: the files do not tell their rate; CMU's are 120 frames a second.
    with_unit: return also the files' unit of length, in words.
    Raises ``MotionFileError`` (file, line, what was expected) for anything malformed.
    """
    path = pathlib.Path(path)
    skeleton_file = read_asf(asf if asf is not None else asf_beside(path))
    values = _read_frames(path, skeleton_file)
    skeleton = skeleton_file.skeleton(end_sites)
    rotations = np.zeros((len(values["root"]), skeleton.n_joints, 4))
    rotations[..., 0] = 1.0
    root, position = _root_motion(skeleton_file, values["root"])
    rotations[:, 0] = root
    for bone in skeleton_file.bones.values():
        if bone.dof:
            turn = _turn(values[bone.name], bone.dof)
            rotations[:, skeleton.index(bone.name)] = quat_mul(quat_mul(bone.axis, turn), quat_inv(bone.axis))
    motion = Motion.from_rotations(skeleton, fps, position, rotations, name=path.stem)
    return (motion, f"{skeleton_file.unit * 100:.4g} cm") if with_unit else motion


# -- ASF ---------------------------------------------------------------------------------------------------


def _sections(path, lines: list[str]) -> dict[str, list[tuple[int, list[str]]]]:
    """The words of each line, with its number, under the keyword (``:bonedata``) that it follows."""
    sections: dict[str, list[tuple[int, list[str]]]] = {}
    current = None
    for n, raw in enumerate(lines, 1):
        words = raw.split("#")[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            current = words[0][1:].lower()
            if current in sections:
                raise MotionFileError(path, f"section {shown(':' + current)} stands twice, expected once", n)
            sections[current] = [(n, words[1:])] if len(words) > 1 else []
        elif current is None:
            raise MotionFileError(path, f"{shown(raw)}, expected a keyword like :version, as an ASF file begins", n)
        else:
            sections[current].append((n, words))
    for need in ("units", "root", "bonedata", "hierarchy"):
        if need not in sections:
            raise MotionFileError(path, f"no :{need} section, expected one", len(lines))
    return sections


def _unit_value(path, units, key: str) -> float:
    if key not in units:
        return 1.0
    n, words = units[key]
    value = numbers(path, n, words[1:], 1, f"unit of {key}")[0]
    if not 1e-6 <= value <= 1e6:
        raise MotionFileError(path, f"unit of {key} {value:g}, expected a number above zero (1e-6 to 1e6)", n)
    return value


def _angle(path, n, words) -> float:
    kind = words[1].lower() if len(words) > 1 else ""
    if kind not in ("deg", "rad"):
        raise MotionFileError(path, f"angle unit {shown(kind)}, expected deg or rad", n)
    return np.pi / 180 if kind == "deg" else 1.0


def _axis(path, n, words: list[str], angle: float, order: str) -> np.ndarray:
    values = np.array(numbers(path, n, words, 3, "axis")) * angle
    return _turn(values[None], tuple("r" + a.lower() for a in _check_axis_order(path, n, order)))[0]


def _check_axis_order(path, n, order: str) -> str:
    if sorted(order.upper()) != ["X", "Y", "Z"]:
        raise MotionFileError(path, f"axis order {shown(order)}, expected one like XYZ", n)
    return order.upper()


def _turn(angles: np.ndarray, dof: tuple[str, ...]) -> np.ndarray:
    """Quaternions ``(T, 4)`` from ``(T, k)`` radians: the first listed angle is applied first, about fixed axes."""
    order = "".join(_DOFS[d] for d in dof)
    full = order + "".join(a for a in "XYZ" if a not in order)
    padded = np.zeros((len(angles), 3))
    padded[:, : len(order)] = angles
    # about fixed axes in the order a, b, c is about moving axes in the order c, b, a
    return euler_to_quat(padded[:, ::-1].copy(), full[::-1])


def _read_root(path, sections, unit, angle):
    found = {words[0].lower(): (n, words[1:]) for n, words in sections["root"]}
    n, words = found.get("order", (None, None))
    if words is None:
        last = sections["root"][-1][0] if sections["root"] else 1
        raise MotionFileError(path, "the :root section has no order, expected one like TX TY TZ RX RY RZ", last)
    order = tuple(w.lower() for w in words)
    if len(set(order)) != len(order) or not set(order) <= _ROOT_DOFS:
        raise MotionFileError(
            path, f"root order {shown(' '.join(words))}, expected each of TX TY TZ RX RY RZ at most once", n
        )
    axis_line, axis_words = found.get("axis", (n, ["XYZ"]))
    axis_order = _check_axis_order(path, axis_line, axis_words[0] if axis_words else "")
    vectors = {}
    for key in ("position", "orientation"):
        line, words = found.get(key, (n, ["0", "0", "0"]))
        vectors[key] = np.array(numbers(path, line, words, 3, f"root {key}"))
    axis = _turn(vectors["orientation"][None] * angle, tuple("r" + a.lower() for a in axis_order))[0]
    return order, axis, vectors["position"] * unit, vectors["orientation"] * angle


def _read_bones(path, sections, unit, angle) -> dict[str, Bone]:
    bones: dict[str, Bone] = {}
    bone, inside, limits_open = None, False, False
    for n, words in sections["bonedata"]:
        key = words[0].lower()
        if key == "begin":
            if inside:
                raise MotionFileError(path, "begin inside a bone, expected end first", n)
            bone, inside, limits_open = Bone("", n), True, False
        elif not inside:
            raise MotionFileError(path, f"{shown(' '.join(words))} outside of a bone, expected begin before it", n)
        elif key == "end":
            _finish_bone(path, n, bone, bones)
            inside = False
        elif key == "limits" or (limits_open and words[0].startswith("(")):
            limits_open = True
            bone.limits += _limits(path, n, words[1:] if key == "limits" else words, angle)
        elif key == "name":
            bone.name = " ".join(words[1:])
        elif key == "direction":
            vector = np.array(numbers(path, n, words[1:], 3, "direction"))
            norm = np.linalg.norm(vector)
            if norm < 1e-6:
                raise MotionFileError(
                    path, f"direction {shown(' '.join(words[1:]))}, expected a vector of some length", n
                )
            bone.direction = vector / norm
        elif key == "length":
            bone.length = numbers(path, n, words[1:], 1, "length")[0] * unit
            if bone.length < 0:
                raise MotionFileError(path, f"length {shown(words[1])}, expected a number of at least zero", n)
        elif key == "axis":
            bone.axis = _axis(path, n, words[1:4], angle, words[4] if len(words) > 4 else "XYZ")
        elif key == "dof":
            bone.dof = tuple(w.lower() for w in words[1:])
            if not set(bone.dof) <= set(_DOFS) or len(set(bone.dof)) != len(bone.dof):
                raise MotionFileError(
                    path, f"dof {shown(' '.join(words[1:]))}, expected some of rx ry rz, each once", n
                )
    if inside:
        raise MotionFileError(path, f"bone {shown(bone.name)} has no end, expected one", bone.line)
    return bones


def _limits(path, n, words, angle) -> tuple[tuple[float, float], ...]:
    pairs = re.findall(r"\(\s*([^\s()]+)\s+([^\s()]+)\s*\)", " ".join(words))
    if not pairs:
        raise MotionFileError(path, f"limits {shown(' '.join(words))}, expected pairs like (-20.0 45.0)", n)
    limits = []
    for pair in pairs:
        low, high = ((float(w) if w.lstrip("+-").lower() == "inf" else number(w)) for w in pair)
        if low is None or high is None:
            raise MotionFileError(path, f"limits {shown(' '.join(pair))}, expected two numbers", n)
        limits.append((low * angle, high * angle))
    return tuple(limits)


def _finish_bone(path, n, bone: Bone, bones: dict[str, Bone]):
    if not bone.name or bone.direction is None or bone.length is None:
        raise MotionFileError(path, f"bone {shown(bone.name)} ends here, expected name, direction and length in it", n)
    if bone.name in bones or bone.name == "root":
        raise MotionFileError(path, f"bone name {shown(bone.name)} stands twice, expected unique names", n)
    if bone.limits and len(bone.limits) != len(bone.dof):
        raise MotionFileError(path, f"bone {shown(bone.name)}: {len(bone.limits)} limits, expected {len(bone.dof)}", n)
    bones[bone.name] = bone


def _read_hierarchy(path, sections, bones: dict[str, Bone]) -> dict[str, Bone]:
    ordered: dict[str, Bone] = {}
    for n, words in sections["hierarchy"]:
        if words[0].lower() in ("begin", "end"):
            continue
        parent = words[0]
        if parent != "root" and parent not in ordered:
            raise MotionFileError(path, f"{shown(parent)} has children here, expected a bone with a parent", n)
        for child in words[1:]:
            if child not in bones:
                raise MotionFileError(path, f"{shown(child)} in the hierarchy, expected one of the bones", n)
            if child in ordered:
                raise MotionFileError(path, f"{shown(child)} has two parents, expected one", n)
            bones[child].parent = parent
            ordered[child] = bones[child]
    missing = [name for name in bones if name not in ordered]
    if missing:
        line = bones[missing[0]].line
        raise MotionFileError(
            path, f"bone {shown(missing[0])} is not in the hierarchy, expected a parent for it there", line
        )
    return ordered


# -- AMC ---------------------------------------------------------------------------------------------------


def _read_frames(path, asf: Asf) -> dict[str, np.ndarray]:
    """Values ``(T, k)`` for the root and each bone with degrees of freedom; angles in radians."""
    text = read_text(path)
    widths = {"root": len(asf.order)} | {bone.name: len(bone.dof) for bone in asf.bones.values() if bone.dof}
    frames: list[dict[str, list[float]]] = []
    angle, started = asf.angle, 0
    for n, raw in enumerate(text.lines, 1):
        words = raw.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            kind = words[0][1:].upper()
            angle = {"DEGREES": np.pi / 180, "RADIANS": 1.0}.get(kind, angle)
        elif len(words) == 1 and whole(words[0]) is not None:
            _check_whole(path, started, frames, widths)
            if whole(words[0]) != len(frames) + 1:
                raise MotionFileError(path, f"frame {shown(words[0])}, expected frame {len(frames) + 1}", n)
            frames.append({})
            started = n
        elif not frames:
            raise MotionFileError(path, f"{shown(raw)}, expected the first frame's number, 1", n)
        else:
            name = words[0]
            if name not in widths:
                raise MotionFileError(path, f"{shown(name)} in the frame, expected a bone with degrees of freedom", n)
            if name in frames[-1]:
                raise MotionFileError(path, f"bone {shown(name)} stands twice in frame {len(frames)}, expected once", n)
            frames[-1][name] = numbers(path, n, words[1:], widths[name], f"bone {shown(name)}")
    if not frames:
        raise MotionFileError(path, "no frames, expected at least one", len(text.lines))
    _check_whole(path, started, frames, widths)
    values = {name: np.array([frame[name] for frame in frames]) for name in widths}
    for name, array in values.items():
        dofs = asf.order if name == "root" else asf.bones[name].dof
        array[:, [k for k, d in enumerate(dofs) if d.startswith("r")]] *= angle
    return values


def _check_whole(path, line, frames, widths):
    if frames and len(frames[-1]) != len(widths):
        missing = next(name for name in widths if name not in frames[-1])
        raise MotionFileError(
            path, f"frame {len(frames)} has no values for {shown(missing)}, expected {widths[missing]}", line
        )


def _root_motion(asf: Asf, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The root's rotations ``(T, 4)`` and places ``(T, 3)`` in metres."""
    place = np.tile(asf.position, (len(values), 1))
    for k, dof in enumerate(asf.order):
        if dof.startswith("t"):
            place[:, "xyz".index(dof[1])] += values[:, k] * asf.unit
    turning = [k for k, dof in enumerate(asf.order) if dof.startswith("r")]
    turn = _turn(values[:, turning], tuple(asf.order[k] for k in turning))
    return quat_mul(quat_mul(asf.axis, turn), quat_inv(asf.axis)), place
