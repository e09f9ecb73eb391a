r"""The conditional restricted Boltzmann machine: a frame and what lies behind it, given the frames before.

Taylor, Hinton and Roweis, "Modeling human motion using binary latent variables" (2006), sections 2 and 3; it is the
cRBM of the VAE-LSTM paper's tables. Real-valued visible units v are the frame, binary hidden units h its explanation,
and the N frames u before it act on both:

.. math:: E(v, h | u) = \tfrac12 \| v - c \|^2 - b^T h - h^T W v, \qquad c = c_0 + A u, \quad b = b_0 + B u

The visible units' standard deviation is 1, as in the paper's experiments, so the features must be normalised. A joins
frames directly (autoregressive connections), B the past with the hidden units. What is not conditioned on is an
ordinary Gaussian-binary machine, whose two conditionals are simple:

.. math:: p(h_j = 1 | v, u) = \sigma(b_j + W_j v), \qquad p(v | h, u) = \mathcal N(c + W^T h, I)

How it is trained: :mod:`tutorial_lib.training.contrastive_divergence`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from ..chance import whole_seed
from ..errors import TutorialError


@dataclass(frozen=True)
class CRBMConfig:
    """Sizes of a :class:`CRBM`, and how many Gibbs steps make a frame.

    The authors' published code generates with 30 steps. It conditions on 3 or 6 frames; 3 fit into the four initial
    frames of the VAE-LSTM paper's table 2.
    """

    dim: int  # numbers a frame
    hidden: int = 100  # binary units
    past: int = 3  # N, frames that a frame is conditioned on
    gibbs: int = 30  # alternating Gibbs steps at generation

    def __post_init__(self):
        for name in ("dim", "hidden", "past", "gibbs"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise TutorialError(f"CRBM: {name} must be a whole number of 1 or more, not {value!r}")

    @property
    def least_length(self) -> int:
        """The frames that a training window must have."""
        return self.past + 1


class CRBMState(NamedTuple):
    """What a :class:`CRBM` goes on from: the last frames, and which random numbers come next.

    It is a value: going on from the same state twice draws the same numbers.
    """

    frames: Tensor | None  # (B, N, D); None: nothing is known yet
    seed: int  # of all draws
    step: int  # frames drawn so far


class CRBM(nn.Module):
    r"""See the top of this module. ``weight`` is W (hidden, D); ``visible`` and ``latent`` are standard ``nn.Linear``
    layers of the past u, N frames one after the other, oldest first: A and c_0, B and b_0.

    Weights start at 0.01 times a normal draw and biases at zero, as in the authors' code.
    """

    def __init__(self, config: CRBMConfig):
        super().__init__()
        self.config = config
        u = config.past * config.dim
        self.weight = nn.Parameter(torch.empty(config.hidden, config.dim))
        self.visible = nn.Linear(u, config.dim)
        self.latent = nn.Linear(u, config.hidden)
        with torch.no_grad():
            for weight in (self.weight, self.visible.weight, self.latent.weight):
                weight.normal_(0, 0.01)
            for bias in (self.visible.bias, self.latent.bias):
                bias.zero_()

    # the distribution

    def dynamic_biases(self, past: Tensor) -> tuple[Tensor, Tensor]:
        """What the past (..., N, D) adds to the biases: c (..., D) of the visible units and b (..., hidden)."""
        u = past.flatten(-2)  # (..., N D)
        return self.visible(u), self.latent(u)  # c = c_0 + A u, b = b_0 + B u

    def free_energy(self, v: Tensor, c: Tensor, b: Tensor) -> Tensor:
        r"""The energy of frames with the hidden units summed out: v (..., D) and its biases to (...).

        .. math:: F(v | u) = -\log \sum_h e^{-E(v, h | u)}
                  = \tfrac12 \| v - c \|^2 - \sum_j \log(1 + e^{b_j + W_j v})
        """
        return 0.5 * (v - c).square().sum(-1) - softplus(b + v @ self.weight.t()).sum(-1)

    def p_hidden(self, v: Tensor, b: Tensor) -> Tensor:
        """p(h = 1 | v, u): v (..., D) and b (..., hidden) to (..., hidden)."""
        return torch.sigmoid(b + v @ self.weight.t())

    @torch.no_grad()
    def gibbs(
        self, v: Tensor, c: Tensor, b: Tensor, steps: int, rng: torch.Generator | None = None, mean_field: bool = False
    ) -> Tensor:
        """Alternating Gibbs steps from frames v (..., D), the biases fixed; returns frames (..., D), no gradient.

        The hidden units are drawn; the visible ones take their mean, without noise, as in the authors' code. With
        ``mean_field`` the last step puts the hidden units' probabilities in the place of a draw: frames of a motion are
        "very noisy if we don't", the code says.
        ``rng`` is a generator on the CPU; torch's global one by default.
        """
        for k in range(steps):
            h = self.p_hidden(v, b)  # (..., hidden)
            if not (mean_field and k == steps - 1):
                h = (torch.rand(h.shape, generator=rng).to(h.device) < h).to(v.dtype)
            v = c + h @ self.weight  # mean of p(v | h, u): (..., D)
        return v

    # as a network that makes a frame at a time

    def start(self, seed: int = 0) -> CRBMState:
        """The state of which generation starts that draws its random numbers from ``seed``, a number of 0 or more."""
        return CRBMState(None, whole_seed(seed), 0)

    def forward(self, x: Tensor, state: CRBMState | None = None) -> tuple[Tensor, CRBMState]:
        """Draw for each frame the one after it, as every network of :mod:`.recurrent` predicts it.

        Taylor et al., section 3.2: each new frame starts as a copy of the last one and takes ``config.gibbs`` Gibbs
        steps, given the N frames before it.

        Parameters
        ----------
        x : (B, T, D) normalised frames; T may be 1.
        state : what an earlier call returned, or :meth:`start`; ``None`` for ``start(0)``. Frames before the
            first one that is known are taken to be equal to it.

        Returns
        -------
        y : (B, T, D), where ``y[:, t]`` is a draw of frame t + 1; no gradient.
        state : the last N frames read, and which random numbers come next.
        """
        frames, seed, step = self.start() if state is None else state
        N = self.config.past
        if frames is None:
            frames = x[:, :1].expand(-1, N, -1)
        frames = torch.cat((frames, x), dim=1)  # (B, N + T, D)
        y = torch.empty_like(x)
        with torch.no_grad():
            for t in range(x.shape[1]):
                past = frames[:, t + 1 : t + 1 + N]  # (B, N, D), x[:, t] the last of them
                c, b = self.dynamic_biases(past)  # (B, D), (B, hidden)
                rng = torch.Generator().manual_seed(_mixed(seed, step + t))
                y[:, t] = self.gibbs(x[:, t], c, b, self.config.gibbs, rng, mean_field=True)
        return y, CRBMState(frames[:, -N:], seed, step + x.shape[1])


def _mixed(seed: int, step: int) -> int:
    """Another 32-bit number for each frame of each seed: neighbours must not be neighbours in the generator."""
    number = (seed * 0x9E3779B1 + step * 0x85EBCA77 + 0x165667B1) & 0xFFFFFFFF
    number = ((number ^ (number >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    return number ^ (number >> 13)
