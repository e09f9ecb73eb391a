"""The Dynamic Future Net: a generative model of motion that imagines a future and moves towards it.

Chen, Wang, Yuan, Shao and Zhou, "Dynamic Future Net: diversified human motion generation" (MM 2020). Its three
stages, trained one after another, are three modules: ``pose`` (:mod:`.pose_code`), ``future`` (:mod:`.future_code`) and
``dynamics`` (:mod:`.stochastic_latent`). Shapes: B sequences of T frames, D numbers of a frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from ..errors import TutorialError
from ..representations import BodyFrame, representation_from_config
from .future_code import FutureCode
from .pose_code import PoseCode
from .stochastic_latent import StochasticLatent

STAGES = ("pose", "future", "dynamics")  # in the order in which they are trained


@dataclass(frozen=True)
class DynamicFutureNetConfig:
    """Sizes of a :class:`DynamicFutureNet`.

    The code of 16, the horizon, the GRU's 128 cells in two layers and all sizes inside stage 3 are the paper's.
    """

    dim: int  # numbers a frame
    features: Mapping[str, Any] | None = field(default=None, hash=False)  # of the representation: BodyFrame.config()
    hidden: int = 128  # cells of the recurrent layers
    layers: int = 2  # of the latent RNN
    code: int = 16  # z_t: pose and velocity together
    velocity_code: int = 4  # those of it that are for the velocity
    summary: int = 32  # m_t
    horizon: int = 8  # H, frames of future that m_t sums up; the paper has 8 or 16
    current: int = 16  # s_t
    future: int = 16  # f_t; 0: without a future state, an ablation

    def __post_init__(self):
        for name in ("dim", "hidden", "layers", "code", "velocity_code", "summary", "horizon", "current", "future"):
            value, least = getattr(self, name), 0 if name == "future" else 1
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise TutorialError(
                    f"DynamicFutureNet: {name} must be a whole number of {least} or more, not {value!r}"
                )
        if self.velocity_code >= self.code:
            raise TutorialError(
                f"DynamicFutureNet: a code of {self.code} numbers, {self.velocity_code} of them for the velocity, "
                "leaves none for the pose"
            )

    @property
    def least_length(self) -> int:
        """Frames that a training window must have: two that have a whole future after them."""
        return self.horizon + 2


class DynamicFutureNet(nn.Module):
    """All three stages. ``stages_done``, kept with the weights, is how many of them have been trained."""

    def __init__(self, config: DynamicFutureNetConfig):
        super().__init__()
        if config.features is None:
            raise TutorialError(
                "DynamicFutureNet must be told the features that it reads, the representation's config()"
            )
        self.config = config
        representation = representation_from_config(dict(config.features))
        if not isinstance(representation, BodyFrame) or representation.dim != config.dim:
            raise TutorialError(
                f"DynamicFutureNet of {config.dim} numbers a frame reads {BodyFrame.name!r} features of that width, "
                f"not {representation!r}"
            )
        self.representation = representation
        self.pose = PoseCode(representation, code=config.code, velocity_code=config.velocity_code)
        self.future = FutureCode(code=config.code, summary=config.summary, horizon=config.horizon, hidden=config.hidden)
        self.dynamics = StochasticLatent(
            code=config.code, summary=config.summary, current=config.current, future=config.future,
            hidden=config.hidden, layers=config.layers,
        )  # fmt: skip
        self.register_buffer("stages_done", torch.zeros((), dtype=torch.int64))

    @property
    def done(self) -> tuple[str, ...]:
        """The names of the stages that have been trained."""
        return STAGES[: int(self.stages_done)]

    def check_done(self, stage: str) -> None:
        """Raise ``TutorialError``, naming both sides, unless all stages before ``stage`` have been trained."""
        before = STAGES[: STAGES.index(stage)]
        if lacking := [name for name in before if name not in self.done]:
            so_far = f"has been trained in {' and '.join(self.done)} only" if self.done else "is untrained"
            raise TutorialError(
                f"stage {stage!r} stands on {' and '.join(before)}, and this network {so_far}: "
                f"train stage {lacking[0]!r} first"
            )

    @torch.no_grad()
    def summarize(self, features: Tensor) -> Tensor:
        """The futures of a clip: ``(T, D)`` features to summaries m_t ``(T - H, M)``.

        Raises ``TutorialError`` for a clip that is not longer than the horizon.
        """
        if features.ndim != 2 or len(features) <= self.config.horizon:
            raise TutorialError(
                f"features of shape {tuple(features.shape)}: expected (T, {self.config.dim}) with T of at least "
                f"{self.config.horizon + 1}, the horizon and one"
            )
        return self.future.summaries(self.pose.encode(features)[None])[0]
