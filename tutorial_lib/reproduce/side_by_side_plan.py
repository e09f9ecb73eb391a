"""What ``reproduce side-by-side`` trains and how it measures: every system of the library under one budget."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..recipes import Recipe
from .grid import Run, check_each_once
from .vae_lstm_plan import check_pooled

DATA = ("cmu/walking",)
SAMPLES = ("samples/walking",)


@dataclasses.dataclass(frozen=True)
class SystemRow:
    """A row of the table: its title, the system, its own settings, and what it can do.

    share: of the budget's steps. A step costs each system something else; with these shares all have a minute or so of
    one core, and LSTM-3LR's network the same steps under every schedule. recipe: settings of its paper that the others
    have not. control: whether it goes where it is told; chance: whether it draws, so that one beginning has many
    futures.
    """

    title: str
    system: str
    share: float
    recipe: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    control: bool = False
    chance: bool = False


HIP = {"representation": "hip-frame", "rotate": False}  # turns with the body, so that random turns change nothing
VAE, DFN = "vae-lstm", "dynamic-future-net"
SYSTEMS = {
    "lstm": SystemRow("LSTM-3LR", "lstm", 0.65),
    "aclstm": SystemRow("acLSTM", "aclstm", 0.65, options={"u": 5, "v": 5}),
    "scheduled-sampling": SystemRow("scheduled sampling", "scheduled-sampling", 0.65),
    "erd": SystemRow("ERD", "erd", 1.4),
    "seq2seq": SystemRow("seq2seq", "seq2seq", 0.9),
    "crbm": SystemRow("cRBM", "crbm", 0.9, HIP, {"cd": 15}, chance=True),
    VAE: SystemRow("VAE-LSTM", VAE, 0.38, {**HIP, "pad": False}, control=True, chance=True),
    DFN: SystemRow("Dynamic Future Net", DFN, 0.3, {"length": 40}, chance=True),
    # In no paper: the first two once more, in the representation of the VAE-LSTM. They tell what is the training's and
    # what the representation's.
    "lstm-hip": SystemRow("LSTM-3LR, hip frame", "lstm", 0.65, HIP),
    "aclstm-hip": SystemRow("acLSTM, hip frame", "aclstm", 0.65, HIP, {"u": 5, "v": 5}),
}


@dataclasses.dataclass(frozen=True)
class Budget:
    """What every system has alike; ``steps`` are those of a share of 1, see :class:`SystemRow`."""

    steps: int = 4000
    hidden: int = 64
    batch: int = 16
    length: int = 60  # frames of a window: no clip of cmu/walking is shorter
    learning_rate: float = 2e-3

    def options(self, system: str) -> dict[str, Any]:
        """A system's options that depend on the window: seq2seq is shown half of it and predicts a sixth."""
        return {"n_seed": self.length // 2, "n_future": max(1, self.length // 6)} if system == "seq2seq" else {}


@dataclasses.dataclass(frozen=True)
class Protocol:
    """How a trained network is measured; times are at 30 frames a second."""

    seeds: int = 20
    seed_frames: int = 20  # as many as the Dynamic Future Net's paper has; what is shown more does not help the others
    frames: int = 900
    futures: int = 16  # drawn from each seed
    future_frames: int = 60
    paths: tuple[str, ...] = ("circle", "figure of eight")
    pace: float = 1.3  # m/s on them
    timed: int = 300  # frames of one character whose making is timed


@dataclasses.dataclass(frozen=True)
class Plan:
    """All that decides what the command trains and measures."""

    samples: bool = False  # the sample motions instead of cmu/walking
    seeds: tuple[int, ...] = (0,)
    budget: Budget = Budget()
    protocol: Protocol = Protocol()
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
        """Of one run: clips, split, the 21 common joints, height and cells are those of all others."""
        row, sizes = SYSTEMS[name], dataclasses.asdict(self.budget)
        sizes["steps"] = max(1, round(self.budget.steps * row.share))
        options = {**row.options, **self.budget.options(row.system), **self.small.get(row.system, {})}
        return Recipe(row.system, self.data, joints="common", seed=seed, options=options, **{**sizes, **row.recipe})

    def runs(self) -> list[Run]:
        """Everything to train, one training seed after the other."""
        return [
            Run(f"{name}-seed{seed}" if seed else name, self.recipe(name, seed))
            for seed in self.seeds
            for name in SYSTEMS
        ]


def name_of(run: Run) -> str:
    """The system of a run, its key in :data:`SYSTEMS`."""
    return run.name.removesuffix(f"-seed{run.recipe.seed}")


QUICK = {
    "budget": Budget(steps=10, hidden=8, batch=4, length=24),
    "protocol": Protocol(seeds=4, frames=60, futures=3, future_frames=30, paths=("circle",), timed=10),
    "small": {VAE: {"filters": 4, "kernel": 5}, "crbm": {"cd": 1, "gibbs": 2}},
    "quick": True,
}
