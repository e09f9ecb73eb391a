"""What the Dynamic Future Net paper finds, and what this library promises of it, held against a result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from .dynamic_future_net_plan import ACLSTM, JOINT, LIMITED, NO_FUTURE, NO_TEMPORAL, SHIPPED, Protocol
from .dynamic_future_net_tables import (
    DANCES,
    alone,
    at_times,
    band_share,
    failed,
    growth,
    growth_in_the_world,
    nets,
    runs_of,
)
from .results import Finding, Result, number, numbers

Runs = Mapping[str, dict[str, Any]]

CLEARLY = 1.05  # by a twentieth: with one network each, less is chance
ALONE = "each action alone"


def _kinds(result: Result) -> dict[str, Runs]:
    """Whole networks by what they were trained on."""
    return {ALONE: alone(result), "all together": runs_of(result, (JOINT,)),
            "all together, the weights shipped": runs_of(result, (SHIPPED,))}  # fmt: skip


def findings(result: Result) -> list[Finding]:
    """Each with its numbers; None where runs that it needs are missing."""
    return [*_stable(result), *_diverse(result), *_transitions(result), *_whole(result), *_limited(result),
            *_ablations(result), *_beside(result)]  # fmt: skip


def _held(claim: str, runs: Runs, say: Callable[[], tuple[bool, str]]) -> Finding:
    """A finding of some runs, or one that was not measured."""
    return Finding(claim, *say()) if runs else Finding(claim, None, "not measured")


def _stable(result: Result) -> list[Finding]:
    frames = result["protocol"]["frames"]

    def told(runs: Runs, what: str) -> tuple[bool, str]:
        counts = {label: failed(run, what) for label, run in runs.items()}
        return not any(bad for bad, _ in counts.values()), ", ".join(f"{k} {bad} of {n} fail" for k, (bad, n) in
                                                                     counts.items())  # fmt: skip

    found = []
    protocol = result["protocol"]
    prefixes = {"stability": protocol["prefix"],
                "stability_short": protocol.get("short_prefix", Protocol.short_prefix)}  # fmt: skip
    for key, given in prefixes.items():
        for what, runs in _kinds(result).items():
            measured = runs if all(key in run for run in runs.values()) else {}
            claim = f"Section 6.1: {frames} frames from prefixes of {given} stay stable"
            found.append(_held(f"{claim}: {what}", measured, lambda runs=runs, key=key: told(runs, key)))
    everything = nets(result)

    def rigid() -> tuple[bool, str]:
        each = [entry["bone_drift"] for run in everything.values() for entry in run["stability"].values()]
        worst = float(np.max(numbers(each)))
        return worst < 1e-4, f"largest change {worst:.1e}"

    return [*found, _held("Bones keep their length to 1e-4", everything, rigid)]


def _diverse(result: Result) -> list[Finding]:
    first, last = result["protocol"]["at"]
    given = result["protocol"]["prefix"]
    found = []
    for what, runs in _kinds(result).items():
        fans = [(action, run) for run in runs.values() for action in run["fan"]["prefixes"]]

        def grows(ratio: Callable[..., float], least: float = 2.0, fans=fans) -> tuple[bool, str]:
            ratios = {a: ratio(result, run, a) for a, run in fans}
            return all(r >= least for r in ratios.values()), ", ".join(f"{a} {r:.2f}" for a, r in ratios.items())

        def matches(own: bool, fans=fans) -> tuple[bool, str]:
            shares = {a: band_share(result, run, a, own) for a, run in fans}
            return all(abs(x - 1) <= 0.2 for x in shares.values()), ", ".join(f"{a} {100 * x:.0f} %" for a, x in
                                                                              shares.items())  # fmt: skip

        placed = all(growth_in_the_world(result, run, action) is not None for action, run in fans)
        found += [
            _held(f"Section 6.3: diversity increases in time: poses are farther apart at frame {last} than at {first}: "
                  f"{what}", runs, lambda grows=grows: grows(growth, CLEARLY)),
            _held(f"Futures are twice as far apart at frame {last} as at {first}, in the world: {what}",
                  runs if placed else {}, lambda grows=grows: grows(growth_in_the_world)),
            _held(f"The same of their poses, wherever they stand: {what}", runs, lambda grows=grows: grows(growth)),
            _held(f"The same of their poses where the {given} frames of the beginning are counted too: {what}",
                  runs if given < first else {}, lambda grows=grows: grows(partial(growth, given=given))),
            _held(f"Figure 9's band at frame {last} is within 20 % of that of the action's data: {what}", runs,
                  lambda matches=matches: matches(True)),
        ]  # fmt: skip
        if what != ALONE:
            found.append(_held(f"The same of all data of all actions, as figure 9 has it: {what}", runs,
                               lambda matches=matches: matches(False)))  # fmt: skip
    followed = {a: run for a, run in alone(result).items() if run["data"][a] is not None}

    def as_the_data() -> tuple[bool, str]:
        ratios = {
            a: at_times(result, run, a, "band")[-1] / number(run["data"][a]["band"][-1]) for a, run in followed.items()
        }
        return all(r >= 0.8 for r in ratios.values()), ", ".join(f"{a} {100 * r:.0f} %" for a, r in ratios.items())

    found.append(_held(f"At frame {last} futures differ at least 80 % as much as the data do after alike beginnings",
                       followed, as_the_data))  # fmt: skip
    return found


def _transitions(result: Result) -> list[Finding]:
    def told(runs: Runs) -> tuple[bool, str]:
        found = next(iter(runs.values()))["transitions"]
        return found["kinds"] >= 3, (f"{found['kinds']} of 12 kinds, in {found['changed']} of {found['motions']} "
                                     f"motions of {found['frames']} frames")  # fmt: skip

    return [_held(f"Section 6.2: one action becomes another (asked here: in at least 3 of 12 kinds): {what}", runs,
                  lambda runs=runs: told(runs)) for what, runs in _kinds(result).items() if what != ALONE]  # fmt: skip


def _whole(result: Result) -> list[Finding]:
    runs = {label: run for each in _kinds(result).values() for label, run in each.items()}

    def copies(runs: Runs) -> tuple[bool, str]:
        pairs = {label: [number(run["copies"][k][1]) for k in ("generated", "held_out")] for label, run in runs.items()}
        return all(a >= b for a, b in pairs.values()), ", ".join(f"{k} {100 * a:.1f} and {100 * b:.1f} cm" for k, (a, b)
                                                                 in pairs.items())  # fmt: skip

    known = result["elsewhere"]
    singles = {a: run for a, run in alone(result).items() if known.get(a)}

    def new() -> tuple[bool, str]:
        pairs = {a: (number(run["copies"]["generated"][1]), number(known[a][1])) for a, run in singles.items()}
        return all(a >= b for a, b in pairs.values()), ", ".join(f"{k} {100 * a:.1f} and {100 * b:.1f} cm" for k, (a, b)
                                                                 in pairs.items())  # fmt: skip

    def fast() -> tuple[bool, str]:
        slowest = float(np.max([number(entry["seconds"]) * result["protocol"]["fan"] / entry["motions"]
                                for run in runs.values() for entry in run["fan"]["prefixes"].values()]))  # fmt: skip
        protocol = result["protocol"]
        return slowest <= 60, f"{slowest:.0f} s of one core, {protocol['fan']} of {protocol['fan_frames']} frames"

    return [
        *(_held("Nothing is copied: generated windows are no nearer to the training clips than windows kept out, at "
                f"the median: {what}", kind, lambda kind=kind: copies(kind)) for what, kind in _kinds(result).items()),
        _held("Nor nearer than windows of the training clips are to others a second away or more", singles, new),
        _held("4096 motions of 128 frames in 60 s", runs, fast),
    ]  # fmt: skip


def _limited(result: Result) -> list[Finding]:
    runs = runs_of(result, DANCES)
    runs = runs if len(runs) == len(DANCES) else {}

    def stable() -> tuple[bool, str]:
        bad, n = failed(runs[DANCES[-1]])
        return bad == 0, f"{bad} of {n} fail"

    def fewer() -> tuple[bool, str]:
        apart = [at_times(result, run, "dancing")[-1] for run in runs.values()]
        falls = all(CLEARLY * after < before for before, after in zip(apart, apart[1:], strict=False))
        return falls, ", ".join(f"{run['train_seconds']:.0f} s {x:.2f} m" for run, x in
                                zip(runs.values(), apart, strict=True))  # fmt: skip

    return [_held(f"Section 6.4: motions stay stable trained on {LIMITED[-1]} s", runs, stable),
            _held("Section 6.4: less data, less diversity (pairwise distance)", runs, fewer)]  # fmt: skip


def _ablations(result: Result) -> list[Finding]:
    found = []
    for label, what in ((NO_FUTURE, "the future state"), (NO_TEMPORAL, "the temporal-difference loss")):
        runs = runs_of(result, (JOINT, label))
        runs = runs if len(runs) == 2 else {}

        def told(runs=runs) -> tuple[bool, str]:
            whole, cut = ([float(np.mean(values)) for values in zip(*(at_times(result, run, a) for a in
                           run["fan"]["prefixes"]), strict=True)] for run in runs.values())  # fmt: skip
            fails, kinds = ([f(run) for run in runs.values()] for f in (failed, lambda r: r["transitions"]["kinds"]))
            said = (f"with it {whole[0]:.2f} and {whole[1]:.2f} m apart, {fails[0][0]} fail, {kinds[0]} kinds; "
                    f"without {cut[0]:.2f} and {cut[1]:.2f} m, {fails[1][0]} fail, {kinds[1]} kinds")  # fmt: skip
            return whole[1] > CLEARLY * cut[1], said

        found.append(_held(f"Without {what} futures are less diverse", runs, told))
    return found


def _beside(result: Result) -> list[Finding]:
    run = result["runs"].get(ACLSTM)

    def told() -> tuple[bool, str]:
        most = max(float(numbers(entry["pairwise"]).max()) for entry in run["fan"]["prefixes"].values())
        return most < 1e-4, f"at most {most:.1e} m apart"

    return [_held("Section 6.3: a deterministic network has one future, no fan", run or {}, told)]
