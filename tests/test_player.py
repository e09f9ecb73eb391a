"""The player without a browser: what is sent, how exactly, how big, and what is refused."""

from __future__ import annotations

import base64
import io
import json
import pathlib
import re
import zlib

import numpy as np
import pytest

from tutorial_lib import view
from tutorial_lib.errors import TutorialError
from tutorial_lib.motion import Motion, Skeleton
from tutorial_lib.view import palette, pose_strip, show
from tutorial_lib.view.benchmark import main, stand_in
from tutorial_lib.view.body import (
    LEFT,
    MIDDLE,
    RIGHT,
    describe,
    facing,
    footprints,
    ground_height,
    node_sides,
)
from tutorial_lib.view.codec import STEP, decode_positions, encode_positions
from tutorial_lib.view.strip import film_strip_png


@pytest.fixture(scope="module")
def dancer() -> Motion:
    return stand_in(300)


def still(positions: np.ndarray, fps: float = 30.0, name: str = "") -> Motion:
    """A two-node motion from positions (T, 2, 3)."""
    return Motion(Skeleton(("root", "tip"), (-1, 0), np.array([[0, 0, 0], [0, 1.0, 0]])), fps, positions, name=name)


# -- codec ---------------------------------------------------------------------------------------------------


def test_decoded_joints_lie_within_three_tenths_of_a_millimetre(dancer):
    payload = encode_positions(dancer.positions, dancer.skeleton.parents)
    back = decode_positions(payload, dancer.skeleton.parents)
    assert payload.step == STEP
    assert 0 < np.linalg.norm(back - dancer.positions, axis=-1).max() <= 3e-4


def test_the_bytes_are_what_the_docstring_says():
    """Worked by hand: a root that moves 0, 1, 3 steps along x, its tip always 2 steps further along y."""
    positions = np.zeros((3, 2, 3))
    positions[:, :, 0] = np.array([0, 1, 3])[:, None] * STEP
    positions[:, 1, 1] = 2 * STEP
    raw = zlib.decompress(encode_positions(positions, (-1, 0)).data)
    # second differences: root x 0 1 1; tip y, relative to the root, 2 -2 0; zigzag doubles, and -2 becomes 3
    low = [0, 2, 2] + [0] * 6 + [0] * 3 + [4, 3, 0] + [0] * 3
    assert list(raw) == low + [0] * len(low)


def test_error_does_not_grow_along_a_long_motion_or_far_from_the_origin():
    rng = np.random.default_rng(1)
    positions = rng.normal(scale=0.01, size=(20000, 2, 3)).cumsum(0) + [5000.0, 0.0, -70000.0]
    back = decode_positions(encode_positions(positions, (-1, 0)), (-1, 0))
    assert np.linalg.norm(back - positions, axis=-1).max() <= 3e-4


@pytest.mark.parametrize("jump", [20.0, 1e3, 1e6])
def test_a_jump_coarsens_the_step_just_as_far_as_needed(jump):
    positions = np.zeros((6, 2, 3))
    positions[3:] += [jump, 0, 0]
    payload = encode_positions(positions, (-1, 0))
    assert jump / 32767 / 2 <= payload.step <= 4 * jump / 32767
    assert np.abs(decode_positions(payload, (-1, 0)) - positions).max() <= payload.step / 2 + 1e-9


def test_a_single_frame_is_enough():
    positions = np.array([[[1.0, 2.0, 3.0], [1.0, 3.0, 3.0]]])
    assert np.abs(decode_positions(encode_positions(positions, (-1, 0)), (-1, 0)) - positions).max() < 3e-4
    player = show(still(positions))
    assert player.spec["frames"] == 1 and player.png


# -- body ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("LeftArm", "RightArm"),
        ("lThigh", "rThigh"),
        ("Foot_L", "Foot_R"),
        ("lfemur", "rfemur"),
        ("LHipJoint", "RHipJoint"),
    ],
)
def test_sides_are_told_by_the_mirrored_name(left, right):
    names = ("hips", left, f"{left}_end", right, f"{right}_end", "lowerback")
    assert node_sides(names, (-1, 0, 1, 0, 3, 0)) == (MIDDLE, LEFT, LEFT, RIGHT, RIGHT, MIDDLE)


def test_body_of_a_person(dancer):
    body, names = describe(dancer), dancer.skeleton.names
    assert [names[j] for j in body.torso] == ["LeftArm", "LeftUpLeg", "RightUpLeg", "RightArm"]
    assert {(names[a], names[b]) for a, b in body.feet} == {
        ("LeftFoot", "LeftToe_end"),
        ("RightFoot", "RightToe_end"),
    }
    drawn = {names[b] for group in body.groups for _, b in group}
    assert not drawn & {"LeftEye", "Jaw", "Head_end"}, "inside the head's circle"
    assert names[body.head[1]] == "Head" and 0.08 < body.head[3] < 0.13
    by_name = dict(zip(names, body.radius, strict=True))
    assert (
        by_name["LeftUpLeg"] > by_name["LeftLeg"] > by_name["LeftToe_end"]
        and by_name["LeftArm"] > by_name["LeftFinger0C"]
    )


def test_facing_turns_with_the_motion(dancer):
    body = describe(dancer)
    turned = dancer.rotate_y(1.0)
    difference = facing(turned, body) - facing(dancer, body)
    assert np.isclose(np.angle(np.exp(1j * (difference - 1.0))), 0, atol=1e-9)


def test_a_mark_on_the_ground_above_the_hips_is_no_part_of_the_body():
    skeleton = Skeleton(("mark", "hips", "chest"), (-1, 0, 1), np.array([[0, 0, 0], [0, 1.0, 0], [0, 0.5, 0]]))
    positions = np.zeros((20, 3, 3))
    positions[:, 1] = np.linspace([0, 1, 0], [4, 1, 0], 20)
    positions[:, 2] = positions[:, 1] + [0, 0.5, 0]
    body = describe(Motion(skeleton, 30, positions))
    assert body.root == 1 and body.groups[0] == ((1, 2),)


def test_footprints_are_where_the_foot_stood(dancer):
    """A foot that stands at x = 0, swings for half a second to x = 1, and stands there."""
    skeleton = Skeleton(
        ("hips", "knee", "ankle", "toe"),
        (-1, 0, 1, 2),
        np.array([[0, 1, 0], [0, -0.5, 0], [0, -0.45, 0], [0, -0.05, 0.2]]),
    )
    x = np.concatenate([np.zeros(30), np.linspace(0, 1, 15), np.ones(30)])
    positions = skeleton.rest_pose() + np.zeros((75, 1, 1))
    positions[..., 0] += x[:, None]
    positions[30:45, :, 1] += 0.2
    motion = Motion(skeleton, 30, positions)
    prints = footprints(motion, describe(motion))
    assert [(a, b) for _, a, b, *_ in prints] == [(0, 29), (45, 74)]
    assert np.allclose([p[3] for p in prints], [0, 1]) and np.allclose([p[6] - p[4] for p in prints], 0.2)


def test_ground_is_zero_unless_the_motion_plainly_stands_elsewhere():
    """A frame lies 2 cm low: drawn as it is. Everything 24 cm low, as in the acRNN files: set on the grid."""
    positions = np.zeros((50, 2, 3)) + [[0, 0, 0], [0, 1.7, 0]]
    for sunk, drawn_at in ((0.02, 0.0), (0.24, -0.24)):
        motion = still(positions - [0, sunk, 0])
        assert np.isclose(ground_height(motion, describe(motion)), drawn_at)


# -- show ----------------------------------------------------------------------------------------------------


def test_sizes(dancer):
    assert len(show(dancer).html) <= 100_000
    source = pathlib.Path(view.__file__).with_name("player.js").read_text(encoding="utf-8")
    assert len(source.encode()) <= 20_000
    assert not re.search(r"https?:|import |fetch\(|getElementById", source)


def test_the_same_input_gives_the_same_output(dancer):
    assert show(dancer).html == show(dancer).html
    assert show(dancer).png == show(dancer).png


def test_spec_holds_what_was_asked_for():
    positions = np.zeros((61, 2, 3)) + [[0, 0, 0], [0, 1.0, 0]]
    a, b = still(positions, 30.0, "a"), still(positions[:21] + [7.0, 0, 3.0], 5.0, "b")
    player = show(
        [a, b],
        labels=["truth", "guess"],
        seed_frames=[0, 4],
        ghosts=[-1, 0.5],
        overlay=True,
        speed=0.5,
        loop=False,
    )
    spec = player.spec
    assert (spec["fps"], spec["frames"]) == (30.0, 121), "counted at the first's rate, to the longest's end"
    assert [(c["name"], c["frames"], c["fps"], c["seed"]) for c in spec["characters"]] == [
        ("truth", 61, 30.0, 0),
        ("guess", 21, 5.0, 4),
    ]
    assert spec["ghostTimes"] == [-1.0, 0.5] and spec["start"]["ghosts"] and spec["start"]["overlay"]
    assert spec["start"]["speed"] == 0.5 and not spec["start"]["loop"] and not spec["autoplay"]
    assert len(spec["bodies"]) == 1, "one skeleton, sent once"
    last = spec["characters"][-1]["bytes"][1]
    assert last == len(player.payload)


def test_places_side_by_side_and_as_they_are():
    positions = np.zeros((3, 2, 3)) + [[0, 0, 0], [0, 1.0, 0]]
    motions = [still(positions + [x, 0, 0]) for x in (5.0, -2.0, 1.0)]
    row = [c["spot"] for c in show(motions).spec["characters"]]
    assert row[0][0] == -row[2][0] == pytest.approx(-0.85) and row[1] == (0, 0)
    assert [c["spot"][0] for c in show(motions, layout="as is").spec["characters"]] == [0, -7, -4]


def test_labels_cannot_break_out_of_the_script(tmp_path, dancer):
    label = "</script><!--<script>alert(1)</script>"
    player = show(dancer, labels=[label], title=f"a & b {label}")
    page = player.save(tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("</script") == 1 and "<!--" not in page
    assert "<title>a &amp; b &lt;/script&gt;" in page
    spec = json.loads(re.search(r"mount\(el, (\{.*\}), fromBase64", page)[1])
    assert spec["characters"][0]["name"] == label
    data = re.search(r'fromBase64\("([^"]*)"\)', page)[1]
    assert base64.b64decode(data) == player.payload


@pytest.mark.parametrize(
    ("choices", "says"),
    [
        ({"labels": ["a", "b"]}, "2 labels for 1 motions"),
        ({"seed_frames": [1, 2]}, "2 seed_frames for 1 motions"),
        ({"colors": ["red"]}, "'red'"),
        ({"layout": "circle"}, "'side by side', 'overlay', 'as is'"),
        ({"colors": [None]}, "None"),
        ({"seed_frames": -3}, "seed_frames -3, expected a whole number of 0 or more"),
        ({"speed": 0}, "speed 0"),
        ({"speed": "2"}, "speed '2', expected a number above zero"),
        ({"width": "100%"}, "width '100%'"),
        ({"height": 0}, "height 0"),
        ({"ghosts": ["soon"]}, "ghosts"),
        ({"ghosts": [float("nan")]}, "ghosts [nan]"),
    ],
)
def test_choices_that_do_not_fit_are_told_in_one_line(dancer, choices, says):
    with pytest.raises(TutorialError, match=re.escape(says)) as caught:
        show(dancer, **choices)
    assert "\n" not in str(caught.value)


def test_dollars_in_a_name_are_no_mathematics(dancer):
    """Nor an error: matplotlib reads what stands between two of them as TeX."""
    assert show(dancer, labels=["cost$5_$x\\y"]).png.startswith(b"\x89PNG")


@pytest.mark.parametrize("wrong", [[], 3, None, ["walk.bvh"], np.zeros((3, 2, 3))])
def test_what_is_no_motion_is_refused(wrong):
    with pytest.raises(TutorialError, match="expected a Motion or a list of them"):
        show(wrong)


def test_not_a_number_is_refused_by_frame_and_joint():
    positions = np.zeros((9, 2, 3))
    positions[4, 1, 2] = np.nan
    with pytest.raises(TutorialError, match="frame 4, joint 'tip'"):
        show(still(positions))


def test_save_is_whole_or_nothing(tmp_path, dancer):
    path = show(dancer).save(tmp_path / "new" / "page.html")
    assert path.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert [p.name for p in path.parent.iterdir()] == ["page.html"]
    with pytest.raises(TutorialError, match="cannot be written"):
        show(dancer).save(path / "inside-a-file.html")
    assert [p.name for p in path.parent.iterdir()] == ["page.html"]


def test_a_notebook_gets_the_strip_first_and_the_player_second(monkeypatch, dancer):
    display = pytest.importorskip("IPython.display")
    shown = []
    monkeypatch.setattr(display, "display", lambda data, **how: shown.append((data, how)))
    show(dancer)._ipython_display_()
    show(dancer, strip=False)._ipython_display_()
    assert [sorted(data)[0] for data, _ in shown] == ["image/png", "text/html", "text/html"]
    assert all(how["raw"] for _, how in shown) and all("image/png" not in data for data, _ in shown[1:])
    assert base64.b64decode(shown[0][0]["image/png"]).startswith(b"\x89PNG")


# -- strips --------------------------------------------------------------------------------------------------


def pixels(png: bytes) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def near(image: np.ndarray, color: str) -> np.ndarray:
    return np.abs(image - list(bytes.fromhex(color[1:]))).max(-1) < 24


def test_film_strip_is_small_whole_and_in_the_motions_colour(dancer):
    png = film_strip_png([dancer])
    image = pixels(png)
    assert image.shape[1] == 720 and image.shape[0] < 260 and len(png) < 30_000
    drawn = near(image, palette.BLUE)
    assert drawn.sum() > 500
    assert not drawn[0].any() and not drawn[:, 0].any() and not drawn[:, -1].any(), "clipped at an edge"


def test_wide_arms_are_neither_clipped_nor_overlapping():
    """A bar 3 m wide: eight of them must stand apart, with a gap between any two."""
    skeleton = Skeleton(("root", "a", "b"), (-1, 0, 0), np.array([[0, 0, 0], [1.5, 0, 0], [-1.5, 0, 0.0]]))
    positions = np.tile(np.array([[0, 1.0, 0], [1.5, 1.0, 0], [-1.5, 1.0, 0]]), (40, 1, 1))
    figure = pose_strip(Motion(skeleton, 30, positions), 8, azimuth=0.0)
    drawn = _render(figure)
    columns = near(drawn, palette.BLUE).any(0).astype(int)
    assert (np.diff(np.concatenate([[0], columns, [0]])) == 1).sum() == 8


def test_strip_marks_seed_frames_and_leaves_ended_motions_blank(dancer):
    image = _render(pose_strip([dancer, dancer[:100]], [0, 50, 200], labels=["long", "short"], seed_frames=[20, 20]))
    height, width = image.shape[0], image.shape[1]
    seed = near(image, palette.SEED)
    thirds = [seed[:, i * width // 3 : (i + 1) * width // 3][: int(0.85 * height)].sum() for i in range(3)]
    assert thirds[0] > 300 and max(thirds[1:]) < 0.1 * thirds[0]
    second = near(image, palette.VERMILLION)[:, 2 * width // 3 :]
    assert second.sum() < 20, "the short motion has no frame 200"


@pytest.mark.parametrize("frames", [0, [], [300], [-1]])
def test_frames_that_are_not_there_are_refused(dancer, frames):
    with pytest.raises(TutorialError, match="pose_strip"):
        pose_strip(dancer, frames)


def test_strips_leave_matplotlibs_state_alone(dancer):
    import sys

    before = "matplotlib.pyplot" in sys.modules
    pose_strip(dancer)
    assert before or "matplotlib.pyplot" not in sys.modules


def _render(figure) -> np.ndarray:
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return pixels(out.getvalue())


# -- benchmark and real clips --------------------------------------------------------------------------------


def test_benchmark_says_when_there_is_no_browser(capsys, monkeypatch):
    monkeypatch.setattr("tutorial_lib.view.benchmark.find_chromium", lambda: None)
    monkeypatch.setattr("tutorial_lib.view.benchmark._fresh_build", lambda frames: 0.5)
    assert main(["--frames", "60", "--no-matplotlib"]) == 0
    printed = capsys.readouterr().out
    assert "1 figure, 60 frames" in printed and "not measured in a browser" in printed


@pytest.mark.parametrize("clips", ["cmu/indian/*.bvh", "cmu/walking/*.bvh", "bandai-namco/run/*.bvh"])
def test_real_figures_have_a_head_a_torso_and_two_feet(real_clips, clips):
    from tutorial_lib.motion.files import read_motion

    motion = read_motion(real_clips(clips)[0])
    body = describe(motion)
    assert body.head and len(body.torso) == 4 and len(body.feet) == 2
    heights = motion.positions[:, [body.head[1], body.torso[0], body.torso[1], body.feet[0][1]], 1].mean(0)
    assert (np.diff(heights) < 0).all(), "head over shoulder over hip over toe"
    back = decode_positions(encode_positions(motion.positions, motion.skeleton.parents), motion.skeleton.parents)
    assert np.linalg.norm(back - motion.positions, axis=-1).max() <= 3e-4
