"""The command line: ``python -m tutorial_lib info | view | data | train | generate | evaluate | benchmark``.

What a user can get wrong ends in one line, ``error: ...``, and exit status 2; Ctrl-C in 130. Results
are written whole or not at all. What is heavy to import (torch, matplotlib) is imported by the command that
needs it, so that ``--help`` is quick.
"""

from __future__ import annotations

import argparse
import contextlib
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

if TYPE_CHECKING:
    from .motion.clip import Motion
    from .training.checkpoints import Checkpoint

PROGRAM = "python -m tutorial_lib"

# What a training run is made of; a resumed one takes these from its file. 128 cells are for a CPU's minutes.
TRAIN_DEFAULTS: dict[str, Any] = {
    "representation": "positions",
    "fps": 30.0,
    "height": 1.54,
    "length": 100,
    "batch": 32,
    "rates": None,
    "rotate": True,
    "normalize": "auto",
    "test_fraction": 0.2,
    "hidden": 128,
    "layers": 3,
    "steps": 2500,
    "learning_rate": 2e-3,
    "schedule": "one-cycle",
    "clip": 1.0,
    "seed": 0,
}
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
SYSTEM_OPTIONS = ("u", "v", "probability", "decay")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        options = _parser().parse_args(arguments)
        with warnings.catch_warnings():
            warnings.showwarning = _note
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
    train.add_argument("system", metavar="SYSTEM", help="what to train: lstm, aclstm or scheduled-sampling")
    train.add_argument("--data", required=True, metavar="NAME", help=own_data)
    train.add_argument("--out", required=True, metavar="FILE", help="the checkpoint to write (.safetensors)")
    train.add_argument(
        "--resume",
        action="store_true",
        default=False,
        help="go on with the unfinished run in FILE, with its own settings; starts it if there is none",
    )

    def setting(group, flag: str, text: str, **kwargs) -> None:
        name = kwargs.get("dest") or flag.lstrip("-").replace("-", "_")
        default = TRAIN_DEFAULTS[name]
        kwargs.setdefault("metavar", name.upper() if "choices" not in kwargs else None)
        group.add_argument(flag, help=text + (f" (default {default})" if default is not None else ""), **kwargs)

    group = train.add_argument_group("what is learnt from")
    setting(group, "--representation", "positions, hip-frame, euler, quaternion or sixd", metavar="NAME")
    setting(group, "--fps", "frames a second", type=_number(0, most=MOST["fps"]))
    setting(group, "--height", "the skeleton is scaled to so many metres; 0 leaves it", type=_height)
    setting(group, "--length", "frames in a training window", type=_whole(2, MOST["length"]))
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
        choices=("auto", "on", "off"),
    )
    setting(
        group,
        "--test-fraction",
        "share of the clips that is kept out for evaluation; 0 trains on all",
        type=_number(0, True),
    )
    group = train.add_argument_group("network")
    setting(group, "--hidden", "cells a layer; the paper has 1024", type=_whole(1, MOST["hidden"]))
    setting(group, "--layers", "layers", type=_whole(1, MOST["layers"]))
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
    group = train.add_argument_group("training")
    setting(group, "--steps", "steps of gradient descent", type=_whole(1, MOST["steps"]))
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
    generate.add_argument("checkpoint", metavar="CHECKPOINT")
    generate.add_argument(
        "--frames", type=_whole(1, MOST["frames"]), default=300, metavar="N", help="frames of each motion (default 300)"
    )
    generate.add_argument("--count", type=_whole(1, MOST["count"]), default=1, metavar="K", help="motions (default 1)")
    generate.add_argument(
        "--seed",
        type=_whole(0, MOST["seed"]),
        default=0,
        metavar="S",
        help="number that chooses the seed motions (default 0)",
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
    _add_device(generate)

    evaluate = add(
        "evaluate",
        _evaluate,
        "measure a checkpoint against real clips",
        "evaluate walk.safetensors --data samples/walking --json walk.json",
    )
    evaluate.add_argument("checkpoint", metavar="CHECKPOINT")
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
    evaluate.add_argument("--count", type=_whole(1, MOST["count"]), default=20, metavar="K", help="seeds (default 20)")
    evaluate.add_argument(
        "--seed", type=_whole(0, MOST["seed"]), default=0, metavar="S", help="chooses them (default 0)"
    )
    _add_device(evaluate)

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
    lines.append(f"  data       {origin.get('data') or 'not told'}, {len(origin.get('clips') or ())} clips")
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


def _load_clips(name: str) -> list[Motion]:
    """A named data set, or motion files of the user's own; sorted by name."""
    from . import data
    from .data.catalog import motion_files, read_clip

    path = pathlib.Path(name)
    if name in data.names() or not path.exists():
        return data.load(name)
    files = motion_files(path) if path.is_dir() else [path]
    if not files:
        raise DataError(f"{name}: the folder holds no motion file, expected .bvh, or .amc with its .asf")
    # named as the catalogue would, folder and file, so that a clip is known again however it was asked for
    root = (path if path.is_dir() else path.parent).resolve().parent
    return [read_clip(file).with_name(file.resolve().relative_to(root).with_suffix("").as_posix()) for file in files]


# --- learning -------------------------------------------------------------------------------------


def _train(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    _use_threads(options)
    from .data.windows import Normalizer, WindowSampler, split_clips
    from .generate import prepare
    from .representations import make_representation
    from .training.checkpoints import load_checkpoint, provenance, read_header
    from .training.systems import make_system, system_kind
    from .training.trainer import Trainer, TrainingConfig, usable_device

    kind = system_kind(options.system)
    usable_device(options.device)
    out = pathlib.Path(options.out)
    defaults = {**TRAIN_DEFAULTS, **kind.options}
    given = {name: getattr(options, name) for name in (*TRAIN_DEFAULTS, *SYSTEM_OPTIONS) if hasattr(options, name)}
    for name in given:
        if name not in defaults:
            raise TutorialError(f"--{name} is not for system {options.system!r}")
    settings = {**defaults, **given}
    if kind.options:
        kind.loss(**{name: settings[name] for name in kind.options})  # raises if they cannot be
    resuming = None
    _check_output(options.out, [options.data])
    if out.exists() and options.resume:
        header = read_header(out)
        if not header["resumable"]:
            if header["training"].get("status") == "finished":
                print(f"{out}: already finished, {header['training'].get('steps_done')} steps")
                return 0
            raise CheckpointError(f"{out}: cannot be resumed, {header['training'].get('status', 'status unknown')}")
        resuming = load_checkpoint(out)
        stored = {**header["training"], **header["model"]}
        settings = {name: stored.get(name, default) for name, default in defaults.items()}
        asked = {**given, "system": options.system, "data": options.data}
        there_all = {**settings, "system": resuming.system, "data": stored.get("data")}
        for name in sorted(asked, key=lambda name: name != "system"):  # another system explains the rest
            value, there = asked[name], there_all[name]
            if value != there:
                raise CheckpointError(
                    f"{out}: holds a run with {name} {there!r}, asked for {value!r}; "
                    f"leave --{name.replace('_', '-')} as it was, or take another --out"
                )
    elif out.exists():
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

    motions = prepare(_load_clips(options.data), height=settings["height"] or None)
    train, test = motions, []
    if settings["test_fraction"] > 0:
        if len(motions) > 1:
            train, test = split_clips(motions, settings["test_fraction"], settings["seed"])
        else:
            print("note: a single clip, trained on whole: nothing is kept out for evaluation", file=sys.stderr)
    if resuming is not None:
        representation, normalizer = resuming.representation, resuming.normalizer
        if [m.name for m in train] != resuming.provenance.get("clips"):
            raise CheckpointError(
                f"{out}: was started on {len(resuming.provenance.get('clips') or ())} clips of "
                f"{options.data}, now there are other ones ({len(train)} to train on)"
            )
    else:
        representation = make_representation(settings["representation"], train[0].skeleton, settings["fps"])
        normalizer = None
    window = {
        "length": settings["length"],
        "batch": settings["batch"],
        "rates": settings["rates"],
        "rotate": settings["rotate"],
    }
    wanted = settings["normalize"] == "on" or (settings["normalize"] == "auto" and representation.name != "positions")
    if wanted and normalizer is None:  # on drawn windows, so that the random turns are in the statistics
        drawn = WindowSampler(train, representation, seed=settings["seed"], **window)
        normalizer = Normalizer.fit(drawn.sample() for _ in range(max(1, 2000 // settings["batch"])))
    batches = WindowSampler(train, representation, normalizer=normalizer, seed=settings["seed"], **window)
    system = make_system(
        options.system, representation.dim, seed=settings["seed"], hidden=settings["hidden"], layers=settings["layers"],
        **{name: settings[name] for name in kind.options},
    )  # fmt: skip
    config = TrainingConfig(**{name: settings[name] for name in ("steps", "learning_rate", "schedule", "clip", "seed")})
    told = ("representation", "fps", "height", "length", "batch", "rates", "rotate", "normalize", "test_fraction")
    trainer = Trainer(
        system, batches, config, path=out, device=options.device, save_seconds=options.save_seconds,
        settings={"data": options.data, **{name: settings[name] for name in told}},
        provenance=provenance(options.data, [m.name for m in train], f"{PROGRAM} {shlex.join(arguments)}",
                              test_clips=[m.name for m in test])
        if resuming is None else resuming.provenance,
    )  # fmt: skip
    seconds = sum(m.duration for m in train)
    print(
        f"{options.data}: {len(train)} clips to train on ({seconds:.0f} s), {len(test)} kept out; "
        f"{representation.name}, {representation.dim} numbers a frame"
    )
    if resuming is not None:
        trainer.resume()
        print(f"{out}: going on after step {trainer.step}")
    trainer.run()
    if not trainer.finished:
        print(
            f"stopped after {trainer.step} of {config.steps} steps, saved in {out}; --resume goes on", file=sys.stderr
        )
        return 130
    print(
        f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB): {trainer.step} steps in {trainer.seconds:.0f} s, "
        f"loss {trainer.loss:.4g}"
    )
    return 0


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
    from .generate import generate
    from .motion.bvh import write_bvh

    _check_named(options.out)
    out = pathlib.Path(options.out)
    _check_folder(out)
    checkpoint = _open(options)
    stem, digits = pathlib.Path(options.checkpoint).stem, max(2, len(str(options.count)))
    names = [f"{stem}-{k:0{digits}d}.bvh" for k in range(1, options.count + 1)]
    source = options.data
    if source is None and checkpoint.seed_frames is None:
        source = checkpoint.provenance.get("data")
    _check_not_input([out / name for name in names], [options.checkpoint, *([source] if source else [])])
    seeds = _seed_clips(checkpoint, options.data)
    made = generate(
        checkpoint,
        options.frames,
        seeds=seeds,
        count=options.count,
        seed=options.seed,
        seed_frames=options.seed_frames,
        progress=True,
    )
    motions = made.motions if options.keep_seed else made.without_seed()
    with _whole_folder(out) as folder:
        for name, motion in zip(names, motions, strict=True):
            write_bvh(motion, folder / name)
    print(f"wrote {len(motions)} files of {len(motions[0])} frames to {options.out}")


def _seed_clips(checkpoint: Checkpoint, name: str | None) -> list[Motion] | None:
    """Clips to cut seeds from, those never trained on if there are any; ``None``: the checkpoint's own seed."""
    from .evaluate import unseen

    if name is None:
        if checkpoint.seed_frames is not None:
            return None
        name = checkpoint.provenance.get("data")
        if not name:
            raise CheckpointError(
                f"{checkpoint.path}: carries no seed and does not say what it was trained on; give --data"
            )
        try:
            clips = _load_clips(name)
        except DataError as error:
            raise DataError(f"seed motions are needed: {error}; or give others with --data") from None
    else:
        clips = _load_clips(name)
    fresh = unseen(checkpoint, clips)
    print(f"seeds from {name}: {len(fresh or clips)} clips {'never ' if fresh else ''}trained on")
    return fresh or clips


def _evaluate(options: argparse.Namespace, _: Sequence[str]) -> None:
    _use_threads(options)
    from .atomic import atomic_write
    from .evaluate import evaluate, summary, unseen

    if options.json is not None:
        _check_output(options.json, [options.checkpoint, options.data])
    checkpoint = _open(options)
    clips = _load_clips(options.data)
    clips = unseen(checkpoint, clips) or clips
    result = evaluate(checkpoint, clips, count=options.count, frames=options.frames, seed=options.seed, progress=True)
    result = {"checkpoint": pathlib.Path(options.checkpoint).name, "data": options.data, **result}
    print("\n".join(summary(result)))
    if options.json is not None:
        with atomic_write(options.json) as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(f"wrote {options.json}")


def _benchmark(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .training.rollout_benchmark import report

    for line in report(options.hidden, threads=options.threads, repeats=options.repeats):
        print(line, flush=True)


def _open(options: argparse.Namespace) -> Checkpoint:
    from .training.checkpoints import load_checkpoint
    from .training.trainer import usable_device

    return load_checkpoint(options.checkpoint, device=usable_device(options.device))


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
