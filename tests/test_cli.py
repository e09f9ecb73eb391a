"""The command line as a user meets it: what it writes, what it says, and how it ends when something is wrong."""

from __future__ import annotations

import json
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch

from tutorial_lib.cli import main
from tutorial_lib.motion import Motion, Skeleton, read_bvh, write_bvh
from tutorial_lib.training.checkpoints import load_checkpoint, read_header

PROJECT = pathlib.Path(__file__).resolve().parents[1]
FAST = ["--steps", "8", "--hidden", "6", "--layers", "2", "--batch", "4", "--length", "20"]


def person() -> Skeleton:
    """Nine nodes of a small person, 1.4 m tall."""
    return Skeleton(
        ("hips", "spine", "head", "l_thigh", "l_shin", "l_foot", "r_thigh", "r_shin", "r_foot"),
        (-1, 0, 1, 0, 3, 4, 0, 6, 7),
        np.array([[0, 0, 0], [0, 0.35, 0], [0, 0.35, 0], [0.1, 0, 0], [0, -0.35, 0], [0, -0.35, 0],
                  [-0.1, 0, 0], [0, -0.35, 0], [0, -0.35, 0]]),
        ("ZXY",) * 9, frozenset({2, 5, 8}),
    )  # fmt: skip


def swing(frames: int, seed: int, fps: float = 30.0) -> Motion:
    """The person swings legs and trunk, each clip in its own rhythm."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames) / fps
    angle = 0.4 * np.sin(rng.uniform(4, 8) * t[:, None] + rng.uniform(0, 6, 9)) * (np.arange(9) > 0)
    rotations = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle], axis=-1)
    rotations[:, [2, 5, 8]] = [1, 0, 0, 0]
    root = np.stack([0 * t, 0.7 + 0 * t, 0.8 * t], axis=-1)
    return Motion.from_rotations(person(), fps, root, rotations)


@pytest.fixture(scope="module")
def clips(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("clips")
    for k in range(4):
        write_bvh(swing(150, k), folder / f"swing{k}.bvh")
    return folder


@pytest.fixture(scope="module")
def trained(clips, tmp_path_factory) -> pathlib.Path:
    out = tmp_path_factory.mktemp("trained") / "swing.safetensors"
    assert main(["train", "lstm", "--data", str(clips), "--out", str(out), *FAST]) == 0
    return out


@pytest.fixture
def fails(capsys):
    """Run a command that must fail: one line on standard error, status 2; gives the line."""

    def run(*arguments) -> str:
        capsys.readouterr()
        try:
            status = main([str(a) for a in arguments])
        except SystemExit as end:  # argparse
            status = end.code
        out, err = capsys.readouterr()
        lines = [line for line in err.splitlines() if not line.startswith(("note:", "lstm:", "generating:"))]
        assert status == 2 and len(lines) == 1 and lines[0].startswith("error: "), (status, err)
        assert "Traceback" not in out + err
        return lines[0]

    return run


# --- info, view, data -----------------------------------------------------------------------------


def test_info_tells_what_a_file_holds(clips, capsys):
    assert main(["info", str(clips / "swing0.bvh")]) == 0
    name, *lines = capsys.readouterr().out.splitlines()
    told = {line[2:12].strip(): line[12:].strip() for line in lines}
    assert name == str(clips / "swing0.bvh")
    assert told["joints"] == "6, and 3 end sites" and told["frames"] == "150" and told["seconds"] == "5.00"
    assert told["rate"].startswith("30 ") and told["height"] == "1.40 m"
    assert told["units"].startswith("cm") and told["up axis"].startswith("y") and "not" in told["skeleton"]


def test_info_goes_on_after_a_bad_file(clips, tmp_path, capsys):
    bad = tmp_path / "bad.bvh"
    bad.write_text("HIERARCHY\nROOT a\n{\n")
    assert main(["info", str(bad), str(tmp_path / "absent.bvh"), str(clips / "swing0.bvh")]) == 2
    out, err = capsys.readouterr()
    assert "frames     150" in out
    first, second = err.splitlines()
    assert first.startswith(f"error: {bad}:") and second.startswith("error: ") and "absent.bvh" in second


def test_info_of_a_checkpoint(trained, capsys):
    assert main(["info", str(trained)]) == 0
    out = capsys.readouterr().out
    assert "lstm (dim 27, hidden 6, layers 2" in out and "8 of 8 steps, finished" in out
    assert "positions, 27 numbers a frame, 30 frames per second" in out


def test_view_writes_a_page(clips, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert main(["view", str(clips / "swing0.bvh"), str(clips / "swing1.bvh"), "-o", str(page)]) == 0
    text = page.read_text()
    assert text.startswith("<!doctype html>") and "swing0" in text and "swing1" in text
    assert str(page) in capsys.readouterr().out


def test_data_commands(capsys, monkeypatch, tmp_path, fails):
    (tmp_path / "cmu" / "martial").mkdir(parents=True)
    write_bvh(swing(30, 0), tmp_path / "cmu" / "martial" / "a.bvh")
    monkeypatch.setenv("TUTORIAL_DATA", str(tmp_path))
    assert main(["data", "list"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[0].split()[:2] == ["name", "clips"]
    martial = next(row for row in rows if row.startswith("cmu/martial"))
    assert "TUTORIAL_DATA" in martial and "MIT" in martial and martial.split()[1] == "1"
    assert any("CC BY-NC" in row for row in rows if row.startswith("bandai-namco"))
    assert main(["data", "where", "cmu/martial"]) == 0
    assert capsys.readouterr().out.strip() == str((tmp_path / "cmu" / "martial").resolve())
    assert "did you mean cmu/martial" in fails("data", "where", "cmu/marital")
    assert "unknown data set" in fails("data", "fetch", "cmu/marital")


# --- train, generate, evaluate --------------------------------------------------------------------


def test_train_writes_weights_and_where_they_come_from(trained, clips):
    checkpoint = load_checkpoint(trained)
    assert checkpoint.config == {"dim": 27, "hidden": 6, "layers": 2}
    origin, training = checkpoint.provenance, checkpoint.training
    assert origin["data"] == str(clips) and len(origin["clips"]) == 3 and len(origin["test_clips"]) == 1
    assert sorted(origin["clips"] + origin["test_clips"]) == [f"swing{k}" for k in range(4)]
    assert origin["command"].startswith("python -m tutorial_lib train lstm --data")
    assert training["status"] == "finished" and training["steps_done"] == 8 and training["batch"] == 4
    assert checkpoint.normalizer is None and not read_header(trained)["resumable"]
    assert trained.stat().st_size < 4 * checkpoint.n_parameters + 20_000
    # 1.4 m tall in the files, 1.54 m in training as in the paper
    assert np.ptp(checkpoint.representation.skeleton.rest_pose()[:, 1]) == pytest.approx(1.54)


@pytest.mark.parametrize("options", [
    ["--representation", "sixd", "--rates", "24", "30"],
    ["--representation", "quaternion", "--height", "0", "--no-rotate", "--normalize", "off", "--test-fraction", "0"],
])  # fmt: skip
def test_train_options(clips, tmp_path, options):
    out = tmp_path / "x.safetensors"
    assert main(["train", "lstm", "--data", str(clips), "--out", str(out), *FAST, *options]) == 0
    checkpoint = load_checkpoint(out)
    assert checkpoint.representation.name == options[1]
    assert (checkpoint.normalizer is None) == ("off" in options)
    assert len(checkpoint.provenance["clips"]) == (4 if "off" in options else 3)


def test_train_on_a_named_data_set(clips, tmp_path, monkeypatch, capsys):
    (tmp_path / "data" / "cmu").mkdir(parents=True)
    (tmp_path / "data" / "cmu" / "salsa").symlink_to(clips)
    monkeypatch.setenv("TUTORIAL_DATA", str(tmp_path / "data"))
    out = tmp_path / "x.safetensors"
    assert main(["train", "lstm", "--data", "cmu/salsa", "--out", str(out), *FAST]) == 0
    assert load_checkpoint(out).provenance["data"] == "cmu/salsa"
    capsys.readouterr()
    made = tmp_path / "made"
    assert main(["generate", str(out), "--frames", "9", "-o", str(made)]) == 0  # finds its data set again
    assert "seeds from cmu/salsa: 1 clips never trained on" in capsys.readouterr().out
    assert len(read_bvh(made / "x-01.bvh")) == 9


def test_one_clip_is_trained_on_whole(clips, tmp_path, capsys):
    out = tmp_path / "x.safetensors"
    assert main(["train", "lstm", "--data", str(clips / "swing1.bvh"), "--out", str(out), *FAST]) == 0
    assert "a single clip" in capsys.readouterr().err
    assert load_checkpoint(out).provenance["clips"] == ["swing1"]


def test_generate_writes_files_of_the_asked_length(trained, tmp_path):
    folder = tmp_path / "made"
    command = ["generate", str(trained), "--frames", "25", "--count", "3", "--seed", "5", "-o", str(folder)]
    assert main(command) == 0
    names = sorted(p.name for p in folder.iterdir())
    assert names == ["swing-01.bvh", "swing-02.bvh", "swing-03.bvh"]
    first = {name: (folder / name).read_bytes() for name in names}
    motions = [read_bvh(folder / name) for name in names]
    assert [len(m) for m in motions] == [25] * 3 and motions[0].fps == 30
    assert [motions[0].skeleton.names[j] for j in motions[0].skeleton.joints] == [
        person().names[j] for j in person().joints
    ]
    assert len(set(first.values())) == 3
    assert main(command) == 0  # again into the same folder: the same files
    assert {name: (folder / name).read_bytes() for name in names} == first
    assert sorted(p.name for p in tmp_path.iterdir()) == ["made"]
    assert main([*command[:-1], str(tmp_path / "seeded"), "--keep-seed", "--seed-frames", "7"]) == 0
    assert len(read_bvh(tmp_path / "seeded" / "swing-01.bvh")) == 32


def test_generated_files_are_what_the_network_makes(trained, clips, tmp_path):
    from tutorial_lib.generate import generate
    from tutorial_lib.motion import read_motion

    assert main(["generate", str(trained), "--frames", "12", "-o", str(tmp_path / "m"), "--data", str(clips)]) == 0
    checkpoint = load_checkpoint(trained)
    test = [read_motion(clips / f"{name}.bvh") for name in checkpoint.provenance["test_clips"]]
    wanted = generate(checkpoint, 12, seeds=test)[0].positions[10:]
    found = read_bvh(tmp_path / "m" / "swing-01.bvh")
    joints = list(found.skeleton.joints)  # the file format holds an end site at a fixed distance
    np.testing.assert_allclose(found.positions[:, joints], wanted[:, joints], atol=2e-5)


def test_evaluate_writes_json(trained, clips, tmp_path, capsys):
    report = tmp_path / "r.json"
    command = ["evaluate", str(trained), "--data", str(clips), "--json", str(report), "--frames", "40", "--count", "3"]
    assert main(command) == 0
    result = json.loads(report.read_text())
    assert result["clips"] == load_checkpoint(trained).provenance["test_clips"]
    assert result["checkpoint"] == "swing.safetensors" and result["frames"] == 40 and result["seeds"] == 3
    assert len(result["prediction_error"]) == 8 and all(e > 0 for e in result["prediction_error"].values())
    out = capsys.readouterr().out
    assert "prediction error" in out and "never trained on" in out and str(report) in out


# --- resuming -------------------------------------------------------------------------------------


LONGER = [*FAST, "--steps", "400"]


def start(out: pathlib.Path, clips: pathlib.Path, *options: str) -> subprocess.Popen:
    """A run of its own, with as many threads as this process has, that saves after every step."""
    return subprocess.Popen(
        [sys.executable, "-m", "tutorial_lib", "train", "lstm", "--data", str(clips), "--out", str(out),
         "--save-seconds", "0", "--threads", str(torch.get_num_threads()), *options],
        cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def wait_for_steps(out: pathlib.Path, child: subprocess.Popen, steps: int) -> None:
    deadline = time.monotonic() + 60
    while not (out.exists() and read_header(out)["training"]["steps_done"] >= steps):
        assert time.monotonic() < deadline and child.poll() is None, "the run did not start, or ended too soon"
        time.sleep(0.005)


def test_killed_interrupted_and_whole_runs_are_the_same(clips, tmp_path, capsys, fails):
    """Killed, then interrupted by Ctrl-C, then finished: the weights of a run that nothing happened to."""
    whole, out = tmp_path / "whole.safetensors", tmp_path / "killed.safetensors"
    assert main(["train", "lstm", "--data", str(clips), "--out", str(whole), *LONGER]) == 0
    child = start(out, clips, *LONGER)
    wait_for_steps(out, child, 5)
    child.kill()
    child.communicate()
    assert child.returncode == -signal.SIGKILL
    killed_at = read_header(out)["training"]["steps_done"]
    assert 5 <= killed_at < 400
    assert "--resume" in fails("train", "lstm", "--data", clips, "--out", out, *LONGER)
    told = fails("train", "lstm", "--data", clips, "--out", out, "--resume", "--hidden", "7")
    assert "hidden 6" in told and "asked for 7" in told
    child = start(out, clips, "--resume")  # the settings are in the file
    wait_for_steps(out, child, killed_at + 5)
    child.send_signal(signal.SIGINT)
    stdout, stderr = child.communicate(timeout=60)
    assert child.returncode == 130 and f"going on after step {killed_at}" in stdout
    assert "--resume goes on" in stderr and "Traceback" not in stderr
    command = ["train", "lstm", "--data", str(clips), "--out", str(out), "--resume"]
    assert main(command) == 0
    ours, theirs = (load_checkpoint(p).model.state_dict() for p in (out, whole))
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)
    capsys.readouterr()
    assert main(command) == 0
    assert "already finished" in capsys.readouterr().out


def test_resume_starts_what_is_not_there(clips, tmp_path):
    out = tmp_path / "x.safetensors"
    assert main(["train", "lstm", "--data", str(clips), "--out", str(out), *FAST, "--resume"]) == 0
    assert load_checkpoint(out).training["steps_done"] == 8


# --- what a user can get wrong --------------------------------------------------------------------


def test_wrong_training_arguments(clips, tmp_path, fails):
    out = tmp_path / "x.safetensors"

    def train(*options, system="lstm", data=clips):
        return fails("train", system, "--data", data, "--out", out, *FAST, *options)

    assert "unknown system 'lsmt'; did you mean lstm" in train(system="lsmt")
    assert "unknown data set" in train(data="cmu/marital")
    assert "no clip is long enough for a window of 200 frames" in train("--length", "200")
    assert "unknown representation 'cube'" in train("--representation", "cube")
    assert "hips and shoulders" in train("--representation", "hip-frame")
    assert "whole number of 1 or more, not '0'" in train("--steps", "0")
    assert "above 0" in train("--lr", "-1")
    assert "cannot compute on device 'toaster'" in train("--device", "toaster")
    assert "unrecognized arguments: --hiden" in train("--hiden", "3")
    assert "between 0 and 1" in train("--test-fraction", "1.5")
    assert "this is a folder" in fails("train", "lstm", "--data", clips, "--out", tmp_path, *FAST)
    assert "this is a file" in fails("train", "lstm", "--data", clips, "--out", clips / "swing0.bvh" / "x", *FAST)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no motion file" in train(data=empty)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty"]


def test_training_that_blows_up_is_one_line(clips, tmp_path, fails):
    out = tmp_path / "x.safetensors"
    told = fails("train", "lstm", "--data", clips, "--out", out, *FAST, "--steps", "60", "--lr", "1e30",
                 "--schedule", "constant")  # fmt: skip
    assert "training stopped" in told
    assert "nothing was learnt" in told or load_checkpoint(out).training["status"] != "finished"


def test_checkpoints_that_are_none(trained, clips, tmp_path, fails):
    text = tmp_path / "text.safetensors"
    text.write_text("hello")
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(trained.read_bytes()[:-100])
    for path, message in [(text, "not a checkpoint"), (cut, "cut off"), (tmp_path / "absent", "no such file")]:
        assert message in fails("generate", path, "-o", tmp_path / "made")
        assert message in fails("evaluate", path, "--data", clips, "--json", tmp_path / "r.json")
    assert "cut off" in fails("info", cut)
    assert "cut off" in fails("train", "lstm", "--data", clips, "--out", cut, "--resume")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cut.safetensors", "text.safetensors"]


def test_generate_with_what_does_not_fit(trained, clips, tmp_path, fails):
    made = tmp_path / "made"
    assert "a seed needs 500 frames" in fails("generate", trained, "-o", made, "--seed-frames", "500")
    assert "unknown data set 'nobody'" in fails("generate", trained, "-o", made, "--data", "nobody")
    other = tmp_path / "other.bvh"
    stick = Skeleton(("a", "b"), (-1, 0), np.eye(3)[:2], ("ZXY",) * 2, frozenset({1}))
    write_bvh(Motion.from_rotations(stick, 30.0, np.zeros((40, 3)), np.eye(4)[[0, 0]][None].repeat(40, 0)), other)
    told = fails("generate", trained, "-o", made, "--data", other)
    assert "2 nodes" in told and "9" in told
    assert "30 frames or more" in fails("evaluate", trained, "--data", clips, "--frames", "5")
    assert not made.exists()
    made.write_text("a file")
    assert "expected a folder" in fails("generate", trained, "-o", made)
    assert made.read_text() == "a file"


def test_nothing_is_left_when_writing_fails(trained, tmp_path, monkeypatch, fails):
    calls = []

    def second_fails(motion, path):
        calls.append(path)
        if len(calls) == 2:
            raise OSError(28, "No space left on device", str(path))
        pathlib.Path(path).write_text("x")

    monkeypatch.setattr("tutorial_lib.motion.bvh.write_bvh", second_fails)
    assert "No space left on device" in fails("generate", trained, "--count", "3", "--frames", "5",
                                              "-o", tmp_path / "made")  # fmt: skip
    assert len(calls) == 2 and list(tmp_path.iterdir()) == []


def test_help_is_quick_and_light():
    """Neither torch nor matplotlib is imported for a help text; each command shows an example."""
    code = ("import sys; from tutorial_lib.cli import main\n"
            "try: main(sys.argv[1:])\n"
            "except SystemExit as end: assert end.code == 0\n"
            "assert not {'torch', 'matplotlib', 'numpy'} & set(sys.modules)")  # fmt: skip
    for command in ([], ["info"], ["view"], ["train"], ["generate"], ["evaluate"], ["data", "fetch"]):
        done = subprocess.run([sys.executable, "-c", code, *command, "--help"], cwd=PROJECT, text=True,
                              capture_output=True, check=True)  # fmt: skip
        assert "usage: python -m tutorial_lib" in done.stdout
        assert not command or "example: python -m tutorial_lib" in done.stdout


def test_module_is_a_command(tmp_path):
    done = subprocess.run([sys.executable, "-m", "tutorial_lib", "info", str(tmp_path / "absent.bvh")], cwd=PROJECT,
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1


def test_real_clips_train_generate_and_evaluate(real_data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TUTORIAL_DATA", str(real_data.resolve()))
    out = tmp_path / "m.safetensors"
    assert main(["train", "lstm", "--data", "cmu/martial", "--out", str(out), *FAST]) == 0
    assert main(["generate", str(out), "--frames", "30", "--count", "2", "-o", str(tmp_path / "made")]) == 0
    made = read_bvh(tmp_path / "made" / "m-02.bvh")
    assert len(made) == 30 and made.skeleton.n_joints == 57
    assert main(["evaluate", str(out), "--data", "cmu/martial", "--frames", "30", "--count", "2"]) == 0
    assert "foot skate" in capsys.readouterr().out
