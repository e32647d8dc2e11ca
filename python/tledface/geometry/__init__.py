"""Closed surfaces, labelled images and their voxels: reading, checking, sampling."""

from tledface.geometry.cleaning import Cleaning
from tledface.geometry.fibres import fibre_field, long_axes, make_field, mean_fibres, read_curves
from tledface.geometry.labels import LabelImage, LabelVolume, read_labels
from tledface.geometry.memory import available_memory, check_memory
from tledface.geometry.polygon_files import read_polygons
from tledface.geometry.surfaces import SurfaceFile, read_surface
from tledface.geometry.voxels import Ranks, VoxelSet, outer_faces, section_ratio, voxelise

__all__ = [
    "Cleaning",
    "LabelImage",
    "LabelVolume",
    "Ranks",
    "SurfaceFile",
    "VoxelSet",
    "available_memory",
    "check_memory",
    "fibre_field",
    "long_axes",
    "make_field",
    "mean_fibres",
    "outer_faces",
    "read_curves",
    "read_labels",
    "read_polygons",
    "read_surface",
    "section_ratio",
    "voxelise",
]
