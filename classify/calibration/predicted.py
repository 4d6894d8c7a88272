"""Pictures that the engine predicts of a scene as its uncertain values change, and their derivatives."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.transport import Transport, World
from generator.transport.parameters import OFFSETS, mean_albedo, with_parameters

CAMERA = ("level", "black", "vignetting")
"""What the camera does to a picture: a relative change of all light; a constant, in units of the mean of the empty
scene's picture; and the share of light that is missing in the corners, which grows as the square of the distance from
the middle."""

_STEP = 0.5
"""Steps of central differences, in standard deviations of what is known beforehand."""
_MOST = 0.99
"""Largest share of a value that can be missing."""
_KEPT = 100
"""Pictures whose light is remembered."""
_ENGINES = 3
"""Engines that are kept: each holds the light of a whole room."""
_OUTSIDE = ("camera.location.x", "camera.location.y", "camera.location.z")
"""What no picture depends on: the view is given on the wall, which looks alike from everywhere."""

Offsets = Mapping[str, float]


@dataclass(frozen=True)
class Placed:
    """Where the object stands in a picture.

    Attributes
    ----------
    position, rotation : (float, float, float)
        Metres, and degrees about x, then y, then z.
    """

    position: Vector
    rotation: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Light:
    """The light of a picture by what it is proportional to, each (height, width)."""

    direct: Array
    room: Array
    target: Array
    sky: Array


class Predicted:
    """Grey pictures, W/m^2/sr, of the empty scene and of the object at some places, by what is off in the scene.

    Parameters
    ----------
    world : World
        The scene as it is thought to be.
    places : sequence of Placed
        Of the pictures with the object; the first picture is always the empty scene's.
    accuracy : float, default=1e-3
        Relative accuracy of the engine.
    seen : callable, optional
        Returns pictures (n, height, width) as the lens gives them, as `Sensor.blurred` does.
    """

    def __init__(
        self,
        world: World,
        places: Sequence[Placed] = (),
        *,
        accuracy: float = 1e-3,
        seen: Callable[[Array], Array] = lambda pictures: pictures,
    ) -> None:
        self.world, self.places, self._accuracy, self._seen = world, tuple(places), accuracy, seen
        self._lights: OrderedDict[object, _Light] = OrderedDict()
        self._engines: OrderedDict[object, Transport] = OrderedDict()
        # With three reflections of one lamp, radiance is a product of albedos along each path.
        self._factors = () if world.is_followed_on else ("wall.albedo", "room.albedo", "target.albedo")
        self._strengths = () if world.emitters is not None else ("spot.power", "ambient")
        width, height = world.watched.resolution
        u, v = np.meshgrid((np.arange(width) + 0.5) / width - 0.5, (np.arange(height) + 0.5) / height - 0.5)
        self._outwards = ((u * width) ** 2 + (v * height) ** 2) / (0.25 * (width**2 + height**2))
        self._mean = float(self._pictured({}, (1.0, 1.0, 1.0), 0).mean())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all that may be off: of the scene, the camera, and the objects' places (``place.1.x``)."""
        missing = {"ambient"} if self.world.ambient is None else set()
        missing |= set() if mean_albedo(self.world.room) else {"room.albedo"}
        missing |= {"target.albedo"} if self.world.is_glossy else set()
        scene = [name for name in OFFSETS if name not in missing]
        return (*scene, *CAMERA, *(f"place.{k + 1}.{axis}" for k in range(len(self.places)) for axis in "xyz"))

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the least and the largest offset of a value that can be."""
        world = self.world
        surfaces = {"room.albedo": world.room, "target.albedo": world.target}
        if name == "wall.albedo":
            wall = world.watched.albedo
            return -_MOST * float(wall.mean()), float(wall.mean() * (1.0 / wall.max() - 1.0))
        if name in surfaces:
            mean, largest = mean_albedo(surfaces[name]), max(float(body.albedo.max()) for body in surfaces[name])
            return -_MOST * mean, mean * (1.0 / largest - 1.0)
        if name in ("spot.power", "target.size", "ambient", "level"):
            return -_MOST, math.inf
        if name == "spot.half_angle":
            return -_MOST * math.degrees(math.acos(world.patch.cos_outer)), math.inf
        return (-math.inf, _MOST) if name == "vignetting" else (-math.inf, math.inf)

    def changed(self, offsets: Offsets) -> World:
        """Return the scene with what is off in it."""
        return with_parameters(self.world, {name: x for name, x in offsets.items() if name in OFFSETS})

    def pictures(self, offsets: Offsets) -> Array:
        """Return all pictures, (n, height, width), W/m^2/sr.

        Raises
        ------
        NlosError
            The scene cannot be so (`with_parameters`), or the object cannot stand there.
        """
        factors = self._albedos(self.changed(offsets))
        light = np.stack([self._pictured(offsets, factors, k) for k in range(1 + len(self.places))])
        made: Array = self._shade(offsets) * self._seen(light) + offsets.get("black", 0.0) * self._mean
        return made

    def slopes(self, offsets: Offsets, deviations: Mapping[str, float]) -> Array:
        """Return the derivatives of all pictures, (names, n, height, width), by the names of ``deviations``.

        They are central differences over a part of each deviation: pictures of the engine are free of noise, and
        take less time than its own derivatives, which it has of unhindered objects only.
        """
        base = self.pictures(offsets)
        found = np.zeros((len(deviations), *base.shape))
        for row, (name, deviation) in enumerate(deviations.items()):
            if name not in _OUTSIDE:
                found[row] = self._difference(offsets, name, _STEP * deviation, base)
        return found

    def _difference(self, offsets: Offsets, name: str, step: float, base: Array) -> Array:
        ends = []
        for side in (step, -step):
            try:
                ends.append((side, self.pictures({**offsets, name: offsets.get(name, 0.0) + side})))
            except NlosError:  # beyond what can be, as an albedo above 1
                ends.append((0.0, base))
        (high, above), (low, below) = ends
        if high == low:
            raise NlosError(f"{name}: neither {step:g} more nor less of it can be; state a smaller deviation")
        slope: Array = (above - below) / (high - low)
        return slope

    def _shade(self, offsets: Offsets) -> Array:
        """Return the camera's factor on each pixel, (height, width)."""
        shade: Array = (1.0 + offsets.get("level", 0.0)) * (1.0 - offsets.get("vignetting", 0.0) * self._outwards)
        return shade

    def _place(self, offsets: Offsets, picture: int) -> Placed:
        x, y, z = (
            value + offsets.get(f"place.{picture}.{axis}", 0.0)
            for value, axis in zip(self.places[picture - 1].position, "xyz", strict=True)
        )
        return replace(self.places[picture - 1], position=(x, y, z))

    def _used(self, offsets: Offsets, picture: int) -> dict[str, float]:
        """Return what a picture's light must be computed for anew: the rest are factors on its parts."""
        unused = {*_OUTSIDE, *self._factors, *self._strengths}
        unused |= set() if picture else {"target.albedo", "target.size"}
        return {name: x for name, x in offsets.items() if name in OFFSETS and name not in unused and x}

    def _albedos(self, world: World) -> tuple[float, float, float]:
        """Return the factors of a world on the albedos of wall, room and target; 1 where light is computed anew."""
        if not self._factors:
            return 1.0, 1.0, 1.0
        base = self.world
        pairs = ((world.room, base.room), (world.target, base.target))
        room, target = (mean_albedo(now) / mean_albedo(then) if mean_albedo(then) else 1.0 for now, then in pairs)
        return float(world.watched.albedo.mean() / base.watched.albedo.mean()), room, target

    def _pictured(self, offsets: Offsets, factors: tuple[float, float, float], picture: int) -> Array:
        """Return a picture as the scene gives it, without the camera's part, (height, width)."""
        light, (wall, room, target) = self._light(offsets, picture), factors
        power, ambient = (
            1.0 + offsets.get(name, 0.0) if name in self._strengths else 1.0 for name in ("spot.power", "ambient")
        )
        lamp = wall * light.direct + wall**2 * (room * light.room + target * light.target)
        return power * lamp + ambient * light.sky

    def _light(self, offsets: Offsets, picture: int) -> _Light:
        used, place = self._used(offsets, picture), self._place(offsets, picture) if picture else None
        key = (picture, *sorted(used.items()), place)
        if key not in self._lights:
            self._lights[key] = self._computed(used, place)
            if len(self._lights) > _KEPT:
                self._lights.popitem(last=False)
        return self._lights[key]

    def _computed(self, used: Offsets, place: Placed | None) -> _Light:
        """Return the light of a picture of the scene with what is off, of the lamp and the sky at their strengths."""
        dark = np.zeros(self._outwards.shape)
        engine = self._engine_of(used)
        if place is None:
            everything, without_sky = engine.background(), engine.background(ambient=False)
            sky = (everything - without_sky).mean(axis=2)
            if not self._factors:
                return _Light(without_sky.mean(axis=2), dark, dark, sky)
            direct = engine.directly_lit().mean(axis=2)
            return _Light(direct, everything.mean(axis=2) - direct, dark, dark)
        empty = self._light(used, 0)
        if self._factors:
            pose = (place.position, place.rotation)
            added = engine.difference(*pose, shadows=False).mean(axis=2)
            hidden = added - engine.difference(*pose).mean(axis=2)
            return _Light(empty.direct, empty.room - hidden, added, dark)
        got = engine.render(place.position, place.rotation)
        change, sky = (got.added - got.hidden + got.further + got.emitted).mean(axis=2), got.ambient.mean(axis=2)
        return _Light(empty.direct + change, dark, dark, empty.sky + sky)

    def _engine_of(self, used: Offsets) -> Transport:
        key = tuple(sorted(used.items()))
        if key not in self._engines:
            empty = {name: x for name, x in used.items() if not name.startswith("target.")}
            like = self._engines.get(tuple(sorted(empty.items())))
            world = with_parameters(self.world, used)
            self._engines[key] = Transport(world, accuracy=self._accuracy, like=like)
            if len(self._engines) > _ENGINES:
                self._engines.popitem(last=False)
        self._engines.move_to_end(key)
        return self._engines[key]
