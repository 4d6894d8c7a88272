from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.model import poses
from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.settings import Sweep

GRID = preset("room").grid
SHEET = np.array([(x, 0.0, z) for x in (-0.25, 0.25) for z in (-0.25, 0.25)])
TURNING = Sweep(rotation=(15.0, 15.0, 90.0), poses=3)


def test_another_seed_gives_other_poses_and_other_noise():
    a, b = (poses.plan(GRID, Sweep(seed=seed, poses=2), SHEET * 0.5) for seed in (0, 1))
    assert not {p.position for p in a} & {p.position for p in b}
    assert not {p.seed for p in a} & {p.seed for p in b}


def test_no_two_poses_share_position_or_noise():
    plan = poses.plan(GRID, Sweep(poses=100), SHEET * 0.5)
    assert len({p.seed for p in plan}) == len({p.position for p in plan}) == len({p.file for p in plan}) == 900
    assert poses.noise_seed(0, 0) not in {p.seed for p in plan}, "the background's noise is its own"


def test_more_poses_leave_the_first_ones_alone():
    few, many = (poses.plan(GRID, Sweep(poses=n), SHEET * 0.5) for n in (2, 5))
    assert many[: len(few)] == few


@given(st.integers(0, 8), st.integers(0, 50))
@settings(max_examples=30, deadline=None)
def test_the_whole_target_stays_in_its_voxel(voxel, index):
    position, rotation = poses.draw(GRID, voxel, index, TURNING, SHEET)
    corners = SHEET @ rotation_matrix(rotation).T + position
    lo, hi = GRID.bounds(voxel)
    assert (corners >= lo - 1e-6).all()
    assert (corners <= hi + 1e-6).all()
    assert (np.abs(rotation) <= TURNING.rotation).all()


def test_rotation_matrix_is_blenders():
    pytest.importorskip("bpy", reason="bpy is not installed: no Blender to compare with")
    from mathutils import Euler

    angles = (20.0, -35.0, 110.0)
    blender = np.array(Euler(np.radians(angles), "XYZ").to_matrix())
    np.testing.assert_allclose(rotation_matrix(angles), blender, atol=1e-6)


def test_poses_are_uniform_where_nothing_turns():
    lo, hi = GRID.bounds(4)
    sweep = Sweep(inside="centre")
    where = np.array([poses.draw(GRID, 4, i, sweep, SHEET)[0] for i in range(400)])
    fraction = (where - lo) / (hi - lo)
    # Kolmogorov-Smirnov, 400 draws: 0.0976 is passed by chance once in 1,000.
    for axis in range(3):
        distance = np.abs(np.sort(fraction[:, axis]) - (np.arange(400) + 0.5) / 400).max()
        assert distance < 0.0976


def test_a_target_that_fits_exactly_fits():
    position, _ = poses.draw(GRID, 0, 0, Sweep(), SHEET)
    assert position[0] == pytest.approx(1.05)


def test_a_target_that_does_not_fit_is_named_with_both_sizes():
    with pytest.raises(NlosError, match=r"voxel A: found no place for the target \(0\.7 x 0 x 0\.7 m\) in 0\.5"):
        poses.draw(GRID, 0, 0, Sweep(), SHEET * 1.4)
    poses.draw(GRID, 0, 0, Sweep(inside="centre"), SHEET * 1.4)


def test_what_does_not_fit_comes_with_what_would_help():
    def advice(hull, **settings):
        with pytest.raises(NlosError, match="found no place") as refused:
            poses.draw(GRID, 0, 0, Sweep(**settings), hull)
        return str(refused.value).partition("; ")[2]

    rigid = "take a smaller target, or larger voxels, or only its centre inside (--inside centre)"
    assert advice(SHEET * 1.4) == rigid
    assert "or smaller turns (--rotation 0 0 0)" in advice(SHEET * 1.4, rotation=(15, 15, 90))
    assert advice(SHEET * 1000) == f"{rigid} (a mesh's unit is the metre; target.size scales it)"


def test_a_taken_place_is_not_used():
    def is_free(position, rotation):
        return position[2] > 1.5

    assert all(poses.draw(GRID, 0, i, Sweep(), SHEET * 0.5, is_free)[0][2] > 1.5 for i in range(20))
    with pytest.raises(NlosError, match="clear of all surfaces"):
        poses.draw(GRID, 0, 0, Sweep(), SHEET * 0.5, lambda *_: False)
