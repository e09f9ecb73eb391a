"""Training in stages: parts of one network, each with a loss of its own, trained one after another."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from ..errors import TutorialError


@dataclasses.dataclass(frozen=True)
class Stage:
    """One stage of a training run; a run without stages is one of them.

    loss : called as every loss is; its ``progress`` runs from 0 at the stage's first step to 1 at its last.
    share : of the run's steps. Those of all stages are taken in proportion.
    module : name of the part of the network that learns; the rest stays as it is. Empty: all that requires gradients.
    check : called as ``check(model)`` before the first step, if given; raises ``TutorialError`` where the network is
        not ready for the stage.
    before, after : called as ``before(model, sample)`` before the first step and after the last, if given;
        ``sample()`` is a batch.
    """

    name: str
    loss: Callable[..., Any]
    share: float = 1.0
    module: str = ""
    check: Callable[..., None] | None = None
    before: Callable[..., None] | None = None
    after: Callable[..., None] | None = None


def stage_ends(stages: Sequence[Stage], steps: int) -> list[int]:
    """The step after each stage's last, in proportion to the shares; each stage has one step at least.

    Raises ``TutorialError`` for fewer steps than stages.
    """
    if steps < len(stages):
        raise TutorialError(f"{steps} steps for {len(stages)} stages: expected one for each at least")
    total, done, ends = sum(stage.share for stage in stages), 0.0, []
    for k, stage in enumerate(stages):
        done += stage.share
        end = round(steps * done / total)
        ends.append(min(max(end, k + 1, (ends[-1] if ends else 0) + 1), steps - (len(stages) - 1 - k)))
    return ends
