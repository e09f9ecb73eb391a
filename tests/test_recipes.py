"""Recipes: what a run is made of, hybrid training, and every system on every representation, resumed as it was."""

from __future__ import annotations

import dataclasses
import json
import pathlib
import warnings

import numpy as np
import pytest
import torch

from tutorial_lib import data
from tutorial_lib.data.windows import WindowSampler, padded
from tutorial_lib.errors import CheckpointError, DataError, MotionError, TutorialError
from tutorial_lib.evaluate import evaluate
from tutorial_lib.generate import generate, prepare
from tutorial_lib.motion import Motion, write_bvh
from tutorial_lib.motion.skeletons import COMMON_JOINTS, KNOWN_SKELETONS
from tutorial_lib.recipes import Recipe, clips_of, load_clips, recipe_in, sets_of, trainer_for
from tutorial_lib.representations import REPRESENTATIONS, make_representation
from tutorial_lib.training.checkpoints import load_checkpoint, provenance, read_header
from tutorial_lib.training.systems import SYSTEMS, make_system
from tutorial_lib.training.trainer import Trainer, TrainingConfig

SMALL = {"hidden": 6, "batch": 4, "length": 12, "steps": 3}
OPTIONS = {
    "aclstm": {"u": 2, "v": 3},
    "erd": {"noise": 0.05},
    "seq2seq": {"n_seed": 6, "n_future": 4},
    "scheduled-sampling": {"decay": "linear"},
    "crbm": {"cd": 2, "past": 2, "gibbs": 3},
    "dynamic-future-net": {"horizon": 4, "code": 6, "velocity_code": 2, "summary": 5, "current": 4, "future": 3},
    "vae-lstm": {"filters": 4, "kernel": 5, "dropout": 0.1},
}
FITTING = [
    (s, r)
    for s, of in SYSTEMS.items()
    for r, by in REPRESENTATIONS.items()
    if set(of.parts) <= set(by.parts) and r in (of.reads or REPRESENTATIONS)
]


@pytest.fixture(autouse=True)
def _offline(monkeypatch):
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)


def small(system: str = "lstm", data="samples/walking", **values) -> Recipe:
    return Recipe(system, data, **{**SMALL, "options": OPTIONS.get(system, {}), **values})


@pytest.fixture(scope="module")
def walking():
    return sets_of(small())


def weights(trainer: Trainer) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in trainer.model.state_dict().items()}


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


# --- the value ------------------------------------------------------------------------------------


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_recipe_comes_back_from_json(system):
    recipe = small(system, ("samples/walking", "samples/running"), rates=(24.0, 30.0), height=None, seed=4)
    assert Recipe.from_dict(json.loads(json.dumps(recipe.to_dict()))) == recipe
    assert hash(recipe) == hash(dataclasses.replace(recipe))
    assert dataclasses.replace(recipe, seed=5) != recipe


def test_what_is_not_said_is_the_systems_default():
    assert (Recipe("lstm", "x").layers, Recipe("erd", "x").layers, Recipe("seq2seq", "x").layers) == (3, 2, 1)
    assert Recipe("seq2seq", "x").options == {"n_seed": 50, "n_future": 25}
    assert Recipe("aclstm", "x", options={"v": 2}).options == {"u": 5, "v": 2, "noise": 0.0}
    assert Recipe("lstm", "x").data == ("x",) and Recipe("lstm", ["x", "y"]).data == ("x", "y")
    assert Recipe("lstm", "x", height=0.0) == Recipe("lstm", "x", height=None)
    plain, vae = Recipe("lstm", "x"), Recipe("vae-lstm", "x")
    assert (plain.representation, plain.joints, plain.length, plain.pad) == ("positions", "own", 100, False)
    assert (vae.representation, vae.joints, vae.length, vae.pad, vae.layers) == ("hip-frame", "common", 120, True, None)
    assert vae.options["kernel"] == 25 and vae.sizes()["filters"] == 64 and vae.sizes()["hidden"] == 128
    assert Recipe("vae-lstm", "x", pad=False, length=60, joints="own").pad is False


@pytest.mark.parametrize("values, told", [
    ({"system": "lsmt"}, "unknown system 'lsmt'; did you mean lstm"),
    ({"data": ()}, "at least one data set"),
    ({"data": ("a", "b", "a")}, "'a' is given twice"),
    ({"options": {"u": 3}}, "'u' is not an option of system 'lstm'; it has none"),
    ({"system": "aclstm", "options": {"decay": 3}}, "'decay' is not an option of system 'aclstm'; it has u, v, noise"),
    ({"system": "aclstm", "options": {"u": 0}}, "u, the frames of truth in a row, must be"),
    ({"system": "seq2seq", "length": 74}, "windows of 75 frames .* .n_seed 50, n_future 25., the length is 74"),
    ({"system": "aclstm", "length": 6}, "windows of 7 frames with its options .u 5, v 5, noise 0.0., the length is 6"),
    ({"system": "aclstm", "options": {"u": 99}}, "windows of 101 frames .*, the length is 100"),
    ({"representation": "cube"}, "unknown representation 'cube'"),
    ({"normalize": "maybe"}, "unknown normalize 'maybe': expected one of auto, on, off"),
    ({"joints": "all"}, "unknown joints 'all': expected one of own, common"),
    ({"fps": 0}, "fps must be above 0"),
    ({"rates": (30, float("nan"))}, "rate must be above 0"),
    ({"rates": ()}, "rates must have one"),
    ({"height": 154}, "between 0.1 and 10 metres"),
    ({"test_fraction": 1}, "expected a number between 0 and 1"),
    ({"length": 1}, "length must be a whole number of 2 or more, not 1"),
    ({"batch": 2.5}, "batch must be a whole number of 1 or more, not 2.5"),
    ({"seed": -1}, "seed must be a whole number of 0 or more"),
    ({"hidden": 0}, "hidden must be a whole number"),
    ({"layers": 0}, "layers must be a whole number"),
    ({"steps": 0}, "steps must be a whole number"),
    ({"system": "vae-lstm", "representation": "positions"}, "needs the control channels .* 'positions' has root and "
     "joints only: expected hip-frame"),
    ({"system": "vae-lstm", "length": 118}, "windows of a multiple of 4 frames, the length is 118"),
    ({"system": "vae-lstm", "layers": 2}, "'vae-lstm' has no number of layers to choose"),
    ({"system": "vae-lstm", "options": {"kernel": 24}}, "kernel must be odd"),
    ({"system": "vae-lstm", "options": {"deviation": 0}}, "standard deviation above 0"),
    ({"system": "vae-lstm", "options": {"control": (0, 3)}}, "'control' is not an option"),
    ({"system": "crbm", "normalize": "off"}, "'crbm' is made for features of standard deviation 1: normalize 'off'"),
    ({"learning_rate": 0}, "learning rate must be above 0"),
    ({"schedule": "none"}, "unknown schedule 'none'"),
])  # fmt: skip
def test_what_cannot_be_is_told_when_the_recipe_is_made(values, told):
    with pytest.raises(TutorialError, match=told) as caught:
        Recipe(**{"system": "lstm", "data": "samples/walking", **values})
    assert "\n" not in str(caught.value)


def test_descriptions_that_are_none():
    with pytest.raises(TutorialError, match="without 'data'"):
        Recipe.from_dict({"system": "lstm"})
    with pytest.raises(TutorialError, match="has no 'n_seed'"):
        Recipe.from_dict({"system": "lstm", "data": "x", "n_seed": 3})
    with pytest.raises(CheckpointError, match="does not tell how it was trained .*'data'"):
        recipe_in({"system": "lstm", "model": {"dim": 3, "hidden": 6, "layers": 3}, "training": {"steps": 4}})


# --- every system, every representation -----------------------------------------------------------


@pytest.mark.parametrize("system, representation", FITTING)
def test_every_system_trains_on_every_representation(system, representation, walking):
    trainer = trainer_for(small(system, representation=representation), sets=walking)
    before = weights(trainer)
    trainer.run(progress=False)
    assert trainer.finished and len(trainer.history["loss"]) == 3 and np.isfinite(trainer.history["loss"]).all()
    assert all(not torch.equal(value, before[name]) for name, value in weights(trainer).items())
    as_it_is = (representation == "positions" and system != "crbm") or bool(SYSTEMS[system].reads)
    assert (trainer.batches.normalizer is None) == as_it_is


class Killed(Exception):
    """In the place of a kill: the run ends in the middle of a step and saves nothing."""


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_killed_run_resumes_to_the_same_weights(system, walking, tmp_path):
    recipe, path = small(system, steps=9), tmp_path / "run.safetensors"
    whole = trainer_for(recipe, sets=walking).run(progress=False)

    def kill(trainer: Trainer) -> None:
        if trainer.step == 4:
            trainer.save()
        if trainer.step == 6:
            raise Killed

    with pytest.raises(Killed):
        trainer_for(recipe, path, sets=walking).run(progress=False, callback=kill)
    again = trainer_for(recipe, path, sets=walking)
    assert again.step == 4 and not again.finished
    again.run(progress=False)
    assert same(weights(again), weights(whole))
    np.testing.assert_equal(again.history, whole.history)  # with terms that are not a number in some stages
    finished = trainer_for(recipe, path, sets=walking)
    assert finished.finished and same(weights(finished), weights(whole))
    assert finished.run(progress=False) is finished and finished.step == 9


def test_a_file_knows_its_recipe_and_no_other_is_taken_for_it(walking, tmp_path):
    recipe, path = small("erd"), tmp_path / "x.safetensors"
    trainer_for(recipe, path, sets=walking, command="mine").run(progress=False)
    assert recipe_in(read_header(path)) == recipe
    origin = load_checkpoint(path).provenance
    assert origin["command"] == "mine" and origin["data"] == "samples/walking"
    assert origin["clips"] == [m.name for m in walking[0][0]] and origin["test_clips"]
    for other, told in [
        (small("lstm"), "holds a run with system 'erd', asked for 'lstm'"),
        (small("erd", seed=3), "holds a run with seed 0, asked for 3"),
        (small("erd", options={"noise": 0.1}), "holds a run with noise 0.05, asked for 0.1"),
        (small("erd", ("samples/walking", "samples/running")), "holds a run with data"),
    ]:
        with pytest.raises(CheckpointError, match=told) as caught:
            trainer_for(other, path, sets=walking)
        assert str(path) in str(caught.value)
    fewer = [(walking[0][0][:-1], walking[0][1])]
    with pytest.raises(CheckpointError, match="clips of samples/walking, now there are other ones"):
        trainer_for(recipe, path, sets=fewer)
    assert trainer_for(small("lstm"), path, sets=walking, resume=False).step == 0


def test_runs_from_before_there_were_recipes_go_on(walking, tmp_path):
    """As the command wrote them then: one data set, by its plain name, and nothing about joints."""
    path, recipe = tmp_path / "old.safetensors", small("aclstm", steps=5)
    (train, test), *_ = walking
    batches = WindowSampler(train, make_representation("positions", train[0].skeleton, 30.0), length=12, batch=4)
    old = Trainer(
        make_system("aclstm", batches.representation.dim, hidden=6, layers=3, u=2, v=3), batches,
        TrainingConfig(steps=5), path=path, provenance=provenance("samples/walking", [m.name for m in train], "old"),
        settings={"data": "samples/walking", "representation": "positions", "fps": 30.0, "height": 1.54, "length": 12,
                  "batch": 4, "rates": None, "rotate": True, "normalize": "auto", "test_fraction": 0.2},
    )  # fmt: skip
    old.run(progress=False, max_seconds=0.0)
    assert 0 < old.step < 5 and recipe_in(read_header(path)) == recipe
    trainer = trainer_for(recipe, path, sets=walking).run(progress=False)
    assert same(weights(trainer), weights(trainer_for(recipe, sets=walking).run(progress=False)))
    checkpoint = load_checkpoint(path)
    assert checkpoint.training["data"] == "samples/walking" and checkpoint.provenance["command"] == "old"
    assert len(generate(checkpoint, 4, seeds=test)[0]) == 14
    assert evaluate(checkpoint, test, count=2, frames=30)["system"] == "aclstm"


def test_a_crbm_from_before_positions_were_normalised_goes_on_as_it_was(walking, tmp_path, monkeypatch):
    recipe, path = small("crbm", representation="positions", steps=4), tmp_path / "old.safetensors"
    with monkeypatch.context() as then:
        then.setattr("tutorial_lib.recipes._normalised", lambda recipe: False)
        trainer_for(recipe, path, sets=walking).run(progress=False, max_seconds=0.0)
    old = trainer_for(recipe, path, sets=walking)
    assert 0 < old.step < 4 and old.batches.normalizer is None


def test_a_start_has_the_features_of_the_run(walking, tmp_path):
    plain, normalised = (str(tmp_path / f"{name}.safetensors") for name in ("plain", "normalised"))
    trainer_for(small(), plain, sets=walking).run(progress=False)
    trainer_for(small(normalize="on"), normalised, sets=walking).run(progress=False)
    for start, normalize, told in [
        (normalised, "auto", r"trained on normalised features, .* asks for features as they are \(normalize 'auto'\)"),
        (normalised, "off", r"trained on normalised features, .* asks for features as they are \(normalize 'off'\)"),
        (plain, "on", r"trained on features as they are, .* asks for normalised features \(normalize 'on'\)"),
    ]:
        with pytest.raises(CheckpointError, match=told) as caught:
            trainer_for(small(start=start, normalize=normalize), sets=walking)
        assert start in str(caught.value) and "\n" not in str(caught.value)
    assert trainer_for(small(start=plain), sets=walking).batches.normalizer is None
    again = trainer_for(small(start=normalised, normalize="on"), sets=walking)
    assert again.batches.normalizer == load_checkpoint(normalised).normalizer


# --- several data sets ----------------------------------------------------------------------------


def test_each_data_set_is_split_and_both_are_in_both(tmp_path):
    recipe = small("lstm", ("samples/walking", "samples/boxing"))
    train, test = clips_of(recipe)
    for name in recipe.data:
        alone = clips_of(small("lstm", name))
        for side, own in zip((train, test), alone, strict=True):
            assert [m.name for m in side if m.name.startswith(name)] == [m.name for m in own] != []
    trainer = trainer_for(recipe, tmp_path / "x.safetensors").run(progress=False)
    origin = load_checkpoint(trainer.path).provenance
    assert origin["data"] == list(recipe.data)
    assert (origin["clips"], origin["test_clips"]) == ([m.name for m in train], [m.name for m in test])
    assert recipe_in(read_header(trainer.path)) == recipe


def leaning(frames: int, height: float, skeleton) -> Motion:
    """A still figure that leans so that its spine's end is ``height`` above its root, half a metre at most."""
    rotations = np.zeros((frames, skeleton.n_joints, 4))
    rotations[..., 0] = 1
    angle = np.arccos(height / 0.5)
    rotations[:, 0] = [np.cos(angle / 2), np.sin(angle / 2), 0, 0]
    return Motion.from_rotations(skeleton, 30.0, np.ones((frames, 3)), rotations)


def test_each_data_set_has_the_same_share_of_the_windows(small_skeleton):
    """One clip of 400 frames in one set, clips of 40 and 20 in another: half the windows are from each."""
    clips = [leaning(400, 0.1, small_skeleton), leaning(40, 0.2, small_skeleton), leaning(20, 0.3, small_skeleton)]
    representation = make_representation("positions", small_skeleton, 30.0)

    def shares(groups) -> list[float]:
        sampler = WindowSampler(clips, representation, length=10, batch=6000, rotate=False, groups=groups)
        frames = np.asarray(representation.decode_positions(sampler.sample()))[:, 0]  # (B, J, 3)
        heights = (10 * (frames[:, 1, 1] - frames[:, 0, 1])).round()
        return [float((heights == k).mean()) for k in (1, 2, 3)]

    starts = np.array([391, 31, 11])
    assert shares(None) == pytest.approx(starts / starts.sum(), abs=0.015)
    assert shares([0, 1, 1]) == pytest.approx([0.5, 0.5 * 31 / 42, 0.5 * 11 / 42], abs=0.02)
    assert shares([0, 1, 2]) == pytest.approx([1 / 3] * 3, abs=0.02)
    assert shares([7, 7, 7]) == shares(None)
    with pytest.raises(DataError, match="groups of 2 clips for 3 clips"):
        shares([0, 1])
    with pytest.raises(DataError, match="no clip is long enough .* 30 frames"):  # the second set would be missing
        WindowSampler(clips, representation, length=30, batch=4, groups=[0, 0, 1])


def test_hybrid_training_gives_each_set_its_share(walking):
    boxing = sets_of(small("lstm", "samples/boxing"))
    long_and_short = [walking[0], (boxing[0][0][:1], boxing[0][1])]
    recipe = small("lstm", ("samples/walking", "samples/boxing"), batch=2000, rotate=False)
    trainer = trainer_for(recipe, sets=long_and_short)
    only = trainer_for(small("lstm", "samples/boxing"), sets=[long_and_short[1]]).batches._positions
    firsts = trainer.batches.sample()[:, 0, 3:6]  # of a joint, relative to the root: told apart by its exact numbers
    boxed = set(map(tuple, (only[:, 1] - only[:, 0]).numpy().round(4).tolist()))
    share = np.mean([tuple(f) in boxed for f in firsts.numpy().round(4).tolist()])
    assert share == pytest.approx(0.5, abs=0.05)


@pytest.fixture(scope="module")
def other_skeleton(tmp_path_factory) -> pathlib.Path:
    """Sample clips as if from another collection: its names of the joints, and the same movements."""
    folder = tmp_path_factory.mktemp("others")
    table = KNOWN_SKELETONS["bandai-namco"]
    for k, motion in enumerate(data.load("samples/boxing")[:3]):
        skeleton = dataclasses.replace(motion.skeleton, names=tuple(table.get(n, n) for n in motion.skeleton.names))
        write_bvh(dataclasses.replace(motion, skeleton=skeleton), folder / f"b{k}.bvh")
    return folder


def test_different_skeletons_need_the_common_joints(other_skeleton, tmp_path):
    names = ("samples/walking", str(other_skeleton))
    told = "samples/walking has 24 nodes, LeftShoulder among them, .* 24, Shoulder_L among them; .*--joints common"
    with pytest.raises(MotionError, match=told) as caught:
        clips_of(small("lstm", names))
    assert str(other_skeleton) in str(caught.value) and "\n" not in str(caught.value)
    recipe, path = small("seq2seq", names, joints="common"), tmp_path / "x.safetensors"
    sets = sets_of(recipe)
    assert all(m.skeleton.names == COMMON_JOINTS for pair in sets for part in pair for m in part)
    trainer_for(recipe, path, sets=sets).run(progress=False)
    checkpoint = load_checkpoint(path)
    for clips in (load_clips(str(other_skeleton)), data.load("samples/walking")):  # clips are mapped when used, too
        assert clips[0].skeleton.names != COMMON_JOINTS
        assert generate(checkpoint, 3, seeds=clips)[0].skeleton.names == COMMON_JOINTS
        assert evaluate(checkpoint, clips, count=2, frames=30)["seeds"] == 2


def test_clips_behind_links_have_the_names_of_their_links(small_skeleton, tmp_path):
    """A folder of chosen clips, linked from wherever they lie, is a data set like any other."""
    real, chosen = tmp_path / "real", tmp_path / "chosen"
    for folder in (real, chosen, tmp_path / "far" / "off"):
        folder.mkdir(parents=True)
    for file in (real / "a.bvh", tmp_path / "far" / "off" / "b.bvh"):
        write_bvh(leaning(40, 0.1, small_skeleton), file)
        (chosen / f"my_{file.name}").symlink_to(file)
    (chosen / "sub").symlink_to(real)
    assert [m.name for m in load_clips(str(chosen))] == ["chosen/my_a", "chosen/my_b", "chosen/sub/a"]
    assert [m.name for m in load_clips(str(chosen / "my_b.bvh"))] == ["chosen/my_b"]
    (tmp_path / "link").symlink_to(real)
    assert [m.name for m in load_clips(str(tmp_path / "link"))] == ["real/a"]  # the folder's own name


def test_no_clip_is_in_two_data_sets(small_skeleton, tmp_path, monkeypatch):
    """Kept out of the one it would be trained on in the other."""
    monkeypatch.setenv("TUTORIAL_DATA", str(tmp_path))
    folder, other = tmp_path / "cmu" / "boxing", tmp_path / "other" / "boxing"
    for place in (folder, other):
        place.mkdir(parents=True)
        for name in ("1.bvh", "2.bvh"):
            write_bvh(leaning(40, 0.1, small_skeleton), place / name)
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / "mine.bvh").symlink_to(folder / "2.bvh")
    for again, file in [
        (f"{folder}/", folder / "1.bvh"), (f"{folder}/../boxing", folder / "../boxing/1.bvh"),
        (str(folder / "2.bvh"), folder / "2.bvh"), (str(tmp_path / "link"), tmp_path / "link" / "mine.bvh"),
    ]:  # fmt: skip
        for first in ("cmu/boxing", str(folder)):
            with pytest.raises(DataError, match="in data set") as caught:
                sets_of(small("lstm", (first, again)))
            assert str(caught.value).startswith(f"{file}: is in data set {first!r} and in {again!r}")
    with pytest.raises(DataError, match="in data set"):
        sets_of(small("lstm", (str(folder / "2.bvh"), str(folder))))
    assert len(sets_of(small("lstm", ("cmu/boxing", str(other))))) == 2  # other clips of the same names


def test_common_joints_of_an_unknown_skeleton(small_motion, tmp_path):
    write_bvh(small_motion, tmp_path / "a.bvh")
    with pytest.raises(MotionError, match="unknown skeleton .root, spine"):
        clips_of(small("lstm", str(tmp_path), joints="common"))


def test_a_single_clip_of_several_sets_is_told_by_its_set(small_skeleton, tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        write_bvh(leaning(40, 0.1, small_skeleton), tmp_path / name / "c.bvh")
    write_bvh(leaning(40, 0.1, small_skeleton), tmp_path / "b" / "d.bvh")
    with pytest.warns(UserWarning, match=f"^{tmp_path / 'a'}: a single clip, trained on whole"):
        train, test = clips_of(small("lstm", (str(tmp_path / "a"), str(tmp_path / "b"))))
    assert (len(train), len(test)) == (2, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(clips_of(small("lstm", str(tmp_path / "a"), test_fraction=0))[0]) == 1


def test_clips_are_prepared_as_asked_for():
    train, _ = clips_of(small(height=1.2))
    wanted = prepare([m for m in data.load("samples/walking") if m.name == train[0].name], height=1.2)
    np.testing.assert_allclose(train[0].positions, wanted[0].positions)


# --- short clips ----------------------------------------------------------------------------------


def test_short_clips_are_padded_with_their_first_and_last_pose(walking):
    clip = walking[0][0][0][10:30]
    longer = padded(clip, 45)
    assert len(longer) == 45 and len(padded(clip, 20)) == len(padded(clip, 3)) == 20
    np.testing.assert_array_equal(longer.positions[12:32], clip.positions)
    for part, frame in ((longer[:12], 0), (longer[32:], -1)):
        assert (part.positions == clip.positions[frame]).all() and (part.rotations == clip.rotations[frame]).all()
    with pytest.warns(UserWarning, match="1 of 2 clips left out, too short"):
        trainer_for(small(length=40), sets=[([clip, walking[0][0][1]], [])])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        batches = trainer_for(small(length=40, pad=True, rates=(30.0, 15.0)), sets=[([clip], [])]).batches
    windows = batches.representation.decode_positions(batches.sample(np.random.default_rng(0)))  # (B, 40, J, 3)
    for window in windows.numpy():
        steps = np.abs(np.diff(window - window[:, :1], axis=0)).max((1, 2))
        moving = np.flatnonzero(steps > 1e-5)
        assert moving[-1] - moving[0] + 1 in (19, 10)  # all of the clip, and nothing twice
