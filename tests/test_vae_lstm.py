"""The VAE-LSTM against its equations written out by hand, its probability against torch's own, its training."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from torch.distributions import Independent, Normal, kl_divergence
from torch.nn.functional import conv1d, pad

from tutorial_lib.errors import TutorialError
from tutorial_lib.models.vae_lstm import VAELSTM, Encoder, ModifiedCell, UpsampleConv, VAELSTMConfig
from tutorial_lib.models.variational import (
    gaussian_divergence,
    gaussian_negative_log_likelihood,
    gaussian_sample,
    mean_absolute_weight,
)
from tutorial_lib.training.systems import make_system
from tutorial_lib.training.variational_loss import VariationalLoss

SMALL = {"dim": 9, "control": (6, 9), "hidden": 8, "filters": 5, "kernel": 5}


def numbers(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def small(seed: int = 0, **values) -> VAELSTM:
    values = {**SMALL, **values}
    return make_system("vae-lstm", values.pop("dim"), seed=seed, **values).model.eval()


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def elu(x):
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


# --- probability ----------------------------------------------------------------------------------


def test_divergence_is_that_of_torchs_distributions():
    mean, log_variance, prior_mean, prior_log_variance = numbers(4, 3, 6, 5).double()
    q = Independent(Normal(mean, (log_variance / 2).exp()), 1)
    p = Independent(Normal(prior_mean, (prior_log_variance / 2).exp()), 1)
    unit = Independent(Normal(torch.zeros_like(mean), torch.ones_like(mean)), 1)
    torch.testing.assert_close(gaussian_divergence(mean, log_variance), kl_divergence(q, unit))
    torch.testing.assert_close(
        gaussian_divergence(mean, log_variance, prior_mean, prior_log_variance), kl_divergence(q, p)
    )
    assert (gaussian_divergence(torch.zeros(2, 5), torch.zeros(2, 5)) == 0).all()


def test_likelihood_is_that_of_torchs_normal_but_for_its_constant():
    x, mean = numbers(2, 3, 7, 4).double()
    wanted = -Normal(mean, 0.3).log_prob(x).flatten(1).sum(1)
    constant = 7 * 4 * np.log(0.3 * np.sqrt(2 * np.pi))
    torch.testing.assert_close(gaussian_negative_log_likelihood(x, mean, 0.3) + constant, wanted)


def test_samples_have_the_mean_and_the_deviation_and_let_gradients_through():
    mean = torch.tensor([1.0, -2.0]).expand(20_000, 2).clone().requires_grad_()
    log_variance = torch.tensor([0.0, -3.0]).expand(20_000, 2).clone().requires_grad_()
    generator = torch.Generator().manual_seed(0)
    z = gaussian_sample(mean, log_variance, generator)
    assert z.mean(0).tolist() == pytest.approx([1, -2], abs=0.03)
    assert z.std(0).tolist() == pytest.approx([1, np.exp(-1.5)], rel=0.02)
    z.sum().backward()
    assert (mean.grad == 1).all()  # dz / dmean = 1, dz / dlog_variance = (z - mean) / 2
    torch.testing.assert_close(log_variance.grad, ((z - mean) / 2).detach())
    again = gaussian_sample(mean, log_variance, torch.Generator().manual_seed(0))
    assert torch.equal(z, again)


def test_mean_absolute_weight_counts_weights_and_no_biases():
    model = torch.nn.Sequential(torch.nn.Linear(2, 1), torch.nn.Linear(1, 1))
    with torch.no_grad():
        for p, value in zip(model.parameters(), (3.0, 100.0, -6.0, 100.0), strict=True):
            p.fill_(value)
    assert mean_absolute_weight(model).item() == pytest.approx((3 + 3 + 6) / 3)


# --- the cell, in its two modes -------------------------------------------------------------------


def step_by_hand(w: dict[str, np.ndarray], state: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Equations 7, 8 and 9."""
    gates = state @ w["gates_state.weight"].T + w["gates_state.bias"]
    gates = gates + h @ w["gates_control.weight"].T + w["gates_control.bias"]
    i, f = np.split(sigmoid(gates), 2, axis=-1)
    return elu(f * (state @ w["state.weight"].T) + i * (h @ w["control.weight"].T))


@pytest.fixture
def cell():
    torch.manual_seed(3)  # a test may
    made = ModifiedCell(6)
    return made, {name: p.detach().numpy().astype(np.float64) for name, p in made.named_parameters()}


def test_in_training_the_cell_reads_the_code_of_the_step(cell):
    cell, w = cell
    code, h = numbers(2, 3, 7, 6)
    with torch.no_grad():
        canvas = cell(code, h)
    wanted = [step_by_hand(w, code[:, t].double().numpy(), h[:, t].double().numpy()) for t in range(7)]
    np.testing.assert_allclose(canvas.numpy(), np.stack(wanted, 1), atol=1e-6)


def test_at_synthesis_the_cell_reads_its_state_before(cell):
    cell, w = cell
    state, h = numbers(3, 6).double().numpy(), numbers(3, 7, 6, seed=1)
    wanted = []
    with torch.no_grad():
        canvas = cell.run(torch.from_numpy(state).float(), h)
    for t in range(7):
        state = step_by_hand(w, state, h[:, t].double().numpy())
        wanted.append(state)
    np.testing.assert_allclose(canvas.numpy(), np.stack(wanted, 1), atol=1e-6)


def test_the_modes_agree_on_the_first_step_and_differ_after_it():
    model = small()
    code, control = numbers(2, 5, 8), numbers(2, 20, 3, seed=1)
    with torch.no_grad():
        h = model.encode_control(control)
        training, _ = model.run(h, code)
        synthesis, state = model.run(h, code[:, 0])
    torch.testing.assert_close(training[:, 0], synthesis[:, 0])
    assert (training[:, 1:] - synthesis[:, 1:]).abs().amax() > 1e-3
    assert torch.equal(state, synthesis[:, -1])


# --- shapes, sizes --------------------------------------------------------------------------------


def test_the_papers_sizes_are_the_default():
    config = VAELSTMConfig(66, (63, 66))
    with torch.device("meta"):
        model = VAELSTM(config)
    shapes = {n: tuple(p.shape) for n, p in model.named_parameters() if n.endswith("weight") and p.ndim == 3}
    assert shapes == {
        "control_encoder.first.weight": (64, 3, 25),
        "control_encoder.second.weight": (128, 64, 25),
        "inference.first.weight": (64, 63, 25),
        "inference.second.weight": (256, 64, 25),
        "decoder.first.weight": (128, 128, 25),
        "decoder.second.weight": (66, 128, 25),
    }
    x = torch.zeros(1, 240, 66, device="meta")
    mean, log_variance = model.infer(x[..., :63])
    assert mean.shape == log_variance.shape == model.encode_control(x[..., 63:]).shape == (1, 60, 128)


@pytest.mark.parametrize("values", [{}, {"cell": "ordinary"}, {"latent": "one"}, {"pooling": 3, "kernel": 7},
                                    {"cell": "ordinary", "latent": "one"}])  # fmt: skip
def test_what_goes_in_comes_out(values):
    model = small(**values)
    stride = model.config.stride
    for steps in (1, 2, 5):
        x = numbers(2, steps * stride, 9)
        made = model(x, torch.Generator().manual_seed(0))
        codes = 1 if values.get("latent") == "one" else steps
        assert made.frames.shape == x.shape and made.mean.shape == made.log_variance.shape == (2, codes, 8)
        for code in (numbers(2, 8), numbers(2, steps, 8)):
            assert model.synthesize(x[..., 6:], code).shape == x.shape


def test_control_channels_may_lie_anywhere():
    x = torch.arange(9.0).expand(1, 4, 9)
    pose, control = small(control=(2, 5)).split(x)
    assert pose[0, 0].tolist() == [0, 1, 5, 6, 7, 8] and control[0, 0].tolist() == [2, 3, 4]


def test_encoder_is_equation_6():
    """Convolution, activation, max-pooling, twice; a convolution keeps the length."""
    torch.manual_seed(0)
    encoder = Encoder(3, 4, VAELSTMConfig(**SMALL)).eval()
    x = numbers(2, 12, 3)
    with torch.no_grad():
        y = x.transpose(1, 2)
        for layer in (encoder.first, encoder.second):
            y = conv1d(pad(y, (2, 2), mode="replicate"), layer.weight, layer.bias)
            y = torch.from_numpy(elu(y.numpy())).unflatten(-1, (-1, 2)).amax(-1)
        torch.testing.assert_close(encoder(x), y.transpose(1, 2))


@pytest.mark.parametrize("kernel, factor", [(25, 2), (5, 2), (7, 3), (1, 2), (9, 1), (3, 4)])
def test_upsampling_convolution_is_repeating_and_convolving(kernel, factor):
    torch.manual_seed(0)
    layer, x = UpsampleConv(3, 4, kernel, factor).double(), numbers(2, 3, 11).double()
    repeated = pad(x.repeat_interleave(factor, -1), (kernel // 2, kernel // 2), mode="replicate")
    torch.testing.assert_close(layer(x), conv1d(repeated, layer.weight, layer.bias))


def test_what_a_layer_keeps_goes_when_its_weights_change():
    """In evaluation sums of weights are kept; a fused optimiser's step does not count a tensor's version up."""
    torch.manual_seed(0)
    layer, x = UpsampleConv(3, 4, 5, 2), numbers(2, 3, 11)
    optimizer = torch.optim.Adam(layer.parameters(), 0.1, fused=True)

    def check():
        repeated = pad(x.repeat_interleave(2, -1), (2, 2), mode="replicate")
        with torch.no_grad():
            torch.testing.assert_close(layer(x), conv1d(repeated, layer.weight, layer.bias))

    for change in range(6):
        layer.eval()
        check()
        check()
        if change % 3 == 0:  # as the trainer does
            layer.train()
            layer(x).sum().backward()
            check()
            optimizer.step()
        elif change % 3 == 1:  # in evaluation
            layer(x).sum().backward()
            optimizer.step()
        else:
            layer.load_state_dict({name: value + 1 for name, value in layer.state_dict().items()})
            check()


@pytest.mark.parametrize("values, told", [
    ({"dim": 0}, "dim must be a whole number of 1 or more"),
    ({"hidden": 2.0}, "hidden must be a whole number"),
    ({"kernel": 4}, "kernel must be odd"),
    ({"pooling": 0}, "pooling must be a whole number"),
    ({"dropout": 1}, "dropout must be a share of 0 or more below 1"),
    ({"dropout": float("nan")}, "dropout must be a share"),
    ({"cell": "gru"}, "unknown cell 'gru': expected one of modified, ordinary"),
    ({"latent": "two"}, "unknown latent 'two': expected one of per-step, one"),
    ({"control": (6, 10)}, "control channels 6 to 9 of 9"),
    ({"control": (0, 9)}, "expected some of them, not all"),
    ({"control": 3}, "control is the pair"),
])  # fmt: skip
def test_impossible_sizes_are_refused(values, told):
    with pytest.raises(TutorialError, match=told):
        VAELSTMConfig(**{**SMALL, **values})


def test_sequences_that_do_not_fit_are_told_with_both_sides():
    model = small()
    with pytest.raises(TutorialError, match=r"features of shape \(2, 8, 7\), expected \(sequences, frames, 9\)"):
        model(torch.zeros(2, 8, 7))
    with pytest.raises(TutorialError, match="features of 10 frames, expected a multiple of 4"):
        model(torch.zeros(2, 10, 9))
    with pytest.raises(TutorialError, match="poses of 0 frames"):
        model.infer(torch.zeros(2, 0, 6))
    with pytest.raises(TutorialError, match=r"control of shape \(8, 3\)"):
        model.encode_control(torch.zeros(8, 3))


# --- training -------------------------------------------------------------------------------------


def test_loss_is_the_bound_and_l1():
    model, x = small(), numbers(3, 12, 9)
    loss, terms = VariationalLoss(deviation=0.5, l1=0.2)(model, x, torch.Generator().manual_seed(1))
    made = model(x, torch.Generator().manual_seed(1))
    q = Normal(made.mean, (made.log_variance / 2).exp())
    divergence = kl_divergence(q, Normal(0.0, 1.0)).sum((1, 2)).mean()  # the *sum* over steps, (4)
    squares = (x - made.frames).square().sum((1, 2)).mean()
    wanted = (divergence + squares / (2 * 0.5**2)) / (12 * 9) + 0.2 * mean_absolute_weight(model)
    torch.testing.assert_close(loss, wanted)
    torch.testing.assert_close(terms["divergence"], divergence)
    torch.testing.assert_close(terms["error"], (x - made.frames).square().mean())


@pytest.mark.parametrize("values", [{}, {"cell": "ordinary"}, {"latent": "one"}])
def test_every_weight_gets_a_gradient(values):
    system = make_system("vae-lstm", seed=1, **{**SMALL, **values})
    system.model.train()
    loss, _ = system.loss(system.model, numbers(4, 16, 9), torch.Generator().manual_seed(0))
    loss.backward()
    for name, p in system.model.named_parameters():
        assert p.grad is not None and p.grad.abs().sum() > 0, name


def test_the_code_gets_its_gradient_from_the_frames_alone():
    """Without the divergence the inference network still learns: through the code, and only through it."""
    model, x = small(), numbers(4, 16, 9)
    frames = model(x, torch.Generator().manual_seed(0)).frames
    frames.square().mean().backward()
    assert model.inference.first.weight.grad.abs().sum() > 0
    with torch.no_grad():
        h, code = model.encode_control(x[..., 6:]), numbers(4, 4, 8)
        assert not torch.allclose(model.run(h, code)[0], model.run(h, code + 1)[0])


def test_dropout_is_for_training_alone():
    model, x = small(dropout=0.5), numbers(2, 16, 9)
    h = model.encode_control(x[..., 6:])
    assert torch.equal(h, model.encode_control(x[..., 6:]))
    model.train()
    assert not torch.equal(h, model.encode_control(x[..., 6:]))


def test_it_learns_a_motion_that_control_tells():
    """Poses that are a function of the control: the error falls far below the poses' own variance."""
    system = make_system("vae-lstm", seed=0, **{**SMALL, "hidden": 16, "dropout": 0.0})
    model, optimizer = system.model.train(), torch.optim.Adam(system.model.parameters(), 1e-2)
    generator = torch.Generator().manual_seed(0)
    t = torch.arange(32.0) / 5

    def batch() -> torch.Tensor:
        phase = 6.3 * torch.rand(16, 1, generator=generator) + t
        control = torch.stack((phase.sin(), phase.cos(), phase.sin()), -1)
        return torch.cat((control, -control, control), -1)

    for _ in range(60):
        loss, _ = system.loss(model, batch(), generator)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    model.eval()
    x = batch()
    with torch.no_grad():
        made = model.synthesize(x[..., 6:], torch.randn(16, 16, generator=generator))
    assert (made - x).square().mean() < 0.15 * x.square().mean()


def test_what_the_loss_cannot_be():
    for options in ({"deviation": 0}, {"deviation": float("inf")}, {"deviation": True}):
        with pytest.raises(TutorialError, match="standard deviation above 0"):
            VariationalLoss(**options)
    with pytest.raises(TutorialError, match="l1 is a weight of 0 or more"):
        VariationalLoss(l1=-1)
    with pytest.raises(TutorialError, match="must be told its control channels"):
        make_system("vae-lstm", 66)
    with pytest.raises(TutorialError, match="no size or option 'layers'; it has control, hidden, .*deviation"):
        make_system("vae-lstm", 66, control=(63, 66), layers=2)


def test_configuration_comes_back_from_json():
    config = VAELSTMConfig(**SMALL)
    assert VAELSTMConfig(**{**dataclasses.asdict(config), "control": [6, 9]}) == config


@pytest.mark.parametrize("latent", ["per-step", "one"])
def test_the_posterior_is_the_inference_network_without_a_last_activation(latent):
    """A mean may lie anywhere; one code for the whole motion is told by all of its steps."""
    model, pose = small(latent=latent), numbers(2, 12, 6)
    with torch.no_grad():
        mean, log_variance = model.infer(3 * pose)
        y, net = 3 * pose.transpose(1, 2), model.inference
        y = conv1d(pad(y, (2, 2), mode="replicate"), net.first.weight, net.first.bias)
        y = torch.from_numpy(elu(y.numpy())).unflatten(-1, (-1, 2)).amax(-1)
        y = conv1d(pad(y, (2, 2), mode="replicate"), net.second.weight, net.second.bias)
        y = y.unflatten(-1, (-1, 2)).amax(-1).transpose(1, 2)  # (2, 3, 16)
        y = y.mean(1, keepdim=True) if latent == "one" else y
        torch.testing.assert_close(torch.cat((mean, log_variance), -1), y)
        net.second.bias.fill_(-100.0)
        mean, log_variance = model.infer(pose)
    assert mean.max() < -50 and (log_variance == -12).all(), "a deviation is not below 0.0025"


def test_dropout_leaves_out_the_share_that_it_is_told():
    """Without pooling, and a frame at a time, a number that is left out is one that has no gradient."""
    torch.manual_seed(0)
    encoder = Encoder(3, 4, VAELSTMConfig(**{**SMALL, "dropout": 0.4, "pooling": 1, "kernel": 1})).train()
    x = numbers(1, 3000, 3).requires_grad_()
    encoder(x).sum().backward()
    assert (x.grad == 0).double().mean().item() == pytest.approx(0.4, abs=0.02)
