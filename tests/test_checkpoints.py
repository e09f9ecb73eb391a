"""Checkpoints: what goes in comes out, and whatever else is opened is refused in one line."""

from __future__ import annotations

import json
import os
import pickle

import numpy as np
import pytest
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from tutorial_lib import pretrained
from tutorial_lib.data.windows import Normalizer
from tutorial_lib.errors import CheckpointError
from tutorial_lib.pretrained.publish import rounded
from tutorial_lib.representations import make_representation
from tutorial_lib.training.checkpoints import (
    load_checkpoint,
    load_state,
    provenance,
    read_header,
    save_checkpoint,
)
from tutorial_lib.training.systems import make_system


@pytest.fixture
def parts(small_skeleton):
    representation = make_representation("positions", small_skeleton, 30.0)
    dim = representation.dim
    rng = np.random.default_rng(0)
    return {
        "system": "lstm",
        "model": make_system("lstm", dim, hidden=8, layers=2, seed=5).model,
        "representation": representation,
        "normalizer": Normalizer(rng.normal(size=dim), rng.uniform(0.5, 2, dim)),
        "training": {"steps": 20, "steps_done": 20, "status": "finished", "learning_rate": 0.1 + 0.2},
        "provenance": provenance("cmu/none", ["a", "b"], "python -m tutorial_lib train", seed=3),
        "seed_frames": rng.normal(size=(2, 12, dim)).astype(np.float32),
    }


def metadata(path):
    with safe_open(path, framework="pt") as file:
        return dict(file.metadata())


def rewrite(path, *, header=None, tensors=None):
    """The same file with some entries changed; ``None`` drops one."""
    old_header, old_tensors = metadata(path), load_file(path)
    new_header = {k: v for k, v in {**old_header, **(header or {})}.items() if v is not None}
    new_tensors = {k: v for k, v in {**old_tensors, **(tensors or {})}.items() if v is not None}
    save_file(new_tensors, path, new_header)


def test_all_comes_back(tmp_path, parts):
    path = tmp_path / "a.safetensors"
    save_checkpoint(path, **parts)
    found = load_checkpoint(path)
    assert found.system == "lstm" and found.path == path and found.config == {"dim": 21, "hidden": 8, "layers": 2}
    assert not found.model.training
    for name, value in parts["model"].state_dict().items():
        assert torch.equal(found.model.state_dict()[name], value)
    assert found.representation == parts["representation"] and found.normalizer == parts["normalizer"]
    assert found.training == parts["training"] and found.provenance == parts["provenance"]
    assert np.array_equal(found.seed_frames, parts["seed_frames"])
    x = torch.randn(2, 5, 21, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        torch.testing.assert_close(found.model(x)[0], parts["model"](x)[0], rtol=0, atol=0)


def test_provenance_says_where_weights_come_from():
    origin = provenance("cmu/martial", ["x"], "train lstm", test_clips=["y"])
    assert origin["data"] == "cmu/martial" and origin["clips"] == ["x"] and origin["test_clips"] == ["y"]
    assert origin["command"] == "train lstm" and origin["date"].startswith("20")
    assert origin["versions"]["torch"] == torch.__version__ and origin["versions"]["tutorial_lib"]
    json.dumps(origin)


def test_file_is_a_documented_safetensors_file(tmp_path, parts):
    """Read with safetensors alone: what another program would find."""
    path = tmp_path / "a.safetensors"
    save_checkpoint(path, **parts)
    header, tensors = metadata(path), load_file(path)
    assert header["format_version"] == "1" and json.loads(header["system"]) == "lstm"
    assert json.loads(header["model"]) == {"dim": 21, "hidden": 8, "layers": 2}
    assert json.loads(header["representation"])["skeleton"]["names"][0] == "root"
    assert tensors["model.lstm.weight_ih_l0"].shape == (32, 21) and tensors["normalizer.mean"].shape == (21,)
    assert "state" not in header and not any(name.startswith("state.") for name in tensors)


def test_half_precision_is_half_the_size_and_near(tmp_path, parts):
    parts["model"] = make_system("lstm", 21, hidden=64, seed=5).model
    full, half = tmp_path / "full.safetensors", tmp_path / "half.safetensors"
    save_checkpoint(full, **parts)
    save_checkpoint(half, **parts, half=True)
    assert half.stat().st_size < 0.55 * full.stat().st_size
    found = load_checkpoint(half)
    for name, value in parts["model"].state_dict().items():
        got = found.model.state_dict()[name]
        assert got.dtype == torch.float32
        torch.testing.assert_close(got, value, rtol=1e-3, atol=1e-4)
    assert found.normalizer == parts["normalizer"] and np.array_equal(found.seed_frames, parts["seed_frames"])


def test_half_precision_leaves_buffers_whole(tmp_path):
    """What scales a network's numbers is no weight; so a file loads as what ``publish`` has measured."""
    before = pretrained.load("dfn-samples")
    scales = [buffer for buffer in before.model.buffers() if buffer.is_floating_point()]
    for scale in scales:
        scale.mul_(1.0001)  # no longer what half precision has
    save_checkpoint(tmp_path / "a.safetensors", system=before.system, model=before.model,
                    representation=before.representation, half=True)  # fmt: skip
    after, passed_on = load_checkpoint(tmp_path / "a.safetensors"), rounded(before)
    assert scales
    for (name, value), there in zip(
        after.model.state_dict().items(), passed_on.model.state_dict().values(), strict=True
    ):
        assert value.dtype == there.dtype and torch.equal(value, there), name


def test_plain_features_need_no_representation(tmp_path, parts):
    save_checkpoint(tmp_path / "a", system="lstm", model=parts["model"])
    found = load_checkpoint(tmp_path / "a")
    assert found.representation is None and found.normalizer is None and found.seed_frames is None


def test_state_of_any_shape_comes_back(tmp_path, parts):
    state = {
        "tensor": torch.arange(3, dtype=torch.uint8), "array": np.arange(4, dtype=np.uint32), "nothing": None,
        "nested": {0: [1, 2.5, "x"], 7: {"deep": torch.ones(2)}}, "big": 2**120 + 1, "inf": float("inf"),
        "yes": True, "number": np.float64(0.1),
    }  # fmt: skip
    save_checkpoint(tmp_path / "a", **parts, state=state)
    header, weights, found = load_state(tmp_path / "a")
    assert header["resumable"] and weights.keys() == parts["model"].state_dict().keys()
    assert torch.equal(found["tensor"], state["tensor"]) and found["tensor"].dtype == torch.uint8
    assert np.array_equal(found["array"], state["array"]) and found["array"].dtype == np.uint32
    assert found["nested"][0] == [1, 2.5, "x"] and torch.equal(found["nested"][7]["deep"], torch.ones(2))
    assert found["big"] == 2**120 + 1 and found["inf"] == float("inf") and found["nothing"] is None
    assert found["yes"] is True and found["number"] == 0.1
    assert load_checkpoint(tmp_path / "a").system == "lstm"  # an unfinished run can be looked at too


def test_a_write_that_fails_leaves_the_old_file(tmp_path, parts, monkeypatch):
    path = tmp_path / "a.safetensors"
    save_checkpoint(path, **parts)
    before = path.read_bytes()

    def fails(tensors, target, header):
        with open(target, "wb") as file:
            file.write(b"half of it")
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr("tutorial_lib.training.checkpoints.save_file", fails)
    with pytest.raises(OSError, match="No space left"):
        save_checkpoint(path, **parts)
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["a.safetensors"]

    def says_so_itself(tensors, target, header):
        raise SafetensorError("Error while serializing: I/O error: No space left on device (os error 28)")

    monkeypatch.setattr("tutorial_lib.training.checkpoints.save_file", says_so_itself)
    with pytest.raises(CheckpointError, match="a.safetensors: cannot be written .*No space left"):
        save_checkpoint(path, **parts)
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["a.safetensors"]


def test_weights_do_not_hang_on_the_file(tmp_path, parts):
    """A file that stays mapped cannot be replaced on Windows, and takes the weights with it when overwritten."""
    path = tmp_path / "a.safetensors"
    save_checkpoint(path, **parts)
    checkpoint = load_checkpoint(path)
    before = {name: value.clone() for name, value in checkpoint.model.state_dict().items()}
    path.write_bytes(bytes(path.stat().st_size))
    assert all(torch.equal(value, before[name]) for name, value in checkpoint.model.state_dict().items())
    assert torch.equal(checkpoint.normalizer.mean, parts["normalizer"].mean)


# --- what is no checkpoint ------------------------------------------------------------------------


def refused(path, message):
    for opener in (load_checkpoint, read_header):
        try:
            opener(path)
        except CheckpointError as error:
            told = str(error)
            assert str(path) in told and "\n" not in told
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(path)


def test_files_that_are_no_checkpoints(tmp_path, parts):
    refused(tmp_path / "absent", "no such file")
    refused(tmp_path, "this is a folder")
    path = tmp_path / "x.safetensors"
    for content in (
        b"",
        b"HIERARCHY\nROOT Hips\n",
        b"\xff" * 1000,
        b"\x00" * 8,
        pickle.dumps({"a": 1}),
        (1 << 40).to_bytes(8, "little") + b"{}",
    ):
        path.write_bytes(content)
        refused(path, "not a checkpoint, or one that is cut off")
    save_file({"model.x": torch.ones(1)}, path)
    refused(path, "not a checkpoint of this library")
    save_file({"model.x": torch.ones(1)}, path, {"format": "pt"})
    refused(path, "not a checkpoint of this library")


def test_a_file_that_may_not_be_read_is_told_as_such(tmp_path, parts, monkeypatch):
    path = tmp_path / "x.safetensors"
    save_checkpoint(path, **parts)

    def refuses(file, *_, **__):  # also as root, whom no permission stops
        raise PermissionError(13, "Permission denied", str(file))

    monkeypatch.setattr("builtins.open", refuses)
    refused(path, f"^{path}: cannot be opened .Permission denied.$")


def test_a_header_may_leave_out_where_it_comes_from(tmp_path, parts):
    path = tmp_path / "x.safetensors"
    for origin in ({}, {"clips": None, "data": None}, {"clips": [], "data": ["cmu/salsa", "cmu/indian"]}):
        save_checkpoint(path, **{**parts, "provenance": origin})
        assert load_checkpoint(path).provenance == origin == read_header(path)["provenance"]


def test_nothing_in_a_pickle_is_run(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "run"),)

    path = tmp_path / "x.safetensors"
    torch.save({"weights": Bomb()}, path)
    refused(path, "not a checkpoint")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("keep", [0.05, 0.5, 0.999])
def test_truncated(tmp_path, parts, keep):
    path = tmp_path / "x.safetensors"
    save_checkpoint(path, **parts)
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    refused(path, "cut off")


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"format_version": "2"}, "format version '2', this library reads version 1"),
        ({"system": '"lsmt"'}, "unknown system 'lsmt'; did you mean lstm"),
        ({"system": "7"}, "unknown system 7"),
        ({"system": "not json"}, "header's system is no JSON"),
        ({"model": None}, "lacks 'model'"),
        ({"training": None}, "lacks 'training'"),
        ({"model": '{"dim": 21, "hidden": 8, "layers": 2, "width": 1}'}, "header is damaged.*width"),
        ({"model": '{"dim": 21, "hidden": "8", "layers": 2}'}, "hidden must be a whole number"),
        ({"model": "[]"}, "header is damaged .model is not an object"),
        ({"training": "[1]"}, "header is damaged .training is not an object"),
        ({"training": "null"}, "header is damaged .training is not an object"),
        ({"provenance": None}, "lacks 'provenance'"),
        ({"provenance": "null"}, "header is damaged .provenance is not an object"),
        ({"provenance": '{"clips": 5}'}, "header is damaged .provenance's clips is not a list of texts"),
        ({"provenance": '{"clips": "ab"}'}, "header is damaged .provenance's clips is not a list of texts"),
        ({"provenance": '{"clips": ["a", 5]}'}, "header is damaged .provenance's clips is not a list of texts"),
        ({"provenance": '{"test_clips": [null]}'}, "header is damaged .provenance's test_clips is not a list of texts"),
        ({"provenance": '{"data": 5}'}, "header is damaged .provenance's data is neither a text nor a list of texts"),
        ({"provenance": '{"data": [5]}'}, "header is damaged .provenance's data is neither a text nor a list of texts"),
        ({"model": "[" * 100_000}, "header's model is no JSON"),
        ({"model": '{"dim": 21, "hidden": 100000000000, "layers": 2}'}, "header is damaged"),
        ({"representation": '{"name": "positions"}'}, "header is damaged.*fps"),
        ({"representation": '{"name": "cube", "fps": 30, "skeleton": {}}'}, "header is damaged"),
        ({"model": '{"dim": 21, "hidden": 9, "layers": 2}'}, r"have shape \(32, 21\), expected \(36, 21\)"),
        ({"model": '{"dim": 21, "hidden": 8, "layers": 3}'}, "lack lstm.bias_hh_l2.*and 3 more"),
        ({"model": '{"dim": 21, "hidden": 8, "layers": 1}'}, "its network does not have"),
        ({"model": '{"dim": 22, "hidden": 8, "layers": 2}'}, "have shape"),
        # sizes of petabytes cost nothing to refuse: shapes are compared before memory is taken
        ({"model": '{"dim": 21, "hidden": 90000000, "layers": 2}'}, "have shape"),
    ],
)  # fmt: skip
def test_headers_that_do_not_fit(tmp_path, parts, header, message):
    path = tmp_path / "x.safetensors"
    save_checkpoint(path, **parts)
    rewrite(path, header=header)
    refused(path, message)


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"model.readout.bias": None}, "weights lack readout.bias"),
        ({"model.readout.bias": torch.zeros(20)}, r"shape \(20,\), expected \(21,\)"),
        ({"model.extra": torch.zeros(1)}, "has the weights extra"),
        ({"model.readout.bias": torch.full((21,), torch.nan)}, "not all finite"),
        ({"model.readout.bias": torch.zeros(21, dtype=torch.int32)}, "of type int32, expected floating-point numbers"),
        ({"normalizer.std": None}, "normalizer without std"),
        ({"normalizer.std": torch.zeros(21)}, "above zero"),
        ({"normalizer.mean": torch.zeros(5), "normalizer.std": torch.ones(5)}, "do not agree.*normaliser 5"),
        ({"seed_frames": torch.zeros(4, 21)}, "seed_frames must be"),
        ({"seed_frames": torch.zeros(1, 4, 20)}, "do not agree.*seed 20"),
        ({"seed_frames": torch.full((1, 4, 21), torch.nan)}, "seed_frames are not all finite"),
        ({"seed_frames": torch.zeros(1, 4, 21, dtype=torch.int64)}, "seed_frames are of type int64"),
    ],
)  # fmt: skip
def test_tensors_that_do_not_fit(tmp_path, parts, tensors, message):
    path = tmp_path / "x.safetensors"
    save_checkpoint(path, **parts)
    rewrite(path, tensors=tensors)
    refused(path, message)
