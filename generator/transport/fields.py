"""The functions on the wall that a picture is made of, each to a relative accuracy, for many poses at once.

Light that the target adds where nothing is in the way is a sum of smooth terms. Light that it adds where something
may be in the way, light of the room, and the part of it that the target hides contain shadows. These are cut out
exactly if flat surfaces are few. If they are many, or if a sphere is partly in shadow, rays are tested.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.model.errors import NlosError
from generator.transport import compiled, elements, gloss, integral, picture, shaded, traced
from generator.transport.lit import Rules
from generator.transport.prepared import Setting
from generator.transport.rays import Placed
from generator.transport.records import Boxes, Disc, Panels, Parts, Poses, Target
from generator.transport.shadows import shadowed
from generator.transport.shadows.cones import facets, ring

Floats = NDArray[Any]

Traced = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""Given owners (n,), wall points (n, 3) and the finest cell of each pose, return values (n, groups) and the number of
elements that each took."""

Shaded = Callable[[Floats, float, int], tuple[Floats, int]]
"""Given wall points (k, 3), the finest cell and the pose, return values (groups, k) and the number of elements."""

Summed = Callable[[Floats, Floats, Floats], Floats]
"""Given owners and boxes of panels and places on them, return values (panels, groups, places)."""

_SINGLE = 5e-5
"""Relative accuracy down to which sums are computed in single precision."""

_SPARE = 2.3
"""Quadrature rules are chosen by the rate at which they converge, which leaves a factor open: 5 at most in
`benchmarks/error_at_request.py`. This is the natural logarithm of that factor with a margin."""

_LOOSE = 2.0
"""Sums over ray tests jump from point to point by about the accuracy, which no polynomial follows: their panels are
cut only for errors above this multiple of the accuracy."""

_SLOPES = 10.0, 5e-3
"""Derivatives of shadows jump where a shadow's edge meets a corner of the room along its length: they are drawn to
the first number times the accuracy, and to no better than the second number."""

_HALVINGS = 8
"""Most times that the elements at shadows' edges are halved, starting from an eighth of the target."""
_DRAFT, _PATIENCE = 2, 4
"""The same for a draft; and without a compiler, for a room's own light, before its shadows are cut out instead. That
takes a thousand times as long as compiled, but sums over rays may take as long again for each further halving."""


CUT, _CUT_ROOM = 128, 40
"""Most flat surfaces whose shadows are cut out as polygons, and most of a room that shades its own light on the wall.
With up to some 200 a picture takes less time than with rays (`benchmarks/cutting.py`), but a background with 54 takes
five times as long."""


class Fields:
    """The functions on the wall of a setting, to an accuracy.

    Parameters
    ----------
    setting : Setting
    accuracy : float
        Relative accuracy, as for `render.Transport`.
    draft : bool, default=False
        Whether shadows' edges are refined `_DRAFT` times at most, and none is cut out.

    Attributes
    ----------
    few : bool
        Whether there are so few flat surfaces that shadows are cut out.
    """

    def __init__(self, setting: Setting, accuracy: float, *, draft: bool = False) -> None:
        self._setting, self._halvings = setting, _DRAFT if draft else _HALVINGS
        self._accuracy = accuracy
        self._digits = math.log(1.0 / accuracy)
        # A sphere's horizon, as seen from the wall, is a kink that no quadrature rule follows, and a jump of
        # derivatives, so it needs finer cells.
        finer = accuracy**-0.4
        self._rings = {False: max(2, math.ceil(0.2 * finer)), True: max(3, math.ceil(0.3 * finer))}
        self._rule = picture.Rule(6 if accuracy > 3e-3 else 8 if accuracy > 3e-5 else 12)
        # Where nothing is in the way a point on the wall costs little, but each further panel needs its own elements.
        self._free_rule = picture.Rule(8 if accuracy > 3e-3 else 10 if accuracy > 3e-5 else 12)
        self._light = shaded.Light(setting.patch, setting.whole, self._digits)
        self.few = not draft and max(len(setting.room.origin), len(setting.target.origin)) <= CUT
        self._first = np.argsort(~setting.obstacles.is_blocker, kind="stable")
        # A sphere's outline is replaced by a polygon of its area, whose error is of fourth order in the angle.
        sides = ring(12 if accuracy > 3e-3 else 24 if accuracy > 3e-4 else 48)
        self._room = shadowed.Room(
            facets(setting.room)[self._first], setting.room.tint[self._first], sides, setting.convex
        )
        # Widest cell where rays are tested, as a share of the target: an edge must not slip between its corners.
        self._widest = min(0.2, 0.25 * (100.0 * accuracy) ** (1.0 / 3.0))
        # For hidden light a quadrature point is a ray into the room, where light varies less than in the near field.
        self._shadow_digits = min(self._digits, 7.0)

    def plain(self, turns: Floats, places: Floats, moving: bool) -> tuple[Floats, list[dict[str, Any]]]:
        """Return the light that a convex target adds where nothing is in the way.

        Parameters
        ----------
        turns, places : ndarray of shape (n, 3, 3) and (n, 3)
        moving : bool
            Whether to compute derivatives.

        Returns
        -------
        pixels : ndarray of shape (n, groups, 1 or 7, height, width)
        reports : list of dict
        """
        setting, rule = self._setting, self._free_rule
        single = self._accuracy > _SINGLE and not moving
        # Derivatives are summed in double precision whatever this is.
        like = np.zeros(0, dtype=np.float32 if self._accuracy > _SINGLE else np.float64)
        n, groups, channels = len(places), setting.tint.shape[1], 7 if moving else 1
        most = np.zeros((n, 2))
        parts, wanted = setting.faces.parts(turns, places)
        arguments = (self._target(moving), Parts(turns, places, parts.picture, wanted), self._rules(_SPARE))

        def evaluate(owner: Floats, boxes: Floats) -> tuple[Floats, Floats]:
            values = np.empty((len(owner), groups, channels, len(rule.places)))
            reports = np.empty((len(owner), 4))
            panel_boxes = Boxes(owner, boxes, rule.places, setting.to_wall, like)
            compiled.in_parts(integral.panels, len(owner), panel_boxes, *arguments, values, reports)
            np.maximum.at(most, parts.picture[owner], reports[:, :2])
            return values.reshape(len(owner), groups * channels, -1), reports[:, 3] / reports[:, 2]

        shape, kin = self._shape(n, groups * channels), self._kin(groups, channels)
        pixels, panels = picture.draw(evaluate, rule, parts, shape, self._accuracy / 2.0, kin=kin)
        reports = [
            _report(panels, k)
            | {"elements": int(most[k, 0]), "patch_points": int(most[k, 1])}
            | {"precision": "float32" if single else "float64", "visibility": "free"}
            for k in range(n)
        ]
        pixels = pixels.reshape(n, groups, channels, *pixels.shape[2:])
        if setting.shine is not None:
            self._add_gloss(turns, places, pixels[:, :, 0], reports)
        return pixels, reports

    def _add_gloss(self, turns: Floats, places: Floats, pixels: Floats, reports: list[dict[str, Any]]) -> None:
        """Add to pixels (n, groups, height, width) what a glossy target sends where nothing is in the way."""
        setting, rule, n = self._setting, self._free_rule, len(places)
        assert setting.shine is not None
        most, like = np.zeros((n, 2)), np.zeros(0)
        parts, wanted = setting.faces.parts(turns, places)
        part_poses = Parts(turns, places, parts.picture, wanted)
        # A pole of the second order, where the rules of cells allow for one of the fourth, is spare enough.
        arguments = (gloss.Glossy(self._sharp(), setting.shine), part_poses, self._rules())

        def evaluate(owner: Floats, boxes: Floats) -> tuple[Floats, Floats]:
            values, found = np.empty((len(owner), pixels.shape[1], len(rule.places))), np.empty((len(owner), 4))
            panel_boxes = Boxes(owner, boxes, rule.places, setting.to_wall, like)
            compiled.in_parts(gloss.panels, len(owner), panel_boxes, *arguments, values, found)
            np.maximum.at(most, parts.picture[owner], found[:, :2])
            return values, found[:, 3] / found[:, 2]

        shape = self._shape(n, pixels.shape[1])
        light, panels = picture.draw(evaluate, rule, parts, shape, self._accuracy / 2.0)
        pixels += light
        for k, report in enumerate(reports):
            report |= {"gloss_panels": int(panels.count[k]), "gloss_elements": int(most[k, 0])}
            report["patch_points"] = max(report["patch_points"], int(most[k, 1]))

    def behind(self, turns: Floats, places: Floats) -> tuple[Floats, list[dict[str, Any]]]:
        """Return the light that a target adds if it may be partly hidden, by itself or by the room.

        Parameters
        ----------
        turns, places : ndarray of shape (n, 3, 3) and (n, 3)

        Returns
        -------
        pixels : ndarray of shape (n, groups, height, width)
        reports : list of dict
        """
        setting, n = self._setting, len(places)
        poses = self._shaded_poses(turns, places)
        cut = self.few and not len(setting.balls) and setting.shine is None
        if cut:
            pixels, panels, lost = self._received(self._target(), poses)
            pixels = pixels[:, :, 0]
            reports = [_report(panels, k) for k in range(n)]
        else:
            pixels, lost = np.zeros((n, setting.tint.shape[1], *setting.resolution[::-1])), np.ones(n, dtype=bool)
            reports = [{} for _ in range(n)]
        remaining = np.flatnonzero(lost)
        if len(remaining):
            evaluate = self._reflected_loops if self.few and compiled.COMPILED else self._reflected_arrays
            reflected = evaluate(self._sharp(), Poses(*(field[remaining] for field in poses)))
            pixels[remaining], panels, most = self._refined(
                reflected, len(remaining), setting.tint.shape[1], setting.target.extent
            )
            for k, pose in enumerate(remaining):
                reports[pose] = _report(panels, k) | {"elements": int(most[k])}
        for report, order, traced_by_rays in zip(reports, poses.orders, lost, strict=True):
            report["patch_points"] = int(order) ** 2
            report["precision"] = "float64"
            report["visibility"] = "rays" if traced_by_rays else "polygons"
        return pixels, reports

    def room(self) -> Floats:
        """Return the light that the room's own surfaces send to the watched patch, (groups, height, width)."""
        setting = self._setting
        poses = _poses(np.eye(3)[None], np.zeros((1, 3)))
        cells = self._target()._replace(
            flat=setting.room_cells, balls=np.zeros((0, elements.WIDTH)), albedo=setting.room.tint
        )
        evaluate, groups = self._reflected_arrays(cells, poses), cells.albedo.shape[1]
        summed = evaluate, 1, groups, setting.room.extent, None, 0.05
        if len(setting.room.origin) <= _CUT_ROOM:  # whatever the target, which is absent here
            if not compiled.COMPILED:
                on_panels, _, agree = self._settled(*summed, _PATIENCE)
                if agree:
                    return self._drawn(on_panels, 1, groups)[0][0]
            orders = np.full(1, self._light.order(setting.room.samples()), dtype=np.int64)
            pixels, _, lost = self._received(cells, poses._replace(orders=orders))
            if not lost.any():
                image: Floats = pixels[0, :, 0]
                return image
        return self._refined(*summed)[0][0]

    def hidden(self, turns: Floats, places: Floats, moving: bool, level: Floats) -> tuple[Floats, Floats]:
        """Return the light of the room that a target hides.

        Parameters
        ----------
        turns, places : ndarray of shape (n, 3, 3) and (n, 3)
        moving : bool
            Whether to compute derivatives.
        level : ndarray of shape (n, groups, 1 or 7)
            Mean square of the light that the target adds; errors are relative to it where it is larger.

        Returns
        -------
        pixels : ndarray of shape (n, groups, 1 or 7, height, width)
        panels : ndarray of shape (n,)
            Number of panels of each picture.

        Raises
        ------
        NlosError
            Derivatives are requested where shadows are not cut out as polygons.
        """
        setting, (n, groups, channels) = self._setting, level.shape
        pixels, panels = np.empty((n, groups, channels, *setting.resolution[::-1])), np.zeros(n, dtype=np.int64)
        lost = np.ones(n, dtype=bool)
        if self.few:
            arguments = (self._target(), self._shaded_poses(turns, places), self._room, self._rules(1.0))

            def cut(panels: Panels, values: Floats) -> None:
                compiled.in_parts(shadowed.hidden_panels, len(panels.owner), panels, *arguments, values)

            level = level.copy()
            level[:, :, 1:] *= max(_SLOPES[0], _SLOPES[1] / self._accuracy) ** 2
            pixels, drawn, lost = self._cut_out(cut, n, groups, channels, level.reshape(n, -1))
            panels = drawn.count
        remaining = np.flatnonzero(lost)
        if len(remaining):
            if moving:
                raise NlosError(f"derivatives: the room or the target has more than {CUT} surfaces")
            evaluate = self._hidden_arrays(turns[remaining], places[remaining])
            extent = setting.target.extent
            pixels[remaining, :, 0], drawn, _ = self._refined(
                evaluate, len(remaining), groups, extent, level[remaining, :, 0]
            )
            panels[remaining] = drawn.count
        return pixels, panels

    def _received(self, cells: Target, poses: Poses) -> tuple[Floats, picture.Panels, Floats]:
        """Return the light of flat cells that may hide each other, as `_cut_out` returns it."""
        rules = self._rules(1.0)

        def cut(panels: Panels, values: Floats) -> None:
            count = len(panels.owner)
            compiled.in_parts(shadowed.received_panels, count, panels, cells, poses, self._room, rules, values)

        return self._cut_out(cut, len(poses.places), cells.albedo.shape[1])

    def _cut_out(
        self,
        cut: Callable[[Panels, Floats], None],
        n: int,
        groups: int,
        channels: int = 1,
        level: Floats | None = None,
    ) -> tuple[Floats, picture.Panels, Floats]:
        """Draw fields whose shadows are cut out as polygons.

        Returns
        -------
        pixels : ndarray of shape (n, groups, channels, height, width)
        panels : picture.Panels
        lost : ndarray of shape (n,), bool
            Whether there were too many polygons.
        """
        lost = np.zeros(n, dtype=bool)

        def on_panels(owner: Floats, boxes: Floats) -> tuple[Floats, Floats]:
            walls = self._walls(boxes, self._rule.places).reshape(len(owner), -1, 3)
            values = np.empty((len(owner), groups, channels, walls.shape[1]))
            cut(Panels(owner, walls), values)
            broken = np.isnan(values).any(axis=(1, 2, 3))
            lost[owner[broken]] = True
            values[broken] = 0.0
            return values.reshape(len(owner), groups * channels, -1), np.zeros(len(owner))

        shape, kin = self._shape(n, groups * channels), self._kin(groups, channels)
        parts, accuracy = picture.Parts.whole(n), self._accuracy / 2.0
        pixels, panels = picture.draw(on_panels, self._rule, parts, shape, accuracy, level=level, kin=kin)
        return pixels.reshape(n, groups, channels, *pixels.shape[2:]), panels, lost

    def _kin(self, groups: int, channels: int) -> Callable[[Floats], Floats] | None:
        """Return the function for the norms that errors of derivatives are relative to; None without derivatives.

        These are the largest over the three directions, and over the three axes: the derivative for one alone may
        almost vanish, as for a ball that turns. A turn is also measured by the shift of the target's rim.
        """
        if channels == 1:
            return None
        reach = self._setting.target.reach

        def largest(norm: Floats) -> Floats:
            by_group = norm.reshape(len(norm), groups, channels).copy()
            shifts = by_group[:, :, 1:4].max(axis=2, keepdims=True)
            by_group[:, :, 1:4] = shifts
            by_group[:, :, 4:] = np.maximum(by_group[:, :, 4:].max(axis=2, keepdims=True), shifts * reach**2)
            return by_group.reshape(norm.shape)

        return largest

    def _shape(self, n: int, channels: int) -> tuple[int, int, int, int]:
        width, height = self._setting.resolution
        return n, channels, height, width

    def _rules(self, spare: float = 0.0) -> Rules:
        """Return the quadrature rules, finer than the accuracy by ``spare`` natural logarithms."""
        setting = self._setting
        return Rules(setting.patch, setting.whole, setting.chords, elements.GAUSS, self._digits + spare)

    def _target(self, moving: bool = False) -> Target:
        setting = self._setting
        return Target(setting.flat, setting.balls, setting.tint, setting.faces.of, self._rings[moving])

    def _sharp(self) -> Target:
        """Return the target with cells as fine as its gloss requires."""
        shine, target = self._setting.shine, self._target()
        if shine is None:
            return target
        flat, balls = target.flat.copy(), target.balls.copy()
        flat[:, elements.SHARP], balls[:, elements.SHARP] = np.split(shine.sharp, [len(flat)])
        return target._replace(flat=flat, balls=balls)

    def _shaded_poses(self, turns: Floats, places: Floats) -> Poses:
        return Poses(turns, places, self._hiders(turns, places), self._orders(places))

    def _hiders(self, turns: Floats, places: Floats) -> Floats:
        """Return how many of the room's surfaces can stand in the way at each pose: static blockers, or all."""
        obstacles = self._setting.obstacles
        counts = [len(obstacles.blockers(p, t).origin) for p, t in zip(places, turns, strict=True)]
        few = int(obstacles.is_blocker.sum())
        return np.array([few if n == few else len(self._first) for n in counts], dtype=np.int64)

    def _orders(self, places: Floats) -> Floats:
        """Return, for each pose, the order of the patch's rule where each of its points throws its own shadow."""
        reach = self._setting.target.reach
        room = self._light.order(self._setting.room.samples())
        return np.array([max(room, self._light.order(p[None], reach)) for p in places], dtype=np.int64)

    def _reflected_loops(self, shape: Target, poses: Poses) -> Traced:
        setting = self._setting
        room, target = traced.rows(setting.room)[self._first], traced.rows(setting.target)
        obstacles = traced.Obstacles(room, target, setting.target.spheres, setting.convex)
        widest = self._widest * setting.target.extent

        glossy = gloss.Glossy(shape, setting.shine or gloss.none(*shape.albedo.shape))

        def evaluate(owner: Floats, walls: Floats, finest: Floats) -> tuple[Floats, Floats]:
            values = np.empty((len(owner), shape.albedo.shape[1] + 1))
            arguments = (traced.Points(owner, walls, finest, widest), glossy, poses, obstacles, self._rules())
            compiled.in_parts(traced.reflected_points, len(owner), *arguments, values)
            return values[:, :-1], values[:, -1]

        return evaluate

    def _reflected_arrays(self, shape: Target, poses: Poses) -> Traced:
        setting, rules = self._setting, self._rules()
        is_room = shape.flat is setting.room_cells
        wanted, faced = np.ones(len(shape.albedo), np.int64), integral.around_patch(setting.patch)

        def at_pose(wall: Floats, finest: float, pose: int) -> tuple[Floats, int]:
            turn, place = poses.turns[pose], poses.places[pose]
            hiders: list[shaded.Hider] = [setting.obstacles.blockers(place, turn)]
            if not is_room and not setting.convex:
                hiders.append(Placed(setting.target, turn, place))
            seen = integral.Seen(faced, _around(wall), rules, finest)
            points = integral.cover(shape, turn, place, seen, wanted)
            values = shaded.reflected(wall, points, shape.albedo, self._light, hiders)
            if setting.shine is not None and not is_room:
                values += shaded.shone(wall, points, setting.shine, self._light, hiders)
            return values, len(points)

        return _arrays(at_pose, shape.albedo.shape[1])

    def _hidden_arrays(self, turns: Floats, places: Floats) -> Traced:
        setting, target = self._setting, self._target()
        rules = self._rules()._replace(digits=self._shadow_digits)
        wanted, patch = np.ones_like(setting.faces.of), integral.around_patch(setting.patch)

        def at_pose(wall: Floats, finest: float, pose: int) -> tuple[Floats, int]:
            turn, place = turns[pose], places[pose]
            view = _around(wall)
            seen, lit = (
                integral.cover(target, turn, place, integral.Seen(faced, view, rules, finest), wanted)
                for faced in (view, patch)
            )
            blockers, hiders = [setting.obstacles.blockers(place, turn)], [Placed(setting.target, turn, place)]
            values = shaded.hidden(
                wall, seen, lit, setting.room, blockers, hiders, self._light, convex=setting.convex
            )
            return values, len(seen) + len(lit)

        return _arrays(at_pose, setting.room.tint.shape[1])

    def _refined(
        self, evaluate: Traced, n: int, groups: int, extent: float, level: Floats | None = None, care: float = 0.5
    ) -> tuple[Floats, picture.Panels, Floats]:
        """Draw fields of sums over ray tests, refined until two resolutions of the shadows' edges agree.

        ``level`` (n, groups) is a mean square that errors are relative to where it is larger than the field's own;
        two resolutions agree if they differ by at most ``care`` times the accuracy.
        """
        on_panels, most, _ = self._settled(evaluate, n, groups, extent, level, care, self._halvings)
        return (*self._drawn(on_panels, n, groups, level), most)

    def _drawn(
        self, on_panels: Summed, n: int, groups: int, level: Floats | None = None
    ) -> tuple[Floats, picture.Panels]:
        """Draw fields that `_settled` has refined."""
        return picture.draw(
            lambda owner, boxes: (on_panels(owner, boxes, self._rule.places), np.zeros(len(owner))),
            *(self._rule, picture.Parts.whole(n), self._shape(n, groups), _LOOSE * self._accuracy),
            level=level,
        )

    def _settled(
        self, evaluate: Traced, n: int, groups: int, extent: float, level: Floats | None, care: float, halvings: int
    ) -> tuple[Summed, Floats, bool]:
        """Refine as `_refined` does; return the field on panels, most elements of each, and whether they agree."""
        finest, most = np.full(n, extent / 8.0), np.zeros(n)

        def on_panels(owner: Floats, boxes: Floats, places: Floats) -> Floats:
            panels = len(owner)
            walls = self._walls(boxes, places)
            point_owner = np.repeat(owner, len(places))
            values, used = evaluate(point_owner, walls, finest)
            np.maximum.at(most, point_owner, used)
            return np.moveaxis(values.reshape(panels, -1, groups), 2, 1)

        whole = np.tile([0.0, 1.0, 0.0, 1.0], (n, 1))
        probes = picture.Rule(4)
        rough = np.arange(n)
        previous = on_panels(rough, whole, probes.places)
        for _ in range(halvings):
            finest[rough] /= 2.0
            values = on_panels(rough, whole[rough], probes.places)
            change, norm = probes.mean_square(values - previous), probes.mean_square(values)
            if level is not None:
                norm = np.maximum(norm, level[rough])
            keep = (change > (care * self._accuracy) ** 2 * norm).any(axis=1)
            rough, previous = rough[keep], values[keep]
            if not len(rough):
                break
        return on_panels, most, not len(rough)

    def _walls(self, boxes: Floats, places: Floats) -> Floats:
        """Return the wall points (panels * points, 3) at places of panels."""
        low, high = boxes[:, None, 0::2], boxes[:, None, 1::2]
        homogeneous = np.ones((len(boxes), len(places), 3))
        homogeneous[:, :, :2] = low + places * (high - low)
        homogeneous = homogeneous.reshape(-1, 3) @ self._setting.to_wall.T
        return np.column_stack([homogeneous[:, :2] / homogeneous[:, 2:], np.zeros(len(homogeneous))])


def _around(wall: Floats) -> Disc:
    """Return a disc around wall points."""
    middle = wall[:, :2].mean(axis=0)
    return Disc(np.append(middle, 0.0), float(np.linalg.norm(wall[:, :2] - middle, axis=1).max()))


def _poses(turns: Floats, places: Floats) -> Poses:
    """Return poses with nothing in their way."""
    return Poses(turns, places, np.zeros(len(places), dtype=np.int64), np.ones(len(places), dtype=np.int64))


def _arrays(some: Shaded, groups: int) -> Traced:
    """Return a function for wall points of many poses, from one for the points of a single pose."""

    def evaluate(owner: Floats, walls: Floats, finest: Floats) -> tuple[Floats, Floats]:
        values, used = np.empty((len(owner), groups)), np.empty(len(owner))
        for pose in np.unique(owner):
            indices = np.flatnonzero(owner == pose)
            light, count = some(walls[indices], float(finest[pose]), int(pose))
            values[indices], used[indices] = light.T, count
        return values, used

    return evaluate


def _report(panels: picture.Panels, k: int) -> dict[str, Any]:
    return {"panels": int(panels.count[k]), "depth": int(panels.depth[k])}
