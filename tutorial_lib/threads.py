"""How many threads torch computes with, for a while: nothing stays set."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch


@contextlib.contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Torch computes with ``count`` threads inside the block.

    With one a result does not depend on the number of cores, nor its cost on what else they do: several threads wait
    for each other, and waiting takes time of the CPU, too.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
