"""A result of ``reproduce side-by-side`` to be read: one table of all systems, and those behind it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..view.tables import ErrorTable, error_table
from . import results
from .failures import RULES
from .results import RESULTS, Result, mean_of, numbers, seeds_note
from .side_by_side_measure import FUTURE_TIMES
from .side_by_side_plan import SYSTEMS

RESULT = RESULTS / "side_by_side.json"
SCHEMA = 1
STOPS = ("freezing", "stuck")  # of the rules; the others find who leaves human poses
COLUMNS = (
    "80 ms, cm", "320 ms, cm", "640 ms, cm", "moves, %", "m/s", "stops, %", "leaves, %", "feet, cm", "bones, %",
    "futures, cm", "off path, cm", "weights, k", "steps", "core s", "ms a frame",
)  # fmt: skip
SHOWN_MS = (80, 320, 640)


def load_result(path: str | os.PathLike | None = None) -> dict[str, Any]:
    """A result that ``reproduce side-by-side`` wrote; by default the one that comes with the library.

    Raises :class:`DataError` for a file that is missing or is no such result.
    """
    return results.load_result(RESULT if path is None else path, "side-by-side", SCHEMA)


# --- what a result says ---------------------------------------------------------------------------


def runs_of(result: Result, label: str) -> list[dict[str, Any]]:
    """The runs of one system, one a training seed; empty if there is none."""
    return [run for run in result["runs"].values() if run["label"] == label]


def value(result: Result, label: str, *keys: str) -> np.ndarray | None:
    """A number of a run, or an array of them, mean over training seeds: ``value(result, "aclstm", "flaws", "bones")``.

    NaN where it is not finite. None without such a run.
    """
    found = []
    for run in runs_of(result, label):
        for key in keys:
            run = run[key]
        found.append(numbers(run))
    return np.mean(found, axis=0) if found else None


def error(result: Result, label: str, at_ms: int, kind: str = "error") -> float:
    """Mean distance of a joint, cm, ``at_ms`` after the seed; NaN where there is none."""
    found = value(result, label, kind)
    return math.nan if found is None else float(found[result["protocol"]["times_ms"].index(at_ms)])


def failed(result: Result, label: str, rules: Sequence[str] = tuple(RULES)) -> float:
    """Share of the motions of which the first failure is by one of these rules; NaN without such a run."""
    firsts = [first for run in runs_of(result, label) for first in run["failures"]["first"]]
    return sum(first is not None and first[0] in rules for first in firsts) / len(firsts) if firsts else math.nan


def off_path(result: Result, label: str, moved: str = "mean") -> float | None:
    """Metres from the prepared paths, mean over them; None for a system that goes where it likes.

    moved: by the control that it was told ("mean"), or by the one that it puts out itself ("predicted").
    """
    found = [run["paths"] for run in runs_of(result, label) if run["paths"]]
    each = numbers([p["deviation"][moved] for paths in found for p in paths.values()])
    return float(np.mean(each)) if found else None


# --- tables ---------------------------------------------------------------------------------------


def tables(result: Result) -> dict[str, ErrorTable]:
    """The one table, and what stands behind it.

    "side by side": all systems, the columns :data:`COLUMNS`. "errors", "pose errors" and "standard errors" at all
    times; "long run"; "failures"; "futures"; "paths" where a system follows any.
    """
    columns = [f"{ms} ms" for ms in result["protocol"]["times_ms"]]
    note, data = _note(result), " + ".join(result["data_sets"])
    found = {"side by side": _side_by_side(result, data, note)}
    for name, kind, caption in (
        ("errors", "error", "Mean distance of a joint from the truth, in the world"),
        ("pose errors", "pose_error", "The same about the root: the pose alone"),
        (
            "standard errors",
            "standard_error",
            f"Standard errors of the first, over {result['protocol']['seeds']} seeds",
        ),
    ):
        learnt = {row.title: value(result, label, kind) for label, row in _there(result)}
        simple = {name: _reference(result, name, kind) for name in _references(result)}
        best = None if name == "standard errors" else "lowest"
        found[name] = error_table(columns, {data: learnt, "nothing learnt": simple}, caption=caption + note, unit="cm",
                                  best=best)  # fmt: skip
    found["long run"] = _long_run(result, data)
    found["failures"] = _failures(result, data)
    found["futures"] = _futures(result, data)
    if (paths := _paths(result)) is not None:
        found["paths"] = paths
    return found


def _note(result: Result) -> str:
    budget = result["budget"]
    note = f"; {budget['hidden']} cells a layer"
    note += seeds_note(len(runs_of(result, label)) for label in SYSTEMS)
    note += "; SAMPLE MOTIONS, not captured" if result["data"] == "samples" else ""
    return note + ("; QUICK TRIAL, nothing is learnt" if result["quick"] else "")


def _there(result: Result) -> list[tuple[str, Any]]:
    return [(label, row) for label, row in SYSTEMS.items() if runs_of(result, label)]


def _references(result: Result) -> list[str]:
    return list(next(iter(result["splits"].values()))["references"]) if result["splits"] else []


def _reference(result: Result, name: str, kind: str = "error") -> np.ndarray:
    return np.mean([numbers(split["references"][name][kind]) for split in result["splits"].values()], axis=0)


def _true(result: Result, key: str) -> float:
    return mean_of(split["true"][key] for split in result["splits"].values())


def _side_by_side(result: Result, data: str, note: str) -> ErrorTable:
    rows: dict[str, list[str | float | None]] = {}
    for label, row in _there(result):
        off = off_path(result, label)
        steps = runs_of(result, label)[0]["recipe"]["steps"]
        rows[row.title] = [
            *(_text(error(result, label, ms), 1) for ms in SHOWN_MS),
            _text(100 * value(result, label, "moves")[-1], 0),
            _text(value(result, label, "speed"), 2),
            _text(100 * failed(result, label, STOPS), 0),
            _text(100 * (failed(result, label) - failed(result, label, STOPS)), 0),
            _text(value(result, label, "flaws", "foot_slide"), 1),
            _text(value(result, label, "flaws", "bones"), 1),
            _text(value(result, label, "futures", "pose")[-1], 1),
            None if off is None else _text(100 * off, 1),
            _text(value(result, label, "parameters") / 1000, 0),
            str(steps),
            _text(value(result, label, "core_seconds"), 0),
            _text(value(result, label, "ms"), 1),
        ]  # fmt: skip
    times = [result["protocol"]["times_ms"].index(ms) for ms in SHOWN_MS]
    rest = [None] * (len(COLUMNS) - len(SHOWN_MS))
    compare: dict[str, list[str | float | None]] = {
        name: [*(_text(e, 1) for e in _reference(result, name)[times]), *rest] for name in _references(result)
    }
    true = [None] * len(COLUMNS)
    for column, (text, digits) in {
        "moves, %": (100.0, 0), "m/s": (_true(result, "speed"), 2), "feet, cm": (_true(result, "foot_slide"), 1),
        "bones, %": (_true(result, "bones"), 1),
    }.items():  # fmt: skip
        true[COLUMNS.index(column)] = _text(text, digits)
    compare["people"] = true
    return error_table(COLUMNS, {data: rows, "to compare": compare}, best=None,
                       caption=f"All systems side by side{note}; core s and ms depend on the machine")  # fmt: skip


def _text(number: float, digits: int) -> str | None:
    """None for what is not finite; what has exploded in two digits."""
    if not math.isfinite(number):
        return None
    return f"{float(number):.{digits}f}" if abs(number) < 1e4 else f"{float(number):.1e}"


def _long_run(result: Result, data: str) -> ErrorTable:
    protocol = result["protocol"]
    some = [value(result, label, "moves") for label, _ in _there(result)]
    count = len(some[0]) if some else 0
    seconds = protocol["frames"] / protocol["fps"] / max(1, count)
    return error_table(
        [f"to {seconds * (k + 1):.0f} s" for k in range(count)],
        {data: {row.title: 100 * value(result, label, "moves") for label, row in _there(result)}},
        caption="Motion change after the seed, per cent of the true one", digits=0, best=None,
    )  # fmt: skip


def _failures(result: Result, data: str) -> ErrorTable:
    rows = {}
    for label, row in _there(result):
        each = [run["failures"] for run in runs_of(result, label)]
        latest = [f["latest"]["seconds"] for f in each if f["latest"]]
        rows[row.title] = [
            *(sum(f["rules"][rule]["count"] for f in each) for rule in RULES), sum(f["count"] for f in each),
            max(latest, default=None), sum(f["stagnations"]["count"] for f in each),
        ]  # fmt: skip
    protocol = result["protocol"]
    return error_table(
        [*RULES, "any", "latest (s)", "stagnations"], {data: rows}, digits=0, best=None,
        caption=f"Failures by rule in {protocol['seeds']} motions of {protocol['frames']} frames",
    )  # fmt: skip


def _futures(result: Result, data: str) -> ErrorTable:
    columns = [f"{kind}, {seconds:g} s" for kind in ("place", "pose") for seconds in FUTURE_TIMES]
    rows = {
        row.title: [
            *value(result, label, "futures", "place"), *value(result, label, "futures", "pose"),
            value(result, label, "futures", "mean"), value(result, label, "futures", "best"),
        ]
        for label, row in _there(result)
    }  # fmt: skip
    return error_table(
        [*columns, "error, 640 ms", "of the best"], {data: rows}, digits=1, best=None, unit="cm",
        caption=f"How far {result['protocol']['futures']} futures of one beginning are apart, and the one nearest to "
        "what came",
    )  # fmt: skip


def _paths(result: Result) -> ErrorTable | None:
    rows = {}
    for label, row in _there(result):
        runs = [run["paths"] for run in runs_of(result, label) if run["paths"]]
        for path in runs[0] if runs else ():
            told = numbers([run[path]["deviation"]["mean"] for run in runs])
            own = numbers([run[path]["deviation"]["predicted"] for run in runs])
            gait = [[run[path][when][key] for run in runs] for when, key in (
                ("before", "step_length"), ("before", "slide"), ("after", "slide"))]  # fmt: skip
            rows[f"{row.title}, {path}"] = [100 * told.mean(), 100 * own.mean(), 100 * numbers(gait[0]).mean(),
                                            *(numbers(each).mean() for each in gait[1:])]  # fmt: skip
    if not rows:
        return None
    return error_table(
        ["as told", "by its own", "a step", "slides", "cleaned up"], {"off the path, and how it steps": rows},
        caption=f"Told to walk a path at {result['protocol']['pace']:g} m/s", unit="cm", digits=1, best=None,
    )  # fmt: skip
