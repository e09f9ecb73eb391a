"""Run lessons from a fresh kernel and keep their outputs: ``python notebooks/execute.py [01 02 ...]``.

What a reader sees in the repository is what a fresh clone gives: the lessons are run here offline, on the
samples and the shipped weights alone, whatever data this machine has. With ``--to FOLDER`` they are run with
this machine's data instead, and what comes out is written to that folder, to be looked at; with ``--share 0.3``
with a random third or so of its clips, since claims that hold on all clips of one machine need not hold on another's.
"""

from __future__ import annotations

import argparse
import itertools
import os
import pathlib
import random
import sys
import tempfile
import time

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

from tutorial_lib.atomic import atomic_write
from tutorial_lib.data.catalog import motion_files

FOLDER = pathlib.Path(__file__).resolve().parent
LIMIT = 1_000_000  # bytes of a lesson with its outputs


def main() -> int:
    """Run the lessons named on the command line, all of them without a name; 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("lesson", nargs="*", help="the beginning of a file name, such as 01; all if none is given")
    parser.add_argument("--to", type=pathlib.Path, metavar="FOLDER", help="run with this machine's data, write there")
    parser.add_argument("--share", type=float, metavar="X", help="only this share of each folder of that data")
    parser.add_argument("--seed", type=int, default=0, help="which share")
    options = parser.parse_args()
    if options.share is not None and not (options.to and os.environ.get("TUTORIAL_DATA") and 0 < options.share <= 1):
        parser.error("--share is a number above 0 and at most 1, and wants --to and clips in TUTORIAL_DATA")
    if options.to is None:
        os.environ.pop("TUTORIAL_DATA", None)
        os.environ["TUTORIAL_OFFLINE"] = "1"
    elif os.environ.get("TUTORIAL_DATA"):
        os.environ["TUTORIAL_DATA"] = str(pathlib.Path(os.environ["TUTORIAL_DATA"]).resolve())
    wanted = options.lesson or [""]
    paths = [p for p in sorted(FOLDER.glob("[0-9]*.ipynb")) if any(p.name.startswith(w) for w in wanted)]
    if not paths:
        print(f"error: no lesson in {FOLDER.name}/ begins with {', '.join(wanted)}", file=sys.stderr)
        return 2
    to = options.to or FOLDER
    try:  # a lesson takes minutes: whether it can be kept is asked before
        to.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=to):
            pass
    except OSError as error:
        print(f"error: {to}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        if options.to is None:  # what this machine has downloaded is not to be used, either
            os.environ["TUTORIAL_CACHE"] = folder
        if options.share is not None:
            os.environ["TUTORIAL_DATA"] = some_clips(os.environ["TUTORIAL_DATA"], folder, options.share, options.seed)
        return max(run(path, to / path.name) for path in paths)


def some_clips(of: str, to: str, share: float, seed: int) -> str:
    """Links in ``to`` to a random share of the clips in each folder of ``of``, and to two at least; returns ``to``."""
    draw = random.Random(seed)
    by_folder = sorted(motion_files(pathlib.Path(of)), key=lambda path: path.parent)
    for folder, clips in itertools.groupby(by_folder, key=lambda path: path.parent):
        clips = list(clips)
        taken = draw.sample(clips, min(len(clips), max(2, round(share * len(clips)))))
        there = pathlib.Path(to) / folder.relative_to(of)
        there.mkdir(parents=True, exist_ok=True)
        for path in [*taken, *folder.glob("*.asf")]:
            (there / path.name).symlink_to(path)
        print(f"{folder.relative_to(of)}: {', '.join(sorted(path.stem for path in taken))}")
    return to


def run(path: pathlib.Path, to: pathlib.Path) -> int:
    """Run one lesson and write it with its outputs; 0 if it went through and is small enough to be kept."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook, timeout=1800, kernel_name="python3", record_timing=False, resources={"metadata": {"path": FOLDER}}
    )
    begin = time.monotonic()
    try:
        client.execute()
    except CellExecutionError as error:
        print(f"{path.name}: {error}", file=sys.stderr)
        if to != path:  # to be looked at
            nbformat.write(notebook, to)
        return 1
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    text = nbformat.writes(notebook) + "\n"
    print(f"{path.name}: {time.monotonic() - begin:.0f} s, {len(text) / 1e3:.0f} kB")
    if len(text) > LIMIT and to == path:
        print(f"error: {path.name} is larger than {LIMIT / 1e6:g} MB with its outputs", file=sys.stderr)
        return 1
    with atomic_write(to) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
