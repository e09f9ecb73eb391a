"""The README's tables from the commands that print them: ``python docs/tables.py`` writes them anew.

A table stands between ``<!-- table: python -m tutorial_lib pretrained list --markdown -->`` and ``<!-- end -->``.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import pathlib
import re
import shlex

from tutorial_lib.atomic import atomic_write
from tutorial_lib.cli import main

README = pathlib.Path(__file__).resolve().parents[1] / "README.md"
TABLE = re.compile(r"(<!-- table: python -m tutorial_lib (.+?) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def printed(command: str) -> str:
    """What ``python -m tutorial_lib COMMAND`` prints, on a machine without data of its own."""
    text, before = io.StringIO(), os.environ.pop("TUTORIAL_DATA", None)
    try:
        with contextlib.redirect_stdout(text):
            status = main(shlex.split(command))
    finally:
        if before is not None:
            os.environ["TUTORIAL_DATA"] = before
    if status:
        raise SystemExit(f"python -m tutorial_lib {command} ended with status {status}")
    return text.getvalue()


def renewed(text: str) -> str:
    """A README with every table as its command prints it now."""
    return TABLE.sub(lambda found: f"{found[1]}{printed(found[2]).rstrip()}\n{found[4]}", text)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    with atomic_write(README) as temporary:
        temporary.write_text(renewed(README.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"wrote the tables of {README}")
