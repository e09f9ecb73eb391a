"""The scan against the same inference written frame by frame with autograd: values and all gradients."""

from __future__ import annotations

import pytest
import torch

from tutorial_lib.models.latent_scan import scan
from tutorial_lib.models.stochastic_latent import BOUND, StochasticLatent, gaussian


def frame_by_frame(model: StochasticLatent, codes, summaries, noise):
    """Equations 8, 10 and 11 along windows, as the paper has them."""
    state, steps = model.start(len(codes)), []
    for t in range(codes.shape[1]):
        h, z, m = state[-1], codes[:, t], summaries[:, t]
        f_mean = f_log = f = noise[0][t]
        if model.n_future:
            f_mean, f_log = model.posterior_future(h, m)
            f = f_mean + (0.5 * f_log).exp() * noise[0][t]
        s_mean, s_log = model.posterior_current(h, z, m)
        s = s_mean + (0.5 * s_log).exp() * noise[1][t]
        state = model.transition(state, s, f)
        steps.append((h, f, s, f_mean, f_log, s_mean, s_log))
    return tuple(torch.stack(column, 1) for column in zip(*steps, strict=True))


@pytest.mark.parametrize(("future", "layers"), [(3, 2), (0, 2), (2, 1), (2, 3)])
def test_values_and_gradients_are_those_of_autograd(future, layers):
    torch.manual_seed(0)
    model = StochasticLatent(code=4, summary=3, current=2, future=future, hidden=5, layers=layers).double()
    codes, summaries = torch.randn(2, 6, 4).double(), torch.randn(2, 6, 3).double()
    noise = torch.randn(6, 2, future).double(), torch.randn(6, 2, 2).double()
    expected = frame_by_frame(model, codes, summaries, noise)
    made = scan(codes, summaries, noise, BOUND, model.future_posterior if future else None, model.current_posterior,
                model.cells)  # fmt: skip
    pull = [torch.randn_like(x) for x in expected]  # every output counts, each in its own way
    for a, b in zip(made, expected, strict=True):
        torch.testing.assert_close(a, b)
    parameters = [p for name, p in model.named_parameters() if "posterior" in name or "cells" in name]
    gradients = [
        torch.autograd.grad(sum((x * w).sum() for x, w in zip(outputs, pull, strict=True)), parameters,
                            allow_unused=True)
        for outputs in (made, expected)
    ]  # fmt: skip
    found = 0
    for a, b in zip(*gradients, strict=True):
        assert (a is None) == (b is None)
        if a is not None:
            torch.testing.assert_close(a, b, rtol=1e-8, atol=1e-10)
            found += bool(a.abs().max() > 0)
    assert found >= 6 * layers, "the gradients are not all nothing"


def test_log_variances_are_bounded_as_everywhere():
    wild = torch.tensor([[0.0, 1e4]])
    assert gaussian(wild).log_variance.item() == pytest.approx(BOUND)
    torch.manual_seed(0)
    model = StochasticLatent(code=4, summary=3, current=2, future=2, hidden=5)
    out = scan(1e6 * torch.randn(1, 3, 4), torch.randn(1, 3, 3), (torch.randn(3, 1, 2), torch.randn(3, 1, 2)), BOUND,
               model.future_posterior, model.current_posterior, model.cells)  # fmt: skip
    assert all(torch.isfinite(x).all() for x in out) and out[6].abs().max() <= BOUND


def test_nothing_is_kept_where_no_gradient_is_asked_for():
    torch.manual_seed(0)
    model = StochasticLatent(code=4, summary=3, current=2, future=2, hidden=5)
    with torch.no_grad():
        seen = model.infer(torch.randn(2, 5, 4), torch.randn(2, 5, 3), torch.Generator().manual_seed(1))
    assert not seen.past.requires_grad and seen.past.shape == (2, 5, 5) and not seen.past[:, 0].any()
