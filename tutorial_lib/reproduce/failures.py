"""When generated motion has failed, by rules: it freezes, stays in one pose, or leaves what people do.

acRNN, section 4 and figure 7, tells of failures among 20 samples of 1000 frames, but not by what rule. Here each is
a number held against true motion (:class:`Truth`); the rules themselves are functions of
:mod:`tutorial_lib.metrics`:

==============  ==================================================================================================
"freezing"      for 10 s the motion change is below a tenth of the true one, on average (``freezing_time``)
"stuck"         for 10 s the pose varies less than a quarter of what it does in true clips (``stuck_time``)
"divergence"    a node is farther from the root than 1.5 times in any training clip (``divergence_time``)
"out of range"  for 1 s the pose is, on average, farther from every training pose than 1.25 times the most that any
                pose of a true clip is from all other clips (``range_exit_time``)
==============  ==================================================================================================

What stands still for less is no failure, since it recovers (figure 6): it is counted by ``stagnations``, stretches of
1 s and more below a tenth of the true motion change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import metrics
from ..generate import prepare
from ..metrics import FREEZING
from ..motion.clip import Motion
from ..representations import Representation

STUCK = {"fraction": 0.25, "seconds": 10.0}
DIVERGENCE = {"factor": 1.5}
OUT_OF_RANGE = {"factor": 1.25, "seconds": 1.0}
STAGNATION = {"fraction": 0.1, "seconds": 1.0}
RULES = {"freezing": FREEZING, "stuck": STUCK, "divergence": DIVERGENCE, "out of range": OUT_OF_RANGE}

POSES_A_SECOND = 6.0  # that are looked up among the true ones
TRUE_POSES = 4000  # at most, that they are looked up among


@dataclass(frozen=True)
class Truth:
    """What true motion is like: the measure of the rules."""

    change: float  # mean motion change a frame of the training clips, in the representation
    spread: float  # mean over the training clips of how much the pose varies within each, metres
    reach: float  # largest distance of a node from the root in the training clips, metres
    range: float  # largest distance of a true pose from the poses of all other clips, metres
    poses: np.ndarray  # (P, J, 3) of the training clips, evenly thinned

    @classmethod
    def of(cls, train: Sequence[Motion], test: Sequence[Motion], representation: Representation) -> Truth:
        """From training clips; for ``range`` each of all the clips is held out in turn.

        The clips are of the representation's size already (:func:`tutorial_lib.recipes.sets_of`).
        """
        fps = representation.fps
        train, test = prepare(train, fps=fps), prepare(test, fps=fps)
        changes = np.concatenate([metrics.frame_change(representation.encode(m)) for m in train if len(m) > 1])
        spreads = [float(metrics.pose_spread(m.positions, m.fps, len(m) / m.fps)[0]) for m in train]
        every = max(1, round(fps / POSES_A_SECOND), -(-sum(map(len, train)) // TRUE_POSES))
        clips = [m.positions[::every] for m in (*train, *test)]
        return cls(
            float(changes.mean()),
            float(np.average(spreads, weights=[len(m) for m in train])),
            max(float(metrics.reach(m.positions)) for m in train),
            metrics.pose_range(clips) if len(clips) > 1 else float("inf"),
            np.concatenate(clips[: len(train)]),
        )

    def to_dict(self) -> dict[str, float]:
        """Its numbers, without the poses."""
        return {name: getattr(self, name) for name in ("change", "spread", "reach", "range")}


def failures(seeds: np.ndarray, made: np.ndarray, representation: Representation, truth: Truth) -> dict[str, Any]:
    """Each sample held against the rules.

    seeds ``(K, T0, D)``, made ``(K, F, D)``: features in the representation, not normalised, the seed going before.

    Returns
    -------
    dict with

    - ``samples``, ``frames``: K and F
    - ``rules``: for each rule its settings and how many samples it finds
    - ``count``: how many samples fail by any rule
    - ``first``: (rule, seconds after the seed) of each sample's first failure, or None
    - ``latest``: sample, rule and seconds of the failure that comes last of all first ones (figure 7), or None
    - ``stagnations``: how many in all samples, their longest in seconds, and how many samples have none
    - ``lowest``: the smallest mean motion change over 10 s in any sample, as a share of the true one

    Samples shorter than a rule's seconds are held against it as a whole.
    """
    fps, frames = representation.fps, made.shape[1]
    whole = frames / fps
    every = max(1, round(fps / POSES_A_SECOND))
    found: dict[str, list[float]] = {rule: [] for rule in RULES}
    still, lowest = [], []
    for seed, sample in zip(seeds, made, strict=True):
        change = metrics.frame_change(np.concatenate([seed[-1:], sample]))  # (F,)
        positions = representation.decode_positions(np.concatenate([seed, sample]))[len(seed) :]
        thin, slow = positions[::every], fps / every
        distance = metrics.pose_distance(thin, truth.poses)
        freezing, stuck = ({**r, "seconds": min(r["seconds"], whole)} for r in (FREEZING, STUCK))
        window = max(1, round(freezing["seconds"] * fps))
        found["freezing"].append(float(metrics.freezing_time(change, truth.change, fps, **freezing)))
        found["stuck"].append(float(metrics.stuck_time(thin, truth.spread, slow, **stuck)))
        found["divergence"].append(float(metrics.divergence_time(positions, truth.reach, fps, **DIVERGENCE)))
        found["out of range"].append(float(metrics.range_exit_time(distance, truth.range, slow, **OUT_OF_RANGE)))
        still.append(metrics.stagnations(change, truth.change, fps, **STAGNATION))
        lowest.append(float(metrics.moving_mean(change, window).min()) / truth.change)
    firsts = []
    for times in zip(*found.values(), strict=True):
        rule, seconds = min(zip(found, times, strict=True), key=lambda pair: pair[1])
        firsts.append((rule, round(seconds, 2)) if np.isfinite(seconds) else None)
    failed = [(first[1], k, first[0]) for k, first in enumerate(firsts) if first]
    latest = max(failed, default=None)
    return {
        "samples": len(made),
        "frames": frames,
        "rules": {rule: {**settings, "count": int(np.isfinite(found[rule]).sum())} for rule, settings in RULES.items()},
        "count": len(failed),
        "first": firsts,
        "latest": None if latest is None else {"sample": latest[1], "rule": latest[2], "seconds": latest[0]},
        "stagnations": {
            **STAGNATION,
            "count": sum(map(len, still)),
            "longest": round(max((seconds for each in still for _, seconds in each), default=0.0), 2),
            "samples without": sum(not each for each in still),
        },
        "lowest": float(f"{min(lowest):.3g}") if np.isfinite(lowest).all() else None,
    }
