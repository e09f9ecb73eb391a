"""The fan of futures without a browser: what is sent, what a choice asks for, what is refused, its picture."""

from __future__ import annotations

import base64
import io

import numpy as np
import pytest
from PIL import Image

from tutorial_lib.errors import MotionError, TutorialError
from tutorial_lib.motion import Motion
from tutorial_lib.view import Fan, fan_strip
from tutorial_lib.view.benchmark import stand_in
from tutorial_lib.view.codec import Payload, decode_positions


@pytest.fixture(scope="module")
def clips() -> dict[str, Motion]:
    """Two of 57 nodes, at 30 frames a second."""
    return {"stroll": stand_in(60, seed=1), "jog": stand_in(25, seed=2)}


class Imagination:
    """In a network's place: the prefix, then somewhere by chance; and what it was asked for."""

    def __init__(self):
        self.asked = []

    def __call__(self, prefix, count, temperature, seed):
        self.asked.append((prefix, count, temperature, seed))
        rng = np.random.default_rng(seed)
        later = temperature * rng.normal(size=(count, 1, 1, 3)) * np.linspace(0.05, 1, 20)[:, None, None] * (1, 0, 1)
        return [
            Motion(prefix.skeleton, prefix.fps, np.concatenate([prefix.positions, prefix.positions[-1] + steps]))
            for steps in later
        ]


def test_the_first_fan_is_made_and_sent_whole(clips):
    futures = Imagination()
    fan = Fan(clips, futures, picture=False, clip="jog", first=3, count=5, temperature=0.5, seed=7)
    ((prefix, *asked),) = futures.asked
    assert asked == [5, 0.5, 7] and np.array_equal(prefix.positions, clips["jog"].positions[3:23])
    spec, data = fan.widget.shown["spec"], base64.b64decode(fan.widget.shown["bytes"])
    assert len(spec["characters"]) == len(fan.motions) == 5 and spec["start"]["overlay"]
    for character, motion in zip(spec["characters"], fan.motions, strict=True):
        payload = Payload(data[slice(*character["bytes"])], character["step"], tuple(motion.positions[0, 0]), 40)
        back = decode_positions(payload, motion.skeleton.parents)
        assert np.abs(back - motion.positions).max() < 2e-3 and character["seed"] == 20
    assert [entry["last"] for entry in fan.widget.spec["clips"]] == [40, 5]
    assert all(len(entry["pose"]) > 10 for entry in fan.widget.spec["clips"])
    assert len({str(character["tones"]) for character in spec["characters"]}) == 5, "each has its colour"


def test_what_the_page_asks_for_is_made(clips):
    futures = Imagination()
    fan = Fan(clips, futures, picture=False)
    first, busy = fan.widget.shown, []
    fan.widget.observe(lambda change: busy.append(change.new), ["busy"])
    fan.widget.choice = {"clip": 1, "first": 2, "count": 3, "temperature": 1.5, "seed": 9}
    prefix, *asked = futures.asked[-1]
    assert asked == [3, 1.5, 9] and np.array_equal(prefix.positions, fan.prefix.positions)
    assert np.array_equal(prefix.positions, clips["jog"].positions[2:22])
    assert len(fan.motions) == 3 and fan.widget.shown != first and busy == [True, False] and fan.widget.note == ""
    fan.widget.choice = dict(fan.widget.choice)
    assert len(futures.asked) == 2, "nothing else was asked for"


def test_a_clip_as_long_as_the_past_has_one_beginning(clips):
    fan = Fan({"short": clips["jog"][:20]}, Imagination(), picture=False)
    with pytest.raises(TutorialError, match="first 7, expected a whole number, 0 to 0"):
        fan.choose(first=7)


def test_python_can_choose_too(clips):
    fan = Fan(clips, Imagination(), first=30, picture=False)
    assert fan.choose(count=2, seed=5) is fan and len(fan.motions) == 2 and fan.widget.choice["seed"] == 5
    fan.choose(clip="jog")
    assert fan.widget.choice["clip"] == 1 and fan.choice.first == 0, "another clip, from its beginning"
    assert "2 futures of jog" in repr(fan)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"count": 0}, "count 0, expected a whole number, 1 to 12"),
        ({"count": 13}, "count 13"),
        ({"count": 2.5}, "count 2.5"),
        ({"temperature": -0.1}, "temperature -0.1, expected a number from 0 to 3"),
        ({"temperature": float("nan")}, "temperature nan"),
        ({"temperature": "hot"}, "temperature 'hot'"),
        ({"first": 41}, "first 41, expected a whole number, 0 to 40"),
        ({"clip": "flight"}, "no clip 'flight', expected one of stroll, jog"),
        ({"seed": -1}, "seed -1, expected a whole number, 0 or more"),
        ({"speed": 3}, "no choice 'speed', expected clip, first, count, temperature, seed"),
    ],
)
def test_a_choice_that_cannot_be_is_refused_and_the_fan_stays(clips, change, words):
    fan = Fan(clips, Imagination(), picture=False)
    before = fan.widget.shown
    with pytest.raises(TutorialError) as told:
        fan.choose(**change)
    assert words in str(told.value) and "\n" not in str(told.value)
    assert fan.widget.shown == before and fan.choice.count == 8
    if "speed" not in change:
        fan.widget.choice = {**fan.widget.choice, **change}
        assert words in fan.widget.note, "asked for by the page: told in it"
        assert fan.widget.choice["count"] == 8 and not fan.widget.busy


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"past": 26}, "jog has 25 frames, the past is 26 of them"),
        ({"past": 0}, "past 0"),
        ({"futures": 3}, "futures of int"),
        ({"clips": []}, "nothing to show"),
        ({"clips": {"a": stand_in(30), "b": stand_in(60, fps=60.0)}}, "a has 30 frames a second and b 60"),
        ({"hottest": float("inf")}, "hottest inf"),
    ],
)
def test_clips_that_cannot_be_are_refused(clips, arguments, words):
    with pytest.raises(TutorialError) as told:
        Fan(**{"clips": clips, "futures": Imagination(), **arguments})
    assert words in str(told.value)


def test_what_the_network_refuses_is_told_in_one_line(clips):
    def refuses(prefix, count, temperature, seed):
        if count > 8:
            raise MotionError("a prefix of another skeleton")
        return Imagination()(prefix, count, temperature, seed)

    fan = Fan(clips, refuses, picture=False)
    with pytest.raises(MotionError, match="another skeleton"):
        fan.choose(count=9)
    fan.widget.choice = {**fan.widget.choice, "count": 9}
    assert fan.widget.note == "a prefix of another skeleton" and fan.choice.count == 8
    fan.widget.choice = {**fan.widget.choice, "count": 2}
    assert fan.widget.note == "" and len(fan.motions) == 2
    with pytest.raises(MotionError, match="another skeleton"):
        Fan(clips, refuses, count=10)
    with pytest.raises(MotionError, match="futures of 20 frames with a past of 20"):
        Fan(clips, lambda prefix, count, temperature, seed: [prefix] * count)


def test_outputs_are_a_picture_a_player_and_the_controls(clips, monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", lambda data, **_: shown.append(data))
    fan = Fan(clips, Imagination(), count=3)
    fan._ipython_display_()
    kinds = [next(iter(data)) for data in shown]
    assert kinds == ["image/png", "text/html", "application/vnd.jupyter.widget-view+json"]
    still = fan.widget.spec["still"]
    assert f'data-motion-player="{still["player"]}"' in shown[1]["text/html"]
    assert shown[0]["image/png"].endswith(still["picture"]) and "live kernel" in shown[2]["text/html"]
    assert Image.open(io.BytesIO(fan.png)).width == 720
    shown.clear()
    Fan(clips, Imagination(), picture=False)._ipython_display_()
    assert len(shown) == 1


def test_the_strip_shows_futures_one_over_the_other(clips):
    made = Imagination()(clips["stroll"][:20], 3, 1.0, 0)
    figure = fan_strip(made, 5, seed_frames=20)
    strip, ways = figure.axes
    assert len(ways.lines) == 7, "past and future of each, and a metre"
    says = [text.get_text() for text in figure.texts]
    assert says[0] == "frame 19\nthe past" and len(says) == 5 and says[-1].startswith("frame 39\n")
    ends = np.array([[c.get_offsets()[0, 0], c.get_offsets()[0, 1]] for c in ways.collections])
    really = np.array([m.positions[-1, 0, [0, 2]] - m.positions[19, 0, [0, 2]] for m in made])
    lengths = np.linalg.norm(really, axis=1)
    assert np.linalg.norm(ends, axis=1) == pytest.approx(lengths, abs=1e-6), "turned, not stretched"
    with pytest.raises(TutorialError, match="30 and 60 frames a second"):
        fan_strip([made[0], stand_in(30, fps=60.0)])
    with pytest.raises(TutorialError, match="1 moments"):
        fan_strip(made, 1)
