"""Settings of a sweep: what is chosen beside the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from generator.model.arrays import Vector
from generator.model.engines import ENGINES, traits_of
from generator.model.errors import require


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What a sweep renders: all that decides the pixels of a data set besides the scene itself.

    Attributes
    ----------
    engine : {"path", "patch", "surfel"}
    samples : int
        Camera rays per pixel, of `path` and `patch`.
    device : {"cpu", "gpu"}
        That `path` and `patch` render on. A GPU's pixels are its own to the last bit, so it is part of the settings.
    denoise : bool
        Clean what `path` and `patch` render with Open Image Denoise: smooth, and biased.
    paired : bool
        Render each pose's background with the pose's own noise and keep only the difference of the two on top of
        the common background: unbiased, twice the cost, and a far smaller error where the object changes little.
    resolution : (int, int)
        Width and height, pixels.
    poses : int
        Per voxel.
    seed : int
        Of the sweep; every pose's own follows from it.
    inside : {"whole", "centre"}
        What stays inside the voxel: all of the target, or its origin only.
    rotation : (float, float, float)
        Largest angles about x, y, z, degrees; each is drawn between minus and plus that.
    accuracy : float
        Of `surfel`: root mean square error over the pixels, relative to what the target adds.
    frames : int
        Of a trajectory, one after the other, in place of poses in every voxel; 0 is none.
    pace : float
        Of a trajectory, metres from frame to frame.
    leave_out : tuple of str
        Pieces of the scene (`generator.blender.engines.simplify`) and parts of `surfel` (`transport.left_out`) that
        are not modelled.
    """

    engine: Literal["path", "patch", "surfel"] = "patch"
    """Of a sweep that is made; where its user names none, it is the cheapest that the scene allows (`AUTO`)."""
    samples: int = 512
    device: Literal["cpu", "gpu"] = "cpu"
    denoise: bool = False
    paired: bool = True
    resolution: tuple[int, int] = (64, 64)
    poses: int = 100
    seed: int = 0
    inside: Literal["whole", "centre"] = "whole"
    rotation: Vector = (0.0, 0.0, 0.0)
    accuracy: float = 1e-3
    frames: int = 0
    pace: float = 0.03
    leave_out: tuple[str, ...] = ()

    @classmethod
    def idle(cls, engine: str) -> tuple[str, ...]:
        """Return the settings that mean nothing to an engine."""
        own = traits_of(engine).settings
        every = dict.fromkeys(name for traits in ENGINES.values() for name in traits.settings)
        return tuple(name for name in every if name not in own)

    @property
    def noisy(self) -> bool:
        """Whether the engine's pictures depend on samples and a seed."""
        return traits_of(self.engine).noisy

    @property
    def unused(self) -> tuple[str, ...]:
        """The settings that mean nothing here: to the engine, and to a sweep of voxels or a trajectory."""
        kind = ("poses", "inside") if self.frames else ("frames", "pace")
        return (*self.idle(self.engine), *kind, *(() if self.leave_out else ("leave_out",)))

    def __post_init__(self) -> None:
        require(1e-8 <= self.accuracy <= 0.3, f"accuracy: {self.accuracy:g} must be from 1e-08 to 0.3")
        require(1 <= self.samples <= 2**24, f"samples: {self.samples} must be from 1 to {2**24}")
        require(0 <= self.frames <= 1_000_000, f"frames: {self.frames} must be from 1 to 1000000")
        require(0.0 < self.pace < math.inf, f"pace: {self.pace:g} must be positive, metres from frame to frame")
        require(1 <= self.poses <= 1_000_000, f"poses: {self.poses} must be from 1 to 1000000")
        require(0 <= self.seed < 2**63, f"seed: {self.seed} must be from 0 to 2^63 - 1")
        require(
            all(1 <= n <= 65536 for n in self.resolution), f"resolution: {self.resolution} must be from 1 to 65536"
        )
        require(all(0 <= a <= 180 for a in self.rotation), f"rotation: {self.rotation} must be from 0 to 180 degrees")


BACKGROUND_FACTOR = 16
"""The background is rendered with this many times a pose's samples: its noise stands in every difference."""
