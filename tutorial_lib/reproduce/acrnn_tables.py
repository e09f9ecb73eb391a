"""A result of ``reproduce acrnn`` to be read: tables with the paper's numbers beside ours, its findings, figures."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..metrics import standard_error
from ..view.plots import motion_change_plot
from ..view.tables import ErrorTable, error_table
from . import results
from .acrnn_plan import DANCE, STYLES, SYSTEMS, label
from .failures import RULES
from .published import ACRNN_TABLE_1, ACRNN_TABLE_2
from .results import RESULTS, Finding, Result, large, numbers, seeds_note

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULT = RESULTS / "acrnn.json"
WIDER_RESULT = RESULTS / "acrnn_wider.json"  # a second budget: which findings hang on the first?
SCHEMA = 1
TABLE_2_ROWS = {
    label(10, 10): "c-length 10",
    label(5, 5): "c-length 5",
    label(2, 2): "c-length 2",
    label(1, 1): "c-length 1",
    "scheduled-sampling": SYSTEMS["scheduled-sampling"].title,
}


# --- files ----------------------------------------------------------------------------------------


def load_result(path: str | os.PathLike | None = None) -> dict[str, Any]:
    """A result that ``reproduce acrnn`` wrote; by default the one that comes with the library.

    Raises :class:`DataError` for a file that is missing or is no such result.
    """
    return results.load_result(RESULT if path is None else path, "acrnn", SCHEMA)


# --- what a result says ---------------------------------------------------------------------------


def runs_of(result: Result, style: str, label: str) -> list[dict[str, Any]]:
    """The runs of one cell, one a training seed; empty if there is none."""
    return [run for run in result["runs"].values() if (run["style"], run["label"]) == (style, label)]


def error(result: Result, style: str, label: str) -> np.ndarray | None:
    """(8,) prediction error, mean over training seeds; NaN where it is not finite; None without such a run."""
    found = runs_of(result, style, label)
    return np.mean([numbers(run["error"]) for run in found], axis=0) if found else None


def last_frame_error(result: Result, style: str) -> np.ndarray:
    """(8,) error of repeating the seed's last frame, which needs no network: mean over the splits."""
    return np.mean([numbers(s["last_frame"]) for k, s in result["splits"].items() if k.split()[0] == style], axis=0)


def difference(result: Result, style: str, one: str, other: str) -> tuple[np.ndarray, np.ndarray] | None:
    """How much larger the error of ``one`` is than that of ``other``: (8,) mean and (8,) its standard error.

    Taken seed by seed, which both were shown alike, over all training seeds that both have. A difference of less than
    two standard errors says little. None without two such runs.
    """
    ones = {run["seed"]: numbers(run["errors"]) for run in runs_of(result, style, one)}
    others = {run["seed"]: numbers(run["errors"]) for run in runs_of(result, style, other)}
    pairs = [ones[seed] - others[seed] for seed in ones if seed in others]  # (8, seeds) each
    if not pairs:
        return None
    each = np.concatenate(pairs, axis=1).T
    return each.mean(0), standard_error(each)


def motion_change(result: Result, name: str) -> np.ndarray:
    """(frames,) the curve of a run after the seed, mean over the seeds, smoothed over 15 frames, in every frame.

    The result keeps each fifth frame; between them it is a straight line. Draw it with ``smooth=1``.
    """
    curve = result["runs"][name]["motion_change"]
    values = numbers(curve["values"])
    return np.interp(np.arange(curve["frames"]), np.arange(len(values)) * curve["every"], values)


def true_change(result: Result, style: str) -> float:
    """The motion change of a style's training clips, mean over the splits."""
    return float(np.mean([s["truth"]["change"] for k, s in result["splits"].items() if k.split()[0] == style]))


def pairs(result: Result, style: str = DANCE) -> dict[tuple[int, int], str]:
    """The acLSTM runs of a style at the first training seed: {(u, v): run name}, for the explorer; (1, 0): LSTM-3LR.

    With v = 0 every frame is the truth: teacher forcing is a corner of the grid.
    """
    first = min((run["seed"] for run in result["runs"].values()), default=0)
    found = {}
    for name, run in result["runs"].items():
        if run["style"] == style and run["seed"] == first:
            if run["u"] is not None:
                found[run["u"], run["v"]] = name
            elif run["system"] == "lstm":
                found[1, 0] = name
    return dict(sorted(found.items()))


def _title(result: Result, style: str) -> str:
    name = result["styles"][style]["data"]
    return STYLES[style].title + (f" (here {name})" if result["data"] == "samples" else "")


# --- tables ---------------------------------------------------------------------------------------


def tables(result: Result) -> dict[str, ErrorTable]:
    """The paper's tables with its numbers beneath ours, and what is to be known beside them.

    "table 1", "table 2" (with the Indian dance), "standard errors" of table 1's numbers, "differences" of acLSTM from
    each other system with their standard errors, "reference" (the last frame of the seed repeated), "training seeds"
    (lowest and highest, where there are several), "failures", "long".
    """
    columns = [f"{ms} ms" for ms in result["protocol"]["times_ms"]]
    styles = [s for s in result["styles"] if any(run["style"] == s for run in result["runs"].values())]
    rows = {s: {**SYSTEMS, **(TABLE_2_ROWS if s == DANCE else {})} for s in styles}
    counts = [len(runs_of(result, s, k)) for s in styles for k in rows[s]]  # a folder may be half finished
    several = max(counts, default=0) > 1
    note = f", {result['budget']['steps']} steps, {result['budget']['hidden']} cells a layer"
    note += ", mirrored clips too" if result["budget"].get("mirror") else ""
    note += seeds_note(counts)
    note += "; SAMPLE MOTIONS, not the paper's" if result["data"] == "samples" else ""
    note += "; QUICK TRIAL, nothing is learnt" if result["quick"] else ""
    found = {}
    found["table 1"] = error_table(
        columns,
        {_title(result, s): _rows(result, s, {k: row.title for k, row in SYSTEMS.items()}) for s in styles},
        {_title(result, s): {SYSTEMS[k].title: v for k, v in ACRNN_TABLE_1[s].items()} for s in styles},
        caption=f"Table 1: prediction error{note}",
    )
    if DANCE in styles:
        title = _title(result, DANCE)
        found["table 2"] = error_table(
            columns,
            {title: _rows(result, DANCE, TABLE_2_ROWS)},
            {title: {TABLE_2_ROWS[k]: v for k, v in ACRNN_TABLE_2.items()}},
            caption=f"Table 2: prediction error by condition length{note}",
        )
    found["standard errors"] = error_table(
        columns,
        {_title(result, s): {row.title: np.mean([numbers(r["standard_error"]) for r in runs_of(result, s, k)], axis=0)
                             for k, row in SYSTEMS.items() if runs_of(result, s, k)} for s in styles},
        caption=f"Standard error of {'one training seed' if several else 'table 1'}'s means, over "
        f"{result['protocol']['seeds']} seeds", best=None,
    )  # fmt: skip
    found["differences"] = error_table(
        columns,
        {_title(result, s): dict(_difference_rows(result, s)) for s in styles},
        caption="Error of acLSTM less that of the others, seed by seed, and the standard error of that", best=None,
    )  # fmt: skip
    found["reference"] = error_table(
        columns,
        {"last frame of the seed repeated": {_title(result, s): last_frame_error(result, s) for s in styles}},
        caption="For comparison: the error of no network at all",
        best=None,
    )
    if several:
        found["training seeds"] = error_table(
            columns,
            {_title(result, s): dict(_seed_rows(result, s)) for s in styles},
            caption="Table 1, the lowest and the highest of the training seeds", best=None,
        )  # fmt: skip
    found["failures"] = failure_table(result)
    if result["long"]:
        found["long"] = long_table(result)
    return found


def _rows(result: Result, style: str, titles: Mapping[str, str]) -> dict[str, np.ndarray]:
    return {title: found for k, title in titles.items() if (found := error(result, style, k)) is not None}


def _difference_rows(result: Result, style: str) -> Iterable[tuple[str, np.ndarray]]:
    for other, row in SYSTEMS.items():
        found = difference(result, style, "aclstm", other) if other != "aclstm" else None
        if found is not None:
            yield f"less {row.title}", found[0]
            yield f"  standard error ({row.title})", found[1]


def _seed_rows(result: Result, style: str) -> Iterable[tuple[str, np.ndarray]]:
    for system, row in SYSTEMS.items():
        found = runs_of(result, style, system)
        if found:
            each = np.array([numbers(run["error"]) for run in found])
            yield f"{row.title}, lowest", each.min(0)
            yield f"{row.title}, highest", each.max(0)


def failure_table(result: Result) -> ErrorTable:
    """Figure 7 in numbers: how many samples fail by each rule, and when the last does; all training seeds together."""
    groups: dict[str, dict[str, list[float | None]]] = {}
    for run in result["runs"].values():
        rows = groups.setdefault(_title(result, run["style"]), {})
        if run["label"] not in rows:
            found = [each["failures"] for each in runs_of(result, run["style"], run["label"])]
            rows[run["label"]] = [sum(f["samples"] for f in found), *_failure_row(*found)]
    return error_table(
        ["samples", *RULES, "any", "latest (s)", "stagnations"], groups, digits=0, best=None,
        caption=f"Failures in samples of {result['protocol']['frames']} frames",
    )  # fmt: skip


def long_table(result: Result) -> ErrorTable:
    """The same for the long samples; also the lowest motion change of any 10 s, as a percentage of the true one."""
    groups = {
        name: {f"{found['samples']} samples, seeds: {found['seeds']}": [
            *_failure_row(found), None if found["lowest"] is None else 100 * found["lowest"]]}
        for name, found in result["long"].items()
    }  # fmt: skip
    frames = next(iter(result["long"].values()))["frames"]
    return error_table(
        [*RULES, "any", "latest (s)", "stagnations", "lowest (%)"], groups, digits=0, best=None,
        caption=f"Failures in samples of {frames:,} frames",
    )  # fmt: skip


def _failure_row(*found: Mapping[str, Any]) -> list[float | None]:
    """Counts added up, and the latest of all."""
    counts = [sum(f["rules"][rule]["count"] for f in found) for rule in RULES]
    latest = [f["latest"]["seconds"] for f in found if f["latest"] is not None]
    stagnations = sum(f["stagnations"]["count"] for f in found)
    return [*counts, sum(f["count"] for f in found), max(latest, default=None), stagnations]


# --- findings -------------------------------------------------------------------------------------


def findings(result: Result) -> list[Finding]:
    """The findings of tables 1 and 2 and figures 2, 7 and 9, each held against the result.

    Which of two systems errs less is as the paper's own numbers have it: on walking they have the acLSTM behind. Here
    it is a comparison of means over the seeds; the differences' standard errors stand in the evidence.
    """
    found = []
    late = [k for k, ms in enumerate(result["protocol"]["times_ms"]) if ms >= 400]
    for style in result["styles"]:
        title = STYLES[style].title
        mine = {k: e for k in SYSTEMS if (e := error(result, style, k)) is not None}
        for other in ("lstm", "seq2seq"):
            papers = np.subtract(ACRNN_TABLE_1[style]["aclstm"], ACRNN_TABLE_1[style][other])[late]
            sign, word = (1, "more") if (papers > 0).all() else (-1, "less")
            claim = f"{title}: from 400 ms on acLSTM errs {word} than {SYSTEMS[other].title}"
            gap = difference(result, style, "aclstm", other)
            holds = None
            if gap is not None:
                apart = np.where(np.isfinite(gap[0]), gap[0], _more(mine["aclstm"], mine[other]))
                holds = bool((sign * apart[late] > 0).all())
            found.append(Finding(claim, holds, _gap(gap, late, sign)))
        claim = f"{title}: at 80 ms seq2seq errs least"
        found.append(_least(claim, {k: e[0] for k, e in mine.items()}, "seq2seq", min))
        if style != "walking":
            claim = f"{title}: at 640 ms seq2seq errs most"
            found.append(_least(claim, {k: e[-1] for k, e in mine.items()}, "seq2seq", max))
        if style == DANCE and len(mine) == len(SYSTEMS):
            times = sum(min(mine, key=lambda k: large(mine[k][t])) == "aclstm" for t in range(8))
            found.append(Finding(f"{title}: acLSTM errs least at most times", times > 4, f"at {times} of 8"))
    found += _condition_lengths(result)
    for style in result["styles"]:
        found += _failing(result, style)
    return found


def _more(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """1 where the one errs more, -1 where the other does, else 0."""
    return 1.0 * (large(one) > large(other)) - 1.0 * (large(one) < large(other))


def _gap(gap: tuple[np.ndarray, np.ndarray] | None, at: Sequence[int], sign: int) -> str:
    if gap is None:
        return "not measured"
    return "by " + ", ".join(f"{sign * gap[0][k]:.2f} ± {gap[1][k]:.2f}" for k in at)


def _least(claim: str, errors: Mapping[str, float], wanted: str, choose) -> Finding:
    if len(errors) < len(SYSTEMS):
        return Finding(claim, None, "not measured")
    first = choose(errors, key=lambda k: large(errors[k]))
    return Finding(claim, first == wanted, ", ".join(f"{SYSTEMS[k].title} {e:.2f}" for k, e in errors.items()))


def _condition_lengths(result: Result) -> list[Finding]:
    if DANCE not in result["styles"]:
        return []
    lengths = [label(n, n) for n in (10, 5, 2, 1)]
    errors = [error(result, DANCE, k) for k in (*lengths, "scheduled-sampling")]
    claims = (
        "Table 2: a longer condition length errs less, at all times",
        "Table 2: scheduled sampling errs more than every condition length, at all times",
        "Figure 9: a longer condition length moves less in the long run",
    )
    if any(e is None for e in errors):
        return [Finding(claim, None, "not measured") for claim in claims]
    means = ", ".join(f"{TABLE_2_ROWS[k]} {e.mean():.2f}" for k, e in zip(TABLE_2_ROWS, errors, strict=True))
    first = min((run["seed"] for run in result["runs"].values()), default=0)
    errors = [large(e) for e in errors]
    at_first = {r["label"]: n for n, r in result["runs"].items() if (r["style"], r["seed"]) == (DANCE, first)}
    moved = [float(np.mean(motion_change(result, at_first[k])[-300:])) for k in lengths if k in at_first]
    found = [
        Finding(claims[0], all(bool((a < b).all()) for a, b in zip(errors, errors[1:-1], strict=False)),
                f"mean over the times: {means}"),
        Finding(claims[1], all(bool((e < errors[-1]).all()) for e in errors[:-1]), f"mean over the times: {means}"),
    ]  # fmt: skip
    if len(moved) < len(lengths):  # the other seeds have what the first lacks
        return [*found, Finding(claims[2], None, "not measured")]
    said = f"last 300 frames, true {true_change(result, DANCE):.3f}: "
    said += ", ".join(f"{TABLE_2_ROWS[k]} {m:.3f}" for k, m in zip(lengths, moved, strict=True))
    return [*found, Finding(claims[2], all(a < b for a, b in zip(moved, moved[1:], strict=False)), said)]


# The paper's claims of failing: figure 2 (vanilla, martial arts and Indian dance), figure 7 (the others, Indian dance);
# acLSTM "never permanently failing" in any style.
FAILING = {"lstm": ("indian", "martial"), "erd": (DANCE,), "seq2seq": (DANCE,), "scheduled-sampling": (DANCE,)}


def _failing(result: Result, style: str) -> list[Finding]:
    found = []
    for system, row in SYSTEMS.items():
        if style not in FAILING.get(system, STYLES):
            continue
        claim = f"{STYLES[style].title}: {row.title} {'never fails' if system == 'aclstm' else 'fails'}"
        runs = [run["failures"] for run in runs_of(result, style, system)]
        if not runs:
            found.append(Finding(claim, None, "not measured"))
            continue
        failed, samples = sum(f["count"] for f in runs), sum(f["samples"] for f in runs)
        rules = {rule: sum(f["rules"][rule]["count"] for f in runs) for rule in RULES}
        by = ", ".join(f"{rule} {count}" for rule, count in rules.items() if count)
        holds = failed == 0 if system == "aclstm" else failed > 0
        found.append(Finding(claim, holds, f"{failed} of {samples} samples" + (f" ({by})" if by else "")))
    return found


# --- figures --------------------------------------------------------------------------------------


def figures(result: Result) -> dict[str, Figure]:
    """Figure 2 for each style and figure 9, from the curves in a result: {"figure-2-martial": figure}.

    Only what was measured is drawn, at the first training seed.
    """
    first = min((run["seed"] for run in result["runs"].values()), default=0)
    names = {(r["style"], r["label"]): name for name, r in result["runs"].items() if r["seed"] == first}
    found = {}
    for style in result["styles"]:
        curves = {SYSTEMS[k].title: motion_change(result, names[style, k])
                  for k in ("lstm", "aclstm") if (style, k) in names}  # fmt: skip
        if curves:
            title = f"Figure 2: {_title(result, style)}"
            found[f"figure-2-{style}"] = motion_change_plot(
                curves, truth=true_change(result, style), smooth=1, title=title
            )
    curves = {TABLE_2_ROWS[k]: motion_change(result, names[DANCE, k]) for k in TABLE_2_ROWS
              if k != "scheduled-sampling" and (DANCE, k) in names}  # fmt: skip
    if curves:
        title = f"Figure 9: {_title(result, DANCE)}"
        found["figure-9"] = motion_change_plot(curves, truth=true_change(result, DANCE), smooth=1, title=title)
    return found
