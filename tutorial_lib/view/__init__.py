"""What a person looks at: player, u/v explorer, path canvas, fan of futures, film strips, plots and tables."""

from .explorer import Cell, Explorer, explorer
from .fan import Fan
from .fan_strip import fan_strip
from .graph_plot import graph_plot
from .latent_plot import band_plot, latent_path_plot
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
    "Fan",
    "PathCanvas",
    "Player",
    "band_plot",
    "bar_plot",
    "cloud_plot",
    "curve_plot",
    "distance_plot",
    "error_table",
    "explorer",
    "fan_strip",
    "graph_plot",
    "latent_path_plot",
    "motion_change_plot",
    "path_plot",
    "pose_strip",
    "rest_pose_plot",
    "schedule_plot",
    "show",
]
