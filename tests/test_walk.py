"""Walking a path, from the weights that come with the library: it walks, it stays on the path, bad input is told."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

from tutorial_lib import pretrained
from tutorial_lib.cli import main
from tutorial_lib.control import find_strides, fit_sway, path_deviation, prepared_path
from tutorial_lib.data.synthetic import sample_skeleton
from tutorial_lib.errors import CheckpointError, MotionError, TutorialError
from tutorial_lib.evaluate_control import cost, gait_of, measured_walk, of_pace, summary
from tutorial_lib.generate_control import generate_control_features, generate_from_control
from tutorial_lib.metrics import bone_length_drift
from tutorial_lib.motion import Motion, read_bvh
from tutorial_lib.motion.ground import PREPARED, read_path
from tutorial_lib.recipes import Recipe, clips_of
from tutorial_lib.training.checkpoints import load_checkpoint, read_header, save_checkpoint
from tutorial_lib.walk import plan_walk, planted_feet, walk

NAME = "vae-lstm-samples"


@pytest.fixture(scope="module")
def checkpoint():
    return pretrained.load(NAME)


@pytest.fixture(scope="module")
def clips():
    return clips_of(Recipe("vae-lstm", "samples/walking", height=1.7))


# --- it walks -------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", list(PREPARED))
def test_somebody_walks_a_prepared_path(checkpoint, clips, path):
    """What the issue asks for, and that it is walking: steps as long and as many as those of the clips."""
    raw, clean = (walk(checkpoint, path, count=2, clean=clean) for clean in (False, True))
    away = path_deviation(clean[0], prepared_path(path))
    assert away.mean < 0.06 and away.max < 0.3 and away.covered > 0.97
    made, mended, true = gait_of(raw), gait_of(clean), gait_of(of_pace(clips[0], 1.3))
    assert made["step_length"] == pytest.approx(true["step_length"], rel=0.25)
    assert made["cadence"] == pytest.approx(true["cadence"], rel=0.15)
    assert mended["slide"] < 2.0 and mended["slide"] < made["slide"] and mended["contact"] > 0.9
    assert bone_length_drift(clean[0].positions, clean[0].skeleton).max() < 1e-6
    assert clean[0].rotations is not None and [m.name for m in clean] == ["walk-1", "walk-2"]


def test_without_the_sway_it_glides(checkpoint):
    """The deliberate failure: on smooth control there is hardly a step."""
    swaying, smooth = (walk(checkpoint, "circle", sway=sway, clean=False)[0] for sway in (True, False))
    assert find_strides(swaying).steps >= 14
    glides = find_strides(smooth)
    assert glides.steps * glides.step_length < 0.4 * find_strides(swaying).steps * find_strides(swaying).step_length


def test_arms_and_legs_alternate(checkpoint):
    """The left hand is ahead where the left foot is behind."""
    motion = walk(checkpoint, [[0, 0], [0, 8]], clean=False)[0]
    at = {name: j for j, name in enumerate(motion.skeleton.names)}
    left, right = (motion.positions[:, at[f"Left{part}"], 2] - motion.positions[:, at[f"Right{part}"], 2]
                   for part in ("Foot", "Hand"))  # fmt: skip
    assert np.corrcoef(left, right)[0, 1] < -0.7


def test_people_differ_and_the_seed_decides(checkpoint):
    five = walk(checkpoint, "circle", count=5, seed=1, clean=False)
    again = walk(checkpoint, "circle", count=5, seed=1, clean=False)
    x = np.stack([m.positions for m in five])
    np.testing.assert_array_equal(x, np.stack([m.positions for m in again]))
    last = x[:, -30:] - x[:, -30:, :1]
    for a in range(5):
        for b in range(a):
            assert np.linalg.norm(last[a] - last[b], axis=-1).mean() > 0.02, "to the end"
    assert not np.allclose(walk(checkpoint, "circle", seed=2, clean=False)[0].positions, five[0].positions)


def test_the_plan_is_what_the_network_is_asked(checkpoint):
    planned = plan_walk(checkpoint, "zigzag", count=3, seed=4)
    assert planned.control.shape == (3, len(planned.way.control), 3) and planned.start.shape == (3, 2)
    smooth = plan_walk(checkpoint, "zigzag", count=3, sway=False)
    np.testing.assert_array_equal(smooth.control[1], smooth.way.control)
    assert np.abs(planned.control[0] - planned.control[1]).max() > 0.05, "each begins in a phase of its own"
    mean = np.abs((planned.control - planned.way.control).mean((0, 1)))
    assert (mean < 0.05).all(), "the sway comes and goes"
    slow, fast = (walk(checkpoint, [[0, 0], [0, 6]], pace, clean=False)[0] for pace in (1.0, 1.6))
    assert len(slow) == 181 and len(fast) == 113
    assert find_strides(slow).cadence < find_strides(fast).cadence


def test_a_seed_that_is_none_is_told(checkpoint):
    planned = [plan_walk(checkpoint, "circle", seed=seed).control for seed in (np.int64(2), 2)]
    np.testing.assert_array_equal(*planned)
    with pytest.raises(TutorialError, match="the seed must be a whole number of 0 or more, not -1"):
        walk(checkpoint, "circle", seed=-1)


def test_another_sway_can_be_given(checkpoint, clips):
    bare = dataclasses.replace(checkpoint, sway=None)
    told = r"brings no sway .*: expected a vae-lstm .*walking \(in Python also sway=, .*control.fit_sway, or False"
    with pytest.raises(CheckpointError, match=told):
        walk(bare, "circle")
    assert find_strides(walk(bare, "circle", sway=fit_sway(clips[0]), clean=False)[0]).steps > 10


def test_where_people_slow_down_is_told_at_the_callers_line_each_time(checkpoint):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("default")  # as Python shows them: the first of each line
        for make in (plan_walk, plan_walk, walk):
            make(checkpoint, [[0, 0], [0, 3]], 60.0)
    line = test_where_people_slow_down_is_told_at_the_callers_line_each_time.__code__.co_firstlineno
    assert [(one.filename, one.lineno - line) for one in told] == [(__file__, 4)] * 3
    assert all("60 m/s were asked for" in str(one.message) for one in told)


def test_a_foot_that_glides_for_a_moment_is_planted_through():
    """A walker's foot that stands, glides on for a quarter of a second and stands again: one stance, in one place."""
    rest = sample_skeleton().rest_pose()
    way = 0.24 * np.clip((np.arange(90) - 40) / 7, 0, 1)[:, None, None] * np.array([0, 0, 1.0])
    made = planted_feet(Motion(sample_skeleton(), 30.0, rest - [0, rest[:, 1].min(), 0] + way))
    toe = made.positions[:, made.skeleton.index("LeftToe")]
    assert np.ptp(toe[5:-5, 2]) < 1e-3


# --- measured -------------------------------------------------------------------------------------


def test_what_is_measured_of_a_walk(checkpoint):
    """Each number once more, from the motions themselves."""
    found, path = measured_walk(checkpoint, "zigzag", 1.3, count=2, seed=1), prepared_path("zigzag")
    made = walk(checkpoint, "zigzag", count=2, seed=1, clean=False)
    away = [path_deviation(motion, path) for motion in made]
    assert found["deviation"]["mean"] == pytest.approx(np.mean([d.distance.mean() for d in away]))
    assert found["deviation"]["drift"] == pytest.approx(np.mean([np.abs(d.drift).mean() for d in away]))
    assert abs(found["deviation"]["drift"] / found["deviation"]["mean"] - 1) > 0.01, "two different things"
    planned = plan_walk(checkpoint, "zigzag", count=2, seed=1)
    beginning = {"place": planned.start, "heading": planned.heading, "codes": "held", "seed": 1}
    alone = generate_from_control(checkpoint, planned.control, integrate="predicted", **beginning)
    lost = np.mean([path_deviation(motion, path).mean for motion in alone])
    assert found["deviation"]["predicted"] == pytest.approx(lost) and lost > 2 * found["deviation"]["mean"]
    assert found["before"] == gait_of(made) and found["after"] == gait_of([planted_feet(motion) for motion in made])


def test_the_gait_is_measured_on_the_ground(clips):
    """Of somebody who rises by 10 cm a second as well: heights that are added up drift, and no foot would stand."""
    clip = clips[0][0]
    up = 0.1 * np.arange(len(clip))[:, None, None] / clip.fps * np.array([0, 1.0, 0])
    level, rising = gait_of([clip]), gait_of([Motion(clip.skeleton, clip.fps, clip.positions + up)])
    assert rising["contact"] == pytest.approx(level["contact"], abs=0.05) and level["contact"] > 0.9
    assert rising["slide"] == pytest.approx(level["slide"], rel=0.2)


def test_what_it_costs_is_told_without_a_warning(checkpoint):
    """Of people who have only walked more slowly than it asks for."""
    slow = dataclasses.replace(checkpoint.sway, limits=dataclasses.replace(checkpoint.sway.limits, speed=0.8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cost(dataclasses.replace(checkpoint, sway=slow), 1, seconds=1.0, repeats=1) > 0


# --- weights ---------------------------------------------------------------------------------------


def test_the_shipped_weights_tell_where_they_are_from():
    for name in (NAME, "vae-lstm-cmu"):
        checkpoint = pretrained.load(name)
        origin = checkpoint.provenance
        assert checkpoint.sway is not None and checkpoint.seed_frames is None
        assert "bandai" not in str(origin).lower() and origin["published"]["name"] == name
        assert "--mirror" in origin["command"] and len(origin["clips"]) >= 8 and origin["test_clips"]
        assert pretrained.path(name).stat().st_size < 3.2e6
        for row in origin["metrics"]["walks"]:
            assert row["deviation"]["mean"] < 0.3
        assert origin["metrics"]["trained_on_these_clips"] is False
        assert "walks a path at" in next(row.summary for row in pretrained.list() if row.name == name)
        assert any("zigzag at 1.3 m/s: steps of" in line for line in summary(origin["metrics"]))


def test_a_checkpoint_keeps_its_sway(checkpoint, tmp_path):
    file = tmp_path / "again.safetensors"
    parts = {"system": checkpoint.system, "model": checkpoint.model, "representation": checkpoint.representation,
             "normalizer": checkpoint.normalizer}  # fmt: skip
    save_checkpoint(file, **parts, sway=checkpoint.sway)
    control = plan_walk(checkpoint, "circle").control
    np.testing.assert_allclose(plan_walk(load_checkpoint(file), "circle").control, control)
    features = generate_control_features(load_checkpoint(file), control)
    np.testing.assert_array_equal(features, generate_control_features(checkpoint, control))
    save_checkpoint(file, **parts)
    assert load_checkpoint(file).sway is None and "sway" not in read_header(file)


def test_evaluating_weights_that_follow_control(tmp_path, capsys):
    json = tmp_path / "walk.json"
    assert (
        main(["evaluate", "--pretrained", NAME, "--data", "samples/walking", "--count", "1", "--json", str(json)]) == 0
    )
    told = capsys.readouterr().out
    assert "figure of eight at 1.3 m/s: steps of" in told and "never trained on" in told and json.exists()


# --- the command ----------------------------------------------------------------------------------


def test_the_command_writes_bvh_files_and_pages(tmp_path, capsys):
    out = tmp_path / "out"
    command = [
        "walk",
        "--pretrained",
        NAME,
        "--path",
        "figure-of-eight",
        "--pace",
        "1.6",
        "--count",
        "2",
        "--seed",
        "3",
    ]
    assert main([*command, "-o", str(out)]) == 0
    assert "wrote 2 files" in capsys.readouterr().out
    files = sorted(out.iterdir())
    assert [file.name for file in files] == ["walk-01.bvh", "walk-02.bvh"]
    assert path_deviation(read_bvh(files[0]), prepared_path("figure of eight")).mean < 0.1
    assert main([*command, "--raw", "--rest", "-o", str(tmp_path / "page.html")]) == 0
    assert (tmp_path / "page.html").stat().st_size > 20_000


def test_a_path_from_a_file(tmp_path, capsys):
    file = tmp_path / "drawn.csv"
    file.write_text("x,z\n0, 0\n\n1.5 2.0  # a corner\n0;4\n", encoding="utf-8")
    np.testing.assert_array_equal(read_path(file), [[0, 0], [1.5, 2], [0, 4]])
    assert main(["walk", "--pretrained", NAME, "--path", str(file), "-o", str(tmp_path / "out")]) == 0
    assert "wrote 1 file " in capsys.readouterr().out


def test_a_path_from_a_file_that_turns_back_within_a_step(tmp_path, capsys):
    file = tmp_path / "drawn.csv"
    file.write_text("0 0\n0 .01\n0 0\n0 2\n", encoding="utf-8")
    assert main(["walk", "--pretrained", NAME, "--path", str(file), "-o", str(tmp_path / "out")]) == 0
    assert "wrote 1 file " in capsys.readouterr().out
    assert path_deviation(read_bvh(tmp_path / "out/walk-01.bvh"), read_path(file)).mean < 0.1


def test_the_first_point_of_a_file_is_not_taken_for_names(tmp_path):
    file = tmp_path / "drawn.csv"
    file.write_bytes(b"\xef\xbb\xbf0,0\r\n0,2\r\n2,4\r\n")  # as Excel writes it, with a byte order mark
    np.testing.assert_array_equal(read_path(file), [[0, 0], [0, 2], [2, 4]])
    file.write_bytes(b"\xef\xbb\xbfx,z\n0,0\n0,2\n")
    np.testing.assert_array_equal(read_path(file), [[0, 0], [0, 2]])


@pytest.mark.parametrize("text, told", [
    ("", r"path of 0 points: expected at least two, 5 cm apart or more"),
    ("1 2\n", r"path of 1 points: expected at least two"),
    ("1,1\n1,1\n", r"path of 2 points: expected at least two, 5 cm apart or more"),
    ("0,0\nnan,1\n", r"path: point 1 is not finite, expected metres"),
    ("0,0\n1\n", r"line 2 is '1', expected two numbers, x and z in metres"),
    ("0,0\n1,2,3\n", r"line 2 is '1,2,3', expected two numbers"),
    ("1.5,2.O\n0,2\n2,4\n", r"line 1 is '1.5,2.O', expected two numbers, x and z in metres"),
    ("0,0\nend,end\n", r"line 2 is 'end,end', expected two numbers"),
    ("0,0\n1e6,0\n", r"path of 1e\+06 m: expected at most 10000, coordinates in metres"),
])  # fmt: skip
def test_files_that_hold_no_path(tmp_path, fails, text, told):
    file = tmp_path / "drawn.csv"
    file.write_text(text, encoding="utf-8")
    assert f"{file}: " in fails("walk", "--pretrained", NAME, "--path", file, "-o", tmp_path / "out")
    with pytest.raises(MotionError, match=told):
        read_path(file)
    assert not (tmp_path / "out").exists()


def test_other_bad_input(tmp_path, fails, capsys):
    out = ["-o", tmp_path / "out"]
    circle = ["walk", "--pretrained", NAME, "--path", "circle"]
    assert "no prepared path 'ring': expected one of circle, figure of eight, zigzag, or a file of points" in fails(
        "walk", "--pretrained", NAME, "--path", "ring", *out)  # fmt: skip
    assert "argument --pace: expected a number above 0" in fails(*circle, "--pace", "nan", *out)
    assert "argument --count: expected a whole number of 1 or more" in fails(*circle, "--count", "0", *out)
    assert "follows no control signal: expected 'vae-lstm'" in fails(
        "walk", "--pretrained", "aclstm-cmu-walking", "--path", "circle", *out)  # fmt: skip
    assert "did you mean vae-lstm-samples" in fails("walk", "--pretrained", "vae-lstm-sample", "--path", "circle", *out)
    assert "no such file" in fails("walk", tmp_path / "x.safetensors", "--path", "circle", *out)
    told = fails("evaluate", "--pretrained", NAME, "--data", "samples/walking", "--frames", "30")
    assert "--frames is not for system 'vae-lstm', which walks its paths to the end" in told
    (tmp_path / "taken").write_text("0 0\n1 1\n", encoding="utf-8")
    assert "expected a folder, this is a file" in fails(*circle, "-o", tmp_path / "taken")
    assert "empty name" in fails(*circle, "-o", " ")
    assert "follows a control signal" in fails("generate", "--pretrained", NAME, *out)
    assert not (tmp_path / "out").exists()
    assert main([*map(str, circle), "--pace", "60", *map(str, out)]) == 0
    told = capsys.readouterr().err
    assert told.count("note: ") == 1 and "60 m/s were asked for" in told


def test_bad_input_from_code(checkpoint):
    for path, told in (([], "path"), ([[0, 0]], "path of 1 points"), ("ring", "no prepared path 'ring'")):
        with pytest.raises(MotionError, match=told):
            walk(checkpoint, path)
    with pytest.raises(MotionError, match="0 people: expected a whole number of 1 or more"):
        walk(checkpoint, "circle", count=0)
    with pytest.raises(MotionError, match="pace -1 m/s"):
        walk(checkpoint, "circle", -1.0)
