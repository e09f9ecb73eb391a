"""What a person sees while a network trains: a line of progress and, in a notebook, the loss so far.

In a notebook both are plain outputs that are *replaced* in place (a line of text and a small PNG), so that
a saved notebook holds their last state only. Widgets would leave "Loading widget ..." in it, and a
bar drawn with carriage returns hundreds of dead lines.
"""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Sequence
from typing import TextIO

import numpy as np
from tqdm.std import tqdm


def in_notebook() -> bool:
    """Whether a Jupyter kernel is running this (a terminal's IPython is not one)."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None


class Progress:
    """A tqdm bar where it reads best: an output that is replaced, a terminal's line, or lines of a log.

    >>> bar = Progress(total=2500, start=0, unit="step")
    >>> bar.update(loss=0.0123)     # one step more
    >>> bar.close()
    """

    def __init__(self, total: int, *, start: int = 0, unit: str = "step", title: str = "", enabled: bool = True):
        notebook = enabled and in_notebook()
        terminal = sys.stderr.isatty()
        stream = _ReplacedLine() if notebook else sys.stderr if terminal else _LogLines(sys.stderr)
        self._bar = tqdm(
            total=total,
            initial=start,
            desc=title or None,
            unit=unit,
            file=stream,
            disable=not enabled,
            # a log gets a line every half minute; miniters=1 keeps tqdm's monitor thread out of it
            mininterval=0.5 if notebook or terminal else 30.0,
            miniters=1,
            ncols=None if terminal and not notebook else 100,
            bar_format="{l_bar}{bar:20}{r_bar}" if notebook else None,
        )

    def update(self, n: int = 1, **values: float) -> None:
        """``n`` more are done; ``values`` (the loss) stand at the end of the line."""
        self._bar.set_postfix({name: f"{value:.4g}" for name, value in values.items()}, refresh=False)
        self._bar.update(n)

    def close(self) -> None:
        """Show the last state and end the line."""
        self._bar.close()


class _ReplacedLine(io.TextIOBase):
    """A stream whose last line is a notebook's output, replaced in place."""

    def __init__(self):
        self._handle = None
        self._shown = ""

    def write(self, text: str) -> int:
        line = text.strip("\r\n ")
        if line and line != self._shown:
            from IPython.display import display

            self._shown = line
            data = {"text/plain": line}
            if self._handle is None:
                self._handle = display(data, raw=True, display_id=True)
            else:
                self._handle.update(data, raw=True)
        return len(text)


class _LogLines(io.TextIOBase):
    """A stream that ends a line where tqdm would go back to its start."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._shown = ""

    def write(self, text: str) -> int:
        line = text.strip("\r\n ")
        if line and line != self._shown:
            self._shown = line
            self._stream.write(line + "\n")
        return len(text)

    def flush(self) -> None:
        self._stream.flush()


class LivePlot:
    """The loss so far as a small figure in a notebook, redrawn every few seconds; elsewhere nothing.

    >>> plot = LivePlot(total=2500)
    >>> plot.update(trainer.history["loss"])
    >>> plot.close(trainer.history["loss"])      # the last state stays
    """

    def __init__(self, total: int, *, seconds: float = 3.0, title: str = "", enabled: bool = True):
        self._enabled = enabled and in_notebook()
        self._total, self._seconds, self._title = total, seconds, title
        self._handle = None
        self._next = 0.0

    def update(self, losses: Sequence[float], *, force: bool = False) -> None:
        """Redraw if it is time to; ``losses`` has one number a step."""
        if not self._enabled or not losses or (time.monotonic() < self._next and not force):
            return
        try:
            from IPython.display import display

            data = {
                "image/png": loss_figure(losses, self._total, self._title),
                "text/plain": f"loss {losses[-1]:.4g} after {len(losses)} steps",
            }
        except ImportError:  # no matplotlib: the line of progress has to do
            self._enabled = False
            return
        if self._handle is None:
            self._handle = display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)
        self._next = time.monotonic() + self._seconds

    def close(self, losses: Sequence[float]) -> None:
        """Leave the finished curve."""
        self.update(losses, force=True)


def loss_figure(losses: Sequence[float], total: int | None = None, title: str = "") -> bytes:
    """A loss curve as PNG (about 15 kB): every step thin, the running mean of about 50 thick."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    values = np.asarray(losses, dtype=float)
    steps = np.arange(1, len(values) + 1)
    figure = Figure(figsize=(5.2, 2.2), dpi=80, layout="constrained")  # no pyplot: no global figure list
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    stride = max(1, len(values) // 2000)
    axes.plot(steps[::stride], values[::stride], color="0.75", linewidth=0.8)
    window = max(1, min(50, len(values) // 5))
    mean = np.convolve(values, np.full(window, 1 / window), mode="valid")
    axes.plot(steps[window - 1 :], mean, color="#0072b2", linewidth=1.8)
    if (values > 0).all():
        axes.set_yscale("log")
    if total:
        axes.set_xlim(0, total)
    axes.set(xlabel="step", ylabel="loss", title=title)
    axes.grid(alpha=0.3)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
