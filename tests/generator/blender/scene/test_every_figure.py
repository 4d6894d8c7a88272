"""Every figure that ``scene`` takes makes a file that can be read, planned and rendered, or is refused by name."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from generator.blender import sweep_worker
from generator.blender.engines import renderers
from generator.blender.scene import blend_file, build, geometry
from generator.blender.scene.description import read_scene
from generator.files.toml import from_dict, set_field, to_dict
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid, voxel_label
from generator.model.presets import preset
from generator.model.scene import ROOM_SURFACES, Scene, Target, replace, unlike

GOOD = [
    *(f'room.surfaces=["{name}"]' for name in ROOM_SURFACES),
    "room.surfaces=[]",
    'room.surfaces=["left","right"]',
    "room.albedo=0",
    "room.z=[0.5,0.6]",
    "partition.depth=1",
    "partition.y=[1.3,1.3001]",
    "wall.x=[-1e4,1e4]",
    "spot.power=0",
    "spot.power=1e30",
    "spot.half_angle=0.5",
    "spot.aim=[0.3,-1,1.3]",
    "spot.location=[0.3,1e-6,1.3]",
    "camera.location=[-1.1,0.5,1.4]",
    "grid.shape=[1,1,1]",
    "target.size=1e-6",
    "target.albedo=0",
    "ambient=1e-40",
    "reflection_order=1",
    "reflection_order=1024",
    "resolution=[3,3]",
    "resolution=[65536,65536]",
]
BAD = {
    'room.surfaces=["floor","floor"]': "room.surfaces",
    "room.z=[1,1]": "room.z",
    "partition.z=[1,1]": "partition.z",
    "partition.depth=-1": "partition.depth",
    "spot.power=1e39": "spot.power",
    "spot.half_angle=0.4": "spot.half_angle",  # Blender's least is half a degree: its picture was another cone's
    "spot.location=[-1,-3,1.7]": "spot.location",
    "spot.location=[-1,0,1.7]": "spot.location",
    "spot.aim=[0.3,5,1.3]": "spot.location",
    "camera.location=[-1.1,0,1.4]": "camera.location",
    "camera.location=[-1.1,1e30,1.4]": "camera",
    "grid.hi=[0.80000001,1.9,2.2]": "grid",
    "target.size=1e39": "target.size",
    "ambient=1e39": "ambient",
    "resolution=[2,1]": "resolution",
}


def wanted(setting):
    plain = to_dict(preset("room"))
    set_field(plain, setting)
    return from_dict(Scene, plain)


def made(setting):
    """As ``nlos-generate scene room --set ...`` does it."""
    scene = blend_file.new_file()
    asked = wanted(setting)
    build.build(scene, asked)
    if words := unlike(asked, read_scene(scene)):
        raise NlosError(words)
    return scene


@pytest.mark.parametrize("setting", GOOD)
def test_a_figure_that_is_taken_can_be_swept(setting, tmp_path):
    file = tmp_path / "scene.blend"
    made(setting)
    blend_file.save_file(file)
    scene = blend_file.open_file(file)
    chosen = {"engine": "patch", "samples": 1, "poses": 1, "resolution": "4"}
    dataset = sweep_worker.plan(scene, file, tmp_path / "set", chosen, force=True, probe=False)
    assert dataset.planned == dataset.grid.n_voxels
    with renderers.opened(scene, "patch", resolution=(4, 4)) as renderer:
        assert np.isfinite(renderer.render(samples=1, seed=0)).all()


@pytest.mark.parametrize("setting", BAD)
def test_a_figure_that_cannot_be_is_named(setting):
    with pytest.raises(NlosError, match=rf"^(\S+: )?(the )?{BAD[setting]}"):
        made(setting)


def test_the_command_refuses_and_leaves_no_file(tmp_path, command):
    file = tmp_path / "a.blend"
    done = command("generator", "scene", "room", "--set", "spot.half_angle=0.1", "-o", file)
    assert (done.returncode, done.stdout, file.exists()) == (2, "", False)
    assert done.stderr.startswith("error: spot.half_angle: 0.1 becomes 0.5 in Blender")


def test_the_command_says_what_check_would(tmp_path, command):
    done = command("generator", "scene", "room", "--set", "reflection_order=2", "-o", tmp_path / "a.blend")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("error: Light makes 2 reflections at most")
    checked = command("generator", "check", tmp_path / "a.blend", "--resolution", "8")
    assert done.stdout.splitlines()[0] in checked.stdout.splitlines()
    for name in ("room", "corridor"):
        done = command("generator", "scene", name, "-o", tmp_path / "b.blend")
        assert done.stdout.startswith(f"{tmp_path / 'b.blend'}: "), name


def test_many_voxels_have_their_names_at_once():
    """Made anew at each question they took a minute of the check."""
    grid = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.0, 1.0, 1.0), shape=(100, 100, 10))
    assert grid.labels is grid.labels
    assert grid.labels[-1] == voxel_label(99_999)


def corners(path, *places):
    """Write an OBJ of one triangle."""
    lines = [*("v " + " ".join(map(str, place)) for place in places), "f 1 2 3"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "places",
    [
        [(1, 2, 3)] * 3,  # one point
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)],  # a line
        [(0, 0, 0), (0, 0, 0), (0, 1, 0)],  # an edge
        [(0, 0, 0), (1, 0, 0), (0, "nan", 0)],
    ],
)
@pytest.mark.parametrize("size", [0.0, 0.3])
def test_a_mesh_file_without_extent_is_refused_by_name(tmp_path, places, size):
    path = corners(tmp_path / "flat.obj", *places)
    target = Target(kind="mesh", size=size, mesh=str(path))
    with pytest.raises(NlosError, match=r"^target\.mesh: .*flat\.obj has no extent"):
        build.build(blend_file.new_file(), replace(preset("room"), target=target))
    assert not bpy.context.scene.objects


def test_a_mesh_file_of_a_sliver_keeps_its_shape(tmp_path):
    path = corners(tmp_path / "thin.obj", (0, 0, 0), (1, 0, 0), (0, 0, 1e-5))
    target = Target(kind="mesh", size=0.3, mesh=str(path))
    scene = blend_file.new_file()
    build.build(scene, replace(preset("room"), target=target))
    extent = np.ptp(geometry.hull(scene), axis=0)
    assert max(extent) == pytest.approx(0.3, rel=1e-6)
    assert sorted(extent)[1] == pytest.approx(3e-6, rel=1e-3)
