"""Numbers that a user gives, of Python's kinds or numpy's, and the generator of a seed among them."""

from __future__ import annotations

import numbers
import operator

import numpy as np
import torch

from .errors import MotionError, TutorialError


def is_whole(value: object) -> bool:
    """Whether it is a whole number, Python's or numpy's; True and False are none."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def is_real(value: object) -> bool:
    """Whether it is a real number, Python's or numpy's; True and False are none."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def check_whole(what: str, value: object, least: int = 1) -> None:
    """``TutorialError`` unless ``value`` is a whole number of ``least`` or more."""
    if not is_whole(value) or value < least:
        raise TutorialError(f"{what} must be a whole number of {least} or more, not {value!r}")


def numbers_of(values: object, what: str) -> np.ndarray:
    """``values`` as an array of float64; ``MotionError`` for what is ragged, or text."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise MotionError(f"{what}: expected numbers, found {type(values).__name__}") from None


def whole_seed(seed: object) -> int:
    """``seed`` as Python's own number, which torch and numpy both take; ``TutorialError`` if it is none."""
    try:
        number = -1 if isinstance(seed, bool) else operator.index(seed)
    except TypeError:
        number = -1
    if not 0 <= number < 2**64:  # torch keeps 64 bits
        below = " below 2**64" if number > 0 else ""
        raise TutorialError(f"the seed must be a whole number of 0 or more{below}, not {seed!r}")
    return number


def seeded(seed: object) -> torch.Generator:
    """A generator on the CPU that starts at ``seed``; ``TutorialError`` for what is no whole number of 0 or more."""
    return torch.Generator().manual_seed(whole_seed(seed))
