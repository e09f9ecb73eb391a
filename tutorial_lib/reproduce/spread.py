"""Tasks side by side through joblib: in processes of this machine or, with another backend of joblib's, of many.

>>> with joblib.parallel_config(backend="dask"):        # after dask.distributed.Client("tcp://scheduler:8786")
...     reproduce("/shared/clips", runs="/shared/runs", jobs=32)

What tasks say and are told goes through a folder that all of them see, as their checkpoints do: no backend has
to know of it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import pathlib
import signal
import socket
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from ..errors import TutorialError
from ..threads import torch_threads

Report = Callable[[str, int], None]  # a run's name and the steps that it has done; raises Stopped when it is to stop


class Stopped(KeyboardInterrupt):
    """Work that was told to stop, by Ctrl-C or because another run failed; what was done is saved."""


def side_by_side(
    function: Callable[..., Any],
    tasks: Sequence[tuple],
    *,
    jobs: int,
    heard: Report | None = None,
    folder: str | os.PathLike | None = None,
) -> list[Any]:
    """``function(*task, report)`` for each task, at most ``jobs`` at a time, with one torch thread each.

    With one job, or one task, they run in this process, one after another; else joblib spreads them: over processes of
    this machine, or where the backend that ``joblib.parallel_config`` names has its workers (the function must be
    one of a module). Of a backend that runs several tasks in one process each waits for the one before it, since
    torch's generator is the process's.

    heard: called here, in a thread, with what the tasks report.
    folder: in which tasks leave word; on several machines one that all see. By default a temporary one.

    Returns the results in the tasks' order. The first error, or Ctrl-C, stops all others as soon as they report again,
    and is raised; a second Ctrl-C ends this at once.
    """
    if jobs < 1:
        raise TutorialError(f"the number of jobs must be 1 or more, not {jobs}")
    import joblib  # which changes the environment when it is imported
    from joblib.externals.loky.process_executor import BrokenProcessPool

    heard = heard or (lambda name, step: None)
    if jobs == 1 or len(tasks) <= 1:
        with torch_threads(1):
            return [function(*task, heard) for task in tasks]
    if folder is not None:
        pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
        folder = pathlib.Path(folder).absolute()
    with tempfile.TemporaryDirectory(prefix=".side-by-side-", dir=folder, ignore_cleanup_errors=True) as place:
        board, caller = _Board(pathlib.Path(place)), _Caller.here()
        try:
            with _interrupt_stops(board), _listening(board, heard):
                outcomes = joblib.Parallel(n_jobs=jobs, batch_size=1, pre_dispatch="all")(
                    joblib.delayed(_work)(function, task, k, board, caller) for k, task in enumerate(tasks)
                )
        except BrokenProcessPool:
            raise TutorialError(
                "a training process ended unexpectedly, perhaps for lack of memory; call again to go on, with fewer "
                "jobs"
            ) from None
        stopped = board.stopped
    errors = [outcome for outcome in outcomes if isinstance(outcome, _Failed)]
    for failed in sorted(errors, key=lambda failed: isinstance(failed.error, KeyboardInterrupt)):
        raise failed.error from failed.cause
    if stopped:
        raise Stopped
    return outcomes


# --- what the tasks and their caller say to each other ------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Board:
    """A folder of small files: one in which each task appends its reports, and one that tells all to stop."""

    folder: pathlib.Path

    def stop(self) -> None:
        with contextlib.suppress(OSError):
            (self.folder / "stop").touch()

    @property
    def stopped(self) -> bool:
        return (self.folder / "stop").exists() or not self.folder.is_dir()

    def say(self, task: int, name: str, step: int) -> None:
        with contextlib.suppress(OSError), open(self.folder / f"{task}.jsonl", "a", encoding="utf-8") as file:
            file.write(json.dumps([name, step]) + "\n")

    def news(self, read: dict[pathlib.Path, int]) -> Iterator[tuple[str, int]]:
        """What tasks have said since; ``read`` has how much of each file is known, and is brought up to date."""
        for path in sorted(self.folder.glob("*.jsonl")):
            with open(path, "rb") as file:
                file.seek(read.get(path, 0))
                for line in file:
                    if line.endswith(b"\n"):  # else it is being written
                        read[path] = read.get(path, 0) + len(line)
                        yield tuple(json.loads(line))


@contextlib.contextmanager
def _listening(board: _Board, heard: Report) -> Iterator[None]:
    """A thread tells ``heard`` what is on the board, until the block ends; an error there stops all and is raised."""
    over, failed, read = threading.Event(), [], {}

    def listen() -> None:
        try:
            while not over.wait(0.2):
                for name, step in board.news(read):
                    heard(name, step)
        except BaseException as error:
            failed.append(error)
            board.stop()

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
    if failed:
        raise failed[0]
    for name, step in board.news(read):
        heard(name, step)


@contextlib.contextmanager
def _interrupt_stops(board: _Board) -> Iterator[None]:
    """Ctrl-C inside the block tells the tasks to stop; joblib by itself would kill them, unsaved. The second raises."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number, frame):
        if board.stopped:
            raise KeyboardInterrupt
        board.stop()

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# --- where a task runs --------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Caller:
    """The process that spreads the tasks, and what its environment says of data."""

    machine: str
    process: int
    environment: Mapping[str, str]

    @classmethod
    def here(cls) -> _Caller:
        told = {name: value for name, value in os.environ.items() if name.startswith("TUTORIAL_")}
        return cls(socket.gethostname(), os.getpid(), told)

    @property
    def is_here(self) -> bool:
        return (self.machine, self.process) == (socket.gethostname(), os.getpid())


@dataclasses.dataclass
class _Failed:
    """What a task gives that has failed: joblib kills all the others where one raises."""

    error: BaseException
    trace: str

    @property
    def cause(self) -> BaseException | None:
        return None if isinstance(self.error, (TutorialError, KeyboardInterrupt)) else RuntimeError(self.trace)


_turn = threading.Lock()  # torch's generator and number of threads are the process's


def _work(function: Callable[..., Any], task: tuple, number: int, board: _Board, caller: _Caller) -> Any:
    with _turn:
        if not caller.is_here:
            _settle_in(caller)
        child = os.getppid() == caller.process and socket.gethostname() == caller.machine
        last, unsaid = time.monotonic(), None

        def report(name: str, step: int) -> None:
            nonlocal last, unsaid
            unsaid = name, step
            now = time.monotonic()
            if now - last >= 0.5:
                last, unsaid = now, None
                board.say(number, name, step)
                if board.stopped or (child and os.getppid() != caller.process):  # its caller was killed
                    raise Stopped

        try:
            if not board.folder.is_dir():
                raise TutorialError(
                    f"{socket.gethostname()} does not see {board.folder.parent}: the folder of runs must be one that "
                    "all machines share"
                )
            if board.stopped:
                raise Stopped
            with torch_threads(1):
                result = function(*task, report)
            if unsaid is not None:
                board.say(number, *unsaid)
            return result
        except BaseException as error:
            board.stop()
            return _Failed(error, traceback.format_exc())


def _settle_in(caller: _Caller) -> None:
    """In a process of a backend: data is looked for where the caller does, and Ctrl-C is the caller's to hear."""
    os.environ.update(caller.environment)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not isinstance(warnings.showwarning, _Notes):
        warnings.showwarning = _Notes()


class _Notes:
    """Warnings as one line each; every run of a style would tell the same ones."""

    def __init__(self):
        self._told: set[str] = set()

    def __call__(self, message, *_, **__) -> None:
        if str(message) not in self._told:
            self._told.add(str(message))
            print(f"note: {message}", file=sys.stderr, flush=True)
