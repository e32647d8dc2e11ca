"""The scene's tables (pydantic models), one class a TOML table; all values are SI after load."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from tledface.errors import InputError
from tledface.scene.base import Table
from tledface.scene.boundary_tables import Boundary, FixedSpec, SurfaceSpec
from tledface.scene.fibres import Fibre
from tledface.scene.fields import (
    Activation,
    CheckpointEvery,
    Gravity,
    LongStretch,
    MassScaling,
    MaterialField,
    Name,
    Paths,
    Positive,
    Pressure,
    Rate,
    Scale,
    Stretch,
    Subcycling,
    Time,
    TimeStep,
)
from tledface.scene.geometry_tables import VOLUMES, Geometry, Layer
from tledface.schedule import Constant

__all__ = [
    "Boundary",
    "FixedSpec",
    "Geometry",
    "Layer",
    "MuscleSpec",
    "Output",
    "SceneTables",
    "Solver",
    "SurfaceSpec",
    "Table",
    "VolumeSpec",
]


class MuscleSpec(Table):
    """A muscle: its closed surfaces, fibre direction, strength and activation."""

    name: Name = Field(examples=["frontalis"])
    surfaces: Paths = Field(examples=[["frontalis_l.obj"]])
    fibre: Fibre = Field(
        description="fibre direction, or how the field of fibres follows from each surface",
        examples=[[0, 0, 1]],
    )
    sigma_act: Pressure = Field(description="active stress at full activation", examples=["5 MPa"])
    sigma_pas: Pressure | None = Field(
        default=None, description="passive fibre stress; sigma_act if left out"
    )
    law: Literal["tension_length", "tension_length_printed", "calcium"] = Field(
        default="tension_length",
        description="fibre law; for calcium the activation is the calcium level",
    )
    lambda_opt: Stretch = Field(default=1.0, description="stretch of the greatest active stress")
    lambda_pas: LongStretch = Field(
        default=1.2, description="stretch above which passive fibre stress is linear"
    )
    material: MaterialField = Field(examples=['{ model = "neo_hookean", ... }'])
    activation: Activation = Field(
        default=Constant(0.0), description="activation (0 to 1) over time", validate_default=False
    )

    @model_validator(mode="after")
    def _passive_follows_active(self) -> MuscleSpec:
        if self.sigma_pas is None and self.law != "calcium":
            object.__setattr__(self, "sigma_pas", self.sigma_act)
        return self


class VolumeSpec(Table):
    """A passive tissue in closed surfaces: a tendon sheet, a pad of fat, cartilage."""

    name: Name = Field(examples=["galea"])
    surfaces: Paths = Field(examples=[["galea.ply"]])
    material: MaterialField = Field(examples=['{ model = "neo_hookean", ... }'])


class Solver(Table):
    """Time integration."""

    duration: Time = Field(description="time that the run covers", examples=["50 ms"])
    dt: TimeStep = Field(default="auto", description="time step; auto keeps below its bound")
    damping: Rate = Field(default=0.0, description="mass-proportional damping")
    hourglass: Literal["physical", "joldes"] = Field(default="physical")
    hourglass_kappa: Positive | None = Field(
        default=None, description='coefficient of hourglass = "joldes"'
    )
    mass_scaling: MassScaling = Field(
        default=1.0,
        description="all masses are multiplied by this; or { dt = time }: only elements that do "
        "not allow this time step are made heavier",
    )
    time_scaling: Scale = Field(
        default=1.0,
        description="activations are played this many times faster; duration, activation and "
        "output are in the time of the playback",
    )
    subcycling: Subcycling = Field(
        default=False,
        description="each part takes the step that its tissue allows; dt is the longest, of 2, 4, "
        "8 or 16 shortest ones: true chooses",
    )
    precision: Literal["single", "double"] = Field(default="single")
    gravity: Gravity = Field(default=(0.0, 0.0, 0.0), description="acceleration of gravity")

    @model_validator(mode="after")
    def _kappa_is_of_joldes(self) -> Solver:
        if self.hourglass_kappa is not None and self.hourglass != "joldes":
            raise InputError(
                f'hourglass_kappa: got {self.hourglass_kappa!r} with hourglass = "physical", which '
                'has none; allowed: leave it out, or hourglass = "joldes"'
            )
        return self


class Output(Table):
    """What a run writes."""

    fps: Positive = Field(default=200.0, description="frames for each second of duration")
    checkpoint_every: CheckpointEvery = Field(
        default="auto",
        description="time between checkpoints; auto: one a minute of the run",
    )


class SceneTables(Table):
    """The whole scene file."""

    schema_version: Literal[1] = Field(
        alias="schema", description="version of this format", examples=[1]
    )
    units: str = Field(
        description="unit of bare lengths and of the surface files: m, cm, mm or um",
        examples=["mm"],
    )
    geometry: Geometry = Field(examples=["{ ... }"])
    layers: list[Layer] = Field(description="from the outer skin inwards", examples=["[[layers]]"])
    muscles: list[MuscleSpec] = Field(default=[])
    volumes: list[VolumeSpec] = Field(
        default=[], description="passive tissues in surfaces of their own"
    )
    layer_bending: Literal["section", "blended"] = Field(
        default="section",
        description="bending stiffness of a voxel with layers: of its section, or of the mean "
        "stiffness (as the published models do)",
    )
    surfaces: list[SurfaceSpec] = Field(
        default=[], description="more surfaces that follow the tissue, to be shown"
    )
    boundary: Boundary = Field(default_factory=Boundary)
    solver: Solver = Field(examples=["{ ... }"])
    output: Output = Field(default=Output())

    @property
    def parts(self) -> list[MuscleSpec | VolumeSpec]:
        """Tissues that fill surfaces of their own: muscles, then volumes."""
        return [*self.muscles, *self.volumes]

    @field_validator("layers")
    @classmethod
    def _last_takes_the_rest(cls, layers: list[Layer], info: ValidationInfo) -> list[Layer]:
        if not layers:
            raise InputError("got []; allowed: at least one [[layers]]")
        # A layer that an image's labels hold needs no depth.
        geometry = info.data.get("geometry")
        labelled = geometry.labels.layers if geometry and geometry.labels else {}
        by_depth = [index for index, layer in enumerate(layers) if layer.name not in labelled]
        last = by_depth[-1] if by_depth else len(layers) - 1
        for index in by_depth[:-1]:
            if layers[index].thickness is None:
                raise InputError(
                    f"layers[{index}].thickness: missing on {layers[index].name!r}; allowed: a "
                    "length on all layers but the last, as 1.8"
                )
        rest = layers[last].model_copy(update={"thickness": None})
        return [*layers[:last], rest, *layers[last + 1 :]]

    @model_validator(mode="after")
    def _names_are_unique(self) -> SceneTables:
        seen: set[str] = set()
        for name in [part.name for part in (*self.layers, *self.parts)]:
            if name in seen:
                raise InputError(
                    f"name {name!r} is used twice; allowed: one layer, muscle or volume for each "
                    "name"
                )
            seen.add(name)
        shown = [surface.name for surface in self.surfaces]
        for name in shown:
            if shown.count(name) > 1 or name == "skin":
                raise InputError(
                    f"surfaces: name {name!r} is used twice; allowed: one surface for each name, "
                    'and "skin" is that of [geometry]'
                )
        for number, attachment in enumerate(self.boundary.attachments):
            names = [muscle.name for muscle in self.muscles]
            if attachment.muscle not in names:
                raise InputError(
                    f"boundary.attachments[{number}].muscle: got {attachment.muscle!r}; allowed: "
                    f"{', '.join(names) or 'a muscle of the scene, which has none'}"
                )
        return self

    @model_validator(mode="after")
    def _volumes_have_a_source(self) -> SceneTables:
        labels = self.geometry.labels
        names = {"layers": [x.name for x in self.layers], "muscles": [x.name for x in self.muscles]}
        for kind in ("layers", "muscles"):
            for name in getattr(labels, kind, {}):
                if name not in names[kind]:
                    raise InputError(
                        f"geometry.labels.{kind}: got {name!r}; allowed: names of [[{kind}]], "
                        f"which has {', '.join(names[kind]) or 'none'}"
                    )
        for index, muscle in enumerate(self.muscles):
            if not muscle.surfaces and muscle.name not in getattr(labels, "muscles", {}):
                raise InputError(
                    f"muscles[{index}].surfaces: got []; allowed: at least one surface file, as "
                    '["left.obj"]'
                )
        for index, volume in enumerate(self.volumes):
            if not volume.surfaces:
                raise InputError(
                    f"volumes[{index}].surfaces: got []; allowed: at least one surface file, as "
                    '["galea.ply"]'
                )
        known = [*VOLUMES, *(part.name for part in self.parts), *names["layers"]]
        for item in self.geometry.priority:
            if item not in known:
                raise InputError(f"geometry.priority: got {item!r}; allowed: {', '.join(known)}")
        return self
