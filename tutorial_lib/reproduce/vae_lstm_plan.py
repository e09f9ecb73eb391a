"""What ``reproduce vae-lstm`` trains and how it measures: systems, budget and learning rates."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..clip_errors import CLIP_FRAMES, PAPER_FRAMES
from ..errors import TutorialError
from ..motion.ground import PREPARED
from ..recipes import Recipe
from .grid import Run, check_each_once

DATA = ("bandai-namco/locomotion",)
SAMPLES = ("samples/walking", "samples/running")


@dataclasses.dataclass(frozen=True)
class SystemRow:
    """A row of the tables: its name there, the system, and what it has of its own.

    steps: of training for each of the VAE-LSTM's.
    """

    title: str
    system: str
    steps: int = 1
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)


# A step of the VAE-LSTM takes twice the time of one of the LSTMs or of CD-15, and six times that of CD-1: with so many
# more steps no baseline has seen fewer windows, and all have had about its seconds.
VAE = "vae-lstm"
SYSTEMS = {
    "erd": SystemRow("ERD", "erd", 2),
    "lstm": SystemRow("LSTM-3LR", "lstm", 2),
    "crbm-cd1": SystemRow("cRBM, CD-1", "crbm", 4, {"cd": 1}),
    "crbm-cd15": SystemRow("cRBM, CD-15", "crbm", 2, {"cd": 15}),
    VAE: SystemRow("VAE-LSTM", "vae-lstm"),
}
BASELINES = tuple(name for name in SYSTEMS if name != VAE)
RATES_TRIED = (1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2, 3.2e-2, 6.4e-2)


@dataclasses.dataclass(frozen=True)
class Budget:
    """What every system has alike; ``steps`` are the VAE-LSTM's, see :class:`SystemRow`."""

    steps: int = 400
    hidden: int = 128
    batch: int = 32
    length: int = CLIP_FRAMES
    pad: bool = True  # "pad individual sequences with the first and final pose if necessary" (section 4.1)


@dataclasses.dataclass(frozen=True)
class Protocol:
    """How a trained network is measured: section 4.3 of the paper, and what the paper has not."""

    clips: int = 20  # "the held-out test set consisting of 20 sequences"
    frames: int = CLIP_FRAMES
    at: tuple[int, ...] = PAPER_FRAMES  # of a clip at 60 frames a second
    shown: int = 30  # the paper's 60 at 60 frames a second, where control is predicted (table 1)
    start: int = 4  # where it is given (table 2)
    samples: int = 64  # on one path
    codes: int = 9  # on the line between two codes, both ends among them
    pairs: int = 8  # of codes
    paths: tuple[str, ...] = tuple(PREPARED)
    pace: float = 1.3  # m/s on them
    seconds: float = 10.0  # of motion whose making is timed


def check_pooled(length: int) -> None:
    """:class:`TutorialError` for windows that the two poolings of the VAE-LSTM cannot divide."""
    if length % 4:
        raise TutorialError(f"windows of {length} frames: expected a multiple of 4, the pooling's")


@dataclasses.dataclass(frozen=True)
class Plan:
    """All that decides what the command trains and measures."""

    samples: bool = False  # the sample motions instead of bandai-namco/locomotion
    seeds: tuple[int, ...] = (0,)
    budget: Budget = Budget()
    protocol: Protocol = Protocol()
    rates: Mapping[str, float] = dataclasses.field(default_factory=lambda: dict.fromkeys(SYSTEMS, 2e-3))
    small: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)  # options of a quick trial
    quick: bool = False

    def __post_init__(self):
        check_each_once(seeds=self.seeds)
        object.__setattr__(self, "seeds", tuple(sorted(self.seeds)))  # the lowest first, as readers take it
        check_pooled(self.budget.length)

    @property
    def data(self) -> tuple[str, ...]:
        """The data sets."""
        return SAMPLES if self.samples else DATA

    def recipe(self, name: str, seed: int = 0) -> Recipe:
        """Of one run: all have the same clips, windows, representation, cells and seconds.

        In the hip's frame turning a window changes nothing, so none is turned; sizes are left as they are, for the
        errors are in the metres of the people themselves.
        """
        row, sizes = SYSTEMS[name], dataclasses.asdict(self.budget)
        sizes["steps"] *= row.steps
        return Recipe(
            row.system, self.data, representation="hip-frame", joints="common", height=None, rotate=False, seed=seed,
            learning_rate=self.rates[name], options={**row.options, **self.small.get(row.system, {})}, **sizes,
        )  # fmt: skip

    def runs(self) -> list[Run]:
        """Everything to train; the VAE-LSTM comes first, then the other systems, then the other seeds."""
        return [
            Run(f"{name}-seed{seed}" if seed else name, self.recipe(name, seed))
            for seed in self.seeds
            for name in (VAE, *BASELINES)
        ]


def name_of(run: Run) -> str:
    """The system of a run, its key in :data:`SYSTEMS`."""
    return run.name.removesuffix(f"-seed{run.recipe.seed}")


QUICK = {
    "budget": Budget(steps=2, hidden=8, batch=16, length=24),
    "protocol": Protocol(clips=4, samples=5, codes=3, pairs=2, paths=("circle",), seconds=2.0),
    "small": {"vae-lstm": {"filters": 4, "kernel": 5}, "crbm": {"gibbs": 2}},
    "quick": True,
}
