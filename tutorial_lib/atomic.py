"""Files that are either written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import secrets
from collections.abc import Iterator


def check_file(path: str | os.PathLike) -> None:
    """What is in the place of a file to write may only be a regular file; else ``OSError``.

    A pipe or a device would not be written to but replaced, ``/dev/null`` for everybody.
    """
    path = pathlib.Path(path)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "expected a file to write, this is a folder", str(path))
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "expected a regular file to write, this is a pipe or a device", str(path))


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike) -> Iterator[pathlib.Path]:
    """Give a temporary path beside ``path``; move it there when the block ends without an error.

    A reader of ``path`` sees the old file or the new one, never half of one. When the block raises,
    the temporary file is removed and ``path`` stays as it was. The folder is made if it is missing. A link
    stays one: the file that it leads to is replaced.

    Raises ``OSError`` where ``path`` is a folder, a pipe or a device, or cannot be written.
    """
    path = pathlib.Path(path)
    check_file(path)
    if path.is_symlink():
        path = pathlib.Path(os.path.realpath(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    # not by ``mkstemp``, whose files only their owner reads: a result should be readable as usual
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    mode = temporary.stat().st_mode & 0o777
    try:
        yield temporary
        os.chmod(temporary, mode)  # whoever wrote may have put a file of its own there, as safetensors does
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
