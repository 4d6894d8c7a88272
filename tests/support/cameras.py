"""Bursts of cameras with known figures, drawn electron by electron, and by nothing that the estimator uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classify.pictures.burst import Burst

LEVELS = (0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.5)
"""Exposure times of the bursts of light, in units of what fills the well."""
DARK_TIMES = (0.001, 0.1, 1.0, 3.0)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera's figures; fields are named as those of `Sensor`, and `bend` is its non-linearity at full well."""

    gain: float = 0.2
    read_noise: float = 3.0
    full_well: float = 18_000.0
    dark_current: float = 30.0
    gain_spread: float = 0.01
    offset_spread: float = 4.0
    bend: float = 0.01
    row_noise: float = 1.0
    column_noise: float = 0.0
    bits: int = 12
    black: float = 64.0

    @classmethod
    def drawn(cls, rng):
        """A camera at random, from a good phone's to a scientific one's."""
        gain, well = 10.0 ** rng.uniform(-1.0, 0.3), 10.0 ** rng.uniform(3.5, 4.3)
        read, offset = rng.uniform(1.5, 8.0), rng.uniform(1.0, 6.0)
        black = 30.0 + 12.0 * gain * np.hypot(read, offset)
        return cls(
            gain=gain,
            read_noise=read,
            full_well=well,
            dark_current=10.0 ** rng.uniform(0.0, 2.0),
            gain_spread=rng.uniform(0.003, 0.02),
            offset_spread=offset,
            bend=rng.uniform(0.0, 0.04),
            row_noise=rng.uniform(0.3, 2.0),
            column_noise=rng.uniform(0.3, 2.0),
            bits=int(np.ceil(np.log2(well * gain + black + 40.0 * gain))),
            black=black,
        )


class Bench:
    """A camera before a lamp.

    Parameters
    ----------
    camera : Camera
    rng : Generator
    shape : (int, int)
        Height and width of its frames.
    light : ndarray of shape (height, width)
        Of the scene, relative.
    """

    def __init__(self, camera, rng, shape=(96, 96), light=1.0):
        self.camera, self.rng, self.shape = camera, rng, shape
        self.gains = light * (1.0 + camera.gain_spread * rng.standard_normal(shape))
        self.offsets = camera.offset_spread * rng.standard_normal(shape)

    def frame(self, light, time):
        """Grey levels of a frame that collects a number of electrons from the light."""
        camera, rng, (height, width) = self.camera, self.rng, self.shape
        electrons = rng.poisson(light * self.gains) + rng.poisson(camera.dark_current * time, size=self.shape)
        held = np.minimum(electrons, camera.full_well)
        volts = held * (1.0 - camera.bend * held / camera.full_well) + self.offsets
        volts = volts + camera.read_noise * rng.standard_normal(self.shape)
        volts = volts + camera.row_noise * rng.standard_normal((height, 1))
        volts = volts + camera.column_noise * rng.standard_normal((1, width))
        levels = np.floor(camera.gain * volts + camera.black + 0.5)
        return np.clip(levels, 0, 2**camera.bits - 1).astype(np.uint8 if camera.bits <= 8 else np.uint16)

    def light(self, count, levels=LEVELS, flicker=0.0):
        """Bursts of light; the well fills in a tenth of a second."""
        bursts = []
        for level in levels:
            bright = level * self.camera.full_well * (1.0 + flicker * self.rng.standard_normal(count))
            frames = np.stack([self.frame(one, 0.1 * level) for one in bright])
            bursts.append(Burst(name=f"light {level}", frames=frames, time=0.1 * level))
        return bursts

    def dark(self, count, times=DARK_TIMES):
        """Bursts with the lens covered."""
        return [
            Burst(name=f"dark {time}", frames=np.stack([self.frame(0.0, time) for _ in range(count)]), time=time)
            for time in times
        ]


def truth(camera, linear):
    """What the figures of a camera should be, by name; ``linear`` are the levels that its linearity is taken from."""
    level = np.array(linear)
    signal = level * (1.0 - camera.bend * level)
    weights = 1.0 / signal**2
    lines = np.stack([np.ones_like(level), level], axis=1)
    offset, slope = np.linalg.solve(lines.T @ (weights[:, None] * lines), lines.T @ (weights * signal))
    return {
        "gain": camera.gain,
        "read_noise": camera.read_noise,
        "temporal_dark_noise": float(np.sqrt(camera.read_noise**2 + camera.row_noise**2 + camera.column_noise**2)),
        "full_well": camera.full_well,
        "dark_current": camera.dark_current,
        "gain_spread": camera.gain_spread,
        "offset_spread": camera.offset_spread,
        "row_noise": camera.row_noise,
        "column_noise": camera.column_noise,
        "nonlinearity": camera.bend,
        "linearity_error": float(np.abs(signal / (offset + slope * level) - 1.0).mean()),
    }
