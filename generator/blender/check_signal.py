"""How much light the hidden object adds, against the noise: measured by a few quick renders."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass

import bpy
import numpy as np

from generator.blender.engines import renderers, survey
from generator.blender.finding import ERROR, GOOD, NOTE, WARNING, Finding
from generator.blender.scene.description import read_scene
from generator.model.arrays import Array
from generator.model.quantities import byte_size, rough_time
from generator.model.settings import Sweep

_PROBE_SAMPLES, _PROBES, _PATIENCE = 16, 64, 8.0
"""Of a probe's pictures; how many pairs where another engine can be asked; and for how many seconds at most."""
_SMALL, _ROUGH = 32, 1e-2
"""What `surfel` is asked with, where it only has to say how much the object adds: pixels a side, and accuracy."""
_BYTES_PER_VALUE = 3.7
"""Of a float32 in a compressed EXR file: noise hardly packs."""


@dataclass(frozen=True)
class Probe:
    """What a few quick renders tell of a sweep; see `probe`.

    Attributes
    ----------
    engine : str
    share : float
        Mean of the difference picture, of the picture's.
    signal_to_noise : float
        Root mean square of the difference picture over that of its noise, at the sweep's samples; for `surfel`, over
        that of the error asked for. NaN if the pictures do not tell.
    seconds : float
        That the sweep takes on all cores, without starting Blender.
    bytes : float
        That its pictures take on disk.
    error : float
        Standard error of the share, where it was not told from the noise; else 0.
    missed : int
        Samples taken, if the object changed none of them; else 0.
    exact : bool
        Whether the share is known without noise, from the engine `surfel`.
    other : bool
        Whether `surfel` can render the scene as well.
    """

    engine: str
    share: float
    signal_to_noise: float
    seconds: float
    bytes: float
    error: float = 0.0
    missed: int = 0
    exact: bool = False
    other: bool = False

    def findings(self) -> list[Finding]:
        """Return it in sentences."""
        cost = f"A sweep takes about {rough_time(self.seconds)} and {byte_size(self.bytes)} on disk"
        return [self._signal(), Finding(NOTE, cost)]

    def _signal(self) -> Finding:
        if self.exact and self.signal_to_noise == 0.0:
            return Finding(ERROR, "The object changes nothing in the pictures, where it stands now")
        more = " or the engine 'surfel'" if self.other and self.engine != "surfel" else ""
        missed = f"none of {self.missed:,} samples of {self.engine!r} met it"
        if self.missed and not self.exact:
            # Three in n is what, with 95 %, is not exceeded by what was met in none of n tries.
            text = (
                f"What the object adds to the picture is not known: {missed}, nor do more than {3 / self.missed:.1g}"
            )
            return Finding(WARNING, f"{text} of all (95 %); take more")
        if self.error:
            low, high = self.share - 2.0 * self.error, self.share + 2.0 * self.error
            text = f"The object adds {_share(low)} to {_share(high)} to the picture (95 %)"
            return Finding(WARNING, f"{text}, which the noise of {self.engine!r} hides; more samples would tell")
        adds = f"The object adds {_share(self.share)} to the picture"
        if self.missed:
            return Finding(WARNING, f"{adds}, but {missed}; take many more{more}")
        stands = f"its difference stands {self.signal_to_noise:.3g} times above the noise of {self.engine!r}"
        if self.signal_to_noise >= 3.0:
            return Finding(GOOD, f"{adds}; {stands}")
        return Finding(WARNING, f"{adds}; {stands}; more samples{more} would mend that")


def probe(scene: bpy.types.Scene, sweep: Sweep) -> Probe:
    """Measure what a sweep's pictures will be like, with the target where it stands.

    Pairs of pictures with and without the target, with few samples and noise of their own: what their differences
    share is signal, where they differ is noise, whose mean square falls with the samples. So many pairs, and no more
    than some seconds, as tell the signal from the noise. Where they do not, the signal is `surfel`'s, if that can
    render the scene.

    Parameters
    ----------
    scene : bpy.types.Scene
    sweep : Sweep

    Raises
    ------
    NlosError
        The engine cannot honour something in the scene.
    """
    voxels = read_scene(scene).grid.n_voxels
    pictures = sweep.poses * voxels
    few = min(_PROBE_SAMPLES, sweep.samples)
    exact = not sweep.noisy
    other = exact or not survey.survey(scene, ambient=True).reasons("surfel")
    with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)) as renderer:
        renderer.render(samples=few, seed=0)  # what is made once is no part of a picture's time
        if not exact:
            renderer.render(samples=few, seed=0, target=False)
        differences, level, start = [], 0.0, time.perf_counter()
        for seed in itertools.count(1):
            picture = renderer.render(samples=few, seed=seed).astype(np.float64)
            begun = time.perf_counter()
            differences.append((picture - renderer.render(samples=few, seed=seed, target=False)).mean(axis=2))
            level += float(picture.mean())
            seconds = ((begun if exact else time.perf_counter()) - start) / seed
            signal, noise, sure = _signal(np.array(differences))
            if exact or sure or (other and seed >= _PROBES) or time.perf_counter() - start > _PATIENCE:
                break
    shares = np.array([d.mean() for d in differences]) / (level / len(differences) or 1.0)
    share, error, missed = float(shares.mean()), 0.0, 0
    if not exact:
        noise *= few / sweep.samples
        seconds *= sweep.samples / few * (1.0 if sweep.paired else 0.5)
        missed = 0 if np.any(differences) else few * picture[..., 0].size * len(differences)
    if not exact and not sure and other:
        share, signal = _exactly(scene, sweep.resolution)
    elif not exact and not sure:
        error = float(shares.std(ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else abs(share)
    told = exact or (other and not sure)
    if exact:
        ratio = 1.0 / sweep.accuracy if signal else 0.0
    elif told and not signal:
        ratio = 0.0
    else:
        ratio = float(np.sqrt(signal / noise)) if noise > 0.0 else math.nan
    return Probe(
        engine=sweep.engine,
        share=share,
        signal_to_noise=ratio,
        seconds=seconds * pictures,
        bytes=_BYTES_PER_VALUE * 3.0 * sweep.resolution[0] * sweep.resolution[1] * pictures,
        error=error,
        missed=missed,
        exact=told,
        other=other,
    )


def _exactly(scene: bpy.types.Scene, resolution: tuple[int, int]) -> tuple[float, float]:
    """What the object changes by the engine `surfel`: mean, of the picture's, and mean square of the difference."""
    longer = max(1.0, max(resolution) / _SMALL)
    size = (max(1, round(resolution[0] / longer)), max(1, round(resolution[1] / longer)))
    with renderers.opened(scene, "surfel", resolution=size, accuracy=_ROUGH) as renderer:
        picture = renderer.render(samples=0, seed=0).astype(np.float64).mean(axis=2)
        difference = picture - renderer.render(samples=0, seed=0, target=False).mean(axis=2)
    level = float(picture.mean())
    return (float(difference.mean()) / level if level else 0.0), float((difference**2).mean())


def _signal(pictures: Array) -> tuple[float, float, bool]:
    """Return mean squares of what pictures (n, height, width) share, and of a picture's noise; whether it is sure.

    The mean of n pictures has a n-th of the noise, which its square is too large by.
    """
    n = len(pictures)
    if n < 2:
        return float((pictures**2).mean()), 0.0, False
    noise = float(pictures.var(axis=0, ddof=1).mean())
    left = noise / n
    signal = float((pictures.mean(axis=0) ** 2).mean()) - left
    return max(signal, 0.0), noise, signal > 6.0 * left * np.sqrt(2.0 / pictures[0].size)


def _share(share: float) -> str:
    """A share in per cent, with two digits that say something."""
    return f"{share:.2%}" if abs(share) >= 1e-3 or share == 0.0 else f"{100.0 * share:.2g} %"
