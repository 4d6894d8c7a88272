"""What is known of a scene without Blender: its figures, as the manifest of a data set has them, in a file alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from generator.files.pictures import COLOUR_SPACE, Picture
from generator.files.toml import dump_toml, from_dict, read_toml
from generator.files.writing import write_text
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.scene import Scene
from generator.sets.simulated import open_set


@dataclass(frozen=True)
class Description:
    """A scene's figures.

    Attributes
    ----------
    scene : dict
        The table ``scene`` of a manifest.
    reference_radiance : float
        Of the lit patch at w1, W/m^2/sr.
    colour_space : str
    background : ndarray of shape (height, width, 3), optional
        Its picture without the target, W/m^2/sr, if it is known.
    """

    scene: dict[str, Any]
    reference_radiance: float
    colour_space: str = COLOUR_SPACE
    background: Picture | None = None

    @property
    def resolution(self) -> tuple[int, int]:
        """Width and height of the pictures."""
        if self.background is not None:
            height, width = self.background.shape[:2]
            return width, height
        width, height = self.scene.get("resolution", (64, 64))
        return int(width), int(height)

    @property
    def watched(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Extent along x and along z of the rectangle of wall that the camera watches, metres, if it is known."""
        camera = self.scene.get("camera")
        if not isinstance(camera, Mapping) or not {"x", "z"} <= set(camera):
            return None
        (x0, x1), (z0, z1) = camera["x"], camera["z"]
        return (float(x0), float(x1)), (float(z0), float(z1))

    @property
    def manifest(self) -> dict[str, Any]:
        """The entries of a manifest that it stands for."""
        return {
            "reference_radiance": self.reference_radiance,
            "colour_space": self.colour_space,
            "scene": self.scene,
        }

    def write(self, path: Path) -> None:
        """Write it as TOML, such as `read` takes and the manifest of a measured set may begin."""
        write_text(path, dump_toml(self.manifest))


def read(path: Path) -> Description:
    """Read the description of a scene from its file, or from any data set of it.

    Raises
    ------
    NlosError
        There is neither, or its figures are not valid.
    """
    if path.is_dir():
        dataset = open_set(path)
        scene = dataset.meta.get("scene", {})
        try:
            background = dataset.background()
        except NlosError:
            background = None
        return Description(scene, dataset.reference_radiance, dataset.colour_space, background)
    if path.suffix == ".blend":
        raise NlosError(f"{path}: describe it first: nlos-generate describe {path.name} -o {path.stem}.toml")
    data = read_toml(path)
    try:
        scene = data.get("scene")
        if not isinstance(scene, Mapping):
            raise NlosError("lacks the table 'scene'")
        if {"wall", "spot", "camera", "grid"} <= set(scene):
            described: Scene = from_dict(Scene, scene, "scene.")
            radiance = described.reference_radiance
        else:  # no more than the voxels is needed to name places
            from_dict(VoxelGrid, scene.get("grid", {}), "scene.grid.")
            radiance = 1.0
        radiance = data.get("reference_radiance", radiance)
        if isinstance(radiance, bool) or not isinstance(radiance, int | float) or radiance < 0.0:
            raise NlosError(f"reference_radiance: {radiance!r} must be a number of 0 or more")
    except NlosError as error:
        raise NlosError(f"{path}: {error}") from None
    return Description(dict(scene), float(radiance), str(data.get("colour_space", COLOUR_SPACE)))
