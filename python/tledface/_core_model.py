"""A model as the core takes it, and checks of a simulator's arrays."""

from __future__ import annotations

import reprlib
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface import _core
from tledface._frame import frame_origin
from tledface._model_checks import unlike
from tledface.conditions import prescribed_mask
from tledface.errors import InputError
from tledface.muscle import CALCIUM_BETA
from tledface.surface import HEX_CORNERS

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = [
    "HostMemory",
    "checked_field",
    "core_model",
    "core_sliding",
]


def core_sliding(model: Model) -> _core.SlidingNodes | None:
    """The sliding nodes of a model, their surfaces in the core's frame; None without any."""
    sliding = model.sliding
    if not len(sliding):
        return None
    core = _core.SlidingNodes()
    origin = frame_origin(model)
    for surface in sliding.surfaces:
        core.add_surface(surface.vertices - origin, surface.faces)
    core.set_nodes(sliding.nodes, sliding.surface, sliding.distance)
    if sliding.friction.any() or sliding.release.any():
        core.set_laws(sliding.friction, sliding.release.astype(np.uint8))
    core.set_moving(np.asarray(sliding.moving, dtype=np.int32))
    return core


# Corner 1 x + 2 y + 4 z of the core among the corners in VTK order.
_CORNERS_BY_BITS = np.argsort(HEX_CORNERS @ (1, 2, 4))


class HostMemory:
    """Memory of a simulator as a buffer that keeps the simulator alive."""

    def __init__(self, address: int, n_bytes: int, owner: object) -> None:
        self._owner = owner
        self.__array_interface__ = {
            "data": (address, False),
            "shape": (n_bytes,),
            "typestr": "|u1",
            "version": 3,
        }


def core_model(
    model: Model,
    *,
    density: NDArray[np.float64] | None = None,
    weightless: bool = False,
    muscles: bool = True,
) -> _core.VoxelModel:
    """The arrays of a model.

    Args:
        model: The model.
        density: (n_elem,) kg/m3 instead of the model's own.
        weightless: Leave gravity out.
        muscles: Whether to take the muscles along.
    """
    parameters = model.element_parameters()
    gx, gy, gz = (0.0 if weightless else float(g) for g in model.gravity)
    no_grid = np.empty((0, 3), dtype=np.int32)
    hx, hy, hz = (1.0, 1.0, 1.0) if model.is_conforming else (float(h) for h in model.voxel)
    core = _core.VoxelModel(
        voxel=(hx, hy, hz),
        cells=no_grid if model.is_conforming else model.cells,
        node_ijk=no_grid if model.is_conforming else model.node_ijk,
        mu=parameters["mu_base"],
        shear_modulus=parameters["mu"],
        bulk_modulus=parameters["bulk"],
        bulk_log=parameters["bulk_log"],
        bulk_quadratic=parameters["bulk_quadratic"],
        density=parameters["density"] if density is None else density,
        bending_modulus=parameters["bending_modulus"],
        fixed=(model.fixed | prescribed_mask(model)).astype(np.uint8),
        gravity=(gx, gy, gz),
    )
    if model.is_conforming:
        core.set_hexahedra(
            positions=model.nodes - frame_origin(model),
            corners=model.elements[:, _CORNERS_BY_BITS],
        )
    fill = model.fill
    for name, elements, rows in model.law_rows():
        core.add_law(name=name, elements=elements, rows=rows)
    for muscle in model.muscles if muscles else []:
        core.add_muscle(
            name=muscle.name,
            elements=muscle.elements,
            fibre=muscle.fibre,
            weight=muscle.weight if fill is None else muscle.weight * fill[muscle.elements],
            sigma_act=muscle.sigma_act,
            sigma_pas=muscle.sigma_pas,
            lambda_opt=muscle.lambda_opt,
            lambda_pas=muscle.lambda_pas,
            calcium=muscle.law == "calcium",
            beta=CALCIUM_BETA if muscle.law == "calcium" else 0.0,
            printed_passive=muscle.law == "tension_length_printed",
        )
    return core


def checked_field(name: str, values: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Finite float64 values of a shape; raises InputError."""
    try:
        field = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"{name}: got {reprlib.repr(values)}; allowed: finite values of shape {shape}"
        ) from None
    if field.shape != shape or not np.isfinite(field).all():
        raise InputError(
            f"{name}: got {unlike(field, shape_fits=field.shape == shape)}; allowed: finite values "
            f"of shape {shape}"
        )
    return field
