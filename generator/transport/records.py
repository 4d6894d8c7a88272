"""What compiled functions are given: named records in place of long lists of arrays.

numba takes named tuples as they are, so a field costs nothing. Lengths are in the wall's frame (`prepared.Frame`).
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
        Which of the target's faces each is in.
    rings : int
        How finely spheres are cut.
    """

    flat: Floats
    balls: Floats
    albedo: Floats
    faces: Floats
    rings: int


class Poses(NamedTuple):
    """Where the target is, pose by pose, and what there is in its way.

    Attributes
    ----------
    turns, places : ndarray of shape (n, 3, 3) and (n, 3)
        Rotation and position.
    hiders : ndarray of shape (n,), int
        How many of the room's surfaces, from the first, can stand in the way.
    orders : ndarray of shape (n,), int
        Which of the rules ``whole`` stands for the lit patch where its points throw shadows one by one.
    """

    turns: Floats
    places: Floats
    hiders: Floats
    orders: Floats


class Parts(NamedTuple):
    """What pictures of a target without shadows are sums of (`faces.Faces.parts`).

    Attributes
    ----------
    turns, places : ndarray of shape (n, 3, 3) and (n, 3)
        Rotation and position, pose by pose.
    poses : ndarray of shape (parts,), int
        Which pose each part is of.
    wanted : ndarray of shape (parts, faces), int
        Which sides of a face a part is made of: `integral.FRONT`, `integral.BACK`, both, or neither; and with
        `integral.ON`, whether its light goes on beyond its horizon.
    """

    turns: Floats
    places: Floats
    poses: Floats
    wanted: Floats


class Boxes(NamedTuple):
    """Panels of pictures, as boxes of the picture.

    Attributes
    ----------
    owner : ndarray of shape (n,), int
        Which part of a picture each belongs to.
    boxes : ndarray of shape (n, 4)
        The u and v range of each.
    places : ndarray of shape (k, 2)
        A panel's points, on [0, 1], the last four its corners.
    to_wall : ndarray of shape (3, 3)
        The projective map from (u, v, 1) to the wall's two axes.
    like : ndarray
        Of the type, float32 or float64, in which to sum.
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
        Which pose each belongs to.
    walls : ndarray of shape (n, k, 3)
        Its points; the last four are its corners.
    """

    owner: Floats
    walls: Floats
