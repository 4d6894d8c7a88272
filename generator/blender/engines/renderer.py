"""The common interface of all renderers, once a scene is prepared for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from generator.files.pictures import Picture
from generator.model.arrays import Array, Vector


@dataclass(frozen=True)
class Shot:
    """A picture to be rendered.

    Attributes
    ----------
    position, rotation : (float, float, float)
        Pose of the target: metres, and degrees about x, then y, then z.
    samples, seed : int
        For engines with noise: camera rays per pixel, and the seed of the noise, 0 to 2^31 - 1.
    """

    position: Vector
    rotation: Vector
    samples: int = 0
    seed: int = 0


class Renderer(Protocol):
    """Renders what the camera sees on the relay wall; made by `generator.blender.engines.renderers.opened`."""

    def render(self, *, samples: int, seed: int, target: bool = True, ambient: bool = True) -> Picture:
        """Render one picture of the scene as it stands.

        Parameters
        ----------
        samples, seed : int
            As in `Shot`.
        target : bool
            Whether the hidden object is rendered; the background without it if not.
        ambient : bool
            Whether the world's light, if there is any, is rendered.

        Returns
        -------
        ndarray of shape (height, width, 3), float32
            Radiance, W/m^2/sr; row 0 is the top.

        Raises
        ------
        NlosError
            The target is hidden from renders; or Cycles failed, or left a picture with NaN or infinite pixels.
        """

    def pictures(self, shots: Sequence[Shot], background: Picture | None = None) -> list[Picture]:
        """Render pictures of many poses, as `render` returns them.

        Parameters
        ----------
        shots : sequence of Shot
            The pictures do not depend on what is rendered together.
        background : ndarray of shape (height, width, 3), optional
            To it, engines with noise add what the target changes, from two renders with the same noise.
        """

    def difference(self, shot: Shot) -> Array:
        """Return what the target at a pose changes in the empty scene's picture, (height, width, 3), W/m^2/sr."""
