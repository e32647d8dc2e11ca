"""The scene's tables of geometry: volumes, how they are sampled, and the skin's layers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    PlainValidator,
    PrivateAttr,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from tledface import units
from tledface.errors import InputError
from tledface.scene.base import Table
from tledface.scene.fields import (
    LENGTH_SCHEMA,
    PATH_SCHEMA,
    Box,
    Length,
    MaterialField,
    Name,
    Outer,
    Paths,
    SurfacePath,
    UnitFraction,
    Vector,
    VoxelSize,
    known_keys,
    read_length,
    read_path,
    read_point,
)

__all__ = ["DepthIn", "Geometry", "Labels", "Layer", "ThicknessField"]

VOLUMES = ("bones", "muscles", "layers")
CHANNELS = ("grey", "red", "green", "blue")


@dataclass(frozen=True)
class ThicknessField:
    """A layer's thickness over the skin, one value per vertex of its file.

    Attributes:
        vertex: Name of a vertex property of the skin's PLY file, in the scene's units.
        file: A file with one value per vertex, in the scene's units (.npy, or text).
        painted: Thickness (m) where the skin's vertex colour is 0 and where it is full.
        channel: Of the colour: grey (the mean of all three), red, green or blue.
    """

    vertex: str | None = None
    file: Path | None = None
    painted: tuple[float, float] | None = None
    channel: str = "grey"


def _read_thickness(value: Any, info: ValidationInfo) -> float | ThicknessField:
    if not isinstance(value, dict):
        return read_length(value, info)
    what = (
        'a length greater than 0, { vertex = "PROPERTY" }, { file = "dermis.npy" }, or '
        '{ painted = [0.8, 2.4], channel = "red" }'
    )
    known_keys(value, ["vertex", "file", "painted", "channel"])
    kinds = [key for key in ("vertex", "file", "painted") if key in value]
    if len(kinds) != 1 or ("channel" in value and kinds != ["painted"]):
        raise InputError(f"got {value!r}; allowed: {what}")
    if kinds == ["file"]:
        return ThicknessField(file=read_path(value["file"], info))
    if kinds == ["vertex"]:
        if not isinstance(value["vertex"], str) or not value["vertex"]:
            raise InputError(f"got {value!r}; allowed: {what}")
        return ThicknessField(vertex=value["vertex"])
    ends, channel = value["painted"], value.get("channel", "grey")
    if not isinstance(ends, list) or len(ends) != 2:
        raise InputError(f"got {value!r}; allowed: {what}")
    if channel not in CHANNELS:
        raise InputError(f"channel: got {channel!r}; allowed: {', '.join(CHANNELS)}")
    low, high = (
        units.bounded(read_point([end, 0, 0], info)[0], at_least=0.0, shown=end, unit="m")
        for end in ends
    )
    if not max(low, high) > 0.0:
        raise InputError(f"painted: got {ends!r}; allowed: lengths of which one is above 0")
    return ThicknessField(painted=(low, high), channel=channel)


def _read_labels(value: Any, info: ValidationInfo) -> list[int]:
    items = [value] if isinstance(value, int) else value
    if (
        not isinstance(items, list)
        or not items
        or not all(isinstance(item, int) and not isinstance(item, bool) for item in items)
    ):
        raise InputError(f"got {value!r}; allowed: a label (a whole number) or a list of them")
    return items


def _read_spacing(value: Any, info: ValidationInfo) -> Vector:
    steps = read_point(value, info)
    for step in steps:
        units.bounded(step, above=0.0, shown=value, unit="m")
    return steps


def _read_priority(value: Any, info: ValidationInfo) -> list[str]:
    if (
        not isinstance(value, list)
        or not value
        or not all(isinstance(item, str) for item in value)
        or len(set(value)) < len(value)
    ):
        raise InputError(
            f"got {value!r}; allowed: a list without repeats of {', '.join(VOLUMES)} and names of "
            "muscles and layers, as ['muscles', 'bones', 'layers']"
        )
    return list(value)


_LABELS_SCHEMA: Mapping[str, Any] = {
    "anyOf": [
        {"type": "integer"},
        {"type": "array", "items": {"type": "integer"}, "minItems": 1},
    ]
}
POINT_SCHEMA = {"type": "array", "items": LENGTH_SCHEMA, "minItems": 3, "maxItems": 3}
Thickness = Annotated[
    float | ThicknessField,
    PlainValidator(_read_thickness),
    WithJsonSchema(
        {
            "anyOf": [
                *LENGTH_SCHEMA["anyOf"],
                {
                    "type": "object",
                    "properties": {
                        "vertex": {"type": "string"},
                        "file": PATH_SCHEMA,
                        "painted": {
                            "type": "array",
                            "items": LENGTH_SCHEMA,
                            "minItems": 2,
                            "maxItems": 2,
                        },
                        "channel": {"enum": list(CHANNELS), "default": "grey"},
                    },
                    "additionalProperties": False,
                },
            ]
        }
    ),
]
LabelList = Annotated[list[int], PlainValidator(_read_labels), WithJsonSchema(dict(_LABELS_SCHEMA))]
Spacing = Annotated[Vector, PlainValidator(_read_spacing), WithJsonSchema(POINT_SCHEMA)]
Point = Annotated[Vector, PlainValidator(read_point), WithJsonSchema(POINT_SCHEMA)]
Priority = Annotated[
    list[str],
    PlainValidator(_read_priority),
    WithJsonSchema({"type": "array", "items": {"type": "string"}, "minItems": 1}),
]


class DepthIn(Table):
    """A box in which tissue is kept down to a depth of its own."""

    box: Box = Field(examples=[[[0, 0, 0], [60, 60, 1]]])
    depth: Length = Field(examples=[4.7])


class Labels(Table):
    """A labelled voxel image and which of its labels are what."""

    file: SurfacePath = Field(
        description="NIfTI (.nii, .nii.gz) or NumPy (.npy, .npz) image", examples=["head.nii.gz"]
    )
    skin: LabelList | None = Field(
        default=None, description="labels within the skin; all but 0 if left out"
    )
    bones: list[LabelList] = Field(default=[], description="labels that hold no tissue, by bone")
    layers: dict[str, LabelList] = Field(
        default={}, description="labels of layers, by the layer's name, whatever their depth"
    )
    muscles: dict[str, LabelList] = Field(
        default={}, description="labels of muscles, by the muscle's name"
    )
    spacing: Spacing | None = Field(
        default=None, description="voxel size of a NumPy image", examples=[[0.5, 0.5, 0.5]]
    )
    origin: Point | None = Field(
        default=None, description="centre of the first voxel of a NumPy image"
    )
    surface: Literal["smooth", "voxels"] = Field(
        default="smooth",
        description="the labels' boundaries, which depth is measured from and which are shown: "
        "smoothed, or the voxels' own faces",
    )


class Geometry(Table):
    """Closed volumes in one frame and how they are sampled."""

    skin: SurfacePath | None = Field(
        default=None,
        description="the outer closed surface; tissue is inside it. Needed unless labels has it",
        examples=["skin.stl"],
    )
    bones: Paths = Field(default=[], description="closed surfaces that hold no tissue")
    labels: Labels | None = Field(default=None, description="a labelled voxel image with volumes")
    holes: Literal["refuse", "close"] = Field(
        default="refuse",
        description="surfaces with holes of more than a tenth of their size around: refused, or "
        "closed and reported",
    )
    voxel: VoxelSize = Field(description="voxel size, one length or three", examples=[0.5])
    samples: Annotated[int, Field(ge=1, le=16)] = Field(
        default=4, description="samples along each voxel edge"
    )
    priority: Priority = Field(
        default=["bones", "muscles", "layers"],
        description="which volume has a place where several overlap, the first first; names of "
        "muscles and layers may stand in it",
    )
    region: Box | None = Field(default=None, description="tissue is kept only in this box")
    depth: Length | None = Field(
        default=None, description="tissue is kept only nearer than this to the skin surface"
    )
    depth_in: list[DepthIn] = Field(default=[], description="boxes with another depth")
    fill: UnitFraction = Field(
        default=0.5, description="a voxel is kept if its tissue fraction is at least this"
    )
    partial: Literal["full", "scaled", "bone-full"] = Field(
        default="full",
        description="density and stiffness of partly filled voxels: as if full, scaled by the "
        "tissue fraction, or scaled with what lies in bone counted as tissue",
    )
    largest_only: bool = Field(
        default=True, description="only the largest connected part of the voxels is kept"
    )
    min_neighbours: Annotated[int, Field(ge=0, le=6)] = Field(
        default=3, description="voxels that hang on by fewer faces are left out"
    )
    behind_bone: Annotated[float, Field(ge=-1, le=1)] | None = Field(
        default=None,
        description="voxels are left out where the cosine between the directions away from the "
        "nearest bone and towards the skin is below this",
    )
    behind_bone_in: Outer = Field(default="all", description="boxes that behind_bone applies to")
    outer: Outer = Field(
        default="all",
        description="skin faces that layers are measured from: all, or those with their centroid "
        "in one of these boxes",
    )
    _unit_scale: float = PrivateAttr(default=1.0)

    @property
    def unit_scale(self) -> float:
        """Metres in one unit of the surface files."""
        return self._unit_scale

    def model_post_init(self, context: Any) -> None:
        """Take the unit of the surface files from the scene's ``units``."""
        self._unit_scale = float((context or {}).get("length", 1.0))

    @model_validator(mode="after")
    def _needs_a_skin(self) -> Geometry:
        if self.skin is None and self.labels is None:
            raise InputError(
                'skin: key missing; give it, as skin = "skin.stl", or a labelled image, as '
                '[geometry.labels] with file = "head.nii.gz"'
            )
        if self.skin is not None and self.labels is not None and self.labels.skin is not None:
            raise InputError(
                f"labels.skin: got {self.labels.skin!r} beside skin = {str(self.skin)!r}; allowed: "
                "one of the two"
            )
        return self


class Layer(Table):
    """A skin layer; thickness None takes what is left inwards."""

    name: Name = Field(examples=["dermis"])
    thickness: Thickness | None = Field(
        default=None,
        description="one length, or a value per skin vertex; leave it out for the last layer, "
        "which takes the rest",
    )
    material: MaterialField = Field(examples=['{ model = "neo_hookean", ... }'])
