"""Lens, perspective and size, against a camera that finds the wall by rays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import wall_camera

from classify.pictures import rectify
from generator.model.errors import NlosError

X, Z = (-0.9, 0.1), (0.8, 1.6)
CORNERS = np.array([(31.3, 22.1), (170.2, 30.4), (176.8, 138.3), (22.5, 129.7)])
RESOLUTION = (10, 8)
LENS = rectify.Lens(
    np.array([[220.0, 0, 101.0], [0, 221.0, 88.0], [0, 0, 1.0]]), np.array([-0.2, 0.05, 1e-3, -5e-4, 0])
)


def wall_of(seed=0):
    return 1.0 + np.random.default_rng(seed).random(RESOLUTION[::-1])


def camera(**changes):
    return wall_camera.Camera(CORNERS, fall=0.0, **changes)


def rectified(light, marks):
    weights = rectify.areas(light.shape, marks, X, Z, RESOLUTION)
    return (weights @ light.ravel()).reshape(RESOLUTION[::-1])


def test_a_tilted_picture_is_straightened():
    wall, seen = wall_of(), camera()
    weights = rectify.areas(seen.shape, rectify.Marks.of_corners(CORNERS.ravel(), X, Z), X, Z, RESOLUTION)
    assert np.allclose(weights.sum(axis=1), 1.0)
    made = (weights @ seen.light(wall).ravel()).reshape(wall.shape)
    # A camera's pixel on a border of two of the wall's holds light of both: a twelfth of their difference, at most.
    assert np.abs(made - wall).max() < 0.12
    assert np.abs(made - wall).mean() < 0.02


def test_light_that_is_even_across_pixels_is_exact():
    """A ramp along the wall: the mean over a pixel is the value in its middle, whatever the perspective."""
    seen = camera(shape=(170, 210))
    v, u = np.mgrid[0 : seen.shape[0], 0 : seen.shape[1]]
    ends = np.float32([(X[1], Z[1]), (X[0], Z[1]), (X[0], Z[0]), (X[1], Z[0])])
    to_wall = cv2.getPerspectiveTransform(np.float32(CORNERS), ends)
    there = np.stack([u, v, np.ones_like(u)], axis=-1) @ to_wall.T
    x, z = there[..., 0] / there[..., 2], there[..., 1] / there[..., 2]
    made = rectified(3.0 + 2.0 * x - z, rectify.Marks.of_corners(CORNERS.ravel(), X, Z))
    columns = X[1] - (np.arange(RESOLUTION[0]) + 0.5) / RESOLUTION[0] * (X[1] - X[0])
    rows = Z[1] - (np.arange(RESOLUTION[1]) + 0.5) / RESOLUTION[1] * (Z[1] - Z[0])
    assert np.allclose(made, 3.0 + 2.0 * columns[None] - rows[:, None], atol=2e-3)


def test_another_rectangle_than_the_watched_one():
    """Corners of a larger rectangle name the same perspective."""
    seen = camera()
    known = rectify.Marks.of_corners(CORNERS.ravel(), X, Z)
    matrix = np.linalg.inv(known.homography())
    x, z = (-1.0, 0.2), (0.7, 1.7)
    ends = np.array([(x[1], z[1], 1), (x[0], z[1], 1), (x[0], z[0], 1), (x[1], z[0], 1)]) @ matrix.T
    other = rectify.Marks.of_corners((ends[:, :2] / ends[:, 2:]).ravel(), x, z)
    light = seen.light(wall_of())
    assert np.allclose(rectified(light, known), rectified(light, other), atol=1e-6)


def test_marks_are_fitted_and_a_wrong_one_is_told():
    known = rectify.Marks.of_corners(CORNERS.ravel(), X, Z)
    inverse, rng = np.linalg.inv(known.homography()), np.random.default_rng(1)
    wall = np.column_stack([rng.uniform(*X, 12), rng.uniform(*Z, 12)])
    pixels = np.column_stack([wall, np.ones(12)]) @ inverse.T
    marks = rectify.Marks(pixels[:, :2] / pixels[:, 2:], wall)
    assert np.allclose(marks.homography() / marks.homography()[2, 2], known.homography() / known.homography()[2, 2])
    swapped = rectify.Marks(marks.pixels, wall[[1, 0, *range(2, 12)]])
    with pytest.raises(NlosError, match="no perspective puts them"):
        swapped.homography()


def test_a_lens_is_undone():
    """Points on the wall, put through OpenCV's own projection, come back."""
    rng = np.random.default_rng(2)
    straight = np.column_stack([rng.uniform(20, 180, 200), rng.uniform(15, 150, 200)])
    bent = LENS.distorted(straight)
    assert np.abs(bent - straight).max() > 3.0
    assert np.allclose(LENS.undistorted(bent), straight, atol=1e-6)
    marks = rectify.Marks.of_corners(LENS.distorted(CORNERS).ravel(), X, Z, LENS)
    plain = rectify.Marks.of_corners(CORNERS.ravel(), X, Z)
    assert np.allclose(marks.homography(), plain.homography(), rtol=1e-6)
    light = camera().light(wall_of())
    v, u = np.mgrid[0 : light.shape[0], 0 : light.shape[1]].astype(np.float64)
    undone = LENS.undistorted(np.column_stack([u.ravel(), v.ravel()])).astype(np.float32)
    through = cv2.remap(light, *(undone[:, k].reshape(light.shape) for k in (0, 1)), cv2.INTER_LINEAR)
    assert np.abs(rectified(through, marks) - rectified(light, plain)).mean() < 0.01


FAULTS = {
    "mirrored": (CORNERS[[1, 0, 3, 2]], "go round the wrong way"),
    "on a line": (np.array([(0, 0), (50, 50), (100, 100), (10, 90)]), "marks: "),
    "crossed": (CORNERS[[0, 2, 1, 3]], "marks: no perspective|go round"),
    "partly outside": (np.add(CORNERS, (60.0, 0.0)), "of the watched rectangle"),
    "outside": (np.add(CORNERS, (5000.0, 0.0)), "lies outside"),
    "too few pixels": (CORNERS / 25.0, "across each of the 10 x 8"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_corners_are_told(fault):
    corners, words = FAULTS[fault]
    with pytest.raises(NlosError, match=words):
        rectify.areas((180, 200), rectify.Marks.of_corners(np.ravel(corners), X, Z), X, Z, RESOLUTION)


def test_a_lens_is_read_or_refused(tmp_path):
    path = tmp_path / "lens.toml"
    path.write_text("camera_matrix = [[200, 0, 100], [0, 200, 90], [0, 0, 1]]\ndistortion = [-0.1, 0.0, 0.0, 0.0]\n")
    assert rectify.Lens.read(path).matrix[0, 0] == 200.0
    for text, words in (
        ("distortion = [1.0]\n", "must be there"),
        ("camera_matrix = [[1, 2], [3, 4]]\ndistortion = [0.0, 0.0, 0.0, 0.0]\n", "must be 3 x 3"),
        ("camera_matrix = [[0, 0, 1], [0, 1, 1], [0, 0, 1]]\ndistortion = [0.0, 0.0, 0.0, 0.0]\n", "focal lengths"),
    ):
        path.write_text(text)
        with pytest.raises(NlosError, match=words):
            rectify.Lens.read(path)
