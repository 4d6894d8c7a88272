from __future__ import annotations

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generator.files.toml import dump_toml, from_dict, set_field, to_dict
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.presets import preset
from generator.model.scene import Scene

PRESETS = ["room", "tabletop", "corridor"]


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("target", ["sheet", "sphere", "teapot.obj"])
def test_scene_survives_toml(name, target):
    scene = preset(name, target)
    text = dump_toml(to_dict(scene))
    assert from_dict(Scene, tomllib.loads(text)) == scene


@given(
    st.dictionaries(
        st.text(min_size=1), st.one_of(st.text(), st.integers(-(2**60), 2**60), st.floats(), st.booleans())
    )
)
def test_dumped_toml_reads_back(data):
    back = tomllib.loads(dump_toml(data))
    assert back.keys() == data.keys()
    for key, value in data.items():
        assert back[key] == value or (value != value and back[key] != back[key])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("wall.albedo=1.5", "wall.albedo: 1.5 must lie between 0 and 1"),
        ("spot.power=-1", "spot.power"),
        ("spot.half_angle=95", "spot.half_angle"),
        ("grid.shape=[0,3,1]", "grid.shape"),
        ("grid.lo=[5,0,0]", "must lie below"),
        ("room.surfaces=['roof']", "room.surfaces"),
        ("camera.x=[1,0]", "camera.x"),
        ("spot.colour=3", "spot.colour: no such field"),
        ("ambient='much'", "ambient: 'much' must be a number"),
        ("target.kind='cube'", "target.kind"),
        ("resolution=[64]", "resolution: must hold 2 values"),
        ("spot", "NAME=VALUE"),
        ("preset.deep=1", "not a table"),
        ("ambient=nan", "not a finite number"),
        ("resolution=[0, 64]", "resolution"),
    ],
)
def test_bad_figures_are_named(change, words):
    plain = to_dict(preset("room"))

    def build():
        set_field(plain, change)
        return from_dict(Scene, plain)

    with pytest.raises(NlosError) as error:
        build()
    assert words in str(error.value)


def test_voxels_run_along_x_first():
    grid = preset("room").grid
    assert grid.labels == list("ABCDEFGHI")
    assert grid.cell(1) == (1, 0, 0)
    assert grid.cell(3) == (0, 1, 0)
    lo, hi = grid.bounds(8)
    np.testing.assert_allclose(lo, (1.8, 1.4, 0.4))
    np.testing.assert_allclose(hi, (2.3, 1.9, 2.2))


def test_labels_go_on_like_spreadsheet_columns():
    labels = VoxelGrid(lo=(0, 0, 0), hi=(1, 1, 1), shape=(10, 10, 10)).labels
    assert labels[25:28] == ["Z", "AA", "AB"]
    assert labels[701:703] == ["ZZ", "AAA"]
    assert len(set(labels)) == 1000


def test_reference_radiance_is_the_inverse_square_law():
    scene = preset("room")
    d = np.subtract(scene.spot.location, scene.spot.aim)
    cosine = d[1] / np.linalg.norm(d)
    expected = 0.8 / np.pi * (1000 / (4 * np.pi)) * cosine / (d @ d)
    assert scene.reference_radiance == pytest.approx(expected, rel=1e-12)


def test_ambient_light_opens_a_closed_room():
    assert "ceiling" not in preset("room").with_ambient(0.1).room.surfaces
    assert preset("room").with_ambient(0.0) == preset("room")


@pytest.mark.parametrize("name", ["room", "corridor"])
def test_presets_hide_every_voxel_and_reach_every_voxel(name):
    """No straight line from lamp or camera into a voxel; one from w1 and from the watched patch to each of them."""
    scene = preset(name)
    grid, screen = scene.grid, scene.partition
    # (The tabletop hides nothing: its lamp and camera stand between wall and object, as in the paper it is from.)

    def blocked(a, b):
        t = (screen.x - a[0]) / (b[0] - a[0])
        return 0 < t < 1 and a[1] + t * (b[1] - a[1]) >= screen.y[0]

    corners = [
        (x, y, z)
        for voxel in range(grid.n_voxels)
        for x in (grid.bounds(voxel)[0][0], grid.bounds(voxel)[1][0])
        for y in (grid.bounds(voxel)[0][1], grid.bounds(voxel)[1][1])
        for z in (grid.lo[2], grid.hi[2])
    ]
    seen = [(x, 0.0, z) for x in np.linspace(*scene.camera.x, 5) for z in scene.camera.z]
    assert all(blocked(eye, c) for c in corners for eye in (scene.spot.location, scene.camera.location))
    assert not any(blocked(scene.spot.aim, c) for c in corners if scene.spot.aim[0] != c[0])
    assert not any(blocked(p, c) for c in corners for p in seen)
    assert not blocked(scene.spot.location, scene.spot.aim)
    reach = (
        2.0
        * np.tan(np.radians(scene.spot.half_angle))
        * np.linalg.norm(np.subtract(scene.spot.aim, scene.spot.location))
    )
    assert scene.spot.aim[0] - reach > scene.camera.x[1], "the lit patch must lie outside the watched one"
