"""The command line: ``python -m tutorial_lib info | view | data | train | generate | evaluate``.

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
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130


def _print_error(error: Exception) -> None:
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename is not None else error.strerror
    print(f"error: {' '.join(text.split())}", file=sys.stderr)


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
        type=_whole(0),
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
    train.add_argument("system", metavar="SYSTEM", help="what to train, such as lstm")
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
    setting(group, "--fps", "frames a second", type=_number(0))
    setting(group, "--height", "the skeleton is scaled to so many metres; 0 leaves it", type=_number(0, True))
    setting(group, "--length", "frames in a training window", type=_whole(2))
    setting(group, "--batch", "windows in a step", type=_whole(1))
    setting(
        group,
        "--rates",
        "frame rates at which windows are also taken, such as 24 30 36 (default: fps)",
        type=_number(0),
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
    setting(group, "--hidden", "cells a layer; the paper has 1024", type=_whole(1))
    setting(group, "--layers", "layers", type=_whole(1))
    group = train.add_argument_group("training")
    setting(group, "--steps", "steps of gradient descent", type=_whole(1))
    setting(group, "--lr", "learning rate", dest="learning_rate", type=_number(0), metavar="RATE")
    setting(group, "--schedule", "of the learning rate", choices=("one-cycle", "constant"))
    setting(group, "--clip", "largest norm of the gradient", type=_number(0), metavar="NORM")
    setting(group, "--seed", "of weights, batches and the split into training and test clips", type=_whole(0))
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
        "--frames", type=_whole(1), default=300, metavar="N", help="frames of each motion (default 300)"
    )
    generate.add_argument("--count", type=_whole(1), default=1, metavar="K", help="motions (default 1)")
    generate.add_argument(
        "--seed", type=_whole(0), default=0, metavar="S", help="number that chooses the seed motions (default 0)"
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
        type=_whole(1),
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
        "--frames", type=_whole(1), default=900, metavar="N", help="frames to generate after each seed (default 900)"
    )
    evaluate.add_argument("--count", type=_whole(1), default=20, metavar="K", help="seeds (default 20)")
    evaluate.add_argument("--seed", type=_whole(0), default=0, metavar="S", help="chooses them (default 0)")
    _add_device(evaluate)
    return parser


def _add_device(command: argparse.ArgumentParser) -> None:
    command.add_argument("--device", default="cpu", help="where to compute: cpu (default), cuda, cuda:1, mps, ...")
    command.add_argument("--threads", type=_whole(1), default=None, metavar="N", help="CPU threads to use")


def _whole(least: int):
    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"expected a whole number of {least} or more, not {text!r}")
        return value

    return parse


def _number(least: float, with_it: bool = False):
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (least <= value < float("inf")) or (value == least and not with_it):
            raise argparse.ArgumentTypeError(
                f"expected a number {'of' if with_it else 'above'} {least:g}{' or more' if with_it else ''}, "
                f"not {text!r}"
            )
        return value

    return parse


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
    from .data.catalog import motion_files
    from .motion.files import read_motion

    path = pathlib.Path(name)
    if name in data.names() or not path.exists():
        return data.load(name)
    files = motion_files(path) if path.is_dir() else [path]
    if not files:
        raise DataError(f"{name}: the folder holds no motion file, expected .bvh, or .amc with its .asf")
    root = path if path.is_dir() else path.parent
    return [read_motion(file).with_name(file.relative_to(root).with_suffix("").as_posix()) for file in files]


# --- learning -------------------------------------------------------------------------------------


def _train(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    _use_threads(options)
    from .data.windows import Normalizer, WindowSampler, split_clips
    from .generate import prepare
    from .representations import make_representation
    from .training.checkpoints import load_checkpoint, provenance, read_header
    from .training.systems import make_system, system_kind
    from .training.trainer import Trainer, TrainingConfig, usable_device

    system_kind(options.system)
    usable_device(options.device)
    out = pathlib.Path(options.out)
    given = {name: getattr(options, name) for name in TRAIN_DEFAULTS if hasattr(options, name)}
    settings = {**TRAIN_DEFAULTS, **given}
    resuming = None
    _check_writable(out)
    if out.exists() and options.resume:
        header = read_header(out)
        if not header["resumable"]:
            if header["training"].get("status") == "finished":
                print(f"{out}: already finished, {header['training'].get('steps_done')} steps")
                return 0
            raise CheckpointError(f"{out}: cannot be resumed, {header['training'].get('status', 'status unknown')}")
        resuming = load_checkpoint(out)
        stored = {**header["training"], **header["model"]}
        settings = {name: stored.get(name, default) for name, default in TRAIN_DEFAULTS.items()}
        asked = {**given, "system": options.system, "data": options.data}
        for name, value in asked.items():
            there = {**settings, "system": resuming.system, "data": stored.get("data")}[name]
            if value != there:
                raise CheckpointError(
                    f"{out}: holds a run with {name} {there!r}, asked for {value!r}; "
                    f"leave --{name.replace('_', '-')} as it was, or take another --out"
                )
    elif out.exists():
        with contextlib.suppress(CheckpointError):  # whatever else lies there is replaced, as by any command
            header = read_header(out)
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
        options.system, representation.dim, seed=settings["seed"], hidden=settings["hidden"], layers=settings["layers"]
    )
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


def _check_writable(path: pathlib.Path) -> None:
    """A result that cannot be written is told before the work, not after it."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "expected a file to write, this is a folder", str(path))
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected a folder, this is a file", str(folder))
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, "the folder cannot be written to", str(folder))


def _generate(options: argparse.Namespace, _: Sequence[str]) -> None:
    _use_threads(options)
    from .generate import generate
    from .motion.bvh import write_bvh

    checkpoint = _open(options)
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
    stem = pathlib.Path(options.checkpoint).stem
    digits = max(2, len(str(len(motions))))
    with _whole_folder(options.out) as folder:
        for k, motion in enumerate(motions, start=1):
            write_bvh(motion, folder / f"{stem}-{k:0{digits}d}.bvh")
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

    if options.json:
        _check_writable(pathlib.Path(options.json))
    checkpoint = _open(options)
    clips = _load_clips(options.data)
    clips = unseen(checkpoint, clips) or clips
    result = evaluate(checkpoint, clips, count=options.count, frames=options.frames, seed=options.seed, progress=True)
    result = {"checkpoint": pathlib.Path(options.checkpoint).name, "data": options.data, **result}
    print("\n".join(summary(result)))
    if options.json:
        with atomic_write(options.json) as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(f"wrote {options.json}")


def _open(options: argparse.Namespace) -> Checkpoint:
    from .training.checkpoints import load_checkpoint
    from .training.trainer import usable_device

    return load_checkpoint(options.checkpoint, device=usable_device(options.device))


def _use_threads(options: argparse.Namespace) -> None:
    if options.threads is not None:
        import torch

        torch.set_num_threads(options.threads)


@contextlib.contextmanager
def _whole_folder(folder: str | os.PathLike) -> Iterator[pathlib.Path]:
    """A temporary folder whose files move to ``folder`` when the block ends without an error, else vanish."""
    folder = pathlib.Path(folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected a folder, this is a file", str(folder))
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = pathlib.Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield temporary
        folder.mkdir(exist_ok=True)
        for file in sorted(temporary.iterdir()):
            os.replace(file, folder / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
