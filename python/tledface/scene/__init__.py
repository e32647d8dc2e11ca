"""Scene files: TOML tables checked and turned into SI values, ready to be built into a model."""

from tledface.scene.boundary_tables import (
    AttachmentSpec,
    Boundary,
    CutSpec,
    FixedSpec,
    LigamentSpec,
    SlidingSpec,
    SurfaceSpec,
    SymmetrySpec,
)
from tledface.scene.geometry_tables import ThicknessField
from tledface.scene.load import MODEL_ENDINGS, Scene
from tledface.scene.tables import Geometry, Layer, MuscleSpec, Output, Solver, VolumeSpec
from tledface.scene.template import template_text, write_template

__all__ = [
    "MODEL_ENDINGS",
    "AttachmentSpec",
    "Boundary",
    "CutSpec",
    "FixedSpec",
    "Geometry",
    "Layer",
    "LigamentSpec",
    "MuscleSpec",
    "Output",
    "Scene",
    "SlidingSpec",
    "Solver",
    "SurfaceSpec",
    "SymmetrySpec",
    "ThicknessField",
    "VolumeSpec",
    "template_text",
    "write_template",
]
