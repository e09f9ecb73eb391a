"""``pretrained``: the weights that come with the library."""

from __future__ import annotations

import argparse
import pathlib
from collections.abc import Sequence

from .options import MOST, PROGRAM, add_command, add_device, add_markdown, use_threads, whole
from .outputs import check_folder, check_named, check_not_input


def add(commands) -> None:
    """Add the command."""
    pretrained = add_command(
        commands, "pretrained", None, "list the weights that come with the library, or add some", "pretrained list"
    )
    actions = pretrained.add_subparsers(title="actions", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="all weights: their size, what they learnt from and how well")
    listing.set_defaults(run=_pretrained_list)
    add_markdown(listing)
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
        type=whole(1, MOST["frames"]),
        default=900,
        metavar="N",
        help="frames to generate after each seed when measuring (default 900)",
    )
    publishing.add_argument(
        "--count", type=whole(1, MOST["count"]), default=20, metavar="K", help="seeds when measuring (default 20)"
    )
    add_device(publishing)


def _pretrained_list(options: argparse.Namespace, _: Sequence[str]) -> None:
    from .. import pretrained

    if options.markdown:
        from ..view.tables import markdown_table

        cells = [(f"`{row.name}`", f"{row.megabytes:.1f}", row.summary) for row in pretrained.list()]
        print(markdown_table(("name", "MB", "what it is"), cells, right=(1,)), end="")
        return
    print(pretrained.list())


def _pretrained_publish(options: argparse.Namespace, _: Sequence[str]) -> None:
    use_threads(options)
    from .. import evaluate_control
    from ..evaluate import summary
    from ..pretrained import FOLDER
    from ..pretrained.publish import publish
    from ..training.checkpoints import read_header
    from ..training.systems import SYSTEMS
    from ..training.trainer import usable_device

    folder = pathlib.Path(FOLDER if options.out is None else options.out)
    check_named(str(folder))
    check_folder(folder)
    check_not_input([folder / f"{options.name}.safetensors"], [options.checkpoint])
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
