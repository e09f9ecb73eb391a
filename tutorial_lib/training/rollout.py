r"""The engine: a recurrent network run under a schedule of truth and its own output, forward and backward.

.. math:: \hat x_t = \begin{cases} x_t & \text{where the schedule is true} \\ y_{t-1} & \text{else} \end{cases}
          \qquad (y_t, m_{t+1}) = H(\hat x_t, m_t)

With truth everywhere this is what equation 1 of the acRNN paper (Zhou et al., section 3) is measured on; where
the network reads itself it is equation 2, and the gradient runs back through all :math:`k` of its own outputs.

:func:`rollout` has two implementations that give the same numbers. The plain loop is the two equations above
and runs any network. The fast one knows the inside of an :class:`LSTM3LR`:

- the whole rollout is a single autograd function, so that nothing is recorded a frame at a time;
- gates are computed where they lie, in memory that is allocated once;
- frames whose input is known beforehand go through the stack a layer at a time, their input products taken
  together. A *run* starts wherever an own output is read and goes on over the truth that follows;
- backward, what the gates' derivatives need is prepared for all frames at once, and each weight's gradient
  is one product over all frames at the end.

It is the same code on a GPU, launched an operation at a time (not captured as a graph).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import TutorialError
from ..models.recurrent import LSTM3LR

State = tuple[Tensor, Tensor]

PIECE = 128  # frames that the fast rollout keeps at a time when no gradient is wanted


def rollout(
    model: nn.Module,
    x: Tensor,
    schedule: Tensor | np.ndarray | Sequence[bool],
    state: State | None = None,
    fast: bool | None = None,
) -> tuple[Tensor, State]:
    """Run a network over ``x``, fed the truth where the schedule says so and its own last output elsewhere.

    Parameters
    ----------
    model : called as ``model(frame (B, 1, D), state)`` -> ``(y (B, 1, D), state)``.
    x : (B, T, D), the truth. Frames that are not fed do not matter to the result.
    schedule : true = fed the truth; (T,), or (B, T) with one for each sequence, see
        :mod:`tutorial_lib.training.conditioning`. The first frame is always fed.
    state : memory to start from, as an earlier call returned it; ``None`` for zeros.
    fast : the fast implementation (true), the plain loop (false), or the fast one if there is one for this
        network (``None``).

    Returns
    -------
    y : (B, T, D), ``y[:, t]`` being the prediction of frame t + 1.
    state : memory after the last frame.

    Both are differentiable with respect to the weights, ``x`` and ``state``, by the fast implementation once.
    Going on from a state starts a new schedule, so its first frame is fed: give the last output as
    ``x[:, 0]`` to go on with that.

    Raises :class:`TutorialError` if the schedule has other frames or sequences than ``x``, does not begin with
    the truth, or if the fast implementation is asked for and does not know the network.
    """
    if x.ndim != 3 or x.shape[0] < 1 or x.shape[1] < 1:
        raise TutorialError(f"a rollout reads (sequences, frames, numbers), not {tuple(x.shape)}")
    truth = _check_schedule(schedule, *x.shape[:2])
    if fast is None:
        fast = has_fast_rollout(model)
    if not fast:
        return plain_rollout(model, x, truth.to(x.device), state)
    if not has_fast_rollout(model):
        raise TutorialError(f"no fast rollout for {type(model).__name__}: it knows LSTM3LR on float32 or float64")
    if x.shape[2] != model.config.dim:
        raise TutorialError(f"the network reads {model.config.dim} numbers a frame, the sequence has {x.shape[2]}")
    return _fast_rollout(model, x, truth, state)


def plain_rollout(model: nn.Module, x: Tensor, truth: Tensor, state: State | None = None) -> tuple[Tensor, State]:
    """:func:`rollout` as its equations say it, a frame at a time: ``truth`` is (B, T), ``x`` is (B, T, D)."""
    outputs, y = [], x[:, 0]  # not read: the first frame is the truth
    for t in range(x.shape[1]):
        frame = torch.where(truth[:, t, None], x[:, t], y)  # (B, D), truth or own output
        y, state = model(frame[:, None], state)
        y = y[:, 0]  # (B, D)
        outputs.append(y)
    return torch.stack(outputs, dim=1), state


def has_fast_rollout(model: nn.Module) -> bool:
    """Whether the fast implementation knows this network: an LSTM3LR, unchanged, in float32 or float64."""
    return (
        isinstance(model, LSTM3LR)
        and type(model).forward is LSTM3LR.forward
        and model.readout.weight.dtype in (torch.float32, torch.float64)
    )


def _check_schedule(schedule: Tensor | np.ndarray | Sequence[bool], batch: int, frames: int) -> Tensor:
    """The schedule as a boolean tensor (B, T) on the CPU."""
    truth = torch.as_tensor(schedule).cpu()
    if truth.dtype != torch.bool:
        raise TutorialError(f"a schedule is true or false at each frame, not {str(truth.dtype).removeprefix('torch.')}")
    if truth.ndim not in (1, 2):
        raise TutorialError(f"a schedule is (frames,) or (sequences, frames), not {tuple(truth.shape)}")
    if truth.shape[-1] != frames:
        raise TutorialError(f"the schedule has {truth.shape[-1]} frames, the sequence {frames}")
    if truth.ndim == 2 and truth.shape[0] != batch:
        raise TutorialError(f"the schedule is for {truth.shape[0]} sequences, there are {batch}")
    if not truth[..., 0].all():
        raise TutorialError("the schedule does not begin with the truth: there is no output yet to feed instead")
    return truth.expand(batch, frames)


def _runs(truth: Tensor) -> list[tuple[int, int]]:
    """Stretches [a, b) of frames of which only the first may read an own output; ``truth`` is (B, T)."""
    starts = [0, *(t for t in (~truth.all(dim=0)).nonzero()[:, 0].tolist())]
    return list(zip(starts, [*starts[1:], truth.shape[1]], strict=True))


def _all_own(truth: Tensor) -> set[int]:
    """Frames at which no sequence is fed the truth."""
    return set((~truth.any(dim=0)).nonzero()[:, 0].tolist())


def _fast_rollout(model: LSTM3LR, x: Tensor, truth: Tensor, state: State | None) -> tuple[Tensor, State]:
    layers, hidden = model.config.layers, model.config.hidden
    if state is None:
        h = c = x.new_zeros(layers, x.shape[0], hidden)
    else:
        h, c = state
    parameters = [getattr(model.lstm, name) for name in _names(layers)]
    parameters += [model.readout.weight, model.readout.bias]
    inputs = (x, h, c, *parameters)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs):
        y, h, c = _Rollout.apply(truth, x.transpose(0, 1), h, c, *parameters)
        return y.transpose(0, 1), (h, c)
    # nothing to keep for a backward pass: in pieces, so that a long sequence takes no more than a short one
    pieces = []
    for a in range(0, x.shape[1], PIECE):
        frames, fed = x[:, a : a + PIECE], truth[:, a : a + PIECE]
        if a > 0 and not fed[:, 0].all():
            first = torch.where(fed[:, 0, None].to(x.device), frames[:, 0], pieces[-1][:, -1])
            frames, fed = frames.clone(), fed.clone()
            frames[:, 0], fed[:, 0] = first, True
        y, h, c, *_ = _forward(fed, frames.transpose(0, 1), h, c, *parameters)
        pieces.append(y.transpose(0, 1))
    return torch.cat(pieces, dim=1), (h, c)


def _names(layers: int) -> list[str]:
    return [f"{kind}_l{k}" for k in range(layers) for kind in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")]


def _to_oifg(w: Tensor) -> Tensor:
    """Rows in torch's order i, f, g, o -> o, i, f, g: the sigmoids side by side, and what the cell reads too."""
    quarter = w.shape[0] // 4
    return torch.cat([w[3 * quarter :], w[: 3 * quarter]])


def _to_ifgo(w: Tensor) -> Tensor:
    quarter = w.shape[0] // 4
    return torch.cat([w[quarter:], w[:quarter]])


def _columns(w: Tensor) -> Tensor:
    """A weight transposed for ``input @ w``; copied where a rollout's many products repay it, in small networks."""
    return w.t().contiguous() if w.numel() <= 2**19 else w.t()


def _forward(truth: Tensor, x: Tensor, h0: Tensor, c0: Tensor, *parameters: Tensor):
    """Time-major: x (T, B, D), h0 and c0 (layers, B, H) -> y, h, c and what a backward pass needs."""
    *weights, w_out, b_out = parameters
    T, B, D = x.shape
    L, _, H = h0.shape
    w_in = [_columns(_to_oifg(w)) for w in weights[0::4]]  # (inputs, 4H), gates in the order o, i, f, g
    w_rec = [_columns(_to_oifg(w)) for w in weights[1::4]]  # (H, 4H)
    bias = [_to_oifg(b + b2) for b, b2 in zip(weights[2::4], weights[3::4], strict=True)]  # (4H,)
    w_out = _columns(w_out)

    inputs = x.contiguous().clone()  # what is really read: own outputs are written over the truth
    fed = truth.t()[..., None].to(x.device)  # (T, B, 1)
    y = x.new_empty(T, B, D)
    gates = [x.new_empty(T, B, 4 * H) for _ in range(L)]
    candidate = [x.new_empty(T, B, H) for _ in range(L)]  # g on its own: tanh is slow on strided memory
    h = [x.new_empty(T + 1, B, H) for _ in range(L)]  # h[k][t] is what layer k remembers before frame t
    c = [x.new_empty(T + 1, B, H) for _ in range(L)]
    tanh_c = [x.new_empty(T, B, H) for _ in range(L)]
    for k in range(L):
        h[k][0], c[k][0] = h0[k], c0[k]
    # views of each frame, made beforehand: a view costs as much as a small product
    steps = []
    for k in range(L):
        gate, g, tanh = gates[k], candidate[k], tanh_c[k]
        parts = (gate, gate[..., : 3 * H], *gate.split(H, dim=2), g, h[k][:-1], h[k][1:], c[k][:-1], c[k][1:], tanh)
        steps.append(list(zip(*(part.unbind(0) for part in parts), strict=True)))

    all_own = _all_own(truth)
    for a, b in _runs(truth):
        if a > 0:
            inputs[a] = y[a - 1] if a in all_own else torch.where(fed[a], x[a], y[a - 1])
        below = inputs[a:b].flatten(0, 1)
        for k in range(L):
            torch.addmm(bias[k], below, w_in[k], out=gates[k][a:b].flatten(0, 1))
            for gate, sigmoids, o, i, f, z, g, h_old, h_new, c_old, c_new, tanh in steps[k][a:b]:
                gate.addmm_(h_old, w_rec[k])
                sigmoids.sigmoid_()
                g.copy_(z).tanh_()
                torch.mul(f, c_old, out=c_new).addcmul_(i, g)  # c' = f c + i g
                torch.mul(o, torch.tanh(c_new, out=tanh), out=h_new)  # h' = o tanh c'
            below = h[k][a + 1 : b + 1].flatten(0, 1)
        torch.addmm(b_out, below, w_out, out=y[a:b].flatten(0, 1))
    last_h, last_c = torch.stack([v[-1] for v in h]), torch.stack([v[-1] for v in c])
    return y, last_h, last_c, inputs, gates, candidate, h, c, tanh_c


class _Rollout(torch.autograd.Function):
    """A whole rollout of an LSTM stack with a linear readout as one step of automatic differentiation."""

    @staticmethod
    def forward(ctx, truth: Tensor, x: Tensor, h0: Tensor, c0: Tensor, *parameters: Tensor):
        y, h_last, c_last, inputs, gates, candidate, h, c, tanh_c = _forward(truth, x, h0, c0, *parameters)
        ctx.truth = truth
        ctx.save_for_backward(inputs, *gates, *candidate, *h, *c, *tanh_c, *parameters)
        return y, h_last, c_last

    @staticmethod
    def backward(ctx, dy: Tensor, dh_last: Tensor, dc_last: Tensor):
        if torch.is_grad_enabled():  # create_graph=True: the products below would be taken for constants
            raise TutorialError("the fast rollout has no second derivative: take rollout(..., fast=False)")
        truth, L = ctx.truth, dh_last.shape[0]
        T, B, D = dy.shape
        H = dh_last.shape[2]
        inputs, *saved = ctx.saved_tensors
        gates, candidate, h, c, tanh_c = (saved[k * L : (k + 1) * L] for k in range(5))
        *weights, w_out, _ = saved[5 * L :]
        w_in = [_to_oifg(w) for w in weights[0::4]]  # (4H, inputs)
        w_rec = [_to_oifg(w) for w in weights[1::4]]  # (4H, H)

        dy = dy.contiguous().clone()  # own outputs that are read again collect more on the way
        dh = [dy.new_zeros(T + 1, B, H) for _ in range(L)]  # dh[k][t + 1]: of what frame t puts out
        dc = list(dc_last.clone().unbind(0))
        torch.mm(dy.flatten(0, 1), w_out, out=dh[-1][1:].flatten(0, 1))
        d_gates, by_c, steps = [], [], []
        for k in range(L):
            dh[k][-1] += dh_last[k]
            d_gates.append(torch.empty_like(gates[k]))
            by_c.append(torch.empty_like(tanh_c[k]))
            d, f = d_gates[k], gates[k][..., 2 * H : 3 * H]
            d_cell = d.view(T, B, 4, H)[:, :, 1:]  # i, f, g
            parts = (d, d[..., :H], d_cell, f, by_c[k], dh[k][:-1], dh[k][1:])
            steps.append(list(zip(*(part.unbind(0) for part in parts), strict=True)))

        own = ~truth.t()[..., None].to(dy.device)  # (T, B, 1)
        all_own = _all_own(truth)
        for a, b in reversed(_runs(truth)):
            for k in reversed(range(L)):
                # derivatives of h' and c' by the arguments of the gates, without the factors dh' and dc'
                d, g, tanh = d_gates[k][a:b], candidate[k][a:b], tanh_c[k][a:b]
                s = gates[k][a:b, :, : 3 * H]
                o, i, _ = s.split(H, dim=2)
                d_o, d_i, d_f, d_g = d.split(H, dim=2)
                torch.addcmul(s, s, s, value=-1, out=d[..., : 3 * H])  # s (1 - s)
                torch.mul(g, i, out=d_g)
                d_i *= g
                torch.addcmul(i, d_g, g, value=-1, out=d_g)  # i (1 - g^2)
                d_o *= tanh
                d_f *= c[k][a:b]
                torch.addcmul(o, h[k][a + 1 : b + 1], tanh, value=-1, out=by_c[k][a:b])  # o (1 - tanh^2 c')
                dck = dc[k]
                dck_column = dck[:, None]
                for d_t, d_o, d_ifg, f, by_c_t, dh_old, dh_new in reversed(steps[k][a:b]):
                    dck.addcmul_(dh_new, by_c_t)
                    d_o.mul_(dh_new)
                    d_ifg.mul_(dck_column)
                    dck.mul_(f)
                    dh_old.addmm_(d_t, w_rec[k])
                if k > 0:
                    dh[k - 1][a + 1 : b + 1].flatten(0, 1).addmm_(d.flatten(0, 1), w_in[k])
            if a > 0:  # frame a read what frame a - 1 put out
                back = torch.mm(d_gates[0][a], w_in[0])
                if a not in all_own:
                    back *= own[a]
                dy[a - 1] += back
                dh[-1][a].addmm_(back, w_out)

        gradients = []
        for k in range(L):
            d = d_gates[k].flatten(0, 1)  # (T B, 4H)
            below = inputs if k == 0 else h[k - 1][1:]
            bias = _to_ifgo(d.sum(dim=0))
            gradients += [_to_ifgo(d.t() @ below.flatten(0, 1)), _to_ifgo(d.t() @ h[k][:-1].flatten(0, 1)), bias, bias]
        gradients += [dy.flatten(0, 1).t() @ h[-1][1:].flatten(0, 1), dy.sum(dim=(0, 1))]
        dx = (d_gates[0] @ w_in[0]).masked_fill_(own, 0) if ctx.needs_input_grad[1] else None
        return None, dx, torch.stack([v[0] for v in dh]), torch.stack(dc), *gradients


class LSTMStream:
    """A network that makes one frame at a time, for synthesis: the memory is allocated once and written over.

    >>> y, state = model(seed)                      # (B, T0, D): warms up the memory
    >>> stream = LSTMStream(model, state)
    >>> frame = y[:, -1]
    >>> for _ in range(300):
    ...     frame = stream.step(frame)              # (B, D)

    Each layer's two products are one, of ``[W_ih, W_hh]`` with ``[input, h]``. The weights are copied when
    the stream is made: a network that is trained further needs a new one. No gradients.

    Parameters
    ----------
    model : an LSTM3LR.
    state : memory to start from, two tensors (layers, B, hidden); copied.
    """

    def __init__(self, model: LSTM3LR, state: State):
        if not has_fast_rollout(model):
            raise TutorialError(f"no fast stream for {type(model).__name__}: it knows LSTM3LR on float32 or float64")
        layers, hidden = model.config.layers, model.config.hidden
        h, c = (part.detach() for part in state)
        if h.shape != c.shape or h.ndim != 3 or h.shape[0] != layers or h.shape[2] != hidden:
            raise TutorialError(
                f"the network remembers two times ({layers}, sequences, {hidden}) numbers, "
                f"the state has {tuple(h.shape)} and {tuple(c.shape)}"
            )
        self.dim, self.batch = model.config.dim, h.shape[1]
        with torch.no_grad():
            self._layers = []
            for k in range(layers):
                w_in, w_rec, b_in, b_rec = (getattr(model.lstm, name) for name in _names(layers)[4 * k : 4 * k + 4])
                w = _to_oifg(torch.cat([w_in, w_rec], dim=1)).t().contiguous()  # (inputs + H, 4H)
                read = torch.cat([w.new_zeros(self.batch, w_in.shape[1]), h[k].to(w)], dim=1)  # [input, h]
                gates = w.new_empty(self.batch, 4 * hidden)
                self._layers.append((
                    w, _to_oifg(b_in + b_rec), read, read[:, : w_in.shape[1]], read[:, w_in.shape[1] :],
                    gates, gates[:, : 3 * hidden], *gates.split(hidden, dim=1), c[k].to(w, copy=True),
                ))  # fmt: skip
            self._w_out, self._b_out = model.readout.weight.detach().clone().t(), model.readout.bias.detach().clone()

    @torch.no_grad()
    def step(self, frame: Tensor) -> Tensor:
        """Read one frame (B, D) and return the prediction of the next, (B, D)."""
        if frame.shape != (self.batch, self.dim):
            raise TutorialError(f"the stream reads ({self.batch}, {self.dim}) numbers, not {tuple(frame.shape)}")
        below = frame
        for w, bias, read, below_part, h, gates, sigmoids, o, i, f, g, c in self._layers:
            below_part.copy_(below)
            if self.batch == 1:  # a matrix times a vector, which is bound by reading the matrix
                torch.addmv(bias, w.t(), read[0], out=gates[0])
            else:
                torch.addmm(bias, read, w, out=gates)
            sigmoids.sigmoid_()
            g.tanh_()
            c.mul_(f).addcmul_(i, g)
            below = torch.mul(o, torch.tanh(c), out=h)
        return torch.addmm(self._b_out, below, self._w_out)

    @property
    def state(self) -> State:
        """Memory after the last frame read: copies, (layers, B, hidden) each."""
        return torch.stack([layer[4] for layer in self._layers]), torch.stack([layer[-1] for layer in self._layers])
