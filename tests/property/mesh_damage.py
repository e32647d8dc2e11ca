"""Damaged surface files, made from a seed, and what may become of them.

``python mesh_damage.py FIRST COUNT`` runs cases and prints one JSON line before and one after each,
so that whoever started it knows the case that crashed or hung. A case is a known solid, damage to
its triangles, a file format and damage to the file's bytes. It ends well with

* an InputError of one line that names the file, or
* a model whose volume is that of the solid, within sampling and what the report says that filled
  holes may be off by,

and damage that leaves the solid's shape must not end in an error, damage that leaves no solid must.
"""

import json
import os
import struct
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).parents[1]))  # run as a script too

from solids import base_solid
from tledface.errors import InputError
from tledface.geometry import read_surface, voxelise
from tledface.geometry.report import surface_repairs

FORMATS = ("stl", "ascii.stl", "obj", "ply", "ascii.ply", "off")
VOXELS_ACROSS = 8
SAMPLES = 3


class Case:
    """A mesh under damage: what it is, and what may come of it."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.done = []
        self.applied = []
        self.must = "model"  # or "error", or "either"
        self.unreported = True  # a volume off without a repair is a failure
        self.close_holes = self.rng.random() < 0.5
        self.data = None  # the file's bytes, where damage made them
        self.kind, vertices, self.faces, self.volume = base_solid(self.rng)
        turn = trimesh.transformations.random_rotation_matrix(self.rng.random(3))[:3, :3]
        scale = 10 ** self.rng.uniform(-2.5, 0)
        self.vertices = vertices @ turn.T * scale + self.rng.uniform(-2, 2, 3) * scale
        self.volume *= scale**3
        self.simple = self.kind != "overlapping boxes"

    def signed_volume(self):
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)

    def allow_error(self):
        if self.must == "model":
            self.must = "either"


# -- damage to triangles; the first group leaves the shape -----------------------------------------


def shuffle(case):
    order = case.rng.permutation(len(case.faces))
    relabel = case.rng.permutation(len(case.vertices))
    vertices = np.empty_like(case.vertices)
    vertices[relabel] = case.vertices
    case.vertices, case.faces = vertices, np.roll(relabel[case.faces[order]], 1, axis=1)


def split(case):
    case.vertices = case.vertices[case.faces].reshape(-1, 3)
    case.faces = np.arange(len(case.vertices)).reshape(-1, 3)


def split_with_rounding(case):
    split(case)
    size = np.ptp(case.vertices, axis=0).max()
    case.vertices = case.vertices + 1e-8 * size * case.rng.standard_normal(case.vertices.shape)


def duplicate(case):
    case.faces = np.concatenate(
        [case.faces, case.faces[case.rng.integers(len(case.faces), size=5)]]
    )


def degenerate(case):
    corners = case.rng.integers(len(case.vertices), size=(4, 2))
    case.faces = np.concatenate([case.faces, corners[:, [0, 0, 1]], corners[:1, [1, 1, 1]]])


def sliver(case):
    """A vertex on an edge of one face only: the T-junction is closed by a face without area."""
    if duplicate in case.applied:
        case.allow_error()  # the face may have a copy, which then lies on two others
    f = case.rng.integers(len(case.faces))
    a, b, c = case.faces[f]
    middle = len(case.vertices)
    case.vertices = np.concatenate([case.vertices, [0.5 * (case.vertices[a] + case.vertices[b])]])
    split_face = [[a, middle, c], [middle, b, c], [a, b, middle]]
    case.faces = np.concatenate([np.delete(case.faces, f, axis=0), split_face])


def unused(case):
    case.vertices = np.concatenate([case.vertices, case.vertices[:3] + 0.01])


def flip_some(case):
    case.faces = case.faces.copy()
    few = case.rng.random(len(case.faces)) < 0.3
    case.faces[few] = case.faces[few, ::-1]


def flip_all(case):
    case.faces = case.faces[:, ::-1]


def move(case):
    size = np.ptp(case.vertices, axis=0).max()
    case.vertices = case.vertices + case.rng.uniform(-0.004, 0.004, case.vertices.shape) * size
    if case.simple:
        case.volume = case.signed_volume()


def spike(case):
    if not case.simple or case.kind == "nested":
        return
    v = case.rng.integers(len(case.vertices))
    middle = case.vertices.mean(axis=0)
    case.vertices = case.vertices.copy()
    case.vertices[v] = middle + (case.vertices[v] - middle) * case.rng.uniform(1.0, 1.6)
    case.volume = case.signed_volume()


def remove_faces(case):
    count = int(case.rng.choice([1, 2, 3, max(1, len(case.faces) // 3)]))
    case.faces = np.delete(case.faces, case.rng.integers(len(case.faces), size=count), axis=0)
    case.allow_error()


def remove_fan(case):
    v = case.rng.choice(case.faces.ravel())
    case.faces = case.faces[(case.faces != v).all(axis=1)]
    case.allow_error()


def cancel(case):
    few = case.rng.integers(len(case.faces), size=2)
    case.faces = np.concatenate([case.faces, case.faces[few][:, ::-1]])
    case.allow_error()


def wrong_index(case):
    case.faces = case.faces.copy()
    for _ in range(case.rng.integers(1, 4)):
        f, c = case.rng.integers(len(case.faces)), case.rng.integers(3)
        case.faces[f, c] = case.rng.integers(len(case.vertices))
    case.allow_error()


def bad_number(case):
    case.vertices = case.vertices.copy()
    v = case.faces[case.rng.integers(len(case.faces)), 0]
    value = case.rng.choice([np.nan, np.inf, -np.inf, 1e8, 1e30, -1e300])
    case.vertices[v, case.rng.integers(3)] = value
    case.must = "error"


def huge(case):
    case.vertices = case.vertices * 1e10 / np.abs(case.vertices).max()
    case.must = "error"


def no_size(case):
    keep = case.rng.choice([0, 1, 2])
    flat = np.zeros(3)
    flat[:keep] = 1.0
    case.vertices = case.vertices * flat
    case.must = "error"


def one_triangle(case):
    case.faces = case.faces[:1]
    case.must = "error"


def no_faces(case):
    case.faces = case.faces[:0]
    case.must = "error"


def index_out_of_range(case):
    case.faces = case.faces.copy()
    bad = case.rng.choice([-7, len(case.vertices), len(case.vertices) + 1000, 2**31 - 1])
    case.faces[case.rng.integers(len(case.faces)), 1] = bad
    case.must = "error"


SHAPE_KEPT = [shuffle, split, split_with_rounding, duplicate, degenerate, sliver, unused, flip_some,
              flip_all]  # fmt: skip
SHAPE_CHANGED = [move, spike, remove_faces, remove_fan, cancel, wrong_index]
HOPELESS = [bad_number, huge, no_size, one_triangle, no_faces, index_out_of_range]


# -- files -----------------------------------------------------------------------------------------


def file_bytes(case, form):
    """Write by hand: exporters refuse what is damaged."""
    v, f = case.vertices, case.faces
    with np.errstate(over="ignore", invalid="ignore"):
        if form in ("stl", "ascii.stl"):
            safe = np.clip(f, 0, len(v) - 1)
            corners = v[safe].astype(np.float32)
        if form == "stl":
            rows = np.zeros(len(f), dtype=[("n", "<3f4"), ("c", "<(3,3)f4"), ("a", "<u2")])
            rows["c"] = corners
            return b"\0" * 80 + struct.pack("<I", len(f)) + rows.tobytes()
    if form == "ascii.stl":
        facets = "".join(
            "facet normal 0 0 0\nouter loop\n"
            + "".join(f"vertex {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in corner)
            + "endloop\nendfacet\n"
            for corner in corners
        )
        return f"solid s\n{facets}endsolid s\n".encode()
    points = "".join(f"{x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in v)
    if form == "obj":
        lines = "".join(f"v {line}\n" for line in points.splitlines())
        return (lines + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in f)).encode()
    rows = "".join(f"3 {a} {b} {c}\n" for a, b, c in f)
    if form == "off":
        return f"OFF\n{len(v)} {len(f)} 0\n{points}{rows}".encode()
    kind = "ascii" if form == "ascii.ply" else "binary_little_endian"
    head = (
        f"ply\nformat {kind} 1.0\nelement vertex {len(v)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(f)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    if kind == "ascii":
        return (head + points + rows).encode()
    table = np.zeros(len(f), dtype=[("n", "u1"), ("i", "<3i4")])
    table["n"] = 3
    table["i"] = f
    return head.encode() + v.astype("<f8").tobytes() + table.tobytes()


def truncate(case, data):
    case.allow_error()
    case.unreported = False
    return data[: case.rng.integers(len(data) + 1)]


def empty(case, data):
    case.must = "error"
    return b""


def garbage(case, data):
    case.must = "error"
    return case.rng.bytes(int(case.rng.integers(1, 2000)))


def flip_bits(case, data):
    case.allow_error()
    case.unreported = False
    damaged = bytearray(data)
    for _ in range(case.rng.integers(1, 9)):
        if damaged:
            damaged[case.rng.integers(len(damaged))] ^= 1 << case.rng.integers(8)
    return bytes(damaged)


def drop_lines(case, data):
    """Cut a piece out of the middle."""
    case.allow_error()
    case.unreported = False
    begin = case.rng.integers(len(data) + 1)
    return data[:begin] + data[begin + case.rng.integers(1, 200) :]


def carriage_returns(case, data):
    return data.replace(b"\n", b"\r\n") if b"\0" not in data and case.text else data


def append_garbage(case, data):
    case.allow_error()
    return data + case.rng.bytes(50)


FILE_DAMAGE = [truncate, flip_bits, drop_lines, append_garbage, empty, garbage, carriage_returns]


def make_case(seed):
    """The case of a seed, and its file's ending and bytes."""
    case = Case(seed)
    rng = case.rng
    what = rng.random()
    if what < 0.35:
        _apply(case, SHAPE_CHANGED[rng.integers(len(SHAPE_CHANGED))])
    for _ in range(rng.integers(0, 4)):
        _apply(case, SHAPE_KEPT[rng.integers(len(SHAPE_KEPT))])
    if what > 0.85:
        _apply(case, HOPELESS[rng.integers(len(HOPELESS))])
    form = FORMATS[rng.integers(len(FORMATS))]
    if index_out_of_range in case.applied:
        if form == "obj":
            case.must = "either"  # there, negative ones count from the end
        elif "stl" in form:
            form = "off"  # STL has no indices
    case.text = form not in ("stl", "ply")
    data = file_bytes(case, form)
    ending = form.split(".")[-1]
    if rng.random() < 0.3:
        damage = FILE_DAMAGE[rng.integers(len(FILE_DAMAGE))]
        case.done.append(damage.__name__)
        hopeless = case.must == "error"
        data = damage(case, data)
        if hopeless and damage is not carriage_returns:
            case.must = "either"  # the damage may have cut out what was hopeless
            case.unreported = False
    elif rng.random() < 0.06:
        ending = str(rng.choice([e for e in ("stl", "obj", "ply", "off") if e != ending]))
        case.done.append(f"{form} named .{ending}")
        case.must = "either"
        case.unreported = False
    case.done.insert(0, f"{case.kind} {form}{' close' if case.close_holes else ''}")
    return case, ending, data


def _apply(case, damage):
    case.applied.append(damage)
    case.done.append(damage.__name__)
    damage(case)


# -- outcome ---------------------------------------------------------------------------------------


def run_case(seed, folder):
    """Run one case; returns what came of it. ``failure`` says what is wrong, if anything is."""
    case, ending, data = make_case(seed)
    path = Path(folder) / f"case{seed}.{ending}"
    path.write_bytes(data)
    result = {"seed": seed, "case": ", ".join(case.done)}
    try:
        surface = read_surface(path, close_holes=case.close_holes)
    except InputError as error:
        text = str(error)
        result["outcome"] = "refused"
        if "\n" in text or path.name not in text:
            result["failure"] = f"not one line that names the file: {text!r}"
        elif case.must == "model":
            result["failure"] = f"refused without need: {text}"
        return result
    finally:
        path.unlink()
    repairs = surface_repairs(surface.solid)
    result["outcome"] = "repaired" if repairs else "as it is"
    if case.must == "error":
        result["failure"] = "accepted"
        return result
    size = np.ptp(surface.bounds, axis=0).max()
    voxel = size / VOXELS_ACROSS
    try:
        voxels = voxelise(surface.solid, voxel=voxel, samples=SAMPLES, fill=1e-9, clean=False)
    except InputError as error:  # a solid that no sample meets: damage made its box huge
        result["outcome"] = "refused"
        if case.must == "model" or "no voxel" not in str(error):
            result["failure"] = f"refused without need: {error}"
        return result
    volume = float(voxels.fill.sum()) * voxel**3
    own = surface.solid.volume
    step = voxel / SAMPLES
    # Sampling: shapes of this kind and fineness come out within these limits undamaged.
    tolerance = 0.02 * own + 0.03 * surface.solid.area * step + 8 * step**3
    holes = surface.solid.report["hole_volume"]
    if not case.unreported and surface.solid.report["holes_closed"]:
        return result  # a file cut short may lack any part of a shape beyond a large hole
    volumes = voxels.report["volumes"]["skin"]
    folded = volumes["covered_twice"] + volumes["inside_out"]
    if abs(volume - own) > tolerance + holes + folded + (0 if case.simple else own):
        result["failure"] = f"voxels hold {volume:.4g}, the surface {own:.4g} m3"
    moved = not _same_places(surface.vertices, case.vertices)
    if moved and not case.unreported:
        return result  # the file says another shape, and is a surface of its own
    if abs(volume - case.volume) > tolerance + holes + folded:
        result["failure"] = (
            f"volume {volume:.4g}, true {case.volume:.4g} m3, allowed {tolerance + holes:.3g}; "
            f"repairs {repairs}"
        )
    return result


def _same_places(found, expected):
    """Whether every vertex lies where one of the mesh did, within the rounding of float32."""
    scale = np.abs(expected[np.isfinite(expected)]).max()
    places = {tuple(row) for row in np.rint(expected / (1e-4 * scale)).tolist()}
    return all(
        any(
            (row[0] + i, row[1] + j, row[2] + k) in places
            for i in (0, 1, -1)
            for j in (0, 1, -1)
            for k in (0, 1, -1)
        )
        for row in np.rint(found / (1e-4 * scale)).tolist()
    )


def main(first, count):
    """Run cases ``first`` to ``first + count - 1``."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + count):
            print(json.dumps({"begins": seed}), flush=True)
            start = time.process_time()
            try:
                result = run_case(seed, folder)
            except Exception as error:
                result = {"seed": seed, "case": ", ".join(make_case(seed)[0].done)}
                result |= {"outcome": "crashed", "failure": f"{type(error).__name__}: {error}"}
            result["seconds"] = time.process_time() - start
            print(json.dumps(result), flush=True)


if __name__ == "__main__":
    os.environ.setdefault("TLEDFACE_NUM_THREADS", "1")
    main(int(sys.argv[1]), int(sys.argv[2]))
