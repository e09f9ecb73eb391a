"""Every system of the library on the same clips, split and skeleton, measured alike: the table of lesson 6.

What is trained
    LSTM-3LR, acLSTM, scheduled sampling, ERD, seq2seq, the cRBM, the VAE-LSTM and the Dynamic Future Net, each in its
    own paper's representation, and two of them once more in another (:mod:`tutorial_lib.reproduce.side_by_side_plan`).
    All have the same training clips, mapped to the 21 common joints and one height, as many cells a layer, one learning
    rate, and a minute or so of one core. The papers have hours and days: the table tells what a system gives for a
    small price, not the best that it can do.

What is measured
    20 beginnings of 20 frames from test clips, the same for all; 900 frames after each. All measures are taken on
    joint positions in the world after decoding, whatever the representation: distance to the truth at 80 ... 640
    ms; motion change and failures by rule (:mod:`tutorial_lib.reproduce.failures`), in the acRNN's metres; sliding
    feet; changing bones; how far 16 futures of one beginning are apart; how far from a path somebody goes who is told
    one; milliseconds a frame. The VAE-LSTM is told the true control, which the others must guess.

The result, a dict that is written as JSON
    ========== ===================================================================================================
    paper      "side-by-side"; ``schema`` 1; ``versions``, ``date``
    data       "cmu" or "samples"; ``data_sets``; ``quick``: true for a trial with tiny networks
    protocol   seeds, frames, ``times_ms``, fps, futures, paths, ...
    budget     steps of a share of 1 and ``each`` system, batch, length, hidden, learning rate, seeds
    splits     {"seed k": training and test clips, seconds of both, ``truth`` (the measure of the failure rules),
               ``true`` (speed, feet and bones of people), ``references`` (two predictors that have learnt nothing)}
    runs       {name: a run}, names as "aclstm", "lstm-hip", "-seed1" behind for other training seeds
    ========== ===================================================================================================

    A run has its label, title, seed, recipe, parameters, seconds of training by the clock and of one core, final loss
    and what :func:`~.side_by_side_measure.measure` tells. What is not finite is None. Seconds and milliseconds depend
    on the machine and what else it does; nothing else should by more than rounding.
"""

from __future__ import annotations

import dataclasses
import os
import pathlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .. import metrics
from ..evaluate import jsonable
from .cost import Costs, whole_cost
from .grid import Run, Told, asked_for, clips_for, finished, folders, side_by_side
from .results import ALL_PAPERS, head, tell_result, write_result
from .side_by_side_findings import findings
from .side_by_side_measure import seconds_of_measuring, train_and_measure
from .side_by_side_networks import load_networks, write_networks
from .side_by_side_plan import DATA, QUICK, SYSTEMS, Budget, Plan, name_of
from .side_by_side_tables import SCHEMA, error, failed, load_result, off_path, tables, value
from .sources import clips_from, samples_stand_in

__all__ = ["error", "failed", "findings", "load_networks", "load_result", "off_path", "reproduce", "tables", "value"]


def reproduce(
    source: str | None = None,
    *,
    runs: str | os.PathLike | None = None,
    out: str | os.PathLike | None = None,
    jobs: int = 2,
    seeds: Sequence[int] = (0,),
    train_missing: bool = True,
    quick: bool = False,
    budget: Mapping[str, int] | None = None,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Train what is missing, measure, write the result and its networks; returns it (see the top of this module).

    Parameters
    ----------
    source : a folder with ``cmu/walking``; "samples" for the sample motions; by default the clips that the catalogue
        finds on this machine, and the samples where it finds none.
    runs : folder for the checkpoints; out : folder for ``side_by_side.json`` and, in a folder ``side_by_side``, the
        networks in half precision (by default that of the runs).
    jobs : how many runs are trained side by side, each in a process with one thread.
    train_missing : without, only runs that are finished are measured.
    budget : sizes that are not the default, ``{"steps": 600, "hidden": 64}``.

    Raises :class:`DataError` for data that is not at hand, ``CheckpointError`` if the folder of runs has a run of
    another recipe in the place of one of these.
    """
    samples = samples_stand_in(source, DATA, tell)
    plan = Plan(samples=samples, seeds=tuple(seeds), **asked_for(Budget(), QUICK, quick, budget))
    runs, out = folders("side-by-side", samples, runs, out)
    with clips_from(source, plan.data, samples=samples):
        result = _measured(plan, runs, jobs=jobs, train_missing=train_missing, tell=tell)
    path = write_result(result, out / "side_by_side.json")
    count = write_networks(result, plan, runs, path.with_suffix(""))
    tell_result(path, tables(result), findings(result), {}, tell, whose=ALL_PAPERS)
    tell(f"wrote {count} networks in half precision to {path.with_suffix('')}")
    return result


def _measured(
    plan: Plan, folder: pathlib.Path, *, jobs: int, train_missing: bool, tell: Callable[[str], None]
) -> dict[str, Any]:
    runs = plan.runs() if train_missing else finished(plan.runs(), folder)
    left = {run.name: run.steps_left(folder) for run in runs}
    costs = Costs(lambda recipe: seconds_of_measuring(recipe, clips_for(recipe), plan.protocol),
                  0.02 if plan.quick else 0.6)  # fmt: skip

    def cost_of(run: Run) -> tuple[float, float]:
        name = name_of(run)
        step = costs.step(name, plan.recipe(name)) if left[run.name] else 0.0
        return step, costs.measuring(name, plan.recipe(name))

    sizes = f"up to {max(run.recipe.steps for run in runs)} steps, {plan.budget.hidden} cells a layer"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the training itself will tell
        cost = whole_cost(runs, left, cost_of, sizes=sizes, jobs=jobs, kind=name_of, tell=tell)
    told = Told(runs, left, cost, jobs=jobs, tell=tell)
    tasks = [(run, folder.absolute(), plan.protocol) for run in runs]
    parts = side_by_side(train_and_measure, tasks, jobs=jobs, heard=told, folder=folder)
    result = _frame(plan)
    for run, (split, measured) in zip(runs, parts, strict=True):
        result["splits"][f"seed {run.recipe.seed}"] = split
        result["runs"][run.name] = measured
    return jsonable(result)


def _frame(plan: Plan) -> dict[str, Any]:
    """The result of a plan, still without what is measured."""
    return {
        **head("side-by-side", SCHEMA),
        "data": "samples" if plan.samples else "cmu",
        "data_sets": plan.data,
        "quick": plan.quick,
        "protocol": {
            **dataclasses.asdict(plan.protocol),
            "times_ms": metrics.PAPER_TIMES_MS,
            "fps": plan.recipe("lstm").fps,
        },
        "budget": {
            **dataclasses.asdict(plan.budget),
            "each": {name: plan.recipe(name).steps for name in SYSTEMS},
            "training_seeds": plan.seeds,
        },
        "splits": {},
        "runs": {},
    }
