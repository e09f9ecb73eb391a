"""Where a ``reproduce`` command finds its clips: in a folder that was named, or where the catalogue does."""

from __future__ import annotations

import contextlib
import os
import pathlib
from collections.abc import Callable, Iterable, Iterator, Sequence

from .. import data
from ..data.catalog import DATA, data_folder
from ..errors import DataError

UNREADABLE = ("empty folder", "closed folder", "missing")  # of ``Listed.at_hand``: nothing is downloaded instead
# Why a data set needs one clip more than there are parts of it set aside: none, test clips, and validation clips too.
WHY = ("", "one is kept out to be measured on", "rates are chosen on a fifth of them set aside")


@contextlib.contextmanager
def data_from(folder: str | None) -> Iterator[None]:
    """Inside the block, also for processes begun there, data sets are looked for in ``folder`` first."""
    if folder is None:
        yield
        return
    before = os.environ.get(DATA)
    os.environ[DATA] = str(pathlib.Path(folder).expanduser().absolute())
    try:
        yield
    finally:
        if before is None:
            del os.environ[DATA]
        else:
            os.environ[DATA] = before


def check_data(names: Sequence[str], *, of_folder: bool, hint: str, aside: int = 1) -> None:
    """One error for all data sets that are missing, before anything is computed; ``hint``: what else can be asked for.

    A folder that was named must have them all; else what is missing is downloaded, as ever. ``aside``: how many parts
    of each are not trained on, see :data:`WHY`; a data set with too few clips for that is an error, too.
    """
    missing = []
    rows = {name: data.listed(name) for name in names}
    for name in names:
        at_hand, path = rows[name].at_hand, rows[name].path
        if of_folder and at_hand != DATA:
            missing.append(name)
        elif at_hand in UNREADABLE:
            missing.append(f"{name} ({at_hand}: {path})")
        elif at_hand == "to download":
            try:
                data.fetch(name)
            except DataError as error:
                missing.append(f"{name} ({getattr(error, 'reason', '') or error})")
    if missing:
        where = f" in {data_folder()}" if of_folder else ""
        raise DataError(
            f"not at hand{where}: {'; '.join(missing)}; expected motion files for all of {', '.join(names)} ({hint})"
        )
    for name in names:
        found = rows[name].clips
        if found <= aside:
            raise DataError(f"{name}: {found} clip{'s' * (found > 1)}, expected at least {aside + 1}: {WHY[aside]}")


def at_hand(name: str) -> bool:
    """Whether a data set's files are on this machine."""
    return data.listed(name).at_hand not in (*UNREADABLE, "to download")


def samples_stand_in(source: str | None, names: Iterable[str], tell: Callable[[str], None]) -> bool:
    """Whether the sample motions are taken: asked for as ``source``, or told, where none is named and a data set's
    files are not on this machine."""
    if source is not None:
        return source == "samples"
    missing = next((name for name in names if not at_hand(name)), None)
    if missing is not None:
        tell(f"{missing} is not at hand, so the sample motions stand in for it")
    return missing is not None


@contextlib.contextmanager
def clips_from(
    source: str | None, names: Sequence[str], *, samples: bool, hint: str = "--data samples takes the samples",
    aside: int = 1,
) -> Iterator[None]:  # fmt: skip
    """Inside the block the data sets are those of the folder ``source``, if one was named; all are there.

    hint, aside: see :func:`check_data`.
    """
    if source is not None and not samples and not pathlib.Path(source).expanduser().is_dir():
        raise DataError(f"{source}: no such folder, expected one that holds {', '.join(names)} ({hint})")
    with data_from(None if samples else source):
        check_data(names, of_folder=source is not None and not samples, hint=hint, aside=aside)
        yield
