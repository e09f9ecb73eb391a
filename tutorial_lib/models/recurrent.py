"""Recurrent networks that predict the next frame of a motion from the frames so far."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn

from ..errors import TutorialError


@dataclass(frozen=True)
class LSTM3LRConfig:
    """Sizes of an :class:`LSTM3LR`; hidden 1024 in three layers is the paper's network."""

    dim: int  # numbers a frame, of input and output
    hidden: int = 1024  # memory cells a layer
    layers: int = 3

    def __post_init__(self):
        for name in ("dim", "hidden", "layers"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise TutorialError(f"LSTM3LR: {name} must be a whole number of 1 or more, not {value!r}")


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
