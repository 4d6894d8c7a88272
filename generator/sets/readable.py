"""What rendered and simulated sets both offer to whoever reads them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from generator.files.pictures import Picture
from generator.files.toml import dump_toml
from generator.model.arrays import Vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import PoseRecord


class PictureSet(Protocol):
    """What pictures are read from: `Dataset`, or `generator.sets.simulated.SimulatedSet`."""

    @property
    def path(self) -> Path:
        """Of the set."""

    @property
    def meta(self) -> dict[str, Any]:
        """All of its manifest."""

    @property
    def settings(self) -> dict[str, Any]:
        """What it was made with."""

    @property
    def grid(self) -> VoxelGrid:
        """The voxel grid."""

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh."""

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit patch around w1, W/m^2/sr."""

    @property
    def colour_space(self) -> str:
        """The linear space that the three channels are of: Rec.709, Rec.2020 or ACEScg."""

    @property
    def planned(self) -> int:
        """How many pictures it has when it is finished."""

    @property
    def records(self) -> list[PoseRecord]:
        """The poses whose pictures are there."""

    def background(self) -> Picture:
        """Return the picture without the hidden object, (height, width, 3), W/m^2/sr."""

    def ambient_background(self) -> Picture | None:
        """Return what ambient light alone adds to it, or None."""

    def picture(self, record: PoseRecord) -> Picture:
        """Return a pose's picture, (height, width, 3), W/m^2/sr."""


class Seen(NamedTuple):
    """A picture on disk: its pixels' own hash, and in what it is not the expected one; none if it is not whole."""

    pixels: Picture | None
    header: dict[str, str]
    digest: str
    fault: str


def check_colours(path: Path, own: str, wanted: str, what: str) -> None:
    """Raise NlosError unless channels of one linear space mean the same as those of another.

    Parameters
    ----------
    path : Path
        Of the picture or the set whose channels are of the space ``own``.
    own, wanted : str
    what : str
        Whose channels are of the space ``wanted``.
    """
    if own != wanted:
        raise NlosError(
            f"{path}: its three channels are linear {own}, and those of {what} linear {wanted}, so they mean other "
            "light; render both with one working space (Blender's scene properties)"
        )


def as_read(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest's values as they are read back: TOML knows no tuples."""
    return tomllib.loads(dump_toml(meta))


RENDER_AGAIN = "take it away and run the sweep again to render it"


def rendered(pose: PoseRecord, seen: Seen) -> PoseRecord:
    """Return a pose as its picture tells it."""
    try:
        seconds, samples = float(seen.header.get("seconds", "0")), int(seen.header.get("samples", "0"))
    except ValueError:
        seconds, samples = 0.0, 0
    return replace(pose, pixel_hash=seen.digest, seconds=seconds, samples=samples)


def vector_text(vector: Vector) -> str:
    """Return a vector as an attribute of a picture holds it: every digit, blanks between."""
    return " ".join(repr(float(value)) for value in vector)
