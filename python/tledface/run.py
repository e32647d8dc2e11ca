"""A run of a scene from start to end: model, simulation, frames, surface, picture, figures.

A run that was killed or stopped goes on from its last checkpoint with `resume_run`, and ends with
the same state and frames, bit for bit on the same device.
"""

from __future__ import annotations

import errno
import math
import time
import tomllib
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tledface import device as device_module
from tledface.errors import InputError, SimulationError, in_shell
from tledface.frame_plan import require_room, reserved_frames
from tledface.frame_queue import FrameQueue
from tledface.io._atomic import NO_ROOM
from tledface.io.surfaces import write_surface
from tledface.io.vtkhdf import VTKHDFWriter
from tledface.output import OutputFolder, earlier_run
from tledface.progress import ProgressBar, spinner
from tledface.run_checkpoints import (
    MODEL_FILE,
    RunCheckpoints,
    how_to_resume,
    newest_whole,
    remove_from,
)
from tledface.run_result import RunResult

if TYPE_CHECKING:
    from tledface.folds import Folds
    from tledface.model import Model
    from tledface.scene import Scene
    from tledface.simulator import Simulator
    from tledface.snapshot import Snapshot
    from tledface.surface import BoundSurface

__all__ = [
    "RunResult",
    "load_run",
    "load_scene",
    "prepared",
    "resume_run",
    "run_prepared",
    "run_scene",
    "save_built",
    "shown_surface",
    "simulator_of",
]

_PROGRESS_TICKS = 100
_MOST_STEPS = 1e12  # years
_MOST_FPS = 1e12  # a step gives one frame at most


def run_scene(
    scene: Scene,
    out_dir: str | Path,
    *,
    device: Any = "auto",
    quiet: bool = False,
    force: bool = False,
    model: Model | None = None,
    about: Mapping[str, Any] | None = None,
) -> RunResult:
    """Simulate a scene and write its results into ``out_dir``.

    The folder gets ``frames.vtkhdf`` (the voxels over time, with von Mises stress),
    ``frames_surface.vtkhdf`` (the skin over time, with the stress under it), ``skin.ply`` (the skin
    at the end, m), an OBJ file for each of ``[[surfaces]]``, ``wrinkles.png`` and ``run.json``.
    Nothing is written before model and simulator stand. A run that fails midway keeps its frames,
    and its checkpoints (``[output] checkpoint_every``) for `resume_run`. While it lasts other
    processes are refused the folder, with ``force`` too.

    Args:
        scene: The scene.
        out_dir: The folder: new, empty, or of an earlier run.
        device: As for `Simulator`.
        quiet: No progress on standard error.
        force: Replace an earlier run in ``out_dir``.
        model: The scene's model where it is built already.
        about: More for ``run.json``.

    Returns:
        `RunResult`.

    Raises:
        InputError: scene, surfaces, device, folder, room on the disk.
        SimulationError: the state is no longer finite.
    """
    folder = OutputFolder(out_dir, force=force)
    sim = prepared(scene, folder, device_module.resolve(device), quiet=quiet, model=model)
    with folder.held():
        return run_prepared(scene, sim, folder, about, quiet=quiet)


def prepared(
    scene: Scene, folder: OutputFolder, device: Any, *, quiet: bool, model: Model | None = None
) -> Simulator:
    """The simulator of a scene that is to run into a folder, in which nothing changes yet.

    Raises InputError: all that a run may be refused for, room for its frames included.
    """
    if model is None:
        with spinner("building the model", quiet=quiet):
            model = scene.build()
    with spinner("preparing the simulation", quiet=quiet):
        sim = simulator_of(scene, model, device)
    require_room(scene, sim, shown_surface(model), folder.path, folder.free())
    return sim


def run_prepared(
    scene: Scene,
    sim: Simulator,
    folder: OutputFolder,
    about: Mapping[str, Any] | None = None,
    *,
    quiet: bool,
) -> RunResult:
    """Run a simulator of `prepared` into a folder that this process holds."""
    facts: dict[str, Any] = {**(about or {}), "scene": str(scene.path) if scene.path else None}
    files = [path.name for path in _files(folder.path, sim.model).values()]
    folder.begin(facts, files=[*files, "frames.part.vtkhdf", "frames_surface.part.vtkhdf"])
    remove_from(folder.path)
    name = sim._device.info.name
    work = partial(_simulate, scene, sim, folder.path, name, quiet=quiet)
    return _recorded(work, sim, folder, facts)


def resume_run(directory: str | Path, *, device: Any = None, quiet: bool = False) -> RunResult:
    """Go on with a run that was killed or stopped, from its last checkpoint to its end.

    Frames up to the checkpoint stay, later ones are computed again.

    Args:
        directory: The folder of the run.
        device: None for the one the run was on; another one is allowed, with a warning: the end
            then is not the same bit for bit.
        quiet: No progress on standard error.

    A checkpoint that is damaged is a warning, and the one before it is taken.

    Raises:
        InputError: no run, one that is finished or still going on, no checkpoint, no such device.
        SimulationError: the state is no longer finite.
    """
    _unfinished(directory)
    folder = OutputFolder(directory, force=True)
    opened = None if device is None else device_module.resolve(device)
    with folder.held():
        # Looked at again: the run may have come to its end just before it gave the folder free.
        return _go_on(folder, _unfinished(directory), opened, quiet=quiet)


def _unfinished(directory: str | Path) -> dict[str, Any]:
    """What ``run.json`` says of a run that has not come to its end; raises InputError else."""
    about = earlier_run(Path(directory))
    if about is None:
        raise InputError(f"resume {directory}: no run; give the folder of `tledface run`")
    if "scene" not in about and "demo" in about:
        raise InputError(
            f"resume {directory}: a study, which has no checkpoints; run "
            f"`tledface demo {about['demo']} --force -o {in_shell(directory)}` again"
        )
    if about.get("state") == "finished":
        raise InputError(f"resume {directory}: the run is finished; there is nothing to resume")
    return about


def _go_on(folder: OutputFolder, about: dict[str, Any], device: Any, *, quiet: bool) -> RunResult:
    """Restore the last checkpoint in a folder that this process holds, and run to the end."""
    with spinner("restoring the simulation", quiet=quiet):
        sim, notes = newest_whole(folder.path, device)
        scene = load_scene(folder.path / MODEL_FILE)
    path, surface = _files(folder.path, sim.model)["frames"], _shown_surface(sim.model)
    writer = VTKHDFWriter.reopen(path, sim.model, surface, keep=notes["frames"])
    _warn_of_changes(about.get("scene"), scene)
    said = {key: value for key, value in about.items() if key not in ("tledface", "error")}
    facts = {key: value for key, value in said.items() if key not in ("state", "files")}
    folder.write({**said, "state": "running"})
    name = sim._device.info.name
    work = partial(_simulate, scene, sim, folder.path, name, quiet=quiet, went_on=(writer, notes))
    return _recorded(work, sim, folder, facts)


def _warn_of_changes(path: str | None, scene: Scene) -> None:
    """Tell of a scene file that is not, or no longer, what the run began with."""
    from tledface.scene import MODEL_ENDINGS

    # Named as it was then: seen from another folder it may not be there.
    if path is None or not Path(path).is_file() or Path(path).suffix.lower() in MODEL_ENDINGS:
        return
    try:
        tables = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        tables = None
    if tables != scene.source:
        warnings.warn(
            f"{path} is not, or no longer, the scene that this run began with; the run goes on "
            "with the scene of then; run --force starts again with that of now",
            stacklevel=2,
        )


def _recorded(
    work: Callable[[], RunResult], sim: Simulator, folder: OutputFolder, facts: dict[str, Any]
) -> RunResult:
    """Do the run, and say in ``run.json`` how it ended."""
    try:
        result = work()
    except BaseException as error:
        state = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
        line = str(error).splitlines()[0] if str(error) else type(error).__name__
        kept = sorted(path.name for path in folder.path.glob("frames*.vtkhdf"))
        # On a full disk the record stays as it was, and the first error is the one to tell.
        with suppress(OSError):
            folder.write({**facts, "state": state, "error": line, "files": kept})
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(_interrupted(sim, folder.path, kept)) from error
        if isinstance(error, SimulationError) and kept:
            raise SimulationError(f"{line}; the frames until then are in {folder.path}") from error
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            raise OSError(error.errno, _no_room(error, folder.path), error.filename) from error
        raise
    names = [path.name for path in result.files.values()]
    folder.write({**facts, "state": "finished", "files": names, "result": result.to_dict()})
    remove_from(folder.path)
    return result


def _interrupted(sim: Simulator, folder: Path, kept: list[str]) -> str:
    """The line that says where an interrupted run stands and how it goes on."""
    go_on = how_to_resume(folder) or "there is no checkpoint"
    frames = f"frames are in {folder}" if kept else f"no frames in {folder}"
    return f"interrupted at t = {sim.playback_time:.6g} s; {frames}; {go_on}"


def _no_room(error: OSError, folder: Path) -> str:
    """What to do about a disk that is full, or a limit of file sizes."""
    limited = error.errno == errno.EFBIG
    first = "raise the limit of file sizes (ulimit -f)" if limited else "make room"
    again = how_to_resume(folder) or "run it again with --force"
    return f"{error.strerror}; {first}, then {again}"


def simulator_of(scene: Scene, model: Model, device: Any) -> Simulator:
    """A simulator with the scene's solver settings and muscle activations.

    Raises InputError: a setting the simulator refuses, or a duration shorter than one step.
    """
    from tledface.simulator import Simulator

    solver = scene.solver
    more: dict[str, Any] = {}
    if solver.hourglass_kappa is not None:
        more["hourglass_kappa"] = solver.hourglass_kappa
    try:
        sim = Simulator(
            model,
            device=device,
            precision=solver.precision,
            damping=solver.damping,
            hourglass=solver.hourglass,
            dt=solver.dt,
            mass_scaling=solver.mass_scaling,
            time_scaling=solver.time_scaling,
            subcycling=solver.subcycling,
            **more,
        )
    except InputError as error:
        raise InputError(f"{scene.path or 'scene'}: solver: {error}") from None
    shortest = sim.dt * solver.time_scaling
    if solver.duration < shortest * (1 - 1e-9):
        raise InputError(
            f"{scene.path or 'scene'}: solver.duration: got {solver.duration:.3g} s, shorter than "
            f"one step of {shortest:.3g} s; take a longer one"
        )
    if not solver.duration / shortest <= _MOST_STEPS:
        raise InputError(
            f"{scene.path or 'scene'}: solver.duration: got {solver.duration:.3g} s, "
            f"{solver.duration / shortest:.3g} steps of {shortest:.3g} s; allowed: "
            f"{_MOST_STEPS:g} steps; take a shorter one"
        )
    for muscle in scene.muscles:
        sim.activate(muscle.name, muscle.activation)
    return sim


def save_built(scene: Scene, model: Model, path: str | Path) -> None:
    """Save a model together with the scene it came from, so that ``load_run`` can run it."""
    import json

    from tledface.io._atomic import atomic_path
    from tledface.io._hdf5 import opened

    with atomic_path(Path(path), "model file") as part:
        model.save(part)
        with opened(part, "r+") as file:
            file["scene"] = json.dumps(scene.source)


def load_run(path: str | Path) -> tuple[Scene, Model]:
    """A model file's model and the scene it was built from.

    Raises InputError: not a model file, or one that holds no scene (saved from Python).
    """
    from tledface.model import Model

    model = Model.load(path)
    return load_scene(path), model


def load_scene(path: str | Path) -> Scene:
    """The scene in a model file written by ``save_built``; raises InputError if it holds none."""
    import json

    import h5py

    from tledface.scene import Scene

    with h5py.File(path, "r") as file:
        if "scene" not in file:
            raise InputError(
                f"model file {path}: holds no scene, so duration and activations are unknown; "
                "run the scene file, or the model from Python with tledface.Simulator"
            )
        tables = json.loads(file["scene"].asstr()[()])
    return Scene.from_dict(tables, check_files=False)


def _simulate(
    scene: Scene,
    sim: Simulator,
    folder: Path,
    device: str,
    *,
    quiet: bool,
    went_on: tuple[VTKHDFWriter, dict[str, Any]] | None = None,
) -> RunResult:
    """Simulate to the end, from the start or from a checkpoint (frames reopened, its notes)."""
    pace = scene.solver.time_scaling
    # In simulated time, as everything here; frames are written at the time of the playback.
    duration, fps = scene.solver.duration / pace, min(scene.output.fps * pace, _MOST_FPS)
    every = scene.output.checkpoint_every
    every = every / pace if isinstance(every, float) else every
    model = sim.model
    surface = _shown_surface(model)
    checkpoints = RunCheckpoints(folder, scene, model, every)
    if went_on is None:
        path = _files(folder, model)["frames"]
        writer = VTKHDFWriter(path, model, surface, frames=reserved_frames(scene, sim))
        notes: dict[str, Any] = {"frames": 0, "last_time": -1.0, "wall": 0.0}
        notes["dt_crit"] = sim.dt_crit
        if pace != 1.0:
            writer.note_time_scaling(pace)
    else:
        writer, notes = went_on
        checkpoints.wait(sim)
    started = time.perf_counter() - notes["wall"]
    with (
        writer,
        _Frames(writer, model.surfaces[surface], fps, pace, notes) as frames,
        ProgressBar("simulating", duration, quiet=quiet) as bar,
    ):

        def take_checkpoint(sim: Simulator) -> None:
            frames.settle()  # those that it counts are in the file
            now = {
                "frames": frames.count,
                "next_frame": frames.next,
                "last_time": frames.last_time,
                "wall": time.perf_counter() - started,
            }
            checkpoints.take(sim, writer, {**notes, **now})

        def on_tick(sim: Simulator) -> None:
            bar.update(sim.time, f"t = {sim.time * pace * 1e3:.2f} ms")
            if frames.due(sim):
                frames.take(sim)
            if checkpoints.due(sim):
                take_checkpoint(sim)

        on_tick(sim)
        # Ticks fall on every frame, and often enough between them for checkpoints and the bar.
        per_frame = max(1, round(_PROGRESS_TICKS / (fps * duration)))
        if isinstance(every, float):
            per_frame = max(per_frame, math.ceil(1.0 / (fps * every)))
        sim.run(until=duration, on_frame=on_tick, fps=fps * per_frame, wait=False)
        if frames.last_time < sim.time:
            frames.take(sim)
        bar.update(duration)
    wall = time.perf_counter() - started
    u = sim.u
    folds = _folds(scene, model, surface, u)
    return RunResult(
        directory=folder,
        files=_write_results(scene, model, surface, u, folds, folder),
        device=device,
        precision=scene.solver.precision,
        n_elements=model.n_elements,
        n_nodes=model.n_nodes,
        steps=sim.n_steps,
        dt=sim.time / sim.n_steps,
        substeps=sim.substeps,
        dt_crit=notes["dt_crit"],
        simulated=sim.time,
        time_scaling=pace,
        added_mass=sim.added_mass,
        wall=wall,
        frames=frames.count,
        max_displacement=float(np.sqrt((u**2).sum(axis=1).max())),
        folds=folds,
    )


class _Frames(FrameQueue):
    """Frames at equal times, the first at the start, written at ``pace`` times their time.

    A step gives one frame at most: where several fall on it, the first stands for all.
    """

    def __init__(
        self,
        writer: VTKHDFWriter,
        surface: BoundSurface,
        fps: float,
        pace: float,
        notes: Mapping[str, Any],
    ) -> None:
        super().__init__(self._append)
        self._writer, self._surface, self._fps, self._pace = writer, surface, fps, pace
        self.count: int = notes["frames"]
        self.next: int = notes.get("next_frame", self.count)
        self.last_time: float = notes["last_time"]

    def due(self, sim: Simulator) -> bool:
        return sim.time > self.last_time and self._reached(sim) >= self.next / self._fps

    def take(self, sim: Simulator) -> None:
        self.make_room()  # before there is one more snapshot
        self.put(sim.snapshot())
        self.count += 1
        self.next = max(self.next, math.floor(self._reached(sim) * self._fps)) + 1
        self.last_time = sim.time

    def _reached(self, sim: Simulator) -> float:
        """Times up to here are nearer to this step than to the next."""
        return sim.time + 0.51 * sim.dt

    def _append(self, snapshot: Snapshot) -> None:
        u = snapshot.u  # first, since it raises where the state is not finite
        # Stress may depend on the past, which frames do not hold; an evaluation is some five steps.
        stress = snapshot.von_mises()
        self._writer.append(
            snapshot.time * self._pace,
            u,
            von_mises=stress,
            on_surface={"von_mises": self._surface.of_elements(stress)},
        )


def shown_surface(model: Model) -> BoundSurface:
    """The surface that frames and picture of a run show."""
    return model.surfaces[_shown_surface(model)]


def _shown_surface(model: Model) -> str:
    return "skin" if "skin" in model.surfaces else next(iter(model.surfaces))


def _shown_beside(model: Model, surface: str) -> list[tuple[str, str]]:
    """Name and role of each surface besides the one shown."""
    return [(name, f"surface {name}") for name in model.surfaces if name != surface]


def _files(folder: Path, model: Model) -> dict[str, Path]:
    shown = _shown_surface(model)
    return {
        "frames": folder / "frames.vtkhdf",
        "surface frames": folder / "frames_surface.vtkhdf",
        "surface": folder / f"{shown}.ply",
        **{role: folder / f"{name}.obj" for name, role in _shown_beside(model, shown)},
        "picture": folder / "wrinkles.png",
    }


def _write_results(
    scene: Scene,
    model: Model,
    surface: str,
    u: NDArray[np.float64],
    folds: Folds | None,
    folder: Path,
) -> dict[str, Path]:
    from tledface.picture import wrinkle_picture
    from tledface.surface import boundary_surface

    bound = model.surfaces[surface]
    moved = bound.displaced(u)
    files = _files(folder, model)
    write_surface(files["surface"], moved, bound.polygons)
    for name, role in _shown_beside(model, surface):
        other = model.surfaces[name]
        write_surface(files[role], other.displaced(u), other.polygons)
    if not len(bound.bound_faces):
        # A skin too coarse for the region: the build warned of it.
        bound = boundary_surface(model)
        moved = bound.displaced(u)
    view: dict[str, Any] = {"profile": False}
    if folds is not None:
        view = {"profile": folds.line, "min_prominence": folds.min_prominence}
        if abs(folds.up[2]) < 0.9:
            # A body seen from straight before its muscle, head up.
            view |= {"view": folds.up, "up": (0.0, 0.0, 1.0)}
        elif scene.geometry.outer == "all":
            view |= {"view": folds.up, "up": (0.0, 1.0, 0.0)}
        else:
            view |= {"view": "oblique", "up": folds.up}
    wrinkle_picture(files["picture"], bound.vertices, moved, bound.bound_faces, **view)
    return files


def _folds(scene: Scene, model: Model, surface: str, u: NDArray[np.float64]) -> Folds | None:
    from tledface.folds import measure_folds

    levels = {
        muscle.name: muscle.activation(scene.solver.duration) * muscle.sigma_act
        for muscle in scene.muscles
    }
    outer = scene.geometry.outer
    try:
        return measure_folds(model, surface, u, levels, None if isinstance(outer, str) else outer)
    except Exception as error:
        # The simulation is done and its frames are there: a figure less does not undo that.
        line = str(error).splitlines()[0] if str(error) else type(error).__name__
        warnings.warn(f"folds not measured ({line}); the run is whole without them", stacklevel=2)
        return None
