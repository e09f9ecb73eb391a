"""Stage 3 of the Dynamic Future Net: a recurrent network that imagines a future, and lets it choose the present.

Chen et al. (2020), sections 5.3 to 5.5, figure 5. Each distribution is a method, with its equation beside it. Shapes:
any leading axes; C numbers of a code z, M of a summary m, F of a future state f, S of a current state s, G of the
past h (the upper GRU layer's output).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from .latent_scan import scan
from .layers import mlp
from .variational import gaussian_sample, standard_normal_like

BOUND = 6.0  # of log-variances, so that no deviation is below 0.05 or above 20 whatever the network is fed

State = tuple[Tensor, ...]
"""The GRU's memory: (B, G) of each layer, the upper one last."""


class Gaussian(NamedTuple):
    """A diagonal Gaussian, as :mod:`tutorial_lib.models.variational` takes it."""

    mean: Tensor  # (..., C)
    log_variance: Tensor  # (..., C)

    def at_temperature(self, temperature: float) -> Gaussian:
        """The same with its deviation ``temperature`` times as large; at 0 every draw is the mean."""
        factor = 2 * math.log(temperature) if temperature > 0 else -math.inf
        return Gaussian(self.mean, self.log_variance + factor)

    def sample(self, generator: torch.Generator | None = None) -> Tensor:
        """A draw that gradients run through."""
        return gaussian_sample(*self, generator)


def gaussian(numbers: Tensor) -> Gaussian:
    """A network's output ``(..., 2 C)`` as mean and log-variance; the latter is kept within +-``BOUND``."""
    mean, log_variance = numbers.chunk(2, -1)
    return Gaussian(mean, BOUND * torch.tanh(log_variance / BOUND))


class Inferred(NamedTuple):
    """What the posteriors make of windows of ``n = T - H`` frames, from codes and summaries that are known."""

    past: Tensor  # (B, n, G) h_t
    future: Tensor  # (B, n, F) f_t, drawn from q(f_t | h_t, m_t)
    current: Tensor  # (B, n, S) s_t, drawn from q(s_t | h_t, z_t, m_t)
    posterior_future: Gaussian
    posterior_current: Gaussian


class StochasticLatent(nn.Module):
    """The stochastic latent RNN. The perceptrons' sizes are the text's; those of f, s and m are not in it.

    future : F; 0 cuts the future state out, for an ablation: no f, and a summary of zeros in its place.
    """

    def __init__(
        self, *, code: int = 16, summary: int = 32, current: int = 16, future: int = 16, hidden: int = 128,
        layers: int = 2,
    ):  # fmt: skip
        super().__init__()
        self.n_summary, self.n_current, self.n_future = summary, current, future
        if future:
            self.future_prior = mlp(hidden, 256, 2 * future, 3)  # g_f^p
            self.summary_decoder = mlp(future + hidden, 128, summary, 4)
            self.future_posterior = mlp(hidden + summary, 512, 2 * future, 3)
        self.current_prior = mlp(hidden + summary, 128, 2 * current, 2)  # g_s^p
        self.code_decoder = mlp(current + hidden, 128, code, 4)
        self.current_posterior = mlp(hidden + code + summary, 32, 2 * current, 3)
        self.earlier_posterior = mlp(current + 2 * hidden, 32, 2 * current, 3)
        self.skip_decoder = mlp(current + 1, 32, current, 4)
        self.cells = nn.ModuleList(nn.GRUCell(current + future if k == 0 else hidden, hidden) for k in range(layers))

    # -- generation: figure 5 a and c --------------------------------------------------------------------

    def prior_future(self, past: Tensor) -> Gaussian:
        """``p(f_t | h_t)``, equation 5."""
        return gaussian(self.future_prior(past))  # (5)

    def summary_of(self, future: Tensor, past: Tensor) -> Tensor:
        """The mean of ``p(m_t | f_t, h_t)``, equation 6."""
        if not self.n_future:
            return past.new_zeros(*past.shape[:-1], self.n_summary)
        return self.summary_decoder(torch.cat((future, past), -1))  # (6)

    def prior_current(self, summary: Tensor, past: Tensor) -> Gaussian:
        """``p(s_t | m_t, h_t)``, equation 7."""
        return gaussian(self.current_prior(torch.cat((past, summary), -1)))  # (7)

    def code_of(self, current: Tensor, past: Tensor) -> Tensor:
        """The mean of ``p(z_t | s_t, h_t)``, below equation 7."""
        return self.code_decoder(torch.cat((current, past), -1))

    def start(self, batch: int) -> State:
        """A memory of no past at all."""
        weight = self.cells[0].weight_hh
        return tuple(weight.new_zeros(batch, weight.shape[1]) for _ in self.cells)

    def transition(self, state: State, current: Tensor, future: Tensor) -> State:
        """``h_{t+1} = GRU(h_t, s_t, f_t)``, equation 8; (B, ...) each."""
        x, after = torch.cat((current, future), -1), []
        for cell, h in zip(self.cells, state, strict=True):
            x = cell(x, h)  # (8)
            after.append(x)
        return tuple(after)

    # -- inference: figure 5 b ---------------------------------------------------------------------------

    def posterior_current(self, past: Tensor, code: Tensor, summary: Tensor) -> Gaussian:
        """``q(s_t | h_t, z_t, m_t)``, equations 9 and 10."""
        return gaussian(self.current_posterior(torch.cat((past, code, summary), -1)))  # (10)

    def posterior_future(self, past: Tensor, summary: Tensor) -> Gaussian:
        """``q(f_t | h_t, m_t)``, equation 11."""
        return gaussian(self.future_posterior(torch.cat((past, summary), -1)))  # (11)

    def posterior_earlier(self, later: Tensor, past: Tensor, later_past: Tensor) -> Gaussian:
        """``q(s_t1 | s_t2, h_t1, h_t2)``, equation 13."""
        return gaussian(self.earlier_posterior(torch.cat((later, past, later_past), -1)))  # (13)

    def skip(self, earlier: Tensor, steps: Tensor) -> Tensor:
        """``s_t2`` reconstructed from ``s_t1`` and ``dt = t2 - t1`` ``(..., 1)``, equation 14."""
        return self.skip_decoder(torch.cat((earlier, steps), -1))  # (14)

    def draw_future(self, past: Tensor, generator: torch.Generator | None, temperature: float = 1.0) -> Tensor:
        """``f_t`` from its prior: ``(..., G)`` to ``(..., F)``."""
        if not self.n_future:
            return past.new_zeros(*past.shape[:-1], 0)
        return self.prior_future(past).at_temperature(temperature).sample(generator)

    def infer(self, codes: Tensor, summaries: Tensor, generator: torch.Generator | None = None) -> Inferred:
        """Run along codes ``(B, n, C)`` and summaries ``(B, n, M)`` of windows, from no past at all.

        ``f_t`` and ``s_t`` are drawn from their posteriors and lead to ``h_{t+1}``, frame by frame: :func:`.scan`.
        """
        if not self.n_future:
            summaries = torch.zeros_like(summaries)
        f_like, s_like = codes.new_empty(len(codes), self.n_future), codes.new_empty(len(codes), self.n_current)
        noise = [[standard_normal_like(x, generator) for x in (f_like, s_like)] for _ in range(codes.shape[1])]
        drawn = tuple(torch.stack(column) for column in zip(*noise, strict=True))  # (n, B, F) and (n, B, S)
        future = self.future_posterior if self.n_future else None
        h, f, s, f_mean, f_log, s_mean, s_log = scan(
            codes, summaries, drawn, BOUND, future, self.current_posterior, self.cells
        )
        return Inferred(h, f, s, Gaussian(f_mean, f_log), Gaussian(s_mean, s_log))
