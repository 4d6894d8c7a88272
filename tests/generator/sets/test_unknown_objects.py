"""Objects that stand in for an unknown one, and sets of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from classify.cli import main
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import Sampler
from generator.model.presets import preset
from generator.model.settings import Sweep
from generator.sets.bulk_set import Bulk
from generator.sets.unknown_objects import DARKEST, FLAT, unknown_object
from generator.transport import Transport
from generator.transport.elements import cells, is_convex_solid

GRID = preset("room").grid
TURNED = Sweep(rotation=(15.0, 15.0, 90.0))


def test_they_are_convex_and_fit_into_a_voxel():
    flat = 0
    for index in range(200):
        mesh = unknown_object(GRID, TURNED, index)
        corners = mesh.triangles.reshape(-1, 3)
        assert (np.ptp(corners, axis=0) < GRID.size).all()
        Sampler(GRID, replace(TURNED, rotation=(0.0, 0.0, 0.0)), corners).draw(0, index)
        sheet = len(mesh.triangles) == 2
        assert sheet or is_convex_solid(mesh.triangles)
        assert len(cells((mesh,))[0]) == (1 if sheet else 6), "its triangles are joined to parallelograms"
        assert DARKEST <= mesh.albedo.min() == mesh.albedo.max() <= 1.0
        flat += sheet
    # What fits is chosen from among sheets and boxes, of which sheets fit more often.
    assert 200 * FLAT - 3 * math.sqrt(200 * FLAT * (1 - FLAT)) < flat < 120


def test_each_follows_from_its_seed_and_index_alone():
    one = unknown_object(GRID, TURNED, 7)
    assert (unknown_object(GRID, TURNED, 7).triangles == one.triangles).all()
    others = [unknown_object(GRID, TURNED, 8), unknown_object(GRID, replace(TURNED, seed=1), 7)]
    others.append(unknown_object(GRID, TURNED, 7, stream=1))
    assert all(len(o.triangles) != len(one.triangles) or (o.triangles != one.triangles).any() for o in others)


def test_what_does_not_turn_stands_straight():
    for index in range(20):
        edges = np.diff(unknown_object(GRID, Sweep(), index).triangles, axis=1).reshape(-1, 3)
        off_axis = np.sort(np.abs(edges), axis=1)[:, :-1]
        # Edges of a box run along one axis, diagonals of its faces along two.
        assert (off_axis[:, 0] < 1e-12).all()


def test_only_centres_inside_leaves_no_size_out():
    centre = replace(TURNED, inside="centre")
    widest = max(
        np.ptp(unknown_object(GRID, centre, i).triangles.reshape(-1, 3), axis=0)[:2].max() for i in range(200)
    )
    assert widest > min(GRID.size[:2])


def test_a_grid_that_holds_none_is_one_sentence():
    narrow = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.0, 1.0, 0.05), shape=(1, 1, 1))
    with pytest.raises(NlosError, match="hold none of the unknown objects; keep only their centres inside"):
        unknown_object(narrow, TURNED, 0)


@pytest.fixture(scope="module")
def unknown(tmp_path_factory, scene_file, command):
    """A set of five unknown objects, from the command line."""
    path = tmp_path_factory.mktemp("unknown") / "set"
    made = ("bulk", scene_file, "-o", path, "--pictures", "45", "--part", "8", "--resolution", "8")
    result = command("generator", *made, "--accuracy", "0.01", "--unknown")
    assert result.returncode == 0, result.stderr
    return path


@pytest.fixture(scope="module")
def others(tmp_path_factory, scene_file, command):
    """A set of other unknown objects."""
    path = tmp_path_factory.mktemp("unknown") / "others"
    made = ("bulk", scene_file, "-o", path, "--pictures", "9", "--resolution", "8", "--no-probe", "--seed", "1")
    result = command("generator", *made, "--accuracy", "0.01", "--unknown")
    assert result.returncode == 0, result.stderr
    return path


def test_a_set_of_unknown_objects(unknown, scene_file, command):
    found = Bulk.open(unknown)
    assert (found.target_kind, found.rotations.any()) == ("box", False)
    for number in (3, 13, 21):  # of the first, second and third index
        mesh = unknown_object(found.grid, found.plan.sweep, number // 9, stream=found.plan.numbered_stream)
        one = Transport(replace(found.world(), target=(mesh,)), accuracy=0.01)
        alone = one.pictures([found.positions[number]], [found.rotations[number]])[0, :, :, 0]
        np.testing.assert_array_equal(found.pictures[number], alone)
    other = command("generator", "bulk", scene_file, "-o", unknown, "--no-unknown")
    assert other.returncode == 2
    assert "unknown is True there and False here" in other.stderr


def test_their_atlas_from_the_shell(unknown, others, tmp_path, capsys):
    """A bound on the voxel and the place, and none of what is asked of one object only."""
    atlas = str(tmp_path / "any.atlas")
    assert main.main(["atlas", str(unknown), "-o", atlas]) == 0
    assert "45 pictures of a box" in capsys.readouterr().out
    assert main.main(["bound", atlas, str(unknown), "--count", "40", "--voxels", "3", "3", "2"]) == 0
    told = capsys.readouterr().out
    assert "median error of the position" in told
    assert "presence" not in told
    assert "\u2502 R     \u2502" in told, "eighteen voxels"
    assert main.main(["bound", atlas, str(unknown), "--map", str(tmp_path / "map.png")]) == 2
    assert "draws what can be known of one object" in capsys.readouterr().err
    assert main.main(["atlas", str(unknown), "-o", atlas, "--unknown"]) == 2
    assert "is of objects of all sizes and albedos already" in capsys.readouterr().err
    assert main.main(["locate", atlas, str(unknown), "--count", "18", "--voxels", "3", "3", "2"]) == 2
    assert "18 of its 18 poses are also in the atlas" in capsys.readouterr().err
    assert main.main(["locate", atlas, str(others), "--count", "9", "--voxels", "3", "3", "2"]) == 0
    assert "within 95 % region" in capsys.readouterr().out
