"""``error_table``: our numbers and the paper's, one above the other, for terminals, notebooks and Markdown."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from ..errors import TutorialError

OURS, PAPER = "ours", "paper"
_NONE = "–"
Values = Sequence[float | str | None]


def error_table(
    columns: Sequence[str],
    ours: Mapping[str, Mapping[str, Values]],
    paper: Mapping[str, Mapping[str, Values]] | None = None,
    *,
    caption: str = "",
    unit: str = "",
    digits: int = 2,
    best: str | None = "lowest",
) -> ErrorTable:
    """The table of a paper with the paper's own numbers beneath ours, to be the last line of a cell or printed.

    columns: a head for each number, ``["80 ms", "160 ms", ...]``.
    ours, paper: ``{group: {row: numbers}}``, such as ``{"Walking": {"acLSTM": [1.05, 1.77, ...]}}``; one number
        a column, None or NaN where there is none; a number as text (``"0.685"``) is kept as it is written.
        Rows that only one of the two has are shown with what there is. A group named ``""`` has no line of its own.
    unit: what the numbers are in, put after the caption. digits: after the point.
    best: ``"lowest"`` or ``"highest"`` of each column of a group is emphasised, among ours and among the paper's
        each for itself, ties together; None for neither.
    Raises ``TutorialError`` for a row that has not one number a column.
    """
    if best not in ("lowest", "highest", None):
        raise TutorialError(f"error_table: best {best!r}, expected 'lowest', 'highest' or None")
    columns = [str(c) for c in columns]
    for who, groups in ((OURS, ours), (PAPER, paper or {})):
        for group, rows in groups.items():
            for row, values in rows.items():
                if len(values) != len(columns):
                    raise TutorialError(
                        f"error_table: {len(values)} numbers for {row!r} of {group!r} ({who}), "
                        f"expected {len(columns)}, one a column"
                    )
    groups = {}
    for group in dict.fromkeys([*ours, *(paper or {})]):
        mine, theirs = ours.get(group, {}), (paper or {}).get(group, {})
        sources = {OURS: _emphasised(mine, digits, best), PAPER: _emphasised(theirs, digits, best)}
        groups[group] = [
            (row, who, sources[who][row])
            for row in dict.fromkeys([*mine, *theirs])
            for who in (OURS, PAPER)
            if row in sources[who]
        ]
    heading = f"{caption} ({unit})" if caption and unit else caption or unit
    return ErrorTable(heading, columns, groups, compared=paper is not None)


@dataclass(frozen=True)
class ErrorTable:
    """What ``error_table`` returns: text where it is printed, a plain HTML table in a notebook, ``.markdown()``.

    groups: ``{group: [(row, "ours" or "paper", [(number as text, whether it is the best), ...]), ...]}``.
    """

    caption: str
    columns: list[str]
    groups: dict[str, list[tuple[str, str, list[tuple[str, bool]]]]]
    compared: bool = field(default=False)

    def __str__(self) -> str:
        """For a terminal; the best of each column has a star."""
        lines = [["", *([""] if self.compared else []), *self.columns]]
        for group, rows in self.groups.items():
            lines += [[group]] if group else []
            before = None
            for row, who, numbers in rows:
                name = "  " + row if row != before else ""
                lines.append([name, *([who] if self.compared else []), *(f"*{n}" if b else n for n, b in numbers)])
                before = row
        whole = [line for line in lines if len(line) > 1]
        widths = [max(len(line[k]) for line in whole) for k in range(len(whole[0]))]
        lead = 2 if self.compared else 1
        text = []
        for line in lines:
            if len(line) == 1:
                text.append(line[0])
                continue
            cells = [c.ljust(w) if k < lead else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True))]
            text.append("  ".join(cells).rstrip())
        starred = any(best for rows in self.groups.values() for *_, numbers in rows for _, best in numbers)
        return "\n".join([self.caption] * bool(self.caption) + text + ["* the best of its column"] * starred)

    __repr__ = __str__

    def markdown(self) -> str:
        """A table in GitHub's Markdown, without its caption; the best of each column is bold."""
        heads = ["", *([""] if self.compared else []), *self.columns]
        lines = []
        for group, rows in self.groups.items():
            lines += [[f"**{group}**", *[""] * (len(heads) - 1)]] if group else []
            lines += self._rows(rows, str, lambda text: f"**{text}**")
        return markdown_table(heads, lines, right=range(len(heads) - len(self.columns), len(heads)))

    def only(self, rows: Sequence[str] = (), columns: Sequence[str] = ()) -> ErrorTable:
        """Some rows and columns, as they stand in the whole; none named: all.

        Raises ``TutorialError`` for a name that is not there.
        """
        kept = [self.columns.index(c) for c in columns if c in self.columns] if columns else range(len(self.columns))
        groups = {
            group: [(row, who, [numbers[k] for k in kept]) for row, who, numbers in lines if not rows or row in rows]
            for group, lines in self.groups.items()
        }
        found = {row for lines in groups.values() for row, *_ in lines}
        for name in (*(row for row in rows if row not in found), *(c for c in columns if c not in self.columns)):
            raise TutorialError(f"the table {self.caption!r} has no {name!r}")
        return ErrorTable(self.caption, [self.columns[k] for k in kept], groups, compared=self.compared)

    def _repr_html_(self) -> str:
        """Tags only, no styles: a notebook that is not trusted loses those."""
        heads = "".join(f"<th>{html.escape(c)}</th>" for c in ["", *([""] if self.compared else []), *self.columns])
        span = len(self.columns) + 1 + self.compared
        body = []
        for group, rows in self.groups.items():
            if group:
                # in a div, since a notebook's own style sets every th's text to the right
                name = f'<div align="left">{html.escape(group)}</div>'
                body.append(f'<tr><th colspan="{span}">{name}</th></tr>')
            for name, *cells in self._rows(rows, html.escape, lambda text: f"<b>{text}</b>"):
                cells = "".join(f'<td align="right">{cell}</td>' for cell in cells)
                body.append(f'<tr><td align="left">{name}</td>{cells}</tr>')
        caption = f"<caption>{html.escape(self.caption)}</caption>" if self.caption else ""
        return f"<table>{caption}<thead><tr>{heads}</tr></thead><tbody>{''.join(body)}</tbody></table>"

    def _rows(self, rows: Sequence, written: Callable[[str], str], strong: Callable[[str], str]) -> list[list[str]]:
        """The cells of a group's rows; a row's name stands at its first line only."""
        lines, before = [], None
        for row, who, numbers in rows:
            name = written(row) if row != before else ""
            lines.append([name, *([who] if self.compared else []), *(strong(n) if b else n for n, b in numbers)])
            before = row
        return lines


def markdown_table(heads: Sequence[str], lines: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> str:
    """A table in GitHub's Markdown; ``right``: the columns that are aligned there, as numbers are."""
    rule = ["---:" if k in right else "---" for k in range(len(heads))]
    cells = [[str(cell).replace("|", "\\|") for cell in line] for line in (heads, *lines)]
    return "".join(f"| {' | '.join(line)} |\n" for line in (cells[0], rule, *cells[1:]))


def _emphasised(rows: Mapping[str, Values], digits: int, best: str | None) -> dict[str, list[tuple[str, bool]]]:
    """Each row's numbers as text, and whether each is the best of its column (as written: ties count)."""
    texts = {row: [_text(v, digits) for v in values] for row, values in rows.items()}
    choose = {"lowest": min, "highest": max, None: None}[best]
    columns = list(zip(*texts.values(), strict=True))
    goal = []
    for column in columns:
        numbers = [float(t) for t in column if t != _NONE and math.isfinite(float(t))]
        goal.append(choose(numbers) if choose and len(numbers) > 1 else None)
    return {
        row: [(t, g is not None and t != _NONE and float(t) == g) for t, g in zip(cells, goal, strict=True)]
        for row, cells in texts.items()
    }


def _text(value: float | str | None, digits: int) -> str:
    if isinstance(value, str):
        return value
    return _NONE if value is None or math.isnan(value) else f"{float(value):.{digits}f}"
