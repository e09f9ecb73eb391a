"""``generate``, ``walk`` and ``evaluate``: motions from weights, and how good they are."""

from __future__ import annotations

import argparse
import contextlib
import json
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import CheckpointError, DataError, TutorialError
from .options import MOST, OWN_DATA, add_command, add_device, add_weights, number, open_weights, use_threads, whole
from .outputs import check_folder, check_named, check_output, check_outputs, whole_folder

if TYPE_CHECKING:
    import numpy as np

    from ..motion.clip import Motion
    from ..training.checkpoints import Checkpoint


def add(commands) -> None:
    """Add the commands."""
    generate = add_command(
        commands,
        "generate",
        _generate,
        "let a checkpoint make motions, as BVH files",
        "generate walk.safetensors --frames 900 --count 4 --seed 1 -o made",
    )
    add_weights(generate)
    generate.add_argument(
        "--frames", type=whole(1, MOST["frames"]), default=300, metavar="N", help="frames of each motion (default 300)"
    )
    generate.add_argument("--count", type=whole(1, MOST["count"]), default=1, metavar="K", help="motions (default 1)")
    generate.add_argument(
        "--seed",
        type=whole(0, MOST["seed"]),
        default=0,
        metavar="S",
        help="number that chooses the seed motions, and all chance (default 0)",
    )
    generate.add_argument(
        "--temperature",
        type=number(0, True),
        metavar="T",
        help="dynamic-future-net: how much chance there is; 0: none (default 1, as it was learnt)",
    )
    generate.add_argument(
        "--noise",
        type=number(0, True),
        metavar="D",
        help="networks that predict the next frame: disturb what they read of their own output by this deviation, so "
        "that they do not go round in a loop; as much as in their training, such as 0.03 (default 0, as in the paper)",
    )
    generate.add_argument("-o", "--out", required=True, metavar="DIR", help="folder for the files")
    generate.add_argument(
        "--data",
        metavar="NAME",
        help=f"where seed motions are cut from: {OWN_DATA}; by default "
        "what the checkpoint carries, else the data set that it was trained on",
    )
    generate.add_argument(
        "--seed-frames",
        type=whole(1, MOST["frames"]),
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
    add_device(generate)

    walk = add_command(
        commands,
        "walk",
        _walk,
        "let a network that follows control walk a path, as BVH files or as a page",
        'walk --pretrained vae-lstm-samples --path "figure of eight" --pace 1.3 --count 3 -o walkers.html',
    )
    add_weights(walk)
    walk.add_argument(
        "--path",
        required=True,
        metavar="PATH",
        help="circle, figure of eight, zigzag, or a file of points: a line each, x and z in metres",
    )
    walk.add_argument(
        "--pace", type=number(0), default=1.3, metavar="M/S", help="metres a second, where the path is straight"
        " (default 1.3)",
    )  # fmt: skip
    walk.add_argument("--count", type=whole(1, MOST["count"]), default=1, metavar="K", help="people (default 1)")
    walk.add_argument("--seed", type=whole(0, MOST["seed"]), default=0, metavar="S", help="who they are (default 0)")
    walk.add_argument("--rest", action="store_true", help="begin and end standing")
    walk.add_argument("--raw", action="store_true", help="as the network gave it: feet are not planted")
    walk.add_argument(
        "-o", "--out", required=True, metavar="OUT", help="folder for BVH files, or a page to play (PAGE.html)"
    )
    add_device(walk)

    evaluate = add_command(
        commands,
        "evaluate",
        _evaluate,
        "measure a checkpoint against real clips",
        "evaluate walk.safetensors --data samples/walking --json walk.json",
    )
    add_weights(evaluate)
    evaluate.add_argument(
        "--data",
        required=True,
        metavar="NAME",
        help=OWN_DATA + "; clips that it was trained on are left out if there are others",
    )
    evaluate.add_argument("--json", metavar="FILE", help="write all measures there")
    evaluate.add_argument(
        "--frames",
        type=whole(1, MOST["frames"]),
        metavar="N",
        help="frames to generate after each seed (default 900); not for a network that follows control, whose paths "
        "say how many",
    )
    evaluate.add_argument(
        "--count",
        type=whole(1, MOST["count"]),
        metavar="K",
        help="seeds (default 20); of a network that follows control, people on each path (default 4)",
    )
    evaluate.add_argument(
        "--seed", type=whole(0, MOST["seed"]), default=0, metavar="S", help="chooses them (default 0)"
    )
    add_device(evaluate)


def _generate(options: argparse.Namespace, _: Sequence[str]) -> None:
    use_threads(options)
    from ..cleanup import clean_up, legs
    from ..generate import check_predicts, choose_seeds, generate_each
    from ..generate_futures import generate_futures
    from ..motion.bvh import write_bvh
    from ..training.progress import Progress
    from ..training.systems import SYSTEMS

    check_named(options.out)
    out = pathlib.Path(options.out)
    check_folder(out)
    checkpoint = open_weights(options)
    check_predicts(checkpoint)
    stem, digits = checkpoint.path.stem, max(2, len(str(options.count)))
    names = [f"{stem}-{k:0{digits}d}.bvh" for k in range(1, options.count + 1)]
    sources = [] if options.data is None else [options.data]
    if options.data is None and checkpoint.seed_frames is None:
        sources = _data_of(checkpoint)
    check_outputs([out / name for name in names], [str(checkpoint.path), *sources])
    if options.clean and checkpoint.representation is not None:
        legs(checkpoint.representation.skeleton)  # an unknown one is told before the work
    seeds = _seed_clips(checkpoint, sources)
    chosen = {"count": options.count, "seed": options.seed}
    if SYSTEMS[checkpoint.system].futures:
        if options.noise is not None:
            raise TutorialError(f"--noise is not for system {checkpoint.system!r}, which has a --temperature")
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
            checkpoint, options.frames, seeds=seeds, seed_frames=options.seed_frames, noise=options.noise or 0.0,
            progress=True, **chosen,
        )  # fmt: skip
    bar = Progress(options.count, unit="file", title="writing")
    with whole_folder(out) as folder, contextlib.closing(bar):
        for name, motion in zip(names, made, strict=True):  # each is written as it comes: few are ever in memory
            motion = clean_up(motion) if options.clean else motion
            motion = motion if options.keep_seed else motion[options.seed_frames :]
            write_bvh(motion, folder / name)
            bar.update()
    print(f"wrote {len(names)} files of {len(motion)} frames to {options.out}")


def _walk(options: argparse.Namespace, _: Sequence[str]) -> None:
    use_threads(options)
    from ..control import path_deviation
    from ..motion.bvh import write_bvh
    from ..walk import walk

    check_named(options.out)
    out, files = pathlib.Path(options.out), [options.path] if pathlib.Path(options.path).is_file() else []
    page = out.suffix.lower() in (".html", ".htm")
    if page:
        check_output(options.out, files)
    else:
        check_folder(out)
    path = _path_of(options.path)
    checkpoint = open_weights(options)
    digits = max(2, len(str(options.count)))
    names = [f"walk-{k:0{digits}d}.bvh" for k in range(1, options.count + 1)]
    check_outputs([out] if page else [out / name for name in names], [str(checkpoint.path), *files])
    motions = walk(
        checkpoint, path, options.pace, count=options.count, seed=options.seed, clean=not options.raw,
        rest=options.rest, progress=options.count > 1,
    )  # fmt: skip
    away = [path_deviation(motion, path) for motion in motions]
    if page:
        from ..view import show

        show(motions).save(out)
    else:
        with whole_folder(out) as folder:
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
    from ..motion.ground import prepared_path, read_path

    if pathlib.Path(name).is_file():
        return read_path(name)
    try:
        return prepared_path(name)
    except TutorialError as error:
        raise DataError(f"{error}, or a file of points, x and z in metres, a line each") from None


def _data_of(checkpoint: Checkpoint) -> list[str]:
    """The data sets that a checkpoint was trained on."""
    from ..pretrained import data_names

    return list(data_names(checkpoint.provenance.get("data")))


def _seed_clips(checkpoint: Checkpoint, names: Sequence[str]) -> list[Motion] | None:
    """Clips to cut seeds from, those never trained on if there are any; ``None``: the checkpoint's own seed."""
    from ..evaluate import unseen
    from ..recipes import load_clips

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
    use_threads(options)
    from .. import evaluate_control
    from ..atomic import atomic_write
    from ..evaluate import evaluate, summary, unseen
    from ..recipes import load_clips
    from ..training.systems import SYSTEMS

    if options.json is not None:
        inputs = [options.data] if options.checkpoint is None else [options.checkpoint, options.data]
        check_output(options.json, inputs)
    checkpoint = open_weights(options)
    clips = load_clips(options.data)
    clips = unseen(checkpoint, clips) or clips
    if SYSTEMS[checkpoint.system].controlled:
        if options.frames is not None:
            raise TutorialError(f"--frames is not for system {checkpoint.system!r}, which walks its paths to the end")
        count = 4 if options.count is None else options.count
        result = evaluate_control.evaluate_control(checkpoint, clips, count=count, seed=options.seed)
        lines = evaluate_control.summary(result)
    else:
        count = 20 if options.count is None else options.count
        frames = 900 if options.frames is None else options.frames
        result = evaluate(checkpoint, clips, count=count, frames=frames, seed=options.seed, progress=True)
        lines = summary(result)
    result = {"checkpoint": checkpoint.path.name, "data": options.data, **result}
    print("\n".join(lines))
    if options.json is not None:
        with atomic_write(options.json) as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(f"wrote {options.json}")
