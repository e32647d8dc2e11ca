"""What a run did: its figures, for a person and for files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tledface.folds import Folds
    from tledface.time_step import AddedMass

__all__ = ["RunResult"]


@dataclass(frozen=True)
class RunResult:
    """What a run did and where its files are (``files``: role to path).

    ``dt`` is the mean time step, of ``substeps`` shortest ones, ``dt_crit`` their bound at rest,
    ``simulated``, ``played`` (``time_scaling`` times it, the time of the frames) and ``wall`` are
    in s, ``max_displacement`` is in m; ``added_mass`` is what mass scaling added.
    """

    directory: Path
    files: dict[str, Path]
    device: str
    precision: str
    n_elements: int
    n_nodes: int
    steps: int
    dt: float
    substeps: int
    dt_crit: float
    simulated: float
    time_scaling: float
    added_mass: AddedMass
    wall: float
    frames: int
    max_displacement: float
    folds: Folds | None

    @property
    def melem_steps_per_s(self) -> float:
        """Millions of element steps for each second of the simulation, writing included.

        With subcycling those of one shortest step for all, which it saves some of.
        """
        return self.n_elements * self.steps * self.substeps / max(self.wall, 1e-9) * 1e-6

    @property
    def played(self) -> float:
        """Time of the last frame, s."""
        return self.simulated * self.time_scaling

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units."""
        return {
            "directory": str(self.directory),
            "files": {role: str(path) for role, path in self.files.items()},
            "device": self.device,
            "precision": self.precision,
            "elements": self.n_elements,
            "nodes": self.n_nodes,
            "steps": self.steps,
            "dt_s": self.dt,
            "substeps": self.substeps,
            "dt_crit_s": self.dt_crit,
            "simulated_s": self.simulated,
            "played_s": self.played,
            "time_scaling": self.time_scaling,
            "added_mass_kg": self.added_mass.kg,
            "added_mass_share": self.added_mass.share,
            "wall_s": self.wall,
            "melem_steps_per_s": self.melem_steps_per_s,
            "frames": self.frames,
            "max_displacement_m": self.max_displacement,
            "wrinkles": None if self.folds is None else self.folds.to_dict(),
        }

    def text(self) -> str:
        """A few lines for a person."""
        lines = [
            f"{self.n_elements:,} elements, {self.steps:,} steps of {self.dt * 1e6:.3g} us "
            f"({f'{self.substeps} short ones each; ' if self.substeps > 1 else ''}"
            f"bound at rest {self.dt_crit * 1e6:.3g} us) on {self.device}: {self.wall:.1f} s, "
            f"{self.melem_steps_per_s:.0f} M element-steps/s",
            *self._scaled(),
            f"largest displacement {self.max_displacement * 1e3:.2f} mm",
        ]
        if self.folds is not None:
            lines.append(self.folds.text())
        width = max(len(role) for role in self.files)
        lines += [f"{role:<{width}}  {path}" for role, path in self.files.items()]
        return "\n".join(lines)

    def _scaled(self) -> list[str]:
        """What mass and time scaling did: inertia is that of so many times the mass."""
        lines = []
        if self.added_mass.kg > 0.0:
            lines.append(
                f"mass scaling: {self.added_mass.kg:.3g} kg added, "
                f"{1.0 + self.added_mass.share:.3g} times the true mass"
            )
        if self.time_scaling != 1.0:
            lines.append(
                f"time scaling {self.time_scaling:g}: {self.simulated:.3g} s simulated, "
                f"{self.played:.3g} s played; inertia as of "
                f"{(1.0 + self.added_mass.share) * self.time_scaling**2:.3g} times the true mass"
            )
        return lines
