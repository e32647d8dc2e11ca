"""Fibre directions in muscles, from the shape of their surfaces or from drawn curves."""

from tledface.geometry.fibres.axes import long_axes
from tledface.geometry.fibres.curves import CURVE_FORMATS, read_curves
from tledface.geometry.fibres.field import (
    FibreField,
    VoxelFibres,
    fibre_field,
    make_field,
    mean_fibres,
)
from tledface.geometry.fibres.nurbs import NurbsField, fit_volume
from tledface.geometry.fibres.potential import MuscleGrid

__all__ = [
    "CURVE_FORMATS",
    "FibreField",
    "MuscleGrid",
    "NurbsField",
    "VoxelFibres",
    "fibre_field",
    "fit_volume",
    "long_axes",
    "make_field",
    "mean_fibres",
    "read_curves",
]
