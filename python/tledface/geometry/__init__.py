"""Closed surfaces, labelled images and their voxels: reading, checking, sampling."""

from tledface.geometry.cleaning import Cleaning
from tledface.geometry.fibres import long_axes
from tledface.geometry.labels import LabelImage, LabelVolume, read_labels
from tledface.geometry.memory import available_memory, check_memory
from tledface.geometry.surfaces import SurfaceFile, read_surface
from tledface.geometry.voxels import Ranks, VoxelSet, section_ratio, voxelise

__all__ = [
    "Cleaning",
    "LabelImage",
    "LabelVolume",
    "Ranks",
    "SurfaceFile",
    "VoxelSet",
    "available_memory",
    "check_memory",
    "long_axes",
    "read_labels",
    "read_surface",
    "section_ratio",
    "voxelise",
]
