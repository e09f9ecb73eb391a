"""The probability of a variational autoencoder, a function each: no network is in here.

Gaussians are diagonal and told by mean and *logarithm of the variance*, ``(..., C)`` each: any number is one.
The equations are those of Habibie et al., "A recurrent variational autoencoder for human motion synthesis" (2017).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ..errors import TutorialError


def standard_normal_like(mean: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Numbers drawn from N(0, 1) in the shape, type and place of ``mean``.

    Drawn on the CPU, where ``generator`` is, so that a seed gives the same numbers on every device;
    ``None``: from torch's global generator.
    """
    return torch.randn(mean.shape, generator=generator, dtype=mean.dtype).to(mean.device)


def gaussian_sample(mean: Tensor, log_variance: Tensor, generator: torch.Generator | None = None) -> Tensor:
    r"""A draw from N(mean, exp(log_variance)) that gradients run through: the reparametrisation trick.

    .. math:: z = \sigma \varepsilon + \mu, \qquad \varepsilon \sim \mathcal N(0, I) \qquad (3)
    """
    noise = standard_normal_like(mean, generator)
    return (0.5 * log_variance).exp() * noise + mean  # (3)


def gaussian_divergence(
    mean: Tensor, log_variance: Tensor, prior_mean: Tensor | float = 0.0, prior_log_variance: Tensor | float = 0.0
) -> Tensor:
    r"""Kullback-Leibler divergence of two diagonal Gaussians, in nats: ``(..., C)`` to ``(...)``.

    .. math:: D_{KL}(q \| p) = \frac12 \sum_c \left( \log \sigma_p^2 - \log \sigma_q^2 - 1
                               + \frac{\sigma_q^2 + (\mu_q - \mu_p)^2}{\sigma_p^2} \right)

    By default p is the unit Gaussian, as in section 3.1. A term of the sum in equation 4.
    """
    prior_log_variance = torch.as_tensor(prior_log_variance, dtype=mean.dtype, device=mean.device)
    ratio = (log_variance - prior_log_variance).exp()  # (..., C): of the variances
    distance = (mean - prior_mean).square() * (-prior_log_variance).exp()  # (..., C)
    return 0.5 * (prior_log_variance - log_variance - 1.0 + ratio + distance).sum(-1)


def gaussian_negative_log_likelihood(x: Tensor, mean: Tensor, deviation: float = 1.0) -> Tensor:
    r"""``-log N(x; mean, deviation^2 I)`` of whole sequences, ``(B, T, D)`` to ``(B,)``, but for a constant.

    .. math:: \mathcal L_x = \frac{1}{2 s^2} \sum_{t, d} (x_{td} - \hat x_{td})^2 \; (+ T D \log s \sqrt{2 \pi})

    Section 3.1, after equation 4. The constant in brackets does not change with what is learnt, and is left out.
    """
    return (x - mean).square().flatten(1).sum(-1) / (2.0 * deviation**2)


def mean_absolute_weight(model: nn.Module) -> Tensor:
    """The mean of ``|w|`` over all weights of a network, biases left out: a scalar.

    Section 4.2 adds "l1 = 0.1 regularization" and does not say of what; the sum over a million weights would be
    thousands of times the rest of the loss, the mean is no larger than it.
    """
    weights = [p for p in model.parameters() if p.ndim > 1]
    if not weights:
        raise TutorialError(f"{type(model).__name__} has no weights to take the mean of")
    return sum(w.abs().sum() for w in weights) / sum(w.numel() for w in weights)


def check_deviation(name: str, value: float) -> None:
    """Raise ``TutorialError`` unless ``value`` can be a standard deviation."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
        raise TutorialError(f"{name} is a standard deviation above 0, not {value!r}")
