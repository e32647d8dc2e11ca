"""Fibre fields against muscles whose fibres are known, and on real anatomy."""

import numpy as np
import pytest

import muscle_shapes as shapes
from muscle_shapes import MM, angles, inner_points
from tledface.fibre_kinds import make_fibre
from tledface.geometry import fibre_field, make_field, mean_fibres, read_surface
from tledface.geometry.fibres import MuscleGrid

# The same limits for a field of any kind, degrees: on average, and for 95 of 100 points.
MEAN, MOST = 3.0, 8.0


def check(figure, mesh, fibres, kind, where=None, *, mean=MEAN, most=MOST, **options):
    points = inner_points(mesh)
    points = points if where is None else points[where(points)]
    off, same = angles(fibre_field(mesh, kind, points, **options), fibres(points))
    figure("mean angle to the fibre, degrees", off.mean(), at_most=mean)
    figure("95 of 100 points within, degrees", np.percentile(off, 95), at_most=most)
    assert same > 0.999  # one sense throughout


@pytest.mark.parametrize("kind", ["nurbs", "spindle"])
class TestAlongTheLength:
    def test_rod(self, figure, kind):
        check(figure, *shapes.rod(), kind, mean=1.0, most=3.0)

    @pytest.mark.parametrize("degrees", [90, 200, 320])
    def test_bent_rod(self, figure, kind, degrees):
        """Fibres are arcs; on 320 degrees no straight axis comes near."""
        check(figure, *shapes.arc(degrees), kind, mean=1.5)

    def test_tapered_spindle(self, figure, kind):
        check(figure, *shapes.spindle(), kind, mean=1.0, most=3.0)

    def test_curved_sheet_between_its_edges(self, figure, kind):
        mesh, fibres = shapes.curved_sheet()
        low = {"box": [[-1.0, -1.0, -1.0], [1.0, 1.0, 1 * MM]]}
        a = np.radians(75.0)
        edge = [[x, -50 * MM * np.cos(a), 50 * MM * np.sin(a)] for x in (0.0, 30 * MM)]
        check(figure, mesh, fibres, kind, start=low, to={"points": edge}, mean=1.5, most=5.0)


def test_flat_sheet(figure):
    check(figure, *shapes.flat_sheet(), "sheet", to="+z", mean=0.1, most=0.5)


def test_curved_sheet(figure):
    """Leaning back by 75 degrees, and known only by "up"."""
    check(figure, *shapes.curved_sheet(), "sheet", to="+z", mean=1.0, most=3.0)


@pytest.mark.parametrize("turned", [False, True])
def test_round_ring(figure, turned):
    mesh, fibres = shapes.round_ring()
    if not turned:
        check(figure, mesh, fibres, "sphincter", mean=1.0, most=3.0)
        return
    import trimesh

    move = trimesh.transformations.rotation_matrix(0.8, [0.5, 0.6, -0.3], [0.2, 0.0, 1.5])
    back = np.linalg.inv(move)

    def there(p):
        return fibres(trimesh.transform_points(p, back)) @ move[:3, :3].T

    check(figure, mesh.copy().apply_transform(move), there, "sphincter", mean=1.0, most=3.0)


def test_bent_elliptic_ring(figure):
    """Neither round nor in a plane, as round a mouth; the middle line's tangent at the section."""
    check(figure, *shapes.bent_ellipse(), "sphincter", mean=3.0, most=8.0)


def test_ring_flows_along_its_own_surface(figure):
    """No fibre of an elliptic ring crosses the surface."""
    solid = shapes.solid_of(shapes.bent_ellipse()[0])
    surface = MuscleGrid(solid).surface
    field = make_field(solid, make_fibre("sphincter"))
    across = np.einsum("ij,ij->i", field.directions(surface.points), surface.normals)
    figure(
        "mean angle between fibre and surface, degrees",
        np.degrees(np.arcsin(np.average(np.abs(across), weights=surface.areas))),
        at_most=4.0,
    )


class TestAnatomy:
    """An atlas' face muscles in voxels of 1 mm."""

    @staticmethod
    def voxel_fibres(folder, numbers, kind, **options):
        solids = [
            read_surface(folder / "bodyparts3d" / f"FMA{n}.obj", unit_scale=MM).solid
            for n in numbers
        ]
        low = np.min([solid.vertices.min(axis=0) for solid in solids], axis=0)
        high = np.max([solid.vertices.max(axis=0) for solid in solids], axis=0)
        cells = np.argwhere(np.ones(np.ceil((high - low) / MM).astype(int)))
        fields = [make_field(solid, make_fibre(kind, options)) for solid in solids]
        found = mean_fibres(fields, solids, cells, origin=low, voxel=[MM] * 3, samples=4)
        centres = low + MM * (cells + 0.5)
        return centres[found.sampled], found.fibre[found.sampled], solids

    def test_frontalis_runs_upwards_in_its_sheet(self, shared_data, figure):
        centres, fibre, solids = self.voxel_fibres(
            shared_data, (46759, 46760), "sheet", **{"from": "-z", "to": "+z"}
        )
        # The sheet's normal from the nearest face of the surface, not from the field's own tensors.
        distance, face, _, _ = zip(*(s.closest_points(centres) for s in solids), strict=True)
        nearest = np.argmin(distance, axis=0)
        normal = np.empty_like(centres)
        for number, solid in enumerate(solids):
            corners = solid.vertices[solid.faces[face[number]]]
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            mine = nearest == number
            normal[mine] = (cross / np.linalg.norm(cross, axis=1)[:, None])[mine]
        up = [0.0, 0.0, 1.0] - normal[:, 2:] * normal
        # At the rim the nearest face is the rim's.
        in_sheet = np.linalg.norm(up, axis=1) > 0.5
        off, _ = angles(fibre[in_sheet], up[in_sheet])
        figure("90 of 100 voxels within, degrees", np.percentile(off, 90), at_most=25.0)
        figure("voxels whose fibre rises, share", np.mean(fibre[:, 2] > 0.5), 1.0, absolute=0.02)

    def test_corrugators_run_sideways(self, shared_data, figure):
        for kind in ("nurbs", "spindle"):
            _, fibre, _ = self.voxel_fibres(shared_data, (46796, 46797), kind)
            level = np.abs(fibre[:, 0])
            figure(f"{kind}: mean share of x", level.mean(), 0.8, absolute=0.12)
            figure(f"{kind}: mean of y", np.abs(fibre[:, 1]).mean(), at_most=0.3)

    def test_procerus_is_upright(self, shared_data, figure):
        _, fibre, _ = self.voxel_fibres(shared_data, (55610, 55611), "sheet", to="-z")
        off, _ = angles(fibre, np.tile([0.0, 0.0, 1.0], (len(fibre), 1)))
        figure("90 of 100 voxels within, degrees", np.percentile(off, 90), at_most=25.0)

    @pytest.mark.parametrize(
        "numbers", [(46785,), (46786,), (46841,)], ids=["right", "left", "oris"]
    )
    def test_orbiculares_run_round(self, shared_data, figure, numbers):
        centres, fibre, _ = self.voxel_fibres(shared_data, numbers, "sphincter")
        low, high = centres.min(axis=0)[[0, 2]], centres.max(axis=0)[[0, 2]]
        seen = (centres[:, [0, 2]] - 0.5 * (low + high)) / (high - low)
        # The sense, which one turn must keep, and the way round an ellipse as seen from the front.
        turn = np.column_stack([-seen[:, 1], seen[:, 0]]) * (high - low)
        turn /= np.linalg.norm(turn, axis=1)[:, None]
        flat = fibre[:, [0, 2]] / np.linalg.norm(fibre[:, [0, 2]], axis=1)[:, None]
        along = np.einsum("ij,ij->i", flat, turn)
        figure("share of voxels with one sense", abs(np.sign(along).mean()), 1.0, absolute=0.02)
        figure("mean cosine to an ellipse", np.abs(along).mean(), 1.0, absolute=0.07)
