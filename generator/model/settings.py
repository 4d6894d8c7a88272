"""Settings of a sweep, apart from the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from generator.model.arrays import Vector
from generator.model.described import check_ranges, described, documented
from generator.model.engines import ENGINES, traits_of
from generator.model.errors import require
from generator.model.variation import Variation, moves_background, parse


@documented
@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Settings of a sweep: all that determines the pixels of a data set besides the scene itself."""

    engine: Literal["path", "patch", "surfel"] = described(
        "how the light is followed; of a sweep whose user names none, the cheapest that the scene allows", "patch"
    )
    samples: int = described(
        "rays per pixel, of path and patch; four times as many halve the noise", 512, lo=1, hi=2**24
    )
    device: Literal["cpu", "gpu"] = described(
        "that path and patch render on; gpu is what Blender's preferences choose, or else all that Cycles finds, and "
        "its pixels are its own to the last bit",
        "cpu",
    )
    denoise: bool = described(
        "clean what path and patch render with Open Image Denoise: smooth, and biased by about half a percent", False
    )
    paired: bool = described(
        "render each pose's background with the pose's own noise, which then cancels: unbiased, twice the time, far "
        "less noise in the difference",
        True,
    )
    resolution: tuple[int, int] = described(
        "width and height of the picture, pixels, which must be square on the wall", (64, 64), lo=1, hi=65536
    )
    poses: int = described(
        "pictures per voxel, each with the object at another place in it, turned another way", 100, lo=1, hi=1_000_000
    )
    seed: int = described("of all that is random: the same seed gives the same pictures", 0, lo=0, hi=2**63 - 1)
    inside: Literal["whole", "centre"] = described(
        "what of the target must lie in its voxel: all of it, or its origin only", "whole"
    )
    rotation: Vector = described(
        "largest angles about x, y and z, degrees; each is drawn between minus and plus that",
        (0.0, 0.0, 0.0),
        lo=0,
        hi=180,
    )
    accuracy: float = described(
        "root mean square error over the pixels, relative to what the target adds (0.01 or 1%), of surfel",
        1e-3,
        lo=1e-8,
        hi=0.3,
    )
    frames: int = described(
        "of a trajectory, one after the other, in place of poses in every voxel; 0 is none", 0, lo=0, hi=1_000_000
    )
    pace: float = described("of a trajectory, metres from frame to frame", 0.03)
    timeline: tuple[int, ...] = described(
        "first frame, last frame and step of Blender's timeline, along which an animated target moves; else a "
        "trajectory is drawn",
        (),
    )
    leave_out: tuple[str, ...] = described(
        "pieces of the scene (`generator.blender.engines.simplify`) and parts of surfel "
        "(`generator.transport.left_out`) that are not modelled",
        (),
    )
    vary: tuple[str, ...] = described(
        "what each pose draws anew, uniformly from a range, such as target.albedo=0.3:1; so may wall.albedo, "
        "room.albedo and spot.power (Blender's watts)",
        (),
    )

    targets: int = described(
        "hidden objects at once: the target and copies of it, each in a voxel of its own", 1, lo=1, hi=100
    )

    @classmethod
    def idle(cls, engine: str) -> tuple[str, ...]:
        """Return the settings that an engine does not use."""
        used = traits_of(engine).settings
        names = dict.fromkeys(name for traits in ENGINES.values() for name in traits.settings)
        return tuple(name for name in names if name not in used)

    @property
    def noisy(self) -> bool:
        """Whether the engine's pictures depend on samples and a seed."""
        return traits_of(self.engine).noisy

    @property
    def unused(self) -> tuple[str, ...]:
        """Settings without effect: neither the engine nor this kind of sweep (voxels or trajectory) uses them."""
        drawn = ("pace", "rotation") if self.timeline else ()
        kind = ("poses", "inside", *drawn) if self.frames else ("frames", "pace")
        empty = tuple(name for name in ("leave_out", "vary", "timeline") if not getattr(self, name))
        return (*self.idle(self.engine), *kind, *empty, *(("targets",) if self.targets == 1 else ()))

    @property
    def variations(self) -> tuple[Variation, ...]:
        """What varies from pose to pose."""
        return parse(self.vary)

    @property
    def own_backgrounds(self) -> bool:
        """Whether each pose has a background picture of its own, since more than the target varies."""
        return moves_background(self.variations)

    @property
    def varied(self) -> bool:
        """Whether poses differ in more than where the target is, so that an engine is opened for each."""
        return bool(self.vary) or self.targets > 1

    def __post_init__(self) -> None:
        check_ranges(self)
        require(not self.frames or self.targets == 1, "targets: one object walks along a trajectory; leave it out")
        require(0.0 < self.pace < math.inf, f"pace: {self.pace:g} must be positive, metres from frame to frame")
        if self.timeline:
            require(
                len(self.timeline) == 3 and self.timeline[2] >= 1,
                f"timeline: {self.timeline} must be the first frame, the last one and a step of 1 or more",
            )
            first, last, step = self.timeline
            require(
                not self.frames or len(range(first, last + 1, step)) == self.frames,
                f"timeline: {self.timeline} does not have the {self.frames} frames of the trajectory",
            )
        variations = self.variations
        require(not (self.frames and variations), "vary: nothing varies along a trajectory; leave it out")
        require(
            self.paired or not self.own_backgrounds,
            f"vary: {', '.join(self.vary)} gives each pose a background of its own, rendered with the pose's noise; "
            "leave out --no-paired",
        )


BACKGROUND_FACTOR = 16
"""The background is rendered with this many times a pose's samples: its noise enters every difference picture."""
