"""Closed surfaces of muscles whose fibres are known, lengths in m, and how far a field is off."""

import numpy as np
import trimesh

from tledface import _core

MM = 1e-3


def tube(path, radius, across, sides=40):
    """A round tube along a path (m, 3); ``across`` is a direction that never lies along it."""
    path = np.asarray(path, dtype=float)
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    first = np.asarray(across) - (along @ np.asarray(across))[:, None] * along
    first /= np.linalg.norm(first, axis=1)[:, None]
    angle = np.arange(sides) / sides * 2.0 * np.pi
    radius = np.broadcast_to(radius, len(path))[:, None, None]
    ring = np.cos(angle)[:, None] * first[:, None]
    ring = ring + np.sin(angle)[:, None] * np.cross(along, first)[:, None]
    vertices = np.concatenate([(path[:, None] + radius * ring).reshape(-1, 3), path[:1], path[-1:]])
    count = len(path)
    i, j = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    faces = [quads(i * sides + j, (i * sides + (j + 1) % sides), i + 1, j, sides)]
    j = np.arange(sides)
    k, last = (j + 1) % sides, (count - 1) * sides
    faces.append(np.stack([np.full(sides, count * sides), k, j], axis=1))
    faces.append(np.stack([np.full(sides, count * sides + 1), last + j, last + k], axis=1))
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def quads(a, b, next_row, j, sides):
    c, d = next_row * sides + (j + 1) % sides, next_row * sides + j
    return np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )


def slab(place, shape, thickness):
    """A sheet about a patch: ``place(s, t)`` gives points and normals for s, t from 0 to 1."""
    ns, nt = shape
    s, t = np.meshgrid(np.linspace(0, 1, ns), np.linspace(0, 1, nt), indexing="ij")
    points, normals = place(s, t)
    half = 0.5 * thickness * normals
    vertices = np.concatenate([(points + half).reshape(-1, 3), (points - half).reshape(-1, 3)])
    i, j = np.meshgrid(np.arange(ns - 1), np.arange(nt - 1), indexing="ij")
    a = (i * nt + j).ravel()
    top = np.concatenate(
        [np.stack([a, a + nt, a + nt + 1], 1), np.stack([a, a + nt + 1, a + 1], 1)]
    )
    rim = np.concatenate(
        [
            np.arange(ns - 1) * nt,
            (ns - 1) * nt + np.arange(nt - 1),
            np.arange(ns - 1, 0, -1) * nt + nt - 1,
            np.arange(nt - 1, 0, -1),
        ]
    )
    after, below = np.roll(rim, -1), ns * nt
    side = [
        np.stack([rim, rim + below, after + below], 1),
        np.stack([rim, after + below, after], 1),
    ]
    faces = np.concatenate([top, top[:, ::-1] + below, *side])
    return trimesh.Trimesh(vertices, faces, process=False)


def ring(place, half_width, half_height, sides=20, count=120):
    """A closed ring: ``place(angle)`` gives points of its middle and two normals of it."""
    points, first, second = place(np.arange(count) / count * 2.0 * np.pi)
    angle = np.arange(sides) / sides * 2.0 * np.pi
    section = half_width * np.cos(angle)[:, None] * first[:, None]
    section = section + half_height * np.sin(angle)[:, None] * second[:, None]
    i, j = np.meshgrid(np.arange(count), np.arange(sides), indexing="ij")
    faces = quads(i * sides + j, i * sides + (j + 1) % sides, (i + 1) % count, j, sides)
    return trimesh.Trimesh((points[:, None] + section).reshape(-1, 3), faces, process=False)


def arc(degrees, radius=20 * MM, thick=4 * MM):
    """Part of a torus about z, and its fibres."""
    angle = np.radians(np.linspace(0.0, degrees, 60))
    path = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return tube(path, thick, (0.0, 0.0, 1.0)), lambda p: np.cross([0.0, 0.0, 1.0], p)


def rod(axis=(0.3, 0.5, 0.81), length=40 * MM, thick=4 * MM):
    axis = np.asarray(axis) / np.linalg.norm(axis)
    path = np.linspace(0.0, length, 24)[:, None] * axis
    return tube(path, thick, np.roll(axis, 1)), lambda p: np.tile(axis, (len(p), 1))


def spindle(length=40 * MM, thick=4 * MM):
    """Radius thick sin(pi z / length): fibres that keep their share of it."""
    share = np.linspace(0.02, 0.98, 50)
    path = np.stack([0.0 * share, 0.0 * share, length * share], axis=1)

    def fibres(p):
        slope = np.pi / length / np.tan(np.pi * p[:, 2] / length)
        return np.stack([p[:, 0] * slope, p[:, 1] * slope, np.ones(len(p))], axis=1)

    return tube(path, thick * np.sin(np.pi * share), (1.0, 0.0, 0.0)), fibres


def flat_sheet():
    def place(s, t):
        points = np.stack([40 * MM * s, 0.0 * s, 30 * MM * t], axis=-1)
        return points, np.broadcast_to([0.0, -1.0, 0.0], points.shape)

    return slab(place, (21, 16), 2 * MM), lambda p: np.tile([0.0, 0.0, 1.0], (len(p), 1))


def curved_sheet(radius=50 * MM):
    """A patch of a cylinder about x that leans back as it rises, as a forehead does."""

    def place(s, t):
        angle = np.radians(75.0 * t)
        normals = np.stack([0.0 * angle, -np.cos(angle), np.sin(angle)], axis=-1)
        return radius * normals + np.stack([30 * MM * s, 0.0 * s, 0.0 * s], axis=-1), normals

    return slab(place, (16, 31), 2 * MM), lambda p: np.cross([-1.0, 0.0, 0.0], p)


def round_ring():
    def place(angle):
        out = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=-1)
        return 15 * MM * out, out, np.broadcast_to([0.0, 1.0, 0.0], out.shape)

    return ring(place, 5 * MM, 1.5 * MM), lambda p: np.cross([0.0, 1.0, 0.0], p)


def bent_ellipse(depth=30 * MM):
    """An elliptic ring bent back at both sides, as round a mouth: its middle line's tangent."""

    def middle(angle):
        x, z = 25 * MM * np.cos(angle), 14 * MM * np.sin(angle)
        return np.stack([x, x**2 / (2.0 * depth), z], axis=-1)

    def place(angle):
        points = middle(angle)
        along = middle(angle + 1e-4) - middle(angle - 1e-4)
        normal = np.stack([-points[:, 0] / depth, 1.0 + 0 * angle, 0.0 * angle], axis=-1)
        first, second = np.cross(along, normal), normal
        return points, *(v / np.linalg.norm(v, axis=1)[:, None] for v in (first, second))

    dense = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)

    def fibres(p):
        gap = ((p[:, None] - middle(dense)[None, ::8]) ** 2).sum(axis=2)
        nearest = dense[::8][gap.argmin(axis=1)]
        return middle(nearest + 1e-4) - middle(nearest - 1e-4)

    return ring(place, 3 * MM, 1.2 * MM), fibres


def solid_of(mesh):
    return _core.prepare_surface(mesh.vertices, mesh.faces.astype(np.int32), "muscle")


def inner_points(mesh, count=4000, seed=0):
    """Points spread over the inside of a closed surface."""
    low, high = mesh.bounds
    points = low + (high - low) * np.random.default_rng(seed).random((20 * count, 3))
    side = solid_of(mesh).closest_points(points)[3]
    return points[side < 0][:count]


def angles(directions, fibres):
    """Angle between lines, degrees, and the share of points with the more common sense."""
    fibres = fibres / np.linalg.norm(fibres, axis=1)[:, None]
    cosine = np.einsum("ij,ij->i", directions, fibres)
    return np.degrees(np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))), abs(np.sign(cosine).mean())
