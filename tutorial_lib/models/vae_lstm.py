"""The VAE-LSTM: a generative model of motion that follows control signals and needs no seed frames.

Habibie, Holden, Schwarz, Yearsley and Komura, "A recurrent variational autoencoder for human motion synthesis"
(BMVC 2017). Equation numbers beside the lines are the paper's.

Shapes: B sequences of T frames, S = T / 4 steps of the motion canvas, J3 numbers of a pose (63), C of control (3),
H cells (128).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import conv1d, dropout, elu, max_pool1d, pad

from ..errors import TutorialError
from .variational import gaussian_sample

CELLS = ("modified", "ordinary")
LATENTS = ("per-step", "one")
LEAST_LOG_VARIANCE = -12.0  # exp(-12 / 2) = 0.0025: below it the divergence only grows


@dataclass(frozen=True)
class VAELSTMConfig:
    """Sizes of a :class:`VAELSTM`; the defaults are the paper's (section 4.2)."""

    dim: int  # numbers a frame, control among them: 66
    control: tuple[int, int]  # first and last + 1 of the control channels, the representation's slice: (63, 66)
    hidden: int = 128  # cells, which is the size of the code, of the encoded control and of a step of the canvas
    filters: int = 64  # of the first convolution of both encoders
    kernel: int = 25  # frames that a convolution sees, odd; at 60 Hz 0.4 s
    pooling: int = 2  # of each of the two blocks: 240 frames become 60 steps (the paper's "size 1" would not)
    dropout: float = 0.1  # share of the encoders' input numbers that are left out; the paper does not say how many
    cell: str = "modified"  # or "ordinary": a plain LSTM that reads the code; the paper finds it ignored (section 3.3)
    latent: str = "per-step"  # or "one": a single code for the whole motion in training, too

    def __post_init__(self):
        for name in ("dim", "hidden", "filters", "kernel", "pooling"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise TutorialError(f"VAELSTM: {name} must be a whole number of 1 or more, not {value!r}")
        if self.kernel % 2 == 0:
            raise TutorialError(f"VAELSTM: the kernel must be odd, so that it has a middle, not {self.kernel}")
        try:
            first, last = (int(edge) for edge in self.control)
        except (TypeError, ValueError):
            raise TutorialError(f"VAELSTM: control is the pair (first, last + 1), not {self.control!r}") from None
        if not 0 <= first < last <= self.dim or last - first == self.dim:
            raise TutorialError(
                f"VAELSTM: control channels {first} to {last - 1} of {self.dim}: expected some of them, not all"
            )
        object.__setattr__(self, "control", (first, last))
        if isinstance(self.dropout, bool) or not isinstance(self.dropout, (int, float)) or not 0 <= self.dropout < 1:
            raise TutorialError(f"VAELSTM: dropout must be a share of 0 or more below 1, not {self.dropout!r}")
        for name, known in (("cell", CELLS), ("latent", LATENTS)):
            if getattr(self, name) not in known:
                raise TutorialError(
                    f"VAELSTM: unknown {name} {getattr(self, name)!r}: expected one of {', '.join(known)}"
                )

    @property
    def stride(self) -> int:
        """Frames in a step of the canvas: 4."""
        return self.pooling**2

    @property
    def n_control(self) -> int:
        """C."""
        return self.control[1] - self.control[0]

    @property
    def halo(self) -> int:
        """Steps of the canvas to either side that one step's encoding, or one frame's decoding, can depend on."""
        radius = self.kernel // 2
        return math.ceil(radius * (1 + self.pooling) / self.stride)


class Encoder(nn.Module):
    """Two blocks of convolution over time, ELU and max-pooling: frames to steps (section 3.2, equation 6, figure 2).

    ``last_activation=False`` leaves out the ELU of the second, for an output that is to have any sign and size.
    """

    def __init__(self, inputs: int, outputs: int, config: VAELSTMConfig, *, last_activation: bool = True):
        super().__init__()
        self.pooling, self.dropout, self.last_activation = config.pooling, config.dropout, last_activation
        half = config.kernel // 2  # "same": a convolution keeps the length
        self.first = nn.Conv1d(inputs, config.filters, config.kernel, padding=half, padding_mode="replicate")
        self.second = nn.Conv1d(config.filters, outputs, config.kernel, padding=half, padding_mode="replicate")

    def forward(self, x: Tensor) -> Tensor:
        """(B, T, inputs) -> (B, T / pooling^2, outputs)."""
        x = dropout(x, self.dropout, self.training)
        x = x.transpose(1, 2)  # (B, inputs, T)
        x = max_pool1d(elu(self.first(x)), self.pooling)  # (6), inner: (B, filters, T / 2)
        x = self.second(x)
        x = max_pool1d(elu(x) if self.last_activation else x, self.pooling)  # (6), outer: (B, outputs, T / 4)
        return x.transpose(1, 2)  # (B, S, outputs)


class ModifiedCell(nn.Module):
    """The LSTM cell of equations 7 to 9: no output gate, its state is its output.

    ``forward(state, control)`` is one step of it. What ``state`` is makes the two modes: the code z_t during
    training, and the state before at synthesis. The paper writes c_(t-1) into equations 7 and 8 in either case but
    says that the state is *set to* the code at every step; read that way the gates see the code too, and a step of
    training does not depend on the one before.
    """

    def __init__(self, hidden: int):
        super().__init__()
        self.gates_state = nn.Linear(hidden, 2 * hidden)  # W_ic, W_fc and their biases
        self.gates_control = nn.Linear(hidden, 2 * hidden)  # W_ih, W_fh and theirs
        self.state = nn.Linear(hidden, hidden, bias=False)  # W_c
        self.control = nn.Linear(hidden, hidden, bias=False)  # W_h

    def forward(self, state: Tensor, control: Tensor) -> Tensor:
        """(..., H) state or code and (..., H) encoded control -> the new state (..., H)."""
        return self.step(state, self.gates_control(control), self.control(control))

    def step(self, state: Tensor, gates: Tensor, candidate: Tensor) -> Tensor:
        """A step for which the control's part was computed before, for all steps at once."""
        gates = torch.sigmoid(self.gates_state(state) + gates)  # s(.)
        i, f = gates.chunk(2, -1)  # (7), (8): (..., H) each
        return elu(f * self.state(state) + i * candidate)  # (9)

    def run(self, state: Tensor, control: Tensor) -> Tensor:
        """Synthesis, algorithm 1: from z_1 (B, H) along the encoded control (B, S, H) -> all states (B, S, H)."""
        gates, candidate, states = self.gates_control(control), self.control(control), []
        for t in range(control.shape[1]):
            state = self.step(state, gates[:, t], candidate[:, t])  # c(t) = RNN(c(t-1), h_t)
            states.append(state)
        return torch.stack(states, 1)


class UpsampleConv(nn.Module):
    """Every step repeated ``factor`` times, then a convolution over time that keeps the length.

    Computed at the lower rate: of the frames that a kernel of 25 sees, neighbours are equal, so that each of the
    ``factor`` frames of a step is a convolution of the steps with 13 sums of weights, half the work.
    """

    def __init__(self, inputs: int, outputs: int, kernel: int, factor: int):
        super().__init__()
        self.factor, radius = factor, kernel // 2
        plain = nn.Conv1d(inputs, outputs, kernel)  # for its usual first weights
        self.weight, self.bias = plain.weight, plain.bias
        self.before, self.after = -(-radius // factor), (radius + factor - 1) // factor  # steps seen to either side
        self.zeros = self.before * factor - radius, self.after * factor + factor - 1 - radius
        self._kept: tuple[object, Tensor | None] = (None, None)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, S) -> (B, outputs, factor S)."""
        x = pad(x, (self.before, self.after), mode="replicate")
        x = conv1d(x, self._weight())  # (B, outputs factor, S)
        return x.unflatten(1, (-1, self.factor)).transpose(2, 3).flatten(2) + self.bias[:, None]

    def train(self, mode: bool = True) -> UpsampleConv:
        """As every module's; what was kept of the weights is forgotten."""
        self._kept = None, None
        return super().train(mode)

    def _weight(self) -> Tensor:
        """The sums (outputs factor, inputs, n). In evaluation they are kept, for they cost more than a second of one
        character's motion; a fused optimiser changes weights without telling, so training forgets them."""
        if self.training or torch.is_grad_enabled():
            self._kept = None, None
            return self._sums()
        state = self.weight.data_ptr(), self.weight._version  # changed by whatever else writes to the weights
        if self._kept[0] != state:
            self._kept = state, self._sums()
        return self._kept[1]

    def _sums(self) -> Tensor:
        left, right = self.zeros  # about the kernel of a step's first frame; of its k-th, shifted by k
        kernels = [pad(self.weight, (left + k, right - k)) for k in range(self.factor)]
        weight = torch.stack(kernels, 1).flatten(0, 1)  # (outputs factor, inputs, n factor)
        return weight.unflatten(-1, (-1, self.factor)).sum(-1)


class Decoder(nn.Module):
    """The deconvolution: the encoder backwards, from the motion canvas to frames (section 3.3)."""

    def __init__(self, config: VAELSTMConfig):
        super().__init__()
        self.first = UpsampleConv(config.hidden, config.hidden, config.kernel, config.pooling)
        self.second = UpsampleConv(config.hidden, config.dim, config.kernel, config.pooling)

    def forward(self, canvas: Tensor) -> Tensor:
        """(B, S, H) -> (B, T, D)."""
        x = elu(self.first(canvas.transpose(1, 2)))  # (B, H, T / 2)
        return self.second(x).transpose(1, 2)  # (B, T, D): any real numbers, so no activation


class Reconstruction(NamedTuple):
    """What training looks at."""

    frames: Tensor  # (B, T, D)
    mean: Tensor  # (B, S, H) of q(z_t | x), or (B, 1, H) where one code is for the whole motion
    log_variance: Tensor  # the same


class VAELSTM(nn.Module):
    """Control encoder, inference network, recurrent decoder, deconvolution (figure 1).

    Reads and writes normalised features ``(B, T, D)``; T is a multiple of ``config.stride``. The inference network
    reads the pose channels, the control encoder the control channels, the output has both.

    The modified cell has no recurrence in training, so all steps are computed at once; see :class:`ModifiedCell`.
    The ordinary cell is an ``nn.LSTM`` that reads control and code side by side and remembers what it likes. With
    ``latent="one"`` training runs as synthesis does, from one code of the whole motion.
    """

    def __init__(self, config: VAELSTMConfig):
        super().__init__()
        self.config = config
        H, C = config.hidden, config.n_control
        self.control_encoder = Encoder(C, H, config)
        # without (6)'s last ELU: mean and log-variance would not get below -1
        self.inference = Encoder(config.dim - C, 2 * H, config, last_activation=False)
        self.cell = ModifiedCell(H) if config.cell == "modified" else nn.LSTM(2 * H, H, batch_first=True)
        self.decoder = Decoder(config)

    def split(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, T, D) -> pose (B, T, J3) and control (B, T, C). Raises ``TutorialError`` for another D or T."""
        self._check(x, self.config.dim, "features")
        first, last = self.config.control
        return torch.cat((x[..., :first], x[..., last:]), -1), x[..., first:last]

    def infer(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """The approximate posterior q(z | x): mean and log-variance, (B, S, H) each ((B, 1, H) of latent "one").

        ``pose`` (B, T, J3); from 4 frames, one step, as the paper starts its test motions.
        """
        self._check(pose, self.config.dim - self.config.n_control, "poses")
        q = self.inference(pose)  # (B, S, 2 H)
        if self.config.latent == "one":
            q = q.mean(1, keepdim=True)  # (B, 1, 2 H)
        mean, log_variance = q.chunk(2, -1)
        return mean, log_variance.clamp(min=LEAST_LOG_VARIANCE)

    def encode_control(self, control: Tensor) -> Tensor:
        """(B, T, C) -> (B, S, H), deterministic: ``h_t^c``."""
        self._check(control, self.config.n_control, "control")
        return self.control_encoder(control)

    def forward(self, x: Tensor, generator: torch.Generator | None = None) -> Reconstruction:
        """The training mode: encode ``x`` (B, T, D), draw a code, and decode it again.

        generator: on the CPU; what the codes are drawn from.
        """
        pose, control = self.split(x)
        mean, log_variance = self.infer(pose)  # (B, S, H), or (B, 1, H)
        code = gaussian_sample(mean, log_variance, generator)  # (3), "a single sample z_t each time step"
        h = self.encode_control(control)  # (B, S, H)
        if self.config.cell == "modified" and self.config.latent == "per-step":
            canvas = self.cell(code, h)  # (9), "during training": (B, S, H)
        else:
            canvas, _ = self.run(h, code[:, 0] if self.config.latent == "one" else code)
        return Reconstruction(self.decoder(canvas), mean, log_variance)

    def run(self, h: Tensor, code: Tensor, state=None) -> tuple[Tensor, object]:
        """The canvas (B, S, H) along the encoded control, and the memory to go on from.

        h : (B, S, H) from :meth:`encode_control`.
        code : (B, H), one code z_1, which is the first cell state (equation 9, "at test time"; the ordinary cell
            reads it at every step); or (B, S, H), one a step, as in training.
        state : what an earlier call gave, to go on from; the one code is then not looked at.
        """
        if self.config.cell == "ordinary":
            codes = code if code.ndim == 3 else code[:, None].expand(-1, h.shape[1], -1)
            return self.cell(torch.cat((h, codes), -1), state)  # m_c = [h_1 || ... || h_S]
        canvas = self.cell(code, h) if code.ndim == 3 else self.cell.run(code if state is None else state, h)  # m_c
        return canvas, canvas[:, -1]

    def synthesize(self, control: Tensor, code: Tensor) -> Tensor:
        """Algorithm 1: control (B, T, C) and a code, (B, H) or (B, S, H), to frames (B, T, D), all normalised."""
        canvas, _ = self.run(self.encode_control(control), code)
        return self.decoder(canvas)

    def _check(self, x: Tensor, width: int, what: str) -> None:
        if x.ndim != 3 or x.shape[-1] != width:
            raise TutorialError(f"VAELSTM: {what} of shape {tuple(x.shape)}, expected (sequences, frames, {width})")
        if x.shape[1] < 1 or x.shape[1] % self.config.stride:
            raise TutorialError(
                f"VAELSTM: {what} of {x.shape[1]} frames, expected a multiple of {self.config.stride}, which the "
                "pooling makes one step of"
            )
