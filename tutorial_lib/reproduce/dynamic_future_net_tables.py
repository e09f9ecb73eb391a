"""A result of ``reproduce dynamic-future-net`` to be read: what it says, and its tables."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..view.tables import ErrorTable, error_table
from . import results
from .dynamic_future_net_plan import (
    ACLSTM,
    ACTIONS,
    FAR_FUTURE,
    JOINT,
    LIMITED,
    NETWORKS,
    NO_FUTURE,
    NO_TEMPORAL,
    SHIPPED,
    VAE,
    Protocol,
)
from .results import RESULTS, Result, number, numbers

RESULT = RESULTS / "dynamic_future_net.json"
SCHEMA = 1
TOGETHER = (JOINT, NO_FUTURE, NO_TEMPORAL, FAR_FUTURE, SHIPPED)
DANCES = ("dancing", *(f"dancing, {seconds} s" for seconds in LIMITED))


def load_result(path: str | os.PathLike | None = None) -> dict[str, Any]:
    """A result that ``reproduce dynamic-future-net`` wrote; by default the one that comes with the library.

    Raises :class:`DataError` for a file that is missing or is no such result.
    """
    return results.load_result(RESULT if path is None else path, "dynamic-future-net", SCHEMA)


# --- what a result says ---------------------------------------------------------------------------


def runs_of(result: Result, labels: Sequence[str]) -> dict[str, dict[str, Any]]:
    """The Dynamic Future Nets of these names that there are."""
    return {label: result["runs"][label] for label in labels if label in result["runs"]}


def alone(result: Result) -> dict[str, dict[str, Any]]:
    """The networks of one action each, as far as they are there."""
    return runs_of(result, ACTIONS)


def nets(result: Result) -> dict[str, dict[str, Any]]:
    """All Dynamic Future Nets."""
    return {label: run for label, run in result["runs"].items() if NETWORKS[label].futures}


def at_times(result: Result, run: dict[str, Any], action: str, what: str = "pairwise") -> np.ndarray:
    """A network's fan from the prefix of an action at ``protocol.at`` (32 and 128 frames): metres.

    what: "pairwise" distance, or "band", the mean distance to the mean.
    """
    fan = run["fan"]
    entry = fan["prefixes"][action]
    values = entry["pairwise"] if what == "pairwise" else entry["band"][0]
    return numbers(values)[[fan["frames"].index(t) for t in result["protocol"]["at"]]]


def growth(result: Result, run: dict[str, Any], action: str, *, given: int = 0) -> float:
    """How many times as far apart futures are at the second of ``protocol.at`` as at the first.

    ``given`` frames of the beginning are counted as well: 20 make of 32 and 128 frames the 12th and the 108th that a
    network made. Between the frames that a result keeps, the distance is a straight line.
    """
    fan = run["fan"]
    times = np.subtract(result["protocol"]["at"], given)
    early, late = np.interp(times, fan["frames"], numbers(fan["prefixes"][action]["pairwise"]))
    return float(np.divide(late, early))


def growth_in_the_world(result: Result, run: dict[str, Any], action: str) -> float | None:
    """The same from the fork, where people stand and face counted; None in a result that has not measured it."""
    there = run["fan"]["prefixes"][action].get("world")
    return None if there is None else float(np.divide(*numbers(there)[::-1]))


def band_share(result: Result, run: dict[str, Any], action: str, own: bool = False) -> float:
    """The band's mean at the last time against the data's: of all that the network learnt, or of the action alone."""
    fan = run["fan"]
    data = (fan["prefixes"][action]["own"] if own else fan)["data"][0]
    return float(at_times(result, run, action, "band")[-1] / number(data))


def failed(run: dict[str, Any], what: str = "stability") -> tuple[int, int]:
    """How many motions of 900 frames failed by any rule, and of how many; what: "stability_short" for those from the
    shortest prefixes."""
    return tuple(sum(entry[key] for entry in run[what].values()) for key in ("count", "samples"))


# --- tables ---------------------------------------------------------------------------------------


def tables(result: Result) -> dict[str, ErrorTable]:
    """"diversity": fans of 4096 from one prefix; "world": how far apart they are in the world; "data": what the data do
    after beginnings that are alike; "stability" of 900 frames; "transitions" of action; "copies"; "limited data";
    "ablations"; "beside it"; "training".
    """  # fmt: skip
    found = {
        "diversity": _diversity(result),
        "world": _world(result),
        "data": _data(result),
        "stability": _stability(result),
        "transitions": _transitions(result),
        "copies": _copies(result),
        "limited data": _compared(result, DANCES, "Limited data: a dance from less and less of it"),
        "ablations": _compared(result, TOGETHER, "Ablations: all four actions together"),
        "beside it": _beside(result),
        "training": _training(result),
    }
    return {name: table for name, table in found.items() if table is not None}


def note(result: Result) -> str:
    """What is to be known beside every table."""
    text = "; SAMPLE MOTIONS, not captured" if result["data"] == "samples" else ""
    return text + ("; QUICK TRIAL, nothing is learnt" if result["quick"] else "")


def _fans(result: Result) -> Iterator[tuple[str, str, dict[str, Any], dict[str, Any]]]:
    """The whole networks' fans: name of the group, action, network, entry."""
    for label, run in runs_of(result, (SHIPPED, JOINT, *ACTIONS)).items():
        name = "each alone" if label in ACTIONS else NETWORKS[label].title
        for action, entry in run["fan"]["prefixes"].items():
            yield name, action, run, entry


def _diversity(result: Result) -> ErrorTable | None:
    first, last = result["protocol"]["at"]
    groups: dict[str, dict[str, list[float]]] = {}
    for name, action, run, entry in _fans(result):
        groups.setdefault(name, {})[action] = [
            *at_times(result, run, action), growth(result, run, action), at_times(result, run, action, "band")[-1],
            entry["own"]["data"][0], run["fan"]["data"][0], 100 * number(entry["own"]["coverage"]),
            100 * number(entry["coverage"]), entry["seconds"],
        ]  # fmt: skip
    if not groups:
        return None
    columns = [f"apart {first}", f"apart {last}", "ratio", f"band {last}", "data's, action", "data's, all",
               "covered %, action", "covered %, all", "seconds"]  # fmt: skip
    caption = f"{result['protocol']['fan']} futures of one prefix: pairwise distance, and mean-distance band (figure 9)"
    return error_table(columns, groups, caption=caption + note(result), unit="m over the whole pose", best=None)


def _world(result: Result) -> ErrorTable | None:
    first, last = result["protocol"]["at"]
    groups: dict[str, dict[str, list[float]]] = {}
    for name, action, run, entry in _fans(result):
        if "world" in entry:
            groups.setdefault(name, {})[action] = [*entry["world"], growth_in_the_world(result, run, action)]
    for action, run in alone(result).items():
        if "world" in (run["data"][action] or {}):
            apart = numbers(run["data"][action]["world"])
            groups.setdefault("the clips, from beginnings that are alike", {})[action] = [*apart, apart[1] / apart[0]]
    if not groups:
        return None
    return error_table([f"apart {first}", f"apart {last}", "ratio"], groups, best=None, unit="m over the whole pose",
                       caption="Pairwise distance in the world, where people stand and face counted"
                       + note(result))  # fmt: skip


def _data(result: Result) -> ErrorTable | None:
    first, last = result["protocol"]["at"]
    rows = {}
    for action, run in alone(result).items():
        own = run["data"][action]
        if own is not None:
            share = number(own["band"][-1]) / number(run["fan"]["data"][0])
            rows[action] = [*own["pairwise"], own["band"][-1], 100 * share, 100 * band_share(result, run, action)]
    if not rows:
        return None
    columns = [f"apart {first}", f"apart {last}", f"band {last}", "% of the action's poses'", "the network's %"]
    return error_table(columns, {"the clips themselves": rows}, best=None, unit="m over the whole pose",
                       caption=f"Places of the data that begin alike, {last} frames later" + note(result))  # fmt: skip


def _stability(result: Result) -> ErrorTable | None:
    groups = {}
    for label, run in result["runs"].items():
        if "stability" not in run:
            continue
        groups[NETWORKS[label].title] = {
            action: [
                str(entry["count"]), str(short[action]["count"]) if (short := run.get("stability_short")) else None,
                entry["stagnations"]["count"],
                entry["lowest"], entry["foot_slide"]["generated"], entry["foot_slide"]["true"],
                100 * number(entry["bone_drift"]),
            ]
            for action, entry in run["stability"].items()
        }  # fmt: skip
    if not groups:
        return None
    fails = f"fail of {result['protocol']['stable']}"
    shortest = f"from {result['protocol'].get('short_prefix', Protocol.short_prefix)} frames"
    columns = [fails, shortest, "standstills", "least change", "slide cm", "true slide", "bones %"]
    caption = (
        f"Open loop, {result['protocol']['frames']} frames after a prefix never trained on, by the rules of lesson 3"
    )
    return error_table(columns, groups, caption=caption + note(result), best=None)


def _transitions(result: Result) -> ErrorTable | None:
    groups = {}
    for label, run in runs_of(result, TOGETHER).items():
        found = run["transitions"]
        heads = [f"to {action}" for action in found["actions"]]
        title = (f"{NETWORKS[label].title}: {found['kinds']} of 12 kinds, {found['changed']} of {found['motions']} "
                 f"motions change")  # fmt: skip
        groups[title] = {
            f"from {a}": [None if k == j else str(n) for j, n in enumerate(row)]
            for k, (a, row) in enumerate(zip(found["actions"], found["counts"], strict=True))
        }
    if not groups:
        return None
    right = result["runs"][next(iter(runs_of(result, TOGETHER)))]["transitions"]
    caption = (f"Changes of action in motions of {right['frames']} frames; the classifier is right about "
               f"{100 * number(right['accuracy']):.1f} % of the windows of clips kept out")  # fmt: skip
    return error_table(heads, groups, caption=caption + note(result), best=None)


def _copies(result: Result) -> ErrorTable | None:
    rows = {NETWORKS[label].title: [100 * number(x) for k in ("generated", "held_out") for x in run["copies"][k]]
            for label, run in nets(result).items()}  # fmt: skip
    if not rows:
        return None
    columns = [f"{who} {q}" for who in ("generated", "kept out") for q in ("25 %", "50 %", "75 %")]
    window = result["protocol"]["window"]
    return error_table(columns, {"": rows}, unit="cm a joint", best=None,
                       caption=f"Distance of {window} frames to the nearest in the clips trained on" + note(result),
                       )  # fmt: skip


def _compared(result: Result, labels: Sequence[str], caption: str) -> ErrorTable | None:
    first, last = result["protocol"]["at"]
    rows = {}
    for run in runs_of(result, labels).values():
        each = np.mean([at_times(result, run, action) for action in run["fan"]["prefixes"]], axis=0)
        covered = numbers([entry["coverage"] for entry in run["fan"]["prefixes"].values()])
        count, samples = failed(run)
        slides = numbers([entry["foot_slide"]["generated"] for entry in run["stability"].values()])
        slide = np.nanmean(slides) if np.isfinite(slides).any() else None
        kinds = run["transitions"]["kinds"] if run["transitions"] else None
        rows[run["title"]] = [f"{run['train_seconds']:.0f}", *each, each[1] / each[0], 100 * np.mean(covered),
                              f"{100 * count / samples:.0f}", slide, 100 * number(run["copies"]["generated"][1]),
                              None if kinds is None else str(kinds)]  # fmt: skip
    if not rows:
        return None
    columns = ["data s", f"apart {first}", f"apart {last}", "ratio", "covered %", "fail %", "slide cm", "nearest cm",
               "kinds of change"]  # fmt: skip
    return error_table(columns, {"": rows}, caption=caption + note(result), best=None)


def _beside(result: Result) -> ErrorTable | None:
    first, last = result["protocol"]["at"]
    groups: dict[str, dict[str, list]] = {}
    for label in (JOINT, ACLSTM, VAE):
        run = result["runs"].get(label)
        if run is None:
            continue
        for action, entry in run["fan"]["prefixes"].items():
            ways = {"": at_times(result, run, action) if label == JOINT else numbers(entry["pairwise"])}
            if label == VAE:
                ways = {", one code": ways[""], ", a code a step": numbers(entry["pairwise, a code a step"])}
            fails = None
            if "stability" in run:
                fails = str(run["stability"][action]["count"])
            for way, values in ways.items():
                title = "Dynamic Future Net" if label == JOINT else run["title"]
                groups.setdefault(f"{title}{way}", {})[action] = [*values, fails]
    if not groups:
        return None
    columns = [f"apart {first}", f"apart {last}", f"fail of {result['protocol']['stable']}"]
    caption = f"Pairwise distance of motions from one beginning, or on one path; {_steps(result)}{note(result)}"
    return error_table(columns, groups, best=None, unit="m over the whole pose", caption=caption)


def _steps(result: Result) -> str:
    """How long each of the networks beside one another was trained."""
    there = {label: result["runs"][label] for label in (JOINT, ACLSTM, VAE) if label in result["runs"]}
    return "steps: " + ", ".join(f"{run['recipe']['steps']} {run['system']}" for run in there.values())


def _training(result: Result) -> ErrorTable:
    rows = {run["title"]: [str(run["recipe"]["steps"]), str(run["recipe"]["batch"]), f"{run['seconds']:.0f}",
                           str(run["parameters"]), f"{run['train_seconds']:.0f}"]
            for run in result["runs"].values()}  # fmt: skip
    budget = result["budget"]
    return error_table(["steps", "batch", "seconds", "parameters", "data s"], {"": rows}, best=None,
                       caption=f"Training: windows of {budget['length']} frames, horizon {budget['horizon']}; seconds "
                       "of a busy machine")  # fmt: skip
