"""The model file: a voxel model in HDF5, SI units.

Nodes and elements are not stored: they follow from the cells (see docs/reference/model-file.md
for the layout). A file is written under a temporary name and renamed when complete.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tledface._model_checks import checked_fill
from tledface.conditions import BodyForce, Prescribed, Pressure
from tledface.constitutive import Material, material
from tledface.errors import InputError
from tledface.io._atomic import as_path, atomic_path
from tledface.io._hdf5 import opened
from tledface.io.model_surfaces import (
    COMPRESSION,
    numbered,
    read_groups,
    read_sliding,
    read_surfaces,
    write_groups,
    write_sliding,
    write_surfaces,
)
from tledface.model import Model
from tledface.motion import RigidMotion

__all__ = ["FORMAT", "VERSION", "load_model", "read_model", "save_model", "write_model"]

FORMAT = "tledface model"
VERSION = 2
# Version 1 had no sliding nodes, direction fields and meshes; what it holds reads as before.
READABLE = (1, 2)
UNITS = "m kg s Pa"


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
    target = as_path(path, "model file")
    with atomic_path(target, "model file") as part, opened(part, "w") as file:
        write_model(model, file)


def write_model(model: Model, file: h5py.Group) -> None:
    """Write a model into an open file or group; see `save_model`."""
    _refuse_callables(model)
    file.attrs["format"] = FORMAT
    # The first version that reads it rightly: before 2, direction fields and sliding nodes would be
    # passed over, and a mesh looked damaged.
    needs = model.is_conforming or bool(model.directions) or len(model.sliding) > 0
    file.attrs["version"] = VERSION if needs else 1
    file.attrs["units"] = UNITS
    grid = () if model.is_conforming else ("voxel", "origin")
    for name in (*grid, "gravity"):
        file.attrs[name] = getattr(model, name)
    mesh = ("nodes", "elements") if model.is_conforming else ("cells",)
    for name in (*mesh, "fractions", "fixed"):
        file.create_dataset(name, data=getattr(model, name), **COMPRESSION)
    if model.section_ratio is not None:
        for name in ("section_ratio", "layer_normal"):
            file.create_dataset(name, data=getattr(model, name), **COMPRESSION)
    if model.fill is not None:
        file.create_dataset("fill", data=model.fill, **COMPRESSION)
    tissues = zip(model.tissues, model.tissue_materials, strict=True)
    for number, (name, law) in enumerate(tissues):
        group = file.create_group(f"tissues/{number}")
        group.attrs.update({"name": name, "model": law.model, "density": law.density})
        group.create_group("parameters").attrs.update(law.parameters)
        group.create_group("options").attrs.update(law.options)
        group.create_group("directions").attrs.update(law.directions)
        for key, field in model.directions.get(name, {}).items():
            group.create_dataset(f"direction_fields/{key}", data=field, **COMPRESSION)
        if law.prony:
            group.attrs["prony"] = law.prony
        if law.pretension is not None:
            group.create_group("pretension").attrs.update(asdict(law.pretension))
    for number, muscle in enumerate(model.muscles):
        group = file.create_group(f"muscles/{number}")
        for name in ("name", "law", "sigma_act", "sigma_pas", "lambda_opt", "lambda_pas"):
            group.attrs[name] = getattr(muscle, name)
        for name in ("elements", "fibre", "weight"):
            group.create_dataset(name, data=getattr(muscle, name), **COMPRESSION)
    _save_conditions(model, file)
    write_sliding(model.sliding, file)
    write_groups(model.groups, file)
    write_surfaces(model.surfaces, file)
    if model.report:
        file["report"] = json.dumps(model.report, default=_plain)


def _refuse_callables(model: Model) -> None:
    kept = [s.motion for s in model.sliding.surfaces]
    motions = [
        m for m in kept if m is not None and not (isinstance(m, RigidMotion) and m.can_be_stored)
    ]
    for method, values in (
        ("prescribe", [record.value for record in model.prescribed]),
        ("body_force", [load.force for load in model.body_forces]),
        ("pressure", [pressure.value for pressure in model.pressures]),
        ("move_surface", motions),
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
        group.create_dataset("nodes", data=record.nodes, **COMPRESSION)
        group["value"] = record.value
    for number, load in enumerate(model.body_forces):
        group = file.create_group(f"body_forces/{number}")
        group.create_dataset("elements", data=load.elements, **COMPRESSION)
        group["force"] = load.force
    for number, pressure in enumerate(model.pressures):
        group = file.create_group(f"pressures/{number}")
        group.create_dataset("faces", data=pressure.faces, **COMPRESSION)
        group["value"] = pressure.value


def _read_conditions(model: Model, file: h5py.Group) -> None:
    for group in numbered(file, "prescribed"):
        nodes, value = group["nodes"][()].astype(np.int64), group["value"][()]
        by_node = np.ndim(value) > 0
        component = int(group.attrs["component"])
        model.prescribed.append(
            Prescribed(nodes, component, value if by_node else float(value), by_node)
        )
    for group in numbered(file, "body_forces"):
        elements = group["elements"][()].astype(np.int64)
        model.body_forces.append(BodyForce(elements, group["force"][()]))
    for group in numbered(file, "pressures"):
        faces = group["faces"][()].astype(np.int32)
        model.pressures.append(Pressure(faces, float(group["value"][()])))


def load_model(path: str | Path) -> Model:
    """Read a model written by `save_model`.

    Raises:
        InputError: no such file, not a model file, a version this tledface does not know, or a
            file that is damaged.
    """
    path = as_path(path, "model file")
    if path.is_dir():
        raise InputError(f"model file {path}: is a folder; give a model file (.h5)")
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
        if version not in READABLE:
            raise InputError(
                f"model file {path}: version {version}, this tledface reads versions "
                f"{READABLE[0]} to {READABLE[-1]}; build the model again"
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


def _direction_field(model: Model, tissue: str, name: str, field: Any) -> NDArray[np.float64]:
    known = model.tissue_materials[model.tissues.index(tissue)].direction_names()
    if name not in known:
        raise InputError(
            f"tissue {tissue!r} has no direction {name!r}; allowed: {', '.join(known)}"
        )
    if field.shape != (model.n_elements, 3) or not np.isfinite(field).all():
        raise InputError(
            f"direction {name!r} of {tissue!r} has shape {field.shape}; allowed: finite "
            f"({model.n_elements}, 3)"
        )
    result: NDArray[np.float64] = field
    return result


def read_model(file: h5py.Group) -> Model:
    """Read the model of an open file or group, bit for bit as it was written.

    Raises InputError, KeyError, OSError, TypeError, ValueError or IndexError for a damaged one.
    """
    model = _read_elements(file)
    for name, group in zip(model.tissues, numbered(file, "tissues"), strict=True):
        if "direction_fields" in group:
            # Not by set_directions: that would normalise again, which may move a last bit, and it
            # refuses a tissue whose elements have become another's since.
            model.directions[name] = {
                key: _direction_field(model, name, key, data[()])
                for key, data in group["direction_fields"].items()
            }
    model.gravity = file.attrs["gravity"]
    fixed = file["fixed"][()].astype(bool)
    if fixed.shape != model.fixed.shape:
        raise InputError(f"fixed has shape {fixed.shape}, the cells give {model.fixed.shape}")
    model.fixed[:] = fixed
    for group in numbered(file, "muscles"):
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
    model.sliding = read_sliding(file, model.n_nodes)
    model.groups = read_groups(file, model.n_nodes)
    voxel = None if model.is_conforming else model.voxel
    model.surfaces.update(read_surfaces(file, model.elements, voxel))
    if "report" in file:
        model.report = json.loads(file["report"].asstr()[()])
    return model


def _read_elements(file: h5py.Group) -> Model:
    groups = numbered(file, "tissues")
    tissues = [str(group.attrs["name"]) for group in groups]
    materials = [_material(group) for group in groups]
    fractions = file["fractions"][()]
    if "nodes" in file:
        mesh = Model.from_hexahedra(
            file["nodes"][()], file["elements"][()], tissues, materials, fractions
        )
        if "fill" in file:
            mesh.fill = checked_fill(file["fill"][()], mesh.n_elements)
        return mesh
    layered = "section_ratio" in file
    return Model.from_voxels(
        file.attrs["voxel"],
        file.attrs["origin"],
        file["cells"][()],
        tissues,
        materials,
        fractions,
        section_ratio=file["section_ratio"][()] if layered else None,
        layer_normal=file["layer_normal"][()] if layered else None,
        fill=file["fill"][()] if "fill" in file else None,
        surfaces={},
    )


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays as JSON has them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value)


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
