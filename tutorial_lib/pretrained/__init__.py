"""Trained weights that come with the library: what there is, and loading one by its name.

Each is a checkpoint (:mod:`tutorial_lib.training.checkpoints`) in half precision, ``NAME.safetensors`` in this folder,
with its provenance; and with seeds that the network itself made or, where it follows control, with the sway of a gait,
so that it generates with no data at hand.
:mod:`tutorial_lib.pretrained.publish` makes them.
"""

from __future__ import annotations

import dataclasses
import difflib
import os
import pathlib
from typing import Any

import torch

from ..errors import CheckpointError
from ..training.checkpoints import Checkpoint, load_checkpoint, read_header

FOLDER = pathlib.Path(__file__).resolve().parent
SUFFIX = ".safetensors"


@dataclasses.dataclass(frozen=True)
class Pretrained:
    """What the header of one file of weights says.

    data: names of the data sets. options: the system's own, such as u and v. metrics: what
    :func:`tutorial_lib.evaluate.evaluate` measured of these weights on clips that they were not trained on.
    """

    name: str
    system: str
    data: tuple[str, ...]
    clips: int
    steps: int | None
    hidden: int | None
    layers: int | None
    megabytes: float
    provenance: dict[str, Any] = dataclasses.field(repr=False)

    @property
    def metrics(self) -> dict[str, Any]:
        return self.provenance.get("metrics") or {}

    @property
    def summary(self) -> str:
        """One line: the network, what it learnt from and for how long, and whether its motion goes on."""
        size = f" {self.layers}x{self.hidden}" if self.hidden and self.layers else ""
        steps = f", {self.steps:,} steps" if self.steps else ""
        text = f"{self.system}{size} on {' + '.join(self.data) or 'unknown data'}, {self.clips} clips{steps}"
        freezing, frames = self.metrics.get("freezing"), self.metrics.get("frames")
        if freezing and frames:
            text += f"; {freezing['count']} of {self.metrics['seeds']} freeze within {frames:,} frames"
        if walks := self.metrics.get("walks"):
            away = sum(row["deviation"]["mean"] for row in walks) / len(walks)
            paces = " and ".join(f"{pace:g}" for pace in sorted({row["pace"] for row in walks}))
            text += f"; walks a path at {paces} m/s, {100 * away:.0f} cm from it on average"
        return text


class Listing(tuple):
    """The rows of :func:`list`, printed one below the other."""

    def __str__(self) -> str:
        width = max((len(row.name) for row in self), default=0)
        lines = [f"{row.name:<{width}}  {row.megabytes:5.2f} MB  {row.summary}" for row in self]
        return "\n".join(lines) or f"no pretrained weights in {FOLDER}"

    __repr__ = __str__


def list() -> Listing:
    """All pretrained weights by name, from their files' headers alone; empty where none came with the library.

    Raises ``CheckpointError``, which names the file, for one that is damaged.
    """
    return Listing(_describe(name) for name in _names())


def path(name: str) -> pathlib.Path:
    """The file of the weights called ``name``; ``CheckpointError`` with the nearest names for an unknown one."""
    names = _names()
    if name in names:
        return FOLDER / f"{name}{SUFFIX}"
    if not names:
        raise CheckpointError(f"no pretrained weights {name!r}: none came with this copy of the library")
    close = difflib.get_close_matches(str(name).lower().replace("_", "-"), names, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(close)}?" if close else f"there are {', '.join(names)}"
    raise CheckpointError(f"no pretrained weights {name!r}; {hint}")


def load(name: str, device: str | torch.device = "cpu") -> Checkpoint:
    """The weights called ``name``, in single precision and ready to use.

    Raises ``CheckpointError`` for an unknown name, with the nearest ones, and for a damaged file.
    """
    return load_checkpoint(path(name), device=device)


def _names() -> tuple[str, ...]:
    return tuple(sorted(file.stem for file in FOLDER.glob(f"*{SUFFIX}") if not file.name.startswith(".")))


def _describe(name: str) -> Pretrained:
    file = path(name)
    header = read_header(file)
    try:
        training, origin, sizes = header["training"], header["provenance"], header["model"]
        return Pretrained(
            name,
            header["system"],
            data_names(origin.get("data")),
            len(origin.get("clips") or ()),
            training.get("steps_done"),
            sizes.get("hidden"),
            sizes.get("layers"),
            os.path.getsize(file) / 1e6,
            origin,
        )
    except (KeyError, AttributeError, TypeError) as error:
        raise CheckpointError(f"{file}: the header is damaged ({error!r})") from None


def data_names(data: str | tuple[str, ...] | None) -> tuple[str, ...]:
    """What a checkpoint's provenance calls its data, one set or several, as a tuple."""
    return (data,) if isinstance(data, str) else tuple(data or ())
