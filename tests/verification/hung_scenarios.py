"""Runs of the shipped block of Hung et al. (2009), and the trends that its paper reports."""

import json
from dataclasses import asdict, dataclass

import numpy as np

from tledface.examples import hung_block
from tledface.run import simulator_of
from tledface.scene import Scene

# m, at calcium 0.9: reported beside ours, never asserted. They belong to the paper's mesh.
PAPER = {"spacing": 9.14e-3, "first_crest": 1.16e-3}
HOMOGENEOUS, SOFTER = 1 / 5, 4 / 3


@dataclass(frozen=True)
class Run:
    """A block at the end of its run; lengths in m.

    ``moved``: how far from there the equilibrium is that `relax` finds (NaN: not asked for).
    ``places`` (nx + 1, nz + 1, 2), ``tissue`` (nx, nz): the nodes of the middle plane, deformed,
    and what most of each voxel there is. ``crests``, ``troughs``: as `hung_block.BlockFolds`.
    """

    scenario: str
    calcium: float
    voxel: float
    bending: str
    elements: int
    steps: int
    folds: int
    spacing: float
    depth: float
    first_crest: float
    end: float
    smallest_J: float
    hourglass: float
    moved: float
    places: np.ndarray
    tissue: np.ndarray
    crests: np.ndarray
    troughs: np.ndarray

    @property
    def figures(self):
        """All but the arrays."""
        return {k: v for k, v in asdict(self).items() if not isinstance(v, np.ndarray)}


def run(folder, *, device="native", relax=False, **settings):
    """Write, build and simulate a block; settings are those of `hung_block.write`."""
    path = hung_block.write(folder, **settings)
    scene = Scene.load(path)
    model = scene.build()
    sim = simulator_of(scene, model, device)
    sim.run(until=scene.solver.duration)
    u, moved = sim.u, float("nan")
    surface = sim.surface("skin")
    found = hung_block.measure(surface.vertices, surface.faces)
    J = np.linalg.det(sim.deformation_gradient())
    hourglass, strain = sim.hourglass_energy().sum(), sim.strain_energy().sum()
    steps = sim.n_steps
    if relax:
        info = sim.relax(tolerance=1e-3)
        assert info.converged, info
        moved = float(np.linalg.norm(sim.u - u, axis=1).max())
    n = model.cells.max(axis=0) + 1
    middle = model.node_ijk[:, 1] == n[1] // 2
    places = np.empty((n[0] + 1, n[2] + 1, 2))
    at = model.node_ijk[middle]
    places[at[:, 0], at[:, 2]] = (model.nodes + u)[middle][:, [0, 2]]
    middle = model.cells[:, 1] == n[1] // 2
    tissue = np.empty((n[0], n[2]), dtype=int)
    at = model.cells[middle]
    tissue[at[:, 0], at[:, 2]] = model.fractions[middle].argmax(axis=1)
    return Run(
        scenario=settings.get("scenario", "base"),
        calcium=settings.get("calcium", 0.9),
        voxel=settings.get("voxel", 0.5),
        bending=settings.get("bending", "blended"),
        elements=model.n_elements,
        steps=steps,
        folds=len(found.crests),
        spacing=found.spacing,
        depth=found.depth,
        first_crest=found.first_crest,
        end=found.end,
        smallest_J=float(J.min()),
        hourglass=float(hourglass / (hourglass + strain)),
        moved=moved,
        places=places,
        tissue=tissue,
        crests=found.crests,
        troughs=found.troughs,
    )


def trends(runs):
    """The paper's four findings at calcium 0.6, by number: (what, got, limit, whether it holds).

    ``runs``: a `Run` for each of `hung_block.SCENARIOS`, alike in all else. The fourth holds where
    the folds are those of the mesh, so it is the caller's to judge.
    """
    base = runs["base"]
    depth = {name: found.depth / base.depth for name, found in runs.items()}
    closer = runs["thin-skin"].spacing / base.spacing
    even, soft, fat = depth["homogeneous-skin"], depth["soft-skin"], depth["thick-subcutis"]
    return [
        ("homogeneous skin: depth over the base's", even, HOMOGENEOUS, even < HOMOGENEOUS),
        ("half the skin's stiffness: depth over the base's", soft, SOFTER, soft >= SOFTER),
        ("twice the subcutis: depth over the base's", fat, 1.0, fat < 1.0),
        ("half the skin: spacing over the base's", closer, 1.0, closer < 1.0),
    ]


def save(path, done):
    """Keep a run as an .npz."""
    arrays = {k: v for k, v in asdict(done).items() if isinstance(v, np.ndarray)}
    np.savez_compressed(path, figures=json.dumps(done.figures), **arrays)


def load(path):
    """A run that was kept."""
    with np.load(path) as file:
        return Run(
            **json.loads(str(file["figures"])),
            **{name: file[name] for name in ("places", "tissue", "crests", "troughs")},
        )
