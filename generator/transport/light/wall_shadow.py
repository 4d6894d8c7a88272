"""Light of lamps and of glowing surfaces straight onto the watched wall, and what of it a target hides.

Its shadows have edges, which no polynomial over the picture has, so both are summed pixel by pixel: from places in
each pixel to points of the source, paired by a lattice.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport.light.beams import EmitterBeams, Points, irradiance
from generator.transport.light.lines import SETS
from generator.transport.light.spread import shifted
from generator.transport.light.view import Pose
from generator.transport.prepared import Setting

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_EMPTY, _FULL, _ALL_PAIRS = 256, 1024, 1 << 22
"""Number of pairs in each pixel for the light of the empty scene, at least and at most, and in a picture."""
_FEWEST, _MOST_PAIRS = 32, 1 << 20
"""Number of pairs in each pixel, at least, for the target's shadow, unless there are more in the picture."""


class _Pairs(NamedTuple):
    """Places of the wall and points of the source: pixel and set of each pair, place, way, and light per group."""

    pixel: Numbers
    part: Numbers
    places: Floats
    ways: Floats
    light: Floats


class WallShadow:
    """Shadows of a target in the light of emitters.

    Parameters
    ----------
    setting : Setting
    beams : EmitterBeams
    """

    def __init__(self, setting: Setting, beams: EmitterBeams) -> None:
        self._setting, self._beams = setting, beams
        self._pairs: dict[int, _Pairs] = {}

    def unshadowed(self) -> Floats:
        """Return the irradiance of the empty scene's wall, (groups, height, width)."""
        width, height = self._setting.resolution
        points = self._beams.finest
        pairs = max(_EMPTY, min(_FULL, _ALL_PAIRS // (width * height)))
        pixels = np.arange(width * height)
        corner = np.stack([pixels % width, pixels // width], axis=1)[:, None]
        found = np.zeros((points.weights.shape[1], height, width))
        flat = points.normals.any(axis=1)
        for some in (flat, ~flat):  # a lamp without extent casts sharper shadows, and is one point
            if not some.any():
                continue
            number = max(1, pairs // int(some.sum()))
            places = self._on_wall(((corner + shifted(number, 2, pixels)) / (width, height)).reshape(-1, 2))
            normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
            light = irradiance(self._beams, Points(*(part[some] for part in points)), places, normals)
            found += np.moveaxis(light.reshape(height, width, number, -1).mean(axis=2), 2, 0)
        return found

    def hidden(self, pose: Pose, lines: int) -> Floats:
        """Return the irradiance that a target hides from the wall, (sets, groups, height, width).

        Parameters
        ----------
        pose : Pose
        lines : int
            Number of lines through the target that are followed besides; the more, the more pairs.
        """
        width, height = self._setting.resolution
        pairs = self._paired(max(_FEWEST, lines >> 7))
        groups = pairs.light.shape[1]
        along = np.einsum("ni,ni->n", pose.centre - pairs.places, pairs.ways)
        along = np.clip(along / np.einsum("ni,ni->n", pairs.ways, pairs.ways), 0.0, 1.0)
        beside = pairs.places + along[:, None] * pairs.ways - pose.centre
        near = np.flatnonzero(np.einsum("ni,ni->n", beside, beside) < pose.radius**2)
        start = (pairs.places[near] - pose.place) @ pose.turn
        near = near[self._setting.target.blocked(start, start + pairs.ways[near] @ pose.turn)]
        if len(self._beams.blockers) and len(near):
            places = pairs.places[near]
            near = near[~self._beams.blockers.blocked(places + pairs.ways[near], places)]
        row = pairs.part[near] * (width * height) + pairs.pixel[near]
        size = SETS * width * height
        found = np.stack([np.bincount(row, pairs.light[near, g], size) for g in range(groups)])
        hidden: Floats = found.reshape(groups, SETS, height, width).swapaxes(0, 1)
        return hidden

    def _on_wall(self, uv: Floats) -> Floats:
        homogeneous = np.concatenate([uv, np.ones((len(uv), 1))], axis=1) @ self._setting.to_wall.T
        return np.append(homogeneous[:, :2] / homogeneous[:, 2:], np.zeros((len(uv), 1)), axis=1)

    def _paired(self, number: int) -> _Pairs:
        """Return ``number`` pairs for each pixel, or fewer of a large picture, without those that are dark."""
        width, height = self._setting.resolution
        number = max(SETS, min(number, _MOST_PAIRS // (width * height)) // SETS * SETS)
        if number not in self._pairs:
            points, pixels = self._beams.dense, np.arange(width * height)
            pixel = np.repeat(pixels, number)
            spread = shifted(number, 3, pixels).reshape(-1, 3)
            corner = np.stack([pixel % width, pixel // width], axis=1)
            places = self._on_wall((corner + spread[:, :2]) / (width, height))
            # Points are drawn as often as they are bright.
            bright = points.weights.max(axis=1)
            chosen = np.searchsorted(np.cumsum(bright) / bright.sum(), spread[:, 2]).clip(max=len(bright) - 1)
            ways = points.places[chosen] - places
            geometry = points.towards(chosen, ways, ways[:, 2])
            share = points.weights[chosen] * (bright.sum() / bright[chosen])[:, None]
            light = geometry[:, None] * share / (number // SETS)
            part = np.tile(np.arange(number) * SETS // number, width * height)
            some = np.flatnonzero(geometry > 0.0)
            self._pairs[number] = _Pairs(pixel[some], part[some], places[some], ways[some], light[some])
        return self._pairs[number]
