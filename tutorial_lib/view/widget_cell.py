"""What a widget is as the last line of a cell: a picture for pages without a kernel, then the widget itself."""

from __future__ import annotations

import base64
import functools
import html
from typing import Any

from .figure import NotebookFigure


class WidgetCell:
    """A base: its classes have a ``figure``, what it shows in words (``alt``), and ``_static``, told in the widget's
    place where no kernel runs; ``picture``, whether the figure goes before the widget, and ``_shown``, the widget."""

    picture: bool
    figure: NotebookFigure
    alt: str
    _static: str

    @property
    def _shown(self) -> Any:
        raise NotImplementedError

    @functools.cached_property
    def png(self) -> bytes:
        """``figure`` as a PNG file's bytes."""
        return self.figure.png()

    @property
    def html(self) -> str:
        """What a page without a kernel shows in the widget's place."""
        return f"<p><em>{html.escape(self._static)}</em></p>"

    def _display_picture(self) -> None:
        from IPython.display import display

        data = base64.b64encode(self.png).decode()
        metadata = {"image/png": {"alt": self.alt}}
        display({"image/png": data, "text/plain": self.alt}, raw=True, metadata=metadata)

    def _ipython_display_(self) -> None:
        from IPython.display import display

        if self.picture:
            self._display_picture()
        view = {"version_major": 2, "version_minor": 0, "model_id": self._shown.model_id}
        bundle = {"application/vnd.jupyter.widget-view+json": view, "text/html": self.html, "text/plain": repr(self)}
        display(bundle, raw=True)
