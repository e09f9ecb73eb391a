"""The systems that can be trained: each a name, a network and the loss that it is trained with.

The trainer, the checkpoints and the command line know a system only through :data:`SYSTEMS`.
A new one is a network with a frozen configuration, a loss function, and one entry here.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor, nn

from ..errors import CheckpointError, TutorialError
from ..models.recurrent import LSTM3LR, LSTM3LRConfig

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


@dataclasses.dataclass(frozen=True)
class SystemKind:
    """What a name such as "lstm" stands for."""

    summary: str
    model: type[nn.Module]
    config: type
    loss: LossFunction


SYSTEMS: dict[str, SystemKind] = {
    "lstm": SystemKind(
        "vanilla three-layer LSTM (LSTM-3LR), always fed the truth in training",
        LSTM3LR,
        LSTM3LRConfig,
        next_frame_loss,
    ),
}


@dataclasses.dataclass
class System:
    """A network and the loss that it is trained with: what a :class:`Trainer` trains.

    ``loss`` is called as ``loss(model, batch, rng, progress)``, see :data:`LossFunction`.
    """

    name: str
    model: nn.Module
    loss: LossFunction


def system_kind(name: str, error: type[TutorialError] = TutorialError) -> SystemKind:
    """The entry of :data:`SYSTEMS`; an unknown name raises ``error`` with the close ones."""
    if name in SYSTEMS:
        return SYSTEMS[name]
    close = difflib.get_close_matches(str(name), SYSTEMS, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(close)}?" if close else f"known are {', '.join(sorted(SYSTEMS))}"
    raise error(f"unknown system {name!r}; {hint}")


def make_system(name: str, dim: int, *, seed: int = 0, **sizes) -> System:
    """A fresh system for frames of ``dim`` numbers.

    ``sizes`` go to the network's configuration (for "lstm": ``hidden``, ``layers``). The weights are
    drawn from ``seed``; torch's global generator is put back as it was.
    """
    kind = system_kind(name)
    allowed = [field.name for field in dataclasses.fields(kind.config) if field.name != "dim"]
    for size in sizes:
        if size not in allowed:
            raise TutorialError(f"system {name!r} has no size {size!r}; it has {', '.join(allowed)}")
    with global_seed(seed):
        model = kind.model(kind.config(dim=dim, **sizes))
    return System(name, model, kind.loss)


def empty_model(name: str, config: dict[str, Any]) -> nn.Module:
    """The network of a checkpoint on torch's "meta" device: shapes, but no memory and no numbers yet."""
    kind = system_kind(name, CheckpointError)
    with torch.device("meta"):
        return kind.model(kind.config(**config))


@contextlib.contextmanager
def global_seed(seed: int) -> Iterator[None]:
    """Torch's global CPU generator starts at ``seed`` inside the block and is put back after it."""
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)
        yield
