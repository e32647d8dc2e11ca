"""Time series for ParaView in VTKHDF, one file a run.

`VTKHDFWriter` stores the voxel model: reference geometry once, displacement per step (in
ParaView: Warp By Vector). `VTKHDFSurfaceWriter` stores a surface whose points move. Both follow
the VTKHDF 2.0 file format of the VTK documentation, transient UnstructuredGrid and PolyData.

While a run lasts the file is called ``<stem>.part.vtkhdf`` and is complete up to the last frame
after each append; closing renames it. A run that ends by an exception keeps its frames under the
final name; a process that is killed leaves the readable part file, and `reopen` goes on with it.

An HDF5 file killed while its metadata changes may be lost. Here they do not change: with ``frames``
given, all space is reserved in the first append (sparse, so it takes no disk yet), and from then on
a frame is raw data in reserved places, then the rows of ``Steps`` (one chunk each, their extent is
one number in place), then the number ``NSteps``, each flushed before the next. Nothing is copied
or merged, ParaView reads the file at any moment, and going back to a checkpoint is to set
``NSteps``. (Measured against the alternatives: a copy of the file at each checkpoint costs the file
again each time; segments merged at the end need twice the disk; SWMR files cannot be opened by
ParaView before h5clear.) Rows of the arrays beyond the last step, where a run ended early, are
unused. Without ``frames`` arrays grow, and a kill within an append may cost the file.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tledface.errors import InputError
from tledface.io._atomic import check_folder, sync
from tledface.io._hdf5 import GuardedFile
from tledface.model import Model
from tledface.surface import BoundSurface

__all__ = ["VTKHDFSurfaceWriter", "VTKHDFWriter", "file_bytes", "frame_bytes"]

_VTK_HEXAHEDRON = 12
_ENDING = ".vtkhdf"
# Bytes of a file beside its numbers: names, groups, places of chunks.
_STRUCTURE = 2**16


class _TimeSeries:
    """The file under its temporary name and the `Steps` group."""

    def __init__(
        self,
        path: str | Path,
        kind: str,
        n_points: int,
        n_cells: int,
        *,
        frames: int = 0,
        keep: int | None = None,
    ) -> None:
        self.path = Path(path)
        if self.path.suffix != _ENDING:
            raise InputError(f"time series {self.path}: the name must end in {_ENDING}")
        check_folder(self.path, "time series")
        self._part = self.path.with_name(f"{self.path.stem}.part{_ENDING}")
        self._n_points, self._n_cells = n_points, n_cells
        self._constant: frozenset[str] = frozenset()
        self._offsets: dict[str, tuple[int, str]] = {}
        self._poly = kind == "PolyData"
        self._reserved = frames
        self._count = 0
        if keep is not None:
            self._reopen(keep)
            return
        self._raw = GuardedFile(self._part, "w")
        self._file = h5py.File(self._raw, "w")
        self._root = self._file.create_group("VTKHDF")
        self._root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
        self._root.attrs.create("Type", np.bytes_(kind))
        self._steps = self._root.create_group("Steps")
        self._steps.attrs["NSteps"] = np.int64(0)
        self._steps.create_group("PointDataOffsets")
        self._steps.create_group("CellDataOffsets")
        self._root.create_group("PointData")
        self._root.create_group("CellData")

    def __enter__(self) -> Self:
        """Use as a context; leaving it closes the file."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file, with the frames it has."""
        # Of several errors the first is told: a full disk is met again by what closing writes.
        with nullcontext() if error is None else suppress(OSError):
            self.close()

    @property
    def n_steps(self) -> int:
        """Number of frames written."""
        return self._count

    def sync(self) -> None:
        """Wait until all frames are on the disk."""
        with self._raw.checked():
            self._file.flush()
        sync(self._part)

    def close(self) -> None:
        """Finish the file and give it its name; without any frame it is removed."""
        if not self._file:
            return
        self._close_file()
        if self.n_steps:
            os.replace(self._part, self.path)
        else:
            self._part.unlink()
        self._raw.check()

    def _close_file(self) -> None:
        self._file.close()
        self._raw.close()

    def note_time_scaling(self, factor: float) -> None:
        """Keep with the frames' times that they are this many times the simulated ones."""
        self._steps.attrs["TimeScaling"] = np.float64(factor)

    def _reopen(self, keep: int) -> None:
        """Open the file of a run that ended early, with its first ``keep`` frames."""
        if not self._part.exists() and self.path.exists():
            os.replace(self.path, self._part)
        if not self._part.exists():
            raise InputError(f"time series {self._part}: no such file; run again from the start")
        try:
            self._raw = GuardedFile(self._part, "r+")
        except BlockingIOError:
            raise InputError(
                f"time series {self._part}: another process is writing it; wait for that run, "
                "or end it"
            ) from None
        try:
            self._file = h5py.File(self._raw, "r+")
            self._root = self._file["VTKHDF"]
            self._steps = self._root["Steps"]
            found = int(self._steps.attrs["NSteps"])
        except (OSError, KeyError, TypeError):
            self._raw.close()
            raise InputError(
                f"time series {self._part}: damaged; run again from the start"
            ) from None
        if found < keep:
            self._close_file()
            raise InputError(
                f"time series {self._part}: holds {found} frames, the checkpoint was made after "
                f"{keep}; run again from the start"
            )
        self._count = keep
        self._steps.attrs.modify("NSteps", np.int64(keep))
        self._file.flush()
        tables = [*self._steps.values(), *self._steps["PointDataOffsets"].values()]
        for table in [*tables, *self._steps["CellDataOffsets"].values()]:
            if isinstance(table, h5py.Dataset):
                table.resize(keep, axis=0)

    def _add_step(self, time: float, first_point: int) -> None:
        """Count a frame; the data it points at are in the file already."""
        self._file.flush()
        step = self.n_steps
        for name, value in (
            ("PartOffsets", 0),
            ("NumberOfParts", 1),
            ("PointOffsets", first_point),
            ("CellOffsets", 0),
            ("ConnectivityIdOffsets", 0),
            ("Values", time),
        ):
            # PolyData keeps one offset for each of vertices, lines, polygons and strips.
            per_kind = self._poly and name in ("CellOffsets", "ConnectivityIdOffsets")
            dtype = np.float64 if name == "Values" else np.int64
            self._write_row(self._steps, name, value, (4,) if per_kind else (), dtype)
        for name, (rows, by_kind) in self._offsets.items():
            self._write_row(self._steps[f"{by_kind}DataOffsets"], name, rows * step)
        self._file.flush()
        self._steps.attrs.modify("NSteps", np.int64(step + 1))
        self._file.flush()
        self._raw.check()
        self._count = step + 1

    def _check_time(self, time: float) -> None:
        if not self._file:
            raise InputError(f"time series {self.path}: it is closed")
        last = float(self._steps["Values"][self.n_steps - 1]) if self.n_steps else -np.inf
        if not np.isfinite(time) or time <= last:
            raise InputError(
                f"time series {self.path}: frame time {time:g} s must be finite and above the "
                f"last one, {last:g} s"
            )

    def _checked(self, name: str, values: ArrayLike) -> tuple[str, NDArray[np.float32]]:
        array = np.asarray(values, dtype=np.float32)
        if array.ndim in (1, 2) and len(array) == self._n_points:
            return "Point", array
        if array.ndim in (1, 2) and len(array) == self._n_cells:
            return "Cell", array
        raise InputError(
            f"time series {self.path}: {name!r} has shape {array.shape}, need "
            f"{self._n_points} rows (points) or {self._n_cells} rows (cells)"
        )

    def _append_arrays(self, checked: dict[str, tuple[str, NDArray[np.float32]]]) -> None:
        known = set(self._steps["PointDataOffsets"]) | set(self._steps["CellDataOffsets"])
        if self.n_steps and set(checked) != known - self._constant:
            raise InputError(
                f"time series {self.path}: every frame must have the same arrays; the first had "
                f"{sorted(known - self._constant)}, this one has {sorted(checked)}"
            )
        self._offsets = {name: (0, "Cell") for name in self._constant}
        for name, (kind, array) in checked.items():
            self._write_frame(self._root[f"{kind}Data"], name, array)
            self._offsets[name] = (len(array), kind)

    def _write_frame(self, group: h5py.Group, name: str, values: NDArray[np.floating[Any]]) -> None:
        """Write the rows of a frame, all frames of the array being of one length."""
        rows = len(values)
        if name not in group:
            group.create_dataset(
                name,
                (self._reserved * rows, *values.shape[1:]),
                values.dtype,
                maxshape=(None, *values.shape[1:]),
                chunks=(max(rows, 1), *values.shape[1:]),
                dcpl=_in_place(),
            )
        data, start = group[name], self.n_steps * rows
        if len(data) < start + rows:
            data.resize(start + rows, axis=0)
        # A frame is a chunk, and goes to its place in the file directly: HDF5 would keep it.
        place = data.id.get_chunk_info_by_coord((start, *[0] * (values.ndim - 1))).byte_offset
        if place is None:
            return  # no rows
        self._raw.seek(place)
        self._raw.write(np.ascontiguousarray(values, dtype=data.dtype).tobytes())
        self._raw.check()

    def _write_row(
        self,
        group: h5py.Group,
        name: str,
        value: float,
        columns: tuple[int, ...] = (),
        dtype: type[np.generic] = np.int64,
    ) -> None:
        step = self.n_steps
        if name not in group:
            rows = max(64, self._reserved)
            group.create_dataset(
                name,
                # Written, so that the rows to come have their place on the disk already.
                data=np.zeros((rows, *columns), dtype),
                maxshape=(None, *columns),
                chunks=(rows, *columns),
                dcpl=_in_place(),
            )
        group[name].resize(step + 1, axis=0)
        group[name][step] = value


class VTKHDFWriter(_TimeSeries):
    """Time series of a voxel model, and of one of its surfaces beside it.

    Args:
        path: A name ending in .vtkhdf; see the module for when it appears.
        model: The model; its geometry is written once.
        surface: Name of one of ``model.surfaces``, or a bound surface: its moving points go to
            ``<stem>_surface.vtkhdf``. None: no surface file.
        frames: Number of frames to reserve space for; more can follow. See the module.

    Constant cell data: ``tissue`` (index of the largest fraction), ``fraction_<tissue>``,
    ``muscle_<name>`` (weight); a slash in a name becomes ``_``, and more than one where another has
    that name. Point data ``displacement`` in m, float32. Of a surface with vertices that stay at
    rest, cell data ``moves``: 0 for triangles that have one.

    Raises:
        InputError: another ending, no such folder, or no surface of that name.
    """

    def __init__(
        self,
        path: str | Path,
        model: Model,
        surface: str | BoundSurface | None = None,
        *,
        frames: int = 0,
        _keep: int | None = None,
    ) -> None:
        """Write the geometry and the constant fields."""
        if isinstance(surface, str):
            if surface not in model.surfaces:
                raise InputError(
                    f"time series {path}: the model has no surface {surface!r}; it has "
                    f"{sorted(model.surfaces)}"
                )
            surface = model.surfaces[surface]
        super().__init__(
            path, "UnstructuredGrid", model.n_nodes, model.n_elements, frames=frames, keep=_keep
        )
        fields = _constant_fields(model)
        self._constant = frozenset(fields)
        if _keep is None:
            self._write_geometry(model, fields)
        self._surface = surface
        self._surface_writer = None
        if surface is not None:
            moves = surface.bound[surface.faces].all(axis=1).astype(np.uint8)
            self._surface_writer = VTKHDFSurfaceWriter(
                self.path.with_name(f"{self.path.stem}_surface{_ENDING}"),
                surface.faces,
                len(surface.vertices),
                frames=frames,
                fields={} if surface.follow is None else {"moves": moves},
                _keep=_keep,
            )

    @classmethod
    def reopen(
        cls, path: str | Path, model: Model, surface: str | BoundSurface | None, *, keep: int
    ) -> Self:
        """Go on with the files of a writer that was killed or closed early.

        Args:
            path, model, surface: As they were given to the first writer.
            keep: Frames to keep, the first ones; later ones are dropped.

        Raises:
            InputError: no such file, damaged, fewer frames, or another process is writing it.
        """
        return cls(path, model, surface, _keep=keep)

    def _write_geometry(self, model: Model, fields: dict[str, NDArray[np.generic]]) -> None:
        root, n_elem = self._root, model.n_elements
        for name, count in (
            ("NumberOfPoints", model.n_nodes),
            ("NumberOfCells", n_elem),
            ("NumberOfConnectivityIds", 8 * n_elem),
        ):
            root.create_dataset(name, data=np.array([count], dtype=np.int64))
        root.create_dataset("Points", data=model.nodes)
        root.create_dataset("Types", data=np.full(n_elem, _VTK_HEXAHEDRON, dtype=np.uint8))
        root.create_dataset("Connectivity", data=model.elements.reshape(-1).astype(np.int64))
        root.create_dataset("Offsets", data=np.arange(0, 8 * n_elem + 1, 8, dtype=np.int64))
        for name, values in fields.items():
            root["CellData"].create_dataset(name, data=values)

    def append(
        self,
        time: float,
        u: ArrayLike,
        *,
        on_surface: Mapping[str, ArrayLike] | None = None,
        **arrays: ArrayLike,
    ) -> None:
        """Add a frame.

        Args:
            time: s, above that of the last frame.
            u: (n_nodes, 3) displacement, m.
            on_surface: Point or cell data of the surface by name; needs a surface.
            arrays: More point or cell data by name, (n_nodes,) or (n_elem,) or with columns;
                the same names in every frame.

        Raises:
            InputError: a wrong shape, other arrays than before, a time that does not grow.
        """
        self._check_time(time)
        displacement = np.asarray(u)
        if displacement.shape != (self._n_points, 3):
            raise InputError(
                f"time series {self.path}: displacement has shape {displacement.shape}, need "
                f"({self._n_points}, 3)"
            )
        taken = sorted(self._constant & set(arrays))
        if taken:
            raise InputError(f"time series {self.path}: {taken[0]!r} is a field of the model")
        checked = {name: self._checked(name, values) for name, values in arrays.items()}
        checked = {"displacement": ("Point", displacement.astype(np.float32))} | checked
        with self._raw.checked():
            self._append_arrays(checked)
            self._add_step(time, first_point=0)
        if self._surface is not None and self._surface_writer is not None:
            moved = self._surface.displaced(displacement)
            self._surface_writer.append(time, moved, **(on_surface or {}))

    def note_time_scaling(self, factor: float) -> None:
        """Keep with the times of both files that they are this many times the simulated ones."""
        super().note_time_scaling(factor)
        if self._surface_writer is not None:
            self._surface_writer.note_time_scaling(factor)

    def sync(self) -> None:
        """Wait until all frames of both files are on the disk."""
        super().sync()
        if self._surface_writer is not None:
            self._surface_writer.sync()

    def close(self) -> None:
        """Finish both files and give them their names."""
        try:
            super().close()
        finally:
            if self._surface_writer is not None:
                self._surface_writer.close()


class VTKHDFSurfaceWriter(_TimeSeries):
    """Time series of a triangle surface whose points move.

    Args:
        path: A name ending in .vtkhdf; see the module for when it appears.
        faces: (nf, 3) int, the same in every frame.
        n_vertices: Number of points in every frame.
        frames: Number of frames to reserve space for; more can follow. See the module.
        fields: Constant data of the triangles by name, (nf,).
    """

    def __init__(
        self,
        path: str | Path,
        faces: ArrayLike,
        n_vertices: int,
        *,
        frames: int = 0,
        fields: Mapping[str, ArrayLike] | None = None,
        _keep: int | None = None,
    ) -> None:
        """Write the triangles."""
        triangles = np.asarray(faces, dtype=np.int64)
        super().__init__(path, "PolyData", n_vertices, len(triangles), frames=frames, keep=_keep)
        self._constant = frozenset(fields or ())
        if _keep is not None:
            return
        for name, values in (fields or {}).items():
            self._root["CellData"].create_dataset(name, data=np.asarray(values))
        self._root.create_dataset("NumberOfPoints", data=np.array([n_vertices]))
        for name in ("Vertices", "Lines", "Polygons", "Strips"):
            ids = triangles.reshape(-1) if name == "Polygons" else np.empty(0, dtype=np.int64)
            group = self._root.create_group(name)
            group.create_dataset("NumberOfCells", data=np.array([len(ids) // 3]))
            group.create_dataset("NumberOfConnectivityIds", data=np.array([len(ids)]))
            group.create_dataset("Connectivity", data=ids)
            group.create_dataset("Offsets", data=np.arange(0, len(ids) + 1, 3))

    def append(self, time: float, vertices: ArrayLike, **arrays: ArrayLike) -> None:
        """Add a frame.

        Args:
            time: s, above that of the last frame.
            vertices: (nv, 3) m, moved positions.
            arrays: Point or cell data by name, the same names in every frame.

        Raises:
            InputError: a wrong shape, other arrays than before, a time that does not grow.
        """
        self._check_time(time)
        points = np.asarray(vertices, dtype=np.float64)
        if points.shape != (self._n_points, 3):
            raise InputError(
                f"time series {self.path}: vertices have shape {points.shape}, need "
                f"({self._n_points}, 3)"
            )
        checked = {name: self._checked(name, v) for name, v in arrays.items()}
        with self._raw.checked():
            self._append_arrays(checked)
            self._write_frame(self._root, "Points", points)
            self._add_step(time, first_point=self.n_steps * self._n_points)


def frame_bytes(model: Model, surface: BoundSurface) -> int:
    """Bytes on the disk of a frame with a scalar of the elements and one of the vertices."""
    return sum(_frame_bytes(model, surface))


def file_bytes(model: Model, surface: BoundSurface, frames: float) -> float:
    """Bytes of the longer one of the two files of so many such frames, about."""
    fields = 1 + len(model.tissues) + len(model.muscles)
    voxels = 24 * model.n_nodes + (1 + 8 + 64 + 4 * fields) * model.n_elements
    triangles = (24 + 8 + 1) * len(surface.faces)
    pairs = zip((voxels, triangles), _frame_bytes(model, surface), strict=True)
    return _STRUCTURE + max(still + frames * each for still, each in pairs)


def _frame_bytes(model: Model, surface: BoundSurface) -> tuple[int, int]:
    """Of the voxels and of the surface, with rows of `Steps`: six tables, one for each array."""
    rows = 8 * (16 + len(model.tissues) + len(model.muscles))
    voxels = 3 * 4 * model.n_nodes + 4 * model.n_elements
    return voxels + rows, (3 * 8 + 4) * len(surface.vertices) + 8 * 16


def _constant_fields(model: Model) -> dict[str, NDArray[np.generic]]:
    fields: dict[str, NDArray[np.generic]] = {
        "tissue": np.argmax(model.fractions, axis=1).astype(np.int32)
    }
    for column, name in enumerate(_plain(model.tissues)):
        fields[f"fraction_{name}"] = model.fractions[:, column].astype(np.float32)
    names = _plain([muscle.name for muscle in model.muscles])
    for name, muscle in zip(names, model.muscles, strict=True):
        weight = np.zeros(model.n_elements, dtype=np.float32)
        weight[muscle.elements] = muscle.weight
        fields[f"muscle_{name}"] = weight
    return fields


def _plain(names: Sequence[str]) -> list[str]:
    """Names without slashes, at which HDF5 splits them; different ones stay different."""
    plain: list[str] = []
    for name in names:
        new = name.replace("/", "_")
        while new != name and (new in names or new in plain):
            new += "_"
        plain.append(new)
    return plain


def _in_place() -> h5py.h5p.PropDCID:
    """Chunks that get their places when the array is made, and are not filled before they do."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    return properties
