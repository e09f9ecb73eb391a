"""The three-layer LSTM against its equations, written out by hand, and its loss."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tutorial_lib.errors import TutorialError
from tutorial_lib.models.recurrent import LSTM3LR, LSTM3LRConfig
from tutorial_lib.training.systems import make_system, next_frame_loss, system_kind


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


def test_loss_is_the_squared_distance_to_the_next_frame():
    """Equation 1 on numbers small enough to do in the head: a network that repeats what it is given."""

    def repeats(x):
        return x, None

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
