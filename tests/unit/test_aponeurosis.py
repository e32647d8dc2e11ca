"""The galea sheet: where it lies on a round head with a muscle that has a V-shaped gap."""

import numpy as np
import pytest
import trimesh

from tledface import _core
from tledface.errors import InputError
from tledface.geometry.aponeurosis import aponeurosis

R = 80e-3


def edge(angle):
    """Upper edge of the muscle, m: lower at the midline."""
    return 20e-3 + 12e-3 * np.minimum(abs(angle) / np.radians(15.0), 1.0)


def solid(mesh, name):
    return _core.prepare_surface(mesh.vertices, mesh.faces.astype(np.int32), name)


@pytest.fixture(scope="module")
def head():
    skin = trimesh.creation.icosphere(subdivisions=5, radius=R)
    # A shell 2 to 4 mm under the skin, from z = 0 to the edge, 40 degrees to either side.
    angle, share = np.meshgrid(np.radians(np.linspace(-40, 40, 81)), np.linspace(0, 1, 41))
    grids = []
    for r in (R - 2e-3, R - 4e-3):
        z = share * edge(angle)
        flat = np.sqrt(r**2 - z**2)
        grids.append(np.stack([flat * np.sin(angle), -flat * np.cos(angle), z], axis=-1))
    from tledface.geometry.aponeurosis import closed_sheet

    return solid(skin, "skin"), solid(closed_sheet(*grids), "muscle")


def test_it_lies_at_the_muscles_depth_and_reaches_into_it(head):
    skin, muscle = head
    sheet = aponeurosis(skin, [muscle], top=60e-3, overlap=3e-3, thickness=1e-3)
    assert sheet.is_watertight and sheet.is_winding_consistent and sheet.volume > 0
    depth = R - np.linalg.norm(sheet.vertices, axis=1)
    assert depth.min() == pytest.approx(2.5e-3, abs=0.15e-3)
    assert depth.max() == pytest.approx(3.5e-3, abs=0.15e-3)
    angle = np.arctan2(sheet.vertices[:, 0], -sheet.vertices[:, 1])
    assert np.degrees(angle.max()) == pytest.approx(40.0, abs=1.0)
    # The lower rim follows the edge, gap included; the upper one is level.
    for at in (-35, -20, -8, 0, 8, 25):
        near = abs(np.degrees(angle) - at) < 1.0
        low = sheet.vertices[near, 2].min()
        blunt = 2.0e-3 if at == 0 else 1.2e-3  # smoothing takes the tip off the gap
        assert low == pytest.approx(edge(np.radians(at)) - 3e-3, abs=blunt), at
    assert sheet.vertices[:, 2].max() == pytest.approx(60e-3 * (R - 2.5e-3) / R, abs=0.5e-3)


def test_a_top_that_is_no_top(head):
    skin, muscle = head
    with pytest.raises(InputError, match="top is 20 mm, the muscle reaches 3"):
        aponeurosis(skin, [muscle], top=20e-3)
    with pytest.raises(InputError, match="no skin at"):
        aponeurosis(skin, [muscle], top=90e-3)
