"""Reference pictures by plain quadrature in double precision, which share no code with `generator.transport`.

The wall is y = 0. Over a flat face the cosine towards w is h(w) / r with h(w) the distance of w from its plane, which
is the same for the whole face. So only 1 / r^4 is left to integrate, and the kinks are straight lines: a pixel that
the plane cuts is split along it, and so is the ellipse of the lit patch. Cells of the face, the pixels and the patch
shrink towards each other, so that none is larger than its distance, down to sizes that carry no light. A sphere is
integrated, for every wall point, in polar coordinates about the direction of that point, so that its horizon is a
limit of integration; its terminator is a band of small cells in which the patch is cut exactly.

Shadows in a room are convex polygons: half planes cut out of each surface. Light is hidden where the target hides a
point of the surface from w or from q, except where the partition does so already, by inclusion and exclusion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.polynomial.legendre import Legendre, leggauss, legvander
from numpy.typing import NDArray

from generator.model.arrays import rotation_matrix
from generator.transport.world import Sphere, Watched, World

Array = NDArray[Any]

_compiled = numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
_NODES, _LEVELS = 300_000, 400
_CORNERS = 140
_FLUSH = 1e-6
"""Height, metres, up to which a face lies on the wall: almost no light gets in between."""


@dataclass(frozen=True)
class Fineness:
    """How fine the cells of a reference are.

    Attributes
    ----------
    points : int
        Gauss points along each side of a cell of target and patch; distant pixels take fewer.
    ratio : float
        Largest ratio of a cell's diagonal to its distance from what it exchanges light with.
    least : float
        Diagonal, metres, below which pixels are not cut; for cells of the target it is 100 times smaller.
    band : float
        Largest cell of a sphere's terminator, radians.
    sides : int
        Corners of a sphere's outline.
    """

    points: int = 6
    ratio: float = 1.0
    least: float = 1e-3
    band: float = 0.2
    sides: int = 32

    @property
    def doubled(self) -> Fineness:
        """The fineness with everything about twice as fine."""
        return Fineness(self.points + 2, self.ratio * 0.75, self.least / 4.0, self.band * 0.6, self.sides * 2)

    @property
    def finer(self) -> Fineness:
        """The fineness one step finer, for cases where twice as fine would take minutes."""
        return Fineness(self.points + 1, self.ratio * 0.8, self.least / 2.0, self.band * 0.8, self.sides * 3 // 2)

    def numbers(self) -> tuple[Array, Array, int, float, float, float]:
        """Return nodes and weights of Gauss rules of up to 16 points on 0 to 1, as rows, and the figures."""
        x, w = np.zeros((17, 16)), np.zeros((17, 16))
        for n in range(1, 17):
            nodes, weights = leggauss(n)
            x[n, :n], w[n, :n] = (nodes + 1.0) / 2.0, weights / 2.0
        return x, w, self.points, self.ratio, self.least, self.band


def patch_figures(world: World) -> Array:
    """Return centre, semi-axes and lamp of the lit patch, its radiance times distance cubed, its reach and area."""
    lit = world.patch
    if lit.cos_width:
        raise ValueError("the reference knows hard-edged spots alone")
    strength = lit.albedo[0] / math.pi * lit.intensity[0] * lit.height
    reach = max(np.linalg.norm(lit.major), np.linalg.norm(lit.minor))
    area = np.linalg.norm(np.cross(lit.major, lit.minor))
    return np.concatenate([lit.centre, lit.major, lit.minor, lit.lamp, [strength, reach, area]])


@_compiled
def _segment(normal, offset, patch):
    """Return the patch where normal . q > offset: end of t, direction in the disc, and height = h + g cos t."""
    h, a, b = -offset, 0.0, 0.0
    for i in range(3):
        h += normal[i] * patch[i]
        a += normal[i] * patch[3 + i]
        b += normal[i] * patch[6 + i]
    g = math.hypot(a, b)
    if g < 1e-300:
        return (math.pi if h > 0.0 else 0.0), 1.0, 0.0, h, 0.0
    if h <= -g:
        return 0.0, 1.0, 0.0, h, g
    return (math.pi if h >= g else math.acos(-h / g)), a / g, b / g, h, g


@_compiled
def _irradiance(x, normal, offset, patch, rule, weight, n, ratio):
    """Return the light that arrives at x on the side of the normal: the ellipse is cut along the plane's chord.

    A disc's segment is (cos t, s sin t) with t up to its end and s from -1 to 1, which is smooth for any end.
    """
    end, e, f, h, g = _segment(normal, offset, patch)
    if end == 0.0 or x[1] <= 0.0:
        return 0.0
    stack = np.empty((_LEVELS, 4))
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, end, -1.0, 1.0
    top, total = 1, 0.0
    while top:
        top -= 1
        t0, t1, s0, s1 = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        tm, sm = (t0 + t1) / 2.0, (s0 + s1) / 2.0
        widest = 1.0 if t0 < math.pi / 2.0 < t1 else max(math.sin(t0), math.sin(t1))
        du, dv = patch[13] * (t1 - t0), patch[13] * (s1 - s0) * widest
        ca, cb = math.cos(tm), math.sin(tm) * sm
        pa, pb = ca * e - cb * f, ca * f + cb * e
        away = 0.0
        for i in range(3):
            away += (patch[i] + pa * patch[3 + i] + pb * patch[6 + i] - x[i]) ** 2
        size = du * du + dv * dv
        if size > ratio * ratio * away and size > 1e-14 and top < _LEVELS - 2:
            for part in range(2):
                if du > dv:
                    stack[top, 0], stack[top, 1] = (t0, tm) if part else (tm, t1)
                    stack[top, 2], stack[top, 3] = s0, s1
                else:
                    stack[top, 0], stack[top, 1] = t0, t1
                    stack[top, 2], stack[top, 3] = (s0, sm) if part else (sm, s1)
                top += 1
            continue
        for i in range(n + 1):
            t = t0 + (t1 - t0) * rule[n + 1, i]
            sin, cos = math.sin(t), math.cos(t)
            line = 0.0
            for j in range(n):
                b = sin * (s0 + (s1 - s0) * rule[n, j])
                pa, pb = cos * e - b * f, cos * f + b * e
                way = lamp = 0.0
                for k in range(3):
                    q = patch[k] + pa * patch[3 + k] + pb * patch[6 + k]
                    way += (q - x[k]) ** 2
                    lamp += (q - patch[9 + k]) ** 2
                line += weight[n, j] / (way * way * lamp * math.sqrt(lamp))
            total += line * max(h + g * cos, 0.0) * sin * sin * weight[n + 1, i] * (t1 - t0) * (s1 - s0)
    return total * x[1] * patch[12] * patch[14]


@_compiled
def _from_patch(x, patch):
    """Return the distance of a point from the patch, or a little less."""
    aside = max(0.0, math.hypot(x[0] - patch[0], x[2] - patch[2]) - patch[13])
    return math.hypot(aside, x[1])


@_compiled
def _cut(shape, corners, a, b, c, out):
    """Clip a convex polygon to a u + b v + c >= 0; return its number of corners."""
    kept = 0
    for i in range(corners):
        j = i + 1 if i + 1 < corners else 0
        h = a * shape[i, 0] + b * shape[i, 1] + c
        k = a * shape[j, 0] + b * shape[j, 1] + c
        if h >= 0.0:
            out[kept] = shape[i]
            kept += 1
        if (h > 0.0 > k) or (h < 0.0 < k):
            out[kept] = shape[i] + (shape[j] - shape[i]) * (h / (h - k))
            kept += 1
    return kept if kept > 2 else 0


@_compiled
def _wall_point(to_wall, u, v, out):
    below = to_wall[3, 0] * u + to_wall[3, 1] * v + to_wall[3, 2]
    for i in range(3):
        out[i] = (to_wall[i, 0] * u + to_wall[i, 1] * v + to_wall[i, 2]) / below


@_compiled
def _pieces(to_wall, column, row, width, height, lines, out):
    """Split a pixel along lines into quadrilaterals, where a triangle has one corner twice; return how many."""
    shapes, sizes = np.empty((8, 12, 2)), np.zeros(8, np.int64)
    for i in range(4):
        shapes[0, i, 0] = (column + (1 if i in (1, 2) else 0)) / width
        shapes[0, i, 1] = (row + (1 if i in (2, 3) else 0)) / height
    sizes[0] = 4
    count = 1
    spare = np.empty((12, 2))
    for k in range(len(lines)):
        for s in range(count):
            a, b, c = lines[k, 0], lines[k, 1], lines[k, 2]
            negative = _cut(shapes[s], sizes[s], -a, -b, -c, shapes[count])
            positive = _cut(shapes[s], sizes[s], a, b, c, spare)
            if negative and positive:
                sizes[count] = negative
                count += 1
                shapes[s], sizes[s] = spare, positive
    n_pieces = 0
    for s in range(count):
        if sizes[s] == 4:
            out[n_pieces] = shapes[s, :4]
            n_pieces += 1
            continue
        for i in range(1, sizes[s] - 1):
            out[n_pieces, 0], out[n_pieces, 1] = shapes[s, 0], shapes[s, i]
            out[n_pieces, 2] = out[n_pieces, 3] = shapes[s, i + 1]
            n_pieces += 1
    return n_pieces


@_compiled
def _split(quad, stack, top):
    """Push the four quarters of a quadrilateral."""
    for p in range(2):
        for q in range(2):
            for i in range(4):
                a = (p + (1 if i in (1, 2) else 0)) / 2.0
                b = (q + (1 if i in (2, 3) else 0)) / 2.0
                for k in range(2):
                    low = quad[0, k] + a * (quad[1, k] - quad[0, k])
                    high = quad[3, k] + a * (quad[2, k] - quad[3, k])
                    stack[top, i, k] = low + b * (high - low)
            top += 1
    return top


@_compiled
def _quad_point(quad, a, b):
    """Return picture coordinates in a quadrilateral, and the area that a unit of a times b has there."""
    du0, dv0 = quad[1, 0] - quad[0, 0], quad[1, 1] - quad[0, 1]
    du1, dv1 = quad[2, 0] - quad[3, 0], quad[2, 1] - quad[3, 1]
    lu, lv = quad[0, 0] + a * du0, quad[0, 1] + a * dv0
    hu, hv = quad[3, 0] + a * du1, quad[3, 1] + a * dv1
    au, av = du0 + b * (du1 - du0), dv0 + b * (dv1 - dv0)
    return lu + b * (hu - lu), lv + b * (hv - lv), abs(au * (hv - lv) - av * (hu - lu))


@_compiled
def _face_at(w, face, one_sided, patch, rule, weight, n, ratio, least, boxes, child, known, light, count):
    """Return radiance at w, up to constants, of a face (centre, half edges, normal, offset); its cell tree grows."""
    h = -face[12]
    for i in range(3):
        h += face[9 + i] * w[i]
    facing = 0 if h > 0.0 else 1
    if h == 0.0 or (facing and one_sided):
        return 0.0, count
    stack = np.empty(_LEVELS, np.int64)
    stack[0] = 0
    top, total = 1, 0.0
    x, normal = np.empty(3), np.empty(3)
    sign = 1.0 - 2.0 * facing
    for i in range(3):
        normal[i] = sign * face[9 + i]
    while top:
        top -= 1
        k = stack[top]
        a0, a1, b0, b1 = boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3]
        am, bm = (a0 + a1) / 2.0, (b0 + b1) / 2.0
        away = size = 0.0
        for i in range(3):
            x[i] = face[i] + am * face[3 + i] + bm * face[6 + i]
            away += (x[i] - w[i]) ** 2
            size += ((a1 - a0) * face[3 + i]) ** 2 + ((b1 - b0) * face[6 + i]) ** 2
        diagonal = math.sqrt(size)
        coarse = size > ratio * ratio * away and diagonal > least / 100.0
        coarse |= diagonal > ratio * _from_patch(x, patch) and diagonal > least / 10.0
        if coarse and (child[k] or count + 4 <= len(boxes)):
            if not child[k]:
                child[k] = count
                for part in range(4):
                    boxes[count, 0], boxes[count, 1] = (a0, am) if part % 2 else (am, a1)
                    boxes[count, 2], boxes[count, 3] = (b0, bm) if part // 2 else (bm, b1)
                    count += 1
            for part in range(4):
                stack[top] = child[k] + part
                top += 1
            continue
        if not known[k, facing]:
            known[k, facing] = True
            area = math.sqrt(face[3] ** 2 + face[4] ** 2 + face[5] ** 2) * (a1 - a0)
            area *= math.sqrt(face[6] ** 2 + face[7] ** 2 + face[8] ** 2) * (b1 - b0)
            for i in range(n):
                for j in range(n):
                    a, b = a0 + (a1 - a0) * rule[n, i], b0 + (b1 - b0) * rule[n, j]
                    for m in range(3):
                        x[m] = face[m] + a * face[3 + m] + b * face[6 + m]
                    came = _irradiance(x, normal, sign * face[12], patch, rule, weight, n, ratio)
                    light[k, facing, i * n + j] = came * max(x[1], 0.0) * area * weight[n, i] * weight[n, j]
        for i in range(n):
            a = a0 + (a1 - a0) * rule[n, i]
            p0 = face[0] + a * face[3] - w[0]
            p1 = face[1] + a * face[4] - w[1]
            p2 = face[2] + a * face[5] - w[2]
            for j in range(n):
                b = b0 + (b1 - b0) * rule[n, j]
                r = (p0 + b * face[6]) ** 2 + (p1 + b * face[7]) ** 2 + (p2 + b * face[8]) ** 2
                total += light[k, facing, i * n + j] / (r * r)
    return total * abs(h), count


@_compiled
def _from_face(w, face):
    """Return the distance of a point from a rectangle."""
    along, across, up, rest = 0.0, 0.0, -face[12], 0.0
    e = f = 0.0
    for i in range(3):
        along += (w[i] - face[i]) * face[3 + i]
        across += (w[i] - face[i]) * face[6 + i]
        e += face[3 + i] ** 2
        f += face[6 + i] ** 2
        up += face[9 + i] * w[i]
    rest = max(abs(along) / e - 1.0, 0.0) ** 2 * e + max(abs(across) / f - 1.0, 0.0) ** 2 * f
    return math.sqrt(rest + up * up)


@_compiled
def _sphere_at(w, ball, patch, rule, weight, n, ratio, band, whole):
    """Return radiance at w, up to constants, of a sphere (centre, radius); ``whole``: patch points, their power."""
    radius = ball[3]
    axis, first = np.empty(3), np.zeros(3)
    for i in range(3):
        axis[i] = w[i] - ball[i]
    distance = math.sqrt((axis * axis).sum())
    axis /= distance
    first[np.argmin(np.abs(axis))] = 1.0
    first -= (first * axis).sum() * axis
    first /= math.sqrt((first * first).sum())
    second = np.cross(axis, first)
    stack = np.empty((_LEVELS, 4))
    for part in range(4):
        stack[part, 0], stack[part, 1] = 0.0, math.acos(radius / distance)
        stack[part, 2], stack[part, 3] = part * math.pi / 2.0, (part + 1) * math.pi / 2.0
    top, total = 4, 0.0
    out, x = np.empty(3), np.empty(3)
    while top:
        top -= 1
        t0, t1, p0, p1 = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        tm, pm = (t0 + t1) / 2.0, (p0 + p1) / 2.0
        away = seen = 0.0
        for i in range(3):
            out[i] = math.cos(tm) * axis[i] + math.sin(tm) * (math.cos(pm) * first[i] + math.sin(pm) * second[i])
            x[i] = ball[i] + radius * out[i]
            away += (x[i] - w[i]) ** 2
            seen += (patch[i] - ball[i]) ** 2
        dt, dp = t1 - t0, (p1 - p0) * math.sin(t1)
        angle = math.hypot(dt, dp)
        _, _, _, h, g = _segment(out, (out * x).sum(), patch)
        change = angle / 2.0 * (math.sqrt(seen) + patch[13])
        if h + g + change < 0.0:
            continue
        partly = h - g - change < 0.0
        if angle > (band if partly else 0.8) or radius * angle > ratio * min(math.sqrt(away), _from_patch(x, patch)):
            for part in range(2):
                if dt > dp:
                    stack[top, 0], stack[top, 1] = (t0, tm) if part else (tm, t1)
                    stack[top, 2], stack[top, 3] = p0, p1
                else:
                    stack[top, 0], stack[top, 1] = t0, t1
                    stack[top, 2], stack[top, 3] = (p0, pm) if part else (pm, p1)
                top += 1
            continue
        for i in range(n):
            t = t0 + dt * rule[n, i]
            sin, cos = math.sin(t), math.cos(t)
            apart = distance * distance + radius * radius - 2.0 * distance * radius * cos
            share = max(distance * cos - radius, 0.0) / (apart * apart) * sin * weight[n, i] * dt * (p1 - p0)
            for j in range(n):
                p = p0 + (p1 - p0) * rule[n, j]
                a, b = sin * math.cos(p), sin * math.sin(p)
                for k in range(3):
                    out[k] = cos * axis[k] + a * first[k] + b * second[k]
                    x[k] = ball[k] + radius * out[k]
                offset = (out * x).sum()
                cut = partly
                if partly:
                    _, _, _, h, g = _segment(out, offset, patch)
                    cut = h < g
                if cut or _from_patch(x, patch) < 4.0 * patch[13]:
                    came = _irradiance(x, out, offset, patch, rule, weight, n, ratio)
                else:
                    came = 0.0
                    for q in range(len(whole)):
                        u, v, s = whole[q, 0] - x[0], whole[q, 1] - x[1], whole[q, 2] - x[2]
                        r = u * u + v * v + s * s
                        came += whole[q, 3] * (out[0] * u + out[1] * v + out[2] * s) / (r * r)
                    came *= x[1]
                total += share * came * max(x[1], 0.0) * weight[n, j]
    return total * radius * radius


@_compiled
def _face_picture(to_wall, width, height, face, one_sided, patch, rule, weight, n, ratio, least):
    """Return a face's picture, up to constants, and how many cells it took."""
    boxes, child = np.zeros((_NODES, 4)), np.zeros(_NODES, np.int64)
    known, light = np.zeros((_NODES, 2), np.bool_), np.empty((_NODES, 2, n * n))
    boxes[0, 0], boxes[0, 1], boxes[0, 2], boxes[0, 3] = -1.0, 1.0, -1.0, 1.0
    count = 1
    lines = np.zeros((1, 3))
    for k in range(3):
        lines[0, k] = -face[12] * to_wall[3, k]
        for i in range(3):
            lines[0, k] += face[9 + i] * to_wall[i, k]
    pieces, stack, quad = np.empty((40, 4, 2)), np.empty((_LEVELS, 4, 2)), np.empty((4, 2))
    w, corner, middle = np.empty(3), np.empty(3), np.empty(3)
    out = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            top = _pieces(to_wall, column, row, width, height, lines, pieces)
            for i in range(top):
                stack[i] = pieces[i]
            while top:
                top -= 1
                quad[:] = stack[top]
                _wall_point(to_wall, quad[:, 0].sum() / 4.0, quad[:, 1].sum() / 4.0, middle)
                size = 0.0
                for i in range(4):
                    _wall_point(to_wall, quad[i, 0], quad[i, 1], corner)
                    size = max(size, 2.0 * math.sqrt(((corner - middle) ** 2).sum()))
                away = _from_face(middle, face)
                if size > ratio * away and size > least:
                    top = _split(quad, stack, top)
                    continue
                m = n - 4 if size < 0.15 * away else (n - 3 if size < 0.4 * away else n - 1)
                for i in range(m):
                    for j in range(m):
                        u, v, area = _quad_point(quad, rule[m, i], rule[m, j])
                        if area > 0.0:
                            _wall_point(to_wall, u, v, w)
                            value, count = _face_at(
                                w,
                                face,
                                one_sided,
                                patch,
                                rule,
                                weight,
                                n,
                                ratio,
                                least,
                                boxes,
                                child,
                                known,
                                light,
                                count,
                            )
                            out[row, column] += value * area * weight[m, i] * weight[m, j] * width * height
    return out, count


@_compiled
def _sphere_points(points, ball, patch, rule, weight, n, ratio, band, whole):
    out = np.empty(len(points))
    for k in range(len(points)):
        out[k] = _sphere_at(points[k], ball, patch, rule, weight, n, ratio, band, whole)
    return out


def _sphere_picture(view: Watched, ball: Array, patch: Array, fine: Fineness) -> Array:
    """Return a sphere's picture, up to constants: smooth, so panels of pixels are polynomials, integrated exactly."""
    rule, weight, n, ratio, _, band = fine.numbers()
    whole = _whole(patch, rule, weight, n)
    width, height = view.resolution
    out = np.zeros((height, width))
    m = n + 2
    panels = [(0, 0, width, height)]
    while panels:
        left, top, wide, high = panels.pop()
        ends = np.array([[left, top], [left + wide, top + high], [left + wide / 2.0, top + high / 2.0]])
        first, last, middle = view.points(ends / view.resolution)
        away = np.linalg.norm(middle - ball[:3]) - ball[3]
        if np.linalg.norm(last - first) > ratio * away and max(wide, high) > 1:
            for x0, x1 in ((left, left + wide // 2), (left + wide // 2, left + wide)):
                for y0, y1 in ((top, top + high // 2), (top + high // 2, top + high)):
                    panels += [(x0, y0, x1 - x0, y1 - y0)] if x1 > x0 and y1 > y0 else []
            continue
        uv = np.stack(np.meshgrid(left + wide * rule[m, :m], top + high * rule[m, :m]), axis=-1) / view.resolution
        points = view.points(uv.reshape(-1, 2))
        values = _sphere_points(points, ball, patch, rule, weight, n, ratio, band, whole).reshape(m, m)
        across, down = (_means(rule[m, :m], weight[m, :m], k) for k in (wide, high))
        out[top : top + high, left : left + wide] = down @ values @ across.T
    return out


def _means(x: Array, weight: Array, parts: int) -> Array:
    """Return the matrix from values at Gauss points on 0 to 1 to the means of their polynomial over equal parts."""
    n = len(x)
    edges = np.linspace(-1.0, 1.0, parts + 1)
    fitted = (legvander(2.0 * x - 1.0, n - 1) * weight[:, None]).T * (2.0 * np.arange(n) + 1.0)[:, None]
    integrals = np.stack([Legendre.basis(k).integ()(edges) for k in range(n)], axis=1)
    means: Array = np.diff(integrals, axis=0) * parts / 2.0 @ fitted
    return means


def _whole(patch: Array, rule: Array, weight: Array, n: int) -> Array:
    """Return points on the whole patch with their power, (k, 4)."""
    t, s = np.meshgrid(math.pi * rule[n, :n], 2.0 * rule[n, :n] - 1.0, indexing="ij")
    share = np.outer(weight[n, :n], weight[n, :n]) * 2.0 * math.pi * np.sin(t) ** 2
    points = patch[:3] + np.cos(t)[..., None] * patch[3:6] + (np.sin(t) * s)[..., None] * patch[6:9]
    power = share * patch[12] * patch[14] / np.linalg.norm(points - patch[9:12], axis=-1) ** 3
    return np.concatenate([points, power[..., None]], axis=-1).reshape(-1, 4)


def faces(triangles: Array) -> list[Array]:
    """Return a rectangle per two triangles: centre, two half edges, normal (outwards of a closed body), offset."""
    rectangles = []
    middle = triangles.reshape(-1, 3).mean(axis=0)
    for pair in triangles.reshape(-1, 2, 3, 3):
        a, b, c = pair[0]
        # The corner opposite the diagonal, which is the longest side.
        k = int(np.argmax([np.linalg.norm(c - b), np.linalg.norm(a - c), np.linalg.norm(b - a)]))
        e, f = pair[0][k - 2] - pair[0][k], pair[0][k - 1] - pair[0][k]
        centre = pair[0][k] + (e + f) / 2.0
        normal = np.cross(e, f) / np.linalg.norm(np.cross(e, f))
        if (centre - middle) @ normal < 0.0:
            normal = -normal
        rectangles.append(np.concatenate([centre, e / 2.0, f / 2.0, normal, [normal @ centre]]))
    return rectangles


def added(world: World, position: Any, rotation: Any, fine: Fineness) -> Array:
    """Return the light that one convex target adds, (height, width), W/m^2/sr, if nothing stands in the way.

    Parameters
    ----------
    world : World
        Its target is a sphere, a rectangle or a closed convex body of rectangles, each of two triangles.
    position, rotation : array-like of shape (3,)
        Metres, degrees.
    fine : Fineness
    """
    patch, (*figures, _) = patch_figures(world), fine.numbers()
    body, view, turn = world.target[0], world.watched, rotation_matrix(tuple(rotation))
    factor = float(view.albedo[0] * np.ravel(body.albedo)[0]) / math.pi**2
    if isinstance(body, Sphere):
        ball = np.append(turn @ body.centre + position, body.radius)
        return factor * _sphere_picture(view, ball, patch, fine)
    parts = faces(body.triangles @ turn.T + position)
    width, height = view.resolution
    total = np.zeros((height, width))
    for part in parts:
        if part[1] + abs(part[4]) + abs(part[7]) < _FLUSH:
            continue
        picture, count = _face_picture(view.to_wall, width, height, part, len(parts) > 1, patch, *figures)
        if count + 4 > _NODES:
            raise RuntimeError(f"pose {position}, {rotation}: the reference needs more than {_NODES} cells")
        total += picture
    return factor * total


@_compiled
def _sides(eye, shape, surface, out):
    """Write half planes, in a surface's coordinates, of what a convex polygon hides from a point; return how many.

    A surface is a corner and two edges. One half plane is the far side of the polygon's own plane. For a point in
    that plane there are none, since nothing is hidden from it.
    """
    corners = len(shape)
    middle, normal = np.zeros(3), np.zeros(3)
    for i in range(corners):
        middle += shape[i] / corners
    for i in range(corners):
        normal += np.cross(shape[i] - middle, shape[i + 1 if i + 1 < corners else 0] - middle)
    normal /= math.sqrt((normal**2).sum())
    height = (normal * (middle - eye)).sum()
    if abs(height) < 1e-12:
        return 0
    for i in range(corners + 1):
        if i < corners:
            side = np.cross(shape[i] - eye, shape[i + 1 if i + 1 < corners else 0] - eye)
            start = eye
            sign = 1.0 if (side * (middle - eye)).sum() > 0.0 else -1.0
        else:
            side, start, sign = normal, middle, (1.0 if height > 0.0 else -1.0)
        for k in range(2):
            out[i, k] = sign * (side * surface[k + 1]).sum()
        out[i, 2] = sign * (side * (surface[0] - start)).sum()
    return corners + 1


@_compiled
def _cone(eye, ball, surface, corners, out):
    """Write half planes of what a sphere hides from a point: a pyramid of nearly the cone's solid angle."""
    axis, first = ball[:3] - eye, np.zeros(3)
    distance = math.sqrt((axis**2).sum())
    axis /= distance
    first[np.argmin(np.abs(axis))] = 1.0
    first -= (first * axis).sum() * axis
    first /= math.sqrt((first**2).sum())
    second = np.cross(axis, first)
    slope = ball[3] / math.sqrt(distance**2 - ball[3] ** 2)
    slope *= math.sqrt(math.pi / (corners * math.tan(math.pi / corners)))
    for i in range(corners + 1):
        turn = 2.0 * math.pi * i / corners
        side = axis if i == corners else slope * axis - math.cos(turn) * first - math.sin(turn) * second
        for k in range(2):
            out[i, k] = (side * surface[k + 1]).sum()
        out[i, 2] = (side * (surface[0] - eye)).sum()
    return corners + 1


@_compiled
def _clip(shape, corners, sides, count, spare):
    """Clip a polygon, in place, to half planes; return its number of corners."""
    for i in range(count):
        if not corners:
            break
        kept = _cut(shape, corners, sides[i, 0], sides[i, 1], sides[i, 2], spare)
        for k in range(kept):
            shape[k] = spare[k]
        corners = kept
    return corners


@_compiled
def _exchange(shape, corners, surface, w, q, rule, weight, n, ratio, stack):
    """Return the integral of G(q, y) G(y, w) over a polygon on a surface, without its distances from q and w."""
    total = 0.0
    y = np.empty(3)
    for fan in range(1, corners - 1):
        stack[0, 0], stack[0, 1], stack[0, 2] = shape[0], shape[fan], shape[fan + 1]
        top = 1
        while top:
            top -= 1
            a0, b0, a1, b1, a2, b2 = (
                stack[top, 0, 0],
                stack[top, 0, 1],
                stack[top, 1, 0],
                stack[top, 1, 1],
                stack[top, 2, 0],
                stack[top, 2, 1],
            )
            area = abs((a1 - a0) * (b2 - b0) - (a2 - a0) * (b1 - b0))
            if area == 0.0:
                continue
            near_w = near_q = side_01 = side_12 = side_20 = 0.0
            for k in range(3):
                e, f = surface[1, k], surface[2, k]
                middle = surface[0, k] + (a0 + a1 + a2) / 3.0 * e + (b0 + b1 + b2) / 3.0 * f
                near_w += (middle - w[k]) ** 2
                near_q += (middle - q[k]) ** 2
                side_01 += ((a1 - a0) * e + (b1 - b0) * f) ** 2
                side_12 += ((a2 - a1) * e + (b2 - b1) * f) ** 2
                side_20 += ((a0 - a2) * e + (b0 - b2) * f) ** 2
            if max(side_01, side_12, side_20) > ratio * ratio * min(near_w, near_q) and top < 60:
                # The longest side is halved.
                am, bm, ao, bo, ap, bp, ar, br = (a0 + a1) / 2.0, (b0 + b1) / 2.0, a2, b2, a0, b0, a1, b1
                if side_12 >= max(side_01, side_20):
                    am, bm, ao, bo, ap, bp, ar, br = (a1 + a2) / 2.0, (b1 + b2) / 2.0, a0, b0, a1, b1, a2, b2
                elif side_20 >= side_01:
                    am, bm, ao, bo, ap, bp, ar, br = (a2 + a0) / 2.0, (b2 + b0) / 2.0, a1, b1, a2, b2, a0, b0
                for part in range(2):
                    stack[top, 0, 0], stack[top, 0, 1], stack[top, 1, 0], stack[top, 1, 1] = am, bm, ao, bo
                    stack[top, 2, 0], stack[top, 2, 1] = (ap, bp) if part else (ar, br)
                    top += 1
                continue
            for i in range(n):
                s = rule[n, i]
                for j in range(n):
                    t = rule[n, j]
                    a = a0 + s * (a1 - a0 + t * (a2 - a1))
                    b = b0 + s * (b1 - b0 + t * (b2 - b1))
                    to_w = to_q = 0.0
                    for k in range(3):
                        y[k] = surface[0, k] + a * surface[1, k] + b * surface[2, k]
                        to_w += (y[k] - w[k]) ** 2
                        to_q += (y[k] - q[k]) ** 2
                    total += weight[n, i] * weight[n, j] * s * area * y[1] ** 2 / (to_w * to_w * to_q * to_q)
    return total


@_compiled
def _hidden_at(w, lit, surface, shape, ball, corners, screens, rule, weight, n, ratio):
    """Return the light of one surface hidden from w, up to constants; ``lit`` holds patch points and their power."""
    normal = np.cross(surface[1], surface[2])
    area = math.sqrt((normal**2).sum())
    normal /= area
    from_w = abs((normal * (w - surface[0])).sum())
    sides, counts = np.empty((4, _CORNERS, 3)), np.zeros(4, np.int64)
    base, part, spare = np.empty((2 * _CORNERS, 2)), np.empty((2 * _CORNERS, 2)), np.empty((2 * _CORNERS, 2))
    stack = np.empty((64, 3, 2))
    counts[0] = _sides(w, shape, surface, sides[0]) if len(shape) else _cone(w, ball, surface, corners, sides[0])
    if len(screens):
        counts[2] = _sides(w, screens, surface, sides[2])
    total = 0.0
    for k in range(len(lit)):
        q = lit[k, :3]
        counts[1] = _sides(q, shape, surface, sides[1]) if len(shape) else _cone(q, ball, surface, corners, sides[1])
        if len(screens):
            counts[3] = _sides(q, screens, surface, sides[3])
        blocked = 0.0
        # Bits: behind the screen as seen from w, from q; then hidden by the target from w, from q or from both.
        for behind in range(4):
            if (behind & 1 and not counts[2]) or (behind & 2 and not counts[3]):
                continue
            base[0], base[1], base[2], base[3] = (0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)
            left = 4
            for s in range(2):
                if behind >> s & 1:
                    left = _clip(base, left, sides[2 + s], counts[2 + s], spare)
            if not left:
                continue
            outside = -1.0 if behind in (1, 2) else 1.0
            for hides in range(1, 4):
                if (hides & 1 and not counts[0]) or (hides & 2 and not counts[1]):
                    continue
                kept = left
                for i in range(left):
                    part[i] = base[i]
                for s in range(2):
                    if hides >> s & 1:
                        kept = _clip(part, kept, sides[s], counts[s], spare)
                if kept:
                    value = _exchange(part, kept, surface, w, q, rule, weight, n, ratio, stack)
                    blocked += outside * (-1.0 if hides == 3 else 1.0) * value
        total += blocked * lit[k, 3] * abs((normal * (q - surface[0])).sum())
    return total * from_w * area


@_compiled
def _hidden_picture(
    to_wall, width, height, lines, lit, surfaces, albedo, shape, ball, corners, screens, rule, weight, n, m, ratio
):
    out = np.zeros((height, width))
    pieces, w = np.empty((40, 4, 2)), np.empty(3)
    for row in range(height):
        for column in range(width):
            for piece in range(_pieces(to_wall, column, row, width, height, lines, pieces)):
                for i in range(m):
                    for j in range(m):
                        u, v, area = _quad_point(pieces[piece], rule[m, i], rule[m, j])
                        if area == 0.0:
                            continue
                        _wall_point(to_wall, u, v, w)
                        share = area * weight[m, i] * weight[m, j] * width * height
                        for k in range(len(surfaces)):
                            if albedo[k] > 0.0:
                                out[row, column] += (
                                    share
                                    * albedo[k]
                                    * _hidden_at(
                                        w, lit, surfaces[k], shape, ball, corners, screens, rule, weight, n, ratio
                                    )
                                )
    return out


def _lit_points(patch: Array, normal: Array | None, offset: float, n: int) -> Array:
    """Return points on the patch with their power, on either side of the line where a plane cuts it."""
    x, weight = leggauss(n)
    points = []
    for sign in (1.0, -1.0) if normal is not None else (1.0,):
        turned = np.zeros(3) if normal is None else sign * normal
        end, e, f, *_ = _segment(turned, sign * offset if normal is not None else -1.0, patch)
        if end == 0.0:
            continue
        t, s = np.meshgrid(end * (x + 1.0) / 2.0, x, indexing="ij")
        a, b = np.cos(t), np.sin(t) * s
        positions = patch[:3] + (a * e - b * f)[..., None] * patch[3:6] + (a * f + b * e)[..., None] * patch[6:9]
        power = np.outer(weight, weight) / 2.0 * end * np.sin(t) ** 2 * patch[12] * patch[14]
        power = power / np.linalg.norm(positions - patch[9:12], axis=-1) ** 3
        points.append(np.concatenate([positions, power[..., None]], axis=-1).reshape(-1, 4))
    return np.concatenate(points)


def hidden(world: World, position: Any, rotation: Any, fine: Fineness) -> Array:
    """Return the room's light that a sheet or a sphere hides, (height, width), W/m^2/sr.

    Parameters
    ----------
    world : World
        Its room is convex and each mesh of it a rectangle of two triangles; one rectangle may stand inside.
    position, rotation : array-like of shape (3,)
        Metres, degrees.
    fine : Fineness
    """
    rule, weight, n, ratio, *_ = fine.numbers()
    patch, view, body = patch_figures(world), world.watched, world.target[0]
    corners = np.concatenate([m.triangles.reshape(-1, 3) for m in world.room] + [view.points(np.eye(2))])
    surfaces, albedo, screens = [], [], np.zeros((0, 3))
    for mesh in world.room:
        a, b, c, d = mesh.triangles[0, 0], mesh.triangles[0, 1], mesh.triangles[0, 2], mesh.triangles[1, 2]
        surfaces.append(np.stack([a, b - a, d - a]))
        albedo.append(mesh.albedo[0, 0])
        above = (corners - a) @ np.cross(b - a, d - a)
        if above.min() < -1e-9 and above.max() > 1e-9:
            if len(screens):
                raise ValueError("the reference knows one partition")
            screens = np.stack([a, b, c, d])
    planes = []
    if isinstance(body, Sphere):
        shape, ball = (
            np.zeros((0, 3)),
            np.append(rotation_matrix(tuple(rotation)) @ body.centre + position, body.radius),
        )
        lit = _lit_points(patch, None, 0.0, n - 1)
    else:
        (face,) = faces(body.triangles @ rotation_matrix(tuple(rotation)).T + position)
        centre, e, f = face[:3], face[3:6], face[6:9]
        shape, ball = np.stack([centre - e - f, centre + e - f, centre + e + f, centre - e + f]), np.zeros(4)
        planes.append(np.append(face[9:12], -face[12]))
        lit = _lit_points(patch, face[9:12], face[12], 2 * n - 3)
    if len(screens):
        normal = np.cross(screens[1] - screens[0], screens[3] - screens[0])
        normal /= np.linalg.norm(normal)
        planes.append(np.append(normal, -normal @ screens[0]))
    width, height = view.resolution
    lines = np.array([plane @ view.to_wall for plane in planes]).reshape(-1, 3)
    total = _hidden_picture(
        view.to_wall,
        width,
        height,
        lines,
        lit,
        np.array(surfaces),
        np.array(albedo),
        shape,
        ball,
        fine.sides,
        screens,
        rule,
        weight,
        n - 2,
        n - 3 if len(shape) else n - 4,
        ratio,
    )
    return total * float(view.albedo[0]) / math.pi**2
