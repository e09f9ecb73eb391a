"""``info``, ``view`` and ``data``: motion files, checkpoints and the named data sets."""

from __future__ import annotations

import argparse
import os
import pathlib
import sys
from collections.abc import Sequence

from ..errors import TutorialError
from .options import MOST, PROGRAM, add_command, add_markdown, whole
from .outputs import check_output, print_error


def add(commands) -> None:
    """Add the commands."""
    info = add_command(
        commands, "info", _info, "tell what motion files or checkpoints hold", "info data_samples/walking/*.bvh"
    )
    info.add_argument("files", nargs="+", metavar="FILE", help=".bvh, .amc or .safetensors")

    view = add_command(
        commands,
        "view",
        _view,
        "write a page that plays motion files side by side",
        "view walk.bvh run.bvh -o page.html",
    )
    view.add_argument("files", nargs="+", metavar="FILE", help=".bvh or .amc")
    view.add_argument("-o", "--out", required=True, metavar="PAGE.html", help="the page to write")
    view.add_argument("--overlay", action="store_true", help="all on one spot instead of side by side")
    view.add_argument(
        "--seed-frames",
        type=whole(0, MOST["frames"]),
        default=0,
        metavar="N",
        help="so many first frames were given to a network: another colour",
    )

    data = add_command(commands, "data", None, "list, fetch and find the named data sets", "data list")
    actions = data.add_subparsers(title="actions", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="all data sets, where they are and under which licence")
    listing.set_defaults(run=_data_list)
    add_markdown(listing)
    fetch = actions.add_parser(
        "fetch", help="download data sets into the cache", epilog=f"example: {PROGRAM} data fetch cmu/martial"
    )
    fetch.add_argument("names", nargs="+", metavar="NAME")
    fetch.set_defaults(run=_data_fetch)
    where = actions.add_parser("where", help="the folder that a data set is read from")
    where.add_argument("names", nargs="+", metavar="NAME")
    where.set_defaults(run=_data_where)


def _info(options: argparse.Namespace, _: Sequence[str]) -> int:
    from ..motion.files import SUFFIXES, file_info

    status = 0
    for path in options.files:
        suffix = pathlib.Path(path).suffix.lower()
        try:
            if suffix == ".safetensors":
                lines = _checkpoint_lines(path)
            elif os.path.isdir(path):
                raise TutorialError(f"{path}: this is a folder, expected files")
            elif os.path.exists(path) and suffix not in SUFFIXES:
                raise TutorialError(f"{path}: suffix {suffix!r}, expected one of {', '.join(SUFFIXES)}, .safetensors")
            else:
                lines = file_info(path).lines()
            print("\n".join(lines))
        except (TutorialError, OSError) as error:  # the other files are still told
            if isinstance(error, BrokenPipeError):
                raise
            sys.stdout.flush()
            print_error(error)
            status = 2
    return status


def _checkpoint_lines(path: str) -> list[str]:
    from ..pretrained import data_names
    from ..training.checkpoints import load_checkpoint

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
    from ..motion.files import read_motion
    from ..view import show

    check_output(options.out, options.files)
    motions = [read_motion(path) for path in options.files]
    labels = _labels(options.files)
    player = show(motions, labels=labels, overlay=options.overlay, seed_frames=options.seed_frames)
    path = player.save(options.out)
    print(f"wrote {path} ({path.stat().st_size / 1e6:.2f} MB)")


def _labels(files: Sequence[str]) -> list[str]:
    """Each file's name without its suffix, after its folder's where two have the same one: ``a/01`` and ``b/01``."""
    paths = [pathlib.Path(os.path.abspath(file)) for file in files]  # absolute: a folder has a name in "../01.bvh", too
    stems = [path.stem for path in paths]
    return [
        stem if stems.count(stem) == 1 else f"{path.parent.name}/{stem}"
        for path, stem in zip(paths, stems, strict=True)
    ]


def _data_list(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .. import data

    def number(value: float | None, form: str) -> str:
        return "" if value is None else format(value, form)

    if options.markdown:
        from ..view.tables import markdown_table

        sets = [data.entry(name) for name in data.names()]  # as published, whatever is at hand
        here = {row.name: row.clips for row in data.listing()}  # the samples are published nowhere else
        cells = [(f"`{row.name}`", row.clips or here[row.name], row.title, row.licence) for row in sets]
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
    from .. import data
    from ..data.catalog import DATA

    for name in options.names:
        data.entry(name)  # an unknown name is told before anything is downloaded
    for name in options.names:
        row = data.listed(name)
        told = f"{row.path} (from {DATA}, nothing to fetch)" if row.at_hand == DATA else data.fetch(name)
        print(f"{name}: {told}")


def _data_where(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .. import data

    for name in options.names:
        print(data.where(name))
        if data.listed(name).at_hand == "to download":  # its folder may be there, empty, from a fetch that failed
            print(f"note: {name} is not at hand yet; data fetch {name} fills that folder", file=sys.stderr)
