"""Many futures: training in stages, and what a Dynamic Future Net generates. Its parts: test_dynamic_future_net.py."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import math

import numpy as np
import pytest
import torch
from torch import nn

from tutorial_lib import data
from tutorial_lib.errors import CheckpointError, DataError, MotionError, TutorialError
from tutorial_lib.evaluate import evaluate
from tutorial_lib.generate import generate, generate_features, synthesize
from tutorial_lib.generate_futures import future_of, generate_futures, reconstruct, reconstruct_sequences
from tutorial_lib.models.future_stream import FutureStream, ImposedFuture
from tutorial_lib.motion import read_motion
from tutorial_lib.recipes import Recipe, recipe_in, sets_of, trainer_for
from tutorial_lib.training.checkpoints import load_checkpoint, read_header, save_checkpoint
from tutorial_lib.training.stages import Stage, stage_ends
from tutorial_lib.training.systems import System, make_system
from tutorial_lib.training.trainer import Trainer, TrainingConfig, TrainingError

SIZES = {"horizon": 3, "code": 6, "velocity_code": 2, "summary": 5, "current": 4, "future": 3}


def small(**values) -> Recipe:
    options = {**SIZES, **values.pop("options", {})}
    given = {"hidden": 12, "batch": 4, "length": 12, "steps": 10, **values}
    return Recipe("dynamic-future-net", "samples/walking", options=options, **given)


@pytest.fixture(autouse=True)
def _offline(monkeypatch):
    monkeypatch.delenv("TUTORIAL_DATA", raising=False)


@pytest.fixture(scope="module")
def walking():
    return sets_of(small())


@pytest.fixture(scope="module")
def clip():
    return data.load("samples/walking")[0]


@pytest.fixture(scope="module")
def trained(walking, tmp_path_factory):
    """A checkpoint of a few steps of each stage: it walks like nobody, but nothing in it is as it began."""
    path = tmp_path_factory.mktemp("trained") / "dfn.safetensors"
    trainer_for(small(), path, sets=walking).run(progress=False)
    return load_checkpoint(path)


# --- stages in the trainer ---------------------------------------------------------------------------------------


class Parts(nn.Module):
    @dataclasses.dataclass(frozen=True)
    class Config:
        dim: int = 1

    def __init__(self):
        super().__init__()
        self.config = self.Config()
        self.one, self.two = nn.Linear(1, 1), nn.Linear(1, 1)


class Numbers:
    """Batches that count: 0, 1, 2, ..."""

    def __init__(self):
        self.k = 0

    def sample(self) -> torch.Tensor:
        self.k += 1
        return torch.tensor([[float(self.k)]])

    def state_dict(self) -> dict:
        return {"k": self.k}

    def load_state_dict(self, state) -> None:
        self.k = state["k"]


def two_stages(log: list, **config) -> Trainer:
    def loss(name):
        def of(model, batch, rng, progress):
            log.append((name, round(progress, 3)))
            return getattr(model, name)(batch).square().sum(), {name: batch.sum()}

        return of

    def note(what):
        return lambda model, sample: log.append((what, float(sample())))

    stages = (
        Stage("first", loss("one"), 0.4, "one", before=note("before one"), after=note("after one")),
        Stage("second", loss("two"), 0.6, "two", check=lambda model: log.append(("check two",))),
    )
    system = System("parts", Parts(), lambda *_: None, stages=stages)
    return Trainer(system, Numbers(), TrainingConfig(**{"steps": 5, **config}))


def test_stages_run_one_after_another():
    log: list = []
    trainer = two_stages(log)
    rates = []
    trainer.run(progress=False, callback=lambda t: rates.append(t._optimizer.param_groups[0]["lr"]))
    assert log == [
        ("before one", 1), ("one", 0), ("one", 1), ("after one", 4),
        ("check two",), ("two", 0), ("two", 0.5), ("two", 1),
    ]  # fmt: skip
    whole = TrainingConfig(steps=3)
    assert rates[2:] == [whole.learning_rate_at(k) for k in range(3)], "each stage has the whole schedule"
    assert trainer.finished and trainer.stage.name == "second"
    assert trainer.stage_history("first")["one"] == [2, 3] and trainer.stage_history("second")["two"] == [5, 6, 7]
    assert list(trainer.stage_history("second")) == ["loss", "two"] and len(trainer.history["one"]) == 5
    assert trainer.loss == pytest.approx(np.mean(trainer.history["loss"][2:])), "of the last stage alone"
    with pytest.raises(TutorialError, match="no stage 'third' in this run; it has first, second"):
        trainer.stage_history("third")


def test_a_stage_leaves_the_other_parts_alone():
    trainer = two_stages([])
    before = {name: p.clone() for name, p in trainer.model.named_parameters()}
    seen = []

    def changed(t: Trainer) -> None:
        seen.append({n.split(".")[0] for n, p in t.model.named_parameters() if not torch.equal(p, before[n])})

    trainer.run(progress=False, callback=changed)
    assert seen[0] == seen[1] == {"one"} and seen[2] == {"one", "two"}


@pytest.mark.parametrize("stopped", [1, 3, None])
def test_a_second_trainer_trains_all_stages_again(stopped):
    """Wherever the first one was stopped, by a stop button, by a defect or not at all."""

    def stop(trainer: Trainer) -> None:
        if trainer.step == stopped:
            raise KeyboardInterrupt

    first = two_stages([])
    first.model.two.bias.requires_grad_(False)
    first = Trainer(first.system, Numbers(), first.config)
    with pytest.raises(KeyboardInterrupt) if stopped else contextlib.nullcontext():
        first.run(progress=False, callback=stop)
    required = {name for name, p in first.model.named_parameters() if p.requires_grad}
    assert required == {"one.weight", "one.bias", "two.weight"}
    before = {name: p.clone() for name, p in first.model.named_parameters()}
    second = Trainer(first.system, Numbers(), first.config).run(progress=False)
    changed = {name for name, p in second.model.named_parameters() if not torch.equal(p, before[name])}
    assert changed == required


def test_a_run_that_goes_on_in_another_stage_is_the_same():
    whole, parted = two_stages([]), two_stages([])
    parted.model.load_state_dict(whole.model.state_dict())
    whole.run(progress=False)
    while not parted.finished:
        parted.run(progress=False, max_seconds=0.0)
        assert all(p.requires_grad for p in parted.model.parameters())
    for one, other in zip(parted.model.parameters(), whole.model.parameters(), strict=True):
        assert torch.equal(one, other)


def test_a_stage_that_fails_keeps_the_stages_before_it():
    trainer = two_stages([])
    trainer.stages = (trainer.stages[0], dataclasses.replace(
        trainer.stages[1], loss=lambda model, batch, rng, progress: model.two(batch).sum() * math.nan))  # fmt: skip
    with pytest.raises(TrainingError, match="the loss of step 3 was nan .* of step 2, are kept"):
        trainer.run(progress=False)
    assert trainer.step == 2 and len(trainer.history["loss"]) == 2


def test_steps_are_shared_out():
    of = [Stage(name, None, share) for name, share in (("a", 0.3), ("b", 0.2), ("c", 0.5))]
    assert stage_ends(of, 10) == [3, 5, 10] and stage_ends(of, 3) == [1, 2, 3] and stage_ends(of[:1], 7) == [7]
    assert stage_ends([Stage("a", None, 1e-9), Stage("b", None, 1.0)], 4) == [1, 4]
    with pytest.raises(TutorialError, match="2 steps for 3 stages"):
        stage_ends(of, 2)


# --- the network's stages ------------------------------------------------------------------------------------------


class Killed(Exception):
    pass


def test_one_run_trains_all_and_resumes_anywhere(walking, tmp_path):
    """Killed in each of the three stages and at their edges: the weights are those of a run left alone."""
    whole = trainer_for(small(), sets=walking).run(progress=False)
    path = tmp_path / "run.safetensors"

    def kill(trainer: Trainer) -> None:
        trainer.save()
        if trainer.step in (2, 3, 4, 5, 8):
            raise Killed

    for _ in range(5):
        with pytest.raises(Killed):
            trainer_for(small(), path, sets=walking).run(progress=False, callback=kill)
    last = trainer_for(small(), path, sets=walking).run(progress=False)
    assert last.finished and last.model.done == ("pose", "future", "dynamics")
    for (name, one), other in zip(last.model.state_dict().items(), whole.model.state_dict().values(), strict=True):
        assert torch.equal(one, other), name
    np.testing.assert_equal(last.history, whole.history)
    assert recipe_in(read_header(path)) == small()


def test_stages_one_by_one(walking, tmp_path):
    """Stage 1 in one file, stage 2 from it in another, stage 3 from that: what a lesson does."""
    paths = {stage: tmp_path / f"{stage}.safetensors" for stage in ("pose", "future", "dynamics")}
    start = None
    for k, (stage, path) in enumerate(paths.items(), start=1):
        recipe = small(steps=3, start=start, options={"stage": stage})
        trainer = trainer_for(recipe, path, sets=walking).run(progress=False)
        assert len(trainer.model.done) == k and trainer.stage.name == stage
        start = str(path)
    one, three = (load_checkpoint(paths[stage]).model for stage in ("pose", "dynamics"))
    for name, value in one.pose.state_dict().items():
        assert torch.equal(value, three.pose.state_dict()[name]), "later stages leave stage 1 as it was"
    assert generate_futures(load_checkpoint(paths["dynamics"]), 2).motion(0).n_frames == 2


def test_a_stage_before_its_time(walking, trained, tmp_path):
    with pytest.raises(TutorialError, match="stage 'dynamics' .* goes on from a checkpoint .* none is given"):
        small(options={"stage": "dynamics"})
    missing = str(tmp_path / "no.safetensors")
    with pytest.raises(CheckpointError, match="stage 'future' cannot start: .*no.safetensors: there is no such file"):
        trainer_for(small(start=missing, options={"stage": "future"}), sets=walking)
    path = tmp_path / "pose.safetensors"
    trainer_for(small(steps=2, options={"stage": "pose"}), path, sets=walking).run(progress=False)
    told = (
        "pose.safetensors: stage 'dynamics' stands on pose and future, and this network has been trained in pose "
        "only: train stage 'future' first"
    )
    with pytest.raises(CheckpointError, match=told):
        trainer_for(small(start=str(path), options={"stage": "dynamics"}), sets=walking)
    with pytest.raises(CheckpointError, match="has been trained in pose so far: to generate it needs"):
        generate_futures(load_checkpoint(path), 5)
    with pytest.raises(CheckpointError, match="has horizon 3, a run that starts from it asks for 4"):
        trainer_for(small(start=str(path), options={"stage": "future", "horizon": 4}), sets=walking)
    with pytest.raises(CheckpointError, match="has fps 30.0, a run that starts from it asks for 25"):
        trainer_for(small(start=str(path), fps=25, options={"stage": "future"}), sets=walking)
    # a trainer that nobody warned tells it before its first step
    system = trainer_for(small(), sets=walking).system
    system.stages = system.stages[2:]
    with pytest.raises(TutorialError, match="this network is untrained: train stage 'pose' first"):
        Trainer(system, trainer_for(small(), sets=walking).batches).run(progress=False)


def test_windows_and_features_that_do_not_fit():
    with pytest.raises(TutorialError, match="needs windows of 5 frames .*horizon 3.*, the length is 4"):
        small(length=4)
    with pytest.raises(TutorialError, match="reads the representation body-frame, not positions"):
        small(representation="positions")
    with pytest.raises(TutorialError, match="takes features as they are: normalize 'on' is not for it"):
        small(normalize="on")
    with pytest.raises(DataError, match="no clip is long enough for a window of 2000 frames"):
        trainer_for(small(length=2000, options={"horizon": 1500}))


# --- generation ------------------------------------------------------------------------------------------------------


def test_many_futures_of_one_past(trained, clip):
    fan = generate_futures(trained, 30, prefix=clip[:20], count=6, seed=1)
    motions = list(fan)
    assert len(motions) == 6 and all(len(m) == 50 and m.rotations is not None for m in motions)
    past = [m.positions[:20] for m in motions]
    assert max(np.abs(p - past[0]).max() for p in past) < 1e-5, "one past"
    ends = fan.made.code[:, -1]
    assert min((ends[j] - ends[k]).abs().max() for j in range(6) for k in range(j)) > 1e-3, "and a future each"
    assert len({m.positions[-1].tobytes() for m in motions}) == 6
    for motion in motions:
        lengths = np.linalg.norm(np.diff(motion.positions[:, motion.skeleton.bones], axis=2)[:, :, 0], axis=-1)
        assert np.abs(lengths - motion.skeleton.bone_lengths).max() < 1e-4


def test_a_seed_is_its_motions(trained, clip):
    one, again, other = (generate_futures(trained, 12, prefix=clip[:8], count=3, seed=s).made.code for s in (4, 4, 5))
    assert torch.equal(one, again) and not torch.allclose(one, other)


def test_features_are_those_of_the_motions(trained, clip):
    fan = generate_futures(trained, 9, prefix=clip[:8], count=2)
    features = fan.features()
    assert features.shape == (2, 9, trained.representation.dim)
    pose = trained.model.pose
    with torch.no_grad():
        whole = pose.features(pose.decode(fan.codes(1)))  # (8 + 9, D)
    np.testing.assert_allclose(whole[8:], features[1], atol=1e-5)
    np.testing.assert_allclose(trained.representation.decode_positions(whole), fan.motion(1).positions, atol=1e-5)
    np.testing.assert_allclose(fan.features(slice(3, 5)), features[:, 3:5], atol=1e-5)


def test_from_the_prior_alone(trained):
    made = generate_futures(trained, 40, count=3, seed=2)
    assert made.n_prefix == 0 and [len(m) for m in made] == [40, 40, 40]
    assert not torch.allclose(made.made.code[0, 0], made.made.code[1, 0]), "even the first frame is drawn"


def test_pieces_are_the_whole(trained, clip):
    prefix = torch.from_numpy(trained.representation.encode(clip_of(trained, clip)[:10]))[None]

    def run(*lengths):
        stream = FutureStream(trained.model, 2, generator=torch.Generator().manual_seed(3))
        stream.read(prefix)
        return torch.cat([stream.take(n).code for n in lengths], 1)

    assert torch.equal(run(12), run(5, 1, 6))
    stream = FutureStream(trained.model, 2, generator=torch.Generator().manual_seed(3))
    stream.read(prefix)
    frames = torch.stack([f for f, _ in zip(stream.features(chunk=5), range(12), strict=False)], 1)
    pose = trained.model.pose
    torch.testing.assert_close(frames, pose.features(pose.decode(run(12))), atol=1e-5, rtol=1e-5)


def clip_of(checkpoint, clip):
    from tutorial_lib.generate import prepare_for

    return prepare_for(checkpoint, [clip])[0]


def test_memory_does_not_grow(trained):
    stream = FutureStream(trained.model, 3, generator=torch.Generator().manual_seed(0))
    held = []
    for _ in range(3):
        stream.take(50)
        held.append(sum(t.numel() for value in vars(stream).values() if isinstance(value, tuple) for t in value))
    assert held == [2 * 3 * 12] * 3, "two layers of 12 cells for 3 motions"


@pytest.mark.parametrize("temperature", [0.0, 0.5, 5.0, 100.0])
def test_no_temperature_leaves_the_numbers(trained, clip, temperature):
    fan = generate_futures(trained, 60, prefix=clip[:8], count=4, temperature=temperature)
    assert all(np.isfinite(m.positions).all() for m in fan)
    assert torch.equal(fan.made.code[0], fan.made.code[3]) == (temperature == 0)


def test_chance_grows_with_temperature(trained, clip):
    spread = [
        float(generate_futures(trained, 10, prefix=clip[:8], count=64, temperature=t).made.current.std(0).mean())
        for t in (0.5, 1.0, 2.0)
    ]
    assert spread[0] < spread[1] < spread[2]


def test_extreme_poses_are_read(trained):
    stream = FutureStream(trained.model, 1, generator=torch.Generator().manual_seed(0))
    stream.read(1e4 * torch.randn(1, 12, trained.representation.dim, generator=torch.Generator().manual_seed(1)))
    frames = stream.take(20).code
    assert torch.isfinite(frames).all()


def test_a_future_is_imposed_for_a_while(trained, clip):
    states = torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    plain = generate_futures(trained, 12, prefix=clip[:8], count=2)
    imposed = generate_futures(trained, 12, prefix=clip[:8], count=2, future=ImposedFuture(5, states=states))
    for k in range(2):
        assert torch.equal(imposed.made.future[k, 5:9], states)
    assert torch.equal(imposed.made.code[:, :5], plain.made.code[:, :5]), "nothing is changed before"
    assert (imposed.made.code[:, 5:9] - plain.made.code[:, 5:9]).abs().amin() > 0
    assert not torch.equal(imposed.made.future[:, 9], states[-1].expand(2, -1))


def test_the_future_of_a_clip_is_imposed(trained, clip):
    other = data.load("samples/dancing")[0]
    future = future_of(trained, other, start=2, frames=6)
    features = torch.from_numpy(trained.representation.encode(clip_of(trained, other)))
    torch.testing.assert_close(future.summaries, trained.model.summarize(features)[:6])
    made = generate_futures(trained, 10, prefix=clip[:8], count=2, future=future).made
    assert torch.isfinite(made.code).all()
    # f is the posterior's mean for that summary: of no chance, given the past
    stream = FutureStream(trained.model, 1, imposed=ImposedFuture(0, summaries=future.summaries))
    with torch.no_grad():
        expected = trained.model.dynamics.posterior_future(stream.past, future.summaries[:1]).mean
    torch.testing.assert_close(stream.take(1).future[:, 0], expected)


def test_stages_alone(trained, clip):
    """Reconstruction by stage 1, and by stages 1 and 2, stand where the clip stands and last as long."""
    mapped = clip_of(trained, clip)
    one, two = reconstruct(trained, clip), reconstruct_sequences(trained, clip)
    assert len(one) == len(clip) and len(two) == 1 + 3 * ((len(clip) - 1) // 3)
    assert one.rotations is not None and one.skeleton == mapped.skeleton
    np.testing.assert_allclose(one.positions[0, 0, [0, 2]], mapped.positions[0, 0, [0, 2]], atol=1e-5)
    representation = trained.representation
    with torch.no_grad():
        made = trained.model.pose(torch.from_numpy(representation.encode(mapped)))
    expected = representation.decode_positions(made.double().numpy(), **representation.origin(mapped))
    np.testing.assert_allclose(one.positions, expected, atol=1e-4)


def test_generate_and_evaluate_know_it(trained, clip):
    made = generate(trained, 6, seeds=[clip], count=2, seed_frames=8, seed=1)
    assert [len(m) for m in made] == [14, 14]
    result = evaluate(trained, [clip], count=2, frames=30)
    assert math.isfinite(result["motion_change"]["at"]["30"]) and result["bone_drift"]["generated"] < 1e-4


def test_one_seed_one_future_for_who_asks_for_features_too(trained, clip):
    seeds = trained.representation.encode(clip_of(trained, clip)[:8])[None]
    one, again, other = (generate_features(trained, seeds, 5, seed=s) for s in (1, 1, 2))
    assert np.array_equal(one, again) and not np.allclose(one, other)
    np.testing.assert_allclose(generate_futures(trained, 5, prefix=seeds, seed=1).features(), one, atol=1e-5)


# --- what cannot be -----------------------------------------------------------------------------------------------


def test_what_is_for_networks_of_another_kind(trained, clip):
    """It tells no next frame: nothing in one can be given. And those that tell it draw from no generator of ours."""
    seeds = trained.representation.encode(clip_of(trained, clip)[:8])[None]
    with pytest.raises(
        TutorialError,
        match="Dynamic Future Net reads none of its output: it takes no state, nothing given and no noise",
    ):
        generate_features(trained, seeds, 4, given={"control": np.zeros((1, 4, 3))})
    with pytest.raises(TutorialError, match="a generator is for the Dynamic Future Net, not for LSTM3LR"):
        synthesize(make_system("lstm", 4, hidden=4).model, torch.zeros(1, 3, 4), 2, generator=torch.Generator())


def test_prefixes_that_cannot_be(trained, clip, small_motion):
    with pytest.raises(MotionError, match="a prefix of 7 frames .*: the network's past is 8 or more"):
        generate_futures(trained, 5, prefix=clip[:7])
    with pytest.raises(MotionError, match="has 7 nodes .*made for 21"):
        generate_futures(trained, 5, prefix=small_motion)
    with pytest.raises(MotionError, match="prefixes of 8, 9 frames"):
        generate_futures(trained, 5, prefix=[clip[:8], clip[:9]])
    with pytest.raises(TutorialError, match="3 motions asked for and 2 prefixes"):
        generate_futures(trained, 5, prefix=[clip[:8], clip[9:17]], count=3)
    with pytest.raises(MotionError, match=r"\(2, 8, 5\).*expected \(2, frames, 67\)"):
        generate_futures(trained, 5, prefix=torch.zeros(2, 8, 5))
    at_120 = dataclasses.replace(clip[:20], fps=120.0)  # five frames at 30
    with pytest.raises(
        MotionError, match="frames at 120 a second .* is one of 5 at the network's 30: its past is 8 or more"
    ):
        generate_futures(trained, 5, prefix=at_120)


@pytest.mark.parametrize("values, told", [
    ({"n_frames": 0}, "number of frames to generate must be a whole number of 1 or more, not 0"),
    ({"n_frames": 2.5}, "number of frames to generate must be a whole number of 1 or more, not 2.5"),
    ({"count": 0}, "number of motions must be a whole number of 1 or more, not 0"),
    ({"count": True}, "number of motions must be a whole number of 1 or more, not True"),
    ({"seed": -1}, "seed must be a whole number of 0 or more, not -1"),
    ({"seed": None}, "seed must be a whole number of 0 or more, not None"),
    ({"temperature": -1}, "temperature must be a number of 0 or more, not -1"),
    ({"temperature": math.nan}, "temperature must be a number of 0 or more, not nan"),
    ({"future": ImposedFuture(0, states=torch.zeros(4, 9))}, "imposed states of 9 numbers, this network's have 3"),
])  # fmt: skip
def test_numbers_that_cannot_be(trained, values, told):
    with pytest.raises(TutorialError, match=told):
        generate_futures(trained, **{"n_frames": 5, **values})


def test_numpys_numbers_are_numbers_too(trained):
    states = torch.zeros(2, SIZES["future"])
    made, same = (
        generate_futures(trained, whole(5), count=whole(2), seed=whole(3), temperature=real(0.5),
                         future=ImposedFuture(whole(1), states=states)).features()
        for whole, real in ((np.int64, np.float32), (int, float))
    )  # fmt: skip
    np.testing.assert_array_equal(made, same)


@pytest.mark.parametrize("values, told", [
    ({}, "either states or summaries"),
    ({"states": torch.zeros(1, 2), "summaries": torch.zeros(1, 2)}, "either states or summaries"),
    ({"states": torch.zeros(3)}, r"shape \(3,\)"),
    ({"states": torch.full((1, 2), math.nan)}, "expected finite numbers"),
    ({"start": -1, "states": torch.zeros(1, 2)}, "begins after 0 frames or more, not -1"),
])  # fmt: skip
def test_imposed_futures_that_cannot_be(values, told):
    with pytest.raises(TutorialError, match=told):
        ImposedFuture(**values)


def test_clips_too_short_for_a_future(trained, clip):
    for function in (future_of, reconstruct_sequences):
        with pytest.raises(MotionError, match="has 3 frames"):
            function(trained, clip[:3])


def test_on_the_command_line(trained, tmp_path, fails, capsys):
    from tutorial_lib.cli import main

    out = tmp_path / "run.safetensors"
    sizes = ["--hidden", "12", "--horizon", "3", "--batch", "4", "--length", "12", "--steps", "6"]
    train = ["train", "dynamic-future-net", "--data", "samples/walking", "--out", str(out), *sizes]
    assert main(train) == 0 and load_checkpoint(out).model.done == ("pose", "future", "dynamics")
    assert "dynamic-future-net, future (2 of 3)" in capsys.readouterr().err
    made = ["generate", str(out), "--frames", "5", "--count", "2", "-o", str(tmp_path / "made"), "--keep-seed"]
    assert main([*made, "--temperature", "0"]) == 0
    assert "--noise is not for system 'dynamic-future-net'" in fails(*made, "--noise", "0.1")
    motion = read_motion(tmp_path / "made" / "run-02.bvh")
    assert len(motion) == 15 and motion.rotations is not None
    second = ["--stage", "dynamics", "--start", str(out), "--out", str(tmp_path / "again.safetensors")]
    assert main([*train[:4], *sizes, *second]) == 0
    assert "stage 'dynamics'" in fails(*train[:-2], "--stage", "dynamics", "--out", str(tmp_path / "no.safetensors"))
    lstm = tmp_path / "lstm.safetensors"
    save_lstm(lstm, trained)
    told = fails("generate", lstm, "--data", "samples/walking", "-o", tmp_path / "x", "--temperature", "2")
    assert "--temperature is not for system 'lstm'" in told


def save_lstm(path, checkpoint) -> None:
    model = make_system("lstm", checkpoint.representation.dim, hidden=4).model
    save_checkpoint(path, system="lstm", model=model, representation=checkpoint.representation)


def test_each_stage_measures_what_later_ones_read(trained, clip):
    """Features before the first stage, codes after it, summaries after the second: numbers of one size."""
    model = trained.model
    features = torch.from_numpy(trained.representation.encode(clip_of(trained, clip)))
    moving = trained.representation.slices["velocity"]
    torch.testing.assert_close(model.pose.unit[moving], model.pose.scale.std[moving])
    ratio = model.pose.scale.std / features.std(0).clamp_min(1e-3)
    assert 0.5 < ratio.median() < 2, "of these very clips"
    with torch.no_grad():
        codes = model.pose.encode(features)
        summaries = model.future.summaries(codes[None])[0]
    for values in (codes, summaries):
        assert values.mean(0).abs().max() < 1.5 and 0.4 < values.std(0).median() < 1.6


@pytest.mark.parametrize("temperature", [0.0, 0.5, 3.0])
def test_a_prefix_is_read_frame_by_frame(trained, clip, temperature):
    """By hand: where all H = 3 frames to come are in the prefix the future is inferred from them, else imagined; what
    is inferred is no wilder than in training, what is imagined has the temperature."""
    model, dynamics = trained.model, trained.model.dynamics
    prefix = torch.from_numpy(trained.representation.encode(clip_of(trained, clip)[:10]))[None]
    stream = FutureStream(model, 2, temperature=temperature, generator=torch.Generator().manual_seed(3))
    codes = stream.read(prefix)
    noise, state = torch.Generator().manual_seed(3), dynamics.start(2)

    def drawn(g, factor):
        return g.mean + factor * (g.log_variance / 2).exp() * torch.randn(g.mean.shape, generator=noise)

    with torch.no_grad():
        torch.testing.assert_close(codes, model.pose.encode(prefix).expand(2, -1, -1))
        summaries = model.future.summaries(codes)  # of the first 7 frames
        for t in range(10):
            h = state[-1]
            if t < 7:
                m = summaries[:, t]
                f = drawn(dynamics.posterior_future(h, m), min(temperature, 1.0))
            else:
                f = drawn(dynamics.prior_future(h), temperature)
                m = dynamics.summary_of(f, h)
            s = drawn(dynamics.posterior_current(h, codes[:, t], m), min(temperature, 1.0))
            state = dynamics.transition(state, s, f)
    torch.testing.assert_close(stream.past, state[-1])


def test_a_prefix_comes_first(trained, clip):
    prefix = torch.from_numpy(trained.representation.encode(clip_of(trained, clip)[:10]))[None]
    stream = FutureStream(trained.model, 2, generator=torch.Generator().manual_seed(3))
    stream.take(1)
    with pytest.raises(TutorialError, match="a prefix comes first, and frames have been made already"):
        stream.read(prefix)


def test_chance_after_an_imposed_future_is_that_without_it(trained):
    after = []
    for imposed in (None, ImposedFuture(2, states=torch.zeros(4, 3))):
        generator = torch.Generator().manual_seed(5)
        FutureStream(trained.model, 2, generator=generator, imposed=imposed).take(8)
        after.append(torch.randn(3, generator=generator))
    assert torch.equal(*after)


def test_an_imposed_clips_future_goes_on_frame_by_frame(trained):
    summaries = torch.randn(4, 5, generator=torch.Generator().manual_seed(0))
    stream = FutureStream(trained.model, 1, imposed=ImposedFuture(1, summaries=summaries))
    stream.take(1)
    for k in range(4):
        with torch.no_grad():
            expected = trained.model.dynamics.posterior_future(stream.past, summaries[k : k + 1]).mean
        torch.testing.assert_close(stream.take(1).future[:, 0], expected)


def test_a_stage_has_a_step_wherever_it_stands():
    of = [Stage(name, None, share) for name, share in (("a", 0.5), ("b", 1e-9), ("c", 0.5))]
    assert stage_ends(of, 10) == [5, 6, 10]


def test_a_run_is_saved_when_a_stage_ends(walking, tmp_path):
    """However short it is: what stage 1 has learnt is not lost in stage 2."""
    path, done = tmp_path / "run.safetensors", []
    trainer = trainer_for(small(), path, sets=walking)
    trainer.run(progress=False, callback=lambda t: path.exists() and done.append(read_header(path)["training"]))
    assert [header["steps_done"] for header in done] == [3, 3, 5, 5, 5, 5, 5], "told at steps 4 to 10"


def test_each_motion_has_its_own_prefix(trained, clip):
    prefixes = [clip[:8], clip[40:48]]
    fan = generate_futures(trained, 4, prefix=prefixes, seed=1)
    for k, prefix in enumerate(prefixes):
        with torch.no_grad():
            codes = trained.model.pose.encode(torch.from_numpy(trained.representation.encode(clip_of(trained, prefix))))
        torch.testing.assert_close(fan.codes(k)[:8], codes, atol=1e-4, rtol=1e-4)


def test_the_future_of_a_clip_begins_where_it_is_told(trained, clip):
    future = future_of(trained, clip, start=2, frames=6)
    assert future.start == 2 and len(future.summaries) == 6
    assert len(future_of(trained, clip).summaries) == len(clip_of(trained, clip)) - SIZES["horizon"]


def test_stretches_are_told_by_their_summary_and_the_code_before(trained, clip):
    model, representation, mapped = trained.model, trained.representation, clip_of(trained, clip)
    with torch.no_grad():
        codes = model.pose.encode(torch.from_numpy(representation.encode(mapped)))
        parts = [codes[:1]]
        for t in range(0, len(codes) - 3, 3):
            parts.append(model.future.decode(model.future.encode(codes[None, t : t + 4]), codes[None, t])[0])
        features = model.pose.features(model.pose.decode(torch.cat(parts)))
    expected = representation.decode_positions(features.double().numpy(), **representation.origin(mapped))
    np.testing.assert_allclose(reconstruct_sequences(trained, clip).positions, expected, atol=1e-4)


def test_two_stages_do_not_generate(trained):
    half = dataclasses.replace(trained, model=copy.deepcopy(trained.model))
    half.model.stages_done.fill_(2)
    with pytest.raises(CheckpointError, match="trained in pose and future so far: to generate it needs"):
        generate_futures(half, 5)
