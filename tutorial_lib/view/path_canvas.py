"""``PathCanvas``: draw a path along the ground with mouse, pen, finger or keys, and Python hears of it.

Needs a live kernel, through anywidget; the page part is ``path_canvas.js``. Before it goes a picture of the prepared
paths, for pages in which nobody can draw (the canvas hides it where it runs).
"""

from __future__ import annotations

import base64
import functools
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import MotionError, TutorialError
from ..motion.clip import Motion
from ..motion.ground import PREPARED, check_path, path_length, prepared_path
from . import palette
from .figure import NotebookFigure
from .page import page_file, script_of
from .path_plot import draw_path, ground_of
from .widget_cell import WidgetCell

_STATIC = "Drawing needs a live kernel: run this cell in Jupyter. Until then the prepared paths serve, by their names."
_MOST = 600  # places of a walked way that are sent to the page


class PathCanvas(WidgetCell):
    """A canvas that is the last line of a cell; ``path`` and ``pace`` are what the reader drew and chose.

    path: points ``(N, 2)`` of x and z in metres to begin with, or the name of a prepared path ("circle", "figure of
        eight", "zigzag"). So there is a path for code that follows also where nobody draws.
    pace: m/s, within ``paces``, the ends of its slider.
    metres: of ground across the canvas, at least; width, height: pixels of the page.
    picture: put the picture of the prepared paths before it.
    Raises ``MotionError`` for no path, ``TutorialError`` for other choices that cannot be.

    ::

        canvas = PathCanvas("circle")

        @canvas.on_path
        def walk(path, pace):
            control = control_from_path(path, pace, fps)
            ...
            canvas.show_walked(motion)
            return show(motion)
    """

    _static = _STATIC

    def __init__(
        self,
        path: str | Sequence = "figure of eight",
        pace: float = 1.3,
        *,
        paces: tuple[float, float] = (0.5, 3.5),
        metres: float = 12.0,
        title: str = "Draw a path, choose a pace",
        width: int = 720,
        height: int = 400,
        picture: bool = True,
    ):
        low, high = _numbers(paces, 2, "paces")
        if not 0 < low < high:
            raise TutorialError(f"path canvas: paces {low:g} to {high:g} m/s, expected two numbers above zero, rising")
        if not (_numbers([metres, width, height], 3, "sizes") >= (1, 200, 100)).all():
            raise TutorialError(
                f"path canvas: {metres} m, {width} x {height} pixels, expected 1 m and 200 x 100 or more"
            )
        self.title, self.picture, self._paces = title, picture, (low, high)
        self._functions: list[Callable[[np.ndarray, float], Any]] = []
        first, pace = self._checked(path), self._checked_pace(pace)
        from ipywidgets import Layout, Output, VBox

        self.widget = _widget_class()(
            path=first,
            pace=pace,
            spec={
                "title": title,
                "width": int(width),
                "height": int(height),
                "metres": float(metres),
                "paces": [low, high],
                "style": page_file("controls.css", "path_canvas.css"),
                "prepared": [[name, _plain(make())] for name, make in PREPARED.items()],
            },
        )
        self._below = Output()
        self._box = VBox([self.widget, self._below], layout=Layout(overflow="visible"))
        self.widget.observe(self._heard, ["path", "pace"])

    # what was drawn

    @property
    def path(self) -> np.ndarray:
        """The path ``(N, 2)``: x and z in metres; ``(0, 2)`` when it has been cleared. Can be set, also by name."""
        return np.array(self.widget.path, dtype=float).reshape(-1, 2)

    @path.setter
    def path(self, path: str | Sequence) -> None:
        self.widget.path = self._checked(path)

    @property
    def pace(self) -> float:
        """The pace chosen, m/s. Can be set."""
        return float(self.widget.pace)

    @pace.setter
    def pace(self, pace: float) -> None:
        self.widget.pace = self._checked_pace(pace)

    def on_path(self, function: Callable[[np.ndarray, float], Any]) -> Callable[[np.ndarray, float], Any]:
        """Call ``function(path, pace)`` whenever another path or pace arrives; also a decorator.

        What it returns is shown below the canvas, in place of what was there. A warning or a ``TutorialError`` is told
        in the canvas as one line; other errors are shown below. Returns the function.
        """
        if not callable(function):
            raise TutorialError(
                f"path canvas: on_path of {type(function).__name__}, expected a function of path and pace"
            )
        self._functions.append(function)
        return function

    def show_walked(self, way: Motion | np.ndarray, note: str = "") -> None:
        """Draw where a motion's root, or places ``(T, 2)`` or ``(T, 3)``, went; ``note`` is written below it.

        It goes when another path is drawn.
        """
        place = ground_of(way)
        self.widget.walked = _plain(place[np.unique(np.linspace(0, len(place) - 1, _MOST).round().astype(int))])
        if note:
            self.widget.note = str(note)

    def _heard(self, _change: Any) -> None:
        widget = self.widget
        widget.note, widget.walked = "", []
        if not self._functions or not widget.path:
            return
        widget.busy = True
        try:
            path, pace = check_path(widget.path), self._checked_pace(widget.pace)
            with self._below, warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always", UserWarning)
                for k, function in enumerate(self._functions):
                    self._call(function, path, pace, first=k == 0)
            if told:
                widget.note = " · ".join(filter(None, [widget.note, *(str(w.message) for w in told)]))
        except TutorialError as error:
            widget.note = str(error)
        finally:
            widget.busy = False

    def _call(self, function: Callable, path: np.ndarray, pace: float, first: bool) -> None:
        from IPython.display import clear_output, display

        if first:
            clear_output(wait=True)  # what is there stays until something new comes
        try:
            result = function(path, pace)
        except TutorialError as error:
            self.widget.note = str(error)
            return
        if result is not None:
            display(result)

    # what is shown

    @functools.cached_property
    def figure(self) -> NotebookFigure:
        """The prepared paths, seen from above."""
        from matplotlib.ticker import MultipleLocator

        paths = {name: make() for name, make in PREPARED.items()}
        figure = NotebookFigure(figsize=(7.2, 2.5), dpi=100, facecolor="white")
        figure.text(0.008, 0.96, self.title, fontsize=9.5, weight="bold", va="top", color="#24292f",
                    parse_math=False)  # fmt: skip
        figure.text(0.992, 0.955, "seen from above, a line every metre", fontsize=8,
                    va="top", ha="right", color=palette.GREY)  # fmt: skip
        figure.text(0.008, 0.03, _STATIC, fontsize=8, color=palette.GREY)
        spread = [np.ptp(path, axis=0) + 1.4 for path in paths.values()]  # x, z
        total, high, gap = 7.2 - 0.12, 2.5 * 0.64, 0.1  # inches
        share = np.array([max(across[1], 1.2 * across[0]) for across in spread])
        wide = share / share.sum() * (total - gap * (len(paths) - 1))
        left = 0.06
        for (name, path), across, w in zip(paths.items(), spread, wide, strict=True):
            axes = figure.add_axes((left / 7.2, 0.14, w / 7.2, high / 2.5))
            left += w + gap
            draw_path(axes, path, color=palette.BLUE, width=2.6)
            middle = (path.min(0) + path.max(0)) / 2
            inch = max(across[1] / w, across[0] / high)  # metres: the same both ways
            axes.set(xlim=middle[1] + w * inch * np.array([-0.5, 0.5]),
                     ylim=middle[0] + high * inch * np.array([-0.5, 0.5]))  # fmt: skip
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(MultipleLocator(1))
            axes.tick_params(length=0, labelleft=False, labelbottom=False)
            axes.grid(color="#e3e8ee", linewidth=0.7)
            axes.set_axisbelow(True)
            axes.spines[:].set_color("#d0d7de")
            axes.set_title(f"{name}, {path_length(path):.1f} m", fontsize=8.5, loc="left", pad=3)
        return figure

    @property
    def alt(self) -> str:
        """What the picture shows, in words."""
        return f"{self.title}. Prepared paths seen from above: {', '.join(PREPARED)}. {_STATIC}"

    def _display_picture(self) -> None:
        self.widget.picture = base64.b64encode(self.png).decode()[-120:]
        super()._display_picture()

    @property
    def _shown(self) -> Any:
        return self._box

    def __repr__(self) -> str:
        path = self.path
        return f"<PathCanvas: path of {len(path)} points, {path_length(path):.1f} m, at {self.pace:g} m/s>"

    # checks

    def _checked(self, path: str | Sequence) -> list[list[float]]:
        return _plain(prepared_path(path) if isinstance(path, str) else check_path(path))

    def _checked_pace(self, pace: float) -> float:
        low, high = self._paces
        if not (isinstance(pace, int | float | np.number) and math.isfinite(pace) and low <= pace <= high):
            raise MotionError(f"path canvas: pace {pace!r} m/s, expected {low:g} to {high:g}")
        return float(pace)


def _plain(points: np.ndarray) -> list[list[float]]:
    """Points for the page, to a millimetre."""
    return np.round(np.asarray(points, dtype=float), 3).tolist()


def _numbers(values: Any, count: int, what: str) -> np.ndarray:
    try:
        found = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise TutorialError(f"path canvas: {what} {values!r}, expected {count} numbers")
    return found


@functools.cache
def _widget_class() -> type:
    """The widget; made when it is first needed, since ipywidgets takes its time to import."""
    import anywidget
    import traitlets

    script = script_of("page.js", "path_canvas.js")
    render = (
        "function render({ model, el }) { const canvas = pathCanvas(el, model); return () => canvas.dispose(); }\n"
        "export default { render };"
    )

    class PathCanvasWidget(anywidget.AnyWidget):
        _esm = f"{script}\n{render}"
        path = traitlets.List().tag(sync=True)
        pace = traitlets.Float().tag(sync=True)
        walked = traitlets.List().tag(sync=True)
        note = traitlets.Unicode().tag(sync=True)
        busy = traitlets.Bool(False).tag(sync=True)
        spec = traitlets.Dict().tag(sync=True)
        picture = traitlets.Unicode().tag(sync=True)  # the end of its data: which output is the picture

    return PathCanvasWidget
