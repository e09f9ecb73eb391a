"""BVH files: Biovision's hierarchy and motion, read and written.

A file is a tree of joints, each with an offset from its parent and a list of channels, and then one row of
channel values a frame. What files of different studios do not agree on is handled here: the order of the
channels (each joint's own), position channels on joints below the root, units, and which axis points up.
"""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass

import numpy as np

from ..atomic import atomic_write
from ..errors import MotionError, MotionFileError
from .clip import Motion
from .ik import with_rotations
from .rotations import euler_to_quat, quat_inv, quat_mul, quat_rotate, quat_to_euler
from .skeleton import Skeleton
from .skeletons import common_indices, recognise, standing_height
from .textfile import numbers, numbers_table, read_text, shown, whole

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
_CHANNELS = {f"{axis}{kind}": (axis, kind) for axis in "XYZ" for kind in ("position", "rotation")}
_AXIS = {"X": 0, "Y": 1, "Z": 2}
END_SUFFIX = "_end"
_SMALLEST = 1e-9  # a body below this size, in any unit, has none


@dataclass
class _Joint:
    """One node of the hierarchy as the file has it."""

    name: str
    parent: int
    line: int
    offset: np.ndarray | None = None
    channels: list[tuple[str, str]] | None = None
    is_end: bool = False
    first: int = 0  # column of its first channel


@dataclass(frozen=True)
class BvhGuess:
    """The unit and the up axis that a file was read with, and whether they were guessed.

    up_guessed: from the body's pose. up_assumed: y, as usual, since no joints' names said which end is up.
    """

    unit: str
    up: str
    unit_guessed: bool
    up_guessed: bool
    up_assumed: bool = False


def read_bvh(
    path: str | os.PathLike,
    *,
    unit: str | None = None,
    up: str | None = None,
    end_sites: bool = True,
    quiet: bool = False,
) -> Motion:
    """Read a BVH file as a ``Motion`` in metres, y up.

    unit: the file's unit of length, ``"m"``, ``"cm"``, ``"mm"``, ``"in"`` or ``"ft"``; up: its vertical axis,
        ``"y"`` or ``"z"``. A BVH file tells neither: None guesses them from the size and the pose of the body (y
        where no joints are named as head and feet) and prints the guess in one line, unless ``quiet``.
    end_sites: whether the ends of bones become nodes, named after their joint with ``_end``.
    Position channels give a joint's place in its parent's frame, instead of its OFFSET.

    Raises ``MotionFileError`` (file, line, what was expected) for anything malformed: cut off, rows too short
    or long, NaN or infinity, no frames, a frame time not above zero, counts that disagree, joint names
    that stand twice, several roots, decimal commas, an empty or binary file.
    """
    motion, guess = read_bvh_with_guess(path, unit=unit, up=up, end_sites=end_sites)
    if not quiet and (guess.unit_guessed or guess.up_guessed or guess.up_assumed):
        how = ["guessed from the body"] if guess.unit_guessed or guess.up_guessed else []
        how += ["y taken as usual"] if guess.up_assumed else []
        print(f"{pathlib.Path(path).name}: read as unit {guess.unit!r}, up axis {guess.up!r} ({', '.join(how)})")
    return motion


def read_bvh_with_guess(
    path: str | os.PathLike, *, unit: str | None = None, up: str | None = None, end_sites: bool = True
) -> tuple[Motion, BvhGuess]:
    """``read_bvh`` that returns its guess instead of printing it."""
    if unit is not None and unit not in METRES_PER_UNIT:
        raise MotionError(f"unit {unit!r}: expected one of {', '.join(METRES_PER_UNIT)}")
    if up not in (None, "y", "z"):
        raise MotionError(f"up axis {up!r}: expected 'y' or 'z'")
    text = read_text(path)
    joints, line = _parse_hierarchy(path, text)
    values, fps = _parse_motion(path, text, line, joints)

    keep = [j for j, joint in enumerate(joints) if end_sites or not joint.is_end]
    place = {j: k for k, j in enumerate(keep)}
    joints = [joints[j] for j in keep]
    parents = tuple(place.get(joint.parent, -1) for joint in joints)
    offsets = np.stack([joint.offset for joint in joints])
    rotations, translations, orders, moved = _evaluate(joints, offsets, values)
    skeleton = Skeleton(
        tuple(joint.name for joint in joints),
        parents,
        offsets,
        orders,
        frozenset(k for k, joint in enumerate(joints) if joint.is_end),
    )
    positions = skeleton.fk(rotations, translations[:, 0], translations if moved else None)
    seen = None if up else _guess_up(skeleton, positions)
    guess = BvhGuess(
        unit or _guess_unit(skeleton, positions),
        up or seen or "y",
        unit_guessed=unit is None,
        up_guessed=seen is not None,
        up_assumed=not (up or seen),
    )
    metres = METRES_PER_UNIT[guess.unit]
    skeleton, positions = skeleton.scaled(metres), positions * metres
    if guess.up == "z":
        skeleton, positions, rotations = _z_up_to_y_up(skeleton, positions, rotations)
    return Motion(skeleton, fps, positions, rotations, pathlib.Path(path).stem), guess


# -- hierarchy ---------------------------------------------------------------------------------------------


def _parse_hierarchy(path, text) -> tuple[list[_Joint], int]:
    """The joints, in the file's order, and the number of the line that says MOTION."""
    joints: list[_Joint] = []
    lines_of: dict[str, int] = {}  # where each joint's name stands
    open_joints: list[int] = []
    pending: int | None = None  # a joint whose opening brace has not come yet
    started, n = False, 0
    for n, raw in enumerate(text.lines, 1):
        words = raw.replace("{", " { ").replace("}", " } ").split()
        if not words:
            continue
        key = words[0].upper()
        if not started:
            if key != "HIERARCHY":
                raise MotionFileError(path, f"{shown(raw)}, expected HIERARCHY, as a BVH file begins", n)
            started, words = True, words[1:]
            if not words:
                continue
            key = words[0].upper()
        if key == "MOTION":
            if open_joints or pending is not None:
                name = joints[open_joints[-1] if pending is None else pending].name
                raise MotionFileError(
                    path, f"MOTION while joint {shown(name)} is still open, expected '}}' before it", n
                )
            if not joints:
                raise MotionFileError(path, "MOTION before any joint, expected ROOT", n)
            if len(words) > 1:
                raise MotionFileError(path, f"{shown(raw)}, expected MOTION alone on its line", n)
            _finish(path, joints)
            return joints, n
        while words:
            words, pending = _take(path, n, words, raw, joints, lines_of, open_joints, pending)
    if not started:
        raise MotionFileError(path, "no text in it, expected HIERARCHY")
    raise MotionFileError(path, "the file ends inside the hierarchy, expected a MOTION section", max(n, 1))


def _take(path, n, words, raw, joints, lines_of, open_joints, pending):
    """Consume one statement from ``words``; the rest of the line and the pending joint come back."""
    key = words[0].upper()
    if pending is not None and key != "{":
        raise MotionFileError(path, f"{shown(raw)}, expected '{{' after joint {shown(joints[pending].name)}", n)
    if key == "{":
        if pending is None:
            raise MotionFileError(path, "'{' without a joint before it, expected ROOT, JOINT or End Site", n)
        open_joints.append(pending)
        return words[1:], None
    if key == "}":
        if not open_joints:
            raise MotionFileError(path, "'}' closes nothing, expected as many '}' as '{'", n)
        open_joints.pop()
        return words[1:], None
    if key in ("ROOT", "JOINT", "END"):
        return _take_joint(path, n, key, words, raw, joints, lines_of, open_joints)
    if not open_joints:
        raise MotionFileError(path, f"{shown(raw)}, expected ROOT, JOINT or MOTION", n)
    joint = joints[open_joints[-1]]
    if key == "OFFSET":
        if joint.offset is not None:
            raise MotionFileError(path, f"joint {shown(joint.name)} has a second OFFSET, expected one", n)
        stop = next((k for k, word in enumerate(words) if word in "{}"), len(words))
        joint.offset = np.array(numbers(path, n, words[1:stop], 3, f"OFFSET of {shown(joint.name)}"))
        return words[stop:], None
    if key == "CHANNELS":
        return _take_channels(path, n, words, raw, joint), None
    raise MotionFileError(path, f"{shown(raw)}, expected OFFSET, CHANNELS, JOINT, End Site or '}}'", n)


def _take_joint(path, n, key, words, raw, joints, lines_of, open_joints):
    if key == "ROOT":
        if joints:
            raise MotionFileError(path, f"{shown(raw)}: a second root, expected one figure in a file", n)
        parent = -1
    elif not open_joints:
        raise MotionFileError(path, f"{shown(raw)} outside of any joint, expected it inside braces", n)
    else:
        parent = open_joints[-1]
        if joints[parent].is_end:
            raise MotionFileError(path, f"{shown(raw)} inside an End Site, expected OFFSET alone", n)
    if key == "END":
        if len(words) < 2 or words[1].upper() != "SITE":
            raise MotionFileError(path, f"{shown(raw)}, expected End Site", n)
        name, rest = joints[parent].name + END_SUFFIX, words[2:]
    else:
        # names may hold spaces; a brace on the same line ends them
        stop = words.index("{") if "{" in words else len(words)
        name, rest = " ".join(words[1:stop]), words[stop:]
        if not name:
            raise MotionFileError(path, f"{key} without a name, expected one", n)
        if name in lines_of:
            what = f"joint name {shown(name)} stands already in line {lines_of[name]}, expected unique names"
            raise MotionFileError(path, what, n)
        lines_of[name] = n
    joints.append(_Joint(name, parent, n, is_end=key == "END"))
    return rest, len(joints) - 1


def _take_channels(path, n, words, raw, joint) -> list[str]:
    if joint.is_end:
        raise MotionFileError(path, "CHANNELS in an End Site, expected OFFSET alone", n)
    if joint.channels is not None:
        raise MotionFileError(path, f"joint {shown(joint.name)} has CHANNELS twice, expected once", n)
    count = whole(words[1]) if len(words) > 1 else None
    if count is None:
        raise MotionFileError(path, f"{shown(raw)}, expected CHANNELS and their number", n)
    names = words[2 : 2 + count]
    joint.channels = []
    for word in names:
        channel = _CHANNELS.get(word[:1].upper() + word[1:].lower())
        if channel is None:
            raise MotionFileError(path, f"channel {shown(word)} of {shown(joint.name)}, expected one like Zrotation", n)
        if channel in joint.channels:
            raise MotionFileError(path, f"channel {word} of {shown(joint.name)} stands twice, expected once", n)
        joint.channels.append(channel)
    rest = words[2 + count :]
    if len(names) != count or (rest and rest[0] not in "{}"):
        raise MotionFileError(
            path, f"joint {shown(joint.name)} lists {len(names) + len(rest)} channels, expected {count} as announced", n
        )
    return rest


def _finish(path, joints):
    column = 0
    for joint in joints:
        if joint.offset is None:
            raise MotionFileError(path, f"joint {shown(joint.name)} has no OFFSET, expected three numbers", joint.line)
        if joint.channels is None:
            if not joint.is_end:
                raise MotionFileError(path, f"joint {shown(joint.name)} has no CHANNELS, expected them", joint.line)
            joint.channels = []
        joint.first = column
        column += len(joint.channels)
    names = {joint.name for joint in joints if not joint.is_end}
    for joint in joints:
        if joint.is_end:  # only now are all joints known whose names an end must not take
            while joint.name in names:
                joint.name += "_"
            names.add(joint.name)


# -- motion ------------------------------------------------------------------------------------------------


def _parse_motion(path, text, line, joints) -> tuple[np.ndarray, float]:
    """Channel values ``(T, C)`` and frames per second, from what follows the line MOTION."""
    header: dict[str, float] = {}
    n = line
    while n < len(text.lines) and len(header) < 2:
        raw = text.lines[n]
        n += 1
        if not raw.strip():
            continue
        key, colon, value = raw.partition(":")
        key = " ".join(key.lower().split())
        want = "frames" if not header else "frame time"
        if not colon or key != want:
            raise MotionFileError(path, f"{shown(raw)}, expected {want.title()}: and a number", n)
        header[key] = numbers(path, n, value.split(), 1, want.title())[0]
        if key == "frames" and (header[key] < 1 or header[key] % 1):
            raise MotionFileError(path, f"Frames: {shown(value)}, expected a whole number of at least 1", n)
        if key == "frame time" and not header[key] >= 1e-6:
            raise MotionFileError(path, f"Frame Time: {shown(value)}, expected seconds above zero (1e-6 or more)", n)
    if len(header) < 2:
        raise MotionFileError(path, "the file ends here, expected Frames: and Frame Time:", max(n, 1))
    columns = sum(len(joint.channels) for joint in joints)
    values = numbers_table(path, text, n, columns, int(header["frames"]))
    return values, _rate(header["frame time"])


def _rate(frame_time: float) -> float:
    """Frames per second; files write 1/120 s as 0.00833333, which is meant to be 120.

    Television's 30/1.001 differs from 30 by a thousandth and stays what it is.
    """
    fps = 1.0 / frame_time
    return float(round(fps)) if abs(fps - round(fps)) < 5e-4 * fps else fps


def _evaluate(joints, offsets, values):
    """Local rotations ``(T, J, 4)``, translations ``(T, J, 3)``, Euler orders, and whether any bone moves."""
    frames = len(values)
    rotations = np.zeros((frames, len(joints), 4))
    rotations[..., 0] = 1.0
    translations = np.broadcast_to(offsets, (frames, len(joints), 3)).copy()
    orders, moved = [], False
    by_order: dict[str, list[tuple[int, list[int]]]] = {}
    for j, joint in enumerate(joints):
        order = ""
        columns = []
        for k, (axis, kind) in enumerate(joint.channels):
            if kind == "position":
                translations[:, j, _AXIS[axis]] = values[:, joint.first + k]
                moved = moved or j > 0
            else:
                order += axis
                columns.append(joint.first + k)
        if 0 < len(order) < 3:  # an axis without a channel is never turned about: its angle is zero
            order += "".join(axis for axis in "ZXY" if axis not in order)
        orders.append(order or "ZXY")
        if columns:
            by_order.setdefault(order, []).append((j, columns))
    for order, entries in by_order.items():
        angles = np.zeros((frames, len(entries), 3))
        for k, (_, columns) in enumerate(entries):
            angles[:, k, : len(columns)] = np.radians(values[:, columns])
        rotations[:, [j for j, _ in entries]] = euler_to_quat(angles, order)
    return rotations, translations, tuple(orders), moved


# -- what the file does not say ----------------------------------------------------------------------------


def _guess_unit(skeleton: Skeleton, positions: np.ndarray) -> str:
    """The unit in which the body has the size of a person, nearest to 1.6 m."""
    known = recognise(skeleton) is not None
    size = standing_height(skeleton) if known else float(np.ptp(skeleton.rest_pose(), axis=0).max())
    if size < _SMALLEST:
        size = float(np.ptp(positions, axis=1).max())
    if size < _SMALLEST:
        return "cm"
    return min(("m", "cm", "mm", "in"), key=lambda unit: abs(np.log(size * METRES_PER_UNIT[unit] / 1.6)))


def _guess_up(skeleton: Skeleton, positions: np.ndarray) -> str | None:
    """The axis along which the head is above the feet, found by their names; None where there are none."""
    if recognise(skeleton) is not None:
        at = common_indices(skeleton)
        head, feet = [at["Head"]], [at["LeftFoot"], at["RightFoot"]]
    else:
        head, *lowest = (
            [j for j, name in enumerate(skeleton.names) if part in name.lower()]
            for part in ("head", "foot", "ankle", "toe", "knee", "leg")  # Biovision's feet are LeftAnkle, RightAnkle
        )
        feet = next(filter(None, lowest), None)
        if not head or not feet:
            return None
    upright = np.median(positions[:, head].mean(1) - positions[:, feet].mean(1), axis=0)
    return "z" if upright[2] > abs(upright[1]) and upright[2] > abs(upright[0]) else "y"


def _z_up_to_y_up(skeleton: Skeleton, positions: np.ndarray, rotations: np.ndarray):
    """Turn the world, and every local frame with it, by -90 degrees about x: (x, y, z) -> (x, z, -y)."""
    turn = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])
    turned = Skeleton(
        skeleton.names, skeleton.parents, quat_rotate(turn, skeleton.offsets), skeleton.orders, skeleton.end_sites
    )
    return turned, quat_rotate(turn, positions), quat_mul(quat_mul(turn, rotations), quat_inv(turn))


# -- writing -----------------------------------------------------------------------------------------------


def write_bvh(motion: Motion, path: str | os.PathLike, *, unit: str = "cm", decimals: int = 6) -> None:
    """Write a motion as BVH, whole or not at all.

    With rotations the file is exact to ``decimals``; a joint gets position channels only where its bone changes
    (by more than 0.01 mm). Without (a network gave positions alone) rotations are recovered bone by bone first,
    by the smallest turn from how the parent is turned: *no twist about a bone's own axis*
    (``ik.rotations_from_positions``). Bones then have the length that they have on average, and position channels
    where they change, so that the joints are just where they were given. An End Site has no channels in a BVH file:
    it stays at its average distance. A last joint without one gets an end site of length zero, which programs expect.
    unit: the unit of length in the file, centimetres as nearly all programs expect.
    Raises ``MotionError`` for an unknown unit and where the file cannot be written.
    """
    if unit not in METRES_PER_UNIT:
        raise MotionError(f"unit {unit!r}: expected one of {', '.join(METRES_PER_UNIT)}")
    if motion.rotations is None:
        motion = with_rotations(motion)
    skeleton = motion.skeleton
    scale = 1.0 / METRES_PER_UNIT[unit]
    translations = motion.translations()
    moves = np.abs(translations - skeleton.offsets).max((0, 2)) > 1e-5
    moves[0] = True

    lines, columns = ["HIERARCHY"], []
    _write_hierarchy(skeleton, scale, decimals, moves, lines, columns)
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1.0 / motion.fps:.10g}"]
    blocks = []
    for j in columns:
        if moves[j]:
            blocks.append(translations[:, j] * scale)
        blocks.append(np.degrees(quat_to_euler(motion.rotations[:, j], skeleton.orders[j])))
    rows = np.round(np.concatenate(blocks, 1), decimals) + 0.0  # + 0.0: no minus before a zero
    try:
        with atomic_write(path) as temporary, open(temporary, "w", encoding="utf-8", newline="\n") as file:
            file.write("\n".join(lines) + "\n")
            np.savetxt(file, rows, fmt=f"%.{decimals}f")
    except OSError as error:
        raise MotionError(f"{path}: cannot be written ({error.strerror})") from None


def _write_hierarchy(skeleton, scale, decimals, moves, lines, columns):
    """Depth first, as the rows have the channels; without recursion, for a chain may have any length."""
    names = _safe_names(skeleton.names)
    todo: list[tuple[int, int] | str] = [(0, 0)]
    while todo:
        item = todo.pop()
        if isinstance(item, str):
            lines.append(item)
            continue
        j, depth = item
        pad = "\t" * depth
        offset = " ".join(f"{x:.{decimals}f}" for x in np.round(skeleton.offsets[j] * scale, decimals) + 0.0)
        if j in skeleton.end_sites:
            lines += [f"{pad}End Site", f"{pad}{{", f"{pad}\tOFFSET {offset}", f"{pad}}}"]
            continue
        rotation = " ".join(f"{axis}rotation" for axis in skeleton.orders[j])
        channels = f"6 Xposition Yposition Zposition {rotation}" if moves[j] else f"3 {rotation}"
        lines += [f"{pad}{'JOINT' if depth else 'ROOT'} {names[j]}", f"{pad}{{"]
        lines += [f"{pad}\tOFFSET {offset}", f"{pad}\tCHANNELS {channels}"]
        columns.append(j)
        todo.append(f"{pad}}}")
        todo += [(child, depth + 1) for child in reversed(skeleton.children[j])]
        if not skeleton.children[j]:
            lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET 0 0 0", f"{pad}\t}}"]


def _safe_names(names: tuple[str, ...]) -> list[str]:
    """Names that a file can hold: one line, no braces, none empty, none twice."""
    safe: dict[str, None] = {}
    for name in names:
        text = " ".join(name.replace("{", "(").replace("}", ")").split())
        text = "".join(c if c.isprintable() else "_" for c in text) or "joint"
        while text in safe:
            text += "_"
        safe[text] = None
    return list(safe)
