"""Synthesis with the Dynamic Future Net: motions that go on from a beginning, or from nothing, as long as one likes.

Chen et al. (2020), section 6. Everything here is in the network's own numbers; for motions see
:mod:`tutorial_lib.generate_futures`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..chance import check_whole, is_real, is_whole
from ..errors import MotionError, TutorialError
from .dynamic_future_net import DynamicFutureNet
from .stochastic_latent import Gaussian, State

LEAST_PREFIX = 8  # frames, section 6.1: "We use a 8 to 20-frame motion prefix"


class Imagined(NamedTuple):
    """Generated frames as the network sees them, K motions of n frames."""

    code: Tensor  # (K, n, C) z_t
    current: Tensor  # (K, n, S) s_t
    future: Tensor  # (K, n, F) f_t


@dataclass(frozen=True)
class ImposedFuture:
    """A future that the network is to have in mind for a while, whatever it would have imagined.

    Either ``states``: f_t itself, or ``summaries``: m_t, such as :meth:`DynamicFutureNet.summarize` makes of a clip,
    for which f_t is then the mean of ``q(f_t | h_t, m_t)``. The paper names this as what its model makes
    possible (section 7), and leaves it for later.

    start : frames after the prefix before it begins.
    states, summaries : ``(n, F)`` or ``(n, M)``, one a frame; it ends after n frames.
    """

    start: int = 0
    states: Tensor | None = None
    summaries: Tensor | None = None

    def __post_init__(self):
        given = [x for x in (self.states, self.summaries) if x is not None]
        if len(given) != 1:
            raise TutorialError("an imposed future is either states or summaries, one of the two")
        if not is_whole(self.start) or self.start < 0:
            raise TutorialError(f"an imposed future begins after 0 frames or more, not {self.start!r}")
        if given[0].ndim != 2 or not len(given[0]) or not torch.isfinite(given[0]).all():
            raise TutorialError(
                f"an imposed future of shape {tuple(given[0].shape)}: expected finite numbers (frames, numbers)"
            )


class FutureStream:
    """K motions that go on as long as they are asked to: only the GRU's memory is kept.

    Pieces of any length are together the very frames of one long piece.

    temperature : times which the deviations of both priors are taken; 0: no chance at all.
    generator : on the CPU; of all draws. ``None``: torch's global one.
    imposed : a future to have in mind for a while.
    """

    def __init__(
        self, model: DynamicFutureNet, count: int, *, temperature: float = 1.0,
        generator: torch.Generator | None = None, imposed: ImposedFuture | None = None,
    ):  # fmt: skip
        check_whole("the number of motions", count)
        if not is_real(temperature) or not 0 <= temperature < 1e6:
            raise TutorialError(f"the temperature must be a number of 0 or more, not {temperature!r}")
        model.eval()
        self.model, self.temperature, self.generator = model, float(temperature), generator
        self._imposed = None if imposed is None else self._checked(imposed)
        self._state: State = model.dynamics.start(int(count))
        self._frame = 0  # frames given out

    def _checked(self, imposed: ImposedFuture) -> ImposedFuture:
        sizes = self.model.config
        if not sizes.future:
            raise TutorialError("this network was trained without a future state: none can be imposed on it")
        given, width = (
            (imposed.states, sizes.future) if imposed.summaries is None else (imposed.summaries, sizes.summary)
        )
        if given.shape[1] != width:
            what = "states" if imposed.summaries is None else "summaries"
            raise TutorialError(f"imposed {what} of {given.shape[1]} numbers, this network's have {width}")
        given = given.to(self.model.stages_done.device, torch.float32)
        states, summaries = (given, None) if imposed.summaries is None else (None, given)
        return ImposedFuture(imposed.start, states, summaries)

    @property
    def past(self) -> Tensor:
        """h_t, (K, G)."""
        return self._state[-1]

    @torch.no_grad()
    def read(self, prefix: Tensor) -> Tensor:
        """Let the network see how the motions begin: features ``(K, T0, D)``, T0 of 8 or more; returns their codes
        ``(K, T0, C)``.

        Where all H frames after a frame are in the prefix its future is inferred from them; for the last H it is
        imagined already. The paper does not say how a prefix is read.
        """
        model, dynamics = self.model, self.model.dynamics
        count = len(self._state[0])
        if prefix.ndim != 3 or prefix.shape[0] not in (1, count) or prefix.shape[2] != model.config.dim:
            raise MotionError(
                f"a prefix of shape {tuple(prefix.shape)} for {count} motions: expected ({count}, frames, "
                f"{model.config.dim})"
            )
        if prefix.shape[1] < LEAST_PREFIX:
            raise MotionError(f"a prefix of {prefix.shape[1]} frames: the network's past is {LEAST_PREFIX} or more")
        if self._frame:
            raise TutorialError("a prefix comes first, and frames have been made already")
        codes = model.pose.encode(prefix)  # (1 or K, T0, C)
        known = model.future.summaries(codes) if codes.shape[1] > model.config.horizon else codes[:, :0]
        for t in range(codes.shape[1]):
            h, z = self.past, codes[:, t].expand(count, -1)
            if t < known.shape[1] and model.config.future:
                m = known[:, t].expand(count, -1)
                f = self._draw(dynamics.posterior_future(h, m))
            else:
                f = dynamics.draw_future(h, self.generator, self.temperature)
                m = dynamics.summary_of(f, h)
            s = self._draw(dynamics.posterior_current(h, z, m))
            self._state = dynamics.transition(self._state, s, f)
        return codes.expand(count, -1, -1)

    def _draw(self, posterior: Gaussian) -> Tensor:
        """What is inferred from frames that are known is never made wilder than it was in training."""
        return posterior.at_temperature(min(self.temperature, 1.0)).sample(self.generator)

    @torch.no_grad()
    def take(self, n: int) -> Imagined:
        """The next ``n`` frames, 1 or more."""
        check_whole("the number of frames", n)
        dynamics, frames = self.model.dynamics, []
        for _ in range(n):
            h = self.past
            f = self._future(h)  # (K, F)
            m = dynamics.summary_of(f, h)
            s = dynamics.prior_current(m, h).at_temperature(self.temperature).sample(self.generator)  # (K, S)
            frames.append((dynamics.code_of(s, h), s, f))
            self._state = dynamics.transition(self._state, s, f)
            self._frame += 1
        return Imagined(*(torch.stack(column, 1) for column in zip(*frames, strict=True)))

    def _future(self, h: Tensor) -> Tensor:
        drawn = self.model.dynamics.draw_future(h, self.generator, self.temperature)  # also where it is not used, so
        imposed = self._imposed  # that the draws after an imposed future are those without it
        k = self._frame - imposed.start if imposed else -1
        if imposed is None or not 0 <= k < len(imposed.states if imposed.summaries is None else imposed.summaries):
            return drawn
        if imposed.summaries is None:
            return imposed.states[k].expand(len(h), -1)
        return self.model.dynamics.posterior_future(h, imposed.summaries[k].expand(len(h), -1)).mean

    def features(self, chunk: int = 32) -> Iterator[Tensor]:
        """Features ``(K, D)`` a frame at a time and without end; ``chunk`` frames are decoded at once."""
        pose = self.model.pose
        while True:
            codes = self.take(chunk).code
            with torch.no_grad():  # not around the yield, so that it does not reach into the caller's code
                frames = pose.features(pose.decode(codes))
            yield from frames.unbind(1)
