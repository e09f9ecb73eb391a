"""How fast the rollout is: ``python -m tutorial_lib benchmark rollout --hidden 128``.

Two ways of doing the same, by turns in one run, so that what else the machine does slows both: the library's
fast rollout, and a plain loop of ``nn.LSTMCell`` calls, one for each layer and frame, as one would write it
first. Both train the same network with the same optimiser. Told are medians and their ratio, and beside them how
long the matrix products alone take, as few as the schedule allows and always on the same memory: no way of computing
them one after another is faster.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor, nn

from ..models.recurrent import LSTM3LR
from ..threads import torch_threads
from .conditioning import auto_conditioning
from .rollout import LSTMStream, rollout, runs
from .systems import global_seed, make_system


class CellLoop(nn.Module):
    """The plain reference: an LSTM3LR's weights in ``nn.LSTMCell`` layers, called a frame at a time."""

    def __init__(self, model: LSTM3LR):
        super().__init__()
        config = model.config
        self.cells = nn.ModuleList(
            nn.LSTMCell(config.dim if k == 0 else config.hidden, config.hidden) for k in range(config.layers)
        )
        self.readout = nn.Linear(config.hidden, config.dim)
        with torch.no_grad():
            for k, cell in enumerate(self.cells):
                for name, weight in cell.named_parameters():
                    weight.copy_(getattr(model.lstm, f"{name}_l{k}"))
        self.readout.load_state_dict(model.readout.state_dict())

    def start(self, batch: int) -> list[tuple[Tensor, Tensor]]:
        """A memory of zeros."""
        zeros = self.readout.weight.new_zeros(batch, self.readout.in_features)
        return [(zeros, zeros) for _ in self.cells]

    def step(self, frame: Tensor, state: list[tuple[Tensor, Tensor]]) -> tuple[Tensor, list[tuple[Tensor, Tensor]]]:
        """One frame (B, D) -> the prediction of the next, and the new memory."""
        after = []
        for cell, memory in zip(self.cells, state, strict=True):
            frame, c = cell(frame, memory)
            after.append((frame, c))
        return self.readout(frame), after

    def forward(self, x: Tensor, schedule: list[bool]) -> Tensor:
        """(B, T, D) under a schedule for all sequences -> (B, T, D)."""
        state, outputs, y = self.start(x.shape[0]), [], x[:, 0]
        for t, truth in enumerate(schedule):
            y, state = self.step(x[:, t] if truth else y, state)
            outputs.append(y)
        return torch.stack(outputs, dim=1)


@dataclasses.dataclass(frozen=True)
class Timing:
    """Median seconds of the plain loop, of the fast rollout, and of the matrix products alone, measured by turns."""

    plain: float
    fast: float
    products: float

    @property
    def ratio(self) -> float:
        """How many times faster."""
        return self.plain / self.fast

    @property
    def limit(self) -> float:
        """How many times faster it would be if all but the products were free."""
        return self.plain / self.products


Product = tuple[int, int, int]


def training_products(hidden: int, layers: int, dim: int, batch: int, schedule: Tensor) -> list[Product]:
    """Rows, terms and columns of each matrix product that a training step cannot do without.

    Frames of truth have their input products taken together, and so have those of the readout of frames up to the
    next that must be known; weights have one product for all frames. What the truth is fed from has no gradient.
    """
    gates, found = 4 * hidden, []
    for a, b in runs(schedule[None]):
        rows = (b - a) * batch
        for k in range(layers):
            below = hidden if k else dim
            back = below if k or not schedule[a] else 0  # columns that a gradient is wanted of
            if b - a == 1:
                found += [(batch, below + hidden, gates), (batch, gates, back + hidden)]
            else:
                found += [(rows, below, gates), (rows if k else batch, gates, back)]
                found += [(batch, hidden, gates), (batch, gates, hidden)] * (b - a)
        found += [(rows, hidden, dim), (rows, dim, hidden)]
    frames = len(schedule) * batch
    found += [(gates, frames, (hidden if k else dim) + hidden) for k in range(layers)] + [(dim, frames, hidden)]
    return [product for product in found if 0 not in product]


def _multiply(products: Sequence[Product]) -> Callable[[], None]:
    """Carries out the products; those of one size on the same memory."""
    memory = {(m, k, n): (torch.rand(m, k), torch.rand(k, n), torch.empty(m, n)) for m, k, n in products}

    def run() -> None:
        for size in products:
            a, b, out = memory[size]
            torch.mm(a, b, out=out)

    return run


def time_training(
    hidden: int, *, layers: int = 3, dim: int = 171, frames: int = 100, batch: int = 32, u: int = 5, v: int = 5,
    repeats: int = 9,
) -> Timing:  # fmt: skip
    """Seconds of a training step of acLSTM: forward, backward and Adam."""
    model = make_system("aclstm", dim, hidden=hidden, layers=layers).model
    loop = CellLoop(model)
    generator = torch.Generator().manual_seed(0)
    x, target = (0.1 * torch.randn(batch, frames, dim, generator=generator) for _ in range(2))
    schedule = auto_conditioning(frames, u, v)
    fed = schedule.tolist()

    def training_step(network: nn.Module, run: Callable[[], Tensor]) -> Callable[[], None]:
        optimizer = torch.optim.Adam(network.parameters(), lr=1e-4, fused=True)

        def step() -> None:
            loss = (run() - target).square().sum(dim=-1).mean()
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()

        return step

    return _by_turns(
        training_step(loop, lambda: loop(x, fed)),
        training_step(model, lambda: rollout(model, x, schedule, fast=True)[0]),
        _multiply(training_products(hidden, layers, dim, batch, schedule)),
        repeats,
    )


def time_synthesis(
    hidden: int = 1024, *, layers: int = 3, dim: int = 171, frames: int = 60, batch: int = 1, repeats: int = 9
) -> Timing:
    """Seconds of a frame of synthesis, the network living on its own output."""
    model = make_system("lstm", dim, hidden=hidden, layers=layers).model
    loop = CellLoop(model)
    zeros = torch.zeros(layers, batch, hidden)
    stream = LSTMStream(model, (zeros, zeros))
    first = 0.1 * torch.randn(batch, dim, generator=torch.Generator().manual_seed(0))

    @torch.no_grad()
    def plain() -> None:
        frame, state = first, loop.start(batch)
        for _ in range(frames):
            frame, state = loop.step(frame, state)

    def fast() -> None:
        frame = first
        for _ in range(frames):
            frame = stream.step(frame)

    sizes = [(4 * hidden, (hidden if k else dim) + hidden) for k in range(layers)] + [(dim, hidden)]
    rest = () if batch == 1 else (batch,)  # a matrix times a vector, if there is one sequence
    memory = [(torch.rand(rows, read), torch.rand(read, *rest), torch.empty(rows, *rest)) for rows, read in sizes]

    def products() -> None:
        for _ in range(frames):
            for weight, columns, out in memory:
                torch.matmul(weight, columns, out=out)

    timing = _by_turns(plain, fast, products, repeats)
    return Timing(*(seconds / frames for seconds in dataclasses.astuple(timing)))


def report(hidden: int, *, threads: int = 2, repeats: int = 9) -> Iterator[str]:
    """The lines that the command prints, each when it is known; the last holds both ratios.

    Training is with ``hidden`` cells a layer, synthesis always the paper's three layers of 1024, batch 1.
    """
    with torch_threads(threads), global_seed(0):
        yield f"{threads} threads, torch {torch.__version__}; 171 numbers a frame, three layers, median of {repeats}"
        training = time_training(hidden, repeats=repeats)
    yield (
        f"training step, {hidden} cells, 100 frames, 32 sequences, u = v = 5: "
        f"plain loop {training.plain:.3f} s, rollout {training.fast:.3f} s; "
        f"matrix products alone {training.products:.3f} s, {training.limit:.2f}x at most"
    )
    with torch_threads(threads), global_seed(0):
        synthesis = time_synthesis(repeats=repeats)
    yield (
        f"synthesis, 1024 cells, one sequence: "
        f"plain loop {1 / synthesis.plain:.0f} frames/s, stream {1 / synthesis.fast:.0f} frames/s; "
        f"matrix products alone {1 / synthesis.products:.0f} frames/s, {synthesis.limit:.2f}x at most"
    )
    yield f"training {training.ratio:.2f}x, synthesis {synthesis.ratio:.2f}x, hidden {hidden}"


def _by_turns(
    plain: Callable[[], None], fast: Callable[[], None], products: Callable[[], None], repeats: int
) -> Timing:
    seconds: tuple[list[float], ...] = ([], [], [])
    for turn in range(repeats + 1):
        for run, times in zip((plain, fast, products), seconds, strict=True):
            start = time.perf_counter()
            run()
            if turn > 0:  # the first warms up
                times.append(time.perf_counter() - start)
    return Timing(*(statistics.median(times) for times in seconds))
