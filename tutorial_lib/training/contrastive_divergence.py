"""How a conditional restricted Boltzmann machine is trained."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from ..errors import TutorialError
from ..models.crbm import CRBM


@dataclasses.dataclass(frozen=True)
class ContrastiveDivergence:
    r"""CD-k as a loss: its value says little, its gradient is the contrastive divergence update.

    .. math:: L = \langle F(v | u) \rangle_{data} - \langle F(\tilde v | u) \rangle_{k},
              \qquad \tilde v \text{ held constant}

    Taylor et al. (2006), section 3.1 (after Hinton 2002): the frame is the start of a Gibbs chain of k steps
    (:meth:`CRBM.gibbs`), given the true past, and its end is the negative sample. As the free energy's gradient is that
    of the energy, averaged over the hidden units, going down this loss changes W by
    :math:`\langle h v^T \rangle_{data} - \langle h v^T \rangle_k`, A by
    :math:`(v - \tilde v) u^T` and B by :math:`(\langle h \rangle_{data} - \langle h \rangle_k) u^T`, with the hidden
    units' probabilities as their statistics. The sample's own dependence on the weights is left out, as ever in CD.

    Summed over the numbers of a frame, averaged over sequences and the frames that have N before them, as the
    losses of the other systems are. The term beside it is ``reconstruction``: the squared distance
    :math:`\| v - \tilde v \|^2` of frames to what the chain has made of them. With k = 1 it is what
    a falling loss is elsewhere; a longer chain leaves the data, and it grows.

    cd : k. The VAE-LSTM paper's tables have 1 and 15.
    """

    cd: int = 1

    def __post_init__(self):
        if not isinstance(self.cd, int) or isinstance(self.cd, bool) or self.cd < 1:
            raise TutorialError(f"cd, the Gibbs steps of contrastive divergence, must be 1 or more, not {self.cd!r}")

    def __call__(
        self, model: CRBM, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> tuple[Tensor, dict[str, Tensor]]:
        N = model.config.past
        if batch.shape[1] < model.config.least_length:
            raise TutorialError(
                f"a CRBM conditioned on {N} frames reads windows of {model.config.least_length} or more, "
                f"these have {batch.shape[1]}"
            )
        past = batch[:, :-1].unfold(1, N, 1).transpose(-1, -2)  # (B, T - N, N, D)
        v = batch[:, N:]  # (B, T - N, D)
        c, b = model.dynamic_biases(past)  # (B, T - N, D), (B, T - N, hidden)
        negative = model.gibbs(v, c, b, self.cd, rng)  # (B, T - N, D), no gradient
        loss = (model.free_energy(v, c, b) - model.free_energy(negative, c, b)).mean()
        return loss, {"reconstruction": (v - negative).square().sum(-1).mean()}
