"""Figures 3 and 4 of the VAE-LSTM paper, of a result of ``reproduce vae-lstm``."""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING

import numpy as np

from ..clip_errors import PAPER_FPS, frames_in_clip
from ..threads import torch_threads
from ..training.checkpoints import load_checkpoint
from ..view.plots import curve_plot
from ..view.strip import pose_strip
from .grid import clips_for
from .results import Result, numbers
from .vae_lstm_measure import GIVEN, POSTERIOR, PREDICTED, PRIOR, rollouts
from .vae_lstm_plan import SYSTEMS, VAE, Plan
from .vae_lstm_tables import runs_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_3 = (80, 100, 120)  # frames at 60 a second
FIGURE_3_ROWS = ("lstm", "erd", "crbm-cd1", VAE)  # the paper does not say which of its two cRBMs it drew


def figure_3(result: Result, plan: Plan, folder: pathlib.Path) -> Figure | None:
    """Poses at frames 80, 100 and 120 of the middle test window: the truth, then what each system makes of it.

    As in table 1: the baselines are shown 30 frames and predict the control themselves; the VAE-LSTM has the true
    control, a code of 4 frames, and goes where it says itself. A row is a system (in the paper a column). Made again
    from the checkpoints, for motions of the Bandai-Namco clips stand in no file; None where none is there.
    """
    runs = {run.name: run for run in plan.runs() if run.name in result["runs"]}
    found = {}
    for name in FIGURE_3_ROWS:
        if name not in runs:
            continue
        way = POSTERIOR if name == VAE else PREDICTED
        clips = [motion for _, test in clips_for(runs[name].recipe) for motion in test]
        with torch_threads(1):
            made = rollouts(load_checkpoint(runs[name].path(folder)), clips, plan.protocol, (way,))[way]
        middle = len(made.made) // 2
        if not found:
            found["ground truth"] = made.representation.decode(made.truth[middle])
        if np.isfinite(made.made[middle]).all():
            found[SYSTEMS[name].title] = made.representation.decode(made.made[middle])
    if not found:
        return None
    fps = next(iter(found.values())).fps
    frames = [k - 1 for k in frames_in_clip(fps, FIGURE_3)]
    return pose_strip(list(found.values()), frames, labels=list(found), width=6.0, row_height=1.7)


def figure_4(result: Result) -> Figure | None:
    """Average pose error at every frame, all being given the true control; None without any run."""
    curves = {}
    for name, row in SYSTEMS.items():
        for way in (POSTERIOR, PRIOR) if name == VAE else (GIVEN,):
            found = [numbers(run["ways"][way]["curve"]) for run in runs_of(result, name)]
            if found:
                curves[row.title + (" (prior sample)" if way == PRIOR else "")] = 100 * np.mean(found, axis=0)
    if not curves:
        return None
    frames = np.arange(1, 1 + len(next(iter(curves.values())))) * PAPER_FPS / result["protocol"]["fps"]
    title = "Figure 4: pose error, true control given"
    return curve_plot(curves, x=frames, xlabel="frame at 60 per second", ylabel="mean distance of a joint, cm",
                      title=title)  # fmt: skip
