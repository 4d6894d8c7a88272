"""The filter against the hidden Markov model written out, and sequences tracked, lost and found again."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from classify_helpers import make_bulk, make_seen, plain_atlas
from scipy.linalg import expm
from scipy.spatial import cKDTree
from scipy.stats import binom, multivariate_normal

from classify.inference import atlas_build, sequence
from classify.inference.posterior import holds, locate
from classify.inference.tracker import Filter
from classify.intervals import wilson
from classify.pictures.sensor import Sensor
from generator.model import poses
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.settings import Sweep
from generator.sets.dataset import Dataset

GRID = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.5, 0.6, 0.2), shape=(3, 2, 1))


def lattice(count=600, scale=6.0, seed=0):
    """An atlas whose codes are the positions themselves, to scale."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(GRID.lo, GRID.hi, size=(count, 3))
    voxels = np.array([GRID.voxel(p) for p in places])
    codes = (scale * (places + 0.5)).astype(np.float32)
    return plain_atlas(codes, places, voxels, GRID)


def written_out(atlas, codes, *, step, appear, vanish, edge=0.1):
    """Presence and place, frame by frame: the forward recursion, every transition and covariance in a full matrix."""
    shape = np.array([15, 6, 2])
    places = np.minimum((atlas.positions / edge).astype(int), shape - 1)
    cells, of = np.unique(places, axis=0, return_inverse=True)
    of = of.ravel()
    # Many tiny steps to either side make the walk of one frame: a matrix exponential, cell by cell.
    longest = int(shape.max())
    line = expm(
        (step / edge) ** 2 / 2.0 * (np.eye(8 * longest, k=1) + np.eye(8 * longest, k=-1) - 2.0 * np.eye(8 * longest))
    )
    reach, middle = longest, 4 * longest
    kernel = line[middle, middle - reach : middle + reach + 1]
    moves = np.ones((len(cells), len(cells)))
    for axis in range(3):
        apart = cells[:, None, axis] - cells[None, :, axis]
        moves *= np.where(np.abs(apart) <= reach, kernel[np.clip(apart + reach, 0, 2 * reach)], 0.0)
    moves /= moves.sum(axis=1, keepdims=True)
    size = np.bincount(of)
    tree = cKDTree(atlas.positions)
    joint = []  # mean and covariance of place and code in each cell
    for cell in range(len(cells)):
        some = np.flatnonzero(of == cell)
        if len(some) < 12:
            some = tree.query(atlas.positions[some].mean(axis=0), 12)[1]
        both = np.hstack([atlas.positions[some], atlas.codes[some].astype(float)])
        joint.append((both.mean(axis=0), np.cov(both.T)))
    known, presence, told = size / size.sum(), 0.5, []
    for code in codes:
        nothing = multivariate_normal(np.zeros(3)).pdf(code)
        cell = np.array([multivariate_normal(m[3:], np.eye(3) + c[3:, 3:]).pdf(code) for m, c in joint]) / nothing
        gains = [c[:3, 3:] @ np.linalg.inv(np.eye(3) + c[3:, 3:]) for _, c in joint]
        places = np.array([m[:3] + g @ (code - m[3:]) for (m, _), g in zip(joint, gains, strict=True)])
        lefts = np.array([c[:3, :3] - g @ c[3:, :3] for (_, c), g in zip(joint, gains, strict=True)])
        left = 1.0 - presence * (1.0 - vanish)
        there = (presence * (1.0 - vanish) * (known @ moves) + left * appear / len(cells)) * cell
        gone = left * (1.0 - appear)
        presence = there.sum() / (there.sum() + gone)
        known = there / there.sum()
        mean = known @ places
        apart = places - mean
        told.append((presence, mean, np.einsum("n,nab->ab", known, lefts) + (apart * known[:, None]).T @ apart))
    return told


@pytest.mark.parametrize("step", [0.04, 0.15])
def test_the_filter_is_the_hidden_markov_models(step):
    """Presence, mean and covariance equal those of the recursion written out."""
    atlas = lattice()
    rng = np.random.default_rng(1)
    codes = [(atlas.codes[i] + rng.normal(size=3)).astype(np.float32) for i in (3, 70, 200, 41, 333, 8)]
    codes[2:4] = [rng.normal(size=3).astype(np.float32) for _ in range(2)]  # nothing there
    tracker = Filter(atlas, step=step, appear=0.05, vanish=0.1)
    for code, (presence, place, covariance) in zip(
        codes, written_out(atlas, codes, step=step, appear=0.05, vanish=0.1), strict=True
    ):
        found = tracker.update(code)
        assert found.presence == pytest.approx(presence, rel=1e-4)
        assert found.position == pytest.approx(place, abs=2e-4)
        np.testing.assert_allclose(found.covariance, covariance, atol=1e-5)
        assert found.voxels.sum() == pytest.approx(1.0)


def test_past_frames_help():
    """A walk is followed better than its frames are located one by one, and as well as is stated."""
    atlas = lattice(4000, scale=4.0)
    rng = np.random.default_rng(2)
    place, apart, alone, stated = np.array([0.7, 0.3, 0.1]), [], [], []
    tracker = Filter(atlas, step=0.03)
    for _ in range(400):
        place = np.clip(place + rng.normal(scale=0.03, size=3), GRID.lo, GRID.hi)
        code = (4.0 * (place + 0.5) + rng.normal(size=3)).astype(np.float32)
        found = tracker.update(code)
        apart.append(((found.position - place) ** 2).sum())
        stated.append(np.trace(found.covariance))
        alone.append(((locate(atlas, code).position - place) ** 2).sum())
    assert np.mean(apart) < 0.6 * np.mean(alone)
    assert np.mean(apart) / np.mean(stated) == pytest.approx(1.0, abs=0.35)


def test_few_poses_are_enough_where_pictures_are_sharp():
    """Between poses that are ten times as far apart as a picture tells, regions hold what they state."""
    atlas = lattice(600, scale=200.0)
    rng = np.random.default_rng(6)
    tracker, inside = Filter(atlas, step=0.5), 0
    for _ in range(300):
        place = rng.uniform(GRID.lo, GRID.hi)
        code = (200.0 * (place + 0.5) + rng.normal(size=3)).astype(np.float32)
        inside += holds(tracker.update(code), tuple(place))
    assert binom.cdf(inside, 300, 0.9) > 1e-3


def test_an_object_of_unknown_size_is_not_tracked_yet():
    atlas = lattice()
    unknown = replace(atlas, hiding=0.0 * atlas.codes)
    with pytest.raises(NlosError, match="track follows one made without --unknown"):
        Filter(unknown, step=0.1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"step": 0.0}, "step 0: must be positive"),
        ({"step": math.nan}, "step nan: must be positive"),
        ({"step": 0.1, "vanish": 1.0}, "vanish 1: must be a probability between 0 and 1"),
    ],
)
def test_walks_that_cannot_be(options, words):
    with pytest.raises(NlosError, match=words):
        Filter(lattice(), **options)


def test_a_trajectory_keeps_its_pace_and_its_distance():
    """Even steps, all inside, hidden all along, the same for the same seed."""
    grid = VoxelGrid(lo=(0.8, 0.4, 0.4), hi=(2.3, 1.9, 2.2), shape=(3, 3, 1))
    sweep = Sweep(frames=300, pace=0.05, seed=3)
    hull = 0.1 * np.concatenate([np.eye(3), -np.eye(3)])

    def is_free(place, turn):
        return math.dist(place[:2], (1.5, 1.1)) > 0.3  # a pillar

    walk = poses.trajectory(grid, sweep, hull, is_free)
    places = np.array([p.position for p in walk])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert len(walk) == 300
    assert steps.max() <= 0.05 + 1e-9
    assert np.median(steps) == pytest.approx(0.05)
    assert all(is_free(p, None) for p in places)
    assert [p.label for p in walk] == [grid.labels[grid.voxel(p)] for p in places]
    assert walk == poses.trajectory(grid, sweep, hull, is_free)
    nowhere = iter([True])  # but where it starts
    with pytest.raises(NlosError, match=r"found no way on|found no place"):
        poses.trajectory(grid, Sweep(frames=9, pace=0.5), hull, lambda place, turn: next(nowhere, False))


def test_lost_and_found_again(tmp_path, command):
    """The command line on a sequence with a gap: what it prints, writes and draws."""
    simulated = make_bulk(tmp_path / "bulk", pictures=1200, inside="centre", radius=0.1, seed=1)
    frames = make_walk(tmp_path / "walk", tmp_path / "way")
    (tmp_path / "dim.toml").write_text("full_well = 300.0\nbits = 10\n")
    made = command("classify", "atlas", simulated.path, "-o", tmp_path / "a.atlas", "--sensor", tmp_path / "dim.toml")
    assert made.returncode == 0, made.stderr
    done = command(
        "classify",
        "track",
        tmp_path / "a.atlas",
        frames.path,
        "-o",
        tmp_path / "out",
        "--gap",
        "15:25",
        "--step",
        "0.05",
    )
    assert done.returncode == 0, done.stderr
    assert "frame 20: nothing" in done.stdout
    assert "found again after" in done.stdout
    with open(tmp_path / "out" / "track.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["there"]) for row in rows] == [1] * 15 + [0] * 10 + [1] * 15
    assert (tmp_path / "out" / "track.png").stat().st_size > 10_000
    assert (tmp_path / "out" / "track.svg").is_file()
    assert "How does it move?" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    other = command("classify", "track", tmp_path / "a.atlas", make_seen(tmp_path / "seen", simulated).path)
    assert other.returncode == 2
    assert "is no trajectory; make one with nlos-generate trajectory" in other.stderr
    bad = command("classify", "track", tmp_path / "a.atlas", frames.path, "--gap", "9")
    assert bad.returncode == 2
    assert "--gap '9': must read FROM:TO" in bad.stderr


def test_poses_that_leave_gaps_or_are_the_walks_own_are_refused(tmp_path):
    """One sentence, which names what would be right; the poses of an atlas that does not say tell it themselves."""
    filled = make_bulk(tmp_path / "filled", pictures=200, inside="centre", radius=0.1)
    atlas = atlas_build.build(filled, Sensor(full_well=300.0, bits=10))
    walk = make_walk(tmp_path / "walk", tmp_path / "way")
    old = replace(atlas, about={"targets": ["sphere"]})
    centres = np.mean([atlas.grid.bounds(voxel) for voxel in atlas.voxels], axis=1)
    apart = replace(old, positions=centres + 0.7 * (atlas.positions - centres))
    for other in (apart, replace(atlas, about=atlas.about | {"inside": ["centre", "whole"]})):
        with pytest.raises(NlosError, match=r"leave gaps .* --inside centre, then nlos-classify atlas SET"):
            sequence.run(other, walk, step=0.1)
    assert len(sequence.run(old, walk, step=0.1).steps) == 40
    with pytest.raises(NlosError, match="20 of its 20 poses are also in the atlas"):
        sequence.run(atlas, make_seen(tmp_path / "learnt", filled, poses=5, frames=20, pace=0.05), step=0.1)


def test_a_gap_is_not_ended_by_the_next():
    """What is detected in or after a later gap does not count for an earlier one; what never is, is no number."""
    there = [True, False, True, True, False, True, True, False, True]
    found = [True, False, False, False, True, False, True, False, False]
    steps = [SimpleNamespace(found=each) for each in found]
    tracked = sequence.TrackedSequence(wilson(1, 1), steps=steps, there=there)
    assert tracked.reacquired() == [None, 2, None]


def make_walk(path, way):
    """A data set of 40 frames at poses of a bulk set of its own, which is put into a folder."""
    return make_seen(path, make_bulk(way, pictures=40, seed=3, radius=0.1), poses=10, frames=40, pace=0.05)


def test_a_sequence_that_grows_is_waited_for(tmp_path):
    """Frames that are not there yet end the pursuit when patience does."""
    simulated = make_bulk(tmp_path / "bulk", pictures=400, inside="centre", radius=0.1)
    frames = make_walk(tmp_path / "walk", tmp_path / "way")
    (frames.path / frames.records[30].file).unlink()
    frames = type(frames).open(frames.path)
    frames.gather()
    atlas = atlas_build.build(simulated, Sensor(full_well=300.0, bits=10))
    followed = sequence.run(atlas, frames, step=0.3, patience=0.05)
    assert len(followed.steps) == 30


def test_the_command_line_renders_frames(tmp_path, scene_file, command):
    """A trajectory is a data set of its own kind: resumed as it was begun, and refused where it is none."""
    some = ("--pace", "0.2", "--engine", "surfel", "--resolution", "8", "--workers", "1")
    walk = tmp_path / "walk"
    done = command("generator", "trajectory", scene_file, "-o", walk, "--frames", "5", *some)
    assert done.returncode == 0, done.stderr
    data = Dataset.open(walk)
    assert [r.file for r in data.records] == [f"frames/{i:05d}.exr" for i in range(5)]
    assert "poses" not in data.settings
    assert data.settings["frames"] == 5
    again = command("generator", "trajectory", scene_file, "-o", walk)
    assert "nothing to do" in again.stdout, again.stderr
    other = command("generator", "trajectory", scene_file, "-o", walk, "--frames", "6")
    assert other.returncode == 2
    assert "frames is 5 there and 6 here" in other.stderr
    voxels = command("generator", "sweep", scene_file, "-o", walk, "--poses", "1")
    assert voxels.returncode == 2
    assert "its poses lie on a trajectory, not in voxels" in voxels.stderr
    none = command("generator", "trajectory", scene_file, "-o", tmp_path / "none", "--frames", "0")
    assert (none.returncode, (tmp_path / "none").exists()) == (2, False)
    assert "--frames 0: must be 1 or more" in none.stderr


def test_frames_are_no_voxels(tiny_dataset, scene_file, command):
    """Nor the other way round."""
    done = command("generator", "trajectory", scene_file, "-o", tiny_dataset, "--frames", "3")
    assert done.returncode == 2
    assert "its poses lie in voxels, not on a trajectory" in done.stderr


def test_an_atlas_of_too_few_poses_for_its_sensor_is_told():
    """Thirty numbers that bend within decimetres, seen sharply: a cell of 12 poses knows too little of them."""

    def waves(count, scale):
        atlas = lattice(count)
        turns = np.random.default_rng(1).normal(scale=4.0, size=(3, 30))
        return replace(atlas, codes=(scale * np.sin(atlas.positions @ turns)).astype(np.float32))

    assert sequence.held_out(waves(6000, 1.0), step=0.1).high >= 0.95
    assert sequence.held_out(waves(1200, 30.0), step=0.1).high < 0.95


def test_regions_hold_though_all_frames_share_the_background_s_noise():
    """A background of as many frames as a picture: half of the noise stays, and 20 frames tell no more than two."""
    atlas = replace(lattice(6000, scale=20.0), spread=2.0)
    assert sequence.held_out(atlas, step=0.03, count=400).high >= 0.95
    independent = Filter(replace(atlas, spread=1.0), step=0.03)
    rng, inside = np.random.default_rng(2), 0
    for pose in range(200):
        independent.restart()
        shared = rng.normal(size=3) * math.sqrt(0.5)
        for _ in range(20):
            noise = shared + rng.normal(size=3) * math.sqrt(0.5)
            step = independent.update((atlas.codes[pose] + noise).astype(np.float32))
        inside += holds(step, atlas.positions[pose])
    assert wilson(inside, 200).high < 0.9
