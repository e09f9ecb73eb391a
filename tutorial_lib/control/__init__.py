"""Control signals (Habibie et al., section 4.1): turning, forward and sideways speed ``(T, 3)`` of a body.

As in ``HipFrame``: rad/s and m/s; turning and sideways are positive to the left; a frame's control is the step that
led to it from the frame before. They are measured from clips, made from a path along the ground or from sliders,
and brought back to the world, where the way that was walked is compared with the path that was asked for.
"""

from ..motion.ground import circle, figure_of_eight, prepared_path, zigzag
from ..representations import integrate_control, measure_control
from .deviation import PathDeviation, path_deviation
from .path import PathControl, control_from_path, path_control
from .signals import (
    LIMITS,
    Limits,
    NoGait,
    check_control,
    constant_control,
    control_of,
    limit_control,
    limits_of,
    piecewise_control,
    smooth_control,
)
from .strides import Strides, find_strides
from .sway import Sway, Swaying, fit_sway

__all__ = [
    "LIMITS",
    "Limits",
    "NoGait",
    "PathControl",
    "PathDeviation",
    "Strides",
    "Sway",
    "Swaying",
    "check_control",
    "circle",
    "constant_control",
    "control_from_path",
    "control_of",
    "figure_of_eight",
    "find_strides",
    "fit_sway",
    "integrate_control",
    "limit_control",
    "limits_of",
    "measure_control",
    "path_control",
    "path_deviation",
    "piecewise_control",
    "prepared_path",
    "smooth_control",
    "zigzag",
]
