"""The engine: the fast rollout against the plain loop, and the plain loop against what can be known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from tutorial_lib.errors import TutorialError
from tutorial_lib.generate import synthesize
from tutorial_lib.models.recurrent import LSTM3LR, LSTM3LRConfig
from tutorial_lib.training import rollout as engine
from tutorial_lib.training.checkpoints import load_checkpoint
from tutorial_lib.training.conditioning import auto_conditioning, scheduled_sampling, seed_only, teacher_forcing
from tutorial_lib.training.rollout import LSTMStream, has_fast_rollout, plain_rollout, rollout
from tutorial_lib.training.systems import AutoConditionedLoss, make_system, next_frame_loss, scheduled_loss
from tutorial_lib.training.trainer import Trainer, TrainingConfig


class Adding(nn.Module):
    """Its next frame is the last one plus one; its memory is the sum of all that it was fed."""

    def forward(self, x, state=None):
        return x + 1, x[:, 0] if state is None else state + x[:, 0]


def make(dim=5, hidden=4, layers=3, seed=1, dtype=torch.float64) -> LSTM3LR:
    model = make_system("lstm", dim, hidden=hidden, layers=layers, seed=seed).model
    with torch.no_grad():  # large weights, so that gates saturate and own outputs matter
        for p in model.parameters():
            p.mul_(2.0)
    return model.to(dtype)


def random(*shape, seed=0, dtype=torch.float64) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def mixed(T: int, batch: int) -> torch.Tensor:
    """A schedule for each sequence: some frames the truth for all, for none and for a few."""
    schedule = scheduled_sampling(T, batch, 0.5, torch.Generator().manual_seed(7))
    if T > 4:
        schedule[:, 3], schedule[:, 4] = False, True
    return schedule


SCHEDULES = {
    "truth": lambda T, B: teacher_forcing(T),
    "5-5": lambda T, B: auto_conditioning(T, 5, 5),
    "1-1": lambda T, B: auto_conditioning(T, 1, 1),
    "2-3": lambda T, B: auto_conditioning(T, 2, 3),
    "3-1": lambda T, B: auto_conditioning(T, 3, 1),
    "seed": lambda T, B: seed_only(T, min(4, T)),
    "seed of one": lambda T, B: seed_only(T, 1),
    "sampled": mixed,
}
SHAPES = {  # sequences, frames, numbers a frame, cells, layers
    "stack of three": (3, 17, 5, 4, 3),
    "one layer": (2, 12, 3, 6, 1),
    "two layers, wide frames": (4, 9, 11, 3, 2),
    "five layers": (2, 11, 2, 3, 5),
    "one of all": (1, 8, 1, 1, 1),
    "one frame": (3, 1, 4, 5, 2),
}


def everything(model, x, schedule, state, fast):
    """Outputs, memory and all gradients of a loss in which every output and the memory count differently."""
    x = x.clone().requires_grad_()
    state = tuple(part.clone().requires_grad_() for part in state) if state is not None else None
    y, (h, c) = rollout(model, x, schedule, state, fast=fast)
    parts = {"y": y, "h": h, "c": c}
    loss = sum((part * random(*part.shape, seed=k, dtype=part.dtype)).sum() for k, part in enumerate(parts.values()))
    inputs = {"x": x, **dict(model.named_parameters())}
    if state is not None:
        inputs |= {"h0": state[0], "c0": state[1]}
    gradients = torch.autograd.grad(loss + y.square().sum(), list(inputs.values()))
    return parts | {f"d {name}": g for name, g in zip(inputs, gradients, strict=True)}


def assert_close(fast: dict, plain: dict, relative: float):
    assert fast.keys() == plain.keys()
    for name, expected in plain.items():
        assert fast[name].shape == expected.shape and fast[name].dtype == expected.dtype, name
        error = (fast[name] - expected).abs().max().item()
        assert error <= relative * max(expected.abs().max().item(), 1e-3), (name, error)


# --- the plain loop -------------------------------------------------------------------------------


def test_plain_loop_feeds_truth_or_own_output():
    """A network that adds one, fed 10, 20, 30, ...: the outputs tell what it was fed."""
    x = (10.0 * torch.arange(1, 7)).reshape(1, 6, 1)
    y, total = rollout(Adding(), x, [True, False, False, True, True, False])
    assert y.flatten().tolist() == [11, 12, 13, 41, 51, 52]
    assert total.item() == 10 + 11 + 12 + 40 + 50 + 51
    y, _ = rollout(Adding(), torch.cat([x, x]), np.array([[True] * 6, [True] + [False] * 5]))
    assert y[..., 0].tolist() == [[11, 21, 31, 41, 51, 61], [11, 12, 13, 14, 15, 16]]


def test_always_the_truth_is_the_network_itself():
    model, x = make(), random(3, 9, 5)
    whole, state = model(x)
    for fast in (False, True):
        y, (h, c) = rollout(model, x, teacher_forcing(9), fast=fast)
        torch.testing.assert_close(y, whole)
        torch.testing.assert_close((h, c), state)


def test_seed_and_then_never_is_synthesis():
    model, x = make(), random(2, 12, 5)
    made = synthesize(model, x[:, :4], 9)
    for fast in (False, True):
        y, _ = rollout(model, x, seed_only(12, 4), fast=fast)
        torch.testing.assert_close(y[:, 3:].detach(), made)


# --- the fast one ---------------------------------------------------------------------------------


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("shape", SHAPES)
def test_fast_equals_plain(shape, schedule):
    B, T, D, H, L = SHAPES[shape]
    model, x, fed = make(D, H, L), random(B, T, D), SCHEDULES[schedule](T, B)
    for state in (None, (random(L, B, H, seed=3), random(L, B, H, seed=4))):
        fast, plain = (everything(model, x, fed, state, fast) for fast in (True, False))
        assert_close(fast, plain, 1e-9)


@pytest.mark.parametrize("schedule", ["5-5", "seed", "sampled"])
@pytest.mark.parametrize("D, H, L", [(171, 32, 3), (24, 100, 2)])
def test_fast_equals_plain_in_single_precision(schedule, D, H, L):
    model = make_system("lstm", D, hidden=H, layers=L).model
    x = random(8, 60, D, dtype=torch.float32)
    fed = SCHEDULES[schedule](60, 8)
    fast, plain = (everything(model, x, fed, None, fast) for fast in (True, False))
    assert_close(fast, plain, 1e-5)


def test_large_weights_that_are_not_copied():
    """Above a size weights are read as they lie: no other numbers."""
    model = make_system("lstm", 7, hidden=420, layers=2).model.double()
    assert model.lstm.weight_hh_l0.numel() > 2**19
    x, fed = random(2, 7, 7), auto_conditioning(7, 2, 2)
    assert_close(everything(model, x, fed, None, True), everything(model, x, fed, None, False), 1e-9)


def test_gradcheck():
    """Against finite differences, which know nothing of either implementation."""
    model = make(2, 2, 2)
    names = [name for name, _ in model.named_parameters()]
    fed = torch.tensor([[True, True, False, False, True], [True, False, False, True, False]])

    def run(x, h, c, *weights):
        other = LSTM3LR(LSTM3LRConfig(2, 2, 2)).double()
        for name, w in zip(names, weights, strict=True):
            owner, _, leaf = name.rpartition(".")
            module = other.get_submodule(owner)
            del module._parameters[leaf]
            module.__dict__[leaf] = w
        y, (h, c) = rollout(other, x, fed, (h, c), fast=True)
        return y, h, c

    inputs = [random(2, 5, 2), random(2, 2, 2, seed=1), random(2, 2, 2, seed=2)]
    inputs += [p.detach().clone() for p in model.parameters()]
    assert torch.autograd.gradcheck(run, [v.requires_grad_() for v in inputs], atol=1e-6)


def test_runs_start_where_an_own_output_is_read():
    assert engine.runs(auto_conditioning(12, 3, 2)[None]) == [(0, 3), (3, 4), (4, 8), (8, 9), (9, 12)]
    assert engine.runs(teacher_forcing(7)[None]) == [(0, 7)]
    two = torch.tensor([[True, True, True, False], [True, False, True, True]])
    assert engine.runs(two) == [(0, 1), (1, 3), (3, 4)]


def test_frames_that_are_not_fed_do_not_matter():
    model, x, fed = make(), random(2, 10, 5), auto_conditioning(10, 2, 3)
    changed = torch.where(fed[:, None], x, torch.tensor(float("nan"), dtype=x.dtype)).requires_grad_()
    y, _ = rollout(model, changed, fed, fast=True)
    assert torch.equal(y, rollout(model, x, fed, fast=True)[0])
    y.sum().backward()
    assert (changed.grad[:, ~fed] == 0).all() and (changed.grad[:, fed] != 0).all()
    assert all(p.grad.isfinite().all() for p in model.parameters())


def test_inputs_are_left_as_they_were_and_twice_backward_is_the_same():
    model, x, fed = make(), random(2, 10, 5), mixed(10, 2)
    state = (random(3, 2, 4, seed=5), random(3, 2, 4, seed=6))
    before = [v.clone() for v in (x, *state)]
    y, _ = rollout(model, x, fed, state, fast=True)
    assert all(torch.equal(a, b) for a, b in zip(before, (x, *state), strict=True))
    kept = y.detach().clone()
    weights = list(model.parameters())
    one = torch.autograd.grad(y.square().sum(), weights, retain_graph=True)
    two = torch.autograd.grad(y.square().sum(), weights)
    assert torch.equal(y, kept) and all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def test_two_rollouts_at_once_do_not_disturb_each_other():
    model, fed = make(), auto_conditioning(10, 2, 3)
    a, b = random(2, 10, 5, seed=1), random(3, 10, 5, seed=2)
    weights = list(model.parameters())
    alone = [torch.autograd.grad(rollout(model, x, fed)[0].sum(), weights) for x in (a, b)]
    ya, yb = rollout(model, a, fed)[0], rollout(model, b, fed)[0]
    together = [torch.autograd.grad(y.sum(), weights) for y in (ya, yb)]
    for one, other in zip(alone, together, strict=True):
        assert all(torch.equal(p, q) for p, q in zip(one, other, strict=True))


def test_there_is_no_second_derivative_and_it_says_so():
    model, x = make(), random(1, 6, 5).requires_grad_()
    y, _ = rollout(model, x, auto_conditioning(6, 2, 2), fast=True)
    with pytest.raises(TutorialError, match="no second derivative: take .*fast=False"):
        torch.autograd.grad(y.sum(), x, create_graph=True)
    y, _ = rollout(model, x, auto_conditioning(6, 2, 2), fast=False)
    (gradient,) = torch.autograd.grad(y.sum(), x, create_graph=True)
    assert torch.autograd.grad(gradient.sum(), x)[0].abs().sum() > 0


def test_state_goes_on_where_it_was_left():
    """In two parts, the second beginning with the first part's last output where its schedule has an own frame."""
    model, x, fed = make(), random(2, 14, 5), auto_conditioning(14, 3, 3)
    whole, end = rollout(model, x, fed)
    first, state = rollout(model, x[:, :5], fed[:5])
    rest = torch.cat([first[:, -1:], x[:, 6:]], dim=1)
    second, state = rollout(model, rest, torch.cat([torch.tensor([True]), fed[6:]]), state)
    torch.testing.assert_close(torch.cat([first, second], dim=1), whole)
    torch.testing.assert_close(state, end)


@pytest.mark.parametrize("schedule", ["truth", "5-5", "seed", "sampled"])
def test_without_gradients_in_pieces(schedule, monkeypatch):
    monkeypatch.setattr(engine, "PIECE", 7)
    model, x = make(), random(3, 40, 5)
    fed = SCHEDULES[schedule](40, 3)
    expected, end = rollout(model, x, fed, fast=False)
    with torch.no_grad():
        y, state = rollout(model, x, fed, fast=True)
    torch.testing.assert_close(y, expected.detach())
    torch.testing.assert_close(state, tuple(part.detach() for part in end))


def test_frozen_weights_get_no_gradient():
    model, x = make(), random(2, 6, 5)
    model.lstm.weight_ih_l0.requires_grad_(False)
    rollout(model, x, auto_conditioning(6, 2, 1))[0].sum().backward()
    assert model.lstm.weight_ih_l0.grad is None and model.lstm.weight_hh_l0.grad.abs().sum() > 0


def test_a_network_that_is_not_known_runs_plainly():
    class Other(LSTM3LR):
        def forward(self, x, state=None):
            y, state = super().forward(x, state)
            return x + y, state  # a residual, as seq2seq has it

    other = Other(LSTM3LRConfig(3, 4, 2)).double()
    x, fed = random(2, 8, 3), auto_conditioning(8, 2, 2)
    assert has_fast_rollout(make()) and not has_fast_rollout(other)
    assert torch.equal(rollout(other, x, fed)[0], plain_rollout(other, x, fed.expand(2, 8))[0])
    with pytest.raises(TutorialError, match="no fast rollout for Other"):
        rollout(other, x, fed, fast=True)


@pytest.mark.parametrize(
    "x, schedule, words",
    [
        (random(2, 8, 5), teacher_forcing(7), "schedule has 7 frames, the sequence 8"),
        (random(2, 8, 5), teacher_forcing(9), "schedule has 9 frames, the sequence 8"),
        (random(2, 8, 5), mixed(8, 3), "schedule is for 3 sequences, there are 2"),
        (random(2, 4, 5), [False, True, True, True], "does not begin with the truth"),
        (random(2, 4, 5), torch.tensor([[True] * 4, [False] * 4]), "does not begin with the truth"),
        (random(2, 4, 5), torch.ones(4), "true or false at each frame, not float32"),
        (random(2, 4, 5), torch.ones(2, 4, 1).bool(), r"not \(2, 4, 1\)"),
        (random(8, 5), teacher_forcing(8), r"\(sequences, frames, numbers\), not \(8, 5\)"),
        (random(2, 4, 6), teacher_forcing(4), "network reads 5 numbers a frame, the sequence has 6"),
    ],
)
def test_what_does_not_fit_is_told_with_both_sides(x, schedule, words):
    with pytest.raises(TutorialError, match=words):
        rollout(make(), x, schedule)


# --- losses and training --------------------------------------------------------------------------


def test_losses_of_equations_one_and_two():
    """A network that adds one, on 10, 20, 40: fed the truth it misses by 9 and 19, fed itself by 9 and 28."""
    batch = torch.tensor([[[10.0], [20.0], [40.0]]])
    assert scheduled_loss(Adding(), batch, [True, True]).item() == (9**2 + 19**2) / 2
    assert scheduled_loss(Adding(), batch, [True, False]).item() == (9**2 + 28**2) / 2
    assert AutoConditionedLoss(1, 1)(Adding(), batch).item() == (9**2 + 28**2) / 2
    assert AutoConditionedLoss(2, 1)(Adding(), batch).item() == next_frame_loss(Adding(), batch).item()
    assert AutoConditionedLoss(2, 1).least_length == 4 and AutoConditionedLoss(1, 1).least_length == batch.shape[1] == 3


class Waves:
    """The same few sine waves in random order."""

    def __init__(self, seed: int = 0):
        self.rng = np.random.default_rng(seed)

    def sample(self) -> torch.Tensor:
        phase = self.rng.uniform(0, 6.28, (6, 1, 1))
        time = 0.3 * np.arange(21)[None, :, None]
        return torch.tensor(np.sin(time * np.array([1.0, 2.0, 0.5]) + phase), dtype=torch.float32)

    def state_dict(self) -> dict:
        return {"generator": self.rng.bit_generator.state}

    def load_state_dict(self, state) -> None:
        self.rng.bit_generator.state = state["generator"]


@pytest.mark.parametrize(
    "name, options",
    [("aclstm", {"u": 2, "v": 3, "noise": 0.05}), ("scheduled-sampling", {"probability": 0.4, "decay": "linear"})],
)
def test_systems_train_and_resume_to_the_same_weights(name, options, tmp_path):
    def trainer(path, **changed):
        system = make_system(name, 3, hidden=6, layers=2, seed=1, **{**options, **changed})
        return Trainer(system, Waves(), TrainingConfig(steps=12, learning_rate=1e-2), path=path)

    whole = trainer(None).run(progress=False)
    assert whole.history["loss"][-1] < whole.history["loss"][0]
    path = tmp_path / "run.safetensors"
    part = trainer(path)
    part.run(progress=False, max_seconds=0.0)
    assert part.step == 1
    with pytest.raises(TutorialError, match="started with"):
        trainer(path, **({"u": 3} if name == "aclstm" else {"probability": 0.5})).resume()
    resumed = trainer(path).resume().run(progress=False)
    for one, other in zip(whole.model.parameters(), resumed.model.parameters(), strict=True):
        assert torch.equal(one, other)
    checkpoint = load_checkpoint(path)
    assert checkpoint.system == name and {k: checkpoint.training[k] for k in options} == options


def test_options_of_systems():
    assert make_system("aclstm", 3, hidden=4).options == {"u": 5, "v": 5, "noise": 0.0}
    assert make_system("lstm", 3, hidden=4).options == {}
    with pytest.raises(TutorialError, match="'lstm' has no size 'u'; it has hidden, layers"):
        make_system("lstm", 3, u=5)
    with pytest.raises(TutorialError, match="'aclstm' has no size or option 'w'; it has hidden, layers, u, v, noise"):
        make_system("aclstm", 3, w=5)
    with pytest.raises(TutorialError, match=r"\(u=0, v=5\)"):
        make_system("aclstm", 3, u=0)
    with pytest.raises(TutorialError, match="between 0 and 1"):
        make_system("scheduled-sampling", 3, probability=2.0)
    same = [make_system(name, 3, hidden=4, seed=2).model.state_dict() for name in ("lstm", "aclstm")]
    assert all(torch.equal(same[0][k], same[1][k]) for k in same[0]), "the same network, from the same seed"


# --- streaming ------------------------------------------------------------------------------------


@pytest.mark.parametrize("batch", [1, 3])
def test_stream_makes_what_synthesis_makes(batch):
    model, seed = make(), random(batch, 6, 5)
    expected = synthesize(model, seed, 40)
    with torch.no_grad():
        y, state = model(seed)
        stream, frame, made = LSTMStream(model, state), y[:, -1], []
        for _ in range(40):
            made.append(frame)
            frame = stream.step(frame)
        whole = model(torch.cat([seed, expected], dim=1))[1]
    torch.testing.assert_close(torch.stack(made, dim=1), expected)
    torch.testing.assert_close(stream.state, whole)


def test_stream_keeps_its_own_memory():
    model = make()
    state = model(random(2, 6, 5))[1]
    kept = [part.clone() for part in state]
    frame = random(2, 5, seed=2)
    first = LSTMStream(model, state)
    out = first.step(frame)
    again = out.clone()
    first.step(out)
    assert torch.equal(out, again) and not out.requires_grad, "what was given out is not written over"
    assert all(torch.equal(a, b) for a, b in zip(kept, state, strict=True))
    assert torch.equal(LSTMStream(model, state).step(frame), out)


def test_stream_refuses_what_does_not_fit():
    model = make()
    state = model(random(2, 6, 5))[1]
    with pytest.raises(TutorialError, match=r"reads \(2, 5\) numbers, not \(1, 5\)"):
        LSTMStream(model, state).step(random(1, 5))
    with pytest.raises(TutorialError, match=r"remembers two times \(3, sequences, 4\)"):
        LSTMStream(model, make(5, 6).forward(random(2, 6, 5))[1])
    with pytest.raises(TutorialError, match="no fast stream for Adding"):
        LSTMStream(Adding(), state)
