"""Recurrent networks that predict the next frame of a motion from the frames so far."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import relu

from ..errors import TutorialError


def _check_sizes(config: LSTM3LRConfig | ERDConfig | Seq2SeqConfig) -> None:
    for name in ("dim", "hidden", "layers"):
        value = getattr(config, name)
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            network = type(config).__name__.removesuffix("Config")
            raise TutorialError(f"{network}: {name} must be a whole number of 1 or more, not {value!r}")


@dataclass(frozen=True)
class LSTM3LRConfig:
    """Sizes of an :class:`LSTM3LR`; hidden 1024 in three layers is the paper's network."""

    dim: int  # numbers a frame, of input and output
    hidden: int = 1024  # memory cells a layer
    layers: int = 3

    def __post_init__(self):
        _check_sizes(self)


class LSTM3LR(nn.Module):
    """Three LSTM layers and a linear readout: the vanilla network of the acRNN paper (section 3).

    Zhou et al., "Auto-conditioned recurrent networks for extended complex human motion synthesis"; the name
    is Fragkiadaki et al.'s (2015). The same network, trained under another schedule, is the acLSTM.

    The layers stack in the ordinary way: layer 2 reads what layer 1 puts out at the same step. The
    published acRNN code hands every layer the *previous* step's output of the layer below instead,
    so that a frame takes three steps to come out; the paper does not mention it.

    ``lstm`` is a standard ``nn.LSTM`` with its usual parameter names (``weight_ih_l0``, ...; gates in the
    order input, forget, cell, output), ``readout`` a standard ``nn.Linear``. The weights are drawn from
    torch's global generator, as in every ``nn.Module``; :func:`tutorial_lib.training.systems.make_system`
    draws them from a seed and leaves that generator alone.
    """

    def __init__(self, config: LSTM3LRConfig):
        super().__init__()
        self.config = config
        self.lstm = nn.LSTM(config.dim, config.hidden, config.layers, batch_first=True)
        self.readout = nn.Linear(config.hidden, config.dim)

    def forward(self, x: Tensor, state: tuple[Tensor, Tensor] | None = None) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Predict for each frame the one after it.

        Parameters
        ----------
        x : (B, T, D) frames; T may be 1, which is how the network is run on its own output.
        state : what an earlier call returned, to go on from there; ``None`` for a memory of zeros.

        Returns
        -------
        y : (B, T, D), where ``y[:, t]`` is the prediction of frame t + 1.
        state : memory after the last frame: two tensors (layers, B, hidden), output h and cell c.
        """
        h, state = self.lstm(x, state)  # (B, T, hidden), ((layers, B, hidden), (layers, B, hidden))
        y = self.readout(h)  # (B, T, D)
        return y, state


@dataclass(frozen=True)
class ERDConfig:
    """Sizes of an :class:`ERD`; hidden 1000 in two layers is the paper's network."""

    dim: int  # numbers a frame, of input and output
    hidden: int = 1000  # memory cells a layer
    layers: int = 2  # recurrent ones

    def __post_init__(self):
        _check_sizes(self)

    @property
    def wide(self) -> int:
        """Units of both encoder layers and of the first decoder layer."""
        return max(1, self.hidden // 2)

    @property
    def narrow(self) -> int:
        """Units of the second decoder layer."""
        return min(100, self.wide)


class ERD(nn.Module):
    """Encoder, recurrent layers, decoder: LSTM layers that read and write a learnt embedding of the pose.

    Fragkiadaki, Levine, Felsen and Malik, "Recurrent network models for human dynamics" (2015), section 3: an
    encoder of two fully connected layers with ReLU (500, 500), two LSTM layers of 1000 cells, and a decoder
    of fully connected layers (500, 100, and the D numbers of a frame), ReLU between them.

    The sizes follow ``hidden``: the 500s are half of it, at 1000 just the paper's. The narrow 100 stays as it is
    where half of ``hidden`` is not less yet: a tenth of 128 cells would leave 12 numbers for a whole pose, which
    has as many joints for a small network as for a large one.

    ``encoder`` and ``decoder`` are lists of ``nn.Linear``, ``lstm`` a standard ``nn.LSTM``.
    """

    def __init__(self, config: ERDConfig):
        super().__init__()
        self.config = config
        wide, narrow = config.wide, config.narrow
        self.encoder = nn.ModuleList([nn.Linear(config.dim, wide), nn.Linear(wide, wide)])
        self.lstm = nn.LSTM(wide, config.hidden, config.layers, batch_first=True)
        self.decoder = nn.ModuleList([
            nn.Linear(config.hidden, wide), nn.Linear(wide, narrow), nn.Linear(narrow, config.dim)
        ])  # fmt: skip

    def forward(self, x: Tensor, state: tuple[Tensor, Tensor] | None = None) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """As :meth:`LSTM3LR.forward`: x (B, T, D) -> y (B, T, D), and the memory, two tensors (layers, B, hidden)."""
        for layer in self.encoder:
            x = relu(layer(x))  # (B, T, wide), twice
        h, state = self.lstm(x, state)  # (B, T, hidden), ((layers, B, hidden), (layers, B, hidden))
        first, second, last = self.decoder
        h = relu(first(h))  # (B, T, wide)
        h = relu(second(h))  # (B, T, narrow)
        y = last(h)  # (B, T, D)
        return y, state


@dataclass(frozen=True)
class Seq2SeqConfig:
    """Sizes of a :class:`Seq2Seq`; hidden 1024 in one layer is the paper's network."""

    dim: int  # numbers a frame, of input and output
    hidden: int = 1024
    layers: int = 1

    def __post_init__(self):
        _check_sizes(self)


class Seq2Seq(nn.Module):
    r"""One GRU that encodes a seed and decodes what follows, and only has to tell what changes.

    .. math:: y_t = x_t + W h_t + b, \qquad h_t = \mathrm{GRU}(x_t, h_{t-1})

    Martinez, Black and Romero, "On human motion prediction using recurrent neural networks" (2017), section 3:
    encoder and decoder share their weights, so they are one network that is first fed the seed and then its
    own output; the residual connection adds the output to the input, so that the GRU models velocities. What
    makes it a sequence-to-sequence system is its loss, see ``Seq2SeqLoss`` in :mod:`tutorial_lib.training.systems`.

    The readout starts at a tenth of ``nn.Linear``'s usual weights and a bias of zero: a new network nearly repeats
    the last frame, which is a good prediction already, instead of piling up a random step at each of its own frames.

    ``gru`` is a standard ``nn.GRU`` (gates in the order reset, update, new), ``readout`` an ``nn.Linear``.
    """

    def __init__(self, config: Seq2SeqConfig):
        super().__init__()
        self.config = config
        self.gru = nn.GRU(config.dim, config.hidden, config.layers, batch_first=True)
        self.readout = nn.Linear(config.hidden, config.dim)
        with torch.no_grad():
            self.readout.weight.mul_(0.1)
            self.readout.bias.zero_()

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """As :meth:`LSTM3LR.forward`: x (B, T, D) -> y (B, T, D), and the memory, one tensor (layers, B, hidden)."""
        h, state = self.gru(x, state)  # (B, T, hidden), (layers, B, hidden)
        y = x + self.readout(h)  # (B, T, D)
        return y, state
