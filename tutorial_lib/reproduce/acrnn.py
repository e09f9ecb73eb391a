"""Zhou et al., "Auto-conditioned recurrent networks": tables 1 and 2, figures 2, 7 and 9, and the long run.

What is trained
    For each style the five systems of table 1; for the Indian dance also u = v of 1, 2 and 10 (table 2) and, where
    asked for, pairs off the diagonal. All have one budget: steps, batch, window, cells a layer. What each system has
    of its own, and the pairs, stand in :mod:`tutorial_lib.reproduce.acrnn_plan`; its learning rate is that of
    ``RATES_TRIED`` which did best on validation clips in short runs (:func:`tune`).

What is measured
    20 seeds of 10 frames, spread over the test clips, none of which was trained on; 1000 frames after each. Distance to
    the truth at the paper's eight times, motion change over 900 frames, failures by rule
    (:mod:`tutorial_lib.reproduce.failures`), sliding feet, changing bones. A training seed draws weights,
    windows and the split into training and test clips; all runs of one seed and style share seeds and clips, so systems
    can be compared seed by seed.

The result, a dict that is written as JSON
    ========== ===================================================================================================
    paper      "acrnn"; ``schema`` 1; ``versions``, ``date``
    data       "cmu" or "samples"; ``quick``: true for a trial with tiny networks
    protocol   seeds, their frames, frames generated, ``times_ms``, fps
    budget     steps, batch, length, hidden, seeds; ``learning_rates`` of the systems and how they were chosen
    styles     {style: title, data set}
    splits     {"style seed k": training and test clips, seconds of both, ``truth`` (the measure of the failure
               rules) and ``last_frame``, the errors of repeating the seed's last frame}
    runs       {name: a run}, names as "martial/aclstm" and "indian/aclstm-u10-v1", "-seed1" behind for other seeds
    long       {name: failures in samples of 18,000 frames}
    tuning     validation errors of each rate tried, where ``--tune`` was given
    shipped    ``versions`` and ``date`` of the shipped weights' part of ``long``, where they were measured later
    ========== ===================================================================================================

    A run has its style, system, label, seed, u and v (None but for acLSTM), recipe, parameters, seconds of training,
    final loss; ``error`` and ``standard_error`` at the eight times, ``errors`` of each seed there; ``motion_change``
    (values every so many frames of the running mean, see :func:`motion_change`); ``failures``; ``foot_skate`` and
    ``bone_drift``. What is not finite is None.
"""

from __future__ import annotations

import dataclasses
import os
import pathlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .. import metrics
from ..errors import DataError
from ..evaluate import jsonable, roll_out
from ..motion.clip import Motion
from ..recipes import Recipe
from ..training.checkpoints import Checkpoint
from .acrnn_examples import examples, explore, failure_strip, load_examples, write_examples
from .acrnn_measure import measure_published, published, seconds_of_measuring, train_and_measure
from .acrnn_plan import LONG_RUNS, QUICK, RATES_TRIED, STYLES, SYSTEMS, Budget, Plan, Protocol
from .acrnn_tables import (
    SCHEMA,
    WIDER_RESULT,
    difference,
    error,
    figures,
    findings,
    last_frame_error,
    load_result,
    motion_change,
    pairs,
    tables,
    true_change,
)
from .cost import Cost, Costs, both, choose_rates, validated, whole_cost
from .grid import Report, Run, Told, asked_for, clips_for, finished, folders, side_by_side
from .results import head, tell_result, write_result
from .sources import clips_from

__all__ = [
    "WIDER_RESULT",
    "difference",
    "error",
    "explore",
    "failure_strip",
    "figures",
    "findings",
    "last_frame_error",
    "load_examples",
    "load_result",
    "measure_shipped",
    "motion_change",
    "pairs",
    "reproduce",
    "tables",
    "true_change",
]


# --- the whole ------------------------------------------------------------------------------------


def reproduce(
    source: str | None = None,
    *,
    runs: str | os.PathLike | None = None,
    out: str | os.PathLike | None = None,
    jobs: int = 2,
    styles: Sequence[str] = tuple(STYLES),
    seeds: Sequence[int] = (0,),
    grid: bool = False,
    long: bool = False,
    tuning: bool = False,
    train_missing: bool = True,
    quick: bool = False,
    budget: Mapping[str, int] | None = None,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Train what is missing, measure, write result and figures; returns the result (see the top of this module).

    Parameters
    ----------
    source : a folder laid out as the catalogue's; "samples" for the sample motions; by default the data that the
        catalogue finds.
    runs : folder for the checkpoints; out : folder for ``acrnn.json`` and the figures (by default that of the runs).
    jobs : how many runs are trained side by side, each in a process with one thread.
    grid : also the pairs of u and v off the diagonal. long : also samples of 18,000 frames. tuning : choose the
        learning rates first. train_missing : without, only runs that are finished are measured.
    budget : what is not the default of :class:`~.acrnn_plan.Budget`, ``{"steps": 10000, "hidden": 256}``.

    Raises :class:`DataError` naming the data sets that are not at hand, ``CheckpointError`` if the folder of runs
    has a run of another recipe in the place of one of these.
    """
    samples = source == "samples"
    plan = Plan(samples=samples, styles=tuple(styles), seeds=tuple(seeds), grid=grid,
                **asked_for(Budget(), QUICK, quick, budget))  # fmt: skip
    runs, out = folders("acrnn", samples, runs, out)
    with clips_from(source, [plan.data(style) for style in plan.styles], samples=samples,
                    hint="--styles takes fewer, --data samples the sample motions", aside=1 + tuning):  # fmt: skip
        record, costs = None, _costs(plan)
        if tuning:
            plan, record = tune(plan, runs, costs, jobs=jobs, tell=tell)
        result = _measured(plan, runs, costs, jobs=jobs, long=long, train_missing=train_missing, tell=tell)
        drawn, motions = figures(result), examples(result, plan, runs)
    if record is not None:
        result["tuning"] = record
    path = write_result(result, out / "acrnn.json")
    if motions is not None:
        drawn["figure-7"] = failure_strip(load_examples(write_examples(*motions, path.with_suffix(".safetensors"))))
    tell_result(path, tables(result), findings(result), drawn, tell)
    return result


def _measured(plan: Plan, folder: pathlib.Path, costs: Costs, *, jobs: int, long: bool, train_missing: bool,
              tell: Callable[[str], None]) -> dict[str, Any]:  # fmt: skip
    runs = plan.runs() if train_missing else finished(plan.runs(), folder)
    long_runs = tuple(run.name for run in runs if long and plan.first(run) in LONG_RUNS)
    left = {run.name: run.steps_left(folder) for run in runs}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of clips that are too short: the training itself will tell
        cost = _whole_cost(plan, runs, left, costs, long_runs=long_runs, jobs=jobs, tell=tell)
    told = Told(runs, left, cost, jobs=jobs, tell=tell)
    tasks = [(run, folder.absolute(), plan.protocol, run.name in long_runs) for run in runs]
    parts = side_by_side(train_and_measure, tasks, jobs=jobs, heard=told, folder=folder)
    result = _frame(plan)
    for run, (split, measured, long_one) in zip(runs, parts, strict=True):
        result["splits"][f"{measured['style']} seed {run.recipe.seed}"] = split
        result["runs"][run.name] = measured
        if long_one is not None:
            result["long"][run.name] = long_one
    if long and not plan.samples and not plan.quick:
        result["long"].update(_shipped(plan, jobs))
    return jsonable(result)


def _shipped(plan: Plan, jobs: int) -> dict[str, Any]:
    """Long samples of the shipped weights."""
    parts = side_by_side(measure_published, [(name, plan.protocol) for name in published()], jobs=jobs)
    return {name: entry for part in parts for name, entry in part.items()}


def measure_shipped(path: str | os.PathLike, source: str | None = None, *, jobs: int = 2,
                    tell: Callable[[str], None] = print) -> dict[str, Any]:  # fmt: skip
    """Measure the shipped weights anew in a result that is there already, for who has put others in their place.

    Nothing is trained and all else stays as it was; the result's ``shipped`` tells when, and with what versions.
    Raises :class:`DataError` for a file that is no result of the CMU's motions or has not all of one, or for data sets
    that are not at hand.
    """
    result, plan = load_result(path), Plan()
    if source == "samples":
        raise DataError(f"samples: the weights shipped are measured on captured motion, expected a folder that holds "
                        f"{', '.join(plan.data(style) for style in plan.styles)}")  # fmt: skip
    _check_whole(result, path)
    with clips_from(source, [plan.data(style) for style in plan.styles], samples=False, aside=0):
        result["long"].update(jsonable(_shipped(plan, jobs)))
    now = head("acrnn", SCHEMA)
    result["shipped"] = {key: now[key] for key in ("versions", "date")}
    write_result(result, path)
    tell(str(tables(result)["long"]))
    tell(f"wrote {path}")
    return result


def _check_whole(result: Mapping[str, Any], path: str | os.PathLike) -> None:
    """:class:`DataError` for a result that long samples of the shipped weights cannot be added to: hours later its
    tables are printed."""
    if result.get("data") != "cmu" or result.get("quick"):
        what = "a quick trial" if result.get("quick") else f"of data {result.get('data')!r}"
        raise DataError(f"{path}: is {what}, expected a whole result of data 'cmu', on which the weights shipped are "
                        "measured")  # fmt: skip
    missing = [key for key, value in _frame(Plan()).items() if not isinstance(result.get(key), type(value))]
    try:
        if not missing:
            tables(result)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        missing = [f"{type(error).__name__} {error}"]
    if missing:
        raise DataError(f"{path}: not a whole result of reproduce acrnn, missing or damaged: {', '.join(missing)}; "
                        "expected one as reproduce acrnn writes it")  # fmt: skip


def _frame(plan: Plan) -> dict[str, Any]:
    """The result of a plan, still without what is measured."""
    protocol = plan.protocol
    return {
        **head("acrnn", SCHEMA),
        "data": "samples" if plan.samples else "cmu",
        "quick": plan.quick,
        "protocol": {
            "seeds": protocol.seeds,
            "seed_frames": protocol.seed_frames,
            "frames": protocol.frames,
            "curve": protocol.curve,
            "times_ms": metrics.PAPER_TIMES_MS,
            "fps": Recipe("lstm", (plan.data(plan.styles[0]),)).fps,
        },
        "budget": {
            **dataclasses.asdict(plan.budget),
            "training_seeds": plan.seeds,
            "learning_rates": dict(plan.rates),
            "rates_tried": RATES_TRIED,
        },
        "styles": {style: {"title": STYLES[style].title, "data": plan.data(style)} for style in plan.styles},
        "splits": {},
        "runs": {},
        "long": {},
    }


# --- cost -----------------------------------------------------------------------------------------


def _costs(plan: Plan) -> Costs:
    """For runs of this plan; kinds are (style, system) of steps and the system alone of measuring."""
    return Costs(lambda recipe: seconds_of_measuring(recipe, clips_for(recipe), plan.protocol),
                 0.02 if plan.quick else 0.6)  # fmt: skip


def _whole_cost(plan: Plan, runs: Sequence[Run], left: Mapping[str, int], costs: Costs, *, long_runs: Sequence[str],
                jobs: int, tell: Callable[[str], None]) -> Cost:  # fmt: skip
    def cost_of(run: Run) -> tuple[float, float]:
        kind = run.name.split("/")[0], run.recipe.system
        step = costs.step(kind, plan.recipe(*kind)) if left[run.name] else 0.0
        after = costs.measuring(run.recipe.system, plan.recipe(*kind))  # of what style makes little difference
        return step, after * (1 + (run.name in long_runs) * plan.protocol.long_frames / plan.protocol.frames)

    sizes = f"{plan.budget.steps} steps, {plan.budget.hidden} cells a layer"
    return whole_cost(runs, left, cost_of, sizes=sizes, jobs=jobs, tell=tell)


# --- learning rates -------------------------------------------------------------------------------


def tune(
    plan: Plan,
    folder: pathlib.Path,
    costs: Costs | None = None,
    *,
    jobs: int,
    tell: Callable[[str], None] = print,
) -> tuple[Plan, dict[str, Any]]:
    """The plan with the learning rate for each system that did best on validation clips, and the record of it.

    A fifth of the training clips is set aside; half of the steps is trained on the rest, for every style, system
    and rate of :data:`RATES_TRIED`; the error is the mean over the eight times of table 1, after 20 seeds from the
    clips set aside. Test clips are not touched. How the rate is chosen: :func:`~.cost.choose_rates`.
    """
    short = dataclasses.replace(plan, budget=dataclasses.replace(plan.budget, steps=max(1, plan.budget.steps // 2)))
    trials = {
        (system, style, rate): Run(
            f"tuning/{style}/{system}-{rate:g}", dataclasses.replace(short.recipe(style, system), learning_rate=rate)
        )
        for system in SYSTEMS
        for style in plan.styles
        for rate in RATES_TRIED
    }
    costs = costs or _costs(plan)

    def step(style: str, system: str) -> float:
        return costs.step((style, system), plan.recipe(style, system))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        later = sum(run.recipe.steps * step(run.name.split("/")[0], run.recipe.system) for run in plan.runs())
    then = f"then {len(plan.runs())} runs of {plan.budget.steps} steps: at most {both(later, jobs)}"
    record = choose_rates(
        validation_error, trials, folder, plan.protocol,
        lambda run: step(run.name.split("/")[1], run.recipe.system), then=then, jobs=jobs, tell=tell,
    )  # fmt: skip
    return dataclasses.replace(plan, rates=record["chosen"]), record


def validation_error(run: Run, folder: pathlib.Path, protocol: Protocol, report: Report) -> float:
    """Mean error over the eight times on clips set aside from the training clips; infinite if training broke off."""

    def error(checkpoint: Checkpoint, aside: list[Motion]) -> float:
        horizon = max(metrics.frames_at(metrics.PAPER_TIMES_MS, run.recipe.fps))
        rolled = roll_out(checkpoint, aside, count=protocol.seeds, frames=max(horizon, round(run.recipe.fps)),
                          seed_frames=protocol.seed_frames)  # fmt: skip
        return float(rolled.errors().mean())

    return validated(run, folder, report, error)
