"""The results that come with the library: the papers' tables, ours beside theirs, with nothing to train."""

from __future__ import annotations

import dataclasses
import importlib
import pathlib
from collections.abc import Sequence
from types import ModuleType

from ..errors import TutorialError
from ..view.tables import ErrorTable
from .results import ALL_PAPERS, ONE_PAPER, RESULTS, report

# Each result's title, the module that has load_result, tables and findings of its paper, and whose these are.
PAPERS = {
    "acrnn": ("acRNN", "acrnn", ONE_PAPER),
    "acrnn-wider": ("acRNN, with wider networks", "acrnn", ONE_PAPER),
    "vae-lstm": ("VAE-LSTM", "vae_lstm", ONE_PAPER),
    "dynamic-future-net": ("Dynamic Future Net", "dynamic_future_net", ONE_PAPER),
    "side-by-side": ("All papers", "side_by_side", ALL_PAPERS),
}
# What of them is shown in short: paper, table, rows (none: all), columns (none: all).
SHORT: tuple[tuple[str, str, Sequence[str], Sequence[str]], ...] = (
    ("acrnn", "table 1", ("LSTM-3LR", "acLSTM-3LR", "sch. smp."), ("80 ms", "320 ms", "640 ms")),
    ("vae-lstm", "table 2", ("ERD", "LSTM-3LR", "VAE-LSTM"), ("frame 70", "frame 120", "frame 210")),
    ("dynamic-future-net", "ablations", (), ("apart 32", "apart 128", "ratio", "fail %", "kinds of change")),
    (
        "side-by-side", "side by side", (),
        ("320 ms, cm", "moves, %", "stops, %", "leaves, %", "feet, cm", "bones, %", "futures, cm", "ms a frame"),
    ),
)  # fmt: skip


def shipped() -> list[str]:
    """The results that come with the library."""
    return [paper for paper in PAPERS if _file(paper).exists()]


def full(paper: str) -> list[str]:
    """All tables and findings of a paper's result, as ``reproduce`` tells them.

    Raises :class:`TutorialError` for a paper without a result, naming those that have one.
    """
    module = _module(paper)
    result = module.load_result(_file(paper))
    return report(module.tables(result), module.findings(result), PAPERS[paper][2])


def short() -> list[ErrorTable]:
    """A few rows and columns of each paper's main table, with the paper's own numbers beneath ours."""
    tables = []
    for paper, name, rows, columns in SHORT:
        if paper in shipped():
            module = _module(paper)
            table = module.tables(module.load_result(_file(paper)))[name].only(rows, columns)
            caption = f"{PAPERS[paper][0]}, {table.caption[:1].lower()}{table.caption[1:]}"
            tables.append(dataclasses.replace(table, caption=caption))
    return tables


def _module(paper: str) -> ModuleType:
    if paper not in shipped():
        raise TutorialError(f"no result of {paper!r} comes with the library; there are {', '.join(shipped())}")
    return importlib.import_module(f".{PAPERS[paper][1]}", __package__)


def _file(paper: str) -> pathlib.Path:
    return RESULTS / f"{paper.replace('-', '_')}.json"
