"""What a simulator gives back: displacements, forces, stresses, surfaces, device arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tledface import device as device_module
from tledface._core_model import HostMemory
from tledface._sampling import Sampling
from tledface.errors import InputError
from tledface.sliding import Sliding, tangential
from tledface.snapshot import von_mises_of

if TYPE_CHECKING:
    import trimesh

    from tledface.model import Where


class Results(Sampling):
    """The part of `Simulator` that reads its state."""

    _device: Any
    # Of the model when the simulator was made: (n_nodes, 3) fixed or prescribed, nodes that slide.
    _held: NDArray[np.bool_]
    _sliding: Sliding

    @property
    def u(self) -> NDArray[np.float64]:
        """Displacement, (n_nodes, 3) m, copied on access."""
        return np.asarray(self._core.displacement())

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocity half a step ago, (n_nodes, 3) m/s."""
        return np.asarray(self._core.velocity())

    @property
    def mass(self) -> NDArray[np.float64]:
        """Lumped nodal mass, (n_nodes,) kg, mass scaling included."""
        return np.asarray(self._core.node_masses())

    def reaction(self, where: Where) -> NDArray[np.float64]:
        """Force of the supports on the body, summed over nodes, (3,) N.

        Args:
            where: (n_nodes,) bool, or a function of the nodes (n_nodes, 3) that returns it.
                Components of them that are neither fixed nor prescribed add nothing.

        The forces of elements, loads and gravity on the nodes, with the sign turned; the inertia
        of prescribed nodes that move is left out. Of sliding nodes what their surfaces take: along
        the normals of the last step, and what friction holds.

        Raises:
            InputError: ``where`` selects no node, or none that is held.
        """
        mask = self.model._select(where, self.model.nodes, "reaction: where", "node")
        held = self._held & mask[:, None]
        sliding = self._sliding
        slides = mask[sliding.nodes]
        if not (held.any() or slides.any()):
            raise InputError("reaction: none of the selected nodes is fixed, prescribed or slides")
        force = self.internal_force() - self.external_force()
        on_surfaces = force - tangential(force, sliding, np.asarray(self._core.sliding_normals()))
        taken = np.where(held, force, on_surfaces)
        return np.asarray(taken[mask].sum(axis=0))

    def array(self, name: str) -> Any:
        """Share the device's own array: ``"u"``, (n_blocks + 1, 3, lanes), in solver order.

        On the native device a NumPy view, on OpenCL a ``pyopencl.array.Array`` over the same
        buffer. It is the displacement of now until the next step. `node_slots` tells where each
        node is; axis ``a`` of the solver is axis ``axis_order[a]`` of the model.

        Raises:
            InputError: unknown name, or pyopencl is missing.
        """
        if name != "u":
            raise InputError(f"array: got {name!r}; allowed: 'u'")
        self._core.finish()
        shape = (self._core.n_blocks + 1, 3, self._core.lanes)
        dtype = np.dtype(np.float32 if self._core.single else np.float64)
        if self._core.buffer_handle:
            queue = device_module.pyopencl_queue(self._device)
            import pyopencl
            from pyopencl import array

            buffer = pyopencl.Buffer.from_int_ptr(self._core.buffer_handle, retain=True)
            return array.Array(queue, shape, dtype, data=buffer)
        count = math.prod(shape)
        memory = HostMemory(self._core.buffer_address, count * dtype.itemsize, self._core)
        return np.asarray(memory).view(dtype).reshape(shape)

    @property
    def node_slots(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(block, lane) of each node in ``array("u")``, each (n_nodes,)."""
        slots = np.asarray(self._core.node_slots())
        return slots // self._core.lanes, slots % self._core.lanes

    @property
    def axis_order(self) -> tuple[int, int, int]:
        """Model axis of each solver axis."""
        a, b, c = self._core.axis_order
        return a, b, c

    def surface(self, name: str) -> trimesh.Trimesh:
        """A bound surface in its deformed place, m.

        Raises:
            InputError: no surface of that name.
        """
        import trimesh

        if name not in self.model.surfaces:
            known = ", ".join(self.model.surfaces) or "none"
            raise InputError(f"surface: got {name!r}; this model has: {known}")
        bound = self.model.surfaces[name]
        return trimesh.Trimesh(bound.displaced(self.u), bound.faces, process=False)

    def deformation_gradient(self) -> NDArray[np.float64]:
        """F at every element's centre, (n_elem, 3, 3)."""
        state = self._core.element_state(self._activations_now())
        return np.asarray(state["deformation_gradient"]).reshape(-1, 3, 3)

    def stress(self) -> NDArray[np.float64]:
        """Cauchy stress at every element's centre, muscles included, (n_elem, 6) Pa.

        Components xx, yy, zz, xy, yz, xz.
        """
        return np.asarray(self._core.element_state(self._activations_now())["stress"])

    def von_mises(self) -> NDArray[np.float64]:
        """Von Mises stress of `stress` at every element's centre, (n_elem,) Pa."""
        return von_mises_of(self.stress())

    def strain_energy(self) -> NDArray[np.float64]:
        """Strain energy density of every element without muscles and hourglass, (n_elem,) J/m3."""
        return np.asarray(self._core.element_state(self._activations_now())["energy_density"])

    def hourglass_energy(self) -> NDArray[np.float64]:
        """Hourglass energy density of every element, (n_elem,) J/m3."""
        return np.asarray(self._core.element_state(self._activations_now())["hourglass_density"])

    def internal_force(self) -> NDArray[np.float64]:
        """Force of the elements on their nodes, with the device's kernels, (n_nodes, 3) N.

        The sign is that of ``f_int``: a node accelerates by ``-f_int / mass``.
        """
        return np.asarray(self._core.internal_force(self._activations_now()))

    def external_force(self) -> NDArray[np.float64]:
        """Gravity, body forces and pressures on the nodes, (n_nodes, 3) N, in float64."""
        return np.asarray(self._core.external_force(self._values_now().channels))
