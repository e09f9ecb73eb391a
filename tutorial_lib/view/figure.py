"""A matplotlib figure that a notebook shows by itself, without pyplot, a backend or any global state."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A ``Figure`` with a picture of its own for Jupyter; small, since lessons are kept under 1 MB."""

    def _repr_png_(self) -> bytes:
        from PIL import Image

        raw, small = io.BytesIO(), io.BytesIO()
        self.savefig(raw, format="png", dpi=100)
        Image.open(raw).convert("RGB").quantize(96).save(small, "PNG", optimize=True)
        return small.getvalue()
