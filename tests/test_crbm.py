"""The conditional restricted Boltzmann machine against sums over all of its hidden states, and CD-k against numpy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from tutorial_lib.errors import TutorialError
from tutorial_lib.generate import synthesize
from tutorial_lib.models.crbm import CRBM, CRBMConfig
from tutorial_lib.recipes import Recipe, sets_of, trainer_for
from tutorial_lib.training.checkpoints import load_checkpoint
from tutorial_lib.training.contrastive_divergence import ContrastiveDivergence
from tutorial_lib.training.systems import System, make_system
from tutorial_lib.training.trainer import Trainer, TrainingConfig

D, HIDDEN, PAST = 3, 5, 2


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.fixture
def model() -> CRBM:
    """Large weights, so that no term of the energy is lost beside another."""
    model = CRBM(CRBMConfig(D, HIDDEN, PAST, gibbs=4)).double()
    with torch.no_grad():
        for k, parameter in enumerate(model.parameters()):
            parameter.copy_(0.7 * random(*parameter.shape, seed=k + 10))
    return model


def numbers(model: CRBM) -> dict[str, np.ndarray]:
    """The paper's names: W (hidden, D), A (D, N D), c0, B (hidden, N D), b0."""
    names = {"weight": "W", "visible.weight": "A", "visible.bias": "c0", "latent.weight": "B", "latent.bias": "b0"}
    return {names[name]: p.detach().numpy() for name, p in model.named_parameters()}


def energy(w: dict[str, np.ndarray], v: np.ndarray, h: np.ndarray, u: np.ndarray) -> float:
    c, b = w["c0"] + w["A"] @ u, w["b0"] + w["B"] @ u
    return float(((v - c) ** 2).sum() / 2 - b @ h - h @ w["W"] @ v)


STATES = [np.array(h, dtype=float) for h in itertools.product((0, 1), repeat=HIDDEN)]


def test_the_free_energy_sums_over_all_hidden_states(model):
    w, v, past = numbers(model), random(4, D, seed=1), random(4, PAST, D, seed=2)
    found = model.free_energy(v, *model.dynamic_biases(past)).detach().numpy()
    for k in range(4):
        terms = [-energy(w, v[k].numpy(), h, past[k].numpy().ravel()) for h in STATES]
        assert found[k] == pytest.approx(-np.logaddexp.reduce(terms), rel=1e-12)


def test_its_gradient_is_the_energys_mean_over_the_hidden_states(model):
    w, v, past = numbers(model), random(D, seed=1), random(PAST, D, seed=2)
    model.free_energy(v, *model.dynamic_biases(past)).backward()
    v, u = v.numpy(), past.numpy().ravel()
    weights = np.array([np.exp(-energy(w, v, h, u)) for h in STATES])
    mean_h = sum(p * h for p, h in zip(weights / weights.sum(), STATES, strict=True))
    c = w["c0"] + w["A"] @ u
    expected = {
        "weight": -np.outer(mean_h, v), "visible.weight": -np.outer(v - c, u), "visible.bias": -(v - c),
        "latent.weight": -np.outer(mean_h, u), "latent.bias": -mean_h,
    }  # fmt: skip
    for name, parameter in model.named_parameters():
        np.testing.assert_allclose(parameter.grad.numpy(), expected[name], rtol=1e-10, atol=1e-12, err_msg=name)


def test_both_conditionals_are_the_energys(model):
    w, v, past = numbers(model), random(D, seed=1), random(PAST, D, seed=2)
    c, b = model.dynamic_biases(past)
    u = past.numpy().ravel()
    weights = np.array([np.exp(-energy(w, v.numpy(), h, u)) for h in STATES])
    marginal = (weights[:, None] * np.array(STATES)).sum(0) / weights.sum()
    np.testing.assert_allclose(model.p_hidden(v, b).detach().numpy(), marginal, rtol=1e-10)
    # a Gaussian's mean is where the energy is least: one mean-field step of a network whose hidden units are all on
    with torch.no_grad():
        model.latent.bias.fill_(1e3)
    c, b = model.dynamic_biases(past)
    mean = model.gibbs(v, c, b, 1, mean_field=True).numpy()
    w, on = numbers(model), np.ones(HIDDEN)
    for step in 0.1 * np.eye(D):
        rise = [energy(w, mean + s * step, on, u) - energy(w, mean, on, u) for s in (1, -1)]
        np.testing.assert_allclose(rise, 0.005, rtol=1e-6)  # 0.1^2 / 2: a standard deviation of 1


def cd_by_hand(w: dict[str, np.ndarray], batch: np.ndarray, k: int, draws: list[np.ndarray]):
    """-(positive - negative statistics) of every weight, one frame at a time; also the reconstruction error."""
    total = {name: np.zeros_like(value) for name, value in w.items()}
    error, count = 0.0, 0
    for i in range(len(batch)):
        for t in range(PAST, batch.shape[1]):
            v, u = batch[i, t], batch[i, t - PAST : t].ravel()
            c, b = w["c0"] + w["A"] @ u, w["b0"] + w["B"] @ u

            def p(v, b=b):
                return 1 / (1 + np.exp(-(b + w["W"] @ v)))

            x = v
            for step in range(k):
                h = (draws[step][i, t - PAST] < p(x)).astype(float)
                x = c + h @ w["W"]
            total["W"] -= np.outer(p(v), v) - np.outer(p(x), x)
            total["A"] -= np.outer(v - x, u)
            total["c0"] -= v - x
            total["B"] -= np.outer(p(v) - p(x), u)
            total["b0"] -= p(v) - p(x)
            error, count = error + ((v - x) ** 2).sum(), count + 1
    return {name: value / count for name, value in total.items()}, error / count


@pytest.mark.parametrize("k", [1, 3])
def test_the_losss_gradient_is_contrastive_divergence(model, k):
    batch = random(4, 7, D, seed=3)
    loss, terms = ContrastiveDivergence(cd=k)(model, batch, torch.Generator().manual_seed(5))
    loss.backward()
    rng = torch.Generator().manual_seed(5)
    draws = [torch.rand(4, 7 - PAST, HIDDEN, generator=rng).numpy() for _ in range(k)]
    expected, error = cd_by_hand(numbers(model), batch.numpy(), k, draws)
    found = [parameter.grad.numpy() for parameter in model.parameters()]
    for name, gradient in zip(numbers(model), found, strict=True):
        np.testing.assert_allclose(gradient, expected[name], rtol=1e-9, atol=1e-12, err_msg=name)
    assert terms["reconstruction"].item() == pytest.approx(error, rel=1e-9)


# --- as a network ---------------------------------------------------------------------------------


def test_a_frame_takes_gibbs_steps_from_the_last_one(model):
    """One hidden state is drawn in each of the first three steps, probabilities are taken in the fourth."""
    x, w = random(1, 3, D, seed=4), numbers(model)
    y, state = model(x, model.start(3))
    outcomes = []
    for t in range(3):
        seen = np.concatenate([np.repeat(x[0, :1].numpy(), PAST, 0), x[0].numpy()])[t + 1 : t + 1 + PAST]
        u = seen.ravel()
        c, b = w["c0"] + w["A"] @ u, w["b0"] + w["B"] @ u
        # what four steps from the last frame can give: the last one averages from one of the states before it
        possible = [c + 1 / (1 + np.exp(-(b + w["W"] @ (c + h @ w["W"])))) @ w["W"] for h in STATES]
        outcomes.append(min(np.abs(y[0, t].numpy() - p).max() for p in possible))
    assert max(outcomes) < 1e-10
    np.testing.assert_array_equal(state.frames[0].numpy(), x[0, -PAST:].numpy())


@pytest.fixture
def undecided(model) -> CRBM:
    """Small weights: its hidden units are as often on as off, and it runs away to nowhere."""
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.mul_(0.3)
    return model


def test_a_state_is_a_value_and_its_seed_says_what_is_drawn(undecided):
    model = undecided
    x, before = random(6, 4, D, seed=4), torch.get_rng_state()
    y, state = model(x, model.start(3))
    again, _ = model(x, model.start(3))
    other, _ = model(x, model.start(4))
    assert torch.equal(y, again) and not torch.equal(y, other) and not y.requires_grad
    assert torch.equal(model(x)[0], model(x, model.start(0))[0])
    first, second = (model(x[:, :1], state)[0] for _ in range(2))
    assert torch.equal(first, second)
    assert torch.equal(before, torch.get_rng_state())
    state = model.start(3)
    for t in range(4):  # a frame at a time the draws are the same
        frame, state = model(x[:, t : t + 1], state)
        torch.testing.assert_close(frame[:, 0], y[:, t])
    same = model(x[:1].expand(200, -1, -1), model.start(1))[0][:, -1]
    assert len(torch.unique(same.round(decimals=6), dim=0)) > 5  # sequences of a batch draw each for itself
    later = [model(x[:1], state._replace(frames=None, step=step))[0][0, -1] for step in range(20)]
    assert len(torch.unique(torch.stack(later).round(decimals=6), dim=0)) > 2  # and each frame anew


def test_batches_of_one_and_many_are_synthesised(undecided):
    model = undecided
    for batch in (1, 50):
        seed = random(batch, 4, D, seed=6)
        made = synthesize(model, seed, 9, state=model.start(7))
        assert made.shape == (batch, 9, D) and torch.isfinite(made).all()
        assert torch.equal(made, synthesize(model, seed, 9, state=model.start(7)))
        assert not torch.equal(made, synthesize(model, seed, 9))


class Turning:
    """Batches of points that go round a circle at a sixth of a turn a frame, from anywhere on it."""

    def __init__(self):
        self.rng = torch.Generator().manual_seed(0)

    def sample(self) -> torch.Tensor:
        angle = 2 * np.pi * (torch.rand(64, 1, generator=self.rng) + torch.arange(12) / 6)
        return 2**0.5 * torch.stack([angle.cos(), angle.sin()], -1)

    def state_dict(self):
        return {}


@pytest.mark.parametrize("cd", [1, 5])
def test_it_learns_to_go_on(cd):
    system = make_system("crbm", 2, hidden=8, past=2, gibbs=10, cd=cd, seed=1)
    assert isinstance(system, System) and system.options == {"cd": cd, "past": 2, "gibbs": 10}
    trainer = Trainer(system, Turning(), TrainingConfig(steps=200, learning_rate=4e-2)).run(progress=False)
    reconstruction = trainer.history["reconstruction"]
    assert np.mean(reconstruction[-20:]) < 0.1 * np.mean(reconstruction[:20])
    x = Turning().sample()
    made = synthesize(system.model, x[:, :4], 6)
    error = (made - x[:, 4:10]).norm(dim=-1).mean(0)
    assert error[0] < 0.3 and error[-1] < 0.8  # the next point is 1.4 away, the opposite one 2.8


def test_a_recipe_says_what_it_is_made_of_and_the_checkpoint_too(tmp_path):
    recipe = Recipe(
        "crbm", "samples/walking", hidden=6, batch=4, length=12, steps=2, options={"cd": 2, "past": 4, "gibbs": 3}
    )
    assert recipe.representation == "hip-frame" and recipe.layers is None
    trainer_for(recipe, tmp_path / "c.safetensors", sets=sets_of(recipe)).run(progress=False)
    checkpoint = load_checkpoint(tmp_path / "c.safetensors")
    assert checkpoint.normalizer is not None and checkpoint.training["cd"] == 2
    assert checkpoint.config == {"dim": checkpoint.representation.dim, "hidden": 6, "past": 4, "gibbs": 3}


# --- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize("options, told", [
    ({"cd": 0}, "cd, the Gibbs steps of contrastive divergence, must be 1 or more, not 0"),
    ({"cd": True}, "must be 1 or more, not True"),
    ({"past": 0}, "CRBM: past must be a whole number of 1 or more, not 0"),
    ({"gibbs": 2.5}, "CRBM: gibbs must be a whole number of 1 or more, not 2.5"),
    ({"hidden": -1}, "CRBM: hidden must be"),
    ({"layers": 2}, "has no size or option 'layers'"),
])  # fmt: skip
def test_what_cannot_be(options, told):
    with pytest.raises(TutorialError, match=told):
        make_system("crbm", 3, **options)


def test_windows_too_short_and_seeds_that_are_none(model):
    with pytest.raises(TutorialError, match="conditioned on 2 frames reads windows of 3 or more, these have 2"):
        ContrastiveDivergence()(model, random(2, 2, D))
    with pytest.raises(TutorialError, match="needs windows of 31 frames"):
        Recipe("crbm", "samples/walking", length=30, options={"past": 30})
    with pytest.raises(TutorialError, match="the seed must be a whole number of 0 or more, not -1"):
        model.start(-1)


def test_it_begins_with_small_weights_and_without_biases():
    """As in the authors' code: 0.01 times a normal draw."""
    model = make_system("crbm", 40, hidden=50, seed=0).model
    for weight in (model.weight, model.visible.weight, model.latent.weight):
        assert weight.std().item() == pytest.approx(0.01, rel=0.1) and abs(weight.mean().item()) < 1e-3
    assert not model.visible.bias.any() and not model.latent.bias.any()


def test_the_next_seed_draws_other_numbers_not_the_same_a_frame_later(model):
    x = random(1, 1, D, seed=4).expand(1, 9, D)  # a figure that stands: nothing but chance tells the frames apart
    one, other = (model(x, model.start(seed))[0] for seed in (0, 1))
    assert not torch.allclose(one[:, 1:], other[:, :-1])
