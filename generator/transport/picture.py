"""Pictures from panels: polynomials on as few panels as smoothness allows, averaged over each pixel's box.

Light that the target reflects falls on the wall as a smooth function, so a few hundred values represent a picture of
any resolution. A panel is a box of the picture with m x m Gauss points; their Legendre coefficients show how well
they represent the function, and a panel that represents it badly is cut in four. Pixels are exact integrals of the
polynomials over their boxes, as for Cycles' box filter.

The light of a flat face ends where its plane meets the wall: a kink of the picture along a line, and a jump of its
derivatives, which panels could only approximate. Such a face is a separate part of the picture, continued smoothly
beyond the line, and only the part on its bright side is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray

from generator.transport.compiled import (
    COMPILED,
    in_parts,
    jit_in_place,
    jit_loops,
    jit_parts,
    jit_released,
)
from generator.transport.polygons import clip

Floats = NDArray[Any]

Evaluate = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Given owners (n,) and boxes (n, 4), return values (n, channels, points) at a rule's places, and the ratio
radius / distance (n,)."""

MAX_DEPTH = 24
_TOO_NEAR = 8.0


@dataclass(frozen=True)
class Panels:
    """Numbers of the panels that pictures were made of.

    Attributes
    ----------
    count : ndarray of shape (pictures,), int
        Number of panels.
    depth : ndarray of shape (pictures,), int
        How often the smallest panel was cut.
    error : ndarray of shape (pictures,)
        Estimated root mean square error of the polynomials, relative to the root mean square of the picture.
    """

    count: Floats
    depth: Floats
    error: Floats


@dataclass(frozen=True)
class Parts:
    """Parts whose sums are pictures.

    Attributes
    ----------
    picture : ndarray of shape (parts,), int
        Index of the picture that each belongs to.
    line : ndarray of shape (parts, 3)
        A part counts where a u + b v + c > 0.
    """

    picture: Floats
    line: Floats

    @classmethod
    def whole(cls, pictures: int) -> Parts:
        """Return pictures of one part each, which counts everywhere."""
        return cls(np.arange(pictures), np.tile([0.0, 0.0, 1.0], (pictures, 1)))

    def side(self, owner: Floats, boxes: Floats, places: Floats) -> Floats:
        """Return a u + b v + c at places (k, 2) of boxes (n, 4), as (n, k)."""
        a, b, c = self.line[owner].T[:, :, None]
        low, wide = boxes[:, 0::2, None], (boxes[:, 1::2] - boxes[:, 0::2])[:, :, None]
        u, v = low[:, 0] + wide[:, 0] * places[:, 0], low[:, 1] + wide[:, 1] * places[:, 1]
        values: Floats = a * u + b * v + c
        return values


class Rule:
    """Gauss points of a panel, and the transform of values there to Legendre coefficients.

    Parameters
    ----------
    m : int
        Number of points along a side.

    Attributes
    ----------
    places : ndarray of shape (n, 2)
        Where a panel is evaluated, on [0, 1]: m x m Gauss points, u varying fastest; points between them, which check
        the polynomial; and the four corners.
    """

    def __init__(self, m: int) -> None:
        x, w = leggauss(m)
        self.m = m
        # Between the nodes, two lattices with one point in each row and column, so that any kink passes some of them.
        i, middles = np.arange(m - 1), (x[:-1] + x[1:]) / 2.0
        between = np.concatenate([np.stack([middles, middles[slope * i % (m - 1)]], axis=1) for slope in (2, -2)])
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
        checks = np.concatenate([between, corners])
        nodes = np.stack([np.tile(x, m), np.repeat(x, m)], axis=1)
        self.places = (np.concatenate([nodes, checks]) + 1.0) / 2.0
        self.weights = np.outer(w, w).ravel() / 4.0
        n = np.arange(m)
        transform = ((2 * n + 1) / 2.0)[:, None] * (legvander(x, m - 1) * w[:, None]).T
        self.transform = np.kron(transform, transform)
        norms = 1.0 / (2 * n + 1)
        high = np.maximum(n[:, None], n[None, :]).ravel() >= m - 2
        self._tail = np.where(high, np.outer(norms, norms).ravel(), 0.0)
        along, down = legvander(checks[:, 0], m - 1), legvander(checks[:, 1], m - 1)
        self._checks = (down[:, :, None] * along[:, None, :]).reshape(len(checks), m * m)

    def coefficients(self, values: Floats) -> Floats:
        """Return Legendre coefficients (..., m * m) of values (..., points)."""
        series: Floats = values[..., : self.m**2] @ self.transform.T
        return series

    def mean_square(self, values: Floats, where: Floats | None = None) -> Floats:
        """Return the mean square over the panel (...) of values (..., points), where a mask (n, points) is set."""
        nodes = values[..., : self.m**2] ** 2
        if where is not None:
            nodes = nodes * where[:, None, : self.m**2]
        squared: Floats = nodes @ self.weights
        return squared

    def tail_square(self, coefficients: Floats, values: Floats) -> Floats:
        """Return an estimate of the mean square error of the polynomial.

        It sums the two highest degrees, which are far larger than the error if coefficients decay; the error between
        the points, in case they do not; and the error at the corners, as light that enters there may be confined to
        the region between them and the first points, a share 1 / m^2 of the panel.
        """
        missed = (coefficients @ self._checks.T - values[..., self.m**2 :]) ** 2
        squared: Floats = coefficients**2 @ self._tail
        squared += 2.0 * missed[..., :-4].mean(axis=-1) + missed[..., -4:].max(axis=-1) / self.m**2
        return squared


def draw(
    evaluate: Evaluate,
    rule: Rule,
    parts: Parts,
    shape: tuple[int, int, int, int],
    accuracy: float,
    *,
    level: Floats | None = None,
    kin: Callable[[Floats], Floats] | None = None,
) -> tuple[Floats, Panels]:
    """Draw pictures of a function that can be evaluated on panels.

    Parameters
    ----------
    evaluate : callable
        Its owners are parts.
    rule : Rule
    parts : Parts
    shape : (int, int, int, int)
        Pictures, channels, and the pictures' height and width, pixels.
    accuracy : float
        Root mean square error, relative to the root mean square of the picture, channel by channel.
    level : ndarray of shape (pictures, channels), optional
        Mean square that errors are relative to where it is larger than that of the picture.
    kin : callable, optional
        Turns all channels' mean squares (pictures, channels) into those that errors are relative to.

    Returns
    -------
    pixels : ndarray of shape (pictures, channels, height, width)
        Means over the pixels' boxes.
    panels : Panels
    """
    pictures, channels, height, width = shape
    out = np.zeros(shape)
    picture = parts.picture
    owner, boxes = np.arange(len(picture)), np.tile([0.0, 1.0, 0.0, 1.0], (len(picture), 1))
    settled, lost = np.zeros((pictures, channels)), np.zeros((pictures, channels))
    count, depth = np.zeros(pictures, dtype=np.int64), np.zeros(pictures, dtype=np.int64)
    shared = np.bincount(picture, minlength=pictures)
    # Peaks as wide as the target's distance can be missed between the points of panels larger than this.
    smallest = 2.0 * math.sqrt(accuracy) / max(width, height)
    for cut in range(MAX_DEPTH + 1):
        bright = parts.side(owner, boxes, rule.places) > 0.0
        visible = bright.any(axis=1)
        owner, boxes, bright = owner[visible], boxes[visible], bright[visible]
        if not len(owner):
            break
        values, nearness = evaluate(owner, boxes)
        coefficients = rule.coefficients(values)
        panel_picture = picture[owner]
        size = 0.5**cut
        area = size * size
        square, tail = area * rule.mean_square(values, bright), area * rule.tail_square(coefficients, values)
        norm = settled.copy()
        np.add.at(norm, panel_picture, square)
        if level is not None:
            norm = np.maximum(norm, level)
        if kin is not None:
            norm = kin(norm)
        # Small panels are allowed larger errors: along a line there are few panels for their size.
        allowed = (0.7 * accuracy) ** 2 * norm[panel_picture] * area * 2.0**cut / shared[panel_picture, None]
        good = (tail <= allowed).all(axis=1) & ((nearness <= _TOO_NEAR) | (size < smallest))
        if cut == MAX_DEPTH:
            good[:] = True
        deposit(out, panel_picture[good], boxes[good], coefficients[good], parts.line[owner[good]])
        np.add.at(settled, panel_picture[good], square[good])
        np.add.at(lost, panel_picture[good], tail[good])
        np.add.at(count, panel_picture[good], 1)
        depth[panel_picture] = cut
        owner, boxes = np.repeat(owner[~good], 4), _quarters(boxes[~good])
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(settled > 0.0, np.sqrt(lost / settled), 0.0).max(axis=1, initial=0.0)
    return out, Panels(count, depth, error)


def _quarters(boxes: Floats) -> Floats:
    u0, u1, v0, v1 = boxes.T
    u, v = (u0 + u1) / 2.0, (v0 + v1) / 2.0
    parts = [(u0, u, v0, v), (u, u1, v0, v), (u0, u, v, v1), (u, u1, v, v1)]
    return np.stack([np.stack(p, axis=-1) for p in parts], axis=1).reshape(-1, 4)


def deposit(out: Floats, owner: Floats, boxes: Floats, coefficients: Floats, lines: Floats) -> None:
    """Add the integrals of panels' polynomials over pixels to the pictures.

    Parameters
    ----------
    out : ndarray of shape (pictures, channels, height, width), added to
    owner : ndarray of shape (n,), int
        Index of the picture of each panel.
    boxes : ndarray of shape (n, 4)
    coefficients : ndarray of shape (n, channels, m * m)
        Degrees along u vary fastest.
    lines : ndarray of shape (n, 3)
        As in `Parts`.
    """
    if len(owner):
        order = np.argsort(owner, kind="stable")
        starts = np.flatnonzero(np.diff(owner[order], prepend=-1))
        m = math.isqrt(coefficients.shape[2])
        runs = _Runs(owner, order, np.append(starts, len(owner)))
        coefficients = np.ascontiguousarray(coefficients).reshape(*coefficients.shape[:2], m, m)
        in_parts(_deposit_runs, len(starts), out, runs, boxes, coefficients, lines)


class _Runs(NamedTuple):
    """Picture of each panel; the order of the panels by picture; and where in that order each picture begins."""

    owner: Floats
    order: Floats
    ends: Floats


@cache
def _edge_rule(m: int) -> Floats:
    """Gauss points and weights on [0, 1], (2, m). Its computation would take a third of a picture's time."""
    nodes, weights = leggauss(m)
    return np.stack([(nodes + 1.0) / 2.0, weights / 2.0])


class _Strip(NamedTuple):
    """Integrals of Legendre polynomials over the pixels of a row or column of the picture; and scratch space.

    Attributes
    ----------
    shares : ndarray of shape (m, pixels)
        Integrals of each over the pixels, in pixels, from the first that a panel overlaps.
    edge : ndarray of shape (2, m + 1)
        Polynomials at the ends of a pixel.
    """

    shares: Floats
    edge: Floats


class _Space(NamedTuple):
    """Scratch space: compiled functions that create no arrays are compiled in a third of the time.

    Attributes
    ----------
    across, down : _Strip
    half : ndarray of shape (m, width)
        Integrals over columns.
    block : ndarray of shape (channels, height, width)
        Integrals of a panel over pixels, from the first that it overlaps.
    corners, polygon : ndarray of shape (4, 2) and (8, 2)
        Of a pixel, and of what is left of it.
    values : ndarray of shape (2, m + 1)
        Polynomials at a point.
    rule : ndarray of shape (2, m)
        Gauss points and weights on [0, 1].
    """

    across: _Strip
    down: _Strip
    half: Floats
    block: Floats
    corners: Floats
    polygon: Floats
    values: Floats
    rule: Floats


class _Pixels(NamedTuple):
    """Pixels that a panel overlaps, and the picture's size."""

    first_row: int
    first_column: int
    rows: int
    columns: int
    height: int
    width: int


def _deposit_runs(
    start: int, stop: int, out: Floats, runs: _Runs, boxes: Floats, coefficients: Floats, lines: Floats
) -> None:
    """Add the panels of pictures ``start`` to ``stop``; see `deposit`."""
    (_, channels, height, width), m = out.shape, coefficients.shape[2]
    across, down = (_Strip(np.empty((m, pixels)), np.empty((2, m + 1))) for pixels in (width, height))
    block, half = np.empty((channels, height, width)), np.empty((m, width))
    space = _Space(
        *(across, down, half, block, np.empty((4, 2)), np.empty((8, 2)), np.empty((2, m + 1)), _edge_rule(m))
    )
    _deposit(start, stop, out, runs, boxes, coefficients, lines, space)


@jit_in_place
def _shares(low: float, high: float, pixels: int, strip: _Strip) -> tuple[int, int]:
    """Write integrals of Legendre polynomials on [low, high] over the pixels that it overlaps, in pixels.

    Uses (2 n + 1) P_n = d/dx (P_(n+1) - P_(n-1)).

    Returns
    -------
    first, count : int
        The first of these pixels, and their number.
    """
    slack = 1e-9
    shares, edge = strip.shares, strip.edge
    m = shares.shape[0]
    first = min(pixels - 1, max(0, math.floor(low * pixels + slack)))
    last = min(pixels - 1, max(first, math.ceil(high * pixels - slack) - 1))
    scale = (high - low) * pixels / 2.0
    for p in range(first, last + 1):
        for e in range(2):
            x = 2.0 * ((p + e) / pixels - low) / (high - low) - 1.0
            x = min(1.0, max(-1.0, x))
            edge[e, 0] = 1.0
            edge[e, 1] = x
            for n in range(1, m):
                edge[e, n + 1] = ((2 * n + 1) * x * edge[e, n] - n * edge[e, n - 1]) / (n + 1)
        shares[0, p - first] = scale * (edge[1, 1] - edge[0, 1])
        for n in range(1, m):
            rise = edge[1, n + 1] - edge[1, n - 1] - edge[0, n + 1] + edge[0, n - 1]
            shares[n, p - first] = scale * rise / (2 * n + 1)
    return first, last - first + 1


def _integrate_loops(polynomial: Floats, pixels: _Pixels, space: _Space) -> None:
    """Write integrals of a panel's polynomials (channels, m, m) over pixels to ``block``."""
    across, down, half, block = space.across.shares, space.down.shares, space.half, space.block
    m = half.shape[0]
    for channel in range(polynomial.shape[0]):
        for j in range(m):
            for column in range(pixels.columns):
                half[j, column] = 0.0
            for i in range(m):
                factor = polynomial[channel, j, i]
                for column in range(pixels.columns):
                    half[j, column] += factor * across[i, column]
        for row in range(pixels.rows):
            for column in range(pixels.columns):
                block[channel, row, column] = 0.0
            for j in range(m):
                factor = down[j, row]
                for column in range(pixels.columns):
                    block[channel, row, column] += factor * half[j, column]


def _integrate_arrays(polynomial: Floats, pixels: _Pixels, space: _Space) -> None:
    """NumPy form of `_integrate_loops`."""
    across, down = space.across.shares[:, : pixels.columns], space.down.shares[:, : pixels.rows]
    space.block[:, : pixels.rows, : pixels.columns] = down.T @ (polynomial @ across)


_integrate = jit_loops(_integrate_loops) if COMPILED else _integrate_arrays


def _add_loops(block: Floats, pixels: _Pixels, image: Floats) -> None:
    """Add a block of pixels to a picture (channels, height, width)."""
    for channel in range(image.shape[0]):
        for row in range(pixels.rows):
            for column in range(pixels.columns):
                added = block[channel, row, column]
                image[channel, pixels.first_row + row, pixels.first_column + column] += added


def _add_arrays(block: Floats, pixels: _Pixels, image: Floats) -> None:
    """NumPy form of `_add_loops`."""
    rows, columns = slice(pixels.first_row, None), slice(pixels.first_column, None)
    image[:, rows, columns][:, : pixels.rows, : pixels.columns] += block[:, : pixels.rows, : pixels.columns]


_add = jit_loops(_add_loops) if COMPILED else _add_arrays


@jit_in_place
def _keep_side(pixels: _Pixels, box: Floats, polynomial: Floats, line: Floats, space: _Space) -> None:
    """Remove from a panel's shares of pixels what lies beyond a line.

    The rest of a pixel that the line crosses is a polygon. The integral over it equals one along its edges (Green's
    theorem), of the polynomial's antiderivative in u, which m Gauss points per edge integrate exactly.
    """
    block, corners, polygon, edge = space.block, space.corners, space.polygon, space.rule
    along, down = space.values[0], space.values[1]
    m = edge.shape[1]
    wide, high = (box[1] - box[0]) / 2.0, (box[3] - box[2]) / 2.0
    # The line and (below) the pixel's sides, in the panel's own coordinates on [-1, 1].
    a, b = line[0] * wide, line[1] * high
    c = line[0] * (box[0] + wide) + line[1] * (box[2] + high) + line[2]
    for row in range(pixels.rows):
        y0 = max(-1.0, ((pixels.first_row + row) / pixels.height - box[2]) / high - 1.0)
        y1 = min(1.0, ((pixels.first_row + row + 1) / pixels.height - box[2]) / high - 1.0)
        for column in range(pixels.columns):
            x0 = max(-1.0, ((pixels.first_column + column) / pixels.width - box[0]) / wide - 1.0)
            x1 = min(1.0, ((pixels.first_column + column + 1) / pixels.width - box[0]) / wide - 1.0)
            corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1] = x0, y0, x1, y0
            corners[2, 0], corners[2, 1], corners[3, 0], corners[3, 1] = x1, y1, x0, y1
            bright = 0
            for k in range(4):
                if a * corners[k, 0] + b * corners[k, 1] + c >= 0.0:
                    bright += 1
            if bright == 4:
                continue
            for channel in range(block.shape[0]):
                block[channel, row, column] = 0.0
            if bright == 0 or x1 <= x0 or y1 <= y0:
                continue
            n = clip(corners, corners.shape[0], a, b, c, polygon)
            for k in range(n):
                after = (k + 1) % n
                rise = polygon[after, 1] - polygon[k, 1]
                if rise == 0.0:
                    continue
                for q in range(edge.shape[1]):
                    x = polygon[k, 0] + edge[0, q] * (polygon[after, 0] - polygon[k, 0])
                    y = polygon[k, 1] + edge[0, q] * rise
                    along[0], along[1], down[0], down[1] = 1.0, x, 1.0, y
                    for i in range(1, m):
                        along[i + 1] = ((2 * i + 1) * x * along[i] - i * along[i - 1]) / (i + 1)
                        down[i + 1] = ((2 * i + 1) * y * down[i] - i * down[i - 1]) / (i + 1)
                    # (2 i + 1) P_i = d/dx (P_(i+1) - P_(i-1))
                    previous = 1.0
                    along[0] = x
                    for i in range(1, m):
                        current = along[i]
                        along[i] = (along[i + 1] - previous) / (2 * i + 1)
                        previous = current
                    share = edge[1, q] * rise * wide * high * pixels.width * pixels.height
                    for channel in range(block.shape[0]):
                        total = 0.0
                        for j in range(m):
                            inner = 0.0
                            for i in range(m):
                                inner += polynomial[channel, j, i] * along[i]
                            total += inner * down[j]
                        block[channel, row, column] += share * total


@jit_parts
def _deposit(
    start: int,
    stop: int,
    out: Floats,
    runs: _Runs,
    boxes: Floats,
    coefficients: Floats,
    lines: Floats,
    space: _Space,
) -> None:
    height, width = out.shape[2], out.shape[3]
    for run in range(start, stop):  # a run is one picture, so no two threads write to the same one
        for k in range(runs.ends[run], runs.ends[run + 1]):
            item = runs.order[k]
            box, line, polynomial = boxes[item], lines[item], coefficients[item]
            first_column, columns = _shares(box[0], box[1], width, space.across)
            first_row, rows = _shares(box[2], box[3], height, space.down)
            pixels = _Pixels(first_row, first_column, rows, columns, height, width)
            _integrate(polynomial, pixels, space)
            least = line[2] + min(line[0] * box[0], line[0] * box[1]) + min(line[1] * box[2], line[1] * box[3])
            if least < 0.0:
                _keep_side(pixels, box, polynomial, line, space)
            _add(space.block, pixels, out[runs.owner[item]])


def _colour_loops(
    start: int,
    stop: int,
    made: Floats,
    background: Floats,
    added: Floats,
    hidden: Floats,
    channel: Floats,
    factor: Floats,
) -> None:
    """Write pictures in colour: ``background + (added - hidden) * factor``, each channel from its group.

    Parameters
    ----------
    start, stop : int
        Range of the pictures.
    made : ndarray of shape (n, height, width, 3), written
    background : ndarray of shape (height, width, 3)
    added, hidden : ndarray of shape (n, groups, height, width)
    channel : ndarray of shape (3,), int
        Each channel's group.
    factor : ndarray of shape (3,)
    """
    for item in range(start, stop):
        for row in range(made.shape[1]):
            for column in range(made.shape[2]):
                for c in range(3):
                    change = added[item, channel[c], row, column] - hidden[item, channel[c], row, column]
                    made[item, row, column, c] = background[row, column, c] + change * factor[c]


def _colour_arrays(
    start: int,
    stop: int,
    made: Floats,
    background: Floats,
    added: Floats,
    hidden: Floats,
    channel: Floats,
    factor: Floats,
) -> None:
    """NumPy form of `_colour_loops`."""
    change = added[start:stop] - hidden[start:stop]
    for c in range(3):
        made[start:stop, :, :, c] = background[:, :, c] + change[:, channel[c]] * factor[c]


colour = jit_released(_colour_loops) if COMPILED else _colour_arrays
