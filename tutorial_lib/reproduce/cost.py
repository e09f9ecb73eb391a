"""What a ``reproduce`` command will cost, told before it begins, and learning rates chosen on validation clips."""

from __future__ import annotations

import contextlib
import math
import pathlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np

from ..data.windows import split_clips
from ..errors import TutorialError
from ..evaluate import jsonable
from ..motion.clip import Motion
from ..recipes import Recipe
from ..training.checkpoints import Checkpoint, load_checkpoint
from ..training.trainer import TrainingError
from .grid import Report, Run, Told, clips_for, duration, seconds_a_step, side_by_side, train

Cost = dict[str, tuple[float, float]]  # of each run: seconds a step, seconds of measuring


class Costs:
    """Seconds that a training step and the measuring of a run take here and now, each kind of run tried once.

    measuring: says how long it takes for a recipe. trial: seconds of trying a step.
    """

    def __init__(self, measuring: Callable[[Recipe], float], trial: float = 0.6):
        self._measure, self._trial = measuring, trial
        self._steps: dict[Hashable, float] = {}
        self._measuring: dict[Hashable, float] = {}

    def step(self, kind: Hashable, recipe: Recipe) -> float:
        """One training step, with one thread."""
        if kind not in self._steps:
            self._steps[kind] = seconds_a_step(recipe, clips_for(recipe), self._trial)
        return self._steps[kind]

    def measuring(self, kind: Hashable, recipe: Recipe) -> float:
        """One network."""
        if kind not in self._measuring:
            self._measuring[kind] = self._measure(recipe)
        return self._measuring[kind]


def whole_cost(
    runs: Sequence[Run],
    left: Mapping[str, int],
    cost_of: Callable[[Run], tuple[float, float]],
    *,
    sizes: str,
    jobs: int,
    kind: Callable[[Run], str] = lambda run: run.recipe.system,
    tell: Callable[[str], None] = print,
) -> Cost:
    """The cost of each run, told as a table of the kinds of runs with the sum of it all.

    left: steps that each run still has to go. cost_of: its seconds a step and of measuring. sizes: a line's beginning.
    """
    cost, lines = {}, {}
    for run in runs:
        step, after = cost[run.name] = cost_of(run)
        line = lines.setdefault(kind(run), [0, 0, 0.0, 0.0])
        line[0] += left[run.name] > 0
        line[1] += left[run.name]
        line[2] += left[run.name] * step
        line[3] += after
    tell(f"{len(runs)} runs of {sizes}; on this machine, now:")
    tell("  system               to train  steps left  s a step  training  evaluation")
    for system, (count, steps, training, after) in lines.items():
        each = f"{training / steps:8.3f}" if steps else "       -"
        tell(f"  {system:<20} {count:>8}  {steps:>10,}  {each}  {duration(training):>8}  {duration(after):>10}")
    tell(f"  the whole cost: {both(sum(line[2] + line[3] for line in lines.values()), jobs)}")
    return cost


def both(seconds: float, jobs: int) -> str:
    """Seconds of one core, and of several processes."""
    beside = f"{jobs} processes of one thread each" if jobs > 1 else "one process"
    return f"{duration(seconds)} of one core, about {duration(seconds / jobs)} with {beside}"


# --- learning rates -------------------------------------------------------------------------------


def choose_rates(
    score: Callable[..., float],
    trials: Mapping[tuple[str, str, float], Run],
    folder: pathlib.Path,
    settings: Any,
    step_seconds: Callable[[Run], float],
    *,
    then: str = "",
    jobs: int,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """The learning rate for each system that did best on validation clips, and the record of it.

    trials: a run for every system, data set and rate. ``score(run, folder, settings, report)`` is its error there,
    of which the rate with the lowest geometric mean over the data sets is chosen (a rate at which training breaks off
    has an infinite one; a data set on which all do is left out, and told). then: what is told of the cost afterwards.
    Returns ``steps`` (a number, or {system: steps} where they differ), ``rates``, ``error`` {system: {data set: [of
    each rate]}} and ``chosen`` {system: rate}. Raises :class:`TutorialError` for a system that no rate can train.
    """
    rates = tuple(dict.fromkeys(rate for *_, rate in trials))
    runs = list(trials.values())
    cost = {run.name: (step_seconds(run), 1.0) for run in runs}
    told = Told(runs, {run.name: _steps_left(run, folder) for run in runs}, cost, jobs=jobs, tell=tell)
    steps = sorted({run.recipe.steps for run in runs})
    each = f"{steps[0]} steps" if len(steps) == 1 else f"{steps[0]} to {steps[-1]} steps"
    tell(f"choosing learning rates, {len(runs)} runs of {each}: {both(told.work_left(), jobs)}")
    if then:
        tell(then)
    tasks = [(run, folder.absolute(), settings) for run in runs]
    scores = side_by_side(score, tasks, jobs=jobs, heard=told, folder=folder)
    record: dict[str, Any] = {"steps": steps[0], "rates": rates, "error": {}, "chosen": {}}
    if len(steps) > 1:
        record["steps"] = {system: run.recipe.steps for (system, *_), run in trials.items()}
    for (system, name, _), error in zip(trials, scores, strict=True):
        record["error"].setdefault(system, {}).setdefault(name, []).append(error)
    for system, sets in record["error"].items():
        best, said = _best_rate(system, sets, rates)
        record["chosen"][system] = rates[best]
        edge = best in (0, len(rates) - 1)
        tell(f"  {system:<20} {rates[best]:g}" + (", at the edge of what was tried" if edge else "") + said)
    return jsonable(record)


def _best_rate(system: str, sets: Mapping[str, Sequence[float]], rates: Sequence[float]) -> tuple[int, str]:
    """The number of the rate that does best on the data sets, and what is to be told of those left out.

    A data set on which no rate has a finite error says nothing of the rates. :class:`TutorialError` if none is left.
    """
    tried = ", ".join(f"{rate:g}" for rate in rates)
    told = {name: errors for name, errors in sets.items() if np.isfinite(errors).any()}
    if told:
        total = np.log(np.array(list(told.values()))).sum(0)  # (rates,)
        if np.isfinite(total.min()):
            left = [name for name in sets if name not in told]
            return int(total.argmin()), f"; without {', '.join(left)}, where no rate has a finite error" if left else ""
    raise TutorialError(
        f"{system}: none of the learning rates {tried} has a finite error on {', '.join(told or sets)}, expected one "
        "that does; without --tune the default is taken"
    )


def _steps_left(run: Run, folder: pathlib.Path) -> int:
    try:
        return run.steps_left(folder)
    except TrainingError:  # it broke off: an outcome like another
        return 0


def validated(
    run: Run, folder: pathlib.Path, report: Report, error: Callable[[Checkpoint, list[Motion]], float]
) -> float:
    """``error(checkpoint, clips)`` on a fifth of each data set's training clips, set aside; the rest is trained on.

    Infinite where training broke off or the error is not finite. Test clips are not touched.
    """
    parts = [split_clips(train_clips, 0.2, run.recipe.seed) for train_clips, _ in clips_for(run.recipe)]
    found = math.inf
    with contextlib.suppress(TrainingError):
        train(run, folder, report, parts)
        found = float(error(load_checkpoint(run.path(folder)), [motion for _, aside in parts for motion in aside]))
    report(run.name, run.recipe.steps + 1)
    return found if math.isfinite(found) else math.inf
