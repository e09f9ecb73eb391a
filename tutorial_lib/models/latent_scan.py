"""The inference of the Dynamic Future Net along whole windows, as one function with a backward pass of its own.

What :meth:`.stochastic_latent.StochasticLatent.infer` does must go frame by frame: the past h_t is made of what was
drawn before. Left to autograd that is some hundred small operations a frame; here the same equations are written out
once forwards and once backwards, and each weight's gradient is one product over all frames at the end: two to four
times as fast, and the same numbers. Shapes: B windows of n frames; G of the past, F and S of the drawn states.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

SLOPE = 0.01  # of LeakyReLU where it is negative


def scan(
    codes: Tensor, summaries: Tensor, noise: tuple[Tensor, Tensor], bound: float,
    future: nn.Sequential | None, current: nn.Sequential, cells: Sequence[nn.GRUCell],
) -> tuple[Tensor, ...]:  # fmt: skip
    """Past, future state, current state, then mean and log-variance of the future's and of the current's posterior.

    codes ``(B, n, C)`` and summaries ``(B, n, M)`` are data: no gradient goes to them. noise: standard normal numbers
    ``(n, B, F)`` and ``(n, B, S)``. bound: of log-variances, see :func:`.stochastic_latent.gaussian`. future, current:
    the posteriors' perceptrons, of (h, m) and of (h, z, m); no ``future``: F is 0. cells: of (s, f), bottom up.
    Returns seven tensors ``(B, n, ...)``.
    """
    posteriors = [[layer for layer in mlp if isinstance(layer, nn.Linear)] for mlp in (future or (), current)]
    parts = [*posteriors[0], *posteriors[1]]
    weights = [w for layer in parts for w in (layer.weight, layer.bias)]
    weights += [w for cell in cells for w in (cell.weight_ih, cell.bias_ih, cell.weight_hh, cell.bias_hh)]
    sizes = len(posteriors[0]), len(posteriors[1]), len(cells)
    return _Scan.apply(codes, summaries, *noise, bound, sizes, *weights)


class _Layers:
    """A perceptron: what each linear layer has read, and on the way back the gradients of what it gave out."""

    def __init__(self, weights: Sequence[Tensor]):
        self.weights, self.biases = weights[::2], weights[1::2]
        self.read: list[list[Tensor]] = [[] for _ in self.weights]
        self.gradients: list[list[Tensor]] = [[] for _ in self.weights]

    def forward(self, x: Tensor) -> Tensor:
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            self.read[k].append(x)
            x = torch.addmm(bias, x, weight.T)
            if k < last:
                x = nn.functional.leaky_relu_(x, SLOPE)
        return x

    def backward(self, t: int, gradient: Tensor) -> Tensor:
        for k in range(len(self.weights) - 1, -1, -1):
            self.gradients[k].append(gradient)
            gradient = gradient @ self.weights[k]
            if k:  # what was read is above 0 where the slope is 1
                gradient = torch.where(self.read[k][t] > 0, gradient, SLOPE * gradient)
        return gradient

    def weight_gradients(self) -> list[Tensor]:
        return [g for read, given in zip(self.read, self.gradients, strict=True) for g in _products(read, given)]


class _Cell:
    """A GRU layer; its memory before and after each frame, and its gates."""

    def __init__(self, weights: Sequence[Tensor]):
        self.w_x, self.b_x, self.w_h, self.b_h = weights
        self.steps: list[tuple[Tensor, ...]] = []
        self.gradients: tuple[list[Tensor], list[Tensor]] = ([], [])

    def forward(self, x: Tensor, h: Tensor) -> Tensor:
        of_x, of_h = torch.addmm(self.b_x, x, self.w_x.T), torch.addmm(self.b_h, h, self.w_h.T)
        size = h.shape[1]
        gates = (of_x[:, : 2 * size] + of_h[:, : 2 * size]).sigmoid_()
        reset, keep = gates[:, :size], gates[:, size:]
        old = of_h[:, 2 * size :]
        new = torch.addcmul(of_x[:, 2 * size :], reset, old).tanh_()
        self.steps.append((x, h, gates, old, new))
        return torch.lerp(new, h, keep)  # (1 - keep) new + keep h

    def backward(self, t: int, gradient: Tensor) -> tuple[Tensor, Tensor]:
        """Of the memory after frame t, to those of what was read and of the memory before it."""
        _, h, gates, old, new = self.steps[t]
        size = h.shape[1]
        reset, keep = gates[:, :size], gates[:, size:]
        of_new = gradient * (1 - keep) * (1 - new * new)
        of_gates = torch.cat((of_new * old, gradient * (h - new)), 1) * gates * (1 - gates)
        of_x, of_h = torch.cat((of_gates, of_new), 1), torch.cat((of_gates, of_new * reset), 1)
        self.gradients[0].append(of_x)
        self.gradients[1].append(of_h)
        return of_x @ self.w_x, torch.addmm(gradient * keep, of_h, self.w_h)

    def weight_gradients(self) -> list[Tensor]:
        read, memory = [step[0] for step in self.steps], [step[1] for step in self.steps]
        return [*_products(read, self.gradients[0]), *_products(memory, self.gradients[1])]


def _products(read: list[Tensor], gradients: list[Tensor]) -> tuple[Tensor, Tensor]:
    """Gradients of a weight and its bias from what was read, and the gradients of what came of it, last frame first."""
    given = torch.cat(gradients[::-1])
    return given.T @ torch.cat(read), given.sum(0)


class _Scan(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, codes: Tensor, summaries: Tensor, noise_f: Tensor, noise_s: Tensor, bound: float,
        sizes: tuple[int, int, int], *weights: Tensor,
    ) -> tuple[Tensor, ...]:  # fmt: skip
        n_future, n_current, n_cells = sizes
        future = _Layers(weights[: 2 * n_future])
        current = _Layers(weights[2 * n_future : 2 * (n_future + n_current)])
        rest = weights[2 * (n_future + n_current) :]
        cells = [_Cell(rest[4 * k : 4 * k + 4]) for k in range(n_cells)]
        state = [codes.new_zeros(len(codes), cell.w_h.shape[1]) for cell in cells]
        steps = []
        for z, m, e_f, e_s in zip(codes.unbind(1), summaries.unbind(1), noise_f, noise_s, strict=True):
            h = state[-1]
            f_mean = f_log = f = e_f
            if n_future:
                f_mean, f_log, f = _draw(future.forward(torch.cat((h, m), 1)), e_f, bound)
            s_mean, s_log, s = _draw(current.forward(torch.cat((h, z, m), 1)), e_s, bound)
            x = torch.cat((s, f), 1)
            for k, cell in enumerate(cells):
                x = state[k] = cell.forward(x, state[k])
            steps.append((h, f, s, f_mean, f_log, s_mean, s_log))
        ctx.parts, ctx.noise, ctx.bound = (future, current, cells), (noise_f, noise_s), bound
        outputs = tuple(torch.stack(column, 1) for column in zip(*steps, strict=True))
        ctx.logs = outputs[4].detach(), outputs[6].detach()
        return outputs

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (future, current, cells), bound = ctx.parts, ctx.bound
        past, f, s, f_mean, f_log, s_mean, s_log = (g.unbind(1) for g in gradients)
        logs_f, logs_s = (log.unbind(1) for log in ctx.logs)
        noise_f, noise_s = ctx.noise
        n_s = s[0].shape[1]
        carried = [torch.zeros_like(cell.steps[0][1]) for cell in cells]  # of the memory after the frame
        for t in range(len(past) - 1, -1, -1):
            for k in range(len(cells) - 1, -1, -1):
                of_x, carried[k] = cells[k].backward(t, carried[k])
                if k:
                    carried[k - 1] = carried[k - 1] + of_x
            of_s, of_f = s[t] + of_x[:, :n_s], f[t] + of_x[:, n_s:]
            size = past[t].shape[1]
            of_past = past[t] + current.backward(t, _undraw(of_s, s_mean[t], s_log[t], logs_s[t], noise_s[t], bound))[
                :, :size]  # fmt: skip
            if future.weights:
                of_past = of_past + future.backward(
                    t, _undraw(of_f, f_mean[t], f_log[t], logs_f[t], noise_f[t], bound))[:, :size]  # fmt: skip
            carried[-1] = carried[-1] + of_past
        found = [*future.weight_gradients(), *current.weight_gradients()]
        found += [g for cell in cells for g in cell.weight_gradients()]
        ctx.parts = None  # large, and of no use twice
        return (None,) * 6 + tuple(found)


def _draw(numbers: Tensor, noise: Tensor, bound: float) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, bounded log-variance and a draw, of a perceptron's output."""
    mean, raw = numbers.chunk(2, 1)
    log = torch.tanh(raw / bound).mul_(bound)
    return mean, log, torch.addcmul(mean, (0.5 * log).exp_(), noise)


def _undraw(of_draw: Tensor, of_mean: Tensor, of_log: Tensor, log: Tensor, noise: Tensor, bound: float) -> Tensor:
    """The gradient of a perceptron's output from those of what :func:`_draw` makes of it."""
    of_log = of_log + of_draw * noise * (0.5 * (0.5 * log).exp_())
    return torch.cat((of_mean + of_draw, of_log * (1 - (log / bound).square_())), 1)
