"""What a variational autoencoder is trained with: the bound of equation 5."""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor, nn

from ..errors import TutorialError
from ..models.variational import (
    check_deviation,
    gaussian_divergence,
    gaussian_negative_log_likelihood,
    mean_absolute_weight,
)


@dataclasses.dataclass(frozen=True)
class VariationalLoss:
    r"""The negative variational lower bound, and l1: what the VAE-LSTM minimises.

    .. math:: \mathcal L(x) = \mathbb E_q[\mathcal L_z + \mathcal L_x], \qquad
              \mathcal L_z = \sum_t D_{KL}(q(z_t | x) \| p(z_t)) \qquad (4), (5)

    Habibie et al., section 3.1, with a single draw of z. Both terms are divided by the T D numbers of a window, so that
    windows of other lengths have losses of the same size.

    deviation : of the Gaussian p(x | z), in units of the normalised features; the paper does not say. The smaller it
        is, the more the code is made to tell: reconstructions come closer, and motions from a draw of the prior, which
        cannot tell as much, fall behind (on bandai-namco/locomotion with 0.1 to three times the error).
    l1 : weight of the weights' mean absolute value (:func:`tutorial_lib.models.variational.mean_absolute_weight`).

    Called as every loss is; the terms beside it are ``divergence`` (nats of all codes of a window), ``error`` (mean
    squared, of a number) and ``l1``.
    """

    deviation: float = 1.0
    l1: float = 0.1

    def __post_init__(self):
        check_deviation("the variational loss's deviation", self.deviation)
        if isinstance(self.l1, bool) or not isinstance(self.l1, (int, float)) or not 0 <= self.l1 < math.inf:
            raise TutorialError(f"l1 is a weight of 0 or more, not {self.l1!r}")

    def __call__(
        self, model: nn.Module, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> tuple[Tensor, dict[str, Tensor]]:
        made = model(batch, rng)  # frames (B, T, D), mean and log-variance (B, S, H)
        numbers = batch[0].numel()  # T D
        divergence = gaussian_divergence(made.mean, made.log_variance).sum(1).mean()  # L_z, (4)
        likelihood = gaussian_negative_log_likelihood(batch, made.frames, self.deviation).mean()  # L_x
        l1 = mean_absolute_weight(model)
        loss = (divergence + likelihood) / numbers + self.l1 * l1  # (5), and l1 of section 4.2
        error = likelihood.detach() * (2 * self.deviation**2 / numbers)
        return loss, {"divergence": divergence, "error": error, "l1": l1}
