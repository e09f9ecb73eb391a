"""A result of ``reproduce vae-lstm`` to be read: tables with the paper's numbers beside ours."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..view.tables import ErrorTable, error_table
from . import results
from .published import VAE_LSTM_TABLE_1, VAE_LSTM_TABLE_2
from .results import RESULTS, Result, mean_of, numbers, seeds_note
from .vae_lstm_measure import GIVEN, GIVEN_LONG, HELD, PER_STEP, POSTERIOR, PREDICTED, PRIOR
from .vae_lstm_plan import BASELINES, SYSTEMS, VAE

RESULT = RESULTS / "vae_lstm.json"
SCHEMA = 2  # 1: steps were told by how far a foot swings, and people walked without sway
VAE_PRIOR = "vae-lstm-prior"  # the paper's last row
# The rows of both tables: the paper's name, ours of the system, and how it was asked.
ROWS_1 = {**{name: (name, PREDICTED) for name in BASELINES}, VAE: (VAE, POSTERIOR), VAE_PRIOR: (VAE, PRIOR)}
ROWS_2 = {**ROWS_1, **{name: (name, GIVEN) for name in BASELINES}}
CM, CM2 = 1e2, 1e4  # in a metre, in a square metre


def load_result(path: str | os.PathLike | None = None) -> dict[str, Any]:
    """A result that ``reproduce vae-lstm`` wrote; by default the one that comes with the library.

    Raises :class:`DataError` for a file that is missing or is no such result.
    """
    return results.load_result(RESULT if path is None else path, "vae-lstm", SCHEMA)


# --- what a result says ---------------------------------------------------------------------------


def runs_of(result: Result, label: str) -> list[dict[str, Any]]:
    """The runs of one system, one a training seed; empty if there is none."""
    return [run for run in result["runs"].values() if run["label"] == label]


def error(result: Result, label: str, way: str, kind: str = "pose", measure: str = "error") -> np.ndarray | None:
    """(5,) at the paper's frames, mean over training seeds; NaN where it is not finite; None without such a run.

    label: "vae-lstm", "erd", "lstm", "crbm-cd1", "crbm-cd15", or the references "mean pose" and "last pose". way: how
    it was asked, a key of a run's ``ways``. kind: "pose", "motion", or "motion_given", the motion error were the
    control the true one. measure: "error" in metres, "squared" in square metres, or their standard errors.
    """
    asked = [split["references"].get(label, {}) for split in result["splits"].values()]
    asked += [run["ways"] for run in runs_of(result, label)]
    found = [numbers(ways[way][kind][measure]) for ways in asked if way in ways]
    return np.mean(found, axis=0) if found else None


def paper_row(result: Result, table: int, row: str, measure: str = "squared") -> np.ndarray | None:
    """(5,) ours in the place of a row of the paper's table 1 or 2."""
    label, way = (ROWS_1 if table == 1 else ROWS_2)[row]
    return error(result, label, way, "motion" if table == 1 else "pose", measure)


def title(row: str) -> str:
    """A row's name in the tables."""
    return f"{SYSTEMS[VAE].title} (prior sample)" if row == VAE_PRIOR else SYSTEMS[row].title


# --- tables ---------------------------------------------------------------------------------------


def tables(result: Result) -> dict[str, ErrorTable]:
    """The paper's tables with its numbers beneath ours, and what is to be known beside them.

    "table 1", "table 2": mean squared errors, ours in square centimetres, the paper's in the unit that it does not
    tell; "ratios": the same against the VAE-LSTM's, which have no unit. "table 1 in cm", "table 2 in cm": mean
    distances, with what the paper has not; "standard errors" of these. "samples", "interpolation", "paths", "feet",
    "speed": what the paper has not. "training".
    """
    columns = [f"frame {frame}" for frame in result["protocol"]["at"]]
    note = _note(result)
    found = {}
    for number, published, what in (
        (1, VAE_LSTM_TABLE_1, "motion error"), (2, VAE_LSTM_TABLE_2, "pose error, true control given to all")
    ):  # fmt: skip
        found[f"table {number}"] = error_table(
            columns,
            {_data(result): {title(row): CM2 * values for row in published
                             if (values := paper_row(result, number, row)) is not None}},
            {_data(result): {title(row): values for row, values in published.items()}},
            caption=f"Table {number}: {what}, mean squared{note}", unit="ours cm², the paper tells no unit",
        )  # fmt: skip
    found["ratios"] = error_table(
        columns,
        {f"Table {n}": _ratios({row: paper_row(result, n, row) for row in ROWS_1}) for n in (1, 2)},
        {"Table 1": _ratios(VAE_LSTM_TABLE_1), "Table 2": _ratios(VAE_LSTM_TABLE_2)},
        caption="Mean squared errors as multiples of the VAE-LSTM's", best=None,
    )  # fmt: skip
    for number in (1, 2):
        found[f"table {number} in cm"] = _in_cm(result, number, columns, note)
    found["standard errors"] = error_table(
        columns,
        {f"Table {n}": {title(row): CM * values for row in ROWS_1
                        if (values := paper_row(result, n, row, "standard_error")) is not None} for n in (1, 2)},
        caption=f"Standard errors of these means, over {result['protocol']['clips']} windows", unit="cm", best=None,
    )  # fmt: skip
    return {**found, **_beyond(result, columns), "training": _training(result)}


def _note(result: Result) -> str:
    note = f"; frames at 60 a second; {result['budget']['steps']} steps"
    note += seeds_note(len(runs_of(result, label)) for label in SYSTEMS)
    note += "; SAMPLE MOTIONS, not captured" if result["data"] == "samples" else ""
    return note + ("; QUICK TRIAL, nothing is learnt" if result["quick"] else "")


def _data(result: Result) -> str:
    return " + ".join(result["data_sets"])


def _ratios(rows: Mapping[str, Any]) -> dict[str, np.ndarray]:
    own = rows.get(VAE)
    return {} if own is None else {title(row): np.asarray(values) / own for row, values in rows.items()
                                   if row != VAE and values is not None}  # fmt: skip


def _in_cm(result: Result, number: int, columns: list[str], note: str) -> ErrorTable:
    kind, published = ("motion", VAE_LSTM_TABLE_1) if number == 1 else ("pose", VAE_LSTM_TABLE_2)
    way = PREDICTED if number == 1 else GIVEN
    shown = result["protocol"]["shown"]
    others = {
        **{f"{SYSTEMS[VAE].title}, {name}": (VAE, name, kind) for name in (PER_STEP, HELD)},
        "last pose kept": ("last pose", way, kind),
        "mean pose": ("mean pose", way, kind),
    }
    if number == 1:
        others = {f"{SYSTEMS[VAE].title}, moved by the true control": (VAE, POSTERIOR, "motion_given"), **others}
    else:
        own = {f"{SYSTEMS[b].title}, {shown} frames shown, own control": (b, PREDICTED, "pose") for b in BASELINES}
        long = {f"{SYSTEMS[b].title}, {shown} frames shown": (b, GIVEN_LONG, "pose") for b in BASELINES}
        others = {**long, **own, **others}
    rows = {name: CM * values for name, asked in others.items() if (values := error(result, *asked)) is not None}
    mine = {title(row): CM * values for row in published
            if (values := paper_row(result, number, row, "error")) is not None}  # fmt: skip
    return error_table(
        columns, {_data(result): mine, "not in the paper": rows}, unit="cm",
        caption=f"Table {number}: {kind} error, mean distance of a joint{note}",
    )  # fmt: skip


# --- what the paper has not -----------------------------------------------------------------------


def of_seeds(result: Result, *keys: str) -> np.ndarray:
    """A number, or a list of them, of "beyond", mean over training seeds; NaN where there is none."""
    found = []
    for values in result["beyond"].values():
        for key in keys:
            values = values[key]
        found.append(numbers(values))
    return np.mean(found, axis=0) if found else np.array(np.nan)


def _beyond(result: Result, columns: list[str]) -> dict[str, ErrorTable]:
    if not result["beyond"]:
        return {}
    one = next(iter(result["beyond"].values()))
    samples, pairs = one["diversity"]["samples"], one["interpolation"]["pairs"]
    uses = {"one": "one code at the start", "per-step": "a code a step", "held": "one code held"}
    found = {}
    found["samples"] = error_table(
        columns,
        {moved: {uses[codes]: CM * of_seeds(result, "diversity", "codes", codes, way)
                 for codes in one["diversity"]["codes"]}
         for way, moved in (("given", "moved by the true control"), ("predicted", "moved by their own"))},
        caption=f"How far {samples} prior samples of one path are from each other", unit="cm", best=None,
    )  # fmt: skip
    found["interpolation"] = error_table(
        [*columns, "length", "largest"],
        {f"the ends of {pairs} lines between codes, cm": {
            uses[codes]: [*(CM * of_seeds(result, "interpolation", "codes", codes, "ends")),
                          *(float(of_seeds(result, "interpolation", "codes", codes, k)) for k in ("length", "largest"))]
            for codes in one["interpolation"]["codes"]}},
        caption="From one code to another: length 1 is straight, a largest change far above 1 a jump", best=None,
    )  # fmt: skip
    found["paths"] = error_table(
        ["mean", "largest", "without sway", "passed (%)", "by its own control"],
        {"moved by the control given": {
            f"{path}, {of_seeds(result, 'paths', path, 'seconds'):.0f} s": [
                *(CM * of_seeds(result, "paths", path, "deviation", k) for k in ("mean", "max", "drift")),
                100 * of_seeds(result, "paths", path, "deviation", "covered"),
                CM * of_seeds(result, "paths", path, "deviation", "predicted"),
            ]
            for path in one["paths"]}},
        caption=f"How far people go from the prepared paths at {result['protocol']['pace']:g} m/s",
        unit="cm", best=None,
    )  # fmt: skip
    found["feet"] = _feet(result, list(one["paths"]))
    found["speed"] = error_table(
        ["ms"],
        {"CPU time for a second of motion, one thread": {
            f"{count} at once": [float(of_seeds(result, "speed", "ms", count))] for count in one["speed"]["ms"]}},
        caption="What synthesis costs", digits=1, best=None,
    )  # fmt: skip
    return found


def _feet(result: Result, paths: list[str]) -> ErrorTable:
    """Steps and how far feet slide in one; how fast they slide, of every system, stands in the second group."""
    nothing = [None] * 5
    places = {"test windows, true motion": ("steps", "true"), "test windows, prior samples": ("steps", "made")}
    places |= {path: ("paths", path) for path in paths}
    rows = {
        name: [
            *(scale * float(of_seeds(result, *keys, "before", what))
              for what, scale in (("step_length", CM), ("cadence", 1), ("contact", 100))),
            *(float(of_seeds(result, *keys, when, "slide")) for when in ("before", "after")),
        ]
        for name, keys in places.items()
    }  # fmt: skip
    skates = {"true motion": mean_of(split["foot_skate"] for split in result["splits"].values())}
    for label, way in dict.fromkeys((*ROWS_1.values(), *ROWS_2.values())):
        found = [run["ways"][way]["foot_skate"] for run in runs_of(result, label)]
        if found:
            skates[f"{SYSTEMS[label].title}, {way}"] = np.mean(numbers(found))
    return error_table(
        ["step (cm)", "a minute", "contact (%)", "slide (cm)", "cleaned up", "cm/s"],
        {"steps, and how far a foot slides in one": {name: [*values, None] for name, values in rows.items()},
         "speed of feet that stand": {name: [*nothing, float(value)] for name, value in skates.items()}},
        caption="Feet", best=None,
    )  # fmt: skip


def _training(result: Result) -> ErrorTable:
    rows = {}
    for name, row in SYSTEMS.items():
        runs = runs_of(result, name)
        if runs:
            rows[row.title] = [
                f"{runs[0]['recipe']['steps']}", f"{np.mean([run['seconds'] for run in runs]):.0f}",
                f"{runs[0]['parameters']}", f"{runs[0]['recipe']['learning_rate']:g}",
            ]  # fmt: skip
    budget = result["budget"]
    return error_table(
        ["steps", "seconds", "parameters", "learning rate"], {_data(result): rows}, best=None,
        caption=f"Training: batches of {budget['batch']} windows of {budget['length']} frames, "
        f"{'short clips padded' if budget['pad'] else 'short clips left out'}; seconds of a busy machine",
    )  # fmt: skip
