"""Rendering by the noise-free integral: the engine `surfel`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from generator.blender.engines.renderer import Shot
from generator.blender.scene import geometry, roles
from generator.files.pictures import Picture
from generator.measure import light_check
from generator.model.arrays import Array
from generator.transport import Transport


class SurfelRenderer:
    """Renders by the three-reflection integral: no samples, no noise.

    Parameters
    ----------
    scene : bpy.types.Scene
    transport : Transport
    shadows : bool
        Whether the light of the room that the target keeps from the wall is subtracted.
    """

    def __init__(self, scene: bpy.types.Scene, transport: Transport, *, shadows: bool = True) -> None:
        self._scene = scene
        self._transport = transport
        self._shadows = shadows

    def render(self, *, samples: int = 0, seed: int = 0, target: bool = True, ambient: bool = True) -> Picture:
        """Render one picture with the target where it stands in the scene; samples and seed have no effect."""
        if not target:
            return self._transport.background(ambient=ambient).astype(np.float32)
        roles.refuse_hidden(self._scene)
        matrix = Matrix(geometry.snapshot(self._scene).matrices["target"].tolist())
        position, turn, _ = geometry.pose_of(roles.find(self._scene, "target"), matrix)
        return self.at(tuple(position), tuple(math.degrees(angle) for angle in turn.to_euler("XYZ")))

    def light_check(self, poses: Sequence[light_check.Pose]) -> dict[str, Any]:
        """Return how far the light of many reflections is trusted at some of the poses."""
        return light_check.look(self._transport, poses)

    def difference(self, shot: Shot) -> Array:
        """Return what the target at a pose changes in the empty scene's picture, (height, width, 3), W/m^2/sr."""
        return self._transport.difference(shot.position, shot.rotation, shadows=self._shadows)

    def at(self, position: Sequence[float], rotation: Sequence[float]) -> Picture:
        """Render one picture with the target at a pose: metres, and degrees about x, then y, then z."""
        return self._pictures([position], [rotation])[0]

    def pictures(self, shots: Sequence[Shot], background: Picture | None = None) -> list[Picture]:
        """Render pictures of many poses, (height, width, 3) each, as `at` does, in less time."""
        return self._pictures([shot.position for shot in shots], [shot.rotation for shot in shots])

    def _pictures(self, positions: Sequence[Sequence[float]], rotations: Sequence[Sequence[float]]) -> list[Picture]:
        return list(self._transport.pictures(positions, rotations, shadows=self._shadows))
