"""Reading numbers out of text files quickly, and saying which line is wrong when one is."""

from __future__ import annotations

import os
import pathlib
import re
from dataclasses import dataclass

import numpy as np

from ..errors import MotionFileError

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"\d{1,9}", re.ASCII)
LARGEST = 1e9  # no body is so large in any unit, and squares of it are still far from overflowing
LONGEST_LINE = 1_000_000  # characters; a row of 500 joints' channels has fewer than 50,000


@dataclass(frozen=True)
class Text:
    """A text file's lines, without their ends."""

    lines: list[str]


def read_text(path: str | os.PathLike) -> Text:
    """A text file's lines, whatever its line ends, with or without a byte order mark."""
    path = pathlib.Path(path)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise MotionFileError(path, "no such file, expected a motion file there") from None
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise MotionFileError(
            path, f"cannot be read ({getattr(error, 'strerror', error)}), expected a motion file"
        ) from None
    if not raw.strip():
        raise MotionFileError(path, "the file is empty, expected a motion")
    if b"\0" in raw[:65536]:
        raise MotionFileError(path, "a binary file, expected text")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")  # joint names in an old Windows encoding; numbers are the same
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if not lines[-1]:
        lines.pop()  # the end of the last line, not a line after it
    for n, line in enumerate(lines, 1):
        if len(line) > LONGEST_LINE:
            what = f"a line of {len(line):,} characters, expected at most {LONGEST_LINE:,} in a motion file"
            raise MotionFileError(path, what, n)
    return Text(lines)


def shown(text: str, width: int = 40) -> str:
    """``text`` in quotes, cut so that an error stays one short line."""
    text = " ".join(text[: 4 * width].split())
    return repr(text if len(text) <= width else text[:width] + "...")


def number(word: str) -> float | None:
    """The number that ``word`` is, else None: no NaN, infinity, decimal comma or underscore, none past 1e9."""
    if _NUMBER.fullmatch(word) is None:
        return None
    value = float(word)
    return value if abs(value) < LARGEST else None


def whole(word: str) -> int | None:
    """The whole number of at most nine digits that ``word`` is, else None."""
    return int(word) if _WHOLE.fullmatch(word) else None


def numbers(path, line: int, words: list[str], count: int, what: str) -> list[float]:
    """``count`` finite numbers from ``words``; ``MotionFileError`` says which word is not one."""
    if len(words) != count:
        raise MotionFileError(path, f"{what}: {len(words)} numbers, expected {count}", line)
    values = []
    for word in words:
        value = number(word)
        if value is None:
            raise MotionFileError(path, f"{what}: {shown(word)}, expected a finite number below 1e9, like -1.5", line)
        values.append(value)
    return values


def numbers_table(path, text: Text, first: int, columns: int, rows: int) -> np.ndarray:
    """``(rows, columns)`` numbers from the lines after the first ``first``; blank lines do not count."""
    lines = text.lines[first:]
    while lines and not lines[-1].strip():
        lines.pop()
    try:
        if not lines:
            raise ValueError
        values = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
        if values.shape == (rows, columns) and np.abs(values).max() < LARGEST:  # false for NaN, too
            return values
    except ValueError:  # a word that is no number, or rows of different lengths
        pass
    return _parse_slow(path, lines, first, columns, rows)


def _parse_slow(path, lines: list[str], first: int, columns: int, rows: int) -> np.ndarray:
    """Line by line, to name the first one that is wrong."""
    table = []
    for n, raw in enumerate(lines, first + 1):
        words = raw.split()
        if not words:
            continue
        if len(table) == rows:
            raise MotionFileError(path, f"a row after the last of {rows} frames, expected the end of the file", n)
        if len(words) != columns:
            raise MotionFileError(path, f"{len(words)} numbers in the row, expected {columns}, one a channel", n)
        table.append(numbers(path, n, words, columns, f"frame {len(table) + 1}"))
    if len(table) != rows:
        raise MotionFileError(
            path, f"the file ends after {len(table)} frames, expected {rows} as Frames: says", first + len(lines)
        )
    return np.array(table, dtype=np.float64).reshape(rows, columns)
