"""Stage 2 of the Dynamic Future Net: the next H codes as one, the summary m_t of a future.

Chen et al. (2020), section 5.2, figure 4. Shapes: N sequences of H + 1 codes of C numbers, M of a summary; B windows
of T frames.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

from .layers import Standardizer


class FutureCode(nn.Module):
    """A sequence auto-encoder of two GRUs: ``z_t, ..., z_{t+H}`` to ``m_t`` and back, given ``z_t``.

    The decoder is fed its own last code and tells what changes, so that it begins where the pose is. The paper gives
    neither the GRUs' sizes nor that of m_t. ``scale`` is fitted after training (:meth:`fit_summaries`), so that
    stage 3 reads summaries with a mean of 0 and a deviation of 1.
    """

    def __init__(self, *, code: int = 16, summary: int = 32, horizon: int = 8, hidden: int = 128):
        super().__init__()
        self.horizon = horizon
        self.encoder = nn.GRU(code, hidden, batch_first=True)
        self.to_summary = nn.Linear(hidden, summary)
        self.from_summary = nn.Linear(summary, hidden)
        self.decoder = nn.GRUCell(code, hidden)
        self.readout = nn.Linear(hidden, code)
        self.scale = Standardizer(summary)

    def sequences(self, codes: Tensor) -> Tensor:
        """All stretches of H + 1 codes: ``(B, T, C)`` to ``(B, T - H, H + 1, C)``."""
        return codes.unfold(1, self.horizon + 1, 1).transpose(2, 3)

    def encode(self, sequences: Tensor) -> Tensor:
        """``(N, H + 1, C)`` to ``m`` ``(N, M)``."""
        _, last = self.encoder(sequences)  # (1, N, hidden)
        return self.scale(self.to_summary(last[0]))

    def decode(self, summary: Tensor, first: Tensor) -> Tensor:
        """``m_t`` ``(N, M)`` and ``z_t`` ``(N, C)`` to ``z'_{t+1}, ..., z'_{t+H}`` ``(N, H, C)``."""
        state = torch.tanh(self.from_summary(self.scale.invert(summary)))  # (N, hidden)
        code, unrolled = first, []
        for _ in range(self.horizon):
            state = self.decoder(code, state)
            code = code + self.readout(state)  # (N, C)
            unrolled.append(code)
        return torch.stack(unrolled, 1)

    def summaries(self, codes: Tensor) -> Tensor:
        """``m_t`` of every frame with H more after it: ``(B, T, C)`` to ``(B, T - H, M)``."""
        sequences = self.sequences(codes)
        return self.encode(sequences.flatten(0, 1)).unflatten(0, sequences.shape[:2])

    def fit_summaries(self, codes: Iterable[Tensor]) -> None:
        """Measure the summaries of codes ``(B, T, C)``: once, after training."""
        with torch.no_grad():
            self.scale.fit([self.summaries(z) for z in codes])


def sequence_error(codes: Tensor, reconstruction: Tensor) -> Tensor:
    r"""Equation 3, first term: the squared distance of codes ``(N, H, C)``, averaged over them: a scalar.

    .. math:: L_{rec} = \frac1T \sum_t \| z_t - z'_t \|_2^2
    """
    return (codes - reconstruction).square().sum(-1).mean()  # (3), L_rec


def smoothness_error(joints: Tensor, reconstruction: Tensor) -> Tensor:
    r"""Equation 3, second term: the squared distance of the joints' velocities, averaged over frames: a scalar.

    .. math:: L_{smooth} = \frac1T \sum_t \| V_t - \hat V_t \|_2^2

    joints, reconstruction: ``(N, H + 1, 3 J)`` in the units of the pose's error. A velocity is the step from the frame
    before, per frame.
    """
    change = (joints - reconstruction).diff(dim=-2)  # V_t - V^_t: (N, H, 3 J)
    return change.square().sum(-1).mean()  # (3), L_smooth
