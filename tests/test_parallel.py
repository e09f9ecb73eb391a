"""Data-parallel training: processes that torchrun started train to the weights of one process alone."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

import pytest
import torch
from torch.nn.functional import dropout
from torch.overrides import TorchFunctionMode

from tutorial_lib.cli import main
from tutorial_lib.errors import TutorialError
from tutorial_lib.recipes import Recipe, trainer_for
from tutorial_lib.training.checkpoints import load_checkpoint
from tutorial_lib.training.parallel import Workers, workers
from tutorial_lib.training.systems import SYSTEMS

PROJECT = pathlib.Path(__file__).resolve().parents[1]
# All that a loss may draw, where the system draws anything.
OPTIONS = {
    "aclstm": {"noise": 0.05},
    "erd": {"noise": 0.05},
    "seq2seq": {"n_seed": 12, "n_future": 12},
    "vae-lstm": {"dropout": 0.2, "filters": 4, "kernel": 3},
    "crbm": {"cd": 2},
    "dynamic-future-net": {"horizon": 4},
}


def recipe(system: str) -> Recipe:
    return Recipe(system, ("samples/boxing",), hidden=8, batch=4, length=24, steps=6, options=OPTIONS.get(system, {}))


def largest_difference(one, other) -> float:
    assert one.keys() == other.keys()
    return max(float((one[name].double() - other[name].double()).abs().max()) for name in one)


COMMAND = ["train", "scheduled-sampling", "--data", "samples/boxing", "--hidden", "8", "--length", "20", "--steps", "5"]
TOGETHER = """
import pathlib, sys

sys.path.insert(0, sys.argv[1])
from test_parallel import COMMAND, recipe
from tutorial_lib.cli import main
from tutorial_lib.recipes import trainer_for
from tutorial_lib.training.parallel import joined
from tutorial_lib.training.systems import SYSTEMS

folder = pathlib.Path(sys.argv[2])
with joined() as workers:
    for system in SYSTEMS:
        path = folder / f"{system}.safetensors"
        trainer = trainer_for(recipe(system), path)
        trainer.run(progress=False, max_seconds=0)  # one step, and saved
        if system in ("aclstm", "dynamic-future-net"):  # thrown away and resumed from its file
            workers.together(lambda: None)  # until the first process has written it
            trainer = trainer_for(recipe(system), path)
            assert trainer.step == 1
        trainer.run(progress=False)
        print(system, trainer.step, *trainer.history["loss"], flush=True)
    assert main([*COMMAND, "--batch", "4", "--out", str(folder / "command.safetensors")]) == 0
    try:
        status = main([*COMMAND, "--batch", "5", "--out", str(folder / "odd.safetensors")])
    except SystemExit as end:
        status = end.code
    assert status == 2
"""


@pytest.fixture(scope="module")
def together(tmp_path_factory) -> tuple[pathlib.Path, list[str], list[str]]:
    """What two processes of torchrun wrote and printed: its start takes longer than all that they do."""
    folder = tmp_path_factory.mktemp("together")
    (folder / "run.py").write_text(TOGETHER, encoding="utf-8")
    result = subprocess.run(
        [
            sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2",
            str(folder / "run.py"), str(PROJECT / "tests"), str(folder),
        ],
        capture_output=True, text=True, timeout=600,
        env={**os.environ, "PYTHONPATH": str(PROJECT), "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return folder, result.stdout.splitlines(), result.stderr.splitlines()


def test_two_processes_give_the_weights_of_one(together):
    """Every system, with all that its loss draws; two of them stopped after a step, and resumed."""
    folder, lines, _ = together
    told = {line.split()[0]: line.split()[1:] for line in lines[: len(SYSTEMS)]}
    assert list(told) == list(SYSTEMS), "each told once: only the first process prints"
    for system in SYSTEMS:
        alone = trainer_for(recipe(system))
        before = {name: value.clone() for name, value in alone.model.state_dict().items()}
        alone.run(progress=False)
        both = load_checkpoint(folder / f"{system}.safetensors")
        assert both.training["status"] == "finished"
        learnt = largest_difference(before, alone.model.state_dict())
        off = largest_difference(alone.model.state_dict(), both.model.state_dict())
        assert learnt > 1e-3 and off < 1e-4 * max(1.0, learnt), (system, learnt, off)
        assert [float(v) for v in told[system][1:]] == pytest.approx(alone.history["loss"], rel=1e-4, abs=1e-5), system


def test_the_command_on_two_processes(together, tmp_path):
    """One line of result, the weights of one process; a batch that cannot be shared is told in one line."""
    folder, lines, errors = together
    assert sum("wrote" in line for line in lines) == 1 and sum("clips to train on" in line for line in lines) == 1
    assert main([*COMMAND, "--batch", "4", "--out", str(tmp_path / "one.safetensors")]) == 0
    one, two = (load_checkpoint(path) for path in (tmp_path / "one.safetensors", folder / "command.safetensors"))
    assert largest_difference(one.model.state_dict(), two.model.state_dict()) < 1e-5
    assert [line for line in errors if line.startswith("error: ")] == [
        "error: a batch of 5 windows cannot be shared evenly by 2 processes: expected a multiple of 2"
    ]
    assert not (folder / "odd.safetensors").exists()


def test_other_commands_are_not_for_torchrun(monkeypatch, fails, tmp_path):
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "none")
    assert "only train" in fails("generate", "--pretrained", "aclstm-cmu-martial", "-o", tmp_path / "made")
    assert not (tmp_path / "made").exists()


def test_alone_nothing_is_changed():
    alone = workers()
    assert alone == Workers() and alone.first
    batch = torch.randn(5, 3)
    assert alone.share(batch) is batch and alone.average(batch) is batch
    assert alone.any(True) and not alone.any(False) and alone.together(lambda: 7) == 7
    assert not isinstance(alone.drawing(), TorchFunctionMode)


def test_shares_make_the_whole():
    batch = {"x": torch.arange(12).view(6, 2), "y": (torch.arange(6), "name")}
    parts = [Workers(rank, 3).share(batch) for rank in range(3)]
    assert torch.equal(torch.cat([part["x"] for part in parts]), batch["x"])
    assert torch.equal(torch.cat([part["y"][0] for part in parts]), batch["y"][0]) and parts[0]["y"][1] == "name"
    with pytest.raises(TutorialError, match="6 windows cannot be shared evenly by 4"):
        Workers(0, 4).share(batch)


def test_draws_for_shares_are_those_for_the_whole():
    """By a generator and by torch's own, of any shape whose first axis is the batch."""

    def draws(batch: int):
        rng = torch.Generator().manual_seed(3)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(5)
            return [
                torch.randn((batch, 4), generator=rng), torch.rand(batch, 2, 3, generator=rng),
                torch.randn(torch.Size([batch * 5])), dropout(torch.ones(batch, 40), 0.5, True),
            ]  # fmt: skip

    parts = []
    for rank in range(2):
        with Workers(rank, 2).drawing():
            parts.append(draws(3))
    for whole, one, other in zip(draws(6), *parts, strict=True):
        assert torch.equal(whole, torch.cat([one, other]))
        assert not torch.equal(one, other)
    with Workers(0, 2).drawing():
        x = torch.ones(3, 2)
        assert torch.equal(dropout(x, 0.5, False), x)
        with pytest.raises(TutorialError, match="draws with randperm"):
            torch.randperm(3)
