"""Tasks side by side through joblib: the same weights on every backend, Ctrl-C that saves, errors that arrive."""

from __future__ import annotations

import os
import pathlib
import signal
import subprocess
import sys
import threading
import time

import joblib
import pytest
import torch

from tutorial_lib.errors import DataError, TutorialError
from tutorial_lib.recipes import Recipe
from tutorial_lib.reproduce import grid
from tutorial_lib.reproduce.spread import side_by_side
from tutorial_lib.training.checkpoints import load_checkpoint, read_header

PROJECT = pathlib.Path(__file__).resolve().parents[1]


def runs(steps: int = 4) -> list[grid.Run]:
    """VAE-LSTMs, whose dropout draws from torch's own generator, which threads share."""
    return [
        grid.Run(f"a/{seed}", Recipe("vae-lstm", ("samples/boxing",), hidden=8, batch=2, length=16, steps=steps,
                                     seed=seed, options={"filters": 4, "kernel": 3}))
        for seed in range(3)
    ]  # fmt: skip


def weights(run: grid.Run, folder: pathlib.Path) -> dict[str, torch.Tensor]:
    return load_checkpoint(run.path(folder)).model.state_dict()


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("alone")
    side_by_side(grid.train, [(run, folder) for run in runs()], jobs=1)
    return folder


@pytest.mark.parametrize("backend", ["loky", "threading", "sequential"])
def test_every_backend_gives_the_same_weights(alone, backend, tmp_path):
    heard = {}
    with joblib.parallel_config(backend=backend):
        side_by_side(
            grid.train, [(run, tmp_path) for run in runs()], jobs=2, folder=tmp_path,
            heard=lambda name, step: heard.update({name: step}),
        )  # fmt: skip
    assert heard == {run.name: 4 for run in runs()}, "the last report of each arrives"
    for run in runs():
        mine, theirs = weights(run, tmp_path), weights(run, alone)
        assert all(torch.equal(mine[name], theirs[name]) for name in theirs), run.name
    assert [path.name for path in tmp_path.iterdir()] == ["a"], "what the tasks said to each other is cleared away"


def place(number: int, report) -> tuple[int, int, str | None]:
    return number, os.getpid(), os.environ.get("TUTORIAL_DATA")


def test_results_are_in_order_and_from_other_processes(monkeypatch, tmp_path):
    """Which know where the caller finds its data, also those that were started before it was told."""
    for folder in ("one", "two"):
        monkeypatch.setenv("TUTORIAL_DATA", str(tmp_path / folder))
        made = side_by_side(place, [(k,) for k in range(4)], jobs=2)
        assert [number for number, *_ in made] == [0, 1, 2, 3]
        assert os.getpid() not in {process for _, process, _ in made}
        assert {data for *_, data in made} == {str(tmp_path / folder)}


def fail(number: int, report) -> None:
    if number == 1:
        raise DataError("the second")
    if number == 2:
        raise ZeroDivisionError("a slip")
    until = time.monotonic() + 60
    while time.monotonic() < until:  # until it is told to stop
        report("a", 1)
        time.sleep(0.05)


@pytest.mark.parametrize("backend", ["loky", "sequential"])
def test_the_first_error_is_raised_and_stops_the_others(backend):
    start = time.monotonic()
    tasks = [(1,), (0,), (0,)] if backend == "sequential" else [(0,), (1,), (0,)]
    with joblib.parallel_config(backend=backend), pytest.raises(DataError, match="the second"):
        side_by_side(fail, tasks, jobs=2)
    assert time.monotonic() - start < 50
    with pytest.raises(ZeroDivisionError, match="a slip") as caught:
        side_by_side(fail, [(2,), (2,)], jobs=2)
    assert "in fail" in str(caught.value.__cause__), "where it happened, of a process that is not this one"


def test_an_error_in_what_is_heard_stops_all():
    def heard(name, step):
        raise TutorialError("nobody listens")

    with pytest.raises(TutorialError, match="nobody listens"):
        side_by_side(fail, [(0,), (0,)], jobs=2, heard=heard)


INTERRUPTED = """
import sys
from test_spread import runs
from tutorial_lib.reproduce import grid, spread

try:
    spread.side_by_side(grid.train, [(run, sys.argv[1]) for run in runs(steps=1_000_000)], jobs=2,
                        heard=lambda name, step: print(name, step, flush=True))
except spread.Stopped:
    print("stopped", flush=True)
"""


def test_ctrl_c_saves_every_run(tmp_path):
    """Given to the whole group of processes, as a terminal does."""
    (tmp_path / "run.py").write_text(INTERRUPTED, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "run.py"), str(tmp_path)], stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(PROJECT), str(PROJECT / "tests")])},
        start_new_session=True,
    )  # fmt: skip
    seen, said = set(), []
    timer = threading.Timer(120, process.kill)
    timer.start()
    for line in process.stdout:
        said.append(line.strip())
        seen.add(line.split()[0])
        if len(seen) == 2 and "interrupted" not in seen:
            seen.add("interrupted")
            os.killpg(process.pid, signal.SIGINT)
    process.wait()
    timer.cancel()
    assert said[-1] == "stopped" and process.returncode == 0
    steps = [read_header(path)["training"]["steps_done"] for path in sorted(tmp_path.rglob("*.safetensors"))]
    assert len(steps) == 2 and min(steps) > 0


def test_a_machine_that_does_not_see_the_folder_is_told(monkeypatch, tmp_path):
    from tutorial_lib.reproduce import spread

    board, caller = spread._Board(tmp_path / "away" / "board"), spread._Caller.here()
    outcome = spread._work(place, (1,), 0, board, caller)
    assert isinstance(outcome.error, TutorialError) and "all machines share" in str(outcome.error)


def test_no_jobs_are_refused():
    with pytest.raises(TutorialError, match="the number of jobs must be 1 or more, not 0"):
        side_by_side(place, [(0,), (1,)], jobs=0)
