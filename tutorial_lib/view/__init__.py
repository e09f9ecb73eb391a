"""What a person looks at: the player, the u/v explorer, the path canvas, film strips, plots and tables."""

from .explorer import Cell, Explorer, explorer
from .path_canvas import PathCanvas
from .path_plot import path_plot
from .player import Player, show
from .plots import (
    bar_plot,
    cloud_plot,
    curve_plot,
    distance_plot,
    motion_change_plot,
    rest_pose_plot,
    schedule_plot,
)
from .strip import pose_strip
from .tables import ErrorTable, error_table

__all__ = [
    "Cell",
    "ErrorTable",
    "Explorer",
    "PathCanvas",
    "Player",
    "bar_plot",
    "cloud_plot",
    "curve_plot",
    "distance_plot",
    "error_table",
    "explorer",
    "motion_change_plot",
    "path_plot",
    "pose_strip",
    "rest_pose_plot",
    "schedule_plot",
    "show",
]
