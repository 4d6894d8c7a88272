"""The transport engine: a world and an accuracy in, pictures of the relay wall out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.model.arrays import Array, rotation_matrix, rotation_rows
from generator.model.errors import NlosError
from generator.transport import compiled, direct, picture
from generator.transport.fields import Fields
from generator.transport.light.change import Followed, LightChange
from generator.transport.light.field import LightField
from generator.transport.light.picture_points import drawn
from generator.transport.prepared import Setting
from generator.transport.world import World

Floats = NDArray[Any]
Picture = NDArray[np.float32]

FINEST, COARSEST = 1e-8, 0.3
"""Smallest and largest accuracy that can be requested."""

_BATCH = 128
"""Number of pictures drawn together: with more, memory is not reused but fetched anew, page by page."""


@dataclass(frozen=True)
class Rendered:
    """One picture and what it is made of; radiance in W/m^2/sr, shape (height, width, 3), float64.

    Attributes
    ----------
    pixels : ndarray
        What the camera sees: ``background + added - hidden + further + ambient + emitted``.
    added : ndarray
        Light of the lamp that took its second reflection on the target, and its third on the wall.
    hidden : ndarray
        Light of the lamp, after its second reflection on the room, that the target hides from the wall.
    further : ndarray
        Change of the lamp's light after more than three reflections.
    ambient : ndarray
        Change of the sky's light by the target; zero where there is none.
    emitted : ndarray
        Change by the target of the light of other lamps and of surfaces that glow; zero where there are none.
    derivatives : ndarray of shape (7, height, width, 3), optional
        Derivatives of ``pixels`` with respect to the target's position (3, per metre), its rotation about the world's
        axes through its origin (3, per radian), and its strength (a factor on all its albedo).
    report : dict
        What the engine chose: ``panels`` (of the picture), ``depth`` (how often the smallest was cut), ``elements``
        (most points on the target for one panel), ``patch_points`` (most on the lit patch), ``precision`` (float32 or
        float64), ``visibility`` ("free": nothing is in the way; "polygons": shadows are cut out; "rays": they are
        tested ray by ray), ``shadow_panels`` (panels of ``hidden``). Of light of more than three reflections, of a
        sky and of other lamps: ``lines`` (by source, how many through the target it took), ``lines_error`` (the
        largest root mean square error by them, relative to the parts of the change joined as squares, of all
        sources'; above 0.6 times the accuracy where the most lines did not get below that).
    """

    pixels: Array
    added: Array
    hidden: Array
    further: Array
    ambient: Array
    emitted: Array
    derivatives: Array | None
    report: dict[str, Any]


@dataclass(frozen=True)
class Gains:
    """Factors on a world's reflectivities and lamp, one a picture; each of shape (n,).

    With at most three reflections and no ambient light, radiance is a product of these along each path: lamp and wall
    (order 1), or lamp, wall, target or room, and wall again (order 3).

    Attributes
    ----------
    target, wall, room, lamp : ndarray of shape (n,)
        On the albedo of the target, of the relay wall and of all other surfaces, and on the lamp's intensity.
    """

    target: Array
    wall: Array
    room: Array
    lamp: Array


class Transport:
    """Pictures of the relay wall after diffuse reflections, to a relative accuracy.

    Parameters
    ----------
    world : World
    accuracy : float, default=1e-3
        Root mean square error over the pixels: of the light that the target adds and hides, relative to the root mean
        square of the light that it adds; of the background, relative to the background.
    threads : int, default=0
        0 uses all cores. The pixels do not depend on it.
    like : Transport, optional
        Engine of the same scene with another target, and as accurate; its results for the empty scene are reused.
    draft : bool, default=False
        Whether edges of shadows are left as they are after a glance, for a picture to look at: errors of some per
        cent where much is hidden. Without a compiler, this takes a tenth of the time.

    Raises
    ------
    NlosError
        The accuracy is out of reach, or the target has no surface.

    Notes
    -----
    The picture is the integral of section 3.1 of the paper, with Lambert's cosines on both sides of both legs
    (Kajiya 1986, equation 8, for two surfaces):

        L(w2) = rho_2/pi int [ rho_x/pi int L_1(w1) G(w1, x) dw1 ] G(x, w2) dx,  G(a, b) = cos_a cos_b V / |a - b|^2

    Examples
    --------
    >>> transport = Transport(world, accuracy=1e-3)                        # doctest: +SKIP
    >>> picture = transport.render((1.0, 0.8, 1.3), (0.0, 0.0, 30.0))      # doctest: +SKIP
    >>> (picture.added - picture.hidden).max()                             # doctest: +SKIP
    """

    def __init__(
        self,
        world: World,
        *,
        accuracy: float = 1e-3,
        threads: int = 0,
        like: Transport | None = None,
        draft: bool = False,
    ) -> None:
        if not FINEST <= accuracy <= COARSEST:
            raise NlosError(f"accuracy: {accuracy:g} must lie between {FINEST:g} and {COARSEST:g}")
        self.world = world
        self.accuracy = accuracy
        self._threads = threads
        self._setting = Setting(world)
        self._fields = Fields(self._setting, accuracy, draft=draft)
        self._background: Array | None = None
        self._field: LightField | None = None
        if like is not None and like._setting.tint.shape[1] == self._setting.tint.shape[1]:
            self._background, self._field = like._background, like._field
        if world.is_followed_on:
            self._field = self._field or LightField(self._setting, world.order, accuracy)
        self._change = LightChange(self._setting, self._field, accuracy) if self._field else None
        self._coarser: LightChange | None = None

    def background(self, *, ambient: bool = True) -> Array:
        """Return the picture without the target, (height, width, 3), W/m^2/sr: room, and lit patch where in view.

        Parameters
        ----------
        ambient : bool, default=True
            Whether to include the sky's light.
        """
        if not ambient and self.world.ambient is not None:
            return self.background() - self._followed("sky")
        if self._background is None:
            compiled.limit_threads(self._threads)
            self._background = self.directly_lit()
            if self.world.order >= 3 and len(self._setting.room):
                self._background = self._background + self._colour(self._fields.room())
            for name in self._field.sources if self._field else ():
                self._background = self._background + self._followed(name)
        return self._background.copy()

    def _followed(self, name: str) -> Array:
        """Return the light of a source in the empty room, as `LightField` follows it, (height, width, 3)."""
        assert self._field is not None
        light = drawn(self._field.background(name), self._setting.resolution)
        if name == "emitters" and self._field.shadow is not None:
            light = light + self._field.shadow.unshadowed()
        return self._of_source(name, light)

    def render(self, position: Any, rotation: Any, *, derivatives: bool = False) -> Rendered:
        """Return the picture with the target at a pose.

        Parameters
        ----------
        position : array-like of shape (3,)
            Position of the target's origin, metres.
        rotation : array-like of shape (3,)
            Rotation about x, then y, then z, degrees.
        derivatives : bool, default=False
            Whether to compute the picture's derivatives.

        Returns
        -------
        Rendered

        Raises
        ------
        NlosError
            The target reaches through the relay wall, lies in it, stands in the lamp's cone or the camera's view, or
            may enclose a lamp.
        """
        added, hidden, reports = self._render(np.array([position], float), np.array([rotation], float), derivatives)
        light = self._colour(added[0, :, 0])
        shade = self._colour(hidden[0, :, 0])
        slopes = None
        if derivatives:
            # Positions are in the unit of the wall's frame; positions and rotations are along its axes.
            moves = np.stack([self._colour(added[0, :, 1 + k] - hidden[0, :, 1 + k]) for k in range(6)])
            strength = light
            if self._change is not None:
                known = (added[0, :, 0] - hidden[0, :, 0]) / math.pi
                for name, more in self._change.slopes(*self._placed(position, rotation), known).items():
                    moves = moves + np.stack([self._of_source(name, more[k]) for k in range(6)])
                    strength = strength + self._of_source(name, more[6])
            turned = np.tensordot(self._setting.frame.axes.T, moves.reshape(2, 3, *light.shape), axes=(1, 1))
            slopes = np.concatenate([turned[:, 0] / self._setting.frame.unit, turned[:, 1], strength[None]])
        followed = self._follow(position, rotation, added[0, :, 0] - hidden[0, :, 0])
        if followed:
            reports[0]["lines"] = {name: one.choice.lines for name, one in followed.items()}
            reports[0]["lines_error"] = max(one.error for one in followed.values())
        changed = {name: self._of_source(name, one.picture) for name, one in followed.items()}
        further, sky, emitted = (changed.get(name, np.zeros_like(light)) for name in ("lamp", "sky", "emitters"))
        pixels = self.background() + light - shade + further + sky + emitted
        return Rendered(pixels, light, shade, further, sky, emitted, slopes, reports[0])

    def difference(self, position: Any, rotation: Any, *, shadows: bool = True) -> Array:
        """Return the change due to the target at a pose, (height, width, 3), W/m^2/sr: picture minus background.

        Takes less time than `render`, which needs the background.

        Parameters
        ----------
        position, rotation : array-like of shape (3,)
            As for `render`.
        shadows : bool, default=True
            Whether to subtract the light of the room that the target hides from the wall.

        Raises
        ------
        NlosError
            In the same cases as `render`.
        """
        added, hidden, _ = self._render(np.array([position], float), np.array([rotation], float), False, shadows)
        exact = added[0, :, 0] - hidden[0, :, 0]
        return sum(self._changed(position, rotation, exact, shadows).values(), start=self._colour(exact))

    def pictures(self, positions: Any, rotations: Any, *, shadows: bool = True) -> Picture:
        """Return the pictures of many poses, (n, height, width, 3), float32, W/m^2/sr.

        Parameters
        ----------
        positions : array-like of shape (n, 3)
            Metres.
        rotations : array-like of shape (n, 3)
            Degrees.
        shadows : bool, default=True
            Whether to subtract the light of the room that the target hides from the wall; without it, the pictures
            take a fraction of the time.

        Raises
        ------
        NlosError
            In the same cases as `render`.
        """
        places, turns = np.asarray(positions, float).reshape(-1, 3), np.asarray(rotations, float).reshape(-1, 3)
        width, height = self.world.watched.resolution
        images = np.empty((len(places), height, width, 3), dtype=np.float32)
        self.background()  # computed before threads start
        threads, n = compiled.limit_threads(self._threads), len(places)
        # Of many poses, each thread draws whole pictures, so that threads seldom wait for each other. Of few poses,
        # the work for each is divided; likewise where a library tests the rays, which has threads of its own.
        shared = threads > 1 and n >= 32 * threads and self._fields.few
        size = min(_BATCH, math.ceil(n / (4 * threads))) if shared else _BATCH
        starts = list(range(0, n, size))

        def draw_batches(first: int, last: int) -> None:
            for start in starts[first:last]:
                self._coloured(
                    images[start : start + size], places[start : start + size], turns[start : start + size], shadows
                )

        if shared:
            compiled.in_parts(draw_batches, len(starts))
        else:
            draw_batches(0, len(starts))
        return images

    def varied(
        self, positions: Any, rotations: Any, gains: Gains, *, shadows: bool = True
    ) -> tuple[Picture, Picture]:
        """Return pictures of many poses in worlds that differ by `Gains`, and the background of each.

        Parameters
        ----------
        positions, rotations, shadows
            As for `pictures`.
        gains : Gains

        Returns
        -------
        pictures, backgrounds : ndarray of shape (n, height, width, 3), float32
            Radiance, W/m^2/sr.

        Raises
        ------
        NlosError
            In the same cases as `render`; or there is ambient light, or light of more than three reflections, whose
            paths the gains do not describe.
        """
        if self._change is not None:
            raise NlosError(
                "gains: describe neither ambient light nor more than three reflections; make a world and a Transport "
                "for each picture"
            )
        places, turns = np.asarray(positions, float).reshape(-1, 3), np.asarray(rotations, float).reshape(-1, 3)
        width, height = self.world.watched.resolution
        pictures, backgrounds = np.empty((2, len(places), height, width, 3), dtype=np.float32)
        direct = self.directly_lit()
        indirect = self.background() - direct
        for start in range(0, len(places), _BATCH):
            rows = slice(start, start + _BATCH)
            added, hidden, _ = self._render(places[rows], turns[rows], False, shadows)
            for k, (light, shade) in enumerate(zip(added[:, :, 0], hidden[:, :, 0], strict=True), start=start):
                once, thrice = gains.lamp[k] * gains.wall[k], gains.lamp[k] * gains.wall[k] ** 2
                empty = once * direct + thrice * gains.room[k] * indirect
                change = gains.target[k] * self._colour(light) - gains.room[k] * self._colour(shade)
                backgrounds[k], pictures[k] = empty, empty + thrice * change
        return pictures, backgrounds

    def _coloured(self, made: Picture, positions: Floats, rotations: Floats, shadows: bool) -> None:
        """Write the pictures of some poses."""
        setting = self._setting
        added, hidden, _ = self._render(positions, rotations, False, shadows)
        channel, light, shade = np.array(setting.channel, dtype=np.int64), added[:, :, 0], hidden[:, :, 0]
        arguments = (made, self._background, light, shade, channel, setting.factor)
        compiled.in_parts(picture.colour, len(made), *arguments)
        if self._change is None:
            return

        def follow(start: int, stop: int) -> None:
            for k in range(start, stop):
                for change in self._changed(positions[k], rotations[k], light[k] - shade[k], shadows).values():
                    made[k] += change

        compiled.in_parts(follow, len(made))

    def _colour(self, groups: Floats) -> Array:
        """Return the radiance (height, width, 3) of relative pictures (groups, height, width)."""
        return self._times(groups, self._setting.factor)

    def _of_source(self, name: str, groups: Floats) -> Array:
        """Return the radiance of pictures of a source's light, as `LightField` has it."""
        setting = self._setting
        if name == "lamp":
            return self._times(groups, math.pi * setting.factor)
        if name == "emitters" and setting.emission is not None:
            return self._times(groups, setting.emission.colour)
        assert setting.sky is not None
        return self._times(groups, setting.sky)

    def _times(self, groups: Floats, factors: Array) -> Array:
        coloured: Array = np.stack(
            [groups[g] * f for g, f in zip(self._setting.channel, factors, strict=True)], axis=-1
        )
        return coloured

    def _changed(self, position: Any, rotation: Any, exact: Floats, shadows: bool = True) -> dict[str, Array]:
        """Return, for each source that is followed on, the change of its light by the target, W/m^2/sr.

        ``exact`` (groups, height, width) is what is known of the lamp's.
        """
        followed = self._follow(position, rotation, exact, shadows)
        return {name: self._of_source(name, one.picture) for name, one in followed.items()}

    def _follow(
        self, position: Any, rotation: Any, exact: Floats, shadows: bool = True, by: LightChange | None = None
    ) -> dict[str, Followed]:
        """As `_changed`, relative, and with the error by lines; ``by`` replaces the engine's own cells."""
        by = by or self._change
        if by is None:
            return {}
        placed = self._placed(position, rotation)
        if by.may_enclose_a_lamp(*placed):
            where = ", ".join(f"{v:g}" for v in position)
            raise NlosError(
                f"pose ({where}): the target may enclose a lamp or a surface that glows; use --engine patch"
            )
        return by.followed(*placed, exact / math.pi, shadows=shadows)

    def light_error(self, position: Any, rotation: Any) -> float:
        """Estimate the error of light of many reflections at a pose, relative to what the target changes.

        Light after the third reflection, of the sky and of other lamps is followed from cell to cell of the room
        (`light.field.LightField`), and along lines through the target. For the cells' error stands what cells larger
        by the root of two change, small ones where the target is near a surface too: as much as that if it falls with
        their size squared, 2.4 times that if with their size. To its square that of the lines' error is added
        (`Rendered.report`).

        Parameters
        ----------
        position, rotation : sequence of 3 floats
            Metres, and degrees about x, then y, then z.

        Returns
        -------
        float
            Root mean square over the pixels, relative to that of the parts of the change, joined as squares; 0 where
            no light is followed from cell to cell.

        Raises
        ------
        NlosError
            As `render`.
        """
        if self._change is None:
            return 0.0
        if self._coarser is None:
            field = LightField(self._setting, self.world.order, self.accuracy, math.sqrt(2.0))
            self._coarser = LightChange(self._setting, field, self.accuracy)
        added, hidden, _ = self._render(np.array([position], float), np.array([rotation], float), moving=False)
        exact = (added - hidden)[0, :, 0]
        followed = [self._follow(position, rotation, exact, by=by) for by in (self._change, self._coarser)]
        one, other = ({name: self._of_source(name, f.picture) for name, f in every.items()} for every in followed)
        parts = [self._colour(exact), *one.values()]
        off = sum((one[name] - other[name] for name in one), start=np.zeros_like(parts[0]))
        cells = math.sqrt(float((off**2).mean()) / max(sum(float((p**2).mean()) for p in parts), 1e-300))
        return math.hypot(cells, max(one.error for one in followed[0].values()))

    def _placed(self, position: Any, rotation: Any) -> tuple[Floats, Floats]:
        """Return a pose as rotation (3, 3) and place (3,) in the wall's frame."""
        frame = self._setting.frame
        return frame.axes @ rotation_matrix(rotation), frame.points(np.asarray(position, float))

    def _render(
        self, positions: Floats, rotations: Floats, moving: bool, shadows: bool = True
    ) -> tuple[Floats, Floats, list[dict[str, Any]]]:
        """Return relative pictures, added and hidden (n, groups, 1 or 7, h, w), and a report for each pose."""
        setting, fields = self._setting, self._fields
        width, height = setting.resolution
        groups, channels = setting.tint.shape[1], 7 if moving else 1
        n = len(positions)
        added, hidden = np.zeros((2, n, groups, channels, height, width))
        reports: list[dict[str, Any]] = [{} for _ in range(n)]
        if not np.isfinite(positions).all() or not np.isfinite(rotations).all():
            raise NlosError("a pose's position or rotation is not finite")
        if self.world.order < 3:
            return added, hidden, reports
        compiled.limit_threads(self._threads)
        turns = setting.frame.axes @ np.moveaxis(np.array(rotation_rows(np.radians(rotations.T))), 2, 0)
        places = setting.frame.points(positions)
        setting.obstacles.refuse(places, turns, positions)
        tested = np.array(
            [not setting.convex or setting.obstacles.may_hide(p, t) for p, t in zip(places, turns, strict=True)]
        )
        clear, behind = np.flatnonzero(~tested), np.flatnonzero(tested)
        if len(clear):
            free, pose_reports = fields.plain(turns[clear], places[clear], moving)
            if len(behind):
                added[clear] = free
            else:
                added = free
            for k, report in zip(clear, pose_reports, strict=True):
                reports[k] = report
        if setting.shine is not None and moving:
            raise NlosError("derivatives: are known only of a diffuse target, and this one is glossy")
        if len(behind):
            if moving:
                raise NlosError(
                    "derivatives: are known only where nothing stands between wall and target, and the target is one "
                    "convex body or one flat sheet"
                )
            added[behind, :, 0], pose_reports = fields.behind(turns[behind], places[behind])
            for k, report in zip(behind, pose_reports, strict=True):
                reports[k] = report
        if len(setting.room) and shadows:
            level = (added**2).mean(axis=(3, 4))
            hidden, counts = fields.hidden(turns, places, moving, level)
            for report, count in zip(reports, counts, strict=True):
                report["shadow_panels"] = int(count)
        return added, hidden, reports

    def directly_lit(self) -> Array:
        """Return the picture of the lit patch itself, where the camera sees it: one reflection."""
        setting = self._setting
        relative = direct.draw(setting.to_wall, setting.patch, setting.resolution, self.accuracy)
        lit: Array = relative[..., None] * setting.wall_radiance
        return lit
