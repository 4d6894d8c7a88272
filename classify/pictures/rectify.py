"""From a camera's pixels to those of a scene's picture: lens, perspective and size in one matrix of areas.

A pixel of a scene's picture is the mean over a rectangle of the wall, and a camera's pixel covers some piece of the
wall. So each of the former is a mean of the latter, weighted by the areas that they share on the wall. Nothing is
interpolated, and the noise of the result follows from the weights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from generator.files.toml import read_toml
from generator.model.arrays import Array
from generator.model.errors import NlosError

_FINE = 40.0
"""Cells that an edge of a scene's pixel is cut into, at least: areas are then right to about a hundredth."""
_CELLS = 2_000_000
"""Cells of a block."""
_SEES = 0.98
"""Share of a scene's pixel that the camera must see."""
_BACK = 1e-2
"""Pixels by which a point may miss itself after its distortion was undone and done again."""
Extent = tuple[float, float]


@dataclass(frozen=True)
class Lens:
    """A lens as OpenCV calibrates it: `cv2.calibrateCamera`.

    Attributes
    ----------
    matrix : ndarray of shape (3, 3)
        Focal lengths and principal point, pixels; the centre of the first pixel is (0, 0).
    distortion : ndarray of shape (n,)
        Coefficients k1, k2, p1, p2, k3 and so on, 4, 5, 8, 12 or 14 of them.
    """

    matrix: Array
    distortion: Array

    @classmethod
    def read(cls, path: Path) -> Lens:
        """Read ``camera_matrix`` and ``distortion`` of a TOML file."""
        data = read_toml(path)
        try:
            matrix = np.array(data["camera_matrix"], dtype=np.float64)
            distortion = np.array(data["distortion"], dtype=np.float64)
        except (KeyError, TypeError, ValueError) as error:
            raise NlosError(f"{path}: camera_matrix and distortion must be there, as numbers ({error})") from None
        sound = matrix.shape == (3, 3) and distortion.ndim == 1 and len(distortion) in (4, 5, 8, 12, 14)
        if not sound or not (np.isfinite(matrix).all() and np.isfinite(distortion).all()):
            raise NlosError(f"{path}: camera_matrix must be 3 x 3, and distortion have 4, 5, 8, 12 or 14 numbers")
        if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
            raise NlosError(f"{path}: camera_matrix: its focal lengths must be positive")
        return cls(matrix, distortion)

    def undistorted(self, points: Array) -> Array:
        """Return where points (n, 2) of the picture, pixels, would be without distortion."""
        exact = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-9)
        turn = np.eye(3)
        made = cv2.undistortPointsIter(points[:, None], self.matrix, self.distortion, turn, self.matrix, exact)
        undone = np.asarray(made, dtype=np.float64)[:, 0]
        if np.abs(self.distorted(undone) - points).max() > _BACK:
            raise NlosError("lens: its distortion cannot be undone all over the patch; calibrate it with marks there")
        return undone

    def distorted(self, points: Array) -> Array:
        """Return where the lens puts points (n, 2) that it would see there without distortion."""
        rays = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(self.matrix).T
        put = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.matrix, self.distortion)[0]
        return np.asarray(put, dtype=np.float64)[:, 0]


@dataclass(frozen=True)
class Marks:
    """Points of the picture, and the same points of the wall.

    Attributes
    ----------
    pixels : ndarray of shape (n, 2)
        Column and row, pixels; the centre of the first pixel is (0, 0).
    wall : ndarray of shape (n, 2)
        x and z, metres.
    lens : Lens, optional
    """

    pixels: Array
    wall: Array
    lens: Lens | None = None
    found: dict[str, Any] = field(default_factory=dict, compare=False)

    @classmethod
    def of_corners(cls, corners: Sequence[float], x: Extent, z: Extent, lens: Lens | None = None) -> Marks:
        """Return the marks of a rectangle of the wall.

        Parameters
        ----------
        corners : sequence of 8 float
            Column and row of its corners in the picture: top left, top right, bottom right, bottom left. Facing the
            wall, +x is to the left.
        x, z : (float, float)
            Its extent, metres.
        lens : Lens, optional
        """
        wall = np.array([(x[1], z[1]), (x[0], z[1]), (x[0], z[0]), (x[1], z[0])])
        return cls(np.reshape(np.asarray(corners, dtype=np.float64), (4, 2)), wall, lens)

    def homography(self) -> Array:
        """Return the matrix (3, 3) from undistorted pixels to metres on the wall; least squares of more than four.

        Raises
        ------
        NlosError
            The marks are fewer than four, lie on a line, or are mirrored.
        """
        if len(self.pixels) < 4:
            raise NlosError(f"marks: {len(self.pixels)} are too few; four or more are needed")
        pixels = self.pixels if self.lens is None else self.lens.undistorted(self.pixels)
        found, _ = cv2.findHomography(pixels, self.wall, 0)
        matrix = np.asarray(np.nan if found is None else found, dtype=np.float64)
        if not np.isfinite(matrix).all():
            raise NlosError("marks: they do not fix the perspective; no three of four may lie on a line")
        there = _mapped(matrix, pixels)
        off = float(np.sqrt(((there - self.wall) ** 2).sum(axis=1).mean()))
        size = float(np.ptp(self.wall, axis=0).max())
        depth = np.column_stack([pixels, np.ones(len(pixels))]) @ matrix[2]
        if not (depth.min() * depth.max() > 0.0 and off < 0.05 * size):
            raise NlosError("marks: no perspective puts them where they are on the wall; check their order")
        # Columns count towards -x and rows towards -z, so that seen from the front the determinant is positive.
        if np.linalg.det(matrix) * depth[0] < 0.0:
            raise NlosError(
                "corners: go round the wrong way, or the picture is mirrored; give top left, top right, bottom "
                "right, bottom left, as seen by the camera"
            )
        self.found["residual"] = off
        return matrix


def whole(shape: tuple[int, int], x: Extent, z: Extent) -> Marks:
    """Return the marks of a picture (height, width) that shows exactly a rectangle of the wall."""
    height, width = shape
    right, bottom = width - 0.5, height - 0.5
    return Marks.of_corners((-0.5, -0.5, right, -0.5, right, bottom, -0.5, bottom), x, z)


def areas(shape: tuple[int, int], marks: Marks, x: Extent, z: Extent, resolution: tuple[int, int]) -> csr_matrix:
    """Return the weight of each pixel of a camera in each pixel of a scene's picture; rows sum to 1.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the camera's picture.
    marks : Marks
    x, z : (float, float)
        Extent of the watched rectangle of wall, metres: column 0 of the scene's picture is the largest x, row 0 the
        largest z.
    resolution : (int, int)
        Width and height of the scene's picture.

    Returns
    -------
    csr_matrix of shape (height * width of the scene's picture, height * width of the camera's)

    Raises
    ------
    NlosError
        The camera does not see all of the rectangle, or has fewer pixels there than the scene's picture.
    """
    matrix = marks.homography()
    width, height = resolution
    # From metres on the wall to columns and rows of the scene's picture.
    to_picture = np.array(
        [
            [-width / (x[1] - x[0]), 0.0, width * x[1] / (x[1] - x[0])],
            [0.0, -height / (z[1] - z[0]), height * z[1] / (z[1] - z[0])],
            [0.0, 0.0, 1.0],
        ]
    )
    matrix = to_picture @ matrix
    low, high = _box(matrix, marks.lens, resolution, shape)
    edge = np.sqrt(float(np.prod(high - low)) / (width * height))
    if edge < 1.0:
        raise NlosError(
            f"the camera has {edge:.2g} pixels across each of the {width} x {height} of the scene's picture; take "
            f"a smaller --resolution, {max(1, int(edge * width))} at most"
        )
    cuts = max(1, int(np.ceil(_FINE / edge)))
    rows_at_once = max(1, int(_CELLS / (cuts * cuts * (high[0] - low[0]))))
    pieces = []
    for top in range(low[1], high[1], rows_at_once):
        bottom = min(top + rows_at_once, high[1])
        pieces.append(_block(matrix, marks.lens, (low[0], high[0]), (top, bottom), cuts, resolution, shape[1]))
    target, source, area = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    weights = coo_matrix((area, (target, source)), shape=(width * height, shape[0] * shape[1])).tocsr()
    seen = np.asarray(weights.sum(axis=1)).ravel()
    if seen.min() < _SEES:
        raise NlosError(
            f"the camera's picture shows {seen.mean():.0%} of the watched rectangle, x {x[0]:g} to {x[1]:g} and z "
            f"{z[0]:g} to {z[1]:g} m; take pictures of all of it, or correct corners, marks or scene"
        )
    return csr_matrix(weights.multiply(1.0 / seen[:, None]))


def _mapped(matrix: Array, points: Array) -> Array:
    there = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    mapped: Array = there[:, :2] / there[:, 2:]
    return mapped


def _box(matrix: Array, lens: Lens | None, resolution: tuple[int, int], shape: tuple[int, int]) -> tuple[Any, Any]:
    """First and last (exclusive) column and row of the camera's pixels that may see the rectangle."""
    width, height = resolution
    steps = np.linspace(0.0, 1.0, 101)
    border = np.concatenate(
        [np.column_stack([width * a + 0.0 * steps, height * steps]) for a in (0.0, 1.0)]
        + [np.column_stack([width * steps, height * a + 0.0 * steps]) for a in (0.0, 1.0)]
    )
    points = _mapped(np.linalg.inv(matrix), border)
    if lens is not None:
        points = lens.distorted(points)
    limits = np.array([shape[1], shape[0]])
    low = np.clip(np.floor(points.min(axis=0) + 0.5 - 1e-6), 0, limits).astype(int)
    high = np.clip(np.ceil(points.max(axis=0) + 0.5 + 1e-6), 0, limits).astype(int)
    if (high <= low).any():
        raise NlosError("the watched rectangle lies outside the camera's picture; correct corners, marks or scene")
    return low, high


def _block(
    matrix: Array, lens: Lens | None, columns: Any, rows: Any, cuts: int, resolution: tuple[int, int], across: int
) -> tuple[Array, Array, Array]:
    """Pixel of the scene's picture, pixel of the camera's and shared area, of the cells of some of the latter."""
    width, height = resolution
    u = np.linspace(columns[0] - 0.5, columns[1] - 0.5, (columns[1] - columns[0]) * cuts + 1)
    v = np.linspace(rows[0] - 0.5, rows[1] - 0.5, (rows[1] - rows[0]) * cuts + 1)
    points = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    if lens is not None:
        points = lens.undistorted(points)
    lattice = _mapped(matrix, points).reshape(len(v), len(u), 2)
    a, b, c, d = lattice[:-1, :-1], lattice[:-1, 1:], lattice[1:, 1:], lattice[1:, :-1]
    across_1, across_2 = c - a, d - b
    area = 0.5 * np.abs(across_1[..., 0] * across_2[..., 1] - across_1[..., 1] * across_2[..., 0])
    middle = 0.25 * (a + b + c + d)
    column, row = (np.floor(middle[..., k]).astype(np.int64) for k in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    which_row = (np.arange(len(v) - 1) // cuts + rows[0])[:, None]
    which_column = (np.arange(len(u) - 1) // cuts + columns[0])[None]
    camera = np.broadcast_to(which_row * across + which_column, inside.shape)[inside]
    return (row * width + column)[inside], camera, area[inside]


def read_marks(rows: Sequence[Mapping[str, str]], path: Path, lens: Lens | None) -> Marks:
    """Return the marks of a table with the columns column, row, x and z."""
    try:
        numbers = np.array([[float(row[name]) for name in ("column", "row", "x", "z")] for row in rows])
    except (KeyError, TypeError, ValueError) as error:
        raise NlosError(f"{path}: needs the columns column, row, x, z, with numbers ({error})") from None
    if not len(numbers) or not np.isfinite(numbers).all():
        raise NlosError(f"{path}: holds no marks, or such that are not finite")
    return Marks(numbers[:, :2], numbers[:, 2:], lens)
