"""Arguments of compiled functions: named records in place of long lists of arrays.

numba supports named tuples directly, so a field costs nothing. Lengths are in the wall's frame (`prepared.Frame`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numpy.typing import NDArray

Floats = NDArray[Any]


class Disc(NamedTuple):
    """A disc on the wall, around points that light comes from or goes to.

    Attributes
    ----------
    centre : ndarray of shape (3,)
    radius : float
    """

    centre: Floats
    radius: float


class Target(NamedTuple):
    """Surfaces that reflect light, cut into cells, in the target's own frame.

    Attributes
    ----------
    flat, balls : ndarray of shape (n, elements.WIDTH)
        Flat cells and spheres.
    albedo : ndarray of shape (flat cells + spheres, groups)
    faces : ndarray of shape (flat cells + spheres,), int
        Index of the target's face that each is in.
    rings : int
        Number of rings of cells that a sphere is cut into.
    """

    flat: Floats
    balls: Floats
    albedo: Floats
    faces: Floats
    rings: int


class Poses(NamedTuple):
    """Poses of the target, and what can hide it at each of them.

    Attributes
    ----------
    turns, places : ndarray of shape (n, 3, 3) and (n, 3)
        Rotation and position.
    hiders : ndarray of shape (n,), int
        Number of the room's surfaces, counted from the first, that can stand in the way.
    orders : ndarray of shape (n,), int
        Index of the rule in ``whole`` that represents the lit patch where each of its points throws a shadow.
    """

    turns: Floats
    places: Floats
    hiders: Floats
    orders: Floats


class Parts(NamedTuple):
    """Parts whose sums are the pictures of a target without shadows (`faces.Faces.parts`).

    Attributes
    ----------
    turns, places : ndarray of shape (n, 3, 3) and (n, 3)
        Rotation and position at each pose.
    poses : ndarray of shape (parts,), int
        Index of the pose of each part.
    wanted : ndarray of shape (parts, faces), int
        Sides of each face that a part consists of: `integral.FRONT`, `integral.BACK`, both, or neither; with
        `integral.ON` added if its light continues beyond its horizon.
    """

    turns: Floats
    places: Floats
    poses: Floats
    wanted: Floats


class Boxes(NamedTuple):
    """Panels of pictures, as boxes in picture coordinates.

    Attributes
    ----------
    owner : ndarray of shape (n,), int
        Index of the part of a picture that each belongs to.
    boxes : ndarray of shape (n, 4)
        Range of u and of v of each.
    places : ndarray of shape (k, 2)
        Points of a panel, on [0, 1]; the last four are its corners.
    to_wall : ndarray of shape (3, 3)
        The projective map from (u, v, 1) to the wall's two axes.
    like : ndarray
        An array of the type, float32 or float64, that sums are computed in.
    """

    owner: Floats
    boxes: Floats
    places: Floats
    to_wall: Floats
    like: Floats


class Panels(NamedTuple):
    """Panels of pictures, as points of the wall.

    Attributes
    ----------
    owner : ndarray of shape (n,), int
        Index of the pose that each belongs to.
    walls : ndarray of shape (n, k, 3)
        Points of each; the last four are its corners.
    """

    owner: Floats
    walls: Floats
