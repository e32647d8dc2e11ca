"""Closed triangle meshes of known volume."""

import numpy as np
import trimesh


def base_solid(rng):
    """A closed triangle mesh of known volume: name, vertices, faces, volume."""
    kind = rng.choice(["sphere", "torus", "box", "box with a hole", "nested", "overlapping boxes"])
    # Fine enough that a face or two are a hole to fill, at some cost.
    fine = rng.random() < 0.2
    if kind == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=4 if fine else 2)
    elif kind == "torus":
        n = 2 if fine else 1
        mesh = trimesh.creation.torus(1.0, 0.45, major_sections=20 * n, minor_sections=10 * n)
    elif kind == "box":
        mesh = trimesh.creation.box((1.0, 1.5, 0.8)).subdivide().subdivide()
    elif kind == "box with a hole":
        mesh = box_with_hole().subdivide()
    elif kind == "nested":
        mesh = trimesh.creation.icosphere(subdivisions=2)
        vertices = np.concatenate([mesh.vertices, 0.5 * mesh.vertices])
        faces = np.concatenate([mesh.faces, mesh.faces[:, ::-1] + len(mesh.vertices)])
        return kind, vertices, faces, mesh.volume * (1 - 0.125)
    else:
        parts = [((0, 0, 0), (0.7, 1, 1)), ((0.4, 0.1, 0.1), (1.4, 0.9, 0.9))]
        mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=p).subdivide() for p in parts])
        return kind, np.array(mesh.vertices), np.array(mesh.faces), 0.7 + 1 * 0.64 - 0.3 * 0.64
    return kind, np.array(mesh.vertices), np.array(mesh.faces), float(mesh.volume)


def box_with_hole(size=(1.0, 1.0, 1.0), duct=0.5):
    """A box with a square duct along z, as one closed surface of genus 1."""
    outer = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5
    ring = np.concatenate([outer * size[:2], outer * duct])
    low, high = (np.c_[ring, np.full(8, z)] for z in (-size[2] / 2, size[2] / 2))
    faces = []
    for i in range(4):
        j = (i + 1) % 4
        for q in (
            [i, j, 8 + j, 8 + i],
            [4 + j, 4 + i, 12 + i, 12 + j],
            [8 + i, 8 + j, 12 + j, 12 + i],
            [j, i, 4 + i, 4 + j],
        ):
            faces += [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]
    return trimesh.Trimesh(np.concatenate([low, high]), faces, process=False)
