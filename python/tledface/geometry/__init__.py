"""Closed surfaces and their voxels: reading, checking, sampling."""

from tledface.geometry.fibres import long_axes
from tledface.geometry.memory import available_memory, check_memory
from tledface.geometry.surfaces import SurfaceFile, read_surface
from tledface.geometry.voxels import VoxelSet, section_ratio, voxelise

__all__ = [
    "SurfaceFile",
    "VoxelSet",
    "available_memory",
    "check_memory",
    "long_axes",
    "read_surface",
    "section_ratio",
    "voxelise",
]
