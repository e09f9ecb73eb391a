"""The command line as a user meets it: what it writes, what it says, and how it ends when something is wrong."""

from __future__ import annotations

import io
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch

from tutorial_lib.cli import main
from tutorial_lib.cli.files import _labels
from tutorial_lib.cli.train import SYSTEM_OPTIONS
from tutorial_lib.data import catalog
from tutorial_lib.motion import Motion, Skeleton, read_bvh, write_bvh
from tutorial_lib.training import rollout_benchmark
from tutorial_lib.training.checkpoints import load_checkpoint, read_header
from tutorial_lib.training.conditioning import auto_conditioning
from tutorial_lib.training.rollout import rollout
from tutorial_lib.training.systems import SYSTEMS, make_system
from tutorial_lib.training.trainer import Trainer

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


def test_info_says_which_files_it_can_tell_of(tmp_path, fails):
    (tmp_path / "notes.md").write_text("# none")
    assert "this is a folder, expected files" in fails("info", tmp_path)
    assert "suffix '.md', expected one of .bvh, .amc, .safetensors" in fails("info", tmp_path / "notes.md")


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


def test_files_of_one_name_are_told_apart_by_their_folders(clips, tmp_path, monkeypatch):
    for name in ("a/01.bvh", "b/01.bvh", "b/02.bvh", "03.bvh"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(clips / "swing0.bvh", tmp_path / name)
    assert _labels([str(tmp_path / name) for name in ("a/01.bvh", "b/01.bvh", "b/02.bvh")]) == ["a/01", "b/01", "02"]
    monkeypatch.chdir(tmp_path / "a")
    assert _labels(["01.bvh", "../b/01.bvh"]) == ["a/01", "b/01"]
    page = tmp_path / "page.html"
    assert main(["view", "01.bvh", "../b/01.bvh", "../03.bvh", "-o", str(page)]) == 0
    assert re.findall(r'"name":"([^"]*)"', page.read_text()) == ["a/01", "b/01", "03"]


def test_file_names_that_are_not_utf8(clips, tmp_path, monkeypatch):
    odd = tmp_path / "caf\udce9.bvh"  # how Python shows the byte E9
    try:
        shutil.copy(clips / "swing0.bvh", odd)
    except OSError:
        pytest.skip("this file system has no such names")
    commands = (["info", str(odd)], ["view", str(odd), "-o", str(tmp_path / "\udce9.html")])
    for command in commands:
        raw = io.BytesIO()
        monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="utf-8", errors="strict"))
        assert main(command) == 0
        sys.stdout.flush()
        assert rb"\udce9" in raw.getvalue()
    assert r"<title>caf\udce9: " in (tmp_path / "\udce9.html").read_text(encoding="utf-8")
    for stream in (io.StringIO(), None):  # that of a program around this one, and none at all
        monkeypatch.setattr(sys, "stdout", stream)
        assert main(commands[0]) == 0
    kept = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="surrogateescape")  # as a user chose it
    monkeypatch.setattr(sys, "stdout", kept)
    assert main(commands[0]) == 0 and kept.errors == "surrogateescape"


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
    capsys.readouterr()
    cache = tmp_path / "cache"
    monkeypatch.setattr(catalog, "default_cache", lambda: cache)
    for _ in range(2):
        assert main(["data", "where", "cmu/boxing"]) == 0
        assert "cmu/boxing is not at hand yet" in capsys.readouterr().err
        catalog.where("cmu/boxing").mkdir(parents=True, exist_ok=True)  # as a fetch without a network leaves it
    assert main(["data", "fetch", "cmu/martial"]) == 0  # at hand: nothing is asked of the network
    told = capsys.readouterr()
    assert "nothing to fetch" in told.out and str(tmp_path.resolve()) in told.out


# --- train, generate, evaluate --------------------------------------------------------------------


def test_train_writes_weights_and_where_they_come_from(trained, clips):
    checkpoint = load_checkpoint(trained)
    assert checkpoint.config == {"dim": 27, "hidden": 6, "layers": 2}
    origin, training = checkpoint.provenance, checkpoint.training
    assert origin["data"] == str(clips) and len(origin["clips"]) == 3 and len(origin["test_clips"]) == 1
    assert sorted(origin["clips"] + origin["test_clips"]) == [f"{clips.name}/swing{k}" for k in range(4)]
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
    assert load_checkpoint(out).provenance["clips"] == [f"{clips.name}/swing1"]


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
    noisy = [*command[:-1], str(tmp_path / "noisy"), "--noise"]
    assert main([*noisy, "0"]) == 0 and (tmp_path / "noisy" / names[0]).read_bytes() == first[names[0]]
    assert main([*noisy, "0.05"]) == 0 and (tmp_path / "noisy" / names[0]).read_bytes() != first[names[0]]


def test_generated_files_are_what_the_network_makes(trained, clips, tmp_path):
    from tutorial_lib.generate import generate
    from tutorial_lib.motion import read_motion

    assert main(["generate", str(trained), "--frames", "12", "-o", str(tmp_path / "m"), "--data", str(clips)]) == 0
    checkpoint = load_checkpoint(trained)
    test = [read_motion(clips.parent / f"{name}.bvh") for name in checkpoint.provenance["test_clips"]]
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
    for name in theirs:  # a step lost or done twice, or other batches, would be seen at 1e-2
        torch.testing.assert_close(ours[name], theirs[name], rtol=0, atol=1e-4, msg=lambda m, n=name: f"{n}: {m}")
    capsys.readouterr()
    assert main(command) == 0
    assert "already finished" in capsys.readouterr().out


def test_a_finished_file_is_not_taken_for_another_run(trained, clips, tmp_path, capsys, fails):
    out = tmp_path / "x.safetensors"
    out.write_bytes(trained.read_bytes())

    def resume(*options, system="lstm", data=clips) -> tuple:
        return "train", system, "--data", data, "--out", out, "--resume", *options

    assert "holds a run with system 'lstm', asked for 'erd'; leave SYSTEM as it was" in fails(*resume(system="erd"))
    assert "holds a run with steps 8, asked for 9; leave --steps as it was" in fails(*resume(*FAST, "--steps", "9"))
    assert "holds a run with data" in fails(*resume(data="samples/walking"))
    capsys.readouterr()
    assert main([str(a) for a in resume(*FAST)]) == 0
    assert "already finished, 8 steps" in capsys.readouterr().out
    assert out.read_bytes() == trained.read_bytes()


def test_resume_starts_what_is_not_there(clips, tmp_path):
    out = tmp_path / "x.safetensors"
    assert main(["train", "lstm", "--data", str(clips), "--out", str(out), *FAST, "--resume"]) == 0
    assert load_checkpoint(out).training["steps_done"] == 8


@pytest.mark.parametrize(
    "system, options, kept",
    [
        ("aclstm", ["--u", "3", "--v", "2", "--noise", "0.02"], {"u": 3, "v": 2, "noise": 0.02}),
        ("aclstm", [], {"u": 5, "v": 5}),
        (
            "scheduled-sampling",
            ["--probability", "0.3", "--decay", "inverse-sigmoid"],
            {"probability": 0.3, "decay": "inverse-sigmoid"},
        ),
        ("erd", ["--noise", "0.02"], {"noise": 0.02}),
        ("seq2seq", ["--n-seed", "9", "--n-future", "4"], {"n_seed": 9, "n_future": 4}),
    ],
)
def test_other_systems_are_trained_and_told_in_the_file(system, options, kept, clips, tmp_path, trained, capsys):
    out = tmp_path / "x.safetensors"
    assert main(["train", system, "--data", str(clips), "--out", str(out), *FAST, *options]) == 0
    checkpoint = load_checkpoint(out)
    assert checkpoint.system == system and kept.items() <= checkpoint.training.items()
    vanilla = load_checkpoint(trained).model.state_dict()  # the same beginning, the same windows, yet another network
    ours = checkpoint.model.state_dict()
    assert ours.keys() != vanilla.keys() or not torch.equal(ours["readout.weight"], vanilla["readout.weight"])
    assert main(["generate", str(out), "--frames", "5", "-o", str(tmp_path / "made")]) == 0
    capsys.readouterr()
    assert main(["info", str(out)]) == 0
    assert f"{system} (dim 27, hidden 6, layers 2" in capsys.readouterr().out


def test_every_option_and_system_can_be_asked_for(capsys):
    assert sorted(SYSTEM_OPTIONS) == sorted({option for kind in SYSTEMS.values() for option in kind.options})
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    told = capsys.readouterr().out
    for flag in (f"--{option.replace('_', '-')}" for option in SYSTEM_OPTIONS):
        assert re.search(rf"^  {flag}\b", told, re.MULTILINE), flag
    assert all(system in told for system in SYSTEMS)


def test_the_vae_lstm_is_trained_by_the_same_command(tmp_path, capsys, fails, monkeypatch):
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)
    out, data = tmp_path / "vae.safetensors", ["samples/walking", "samples/running"]
    sizes = ["--hidden", "6", "--filters", "4", "--kernel", "5"]
    train = ["train", "vae-lstm", "--data", *data, "--out", str(out), *sizes]
    assert main([*train, "--batch", "64", "--length", "40", "--steps", "3", "--deviation", "0.5"]) == 0
    assert "samples/walking + samples/running: 8 clips to train on" in capsys.readouterr().out
    checkpoint = load_checkpoint(out)
    assert checkpoint.config["control"] == (63, 66) and checkpoint.config["kernel"] == 5
    assert checkpoint.training["deviation"] == 0.5 and checkpoint.training["pad"] and checkpoint.normalizer.dim == 66
    assert main([*train, "--resume"]) == 0 and "already finished, 3 steps" in capsys.readouterr().out
    told = fails("generate", out, "-o", tmp_path / "made", "--data", data[0])
    assert "follows a control signal" in told and not (tmp_path / "made").exists()
    told = fails(*train, "--out", tmp_path / "x", "--length", "41")
    assert "multiple of 4 frames, the length is 41" in told
    assert "--filters is not for system 'lstm'" in fails("train", "lstm", *train[2:], "--out", tmp_path / "x")
    assert "no number of layers" in fails(*train, "--out", tmp_path / "x", "--layers", "2")
    assert "root and joints only: expected hip-frame" in fails(
        *train, "--out", tmp_path / "x", "--representation", "positions"
    )


def test_hybrid_training_is_told_and_resumed(clips, tmp_path, capsys, fails, monkeypatch):
    other, out = tmp_path / "other", tmp_path / "x.safetensors"
    other.mkdir()
    for k in range(2):
        write_bvh(swing(60, 10 + k), other / f"swing{k}.bvh")
    command = ["train", "seq2seq", "--data", str(clips), str(other), "--out", str(out), *FAST]
    command += ["--n-seed", "5", "--n-future", "3"]
    run = Trainer.run
    monkeypatch.setattr(Trainer, "run", lambda self: run(self, max_seconds=0.0))
    assert main(command) == 130
    monkeypatch.undo()
    assert "holds a run with data" in fails("train", "seq2seq", "--data", clips, "--out", out, "--resume")
    assert "holds a run with n_seed 5, asked for 6; leave --n-seed" in fails(*command, "--n-seed", "6", "--resume")
    assert main(["train", "seq2seq", "--data", str(clips), str(other), "--out", str(out), "--resume"]) == 0
    assert f"{clips} + {other}: 4 clips to train on" in capsys.readouterr().out
    origin = load_checkpoint(out).provenance
    assert origin["data"] == [str(clips), str(other)]
    assert sorted(origin["clips"] + origin["test_clips"]) == sorted(
        [f"{clips.name}/swing{k}" for k in range(4)] + [f"other/swing{k}" for k in range(2)]
    )
    assert {name.split("/")[0] for name in origin["test_clips"]} == {clips.name, "other"}
    assert main(["info", str(out)]) == 0
    assert f"{clips} + {other}, 4 clips" in capsys.readouterr().out
    assert main(["generate", str(out), "--frames", "3", "-o", str(tmp_path / "made")]) == 0  # seeds from both


def test_a_schedule_is_resumed_as_it_was(clips, tmp_path, fails, monkeypatch):
    out = tmp_path / "x.safetensors"
    command = ["train", "aclstm", "--data", str(clips), "--out", str(out), *FAST]
    run = Trainer.run
    monkeypatch.setattr(Trainer, "run", lambda self: run(self, max_seconds=0.0))
    assert main([*command, "--u", "2"]) == 130
    monkeypatch.undo()
    assert "holds a run with u 2, asked for 3; leave --u as it was" in fails(*command, "--resume", "--u", "3")
    assert "holds a run with system 'aclstm'" in fails("train", "lstm", *command[2:], "--resume")
    assert main([*command, "--resume"]) == 0
    training = load_checkpoint(out).training
    assert training["u"] == 2 and training["v"] == 5 and training["steps_done"] == 8


def test_benchmark_of_the_rollout_ends_in_one_line_of_ratios(capsys, monkeypatch):
    small = rollout_benchmark.time_synthesis
    monkeypatch.setattr(rollout_benchmark, "time_synthesis", lambda repeats: small(16, frames=5, repeats=repeats))
    threads = torch.get_num_threads()
    assert main(["benchmark", "rollout", "--hidden", "8", "--threads", "1", "--repeats", "1"]) == 0
    _, training, synthesis, last = capsys.readouterr().out.splitlines()
    for line in (training, synthesis):
        assert re.search(r"; matrix products alone \S+ (s|frames/s), \d+\.\d\dx at most$", line)
    match = re.fullmatch(r"training (\d+\.\d\d)x, synthesis (\d+\.\d\d)x, hidden 8", last)
    assert match and all(float(ratio) > 0 for ratio in match.groups())
    assert torch.get_num_threads() == threads


def test_benchmark_compares_the_same_computation():
    model = make_system("aclstm", 4, hidden=6, layers=2).model.double()
    loop = rollout_benchmark.CellLoop(model).double()
    x = torch.randn(3, 9, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    fed = auto_conditioning(9, 2, 2)
    torch.testing.assert_close(loop(x, fed.tolist()), rollout(model, x, fed)[0])


@pytest.mark.parametrize("pair", [(1, 1), (2, 3), (9, 1)])
def test_benchmark_counts_no_product_more_than_once(pair):
    """Multiplications of a step: forward, as many for the gradients of what is read, and again for the weights'."""
    B, D, H, L, schedule = 3, 4, 6, 2, auto_conditioning(9, *pair)
    found = sum(m * k * n for m, k, n in rollout_benchmark.training_products(H, L, D, B, schedule))
    frame = 4 * H * (D + H + (L - 1) * 2 * H) + H * D
    assert found == B * (3 * 9 * frame - int(schedule.sum()) * 4 * H * D)  # of the truth nothing wants a gradient


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
    assert "--u is not for system 'lstm'" in train("--u", "3")
    assert "--decay is not for system 'aclstm'" in train("--decay", "linear", system="aclstm")
    assert "whole number of 1 or more, not '0'" in train("--v", "0", system="aclstm")
    assert "between 0 and 1, not at 1.5" in train("--probability", "1.5", system="scheduled-sampling")
    assert "exponential decay ends at a probability above 0" in train(
        "--probability", "0", "--decay", "exponential", system="scheduled-sampling"
    )
    assert "--n-seed is not for system 'erd'" in train("--n-seed", "3", system="erd")
    assert "number of 0 or more, not '-1'" in train("--noise", "-1", system="erd")
    told = train(system="seq2seq")
    assert "needs windows of 75 frames" in told and "n_seed 50, n_future 25" in told and "the length is 20" in told
    assert "is given twice" in fails("train", "lstm", "--data", clips, clips, "--out", out, *FAST)
    told = fails("train", "lstm", "--data", clips, "samples/walking", "--out", out, *FAST)
    assert "different skeletons" in told and "9 nodes" in told and "24" in told and "--joints common" in told
    told = fails("train", "lstm", "--data", clips, "--out", out, *FAST, "--joints", "common")
    assert "unknown skeleton (hips, spine" in told
    assert "cannot compute on device 'toaster'" in train("--device", "toaster")
    assert "unrecognized arguments: --hiden" in train("--hiden", "3")
    assert "between 0 and 1" in train("--test-fraction", "1.5")
    assert "this is a folder" in fails("train", "lstm", "--data", clips, "--out", tmp_path, *FAST)
    assert "this is a file" in fails("train", "lstm", "--data", clips, "--out", clips / "swing0.bvh" / "x", *FAST)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no motion file" in train(data=empty)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty"]


@pytest.mark.parametrize(
    "command, option, value, bound",
    [
        ("train", "--hidden", "16385", "at most 16384"),
        ("train", "--layers", "65", "at most 64"),
        ("train", "--batch", "65537", "at most 65536"),
        ("train", "--length", "100001", "at most 100000"),
        ("train", "--steps", "1000000001", "at most 1000000000"),
        ("train", "--seed", str(2**63), f"at most {2**63 - 1}"),
        ("train", "--fps", "1000.5", "at most 1000"),
        ("train", "--rates", "2000", "at most 1000"),
        ("train", "--height", "0.09", "between 0.1 and 10"),
        ("train", "--height", "154", "between 0.1 and 10"),
        ("train", "--threads", str(4 * os.cpu_count() + 1), f"at most {min(1024, 4 * os.cpu_count())}"),
        ("generate", "--frames", "10000001", "at most 10000000"),
        ("generate", "--count", "1000001", "at most 1000000"),
        ("generate", "--seed", str(2**64), f"at most {2**63 - 1}"),
        ("generate", "--seed", "-1", "of 0 or more"),
        ("evaluate", "--frames", "9" * 5000, "at most 10000000"),
        ("evaluate", "--count", "1000001", "at most 1000000"),
        ("evaluate", "--seed", str(2**63), f"at most {2**63 - 1}"),
        ("benchmark", "--hidden", "99999", "at most 16384"),
    ],
)
def test_numbers_past_use_are_told_at_once(command, option, value, bound, fails):
    told = fails(command, option, value)
    assert f"argument {option}:" in told and bound in told and len(told) < 300


def test_the_largest_seed_and_the_smallest_height_are_taken(clips, tmp_path):
    out = tmp_path / "x.safetensors"
    command = ["train", "lstm", "--data", str(clips), "--out", str(out), *FAST, "--height", "0.1"]
    assert main([*command, "--seed", str(2**63 - 1)]) == 0
    assert main(["generate", str(out), "--seed", str(2**63 - 1), "--frames", "3", "-o", str(tmp_path / "made")]) == 0
    assert main(["evaluate", str(out), "--data", str(clips), "--seed", str(2**63 - 1), "--frames", "30"]) == 0
    assert load_checkpoint(out).training["seed"] == 2**63 - 1


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 9.1 TiB"),
        MemoryError(),
        RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes.\n(12)"),
        RuntimeError("DefaultCPUAllocator: not enough memory: you tried to allocate 9 bytes."),
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 9 GiB"),
    ],
)
def test_too_little_memory_is_one_line(error, clips, tmp_path, monkeypatch, fails):
    def run(self):
        raise error

    monkeypatch.setattr(Trainer, "run", run)
    told = fails("train", "lstm", "--data", clips, "--out", tmp_path / "x.safetensors", *FAST)
    assert told.startswith("error: not enough memory") and "batch" in told and list(tmp_path.iterdir()) == []
    assert any(f"memory for {size};" in told for size in ("9.1 TiB", "9 bytes", "9 GiB")) == bool(str(error))


def test_other_runtime_errors_are_not_taken_for_it(clips, tmp_path, monkeypatch):
    def run(self):
        raise RuntimeError("a defect of ours")

    monkeypatch.setattr(Trainer, "run", run)
    with pytest.raises(RuntimeError, match="a defect of ours"):
        main(["train", "lstm", "--data", str(clips), "--out", str(tmp_path / "x.safetensors"), *FAST])


def test_no_command_writes_over_its_own_input(trained, tmp_path, fails):
    clip, link, model = tmp_path / "w.bvh", tmp_path / "link.html", tmp_path / "m.safetensors"
    write_bvh(swing(150, 0), clip)
    link.symlink_to(clip)
    model.write_bytes(trained.read_bytes())
    made = tmp_path / "made"
    made.mkdir()
    write_bvh(swing(150, 1), made / "m-02.bvh")
    files = [clip, model, made / "m-02.bvh"]
    before = [file.read_bytes() for file in files]
    for command in [
        ("view", clip, "-o", clip),
        ("view", clip, "-o", link),
        ("view", clip, "-o", made / ".." / "w.bvh"),
        ("train", "lstm", "--data", clip, "--out", clip, *FAST),
        ("train", "lstm", "--data", made, "--out", made / "m-02.bvh", *FAST),
        ("train", "lstm", "--data", clip, "--start", model, "--out", made / ".." / "m.safetensors", *FAST),
        ("evaluate", model, "--data", clip, "--json", model),
        ("evaluate", model, "--data", clip, "--json", clip),
        ("generate", model, "--data", made, "--count", "3", "-o", made),
    ]:
        assert "is read by this command" in fails(*command)
    assert [file.read_bytes() for file in files] == before
    assert main(["generate", str(model), "--data", str(made), "--frames", "3", "-o", str(made)]) == 0  # m-01 only
    assert files[2].read_bytes() == before[2] and len(read_bvh(made / "m-01.bvh")) == 3


def test_generate_spares_the_clips_that_the_checkpoint_names(tmp_path, fails):
    made, out = tmp_path / "made", tmp_path / "m.safetensors"
    made.mkdir()
    write_bvh(swing(150, 1), made / "m-01.bvh")
    assert main(["train", "lstm", "--data", str(made), "--out", str(out), *FAST]) == 0
    assert "is read by this command" in fails("generate", out, "--frames", "3", "-o", made)


def test_train_replaces_checkpoints_only(trained, clips, tmp_path, fails):
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    told = fails("train", "lstm", "--data", clips, "--out", notes, *FAST)
    assert "not a checkpoint of this library" in told and notes.read_text() == "mine"
    old = tmp_path / "old.safetensors"
    old.write_bytes(trained.read_bytes())
    assert main(["train", "lstm", "--data", str(clips), "--out", str(old), *FAST, "--seed", "9"]) == 0
    assert load_checkpoint(old).training["seed"] == 9


def test_empty_names_of_outputs(trained, clips, fails):
    for command in [
        ("view", clips / "swing0.bvh", "-o", ""),
        ("train", "lstm", "--data", clips, "--out", "", *FAST),
        ("generate", trained, "-o", ""),
        ("evaluate", trained, "--data", clips, "--json", ""),
    ]:
        assert "empty name" in fails(*command)


def test_a_folder_that_cannot_be_written_is_told_before_generating(trained, tmp_path, fails, monkeypatch):
    def generate(*_, **__):
        raise AssertionError("generated in vain")

    monkeypatch.setattr("tutorial_lib.generate.generate", generate)
    monkeypatch.setattr(os, "access", lambda path, mode: pathlib.Path(path) != tmp_path)  # also as root
    told = fails("generate", trained, "-o", tmp_path / "par" / "out")
    assert told == f"error: {tmp_path}: the folder cannot be written to"
    monkeypatch.undo()
    monkeypatch.setattr("tutorial_lib.generate.generate", generate)
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        assert fails("generate", trained, "-o", out) == f"error: {tmp_path / 'file'}: expected a folder, this is a file"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_generated_samples_are_accepted_by_path(tmp_path, capsys, monkeypatch):
    """The sample skeleton has no end sites, its files have empty ones: by name and by path it is the same."""
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)
    out, made, samples = tmp_path / "w.safetensors", tmp_path / "made", PROJECT / "data_samples" / "walking"
    assert main(["train", "lstm", "--data", "samples/walking", "--out", str(out), *FAST]) == 0
    assert main(["generate", str(out), "--frames", "80", "-o", str(made)]) == 0
    for data in (made, samples, samples / "01.bvh"):
        assert main(["evaluate", str(out), "--data", str(data), "--frames", "30", "--count", "2"]) == 0
    assert main(["generate", str(out), "--data", str(made), "--frames", "3", "-o", str(tmp_path / "again")]) == 0


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
    told = fails("generate", trained, "-o", made, "--data", "nobody")
    assert "unknown data set 'nobody'" in told and "nor is there such a file or folder" in told
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
    calls.clear()
    told = fails("generate", trained, "--count", "3", "--frames", "5", "-o", tmp_path / "made")
    assert told == f"error: {tmp_path / 'made'}: No space left on device"  # not a temporary folder


def test_a_full_disk_is_told_by_the_name_of_the_folder(trained, tmp_path, monkeypatch, fails):
    """``write_bvh`` tells the file that it could not write, which lies in a temporary folder."""

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tutorial_lib.motion.bvh.np.savetxt", full)
    made = tmp_path / "made"
    told = fails("generate", trained, "--frames", "5", "-o", made)
    assert told == f"error: {made / 'swing-01.bvh'}: cannot be written (No space left on device)"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_what_is_in_the_place_of_an_output_is_told_before_the_work(trained, clips, tmp_path, monkeypatch, fails):
    """A folder in the place of the second file left the first one, and a pipe became a file."""
    made, pipe = tmp_path / "made", tmp_path / "pipe"
    (made / "swing-02.bvh").mkdir(parents=True)
    os.mkfifo(pipe)
    for path in ("tutorial_lib.generate.generate_each", "tutorial_lib.view.show"):
        monkeypatch.setattr(path, lambda *_, **__: pytest.fail("made in vain"))
    folder = f"error: {made / 'swing-02.bvh'}: expected a file to write, this is a folder"
    assert fails("generate", trained, "--count", "3", "--frames", "5", "-o", made) == folder
    for command in [
        ("view", clips / "swing0.bvh", "-o", pipe),
        ("train", "lstm", "--data", clips, "--out", pipe, *FAST),
        ("evaluate", trained, "--data", clips, "--json", pipe),
    ]:
        assert fails(*command) == f"error: {pipe}: expected a regular file to write, this is a pipe or a device"
    assert [p.name for p in made.iterdir()] == ["swing-02.bvh"] and pipe.is_fifo()


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
