"""Light of lamps and of glowing surfaces straight onto the watched wall, and what of it a target hides.

Its shadows have edges, which no polynomial over the picture has, so both are summed pixel by pixel: from places in
each pixel to points of the source, paired by a lattice. A few pairs tell which pixels a shadow may be in; the others
are all of these.
"""

from __future__ import annotations

import math
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
_FEWEST, _LEAST = 32, 1 << 14
"""Number of pairs that tell where the target's shadow is, in each pixel, fewer in a large picture, and in a small
picture at least."""
_PER_LINE, _MOST_EACH, _MOST_PAIRS = 8, 1 << 14, 1 << 20
"""Number of pairs that tell how deep it is: for each line through the target; in a pixel and in all, at most."""


class _Pairs(NamedTuple):
    """Places of the wall and points of the source: pixel and set of each pair, place, way, and the point's number."""

    pixel: Numbers
    part: Numbers
    places: Floats
    ways: Floats
    chosen: Numbers


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
        # Points are drawn as often as they are bright.
        bright = beams.dense.weights.max(axis=1)
        self._drawn = np.cumsum(bright) / max(float(bright.sum()), 1e-300)
        self._share = beams.dense.weights * (bright.sum() / np.maximum(bright, 1e-300))[:, None]

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
        count = width * height
        pairs = self._everywhere(max(SETS, min(max(_FEWEST, _LEAST // count), _MOST_PAIRS // count)))
        seen = np.zeros((height, width), dtype=bool)
        seen.reshape(-1)[pairs.pixel[_beside(pairs, pose)]] = True
        pixels = np.flatnonzero(_grown(seen))
        total = min(_MOST_PAIRS, _PER_LINE * lines) // max(1, len(pixels))
        # A power of two: at neighbouring poses the same places are paired.
        number = 1 << max(SETS.bit_length() - 1, int(math.log2(min(_MOST_EACH, max(1, total)))))
        pairs = self._everywhere(number) if 2 * len(pixels) > count else self._paired(number, pixels)
        some = _beside(pairs, pose)
        start = (pairs.places[some] - pose.place) @ pose.turn
        some = some[self._setting.target.blocked(start, start + pairs.ways[some] @ pose.turn)]
        if len(self._beams.blockers) and len(some):
            places = pairs.places[some]
            some = some[~self._beams.blockers.blocked(places + pairs.ways[some], places)]
        chosen = pairs.chosen[some]
        geometry = self._beams.dense.towards(chosen, pairs.ways[some], pairs.ways[some, 2])
        light = geometry[:, None] * self._share[chosen] / (number // SETS)
        row, size = pairs.part[some] * count + pairs.pixel[some], SETS * count
        found = np.stack([np.bincount(row, of_group, size) for of_group in light.T])
        hidden: Floats = found.reshape(-1, SETS, height, width).swapaxes(0, 1)
        return hidden

    def _on_wall(self, uv: Floats) -> Floats:
        homogeneous = np.concatenate([uv, np.ones((len(uv), 1))], axis=1) @ self._setting.to_wall.T
        return np.append(homogeneous[:, :2] / homogeneous[:, 2:], np.zeros((len(uv), 1)), axis=1)

    def _everywhere(self, number: int) -> _Pairs:
        if number not in self._pairs:
            width, height = self._setting.resolution
            self._pairs[number] = self._paired(number, np.arange(width * height))
        return self._pairs[number]

    def _paired(self, number: int, pixels: Numbers) -> _Pairs:
        """Return ``number`` pairs for each of some pixels."""
        width, height = self._setting.resolution
        pixel = np.repeat(pixels, number)
        spread = shifted(number, 3, pixels).reshape(-1, 3)
        corner = np.stack([pixel % width, pixel // width], axis=1)
        places = self._on_wall((corner + spread[:, :2]) / (width, height))
        chosen = np.searchsorted(self._drawn, spread[:, 2]).clip(max=len(self._drawn) - 1)
        part = np.tile(np.arange(number) * SETS // number, len(pixels))
        return _Pairs(pixel, part, places, self._beams.dense.places[chosen] - places, chosen)


def _beside(pairs: _Pairs, pose: Pose) -> Numbers:
    """Return which pairs have the ball around a target between them."""
    along = np.einsum("ni,ni->n", pose.centre - pairs.places, pairs.ways)
    along = np.clip(along / np.einsum("ni,ni->n", pairs.ways, pairs.ways), 0.0, 1.0)
    beside = pairs.places + along[:, None] * pairs.ways - pose.centre
    return np.flatnonzero(np.einsum("ni,ni->n", beside, beside) < pose.radius**2)


def _grown(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return pixels (height, width) and those next to them."""
    rows, columns = seen.shape
    padded = np.pad(seen, 1)
    grown: NDArray[np.bool_] = np.any(
        [padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0
    )
    return grown
