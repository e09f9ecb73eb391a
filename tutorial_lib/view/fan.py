"""``Fan``: one past, many futures. Choose what they go on from, how many and how wild; they move over one another.

Chen et al., "Dynamic Future Net", figure 1. Choosing needs a live kernel, through anywidget; the page part is
``fan.js``. Before it go a picture and a player of the first fan, for pages in which nobody can choose (the fan hides
them where it runs).
"""

from __future__ import annotations

import base64
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..chance import is_real, is_whole
from ..errors import MotionError, TutorialError
from ..motion.clip import Motion
from .body import describe, facing
from .fan_strip import fan_colors, fan_strip
from .figure import NotebookFigure
from .page import page_file, script_of
from .player import Player
from .strip import as_motions
from .widget_cell import WidgetCell

STEP = 0.002  # metres: what the futures are rounded to for the page; there are many of them
MOST, HOTTEST = 12, 3.0
_MOMENTS = 7  # in the picture
_STATIC = "Choosing needs a live kernel: run this cell in Jupyter. Until then this is the fan that the cell asks for."

#: ``(prefix, count, temperature, seed) -> motions``, each of which begins with the prefix
Futures = Callable[[Motion, int, float, int], Sequence[Motion]]


@dataclass(frozen=True)
class Choice:
    """What a fan is asked for: the prefix begins at frame ``first`` of clip number ``clip``."""

    clip: int = 0
    first: int = 0
    count: int = 8
    temperature: float = 1.0
    seed: int = 0


class Fan(WidgetCell):
    """A fan of futures that is the last line of a cell.

    clips: what the past can be cut from, ``{name: Motion}`` or motions with names, all at one frame rate.
    futures: called as ``futures(prefix, count, temperature, seed)``, returns ``count`` motions that begin with the
        prefix; so the fan is for any network. What it refuses with a ``TutorialError`` is told in one line.
    past: frames of the prefix. clip, first: with which it begins, name or number of a clip, and its frame.
    count, temperature, seed: of the first fan; most, hottest: the ends of the sliders.
    width, height: pixels of the page. picture: put picture and player of the first fan before it.

    ``motions`` are the futures shown, ``choice`` what was asked for; ``choose(count=4)`` asks for others. ``player``
    shows the first fan, for pages without a kernel.
    Raises ``MotionError`` for clips that cannot be, ``TutorialError`` for other choices.

        def futures(prefix, count, temperature, seed):
            return list(generate_futures(network, 128, prefix=prefix, count=count, temperature=temperature, seed=seed))

        Fan(clips, futures)
    """

    _static = _STATIC

    def __init__(
        self,
        clips: Mapping[str, Motion] | Sequence[Motion] | Motion,
        futures: Futures,
        *,
        past: int = 20,
        clip: str | int = 0,
        first: int = 0,
        count: int = 8,
        temperature: float = 1.0,
        seed: int = 0,
        most: int = MOST,
        hottest: float = HOTTEST,
        title: str = "One past, many futures",
        width: int = 720,
        height: int = 420,
        picture: bool = True,
    ):
        if not callable(futures):
            raise TutorialError(f"fan: futures of {type(futures).__name__}, expected a function that makes motions")
        self.past = _whole("past", past, 1)
        self._most, self._hottest = _whole("most", most, 1), _number("hottest", hottest, 0.1, 100.0)
        self.clips = _named(clips, self.past)
        self.title, self.picture, self._futures = title, picture, futures
        self._size = {"width": _whole("width", width, 200) - 26, "height": _whole("height", height, 100)}
        self.choice = self._checked(Choice(self._clip(clip), first, count, temperature, seed))
        self.motions: tuple[Motion, ...] = ()
        self.player = player = self._imagine()
        still = {"player": _key(player), "picture": base64.b64encode(self.png).decode()[-120:] if picture else "none"}
        self.widget = _widget_class()(
            choice=asdict(self.choice),
            shown=_sent(player),
            spec={
                "title": title,
                "width": int(width),
                "style": page_file("controls.css", "fan.css"),
                "past": self.past,
                "most": self._most,
                "hottest": self._hottest,
                "clips": [
                    {"name": name, "last": len(clip) - self.past, "fps": clip.fps, "pose": _stick(clip)}
                    for name, clip in self.clips.items()
                ],
                "still": still if picture else {"player": "none", "picture": "none"},
            },
        )
        self.widget.observe(self._heard, ["choice"])

    @property
    def prefix(self) -> Motion:
        """The past that was chosen."""
        clip = list(self.clips.values())[self.choice.clip]
        return clip[self.choice.first : self.choice.first + self.past]

    def choose(self, **changes: Any) -> Fan:
        """Another fan: ``clip`` (its name or number), ``first``, ``count``, ``temperature``, ``seed``.

        Raises what the constructor does; the fan is then as it was.
        """
        unknown = set(changes) - set(asdict(self.choice))
        if unknown:
            raise TutorialError(f"fan: no choice {sorted(unknown)[0]!r}, expected {', '.join(asdict(self.choice))}")
        if "clip" in changes:
            changes["clip"] = self._clip(changes["clip"])
            changes.setdefault("first", 0)
        self._take(self._checked(Choice(**{**asdict(self.choice), **changes})))
        self.widget.choice = asdict(self.choice)
        return self

    def _take(self, choice: Choice) -> None:
        before, self.choice = self.choice, choice
        try:
            self.widget.shown = _sent(self._imagine())
        except Exception:
            self.choice = before
            raise
        self.widget.note = ""

    def _imagine(self) -> Player:
        """The futures of the choice, in a player."""
        choice, prefix = self.choice, self.prefix
        made = as_motions(self._futures(prefix, choice.count, choice.temperature, choice.seed))
        seen, shortest = round(self.past * made[0].fps / prefix.fps), min(map(len, made))
        if any(motion.fps != made[0].fps for motion in made) or shortest < seen + _MOMENTS:
            raise MotionError(
                f"fan: futures of {shortest} frames with a past of {seen}, at {made[0].fps:g} a second: expected all "
                f"at one rate, and {seen + _MOMENTS} frames or more"
            )
        player = Player(
            made, layout="overlay", seed_frames=seen, colors=fan_colors(len(made)), step=STEP, strip=False,
            **self._size,
            title=f"{len(made)} futures of {prefix.name or 'one past'}, temperature {choice.temperature:g}",
            labels=[motion.name or str(k + 1) for k, motion in enumerate(made)],
        )  # fmt: skip
        self.motions = made
        return player

    def _heard(self, change: Any) -> None:
        """The page asks for something."""
        if change.new == asdict(self.choice):
            return
        self.widget.busy = True
        try:
            self._take(self._checked(Choice(**change.new)))
        except TutorialError as error:
            self.widget.note = str(error)
            self.widget.choice = asdict(self.choice)
        finally:
            self.widget.busy = False

    # what is shown

    @functools.cached_property
    def figure(self) -> NotebookFigure:
        """The futures of the first fan at some moments, and the ways they went."""
        seen = self.player.seed_frames[0]
        title = f"{self.title}: {self._says}"
        return fan_strip(self.player.motions, _MOMENTS, seed_frames=seen, width=7.2, title=title)

    @property
    def _says(self) -> str:
        name, choice = list(self.clips)[self.choice.clip], self.choice
        return f"{choice.count} futures of {name}, temperature {choice.temperature:g}"

    @property
    def alt(self) -> str:
        """What the picture shows, in words."""
        return f"{self.title}. {self._says}, seen at seven moments. {_STATIC}"

    def _display_picture(self) -> None:
        """The picture, and a player of the first fan below it."""
        from IPython.display import display

        super()._display_picture()
        display({"text/html": self.player.html, "text/plain": repr(self.player)}, raw=True)

    @property
    def _shown(self) -> Any:
        return self.widget

    def __repr__(self) -> str:
        return f"<Fan: {self._says}>"

    # checks

    def _clip(self, clip: str | int) -> int:
        names = list(self.clips)
        if isinstance(clip, str) and clip in names:
            return names.index(clip)
        if isinstance(clip, int) and not isinstance(clip, bool) and 0 <= clip < len(names):
            return clip
        raise TutorialError(f"fan: no clip {clip!r}, expected one of {', '.join(names)}")

    def _checked(self, choice: Choice) -> Choice:
        clip = self._clip(choice.clip)
        last = len(list(self.clips.values())[clip]) - self.past
        return Choice(
            clip,
            _whole("first", choice.first, 0, last),
            _whole("count", choice.count, 1, self._most),
            _number("temperature", choice.temperature, 0.0, self._hottest),
            _whole("seed", choice.seed, 0),
        )


def _whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    if not is_whole(value) or value < least or (most is not None and value > most):
        upto = "or more" if most is None else f"to {most}"
        raise TutorialError(f"fan: {name} {value!r}, expected a whole number, {least} {upto}")
    return int(value)


def _number(name: str, value: Any, least: float, most: float) -> float:
    if not is_real(value) or not least <= value <= most:  # NaN is not, either
        raise TutorialError(f"fan: {name} {value!r}, expected a number from {least:g} to {most:g}")
    return float(value)


def _named(clips: Mapping[str, Motion] | Sequence[Motion] | Motion, past: int) -> dict[str, Motion]:
    if isinstance(clips, Mapping):
        named = dict(zip(map(str, clips), as_motions(list(clips.values())), strict=True))
    else:
        motions = as_motions(clips)
        names = [motion.name for motion in motions]
        if not all(names) or len(set(names)) < len(names):
            names = [str(i + 1) for i in range(len(motions))]
        named = dict(zip(names, motions, strict=True))
    rates = {clip.fps: name for name, clip in named.items()}
    if len(rates) > 1:
        (a, one), (b, other), *_ = rates.items()
        raise MotionError(f"fan: {one} has {a:g} frames a second and {other} {b:g}, expected all at one rate")
    for name, clip in named.items():
        if len(clip) < past:
            raise MotionError(f"fan: {name} has {len(clip)} frames, the past is {past} of them")
    return named


def _stick(clip: Motion) -> list[tuple[int, int, int, int]]:
    """The bones of a clip's middle pose from the side, in hundredths of its height: x, y of one end and the other."""
    pose, body = clip[len(clip) // 2 : len(clip) // 2 + 1], describe(clip)
    turn = facing(pose, body) + 0.9
    at = pose.positions[0] - pose.positions[0, body.root] * (1, 0, 1)
    x = (np.cos(turn) * at[:, 0] - np.sin(turn) * at[:, 2]) * 100 / body.height
    y = -(at[:, 1] - at[:, 1].min()) * 100 / body.height
    bones = [bone for group in body.groups for bone in group]
    return [tuple(round(float(v)) for v in (x[a], y[a], x[b], y[b])) for a, b in bones]


def _key(player: Player) -> str:
    """What the player's element is known by on a page."""
    return player.html.split('"', 2)[1]


def _sent(player: Player) -> dict[str, Any]:
    return {"spec": player.spec, "bytes": base64.b64encode(player.payload).decode()}


@functools.cache
def _widget_class() -> type:
    """The widget; made when it is first needed, since ipywidgets takes its time to import."""
    import anywidget
    import traitlets

    render = (
        "function render({ model, el }) { const fan = futureFan(el, model); return () => fan.dispose(); }\n"
        "export default { render };"
    )

    class FanWidget(anywidget.AnyWidget):
        _esm = f"{script_of('page.js', 'player.js', 'stage.js', 'fan.js')}\n{render}"
        choice = traitlets.Dict().tag(sync=True)
        shown = traitlets.Dict().tag(sync=True)
        note = traitlets.Unicode().tag(sync=True)
        busy = traitlets.Bool(False).tag(sync=True)
        spec = traitlets.Dict().tag(sync=True)

    return FanWidget
