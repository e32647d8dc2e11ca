"""Scene files: TOML tables checked and turned into SI values, ready to be built into a model."""

from tledface.scene.load import Scene
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
    "Boundary",
    "FixedSpec",
    "Geometry",
    "Layer",
    "MuscleSpec",
    "Output",
    "Scene",
    "Solver",
    "template_text",
    "write_template",
]
