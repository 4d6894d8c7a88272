"""Common interface by which rendered and simulated sets are read."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from generator.files.pictures import Picture
from generator.files.toml import dump_toml
from generator.model.arrays import Vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import Other, PoseRecord
from generator.model.variation import Values


class PictureSet(Protocol):
    """A set that pictures are read from: `Dataset`, `generator.sets.simulated.SimulatedSet`, or a `MeasuredSet`."""

    @property
    def path(self) -> Path:
        """Folder of the set."""

    @property
    def meta(self) -> dict[str, Any]:
        """All values of its manifest."""

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that it was made with."""

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
        """Linear colour space of the three channels: Rec.709, Rec.2020 or ACEScg."""

    @property
    def planned(self) -> int:
        """Number of pictures of the finished set."""

    @property
    def records(self) -> list[PoseRecord]:
        """The poses whose pictures exist."""

    @property
    def own_backgrounds(self) -> bool:
        """Whether each picture has a background of its own, since more than the target varies."""

    def background(self) -> Picture:
        """Return the picture without the hidden object, (height, width, 3), W/m^2/sr."""

    def background_of(self, record: PoseRecord) -> Picture:
        """Return the background of a pose's picture: its own, or `background` where all have the same."""

    def ambient_background(self) -> Picture | None:
        """Return what ambient light alone adds to the background, or None where it is off."""

    def picture(self, record: PoseRecord) -> Picture:
        """Return a pose's picture, (height, width, 3), W/m^2/sr."""


class Seen(NamedTuple):
    """A picture on disk, None if it is not whole; its pixels' hash, and how it differs from the expected picture."""

    pixels: Picture | None
    header: dict[str, str]
    digest: str
    fault: str


def check_colours(path: Path, own: str, wanted: str, what: str) -> None:
    """Raise NlosError unless the channels of two sets or pictures are in the same linear space.

    Parameters
    ----------
    path : Path
        Picture or set whose channels are in the space ``own``.
    own, wanted : str
    what : str
        Words for the set or picture whose channels are in the space ``wanted``.
    """
    if own != wanted:
        raise NlosError(
            f"{path}: its three channels are linear {own}, and those of {what} linear {wanted}, so they mean other "
            "light; render both with one working space (Blender's scene properties)"
        )


def as_read(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest's values as they are read back from TOML, which has no tuples."""
    return tomllib.loads(dump_toml(meta))


RENDER_AGAIN = "take it away and run the sweep again to render it"


def rendered(pose: PoseRecord, seen: Seen) -> PoseRecord:
    """Return a pose with the hash, seconds and samples of its picture."""
    try:
        seconds, samples = float(seen.header.get("seconds", "0")), int(seen.header.get("samples", "0"))
    except ValueError:
        seconds, samples = 0.0, 0
    return replace(pose, pixel_hash=seen.digest, seconds=seconds, samples=samples)


def values_text(values: Values) -> str:
    """Return what varies, and its values with all digits, as text for an attribute of a picture."""
    return " ".join(f"{name}={value!r}" for name, value in values)


def others_text(others: Sequence[Other]) -> str:
    """Return the objects besides the first as text for an attribute of a picture: voxel, place, rotation of each."""
    return "; ".join(f"{o.label} {vector_text(o.position)} {vector_text(o.rotation)}" for o in others)


def vector_text(vector: Vector) -> str:
    """Return a vector as text for an attribute of a picture: with all digits, separated by blanks."""
    return " ".join(repr(float(value)) for value in vector)
