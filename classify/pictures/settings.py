"""Settings of features. A module of its own, so that a command line need not load what computes them."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from generator.files.toml import from_dict
from generator.model.arrays import Vector
from generator.model.described import described, documented
from generator.model.errors import NlosError
from generator.model.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Geometry of a scene: the lit patch, the watched part of the wall, and where an object may be.

    Attributes
    ----------
    lit : (float, float, float)
        Lit wall point w1, metres.
    lit_area : float
        Area of the lit patch, m^2.
    watched : (float, float, float, float)
        The watched rectangle of the wall, metres: x of its right and of its left edge in the picture, z of its lower
        and of its upper edge.
    lo, hi : (float, float, float)
        Opposite corners of the voxel grid, metres.
    face : float
        Area of the smallest face of a voxel, m^2.
    """

    lit: Vector
    lit_area: float
    watched: tuple[float, float, float, float]
    lo: Vector
    hi: Vector
    face: float

    def __post_init__(self) -> None:
        x0, x1, z0, z1 = self.watched
        if not (x0 < x1 and z0 < z1 and all(a < b for a, b in zip(self.lo, self.hi, strict=True))):
            raise NlosError("setup: edges of the watched rectangle and of the voxel grid must be low before high")
        if not (self.lit_area > 0.0 and self.face > 0.0 and self.lo[1] > 0.0):
            raise NlosError("setup: lit_area and face must be positive, and the voxel grid in front of the wall")

    @classmethod
    def of(cls, scene: Scene) -> Setup:
        """Return the setup of a scene."""
        spot, camera, grid = scene.spot, scene.camera, scene.grid
        beam = np.subtract(spot.location, spot.aim)
        distance = float(np.linalg.norm(beam))
        area = math.pi * (distance * math.tan(math.radians(spot.half_angle))) ** 2 * distance / max(beam[1], 1e-9)
        x, y, z = grid.size
        return cls(
            lit=spot.aim,
            lit_area=area,
            watched=(*camera.x, *camera.z),
            lo=grid.lo,
            hi=grid.hi,
            face=min(x * y, y * z, x * z),
        )


@documented
@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """All settings that determine a picture's features; stored with them, and in every model trained on them."""

    set: Literal["global", "spatial-hog", "physics"] = described(
        "global: colour histogram, Hu moments and Haralick texture (paper, 5.3.1); spatial-hog: down-sampled copy, "
        "colour histogram and HOG (section 4); physics: level, shape without level, and the fit of an unknown target",
        "global",
    )
    input: Literal["difference", "raw"] = described("picture minus background, or the picture itself", "difference")
    tone: Literal["log", "linear"] = described(
        "log keeps shades in near and far voxels alike: signed asinh, linear below floor; linear, up to ceiling, is "
        "like 8 bits of the brightest",
        "log",
    )
    floor: float = described("radiance at which log turns linear, in units of the lit patch's radiance", 1e-7)
    ceiling: float = described("radiance that counts as white, in the same units", 1e-3)
    size: int = described("pixels a side to which larger pictures are averaged down", 32)
    bins: int = described("histogram bins per channel", 32)
    levels: int = described("grey levels of the co-occurrence matrices behind Haralick's texture", 64)
    setup: Setup | None = described("setup of the scene, which physics needs", None)

    def __post_init__(self) -> None:
        if not 0.0 < self.floor < self.ceiling < float("inf"):
            raise NlosError(f"floor {self.floor:g} and ceiling {self.ceiling:g}: must be 0 < floor < ceiling")
        if not (1 <= self.size <= 4096 and 2 <= self.bins <= 256 and 2 <= self.levels <= 256):
            raise NlosError("size must be 1 to 4096, bins and levels 2 to 256")

    def to_json(self) -> str:
        """Return the settings as text."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> FeatureSettings:
        """Return the settings from the text of `to_json`; NlosError if the text is not valid."""
        try:
            values = json.loads(text)
        except json.JSONDecodeError:
            raise NlosError("feature settings: are not JSON") from None
        settings: FeatureSettings = from_dict(cls, values, "feature settings: ")
        return settings
