"""Files that are either written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import pathlib
import secrets
from collections.abc import Iterator


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike) -> Iterator[pathlib.Path]:
    """Give a temporary path beside ``path``; move it there when the block ends without an error.

    A reader of ``path`` sees the old file or the new one, never half of one. When the block raises,
    the temporary file is removed and ``path`` stays as it was. The folder is made if it is missing.
    """
    path = pathlib.Path(path)
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
