"""A camera that takes pictures of a wall: perspective, vignetting, black level, gain, noise and rounding.

It shares no code with what imports its pictures: rays from points of its pixels find the wall's pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

POINTS = 6
"""Points along each edge of a pixel."""


@dataclass
class Camera:
    """Where a rectangle of the wall is in its picture, and how it turns light into grey levels."""

    corners: np.ndarray
    shape: tuple[int, int] = (180, 200)
    exposure: float = 1.0
    electrons: float = 2.0
    read_noise: float = 3.0
    black: float = 64.0
    top: int = 65535
    fall: float = 0.4

    def light(self, wall):
        """Light (height, width) of a wall's pixels (rows, columns), of which the outer ones go on around."""
        rows, columns = wall.shape
        ends = np.float32([(0, 0), (columns, 0), (columns, rows), (0, rows)])
        to_wall = cv2.getPerspectiveTransform(np.float32(self.corners), ends)
        height, width = self.shape
        offsets = (np.arange(POINTS) + 0.5) / POINTS - 0.5
        total = np.zeros(self.shape)
        v, u = np.mgrid[0:height, 0:width]
        for down in offsets:
            for across in offsets:
                there = np.stack([u + across, v + down, np.ones_like(u)], axis=-1) @ to_wall.T
                c, r = (np.floor(there[..., k] / there[..., 2]).astype(int) for k in (0, 1))
                total += wall[np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)]
        return total / POINTS**2 * self.vignetting

    @property
    def vignetting(self):
        """Share of the light that reaches each pixel."""
        height, width = self.shape
        v, u = np.mgrid[0:height, 0:width]
        return 1.0 - self.fall * (((u - width / 2) / width) ** 2 + ((v - height / 2) / height) ** 2) * 2.0

    def levels(self, light, rng):
        """Grey levels (height, width) of a frame."""
        charge = rng.poisson(np.maximum(light, 0.0) * self.exposure)
        charge = charge + rng.normal(scale=self.read_noise, size=light.shape)
        levels = np.clip(np.rint(self.black + charge / self.electrons), 0, self.top)
        return levels.astype(np.uint16 if self.top > 255 else np.uint8)

    def take(self, path, light, rng, count=1):
        """Write frames as PNG files into a folder; return their paths."""
        path.mkdir(parents=True, exist_ok=True)
        paths = [path / f"{k}.png" for k in range(count)]
        for file in paths:
            assert cv2.imwrite(str(file), self.levels(light, rng))
        return paths
