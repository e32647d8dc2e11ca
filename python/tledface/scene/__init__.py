"""Scene files: TOML tables checked and turned into SI values, ready to be built into a model."""

from tledface.scene.geometry_tables import ThicknessField
from tledface.scene.load import MODEL_ENDINGS, Scene
from tledface.scene.tables import (
    Boundary,
    FixedSpec,
    Geometry,
    Layer,
    MuscleSpec,
    Output,
    Solver,
)
from tledface.scene.template import template_text, write_template

__all__ = [
    "MODEL_ENDINGS",
    "Boundary",
    "FixedSpec",
    "Geometry",
    "Layer",
    "MuscleSpec",
    "Output",
    "Scene",
    "Solver",
    "ThicknessField",
    "template_text",
    "write_template",
]
