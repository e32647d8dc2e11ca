"""Nodes that slide on surfaces: their distances, the search against brute force, energy."""

import functools
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import tledface as tf
from scenes import soft
from tledface import _core
from tledface.bench_face import advance, started
from tledface.device import resolve
from tledface.geometry import read_surface

H = 0.5e-3
FAR = np.array([0.1, -0.2, 1.6])  # where atlases lie


def saddle():
    x, y = np.meshgrid(np.linspace(-20e-3, 20e-3, 41), np.linspace(-20e-3, 20e-3, 41))
    points = np.stack([x.ravel(), y.ravel(), ((x**2 - y**2) / 60e-3).ravel()], axis=1)
    i = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return trimesh.Trimesh(points, faces, process=False)


def box():
    """Edges and corners: the slab hangs over its sides by 0.2 mm, in the end over corners too."""
    return trimesh.creation.box((27.6e-3, 5.6e-3, 20e-3)).apply_translation((0, 0, -10e-3))


def rough(inverted=False):
    """Ridges, valleys and saddles of a few degrees at every edge."""
    line = np.linspace(-20e-3, 20e-3, 41)
    x, y = np.meshgrid(line, line)
    z = 0.03e-3 * np.random.default_rng(5).standard_normal(x.shape)
    i = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    if inverted:
        faces = faces[:, ::-1]
    return trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), z.ravel()], 1), faces, process=False)


SURFACES = {
    "sphere": (trimesh.creation.icosphere(subdivisions=4, radius=20e-3), 20e-3),
    "inside a sphere": (trimesh.creation.icosphere(subdivisions=4, radius=20e-3), -19.7e-3),
    "saddle": (saddle(), 0.4e-3),
    "rough": (rough(), 0.3e-3),
    "behind a rough one": (rough(inverted=True), 0.3e-3),
    "box": (box(), 0.3e-3),
    "on the box": (box(), 0.0),
}


def tissue(height, cells=(16, 12, 3)):
    """A slab whose lower side is `height` above the origin, far from 0; mask of that side."""
    low = FAR + np.array([-cells[0] * H / 2, -cells[1] * H / 2, height])
    block = tf.Model.block(cells, tuple(n * H for n in cells), soft(30e3, 0.45))
    model = tf.Model.from_voxels(
        block.voxel, low, block.cells, block.tissues, block.tissue_materials, block.fractions
    )
    return model, block.node_ijk[:, 2] == 0


def dragged(model, lower, surface, by, **options):
    """The slab pulled sideways by its upper side; simulator and kept distances."""
    surface = surface.copy()
    surface.apply_translation(FAR)
    kept = model.slide(lower, surface)
    top = model.nodes[:, 2] > model.nodes[:, 2].max() - 1e-9
    over = 8e-3
    model.prescribe(top, {"x": lambda t: by * min(t / over, 1.0)})
    sim = tf.Simulator(model, damping=100.0, **options)
    sim.run(until=over)
    return sim, kept


def distances(model, x):
    """To the surface, by trying every triangle."""
    surface = model.sliding.surfaces[0]
    squares, _ = _core.brute_force_nearest(surface.vertices - FAR, surface.faces, x - FAR)
    return np.sqrt(squares)


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("precision", ["single", "double"])
def test_distances_are_kept(executor, figure, name, precision):
    surface, height = SURFACES[name]
    model, lower = tissue(height)
    sim, kept = dragged(model, lower, surface, 10e-3, precision=precision, **executor.kwargs)
    x = (model.nodes + sim.u)[lower]
    assert sim.u[lower][:, 0].mean() > 5e-3  # it went along
    figure(
        f"{precision}: error of the distance over the voxel",
        abs(distances(model, x) - abs(kept)).max() / H,
        at_most=1e-4 if precision == "single" else 1e-9,
    )


def test_no_node_is_lost_at_a_voxel_a_step(figure):
    """Thrown along the surface far faster than tissue moves."""
    surface, height = SURFACES["sphere"]
    model, lower = tissue(height)
    surface = surface.copy()
    surface.apply_translation(FAR)
    kept = model.slide(lower, surface)
    sim = tf.Simulator(model, device="native", precision="double")
    velocity = np.zeros_like(model.nodes)
    velocity[:, 0] = H / sim.dt
    sim.set_state(np.zeros_like(velocity), velocity)
    worst = 0.0
    for _ in range(12):
        before = sim.u
        sim.step(1)
        moved = abs(sim.u - before).max()
        x = (model.nodes + sim.u)[lower]
        worst = max(worst, abs(distances(model, x) - abs(kept)).max() / H)
    assert moved > 0.5 * H
    figure("error of the distance over the voxel", worst, at_most=1e-9)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_distances_from_a_real_bone_are_kept(executor, figure, shared_data, precision):
    """The forehead's bone: concave, convex, thin, with an inner side not far behind."""
    path = shared_data / "bodyparts3d" / "FMA52734.obj"
    if not path.is_file():
        pytest.skip("the atlas is not on this machine")
    solid = read_surface(path, unit_scale=1e-3).solid
    bone = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    # Turned so that its front looks along z, the slab over it.
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, (-1, 0, 0))
    bone.apply_transform(turn)
    bone.apply_translation(-np.array([-5e-3, 1575e-3, 181.9e-3]))
    # All of its lower side before the bone: inside it, halfway to its inner
    # side, a distance can be kept from one side only.
    model, lower = tissue(0.4e-3)
    sim, kept = dragged(model, lower, bone, 10e-3, precision=precision, **executor.kwargs)
    x = (model.nodes + sim.u)[lower]
    assert kept.min() > 0.0
    assert sim.u[lower][:, 0].mean() > 5e-3
    figure(
        f"{precision}: error of the distance over the voxel",
        abs(distances(model, x) - abs(kept)).max() / H,
        at_most=1e-4 if precision == "single" else 1e-9,
    )


def nearest_in(triangles, places):
    """The nearest point of each triangle (n, 3, 3) to its place (n, 3): in it, or on a side."""
    a = triangles[:, 0]
    normal = np.cross(triangles[:, 1] - a, triangles[:, 2] - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    foot = places - ((places - a) * normal).sum(axis=1, keepdims=True) * normal
    inside = np.ones(len(places), bool)
    best, square = foot.copy(), np.full(len(places), np.inf)
    for k in range(3):
        start, along = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        inside &= (np.cross(along, foot - start) * normal).sum(axis=1) >= 0.0
        share = ((places - start) * along).sum(axis=1) / (along**2).sum(axis=1)
        on = start + np.clip(share, 0.0, 1.0)[:, None] * along
        nearer = ((places - on) ** 2).sum(axis=1) < square
        best[nearer] = on[nearer]
        square = np.minimum(square, ((places - on) ** 2).sum(axis=1))
    best[inside] = foot[inside]
    return best


@functools.cache
def by_brute_force(name):
    """About 34 000 places about a surface and far from it, squared distances and nearest faces."""
    surface, _ = SURFACES[name]
    rng = np.random.default_rng(2)
    on, _ = trimesh.sample.sample_surface(surface, 24_000, seed=3)
    near = on + 1e-3 * rng.standard_normal(on.shape)
    far = rng.uniform(-50e-3, 50e-3, (9_000, 3))
    places = np.concatenate([surface.vertices[:500], surface.triangles_center[:500], near, far])
    return places, *_core.brute_force_nearest(surface.vertices, surface.faces, places)


@pytest.mark.parametrize("name", ["sphere", "saddle", "box"])
def test_search_finds_what_brute_force_finds(executor, figure, name):
    """The same distance and point, but where two points are as near; 10^5 places in all."""
    surface, _ = SURFACES[name]
    places, exact, nearest = by_brute_force(name)
    device = resolve(executor.device)
    for precision, allowed in (("double", 1e-14), ("single", 1e-8)):
        squares, faces = _core.grid_nearest(
            device, precision, surface.vertices, surface.faces, places
        )
        assert faces.min() >= 0
        # Two faces may meet in the point that is nearest.
        other = np.flatnonzero(faces != nearest)
        found, point = (
            nearest_in(surface.triangles[f[other]], places[other]) for f in (faces, nearest)
        )
        distance = np.linalg.norm(places[other] - found, axis=1)
        assert abs(distance - np.sqrt(exact[other])).max(initial=0.0) < allowed
        off = np.linalg.norm(found - point, axis=1) > 1e-6
        # Within rounding of the sphere's middle everything is.
        figure(f"{precision}: share with two", off.sum() / len(places), at_most=2e-3)
        figure(
            f"{precision}: distance off brute force, m",
            abs(np.sqrt(squares) - np.sqrt(exact)).max(),
            at_most=allowed,
        )


# As kernels_cl/sliding_layout.cl has them: reals zones are counted in, of a head; borders a group.
UNIT, HEAD, GROUP = 16, 8, 8
# Zones of a triangle: of its face, edges and corners before it, then behind it.
PARTS = 14


def zone_at(reals, zone):
    """Number of borders, whether it is round about something, a point, a direction; all places for
    borders: unit normal, limit, number of the zone behind, each (5, n).
    """
    head, rest = reals[zone * UNIT :][:HEAD], reals[zone * UNIT + HEAD :]
    groups = -(-int(head[0]) // GROUP)
    borders = rest[: 5 * GROUP * groups].reshape(-1, 5, GROUP).transpose(1, 0, 2).reshape(5, -1)
    return int(head[0]), head[1] != 0.0, head[2:5], head[5:8], borders


@pytest.mark.parametrize("name", ["rough", "saddle", "box"])
def test_what_a_zone_is_of_is_nearest_in_it(figure, name):
    """Places before a surface: those in a zone against brute force; no two zones have one place."""
    surface, height = SURFACES[name]
    reals, of_triangle = _core.surface_zones(surface.vertices, surface.faces, 1.1 * height)
    rng = np.random.default_rng(5)
    on, face = trimesh.sample.sample_surface(surface, 2000, seed=4)
    # More about faces with a second group.
    full = np.flatnonzero([z >= 0 and reals[z * UNIT] > GROUP for z in of_triangle[::PARTS]])
    full = np.repeat(rng.permutation(full)[:50], 60)
    shares = 1.3 * (rng.dirichlet(np.ones(3), len(full)) - 1 / 3) + 1 / 3
    about = (shares[:, :, None] * surface.triangles[full]).sum(axis=1)
    on, face = np.concatenate((on, about)), np.concatenate((face, full))
    way = surface.face_normals[face]
    # And over corners, about the normals of their faces.
    corner = rng.integers(len(surface.vertices), size=2000)
    of = surface.vertex_faces[corner]
    weights = rng.dirichlet(np.ones(of.shape[1]), len(of)) * (of >= 0)
    mean = (weights[:, :, None] * surface.face_normals[of]).sum(axis=1)
    way = np.concatenate((way, mean / np.linalg.norm(mean, axis=1)[:, None]))
    on = np.concatenate((on, surface.vertices[corner]))
    places = on + rng.uniform(0.02, 1.0, (len(on), 1)) * height * way
    square, _ = _core.brute_force_nearest(surface.vertices, surface.faces, places)
    n_zones, worst, most, over_corners = np.zeros(len(places), int), 0.0, 0, 0
    for zone in np.unique(of_triangle[of_triangle >= 0]):
        count, rounded, corner, direction, borders = zone_at(reals, zone)
        most = max(most, count)
        x, y, z, limit, _ = borders
        assert (limit[count:] >= 1e30).all()
        normals = np.stack((x, y, z))
        inside = (places @ normals < limit).all(axis=1)
        n_zones += inside
        over_corners += inside.sum() if rounded and not direction.any() else 0
        off = places[inside] - corner
        along = off @ direction
        distance = np.linalg.norm(off - along[:, None] * direction, axis=1)
        there = distance if rounded else abs(along)
        worst = max(worst, abs(there - np.sqrt(square[inside])).max(initial=0.0))
    assert n_zones.max() == 1
    assert n_zones.mean() > 0.25
    assert name == "saddle" or over_corners > 100
    assert name != "rough" or most > GROUP
    figure("distance off brute force, m", worst, at_most=1e-12)


@pytest.mark.parametrize("name", ["rough", "saddle", "box"])
def test_zones_near_some_nodes_are_those_of_the_whole_surface(name):
    """And of all triangles that the nodes may come to; the others have none."""
    surface, height = SURFACES[name]
    rng = np.random.default_rng(6)
    extent = surface.extents.max()
    points = surface.vertices[rng.integers(len(surface.vertices))] + rng.normal(
        0, 0.02 * extent, (40, 3)
    )
    margin = 0.1 * extent
    low, high = surface.triangles.min(axis=1), surface.triangles.max(axis=1)
    apart = np.maximum(low[:, None] - points, points - high[:, None]).max(axis=2).min(axis=1)
    reals, zones = _core.surface_zones(surface.vertices, surface.faces, height, points, margin)
    every, of_all = _core.surface_zones(surface.vertices, surface.faces, height)
    face = zones[::PARTS]
    assert (face[apart <= margin] >= 0).all() and (face[apart > 1.25 * margin] < 0).all()
    assert name == "box" or 0 < (face >= 0).sum() < len(face)
    there = zones >= 0
    assert there.any() and (of_all[there] >= 0).all()
    same = dict(zip(zones[there], of_all[there], strict=True)) | {-1: -1}
    linked = 0
    for ours, theirs in zip(zones[there], of_all[there], strict=True):
        *mine, (*planes, behind) = zone_at(reals, ours)
        *other, (*their_planes, behind_theirs) = zone_at(every, theirs)
        assert all(np.array_equal(a, b) for a, b in zip(mine, other, strict=True))
        assert np.array_equal(planes, their_planes)
        for a, b in zip(behind, behind_theirs, strict=True):
            assert a < 0 or same[int(a)] == int(b)
            # A half more says that the zone behind has another group of borders.
            assert a < 0 or a % 1 == b % 1 == (0.5 if reals[int(a) * UNIT] > GROUP else 0.0)
            linked += a >= 0
    assert linked > there.sum() / 2


def test_nodes_that_leave_the_zones_made_for_them_keep_their_distance(figure):
    """A few nodes on a fine surface, dragged twice as far as its zones reach at the start."""
    surface = trimesh.creation.icosphere(subdivisions=6, radius=20e-3)
    model, lower = tissue(20e-3, (3, 3, 3))
    sim, kept = dragged(model, lower, surface, 10e-3, device="native", precision="double")
    start, end = model.nodes[lower] - FAR, (model.nodes + sim.u)[lower] - FAR
    # 8 cells of the grid, each as long as a triangle's edges are on average, and a quarter.
    most = 10 * surface.edges_unique_length.mean()
    _, zones = _core.surface_zones(surface.vertices, surface.faces, 1e-3, start, most)
    _, face = _core.brute_force_nearest(surface.vertices, surface.faces, end)
    assert (zones[::PARTS][face] < 0).all()
    worst = abs(distances(model, end + FAR) - abs(kept)).max() / H
    figure("error of the distance over the voxel", worst, at_most=1e-9)


@pytest.mark.parametrize("name", ["rough", "box"])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_kernels_of_a_step_put_nodes_back_as_a_pass_of_its_own_does(executor, name, precision):
    """Loads of nothing on sliding nodes ask for the pass; steps are dealt to calls unevenly."""
    surface, height = SURFACES[name]
    reached, reactions = [], []
    for loaded in (False, True):
        model, lower = tissue(height)
        if loaded:
            model.body_force(model.cells[:, 2] == 0, lambda t: (0.0, 0.0, 0.0))
        moved = surface.copy()
        moved.apply_translation(FAR)
        model.slide(lower, moved)
        top = model.nodes[:, 2] > model.nodes[:, 2].max() - 1e-9
        model.prescribe(top, {"x": lambda t: 3e-3 * min(t / 2e-3, 1.0)})
        sim = tf.Simulator(model, damping=100.0, precision=precision, **executor.kwargs)
        on_gpu = resolve(executor.device).info.kind == "gpu"
        fuses = executor.kernels == ("tile" if on_gpu else "rows")
        assert sim._core.fuses_sliding == (fuses and not loaded)
        for steps in (1, 2, 37, 200):
            sim.step(steps)
        assert sim.time > 2e-3
        reached.append(sim.u)
        reactions.append(sim._core.sliding_normals())
    allowed = 1e-12 if precision == "double" else 1e-6
    assert np.abs(reached[0] - reached[1]).max() < allowed * np.abs(reached[0]).max()
    assert np.abs(reactions[0] - reactions[1]).max() < 10 * allowed


@pytest.mark.parametrize("in_a_column", [9, 36])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_columns_with_more_nodes_to_look_at_than_may_wait(figure, in_a_column, precision):
    """All are looked at in the first step. Whichever way the row kernel's columns stand, they stand
    along two of three walls.
    """
    off = 3  # away from where two walls are as near
    n = in_a_column + off - 1
    block = tf.Model.block((n, n, n), (n * H, n * H, n * H), soft(30e3, 0.45))
    at = np.sort(block.node_ijk, axis=1)
    on_a_wall = (at[:, 0] == 0) & (at[:, 1] >= off)
    walls = trimesh.creation.box((n * H + 8e-3,) * 3)
    walls.apply_translation((n * H / 2 + 3.7e-3,) * 3)
    walls.invert()
    kept = block.slide(on_a_wall, walls)
    sim = tf.Simulator(block, device="native", precision=precision)
    assert sim._core.fuses_sliding
    velocity = np.full((block.n_nodes, 3), -1.0)
    sim.set_state(np.zeros_like(velocity), velocity)
    sim.step(10)
    x = (block.nodes + sim.u)[on_a_wall]
    squares, _ = _core.brute_force_nearest(walls.vertices, walls.faces, x)
    worst = abs(np.sqrt(squares) - abs(kept)).max() / H
    figure(
        f"{precision}: error of the distance over the voxel",
        worst,
        at_most=1e-4 if precision == "single" else 1e-9,
    )
    assert abs(sim.u[~on_a_wall]).max() > 0.1 * H


def test_restart_goes_on_bit_for_bit(executor, tmp_path):
    surface, height = SURFACES["box"]
    model, lower = tissue(height)
    surface = surface.copy()
    surface.apply_translation(FAR)
    model.slide(lower, surface)
    model.gravity = (30.0, 5.0, -9.81)
    sim = tf.Simulator(model, **executor.kwargs)
    sim.step(300)
    sim.checkpoint(tmp_path / "c.h5")
    again = tf.Simulator.restore(tmp_path / "c.h5")
    for each in (sim, again):
        each.step(300)
    assert np.array_equal(sim.u, again.u)


def test_a_slope_pushes_with_its_normal(figure):
    """At rest on an inclined plane under gravity, held against sliding: the plane's reaction."""
    angle = np.radians(30.0)
    plane = trimesh.creation.box((60e-3, 60e-3, 2e-3)).apply_translation((0, 0, -1e-3))
    model, lower = tissue(0.0, (10, 8, 6))
    plane.apply_translation(FAR)
    model.slide(lower, plane)
    g = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    model.gravity = g
    end = model.nodes[:, 0] > model.nodes[:, 0].max() - 1e-9
    model.fix(end, "x")
    sim = tf.Simulator(model, device="native", precision="double")
    info = sim.relax(1e-6, 100_000)
    assert info.converged, info
    weight = 1100.0 * model.volumes.sum() * 9.81
    figure(
        "plane's reaction over weight x cos",
        sim.reaction(lower)[2] / weight,
        np.cos(angle),
        rel=1e-4,
    )
    figure(
        "stop's reaction over weight x sin", -sim.reaction(end)[0] / weight, np.sin(angle), rel=1e-4
    )


def test_a_plane_of_symmetry_and_a_surface_hold_both():
    surface, height = SURFACES["sphere"]
    model, lower = tissue(height)
    middle = model.nodes[:, 1].min()
    model.fix(model.nodes[:, 1] < middle + 1e-9, "y")
    sim, kept = dragged(model, lower, surface, 5e-3, device="native", precision="double")
    x = (model.nodes + sim.u)[lower]
    assert abs(distances(model, x) - abs(kept)).max() <= 1e-6 * H
    assert abs(sim.u[model.nodes[:, 1] < middle + 1e-9, 1]).max() == 0.0


def test_sliding_takes_no_energy(figure):
    """Undamped, thrown over a sphere: what it holds stays."""
    surface, height = SURFACES["sphere"]
    model, lower = tissue(height)
    surface = surface.copy()
    surface.apply_translation(FAR)
    model.slide(lower, surface)
    sim = tf.Simulator(model, device="native", precision="double", energy_every=20)
    velocity = np.zeros_like(model.nodes)
    velocity[:, 0] = 0.5
    sim.set_state(np.zeros_like(velocity), velocity)
    sim.step(3000)
    energies = sim.energies
    held = energies["kinetic"] + energies["strain"] + energies["hourglass"]
    figure("balance error over the energy", abs(energies["error"]) / held, at_most=0.02)


def test_a_state_that_runs_away_is_reported_at_once():
    """No node is sought for once it is no number: the watch gets its turn."""
    surface, height = SURFACES["sphere"]
    model, lower = tissue(height)
    surface = surface.copy()
    surface.apply_translation(FAR)
    model.slide(lower, surface)
    sim = tf.Simulator(model, device="native")
    with np.errstate(over="ignore"):
        sim._core.dt = 50 * sim.dt
        with pytest.raises(tf.SimulationError, match="no longer finite"):
            sim.step(2000)


def test_what_is_known_of_surfaces_goes_along_with_a_state():
    """A restart repeats the bits of a face on its way, a state given anew those of a new simulator.

    Where regions of single nodes meet, searching again may change a last digit in single precision.
    """
    body = _core.Workload("face", 29_500)

    def raw(sim, *, sliding=True):
        return {k: v for k, v in sim.raw_state().items() if sliding or k != "sliding"}

    first, second, blind = (started(body, resolve("native")) for _ in range(3))
    advance(first, 150)
    second.set_raw_state(**raw(first))
    blind.set_raw_state(**raw(first, sliding=False))
    for sim in (first, second, blind):
        advance(sim, 100)
    u = first.displacement()
    assert np.array_equal(u, second.displacement())
    known = [sim.raw_state()["sliding"] for sim in (first, second, blind)]
    assert np.array_equal(known[0], known[1]) and not np.array_equal(known[0], known[2])
    assert np.abs(u - blind.displacement()).max() < 1e-7
    velocity = np.zeros((body.n_nodes, 3))
    velocity[:, 1] = body.speed / first.dt
    first.set_state(np.zeros_like(velocity), velocity, 0.0)
    new = started(body, resolve("native"))
    for sim in (first, new):
        advance(sim, 100)
    assert np.array_equal(first.displacement(), new.displacement())


def known(sim):
    """Of the sliding nodes of a single-precision simulator whose rows are vectors: ball, zone."""
    layout = Path(tf.__file__).parent / "kernels_cl" / "sliding_layout.cl"
    size = {k: int(v) for k, v in re.findall(r"#define (\w+) (\d+)(?![\d.])", layout.read_text())}
    words = sim.raw_state()["sliding"][1:].view(np.int32)
    reals = size["SLIDE_ROWS"] + size["REGION_ROWS"] + size["RECORD_REALS"]
    borders = 4 * size["REGION_MOST_BORDERS"]
    of_lane = reals + size["SLIDE_INTS"] + 2 * size["SLIDE_MOST"] + 5 + borders
    head, ahead = size["SLIDE_HEAD"], size["SLIDE_HEAD"] * size["SLIDE_AHEAD"]
    n_rows = (len(words) - ahead) // (of_lane * sim.lanes + head)
    rows = words[: n_rows * size["SLIDE_ROWS"] * sim.lanes].reshape(n_rows, -1, sim.lanes)
    at = n_rows * (size["SLIDE_ROWS"] + size["REGION_ROWS"]) * sim.lanes
    records = words[at : at + n_rows * sim.lanes * size["RECORD_REALS"]].view(np.float32)
    records = records.reshape(n_rows, sim.lanes, -1)
    is_node = records[..., size["RECORD_SURFACE"]] >= 0
    ball = rows[:, size["SLIDE_SEEN"] : size["SLIDE_SLACK"] + 1].transpose(0, 2, 1)
    return ball[is_node], records[..., size["RECORD_ZONE"]][is_node]


def test_few_nodes_are_looked_at_and_nearly_all_have_a_zone(figure):
    """A look renews the ball of its node. Balls that do not grow off their border, and zones of
    edges that a far triangle cuts off all along, cost twice the looks and searches.
    """
    # Of a smaller body a handful of nodes without a zone would decide.
    body, steps, looks, without = _core.Workload("face", 120_000), 20, 0, 0.0
    sim = started(body, resolve("native"))
    advance(sim, 150)
    before, zones = known(sim)
    assert len(zones) == len(body.sliding_nodes)
    for _ in range(steps):
        advance(sim, 1)
        ball, zones = known(sim)
        looks += (ball != before).any(axis=1).sum()
        without += (zones < 0).mean() / steps
        before = ball
    assert looks > 0
    figure("looks a step over nodes", looks / steps / len(zones), at_most=0.009)
    figure("nodes in no zone over nodes", without, at_most=0.0005)
