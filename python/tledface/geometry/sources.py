"""The volumes that a scene names, from surface files and labelled images, and their voxels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tledface import _core
from tledface.errors import InputError
from tledface.geometry.cleaning import Cleaning
from tledface.geometry.labels import LabelImage, LabelVolume, read_labels
from tledface.geometry.surfaces import SurfaceFile, read_surface
from tledface.geometry.vertex_fields import on_solid, painted, values_of_file, vertex_property
from tledface.geometry.voxels import Ranks, VoxelSet, voxelise
from tledface.scene import Scene, ThicknessField

__all__ = ["Sources", "read_sources", "sample"]

Volume = _core.Surface | LabelVolume


@dataclass(frozen=True, eq=False)
class Sources:
    """The volumes of a scene; those of a labelled image have a surface of the labels.

    Attributes:
        skin: The outer surface, also shown.
        bones: Surfaces without tissue.
        muscles: The surfaces of each muscle, then those of the scene's volumes.
        skin_volume, bone_volumes, muscle_volumes: The same for the sampler.
        layer_volumes: Layers that labels hold: index of the layer and volume.
        unit_scale: Metres in a unit of the surface files.
    """

    skin: SurfaceFile
    bones: list[SurfaceFile]
    muscles: list[list[SurfaceFile]]
    skin_volume: Volume
    bone_volumes: list[Volume]
    muscle_volumes: list[list[Volume]]
    layer_volumes: list[tuple[int, LabelVolume]]
    unit_scale: float

    @property
    def files(self) -> list[SurfaceFile]:
        """Every surface but those of label layers."""
        return [self.skin, *self.bones, *(s for surfaces in self.muscles for s in surfaces)]


def read_sources(scene: Scene) -> Sources:
    """Read every surface and labelled image of a scene.

    Raises InputError: a file that is missing or cannot be used, a label that no voxel has.
    """
    geometry, labels = scene.geometry, scene.geometry.labels
    smooth = labels is None or labels.surface == "smooth"
    image: LabelImage | None = None
    if labels is not None:
        image = read_labels(
            labels.file,
            unit_scale=geometry.unit_scale,
            spacing=labels.spacing,
            origin=labels.origin,
        )

    def labelled(members: list[int] | None, what: str) -> LabelVolume:
        assert image is not None
        return LabelVolume.of(image, members, what, smooth=smooth)

    def read(path: object) -> SurfaceFile:
        return read_surface(
            str(path),
            unit_scale=geometry.unit_scale,
            close_holes=geometry.holes == "close",
        )

    skin_volume: Volume
    if geometry.skin is not None:
        skin = read(geometry.skin)
        skin_volume = skin.solid
    else:
        assert labels is not None
        skin_volume = labelled(labels.skin, "skin")
        skin = skin_volume.surface
    bones = [read(path) for path in geometry.bones]
    bone_volumes: list[Volume] = [bone.solid for bone in bones]
    muscles = [[read(path) for path in part.surfaces] for part in scene.parts]
    muscle_volumes: list[list[Volume]] = [[s.solid for s in surfaces] for surfaces in muscles]
    layers = []
    if labels is not None:
        for number, members in enumerate(labels.bones):
            volume = labelled(members, f"bone {number}")
            bones.append(volume.surface)
            bone_volumes.append(volume)
        for index, muscle in enumerate(scene.muscles):
            if muscle.name in labels.muscles:
                volume = labelled(labels.muscles[muscle.name], f"muscle {muscle.name}")
                muscles[index].append(volume.surface)
                muscle_volumes[index].append(volume)
        for index, layer in enumerate(scene.layers):
            if layer.name in labels.layers:
                layers.append((index, labelled(labels.layers[layer.name], f"layer {layer.name}")))
    return Sources(
        skin, bones, muscles, skin_volume, bone_volumes, muscle_volumes, layers, geometry.unit_scale
    )


def sample(
    scene: Scene, sources: Sources, align: Sequence[float | None] = (None, None, None)
) -> VoxelSet:
    """Sample a scene's volumes into voxels; ``align`` as for `voxelise`.

    Columns of the result are the scene's layers, then the surfaces of the muscles in order.

    Raises InputError as `voxelise` does, or for a thickness that cannot be read.
    """
    geometry, layers = scene.geometry, scene.layers
    labelled = [index for index, _ in sources.layer_volumes]
    by_depth = [i for i in range(len(layers)) if i not in labelled] or [len(layers) - 1]
    muscles = [volume for volumes in sources.muscle_volumes for volume in volumes]
    parts = [*muscles, *(volume for _, volume in sources.layer_volumes)]
    order = geometry.priority
    order = [*order, *(kind for kind in ("bones", "muscles", "layers") if kind not in order)]

    def rank(name: str, kind: str) -> int:
        return order.index(name if name in order else kind)

    layer_ranks = [rank(layer.name, "layers") for layer in layers]
    muscle_ranks = [
        rank(part.name, "muscles")
        for part, volumes in zip(scene.parts, sources.muscle_volumes, strict=True)
        for _ in volumes
    ]
    ends, end = [], np.zeros(1)
    for index in by_depth[:-1]:
        end = end + _thickness(layers[index].thickness, layers[index].name, sources)
        ends.append(end)
    voxels = voxelise(
        sources.skin_volume,
        voxel=geometry.voxel,
        boundaries=ends,
        bones=sources.bone_volumes,
        muscles=parts,
        samples=geometry.samples,
        depth=geometry.depth,
        depth_in=[(spec.box, spec.depth) for spec in geometry.depth_in],
        region=geometry.region,
        outer=geometry.outer,
        fill=geometry.fill,
        partial=geometry.partial,
        ranks=Ranks(
            order.index("bones"),
            [*muscle_ranks, *(layer_ranks[index] for index in labelled)],
            [layer_ranks[index] for index in by_depth],
        ),
        clean=Cleaning(
            largest_only=geometry.largest_only,
            min_neighbours=geometry.min_neighbours,
            behind_bone=geometry.behind_bone,
            behind_bone_in=geometry.behind_bone_in,
        ),
        align=align,
    )
    muscle_columns = [len(layers) + number for number in range(len(muscles))]
    return _regrouped(voxels, [*by_depth, *muscle_columns, *labelled], len(layers) + len(muscles))


def _thickness(
    given: float | ThicknessField | None, layer: str, sources: Sources
) -> NDArray[np.float64]:
    """Return a layer's thickness, m: (1,) or one per vertex of the skin's surface."""
    if not isinstance(given, ThicknessField):
        return np.array([given], dtype=np.float64)
    skin = sources.skin
    if isinstance(sources.skin_volume, LabelVolume):
        raise InputError(
            f"layer {layer!r}: thickness by vertex needs a skin surface file; the skin comes from "
            f"{skin.path}; give one length, or skin = FILE"
        )
    scale = sources.unit_scale
    if given.painted is not None:
        low, high = given.painted
        values = low + painted(skin, given.channel) * (high - low)
    elif given.vertex is not None:
        values = vertex_property(skin, given.vertex) * scale
    else:
        assert given.file is not None
        values = values_of_file(skin, given.file) * scale
    if values.min() < 0.0 or not values.max() > 0.0:
        raise InputError(
            f"layer {layer!r}: thickness from {1e3 * values.min():.4g} to "
            f"{1e3 * values.max():.4g} mm; allowed: at least 0, somewhere above"
        )
    return on_solid(skin, values)


def _regrouped(voxels: VoxelSet, column_of: list[int], n_columns: int) -> VoxelSet:
    """Add columns that belong together; moments about one depth add up as fractions do."""
    merged: dict[str, Any] = {}
    for name in ("fractions", "first", "second"):
        values = getattr(voxels, name)
        merged[name] = np.zeros((len(values), n_columns))
        for column, target in enumerate(column_of):
            merged[name][:, target] += values[:, column]
    return replace(voxels, **merged)
