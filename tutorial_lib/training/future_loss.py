"""What the Dynamic Future Net is trained with: a loss for each of its three stages, and each term a function.

Chen et al. (2020), sections 5.1 to 5.6; equation numbers beside the lines are the paper's. Stage 3 maximises a bound;
here its negative is minimised. Sums over time are divided by the number of frames, so that windows of other
lengths have losses of the same size.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from ..errors import TutorialError
from ..models.dynamic_future_net import STAGES, DynamicFutureNet
from ..models.future_code import sequence_error, smoothness_error
from ..models.pose_code import pose_error
from ..models.stochastic_latent import Gaussian, StochasticLatent
from ..models.variational import check_deviation, gaussian_divergence, gaussian_negative_log_likelihood
from .stages import Stage

FITTED_ON = 20  # batches from which means and deviations are taken before and after a stage

Terms = tuple[Tensor, dict[str, Tensor]]


# --- the terms of equation 15: of a sequence's frames (B, n, ...), averaged over frames and sequences -----------


def current_divergence(posterior: Gaussian, prior: Gaussian) -> Tensor:
    """``KL(q(s_t | h_t, z_t, m_t) || p(s_t | h_t, m_t))`` in nats a frame, equation 15, first term."""
    return gaussian_divergence(*posterior, *prior).mean()  # (15)


def future_divergence(posterior: Gaussian, prior: Gaussian) -> Tensor:
    """``KL(q(f_t | h_t, m_t) || p(f_t | h_t))`` in nats a frame, equation 15, second term."""
    return gaussian_divergence(*posterior, *prior).mean()  # (15)


def code_likelihood(code: Tensor, mean: Tensor, deviation: float) -> Tensor:
    """``-log p(z_t | s_t, h_t)`` a frame but for a constant, equation 15, third term."""
    return gaussian_negative_log_likelihood(code, mean, deviation).mean() / code.shape[1]  # (15)


def summary_likelihood(summary: Tensor, mean: Tensor, deviation: float) -> Tensor:
    """``-log p(m_t | f_t, h_t)`` a frame but for a constant, equation 15, fourth term."""
    return gaussian_negative_log_likelihood(summary, mean, deviation).mean() / summary.shape[1]  # (15)


def skip_steps(batch: int, frames: int, horizon: int, rng: torch.Generator | None = None) -> Tensor:
    """For every frame ``t1`` but the last a number of steps to some ``t2``, 1 to ``horizon`` and within the sequence:
    ``(batch, frames - 1)`` whole numbers."""
    most = torch.arange(frames - 1, 0, -1).clamp(max=horizon)  # (frames - 1,)
    drawn = (torch.rand(batch, frames - 1, generator=rng) * most).long()  # 0 ... most - 1
    return 1 + torch.minimum(drawn, most - 1)


def temporal_difference(
    dynamics: StochasticLatent, current: Tensor, past: Tensor, prior: Gaussian, steps: Tensor, horizon: int,
    rng: torch.Generator | None = None,
) -> Tensor:  # fmt: skip
    r"""Equations 12 to 14 and ``-L_T`` of equation 15, a pair (t1, t2): what was can be told from what came, and leads
    to it.

    .. math:: -L_T = \sum_{t_1, t_2} KL(q(s_{t_1} | s_{t_2}, h_{t_1}, h_{t_2}) \| p(s_{t_1}))
                     - \log p(s_{t_2} | s_{t_1}, t_1, t_2)

    The paper leaves ``p(s_t1)`` open; it is taken as the prior of that moment, ``p(s_t1 | m_t1, h_t1)``, as TD-VAE
    (Gregor et al. 2019), which the section follows, has its belief there. The last term's ``log``
    is missing in the paper. The likelihood has deviation 1, and ``dt`` is told in horizons.

    current: s ``(B, n, S)``; past: h ``(B, n, G)``; prior: of s ``(B, n, S)``; steps: ``t2 - t1`` of every t1 but the
    last, ``(B, n - 1)``. Returns a scalar, the mean over pairs.
    """
    later = torch.arange(steps.shape[1], device=steps.device) + steps  # t2: (B, n - 1)
    s2, h2 = (x.gather(1, later[..., None].expand(-1, -1, x.shape[-1])) for x in (current, past))
    posterior = dynamics.posterior_earlier(s2, past[:, :-1], h2)  # (13)
    s1 = posterior.sample(rng)  # (B, n - 1, S)
    reconstructed = dynamics.skip(s1, steps[..., None].to(s1.dtype) / horizon)  # (14)
    divergence = gaussian_divergence(*posterior, *(p[:, :-1] for p in prior)).mean()  # (15), L_T
    return divergence + gaussian_negative_log_likelihood(s2, reconstructed).mean() / s2.shape[1]


# --- the stages -------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class DynamicFutureLoss:
    """How the three stages are trained: which of them, for what share of the steps, and what counts how much.

    stage : "all", one after another; or the name of one, for a network in which those before are trained already.
    pose_share, future_share : of the steps of a run of all stages; the rest is for stage 3.
    code_deviation, summary_deviation : of the Gaussians ``p(z_t | s_t, h_t)`` and ``p(m_t | f_t, h_t)``, where 1 is how
        much codes and summaries differ in the data. The paper does not say.
    temporal : weight of the temporal-difference loss; 0 leaves it out, an ablation.
    smooth : weight of the smoothness loss of equation 3.
    """

    stage: str = "all"
    pose_share: float = 0.3
    future_share: float = 0.2
    code_deviation: float = 0.1
    summary_deviation: float = 0.3
    temporal: float = 1.0
    smooth: float = 1.0

    def __post_init__(self):
        if self.stage not in ("all", *STAGES):
            raise TutorialError(f"unknown stage {self.stage!r}: expected one of all, {', '.join(STAGES)}")
        for name in ("code_deviation", "summary_deviation"):
            check_deviation(name, getattr(self, name))
        for name in ("pose_share", "future_share", "temporal", "smooth"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
                raise TutorialError(f"{name} must be a number of 0 or more, not {value!r}")
        if self.pose_share <= 0 or self.future_share <= 0 or self.pose_share + self.future_share >= 1:
            raise TutorialError(
                f"shares of the steps of {self.pose_share:g} for pose and {self.future_share:g} for future: "
                "expected some for each, and some left for dynamics"
            )

    @property
    def needs_start(self) -> bool:
        """Whether training begins with a network that has been trained before."""
        return self.stage not in ("all", STAGES[0])

    def stages(self) -> tuple[Stage, ...]:
        """What the trainer runs, one after another."""
        share = {"pose": self.pose_share, "future": self.future_share}
        share["dynamics"] = 1 - self.pose_share - self.future_share
        losses = {"pose": self.pose_loss, "future": self.trajectory_loss, "dynamics": self.dynamics_loss}
        return tuple(
            Stage(
                name, losses[name], share[name] if self.stage == "all" else 1.0, module=name,
                check=partial(_check, name), before=partial(_before, name), after=partial(_after, name),
            )
            for name in (STAGES if self.stage == "all" else (self.stage,))
        )  # fmt: skip

    def pose_loss(
        self, model: DynamicFutureNet, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> Terms:
        """Stage 1, equation 2; ``batch`` is (B, T, D). The term beside it is the joints' mean distance in metres."""
        made = model.pose(batch)
        joints = model.representation.slices["joints"]
        off = (made - batch)[..., joints].detach().unflatten(-1, (-1, 3)).norm(dim=-1).mean()
        return pose_error(batch, made, model.pose.unit), {"joint error": off}

    def trajectory_loss(
        self, model: DynamicFutureNet, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> Terms:
        """Stage 2, equation 3; ``batch`` is (B, T, D).

        Sequences begin at every half horizon of a window, not at every frame: neighbours are nearly the same.
        """
        stride = max(1, model.config.horizon // 2)
        joints = model.representation.slices["joints"]
        with torch.no_grad():
            codes = model.pose.encode(batch)  # (B, T, C)
            sequences = model.future.sequences(codes)[:, ::stride].flatten(0, 1)  # (N, H + 1, C)
            features = model.future.sequences(batch / model.pose.unit)[:, ::stride].flatten(0, 1)[..., joints]
        unrolled = model.future.decode(model.future.encode(sequences), sequences[:, 0])  # (N, H, C)
        whole = torch.cat((sequences[:, :1], unrolled), 1)  # (N, H + 1, C)
        made = model.pose.features(model.pose.decode(whole))[..., joints] / model.pose.unit[joints]
        reconstruction = sequence_error(sequences[:, 1:], unrolled)  # (3), L_rec
        smoothness = smoothness_error(features, made)  # (3), L_smooth
        loss = reconstruction + self.smooth * smoothness  # (3)
        return loss, {"reconstruction": reconstruction.detach(), "smoothness": smoothness.detach()}

    def dynamics_loss(
        self, model: DynamicFutureNet, batch: Tensor, rng: torch.Generator | None = None, progress: float = 0.0
    ) -> Terms:
        """Stage 3, equation 15; ``batch`` is (B, T, D), of which the last H frames are only a future."""
        dynamics, horizon = model.dynamics, model.config.horizon
        with torch.no_grad():
            codes = model.pose.encode(batch)  # (B, T, C)
            summaries = model.future.summaries(codes)  # (B, T - H, M)
            codes = codes[:, : summaries.shape[1]]
        seen = dynamics.infer(codes, summaries, rng)
        imagined = dynamics.summary_of(seen.future, seen.past)  # m_t^p of equation 7: what synthesis will have
        prior = dynamics.prior_current(imagined, seen.past)
        terms = {
            "current divergence": current_divergence(seen.posterior_current, prior),
            "code": code_likelihood(codes, dynamics.code_of(seen.current, seen.past), self.code_deviation),
        }
        if model.config.future:
            terms["future divergence"] = future_divergence(seen.posterior_future, dynamics.prior_future(seen.past))
            terms["summary"] = summary_likelihood(summaries, imagined, self.summary_deviation)
        loss = sum(terms.values())  # (15), -L_d
        if self.temporal:
            steps = skip_steps(*seen.current.shape[:2], horizon, rng).to(codes.device)
            terms["temporal difference"] = temporal_difference(
                dynamics, seen.current, seen.past, prior, steps, horizon, rng
            )
            loss = loss + self.temporal * terms["temporal difference"]  # (15), -L_T
        return loss, {name: term.detach() for name, term in terms.items()}


def _check(stage: str, model: DynamicFutureNet) -> None:
    model.check_done(stage)


def _before(stage: str, model: DynamicFutureNet, sample: Callable[[], Tensor]) -> None:
    """The first stage begins with how large the data's numbers are."""
    if stage == "pose":
        model.pose.fit_features([sample() for _ in range(FITTED_ON)])


def _after(stage: str, model: DynamicFutureNet, sample: Callable[[], Tensor]) -> None:
    """What a stage has learnt is read by later ones as numbers of one size."""
    if stage == "pose":
        model.pose.fit_codes([sample() for _ in range(FITTED_ON)])
    elif stage == "future":
        with torch.no_grad():
            model.future.fit_summaries([model.pose.encode(sample()) for _ in range(FITTED_ON)])
    model.stages_done.fill_(STAGES.index(stage) + 1)
