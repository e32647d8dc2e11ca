"""A scene's ``[boundary]`` as a whole: nodes bound twice, entries without nodes, bad entries."""

import numpy as np
import pytest

from shell_scene import CENTRE, INF, build, groups
from tledface.boundary import bone_names
from tledface.build import BuildWarning
from tledface.errors import InputError


def test_nodes_bound_twice_are_counted_and_rigid_comes_first(tmp_path):
    x, y, z = CENTRE
    boundary = {
        "fixed": [{"box": [[x, -INF, -INF], [INF, INF, INF]]}],
        "attachments": [{"muscle": "lid", "reach": 1.0}],
        "ligaments": [
            {"name": "a", "points": [[x - 4, y, z + 9]], "radius": 3},
            {"name": "b", "points": [[x - 5, y, z + 9]], "radius": 3},
        ],
        "sliding": ["bones"],
    }
    model = build(tmp_path, boundary=boundary)
    named, free = groups(model), build(tmp_path, boundary={"sliding": ["bones"]}).sliding.nodes
    counted = {
        (entry["first"], entry["second"]): (entry["nodes"], entry["kept"])
        for entry in model.report["boundary"]["bound_twice"]
    }
    claims = {
        "fixed[0]": named["fixed", "fixed[0]"],
        "attachment lid on bones": named["attachment", "lid on bones"],
        "ligament a": named["ligament", "a"],
        "ligament b": named["ligament", "b"],
    }
    names = list(claims)
    for first, name in enumerate(names):
        for other in names[first + 1 :]:
            shared = len(np.intersect1d(claims[name], claims[other]))
            assert counted.get((name, other), (0, "held once")) == (shared, "held once")
        shared = len(np.intersect1d(claims[name], free))
        assert counted[name, "sliding"] == (shared, "rigid") and shared > 0
    rigid = np.unique(np.concatenate(list(claims.values())))
    np.testing.assert_array_equal(np.flatnonzero(model.fixed.all(axis=1)), rigid)
    np.testing.assert_array_equal(model.sliding.nodes, np.setdiff1d(free, rigid))
    assert counted["ligament a", "ligament b"][0] > 10


def test_entries_without_nodes_warn(tmp_path):
    z = CENTRE[2]
    entries = {
        r"fixed\[0\]: no node lies in the box": {"fixed": [{"box": [[90, 90, 90], [91, 91, 91]]}]},
        r"cuts\[0\] z\+: no cut face": {"cuts": [{"side": "z+", "at": z + 40}]},
        r"ligament far: no node": {
            "ligaments": [{"name": "far", "points": [[90, 90, 90]], "radius": 1}]
        },
        r"attachment lid on bones: no node": {"attachments": [{
            "muscle": "lid", "reach": 0, "boxes": [[[90, 90, 90], [91, 91, 91]]]}]},
        r"sliding: no node slides": {"sliding": {"boxes": [[[90, 90, 90], [91, 91, 91]]]}},
    }  # fmt: skip
    for pattern, boundary in entries.items():
        with pytest.warns(BuildWarning, match=pattern):
            model = build(tmp_path, boundary=boundary)
        assert len(model.report["warnings"]) == 1


@pytest.mark.parametrize(
    ("boundary", "pattern"),
    [
        ({"sliding": ["jaw"]}, r"boundary\.sliding\.on: got 'jaw'; allowed: bones, skull"),
        ({"attachments": [{"muscle": "lid", "bone": "jaw", "reach": 1}]},
         r"boundary\.attachments\[0\]\.bone: got 'jaw'"),
        ({"attachments": [{"muscle": "lids", "reach": 1}]},
         r"boundary\.attachments\[0\]\.muscle: got 'lids'; allowed: lid"),
        ({"cuts": [{"side": "z+"}]}, r"boundary\.cuts\[0\]\.at: key missing"),
        ({"cuts": [{"side": "up"}]}, r"side: got 'up'; allowed: one of x-, x\+"),
        ({"sliding": "bones"}, r"sliding: got 'bones'; allowed: a list of bones"),
        ({"sliding": {"facing": 1.0}}, r"facing: got 1.0; allowed"),
        ({"symmetry": [{"axis": "x"}, {"axis": "x", "at": 1}]}, r"axis 'x' is used twice"),
        ({"ligaments": [{"name": "a", "radius": 1}]}, r"points, file: got neither"),
        ({"ligaments": [{"name": "a", "points": [[0, 0]], "radius": 1}]}, "three lengths"),
        ({"fixed": [{"box": [[0, 0, 0], [INF, -INF, 0]]}]}, "a low corner not above the high"),
        ({"fixed": [{"box": [[0, 0, 0], [float("nan"), 1, 1]]}]}, "finite number"),
    ],
)  # fmt: skip
def test_bad_entries_are_one_clear_line(tmp_path, boundary, pattern):
    with pytest.raises(InputError, match=pattern) as caught:
        build(tmp_path, boundary=boundary)
    assert "\n" not in str(caught.value)


def test_names_of_bones(tmp_path):
    paths = [tmp_path / name for name in ("a/jaw.stl", "b/jaw.obj", "bones.ply")]
    assert bone_names(paths) == ["jaw", "jaw 2", "bones 2"]
