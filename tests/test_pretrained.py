"""Weights that come with the library: found by name, made from runs, used with no data at hand."""

from __future__ import annotations

import hashlib
import json
import pathlib
import sys

import numpy as np
import pytest
import torch
from torch import nn

from tutorial_lib import data, pretrained
from tutorial_lib.cli import main
from tutorial_lib.data.synthetic import sample_skeleton
from tutorial_lib.errors import CheckpointError
from tutorial_lib.generate import generate, generate_features, prepare
from tutorial_lib.models.recurrent import LSTM3LRConfig
from tutorial_lib.motion import Motion, Skeleton, read_bvh, write_bvh
from tutorial_lib.pretrained import publish as publishing
from tutorial_lib.pretrained.publish import clips_hash, nearest_captured, own_seeds, publish, rounded
from tutorial_lib.recipes import Recipe, clips_of, trainer_for
from tutorial_lib.representations import make_representation
from tutorial_lib.training.checkpoints import Checkpoint, load_checkpoint, provenance, read_header, save_checkpoint
from tutorial_lib.training.systems import SYSTEMS, make_system

RECIPE = Recipe("aclstm", ("samples/walking",), hidden=12, layers=2, length=20, batch=4, steps=40, test_fraction=0.4)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> pathlib.Path:
    """A finished run, too short to make motion that goes on."""
    path = tmp_path_factory.mktemp("run") / "walk.safetensors"
    trainer_for(RECIPE, path, command=f"python -m tutorial_lib train aclstm --out {path}").run()
    return path


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory) -> pathlib.Path:
    """A folder with one published file; the seeds are taken as they come, for the network hardly moves."""
    folder = tmp_path_factory.mktemp("weights")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(publishing, "MOVING", 0.0)
        patch.setattr(publishing, "ALONE", (2.0, 8.0))  # not a minute: this is quick
        publish(run, "aclstm-walk", folder=folder, frames=60, count=4)
    return folder


@pytest.fixture
def weights(folder, monkeypatch) -> pathlib.Path:
    monkeypatch.setattr(pretrained, "FOLDER", folder)
    return folder


# --- what is there --------------------------------------------------------------------------------


def test_weights_are_listed_from_their_headers(weights, monkeypatch):
    monkeypatch.setattr(pretrained, "load_checkpoint", None)  # reading the weights would fail
    (row,) = pretrained.list()
    assert (row.name, row.system, row.data, row.steps) == ("aclstm-walk", "aclstm", ("samples/walking",), 40)
    assert (row.hidden, row.layers, row.clips) == (12, 2, 3)
    assert row.megabytes == pytest.approx((weights / "aclstm-walk.safetensors").stat().st_size / 1e6)
    text = str(pretrained.list())
    assert text == repr(pretrained.list()) and "\n" not in text
    assert "aclstm 2x12 on samples/walking, 3 clips, 40 steps" in text and "within 60 frames" in text


def test_hybrid_weights_name_all_their_data(tmp_path, monkeypatch):
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    for name, sets in (("both", ["cmu/salsa", "cmu/indian"]), ("none", None)):
        save_checkpoint(tmp_path / f"{name}.safetensors", system="lstm", model=make_system("lstm", 3, hidden=4).model,
                        provenance=provenance(sets, ["a"]), half=True)  # fmt: skip
    assert [row.data for row in pretrained.list()] == [("cmu/salsa", "cmu/indian"), ()]
    assert "on cmu/salsa + cmu/indian, 1 clips" in str(pretrained.list())
    assert "on unknown data" in str(pretrained.list())


def test_a_copy_without_weights(tmp_path, monkeypatch, capsys, fails):
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    assert pretrained.list() == () and "no pretrained weights" in str(pretrained.list())
    with pytest.raises(CheckpointError, match="'aclstm-walk': none came with this copy"):
        pretrained.load("aclstm-walk")
    assert main(["pretrained", "list"]) == 0 and "no pretrained weights" in capsys.readouterr().out
    assert "none came with this copy" in fails("generate", "--pretrained", "x", "-o", tmp_path / "made")
    assert list(tmp_path.iterdir()) == []


def test_unknown_and_damaged_weights(folder, tmp_path, monkeypatch, fails):
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    whole = (folder / "aclstm-walk.safetensors").read_bytes()
    (tmp_path / "aclstm-walk.safetensors").write_bytes(whole)
    for name in ("aclstm-wakl", "ACLSTM-walk", "aclstm_walk"):
        with pytest.raises(CheckpointError, match=f"no pretrained weights '{name}'; did you mean aclstm-walk"):
            pretrained.load(name)
    for name in ("../aclstm-walk", "", "zzz"):
        with pytest.raises(CheckpointError, match="; there are aclstm-walk|; did you mean aclstm-walk"):
            pretrained.path(name)
    assert "did you mean" in fails("evaluate", "--pretrained", "aclstm-wal", "--data", "samples/walking")
    (tmp_path / "cut.safetensors").write_bytes(whole[:-100])
    with pytest.raises(CheckpointError, match="cut.safetensors.*cut off"):
        pretrained.load("cut")
    with pytest.raises(CheckpointError, match="cut.safetensors"):
        pretrained.list()


def test_what_is_in_the_library_opens_is_small_and_accounted_for():
    files = sorted(pathlib.Path(pretrained.__file__).parent.glob("*.safetensors"))
    assert [row.name for row in pretrained.list()] == [file.stem for file in files]
    assert sum(file.stat().st_size for file in files) <= 40e6
    for file in files:
        checkpoint = load_checkpoint(file)
        told = checkpoint.provenance
        assert told["clips"] and told["command"] and told["clips_sha256"]
        assert told["published"]["name"] == file.stem and not read_header(file)["resumable"]
        if SYSTEMS[checkpoint.system].controlled:
            assert told["metrics"]["walks"] and checkpoint.sway is not None and checkpoint.seed_frames is None
        else:
            assert told["metrics"]["prediction_error"] and checkpoint.seed_frames.shape[1] >= 10


def test_weights_are_package_data():
    project = pathlib.Path(pretrained.__file__).parents[2] / "pyproject.toml"
    assert '"**/*.safetensors"' in project.read_text()


# --- publishing -----------------------------------------------------------------------------------


def test_a_published_file_tells_where_it_is_from(run, weights):
    made, before = pretrained.load("aclstm-walk"), load_checkpoint(run)
    assert (weights / "aclstm-walk.safetensors").stat().st_mode & 0o044
    for (name, new), old in zip(made.model.state_dict().items(), before.model.state_dict().values(), strict=True):
        assert new.dtype == torch.float32 and torch.equal(new, old.half().float()), name
    told = made.provenance
    assert told["clips"] == before.provenance["clips"] and told["test_clips"] == before.provenance["test_clips"]
    assert told["command"] == "python -m tutorial_lib train aclstm --out walk.safetensors"  # and not in whose folder
    assert made.training["steps_done"] == 40 and made.training["seed"] == 0 and told["versions"]["torch"]
    assert told["published"]["name"] == "aclstm-walk" and told["metrics"]["frames"] == 60
    assert told["metrics"]["clips"] == told["test_clips"] and not told["metrics"]["trained_on_these_clips"]
    assert str(run.parent) not in json.dumps(read_header(weights / "aclstm-walk.safetensors"))


def test_the_published_weights_are_measured_and_not_the_runs(run, weights):
    from tutorial_lib.evaluate import evaluate

    made = pretrained.load("aclstm-walk")
    measured = evaluate(made, clips_of(RECIPE)[1], count=4, frames=60)
    assert json.loads(json.dumps(measured)) == made.provenance["metrics"]
    assert evaluate(load_checkpoint(run), clips_of(RECIPE)[1], count=4, frames=60) != measured


def test_clips_are_told_apart_by_their_hash():
    motion = Motion(sample_skeleton(), 30.0, np.random.default_rng(0).normal(size=(3, 24, 3)), name="a")
    by_hand = hashlib.sha256(b"a\x003\x00" + np.round(motion.positions * 1000).astype("<i4").tobytes()).hexdigest()
    assert clips_hash([motion]) == by_hand
    assert clips_hash([motion.translate((0, 1e-9, 0))]) == by_hand != clips_hash([motion.translate((0, 0.01, 0))])


def test_runs_that_cannot_be_published(run, tmp_path, monkeypatch, fails):
    monkeypatch.setattr(publishing, "ALONE", (5.0, 15.0))

    def refused(match, source=run, name="ok", **kwargs):
        with pytest.raises(CheckpointError, match=match):
            publish(source, name, folder=tmp_path / "out", **kwargs)

    refused("none has 1 s of moving, human motion of its own")  # 40 steps: it stands still
    for name in ("Upper", "../up", "a b", "", "-a"):
        refused("expected small letters", name=name)
    train, test = clips_of(RECIPE)
    refused("has 3 clips trained on, given were 2; samples/walking/.. is only in the run", clips=(train[1:], test))
    refused("2 clips kept out, given were 3; .* is only in those given", clips=(train, [*test, train[0]]))
    unfinished = tmp_path / "unfinished.safetensors"
    trainer = trainer_for(RECIPE, unfinished)
    trainer.save()
    refused("the run is unfinished, expected a finished one", unfinished)
    assert "unfinished" in fails("pretrained", "publish", unfinished, "--name", "a", "--out", tmp_path / "out")
    assert "no such file" in fails("pretrained", "publish", tmp_path / "no", "--name", "a", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_weights_beyond_half_precision(run):
    checkpoint = load_checkpoint(run)
    with torch.no_grad():
        checkpoint.model.readout.bias[3] = 70_000.0
    with pytest.raises(CheckpointError, match="readout.bias reach 7e.04, half precision ends at 65504"):
        rounded(checkpoint)


# --- own seeds ------------------------------------------------------------------------------------


class Turning(nn.Module):
    """Every frame is a person who waves an arm, faster or slower, whatever the seed was: it never stops by itself.

    ``stops`` frames after its seed it stands still. The seed's own pose is never repeated.
    """

    def __init__(self, representation, pose: np.ndarray, stops: int = 10**9, size: float = 1.0):
        super().__init__()
        self.config = LSTM3LRConfig(representation.dim, 1, 1)
        self.weight = nn.Parameter(torch.zeros(1))
        self.pose, self.stops, self.size = torch.as_tensor(pose, dtype=torch.float32), stops, size

    def forward(self, x, state=None):
        batch, frames, dim = x.shape
        at = 0 if state is None else state
        t = torch.arange(at, at + frames)
        phase = 0.3 * t.clamp(max=self.stops)
        out = self.pose.repeat(frames, 1)
        out[:, -9:] += self.size * (0.3 + 0.1 * phase.sin())[:, None]
        return out.expand(batch, frames, dim), at + frames


def turning(**kwargs) -> tuple[Checkpoint, list[Motion]]:
    clips = prepare(data.load("samples/walking")[:2], height=1.54, fps=30.0)
    representation = make_representation("positions", clips[0].skeleton, 30.0)
    pose = representation.encode(clips[0])[50]
    model = Turning(representation, pose, **kwargs)
    return Checkpoint("lstm", model.eval(), representation, None, {}, {"clips": []}), clips


def test_own_seeds_are_windows_of_what_the_network_made_long_after_the_captured_one():
    checkpoint, clips = turning()
    seeds, about = own_seeds(checkpoint, clips, count=5, frames=12)
    assert seeds.shape == (5, 12, checkpoint.representation.dim) and about["count"] == 5
    first, last = about["seconds_after_the_captured_seed"]
    assert 5 <= first <= last <= 60
    captured = clips[0].positions[:10]
    start = checkpoint.representation.encode(Motion(clips[0].skeleton, 30.0, captured))
    made = generate_features(checkpoint, start[None], 1800)[0]
    for seed in seeds:  # each stands somewhere in what the network makes, and not in its first five seconds alone
        distance = [np.abs(made[k : k + 12] - seed).max() for k in range(150, 1789)]
        assert min(distance) < 1e-5
    assert about["nearest_captured_motion_m"] >= 0.02


def test_a_network_that_stops_gives_its_last_moving_second():
    checkpoint, clips = turning(stops=90)
    seeds, about = own_seeds(checkpoint, clips, count=3, frames=12)
    first, last = about["seconds_after_the_captured_seed"]
    assert first == last and 2.0 < last < 3.0  # it stops 90 frames after its seed began
    assert np.abs(np.diff(seeds[:, :4], axis=1)).max() > 1e-3


def test_no_copy_of_a_clip_is_taken_for_a_seed(monkeypatch):
    monkeypatch.setattr(publishing, "ALONE", (2.0, 8.0))
    checkpoint, clips = turning()
    copies = Motion(clips[0].skeleton, 30.0, checkpoint.representation.decode_positions(
        generate_features(checkpoint, np.zeros((1, 10, 72), np.float32), 240))[0], name="learnt by heart")  # fmt: skip
    with pytest.raises(CheckpointError, match="of 8 runs none has 0.4 s of moving, human motion of its own"):
        own_seeds(checkpoint, [copies], count=2, frames=12)
    with pytest.raises(CheckpointError, match="none has"):
        own_seeds(turning(size=40.0)[0], clips, count=2, frames=12)  # an arm of ten metres is not human


def test_the_nearest_captured_motion_is_found_however_it_is_turned():
    clip = prepare(data.load("samples/dancing")[:1], height=1.54, fps=30.0)[0]
    other = prepare(data.load("samples/walking")[:1], height=1.54, fps=30.0)[0]
    piece = clip[77:107].rotate_y(2.0).translate((3, 0, -1)).positions
    assert nearest_captured(piece, [other, clip]) < 1e-6
    assert nearest_captured(piece + np.random.default_rng(0).normal(scale=0.1, size=(30, 24, 1)), [clip]) > 0.05
    # against the plain way: many angles
    single = other[40:70]
    best = min(
        np.sqrt(np.square(single.rotate_y(a).positions - single.rotate_y(a).positions[:, :1] - piece + piece[:, :1])
                .sum(-1).mean()) for a in np.linspace(0, 2 * np.pi, 361)
    )  # fmt: skip
    assert nearest_captured(piece, [single]) == pytest.approx(best, rel=1e-3)
    assert nearest_captured(piece, [other]) <= nearest_captured(piece, [single])
    assert nearest_captured(piece, [clip[:20]]) == np.inf


# --- commands -------------------------------------------------------------------------------------


def test_generating_needs_no_data(weights, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TUTORIAL_DATA", str(tmp_path / "nothing"))
    monkeypatch.setenv("TUTORIAL_OFFLINE", "1")
    monkeypatch.setitem(sys.modules, "tutorial_lib.data.download", None)  # whoever would download fails
    arguments = ["generate", "--pretrained", "aclstm-walk", "--frames", "40", "--count", "3", "-o"]
    assert main([*arguments, str(tmp_path / "made")]) == 0
    assert "wrote 3 files of 40 frames" in capsys.readouterr().out
    files = sorted((tmp_path / "made").iterdir())
    assert [f.name for f in files] == [f"aclstm-walk-0{k}.bvh" for k in (1, 2, 3)]
    expected = generate(pretrained.load("aclstm-walk"), 40, count=3).without_seed()
    for file, motion in zip(files, expected, strict=True):
        back = read_bvh(file, quiet=True, unit="cm", up="y")
        nodes = [back.skeleton.index(name) for name in motion.skeleton.names]
        np.testing.assert_allclose(back.positions[:, nodes], motion.positions, atol=1e-4)


def test_clean_motion_by_command(weights, tmp_path, fails, monkeypatch):
    made = tmp_path / "made"
    assert main(["generate", "--pretrained", "aclstm-walk", "--frames", "40", "--clean", "-o", str(made)]) == 0
    text = (made / "aclstm-walk-01.bvh").read_text()
    assert text.count("CHANNELS 6") == 1 and "Frames: 40" in text
    stick = Skeleton(("a", "b"), (-1, 0), np.eye(3)[:2], ("ZXY",) * 2, frozenset({1}))
    odd = make_representation("positions", stick, 30.0)
    save_checkpoint(tmp_path / "odd.safetensors", system="lstm", model=make_system("lstm", 6, hidden=4).model,
                    representation=odd, seed_frames=np.zeros((1, 20, 6)))  # fmt: skip
    assert "unknown skeleton" in fails("generate", tmp_path / "odd.safetensors", "--clean", "-o", tmp_path / "no")
    assert not (tmp_path / "no").exists()


def test_each_motion_is_written_before_the_next_is_made(weights, tmp_path, monkeypatch):
    alive, most = [], []

    def watch(motion, path):
        import weakref

        alive.append(weakref.ref(motion.positions.base if motion.positions.base is not None else motion.positions))
        most.append(sum(ref() is not None for ref in alive))
        pathlib.Path(path).write_text("x")

    monkeypatch.setattr("tutorial_lib.motion.bvh.write_bvh", watch)
    out = tmp_path / "made"
    assert main(["generate", "--pretrained", "aclstm-walk", "--frames", "40", "--count", "6", "-o", str(out)]) == 0
    assert len(most) == 6 and max(most) <= 2


def test_evaluating_shipped_weights(weights, tmp_path, capsys):
    out = tmp_path / "r.json"
    assert main(["evaluate", "--pretrained", "aclstm-walk", "--data", "samples/walking", "--frames", "60", "--count",
                 "4", "--json", str(out)]) == 0  # fmt: skip
    assert "never trained on" in capsys.readouterr().out
    told, stored = json.loads(out.read_text()), pretrained.load("aclstm-walk").provenance["metrics"]
    assert told["checkpoint"] == "aclstm-walk.safetensors"
    # the command reads the clips at their own size and brings them to the network's: the same to rounding
    for ms, error in stored["prediction_error"].items():
        assert told["prediction_error"][ms] == pytest.approx(error, rel=1e-3)


def test_a_checkpoint_or_a_name_and_not_both(weights, run, tmp_path, fails):
    out = tmp_path / "made"
    assert "expected a CHECKPOINT file or --pretrained NAME" in fails("generate", "-o", out)
    assert "expected one of the two" in fails("generate", run, "--pretrained", "aclstm-walk", "-o", out)
    assert "expected a CHECKPOINT file or --pretrained NAME" in fails("evaluate", "--data", "samples/walking")
    # a misspelt option is told as such, and its number not as a checkpoint
    assert "--framse" in fails("generate", "--pretrained", "aclstm-walk", "--framse", "100", "-o", out)
    assert not out.exists()


def test_seeds_that_do_not_fit(weights, tmp_path, fails):
    command = ("generate", "--pretrained", "aclstm-walk", "-o", tmp_path / "made")
    told = fails(*command, "--seed-frames", "31")
    assert "a seed of 31 frames was asked for, the checkpoint's own seeds have 30" in told
    told = fails(*command, "--data", "samples/walking", "--seed-frames", "9999")
    assert "a seed needs 9999 frames, the longest of 2 clips has 450" in told
    stick = Skeleton(("a", "b"), (-1, 0), np.eye(3)[:2], ("ZXY",) * 2, frozenset({1}))
    write_bvh(Motion.from_rotations(stick, 30.0, np.zeros((40, 3)), np.eye(4)[[0, 0]][None].repeat(40, 0)),
              tmp_path / "stick.bvh")  # fmt: skip
    told = fails(*command, "--data", tmp_path / "stick.bvh")
    assert "2 nodes with root 'a'" in told and "made for 24 with root 'Hips'" in told
    checkpoint = pretrained.load("aclstm-walk")
    with pytest.raises(CheckpointError, match=r"shape \(1, 10, 75\), the network reads \(sequences, frames, 72\)"):
        generate(checkpoint, 5, seeds=np.zeros((1, 10, 75)))  # features of the hip frame
    assert not (tmp_path / "made").exists()


def test_publishing_by_command(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(publishing, "MOVING", 0.0)
    monkeypatch.setattr(publishing, "ALONE", (2.0, 8.0))
    arguments = ["pretrained", "publish", str(run), "--name", "b", "--out", str(tmp_path), "--frames", "60", "--count"]
    assert main([*arguments, "3"]) == 0
    out = capsys.readouterr().out
    assert "prediction error" in out and "own seeds           20 of 30 frames" in out
    assert load_checkpoint(tmp_path / "b.safetensors").provenance["metrics"]["seeds"] == 3
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    assert main(["pretrained", "list"]) == 0 and capsys.readouterr().out.startswith("b  ")
