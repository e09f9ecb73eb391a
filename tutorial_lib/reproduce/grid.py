"""Many training runs, one beside the other: what every paper's ``reproduce`` command stands on.

A :class:`Run` is a name and a recipe; its checkpoint is ``FOLDER/name.safetensors``. Runs go to processes of their own
(:mod:`.spread`), each with one torch thread, since small networks gain little from a second one. They can be stopped
and killed at any moment and are resumed from their last save; a process whose parent is gone saves and ends.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import pathlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..data.catalog import DATA
from ..errors import CheckpointError, DataError, TutorialError
from ..motion.clip import Motion
from ..recipes import Recipe, check_same_clips, differences, recipe_in, sets_of, trainer_for
from ..threads import torch_threads
from ..training.checkpoints import Checkpoint, read_header
from ..training.trainer import Trainer, TrainingError
from .spread import Report, Stopped
from .spread import side_by_side as side_by_side

Clips = Sequence[tuple[list[Motion], list[Motion]]]  # what recipes.sets_of gives

SAVE_SECONDS = 60.0


@dataclasses.dataclass(frozen=True)
class Run:
    """One network to train. ``name`` is its place below the folder of runs, such as ``martial/aclstm``."""

    name: str
    recipe: Recipe

    def path(self, folder: str | os.PathLike) -> pathlib.Path:
        """Its checkpoint in a folder of runs."""
        return pathlib.Path(folder) / f"{self.name}.safetensors"

    def steps_left(self, folder: str | os.PathLike) -> int:
        """How many steps are still to be trained.

        Raises :class:`CheckpointError` if the run of another recipe is in its place, :class:`TrainingError` if it
        stopped for good.
        """
        path = self.path(folder)
        if not path.exists():
            return self.recipe.steps
        header = read_header(path)
        try:
            there = recipe_in(header)
        except CheckpointError as error:
            raise CheckpointError(f"{path}: {error}") from None
        for name, (asked, stored) in differences(self.recipe, there).items():
            raise CheckpointError(
                f"{path}: holds a run with {name} {stored!r}, asked for {asked!r}; take another folder for the runs, "
                "or remove that file"
            )
        status = header["training"].get("status")
        if not header["resumable"] and status != "finished":
            raise TrainingError(f"{path}: training has stopped for good: {status}")
        return self.recipe.steps - int(header["training"]["steps_done"])


def finished(runs: Sequence[Run], folder: str | os.PathLike) -> list[Run]:
    """Those that are trained to their end; :class:`DataError` if none is."""
    found = [run for run in runs if run.steps_left(folder) == 0]
    if not found:
        raise DataError(f"{folder}: none of the {len(runs)} runs is finished, so there is nothing to measure")
    return found


def asked_for(default: Any, trial: Mapping[str, Any], quick: bool, budget: Mapping[str, int] | None) -> dict[str, Any]:
    """A plan's arguments: its budget with the sizes that were asked for, and all of a ``quick`` trial's."""
    base = trial["budget"] if quick else default
    return {**(trial if quick else {}), "budget": dataclasses.replace(base, **(budget or {}))}


def folders(
    name: str, samples: bool, runs: str | os.PathLike | None, out: str | os.PathLike | None
) -> tuple[pathlib.Path, pathlib.Path]:
    """The folder of a command's runs, by default ``runs/name``, and that of its result, by default the same."""
    runs = pathlib.Path(runs or pathlib.Path("runs") / (f"{name}-samples" if samples else name))
    return runs, pathlib.Path(out or runs)


def check_each_once(**several: Sequence[Any]) -> None:
    """:class:`TutorialError` for values of which there is none, or one twice."""
    for name, values in several.items():
        if not values or len(set(values)) < len(values):
            raise TutorialError(f"{name} {list(values)}: expected one or more, each once")


def trained_with(recipe: Recipe, checkpoint: Checkpoint) -> dict[str, Any]:
    """What every result says of a run: its recipe, and what the training told."""
    return {
        "recipe": recipe.to_dict(),
        "parameters": checkpoint.n_parameters,
        "seconds": checkpoint.training["seconds"],
        "loss": checkpoint.training["loss"],
    }


def clips_for(recipe: Recipe) -> Clips:
    """What :func:`tutorial_lib.recipes.sets_of` gives, kept for the next runs on the same data set."""
    data = Recipe("lstm", recipe.data, height=recipe.height, joints=recipe.joints, test_fraction=recipe.test_fraction,
                  seed=recipe.seed)  # fmt: skip
    return _kept_clips(data, os.environ.get(DATA))


@functools.lru_cache(maxsize=4)
def _kept_clips(recipe: Recipe, folder: str | None) -> Clips:
    return sets_of(recipe)


def train(run: Run, folder: str | os.PathLike, report: Report, sets: Clips | None = None) -> None:
    """Train what is left of a run; ``sets`` are its clips, by default :func:`clips_for` its recipe.

    Raises :class:`Stopped`, with everything saved, on Ctrl-C or when ``report`` does; :class:`CheckpointError` for a
    run of other clips, also a finished one: measured on these it could have been trained on them.
    """
    left = run.steps_left(folder)
    sets = clips_for(run.recipe) if sets is None else sets
    if left == 0:
        path = run.path(folder)
        check_same_clips(path, run.recipe, read_header(path)["provenance"], sets)
        return
    trainer = trainer_for(run.recipe, run.path(folder), save_seconds=SAVE_SECONDS, sets=sets,
                          command="python -m tutorial_lib reproduce")  # fmt: skip

    def each_step(trainer: Trainer) -> None:
        try:
            report(run.name, trainer.step)
        except Stopped:
            trainer.save()
            raise

    trainer.run(progress=False, live_plot=False, callback=each_step)
    if not trainer.finished:
        raise Stopped


def seconds_a_step(recipe: Recipe, sets: Clips, trial: float = 0.6) -> float:
    """How long a training step of a recipe takes here and now with one thread, tried for ``trial`` seconds."""
    trainer = trainer_for(dataclasses.replace(recipe, steps=100_000), sets=sets)
    with torch_threads(1):
        trainer.run(progress=False, live_plot=False, max_seconds=0)  # the first step is slow
        start, first = time.monotonic(), trainer.step
        while trainer.step < first + 3 or time.monotonic() - start < trial:
            trainer.run(progress=False, live_plot=False, max_seconds=0)
        return (time.monotonic() - start) / (trainer.step - first)


# --- what is told meanwhile -----------------------------------------------------------------------


class Told:
    """Progress of many runs as plain lines: which run, how far, how many are done, when all will be.

    left: the steps that each run still has to go. cost: seconds of one core that each run is expected to take,
    ``{name: (a step, measuring after the last)}``.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        left: Mapping[str, int],
        cost: Mapping[str, tuple[float, float]],
        *,
        jobs: int,
        tell: Callable[[str], None] = print,
        every: float = 30.0,
    ):
        self._steps = {run.name: run.recipe.steps for run in runs}
        self._done = {run.name: run.recipe.steps - left[run.name] for run in runs}
        self._cost, self._jobs, self._tell, self._every = cost, jobs, tell, every
        self._finished: set[str] = set()
        self._start = self._last = time.monotonic()
        self._work = self.work_left()

    def work_left(self) -> float:
        """Seconds of one core, as calibrated."""
        return sum(
            (steps - self._done[name]) * self._cost[name][0] + self._cost[name][1]
            for name, steps in self._steps.items()
            if name not in self._finished
        )

    def __call__(self, name: str, step: int) -> None:
        """``step`` steps of the run ``name`` are done; one more than there are: it has been measured too."""
        if step > self._steps[name]:
            self._done[name] = self._steps[name]
            self._finished.add(name)
        else:
            self._done[name] = step
        now = time.monotonic()
        if step > self._steps[name]:
            self._tell(f"{name}: done; {self._rest(now)}")
        elif now - self._last >= self._every:
            going = ", ".join(
                f"{n} {self._done[n]} of {s} steps" for n, s in self._steps.items() if 0 < self._done[n] < s
            )
            self._tell(f"{going or name}; {self._rest(now)}")
            self._last = now

    def _rest(self, now: float) -> str:
        left, spent = self.work_left(), now - self._start
        done = self._work - left
        seconds = left / self._jobs
        if spent > 20 and done > 10:  # what has been done tells more than the calibration
            seconds = left * spent / done
        many = f"{len(self._finished)} of {len(self._steps)} runs done"
        if left <= 0:
            return many
        at = time.strftime("%H:%M", time.localtime(time.time() + seconds))
        return f"{many}, all at about {at} ({duration(seconds)} more)"


def duration(seconds: float) -> str:
    """For a person: 40 s, 12 min, 3 h 05 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
