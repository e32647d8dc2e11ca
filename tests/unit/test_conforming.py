"""Conforming meshes: reading them, what is refused, what they have and lack."""

import subprocess
import sys

import numpy as np
import pytest

import tledface as tf
from conftest import required
from tledface.errors import InputError

FAT = tf.material("neo_hookean", youngs_modulus=30e3, poissons_ratio=0.45, density=1000.0)
SKIN = tf.material("neo_hookean", youngs_modulus=90e3, poissons_ratio=0.45, density=1100.0)


def bent():
    """A bent block of 4 x 3 x 2 hexahedra, nodes and elements."""
    block = tf.Model.block((4, 3, 2), (4.0, 3.0, 2.0), FAT)
    nodes = block.nodes.copy()
    nodes[:, 2] += 0.1 * nodes[:, 0] ** 2
    return nodes, block.elements


def write(path, regions=None, names=None, **kinds):
    meshio = required("meshio")
    nodes, elements = bent()
    nodes = np.vstack([nodes, [[9.0, 9.0, 9.0]]])  # a node that no hexahedron has
    cells = kinds or {"hexahedron": elements}
    data = {} if regions is None else {"gmsh:physical": [regions]}
    field = {} if names is None else {n: np.array([i, 3]) for n, i in names.items()}
    meshio.Mesh(nodes, cells, cell_data=data, field_data=field).write(path)
    return path


@pytest.mark.parametrize("name", ["mesh.vtk", "mesh.vtu", "mesh.inp"])
def test_one_material(tmp_path, name):
    model = tf.Model.from_mesh(write(tmp_path / name), FAT, scale=1e-3)
    nodes, elements = bent()
    assert model.is_conforming and model.tissues == ["tissue"]
    assert np.allclose(model.nodes, nodes * 1e-3, atol=1e-12)
    assert np.array_equal(model.elements, elements)
    assert model.volumes.sum() == pytest.approx(24e-9, rel=1e-9)  # bending shears, no more


def test_regions_become_tissues(tmp_path):
    path = write(tmp_path / "m.vtu", regions=np.repeat([7, 3], 12))
    model = tf.Model.from_mesh(path, {3: SKIN, 7: FAT}, scale=1e-3)
    assert model.tissues == ["3", "7"]
    assert np.array_equal(model.fractions[:, 0], np.repeat([0.0, 1.0], 12))
    assert model.tissue_materials == [SKIN, FAT]
    other = tf.Model.from_mesh(path, {3: SKIN, 7: FAT}, regions="gmsh:physical")
    assert other.volumes.sum() == pytest.approx(24.0)


@pytest.mark.parametrize("of_surfaces", [[], ['2 1 "held face"']])
def test_regions_named_by_the_file(tmp_path, of_surfaces):
    required("meshio")
    path = tmp_path / "m.msh"
    nodes, elements = bent()
    lines = [
        "$MeshFormat",
        "2.2 0 8",
        "$EndMeshFormat",
        "$PhysicalNames",
        str(2 + len(of_surfaces)),
    ]
    # A group of surfaces has the number of one of volumes and names none of them.
    lines += [
        '3 1 "fat"',
        '3 2 "skin"',
        *of_surfaces,
        "$EndPhysicalNames",
        "$Nodes",
        str(len(nodes)),
    ]
    lines += [f"{i + 1} {x} {y} {z}" for i, (x, y, z) in enumerate(nodes.tolist())]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for i, corners in enumerate(elements.tolist()):
        tag = 1 if i < 12 else 2
        lines.append(f"{i + 1} 5 2 {tag} {tag} " + " ".join(str(n + 1) for n in corners))
    path.write_text("\n".join([*lines, "$EndElements", ""]))
    model = tf.Model.from_mesh(path, {"fat": FAT, "skin": SKIN}, scale=1e-3)
    assert model.tissues == ["fat", "skin"]
    assert model.tissue_of(0) == "fat" and model.tissue_of(23) == "skin"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda n, e: (n, e[:, [0, 3, 2, 1, 4, 7, 6, 5]]), "24 such"),
        (lambda n, e: (np.where(n > 1e9, n, np.nan), e), "finite metres"),
        (
            lambda n, e: (np.where(np.arange(3 * len(n)).reshape(-1, 3) > 6, np.nan, n), e),
            r"nodes: got nan at \[2, 1\] \(\d+ such of \d+\), which is not finite",
        ),
        (lambda n, e: (n, e[:, :6]), r"got shape \(24, 6\)"),
        (lambda n, e: (n, e + 1), "allowed 0 to 59"),
        (lambda n, e: (n, e[:0]), "got none"),
        (lambda n, e: (np.vstack([n, n[:1]]), e), "1 of 61 belong to no element"),
        (lambda n, e: (n * (1, 1, 0), e), "degenerate"),
    ],
)
def test_bad_meshes_are_refused(change, says):
    nodes, elements = change(*bent())
    with pytest.raises(InputError, match=says):
        tf.Model.from_hexahedra(nodes, elements, ["t"], [FAT], np.ones((len(elements), 1)))


def test_bad_files_are_one_line(tmp_path):
    required("meshio")
    with pytest.raises(InputError, match="no such file"):
        tf.Model.from_mesh(tmp_path / "none.vtk", FAT)
    broken = tmp_path / "broken.vtk"
    broken.write_text("no mesh")
    with pytest.raises(InputError, match=r"broken.vtk: .*read"):
        tf.Model.from_mesh(broken, FAT)
    surface = write(tmp_path / "s.vtk", triangle=np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="it has triangle; elements of kind 'hexahedron'"):
        tf.Model.from_mesh(surface, FAT)
    plain = write(tmp_path / "plain.vtk")
    with pytest.raises(InputError, match="region numbers are needed"):
        tf.Model.from_mesh(plain, {1: FAT})
    regions = write(tmp_path / "r.vtu", regions=np.repeat([1, 2], 12))
    with pytest.raises(InputError, match=r"region '2' has no material; .* for 1"):
        tf.Model.from_mesh(regions, {1: FAT})
    with pytest.raises(InputError, match="scale is 0"):
        tf.Model.from_mesh(plain, FAT, scale=0)


def test_without_meshio_it_says_what_brings_it(tmp_path):
    code = (
        "import sys; sys.modules['meshio'] = None\n"
        "import tledface as tf\n"
        "m = tf.material('neo_hookean', youngs_modulus=1e4, poissons_ratio=0.4, density=1e3)\n"
        "try: tf.Model.from_mesh('x.vtk', m)\n"
        "except tf.InputError as e: print(e)\n"
    )
    got = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 'pip install "tledface[mesh]"' in got.stdout


def test_boundary_surface_and_what_is_not_there(tmp_path):
    model = tf.Model.from_mesh(write(tmp_path / "m.vtk"), FAT, scale=1e-3)
    surface = model.surfaces["surface"]
    assert len(surface.faces) == 2 * 2 * (4 * 3 + 3 * 2 + 4 * 2)
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(24e-9, rel=0.01) and volume > 0  # outwards
    assert np.array_equal(surface.displaced(np.zeros_like(model.nodes)), surface.vertices)
    with pytest.raises(AttributeError, match="no grid of voxels"):
        _ = model.voxel
    with pytest.raises(InputError, match="voxel models only"):
        tf.surface.BoundSurface.on(model, surface.vertices, surface.faces)


def test_saved_and_read_again(tmp_path):
    model = tf.Model.from_mesh(write(tmp_path / "m.vtk"), FAT, scale=1e-3)
    model.add_muscle("m", lambda c: c[:, 0] < 2e-3, fibre=(1, 0, 0), sigma_act=1e4)
    model.fix(lambda X: X[:, 0] < 1e-9)
    model.pressure(lambda c, n: n[:, 2] > 0.5, 100.0)
    model.body_force(lambda c: c[:, 0] > 0.0, (0.0, 0.0, 5.0))
    model.save(tmp_path / "m.h5")
    again = tf.Model.load(tmp_path / "m.h5")
    assert again.is_conforming
    for name in ("nodes", "elements", "fractions", "fixed", "volumes"):
        assert np.array_equal(getattr(again, name), getattr(model, name))
    sims = [tf.Simulator(m, device="native", energy_every=10) for m in (model, again)]
    # Area seen from above times the pressure, and the body force.
    total = -100.0 * 12e-6 + 5.0 * 24e-9
    assert sims[0].external_force()[:, 2].sum() == pytest.approx(total, rel=1e-9)
    for sim in sims:
        sim.activate("m", 0.2)
        sim.step(40)
    assert np.array_equal(sims[0].u, sims[1].u)
    assert sims[0].energies == sims[1].energies


def test_frames_are_written(tmp_path):
    required("vtk")
    from tledface.io.vtkhdf import VTKHDFWriter

    model = tf.Model.from_mesh(write(tmp_path / "m.vtk"), FAT, scale=1e-3)
    sim = tf.Simulator(model, device="native")
    with VTKHDFWriter(tmp_path / "f.vtkhdf", model) as writer:
        writer.append(0.0, sim.u)
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(tmp_path / "f.vtkhdf"))
    reader.Update()
    assert reader.GetOutput().GetNumberOfCells() == 24


def test_a_voxel_model_keeps_what_it_can_as_a_mesh(tmp_path):
    weights = np.linspace(0.5, 1.0, 24)
    block = tf.Model.block((4, 3, 2), (4e-3, 3e-3, 2e-3), FAT)
    voxels = tf.Model.from_voxels(
        block.voxel, block.origin, block.cells, ["fat"], [FAT], np.ones((24, 1)), fill=weights
    )
    voxels.add_muscle("m", lambda c: c[:, 2] < 1e-3, fibre=(1, 0, 0), sigma_act=1e4)
    mesh = voxels.as_hexahedra()
    mesh.save(tmp_path / "m.h5")
    again = tf.Model.load(tmp_path / "m.h5")
    u = 0.1e-3 * np.random.default_rng(4).standard_normal(voxels.nodes.shape)
    forces = []
    for model in (voxels, mesh, again):
        sim = tf.Simulator(model, device="native", precision="double")
        sim.activate("m", 0.5)
        sim.set_state(u)
        forces.append(sim.internal_force())
        assert sim.mass.sum() == pytest.approx(1000.0 * weights.mean() * 24e-9)
    assert abs(forces[1] - forces[0]).max() <= 1e-12 * abs(forces[0]).max()
    assert np.array_equal(forces[1], forces[2])
