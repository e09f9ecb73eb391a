"""What ``reproduce acrnn`` trains and how it measures: styles, systems, budget and learning rates."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..errors import TutorialError
from ..generate import SEED_FRAMES
from ..recipes import Recipe
from .grid import Run, check_each_once


@dataclasses.dataclass(frozen=True)
class Style:
    """A kind of motion: its name in the paper's tables, its clips, and the samples that stand in for them."""

    title: str
    data: str
    sample: str


STYLES = {
    "walking": Style("Walking", "cmu/walking", "samples/walking"),
    "indian": Style("Indian Dance", "cmu/indian", "samples/dancing"),
    "martial": Style("Martial Arts", "cmu/martial", "samples/boxing"),
}
DANCE = "indian"  # what table 2 and figure 9 are of


@dataclasses.dataclass(frozen=True)
class Budget:
    """What every system has alike."""

    steps: int = 1000
    hidden: int = 64
    batch: int = 16
    length: int = 100
    rates: tuple[float, ...] = (20.0, 24.0, 30.0, 40.0)  # "at multiple frame-rates" (acRNN, section 3)
    mirror: bool = False  # whether clips are also learnt from in their mirror image, left and right exchanged

    def options(self, system: str) -> dict[str, Any]:
        """A system's options that depend on the window: of 100 frames seq2seq is shown 50 and predicts 10."""
        return {"n_seed": self.length // 2, "n_future": max(1, self.length // 10)} if system == "seq2seq" else {}


@dataclasses.dataclass(frozen=True)
class SystemRow:
    """A row of table 1: the system's name in the table and what it has of its own."""

    title: str
    learning_rate: float
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)


RATES_TRIED = (5e-4, 1e-3, 2e-3)
SYSTEMS = {
    "lstm": SystemRow("LSTM-3LR", 2e-3),
    "aclstm": SystemRow("acLSTM-3LR", 2e-3, {"u": 5, "v": 5}),
    "erd": SystemRow("ERD", 2e-3),
    "seq2seq": SystemRow("seq2seq", 2e-3),
    "scheduled-sampling": SystemRow("sch. smp.", 2e-3, {"probability": 0.5, "decay": "fixed"}),
}
TABLE_2_PAIRS = ((10, 10), (2, 2), (1, 1))  # and (5, 5), which is table 1's
GRID_PAIRS = ((10, 1), (1, 10), (10, 5), (5, 10))
LONG_RUNS = tuple(f"{style}/{system}" for style in ("martial", "indian") for system in ("aclstm", "lstm"))
LONG_FRAMES = 18_000


@dataclasses.dataclass(frozen=True)
class Protocol:
    """How a trained network is measured: acRNN, section 4."""

    seeds: int = 20
    frames: int = 1000
    curve: int = 900  # frames of figures 2 and 9
    long_samples: int = 20
    long_frames: int = LONG_FRAMES
    seed_frames: int = SEED_FRAMES


@dataclasses.dataclass(frozen=True)
class Plan:
    """All that decides what the command trains and measures."""

    samples: bool = False  # the sample motions instead of the CMU's
    styles: tuple[str, ...] = tuple(STYLES)
    seeds: tuple[int, ...] = (0,)
    grid: bool = False
    budget: Budget = Budget()
    protocol: Protocol = Protocol()
    rates: Mapping[str, float] = dataclasses.field(
        default_factory=lambda: {name: row.learning_rate for name, row in SYSTEMS.items()}
    )
    quick: bool = False

    def __post_init__(self):
        for style in self.styles:
            if style not in STYLES:
                raise TutorialError(f"unknown style {style!r}; known are {', '.join(STYLES)}")
        check_each_once(styles=self.styles, seeds=self.seeds)
        object.__setattr__(self, "seeds", tuple(sorted(self.seeds)))  # the lowest first, as readers take it

    def data(self, style: str) -> str:
        """The data set of a style."""
        return STYLES[style].sample if self.samples else STYLES[style].data

    def recipe(self, style: str, system: str, seed: int = 0, **options: Any) -> Recipe:
        """Of one run; ``options`` replace the system's own."""
        own = {**SYSTEMS[system].options, **self.budget.options(system), **options}
        return Recipe(
            system, (self.data(style),), learning_rate=self.rates[system], seed=seed, options=own,
            **dataclasses.asdict(self.budget),
        )  # fmt: skip

    def first(self, run: Run) -> str | None:
        """The name of a run of the first training seed, without the seed; None for one of another seed."""
        seed = run.recipe.seed
        return run.name.removesuffix(f"-seed{seed}") if seed == self.seeds[0] else None

    def runs(self) -> list[Run]:
        """Everything to train, in the order of its worth: table 1, table 2, the grid; then the other seeds."""
        found = []
        for seed in self.seeds:
            after = f"-seed{seed}" if seed else ""
            found += [
                Run(f"{style}/{system}{after}", self.recipe(style, system, seed))
                for style in self.styles
                for system in SYSTEMS
            ]
            if DANCE in self.styles:
                pairs = TABLE_2_PAIRS + (GRID_PAIRS if self.grid and seed == self.seeds[0] else ())
                found += [
                    Run(f"{DANCE}/{label(u, v)}{after}", self.recipe(DANCE, "aclstm", seed, u=u, v=v)) for u, v in pairs
                ]
        return found


QUICK = {
    "budget": Budget(steps=4, hidden=8, batch=4, length=24),
    "protocol": Protocol(seeds=4, frames=60, curve=45, long_samples=3, long_frames=120),
    "quick": True,
}


def label(u: int, v: int) -> str:
    """The label of acLSTM with u frames of truth and v of its own."""
    row = SYSTEMS["aclstm"].options
    return "aclstm" if (u, v) == (row["u"], row["v"]) else f"aclstm-u{u}-v{v}"
