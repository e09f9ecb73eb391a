"""What several commands are told: numbers in their bounds, weights, the device to compute on."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from ..errors import TutorialError

if TYPE_CHECKING:
    from ..training.checkpoints import Checkpoint

PROGRAM = "python -m tutorial_lib"
OWN_DATA = "a data set's name (see: data list), or a motion file or folder of your own"

# No run on one computer needs more; what is above is a slip of the keyboard, told before memory runs out.
MOST = {
    "hidden": 16_384,
    "layers": 64,
    "batch": 65_536,
    "length": 100_000,
    "count": 1_000_000,
    "frames": 10_000_000,
    "steps": 10**9,
    "seed": 2**63 - 1,
    "fps": 1000.0,
    "threads": min(1024, 4 * (os.cpu_count() or 1)),
    "repeats": 10_000,
}


def add_command(commands, name: str, run, summary: str, example: str, **kwargs) -> argparse.ArgumentParser:
    """A command with its summary and an example; ``run(options, arguments)`` returns the exit status or ``None``."""
    command = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog=f"example: {PROGRAM} {example}",
        **kwargs,
    )
    command.set_defaults(run=run)
    return command


def add_markdown(listing: argparse.ArgumentParser) -> None:
    listing.add_argument("--markdown", action="store_true", help="as a table for a README: what is so everywhere")


def add_weights(command: argparse.ArgumentParser) -> None:
    # which of the two is looked at in open_weights: argparse would tell a misspelt option as a second CHECKPOINT
    command.add_argument("checkpoint", metavar="CHECKPOINT", nargs="?", help="a checkpoint file (.safetensors)")
    command.add_argument(
        "--pretrained", metavar="NAME", help="or weights that come with the library (see: pretrained list)"
    )


def add_device(command: argparse.ArgumentParser) -> None:
    command.add_argument("--device", default="cpu", help="where to compute: cpu (default), cuda, cuda:1, mps, ...")
    command.add_argument(
        "--threads", type=whole(1, MOST["threads"]), default=None, metavar="N", help="CPU threads to use"
    )


def whole(least: int, most: int):
    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:  # int() also refuses more than some thousand digits
            value = most + 1 if text.isdecimal() else least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"expected a whole number of {least} or more, not {short(text)}")
        if value > most:
            raise argparse.ArgumentTypeError(f"expected a whole number of at most {most}, not {short(text)}")
        return value

    return parse


def number(least: float, with_it: bool = False, most: float = float("inf")):
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (least <= value < float("inf")) or (value == least and not with_it):
            raise argparse.ArgumentTypeError(
                f"expected a number {'of' if with_it else 'above'} {least:g}{' or more' if with_it else ''}, "
                f"not {short(text)}"
            )
        if value > most:
            raise argparse.ArgumentTypeError(f"expected a number of at most {most:g}, not {short(text)}")
        return value

    return parse


def height(text: str) -> float:
    value = number(0, True)(text)
    if value != 0 and not 0.1 <= value <= 10:
        raise argparse.ArgumentTypeError(f"expected 0, or metres between 0.1 and 10, not {short(text)}")
    return value


def short(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def open_weights(options: argparse.Namespace) -> Checkpoint:
    from ..training.checkpoints import load_checkpoint
    from ..training.trainer import usable_device

    named = getattr(options, "pretrained", None)
    if named is not None and options.checkpoint is not None:
        raise TutorialError(
            f"weights: {short(options.checkpoint)} and --pretrained {short(named)}: expected one of the two"
        )
    if named is None and options.checkpoint is None:
        raise TutorialError("weights: expected a CHECKPOINT file or --pretrained NAME (see: pretrained list)")
    device = usable_device(options.device)
    if named is not None:
        from .. import pretrained

        return pretrained.load(named, device)
    return load_checkpoint(options.checkpoint, device=device)


def use_threads(options: argparse.Namespace) -> None:
    if options.threads is not None:
        import torch

        torch.set_num_threads(options.threads)
