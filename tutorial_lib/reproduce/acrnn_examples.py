"""Motions that belong to a result of ``reproduce acrnn``, to be looked at: for the explorer and for figure 7.

They were made by the trained networks alone, some seconds after their seeds, and lie beside the result as
half-precision features in one safetensors file, so that a lesson can show them without the networks.
"""

from __future__ import annotations

import functools
import json
import os
import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from ..atomic import atomic_write
from ..errors import DataError
from ..evaluate import roll_out
from ..metrics import divergence_time
from ..motion.clip import Motion
from ..representations import representation_from_config
from ..threads import torch_threads
from ..training.checkpoints import load_checkpoint
from ..view.explorer import Cell, Explorer, explorer
from ..view.strip import pose_strip
from .acrnn_plan import DANCE, SYSTEMS, Plan, Protocol
from .acrnn_tables import RESULT, motion_change, pairs, true_change
from .failures import DIVERGENCE
from .grid import Run, clips_for

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = RESULT.with_name("acrnn.safetensors")
WATCHED = (10.0, 18.0)  # seconds after the seed between which a pair's motion is shown
BEFORE, AFTER = 2.0, 3.0  # seconds about a failure


def examples(
    result: Mapping[str, Any], plan: Plan, folder: pathlib.Path
) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
    """Motions made again from the checkpoints in ``folder``, features (T, D), and their representation's configuration.

    None where there are none, as without the Indian dance.

    "pair u v": the first sample of each pair of u and v, from 10 to 18 s after its seed. "failure SYSTEM": for
    each system on the Indian dance the sample that failed last, about when it did, cut where limbs are farther
    away than the rule of divergence allows.
    """
    protocol, found, made = plan.protocol, {}, None
    runs = {run.name: run for run in plan.runs() if run.name in result["runs"]}
    samples = functools.cache(lambda name: _made(runs[name], folder, protocol))  # some are a pair and a failure
    for (u, v), name in pairs(result).items():
        made = samples(name)
        first, last = (round(seconds * made.fps) for seconds in WATCHED)
        first = min(first, protocol.frames // 2)  # of a quick trial there is less
        found[f"pair {u} {v}"] = made.made[0, first:last]
    for run in runs.values():
        style, system = (plan.first(run) or "/").split("/")
        latest = result["runs"][run.name]["failures"]["latest"]
        if style != DANCE or system not in SYSTEMS or latest is None:
            continue
        made = samples(run.name)
        at = round(latest["seconds"] * made.fps)
        part = made.made[latest["sample"], max(0, at - round(BEFORE * made.fps)) : at + round(AFTER * made.fps)]
        reach = result["splits"][f"{style} seed {run.recipe.seed}"]["truth"]["reach"]
        end = divergence_time(made.representation.decode_positions(part), reach, made.fps, **DIVERGENCE)
        part = part[: max(2, round(end * made.fps))] if np.isfinite(end) else part
        if np.isfinite(part).all():
            found[f"failure {SYSTEMS[system].title}: {latest['rule']}, {latest['seconds']:.1f} s"] = part
    return None if made is None else (found, made.representation.config())


def _made(run: Run, folder: pathlib.Path, protocol: Protocol):
    with torch_threads(1):
        return roll_out(load_checkpoint(run.path(folder)), clips_for(run.recipe)[0][1], count=protocol.seeds,
                        frames=protocol.frames, seed_frames=protocol.seed_frames)  # fmt: skip


def write_examples(
    found: Mapping[str, np.ndarray], representation: Mapping[str, Any], path: str | os.PathLike
) -> pathlib.Path:
    """Write features in half precision, with the configuration of their representation; whole or not at all."""
    path = pathlib.Path(path)
    tensors = {name: np.ascontiguousarray(values, dtype=np.float16) for name, values in found.items()}
    with atomic_write(path) as temporary:
        save_file(tensors, temporary, {"representation": json.dumps(representation)})
    return path


def load_examples(path: str | os.PathLike | None = None) -> dict[str, Motion]:
    """The motions beside a result, by default those of the result that comes with the library.

    Raises :class:`DataError` for a file that is missing or damaged.
    """
    path = EXAMPLES if path is None else pathlib.Path(path)
    try:
        with safe_open(path, "numpy") as file:
            representation = representation_from_config(json.loads(file.metadata()["representation"]))
            return {
                name: representation.decode(file.get_tensor(name).astype(np.float32), name=name).settled()
                for name in sorted(file.keys())
            }
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: no motions beside a result ({' '.join(str(error).split())[:120]})") from None


def explore(result: Mapping[str, Any], motions: Mapping[str, Motion] | None = None) -> Explorer:
    """The explorer of u and v over the trained pairs of a result; see :func:`tutorial_lib.view.explorer.explorer`."""
    motions = load_examples() if motions is None else motions
    times = result["protocol"]["times_ms"]
    cells = {}
    for (u, v), name in pairs(result).items():
        run = result["runs"][name]
        failures = run["failures"]
        cells[1 if v == 0 else u, v] = Cell(
            motion_change(result, name),
            motions.get(f"pair {u} {v}"),
            {
                "error at 400 ms": run["error"][times.index(400)],
                "failed": f"{failures['count']} of {failures['samples']}",
                "error at 80 ms": run["error"][times.index(80)],
                "training loss": run["loss"],
            },
        )
    return explorer(cells, truth=true_change(result, DANCE), fps=result["protocol"]["fps"], start=(5, 5), smooth=1)


def failure_strip(motions: Mapping[str, Motion] | None = None) -> Figure | None:
    """Figure 7: poses about the latest failure of each system, one row each; None if none failed."""
    motions = load_examples() if motions is None else motions
    rows = {name.removeprefix("failure "): m for name, m in motions.items() if name.startswith("failure ")}
    return pose_strip(list(rows.values()), labels=list(rows), frames=9, row_height=1.7) if rows else None
