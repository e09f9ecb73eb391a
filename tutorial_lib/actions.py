"""What somebody does: a small classifier of short windows, and how often one action becomes another.

For motions that were generated, to count the changes of action that the Dynamic Future Net paper shows in pictures
(Chen et al. 2020, section 6.2). The classifier is trained on labelled clips in seconds; how often it is right on
clips that it has not seen is to be told beside what it finds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from .chance import seeded
from .diversity import windows_of
from .errors import TutorialError
from .models.layers import Standardizer, mlp
from .training.systems import global_seed

WINDOW = 15  # frames that are looked at, half a second
STRIDE = 5  # frames between windows
SURE = 0.9  # probability from which a window counts as an action
HELD = 1.0  # seconds that an action must go on to be one


class ActionClassifier(nn.Module):
    """Windows ``(..., W, D)`` of features to log-probabilities ``(..., A)``: one perceptron, features standardised."""

    def __init__(self, actions: Sequence[str], dim: int, *, window: int = WINDOW, hidden: int = 64):
        super().__init__()
        self.actions, self.window = tuple(actions), window
        self.scale = Standardizer(dim)
        self.layers = mlp(window * dim, hidden, len(self.actions), 3)

    def forward(self, windows: Tensor) -> Tensor:
        return self.layers(self.scale(windows).flatten(-2)).log_softmax(-1)

    @torch.no_grad()
    def probabilities(self, features: np.ndarray | Tensor, stride: int = STRIDE) -> np.ndarray:
        """Of motions ``(K, T, D)``: ``(K, N, A)``, windows ``stride`` frames apart. NaN where frames are not finite."""
        features = torch.as_tensor(features, dtype=torch.float32)
        return np.stack([self(windows_of(motion, self.window, stride)).exp().numpy() for motion in features])


def train_classifier(
    clips: Mapping[str, Sequence[np.ndarray]],
    *,
    window: int = WINDOW,
    steps: int = 300,
    batch: int = 128,
    seed: int = 0,
) -> ActionClassifier:
    """A classifier of the actions that ``clips`` names, ``{action: [features (T, D), ...]}``, each drawn equally often.

    A quarter of the windows have their numbers disturbed by noise of a third of a deviation, so that what is generated
    need not be as clean as what was captured. Raises ``TutorialError`` for fewer than two actions or one without a
    window.
    """
    if len(clips) < 2:
        raise TutorialError(f"a classifier of {len(clips)} actions: expected at least 2")
    windows = {}
    for action, each in clips.items():
        found = [windows_of(np.asarray(x, np.float32), window) for x in each if len(x) >= window]  # views
        if not found:
            raise TutorialError(f"no clip of {action!r} has a window of {window} frames")
        windows[action] = torch.from_numpy(np.concatenate(found))  # (N, W, D)
    dim = next(iter(windows.values())).shape[-1]
    rng = seeded(seed)
    with global_seed(seed):
        model = ActionClassifier(list(windows), dim, window=window)
    model.scale.fit([w[torch.randint(len(w), (2000,), generator=rng)] for w in windows.values()])
    optimizer = torch.optim.Adam(model.parameters(), lr=2e-3, weight_decay=1e-4)
    each = max(1, batch // len(windows))
    truth = torch.arange(len(windows)).repeat_interleave(each)
    for _ in range(steps):
        x = torch.cat([w[torch.randint(len(w), (each,), generator=rng)] for w in windows.values()])
        noisy = (torch.rand(len(x), 1, 1, generator=rng) < 0.25) * (model.scale.std / 3)
        x = x + noisy * torch.randn(x.shape, generator=rng)
        loss = nn.functional.nll_loss(model(x), truth)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    return model.eval()


def accuracy(model: ActionClassifier, clips: Mapping[str, Sequence[np.ndarray]]) -> float:
    """Share of the windows of labelled clips that are told rightly, each action counting the same."""
    shares = []
    for k, action in enumerate(model.actions):
        told = [
            model.probabilities(x[None])[0].argmax(-1) == k for x in clips.get(action, ()) if len(x) >= model.window
        ]
        if told:
            shares.append(float(np.concatenate(told).mean()))
    if not shares:
        raise TutorialError("no labelled clip is long enough to be told")
    return float(np.mean(shares))


@dataclasses.dataclass(frozen=True)
class Transitions:
    """Changes of action in K motions.

    counts: ``(A, A)``, row a, column b: how many motions go from a straight to b, once or more often. share: ``(A,)``
    of all windows that are surely each action. changed: how many motions change their action at all.
    """

    actions: tuple[str, ...]
    counts: np.ndarray
    share: np.ndarray
    changed: int
    motions: int

    @property
    def kinds(self) -> int:
        """How many of the A (A - 1) kinds occur."""
        return int((self.counts > 0).sum())


def transitions(
    model: ActionClassifier, features: np.ndarray, fps: float, *, sure: float = SURE, held: float = HELD
) -> Transitions:
    """Which actions become which in motions ``(K, T, D)``.

    A motion is in an action where all windows of ``held`` seconds have it with probability ``sure`` or more; between
    two such stretches it may be anything. A change is two such stretches of different actions after one another.
    """
    p = model.probabilities(features)  # (K, N, A)
    n, actions = max(1, round(held * fps / STRIDE)), len(model.actions)
    counts, changed = np.zeros((actions, actions), dtype=int), 0
    surely = np.nan_to_num(p) >= sure
    for each in surely:
        runs = np.lib.stride_tricks.sliding_window_view(each, n, axis=0).all(-1) if len(each) >= n else each[:0]
        order = [int(row.argmax()) for row in runs if row.any()]
        steps = {(a, b) for a, b in zip(order, order[1:], strict=False) if a != b}
        for a, b in steps:
            counts[a, b] += 1
        changed += bool(steps)
    return Transitions(model.actions, counts, surely.mean((0, 1)), changed, len(p))
