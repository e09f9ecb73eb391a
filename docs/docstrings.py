"""This project's docstrings as reStructuredText: parameters stand as ``name: text`` or ``name : text``, a line each.

Sphinx reads continuation lines of such a paragraph as block quotes, and NumPy's ``name : type`` is not what is meant.
"""

from __future__ import annotations

import re

ITEM = re.compile(r"^(`{0,2}[A-Za-z_][\w.]*`{0,2}(?:(?:, | and )`{0,2}[A-Za-z_][\w.]*`{0,2})*) ?: +(\S.*)$")


def as_list(lines: list[str]) -> list[str]:
    """The lines with each run of parameters as a list, and underlined heads (Parameters, Raises) in bold."""
    made: list[str] = []
    inside = False  # of a list
    for number, line in enumerate(lines):
        following = lines[number + 1] if number + 1 < len(lines) else ""
        before = lines[number - 1] if number else ""
        if re.fullmatch(r"-{3,}", line) and before.strip():
            made[-1] = f"**{before.strip()}**"
            made.append("")
            inside = True
            continue
        item = ITEM.match(line)
        starts = number > 0 and (not before.strip() or inside)
        if number and item and (starts or ITEM.match(before) or _is_list(following)):
            if not inside and made and made[-1].strip():
                made.append("")
            made.append(f"-   **{item[1].replace('`', '')}**: {item[2]}")
            inside = True
        elif inside and line[:1].isspace() and line.strip():
            made.append("    " + line.strip() if not line.startswith("     ") else line)
        else:
            if inside and line.strip():
                if made and made[-1].strip():
                    made.append("")
                inside = False
            made.append(line)
    return made


def _is_list(line: str) -> bool:
    return bool(ITEM.match(line)) or (line.startswith("    ") and bool(line.strip()))


def process(app, what, name, obj, options, lines: list[str]) -> None:
    """What autodoc calls with each docstring."""
    lines[:] = as_list(lines)
