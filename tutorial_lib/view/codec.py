"""Joint positions as few bytes: how a motion travels inside an HTML page.

Positions become whole numbers of steps (a third of a millimetre), each joint relative to its parent,
then second differences in time, sign in the lowest bit, one joint coordinate after another, low bytes
before high bytes, deflate. All but the rounding is exact, so no error builds up over time or along a limb:
a decoded joint is at most ``sqrt(3) / 2`` steps, 0.29 mm, from where it was.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

STEP = 0.001 / 3  # metres; sqrt(3)/2 of it is 0.29 mm
_LARGEST = 32767  # second differences must fit 16 bits
_SPAN = 2**28  # and their sums 32 bits, in Python and in JavaScript


@dataclass(frozen=True)
class Payload:
    """Encoded positions: ``data`` (deflated bytes), ``step`` and ``origin`` (metres), ``frames``."""

    data: bytes
    step: float
    origin: tuple[float, float, float]
    frames: int


def encode_positions(positions: np.ndarray, parents: Sequence[int], *, step: float = STEP) -> Payload:
    """Encode finite positions (T, J, 3) in metres, T >= 1, of nodes whose parents come first (root: -1).

    A motion that jumps too far for 16 bits (by about 11 m between frames, or a figure hundreds of
    times too large) gets a step two, four, ... times as long: coarser, but never refused.
    """
    positions = np.asarray(positions, np.float64)
    frames, joints, _ = positions.shape
    parents = np.asarray(parents, int)
    origin = positions[0, 0].copy()
    relative = positions - origin
    span = float(np.abs(relative).max())
    while True:
        if span < step * _SPAN:
            lattice = np.rint(relative.reshape(frames, -1).T / step).astype(np.int32).reshape(joints, 3, frames)
            local = lattice.copy()
            children = np.flatnonzero(parents >= 0)
            local[children] -= lattice[parents[children]]
            change = np.diff(local, n=2, axis=-1, prepend=np.zeros((joints, 3, 2), np.int32))
            if max(int(change.max()), -int(change.min())) <= _LARGEST:
                break
        step *= 2
    change = change.astype(np.int16)
    zigzag = ((change << 1) ^ (change >> 15)).astype("<u2")
    planes = zigzag.reshape(-1).view(np.uint8).reshape(-1, 2).T
    return Payload(zlib.compress(planes.tobytes(), 6), step, tuple(origin.tolist()), frames)


def decode_positions(payload: Payload, parents: Sequence[int]) -> np.ndarray:
    """What the page's script makes of a payload, in Python: positions (T, J, 3) in metres."""
    joints = len(parents)
    planes = np.frombuffer(zlib.decompress(payload.data), np.uint8).reshape(2, -1)
    zigzag = planes[0].astype(np.int32) | planes[1].astype(np.int32) << 8
    change = ((zigzag >> 1) ^ -(zigzag & 1)).reshape(joints, 3, payload.frames)
    local = np.cumsum(np.cumsum(change, axis=-1), axis=-1)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[joint] += local[parent]
    return local.transpose(2, 0, 1) * payload.step + np.asarray(payload.origin)
