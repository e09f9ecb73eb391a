"""The networks of a result of ``reproduce side-by-side``, to be watched: in half precision beside the result."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Mapping
from typing import Any

from ..errors import DataError
from ..pretrained.publish import rounded
from ..training.checkpoints import Checkpoint, load_checkpoint, save_checkpoint
from .side_by_side_plan import SYSTEMS, Plan, name_of
from .side_by_side_tables import RESULT

NETWORKS = RESULT.with_suffix("")  # the folder of those that come with the library


def write_networks(result: Mapping[str, Any], plan: Plan, runs: pathlib.Path, folder: str | os.PathLike) -> int:
    """``folder/NAME.safetensors`` for each system of a result, of the first training seed; how many were written.

    With the rounded weights that were measured; no captured motion is in them.
    """
    folder, count = pathlib.Path(folder), 0
    for run in plan.runs():
        if run.name in result["runs"] and run.recipe.seed == plan.seeds[0]:
            network = rounded(load_checkpoint(run.path(runs)))
            save_checkpoint(
                folder / f"{name_of(run)}.safetensors",
                system=network.system,
                model=network.model,
                representation=network.representation,
                normalizer=network.normalizer,
                training=network.training,
                provenance=network.provenance,
                sway=network.sway,
                half=True,
            )
            count += 1
    return count


def load_networks(folder: str | os.PathLike | None = None) -> dict[str, Checkpoint]:
    """The networks beside a result by their labels, by default those of the result that comes with the library.

    Raises :class:`DataError` where there is none, ``CheckpointError`` for a damaged file.
    """
    folder = NETWORKS if folder is None else pathlib.Path(folder)
    found = {label: folder / f"{label}.safetensors" for label in SYSTEMS}
    networks = {label: load_checkpoint(path) for label, path in found.items() if path.exists()}
    if not networks:
        raise DataError(f"{folder}: no networks here, expected lstm.safetensors and others as reproduce side-by-side "
                        "writes them beside its result")  # fmt: skip
    return networks
