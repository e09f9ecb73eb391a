"""What ``reproduce dynamic-future-net`` trains and how it measures: networks, budget and protocol."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..errors import TutorialError
from ..motion.clip import Motion
from ..recipes import Recipe
from .grid import Clips, Run, clips_for

# Table 1 of the paper: four kinds of motion. Martial arts stand for boxing, Indian dance for dancing.
DATA = {"walking": "cmu/walking", "running": "cmu/running", "boxing": "cmu/martial", "dancing": "cmu/indian"}
SAMPLES = {action: f"samples/{action}" for action in DATA}
ACTIONS = tuple(DATA)

JOINT = "joint"
NO_FUTURE, NO_TEMPORAL = "joint, no future", "joint, no temporal difference"
FAR_FUTURE = "joint, horizon 16"  # section 5.2: the future is 8 or 16 frames long
ACLSTM, VAE = "aclstm", "vae-lstm"
SHIPPED = "shipped"
PUBLISHED = {True: "dfn-samples", False: "dfn-cmu"}  # weights that come with the library: of the samples, of the clips
LIMITED = (20, 7)  # seconds of dance; section 6.4 goes down to 7
SHARES = {"pose_share": 0.45, "future_share": 0.15}  # of the steps; a step of stage 1 costs a fifth of one of stage 3
JOINT_SHARES = {"pose_share": 0.6, "future_share": 0.12}  # four kinds of motion have more poses to be learnt first
JOIN = 0.3  # seconds of blending between CMU clips, of which the shortest has 1.2 s; the samples are long enough
# Each clip also slower and faster by a fifth, and in its mirror image (ours, not the paper's): six seconds of running
# in one rhythm are learnt by heart, and runners that never fall out of step have one future.
RATES = (24.0, 27.0, 30.0, 33.0, 36.0)
MIRROR = True


@dataclasses.dataclass(frozen=True)
class Network:
    """One network of the plan.

    actions: what it is trained on. steps, batch: for each of the budget's. seconds: of data at most; None: all.
    options: what it has of its own. figures: whether what figures 6 to 8 need is kept. many: whether all of the
    protocol's fan is made.
    """

    title: str
    actions: tuple[str, ...] = ACTIONS
    system: str = "dynamic-future-net"
    steps: int = 1
    batch: int = 1
    seconds: int | None = None
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    figures: bool = False
    many: bool = False

    @property
    def joint(self) -> bool:
        """Whether it has more than one action to choose from."""
        return len(self.actions) > 1

    @property
    def futures(self) -> bool:
        """Whether it is a Dynamic Future Net."""
        return self.system == "dynamic-future-net"


TOGETHER = {"steps": 3, "batch": 2}  # times the budget's, for four times the data
NETWORKS = {
    JOINT: Network("all four together", **TOGETHER, figures=True, many=True),
    **{action: Network(f"{action} alone", (action,)) for action in ACTIONS},
    **{f"dancing, {s} s": Network(f"{s} s of dancing", ("dancing",), seconds=s) for s in LIMITED},
    NO_FUTURE: Network("together, without the future state", **TOGETHER, options={"future": 0}),
    NO_TEMPORAL: Network("together, without the temporal-difference loss", **TOGETHER, options={"temporal": 0.0}),
    FAR_FUTURE: Network("together, 16 frames of future", **TOGETHER, options={"horizon": 16}),
    SHIPPED: Network("the weights shipped", figures=True, many=True),  # by the command train; here only measured
    ACLSTM: Network("acLSTM", system="aclstm"),
    VAE: Network("VAE-LSTM", system="vae-lstm"),
}


@dataclasses.dataclass(frozen=True)
class Budget:
    """What all networks have alike; a joint one has more, see :data:`TOGETHER`."""

    steps: int = 2400
    hidden: int = 128
    batch: int = 16
    length: int = 40
    horizon: int = 8


@dataclasses.dataclass(frozen=True)
class Protocol:
    """How a trained network is measured."""

    prefix: int = 20  # frames, section 6.1
    short_prefix: int = 8  # the least of that section; for stability alone
    stable: int = 20  # motions of each action, from prefixes never trained on
    frames: int = 900
    fan: int = 4096  # motions from each of four prefixes, section 6.3; of networks beside the main ones ``pairs``
    fan_frames: int = 128
    at: tuple[int, ...] = (32, 128)  # frames at which they are compared, figure 8
    pairs: int = 1024  # of them, whose pairwise distance is told
    points: int = 200  # of them, in figure 8
    paths: int = 8  # in figure 7
    many: int = 256  # motions in which changes of action are counted
    many_frames: int = 600
    lessons: int = 300  # training steps of the classifier that tells actions
    window: int = 30  # frames that are looked for among the data
    similar: int = 8  # places of the data that begin alike


@dataclasses.dataclass(frozen=True)
class Plan:
    """All that decides what the command trains and measures."""

    samples: bool = False  # the sample motions instead of the CMU clips
    budget: Budget = Budget()
    protocol: Protocol = Protocol()
    networks: tuple[str, ...] = tuple(NETWORKS)
    small: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)  # options of a quick trial
    seed: int = 0
    quick: bool = False

    def __post_init__(self):
        for name in self.networks:
            if name not in NETWORKS:
                raise TutorialError(f"unknown network {name!r}: expected some of {', '.join(NETWORKS)}")
        if not self.networks:
            raise TutorialError(f"no network to measure: expected some of {', '.join(NETWORKS)}")

    @property
    def sources(self) -> dict[str, str]:
        """The data set of each action."""
        return SAMPLES if self.samples else DATA

    @property
    def data(self) -> tuple[str, ...]:
        """The data sets."""
        return tuple(self.sources.values())

    def recipe(self, name: str) -> Recipe:
        """Of one network. All are 1.54 m tall and at 30 frames a second on the 21 common joints.

        The baselines learn from what their own papers have: positions in the world, and the hip's frame. Clips that are
        cut short are not joined: their seconds are all that there is.
        """
        network, sizes = NETWORKS[name], dataclasses.asdict(self.budget)
        horizon = sizes.pop("horizon")
        sizes["steps"] *= network.steps
        sizes["batch"] *= network.batch
        if not self.samples and network.seconds is None and network.system != "vae-lstm":
            sizes["join"] = JOIN
        shares = JOINT_SHARES if network.joint else SHARES
        options = {"horizon": horizon, **shares} if network.futures else {}
        if network.system == "vae-lstm":
            sizes.update(length=120 if not self.quick else 24, pad=True, steps=max(1, sizes["steps"] // 4))
        if network.system == "aclstm":
            sizes.update(length=100 if not self.quick else 24, pad=True)
        return Recipe(
            network.system, tuple(self.sources[action] for action in network.actions), joints="common",
            rates=RATES, mirror=MIRROR, seed=self.seed,
            options={**options, **network.options, **self.small.get(network.system, {})}, **sizes,
        )  # fmt: skip

    def runs(self) -> list[Run]:
        """Everything to train."""
        return [Run(file_name(name), self.recipe(name)) for name in self.networks if name != SHIPPED]

    @property
    def published(self) -> str | None:
        """The weights of the library that are measured as well; none in a quick trial."""
        return PUBLISHED[self.samples] if SHIPPED in self.networks and not self.quick else None


def file_name(name: str) -> str:
    """A network's name as that of a file: ``joint-no-future``."""
    return name.replace(", ", "-").replace(" ", "-")


def name_of(run: Run) -> str:
    """The key in :data:`NETWORKS` of a run."""
    return next(name for name in NETWORKS if file_name(name) == run.name)


def sets_for(run: Run) -> Clips:
    """(Training clips, test clips) of each action, those to train on cut to the seconds that the network is to have."""
    sets, seconds = clips_for(run.recipe), NETWORKS[name_of(run)].seconds
    return sets if seconds is None else [(first_seconds(train, seconds), test) for train, test in sets]


def first_seconds(clips: list[Motion], seconds: float) -> list[Motion]:
    """The beginnings of clips, one after another, until there are so many seconds."""
    kept = []
    for clip in clips:
        frames = min(len(clip), round(seconds * clip.fps))
        kept.append(clip[:frames].with_name(f"{clip.name} (first {frames / clip.fps:g} s)"))
        seconds -= frames / clip.fps
        if seconds < 1 / clip.fps:
            return kept
    return kept


QUICK = {
    "budget": Budget(steps=4, hidden=8, batch=8, length=24),
    "protocol": Protocol(stable=3, frames=60, fan=24, fan_frames=32, at=(8, 32), pairs=16, points=10, paths=3, many=8,
                         many_frames=45, lessons=20, window=10, similar=3),
    "small": {"vae-lstm": {"filters": 4, "kernel": 5}},
    "quick": True,
}  # fmt: skip
