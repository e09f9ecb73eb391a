"""``reproduce``, ``results`` and ``benchmark``: the papers' tables and figures, and how fast the library is."""

from __future__ import annotations

import argparse
import pathlib
from collections.abc import Sequence
from typing import Any

from .options import MOST, PROGRAM, add_command, whole
from .outputs import check_folder, check_named, check_output, tell


def add(commands) -> None:
    """Add the commands."""
    reproduce = add_command(
        commands, "reproduce", None, "rebuild a paper's tables and figures", "reproduce acrnn --data samples --quick"
    )
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
            type=whole(least, MOST[size]),
            metavar="N",
            help="of every run, instead of the paper's stand-in",
        )
    acrnn.add_argument("--mirror", action="store_true", default=None, help="learn from every clip's mirror image too")
    acrnn.add_argument("--grid", action="store_true", help="also u and v that differ, for the explorer")
    acrnn.add_argument("--long", action="store_true", help="also samples of 18,000 frames, and of the weights shipped")
    acrnn.add_argument("--shipped", metavar="FILE", help="only the weights shipped, anew, in this acrnn.json")

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
        type=whole(1, MOST["steps"]),
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
        type=whole(3, MOST["steps"]),
        metavar="N",
        help="of a network of one action (default 2400); one of all four has three times as many",
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
    steps = "of training, of which each system takes its share (default 4000)"
    for size, what in (("steps", steps), ("hidden", "cells a layer (default 64)")):
        every.add_argument(f"--{size}", type=whole(10 if size == "steps" else 1, MOST[size]), metavar="N", help=what)
    for paper in (acrnn, vae, future, every):
        _add_reproduce(paper, tunes=paper in (acrnn, vae), seeded=paper is not future)

    results = add_command(
        commands, "results", _results, "show the papers' tables beside ours, as they come with the library", "results"
    )
    results.add_argument(
        "paper",
        metavar="PAPER",
        nargs="?",
        help="all tables and findings of this one, as reproduce tells them (default: a few lines of each, in Markdown)",
    )

    benchmark = add_command(
        commands,
        "benchmark",
        _benchmark,
        "measure how fast the library is against the plain way of doing the same",
        "benchmark rollout --hidden 128",
    )
    benchmark.add_argument("what", choices=("rollout",), help="rollout: training and synthesis of an LSTM")
    benchmark.add_argument(
        "--hidden",
        type=whole(1, MOST["hidden"]),
        default=128,
        metavar="N",
        help="cells a layer, in training (default 128)",
    )
    benchmark.add_argument(
        "--threads", type=whole(1, MOST["threads"]), default=2, metavar="N", help="CPU threads to use (default 2)"
    )
    benchmark.add_argument(
        "--repeats",
        type=whole(1, MOST["repeats"]),
        default=9,
        metavar="N",
        help="turns, of which the median is told (default 9)",
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
        type=whole(1, MOST["threads"]),
        default=2,
        metavar="N",
        help="runs trained side by side, each with one thread (default 2)",
    )
    if seeded:
        paper.add_argument(
            "--seeds", type=whole(0, MOST["seed"]), nargs="+", default=[0], metavar="S", help="of training (default 0)"
        )
    if tunes:
        paper.add_argument("--tune", action="store_true", help="first choose the learning rates, on validation clips")
    paper.add_argument("--no-train", action="store_true", help="measure the runs that are finished, and train none")
    paper.add_argument("--quick", action="store_true", help="a trial with tiny networks and few steps")


def _reproduce_acrnn(options: argparse.Namespace, _: Sequence[str]) -> None:
    from ..reproduce.acrnn import measure_shipped, reproduce

    if options.shipped is not None:
        check_output(options.shipped, ())
        measure_shipped(options.shipped, options.data, jobs=options.jobs)
        return
    common = _reproduction(options, "steps", "hidden", "batch", "length", "mirror")
    reproduce(
        options.data, styles=options.styles, seeds=options.seeds, grid=options.grid, long=options.long,
        tuning=options.tune, **common,
    )  # fmt: skip


def _reproduce_vae_lstm(options: argparse.Namespace, _: Sequence[str]) -> None:
    from ..reproduce.vae_lstm import reproduce

    reproduce(options.data, seeds=options.seeds, tuning=options.tune, **_reproduction(options, "steps"))


def _reproduce_dynamic_future_net(options: argparse.Namespace, _: Sequence[str]) -> None:
    from ..reproduce.dynamic_future_net import reproduce

    reproduce(options.data, **_reproduction(options, "steps"))


def _reproduce_side_by_side(options: argparse.Namespace, _: Sequence[str]) -> None:
    from ..reproduce.side_by_side import reproduce

    reproduce(options.data, seeds=options.seeds, **_reproduction(options, "steps", "hidden"))


def _reproduction(options: argparse.Namespace, *sizes: str) -> dict[str, Any]:
    """What all of them are told; ``sizes``: of the budget, as far as they were given."""
    for folder in (options.runs, options.out):
        if folder is not None:
            check_named(folder)
            check_folder(pathlib.Path(folder))
    return {
        "runs": options.runs,
        "out": options.out,
        "jobs": options.jobs,
        "train_missing": not options.no_train,
        "quick": options.quick,
        "budget": {name: getattr(options, name) for name in sizes if getattr(options, name) is not None},
        "tell": tell,
    }


def _results(options: argparse.Namespace, _: Sequence[str]) -> None:
    from ..reproduce.shipped import full, short

    if options.paper is not None:
        print("\n".join(full(options.paper)))
        return
    print("\n".join(f"{table.caption}\n\n{table.markdown()}" for table in short()), end="")


def _benchmark(options: argparse.Namespace, _: Sequence[str]) -> None:
    from ..training.rollout_benchmark import report

    for line in report(options.hidden, threads=options.threads, repeats=options.repeats):
        tell(line)
