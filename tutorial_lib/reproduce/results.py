"""What the results of all papers have in common: the file, its head, the numbers in it, and findings."""

from __future__ import annotations

import datetime
import json
import math
import os
import pathlib
import platform
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import __version__
from ..atomic import atomic_write
from ..errors import DataError
from ..view.tables import ErrorTable

Result = Mapping[str, Any]

ONE_PAPER, ALL_PAPERS = "the paper finds", "the papers say"  # whose findings are told

RESULTS = pathlib.Path(__file__).with_name("results")  # those that come with the library


def head(paper: str, schema: int) -> dict[str, Any]:
    """The first entries of a result: the paper, the schema, what it was made with and when."""
    import torch

    return {
        "paper": paper,
        "schema": schema,
        "versions": {
            "tutorial_lib": __version__,
            "torch": torch.__version__.split("+")[0],
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
    }


def write_result(result: Result, path: str | os.PathLike) -> pathlib.Path:
    """Write a result as JSON, whole or not at all; rows of numbers in one line each."""
    path = pathlib.Path(path)
    text = json.dumps(result, indent=1, allow_nan=False)
    text = re.sub(r"\[(?:[^\[\]{}]|\[[^\[\]{}]*\])*\]", lambda found: " ".join(found[0].split()), text)
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    return path


def load_result(path: str | os.PathLike, paper: str, schema: int) -> dict[str, Any]:
    """A result that ``reproduce PAPER`` wrote. Raises :class:`DataError` for a file that is missing or is none."""
    path = pathlib.Path(path)
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(
            f"{path}: there is no such result; python -m tutorial_lib reproduce {paper} makes one"
        ) from None
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: not a result of reproduce {paper} ({' '.join(str(error).split())[:120]})") from None
    if not isinstance(result, dict) or result.get("paper") != paper or result.get("schema") != schema:
        raise DataError(f"{path}: not a result of reproduce {paper}, expected paper '{paper}' and schema {schema}")
    return result


# --- numbers --------------------------------------------------------------------------------------


def rounded(values: np.ndarray, digits: int = 5) -> list:
    """Plain numbers of so many digits; what is not finite becomes None."""
    values = np.asarray(values, dtype=float)
    if values.ndim > 1:
        return [rounded(row, digits) for row in values]
    return [float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in values]


def numbers(values: Any) -> np.ndarray:
    """An array of what a result has; None becomes NaN."""
    return np.array(values, dtype=float)


def seeds_note(counts: Iterable[int]) -> str:
    """How many training seeds a table is the mean of, to follow its caption; counts: runs of each row, as far as there
    are any. Nothing where no row has two."""
    counts = sorted(filter(None, counts))
    if not counts or counts[-1] < 2:
        return ""
    return f", mean of {f'{counts[0]} to ' if counts[0] < counts[-1] else ''}{counts[-1]} training seeds"


def number(value: float | None) -> float:
    """A number of a result; NaN for None."""
    return math.nan if value is None else float(value)


def mean_of(values: Iterable[float | None]) -> float:
    """The mean of those that are finite, such as the slides of clips in which a foot touches the ground; NaN for
    none."""
    each = numbers(list(values))
    each = each[np.isfinite(each)]
    return float(each.mean()) if len(each) else math.nan


def large(values: Any) -> np.ndarray:
    """Errors to be compared: what is not finite is as wrong as can be."""
    return np.nan_to_num(numbers(values), nan=np.inf, posinf=np.inf)


# --- findings -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Finding:
    """One thing that the paper finds, and whether this result finds it too.

    ours: None where runs that it needs are missing. evidence: numbers, in one line.
    """

    claim: str
    ours: bool | None
    evidence: str

    @property
    def answer(self) -> str:
        """yes, no, or - where it was not measured."""
        return {True: "yes", False: "no", None: "-"}[self.ours]

    def __str__(self) -> str:
        return f"{self.answer:<4}{self.claim}: {self.evidence}"


def tell_result(
    path: pathlib.Path,
    tables: Mapping[str, ErrorTable],
    findings: Iterable[Finding],
    figures: Mapping[str, Any],
    tell: Callable[[str], None],
    whose: str = ONE_PAPER,
) -> None:
    """Say what the result in ``path`` holds, and write its figures (those that are not None) beside it.

    whose: who finds the findings, the end of "What ...".
    """
    for line in report(tables, findings, whose):
        tell(line)
    for name, figure in figures.items():
        if figure is not None:
            figure.savefig(path.with_name(f"{path.stem}-{name}.png"), dpi=120)
    beside = " and the figures beside it" if figures else ""
    tell(f"wrote {path} ({path.stat().st_size / 1000:.0f} kB){beside}")


def report(tables: Mapping[str, ErrorTable], findings: Iterable[Finding], whose: str = ONE_PAPER) -> list[str]:
    """All of it for a terminal."""
    lines = []
    for table in tables.values():
        lines += [*str(table).splitlines(), ""]
    lines.append(f"What {whose}, and whether it is so here:")
    return [*lines, *map(str, findings)]
