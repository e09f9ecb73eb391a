"""Pieces that several networks are made of."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn


def mlp(inputs: int, hidden: int, outputs: int, layers: int) -> nn.Sequential:
    """A multi-layer perceptron of ``layers`` linear layers, LeakyReLU between them: ``(..., inputs)`` to
    ``(..., outputs)``."""
    sizes = [inputs, *[hidden] * (layers - 1), outputs]
    parts: list[nn.Module] = []
    for k, (a, b) in enumerate(zip(sizes, sizes[1:], strict=False)):
        parts += [nn.Linear(a, b)] if k == layers - 1 else [nn.Linear(a, b), nn.LeakyReLU()]
    return nn.Sequential(*parts)


class Standardizer(nn.Module):
    """``(x - mean) / std``, channel by channel, kept with a network's weights; changes nothing before :meth:`fit`.

    mean, std: ``(C,)`` buffers.
    """

    def __init__(self, channels: int):
        super().__init__()
        self.register_buffer("mean", torch.zeros(channels))
        self.register_buffer("std", torch.ones(channels))

    def fit(self, values: Iterable[Tensor], floor: float = 1e-3) -> None:
        """Take mean and standard deviation of tensors ``(..., C)``; channels that hardly change have ``floor``."""
        values = torch.cat([v.detach().reshape(-1, len(self.mean)) for v in values]).double()
        self.mean.copy_(values.mean(0))
        self.std.copy_(values.std(0, correction=0).clamp_min(floor))

    def forward(self, x: Tensor) -> Tensor:
        """``(..., C)`` to numbers with mean 0 and deviation 1."""
        return (x - self.mean) / self.std

    def invert(self, x: Tensor) -> Tensor:
        """The inverse of ``forward``."""
        return x * self.std + self.mean
