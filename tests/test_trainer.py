"""Training: the same run whether it is interrupted, killed or left alone; and what stops it."""

from __future__ import annotations

import math
import os
import pathlib
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
import torch
from torch import nn

from tutorial_lib.errors import CheckpointError, TutorialError
from tutorial_lib.motion import Skeleton
from tutorial_lib.representations import make_representation
from tutorial_lib.training.checkpoints import load_checkpoint, read_header
from tutorial_lib.training.progress import in_notebook, loss_figure
from tutorial_lib.training.systems import System, make_system, next_frame_loss
from tutorial_lib.training.trainer import Trainer, TrainingConfig, TrainingError, usable_device

PROJECT = pathlib.Path(__file__).resolve().parents[1]


class Waves:
    """Batches of sine waves with random phases, from a numpy generator of their own."""

    def __init__(self, seed: int = 0):
        self.rng = np.random.default_rng(seed)

    def sample(self) -> torch.Tensor:
        phase = self.rng.uniform(0, 2 * math.pi, (4, 1, 1))
        time = 0.3 * np.arange(12)[None, :, None]
        return torch.tensor(np.sin(time * np.array([1.0, 2.0, 0.5]) + phase), dtype=torch.float32)

    def state_dict(self) -> dict:
        return {"generator": self.rng.bit_generator.state}

    def load_state_dict(self, state) -> None:
        self.rng.bit_generator.state = state["generator"]


def noisy_loss(model, batch, rng, progress):
    """Draws from everything a loss may draw from: the trainer's generator and, as dropout does, torch's own."""
    batch = batch + 0.05 * torch.randn(batch.shape, generator=rng)
    batch = nn.functional.dropout(batch, 0.1, training=model.training)
    loss = next_frame_loss(model, batch) * (1 + progress)
    return loss, {"plain": loss / (1 + progress)}


def make_trainer(path=None, *, steps=20, loss=noisy_loss, seed=1, batches=None, **options) -> Trainer:
    config = TrainingConfig(**{"steps": steps, "learning_rate": 1e-2, "seed": 4, **options.pop("config", {})})
    system = make_system("lstm", 3, hidden=6, layers=2, seed=seed)
    return Trainer(System("lstm", system.model, loss), batches or Waves(), config, path=path, **options)


def weights(model: nn.Module) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in model.state_dict().items()}


def assert_same(a: nn.Module, b: nn.Module) -> None:
    for (name, one), other in zip(a.state_dict().items(), b.state_dict().values(), strict=True):
        assert torch.equal(one, other), name


def test_training_learns_and_is_the_same_each_time():
    trainer = make_trainer(steps=300, loss=lambda m, b, rng, p: next_frame_loss(m, b)).run(progress=False)
    loss = trainer.history["loss"]
    assert len(loss) == 300 and trainer.finished and not trainer.model.training
    assert np.mean(loss[-20:]) < 0.1 * loss[0]
    one, two = make_trainer().run(progress=False), make_trainer().run(progress=False)
    assert_same(one.model, two.model)
    assert one.history == two.history and set(one.history) == {"loss", "plain"}
    other = make_trainer(config={"seed": 5}).run(progress=False)
    assert other.history["loss"] != one.history["loss"]


def test_first_step_is_adams():
    """Adam's first step is lr * g / (|g| + eps), whatever the gradient's size: checked by hand on one weight."""

    class Scale(nn.Module):
        def __init__(self):
            super().__init__()
            self.w = nn.Parameter(torch.tensor([2.0]))

    model = Scale()
    system = System("scale", model, lambda m, b, rng, p: (m.w * 3.0 - 1.0).square().sum())
    config = TrainingConfig(steps=1, learning_rate=0.1, schedule="constant", clip=None)
    trainer = Trainer(system, Waves(), config).run(progress=False)
    assert trainer.history["loss"] == [25.0]
    assert model.w.item() == pytest.approx(1.9, abs=1e-6)


def test_one_cycle_goes_up_and_down():
    config = TrainingConfig(steps=1001, learning_rate=0.5)
    rates = [config.learning_rate_at(step) for step in range(1001)]
    assert rates[0] == pytest.approx(0.02) and rates[300] == pytest.approx(0.5) and rates[150] == pytest.approx(0.26)
    assert rates[-1] == pytest.approx(0.5 / 250_000)
    assert np.all(np.diff(rates[:301]) > 0) and np.all(np.diff(rates[300:]) < 0)
    assert TrainingConfig(steps=9, schedule="constant", learning_rate=0.5).learning_rate_at(8) == 0.5
    assert TrainingConfig(steps=1).learning_rate_at(0) > 0


def test_gradient_is_clipped_as_a_whole():
    seen = []
    model = nn.Linear(3, 1)
    system = System("x", model, lambda m, b, rng, p: 1e3 * m(b[:, 0]).square().mean())
    trainer = Trainer(system, Waves(), TrainingConfig(steps=3, clip=0.25))
    trainer.run(
        progress=False,
        callback=lambda t: seen.append(math.sqrt(sum(p.grad.square().sum().item() for p in model.parameters()))),
    )
    assert seen == pytest.approx([0.25] * 3, rel=1e-4)


def test_global_generators_are_left_alone():
    torch.manual_seed(11)
    np_state, state = np.random.get_state()[1].copy(), torch.get_rng_state()  # noqa: NPY002
    threads = torch.get_num_threads()
    make_trainer().run(progress=False)
    assert torch.equal(torch.get_rng_state(), state) and torch.get_num_threads() == threads
    assert np.array_equal(np.random.get_state()[1], np_state)  # noqa: NPY002


def test_frozen_parameters_stay():
    trainer_ = make_trainer()
    system = trainer_.system
    for p in system.model.readout.parameters():
        p.requires_grad_(False)
    before = weights(system.model)
    trainer = Trainer(system, Waves(), TrainingConfig(steps=3)).run(progress=False)
    assert torch.equal(trainer.model.readout.weight, before["readout.weight"])
    assert not torch.equal(trainer.model.lstm.weight_hh_l0, before["lstm.weight_hh_l0"])


def test_a_network_without_anything_to_learn_is_refused(tmp_path):
    path = tmp_path / "x.safetensors"
    system = make_trainer(path).run(progress=False).system
    there = load_checkpoint(path).model
    with pytest.raises(TutorialError, match=r"system 'lstm' requires a gradient, .*: model.requires_grad_\(True\)"):
        Trainer(System("lstm", there, noisy_loss), Waves(), TrainingConfig(steps=3))
    for model in (there.requires_grad_(True), system.model):  # what the message says to do, it does
        Trainer(System("lstm", model, noisy_loss), Waves(), TrainingConfig(steps=3)).run(progress=False)
    assert_same(there, system.model)


# --- resuming -------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [1, 7, 19])
def test_resumed_run_ends_in_the_same_weights(tmp_path, at):
    whole = make_trainer().run(progress=False)
    path = tmp_path / "run.safetensors"

    def stop(trainer):
        if trainer.step == at:
            os.kill(os.getpid(), signal.SIGINT)

    part = make_trainer(path).run(progress=False, callback=stop)
    assert part.step == at and not part.finished
    assert read_header(path)["resumable"] and read_header(path)["training"]["steps_done"] == at
    # other weights, other place in the data, other generator: all must come from the file
    again = make_trainer(path, seed=99, batches=Waves(7)).resume()
    assert again.step == at
    again.run(progress=False)
    assert_same(again.model, whole.model)
    assert again.history == whole.history
    assert not read_header(path)["resumable"]
    assert_same(load_checkpoint(path).model, whole.model)


def test_run_goes_on_in_the_same_process(tmp_path):
    whole = make_trainer().run(progress=False)
    trainer = make_trainer(tmp_path / "x.safetensors")
    while not trainer.finished:
        trainer.run(progress=False, max_seconds=0)
    assert_same(trainer.model, whole.model)


def test_a_callback_may_save_and_generate(tmp_path):
    whole = make_trainer().run(progress=False)

    def look(trainer):
        trainer.model.eval()  # as synthesis does
        if trainer.step == 7:
            trainer.save()
            (tmp_path / "7.safetensors").write_bytes(trainer.path.read_bytes())

    assert_same(make_trainer(tmp_path / "x.safetensors").run(progress=False, callback=look).model, whole.model)
    again = make_trainer(tmp_path / "7.safetensors", seed=99).resume()
    assert again.step == 7
    assert_same(again.run(progress=False).model, whole.model)


KILLED = """
    import sys
    sys.path[:0] = [{tests!r}, {project!r}]
    from test_trainer import make_trainer
    import time
    trainer = make_trainer({path!r}, steps=60, save_seconds=0.0)
    trainer.run(progress=False, callback=lambda t: time.sleep(0.02))
"""


def test_killed_run_resumes_to_the_same_weights(tmp_path):
    """SIGKILL from outside, at no chosen moment, while the run saves after every step; twice."""
    path = tmp_path / "killed.safetensors"
    whole = make_trainer(steps=60).run(progress=False)
    code = textwrap.dedent(KILLED.format(tests=str(PROJECT / "tests"), project=str(PROJECT), path=str(path)))
    env = {**os.environ, "OMP_NUM_THREADS": str(torch.get_num_threads())}
    child = subprocess.Popen([sys.executable, "-c", code], env=env)
    try:
        deadline = time.monotonic() + 60
        while not (path.exists() and read_header(path)["training"]["steps_done"] >= 5):
            assert time.monotonic() < deadline and child.poll() is None, "the run did not start"
            time.sleep(0.01)
    finally:
        child.kill()
        child.wait()
    assert child.returncode == -signal.SIGKILL
    done = read_header(path)["training"]["steps_done"]
    assert 5 <= done < 60
    trainer = make_trainer(path, steps=60, seed=99).resume()
    assert trainer.step == done
    trainer.run(progress=False)
    assert_same(trainer.model, whole.model)
    assert trainer.history == whole.history


def test_resume_of_another_run_is_refused(tmp_path):
    path = tmp_path / "run.safetensors"
    make_trainer(path, settings={"length": 12}).run(progress=False, max_seconds=0)
    with pytest.raises(CheckpointError, match="learning_rate 0.02: it was started with 0.01"):
        make_trainer(path, settings={"length": 12}, config={"learning_rate": 0.02}).resume()
    with pytest.raises(CheckpointError, match="length 13: it was started with 12"):
        make_trainer(path, settings={"length": 13}).resume()
    with pytest.raises(CheckpointError, match="another representation or skeleton"):
        skeleton = Skeleton(("hip",), (-1,), np.zeros((1, 3)))
        other = make_representation("positions", skeleton, 30.0)
        make_trainer(path, settings={"length": 12}, representation=other).resume()
    with pytest.raises(CheckpointError, match="no path"):
        make_trainer().resume()
    finished = make_trainer(tmp_path / "done.safetensors").run(progress=False)
    with pytest.raises(CheckpointError, match="weights only"):
        make_trainer(finished.path).resume()


# --- stopping -------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_loss_that_is_not_finite_stops_with_the_last_good_weights(tmp_path, bad):
    """The weights kept are those before the update that led to it: a run of 8 steps has the same."""
    path = tmp_path / "x.safetensors"
    calls = []

    def loss(model, batch, rng, progress):
        calls.append(0)
        return next_frame_loss(model, batch) * (bad if len(calls) == 10 else 1.0)

    trainer = make_trainer(path, loss=loss)
    with pytest.raises(
        TrainingError, match=r"loss of step 10 was (nan|inf).*of step 8, are kept.*x\.safetensors"
    ) as told:
        trainer.run(progress=False)
    assert "\n" not in str(told.value)
    good = make_trainer(loss=lambda m, b, rng, p: next_frame_loss(m, b))
    good.run(progress=False, callback=lambda t: t.step == 8 and os.kill(os.getpid(), signal.SIGINT))
    assert good.step == 8
    assert_same(trainer.model, good.model)
    kept = load_checkpoint(path)
    assert_same(kept.model, good.model)
    assert kept.training["steps_done"] == 8 and "step 10" in kept.training["status"]
    assert trainer.history["loss"] == good.history["loss"]
    with pytest.raises(TrainingError, match="stopped for good"):
        trainer.run(progress=False)


def test_a_gradient_that_is_not_finite_stops_it():
    """The square root's slope at zero is infinite: the loss is fine, its gradient is not."""

    def loss(model, batch, rng, progress):
        return next_frame_loss(model, batch) + (0.0 * model.readout.bias.sum()).sqrt()

    with pytest.raises(TrainingError, match="gradient's norm of step 1 was nan.*nothing was learnt"):
        make_trainer(loss=loss).run(progress=False)


def test_a_learning_rate_that_is_too_high_keeps_finite_weights(tmp_path):
    trainer = make_trainer(
        tmp_path / "x.safetensors", steps=50, config={"learning_rate": 1e30, "schedule": "constant", "clip": None}
    )
    with pytest.raises(TrainingError):
        trainer.run(progress=False)
    assert all(torch.isfinite(p).all() for p in trainer.model.parameters())


def test_a_last_update_that_overflows_is_undone():
    """A finite gradient, and a step that is too long for float32: noticed although no step follows."""
    trainer = make_trainer(steps=1, config={"learning_rate": 1e39, "schedule": "constant"})
    before = weights(trainer.model)
    with pytest.raises(TrainingError, match="largest weight after the update of step 1 was inf"):
        trainer.run(progress=False)
    assert all(torch.equal(value, before[name]) for name, value in trainer.model.state_dict().items())


def test_second_interrupt_ends_at_once():
    def twice(trainer):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        make_trainer().run(progress=False, callback=twice)
    assert signal.getsignal(signal.SIGINT) is handler


def test_runs_outside_the_main_thread():
    whole, trainer = make_trainer().run(progress=False), make_trainer()
    thread = threading.Thread(target=lambda: trainer.run(progress=False))
    thread.start()
    thread.join()
    assert_same(trainer.model, whole.model)


@pytest.mark.parametrize(
    "wrong",
    [
        {"steps": 0},
        {"steps": 2.5},
        {"learning_rate": 0.0},
        {"learning_rate": float("nan")},
        {"schedule": "zigzag"},
        {"clip": -1.0},
    ],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(TutorialError):
        TrainingConfig(**wrong)


def test_devices_that_are_not_there_are_refused():
    assert usable_device("cpu").type == "cpu"
    for name in ("cuda:99", "toaster", "meta"):
        with pytest.raises(TutorialError, match="cannot compute on device") as told:
            usable_device(name)
        assert "\n" not in str(told.value)


# --- what is seen ---------------------------------------------------------------------------------


def test_progress_in_a_log_is_lines_with_loss_and_speed(capsys):
    make_trainer().run()
    err = capsys.readouterr().err
    assert "\r" not in err and "20/20" in err and ("step/s" in err or "s/step" in err) and "loss=" in err


class FakeHandle:
    def __init__(self, shown):
        self.shown = shown

    def update(self, data, raw):
        self.shown.append(("update", data))


def test_progress_in_a_notebook_is_one_line_and_one_figure_replaced_in_place(monkeypatch, capsys):
    import IPython
    import IPython.display

    from tutorial_lib.training import progress

    shown = []

    def display(data, raw, display_id):
        shown.append(("new", data))
        return FakeHandle(shown)

    shell = type("Shell", (), {"kernel": object()})()
    monkeypatch.setattr(IPython, "get_ipython", lambda: shell)
    monkeypatch.setattr(IPython.display, "display", display)
    monkeypatch.setattr(
        progress.LivePlot.__init__, "__kwdefaults__", {**progress.LivePlot.__init__.__kwdefaults__, "seconds": 0.0}
    )
    assert in_notebook()
    make_trainer(steps=8).run()
    assert sum(kind == "new" for kind, _ in shown) == 2
    lines = [data["text/plain"] for _, data in shown if "image/png" not in data]
    pictures = [data["image/png"] for _, data in shown if "image/png" in data]
    assert "8/8" in lines[-1] and "loss=" in lines[-1]
    assert "step/s" in lines[-1] or "s/step" in lines[-1]  # the second below one step a second: drawing, and other load
    assert len(pictures) >= 8 and all(p.startswith(b"\x89PNG") and len(p) < 60_000 for p in pictures)
    assert pictures[0] != pictures[-1]
    assert capsys.readouterr() == ("", "")


def test_outside_a_notebook_nothing_is_drawn(monkeypatch):
    def never(*args):
        raise AssertionError("drawn")

    monkeypatch.setattr("tutorial_lib.training.progress.loss_figure", never)
    assert not in_notebook()
    make_trainer(steps=2).run(progress=False, live_plot=True)


def test_loss_figure_takes_any_losses():
    for losses in ([1.0], [0.0, 0.0], [3.0, -1.0], list(np.geomspace(1, 1e-6, 5000))):
        assert loss_figure(losses, 10_000).startswith(b"\x89PNG")


def test_importing_changes_nothing():
    code = (
        "import torch; s = torch.get_rng_state(); n = torch.get_num_threads(); import tutorial_lib.cli, "
        "tutorial_lib.generate, tutorial_lib.evaluate, tutorial_lib.training.trainer, sys; "
        "assert torch.equal(s, torch.get_rng_state()) and n == torch.get_num_threads(); "
        "assert 'matplotlib' not in sys.modules and 'IPython' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PROJECT)


def test_the_loss_told_is_the_mean_of_the_last_hundred_steps():
    trainer = make_trainer(steps=130).run(progress=False)
    assert trainer.loss == pytest.approx(np.mean(trainer.history["loss"][-100:]))


def test_seconds_are_those_of_all_runs():
    trainer = make_trainer(steps=3)
    trainer.seconds = 50.0  # as of a run before
    trainer.run(progress=False)
    assert 50 < trainer.seconds < 100


def test_resume_of_another_system_is_refused(tmp_path):
    """Of the very same network, trained otherwise."""
    path = tmp_path / "run.safetensors"
    make_trainer(path).run(progress=False, max_seconds=0)
    trainer = make_trainer(path)
    trainer.system.name = "aclstm"
    with pytest.raises(CheckpointError, match="system 'aclstm': it was started with 'lstm'"):
        trainer.resume()


def test_a_trainer_on_a_device_that_is_not_there_is_refused():
    with pytest.raises(TutorialError, match="cannot compute on device 'meta'"):
        make_trainer(device="meta")
