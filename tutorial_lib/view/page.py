"""What every moving figure shares: HTML that fills itself with a script, and a picture for pages without scripts.

A notebook gets two outputs: the picture first, by itself, since some pages drop HTML outputs whole; then the HTML.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import html
import json
import os
import pathlib
from collections.abc import Sequence
from typing import Any

from ..atomic import atomic_write
from ..errors import TutorialError


class PageOutput:
    """The base of ``Player`` and ``Explorer``: displays itself in a notebook, ``save`` writes a page of its own.

    Subclasses have ``html``, ``png``, ``alt`` (the picture in words) and ``title``, and say by ``picture``
    whether the picture is wanted.
    """

    title: str
    html: str
    png: bytes
    alt: str
    picture: bool = True

    def save(self, path: str | os.PathLike) -> pathlib.Path:
        """Write a page that stands alone, opens from disk and needs nothing else; whole or not at all."""
        path = pathlib.Path(path)
        data = base64.b64encode(self.png).decode() if self.picture else ""
        picture = f'<noscript><img alt="{html.escape(self.alt)}" src="data:image/png;base64,{data}"></noscript>\n'
        page = (
            '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{html.escape(self.title)}</title>\n"
            "<style>:root { color-scheme: light dark } body { margin: 16px; font: 15px system-ui, sans-serif }\n"
            "[data-motion-player], [data-motion-explorer] { display: flow-root }</style>\n"
            f"{picture if data else ''}{self.html}\n</html>\n"
        )
        try:
            with atomic_write(path) as temporary:
                # a title from a file name that is not UTF-8 has characters that cannot be written
                temporary.write_text(page, encoding="utf-8", errors="backslashreplace")
        except OSError as error:
            raise TutorialError(f"{path}: cannot be written: {error.strerror or error}") from error
        return path

    def _ipython_display_(self) -> None:
        from IPython.display import display

        if self.picture:
            data = base64.b64encode(self.png).decode()
            display({"image/png": data, "text/plain": self.alt}, raw=True,
                    metadata={"image/png": {"alt": self.alt}})  # fmt: skip
        display({"text/html": self.html, "text/plain": repr(self)}, raw=True)

    def _repr_html_(self) -> str:
        return self.html


def filled_element(
    kind: str, call: str, spec: dict[str, Any], payload: bytes, *, scripts: Sequence[str], hint: str
) -> str:
    """Self-contained HTML: an element ``data-motion-<kind>`` and the script that fills every copy of it on the page.

    call: the function in ``scripts`` (files beside this one, modules without imports) that is called as
    ``call(element, spec, bytes)`` and leaves its controls in the element's property ``kind``.
    hint: what the element says where no script runs. Neither ids nor ``currentScript`` are used: both break
    when an output stands twice on a page.
    """
    text = json.dumps(spec, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    data = base64.b64encode(payload).decode()
    script = script_of(*scripts)
    key = hashlib.sha256(text.encode() + payload).hexdigest()[:16]
    return (
        f'<div data-motion-{kind}="{key}">{hint}</div>\n<script type="module">\n{script}\n'
        f"for (const el of document.querySelectorAll('[data-motion-{kind}=\"{key}\"]')) {{\n"
        f'if (!el.{kind}) {call}(el, {text}, fromBase64("{data}"));\n}}\n</script>'
    )


@functools.cache
def page_file(*names: str) -> str:
    """Files beside this one, one after another, for the inside of a page: without comment lines and indentation."""
    folder = pathlib.Path(__file__).parent
    lines = [line.strip() for name in names for line in (folder / name).read_text(encoding="utf-8").splitlines()]
    return "\n".join(line for line in lines if line and not line.startswith(("//", "/*")))


def script_of(*names: str) -> str:
    """Scripts beside this one as one module: what each exports is the others' too."""
    return page_file(*names).replace("export function", "function")
