"""Values of the scene that vary from pose to pose within one set: which there are, their ranges, and their draws."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from generator.model.errors import NlosError, instead, require

VARIABLES = ("target.albedo", "wall.albedo", "room.albedo", "spot.power")
"""Fields of a `generator.model.scene.Scene` that may vary; the position of a name here salts its draws."""

_SALT = 1000
"""Start of the numbers that distinguish the streams of the values from those of the poses."""

Values = tuple[tuple[str, float], ...]
"""Names of what varies, each with its value at one pose."""


@dataclass(frozen=True)
class Variation:
    """A field of the scene whose value each pose draws uniformly from a range.

    Attributes
    ----------
    name : str
        One of `VARIABLES`.
    low, high : float
        Ends of the range: albedos, or for ``spot.power`` Blender's watts.
    """

    name: str
    low: float
    high: float

    @classmethod
    def parse(cls, text: str) -> Variation:
        """Return the variation that a text such as ``target.albedo=0.3:1`` describes.

        Raises
        ------
        NlosError
            It does not read so, names what cannot vary, or its range is none.
        """
        name, _, range_ = text.partition("=")
        if name not in VARIABLES:
            raise NlosError(f"vary: {name!r} is nothing that can vary; {instead(name, VARIABLES)}")
        low, _, high = range_.partition(":")
        try:
            variation = cls(name, float(low), float(high))
        except ValueError:
            raise NlosError(f"vary: {text!r} must read NAME=LOW:HIGH, for example {name}=0.3:1") from None
        most = math.inf if name == "spot.power" else 1.0
        valid = 0.0 <= variation.low < variation.high <= most and math.isfinite(variation.high)
        bounds = "from 0 up" if most == math.inf else "between 0 and 1"
        require(valid, f"vary: {text!r} must run from low to high, {bounds}")
        return variation


def parse(texts: Iterable[str]) -> tuple[Variation, ...]:
    """Return the variations of a set; NlosError if a text is no variation, or two are of one name."""
    variations = tuple(map(Variation.parse, texts))
    for k, variation in enumerate(variations):
        twice = variation.name in [other.name for other in variations[:k]]
        require(not twice, f"vary: {variation.name} is given twice; give one range for it")
    return variations


def draw(variations: Iterable[Variation], seed: int, voxel: int, index: int, *, stream: int = 0) -> Values:
    """Return the values of a pose, which follow from the set's seed, the voxel, and the pose's index in it.

    Each name has a stream of its own, so that its values do not depend on what else varies.

    Parameters
    ----------
    variations : iterable of Variation
    seed, voxel, index : int
        The set's seed, the number of the voxel, and the index of the pose within it.
    stream : int
        As `generator.model.poses.Sampler` takes it.
    """

    def value(variation: Variation) -> float:
        salt = _SALT + VARIABLES.index(variation.name)
        rng = np.random.default_rng([seed, voxel, index, salt, stream])
        return float(rng.uniform(variation.low, variation.high))

    return tuple((variation.name, value(variation)) for variation in variations)


def value_in(scene: Mapping[str, Any], name: str) -> float:
    """Return the value that a scene, as plain tables, has for one of `VARIABLES`."""
    table, _, field = name.partition(".")
    return float(scene[table][field])


def moves_background(variations: Iterable[Variation]) -> bool:
    """Whether the picture without the hidden object is another at every pose."""
    return any(variation.name != "target.albedo" for variation in variations)
