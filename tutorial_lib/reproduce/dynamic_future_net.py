"""Chen et al., "Dynamic Future Net": figures 6 to 9, stability, changes of action, limited data and ablations.

What is trained
    The Dynamic Future Net on walking, running, boxing and dancing, together and each alone; on 20 s and 7 s of dance;
    together without the future state, and without the temporal-difference loss; beside it the acLSTM and the VAE-LSTM
    on the same clips, each of them at its own speed, slower and faster by up to a fifth, and mirrored, which the paper
    does not mention. Sizes and steps stand in :mod:`tutorial_lib.reproduce.dynamic_future_net_plan`: small networks
    and few steps, for minutes of a CPU.

What is measured
    All prefixes are from clips never trained on. 20 motions of 900 frames of each action by the rules of lesson 3; 4096
    motions of 128 frames from one prefix of each action, how far apart they are and how far from their mean, beside
    the data's own; how often one action becomes another in 256 motions of 600 frames; how near generated windows come
    to the training clips. What each is stands in :mod:`tutorial_lib.reproduce.dynamic_future_net_measure`,
    :mod:`tutorial_lib.diversity` and :mod:`tutorial_lib.actions`. Weights that come with the library, a network
    of all four actions from another run, are measured as well.

The result, a dict that is written as JSON
    ========== ===================================================================================================
    paper      "dynamic-future-net"; ``schema`` 1; ``versions``, ``date``
    data       "cmu" or "samples"; ``data_sets`` of each action; ``quick``: true for a trial with tiny networks
    protocol   prefix, frames, how many motions, ...; ``fps``
    budget     steps, batch, length, hidden, horizon; ``seed``
    elsewhere  how near windows of the training clips of each action come to others, quartiles in metres
    runs       {name: a network}, names are the keys of ``NETWORKS``
    ========== ===================================================================================================

    A network has its label, title, system, actions, seconds of data, recipe, parameters, seconds of training, final
    loss and what :func:`tutorial_lib.reproduce.dynamic_future_net_measure.measure` tells. What is not finite is None.
"""

from __future__ import annotations

import dataclasses
import os
import pathlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .. import pretrained
from ..evaluate import jsonable
from ..generate import prepare
from .cost import Costs, whole_cost
from .dynamic_future_net_figures import figure_6, figure_7, figure_8, figure_9
from .dynamic_future_net_findings import findings
from .dynamic_future_net_measure import (
    elsewhere,
    measure_published,
    seconds_of_measuring,
    train_and_measure,
)
from .dynamic_future_net_plan import DATA, JOINT, NETWORKS, QUICK, SHIPPED, Budget, Plan, name_of
from .dynamic_future_net_tables import SCHEMA, load_result, tables
from .grid import Run, Told, asked_for, clips_for, finished, folders, side_by_side
from .results import head, tell_result, write_result
from .sources import clips_from, samples_stand_in

__all__ = ["figure_6", "figure_7", "figure_8", "figure_9", "findings", "load_result", "reproduce", "tables"]


def reproduce(
    source: str | None = None,
    *,
    runs: str | os.PathLike | None = None,
    out: str | os.PathLike | None = None,
    jobs: int = 2,
    networks: Sequence[str] = tuple(NETWORKS),
    train_missing: bool = True,
    quick: bool = False,
    budget: Mapping[str, int] | None = None,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Train what is missing, measure, write result and figures; returns the result (see the top of this module).

    Parameters
    ----------
    source : a folder with the four CMU data sets; "samples" for the sample motions; by default the clips that the
        catalogue finds on this machine, and the samples where it finds none.
    runs : folder for the checkpoints; out : folder for ``dynamic_future_net.json`` and the figures (by default that of
        the runs).
    jobs : how many runs are trained side by side, each in a process with one thread.
    networks : of these only. budget : sizes that are not the default, ``{"steps": 2000}``.

    Raises :class:`DataError` for data that is not at hand, ``CheckpointError`` if the folder of runs has a run of
    another recipe in the place of one of these.
    """
    samples = samples_stand_in(source, DATA.values(), tell)
    plan = Plan(samples=samples, networks=tuple(networks), **asked_for(Budget(), QUICK, quick, budget))
    runs, out = folders("dynamic-future-net", samples, runs, out)
    with clips_from(source, plan.data, samples=samples):
        result = _measured(plan, runs, jobs=jobs, train_missing=train_missing, tell=tell)
    path = write_result(result, out / "dynamic_future_net.json")
    drawn = {f"figure-{n}": draw(result) for n, draw in ((6, figure_6), (7, figure_7), (8, figure_8), (9, figure_9))}
    tell_result(path, tables(result), findings(result), drawn, tell)
    return result


def _measured(plan: Plan, folder: pathlib.Path, *, jobs: int, train_missing: bool,
              tell: Callable[[str], None]) -> dict[str, Any]:  # fmt: skip
    runs = plan.runs()
    if runs and not train_missing:
        runs = finished(runs, folder)
    left = {run.name: run.steps_left(folder) for run in runs}
    by_recipe = {run.recipe: run for run in runs}
    costs = Costs(lambda recipe: seconds_of_measuring(by_recipe[recipe], folder, plan), 0.02 if plan.quick else 0.6)

    def cost_of(run: Run) -> tuple[float, float]:
        network = NETWORKS[name_of(run)]
        kind = network.system, network.joint, *network.options  # how long it takes, whatever the action
        step = costs.step(kind, run.recipe) if left[run.name] else 0.0
        return step, costs.measuring(run.name, run.recipe)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of clips that are too short: the training itself will tell
        sizes = f"up to {max((run.recipe.steps for run in runs), default=0)} steps, {plan.budget.hidden} cells a layer"
        cost = whole_cost(runs, left, cost_of, sizes=sizes, jobs=jobs, tell=tell)
    told = Told(runs, left, cost, jobs=jobs, tell=tell)
    tasks = [(run, folder.absolute(), plan) for run in runs]
    parts = side_by_side(train_and_measure, tasks, jobs=jobs, heard=told, folder=folder)
    entries = {name_of(run): part for run, part in zip(runs, parts, strict=True)}
    if plan.published in [row.name for row in pretrained.list()]:
        tell(f"measuring {plan.published}")
        entries[SHIPPED] = side_by_side(measure_published, [(plan.published, folder, plan.protocol)], jobs=jobs)[0]
        if JOINT in entries:  # their figures are drawn
            entries[JOINT] = _without_figures(entries[JOINT])
    known = {}
    for action in plan.sources:
        recipe = plan.recipe(action)
        known[action] = prepare([m for train, _ in clips_for(recipe) for m in train], fps=recipe.fps)
    result = {
        **head("dynamic-future-net", SCHEMA),
        "data": "samples" if plan.samples else "cmu",
        "data_sets": plan.sources,
        "quick": plan.quick,
        "protocol": {**dataclasses.asdict(plan.protocol), "fps": plan.recipe(JOINT).fps},
        "budget": {**dataclasses.asdict(plan.budget), "seed": plan.seed},
        "elsewhere": elsewhere(known, plan.protocol),
        "runs": entries,
    }
    return jsonable(result)


def _without_figures(entry: dict[str, Any]) -> dict[str, Any]:
    """An entry without what figures 6 to 8 are drawn from, thousands of numbers."""
    prefixes = {action: {k: v for k, v in each.items() if k != "latent"}
                for action, each in entry["fan"]["prefixes"].items()}  # fmt: skip
    return {**entry, "paths": None, "fan": {**entry["fan"], "prefixes": prefixes}}
