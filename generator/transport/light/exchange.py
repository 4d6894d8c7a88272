"""Light that cells of a room exchange, from the rays that each of them sends out.

As many cells as there are would make a large matrix, almost empty; so only what rays meet is kept. With n rays from
each cell i, of which n_ij meet cell j, F_ij = n_ij / n is the share of cell j in what cell i sees. All sums are over
the rays of the cell that they are for: rays are spread evenly, so such a sum is smooth where the light is. What comes
back to a cell from the others' rays would be counts of the few of them that meet it.

Each sum has two forms, loops for numba and arrays for NumPy; tests check that they agree to rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport.compiled import COMPILED, jit_released
from generator.transport.light.cells import lit

Floats = NDArray[Any]
Numbers = NDArray[Any]

_CHUNK = 1 << 21


class Exchange:
    """Light between cells.

    Parameters
    ----------
    met : ndarray of shape (cells, rays), int
        Cell that each ray meets; the number of cells where it meets none.
    area : ndarray of shape (cells,)

    Attributes
    ----------
    open : ndarray of shape (cells,)
        Share of rays that meet none.
    """

    def __init__(self, met: Numbers, area: Floats) -> None:
        self._met, self._area = met, area[:, None]
        self.open: Floats = (met == len(area)).mean(axis=1)

    def received(self, radiosity: Floats, some: Numbers | None = None) -> Floats:
        """Return the irradiance F B of cells, or of some (n,), by the radiosity B of all, (n, columns)."""
        return _means(np.ascontiguousarray(radiosity), self._met if some is None else self._met[some])

    def sent(self, worth: Floats) -> Floats:
        """Return what cells' radiosity is worth, (cells, columns), if their irradiance is worth that.

        It is F' w, in which A_i F_ij = A_j F_ji for areas A: light goes both ways alike.
        """
        found: Floats = self._area * self.received(worth / self._area)
        return found

    def spread(self, radiosity: Floats) -> Floats:
        """Return the irradiance as `received` does, by the rays of the cells that have any radiosity, which are few.

        Cells count the rays that meet them: each for itself is noisy, but not many together.
        """
        some = lit(radiosity)
        sent = radiosity[some] * (self._area[some] / self._met.shape[1])
        found: Floats = _counted(sent, self._met[some], len(self._met)) / self._area
        return found

    def between(self, block: Numbers, area: Floats) -> Floats:
        """Return the irradiance of blocks of cells by the radiosity of each other, (blocks, blocks).

        Parameters
        ----------
        block : ndarray of shape (cells,), int
            Block that each cell is in.
        area : ndarray of shape (blocks,)
        """
        n, (cells, rays) = len(area), self._met.shape
        found = np.zeros(n * n)
        step = max(1, _CHUNK // rays)
        for start in range(0, cells, step):
            one = np.repeat(np.arange(start, min(start + step, cells)), rays)
            other = self._met[start : start + step].reshape(-1).astype(np.int64)
            one, other = one[other < cells], other[other < cells]
            found += np.bincount(block[one] * n + block[other], self._area[one, 0] / rays, n * n)
        return found.reshape(n, n) / area[:, None]


def _means_loops(values: Floats, met: Numbers) -> Floats:
    """Return the means (n, columns), over rays (n, rays), of the values of the cells that they meet, 0 for none."""
    n, rays = met.shape
    count, columns = values.shape
    found = np.zeros((n, columns))
    for i in range(n):
        for k in range(rays):
            j = met[i, k]
            if j < count:
                for column in range(columns):
                    found[i, column] += values[j, column]
        for column in range(columns):
            found[i, column] /= rays
    return found


def means_arrays(values: Floats, met: Numbers) -> Floats:
    """NumPy form of `_means_loops`."""
    n, rays = met.shape
    padded = np.append(values, np.zeros((1, values.shape[1])), axis=0)
    found = np.empty((n, values.shape[1]))
    step = max(1, _CHUNK // (rays * max(1, values.shape[1])))
    for start in range(0, n, step):
        found[start : start + step] = padded[met[start : start + step]].mean(axis=1)
    return found


def _counted_loops(values: Floats, met: Numbers, count: int) -> Floats:
    """Return the sums (count, columns) of the values (n, columns) of the rays (n, rays) that meet each cell."""
    n, rays = met.shape
    columns = values.shape[1]
    found = np.zeros((count, columns))
    for i in range(n):
        for k in range(rays):
            j = met[i, k]
            if j < count:
                for column in range(columns):
                    found[j, column] += values[i, column]
    return found


def counted_arrays(values: Floats, met: Numbers, count: int) -> Floats:
    """NumPy form of `_counted_loops`."""
    found = np.empty((count, values.shape[1]))
    for column in range(values.shape[1]):
        each = np.repeat(values[:, column], met.shape[1])
        found[:, column] = np.bincount(met.reshape(-1), each, count + 1)[:count]
    return found


_counted = jit_released(_counted_loops) if COMPILED else counted_arrays
_means = jit_released(_means_loops) if COMPILED else means_arrays
