r"""The engine: a recurrent network run under a schedule of truth and its own output, forward and backward.

.. math:: \hat x_t = \begin{cases} x_t & \text{where the schedule is true} \\ y_{t-1} & \text{else} \end{cases}
          \qquad (y_t, m_{t+1}) = H(\hat x_t, m_t)

With truth everywhere this is what equation 1 of the acRNN paper (Zhou et al., section 3) is measured on; where
the network reads itself it is equation 2, and the gradient runs back through all :math:`k` of its own outputs.

:func:`rollout` has two implementations that give the same numbers. The plain loop is the two equations above
and runs any network. The fast one knows the inside of an :class:`LSTM3LR`:

- the whole rollout is a single autograd function, so that nothing is recorded a frame at a time;
- all that the layers read lies on one tape, so that a layer's input, its own last output and the bias are one
  product, and no output is stored twice; the tape and the gates' memory are kept for the next rollout;
- frames whose input is known beforehand go through the stack a layer at a time, their input products taken
  together. A *run* starts wherever an own output is read and goes on over the truth that follows;
- gates are computed where they lie, all four by one sigmoid;
- backward, each layer's weights, both matrices and the bias, take one product over all frames at the end.

It is the same code on a GPU, launched an operation at a time (not captured as a graph).
"""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import TutorialError
from ..models.recurrent import LSTM3LR

State = tuple[Tensor, Tensor]

PIECE = 128  # frames that the fast rollout keeps at a time when no gradient is wanted
LARGE = 2**19  # weights in a layer from which on a transposed copy costs more than it gains
OIFG, IFGO = (3, 0, 1, 2), (1, 2, 3, 0)  # torch's gates i, f, g, o in the workspace's order, and back


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


def runs(truth: Tensor) -> list[tuple[int, int]]:
    """Stretches [a, b) of frames of which only the first may read an own output; ``truth`` is (B, T)."""
    starts = [0, *(~truth.all(dim=0)).nonzero()[:, 0].tolist()]
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
    parameters = _parameters(model)
    inputs = (x, h, c, *parameters)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs):
        y, h, c = _Rollout.apply(_Lease(model, x), truth, x.transpose(0, 1), h, c, *parameters)
        return y.transpose(0, 1), (h, c)
    # nothing to keep for a backward pass: in pieces, so that a long sequence takes no more than a short one
    pieces = []
    with torch.no_grad():
        for a in range(0, x.shape[1], PIECE):
            frames, fed = x[:, a : a + PIECE], truth[:, a : a + PIECE]
            if a > 0 and not fed[:, 0].all():
                first = torch.where(fed[:, 0, None].to(x.device), frames[:, 0], pieces[-1][:, -1])
                frames, fed = frames.clone(), fed.clone()
                frames[:, 0], fed[:, 0] = first, True
            lease = _Lease(model, frames)
            y, h, c = _forward(lease.workspace, fed, frames.transpose(0, 1), h, c, parameters)
            pieces.append(y.transpose(0, 1))
            del lease  # before the next one is made, which takes over the memory
    return torch.cat(pieces, dim=1), (h, c)


def _parameters(model: LSTM3LR) -> list[Tensor]:
    """For each layer W_ih, W_hh, b_ih, b_hh, then the readout's W and b."""
    kinds = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    weights = [getattr(model.lstm, f"{kind}_l{k}") for k in range(model.config.layers) for kind in kinds]
    return [*weights, model.readout.weight, model.readout.bias]


@dataclasses.dataclass(frozen=True)
class _Shape:
    """What a workspace is made for."""

    frames: int
    batch: int
    dim: int
    hidden: int
    layers: int
    dtype: torch.dtype
    device: torch.device


class _Tape:
    """How all that an LSTM stack reads lies in one row of memory, and its weights packed to match.

    A row is, for three layers, ``1 | x | h1 | 1 | h2 | 1 | h3 | 1``: what a layer reads, the layer below's output
    and its own last one, lies side by side with a 1 for the bias, and is multiplied with ``[W_ih, b, W_hh]`` in
    one product. The readout reads ``h3 | 1``. Nothing is stored twice.

    The gates' rows of a packed weight stand in the order o, i, f, g. Those of g are doubled, because
    tanh(z) = 2 sigmoid(2 z) - 1: one sigmoid serves all four, faster than a tanh of a strided quarter.
    """

    def __init__(self, dim: int, hidden: int, layers: int):
        self.dim, self.hidden, self.layers = dim, hidden, layers
        self._own = [1 + dim + k * (hidden + 1) for k in range(layers)]  # columns where the layers' outputs begin
        self.width = 1 + dim + layers * (hidden + 1)
        self.inner = [self._own[0]] + [hidden + 1] * (layers - 1)  # how many columns a layer reads from below, with 1

    def memory(self, *rows: int, like: Tensor) -> Tensor:
        """Zeros (*rows, width) with the ones in their places."""
        tape = like.new_zeros(*rows, self.width)
        tape[..., 0] = 1
        for column in self._own:
            tape[..., column + self.hidden] = 1
        return tape

    def x(self, tape: Tensor) -> Tensor:
        """The columns of the stack's input."""
        return tape[..., 1 : 1 + self.dim]

    def puts(self, tape: Tensor, k: int) -> Tensor:
        """The columns of layer ``k``'s output."""
        return tape[..., self._own[k] : self._own[k] + self.hidden]

    def reads(self, tape: Tensor, k: int) -> Tensor:
        """The columns of all that layer ``k`` reads: what comes from below, the 1, and its own last output."""
        return tape[..., self._own[k] - self.inner[k] : self._own[k] + self.hidden]

    def below(self, tape: Tensor, k: int) -> Tensor:
        """The columns that layer ``k`` reads from below, and the 1."""
        return tape[..., self._own[k] - self.inner[k] : self._own[k]]

    def out(self, tape: Tensor) -> Tensor:
        """The columns that the readout reads."""
        return tape[..., self._own[-1] :]

    def pack(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """A matrix (4H, columns read) for each layer, and the readout's (D, H + 1).

        ``parameters`` as the network has them: for each layer W_ih, W_hh, b_ih, b_hh, then the readout's W and b.
        """
        *weights, w_out, b_out = parameters
        H, packed = self.hidden, []
        for k in range(self.layers):
            w_in, w_rec, b_in, b_rec = weights[4 * k : 4 * k + 4]
            bias = (b_in + b_rec)[:, None]
            # the 1 stands before x, and behind every h
            parts = (bias, w_in, w_rec) if k == 0 else (w_in, bias, w_rec)
            w = torch.cat([torch.cat([part[q * H : (q + 1) * H] for part in parts], dim=1) for q in OIFG])
            w[3 * H :] *= 2
            packed.append(w)
        return [*packed, torch.cat([w_out, b_out[:, None]], dim=1)]

    def unpack(self, gradients: Sequence[Tensor]) -> list[Tensor]:
        """Gradients of packed weights as those of ``parameters``."""
        *layers, out = gradients
        H, parameters = self.hidden, []
        for k, w in enumerate(layers):
            w = torch.cat([w[q * H : (q + 1) * H] * (2 if q == 3 else 1) for q in IFGO])
            below, w_rec = w[:, :-H], w[:, -H:]
            w_in, bias = (below[:, 1:], below[:, 0]) if k == 0 else (below[:, :-1], below[:, -1])
            parameters += [w_in.contiguous(), w_rec.contiguous(), bias.contiguous(), bias.clone()]
        return [*parameters, out[:, :-1].contiguous(), out[:, -1].contiguous()]


class _Workspace:
    """The memory of one rollout, and its frames as views that are made once: a view costs as much as a small product.

    Row r of the tape (T + L, B, width) holds x_r, h1_{r-1}, h2_{r-2}, h3_{r-3}: each layer is one row behind the
    layer below, and so reads one row in every frame, though layer 2 takes layer 1's output of the same frame.
    """

    def __init__(self, shape: _Shape):
        T, B, D, H, L = shape.frames, shape.batch, shape.dim, shape.hidden, shape.layers
        self.shape = shape

        def memory(*size: int) -> Tensor:
            return torch.empty(size, dtype=shape.dtype, device=shape.device)

        self.layout = layout = _Tape(D, H, L)
        self.tape = layout.memory(T + L, B, like=memory(0))
        self.x = layout.x(self.tape[:T])
        self.read_out = layout.out(self.tape[L:])  # (T, B, H + 1)
        self.gates = [memory(T, B, 4 * H) for _ in range(L)]
        self.candidate = [memory(T, B, H) for _ in range(L)]  # g
        self.c = [memory(T + 1, B, H) for _ in range(L)]  # c[k][t] is layer k's cell before frame t
        self.tanh_c = [memory(T, B, H) for _ in range(L)]
        self.forward_steps = []
        for k in range(L):
            gate = self.gates[k]
            parts = (
                layout.reads(self.rows(k), k), layout.puts(self.rows(k), k), layout.puts(self.rows(k + 1), k),
                gate, *gate.split(H, dim=2), self.candidate[k], self.c[k][:-1], self.c[k][1:], self.tanh_c[k],
            )  # fmt: skip
            self.forward_steps.append(_frames(parts))
        self.backward_steps: list[list[tuple[Tensor, ...]]] = []  # made when a backward pass first needs them

    def rows(self, first: int, tape: Tensor | None = None) -> Tensor:
        """A row for each frame, (T, B, width), from this one on; layer k reads from row k on, writes from k + 1 on."""
        return (self.tape if tape is None else tape)[first : first + self.shape.frames]

    def load_weights(self, parameters: Sequence[Tensor]) -> None:
        """Pack them: rows are for the backward pass, columns for the forward one."""
        *self.w, self.w_out = self.layout.pack(parameters)
        self.columns, self.columns_out = [_columns(w) for w in self.w], _columns(self.w_out)

    def prepare_backward(self) -> None:
        """Memory for gradients, the first time that they are asked for."""
        if self.backward_steps:
            return
        layout, H = self.layout, self.shape.hidden
        self.d_tape = torch.empty_like(self.tape)
        self.d_gates = [torch.empty_like(gate) for gate in self.gates]
        self.scratch = torch.empty_like(self.tanh_c[0][0])
        for k in range(self.shape.layers):
            o, i, f, _ = self.gates[k].split(H, dim=2)
            read, written = self.rows(k, self.d_tape), self.rows(k + 1, self.d_tape)
            parts = (
                self.d_gates[k], *self.d_gates[k].split(H, dim=2), self.gates[k], o, i, f, self.candidate[k],
                self.c[k][:-1], self.tanh_c[k], layout.puts(self.rows(k + 1), k),
                layout.puts(written, k), layout.puts(read, k), layout.reads(read, k),
            )  # fmt: skip
            self.backward_steps.append(_frames(parts))

    def weight_gradients(self, dy: Tensor) -> list[Tensor]:
        """One product over all frames for each layer, in the network's own order."""
        products = [
            d.flatten(0, 1).t() @ self.layout.reads(self.rows(k), k).flatten(0, 1) for k, d in enumerate(self.d_gates)
        ]
        return self.layout.unpack([*products, dy.flatten(0, 1).t() @ self.read_out.flatten(0, 1)])


def _columns(w: Tensor) -> Tensor:
    """A weight transposed for ``input @ w``; copied where a rollout's many products repay it, in small networks."""
    return w.t().contiguous() if w.numel() <= LARGE else w.t()


def _frames(parts: Sequence[Tensor]) -> list[tuple[Tensor, ...]]:
    """Each frame's part of each, from time-major tensors."""
    return list(zip(*(part.unbind(0) for part in parts), strict=True))


_spare: weakref.WeakKeyDictionary[nn.Module, _Workspace] = weakref.WeakKeyDictionary()
"""One workspace a network that no rollout is using: the next one need not ask the system for fresh memory."""


class _Lease:
    """A workspace for as long as a rollout's graph lives; then it is kept for the network's next rollout."""

    def __init__(self, model: LSTM3LR, x: Tensor):
        config = model.config
        shape = _Shape(x.shape[1], x.shape[0], config.dim, config.hidden, config.layers, x.dtype, x.device)
        spare = _spare.pop(model, None)
        self.workspace = spare if spare is not None and spare.shape == shape else _Workspace(shape)
        self._model = weakref.ref(model)

    def __del__(self):
        model = self._model() if hasattr(self, "_model") else None
        if model is not None:
            _spare[model] = self.workspace


def _forward(
    space: _Workspace, truth: Tensor, x: Tensor, h0: Tensor, c0: Tensor, parameters: Sequence[Tensor]
) -> tuple[Tensor, Tensor, Tensor]:
    """Time-major: x (T, B, D), h0 and c0 (layers, B, H) -> y, h, c; the workspace holds what a backward pass needs."""
    T, B, L = space.shape.frames, space.shape.batch, space.shape.layers
    space.load_weights(parameters)
    space.x.copy_(x)  # what is really read: own outputs are written over the truth
    layout = space.layout
    for k in range(L):
        layout.puts(space.tape[k], k).copy_(h0[k])
        space.c[k][0] = c0[k]
    fed = truth.t()[..., None].to(x.device)  # (T, B, 1)
    all_own = _all_own(truth)
    minus_one = x.new_tensor(-1.0)

    for a, b in runs(truth):
        if a in all_own:
            torch.mm(space.read_out[a - 1], space.columns_out, out=space.x[a])
        elif a > 0:
            torch.where(fed[a], x[a], torch.mm(space.read_out[a - 1], space.columns_out), out=space.x[a])
        for k in range(L):
            columns = space.columns[k]
            alone = b - a == 1
            if not alone:  # inputs that are all known: one product
                known = layout.below(space.rows(k)[a:b], k).flatten(0, 1)
                torch.mm(known, columns[: layout.inner[k]], out=space.gates[k][a:b].flatten(0, 1))
                columns = columns[layout.inner[k] :]
            for read, h_old, h_new, gate, o, i, f, s, g, c_old, c_new, tanh in space.forward_steps[k][a:b]:
                if alone:
                    torch.mm(read, columns, out=gate)
                else:
                    gate.addmm_(h_old, columns)
                gate.sigmoid_()
                torch.add(minus_one, s, alpha=2, out=g)  # tanh z = 2 sigmoid(2 z) - 1
                torch.mul(f, c_old, out=c_new).addcmul_(i, g)  # c' = f c + i g
                torch.mul(o, torch.tanh(c_new, out=tanh), out=h_new)  # h' = o tanh c'
    y = (space.read_out.flatten(0, 1) @ space.columns_out).view(T, B, -1)
    h = torch.stack([layout.puts(space.tape[k + T], k) for k in range(L)])
    return y, h, torch.stack([c[T] for c in space.c])


class _Rollout(torch.autograd.Function):
    """A whole rollout of an LSTM stack with a linear readout as one step of automatic differentiation."""

    @staticmethod
    def forward(ctx, lease: _Lease, truth: Tensor, x: Tensor, h0: Tensor, c0: Tensor, *parameters: Tensor):
        ctx.lease, ctx.truth = lease, truth
        return _forward(lease.workspace, truth, x, h0, c0, parameters)

    @staticmethod
    def backward(ctx, dy: Tensor, dh_last: Tensor, dc_last: Tensor):
        if torch.is_grad_enabled():  # create_graph=True: the products below would be taken for constants
            raise TutorialError("the fast rollout has no second derivative: take rollout(..., fast=False)")
        space, truth = ctx.lease.workspace, ctx.truth
        space.prepare_backward()
        layout, d_tape, scratch = space.layout, space.d_tape, space.scratch
        T, L = space.shape.frames, space.shape.layers
        w_x, w_out = layout.x(space.w[0]), space.w_out[:, :-1]

        dy = dy.contiguous().clone()  # own outputs that are read again collect more on the way
        d_tape.zero_()
        d_out = layout.puts(d_tape[L:], L - 1)  # (T, B, H), of what the last layer puts out
        torch.mm(dy.flatten(0, 1), w_out, out=d_out.flatten(0, 1))
        for k in range(L):
            layout.puts(d_tape[k + T], k).add_(dh_last[k])
        dc = list(dc_last.clone().unbind(0))
        d_x = layout.x(d_tape[:T])
        zero = dy.new_tensor(0.0)

        own = ~truth.t()[..., None].to(dy.device)  # (T, B, 1)
        all_own = _all_own(truth)
        for a, b in reversed(runs(truth)):
            for k in reversed(range(L)):
                w, dck = space.w[k], dc[k]
                alone, inner = b - a == 1, layout.inner[k]
                w_rec = w[:, inner:]
                for d, d_o, d_i, d_f, d_g, gate, o, i, f, g, c, tanh, h, dh, dh_old, d_read in reversed(
                    space.backward_steps[k][a:b]
                ):
                    torch.mul(dh, tanh, out=d_o)
                    dck.addcmul_(dh, torch.addcmul(o, h, tanh, value=-1, out=scratch))  # o (1 - tanh^2 c')
                    torch.mul(dck, g, out=d_i)
                    torch.mul(dck, c, out=d_f)
                    torch.addcmul(zero, dck, i, value=2, out=d_g)
                    torch.ops.aten.sigmoid_backward.grad_input(d, gate, grad_input=d)  # d * s (1 - s), all gates
                    dck.mul_(f)
                    if alone:
                        d_read.addmm_(d, w)
                    else:
                        dh_old.addmm_(d, w_rec)
                if not alone and k > 0:
                    below = layout.below(space.rows(k, d_tape)[a:b], k).flatten(0, 1)
                    below.addmm_(space.d_gates[k][a:b].flatten(0, 1), w[:, :inner])
            if a > 0:  # frame a read what frame a - 1 put out
                back = d_x[a] if b - a == 1 else torch.mm(space.d_gates[0][a], w_x)
                if a not in all_own:
                    back = back * own[a]
                dy[a - 1] += back
                d_out[a - 1].addmm_(back, w_out)

        dx = None
        if ctx.needs_input_grad[2]:
            dx = (space.d_gates[0] @ w_x).masked_fill_(own, 0)
        dh0 = torch.stack([layout.puts(d_tape[k], k) for k in range(L)])
        return None, None, dx, dh0, torch.stack(dc), *space.weight_gradients(dy)


class LSTMStream:
    """A network that makes one frame at a time, for synthesis: the memory is allocated once and written over.

    >>> y, state = model(seed)                      # (B, T0, D): warms up the memory
    >>> stream = LSTMStream(model, state)
    >>> frame = y[:, -1]
    >>> for _ in range(300):
    ...     frame = stream.step(frame)              # (B, D)

    Its memory is one row of the rollout's tape: each layer writes its output where the layer above and itself
    read it, and all that a layer reads is multiplied in one product. The weights are copied when the stream is
    made: a network that is trained further needs a new one. No gradients.

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
        weights = _parameters(model)
        with torch.no_grad():
            like = weights[0]
            self._tape = _Tape(model.config.dim, hidden, layers)
            row = self._tape.memory(self.batch, like=like)
            packed = self._tape.pack(weights)
            self._x = self._tape.x(row)
            self._read_out, self._w_out = self._tape.out(row), packed[-1]
            self._layers = []
            for k, w in enumerate(packed[:-1]):
                put = self._tape.puts(row, k)
                put.copy_(h[k])
                gates, g, tanh = (like.new_empty(self.batch, n * hidden) for n in (4, 1, 1))
                o, i, f, s = gates.split(hidden, dim=1)
                cell = c[k].to(like, copy=True)
                self._layers.append((self._tape.reads(row, k), w, gates, o, i, f, s, g, cell, tanh, put))
            self._minus_one = like.new_tensor(-1.0)

    @torch.no_grad()
    def step(self, frame: Tensor) -> Tensor:
        """Read one frame (B, D) and return the prediction of the next, (B, D)."""
        if frame.shape != (self.batch, self.dim):
            raise TutorialError(f"the stream reads ({self.batch}, {self.dim}) numbers, not {tuple(frame.shape)}")
        self._x.copy_(frame)
        for read, w, gates, o, i, f, s, g, c, tanh, h in self._layers:
            if self.batch == 1:  # a matrix times a vector, which is bound by reading the matrix
                torch.mv(w, read[0], out=gates[0])
            else:
                torch.mm(read, w.t(), out=gates)
            gates.sigmoid_()
            torch.add(self._minus_one, s, alpha=2, out=g)  # tanh z = 2 sigmoid(2 z) - 1
            c.mul_(f).addcmul_(i, g)
            torch.mul(o, torch.tanh(c, out=tanh), out=h)
        return self._read_out @ self._w_out.t()

    @property
    def state(self) -> State:
        """Memory after the last frame read: copies, (layers, B, hidden) each."""
        return torch.stack([layer[-1] for layer in self._layers]), torch.stack([layer[-3] for layer in self._layers])
