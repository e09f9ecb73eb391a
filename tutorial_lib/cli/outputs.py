"""What a command writes: told before the work if it cannot be, written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence

from ..atomic import check_file
from ..errors import MotionError, TutorialError


def check_output(name: str, inputs: Sequence[str]) -> None:
    """A file that cannot be written, or that is one of the inputs, is told before the work, not after it."""
    check_named(name)
    path = pathlib.Path(name)
    check_outputs([path], inputs)
    check_folder(pathlib.Path(os.path.realpath(path)).parent)  # of a link, where it leads to


def check_named(name: str) -> None:
    if not name.strip():
        raise TutorialError("the output has an empty name, expected a path to write to")


def check_folder(folder: pathlib.Path) -> None:
    """That files can be made in ``folder``, or the folder itself if it is not there."""
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "expected a folder, this is a file", str(there))
    if not os.access(there, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "the folder cannot be written to", str(there))


def check_outputs(outputs: Sequence[pathlib.Path], inputs: Sequence[str]) -> None:
    """That none of the files to write is a folder, a pipe or a device, or one of the inputs."""
    for path in outputs:
        check_file(path)
    check_not_input(outputs, inputs)


def check_not_input(outputs: Sequence[pathlib.Path], inputs: Sequence[str]) -> None:
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
    from .. import data
    from ..data.catalog import files_below
    from ..motion.files import SUFFIXES

    path = pathlib.Path(data.where(name) if name in data.names() else name)
    if path.is_dir():
        return [file for file in files_below(path) if file.suffix.lower() in (*SUFFIXES, ".asf")]
    skeletons = path.parent.glob("*.asf") if path.suffix.lower() == ".amc" else ()
    return [file for file in (path, *skeletons) if file.is_file()]


@contextlib.contextmanager
def whole_folder(folder: pathlib.Path) -> Iterator[pathlib.Path]:
    """A temporary folder whose files move to ``folder`` when the block ends without an error, else vanish.

    An ``OSError`` or ``MotionError`` names ``folder``, for the temporary one means nothing to a user.
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
    except MotionError as error:  # as ``write_bvh`` tells that a file cannot be written
        if temporary is None or str(temporary) not in str(error):
            raise
        raise MotionError(str(error).replace(str(temporary), str(folder))) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def print_error(error: Exception) -> None:
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename is not None else error.strerror
    print(f"error: {' '.join(text.split())}", file=sys.stderr)


def tell(line: str) -> None:
    print(line, flush=True)
