"""The scene's tables of bound nodes, ``[boundary]``, and of surfaces to show, ``[[surfaces]]``."""

from __future__ import annotations

import re
from typing import Any

from pydantic import Field, PrivateAttr, field_validator, model_validator

from tledface.errors import InputError
from tledface.scene.base import Table
from tledface.scene.boundary_fields import (
    Angle,
    Axis,
    Coefficient,
    Cosine,
    Direction,
    OpenBox,
    OpenBoxes,
    Point,
    Points,
    Position,
    Reach,
    Side,
)
from tledface.scene.fields import Activation, Components, Length, Name, SurfacePath
from tledface.schedule import Constant
from tledface.units import KINDS, unit_scale

__all__ = [
    "AttachmentSpec",
    "Boundary",
    "CutSpec",
    "FixedSpec",
    "LigamentSpec",
    "MotionSpec",
    "SlidingSpec",
    "SurfaceSpec",
    "SymmetrySpec",
]

_FILE_NAME = re.compile(r"[\w][\w .-]*")


class FixedSpec(Table):
    """Nodes in a box, held in the named components."""

    box: OpenBox = Field(examples=[[[0, 0, 0], [60, 60, 1]]])
    components: Components = Field(default="xyz", description="which components are held")


class CutSpec(Table):
    """Nodes on a face where the tissue was cut off, held."""

    side: Side = Field(
        description="which way the cut face looks: x-, x+, y-, y+, z- or z+", examples=["z+"]
    )
    at: Position | None = Field(
        default=None, description="where the cut is along that axis; the region's side if left out"
    )
    boxes: OpenBoxes = Field(default=[], description="only nodes in one of these boxes")
    components: Components = Field(default="xyz", description="which components are held")


class AttachmentSpec(Table):
    """Nodes of a muscle near a bone, held."""

    muscle: Name = Field(examples=["corrugator"])
    bone: Name = Field(default="bones", description='a bone of [geometry], or "bones": any')
    reach: Reach = Field(
        description="nodes of the muscle's voxels this near to the bone are held", examples=[1.0]
    )
    boxes: OpenBoxes = Field(default=[], description="only nodes in one of these boxes")


class LigamentSpec(Table):
    """Nodes near a point or a line, held."""

    name: Name = Field(examples=["supraorbital"])
    points: Points | None = Field(
        default=None, description="one point, or the corners of a line", examples=[[[0, 0, 4]]]
    )
    file: SurfacePath | None = Field(
        default=None,
        description="points and lines from a file: OBJ, or text with three numbers a line and an "
        "empty line between lines",
    )
    radius: Reach = Field(description="nodes this near are held", examples=[1.0])

    @model_validator(mode="after")
    def _one_source(self) -> LigamentSpec:
        if (self.points is None) == (self.file is None):
            given = "neither" if self.points is None else "both"
            raise InputError(f"points, file: got {given}; allowed: one of the two")
        return self


class SymmetrySpec(Table):
    """A plane that the body mirrors in: nodes on it stay on it."""

    axis: Axis = Field(description="the plane's normal", examples=["x"])
    at: Position = Field(default=0.0, description="where it is along that axis")


class SlidingSpec(Table):
    """Which of the outermost nodes slide on bone."""

    on: list[Name] = Field(default=["bones"], description='bones of [geometry], or "bones": all')
    facing: Cosine = Field(
        default=0.6,
        description="only where the bone's outward normal and the way to the skin have a cosine "
        "above this",
    )
    reach: Length | None = Field(
        default=None, description="only nodes this near to the bone; two voxels if left out"
    )
    boxes: OpenBoxes = Field(default=[], description="only nodes in one of these boxes")
    excluded: OpenBoxes = Field(default=[], description="no nodes in these boxes")
    held: bool = Field(default=False, description="these nodes are held instead of sliding")
    friction: Coefficient = Field(default=0.0, description="Coulomb's coefficient")
    release: bool = Field(default=False, description="nodes may leave the bone, not sink into it")


class MotionSpec(Table):
    """A bone that moves as a rigid body, and carries what slides on it."""

    bone: Name = Field(description="a bone of [geometry] that nodes slide on", examples=["jaw"])
    about: Point = Field(default=(0.0, 0.0, 0.0), description="a point of the axis of the turn")
    axis: Direction = Field(default=(1.0, 0.0, 0.0), description="its direction")
    degrees: Angle = Field(
        default=0.0, description="right-handed turn about the axis at a share of 1"
    )
    shift: Point = Field(default=(0.0, 0.0, 0.0), description="shift at a share of 1")
    share: Activation = Field(
        default=Constant(0.0),
        description="how much of it over time, 0 at first, as for an activation",
        validate_default=False,
    )


def _list_schema(schema: dict[str, Any]) -> None:
    names = {"type": "array", "items": {"type": "string"}, "description": "bones, as on"}
    schema["anyOf"].insert(0, names)


class Boundary(Table):
    """Held and sliding nodes; where several bind a node, in this order."""

    fixed: list[FixedSpec] = Field(default=[], description="boxes of nodes that are held")
    cuts: list[CutSpec] = Field(default=[], description="cut faces whose nodes are held")
    attachments: list[AttachmentSpec] = Field(
        default=[], description="muscles held where they meet a bone"
    )
    ligaments: list[LigamentSpec] = Field(
        default=[], description="points and lines whose nodes are held"
    )
    symmetry: list[SymmetrySpec] = Field(default=[], description="planes of symmetry")
    sliding: SlidingSpec | None = Field(
        default=None,
        description='nodes that slide on bone: ["bones"], or a table',
        json_schema_extra=_list_schema,
    )

    motions: list[MotionSpec] = Field(default=[], description="bones that move")

    @field_validator("sliding", mode="before")
    @classmethod
    def _names_are_a_table(cls, value: Any) -> Any:
        if isinstance(value, list):
            return {"on": value} if value else None
        if value is None or isinstance(value, dict | SlidingSpec):
            return value
        raise InputError(
            f'got {value!r}; allowed: a list of bones, as ["bones"], or a table, as '
            '{ on = ["bones"], facing = 0.6 }'
        )

    @field_validator("symmetry")
    @classmethod
    def _one_plane_an_axis(cls, planes: list[SymmetrySpec]) -> list[SymmetrySpec]:
        axes = [plane.axis for plane in planes]
        for axis in axes:
            if axes.count(axis) > 1:
                raise InputError(f"axis {axis!r} is used twice; allowed: one plane for each axis")
        return planes


class SurfaceSpec(Table):
    """A surface that follows the tissue, to be shown and exported."""

    name: Name = Field(examples=["face"])
    file: SurfacePath = Field(examples=["face.obj"])
    units: str | None = Field(
        default=None, description="unit of the file; the scene's if left out", examples=["mm"]
    )
    reach: Length | None = Field(
        default=None,
        description="vertices farther than this from the tissue stay at rest; if left out three "
        "voxels where [geometry] has a region, else none stay",
    )
    fade: Reach = Field(
        default=0.0, description="over this length beyond reach the movement fades out"
    )
    _scene_scale: float = PrivateAttr(default=1.0)

    @property
    def unit_scale(self) -> float:
        """Metres in one unit of the file."""
        return self._scene_scale if self.units is None else unit_scale(self.units)

    def model_post_init(self, context: Any) -> None:
        """Take the scene's unit where the surface has none of its own."""
        self._scene_scale = float((context or {}).get("length", 1.0))

    @field_validator("name")
    @classmethod
    def _is_a_file_name(cls, name: str) -> str:
        if not _FILE_NAME.fullmatch(name):
            raise InputError(
                f"got {name!r}; allowed: letters, digits, spaces and _ . - (a run names the "
                "surface's file so)"
            )
        return name

    @field_validator("units")
    @classmethod
    def _is_a_length(cls, unit: str | None) -> str | None:
        if unit is not None and unit not in KINDS["length"].units:
            raise InputError(f"got {unit!r}; allowed: one of {', '.join(KINDS['length'].units)}")
        return unit
