"""The command line: ``python -m tutorial_lib COMMAND``; ``--help`` lists the commands.

What a user can get wrong ends in one line, ``error: ...``, and exit status 2; Ctrl-C in 130. Results
are written whole or not at all. What is heavy to import (torch, matplotlib) is imported by the command that
needs it, so that ``--help`` is quick.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import NoReturn

from ..errors import TutorialError
from . import files, papers, synthesis, train, weights
from .options import PROGRAM
from .outputs import print_error

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    _print_any_name()
    try:
        options = _parser().parse_args(arguments)
        with warnings.catch_warnings():
            warnings.showwarning = _note
            _check_launcher(options)
            return options.run(options, arguments) or 0
    except BrokenPipeError:  # the reader of a pipe has seen enough
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (TutorialError, OSError) as error:
        print_error(error)
        return 2
    except (MemoryError, RuntimeError) as error:
        if not _lacks_memory(error):
            raise
        size = re.search(r"to allocate ([\d.]+ ?\w+)", str(error))
        asked = f" for {size[1]}" if size else ""
        print(
            f"error: not enough memory{asked}; smaller numbers need less: "
            "hidden, layers, batch, length, count or frames",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130


def _print_any_name() -> None:
    """A file may have a name that is not UTF-8: its odd bytes are then shown as escapes, instead of a traceback."""
    for stream in (sys.stdout, sys.stderr):
        # not every stream can: a notebook's or a program's own; and what was chosen (PYTHONIOENCODING) stays
        if hasattr(stream, "reconfigure") and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def _check_launcher(options: argparse.Namespace) -> None:
    """Several processes of any other command would write the same files."""
    if (
        options.run is not train.run
        and int(os.environ.get("WORLD_SIZE", 1)) > 1
        and "TORCHELASTIC_RUN_ID" in os.environ
    ):
        raise TutorialError("only train runs on the processes of torchrun; start this command without it")


def _lacks_memory(error: Exception) -> bool:
    """PyTorch tells it by a RuntimeError, in words of its own for each device."""
    told = ("not enough memory", "can't allocate memory", "out of memory")
    return isinstance(error, MemoryError) or any(words in str(error) for words in told)


def _note(message, category, filename, lineno, file=None, line=None) -> None:
    print(f"note: {message}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog=PROGRAM,
        description="Read, look at, learn and generate human motion.",
        epilog=f"Each command explains itself: {PROGRAM} train --help",
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in (files, train, synthesis, weights, papers):
        module.add(commands)
    return parser
