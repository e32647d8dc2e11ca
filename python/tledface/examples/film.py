"""A stiff film on a soft substrate, shortened until it wrinkles, against the exact theory.

Plane strain, film one voxel thick. The strip is shortened in small steps, each from a trace of
noise, once with the physical hourglass form and once with the kappa form of the literature. In
each step every cosine wave along the strip grows or decays; the shortening at which its rate passes
zero is that wave's critical strain, and the least of them is the onset of wrinkles. With the
physical form strain and wavelength are those of Biot's theory (M. A. Biot, Appl. Sci. Res. A 12,
168-182, 1963), with nothing to tune; with the kappa form they are what kappa makes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tledface.errors import InputError

if TYPE_CHECKING:
    from tledface.model import Model

__all__ = ["EXACT", "FilmResult", "FilmRun", "check", "shorten", "strip", "study"]

Floats = NDArray[np.float64]

# Ratio of the moduli: (reference wavelength over film thickness, nominal shortening) at onset, for
# an incompressible neo-Hookean film on a half-space; the verification tests derive them.
EXACT = {10.0: (11.457, 0.10522), 24.57: (14.131, 0.05893), 100.0: (21.113, 0.02364)}

THICKNESS = 0.5e-3  # m, of the film
SUBSTRATE, NU, DENSITY = 81.4e3, 0.49, 1100.0  # Pa, -, kg/m3: a dermis
WAVES_LONG, WAVES_DEEP = 8.0, 1.5
# Strain steps up to the exact onset, and bounds of what a study computes.
_RESOLUTION, _FINEST, _MOST_WAVES = 50, 10_000, 1000.0
# Noise at the start of each strain step, in film thicknesses.
_NOISE = 1e-3
# Duration of a strain step, in units of 1 / omega of the shear wave as long as the wrinkles.
_DURATION = 60.0
# Strain steps of growth in a row that make an onset.
_GROWING = 5
# Share of the highest wave below which a wave is taken for driven by others.
_DRIVEN = 0.02


@dataclass(frozen=True)
class FilmRun:
    """A strip shortened step by step with one hourglass form.

    Attributes:
        hourglass: "physical" or "joldes".
        strains: (n_steps,) nominal shortening of each step.
        amplitudes: (n_steps,) m, half the height of the wrinkles at the end of each step.
        onset: shortening at which the first wave becomes neutral; NaN if none does.
        wavelength: m, reference length of that wave; NaN if none does.
        model: the strip.
        u: (n_nodes, 3) m, displacement at the end.
        steps: time steps taken.
    """

    hourglass: str
    strains: Floats = field(repr=False)
    amplitudes: Floats = field(repr=False)
    onset: float
    wavelength: float
    model: Model = field(repr=False)
    u: Floats = field(repr=False)
    steps: int


@dataclass(frozen=True)
class FilmResult:
    """What `study` found: lengths in m, strains nominal; ``files`` maps role to path."""

    ratio: float
    exact_wavelength: float
    exact_onset: float
    wavelength: dict[str, float]
    onset: dict[str, float]
    files: dict[str, Path]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units; NaN (no wrinkles) as None."""
        plain = asdict(self)
        plain["files"] = {role: str(path) for role, path in self.files.items()}
        for key in ("wavelength", "onset"):
            plain[key] = {k: v if np.isfinite(v) else None for k, v in plain[key].items()}
        return plain

    def text(self) -> str:
        """A few lines for a person."""
        lines = [
            f"film {self.ratio:g} times as stiff as its substrate, one voxel thick",
            f"exact     wavelength {self.exact_wavelength * 1e3:6.2f} mm   "
            f"onset at {self.exact_onset * 100:5.2f} % shortening",
        ]
        for form, wavelength in self.wavelength.items():
            if not np.isfinite(wavelength):
                lines.append(f"{form:<9} no wrinkles")
                continue
            onset = self.onset[form]
            longer = wavelength / self.exact_wavelength - 1.0
            later = onset / self.exact_onset - 1.0
            lines.append(
                f"{form:<9} wavelength {wavelength * 1e3:6.2f} mm   onset at {onset * 100:5.2f} % "
                f"shortening   ({longer:+.1%}, {later:+.1%})"
            )
        lines += [f"{role:<9} {path}" for role, path in self.files.items()]
        return "\n".join(lines)


def strip(
    ratio: float, wavelength: float, *, layers: int = 1, aspect: float = 1.0, waves: float = 8.0
) -> Model:
    """Return a strip in plane strain whose ends and bottom slide, its film on top.

    Args:
        ratio: Modulus of the film over the substrate's.
        wavelength: m; the strip is ``waves`` of them long and 1.5 deep.
        layers: Voxels over the thickness of the film.
        aspect: Length over height of a voxel.
        waves: Length of the strip in wavelengths.

    Raises:
        InputError: a value that is not above 0.
    """
    from tledface.constitutive import material
    from tledface.model import Model

    if not (ratio > 0 and wavelength > 0 and layers >= 1 and aspect > 0 and waves > 0):
        raise InputError("film: ratio, wavelength, layers, aspect and waves must be above 0")

    def tissue(factor: float) -> Any:
        # The density follows the modulus, so that the film does not set the time step: at rest or
        # nearly so it matters for nothing else.
        return material(
            "neo_hookean",
            youngs_modulus=SUBSTRATE * factor,
            poissons_ratio=NU,
            density=DENSITY * factor,
        )

    height = THICKNESS / layers
    length = height * aspect
    columns = int(np.ceil(waves * wavelength / length))
    rows = layers + int(np.ceil(WAVES_DEEP * wavelength / height))
    model = Model.block(
        cells=(columns, 1, rows),
        size=(columns * length, height, rows * height),
        material=tissue(1.0),
        tissue="substrate",
    )
    top = rows * height - THICKNESS
    model.set_material(lambda centres: centres[:, 2] > top, tissue(ratio), name="film")
    model.fix(np.ones(model.n_nodes, dtype=bool), "y")
    model.fix(model.node_ijk[:, 2] == 0, "z")
    model.fix((model.node_ijk[:, 0] == 0) | (model.node_ijk[:, 0] == columns), "x")
    return model


def shorten(
    model: Model,
    wavelength: float,
    to: float,
    *,
    step: float,
    hourglass: str = "physical",
    device: Any = "auto",
    on_step: Callable[[float], None] | None = None,
    stop_after_onset: bool = False,
) -> FilmRun:
    """Shorten a `strip` in small steps and find when which wave appears.

    Args:
        model: The strip.
        wavelength: m, of the wrinkles that damping and durations are chosen for.
        to: Nominal shortening at the end.
        step: Shortening of one strain step; the onset is interpolated between steps, so that
            steps of a hundredth of it serve, while the strip must not run ahead of its wrinkles.
        hourglass: "physical" or "joldes".
        device: As for `tledface.Simulator`.
        on_step: Called as ``on_step(strain)`` after every strain step, or None.
        stop_after_onset: End once the onset is known.

    Raises:
        InputError: no such device or form. SimulationError: the state is no longer finite.

    Every strain step moves the strip uniformly, so that no waves run in from its ends, and adds
    noise; the rate of each cosine wave of the upper face is taken over the step's second half.
    """
    from tledface.simulator import Simulator

    speed = np.sqrt(SUBSTRATE / (2 * (1 + NU)) / DENSITY)
    omega = 2 * np.pi * speed / wavelength
    sim = Simulator(
        model, device=device, precision="double", hourglass=hourglass, damping=2 * omega
    )
    top = np.flatnonzero(
        (model.node_ijk[:, 2] == model.node_ijk[:, 2].max()) & (model.node_ijk[:, 1] == 0)
    )
    columns = len(top) - 1
    # Cosines fit the sliding ends; the trapezoid rule keeps them orthogonal.
    weight = np.full(columns + 1, 2.0 / columns)
    weight[[0, -1]] /= 2
    waves = np.arange(1, columns // 2)
    cosines = np.cos(np.pi * np.outer(waves, np.arange(columns + 1)) / columns) * weight
    rng = np.random.default_rng(1)
    rows = model.node_ijk[:, 2].max() + 1
    n_strains = round(to / step)
    strains = np.linspace(step, n_strains * step, n_strains)
    rates: list[Floats] = []
    spectra: list[Floats] = []
    taken = 0
    least = 1e-9 * _NOISE * THICKNESS  # what round-off leaves of the shortest waves
    last, velocity = 0.0, np.zeros((model.n_nodes, 3))
    u = np.zeros((model.n_nodes, 3))
    for strain in strains.tolist():
        along, across = (1 - strain) / (1 - last), thickening(strain) / thickening(last)
        u = (model.nodes + u) * (along, 1.0, across) - model.nodes
        # Both nodes of a column across the strip get the same noise.
        noise = rng.standard_normal((columns + 1, rows)) * _NOISE * THICKNESS
        noise[:, 0] = 0.0
        u[:, 2] += noise[model.node_ijk[:, 0], model.node_ijk[:, 2]]
        sim.set_state(u, velocity, time=sim.time)
        n = max(2, int(np.ceil(_DURATION / omega / sim.dt / 2)))
        sim.step(n)
        half = cosines @ sim.u[top, 2]
        sim.step(n)
        taken += 2 * n
        u, velocity, last = sim.u, sim.velocity, strain
        now = cosines @ u[top, 2]
        rates.append(np.log(np.maximum(abs(now), least) / np.maximum(abs(half), least)))
        spectra.append(abs(now))
        if on_step is not None:
            on_step(strain)
        if stop_after_onset and _begins(np.array(rates)) is not None:
            break
    strains = strains[: len(rates)]
    onset, wave = _first_neutral(strains, np.array(rates), np.array(spectra), waves)
    length = columns * float(model.voxel[0])
    return FilmRun(
        hourglass, strains, np.array(spectra).max(axis=1), onset, 2 * length / wave, model, u, taken
    )


def check(
    *, ratio: float = 24.57, waves: float = WAVES_LONG, resolution: int = _RESOLUTION
) -> None:
    """Raise InputError for settings that `study` refuses."""
    if ratio not in EXACT:
        known = ", ".join(f"{known:g}" for known in EXACT)
        raise InputError(f"film ratio: got {ratio!r}; allowed, with an exact answer: {known}")
    if not 1.0 <= waves <= _MOST_WAVES:
        raise InputError(f"film waves: got {waves!r}; allowed: 1 to {_MOST_WAVES:g}")
    if not _GROWING <= resolution <= _FINEST:
        raise InputError(f"film resolution: got {resolution!r}; allowed: {_GROWING} to {_FINEST}")


def study(
    folder: str | Path,
    *,
    ratio: float = 24.57,
    waves: float = WAVES_LONG,
    resolution: int = _RESOLUTION,
    device: Any = "auto",
    quiet: bool = False,
) -> FilmResult:
    """Shorten a film with both hourglass forms and draw them beside the exact theory.

    Args:
        folder: Existing folder; ``film.png`` in it is replaced.
        ratio: Modulus of the film over the substrate's, one of `EXACT`.
        waves: Length of the strip in exact wavelengths; below eight the answer gets rough.
        resolution: Strain steps up to the exact onset.
        device: As for `tledface.Simulator`.
        quiet: No progress bar.

    Raises:
        InputError: settings that `check` refuses, or a folder that cannot be written.
    """
    from tledface.examples._film_picture import draw
    from tledface.progress import ProgressBar

    check(ratio=ratio, waves=waves, resolution=resolution)
    wavelength, strain = EXACT[ratio][0] * THICKNESS, EXACT[ratio][1]
    model = strip(ratio, wavelength, waves=waves)
    runs: list[FilmRun] = []
    # Beyond the onset of both forms.
    end = 2.1 * strain
    with ProgressBar("shortening the film", 2.0 * end, quiet=quiet) as bar:
        for form in ("physical", "joldes"):
            done = end * len(runs)

            def show(strain_now: float, done: float = done) -> None:
                bar.update(done + strain_now)

            runs.append(
                shorten(
                    model,
                    wavelength,
                    end,
                    step=strain / resolution,
                    hourglass=form,
                    device=device,
                    on_step=show,
                )
            )
    path = Path(folder) / "film.png"
    draw(path, runs, wavelength, strain)
    return FilmResult(
        ratio,
        wavelength,
        strain,
        {run.hourglass: run.wavelength for run in runs},
        {run.hourglass: run.onset for run in runs},
        {"picture": path},
    )


def thickening(strain: float) -> float:
    """Stretch across a plane-strain body of Poisson's ratio 0.49 shortened by ``strain``."""
    mu, bulk = 1 / (2 * (1 + NU)), 1 / (3 * (1 - 2 * NU))
    low, high = 0.9, 3.0
    for _ in range(80):
        middle = (low + high) / 2
        F = (1 - strain, 1.0, middle)
        J = F[0] * F[2]
        sigma = mu * J ** (-5 / 3) * (F[2] ** 2 - sum(f * f for f in F) / 3)
        low, high = (middle, high) if sigma + bulk / 2 * (J - 1 / J) < 0 else (low, middle)
    return middle


def _begins(rates: Floats) -> int | None:
    """First step of a run of growing ones, if it is that long already."""
    grows: NDArray[np.bool_] = np.any(rates > 0.0, axis=1)
    for at in range(len(grows) - _GROWING + 1):
        if grows[at : at + _GROWING].all():
            return at
    return None


def _passage(strains: Floats, rates: Floats) -> float:
    """Strain at which one wave's rate passes from decay to growth that lasts; inf if never."""
    grows = rates > 0.0
    for at in np.flatnonzero(grows[1:] & ~grows[:-1]) + 1:
        if grows[at : at + 3].all():
            low, high = rates[at - 1], rates[at]
            return float(strains[at] - (strains[at] - strains[at - 1]) * high / (high - low))
    return float("inf")


def _first_neutral(
    strains: Floats, rates: Floats, spectra: Floats, waves: NDArray[np.int64]
) -> tuple[float, float]:
    """Least critical strain and its wave number (in half waves a strip, not whole)."""
    begins = _begins(rates)
    if begins is None:
        return float("nan"), float("nan")
    # Sums and differences of the growing waves are driven by them and seem to grow on their own;
    # while all are small they are far smaller than what the noise leaves.
    early = spectra[begins + 1]
    critical = np.array(
        [
            _passage(strains, rates[:, at]) if early[at] > _DRIVEN * early.max() else np.inf
            for at in range(len(waves))
        ]
    )
    best = int(np.argmin(critical))
    if not np.isfinite(critical[best]):
        return float("nan"), float("nan")
    for at in range(max(best - 2, 0), min(best + 3, len(waves))):
        critical[at] = _passage(strains, rates[:, at])
    # Between the waves that fit the strip the critical strain is smooth: a cubic through five.
    around = slice(max(best - 2, 0), best + 3)
    near = np.isfinite(critical[around])
    if np.count_nonzero(near) < 4:
        return float(critical[best]), float(waves[best])
    offset = waves[around][near] - waves[best]
    fit = np.polynomial.Polynomial.fit(offset, critical[around][near] / critical[best], 3)
    between = np.linspace(-1.0, 1.0, 401)
    least = int(np.argmin(fit(between)))
    return float(fit(between[least]) * critical[best]), float(waves[best] + between[least])
