"""The systems that can be trained: each a name, a network and the loss that it is trained with.

The trainer, the checkpoints and the command line know a system only through :data:`SYSTEMS`.
A new one is a network with a frozen configuration, a loss function, and one entry here.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from ..chance import whole_seed
from ..errors import CheckpointError, TutorialError
from ..models.crbm import CRBM, CRBMConfig
from ..models.dynamic_future_net import DynamicFutureNet, DynamicFutureNetConfig
from ..models.recurrent import ERD, LSTM3LR, ERDConfig, LSTM3LRConfig, Seq2Seq, Seq2SeqConfig
from ..models.vae_lstm import VAELSTM, VAELSTMConfig
from ..models.variational import standard_normal_like
from ..representations import REPRESENTATIONS, Representation
from .conditioning import (
    auto_conditioning,
    check_decay,
    check_noise,
    scheduled_sampling,
    seed_only,
    truth_probability,
)
from .contrastive_divergence import ContrastiveDivergence
from .future_loss import DynamicFutureLoss
from .rollout import rollout
from .stages import Stage
from .variational_loss import VariationalLoss

LossFunction = Callable[..., Any]
"""``loss(model, batch, rng, progress)`` -> scalar tensor, or the pair (scalar, {name of term: scalar}).

``rng`` is a ``torch.Generator`` on the CPU, for everything that the loss draws; ``progress`` runs from 0 at
the first step to 1 at the last, for losses that change on the way."""


def next_frame_loss(
    model: nn.Module, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
) -> Tensor:
    r"""Teacher forcing: the network is fed the truth at every step and asked for the next frame.

    .. math:: L(x_t) = \| H(x_t, m_t) - x_{t+1} \|_2^2   \qquad (1)

    Zhou et al., section 3, equation 1: the squared Euclidean distance, *summed* over the D numbers of
    a frame, then averaged over the sequences and their time steps.

    ``batch`` is (B, T, D); the first T - 1 frames go in, the last T - 1 are the targets.
    """
    prediction, _ = model(batch[:, :-1])  # H(x_t, m_t): (B, T-1, D)
    distance = (prediction - batch[:, 1:]).square().sum(dim=-1)  # ||. - x_{t+1}||^2: (B, T-1)
    return distance.mean()


def scheduled_loss(
    model: nn.Module, batch: Tensor, schedule: Tensor, *, noise: float = 0.0, rng: torch.Generator | None = None
) -> Tensor:
    r"""The loss under any schedule: fed truth or its own output, the network is asked for the *true* next frame.

    .. math:: L(x_t) = \| H(\hat x_t^k, m_t) - x_{t+1} \|_2^2   \qquad (2)

    Zhou et al., section 3, equation 2; where the truth is fed, k = 0 and it is equation 1. Summed over the D numbers
    of a frame, averaged over sequences and time steps, as :func:`next_frame_loss`; the gradient runs back
    through the outputs that were fed.

    ``batch`` is (B, T, D); ``schedule``, (T - 1,) or (B, T - 1), is for the first T - 1 frames. ``noise``: see
    :func:`noisy`; it is on the truth that is fed, never on the targets.
    """
    prediction, _ = rollout(model, noisy(batch[:, :-1], noise, rng), schedule)  # (B, T-1, D)
    distance = (prediction - batch[:, 1:]).square().sum(dim=-1)  # (B, T-1)
    return distance.mean()


def noisy(frames: Tensor, deviation: float, rng: torch.Generator | None = None) -> Tensor:
    """Frames with Gaussian noise of that standard deviation, in the units of the features, on every number."""
    if deviation == 0:
        return frames
    return frames + deviation * standard_normal_like(frames, rng)


@dataclasses.dataclass(frozen=True)
class AutoConditionedLoss:
    """:func:`scheduled_loss` with ``u`` frames of truth, then ``v`` own ones, in turn: the acLSTM.

    ``noise`` on the truth that is fed is not in the acRNN paper, so the default is none. A network that has only
    met exact frames and ``v`` frames of its own can settle in a pose that lies beside all of them; with noise it has
    learnt to come back from everywhere around the truth, as the ERD does (:class:`NoisyInputLoss`).
    """

    u: int = 5
    v: int = 5
    noise: float = 0.0

    def __post_init__(self):
        auto_conditioning(1, self.u, self.v)  # raises if they cannot be
        check_noise(self.noise)

    @property
    def least_length(self) -> int:
        """The frames that a window must have to feed one own frame, the last being a target only; else it is lstm."""
        return self.u + 2

    def __call__(
        self, model: nn.Module, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> Tensor:
        schedule = auto_conditioning(batch.shape[1] - 1, self.u, self.v)
        return scheduled_loss(model, batch, schedule, noise=self.noise, rng=rng)


@dataclasses.dataclass(frozen=True)
class ScheduledSamplingLoss:
    """:func:`scheduled_loss` with a coin tossed at each frame: truth with ``probability``, which may decay to that."""

    probability: float = 0.5
    decay: str = "fixed"

    def __post_init__(self):
        check_decay(self.probability, self.decay)

    def __call__(
        self, model: nn.Module, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> Tensor:
        probability = truth_probability(progress, self.probability, self.decay)
        return scheduled_loss(model, batch, scheduled_sampling(batch.shape[1] - 1, batch.shape[0], probability, rng))


@dataclasses.dataclass(frozen=True)
class NoisyInputLoss:
    """Equation 1 with Gaussian noise on the frames that are fed, the targets being clean: the ERD.

    Fragkiadaki et al. (2015), section 3: noise of growing strength teaches the network to come back from its own
    mistakes. Here its standard deviation, in the units of the features, rises in a straight line from 0 at the
    first step to ``noise`` at the last. The acRNN paper mentions no noise for its ERD, so the default is none:
    :func:`next_frame_loss` itself.
    """

    noise: float = 0.0

    def __post_init__(self):
        check_noise(self.noise)

    def __call__(
        self, model: nn.Module, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> Tensor:
        prediction, _ = model(noisy(batch[:, :-1], self.noise * progress, rng))  # (B, T-1, D)
        distance = (prediction - batch[:, 1:]).square().sum(dim=-1)  # (B, T-1)
        return distance.mean()


@dataclasses.dataclass(frozen=True)
class Seq2SeqLoss:
    r"""The sampling-based loss: truth for ``n_seed`` frames, own output for ``n_future``, measured on those alone.

    .. math:: L = \frac{1}{N} \sum_{k=1}^{N} \| y_{S-1+k} - x_{S+k} \|_2^2, \qquad S = n_{seed}, \; N = n_{future}

    Martinez et al. (2017), section 3: at each training step the decoder is fed what it put out before, as it will be
    at synthesis, and the error is taken on its frames, not on the encoder's. There 50 frames are shown
    and 25 predicted (2 s and 1 s). The distance is that of equation 1 of the acRNN paper, so that the losses
    of all systems are in one unit.

    Of longer windows the first ``n_seed + n_future`` frames are used; shorter ones raise :class:`TutorialError`.
    """

    n_seed: int = 50
    n_future: int = 25

    def __post_init__(self):
        for name in ("n_seed", "n_future"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise TutorialError(f"seq2seq: {name} must be a whole number of 1 or more, not {value!r}")

    @property
    def least_length(self) -> int:
        """The frames that a window must have."""
        return self.n_seed + self.n_future

    def __call__(
        self, model: nn.Module, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> Tensor:
        if batch.shape[1] < self.least_length:
            raise TutorialError(
                f"seq2seq reads windows of {self.least_length} frames (n_seed {self.n_seed} + n_future "
                f"{self.n_future}), these have {batch.shape[1]}"
            )
        x = batch[:, : self.least_length]
        schedule = seed_only(self.least_length - 1, self.n_seed)
        prediction, _ = rollout(model, x[:, :-1], schedule)  # (B, n_seed + n_future - 1, D)
        distance = (prediction - x[:, 1:]).square().sum(dim=-1)[:, self.n_seed - 1 :]  # (B, n_future)
        return distance.mean()


@dataclasses.dataclass(frozen=True)
class SystemKind:
    """What a name such as "lstm" stands for.

    ``loss`` is the loss function itself or, for a system with options of its own, the frozen dataclass of them
    whose values are loss functions; or have, for a system that is trained in stages, a method ``stages()``.
    ``parts`` are slices of the representation that the network must know, fields of its configuration: "control".
    ``reads`` names the only representations that the network can read, if it must know more of them than their width:
    its configuration then has the representation's own as ``features``, and it takes features as they are, never
    normalised.
    ``normalized`` : whether the network is made for features of standard deviation 1, so that they always are.
    ``recipe`` has what a training run is by default, where it is not what other systems have.
    ``predicts`` : whether the network tells the next frame, and so lives on its own output after a seed.
    ``futures`` : whether it goes on from a seed in another way, by chance: :mod:`tutorial_lib.generate_futures`.
    """

    summary: str
    model: type[nn.Module]
    config: type
    loss: LossFunction
    parts: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    normalized: bool = False
    recipe: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    predicts: bool = True
    futures: bool = False

    @property
    def controlled(self) -> bool:
        """Whether the network follows control and goes on from no seed: :mod:`tutorial_lib.walk`."""
        return "control" in self.parts

    @property
    def sizes(self) -> tuple[str, ...]:
        """What the network's configuration has besides ``dim``."""
        return tuple(field.name for field in dataclasses.fields(self.config) if field.name != "dim")

    @property
    def loss_options(self) -> dict[str, Any]:
        """The options of the loss, such as u and v, with their defaults."""
        if not dataclasses.is_dataclass(self.loss):
            return {}
        return {field.name: field.default for field in dataclasses.fields(self.loss)}

    @property
    def options(self) -> dict[str, Any]:
        """The system's own options, with their defaults: of the loss, and of the network those that not all have."""
        fields = {field.name: field.default for field in dataclasses.fields(self.config)}
        own = {n: v for n, v in fields.items() if n not in ("dim", "hidden", "layers", "features", *self.parts)}
        return {**self.loss_options, **own}

    def check_parts(self, name: str, representation: Representation | type[Representation]) -> None:
        """Raise ``TutorialError`` unless a representation is one that the network can read, with all parts that it must
        know."""
        if self.reads and representation.name not in self.reads:
            raise TutorialError(
                f"system {name!r} reads the representation {' or '.join(self.reads)}, not {representation.name}"
            )
        for part in self.parts:
            if part not in representation.parts:
                having = [other.name for other in REPRESENTATIONS.values() if part in other.parts]
                raise TutorialError(
                    f"system {name!r} needs the {part} channels of a representation, {representation.name!r} has "
                    f"{' and '.join(representation.parts)} only: expected {' or '.join(having)}"
                )


SYSTEMS: dict[str, SystemKind] = {
    "lstm": SystemKind(
        "vanilla three-layer LSTM (LSTM-3LR), always fed the truth in training",
        LSTM3LR,
        LSTM3LRConfig,
        next_frame_loss,
    ),
    "aclstm": SystemKind(
        "auto-conditioned LSTM (acLSTM): the same network, fed u frames of truth and v of its own in turn",
        LSTM3LR,
        LSTM3LRConfig,
        AutoConditionedLoss,
    ),
    "erd": SystemKind(
        "encoder, recurrent layers and decoder (ERD, Fragkiadaki et al.), fed the truth, with noise if asked for",
        ERD,
        ERDConfig,
        NoisyInputLoss,
    ),
    "seq2seq": SystemKind(
        "residual GRU with sampling-based loss (Martinez et al.): shown a seed, measured on what it makes of it",
        Seq2Seq,
        Seq2SeqConfig,
        Seq2SeqLoss,
    ),
    "scheduled-sampling": SystemKind(
        "the network of lstm, fed the truth or its own output at random (Bengio et al.)",
        LSTM3LR,
        LSTM3LRConfig,
        ScheduledSamplingLoss,
    ),
    "vae-lstm": SystemKind(
        "recurrent variational autoencoder that follows control signals and needs no seed (Habibie et al.)",
        VAELSTM,
        VAELSTMConfig,
        VariationalLoss,
        parts=("control",),
        recipe={  # rotate: the hip's frame turns with the body, so turning a window changes nothing
            "representation": "hip-frame",
            "joints": "common",
            "length": 120,
            "pad": True,
            "rotate": False,
            "steps": 1000,
        },
        predicts=False,
    ),
    "crbm": SystemKind(
        "conditional restricted Boltzmann machine (Taylor et al.): draws a frame given those before, trained by CD-k",
        CRBM,
        CRBMConfig,
        ContrastiveDivergence,
        normalized=True,  # its visible units have a standard deviation of 1
        recipe={"representation": "hip-frame"},
    ),
    "dynamic-future-net": SystemKind(
        "Dynamic Future Net (Chen et al.): imagines one of many futures and moves towards it; trained in three stages",
        DynamicFutureNet,
        DynamicFutureNetConfig,
        DynamicFutureLoss,
        reads=("body-frame",),
        recipe={"representation": "body-frame", "joints": "common", "length": 40, "rotate": False, "steps": 6000},
        predicts=False,
        futures=True,
    ),
}


@dataclasses.dataclass
class System:
    """A network and the loss that it is trained with: what a :class:`Trainer` trains.

    ``loss`` is called as ``loss(model, batch, rng, progress)``, see :data:`LossFunction`; ``options`` are what it
    was made with, kept in the checkpoint's ``training``. With ``stages`` the trainer takes their losses instead.
    """

    name: str
    model: nn.Module
    loss: LossFunction
    options: dict[str, Any] = dataclasses.field(default_factory=dict)
    stages: tuple[Stage, ...] = ()


def system_kind(name: str, error: type[TutorialError] = TutorialError) -> SystemKind:
    """The entry of :data:`SYSTEMS`; an unknown name raises ``error`` with the close ones."""
    if name in SYSTEMS:
        return SYSTEMS[name]
    close = difflib.get_close_matches(str(name), SYSTEMS, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(close)}?" if close else f"known are {', '.join(sorted(SYSTEMS))}"
    raise error(f"unknown system {name!r}; {hint}")


def make_system(name: str, dim: int, *, seed: int = 0, **values) -> System:
    """A fresh system for frames of ``dim`` numbers.

    ``values`` are sizes of the network (``hidden``, ``layers``) and the system's own options ("aclstm": ``u``,
    ``v``, ``noise``; "erd": ``noise``; "seq2seq": ``n_seed``, ``n_future``; "scheduled-sampling": ``probability``,
    ``decay``; "vae-lstm": ``deviation``, ``l1``, ``kernel``, ..., and its ``control`` channels, which must be given;
    "crbm": ``cd``, ``past``, ``gibbs``; "dynamic-future-net": ``stage``, ``horizon``, ..., and its ``features``, which
    must be given). The weights are drawn from ``seed``; torch's global generator is put back as it was.
    """
    kind = system_kind(name)
    known = tuple(dict.fromkeys((*kind.sizes, *kind.options)))
    for value in values:
        if value not in known:
            what = "size" if not kind.options else "size or option"
            raise TutorialError(f"system {name!r} has no {what} {value!r}; it has {', '.join(known)}")
    for part in kind.parts:
        if part not in values:
            raise TutorialError(f"system {name!r} must be told its {part} channels, the representation's slice")
    if kind.reads and values.get("features") is None:
        raise TutorialError(f"system {name!r} must be told its features, the representation's config()")
    options = {option: values.get(option, default) for option, default in kind.options.items()}
    of_loss = {option: options[option] for option in kind.loss_options}
    loss = kind.loss(**of_loss) if of_loss else kind.loss
    with global_seed(seed):
        model = kind.model(kind.config(dim=dim, **{size: values[size] for size in kind.sizes if size in values}))
    return System(name, model, loss, options, loss.stages() if hasattr(loss, "stages") else ())


def empty_model(name: str, config: dict[str, Any]) -> nn.Module:
    """The network of a checkpoint on torch's "meta" device: shapes, but no memory and no numbers yet."""
    kind = system_kind(name, CheckpointError)
    with torch.device("meta"):
        return kind.model(kind.config(**config))


@contextlib.contextmanager
def global_seed(seed: int) -> Iterator[None]:
    """Torch's global CPU generator starts at ``seed`` inside the block and is put back after it."""
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(whole_seed(seed))
        yield
