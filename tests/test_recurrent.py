"""The networks against their equations, written out by hand, and their losses."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tutorial_lib.errors import TutorialError
from tutorial_lib.generate import synthesize
from tutorial_lib.models.recurrent import ERD, LSTM3LR, ERDConfig, LSTM3LRConfig, Seq2SeqConfig
from tutorial_lib.training.conditioning import seed_only
from tutorial_lib.training.rollout import rollout
from tutorial_lib.training.systems import (
    SYSTEMS,
    AutoConditionedLoss,
    NoisyInputLoss,
    Seq2SeqLoss,
    make_system,
    next_frame_loss,
    system_kind,
)

PREDICTING = [name for name, kind in SYSTEMS.items() if kind.predicts]


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def by_hand(model: LSTM3LR, x: np.ndarray) -> np.ndarray:
    """The equations of an LSTM, a frame and a layer at a time; layer l reads layer l - 1's output of this step."""
    w = {name: p.detach().numpy().astype(np.float64) for name, p in model.named_parameters()}
    layers, hidden = model.config.layers, model.config.hidden
    h, c = np.zeros((2, layers, len(x), hidden))
    out = []
    for t in range(x.shape[1]):
        below = x[:, t]
        for k in range(layers):
            gates = below @ w[f"lstm.weight_ih_l{k}"].T + h[k] @ w[f"lstm.weight_hh_l{k}"].T
            gates = gates + w[f"lstm.bias_ih_l{k}"] + w[f"lstm.bias_hh_l{k}"]
            i, f, g, o = np.split(gates, 4, axis=1)
            c[k] = sigmoid(f) * c[k] + sigmoid(i) * np.tanh(g)
            h[k] = sigmoid(o) * np.tanh(c[k])
            below = h[k]
        out.append(below @ w["readout.weight"].T + w["readout.bias"])
    return np.stack(out, axis=1)


@pytest.fixture
def model() -> LSTM3LR:
    return make_system("lstm", 5, hidden=4, layers=3, seed=3).model


def test_forward_is_the_equations_with_ordinary_stacking(model):
    x = torch.randn(2, 6, 5, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        y, (h, c) = model(x)
    assert y.shape == (2, 6, 5) and h.shape == c.shape == (3, 2, 4)
    np.testing.assert_allclose(y.numpy(), by_hand(model, x.numpy().astype(np.float64)), atol=1e-6)


def test_the_first_output_depends_on_the_first_frame(model):
    """In the published code layers read the step before, so that a frame needs three steps to come through."""
    x = torch.zeros(1, 1, 5)
    with torch.no_grad():
        assert not torch.allclose(model(x)[0], model(x + 1)[0])


def test_state_carries_the_memory_on(model):
    x = torch.randn(3, 9, 5, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        whole, _ = model(x)
        first, state = model(x[:, :4])
        rest, _ = model(x[:, 4:], state)
    torch.testing.assert_close(torch.cat([first, rest], dim=1), whole)


def test_paper_sizes_are_the_default_and_parameter_names_are_torchs():
    assert LSTM3LRConfig(dim=171) == LSTM3LRConfig(171, hidden=1024, layers=3)
    with torch.device("meta"):
        model = LSTM3LR(LSTM3LRConfig(171))
    names = dict(model.named_parameters())
    assert names["lstm.weight_ih_l0"].shape == (4096, 171) and names["lstm.weight_hh_l2"].shape == (4096, 1024)
    assert sum(p.numel() for p in model.parameters()) == 4096 * (171 + 5 * 1024 + 3 * 2) + 171 * 1025


@pytest.mark.parametrize("sizes", [{"dim": 0}, {"dim": 3, "hidden": -1}, {"dim": 3, "layers": 1.5}])
def test_impossible_sizes_are_refused(sizes):
    with pytest.raises(TutorialError, match="whole number of 1 or more"):
        LSTM3LRConfig(**sizes)


class Repeats(torch.nn.Module):
    """A network that repeats what it is given."""

    def forward(self, x, state=None):
        return x, state


def test_loss_is_the_squared_distance_to_the_next_frame():
    """Equation 1 on numbers small enough to do in the head."""
    repeats = Repeats()
    batch = torch.tensor([[[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]]])
    assert next_frame_loss(repeats, batch).item() == (25 + 1) / 2  # summed over numbers, averaged over steps
    two = torch.cat([batch, torch.zeros_like(batch)])
    assert next_frame_loss(repeats, two).item() == (25 + 1) / 4  # and over sequences


def test_weights_come_from_the_seed_and_the_global_generator_stays():
    torch.manual_seed(5)  # a test may; the library may not
    before = torch.get_rng_state()
    one, again, other = (make_system("lstm", 3, hidden=4, seed=s).model.state_dict() for s in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    assert all(torch.equal(one[name], again[name]) for name in one)
    assert not torch.equal(one["readout.weight"], other["readout.weight"])


def test_unknown_systems_and_sizes_are_told_with_what_there_is():
    with pytest.raises(TutorialError, match="did you mean lstm"):
        system_kind("lsmt")
    with pytest.raises(TutorialError, match="has no size 'width'; it has hidden, layers"):
        make_system("lstm", 3, width=4)


# --- ERD ------------------------------------------------------------------------------------------


def random_frames(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_erd_is_its_layers_one_after_the_other():
    """Encoder, cells and decoder written out in numpy, a frame at a time."""
    model = make_system("erd", 5, hidden=6, layers=2, seed=4).model
    w = {name: p.detach().numpy().astype(np.float64) for name, p in model.named_parameters()}
    x = random_frames(2, 7, 5)

    def linear(name: str, values: np.ndarray) -> np.ndarray:
        return values @ w[f"{name}.weight"].T + w[f"{name}.bias"]

    h, c = np.zeros((2, 2, 2, 6))
    wanted = []
    for t in range(7):
        below = np.maximum(0, linear("encoder.0", x[:, t].numpy().astype(np.float64)))
        below = np.maximum(0, linear("encoder.1", below))
        assert below.shape == (2, 3)
        for k in range(2):
            gates = below @ w[f"lstm.weight_ih_l{k}"].T + h[k] @ w[f"lstm.weight_hh_l{k}"].T
            i, f, g, o = np.split(gates + w[f"lstm.bias_ih_l{k}"] + w[f"lstm.bias_hh_l{k}"], 4, axis=1)
            c[k] = sigmoid(f) * c[k] + sigmoid(i) * np.tanh(g)
            h[k] = sigmoid(o) * np.tanh(c[k])
            below = h[k]
        below = np.maximum(0, linear("decoder.0", below))
        wanted.append(linear("decoder.2", np.maximum(0, linear("decoder.1", below))))
    with torch.no_grad():
        y, state = model(x)
    np.testing.assert_allclose(y.numpy(), np.stack(wanted, axis=1), atol=1e-6)
    np.testing.assert_allclose(state[0].numpy(), h, atol=1e-6)
    np.testing.assert_allclose(state[1].numpy(), c, atol=1e-6)


def test_erd_has_the_papers_sizes_by_default():
    with torch.device("meta"):
        model = ERD(ERDConfig(171))
    shapes = [tuple(layer.weight.shape) for layer in (*model.encoder, *model.decoder)]
    assert shapes == [(500, 171), (500, 500), (500, 1000), (100, 500), (171, 100)]
    assert model.lstm.weight_ih_l0.shape == (4000, 500) and model.lstm.num_layers == 2
    assert (ERDConfig(171, 128).wide, ERDConfig(171, 128).narrow) == (64, 64)


def test_noise_rises_from_none_to_the_deviation_asked_for():
    """A network that repeats what it is given: with targets equal to the frames, the loss is the noise itself."""
    model = Repeats()
    batch = torch.zeros(64, 101, 20)
    loss = NoisyInputLoss(noise=0.3)
    rng = torch.Generator().manual_seed(0)
    assert loss(model, batch, rng, 0.0).item() == 0
    for progress in (0.5, 1.0):
        expected = 20 * (0.3 * progress) ** 2  # summed over 20 numbers a frame
        assert loss(model, batch, rng, progress).item() == pytest.approx(expected, rel=0.02)
    before = rng.get_state()
    assert NoisyInputLoss()(model, batch + 1, rng, 1.0).item() == 0 and torch.equal(rng.get_state(), before)


def test_noise_of_auto_conditioning_is_on_the_truth_that_is_fed_alone():
    """The network repeats: what it puts out at first is the noise on the truth, and of its own nothing is added."""
    seen = []

    class Notes(Repeats):
        def forward(self, x, state=None):
            seen.append(x)
            return super().forward(x, state)

    batch = torch.zeros(500, 5, 20)
    loss = AutoConditionedLoss(u=1, v=3, noise=0.3)(Notes(), batch, torch.Generator().manual_seed(0), 0.0)
    assert loss.item() == pytest.approx(20 * 0.3**2, rel=0.03)
    assert all(torch.equal(frame, seen[0]) for frame in seen[1:4])
    again = AutoConditionedLoss(u=1, v=3, noise=0.3)(Repeats(), batch, torch.Generator().manual_seed(0), 0.0)
    assert again.item() == loss.item() and AutoConditionedLoss(u=1, v=3)(Repeats(), batch).item() == 0


def test_targets_stay_clean():
    seen = []

    class Watches(Repeats):
        def forward(self, x, state=None):
            seen.append(x)
            return torch.full_like(x, 2.0), None

    loss = NoisyInputLoss(noise=1.0)(Watches(), torch.full((3, 5, 4), 2.0), torch.Generator().manual_seed(0), 1.0)
    assert loss.item() == 0 and seen[0].std() > 0.5


# --- seq2seq --------------------------------------------------------------------------------------


def test_seq2seq_is_a_gru_cell_and_a_residual():
    model = make_system("seq2seq", 5, hidden=6, layers=2, seed=4).model
    cells = [torch.nn.GRUCell(5, 6), torch.nn.GRUCell(6, 6)]
    for k, cell in enumerate(cells):
        cell.load_state_dict({
            f"{kind}_{part}": getattr(model.gru, f"{kind}_{part}_l{k}")
            for kind in ("weight", "bias") for part in ("ih", "hh")
        })  # fmt: skip
    x, wanted, h = random_frames(2, 7, 5), [], [torch.zeros(2, 6), torch.zeros(2, 6)]
    with torch.no_grad():
        for t in range(7):
            below = x[:, t]
            for k, cell in enumerate(cells):
                below = h[k] = cell(below, h[k])
            wanted.append(x[:, t] + below @ model.readout.weight.T + model.readout.bias)
        y, state = model(x)
    torch.testing.assert_close(y, torch.stack(wanted, dim=1))
    torch.testing.assert_close(state, torch.stack(h))


def test_a_new_seq2seq_nearly_repeats_the_last_frame():
    x = random_frames(4, 20, 30)
    with torch.no_grad():
        y, _ = make_system("seq2seq", 30, hidden=32).model(x)
    assert 0 < (y - x).norm() < 0.05 * x.norm()


@pytest.mark.parametrize("n_seed, n_future", [(1, 1), (3, 2), (5, 4)])
def test_seq2seq_loss_is_on_the_frames_after_the_seed(n_seed, n_future):
    """By hand: read the seed, then each own output; frames past the future and errors on the seed do not count."""
    model = make_system("seq2seq", 4, hidden=5, seed=1).model.double()
    batch = random_frames(3, 12, 4).double()
    with torch.no_grad():
        y, state = model(batch[:, :n_seed])
        frame, total = y[:, -1:], 0.0
        for k in range(n_future):
            total += (frame[:, 0] - batch[:, n_seed + k]).square().sum(dim=-1).mean().item() / n_future
            frame, state = model(frame, state)
        loss = Seq2SeqLoss(n_seed, n_future)
        assert loss(model, batch).item() == pytest.approx(total, rel=1e-9)
        later = batch.clone()
        later[:, n_seed + n_future :] = 1e6
        assert loss(model, later).item() == loss(model, batch).item()


def test_seq2seq_of_a_network_that_repeats():
    batch = torch.arange(5.0)[None, :, None]  # 0 1 2 3 4: after the seed 0 1 it says 1, 1
    assert Seq2SeqLoss(2, 2)(Repeats(), batch).item() == (1**2 + 2**2) / 2


def test_too_short_windows_and_wrong_options_are_told():
    with pytest.raises(TutorialError, match=r"75 frames \(n_seed 50 \+ n_future 25\), these have 74"):
        Seq2SeqLoss()(Repeats(), torch.zeros(1, 74, 2))
    for options in ({"n_seed": 0}, {"n_future": 0}, {"n_seed": 2.0}):
        with pytest.raises(TutorialError, match="whole number of 1 or more"):
            make_system("seq2seq", 3, **options)
    for noise in (-0.1, float("inf"), float("nan"), "much", True):
        with pytest.raises(TutorialError, match="standard deviation of 0 or more"):
            make_system("erd", 3, noise=noise)
        with pytest.raises(TutorialError, match="standard deviation of 0 or more"):
            make_system("aclstm", 3, noise=noise)
    with pytest.raises(TutorialError, match="Seq2Seq: hidden must be a whole number"):
        Seq2SeqConfig(3, hidden=0)
    with pytest.raises(TutorialError, match="ERD: layers must be a whole number"):
        ERDConfig(3, layers=0)


# --- all networks ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PREDICTING)
def test_a_whole_sequence_is_the_same_as_a_frame_at_a_time(name):
    model = make_system(name, 5, hidden=6, seed=2).model
    x = random_frames(3, 9, 5, seed=1)
    with torch.no_grad():
        whole, last = model(x)
        state, frames = None, []
        for t in range(9):
            y, state = model(x[:, t : t + 1], state)
            frames.append(y)
        torch.testing.assert_close(torch.cat(frames, dim=1), whole)
        torch.testing.assert_close(state, last)
        first, state = model(x[:, :4])
        rest, _ = model(x[:, 4:], state)
        torch.testing.assert_close(torch.cat([first, rest], dim=1), whole)


@pytest.mark.parametrize("name", PREDICTING)
def test_rollout_is_synthesis_for_every_network(name):
    """The engine under "truth for the seed, then never" and generation give the same frames."""
    model = make_system(name, 5, hidden=6, seed=2).model
    seed = random_frames(3, 4, 5, seed=1)
    x = torch.cat([seed, torch.full((3, 5, 5), 9.0)], dim=1)
    with torch.no_grad():
        y, _ = rollout(model, x, seed_only(9, 4))
    torch.testing.assert_close(synthesize(model, seed, 6), y[:, 3:])
