"""What a person looks at: the player, film strips and plots."""

from .player import Player, show
from .plots import bar_plot, curve_plot, distance_plot, motion_change_plot, rest_pose_plot
from .strip import pose_strip

__all__ = [
    "Player",
    "bar_plot",
    "curve_plot",
    "distance_plot",
    "motion_change_plot",
    "pose_strip",
    "rest_pose_plot",
    "show",
]
