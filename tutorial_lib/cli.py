"""The command line: ``python -m tutorial_lib COMMAND``; ``--help`` lists the commands.

What a user can get wrong ends in one line, ``error: ...``, and exit status 2; Ctrl-C in 130. Results
are written whole or not at all. What is heavy to import (torch, matplotlib) is imported by the command that
needs it, so that ``--help`` is quick.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import errno
import json
import os
import pathlib
import re
import shlex
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

from .errors import CheckpointError, DataError, TutorialError
from .recipes import DEFAULTS, JOINTS, NORMALIZE, Recipe

if TYPE_CHECKING:
    import numpy as np

    from .motion.clip import Motion
    from .training.checkpoints import Checkpoint
    from .training.trainer import Trainer

PROGRAM = "python -m tutorial_lib"

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
# What some systems have besides, with defaults of their own (see training/systems.py).
SYSTEM_OPTIONS = (
    "u", "v", "probability", "decay", "noise", "n_seed", "n_future",
    "deviation", "l1", "filters", "kernel", "pooling", "dropout", "cell", "latent", "cd", "past", "gibbs",
    "stage", "pose_share", "future_share", "temporal", "smooth", "code_deviation", "summary_deviation",
    "code", "velocity_code", "horizon", "future", "current", "summary",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
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
        _print_error(error)
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


def _check_launcher(options: argparse.Namespace) -> None:
    """Several processes of any other command would write the same files."""
    if options.run is not _train and int(os.environ.get("WORLD_SIZE", 1)) > 1 and "TORCHELASTIC_RUN_ID" in os.environ:
        raise TutorialError("only train runs on the processes of torchrun; start this command without it")


def _print_error(error: Exception) -> None:
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename is not None else error.strerror
    print(f"error: {' '.join(text.split())}", file=sys.stderr)


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

    def add(name: str, run, summary: str, example: str, **kwargs) -> argparse.ArgumentParser:
        command = commands.add_parser(
            name,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            epilog=f"example: {PROGRAM} {example}",
            **kwargs,
        )
        command.set_defaults(run=run)
        return command

    info = add("info", _info, "tell what motion files or checkpoints hold", "info data_samples/walking/*.bvh")
    info.add_argument("files", nargs="+", metavar="FILE", help=".bvh, .amc or .safetensors")

    view = add("view", _view, "write a page that plays motion files side by side", "view walk.bvh run.bvh -o page.html")
    view.add_argument("files", nargs="+", metavar="FILE", help=".bvh or .amc")
    view.add_argument("-o", "--out", required=True, metavar="PAGE.html", help="the page to write")
    view.add_argument("--overlay", action="store_true", help="all on one spot instead of side by side")
    view.add_argument(
        "--seed-frames",
        type=_whole(0, MOST["frames"]),
        default=0,
        metavar="N",
        help="so many first frames were given to a network: another colour",
    )

    data = add("data", None, "list, fetch and find the named data sets", "data list")
    actions = data.add_subparsers(title="actions", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="all data sets, where they are and under which licence")
    listing.set_defaults(run=_data_list)
    _add_markdown(listing)
    fetch = actions.add_parser(
        "fetch", help="download data sets into the cache", epilog=f"example: {PROGRAM} data fetch cmu/martial"
    )
    fetch.add_argument("names", nargs="+", metavar="NAME")
    fetch.set_defaults(run=_data_fetch)
    where = actions.add_parser("where", help="the folder that a data set is read from")
    where.add_argument("names", nargs="+", metavar="NAME")
    where.set_defaults(run=_data_where)

    own_data = "a data set's name (see: data list), or a motion file or folder of your own"
    train = add(
        "train",
        _train,
        "train a system and write a checkpoint",
        "train lstm --data samples/walking --out walk.safetensors --steps 2500",
        argument_default=argparse.SUPPRESS,
    )
    train.add_argument(
        "system",
        metavar="SYSTEM",
        help="what to train: lstm, aclstm, erd, seq2seq, scheduled-sampling, crbm, vae-lstm or dynamic-future-net",
    )
    train.add_argument(
        "--data",
        required=True,
        nargs="+",
        metavar="NAME",
        help=own_data + "; several are learnt together (hybrid), each giving the same share of the windows",
    )
    train.add_argument("--out", required=True, metavar="FILE", help="the checkpoint to write (.safetensors)")
    train.add_argument(
        "--resume",
        action="store_true",
        default=False,
        help="go on with the unfinished run in FILE, with its own settings; starts it if there is none",
    )

    def setting(group, flag: str, text: str, **kwargs) -> None:
        name = kwargs.get("dest") or flag.lstrip("-").replace("-", "_")
        default = DEFAULTS.get(name, getattr(Recipe, name))
        kwargs.setdefault("metavar", name.upper() if "choices" not in kwargs else None)
        group.add_argument(flag, help=text + (f" (default {default})" if default is not None else ""), **kwargs)

    group = train.add_argument_group("what is learnt from")
    setting(
        group,
        "--representation",
        "positions, hip-frame (always of vae-lstm, of crbm unless told), body-frame (always of dynamic-future-net), "
        "euler, quaternion or sixd",
        metavar="NAME",
    )
    setting(group, "--fps", "frames a second", type=_number(0, most=MOST["fps"]))
    setting(group, "--height", "the skeleton is scaled to so many metres; 0 leaves it", type=_height)
    setting(
        group,
        "--length",
        "frames in a training window; of vae-lstm 120, of dynamic-future-net 40",
        type=_whole(2, MOST["length"]),
    )
    setting(group, "--batch", "windows in a step", type=_whole(1, MOST["batch"]))
    setting(
        group,
        "--rates",
        "frame rates at which windows are also taken, such as 24 30 36 (default: fps)",
        type=_number(0, most=MOST["fps"]),
        nargs="+",
        metavar="FPS",
    )
    group.add_argument(
        "--no-rotate", dest="rotate", action="store_false", help="do not turn windows about the vertical at random"
    )
    setting(
        group,
        "--normalize",
        "bring every number to mean 0 and deviation 1; auto: all but positions, which the paper takes in metres",
        choices=NORMALIZE,
    )
    setting(
        group,
        "--test-fraction",
        "share of each data set's clips that is kept out for evaluation; 0 trains on all",
        type=_number(0, True),
    )
    setting(
        group,
        "--joints",
        "common: map every clip to the 21 common joints, for different skeletons; by default for vae-lstm and "
        "dynamic-future-net",
        choices=JOINTS,
    )
    group.add_argument(
        "--pad",
        action=argparse.BooleanOptionalAction,
        help="lengthen clips that are shorter than a window with their first and last pose; without, they are left "
        "out (default: vae-lstm only)",
    )
    setting(
        group,
        "--join",
        "training clips follow one another without end, blended over so many seconds; 0: each ends where it ends",
        type=_number(0, True, most=10),
    )
    group.add_argument(
        "--mirror", action="store_true", help="learn also from every clip's mirror image, left and right exchanged"
    )
    group = train.add_argument_group("network")
    setting(group, "--hidden", "cells a layer; the paper has 1024", type=_whole(1, MOST["hidden"]))
    setting(
        group,
        "--layers",
        "recurrent layers (default: erd and dynamic-future-net 2, seq2seq 1, else 3, as in the papers; vae-lstm has "
        "but one, crbm none)",
        type=_whole(1, MOST["layers"]),
    )
    group = train.add_argument_group("what the network is fed (the truth, unless said here)")
    group.add_argument(
        "--u", type=_whole(1, MOST["length"]), metavar="N", help="aclstm: frames of truth in a row (default 5)"
    )
    group.add_argument(
        "--v", type=_whole(1, MOST["length"]), metavar="N", help="aclstm: own outputs in a row (default 5)"
    )
    group.add_argument(
        "--probability",
        type=_number(0, True),
        metavar="P",
        help="scheduled-sampling: of the truth, at each frame; with a decay, at the end (default 0.5)",
    )
    group.add_argument(
        "--decay",
        choices=("fixed", "linear", "exponential", "inverse-sigmoid"),
        help="scheduled-sampling: how the probability falls as training goes on (default fixed)",
    )
    group.add_argument(
        "--noise",
        type=_number(0, True),
        metavar="SD",
        help="aclstm, erd: standard deviation of noise on the truth that is fed; erd reaches it at the end (default 0)",
    )
    group.add_argument(
        "--n-seed",
        type=_whole(1, MOST["length"]),
        metavar="N",
        help="seq2seq: frames of truth at the start of a window (default 50)",
    )
    group.add_argument(
        "--n-future",
        type=_whole(1, MOST["length"]),
        metavar="N",
        help="seq2seq: frames that it makes from its own output, and is measured on (default 25)",
    )
    group = train.add_argument_group("vae-lstm (the defaults are the paper's where it gives them)")
    for flag, text in (
        ("--filters", "of the first convolution of both encoders (default 64)"),
        ("--kernel", "frames that a convolution sees, odd (default 25)"),
        ("--pooling", "frames that each of the two pooling layers makes one of (default 2)"),
    ):
        group.add_argument(flag, type=_whole(1, MOST["hidden"]), metavar="N", help=text)
    for flag, text in (
        ("--dropout", "share of the input numbers left out in training (default 0.1)"),
        ("--deviation", "of the errors that count as noise, in deviations of the data (default 1)"),
        ("--l1", "weight of the mean absolute weight (default 0.1)"),
    ):
        group.add_argument(flag, type=_number(0, flag != "--deviation"), metavar="X", help=text)
    group.add_argument("--cell", choices=("modified", "ordinary"), help="the recurrent cell (default modified)")
    group.add_argument("--latent", choices=("per-step", "one"), help="codes of a window in training (default per-step)")
    group = train.add_argument_group("crbm")
    for flag, text in (
        ("--cd", "steps of contrastive divergence (default 1; the VAE-LSTM paper has 1 and 15)"),
        ("--past", "frames that a frame is conditioned on (default 3)"),
        ("--gibbs", "Gibbs steps that make a frame at generation (default 30)"),
    ):
        group.add_argument(flag, type=_whole(1, MOST["hidden"]), metavar="N", help=text)
    group = train.add_argument_group("dynamic-future-net (three stages, one after another)")
    group.add_argument(
        "--stage",
        metavar="NAME",
        help="all, or one of pose, future, dynamics; the latter two go on from --start (default all)",
    )
    for flag, text in (
        ("--pose-share", "of the steps, for stage pose (default 0.3)"),
        ("--future-share", "of the steps, for stage future (default 0.2); the rest is for dynamics"),
        ("--smooth", "weight of the smoothness loss of stage future (default 1)"),
        ("--temporal", "weight of the temporal-difference loss, 0: without (default 1)"),
        ("--code-deviation", "of the errors of a code that count as noise (default 0.1)"),
        ("--summary-deviation", "of those of a future's summary (default 0.3)"),
    ):
        group.add_argument(flag, type=_number(0, flag in ("--smooth", "--temporal")), metavar="X", help=text)
    for flag, least, text in (
        ("--code", 2, "numbers of a frame's code (default 16)"),
        ("--velocity-code", 1, "those of them that are for the velocity (default 4)"),
        ("--horizon", 1, "frames of future that are summed up (default 8; the paper has 8 or 16)"),
        ("--summary", 1, "numbers of that summary (default 32)"),
        ("--current", 1, "numbers of the current state (default 16)"),
        ("--future", 0, "numbers of the future state, 0: without one (default 16)"),
    ):
        group.add_argument(flag, type=_whole(least, MOST["hidden"]), metavar="N", help=text)
    group = train.add_argument_group("training")
    setting(
        group,
        "--steps",
        "steps of gradient descent; of vae-lstm 1000, of dynamic-future-net 6000",
        type=_whole(1, MOST["steps"]),
    )
    setting(group, "--start", "begin with the weights of another run of the same system", metavar="FILE")
    setting(group, "--lr", "learning rate", dest="learning_rate", type=_number(0), metavar="RATE")
    setting(group, "--schedule", "of the learning rate", choices=("one-cycle", "constant"))
    setting(group, "--clip", "largest norm of the gradient", type=_number(0), metavar="NORM")
    setting(
        group, "--seed", "of weights, batches and the split into training and test clips", type=_whole(0, MOST["seed"])
    )
    _add_device(train)
    train.add_argument(
        "--save-seconds",
        type=_number(0, True),
        default=60.0,
        metavar="S",
        help="save so often what --resume needs (default 60)",
    )

    generate = add(
        "generate",
        _generate,
        "let a checkpoint make motions, as BVH files",
        "generate walk.safetensors --frames 900 --count 4 --seed 1 -o made",
    )
    _add_weights(generate)
    generate.add_argument(
        "--frames", type=_whole(1, MOST["frames"]), default=300, metavar="N", help="frames of each motion (default 300)"
    )
    generate.add_argument("--count", type=_whole(1, MOST["count"]), default=1, metavar="K", help="motions (default 1)")
    generate.add_argument(
        "--seed",
        type=_whole(0, MOST["seed"]),
        default=0,
        metavar="S",
        help="number that chooses the seed motions, and all chance (default 0)",
    )
    generate.add_argument(
        "--temperature",
        type=_number(0, True),
        metavar="T",
        help="dynamic-future-net: how much chance there is; 0: none (default 1, as it was learnt)",
    )
    generate.add_argument("-o", "--out", required=True, metavar="DIR", help="folder for the files")
    generate.add_argument(
        "--data",
        metavar="NAME",
        help=f"where seed motions are cut from: {own_data}; by default "
        "what the checkpoint carries, else the data set that it was trained on",
    )
    generate.add_argument(
        "--seed-frames",
        type=_whole(1, MOST["frames"]),
        default=10,
        metavar="N",
        help="frames that the network is shown first (default 10, as in the paper)",
    )
    generate.add_argument("--keep-seed", action="store_true", help="put the seed's frames before the generated ones")
    generate.add_argument(
        "--clean",
        action="store_true",
        help="bring bones to the skeleton's lengths and plant the feet before writing, see tutorial_lib.cleanup",
    )
    _add_device(generate)

    walk = add(
        "walk",
        _walk,
        "let a network that follows control walk a path, as BVH files or as a page",
        'walk --pretrained vae-lstm-samples --path "figure of eight" --pace 1.3 --count 3 -o walkers.html',
    )
    _add_weights(walk)
    walk.add_argument(
        "--path",
        required=True,
        metavar="PATH",
        help="circle, figure of eight, zigzag, or a file of points: a line each, x and z in metres",
    )
    walk.add_argument(
        "--pace", type=_number(0), default=1.3, metavar="M/S", help="metres a second, where the path is straight"
        " (default 1.3)",
    )  # fmt: skip
    walk.add_argument("--count", type=_whole(1, MOST["count"]), default=1, metavar="K", help="people (default 1)")
    walk.add_argument("--seed", type=_whole(0, MOST["seed"]), default=0, metavar="S", help="who they are (default 0)")
    walk.add_argument("--rest", action="store_true", help="begin and end standing")
    walk.add_argument("--raw", action="store_true", help="as the network gave it: feet are not planted")
    walk.add_argument(
        "-o", "--out", required=True, metavar="OUT", help="folder for BVH files, or a page to play (PAGE.html)"
    )
    _add_device(walk)

    evaluate = add(
        "evaluate",
        _evaluate,
        "measure a checkpoint against real clips",
        "evaluate walk.safetensors --data samples/walking --json walk.json",
    )
    _add_weights(evaluate)
    evaluate.add_argument(
        "--data",
        required=True,
        metavar="NAME",
        help=own_data + "; clips that it was trained on are left out if there are others",
    )
    evaluate.add_argument("--json", metavar="FILE", help="write all measures there")
    evaluate.add_argument(
        "--frames",
        type=_whole(1, MOST["frames"]),
        default=900,
        metavar="N",
        help="frames to generate after each seed (default 900)",
    )
    evaluate.add_argument(
        "--count",
        type=_whole(1, MOST["count"]),
        metavar="K",
        help="seeds (default 20); of a network that follows control, people on each path (default 4)",
    )
    evaluate.add_argument(
        "--seed", type=_whole(0, MOST["seed"]), default=0, metavar="S", help="chooses them (default 0)"
    )
    _add_device(evaluate)

    pretrained = add("pretrained", None, "list the weights that come with the library, or add some", "pretrained list")
    actions = pretrained.add_subparsers(title="actions", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="all weights: their size, what they learnt from and how well")
    listing.set_defaults(run=_pretrained_list)
    _add_markdown(listing)
    publishing = actions.add_parser(
        "publish",
        help="half precision, own seeds and measures for a finished run, as a file to pass on",
        epilog=f"example: {PROGRAM} pretrained publish run.safetensors --name aclstm-cmu-martial",
    )
    publishing.set_defaults(run=_pretrained_publish)
    publishing.add_argument("checkpoint", metavar="CHECKPOINT", help="of a finished run, with its data at hand")
    publishing.add_argument("--name", required=True, help="of the weights, such as aclstm-cmu-martial")
    publishing.add_argument("--out", metavar="FOLDER", help="where the file goes (default: into the library)")
    publishing.add_argument(
        "--frames",
        type=_whole(1, MOST["frames"]),
        default=900,
        metavar="N",
        help="frames to generate after each seed when measuring (default 900)",
    )
    publishing.add_argument(
        "--count", type=_whole(1, MOST["count"]), default=20, metavar="K", help="seeds when measuring (default 20)"
    )
    _add_device(publishing)

    reproduce = add("reproduce", None, "rebuild a paper's tables and figures", "reproduce acrnn --data samples --quick")
    papers = reproduce.add_subparsers(title="papers", metavar="PAPER", required=True)
    acrnn = papers.add_parser(
        "acrnn",
        help="auto-conditioned recurrent networks: tables 1 and 2, figures 2, 7 and 9",
        description="Train what is missing, measure it, and print tables 1 and 2 with the paper's numbers beside ours. "
        "Can be stopped at any moment; called again, it goes on.",
        epilog=f"example: {PROGRAM} reproduce acrnn --data DIR --runs runs/acrnn --jobs 2",
    )
    acrnn.set_defaults(run=_reproduce_acrnn)
    _add_places(
        acrnn,
        "acrnn",
        "folder with cmu/walking, cmu/indian and cmu/martial, or: samples (default: where data list finds them)",
    )
    acrnn.add_argument(
        "--styles", nargs="+", default=["walking", "indian", "martial"], metavar="STYLE", help="of these only"
    )
    for size in ("steps", "hidden", "batch", "length"):
        least = 24 if size == "length" else 1
        acrnn.add_argument(
            f"--{size}",
            type=_whole(least, MOST[size]),
            metavar="N",
            help="of every run, instead of the paper's stand-in",
        )
    acrnn.add_argument("--grid", action="store_true", help="also u and v that differ, for the explorer")
    acrnn.add_argument("--long", action="store_true", help="also samples of 18,000 frames, and of the weights shipped")

    vae = papers.add_parser(
        "vae-lstm",
        help="a recurrent variational autoencoder for motion synthesis: tables 1 and 2, figures 3 and 4",
        description="Train the VAE-LSTM and the baselines, as far as they are missing, measure them, and print tables "
        "1 and 2 with the paper's numbers beside ours. Can be stopped at any moment; called again, it goes on.",
        epilog=f"example: {PROGRAM} reproduce vae-lstm --data DIR --runs runs/vae-lstm --jobs 2",
    )
    vae.set_defaults(run=_reproduce_vae_lstm)
    _add_places(
        vae,
        "vae-lstm",
        "folder with bandai-namco/locomotion, or: samples (default: where data list finds the clips, else the samples)",
    )
    vae.add_argument(
        "--steps",
        type=_whole(1, MOST["steps"]),
        metavar="N",
        help="of the VAE-LSTM (default 400); the baselines, whose steps are cheaper, have two to four times as many",
    )

    future = papers.add_parser(
        "dynamic-future-net",
        help="diversified motion: figures 6 to 9, stability, changes of action, limited data, ablations",
        description="Train the Dynamic Future Net on four kinds of motion, together and each alone, with less data and "
        "with parts cut out, as far as they are missing, and measure how stable and how different its motions are. "
        "Can be stopped at any moment; called again, it goes on.",
        epilog=f"example: {PROGRAM} reproduce dynamic-future-net --data DIR --runs runs/dfn --jobs 2",
    )
    future.set_defaults(run=_reproduce_dynamic_future_net)
    _add_places(
        future,
        "dynamic-future-net",
        "folder with cmu/walking, cmu/running, cmu/martial and cmu/indian, or: samples (default: where data list finds "
        "the clips, else the samples)",
    )
    future.add_argument(
        "--steps",
        type=_whole(3, MOST["steps"]),
        metavar="N",
        help="of a network of one action (default 800); one of all four has twice as many",
    )

    every = papers.add_parser(
        "side-by-side",
        help="every system on the same clips, split and skeleton, in one table",
        description="Train every system of the library on the same clips for about the same time, as far as they are "
        "missing, measure all alike, and print one table. Can be stopped at any moment; called again, it goes on.",
        epilog=f"example: {PROGRAM} reproduce side-by-side --data DIR --runs runs/side-by-side --jobs 2",
    )
    every.set_defaults(run=_reproduce_side_by_side)
    _add_places(
        every,
        "side-by-side",
        "folder with cmu/walking, or: samples (default: where data list finds the clips, else the samples)",
        "side_by_side.json and its networks",
    )
    for size, what in (("steps", "of LSTM-3LR; the others have as many as take as long"), ("hidden", "cells a layer")):
        every.add_argument(f"--{size}", type=_whole(10 if size == "steps" else 1, MOST[size]), metavar="N", help=what)
    for paper in (acrnn, vae, future, every):
        _add_reproduce(paper, tunes=paper in (acrnn, vae), seeded=paper is not future)

    results = add("results", _results, "show the papers' tables beside ours, as they come with the library", "results")
    results.add_argument(
        "paper",
        metavar="PAPER",
        nargs="?",
        help="all tables and findings of this one, as reproduce tells them (default: a few lines of each, in Markdown)",
    )

    benchmark = add(
        "benchmark",
        _benchmark,
        "measure how fast the library is against the plain way of doing the same",
        "benchmark rollout --hidden 128",
    )
    benchmark.add_argument("what", choices=("rollout",), help="rollout: training and synthesis of an LSTM")
    benchmark.add_argument(
        "--hidden",
        type=_whole(1, MOST["hidden"]),
        default=128,
        metavar="N",
        help="cells a layer, in training (default 128)",
    )
    benchmark.add_argument(
        "--threads", type=_whole(1, MOST["threads"]), default=2, metavar="N", help="CPU threads to use (default 2)"
    )
    benchmark.add_argument(
        "--repeats",
        type=_whole(1, MOST["repeats"]),
        default=9,
        metavar="N",
        help="turns, of which the median is told (default 9)",
    )
    return parser


def _add_markdown(listing: argparse.ArgumentParser) -> None:
    listing.add_argument("--markdown", action="store_true", help="as a table for a README: what is so everywhere")


def _add_weights(command: argparse.ArgumentParser) -> None:
    weights = command.add_mutually_exclusive_group(required=True)
    weights.add_argument("checkpoint", metavar="CHECKPOINT", nargs="?", help="a checkpoint file (.safetensors)")
    weights.add_argument(
        "--pretrained", metavar="NAME", help="weights that come with the library (see: pretrained list)"
    )


def _add_places(paper: argparse.ArgumentParser, name: str, data: str, written: str = "") -> None:
    """Where a paper's command reads from and writes to; data: the help of its --data; written: what it writes."""
    runs = f"for the checkpoints (default runs/{name}, of samples runs/{name}-samples)"
    written = written or f"{name.replace('-', '_')}.json and the figures"
    result = f"for {written} (default: that of the runs)"
    paper.add_argument("--data", metavar="DIR", help=data)
    paper.add_argument("--runs", metavar="FOLDER", help=runs)
    paper.add_argument("--out", metavar="FOLDER", help=result)


def _add_reproduce(paper: argparse.ArgumentParser, tunes: bool, seeded: bool) -> None:
    """What every paper's command has; ``seeded``: also seeds of training; ``tunes``: also a choice of rates."""
    paper.add_argument(
        "--jobs",
        type=_whole(1, MOST["threads"]),
        default=2,
        metavar="N",
        help="runs trained side by side, each with one thread (default 2)",
    )
    if seeded:
        paper.add_argument(
            "--seeds", type=_whole(0, MOST["seed"]), nargs="+", default=[0], metavar="S", help="of training (default 0)"
        )
    if tunes:
        paper.add_argument("--tune", action="store_true", help="first choose the learning rates, on validation clips")
    paper.add_argument("--no-train", action="store_true", help="measure the runs that are finished, and train none")
    paper.add_argument("--quick", action="store_true", help="a trial with tiny networks and few steps")


def _add_device(command: argparse.ArgumentParser) -> None:
    command.add_argument("--device", default="cpu", help="where to compute: cpu (default), cuda, cuda:1, mps, ...")
    command.add_argument(
        "--threads", type=_whole(1, MOST["threads"]), default=None, metavar="N", help="CPU threads to use"
    )


def _whole(least: int, most: int):
    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:  # int() also refuses more than some thousand digits
            value = most + 1 if text.isdecimal() else least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"expected a whole number of {least} or more, not {_short(text)}")
        if value > most:
            raise argparse.ArgumentTypeError(f"expected a whole number of at most {most}, not {_short(text)}")
        return value

    return parse


def _number(least: float, with_it: bool = False, most: float = float("inf")):
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (least <= value < float("inf")) or (value == least and not with_it):
            raise argparse.ArgumentTypeError(
                f"expected a number {'of' if with_it else 'above'} {least:g}{' or more' if with_it else ''}, "
                f"not {_short(text)}"
            )
        if value > most:
            raise argparse.ArgumentTypeError(f"expected a number of at most {most:g}, not {_short(text)}")
        return value

    return parse


def _height(text: str) -> float:
    value = _number(0, True)(text)
    if value != 0 and not 0.1 <= value <= 10:
        raise argparse.ArgumentTypeError(f"expected 0, or metres between 0.1 and 10, not {_short(text)}")
    return value


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


# --- looking at files -----------------------------------------------------------------------------


def _info(options: argparse.Namespace, _: Sequence[str]) -> int:
    from .motion.files import file_info

    status = 0
    for path in options.files:
        try:
            if pathlib.Path(path).suffix.lower() == ".safetensors":
                lines = _checkpoint_lines(path)
            else:
                lines = file_info(path).lines()
            print("\n".join(lines))
        except (TutorialError, OSError) as error:  # the other files are still told
            if isinstance(error, BrokenPipeError):
                raise
            sys.stdout.flush()
            _print_error(error)
            status = 2
    return status


def _checkpoint_lines(path: str) -> list[str]:
    from .pretrained import data_names
    from .training.checkpoints import load_checkpoint

    checkpoint = load_checkpoint(path)
    training, origin, representation = checkpoint.training, checkpoint.provenance, checkpoint.representation
    sizes = ", ".join(f"{name} {value}" for name, value in checkpoint.config.items())
    lines = [str(path), f"  system     {checkpoint.system} ({sizes}; {checkpoint.n_parameters:,} weights)"]
    if representation is not None:
        lines.append(
            f"  features   {representation.name}, {representation.dim} numbers a frame, "
            f"{representation.fps:g} frames per second, {representation.skeleton.n_joints} nodes"
            + (", normalised" if checkpoint.normalizer is not None else "")
        )
    lines.append(
        f"  training   {training.get('steps_done', '?')} of {training.get('steps', '?')} steps, "
        f"{training.get('status', 'unknown')}"
    )
    names = " + ".join(data_names(origin.get("data"))) or "not told"
    lines.append(f"  data       {names}, {len(origin.get('clips') or ())} clips")
    lines.append(f"  made       {origin.get('date', '?')} by {origin.get('command') or 'a program'}")
    return lines


def _view(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .motion.files import read_motion
    from .view import show

    _check_output(options.out, options.files)
    motions = [read_motion(path) for path in options.files]
    labels = [pathlib.Path(path).stem for path in options.files]
    player = show(motions, labels=labels, overlay=options.overlay, seed_frames=options.seed_frames)
    path = player.save(options.out)
    print(f"wrote {path} ({path.stat().st_size / 1e6:.2f} MB)")


# --- data -----------------------------------------------------------------------------------------


def _data_list(options: argparse.Namespace, _: Sequence[str]) -> None:
    from . import data

    def number(value: float | None, form: str) -> str:
        return "" if value is None else format(value, form)

    if options.markdown:
        from .view.tables import markdown_table

        sets = [data.entry(name) for name in data.names()]  # as published, whatever is at hand
        cells = [(f"`{row.name}`", row.clips, row.title, row.licence) for row in sets]
        print(markdown_table(("name", "clips", "what", "licence"), cells, right=(1,)), end="")
        return
    rows = [("name", "clips", "minutes", "MB", "at hand", "licence", "what")]
    rows += [
        (
            row.name,
            str(row.clips),
            number(row.minutes, ".1f"),
            number(row.megabytes, ".1f"),
            row.at_hand,
            row.licence,
            row.title,
        )
        for row in data.listing()
    ]
    widths = [max(len(row[k]) for row in rows) for k in range(6)]
    for row in rows:
        cells = [
            cell.rjust(width) if k in (1, 2, 3) else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=False))
        ]
        print("  ".join([*cells, row[6]]).rstrip())


def _data_fetch(options: argparse.Namespace, _: Sequence[str]) -> None:
    from . import data

    for name in options.names:
        data.entry(name)  # an unknown name is told before anything is downloaded
    for name in options.names:
        print(f"{name}: {data.fetch(name)}")


def _data_where(options: argparse.Namespace, _: Sequence[str]) -> None:
    from . import data

    for name in options.names:
        print(data.where(name))


# --- learning -------------------------------------------------------------------------------------


def _train(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    _use_threads(options)
    from .training.parallel import joined

    with joined() as workers:  # with the other processes, if torchrun has started some
        trainer = workers.together(lambda: _trainer(options, arguments, workers.device(options.device)))
        return 0 if trainer is None else _run(trainer)


def _trainer(options: argparse.Namespace, arguments: Sequence[str], device: str) -> Trainer | None:
    """The trainer that is asked for; ``None`` if its run is finished already."""
    from .recipes import sets_of, trainer_for
    from .training.systems import system_kind
    from .training.trainer import usable_device

    kind = system_kind(options.system)
    usable_device(device)
    out = pathlib.Path(options.out)
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Recipe)
             if hasattr(options, field.name)}  # fmt: skip
    own = {name: getattr(options, name) for name in SYSTEM_OPTIONS if hasattr(options, name)}
    for name in own:
        if name not in kind.options:
            raise TutorialError(f"{_flag(name)} is not for system {options.system!r}")
    _check_output(options.out, options.data)
    resuming = options.resume and out.exists()
    recipe = _recipe_there(out, {**given, **own}) if resuming else Recipe(**given, options=own)
    if recipe is None:
        return None
    if out.exists() and not resuming:
        _check_replaceable(out)

    sets = sets_of(recipe)
    trainer = trainer_for(
        recipe, out, device=device, save_seconds=options.save_seconds, resume=options.resume, sets=sets,
        command=f"{PROGRAM} {shlex.join(arguments)}",
    )  # fmt: skip
    train, test = [m for part, _ in sets for m in part], [m for _, part in sets for m in part]
    features = trainer.batches.representation
    print(
        f"{' + '.join(recipe.data)}: {len(train)} clips to train on ({sum(m.duration for m in train):.0f} s), "
        f"{len(test)} kept out; {features.name}, {features.dim} numbers a frame"
    )
    return trainer


def _run(trainer: Trainer) -> int:
    out, steps = trainer.path, trainer.config.steps
    if trainer.step:
        print(f"{out}: going on after step {trainer.step}")
    trainer.run()
    if not trainer.finished:
        print(f"stopped after {trainer.step} of {steps} steps, saved in {out}; --resume goes on", file=sys.stderr)
        return 130
    if trainer.path.exists():  # of several processes the first one writes, perhaps on another machine
        print(
            f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB): {trainer.step} steps in {trainer.seconds:.0f} s, "
            f"loss {trainer.loss:.4g}"
        )
    return 0


def _recipe_there(out: pathlib.Path, given: dict[str, Any]) -> Recipe | None:
    """The recipe of the unfinished run in ``out``, which must have all that was ``given``; ``None``: it is finished."""
    from .recipes import recipe_in
    from .training.checkpoints import read_header

    header = read_header(out)
    training = header["training"]
    if not header["resumable"] and training.get("status") == "finished":
        print(f"{out}: already finished, {training.get('steps_done')} steps")
        return None
    try:
        recipe = recipe_in(header)
    except CheckpointError as error:
        raise CheckpointError(f"{out}: {error}") from None
    stored = recipe.to_dict()
    for name in sorted(given, key=lambda name: name != "system"):  # another system explains the rest
        value, there = given[name], stored.get(name)
        if (value or None if name == "height" else value) != there:
            raise CheckpointError(
                f"{out}: holds a run with {name} {there!r}, asked for {value!r}; "
                f"leave {_flag(name)} as it was, or take another --out"
            )
    return recipe


def _flag(name: str) -> str:
    return "--lr" if name == "learning_rate" else f"--{name.replace('_', '-')}"


def _check_replaceable(out: pathlib.Path) -> None:
    """A file in the place of a new checkpoint may only be a finished one."""
    from .training.checkpoints import read_header

    try:
        header = read_header(out)
    except CheckpointError:
        raise DataError(
            f"{out}: is there and not a checkpoint of this library, so it is not replaced; "
            "take another --out, or remove it"
        ) from None
    if header["resumable"]:
        raise DataError(
            f"{out}: holds an unfinished run ({header['training'].get('steps_done')} of "
            f"{header['training'].get('steps')} steps); add --resume to go on with it, or remove it"
        )


def _check_output(name: str, inputs: Sequence[str]) -> None:
    """A file that cannot be written, or that is one of the inputs, is told before the work, not after it."""
    _check_named(name)
    path = pathlib.Path(name)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "expected a file to write, this is a folder", str(path))
    _check_folder(path.absolute().parent)
    _check_not_input([path], inputs)


def _check_named(name: str) -> None:
    if not name.strip():
        raise TutorialError("the output has an empty name, expected a path to write to")


def _check_folder(folder: pathlib.Path) -> None:
    """That files can be made in ``folder``, or the folder itself if it is not there."""
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected a folder, this is a file", str(there))
    if not os.access(there, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "the folder cannot be written to", str(there))


def _check_not_input(outputs: Sequence[pathlib.Path], inputs: Sequence[str]) -> None:
    outputs = [path for path in outputs if path.exists()]
    if not outputs:
        return
    # links and other spellings of a path count as well
    taken = {_identity(file) for name in inputs for file in _input_files(name)}
    for path in outputs:
        if _identity(path) in taken:
            raise TutorialError(f"{path}: is read by this command, so it is not written to; take another output")


def _identity(path: pathlib.Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino


def _input_files(name: str) -> list[pathlib.Path]:
    """The files behind a checkpoint, a motion file, a folder of them or a data set's name, if they are there."""
    from . import data
    from .motion.files import SUFFIXES

    path = pathlib.Path(data.where(name) if name in data.names() else name)
    if path.is_dir():
        return [file for file in path.rglob("*") if file.suffix.lower() in (*SUFFIXES, ".asf") and file.is_file()]
    skeletons = path.parent.glob("*.asf") if path.suffix.lower() == ".amc" else ()
    return [file for file in (path, *skeletons) if file.is_file()]


def _generate(options: argparse.Namespace, _: Sequence[str]) -> None:
    _use_threads(options)
    from .cleanup import clean_up, legs
    from .generate import check_predicts, choose_seeds, generate_each
    from .generate_futures import generate_futures
    from .motion.bvh import write_bvh
    from .training.progress import Progress
    from .training.systems import SYSTEMS

    _check_named(options.out)
    out = pathlib.Path(options.out)
    _check_folder(out)
    checkpoint = _open(options)
    check_predicts(checkpoint)
    stem, digits = checkpoint.path.stem, max(2, len(str(options.count)))
    names = [f"{stem}-{k:0{digits}d}.bvh" for k in range(1, options.count + 1)]
    sources = [] if options.data is None else [options.data]
    if options.data is None and checkpoint.seed_frames is None:
        sources = _data_of(checkpoint)
    _check_not_input([out / name for name in names], [str(checkpoint.path), *sources])
    if options.clean and checkpoint.representation is not None:
        legs(checkpoint.representation.skeleton)  # an unknown one is told before the work
    seeds = _seed_clips(checkpoint, sources)
    chosen = {"count": options.count, "seed": options.seed}
    if SYSTEMS[checkpoint.system].futures:
        prefix = choose_seeds(checkpoint, seeds, frames=options.seed_frames, **chosen)
        temperature = 1.0 if options.temperature is None else options.temperature
        made = iter(
            generate_futures(
                checkpoint, options.frames, prefix=prefix, temperature=temperature, progress=True, **chosen
            )
        )
    elif options.temperature is not None:
        raise TutorialError(f"--temperature is not for system {checkpoint.system!r}")
    else:
        made = generate_each(
            checkpoint, options.frames, seeds=seeds, seed_frames=options.seed_frames, progress=True, **chosen
        )
    bar = Progress(options.count, unit="file", title="writing")
    with _whole_folder(out) as folder, contextlib.closing(bar):
        for name, motion in zip(names, made, strict=True):  # each is written as it comes: few are ever in memory
            motion = clean_up(motion) if options.clean else motion
            motion = motion if options.keep_seed else motion[options.seed_frames :]
            write_bvh(motion, folder / name)
            bar.update()
    print(f"wrote {len(names)} files of {len(motion)} frames to {options.out}")


def _walk(options: argparse.Namespace, _: Sequence[str]) -> None:
    _use_threads(options)
    from .control import path_deviation
    from .motion.bvh import write_bvh
    from .walk import walk

    _check_named(options.out)
    out, files = pathlib.Path(options.out), [options.path] if pathlib.Path(options.path).is_file() else []
    page = out.suffix.lower() in (".html", ".htm")
    if page:
        _check_output(options.out, files)
    else:
        _check_folder(out)
    path = _path_of(options.path)
    checkpoint = _open(options)
    digits = max(2, len(str(options.count)))
    names = [f"walk-{k:0{digits}d}.bvh" for k in range(1, options.count + 1)]
    _check_not_input([out] if page else [out / name for name in names], [str(checkpoint.path), *files])
    motions = walk(
        checkpoint, path, options.pace, count=options.count, seed=options.seed, clean=not options.raw, rest=options.rest
    )
    away = [path_deviation(motion, path) for motion in motions]
    if page:
        from .view import show

        show(motions, layout="as is").save(out)
    else:
        with _whole_folder(out) as folder:
            for name, motion in zip(names, motions, strict=True):
                write_bvh(motion, folder / name)
    many = "1 file" if len(names) == 1 else f"{len(names)} files"
    told = f"wrote {out}" if page else f"wrote {many} to {out}"
    mean, most = sum(d.mean for d in away) / len(away), max(d.max for d in away)
    print(
        f"{told}: {motions[0].duration:.1f} s each, {100 * mean:.1f} cm from the path on average, "
        f"{100 * most:.1f} at most"
    )


def _path_of(name: str) -> np.ndarray:
    """A prepared path, or the points in a file."""
    from .motion.ground import prepared_path, read_path

    if pathlib.Path(name).is_file():
        return read_path(name)
    try:
        return prepared_path(name)
    except TutorialError as error:
        raise DataError(f"{error}, or a file of points, x and z in metres, a line each") from None


def _data_of(checkpoint: Checkpoint) -> list[str]:
    """The data sets that a checkpoint was trained on."""
    from .pretrained import data_names

    return list(data_names(checkpoint.provenance.get("data")))


def _seed_clips(checkpoint: Checkpoint, names: Sequence[str]) -> list[Motion] | None:
    """Clips to cut seeds from, those never trained on if there are any; ``None``: the checkpoint's own seed."""
    from .evaluate import unseen
    from .recipes import load_clips

    if not names:
        if checkpoint.seed_frames is not None:
            return None
        raise CheckpointError(
            f"{checkpoint.path}: carries no seed and does not say what it was trained on; give --data"
        )
    try:
        clips = [clip for name in names for clip in load_clips(name)]
    except DataError as error:
        if list(names) != _data_of(checkpoint):
            raise
        raise DataError(f"seed motions are needed: {error}; or give others with --data") from None
    fresh = unseen(checkpoint, clips)
    print(f"seeds from {', '.join(names)}: {len(fresh or clips)} clips {'never ' if fresh else ''}trained on")
    return fresh or clips


def _evaluate(options: argparse.Namespace, _: Sequence[str]) -> None:
    _use_threads(options)
    from . import evaluate_control
    from .atomic import atomic_write
    from .evaluate import evaluate, summary, unseen
    from .recipes import load_clips
    from .training.systems import SYSTEMS

    if options.json is not None:
        inputs = [options.data] if options.checkpoint is None else [options.checkpoint, options.data]
        _check_output(options.json, inputs)
    checkpoint = _open(options)
    clips = load_clips(options.data)
    clips = unseen(checkpoint, clips) or clips
    if SYSTEMS[checkpoint.system].controlled:
        count = 4 if options.count is None else options.count
        result = evaluate_control.evaluate_control(checkpoint, clips, count=count, seed=options.seed)
        lines = evaluate_control.summary(result)
    else:
        count = 20 if options.count is None else options.count
        result = evaluate(checkpoint, clips, count=count, frames=options.frames, seed=options.seed, progress=True)
        lines = summary(result)
    result = {"checkpoint": checkpoint.path.name, "data": options.data, **result}
    print("\n".join(lines))
    if options.json is not None:
        with atomic_write(options.json) as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(f"wrote {options.json}")


# --- weights that come with the library -----------------------------------------------------------


def _pretrained_list(options: argparse.Namespace, _: Sequence[str]) -> None:
    from . import pretrained

    if options.markdown:
        from .view.tables import markdown_table

        cells = [(f"`{row.name}`", f"{row.megabytes:.1f}", row.summary) for row in pretrained.list()]
        print(markdown_table(("name", "MB", "what it is"), cells, right=(1,)), end="")
        return
    print(pretrained.list())


def _pretrained_publish(options: argparse.Namespace, _: Sequence[str]) -> None:
    _use_threads(options)
    from . import evaluate_control
    from .evaluate import summary
    from .pretrained import FOLDER
    from .pretrained.publish import publish
    from .training.checkpoints import read_header
    from .training.systems import SYSTEMS
    from .training.trainer import usable_device

    folder = pathlib.Path(FOLDER if options.out is None else options.out)
    _check_named(str(folder))
    _check_folder(folder)
    _check_not_input([folder / f"{options.name}.safetensors"], [options.checkpoint])
    file = publish(
        options.checkpoint,
        options.name,
        folder=folder,
        frames=options.frames,
        count=options.count,
        device=usable_device(options.device),
        progress=True,
    )
    header = read_header(file)
    origin = header["provenance"]
    controlled = SYSTEMS[header["system"]].controlled
    print("\n".join((evaluate_control.summary if controlled else summary)(origin["metrics"])))
    if not controlled:
        print(f"own seeds           {origin['seeds']['count']} of {origin['seeds']['frames']} frames")
    print(f"wrote {file} ({file.stat().st_size / 1e6:.2f} MB)")


def _reproduce_acrnn(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .reproduce.acrnn import reproduce

    common = _reproduction(options, "steps", "hidden", "batch", "length")
    reproduce(
        options.data, styles=options.styles, seeds=options.seeds, grid=options.grid, long=options.long,
        tuning=options.tune, **common,
    )  # fmt: skip


def _reproduce_vae_lstm(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .reproduce.vae_lstm import reproduce

    reproduce(options.data, seeds=options.seeds, tuning=options.tune, **_reproduction(options, "steps"))


def _reproduce_dynamic_future_net(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .reproduce.dynamic_future_net import reproduce

    reproduce(options.data, **_reproduction(options, "steps"))


def _reproduce_side_by_side(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .reproduce.side_by_side import reproduce

    reproduce(options.data, seeds=options.seeds, **_reproduction(options, "steps", "hidden"))


def _reproduction(options: argparse.Namespace, *sizes: str) -> dict[str, Any]:
    """What all of them are told; ``sizes``: of the budget, as far as they were given."""
    for folder in (options.runs, options.out):
        if folder is not None:
            _check_named(folder)
            _check_folder(pathlib.Path(folder))
    return {
        "runs": options.runs,
        "out": options.out,
        "jobs": options.jobs,
        "train_missing": not options.no_train,
        "quick": options.quick,
        "budget": {name: getattr(options, name) for name in sizes if getattr(options, name) is not None},
        "tell": _tell,
    }


def _results(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .reproduce.shipped import full, short

    if options.paper is not None:
        print("\n".join(full(options.paper)))
        return
    print("\n".join(f"{table.caption}\n\n{table.markdown()}" for table in short()), end="")


def _tell(line: str) -> None:
    print(line, flush=True)


def _benchmark(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .training.rollout_benchmark import report

    for line in report(options.hidden, threads=options.threads, repeats=options.repeats):
        _tell(line)


def _open(options: argparse.Namespace) -> Checkpoint:
    from .training.checkpoints import load_checkpoint
    from .training.trainer import usable_device

    device = usable_device(options.device)
    if getattr(options, "pretrained", None) is not None:
        from . import pretrained

        return pretrained.load(options.pretrained, device)
    return load_checkpoint(options.checkpoint, device=device)


def _use_threads(options: argparse.Namespace) -> None:
    if options.threads is not None:
        import torch

        torch.set_num_threads(options.threads)


@contextlib.contextmanager
def _whole_folder(folder: pathlib.Path) -> Iterator[pathlib.Path]:
    """A temporary folder whose files move to ``folder`` when the block ends without an error, else vanish.

    An ``OSError`` names ``folder``, for the temporary one means nothing to a user.
    """
    temporary = None
    try:
        beside = folder if folder.is_dir() else folder.parent  # of a folder that is there, only it need be writable
        beside.mkdir(parents=True, exist_ok=True)
        temporary = pathlib.Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=beside))
        yield temporary
        folder.mkdir(exist_ok=True)
        for file in sorted(temporary.iterdir()):
            os.replace(file, folder / file.name)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(folder)) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
