"""What varies from pose to pose: how it is written, and that its draws follow from the seed alone."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from generator.model.errors import NlosError
from generator.model.poses import PoseRecord, plan, pose_columns
from generator.model.presets import preset
from generator.model.settings import Sweep
from generator.model.variation import draw, parse

GRID = preset("room").grid
POINT = np.zeros((1, 3))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("target.albedo", "must read NAME=LOW:HIGH"),
        ("target.albedo=0.3", "must read NAME=LOW:HIGH"),
        ("target.albedo=a:b", "must read NAME=LOW:HIGH"),
        ("target.albdo=0:1", r"did you mean target\.albedo\?"),
        ("camera=0:1", "choose from target.albedo, wall.albedo, room.albedo, spot.power"),
        ("target.albedo=1:0.3", "must run from low to high"),
        ("wall.albedo=0.5:1.5", "between 0 and 1"),
        ("wall.albedo=nan:1", "between 0 and 1"),
        ("spot.power=1:inf", "from 0 up"),
    ],
)
def test_what_cannot_vary_is_one_sentence(text, words):
    with pytest.raises(NlosError, match=words):
        Sweep(vary=(text,))


def test_nothing_varies_twice_or_along_a_trajectory_or_without_paired_noise():
    for settings, words in (
        ({"vary": ("target.albedo=0:1", "target.albedo=0:0.5")}, "given twice"),
        ({"vary": ("target.albedo=0:1",), "frames": 5}, "trajectory"),
        ({"vary": ("room.albedo=0:1",), "paired": False}, "--no-paired"),
    ):
        with pytest.raises(NlosError, match=words):
            Sweep(**settings)
    assert not Sweep(vary=("target.albedo=0:1",), paired=False).own_backgrounds


def test_values_are_uniform_and_follow_from_seed_voxel_index_and_name_alone():
    both = parse(["wall.albedo=0.2:0.8", "target.albedo=0.3:1"])
    drawn = [draw(both, 3, voxel, index) for voxel in range(9) for index in range(100)]
    for k, (low, high) in enumerate([(0.2, 0.8), (0.3, 1.0)]):
        values = np.array([values[k][1] for values in drawn])
        assert kstest((values - low) / (high - low), "uniform").pvalue > 1e-3
        assert len(set(values)) == len(values)
    albedos = np.array([[value for _, value in values] for values in drawn])
    assert abs(np.corrcoef(albedos.T)[0, 1]) < 4 / np.sqrt(len(albedos))
    assert draw(both[1:], 3, 4, 7) == draw(both, 3, 4, 7)[1:]
    assert draw(both, 3, 4, 7) != draw(both, 3, 4, 7, stream=1)


@pytest.mark.parametrize("inside", ["whole", "centre"])
def test_objects_have_voxels_of_their_own_and_do_not_cut_one_another(inside):
    hull = 0.15 * np.concatenate([np.eye(3), -np.eye(3)])
    planned = plan(GRID, Sweep(poses=20, targets=3, inside=inside), hull)
    alone = plan(GRID, Sweep(poses=20, inside=inside), hull)
    assert [(pose.position, pose.rotation) for pose in planned] == [(pose.position, pose.rotation) for pose in alone]
    placed = []
    for pose in planned:
        objects = [pose, *pose.others]
        assert len({one.voxel for one in objects}) == 3
        assert all(GRID.voxel(np.array(one.position)) == one.voxel for one in objects)
        assert pose.answer == "+".join(sorted(one.label for one in objects))
        places = np.array([one.position for one in objects])
        least = min(np.linalg.norm(places[a] - places[b]) for a, b in ((0, 1), (0, 2), (1, 2)))
        assert inside == "whole" or least >= 0.3
        placed += map(tuple, places.tolist())
        assert PoseRecord.from_row(dict(zip(pose_columns(planned), pose.row(), strict=True))) == pose
    assert len(set(placed)) == len(placed), "no two pictures share a place"
    homes = Counter(other.voxel for pose in planned for other in pose.others)
    assert chisquare([homes[voxel] for voxel in range(GRID.n_voxels)]).pvalue > 1e-3


def test_more_objects_than_voxels_or_room_are_one_sentence():
    with pytest.raises(NlosError, match="targets: 10 do not fit into 9 voxels"):
        plan(GRID, Sweep(poses=1, targets=10), POINT)
    with pytest.raises(NlosError, match="targets: one object walks along a trajectory"):
        Sweep(frames=3, targets=2)
    large = 5.0 * np.eye(3)
    with pytest.raises(NlosError, match=r"targets: found no place in voxel . clear of the other objects"):
        plan(GRID, Sweep(poses=1, targets=2, inside="centre"), large)


def test_poses_do_not_depend_on_what_varies():
    still = plan(GRID, Sweep(poses=2), POINT)
    varied = plan(GRID, Sweep(poses=2, vary=("target.albedo=0.3:1",)), POINT)
    assert [pose.plan[:7] for pose in varied] == [pose.plan[:7] for pose in still]
    assert [len(pose.row()) for pose in varied] == [len(still[0].row()) + 1] * len(varied)
