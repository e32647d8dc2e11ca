"""The model file: a voxel model in HDF5, SI units.

Nodes and elements are not stored: they follow from the cells (see docs/reference/model-file.md
for the layout). A file is written under a temporary name and renamed when complete.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tledface.conditions import BodyForce, Prescribed, Pressure
from tledface.constitutive import Material, material
from tledface.errors import InputError
from tledface.io._atomic import atomic_path
from tledface.model import Model
from tledface.surface import BoundSurface

__all__ = ["FORMAT", "VERSION", "load_model", "read_model", "save_model", "write_model"]

FORMAT = "tledface model"
VERSION = 1
UNITS = "m kg s Pa"

_COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


def save_model(model: Model, path: str | Path) -> None:
    """Write a model.

    Args:
        model: The model.
        path: The file to write; an existing one is replaced once the new one is complete.

    Prescribed motion, body forces and pressures are stored where they are numbers.

    Raises:
        InputError: the folder does not exist or is not writable, or a condition is a callable,
            which no file can hold.
    """
    with atomic_path(Path(path), "model file") as part, h5py.File(part, "w") as file:
        write_model(model, file)


def write_model(model: Model, file: h5py.Group) -> None:
    """Write a model into an open file or group; see `save_model`."""
    _refuse_callables(model)
    file.attrs["format"] = FORMAT
    file.attrs["version"] = VERSION
    file.attrs["units"] = UNITS
    for name in ("voxel", "origin", "gravity"):
        file.attrs[name] = getattr(model, name)
    for name in ("cells", "fractions", "fixed"):
        file.create_dataset(name, data=getattr(model, name), **_COMPRESSION)
    if model.section_ratio is not None:
        for name in ("section_ratio", "layer_normal"):
            file.create_dataset(name, data=getattr(model, name), **_COMPRESSION)
    if model.fill is not None:
        file.create_dataset("fill", data=model.fill, **_COMPRESSION)
    tissues = zip(model.tissues, model.tissue_materials, strict=True)
    for number, (name, law) in enumerate(tissues):
        group = file.create_group(f"tissues/{number}")
        group.attrs.update({"name": name, "model": law.model, "density": law.density})
        group.create_group("parameters").attrs.update(law.parameters)
        group.create_group("options").attrs.update(law.options)
        group.create_group("directions").attrs.update(law.directions)
        if law.prony:
            group.attrs["prony"] = law.prony
        if law.pretension is not None:
            group.create_group("pretension").attrs.update(asdict(law.pretension))
    for number, muscle in enumerate(model.muscles):
        group = file.create_group(f"muscles/{number}")
        for name in ("name", "law", "sigma_act", "sigma_pas", "lambda_opt", "lambda_pas"):
            group.attrs[name] = getattr(muscle, name)
        for name in ("elements", "fibre", "weight"):
            group.create_dataset(name, data=getattr(muscle, name), **_COMPRESSION)
    _save_conditions(model, file)
    for number, (name, surface) in enumerate(model.surfaces.items()):
        group = file.create_group(f"surfaces/{number}")
        group.attrs["name"] = name
        for key in ("vertices", "faces", "element", "local"):
            group.create_dataset(key, data=getattr(surface, key), **_COMPRESSION)


def _refuse_callables(model: Model) -> None:
    for method, values in (
        ("prescribe", [record.value for record in model.prescribed]),
        ("body_force", [load.force for load in model.body_forces]),
        ("pressure", [pressure.value for pressure in model.pressures]),
    ):
        if any(callable(value) for value in values):
            raise InputError(
                f"model file: a function given to Model.{method} cannot be saved; save the model "
                f"first and call {method} on the loaded one"
            )


def _save_conditions(model: Model, file: h5py.Group) -> None:
    for number, record in enumerate(model.prescribed):
        group = file.create_group(f"prescribed/{number}")
        group.attrs["component"] = record.component
        group.create_dataset("nodes", data=record.nodes, **_COMPRESSION)
        group["value"] = record.value
    for number, load in enumerate(model.body_forces):
        group = file.create_group(f"body_forces/{number}")
        group.create_dataset("elements", data=load.elements, **_COMPRESSION)
        group["force"] = load.force
    for number, pressure in enumerate(model.pressures):
        group = file.create_group(f"pressures/{number}")
        group.create_dataset("faces", data=pressure.faces, **_COMPRESSION)
        group["value"] = pressure.value


def _read_conditions(model: Model, file: h5py.Group) -> None:
    for group in _numbered(file, "prescribed"):
        nodes, value = group["nodes"][()].astype(np.int64), group["value"][()]
        by_node = np.ndim(value) > 0
        component = int(group.attrs["component"])
        model.prescribed.append(
            Prescribed(nodes, component, value if by_node else float(value), by_node)
        )
    for group in _numbered(file, "body_forces"):
        elements = group["elements"][()].astype(np.int64)
        model.body_forces.append(BodyForce(elements, group["force"][()]))
    for group in _numbered(file, "pressures"):
        faces = group["faces"][()].astype(np.int32)
        model.pressures.append(Pressure(faces, float(group["value"][()])))


def load_model(path: str | Path) -> Model:
    """Read a model written by `save_model`.

    Raises:
        InputError: no such file, not a model file, a version this tledface does not know, or a
            file that is damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"model file {path}: no such file")
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise InputError(
            f"model file {path}: not an HDF5 file, or cut short; build the model again"
        ) from None
    with file:
        if file.attrs.get("format") != FORMAT:
            raise InputError(
                f"model file {path}: an HDF5 file but not a tledface model; "
                "`tledface build SCENE -o MODEL.h5` makes one"
            )
        version = file.attrs.get("version")
        if version != VERSION:
            raise InputError(
                f"model file {path}: version {version}, this tledface reads version {VERSION}; "
                "build the model again"
            )
        try:
            return read_model(file)
        except InputError as error:
            raise InputError(f"model file {path}: {error}") from None
        except (KeyError, OSError, TypeError, ValueError, IndexError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"model file {path}: damaged ({reason}); build the model again"
            ) from None


def read_model(file: h5py.Group) -> Model:
    """Read the model of an open file or group, bit for bit as it was written.

    Raises InputError, KeyError, OSError, TypeError, ValueError or IndexError for a damaged one.
    """
    tissues = _numbered(file, "tissues")
    layered = "section_ratio" in file
    model = Model.from_voxels(
        file.attrs["voxel"],
        file.attrs["origin"],
        file["cells"][()],
        [str(group.attrs["name"]) for group in tissues],
        [_material(group) for group in tissues],
        file["fractions"][()],
        section_ratio=file["section_ratio"][()] if layered else None,
        layer_normal=file["layer_normal"][()] if layered else None,
        fill=file["fill"][()] if "fill" in file else None,
        surfaces={},
    )
    model.gravity = file.attrs["gravity"]
    fixed = file["fixed"][()].astype(bool)
    if fixed.shape != model.fixed.shape:
        raise InputError(f"fixed has shape {fixed.shape}, the cells give {model.fixed.shape}")
    model.fixed[:] = fixed
    for group in _numbered(file, "muscles"):
        where = np.zeros(model.n_elements, dtype=bool)
        where[group["elements"][()]] = True
        muscle = model.add_muscle(
            str(group.attrs["name"]),
            where,
            group["fibre"][()],
            weight=group["weight"][()],
            law=str(group.attrs["law"]),
            **{
                key: float(group.attrs[key])
                for key in ("sigma_act", "sigma_pas", "lambda_opt", "lambda_pas")
            },
        )
        # Normalising a unit vector again may move its last bit, and a restart would differ.
        muscle.fibre[:] = group["fibre"][()]
    _read_conditions(model, file)
    for group in _numbered(file, "surfaces"):
        element = group["element"][()]
        model.surfaces[str(group.attrs["name"])] = BoundSurface(
            group["vertices"][()],
            group["faces"][()],
            element,
            group["local"][()],
            model.elements[element],
        )
    return model


def _numbered(file: h5py.File, name: str) -> list[h5py.Group]:
    return [file[name][str(n)] for n in range(len(file[name]))] if name in file else []


def _material(group: h5py.Group) -> Material:
    parameters = {key: float(value) for key, value in group["parameters"].attrs.items()}
    options = {key: str(value) for key, value in group["options"].attrs.items()}
    more: dict[str, object] = {
        key: value.tolist() for key, value in group["directions"].attrs.items()
    }
    if "prony" in group.attrs:
        more["prony"] = group.attrs["prony"].tolist()
    if "pretension" in group:
        more["pretension"] = {
            key: value.tolist() for key, value in group["pretension"].attrs.items()
        }
    return material(
        str(group.attrs["model"]),
        density=float(group.attrs["density"]),
        **parameters,
        **options,
        **more,
    )
