"""The frames of a run, read back from its folder, also while it lasts and after it was killed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError
from tledface.stress_picture import VoxelStress

__all__ = ["RunFrames"]

Floats = NDArray[np.float64]

STRESS = "von_mises"


class RunFrames:
    """The frames in the folder of a run.

    Attributes:
        times: (n,) s, of the frames as they are played.

    Raises:
        InputError: no frames, a damaged file.
    """

    def __init__(self, directory: str | Path) -> None:
        """Read the times."""
        self._directory = Path(directory)
        with self._root("frames_surface") as root:
            self.times: Floats = root["Steps/Values"][: _count(root)].astype(np.float64)
        if not len(self.times):
            raise InputError(f"render {directory}: it holds no frame yet; wait for the first")

    def at(self, time: float | None) -> int:
        """The frame nearest to a time (s), the last for None; InputError: beyond the frames."""
        last = len(self.times) - 1
        if time is None:
            return last
        spacing = (self.times[-1] - self.times[0]) / max(last, 1)
        if not self.times[0] - spacing <= time <= self.times[-1] + spacing:
            raise InputError(
                f"--at: got {1e3 * time:g} ms; the frames of {self._directory} span "
                f"{1e3 * self.times[0]:g} to {1e3 * self.times[-1]:g} ms"
            )
        return int(np.argmin(np.abs(self.times - time)))

    def surface(self, frames: tuple[int, int]) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Points of two frames, (nv, 3) m, and the triangles that follow the tissue, (nf, 3)."""
        with self._root("frames_surface") as root:
            n = int(root["NumberOfPoints"][0])
            before, after = (_rows(root["Points"], frame, n) for frame in frames)
            faces = root["Polygons/Connectivity"][()].astype(np.int64).reshape(-1, 3)
            if "moves" in root["CellData"]:
                faces = faces[root["CellData/moves"][()] != 0]
        if not len(faces):
            raise InputError(
                f"render {self._directory}: no face of its skin moves with the tissue; divide the "
                "long faces of the scene's skin, or take a larger region, and run it again"
            )
        return before, after, faces

    def surface_stress(self, frames: tuple[int, int]) -> tuple[Floats, Floats]:
        """Von Mises stress under the surface in two frames, (nv,) Pa each.

        Raises:
            InputError: the frames hold no stress.
        """
        with self._root("frames_surface") as root:
            n = int(root["NumberOfPoints"][0])
            data = self._stress(root["PointData"])
            before, after = (_rows(data, frame, n) for frame in frames)
        return before, after

    def voxels(self, frames: tuple[int, int]) -> VoxelStress:
        """The voxels with displacement and stress in two frames.

        Raises:
            InputError: the frames hold no stress.
        """
        with self._root("frames") as root:
            n_nodes, n_elem = int(root["NumberOfPoints"][0]), int(root["NumberOfCells"][0])
            cells = root["CellData"]
            data = self._stress(cells)
            muscle = np.zeros(n_elem)
            for name in cells:
                if name.startswith("muscle_"):
                    muscle += cells[name][()]
            u = [_rows(root["PointData/displacement"], frame, n_nodes) for frame in frames]
            stress = [_rows(data, frame, n_elem) for frame in frames]
            return VoxelStress(
                root["Points"][()].astype(np.float64),
                root["Connectivity"][()].astype(np.int64).reshape(-1, 8),
                (u[0], u[1]),
                (stress[0], stress[1]),
                muscle >= 0.5,
            )

    def _stress(self, group: h5py.Group) -> h5py.Dataset:
        if STRESS not in group:
            raise InputError(
                f"render {self._directory}: its frames hold no stress (an older run); run the "
                "scene again"
            )
        return group[STRESS]

    @contextmanager
    def _root(self, stem: str) -> Iterator[Any]:
        names = (f"{stem}.vtkhdf", f"{stem}.part.vtkhdf")
        found = [path for name in names if (path := self._directory / name).exists()]
        if not found:
            raise InputError(
                f"render {self._directory}: it holds no {names[0]}; run the scene again"
            )
        try:
            # Without a lock: a run that goes on holds one, and its frames are whole at any moment.
            with h5py.File(found[0], "r", locking=False) as file:
                yield file["VTKHDF"]
        except InputError:
            raise
        except (OSError, KeyError, ValueError, IndexError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"{found[0]}: cannot be read ({reason}); run the scene again"
            ) from None


def _count(root: Any) -> int:
    return int(root["Steps"].attrs["NSteps"])


def _rows(data: h5py.Dataset, frame: int, rows: int) -> Floats:
    """A frame of an array that has so many rows in each."""
    values: Floats = data[frame * rows : (frame + 1) * rows].astype(np.float64)
    if len(values) != rows:
        raise ValueError(f"{data.name} ends in frame {frame}")
    return values
