import os
import subprocess
import sys

import h5py
import numpy as np
import pytest
import trimesh

from conftest import file_limit, required
from tledface.constitutive import material
from tledface.errors import InputError
from tledface.io.surfaces import SURFACE_ENDINGS, write_surface
from tledface.io.vtkhdf import VTKHDFSurfaceWriter, VTKHDFWriter
from tledface.model import Model
from tledface.surface import BoundSurface

SOFT = material("neo_hookean", youngs_modulus=34e3, poissons_ratio=0.49, density=1100.0)
STIFF = material(
    "neo_hookean", youngs_modulus=2e6, poissons_ratio=0.3, density=1300.0, volumetric="quadratic"
)


@pytest.fixture
def model():
    cells = np.argwhere(np.random.default_rng(0).random((5, 4, 3)) < 0.6)
    n = len(cells)
    share = np.linspace(0, 1, n)
    model = Model.from_voxels(
        (1e-3, 2e-3, 3e-3), (1, 2, 3), cells[::-1], ["fat", "dermis/upper"], [SOFT, STIFF],
        np.stack([share, 1 - share], axis=1),
        section_ratio=np.linspace(0.1, 1, n), layer_normal=np.tile([0, 0.6, 0.8], (n, 1)),
    )  # fmt: skip
    model.fix(lambda x: x[:, 0] < 1.002, "xz")
    model.gravity = (0, 0, -9.81)
    model.add_muscle(
        "frontalis", model.cells[:, 0] > 2, np.random.default_rng(1).normal(size=(n, 3)),
        sigma_act=5e6, sigma_pas=1e6, lambda_opt=1.1, lambda_pas=1.3, weight=share,
    )  # fmt: skip
    model.add_muscle("corrugator", model.cells[:, 1] > 0, (0, 1, 0), sigma_act=2e6)
    model.surfaces["skin"] = BoundSurface.on(model, model.nodes[:9] + 1e-4, [[0, 1, 2], [2, 3, 8]])
    return model


def test_a_model_comes_back_bit_for_bit(model, tmp_path):
    path = tmp_path / "model.h5"
    model.save(path)
    back = Model.load(path)
    arrays = "voxel origin cells node_ijk nodes elements fractions section_ratio layer_normal fixed"
    for name in [*arrays.split(), "gravity"]:
        assert np.array_equal(getattr(back, name), getattr(model, name)), name
        assert getattr(back, name).dtype == getattr(model, name).dtype, name
    assert back.tissues == model.tissues
    assert back.tissue_materials == model.tissue_materials
    for ours, theirs in zip(model.muscles, back.muscles, strict=True):
        for name in vars(ours):
            if name == "fibre":
                assert theirs.fibre == pytest.approx(ours.fibre, abs=1e-15)
            else:
                assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name
    assert list(back.surfaces) == ["surface", "skin"]
    u = np.random.default_rng(2).normal(size=model.nodes.shape)
    for name, surface in model.surfaces.items():
        assert np.array_equal(back.surfaces[name].displaced(u), surface.displaced(u))
        assert np.array_equal(back.surfaces[name].faces, surface.faces)
    assert os.listdir(tmp_path) == ["model.h5"]


def test_a_saved_copy_of_a_loaded_model_holds_the_same_fibres(model, tmp_path):
    model.save(tmp_path / "a.h5")
    Model.load(tmp_path / "a.h5").save(tmp_path / "b.h5")
    first, second = Model.load(tmp_path / "a.h5"), Model.load(tmp_path / "b.h5")
    assert np.array_equal(first.muscles[0].fibre, second.muscles[0].fibre)


def edit(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def truncate(path):
    path.write_bytes(path.read_bytes()[:-2000])


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (truncate, "cut short"),
        (lambda path: path.write_text("solid"), "not an HDF5 file"),
        (lambda path: path.unlink(), "no such file"),
        (lambda path: edit(path, lambda f: f.attrs.update(format="x")), "not a tledface model"),
        (lambda path: edit(path, lambda f: f.attrs.update(version=99)), "version 99"),
        (lambda path: edit(path, lambda f: f.pop("cells")), "damaged"),
        (lambda path: edit(path, lambda f: f["tissues/0"].attrs.update(model="jelly")), "jelly"),
        (lambda path: edit(path, lambda f: f.pop("tissues/0")), "damaged"),
        (lambda path: edit(path, lambda f: f["fractions"].__setitem__(..., 0.0)), "fractions"),
    ],
)
def test_unusable_model_files_are_one_clear_line(model, tmp_path, change, word):
    path = tmp_path / "model.h5"
    model.save(path)
    change(path)
    with pytest.raises(InputError, match=word) as caught:
        Model.load(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_no_file_is_refused(model, tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="folder: is a folder; give the name of a file"):
        model.save(tmp_path / "folder")
    with pytest.raises(InputError, match="cannot be made there"):
        model.save(tmp_path / f"{'x' * 300}.h5")
    with pytest.raises(InputError, match="folder: is a folder; give a model file"):
        Model.load(tmp_path / "folder")
    for call in (model.save, Model.load):
        with pytest.raises(InputError, match="model file: got None; allowed: the path of a file"):
            call(None)
    assert os.listdir(tmp_path) == ["folder"]
    assert os.listdir(tmp_path / "folder") == []


def test_a_failed_save_leaves_the_old_file(model, tmp_path):
    path = tmp_path / "model.h5"
    model.save(path)
    before = path.read_bytes()
    model.tissue_materials.append(SOFT)
    with pytest.raises(ValueError):
        model.save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["model.h5"]
    with pytest.raises(InputError, match="no folder"):
        model.save(tmp_path / "missing" / "model.h5")


@pytest.mark.parametrize("ending", SURFACE_ENDINGS)
def test_surfaces_are_written(model, tmp_path, ending):
    surface = model.surfaces["surface"]
    path = tmp_path / f"skin{ending}"
    write_surface(path, surface.vertices, surface.faces)
    back = trimesh.load(path, process=False, force="mesh")
    assert len(back.faces) == len(surface.faces)
    assert back.bounds == pytest.approx(
        np.stack([surface.vertices.min(0), surface.vertices.max(0)])
    )
    assert os.listdir(tmp_path) == [path.name]


def test_an_unknown_ending_is_named(model, tmp_path):
    surface = model.surfaces["surface"]
    with pytest.raises(InputError, match=r"'.fbx'.*\.ply"):
        write_surface(tmp_path / "skin.fbx", surface.vertices, surface.faces)


def vtk_steps(path):
    hdf = required("vtkmodules.vtkIOHDF")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline

    reader = hdf.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())

    def arrays(data):
        names = [data.GetArrayName(n) for n in range(data.GetNumberOfArrays())]
        return {name: vtk_to_numpy(data.GetArray(name)).copy() for name in names}

    steps = []
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        grid = reader.GetOutput()
        points = vtk_to_numpy(grid.GetPoints().GetData()).copy()
        cells = [
            [grid.GetCell(c).GetPointId(n) for n in range(grid.GetCell(c).GetNumberOfPoints())]
            for c in range(grid.GetNumberOfCells())
        ]
        steps.append((points, cells, arrays(grid.GetPointData()), arrays(grid.GetCellData())))
    return list(times), steps


def test_vtk_reads_the_time_series(model, tmp_path):
    rng = np.random.default_rng(3)
    u = rng.normal(size=(3, *model.nodes.shape)).astype(np.float32)
    stress = rng.normal(size=(3, model.n_elements, 6)).astype(np.float32)
    with VTKHDFWriter(tmp_path / "run.vtkhdf", model, surface="skin") as writer:
        for step in range(3):
            writer.append(0.01 * step, u[step], stress=stress[step], speed=u[step, :, 0])
    assert sorted(os.listdir(tmp_path)) == ["run.vtkhdf", "run_surface.vtkhdf"]
    times, steps = vtk_steps(tmp_path / "run.vtkhdf")
    assert times == [0.0, 0.01, 0.02]
    for step, (points, cells, point_data, cell_data) in enumerate(steps):
        assert np.array_equal(points, model.nodes)
        assert np.array_equal(cells, model.elements)
        assert np.array_equal(point_data["displacement"], u[step])
        assert np.array_equal(point_data["speed"], u[step, :, 0])
        assert np.array_equal(cell_data["stress"], stress[step])
        assert np.array_equal(cell_data["tissue"], model.fractions.argmax(axis=1))
        assert cell_data["fraction_dermis_upper"] == pytest.approx(model.fractions[:, 1])
        weight = np.zeros(model.n_elements)
        weight[model.muscles[0].elements] = model.muscles[0].weight
        assert cell_data["muscle_frontalis"] == pytest.approx(weight)
    times, steps = vtk_steps(tmp_path / "run_surface.vtkhdf")
    assert times == [0.0, 0.01, 0.02]
    for step, (points, cells, _, _) in enumerate(steps):
        assert points == pytest.approx(model.surfaces["skin"].displaced(u[step]), abs=1e-12)
        assert np.array_equal(cells, model.surfaces["skin"].faces)


def test_names_that_differ_in_a_slash_have_fields_of_their_own(tmp_path):
    cells = [[i, 0, 0] for i in range(4)]
    tissues = ["a/m", "a_m", "a_m_"]
    share = np.eye(3)[[0, 1, 2, 2]]
    block = Model.from_voxels(
        (1e-3, 1e-3, 1e-3), (0, 0, 0), cells, tissues, [SOFT, STIFF, STIFF], share
    )
    for index, name in enumerate(["a_m", "a/m_", "a/m/"]):
        block.add_muscle(name, np.arange(4) == index, (1, 0, 0), sigma_act=1.0)
    with VTKHDFWriter(tmp_path / "run.vtkhdf", block) as writer:
        writer.append(0.0, np.zeros_like(block.nodes))
    with h5py.File(tmp_path / "run.vtkhdf") as file:
        cells = {name: data[()].tolist() for name, data in file["VTKHDF/CellData"].items()}
    assert cells == {
        "tissue": [0, 1, 2, 2],
        "fraction_a_m__": [1, 0, 0, 0],
        "fraction_a_m": [0, 1, 0, 0],
        "fraction_a_m_": [0, 0, 1, 1],
        "muscle_a_m": [1, 0, 0, 0],
        "muscle_a_m_": [0, 1, 0, 0],
        "muscle_a_m__": [0, 0, 1, 0],
    }


def test_surface_series_with_arrays(tmp_path):
    points = np.eye(3)
    with VTKHDFSurfaceWriter(tmp_path / "s.vtkhdf", [[0, 1, 2]], 3) as writer:
        writer.append(0.0, points, height=[1, 2, 3])
        writer.append(1.0, 2 * points, height=[4, 5, 6])
    _, steps = vtk_steps(tmp_path / "s.vtkhdf")
    assert steps[1][2]["height"].tolist() == [4, 5, 6]
    assert np.array_equal(steps[1][0], 2 * points)


def test_bad_frames_are_refused_and_leave_the_file_whole(model, tmp_path):
    still = np.zeros_like(model.nodes)
    with VTKHDFWriter(tmp_path / "run.vtkhdf", model) as writer:
        writer.append(0.0, still)
        for arguments, arrays, word in (
            ((0.0, still), {}, "above the last"),
            ((np.nan, still), {}, "finite"),
            ((1.0, still[1:]), {}, "displacement has shape"),
            ((1.0, still), {"stress": np.zeros(model.n_elements)}, "same arrays"),
            ((1.0, still), {"odd": np.zeros(5)}, "'odd' has shape"),
            ((1.0, still), {"tissue": np.zeros(model.n_elements)}, "field of the model"),
        ):
            with pytest.raises(InputError, match=word):
                writer.append(*arguments, **arrays)
        writer.append(1.0, still)
        assert writer.n_steps == 2
    with pytest.raises(InputError, match="closed"):
        writer.append(2.0, still)
    assert vtk_steps(tmp_path / "run.vtkhdf")[0] == [0.0, 1.0]


def test_names_of_time_series_are_checked(model, tmp_path):
    with pytest.raises(InputError, match=r"end in \.vtkhdf"):
        VTKHDFWriter(tmp_path / "run.vtk", model)
    with pytest.raises(InputError, match="no folder"):
        VTKHDFWriter(tmp_path / "missing" / "run.vtkhdf", model)
    with pytest.raises(InputError, match="no surface 'brow'"):
        VTKHDFWriter(tmp_path / "run.vtkhdf", model, surface="brow")
    VTKHDFWriter(tmp_path / "run.vtkhdf", model).close()
    assert os.listdir(tmp_path) == []


def test_an_exception_keeps_the_frames(model, tmp_path):
    with (
        pytest.raises(RuntimeError),
        VTKHDFWriter(tmp_path / "run.vtkhdf", model) as writer,
    ):
        writer.append(0.0, np.zeros_like(model.nodes))
        raise RuntimeError("the simulation failed")
    assert os.listdir(tmp_path) == ["run.vtkhdf"]


def test_a_killed_run_leaves_a_readable_part_file(tmp_path):
    program = f"""
import os, numpy as np
from tledface.constitutive import material
from tledface.io.vtkhdf import VTKHDFWriter
from tledface.model import Model
soft = material("neo_hookean", youngs_modulus=1e3, poissons_ratio=0.4, density=1e3)
model = Model.block((2, 2, 2), (1, 1, 1), soft)
writer = VTKHDFWriter({str(tmp_path / "run.vtkhdf")!r}, model)
for step in range(3):
    writer.append(float(step), np.full(model.nodes.shape, step))
os._exit(9)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 9
    assert os.listdir(tmp_path) == ["run.part.vtkhdf"]
    times, steps = vtk_steps(tmp_path / "run.part.vtkhdf")
    assert times == [0.0, 1.0, 2.0]
    assert (steps[2][2]["displacement"] == 2.0).all()


def bytes_outside_frames(path):
    """A time series file without its frames' data."""
    data = bytearray(path.read_bytes())
    with h5py.File(path, locking=False) as file:  # as its writer still has it
        fields = [*file["VTKHDF/PointData"].values()]
        fields += [x for x in (file["VTKHDF/Points"],) if x.chunks]
        places = [
            field.id.get_chunk_info(n)
            for field in fields
            if field.chunks
            for n in range(field.id.get_num_chunks())
        ]
        ends = [attribute_of(file)]
    for place in places:
        data[place.byte_offset : place.byte_offset + place.size] = bytes(place.size)
    return bytes(data), ends


def attribute_of(file):
    return int(file["VTKHDF/Steps"].attrs["NSteps"])


def test_frames_in_reserved_space_leave_the_file_s_structure_alone(model, tmp_path):
    """A kill at any moment finds the same trees, with other numbers in the same places."""
    u = np.random.default_rng(5).normal(size=(6, *model.nodes.shape))
    writer = VTKHDFWriter(tmp_path / "run.vtkhdf", model, surface="skin", frames=6)
    seen = {"run.part.vtkhdf": [], "run_surface.part.vtkhdf": []}
    for step in range(6):
        writer.append(float(step), u[step])
        for name, found in seen.items():
            found.append(bytes_outside_frames(tmp_path / name))
    writer.close()
    for found in seen.values():
        assert [steps for _, (steps,) in found] == [1, 2, 3, 4, 5, 6]
        (first, _), *others = found
        for data, _ in others:
            changed = sum(a != b for a, b in zip(first, data, strict=True))
            # The extents of a dozen tables, their rows, and the number of steps.
            assert changed < 12 * (8 + 6 * 8) + 8


def test_a_killed_series_goes_on_from_a_checkpoint(model, tmp_path):
    u = np.random.default_rng(5).normal(size=(6, *model.nodes.shape)).astype(np.float32)
    path = tmp_path / "run.vtkhdf"

    def write(writer, steps):
        for step in steps:
            writer.append(float(step), u[step], speed=u[step, :, 0])

    with VTKHDFWriter(tmp_path / "whole.vtkhdf", model, surface="skin", frames=6) as writer:
        write(writer, range(6))
    killed = VTKHDFWriter(path, model, surface="skin", frames=6)
    write(killed, range(4))
    with pytest.raises(InputError, match="another process is writing it"):
        in_another_process(VTKHDFWriter.reopen, path, model, "skin", keep=2)
    killed.sync()
    killed._close_file()
    killed._surface_writer._close_file()
    with VTKHDFWriter.reopen(path, model, "skin", keep=2) as writer:
        assert writer.n_steps == 2
        with pytest.raises(InputError, match="above the last one, 1 s"):
            writer.append(1.0, u[0], speed=u[0, :, 0])
        write(writer, (2,))
    # Closed early, so under its final name: that is gone back to as well.
    with VTKHDFWriter.reopen(path, model, "skin", keep=1) as writer:
        write(writer, range(1, 6))
    for end in (".vtkhdf", "_surface.vtkhdf"):
        with (
            h5py.File(tmp_path / f"whole{end}") as whole,
            h5py.File(tmp_path / f"run{end}") as run,
        ):
            names = []
            whole.visit(names.append)
            for name in names:
                if isinstance(whole[name], h5py.Dataset):
                    assert np.array_equal(whole[name][()], run[name][()]), name
            assert attribute_of(whole) == attribute_of(run) == 6


def in_another_process(reopen, *arguments, keep):
    """What another process sees: HDF5 takes two openings of one process for the same."""
    model = arguments[1]
    model.save(arguments[0].with_name("model.h5"))
    program = f"""
from tledface.io.vtkhdf import VTKHDFWriter
from tledface.model import Model
VTKHDFWriter.reopen({str(arguments[0])!r}, Model.load({str(arguments[0].with_name("model.h5"))!r}),
                    {arguments[2]!r}, keep={keep})
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    raise InputError(done.stderr.splitlines()[-1])


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the file size there")
@pytest.mark.parametrize("share", [0.02, 0.2, 0.6, 0.9, 0.99])
def test_a_series_that_its_limit_cuts_ends_in_the_system_s_words(model, tmp_path, share):
    """At any place, also where HDF5 writes: it told of that in lines of its own, or crashed."""
    model.save(tmp_path / "model.h5")
    with VTKHDFWriter(tmp_path / "run.vtkhdf", model, surface="skin", frames=6) as writer:
        writer.append(0.0, np.zeros_like(model.nodes))
    size = int(share * (tmp_path / "run.vtkhdf").stat().st_size)
    program = f"""
import numpy as np
import resource
from tledface.io.vtkhdf import VTKHDFWriter
from tledface.model import Model
model = Model.load("model.h5")
resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))
try:
    with VTKHDFWriter("cut.vtkhdf", model, surface="skin", frames=6) as writer:
        writer.append(0.0, np.zeros_like(model.nodes))
except OSError as error:
    print(f"{{error.filename}}: {{error.strerror}}")
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    expected = (0, "cut.part.vtkhdf: File too large\n", "")
    assert (done.returncode, done.stdout, done.stderr) == expected
    assert not list(tmp_path.glob("cut*"))


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the file size there")
@pytest.mark.parametrize("size", [500, 4000, 9000])
def test_a_model_file_that_its_limit_cuts_leaves_the_one_there(model, tmp_path, size):
    model.save(tmp_path / "model.h5")
    before = (tmp_path / "model.h5").read_bytes()
    assert len(before) > size
    with file_limit(size), pytest.raises(OSError, match=r"File too large: .*model.part.h5"):
        model.save(tmp_path / "model.h5")
    assert os.listdir(tmp_path) == ["model.h5"]
    assert (tmp_path / "model.h5").read_bytes() == before


def test_series_that_cannot_go_on_are_named(model, tmp_path):
    path = tmp_path / "run.vtkhdf"
    with pytest.raises(InputError, match="no such file"):
        VTKHDFWriter.reopen(path, model, None, keep=1)
    with VTKHDFWriter(path, model) as writer:
        writer.append(0.0, np.zeros_like(model.nodes))
    with pytest.raises(InputError, match="holds 1 frames, the checkpoint was made after 2"):
        VTKHDFWriter.reopen(path, model, None, keep=2)
    path = path.with_name("run.part.vtkhdf")
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match="damaged"):
        VTKHDFWriter.reopen(tmp_path / "run.vtkhdf", model, None, keep=1)


def test_vtk_reads_a_series_that_ended_early(model, tmp_path):
    u = np.ones_like(model.nodes)
    with VTKHDFWriter(tmp_path / "run.vtkhdf", model, surface="skin", frames=9) as writer:
        for step in range(3):
            writer.append(0.5 * step, step * u)
    for name in ("run", "run_surface"):
        times, steps = vtk_steps(tmp_path / f"{name}.vtkhdf")
        assert times == [0.0, 0.5, 1.0]
        assert len(steps) == 3
    assert (vtk_steps(tmp_path / "run.vtkhdf")[1][2][2]["displacement"] == 2.0).all()
