"""Pictures that the engine predicts of a scene as its uncertain values change, and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.transport import Transport, World
from generator.transport.parameters import OFFSETS, mean_albedo, with_parameters

CAMERA = ("level", "black", "vignetting")
"""What the camera does, as measured pictures show it: a relative change of all light; a constant, in units of the mean
of the empty scene's picture; and the share of light that is missing in the corners, as the square of the distance from
the middle."""

_STEP = 0.5
"""Steps of central differences, in standard deviations of what is known beforehand."""
_KEPT = 64
"""Scenes whose light is remembered."""

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

    lamp: Array
    sky: Array
    other: Array


class Predicted:
    """Grey pictures, W/m^2/sr, of the empty scene and of the object at some places, by what is off in the scene.

    Parameters
    ----------
    world : World
        The scene as it is thought to be.
    places : sequence of Placed
        Of the pictures with the object; the first picture is always the empty scene's.
    accuracy : float, default=2e-4
        Relative accuracy of the engine.
    """

    def __init__(self, world: World, places: Sequence[Placed] = (), *, accuracy: float = 2e-4) -> None:
        self.world, self.places, self._accuracy = world, tuple(places), accuracy
        self._lights: dict[tuple[object, ...], _Light] = {}
        self._engine: tuple[tuple[object, ...], Transport] | None = None
        width, height = world.watched.resolution
        u, v = np.meshgrid((np.arange(width) + 0.5) / width - 0.5, (np.arange(height) + 0.5) / height - 0.5)
        self._outwards = ((u * width) ** 2 + (v * height) ** 2) / (0.25 * (width**2 + height**2))
        self._mean = float(self._pictured({}, 0).mean())

    @property
    def count(self) -> int:
        """Number of pictures."""
        return 1 + len(self.places)

    def names(self) -> tuple[str, ...]:
        """Return the names of all that may be off: of the scene, the camera, and the places (``place.1.x``)."""
        missing = {"ambient"} if self.world.ambient is None else set()
        missing |= set() if mean_albedo(self.world.room) else {"room.albedo"}
        missing |= {"target.albedo", "target.size"} if not self.places else set()
        scene = [name for name in OFFSETS if name not in missing]
        return (*scene, *CAMERA, *(f"place.{k + 1}.{axis}" for k in range(len(self.places)) for axis in "xyz"))

    def pictures(self, offsets: Offsets) -> Array:
        """Return all pictures, (n, height, width), W/m^2/sr.

        Raises
        ------
        NlosError
            The scene cannot be so (`with_parameters`), or the object cannot stand there.
        """
        shaded = (1.0 + offsets.get("level", 0.0)) * (1.0 - offsets.get("vignetting", 0.0) * self._outwards)
        black = offsets.get("black", 0.0) * self._mean
        seen = np.stack([self._pictured(offsets, k) for k in range(self.count)])
        made: Array = shaded * seen + black
        return made

    def slopes(self, offsets: Offsets, deviations: Mapping[str, float]) -> Array:
        """Return the derivatives of all pictures, (names, n, height, width), by the names of ``deviations``.

        They are central differences of the engine, over a part of each deviation; of the object's places the engine
        has exact ones, unless something stands in the way.
        """
        found = np.zeros((len(deviations), self.count, *self._outwards.shape))
        base = self.pictures(offsets)
        for row, (name, deviation) in zip(found, deviations.items(), strict=True):
            if name.startswith("camera.location"):  # the view is given on the wall, which looks alike from everywhere
                continue
            if name.startswith("place."):
                picture = int(name.split(".")[1])
                row[picture] = self._by_place(offsets, picture, "xyz".index(name[-1]))
                continue
            step = _STEP * deviation
            ends = []
            for sign in (1.0, -1.0):
                try:
                    ends.append((sign * step, self.pictures({**offsets, name: offsets.get(name, 0.0) + sign * step})))
                except NlosError:  # beyond what can be, as an albedo above 1
                    ends.append((0.0, base))
            (high, above), (low, below) = ends
            if high == low:
                raise NlosError(f"{name}: neither {step:g} more nor less of it can be; state a smaller deviation")
            row[:] = (above - below) / (high - low)
        return found

    def _by_place(self, offsets: Offsets, picture: int, axis: int) -> Array:
        """Return the derivative of a picture by a coordinate of its object, per metre."""
        shaded = (1.0 + offsets.get("level", 0.0)) * (1.0 - offsets.get("vignetting", 0.0) * self._outwards)
        engine, place = self._engine_of(offsets), self._place(offsets, picture)
        try:
            slopes = engine.render(place.position, place.rotation, derivatives=True).derivatives
            assert slopes is not None
            return shaded * slopes[axis].mean(axis=-1)  # type: ignore[no-any-return]
        except NlosError:  # known only where nothing is in the way
            name, step = f"place.{picture}.{'xyz'[axis]}", 0.01
            here = offsets.get(name, 0.0)
            ends = [self._pictured({**offsets, name: here + sign * step}, picture) for sign in (1.0, -1.0)]
            return shaded * (ends[0] - ends[1]) / (2.0 * step)

    def _place(self, offsets: Offsets, picture: int) -> Placed:
        place = self.places[picture - 1]
        moved = [
            x + offsets.get(f"place.{picture}.{axis}", 0.0) for x, axis in zip(place.position, "xyz", strict=True)
        ]
        return replace(place, position=(moved[0], moved[1], moved[2]))

    def _pictured(self, offsets: Offsets, picture: int) -> Array:
        """Return a picture as the scene gives it, without the camera's part, (height, width)."""
        power, ambient = 1.0 + offsets.get("spot.power", 0.0), 1.0 + offsets.get("ambient", 0.0)
        light = self._light(offsets, picture)
        return power * light.lamp + ambient * light.sky + light.other

    def _engine_of(self, offsets: Offsets) -> Transport:
        """Return the engine of the scene; lamp and sky of the strength that the scene has."""
        changed = {
            name: value
            for name, value in offsets.items()
            if name in OFFSETS and value and name not in ("spot.power", "ambient")
        }
        key = tuple(sorted(changed.items()))
        if self._engine is None or self._engine[0] != key:
            self._engine = key, Transport(with_parameters(self.world, changed), accuracy=self._accuracy)
        return self._engine[1]

    def _light(self, offsets: Offsets, picture: int) -> _Light:
        """Return the light of a picture at the lamp's and the sky's own strength."""
        world, place = self.world, self._place(offsets, picture) if picture else None
        albedos = ("wall.albedo", "room.albedo", "target.albedo")
        scaled = () if world.is_followed_on else albedos
        unused = ("spot.power", "ambient", *scaled, *(() if picture else ("target.albedo", "target.size")))
        used = {n: x for n, x in offsets.items() if n in OFFSETS and n not in unused and x and "camera.loc" not in n}
        key = (picture, *sorted(used.items()), place and place.position)
        if key not in self._lights:
            if len(self._lights) > _KEPT * self.count:
                self._lights.clear()
            self._lights[key] = self._computed(used, picture, place)
        return self._lights[key]

    def _computed(self, used: Offsets, picture: int, place: Placed | None) -> _Light:
        raise NotImplementedError
