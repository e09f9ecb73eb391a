"""Habibie et al., "A recurrent variational autoencoder for human motion synthesis": tables 1 and 2, figures 3 and 4.

What is trained
    The VAE-LSTM and the paper's baselines, ERD, LSTM-3LR and the cRBM with CD-1 and CD-15, on the same training clips,
    windows of 4 s, padding and representation; how many steps each and why stands in
    :mod:`tutorial_lib.reproduce.vae_lstm_plan`. With ``tuning`` each has the rate of ``RATES_TRIED`` that did best
    on validation clips.

What is measured
    20 windows of 4 s of test clips, at the paper's five times. A baseline predicts its control itself and is shown
    30 frames (table 1), or is given the true control and shown 4 (table 2). The VAE-LSTM is always given the true
    control; its single code is from the prior, or from the posterior of 4 frames; its motion error is of the control
    that it puts out. Errors are mean distances, in metres, and as the paper has them mean squared ones; the paper
    prints no unit. Beside them: what holding a pose would give, and what the paper has not
    (:mod:`tutorial_lib.reproduce.vae_lstm_beyond`).

The result, a dict that is written as JSON
    ========== ===================================================================================================
    paper      "vae-lstm"; ``schema`` 2; ``versions``, ``date``
    data       "bandai-namco" or "samples"; ``data_sets``; ``quick``: true for a trial with tiny networks
    protocol   clips, their frames, ``at`` (frames at 60 a second), fps, frames shown, samples, ...
    budget     steps of the VAE-LSTM and ``each`` system, batch, length, hidden, pad, seeds; ``learning_rates``
    splits     {"seed k": training and test clips, seconds of both, ``references`` (mean pose, last pose), the true
               ``foot_skate``}
    runs       {name: a run}, names as "vae-lstm" and "crbm-cd15", "-seed1" behind for other seeds
    beyond     {"seed k": diversity, interpolation, paths, steps, speed}
    tuning     validation errors of each rate tried, where ``--tune`` was given
    ========== ===================================================================================================

    A run has its label, title, seed, recipe, parameters, seconds of training, final loss and ``ways``: for each way in
    which it was asked ``pose``, ``motion`` and ``motion_given`` errors, the ``curve`` of figure 4 and
    ``foot_skate``, see :func:`tutorial_lib.reproduce.vae_lstm_measure.errors_of`. What is not finite is None.
"""

from __future__ import annotations

import dataclasses
import os
import pathlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..evaluate import jsonable
from .cost import Costs, both, choose_rates, whole_cost
from .grid import Run, Told, asked_for, clips_for, finished, folders, side_by_side
from .results import head, tell_result, write_result
from .sources import clips_from, samples_stand_in
from .vae_lstm_figures import figure_3, figure_4
from .vae_lstm_findings import findings
from .vae_lstm_measure import seconds_of_measuring, train_and_measure, validation_error
from .vae_lstm_plan import DATA, QUICK, RATES_TRIED, SYSTEMS, Budget, Plan, name_of
from .vae_lstm_tables import SCHEMA, error, load_result, tables

__all__ = ["error", "figure_3", "figure_4", "findings", "load_result", "reproduce", "tables", "tune"]


def reproduce(
    source: str | None = None,
    *,
    runs: str | os.PathLike | None = None,
    out: str | os.PathLike | None = None,
    jobs: int = 2,
    seeds: Sequence[int] = (0,),
    tuning: bool = False,
    train_missing: bool = True,
    quick: bool = False,
    budget: Mapping[str, int] | None = None,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Train what is missing, measure, write result and figures; returns the result (see the top of this module).

    Parameters
    ----------
    source : a folder with ``bandai-namco/locomotion``; "samples" for the sample motions; by default the clips that the
        catalogue finds on this machine, and the samples where it finds none.
    runs : folder for the checkpoints; out : folder for ``vae_lstm.json`` and the figures (by default that of the runs).
    jobs : how many runs are trained side by side, each in a process with one thread.
    tuning : choose the learning rates first. train_missing : without, only runs that are finished are measured.
    budget : sizes that are not the default, ``{"steps": 1000}``.

    Raises :class:`DataError` for data that is not at hand, ``CheckpointError`` if the folder of runs has a run of
    another recipe in the place of one of these.
    """
    samples = samples_stand_in(source, DATA, tell)
    plan = Plan(samples=samples, seeds=tuple(seeds), **asked_for(Budget(), QUICK, quick, budget))
    runs, out = folders("vae-lstm", samples, runs, out)
    with clips_from(source, plan.data, samples=samples, aside=1 + tuning):
        record, costs = None, _costs(plan)
        if tuning:
            plan, record = tune(plan, runs, costs, jobs=jobs, tell=tell)
        result = _measured(plan, runs, costs, jobs=jobs, train_missing=train_missing, tell=tell)
        drawn = {"figure-3": figure_3(result, plan, runs), "figure-4": figure_4(result)}
    if record is not None:
        result["tuning"] = record
    path = write_result(result, out / "vae_lstm.json")
    tell_result(path, tables(result), findings(result), drawn, tell)
    return result


def _costs(plan: Plan) -> Costs:
    """For the runs of this plan; kinds are names of the plan's systems for steps, and of systems for measuring."""
    return Costs(lambda recipe: seconds_of_measuring(recipe, clips_for(recipe), plan.protocol),
                 0.02 if plan.quick else 0.6)  # fmt: skip


def _measured(plan: Plan, folder: pathlib.Path, costs: Costs, *, jobs: int, train_missing: bool,
              tell: Callable[[str], None]) -> dict[str, Any]:  # fmt: skip
    runs = plan.runs() if train_missing else finished(plan.runs(), folder)
    left = {run.name: run.steps_left(folder) for run in runs}

    def cost_of(run: Run) -> tuple[float, float]:
        name = name_of(run)
        step = costs.step(name, plan.recipe(name)) if left[run.name] else 0.0
        return step, costs.measuring(run.recipe.system, plan.recipe(name))

    sizes = f"up to {max(run.recipe.steps for run in runs)} steps, {plan.budget.hidden} cells a layer"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of clips that are too short: the training itself will tell
        cost = whole_cost(runs, left, cost_of, sizes=sizes, jobs=jobs, kind=name_of, tell=tell)
    told = Told(runs, left, cost, jobs=jobs, tell=tell)
    tasks = [(run, folder.absolute(), plan.protocol) for run in runs]
    parts = side_by_side(train_and_measure, tasks, jobs=jobs, heard=told, folder=folder)
    result = _frame(plan)
    for run, (split, measured, more) in zip(runs, parts, strict=True):
        seed = f"seed {run.recipe.seed}"
        result["splits"][seed] = split
        result["runs"][run.name] = measured
        if more is not None:
            result["beyond"][seed] = more
    return jsonable(result)


def _frame(plan: Plan) -> dict[str, Any]:
    """The result of a plan, still without what is measured."""
    return {
        **head("vae-lstm", SCHEMA),
        "data": "samples" if plan.samples else "bandai-namco",
        "data_sets": plan.data,
        "quick": plan.quick,
        "protocol": {**dataclasses.asdict(plan.protocol), "fps": plan.recipe("vae-lstm").fps},
        "budget": {
            **dataclasses.asdict(plan.budget),
            "each": {name: plan.recipe(name).steps for name in SYSTEMS},
            "training_seeds": plan.seeds,
            "learning_rates": dict(plan.rates),
            "rates_tried": RATES_TRIED,
        },
        "splits": {},
        "runs": {},
        "beyond": {},
    }


def tune(
    plan: Plan,
    folder: pathlib.Path,
    costs: Costs | None = None,
    *,
    jobs: int,
    tell: Callable[[str], None] = print,
) -> tuple[Plan, dict[str, Any]]:
    """The plan with the learning rate for each system that did best on validation clips, and the record of it.

    A fifth of the training clips is set aside; all of each system's steps are trained on the rest with each rate of
    :data:`RATES_TRIED`, for runs of a quarter of them chose rates at which the whole ones did worse; the error is
    :func:`~.vae_lstm_measure.validation_error`. Test clips are not touched.
    """
    data = " + ".join(plan.data)
    trials = {
        (name, data, rate): Run(f"tuning/{name}-{rate:g}", dataclasses.replace(plan.recipe(name), learning_rate=rate))
        for name in SYSTEMS
        for rate in RATES_TRIED
    }
    costs = costs or _costs(plan)

    def step(name: str) -> float:
        return costs.step(name, plan.recipe(name))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        later = sum(run.recipe.steps * step(name_of(run)) for run in plan.runs())
    record = choose_rates(
        validation_error, trials, folder, plan.protocol,
        lambda run: step(run.name.removeprefix("tuning/").removesuffix(f"-{run.recipe.learning_rate:g}")),
        then=f"then {len(plan.runs())} runs: at most {both(later, jobs)}", jobs=jobs, tell=tell,
    )  # fmt: skip
    return dataclasses.replace(plan, rates=record["chosen"]), record
