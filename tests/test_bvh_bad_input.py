"""Malformed motion files: one line that names file, line and what was expected; never a traceback, never a warning."""

from __future__ import annotations

import gzip
import os
import re
import time
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tutorial_lib.errors import MotionFileError
from tutorial_lib.motion import read_bvh, read_motion

pytestmark = pytest.mark.filterwarnings("error")

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
Frames: 3
Frame Time: 0.0083333
1 2 3 0 0 0 0 0 0
1 2 3 90 0 0 0 90 0
1 2 3 91 0 0 0 90 0
"""

ASF = """:version 1.10
:name test
:units
  mass 1.0
  length 0.45
  angle deg
:documentation
  words
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
    length 2.0
    axis 0 0 20 XYZ
    dof rx ry
    limits (-160.0 20.0)
           (-70.0 70.0)
  end
  begin
    id 2
    name lower
    direction 1 0 0
    length 1.0
    axis 0 0 0 XYZ
    dof rz
    limits (-inf inf)
  end
:hierarchy
  begin
    root upper
    upper lower
  end
"""
AMC = """# made for a test
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 10 20 30
upper 5 6
lower 7
2
root 1 2 4 10 20 30
upper 5 7
lower 8
"""


def told(path, line: int | None, *expected: str) -> str:
    """The one line with which ``path`` is refused; it names the file, the line, and what was expected."""
    with pytest.raises(MotionFileError) as caught:
        read_motion(path)
    message = str(caught.value)
    assert "\n" not in message and "\r" not in message and len(message) < len(str(path)) + 200, message
    where = re.match(re.escape(str(path.parent)) + r"[/\\][^:]+(:(\d+))?: ", message)
    assert where, message
    assert (int(where[2]) if where[2] else None) == line, message
    assert caught.value.line == line
    for text in expected:
        assert text in message, message
    return message


def bvh(tmp_path, text: str | bytes, name: str = "clip.bvh"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
    return path


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


# what is changed: (old text, new text, line that is named, words of the message)
BVH_CASES = {
    # the table
    "row too short": ("1 2 3 90 0 0 0 90 0", "1 2 3 90 0 0 0 90", 20, "8 numbers in the row, expected 9"),
    "row too long": ("1 2 3 90 0 0 0 90 0", "1 2 3 90 0 0 0 90 0 0", 20, "10 numbers in the row, expected 9"),
    "NaN": ("3 90 0", "3 NaN 0", 20, "'NaN', expected a finite number"),
    "-nan(ind)": ("3 90 0", "3 -nan(ind) 0", 20, "'-nan(ind)', expected a finite number"),
    "infinity": ("3 91 0", "3 inf 0", 21, "'inf', expected a finite number"),
    "-Infinity": ("3 90 0", "3 -Infinity 0", 20, "expected a finite number"),
    "1e999": ("3 90 0", "3 1e999 0", 20, "'1e999', expected a finite number"),
    "1e300": ("3 90 0", "3 1e300 0", 20, "'1e300', expected a finite number below 1e9"),
    "decimal comma": ("3 90 0", "3 90,5 0", 20, "'90,5', expected a finite number"),
    "comma separated": ("1 2 3 90 0 0 0 90 0", "1,2,3,90,0,0,0,90,0", 20, "1 numbers in the row, expected 9"),
    "word": ("3 90 0", "3 ninety 0", 20, "'ninety', expected"),
    "hexadecimal": ("3 90 0", "3 0x5A 0", 20, "'0x5A', expected"),
    "underscore": ("3 90 0", "3 9_0 0", 20, "'9_0', expected"),
    "foreign digits": ("3 90 0", "3 \uff19\uff10 0", 20, "expected a finite number"),
    "comment": ("3 90 0", "3 90 # 0", 20, "in the row, expected 9"),
    "zero byte later": ("3 90 0", "3 \x00 0", None, "binary"),
    "row missing": ("1 2 3 91 0 0 0 90 0\n", "", 20, "ends after 2 frames, expected 3"),
    "row too many": ("1 2 3 91 0 0 0 90 0\n", "1 2 3 91 0 0 0 90 0\n" * 2, 22, "a row after the last of 3 frames"),
    "text after the table": ("1 2 3 91 0 0 0 90 0\n", "1 2 3 91 0 0 0 90 0\nend\n", 22, "after the last of 3 frames"),
    # its head
    "zero frames": ("Frames: 3", "Frames: 0", 17, "Frames: '0', expected a whole number of at least 1"),
    "negative frames": ("Frames: 3", "Frames: -3", 17, "expected a whole number of at least 1"),
    "half a frame": ("Frames: 3", "Frames: 2.5", 17, "expected a whole number"),
    "frames without end": ("Frames: 3", "Frames: 1e300", 17, "expected a finite number"),
    "more frames than rows": ("Frames: 3", "Frames: 999999999", 21, "expected 999999999 as Frames: says"),
    "frames are words": ("Frames: 3", "Frames: three", 17, "'three', expected"),
    "frames without number": ("Frames: 3", "Frames:", 17, "0 numbers, expected 1"),
    "frames twice": ("Frame Time: 0.0083333", "Frames: 3", 18, "expected Frame Time:"),
    "no frames line": ("Frames: 3\n", "", 17, "expected Frames: and a number"),
    "no colon": ("Frames: 3", "Frames 3", 17, "expected Frames:"),
    "zero frame time": ("Time: 0.0083333", "Time: 0", 18, "Frame Time: '0', expected seconds above zero"),
    "negative frame time": ("Time: 0.0083333", "Time: -0.01", 18, "expected seconds above zero"),
    "vanishing frame time": ("Time: 0.0083333", "Time: 5e-324", 18, "expected seconds above zero"),
    "NaN frame time": ("Time: 0.0083333", "Time: nan", 18, "'nan', expected a finite number"),
    "comma in frame time": ("Time: 0.0083333", "Time: 0,0083", 18, "'0,0083', expected"),
    "no frame time": ("Frame Time: 0.0083333\n", "", 18, "expected Frame Time:"),
    "words after MOTION": ("MOTION\n", "MOTION now\n", 16, "expected MOTION alone"),
    # the hierarchy
    "no HIERARCHY": ("HIERARCHY\n", "", 1, "expected HIERARCHY"),
    "two roots": ("MOTION", "ROOT other\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\nMOTION", 16, "a second root, expected one"),
    "root inside": ("JOINT arm", "ROOT arm", 6, "a second root"),
    "joint first": ("ROOT hip", "JOINT hip", 2, "expected it inside braces"),
    "joint after the root": ("}\nMOTION", "}\nJOINT x\n{\nMOTION", 16, "outside of any joint"),
    "duplicate name": ("JOINT arm", "JOINT hip", 6, "'hip' stands already in line 2, expected unique names"),
    "no name": ("JOINT arm", "JOINT", 6, "JOINT without a name"),
    "no opening brace": ("ROOT hip\n{", "ROOT hip\n", 4, "expected '{' after joint 'hip'"),
    "two opening braces": ("ROOT hip\n{", "ROOT hip\n{\n{", 4, "'{' without a joint"),
    "a brace too few": ("\t}\n}\nMOTION", "\t}\nMOTION", 15, "'hip' is still open, expected '}'"),
    "a brace too many": ("}\nMOTION", "}\n}\nMOTION", 16, "'}' closes nothing"),
    "no offset": ("\t\tOFFSET 10 0 0\n", "", 6, "'arm' has no OFFSET, expected three numbers"),
    "short offset": ("OFFSET 10 0 0", "OFFSET 10 0", 8, "2 numbers, expected 3"),
    "long offset": ("OFFSET 10 0 0", "OFFSET 10 0 0 0", 8, "4 numbers, expected 3"),
    "two offsets": ("OFFSET 10 0 0", "OFFSET 10 0 0\nOFFSET 1 0 0", 9, "a second OFFSET, expected one"),
    "NaN offset": ("OFFSET 10 0 0", "OFFSET 10 nan 0", 8, "'nan', expected a finite number"),
    "comma in an offset": ("OFFSET 10 0 0", "OFFSET 10,5 0 0", 8, "'10,5', expected"),
    "huge offset": ("OFFSET 10 0 0", "OFFSET 1e308 0 0", 8, "below 1e9"),
    "no channels": ("\t\tCHANNELS 3 Zrotation Xrotation Yrotation\n", "", 6, "'arm' has no CHANNELS"),
    "fewer channels than said": ("CHANNELS 3 Zrotation", "CHANNELS 4 Zrotation", 9, "lists 3 channels, expected 4"),
    "more channels than said": ("CHANNELS 3 Zrotation", "CHANNELS 2 Zrotation", 9, "lists 3 channels, expected 2"),
    "channels without number": ("CHANNELS 3 Zrotation", "CHANNELS Zrotation", 9, "expected CHANNELS and their number"),
    "channels squared": ("CHANNELS 3 Zrotation", "CHANNELS \u00b2 Zrotation", 9, "expected CHANNELS and their number"),
    "channels without end": ("CHANNELS 3", "CHANNELS " + "9" * 5000, 9, "expected CHANNELS and their number"),
    "negative channels": ("CHANNELS 3", "CHANNELS -3", 9, "expected CHANNELS and their number"),
    "unknown channel": ("CHANNELS 3 Zrotation", "CHANNELS 3 Wrotation", 9, "'Wrotation' of 'arm', expected one like"),
    "channel twice": ("CHANNELS 3 Zrotation X", "CHANNELS 3 Xrotation X", 9, "Xrotation of 'arm' stands twice"),
    "channels twice": ("\t\tEnd Site", "\t\tCHANNELS 0\n\t\tEnd Site", 10, "CHANNELS twice, expected once"),
    "channels in an end": ("OFFSET 0 20 0", "OFFSET 0 20 0\nCHANNELS 1 Xrotation", 13, "expected OFFSET alone"),
    "joint in an end": ("OFFSET 0 20 0", "OFFSET 0 20 0\nJOINT x", 13, "inside an End Site"),
    "end of what": ("End Site", "End", 10, "expected End Site"),
    "end without offset": ("\t\t\tOFFSET 0 20 0\n", "", 10, "no OFFSET, expected three numbers"),
    "unknown word": ("\tJOINT arm", "\tSCALE 1\n\tJOINT arm", 6, "expected OFFSET, CHANNELS, JOINT, End Site or '}'"),
    "offset outside": ("ROOT hip", "OFFSET 0 0 0\nROOT hip", 2, "expected ROOT"),
}  # fmt: skip


@pytest.mark.parametrize("case", BVH_CASES)
def test_a_malformed_bvh(tmp_path, case):
    old, new, line, *expected = BVH_CASES[case]
    told(bvh(tmp_path, changed(ARM, old, new)), line, *expected)


def test_the_line_is_right_with_other_line_ends_and_blank_lines(tmp_path):
    bad = changed(ARM, "3 90 0", "3 NaN 0")
    for end in ("\r\n", "\r"):
        told(bvh(tmp_path, bad.replace("\n", end)), 20, "'NaN'")
    told(bvh(tmp_path, bad.replace("1 2 3 0 0", "\n\n1 2 3 0 0")), 22, "'NaN'", "frame 2")


def test_cut_off_after_every_line(tmp_path):
    lines = ARM.splitlines(keepends=True)
    for n in range(1, len(lines)):
        message = told(bvh(tmp_path, "".join(lines[:n])), n)
        assert "ends" in message and "expected" in message


def test_cut_off_at_every_byte(tmp_path):
    """Within the last number nobody can tell; anywhere before, it is refused."""
    for n in range(len(ARM) - 2):
        path = bvh(tmp_path, ARM[:n])
        if not ARM[:n].strip():
            told(path, None, "empty")
            continue
        with pytest.raises(MotionFileError):
            read_bvh(path)


NO_TEXT = {
    "empty": (b"", "the file is empty"),
    "blank": (b" \n\t\r\n" * 1000, "the file is empty"),
    "only a byte order mark": (b"\xef\xbb\xbf", "HIERARCHY"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(range(256)), "binary"),
    "UTF-16": (ARM.encode("utf-16"), "binary"),
    "compressed": (gzip.compress(ARM.encode(), mtime=0), "binary"),
    "compressed and cut": (gzip.compress(ARM.encode() * 50, mtime=0)[:100], "binary"),
    "random": (np.random.default_rng(0).bytes(5000), "binary"),
    "high bytes": (bytes(range(128, 256)) * 20, "expected HIERARCHY"),
    "a web page": (b"<!DOCTYPE html>\n<html>404</html>", "expected HIERARCHY"),
    "a pointer": (b"version https://git-lfs.github.com/spec/v1\noid sha256:00", "expected HIERARCHY"),
}


@pytest.mark.parametrize("case", NO_TEXT)
def test_no_motion_at_all(tmp_path, case):
    content, expected = NO_TEXT[case]
    with pytest.raises(MotionFileError, match=expected) as caught:
        read_motion(bvh(tmp_path, content))
    assert str(caught.value).isprintable()


def test_a_zero_byte_far_into_the_file(tmp_path):
    text = changed(ARM, "MOTION", "\n" * 70_000 + "MOTION")
    told(bvh(tmp_path, changed(text, "91 0", "91\x00 0")), 70_021, "expected")


def test_what_is_no_file(tmp_path):
    told(tmp_path / "none.bvh", None, "no such file")
    told(tmp_path / "none.amc", None, "no such file")
    (tmp_path / "folder.bvh").mkdir()
    told(tmp_path / "folder.bvh", None, "cannot be read")
    with pytest.raises(MotionFileError, match="cannot be read"):
        read_bvh("zero\0byte.bvh")
    with pytest.raises(MotionFileError):
        read_bvh(tmp_path / ("x" * 5000 + ".bvh"))
    if hasattr(os, "geteuid") and os.geteuid() != 0:
        path = bvh(tmp_path, ARM)
        path.chmod(0)
        told(path, None, "cannot be read")


FIFTY = 50 * 2**20
ONE_LINE = {
    "letters": lambda: b"a" * FIFTY,
    "words": lambda: b"a " * (FIFTY // 2),
    "after HIERARCHY": lambda: b"HIERARCHY " + b"ROOT x { " * (FIFTY // 9),
    "braces": lambda: b"HIERARCHY\nROOT x\n" + b"{" * FIFTY,
    "a row": lambda: ARM.encode().replace(b"1 2 3 90", b"1 2 3 90" + b" 1.5" * (FIFTY // 4)),
    "one number": lambda: ARM.encode().replace(b"1 2 3 90", b"1 2 3 " + b"9" * FIFTY),
    "a name": lambda: ARM.encode().replace(b"arm", b"arm " * (FIFTY // 4)),
    "channels": lambda: ARM.encode().replace(b"CHANNELS 3", b"CHANNELS 3" + b" Xrotation" * (FIFTY // 10)),
}


@pytest.mark.parametrize("case", ONE_LINE)
def test_fifty_megabytes_of_one_line(tmp_path, case):
    resource = pytest.importorskip("resource")
    path = bvh(tmp_path, ONE_LINE[case]())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    with pytest.raises(MotionFileError, match=r"clip.bvh:\d+: a line of .* characters, expected at most") as caught:
        read_motion(path)
    assert time.perf_counter() - start < 10
    assert len(str(caught.value)) < len(str(path)) + 200
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000  # kilobytes
    path.unlink()


LONG = 990_000  # characters: a line that is just not too long
LONG_LINES = {
    "digits and a letter": ("3 90 0", "3 " + "9" * LONG + "x 0", 20),
    "digits": ("3 90 0", "3 " + "9" * LONG + " 0", 20),
    "points": ("3 90 0", "3 " + "9." * (LONG // 2) + " 0", 20),
    "a row": ("3 90 0", "3 " + "9 " * (LONG // 2) + " 0", 20),
    "a name": ("JOINT arm\n\t{\n\t\tOFFSET 10 0 0", "JOINT " + "a" * LONG + "\n\t{", 6),
    "a name of words": ("JOINT arm\n\t{", "JOINT " + "a " * (LONG // 2) + "\n\t(", 7),
    "braces": ("JOINT arm", "JOINT arm" + "{" * LONG, 6),
    "closing braces": ("JOINT arm", "}" * LONG, 6),
    "channels": ("CHANNELS 3", "CHANNELS 3" + " Xrotation" * (LONG // 10), 9),
    "zeros": ("0.0083333", "0." + "0" * LONG + "1", 18),
    "frames": ("Frames: 3", "Frames: -" + "0" * LONG + "3", 17),
}


@pytest.mark.parametrize("case", LONG_LINES)
def test_the_longest_lines_end_soon_with_a_short_message(tmp_path, case):
    old, new, line = LONG_LINES[case]
    start = time.perf_counter()
    told(bvh(tmp_path, changed(ARM, old, new)), line, "expected")
    assert time.perf_counter() - start < 10


def test_many_short_lines_of_nonsense_end_soon(tmp_path):
    """A quarter of a million joints: no search through all names for each."""
    text = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 0\n"
    text += "".join(f"JOINT j{i}\n{{\nOFFSET 0 0 0\nCHANNELS 0\n}}\n" for i in range(60_000))
    start = time.perf_counter()
    told(bvh(tmp_path, text), text.count("\n"), "ends inside the hierarchy")
    assert time.perf_counter() - start < 10


# -- ASF/AMC -------------------------------------------------------------------------------------------------


def pair(tmp_path, asf: str = ASF, amc: str = AMC):
    (tmp_path / "01.asf").write_text(asf)
    (tmp_path / "01_01.amc").write_text(amc)
    return tmp_path / "01_01.amc"


AMC_CASES = {
    "row too short": ("upper 5 6", "upper 5", 6, "1 numbers, expected 2"),
    "row too long": ("upper 5 6", "upper 5 6 7", 6, "3 numbers, expected 2"),
    "NaN": ("upper 5 6", "upper 5 nan", 6, "'nan', expected a finite number"),
    "infinity": ("upper 5 6", "upper inf 6", 6, "'inf', expected a finite number"),
    "decimal comma": ("upper 5 6", "upper 5,5 6", 6, "'5,5', expected"),
    "huge": ("upper 5 6", "upper 1e200 6", 6, "expected a finite number below 1e9"),
    "unknown bone": ("upper 5 6", "middle 5 6", 6, "'middle' in the frame, expected a bone with degrees"),
    "bone twice": ("upper 5 6", "upper 5 6\nupper 5 6", 7, "'upper' stands twice in frame 1"),
    "bone missing": ("upper 5 6\n", "", 4, "frame 1 has no values for 'upper'"),
    "root missing": ("root 1 2 4 10 20 30\n", "", 8, "frame 2 has no values for 'root'"),
    "frame left out": ("\n2\n", "\n3\n", 8, "frame '3', expected frame 2"),
    "frame twice": ("\n2\n", "\n1\n", 8, "frame '1', expected frame 2"),
    "no first frame": ("\n1\n", "\n", 4, "expected the first frame's number"),
    "squared frame": ("\n1\n", "\n\u00b2\n", 4, "expected the first frame's number"),
    "endless frame": ("\n1\n", "\n" + "1" * 5000 + "\n", 4, "expected the first frame's number"),
    "cut off": ("2\nroot 1 2 4 10 20 30\nupper 5 7\nlower 8\n", "2\nroot 1 2 4 10 20 30\n", 8, "no values for 'upper'"),
    "zero frames": (AMC[AMC.index("1\n") :], "", 3, "no frames, expected at least one"),
}


@pytest.mark.parametrize("case", AMC_CASES)
def test_a_malformed_amc(tmp_path, case):
    old, new, line, *expected = AMC_CASES[case]
    told(pair(tmp_path, amc=changed(AMC, old, new)), line, *expected)


ASF_CASES = {
    "no keyword first": (":version 1.10", "version 1.10", 1, "expected a keyword"),
    "section twice": (":documentation", ":units", 7, "section ':units' stands twice"),
    "no units": (":units", ":measures", 38, "no :units section"),
    "no root": (":root", ":stem", 38, "no :root section"),
    "no bones": (":bonedata", ":data", 38, "no :bonedata section"),
    "no hierarchy": (":hierarchy", ":tree", 38, "no :hierarchy section"),
    "zero unit": ("length 0.45", "length 0", 5, "expected a number above zero"),
    "tiny unit": ("length 0.45", "length 1e-320", 5, "expected a number above zero"),
    "comma": ("length 0.45", "length 0,45", 5, "'0,45', expected"),
    "angle unit": ("angle deg", "angle gon", 6, "'gon', expected deg or rad"),
    "root order": ("TX TY TZ RX RY RZ", "TX TY TZ RX RY RW", 10, "root order"),
    "root order twice": ("TX TY TZ RX RY RZ", "TX TY TZ RX RX RZ", 10, "at most once"),
    "no root order": ("  order TX TY TZ RX RY RZ\n", "", 12, "has no order, expected one"),
    "root axis": ("axis XYZ", "axis XYY", 11, "axis order 'XYY', expected one like XYZ"),
    "root position": ("position 0 0 0", "position 0 0", 12, "2 numbers, expected 3"),
    "direction": ("direction 0 1 0", "direction 0 0 0", 18, "expected a vector of some length"),
    "short direction": ("direction 0 1 0", "direction 0 1", 18, "2 numbers, expected 3"),
    "length": ("length 2.0", "length two", 19, "'two', expected"),
    "negative length": ("length 2.0", "length -2.0", 19, "expected a number of at least zero"),
    "NaN length": ("length 2.0", "length nan", 19, "expected a finite number"),
    "axis": ("axis 0 0 20 XYZ", "axis 0 0 XYZ", 20, "expected"),
    "axis order": ("axis 0 0 20 XYZ", "axis 0 0 20 XXZ", 20, "axis order 'XXZ'"),
    "dof": ("dof rx ry", "dof rx rw", 21, "dof 'rx rw', expected some of rx ry rz"),
    "limits": ("limits (-160.0 20.0)", "limits -160.0 20.0", 22, "expected pairs like"),
    "limits of words": ("limits (-160.0 20.0)", "limits (low high)", 22, "expected two numbers"),
    "too few limits": ("           (-70.0 70.0)\n", "", 23, "1 limits, expected 2"),
    "no length": ("    length 2.0\n", "", 23, "expected name, direction and length"),
    "bone twice": ("name lower", "name upper", 33, "'upper' stands twice"),
    "bone called root": ("name lower", "name root", 33, "'root' stands twice"),
    "begin twice": ("    id 2\n", "begin\n", 26, "begin inside a bone"),
    "no end": ("  end\n:hierarchy\n", ":hierarchy\n", 25, "'lower' has no end, expected one"),
    "outside": ("  begin\n    id 2\n", "    id 2\n", 25, "expected begin before it"),
    "unknown child": (
        "    upper lower",
        "    upper higher",
        37,
        "'higher' in the hierarchy, expected one of the bones",
    ),
    "unknown parent": (
        "    upper lower",
        "    higher lower",
        37,
        "'higher' has children here, expected a bone with a parent",
    ),
    "two parents": ("    upper lower", "    upper lower\n    root lower", 38, "'lower' has two parents"),
    "left out": ("    upper lower\n", "", 25, "'lower' is not in the hierarchy"),
    "a circle": (
        "    root upper\n",
        "    lower upper\n",
        36,
        "'lower' has children here, expected a bone with a parent",
    ),
}


@pytest.mark.parametrize("case", ASF_CASES)
def test_a_malformed_asf(tmp_path, case):
    old, new, line, *expected = ASF_CASES[case]
    path = pair(tmp_path, asf=changed(ASF, old, new))
    with pytest.raises(MotionFileError) as caught:
        read_motion(path)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / '01.asf'}:{line}: ") and "\n" not in message, message
    for text in expected:
        assert text in message


def test_amc_without_its_skeleton(tmp_path):
    path = pair(tmp_path)
    (tmp_path / "01.asf").rename(tmp_path / "07.asf")
    assert len(read_motion(path)) == 2  # the only one in the folder
    (tmp_path / "08.asf").write_text(ASF)
    told(path, None, "2 ASF files beside it, none called 01.asf")
    for other in ("07.asf", "08.asf"):
        (tmp_path / other).unlink()
    told(path, None, "0 ASF files beside it, none called 01.asf")
    (tmp_path / "01.asf").write_text("")
    with pytest.raises(MotionFileError, match="01.asf: the file is empty"):
        read_motion(path)


@pytest.mark.parametrize("fill", ["(", "(a", "( a", ")", "a", "( a b ", "9"])
def test_limits_of_a_million_characters_end_soon(tmp_path, fill):
    path = pair(tmp_path, changed(ASF, "limits (-160.0 20.0)", "limits " + fill * (LONG // len(fill))))
    start = time.perf_counter()
    with pytest.raises(MotionFileError, match=r"01.asf:2[23]: ") as caught:
        read_motion(path)
    assert time.perf_counter() - start < 10 and len(str(caught.value)) < len(str(path)) + 200


@pytest.mark.parametrize("content", [b"", b"\0\1\2", b"a" * 2_000_000, b"root " + b"1 " * 600_000, b"\xff\xfe\xfd"])
def test_an_amc_that_is_none(tmp_path, content):
    path = pair(tmp_path)
    path.write_bytes(content)
    with pytest.raises(MotionFileError):
        read_motion(path)


# -- whatever else may happen to a file ----------------------------------------------------------------------

WORDS = """nan inf - 1e999 1e-999 1e8 -1e8 0 1,5 { } # : ' " 0x1 -1 1e-300 3 6 ( ) ROOT JOINT End Site MOTION OFFSET
CHANNELS Xrotation Zposition begin end :root root dof rx"""
JUNK = st.sampled_from([*WORDS.split(), "\u00b2", "\x85", "\u2028", "\x1c", "\x0c", "\ufeff", "\ud800", "9" * 400, ""])


@st.composite
def damaged(draw, text: str) -> str:
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["delete", "double", "swap", "cut", "word", "insert"]))
        lines = text.split("\n")
        n = draw(st.integers(0, len(lines) - 1))
        words = lines[n].split(" ")
        w = draw(st.integers(0, len(words) - 1))
        if kind == "delete":
            del lines[n]
        elif kind == "double":
            lines.insert(n, lines[n])
        elif kind == "swap":
            m = draw(st.integers(0, len(lines) - 1))
            lines[n], lines[m] = lines[m], lines[n]
        elif kind == "cut":
            lines = [text[: draw(st.integers(0, len(text)))]]
        elif kind == "word":
            words[w] = draw(JUNK)
            lines[n] = " ".join(words)
        else:
            words.insert(w, draw(JUNK))
            lines[n] = " ".join(words)
        text = "\n".join(lines)
    return text


def reads_or_is_refused(path):
    """Success gives finite motion; refusal is a ``MotionFileError`` of one printable line; nothing warns."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            motion = read_motion(path)
        except MotionFileError as error:
            assert str(error).replace(str(path.parent), "").isprintable()
            assert "expected" in str(error)
            return
    assert np.isfinite(motion.positions).all() and len(motion) >= 1 and motion.fps > 0


FUZZ = settings(max_examples=250, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


@FUZZ
@given(text=damaged(ARM))
def test_a_damaged_bvh_reads_or_is_refused(tmp_path_factory, text):
    folder = tmp_path_factory.getbasetemp()
    reads_or_is_refused(bvh(folder, text, "damaged.bvh"))


@FUZZ
@given(asf=st.one_of(st.just(ASF), damaged(ASF)), amc=st.one_of(st.just(AMC), damaged(AMC)))
def test_a_damaged_amc_reads_or_is_refused(tmp_path_factory, asf, amc):
    folder = tmp_path_factory.getbasetemp() / "damaged"
    folder.mkdir(exist_ok=True)
    (folder / "01.asf").write_bytes(asf.encode("utf-8", "surrogatepass"))
    path = folder / "01_01.amc"
    path.write_bytes(amc.encode("utf-8", "surrogatepass"))
    reads_or_is_refused(path)


@FUZZ
@given(content=st.binary(max_size=300))
def test_any_bytes_are_refused(tmp_path_factory, content):
    path = bvh(tmp_path_factory.getbasetemp(), content, "bytes.bvh")
    with pytest.raises(MotionFileError):
        read_motion(path)
