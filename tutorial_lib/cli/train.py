"""``train``: one command for every system."""

from __future__ import annotations

import argparse
import dataclasses
import pathlib
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..errors import CheckpointError, DataError, TutorialError
from ..recipes import DEFAULTS, JOINTS, NORMALIZE, Recipe
from .options import MOST, OWN_DATA, PROGRAM, add_command, add_device, height, number, use_threads, whole
from .outputs import check_output

if TYPE_CHECKING:
    from ..training.trainer import Trainer

# What some systems have besides, with defaults of their own (see training/systems.py).
SYSTEM_OPTIONS = (
    "u", "v", "probability", "decay", "noise", "n_seed", "n_future",
    "deviation", "l1", "filters", "kernel", "pooling", "dropout", "cell", "latent", "cd", "past", "gibbs",
    "stage", "pose_share", "future_share", "temporal", "smooth", "code_deviation", "summary_deviation",
    "code", "velocity_code", "horizon", "future", "current", "summary",
)  # fmt: skip


def add(commands) -> None:
    """Add the command."""
    train = add_command(
        commands,
        "train",
        run,
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
        help=OWN_DATA + "; several are learnt together (hybrid), each giving the same share of the windows",
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
    setting(group, "--fps", "frames a second", type=number(0, most=MOST["fps"]))
    setting(group, "--height", "the skeleton is scaled to so many metres; 0 leaves it", type=height)
    setting(
        group,
        "--length",
        "frames in a training window; of vae-lstm 120, of dynamic-future-net 40",
        type=whole(2, MOST["length"]),
    )
    setting(group, "--batch", "windows in a step", type=whole(1, MOST["batch"]))
    setting(
        group,
        "--rates",
        "frame rates at which windows are also taken, such as 24 30 36 (default: fps)",
        type=number(0, most=MOST["fps"]),
        nargs="+",
        metavar="FPS",
    )
    group.add_argument(
        "--no-rotate", dest="rotate", action="store_false", help="do not turn windows about the vertical at random"
    )
    setting(
        group,
        "--normalize",
        "bring every number to mean 0 and deviation 1; auto: all but positions, which the paper takes in metres "
        "(crbm: positions, too)",
        choices=NORMALIZE,
    )
    setting(
        group,
        "--test-fraction",
        "share of each data set's clips that is kept out for evaluation; 0 trains on all",
        type=number(0, True),
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
        type=number(0, True, most=10),
    )
    group.add_argument(
        "--mirror", action="store_true", help="learn also from every clip's mirror image, left and right exchanged"
    )
    group = train.add_argument_group("network")
    setting(group, "--hidden", "cells a layer; the paper has 1024", type=whole(1, MOST["hidden"]))
    setting(
        group,
        "--layers",
        "recurrent layers (default: erd and dynamic-future-net 2, seq2seq 1, else 3, as in the papers; vae-lstm has "
        "but one, crbm none)",
        type=whole(1, MOST["layers"]),
    )
    group = train.add_argument_group("what the network is fed (the truth, unless said here)")
    group.add_argument(
        "--u", type=whole(1, MOST["length"]), metavar="N", help="aclstm: frames of truth in a row (default 5)"
    )
    group.add_argument(
        "--v", type=whole(1, MOST["length"]), metavar="N", help="aclstm: own outputs in a row (default 5)"
    )
    group.add_argument(
        "--probability",
        type=number(0, True),
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
        type=number(0, True),
        metavar="SD",
        help="aclstm, erd: standard deviation of noise on the truth that is fed; erd reaches it at the end (default 0)",
    )
    group.add_argument(
        "--n-seed",
        type=whole(1, MOST["length"]),
        metavar="N",
        help="seq2seq: frames of truth at the start of a window (default 50)",
    )
    group.add_argument(
        "--n-future",
        type=whole(1, MOST["length"]),
        metavar="N",
        help="seq2seq: frames that it makes from its own output, and is measured on (default 25)",
    )
    group = train.add_argument_group("vae-lstm (the defaults are the paper's where it gives them)")
    for flag, text in (
        ("--filters", "of the first convolution of both encoders (default 64)"),
        ("--kernel", "frames that a convolution sees, odd (default 25)"),
        ("--pooling", "frames that each of the two pooling layers makes one of (default 2)"),
    ):
        group.add_argument(flag, type=whole(1, MOST["hidden"]), metavar="N", help=text)
    for flag, text in (
        ("--dropout", "share of the input numbers left out in training (default 0.1)"),
        ("--deviation", "of the errors that count as noise, in deviations of the data (default 1)"),
        ("--l1", "weight of the mean absolute weight (default 0.1)"),
    ):
        group.add_argument(flag, type=number(0, flag != "--deviation"), metavar="X", help=text)
    group.add_argument("--cell", choices=("modified", "ordinary"), help="the recurrent cell (default modified)")
    group.add_argument("--latent", choices=("per-step", "one"), help="codes of a window in training (default per-step)")
    group = train.add_argument_group("crbm")
    for flag, text in (
        ("--cd", "steps of contrastive divergence (default 1; the VAE-LSTM paper has 1 and 15)"),
        ("--past", "frames that a frame is conditioned on (default 3)"),
        ("--gibbs", "Gibbs steps that make a frame at generation (default 30)"),
    ):
        group.add_argument(flag, type=whole(1, MOST["hidden"]), metavar="N", help=text)
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
        group.add_argument(flag, type=number(0, flag in ("--smooth", "--temporal")), metavar="X", help=text)
    for flag, least, text in (
        ("--code", 2, "numbers of a frame's code (default 16)"),
        ("--velocity-code", 1, "those of them that are for the velocity (default 4)"),
        ("--horizon", 1, "frames of future that are summed up (default 8; the paper has 8 or 16)"),
        ("--summary", 1, "numbers of that summary (default 32)"),
        ("--current", 1, "numbers of the current state (default 16)"),
        ("--future", 0, "numbers of the future state, 0: without one (default 16)"),
    ):
        group.add_argument(flag, type=whole(least, MOST["hidden"]), metavar="N", help=text)
    group = train.add_argument_group("training")
    setting(
        group,
        "--steps",
        "steps of gradient descent; of vae-lstm 1000, of dynamic-future-net 6000",
        type=whole(1, MOST["steps"]),
    )
    setting(group, "--start", "begin with the weights of another run of the same system", metavar="FILE")
    setting(group, "--lr", "learning rate", dest="learning_rate", type=number(0), metavar="RATE")
    setting(group, "--schedule", "of the learning rate", choices=("one-cycle", "constant"))
    setting(group, "--clip", "largest norm of the gradient", type=number(0), metavar="NORM")
    setting(
        group, "--seed", "of weights, batches and the split into training and test clips", type=whole(0, MOST["seed"])
    )
    add_device(train)
    train.add_argument(
        "--save-seconds",
        type=number(0, True),
        default=60.0,
        metavar="S",
        help="save so often what --resume needs (default 60)",
    )


def run(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    use_threads(options)
    from ..training.parallel import joined

    with joined() as workers:  # with the other processes, if torchrun has started some
        trainer = workers.together(lambda: _trainer(options, arguments, workers.device(options.device)))
        return 0 if trainer is None else _finish(trainer)


def _trainer(options: argparse.Namespace, arguments: Sequence[str], device: str) -> Trainer | None:
    """The trainer that is asked for; ``None`` if its run is finished already."""
    from ..recipes import sets_of, trainer_for
    from ..training.systems import system_kind
    from ..training.trainer import usable_device

    kind = system_kind(options.system)
    usable_device(device)
    out = pathlib.Path(options.out)
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(Recipe)
             if hasattr(options, field.name)}  # fmt: skip
    own = {name: getattr(options, name) for name in SYSTEM_OPTIONS if hasattr(options, name)}
    for name in own:
        if name not in kind.options:
            raise TutorialError(f"{_flag(name)} is not for system {options.system!r}")
    resuming = options.resume and out.exists()
    start = None if resuming else given.get("start")  # a run that goes on has read it already
    check_output(options.out, [*options.data, *([start] if start else [])])
    recipe = _recipe_there(out, {**given, **own}) if resuming else Recipe(**given, options=own)
    if recipe is None:
        return None
    if out.exists() and not resuming:
        check_replaceable(out)

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


def _finish(trainer: Trainer) -> int:
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
    """The recipe of the run in ``out``, which must have all that was ``given``; ``None``: that run is finished.

    Raises ``CheckpointError`` for a run of other settings, finished or not, and a file that does not tell them.
    """
    from ..recipes import recipe_in
    from ..training.checkpoints import read_header

    header = read_header(out)
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
    training = header["training"]
    if not header["resumable"] and training.get("status") == "finished":  # only now: it may be of another run
        print(f"{out}: already finished, {training.get('steps_done')} steps")
        return None
    return recipe


def _flag(name: str) -> str:
    """What a setting is called on the command line."""
    return {"learning_rate": "--lr", "system": "SYSTEM"}.get(name, f"--{name.replace('_', '-')}")


def check_replaceable(out: pathlib.Path) -> None:
    """A file in the place of a new checkpoint may only be a finished one."""
    from ..training.checkpoints import read_header

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
