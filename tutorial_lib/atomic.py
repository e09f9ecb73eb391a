"""Files that are either written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import pathlib
import tempfile
from collections.abc import Iterator


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike) -> Iterator[pathlib.Path]:
    """Give a temporary path beside ``path``; move it there when the block ends without an error.

    A reader of ``path`` sees the old file or the new one, never half of one. When the block raises,
    the temporary file is removed and ``path`` stays as it was. The folder is made if it is missing.
    """
    path = pathlib.Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    os.close(handle)
    temporary = pathlib.Path(name)
    try:
        yield temporary
        _give_default_permissions(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _give_default_permissions(path: pathlib.Path) -> None:
    """``mkstemp`` makes files that only their owner reads; a result should be readable as usual."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod(0o666 & ~mask)
