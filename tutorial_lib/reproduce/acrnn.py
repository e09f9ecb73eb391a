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
    ========== ===================================================================================================

    A run has its style, system, label, seed, u and v (None but for acLSTM), recipe, parameters, seconds of training,
    final loss; ``error`` and ``standard_error`` at the eight times, ``errors`` of each seed there; ``motion_change``
    (values every so many frames of the running mean, see :func:`motion_change`); ``failures``; ``foot_skate`` and
    ``bone_drift``. What is not finite is None.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import math
import os
import pathlib
import platform
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch

from .. import __version__, data, metrics
from ..data.catalog import DATA, data_folder
from ..data.windows import split_clips
from ..errors import DataError
from ..evaluate import jsonable, roll_out
from ..recipes import Recipe
from ..training.checkpoints import load_checkpoint
from ..training.trainer import TrainingError
from .acrnn_examples import examples, explore, failure_strip, load_examples, write_examples
from .acrnn_measure import measure_published, published, seconds_of_measuring, train_and_measure
from .acrnn_plan import LONG_RUNS, QUICK, RATES_TRIED, STYLES, SYSTEMS, Budget, Plan, Protocol
from .acrnn_tables import (
    SCHEMA,
    difference,
    error,
    figures,
    findings,
    load_result,
    motion_change,
    pairs,
    report,
    tables,
    true_change,
    write_result,
)
from .grid import Report, Run, Told, clips_for, duration, seconds_a_step, side_by_side, train

__all__ = [
    "difference",
    "error",
    "explore",
    "failure_strip",
    "figures",
    "findings",
    "load_examples",
    "load_result",
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
    budget : sizes that are not the default, ``{"steps": 10000, "hidden": 256}``.

    Raises :class:`DataError` naming the data sets that are not at hand, ``CheckpointError`` if the folder of runs
    has a run of another recipe in the place of one of these.
    """
    samples = source == "samples"
    sizes = {**dataclasses.asdict(QUICK["budget"] if quick else Budget()), **(budget or {})}
    made = {**(QUICK if quick else {}), "budget": Budget(**sizes)}
    plan = Plan(samples=samples, styles=tuple(styles), seeds=tuple(seeds), grid=grid, **made)
    runs = pathlib.Path(runs or pathlib.Path("runs") / ("acrnn-samples" if samples else "acrnn"))
    out = pathlib.Path(out or runs)
    with _data_from(None if samples else source):
        _check_data(plan, of_folder=source is not None and not samples)
        record, costs = None, _Costs(plan)
        if tuning:
            plan, record = tune(plan, runs, costs, jobs=jobs, tell=tell)
        result = _measured(plan, runs, costs, jobs=jobs, long=long, train_missing=train_missing, tell=tell)
        drawn, motions = figures(result), examples(result, plan, runs)
    if record is not None:
        result["tuning"] = record
    path = write_result(result, out / "acrnn.json")
    if motions is not None:
        drawn["figure-7"] = failure_strip(load_examples(write_examples(*motions, path.with_suffix(".safetensors"))))
    for line in report(result):
        tell(line)
    for name, figure in drawn.items():
        if figure is not None:
            figure.savefig(out / f"acrnn-{name}.png", dpi=120)
    tell(f"wrote {path} ({path.stat().st_size / 1000:.0f} kB) and the figures beside it")
    return result


def _measured(plan: Plan, folder: pathlib.Path, costs: _Costs, *, jobs: int, long: bool, train_missing: bool,
              tell: Callable[[str], None]) -> dict[str, Any]:  # fmt: skip
    all_runs = plan.runs()
    runs = [run for run in all_runs if train_missing or run.steps_left(folder) == 0]
    if not runs:
        raise DataError(f"{folder}: none of the {len(all_runs)} runs is finished, so there is nothing to measure")
    long_runs = tuple(name for name in LONG_RUNS if long and any(run.name == name for run in runs))
    left = {run.name: run.steps_left(folder) for run in runs}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of clips that are too short: the training itself will tell
        cost = _whole_cost(plan, runs, left, costs, long_runs=long_runs, jobs=jobs, tell=tell)
    told = Told(runs, left, cost, jobs=jobs, tell=tell)
    tasks = [(run, folder, plan.protocol, run.name in long_runs) for run in runs]
    parts = side_by_side(train_and_measure, tasks, jobs=jobs, heard=told)
    result = _frame(plan)
    for run, (split, measured, long_one) in zip(runs, parts, strict=True):
        result["splits"][f"{measured['style']} seed {run.recipe.seed}"] = split
        result["runs"][run.name] = measured
        if long_one is not None:
            result["long"][run.name] = long_one
    if long and not plan.samples:
        tasks = [(name, plan.protocol) for name in published() if not plan.quick]
        for part in side_by_side(measure_published, tasks, jobs=jobs):
            result["long"].update(part)
    return jsonable(result)


def _frame(plan: Plan) -> dict[str, Any]:
    """The result of a plan, still without what is measured."""
    protocol = plan.protocol
    return {
        "paper": "acrnn",
        "schema": SCHEMA,
        "versions": {
            "tutorial_lib": __version__,
            "torch": torch.__version__.split("+")[0],
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
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


# --- data -----------------------------------------------------------------------------------------


@contextlib.contextmanager
def _data_from(folder: str | None) -> Iterator[None]:
    """Inside the block, also for processes begun there, data sets are looked for in ``folder`` first."""
    if folder is None:
        yield
        return
    before = os.environ.get(DATA)
    os.environ[DATA] = str(pathlib.Path(folder).expanduser().absolute())
    try:
        yield
    finally:
        if before is None:
            del os.environ[DATA]
        else:
            os.environ[DATA] = before


def _check_data(plan: Plan, *, of_folder: bool) -> None:
    """One error for all data sets that are missing, before anything is computed.

    A folder that was named must have them all; else what is missing is downloaded, as ever.
    """
    missing = []
    places = {row.name: (row.at_hand, row.path) for row in data.listing()}
    for name in map(plan.data, plan.styles):
        at_hand, path = places[name]
        if of_folder and at_hand != DATA:
            missing.append(name)
        elif at_hand in ("empty folder", "missing"):
            missing.append(f"{name} ({at_hand}: {path})")
        elif at_hand == "to download":
            try:
                data.fetch(name)
            except DataError as error:
                missing.append(f"{name} ({getattr(error, 'reason', '') or error})")
    if missing:
        where = f" in {data_folder()}" if of_folder else ""
        raise DataError(
            f"not at hand{where}: {'; '.join(missing)}; expected motion files for all of "
            f"{', '.join(map(plan.data, plan.styles))} (--styles takes fewer, --data samples the sample motions)"
        )


# --- cost -----------------------------------------------------------------------------------------


class _Costs:
    """Seconds that a training step and the measuring of a system take here and now, each tried once."""

    def __init__(self, plan: Plan):
        self._plan = plan
        self._steps: dict[tuple[str, str], float] = {}
        self._measuring: dict[str, float] = {}

    def step(self, style: str, system: str) -> float:
        """One training step, with one thread."""
        kind = style, system
        if kind not in self._steps:
            recipe = self._plan.recipe(style, system)
            self._steps[kind] = seconds_a_step(recipe, clips_for(recipe), 0.02 if self._plan.quick else 0.6)
        return self._steps[kind]

    def measuring(self, style: str, system: str) -> float:
        """One network; of what style makes little difference."""
        if system not in self._measuring:
            recipe = self._plan.recipe(style, system)
            self._measuring[system] = seconds_of_measuring(recipe, clips_for(recipe), self._plan.protocol)
        return self._measuring[system]


def _whole_cost(plan: Plan, runs: Sequence[Run], left: Mapping[str, int], costs: _Costs, *, long_runs: Sequence[str],
                jobs: int, tell: Callable[[str], None]) -> dict[str, tuple[float, float]]:  # fmt: skip
    """(Seconds a step, seconds of measuring) of each run, told as a table with the sum of it all."""
    cost, lines = {}, {}
    for run in runs:
        style, system = run.name.split("/")[0], run.recipe.system
        step = costs.step(style, system) if left[run.name] else 0.0
        after = costs.measuring(style, system)
        after *= 1 + (run.name in long_runs) * plan.protocol.long_frames / plan.protocol.frames
        cost[run.name] = step, after
        line = lines.setdefault(system, [0, 0, 0.0, 0.0])
        line[0] += left[run.name] > 0
        line[1] += left[run.name]
        line[2] += left[run.name] * step
        line[3] += after
    tell(f"{len(runs)} runs of {plan.budget.steps} steps, {plan.budget.hidden} cells a layer; on this machine, now:")
    tell("  system               to train  steps left  s a step  training  evaluation")
    for system, (count, steps, training, after) in lines.items():
        each = f"{training / steps:8.3f}" if steps else "       -"
        tell(f"  {system:<20} {count:>8}  {steps:>10,}  {each}  {duration(training):>8}  {duration(after):>10}")
    total = sum(line[2] + line[3] for line in lines.values())
    tell(f"  the whole cost: {_both(total, jobs)}")
    return cost


def _both(seconds: float, jobs: int) -> str:
    beside = f"{jobs} processes of one thread each" if jobs > 1 else "one process"
    return f"{duration(seconds)} of one core, about {duration(seconds / jobs)} with {beside}"


# --- learning rates -------------------------------------------------------------------------------


def tune(
    plan: Plan,
    folder: pathlib.Path,
    costs: _Costs | None = None,
    *,
    jobs: int,
    tell: Callable[[str], None] = print,
) -> tuple[Plan, dict[str, Any]]:
    """The plan with the learning rate for each system that did best on validation clips, and the record of it.

    A fifth of the training clips is set aside; a fifth of the steps is trained on the rest, for every style, system
    and rate of :data:`RATES_TRIED`; the error is the mean over the eight times of table 1, after 20 seeds from the
    clips set aside. Test clips are not touched. The rate is the one with the lowest geometric mean of the errors over
    the styles (a rate at which training breaks off has an infinite one).
    """
    steps = max(1, plan.budget.steps // 5)
    short = dataclasses.replace(plan, budget=dataclasses.replace(plan.budget, steps=steps))
    cells = [(system, style, rate) for system in SYSTEMS for style in plan.styles for rate in RATES_TRIED]
    tasks, runs = [], []
    for system, style, rate in cells:
        recipe = dataclasses.replace(short.recipe(style, system), learning_rate=rate)
        runs.append(Run(f"tuning/{style}/{system}-{rate:g}", recipe))
        tasks.append((runs[-1], folder, plan.protocol))
    left = {run.name: _steps_left(run, folder) for run in runs}
    costs = costs or _Costs(plan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cost = {run.name: (costs.step(run.name.split("/")[1], run.recipe.system), 1.0) for run in runs}
        later = sum(run.recipe.steps * costs.step(run.name.split("/")[0], run.recipe.system) for run in plan.runs())
    told = Told(runs, left, cost, jobs=jobs, tell=tell)
    tell(f"choosing learning rates, {len(runs)} runs of {steps} steps: {_both(told.work_left(), jobs)}")
    tell(f"then {len(plan.runs())} runs of {plan.budget.steps} steps: at most {_both(later, jobs)}")
    scores = side_by_side(validation_error, tasks, jobs=jobs, heard=told)
    record: dict[str, Any] = {"steps": steps, "rates": RATES_TRIED, "error": {}, "chosen": {}}
    for (system, style, _), score in zip(cells, scores, strict=True):
        record["error"].setdefault(system, {}).setdefault(style, []).append(score)
    for system, styles in record["error"].items():
        total = np.log(np.array(list(styles.values()))).sum(0)  # (rates,)
        record["chosen"][system] = RATES_TRIED[int(total.argmin())]
        edge = total.argmin() in (0, len(total) - 1)
        tell(f"  {system:<20} {record['chosen'][system]:g}" + (", at the edge of what was tried" if edge else ""))
    return dataclasses.replace(plan, rates=record["chosen"]), jsonable(record)


def _steps_left(run: Run, folder: pathlib.Path) -> int:
    try:
        return run.steps_left(folder)
    except TrainingError:  # it broke off: an outcome like another
        return 0


def validation_error(run: Run, folder: pathlib.Path, protocol: Protocol, report: Report) -> float:
    """Mean error over the eight times on clips set aside from the training clips; infinite if training broke off."""
    train_clips, _ = clips_for(run.recipe)[0]
    kept, aside = split_clips(train_clips, 0.2, run.recipe.seed)
    with contextlib.suppress(TrainingError):
        train(run, folder, report, [(kept, aside)])
        checkpoint = load_checkpoint(run.path(folder))
        horizon = max(metrics.frames_at(metrics.PAPER_TIMES_MS, run.recipe.fps))
        rolled = roll_out(checkpoint, aside, count=protocol.seeds, frames=max(horizon, round(run.recipe.fps)),
                          seed_frames=protocol.seed_frames)  # fmt: skip
        report(run.name, run.recipe.steps + 1)
        error = float(rolled.errors().mean())
        return error if math.isfinite(error) else math.inf
    report(run.name, run.recipe.steps + 1)
    return math.inf
