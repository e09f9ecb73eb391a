"""Schedules: at which frames a recurrent network is fed the truth, and at which its own last output.

Teacher forcing, auto-conditioning, scheduled sampling and synthesis run the same network; they differ only in
this. A schedule is a boolean tensor over time, ``True`` = fed the truth: (T,), or (B, T) where every sequence
has its own. The first frame is always the truth, since there is no output yet. :func:`~.rollout.rollout` runs a
network under a schedule; drawn as rows of squares it is figure 1 of the acRNN paper.

A schedule has whole frames of truth. At synthesis some channels may be true at *every* frame, such as the control
signal that someone gives: :class:`Given`; and what is fed may be disturbed: :class:`WanderingNoise`.

>>> auto_conditioning(10, u=3, v=2).int().tolist()
[1, 1, 1, 0, 0, 1, 1, 1, 0, 0]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..chance import is_real
from ..errors import TutorialError
from ..models.variational import standard_normal_like

DECAYS = ("fixed", "linear", "exponential", "inverse-sigmoid")


def teacher_forcing(T: int) -> Tensor:
    """(T,), the truth at every frame: how the vanilla network is trained (acRNN, section 3, equation 1)."""
    _check_whole("the number of frames", T)
    return torch.ones(T, dtype=torch.bool)


def auto_conditioning(T: int, u: int = 5, v: int = 5) -> Tensor:
    """(T,), ``u`` frames of truth, then ``v`` of the network's own, over and over from the sequence's start.

    Zhou et al., "Auto-conditioned recurrent networks", section 3 and figure 1 (there with u = v = 4): u is the
    "ground-truth length", v the "condition length". In the main text u = v = 5, the default here.
    """
    _check_whole("the number of frames", T)
    for name, length in (("u, the frames of truth in a row,", u), ("v, the own frames in a row,", v)):
        if not _is_whole(length) or length < 1:
            raise TutorialError(f"auto-conditioning (u={u!r}, v={v!r}): {name} must be a whole number of 1 or more")
    return torch.arange(T) % (u + v) < u


def scheduled_sampling(T: int, batch: int, probability: float, rng: torch.Generator | None = None) -> Tensor:
    """(batch, T), each frame of each sequence the truth with this probability, tossed on its own.

    Bengio et al., "Scheduled sampling for sequence prediction with recurrent neural networks" (2015), section
    2.3, whose epsilon is ``probability``; there it falls as training goes on, see :func:`truth_probability`.
    ``rng`` is a generator on the CPU, torch's global one by default. The first frames are always the truth.
    """
    _check_whole("the number of frames", T)
    _check_whole("the number of sequences", batch)
    _check_probability("the probability of truth", probability)
    schedule = torch.rand(batch, T, generator=rng) < probability
    schedule[:, 0] = True
    return schedule


def seed_only(T: int, n_seed: int) -> Tensor:
    """(T,), the truth for ``n_seed`` frames and then never again: synthesis."""
    _check_whole("the number of frames", T)
    _check_whole("the length of the seed", n_seed)
    if n_seed > T:
        raise TutorialError(f"the seed has {n_seed} frames, the sequence only {T}")
    return torch.arange(T) < n_seed


def truth_probability(progress: float, probability: float, decay: str = "fixed") -> float:
    r"""The probability of truth at some point of training, for :func:`scheduled_sampling`.

    The three decays are those of Bengio et al. (2015), section 2.4, stretched so that they begin with (nearly)
    always the truth and arrive at ``probability`` with the last step:

    ==================  ============================================================  ==================
    "fixed"             ``probability`` throughout
    "linear"            a straight line from 1                                        max(eps, k - c i)
    "exponential"       ``probability ** progress``; needs a probability above 0      k^i
    "inverse-sigmoid"   k / (k + exp(z progress)), k = 99: from 0.99, slow at first   k / (k + exp(i / k))
    ==================  ============================================================  ==================

    ``progress`` runs from 0 at the first step to 1 at the last.
    """
    check_decay(probability, decay)
    if not 0 <= progress <= 1:
        raise TutorialError(f"progress runs from 0 to 1, not to {progress!r}")
    if decay == "fixed":
        return float(probability)
    if decay == "linear":
        return 1 - (1 - probability) * progress
    if decay == "exponential":
        return float(probability) ** progress
    k = 99
    odds = k * (1 - probability) / probability  # exp(z): what the exponential must reach at the end
    return k / (k + odds**progress)


def check_decay(probability: float, decay: str) -> None:
    """Raise :class:`TutorialError` unless :func:`truth_probability` can take these."""
    _check_probability("the probability of truth", probability)
    if decay not in DECAYS:
        raise TutorialError(f"unknown decay {decay!r}; known are {', '.join(DECAYS)}")
    if decay in ("exponential", "inverse-sigmoid") and not (0 < probability < 1):
        raise TutorialError(f"the {decay} decay ends at a probability above 0 and below 1, not at {probability!r}")


@dataclass(frozen=True, eq=False)
class Given:
    """True values of some channels of the frames to come, put in the place of what a network says there.

    Of each frame that the network predicts the given channels are replaced, and so it goes out and is read at the next
    step: the rest of frame t + 1 was predicted from the given values up to frame t. VAE-LSTM, figure 4: "For each
    frame predicted by LSTM-3LR, ERD and CRBM, we replace predicted control signals with the ground truth".

    channels : their numbers in a frame, such as ``range(63, 66)``; for the parts of a representation see
        :func:`tutorial_lib.generate.given_parts`.
    values : (B, F, C) for the F frames after the seed, in the network's own (normalised) features.
    Raises :class:`TutorialError` for values that are not finite or not C in a frame, or channels named twice.
    """

    channels: Sequence[int]
    values: Tensor

    def __post_init__(self):
        object.__setattr__(self, "channels", tuple(int(channel) for channel in self.channels))
        shape = tuple(self.values.shape)
        if len(shape) != 3 or shape[-1] != len(self.channels):
            raise TutorialError(
                f"given values of shape {shape} for {len(self.channels)} channels: expected (sequences, frames, "
                f"{len(self.channels)})"
            )
        if len(set(self.channels)) < len(self.channels) or min(self.channels, default=0) < 0:
            raise TutorialError(f"given channels {list(self.channels)}: expected different numbers of 0 or more")
        bad = ~torch.isfinite(self.values).all(-1).all(0)
        if bad.any():
            raise TutorialError(f"given values are not finite at frame {int(bad.to(torch.uint8).argmax()) + 1}")

    @property
    def frames(self) -> int:
        """F."""
        return self.values.shape[1]

    def put(self, frame: Tensor, t: int) -> Tensor:
        """A copy of a frame (B, D), number t after the seed from 0 on, that has the given values."""
        frame = frame.clone()
        frame[:, list(self.channels)] = self.values[:, t].to(frame)
        return frame

    def check(self, batch: int, dim: int) -> None:
        """Raise :class:`TutorialError` unless this is for so many sequences of such frames."""
        if len(self.values) != batch or max(self.channels, default=0) >= dim:
            raise TutorialError(
                f"given values for {len(self.values)} sequences and channels {list(self.channels)}, the seed has "
                f"{batch} sequences of {dim} numbers a frame"
            )


class WanderingNoise:
    r"""Gaussian noise that wanders slowly, for the frames that a network is fed of its own output at synthesis.

    A network that draws nothing, run for long enough, comes back to where it was and goes round. With each number of
    what it is fed a little off it does not; noise that is new at every frame is smoothed away by its memory, so this
    one is remembered for a while, an Ornstein-Uhlenbeck process at whole frames:

    .. math:: n_{t+1} = a\, n_t + \sqrt{1 - a^2}\, \sigma \varepsilon_t, \qquad a = e^{-1 / \mathrm{frames}},
              \qquad \varepsilon_t \sim \mathcal N(0, I)

    Not in the acRNN paper. A network has its way back from as much noise as it was trained with (``train --noise``).

    deviation : sigma, in the units of the network's (normalised) features; 0 disturbs nothing.
    frames : for how many the noise is remembered.
    generator : of all that is drawn, on the CPU; by default torch's global one.
    Raises :class:`TutorialError` for a deviation below 0 or no frames.
    """

    def __init__(self, deviation: float, frames: float, generator: torch.Generator | None = None):
        check_noise(float(deviation) if is_real(deviation) else deviation)  # numpy's numbers too
        if not 0 < frames < math.inf:
            raise TutorialError(f"noise must be remembered for some frames, not {frames!r}")
        self.deviation, self.keep, self.generator = float(deviation), math.exp(-1 / frames), generator
        self._now: Tensor | None = None  # (B, D), of deviation 1

    def disturb(self, frame: Tensor) -> Tensor:
        """A frame (B, D) with the noise of this moment; the noise then wanders on."""
        drawn = standard_normal_like(frame, self.generator)
        if self._now is None:
            self._now = drawn
        else:
            self._now = self.keep * self._now + math.sqrt(1 - self.keep**2) * drawn
        return frame + self.deviation * self._now


def check_noise(noise: float) -> None:
    """Raise :class:`TutorialError` unless ``noise`` can be a standard deviation."""
    if isinstance(noise, bool) or not isinstance(noise, (int, float)) or not 0 <= noise < math.inf:
        raise TutorialError(f"the noise is a standard deviation of 0 or more, not {noise!r}")


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check_whole(what: str, value: object) -> None:
    if not _is_whole(value) or value < 1:
        raise TutorialError(f"{what} must be a whole number of 1 or more, not {value!r}")


def _check_probability(what: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 1:
        raise TutorialError(f"{what} lies between 0 and 1, not at {value!r}")
