"""``python -m tutorial_lib.data.synthetic``: write the sample clips, or measure how fast they are made."""

from __future__ import annotations

import argparse

from ...errors import TutorialError
from .samples import benchmark, make_samples


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tutorial_lib.data.synthetic", description=__doc__)
    parser.add_argument("--out", metavar="FOLDER", help="write the clips into this folder")
    parser.add_argument("--benchmark", action="store_true", help="print how much faster than real time")
    options = parser.parse_args(arguments)
    if not (options.out or options.benchmark):
        parser.error("expected --out FOLDER or --benchmark")
    if options.out:
        try:
            paths = make_samples(options.out)
        except (TutorialError, OSError) as error:
            parser.exit(2, f"error: {error}\n")
        size = sum(path.stat().st_size for path in paths)
        print(f"{len(paths)} clips, {size / 1e6:.1f} MB, in {options.out}")
    if options.benchmark:
        for style, factor in benchmark().items():
            print(f"{style}: {factor:.0f} times faster than real time")


if __name__ == "__main__":
    main()
