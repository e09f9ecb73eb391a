"""Motions, skeletons, rotations, and the files that hold them."""

from .asf_amc import read_amc, read_asf
from .bvh import read_bvh, write_bvh
from .clip import Motion
from .files import read_motion
from .retarget import to_common
from .skeleton import Skeleton
from .skeletons import COMMON_JOINTS, common_indices, recognise

__all__ = [
    "COMMON_JOINTS",
    "Motion",
    "Skeleton",
    "common_indices",
    "read_amc",
    "read_asf",
    "read_bvh",
    "read_motion",
    "recognise",
    "to_common",
    "write_bvh",
]
