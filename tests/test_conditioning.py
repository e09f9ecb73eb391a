"""Schedules against what the papers say of them, written out by hand."""

from __future__ import annotations

import math

import pytest
import torch

from tutorial_lib.errors import TutorialError
from tutorial_lib.training.conditioning import (
    DECAYS,
    WanderingNoise,
    auto_conditioning,
    scheduled_sampling,
    seed_only,
    teacher_forcing,
    truth_probability,
)


def drawn(schedule: torch.Tensor) -> str:
    return "".join("I" if fed else "o" for fed in schedule.tolist())


def test_auto_conditioning_repeats_from_the_start():
    assert drawn(auto_conditioning(18, 4, 4)) == "IIIIooooIIIIooooII"  # figure 1 of the paper
    assert drawn(auto_conditioning(9, u=3, v=1)) == "IIIoIIIoI"
    assert drawn(auto_conditioning(9, u=1, v=3)) == "IoooIoooI"
    assert drawn(auto_conditioning(3, u=5, v=5)) == "III"
    assert torch.equal(auto_conditioning(100), auto_conditioning(100, 5, 5))


def test_always_and_only_at_first():
    assert drawn(teacher_forcing(4)) == "IIII"
    assert drawn(seed_only(6, 2)) == "IIoooo" and drawn(seed_only(3, 3)) == "III"
    for schedule in (teacher_forcing(4), auto_conditioning(4, 1, 1), seed_only(4, 1), scheduled_sampling(4, 2, 0.5)):
        assert schedule.dtype == torch.bool


def test_scheduled_sampling_tosses_each_frame_of_each_sequence():
    schedule = scheduled_sampling(400, 300, 0.7, torch.Generator().manual_seed(0))
    assert schedule.shape == (300, 400) and schedule[:, 0].all()
    rest = schedule[:, 1:].double()
    assert rest.mean().item() == pytest.approx(0.7, abs=5 * math.sqrt(0.21 / rest.numel()))
    # no frame and no sequence is favoured, and one toss says nothing of the next
    assert (rest.mean(dim=0) - 0.7).abs().max() < 5 * math.sqrt(0.21 / 300)
    assert (rest.mean(dim=1) - 0.7).abs().max() < 5 * math.sqrt(0.21 / 399)
    both = (rest[:, 1:] * rest[:, :-1]).mean().item()
    assert both == pytest.approx(0.49, abs=0.01)


def test_scheduled_sampling_draws_from_its_generator_only():
    before = torch.get_rng_state()
    one, two = (scheduled_sampling(50, 4, 0.5, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(one, two) and torch.equal(torch.get_rng_state(), before)
    assert not torch.equal(one, scheduled_sampling(50, 4, 0.5, torch.Generator().manual_seed(4)))
    assert scheduled_sampling(50, 4, 1.0).all()
    assert not scheduled_sampling(50, 4, 0.0)[:, 1:].any()


def test_probability_decays_as_bengio_has_it():
    assert [truth_probability(p, 0.4) for p in (0.0, 0.5, 1.0)] == [0.4] * 3
    assert [truth_probability(p, 0.4, "linear") for p in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 0.7, 0.4])
    assert [truth_probability(p, 0.25, "exponential") for p in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 0.5, 0.25])
    sigmoid = [truth_probability(p / 10, 0.2, "inverse-sigmoid") for p in range(11)]
    assert sigmoid[0] == pytest.approx(0.99) and sigmoid[-1] == pytest.approx(0.2)
    # k / (k + exp(i / k)) with i / k = z p: log(k / eps - k) is a straight line in p
    logs = [math.log(99 / p - 99) for p in sigmoid]
    assert [b - a for a, b in zip(logs, logs[1:], strict=False)] == pytest.approx([logs[-1] / 10] * 10)
    for decay in DECAYS[1:]:
        values = [truth_probability(p / 20, 0.3, decay) for p in range(21)]
        assert all(a > b for a, b in zip(values, values[1:], strict=False)), decay


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: auto_conditioning(10, 0, 5), r"\(u=0, v=5\): u, .* must be a whole number of 1 or more"),
        (lambda: auto_conditioning(10, 5, -2), r"\(u=5, v=-2\): v, .* must be a whole number of 1 or more"),
        (lambda: auto_conditioning(10, 2.5, 5), "u=2.5"),
        (lambda: auto_conditioning(0, 5, 5), "number of frames must be .* not 0"),
        (lambda: teacher_forcing(-1), "number of frames"),
        (lambda: seed_only(5, 0), "length of the seed .* not 0"),
        (lambda: seed_only(5, 6), "the seed has 6 frames, the sequence only 5"),
        (lambda: scheduled_sampling(5, 0, 0.5), "number of sequences"),
        (lambda: scheduled_sampling(5, 2, 1.5), "between 0 and 1, not at 1.5"),
        (lambda: scheduled_sampling(5, 2, float("nan")), "between 0 and 1"),
        (lambda: truth_probability(0.5, 0.5, "cosine"), "unknown decay 'cosine'; known are fixed, linear"),
        (lambda: truth_probability(0.5, 0.0, "exponential"), "above 0 and below 1, not at 0.0"),
        (lambda: truth_probability(1.5, 0.5, "linear"), "progress"),
    ],
)
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(TutorialError, match=words) as error:
        call()
    assert "\n" not in str(error.value)


# --- noise that wanders ---------------------------------------------------------------------------


def wandering(deviation=0.5, frames=4.0, n=4000, batch=3, seed=0):
    noise = WanderingNoise(deviation, frames, torch.Generator().manual_seed(seed))
    return torch.stack([noise.disturb(torch.ones(batch, 2)) - 1 for _ in range(n)])  # (n, B, 2)


def test_wandering_noise_has_its_deviation_and_is_remembered_for_its_frames():
    noise = wandering()
    assert float(noise.mean()) == pytest.approx(0, abs=0.05) and float(noise.std()) == pytest.approx(0.5, rel=0.05)
    for lag in (1, 4, 12):  # its correlation falls to 1 / e in 4 frames
        together = float((noise[lag:] * noise[:-lag]).mean()) / 0.25
        assert together == pytest.approx(math.exp(-lag / 4), abs=0.06)
    between = float((noise[:, 0] * noise[:, 1]).mean()) / 0.25  # of two sequences
    assert between == pytest.approx(0, abs=0.06)


def test_wandering_noise_hangs_on_its_generator_alone():
    assert torch.equal(wandering(n=5), wandering(n=5)) and not torch.equal(wandering(n=5), wandering(n=5, seed=1))
    assert not wandering(deviation=0.0, n=5).any()
    for bad in (-0.1, math.nan, math.inf, "much", True):
        with pytest.raises(TutorialError, match="standard deviation of 0 or more"):
            WanderingNoise(bad, 15)
    with pytest.raises(TutorialError, match="for some frames, not 0"):
        WanderingNoise(0.1, 0)


def test_wandering_noise_begins_with_its_deviation():
    first = wandering(n=3, batch=4000)
    assert first.std((1, 2)).tolist() == pytest.approx([0.5] * 3, rel=0.05)
