"""Checkpoints: weights, what is needed to use them, and where they came from, in one safetensors file.

The file holds tensors and a header of JSON texts, and nothing that opening it could run (no pickle):

===================  =========================================================================
header               content
===================  =========================================================================
``format_version``   "1"; another number is refused
``system``           name in :data:`tutorial_lib.training.systems.SYSTEMS`
``model``            the network's configuration (sizes)
``representation``   name, skeleton and frame rate: features <-> motion
``training``         steps done, steps asked for, learning rate, seed, ..., ``status``
``provenance``       data set, clips, command, library versions, date, metrics
``sway``             where the network follows control: the gait of its clips (:mod:`tutorial_lib.control.sway`)
``state``            only while a run is unfinished: optimiser, generators, sampler, loss history
===================  =========================================================================

Tensors are ``model.*`` (the network's own parameter names), ``normalizer.mean`` and ``normalizer.std``,
``seed_frames`` (features to start from with no data at hand) and, while unfinished, ``state.*``.
A run writes one file from beginning to end: as long as it can be resumed the file carries the training
state, about three times the weights' size; the last save leaves it out. Weights and state lie in the same
file so that a kill between two files cannot part them. Each save replaces the file in one move.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import math
import os
import pathlib
import platform
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from .. import __version__
from ..atomic import atomic_write
from ..control.sway import Sway
from ..data.windows import Normalizer
from ..errors import CheckpointError, TutorialError
from ..representations import Representation, representation_from_config
from .systems import empty_model

FORMAT_VERSION = "1"


@dataclasses.dataclass
class Checkpoint:
    """An opened checkpoint: a network in evaluation mode and all that is needed to use it."""

    system: str
    model: nn.Module
    representation: Representation | None  # None: trained on plain features, nothing to decode
    normalizer: Normalizer | None  # None: features go in as they are
    training: dict[str, Any]
    provenance: dict[str, Any]
    seed_frames: Tensor | None = None  # (K, T, D) features, not normalised
    path: pathlib.Path | None = None
    sway: Sway | None = None  # how the people sway from whom the network learnt to follow control

    @property
    def config(self) -> dict[str, Any]:
        """The network's sizes."""
        return dataclasses.asdict(self.model.config)

    @property
    def n_parameters(self) -> int:
        """How many numbers the network has learnt."""
        return sum(p.numel() for p in self.model.parameters())


def provenance(
    data: str | None = None, clips: Sequence[str] = (), command: str | None = None, **more: Any
) -> dict[str, Any]:
    """Where weights come from: data set, clips, command, versions, date and whatever else is given."""
    return {
        "data": data,
        "clips": list(clips),
        "command": command,
        "versions": {
            "tutorial_lib": __version__,
            "torch": torch.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "metrics": {},
        **more,
    }


def save_checkpoint(
    path: str | os.PathLike,
    *,
    system: str,
    model: nn.Module,
    representation: Representation | None = None,
    normalizer: Normalizer | None = None,
    training: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
    seed_frames: Tensor | np.ndarray | None = None,
    sway: Sway | None = None,
    state: Mapping[str, Any] | None = None,
    half: bool = False,
) -> None:
    """Write a checkpoint, whole or not at all.

    ``model.config`` must be the dataclass that the network was built from. ``seed_frames`` are (K, T, D)
    or (T, D) features in the representation, not normalised. ``state`` is a nested dict of tensors, arrays
    and plain values to resume from. ``half`` stores the weights as float16 (they load as float32 again),
    for files that are passed on; buffers, the normaliser and the seed stay as they are.
    Raises ``CheckpointError`` where the file cannot be written whole (a full disk), ``OSError`` where not begun.
    """
    weights = dict(model.named_parameters())
    tensors = {
        f"model.{name}": value.half() if half and name in weights else value
        for name, value in model.state_dict().items()
    }
    if normalizer is not None:
        tensors |= {f"normalizer.{name}": value for name, value in normalizer.to_dict().items()}
    if seed_frames is not None:
        seed_frames = torch.as_tensor(seed_frames, dtype=torch.float32)
        tensors["seed_frames"] = seed_frames.reshape(-1, *seed_frames.shape[-2:])
    header = {
        "system": system,
        "model": dataclasses.asdict(model.config),
        "representation": None if representation is None else representation.config(),
        "training": dict(training or {}),
        "provenance": dict(provenance or {}),
    }
    if sway is not None:
        header["sway"] = sway.to_dict()
    if state is not None:
        header["state"] = _pack(state, "state", tensors)
    metadata = {name: json.dumps(value) for name, value in header.items()}
    metadata["format_version"] = FORMAT_VERSION
    tensors = {name: value.detach().to("cpu").contiguous() for name, value in tensors.items()}
    with atomic_write(path) as temporary:
        try:
            save_file(tensors, temporary, metadata)
        except SafetensorError as error:
            raise CheckpointError(f"{path}: cannot be written ({_one_line(error)})") from None


def load_checkpoint(path: str | os.PathLike, *, device: str | torch.device = "cpu") -> Checkpoint:
    """Open a checkpoint, finished or not, and build its network, ready to use.

    Raises :class:`CheckpointError`, in one line, for a file that is missing, cannot be opened, is not safetensors
    or is cut off, has another format version, a damaged header, an unknown system, missing or superfluous weights,
    weights of other shapes or kinds, or numbers that are not finite.
    """
    header, tensors = _read(path, with_state=False)
    try:
        system, config = header["system"], header["model"]
        training, origin = header["training"], header["provenance"]
        model = empty_model(system, config)
        representation = header["representation"]
        if representation is not None:
            representation = representation_from_config(representation)
        sway = Sway.from_dict(header["sway"]) if "sway" in header else None
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from None
    except KeyError as error:
        raise CheckpointError(f"{path}: the header lacks {error}") from None
    except (TutorialError, TypeError, ValueError, AttributeError, IndexError, RuntimeError) as error:
        # RuntimeError: sizes past counting
        raise CheckpointError(f"{path}: the header is damaged ({_one_line(error)})") from None

    weights = {n.removeprefix("model."): t for n, t in tensors.items() if n.startswith("model.")}
    _check_weights(path, model, weights)
    model.load_state_dict(
        {name: value.float() if value.is_floating_point() else value for name, value in weights.items()}, assign=True
    )
    model.requires_grad_(False)  # ready to use; a trainer resumes from its own network
    normalizer = None
    parts = {n.removeprefix("normalizer."): t for n, t in tensors.items() if n.startswith("normalizer.")}
    if parts:
        try:
            normalizer = Normalizer.from_dict(parts)
        except TutorialError as error:
            raise CheckpointError(f"{path}: {error}") from None
    seed_frames = tensors.get("seed_frames")
    if seed_frames is not None and seed_frames.ndim != 3:
        raise CheckpointError(f"{path}: seed_frames must be (motions, frames, numbers), not {tuple(seed_frames.shape)}")
    if seed_frames is not None:
        _check_numbers(path, "seed_frames", seed_frames)
    widths = {
        "the network": getattr(model.config, "dim", None),
        "the representation": None if representation is None else representation.dim,
        "the normaliser": None if normalizer is None else normalizer.dim,
        "the seed": None if seed_frames is None else seed_frames.shape[-1],
    }
    known = {what: width for what, width in widths.items() if width is not None}
    if len(set(known.values())) > 1:
        told = ", ".join(f"{what} {width}" for what, width in known.items())
        raise CheckpointError(f"{path}: the numbers a frame do not agree: {told}")
    return Checkpoint(
        system, model.to(device).eval(), representation, normalizer, training, origin, seed_frames, pathlib.Path(path),
        sway,
    )  # fmt: skip


def read_header(path: str | os.PathLike) -> dict[str, Any]:
    """The header of a checkpoint (see the top of this module) without its tensors.

    ``header["resumable"]`` says whether the file carries a training state. Raises :class:`CheckpointError` for a file
    that is missing, cannot be opened or is no checkpoint, or whose header is damaged.
    """
    header, _ = _read(path, with_state=False, with_tensors=False)
    return header


def load_state(path: str | os.PathLike) -> tuple[dict[str, Any], dict[str, Tensor], dict[str, Any]]:
    """Header, weights and training state of an unfinished run, for :meth:`Trainer.resume`."""
    header, tensors = _read(path, with_state=True)
    if not header["resumable"]:
        raise CheckpointError(f"{path}: holds weights only and no training state to resume from")
    try:
        state = _unpack(header["state"], tensors)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise CheckpointError(f"{path}: the training state is damaged ({_one_line(error)})") from None
    weights = {n.removeprefix("model."): t for n, t in tensors.items() if n.startswith("model.")}
    return header, weights, state


def _read(
    path: str | os.PathLike, *, with_state: bool, with_tensors: bool = True
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    if not os.path.exists(path):
        raise CheckpointError(f"{path}: there is no such file")
    if not os.path.isfile(path):
        raise CheckpointError(f"{path}: expected a checkpoint file, this is a folder")
    try:
        with open(path, "rb"):  # what forbids it is told here; safetensors calls every such file absent
            pass
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be opened ({error.strerror})") from None
    tensors = {}
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            if with_tensors:
                for name in file.keys():  # noqa: SIM118 (not a dict)
                    if with_state or not name.startswith("state."):
                        # a copy: the tensor lies in the mapped file, which Windows then lets nobody replace
                        tensors[name] = file.get_tensor(name).clone()
    except SafetensorError as error:
        raise CheckpointError(f"{path}: not a checkpoint, or one that is cut off ({_one_line(error)})") from None
    version = metadata.get("format_version")
    if version is None or "system" not in metadata:
        raise CheckpointError(f"{path}: a safetensors file, but not a checkpoint of this library")
    if version != FORMAT_VERSION:
        raise CheckpointError(f"{path}: has format version {version!r}, this library reads version {FORMAT_VERSION}")
    header: dict[str, Any] = {"resumable": "state" in metadata}
    for name, text in metadata.items():
        if name == "format_version" or (name == "state" and not with_state):
            continue
        try:
            header[name] = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise CheckpointError(f"{path}: the header's {name} is no JSON ({_one_line(error)})") from None
    _check_header(path, header)
    return header, tensors


def _check_header(path: str | os.PathLike, header: Mapping[str, Any]) -> None:
    """The kinds of what everybody reads in a header; what a network is built from is checked as it is built."""
    for name in ("model", "training", "provenance"):
        if name not in header:
            raise CheckpointError(f"{path}: the header lacks {name!r}")
        if not isinstance(header[name], dict):
            raise CheckpointError(f"{path}: the header is damaged ({name} is not an object)")
    origin = header["provenance"]
    for name in ("clips", "test_clips", "data"):  # each may be missing or null
        told = origin.get(name)
        if told is None or (name == "data" and isinstance(told, str)):
            continue
        if not isinstance(told, list) or not all(isinstance(text, str) for text in told):
            kind = "neither a text nor a list of texts" if name == "data" else "not a list of texts"
            raise CheckpointError(f"{path}: the header is damaged (provenance's {name} is {kind})")


def _check_weights(path: str | os.PathLike, model: nn.Module, weights: Mapping[str, Tensor]) -> None:
    own = model.state_dict()
    expected = {name: tuple(value.shape) for name, value in own.items()}
    if missing := sorted(expected.keys() - weights.keys()):
        raise CheckpointError(
            f"{path}: the weights lack {missing[0]} of shape {expected[missing[0]]}"
            + (f" and {len(missing) - 1} more" if len(missing) > 1 else "")
        )
    if extra := sorted(weights.keys() - expected.keys()):
        raise CheckpointError(f"{path}: has the weights {extra[0]}, which its network does not have")
    for name, shape in expected.items():
        if tuple(weights[name].shape) != shape:
            raise CheckpointError(
                f"{path}: the weights {name} have shape {tuple(weights[name].shape)}, expected {shape}"
            )
        _check_numbers(path, f"the weights {name}", weights[name], own[name].is_floating_point())


def _check_numbers(path: str | os.PathLike, what: str, values: Tensor, floating: bool = True) -> None:
    """Finite, and floating-point numbers (of any precision) or whole ones as expected."""
    if values.is_floating_point() != floating:
        kind = "floating-point" if floating else "whole"
        there = str(values.dtype).removeprefix("torch.")
        raise CheckpointError(f"{path}: {what} are of type {there}, expected {kind} numbers")
    if not torch.isfinite(values).all():
        raise CheckpointError(f"{path}: {what} are not all finite numbers")


def _pack(tree: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    """A nested value as JSON; its tensors move to ``tensors`` under their own names."""
    if isinstance(tree, Tensor):
        tensors[name] = tree
        return {"tensor": name}
    if isinstance(tree, np.ndarray):
        return {"array": tree.tolist(), "dtype": str(tree.dtype)}
    if isinstance(tree, Mapping):  # as pairs, for JSON would turn the optimiser's whole-number keys to text
        return {"dict": [[key, _pack(value, f"{name}.{key}", tensors)] for key, value in tree.items()]}
    if isinstance(tree, (list, tuple)):
        return {"list": [_pack(value, f"{name}.{i}", tensors) for i, value in enumerate(tree)]}
    if isinstance(tree, np.generic):
        tree = tree.item()
    if isinstance(tree, float) and not math.isfinite(tree):
        return {"float": repr(tree)}
    return {"value": tree}


def _unpack(tree: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> Any:
    if "tensor" in tree:
        return tensors[tree["tensor"]]
    if "array" in tree:
        return np.array(tree["array"], dtype=tree["dtype"])
    if "dict" in tree:
        return {key: _unpack(value, tensors) for key, value in tree["dict"]}
    if "list" in tree:
        return [_unpack(value, tensors) for value in tree["list"]]
    if "float" in tree:
        return float(tree["float"])
    return tree["value"]


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
