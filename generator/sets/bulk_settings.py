"""Settings of a bulk set, and the layout of its parts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from generator.model.arrays import Vector
from generator.model.described import borrowed, check_ranges, described, documented
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.settings import Sweep
from generator.model.uncertainty import Uncertainty
from generator.model.variation import Values, draw

_CHUNK = 64 * 1024
_PART = 64 * 1024**2
_LARGEST_PART = 1024**3
_MOST_PARTS = 512
"""HDF5 keeps every part open that it has read through the master, and a process may have 1024 files open."""


@documented
@dataclass(frozen=True, kw_only=True)
class Settings:
    """All that determines a bulk set besides the scene."""

    pictures: int = described("in all voxels together", lo=1, hi=10**9)
    seed: int = borrowed(Sweep, "seed")
    resolution: tuple[int, int] = borrowed(Sweep, "resolution")
    accuracy: float = described("relative error of a picture (0.01 or 1%)", 1e-3, lo=1e-8, hi=0.3)
    inside: Literal["whole", "centre"] = borrowed(Sweep, "inside")
    rotation: Vector = borrowed(Sweep, "rotation")
    part: int = described("pictures per file; 0 takes about 64 MiB", 0)
    compress: bool = described(
        "smaller files (gzip, which every HDF5 reader knows), several times slower to write and to read", False
    )
    unknown: bool = described(
        "at every pose another box or sheet in place of the target, turned by up to 15 15 90 degrees, for an unknown "
        "object",
        False,
    )

    stream: Literal["sweep", "bulk"] = described(
        "which poses the seed draws: bulk's own, or those of a sweep with the same seed, to compare engines pose by "
        "pose and never to test what was trained on them",
        "sweep",  # of sets of older versions, which do not say
    )
    vary: tuple[str, ...] = borrowed(Sweep, "vary")
    targets: int = borrowed(Sweep, "targets")
    uncertain: Uncertainty | None = described(
        "file of what is not known exactly of the scene (uncertainty.toml); each pose draws a scene from it, with a "
        "background of its own",
        None,
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.part < 0:
            raise NlosError(f"part: {self.part} must be 1 or more, or 0 to choose")
        names = [variation.name for variation in self.sweep.variations]  # raises what a sweep raises
        if self.unknown and self.targets > 1:
            raise NlosError("targets: an unknown object is alone in its picture; leave --targets or --unknown out")
        if self.unknown and "target.albedo" in names:
            raise NlosError(
                "vary: target.albedo is drawn for every unknown object already; leave it or --unknown out"
            )
        if self.uncertain and (names or self.targets > 1):
            other = "vary" if names else "targets"
            raise NlosError(f"uncertain: draws a scene for each pose already; leave --{other} out")

    @property
    def numbered_stream(self) -> int:
        """The stream as `generator.model.poses.Sampler` takes it."""
        return 1 if self.stream == "bulk" else 0

    @property
    def unused(self) -> tuple[str, ...]:
        """Settings without effect, which sets of older versions lack."""
        return (*(() if self.vary else ("vary",)), *(("targets",) if self.targets == 1 else ()))

    @property
    def sweep(self) -> Sweep:
        """Settings of the poses; `numbered_stream` says which are drawn."""
        names = ("seed", "resolution", "inside", "rotation", "vary", "targets")
        return Sweep(**{name: getattr(self, name) for name in names})

    @property
    def own_backgrounds(self) -> bool:
        """Whether each pose has a background picture of its own, since more than the target varies."""
        return self.uncertain is not None or self.sweep.own_backgrounds

    @property
    def varying(self) -> tuple[str, ...]:
        """What varies from pose to pose, a text for each value."""
        return self.uncertain.names if self.uncertain else self.vary

    def chunk(self, channels: int) -> int:
        """Pictures per HDF5 chunk, which is read whole from disk for any of its pictures: about 64 KiB."""
        return max(1, min(1024, _CHUNK // self.picture_bytes(channels)))

    def picture_bytes(self, channels: int) -> int:
        """Bytes of one picture."""
        return math.prod(self.resolution) * channels * 4

    def with_part(self, channels: int) -> Settings:
        """Return the settings with a size of part chosen, if there is none yet.

        A part has about 64 MiB, but there are enough to share among workers, and few enough to be all open at once.
        """
        if self.part:
            return self
        size = self.picture_bytes(channels)
        wanted = min(4096, _PART // size, max(64, math.ceil(self.pictures / 64)))
        wanted = max(1, min(max(wanted, math.ceil(self.pictures / _MOST_PARTS)), _LARGEST_PART // size))
        chunk = self.chunk(channels)
        return replace(self, part=math.ceil(wanted / chunk) * chunk)


@dataclass(frozen=True)
class Layout:
    """Layout of the parts of a set.

    Attributes
    ----------
    path : Path
        Folder of the set.
    fingerprint : str
        Fingerprint of the set.
    plan : Settings
    channels : int
        Number of channels of a stored picture, 1 or 3.
    grid : VoxelGrid
    scene : mapping
        The scene as plain tables.
    """

    path: Path
    fingerprint: str
    plan: Settings
    channels: int
    grid: VoxelGrid
    scene: Mapping[str, Any]

    def values(self, voxel: int, index: int, attempt: int = 0) -> Values:
        """Return what varies at a pose; ``attempt`` as for `generator.model.uncertainty.Uncertainty.draw`."""
        plan, place = self.plan, (self.plan.seed, voxel, index)
        if plan.uncertain:
            return plan.uncertain.draw(self.scene, *place, stream=plan.numbered_stream, attempt=attempt)
        return draw(plan.sweep.variations, *place, stream=plan.numbered_stream)

    @property
    def parts(self) -> int:
        """Number of parts of the finished set."""
        return math.ceil(self.plan.pictures / self.plan.part)

    @property
    def images(self) -> tuple[str, ...]:
        """Names of the datasets that hold pictures: there are backgrounds where more than the target varies."""
        return ("pictures", "backgrounds") if self.plan.own_backgrounds else ("pictures",)

    @property
    def columns(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """The other datasets: shape of a row, and type."""
        varying = len(self.plan.varying)
        return {
            "position": ((3,), "<f8"),
            "rotation": ((3,), "<f8"),
            "voxel": ((), "<i8"),
            "index": ((), "<i8"),
            **({"values": ((varying,), "<f8")} if varying else {}),
            **({name: self._others[name] for name in self._others if self.plan.targets > 1}),
        }

    @property
    def _others(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """The datasets of the objects besides the first."""
        n = self.plan.targets - 1
        return {
            "other_positions": ((n, 3), "<f8"),
            "other_rotations": ((n, 3), "<f8"),
            "other_voxels": ((n,), "<i8"),
        }

    @property
    def picture_shape(self) -> tuple[int, ...]:
        """Shape of a stored picture: (height, width), or (height, width, 3) where the scene has colours."""
        width, height = self.plan.resolution
        return (height, width) if self.channels == 1 else (height, width, 3)

    def part_path(self, number: int) -> Path:
        """Return the file of a part."""
        return self.path / f"part-{self.fingerprint[:8]}-{number:06d}.h5"

    def part_range(self, number: int) -> range:
        """Return the numbers of a part's pictures."""
        return range(number * self.plan.part, min((number + 1) * self.plan.part, self.plan.pictures))
