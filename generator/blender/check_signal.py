"""Measures how much light the hidden object adds, compared with the noise, by a few quick renders."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from generator.blender.engines import renderers, survey
from generator.blender.finding import ERROR, GOOD, NOTE, WARNING, Finding
from generator.blender.scene import roles
from generator.blender.scene.description import read_scene
from generator.measure import student
from generator.model.arrays import Array
from generator.model.engines import ENGINES
from generator.model.quantities import ROUNDING, byte_size, rough_time
from generator.model.settings import Sweep

_PROBE_SAMPLES, _PROBES, _PATIENCE = 16, 64, 8.0
"""Samples of a probe's pictures; most pairs of pictures if `surfel` can measure instead; and most seconds."""
_SMALL, _ROUGH = 32, 1e-2
"""Pixels of the longer side, and accuracy, of pictures by `surfel` that only measure how much the object adds."""
_BYTES_PER_VALUE = 3.7
"""Size of a float32 in a compressed EXR file: noise hardly compresses."""


@dataclass(frozen=True)
class Probe:
    """What a few quick renders predict for a sweep; see `probe`.

    Attributes
    ----------
    engine : str
    share : float
        Mean of the difference picture, relative to the mean of the picture.
    signal_to_noise : float
        Root mean square of the difference picture over that of its noise, at the sweep's samples; for `surfel`, over
        that of the requested error. NaN if the pictures do not determine it.
    seconds : float
        Time of the sweep on all cores, without starting Blender.
    bytes : float
        Size of its pictures on disk.
    error : float
        Half the 95 % interval of the share; 0 if it is known without noise.
    hidden : bool
        Whether the signal could not be separated from the noise.
    missed : int
        Number of samples taken, if the object changed none of them; else 0.
    exact : bool
        Whether the share is known without noise, from the engine `surfel`.
    other : bool
        Whether `surfel` can render the scene as well.
    target : str
        Name of the object.
    """

    engine: str
    share: float
    signal_to_noise: float
    seconds: float
    bytes: float
    error: float = 0.0
    hidden: bool = False
    missed: int = 0
    exact: bool = False
    other: bool = False
    target: str = ""

    def findings(self) -> list[Finding]:
        """Return the prediction as findings."""
        cost = f"A sweep takes about {rough_time(self.seconds)} and {byte_size(self.bytes)} on disk"
        return [replace(self._signal(), object=self.target), Finding(NOTE, cost)]

    def _signal(self) -> Finding:
        if self.exact and self.signal_to_noise == 0.0:
            rounding = f"above the rounding of float32, {_share(ROUNDING)} of a pixel"
            remedy = "put it where the lit patch and the watched one see it, or give it a lighter material"
            return Finding(ERROR, f"The object makes no change {rounding}, where it stands now; {remedy}")
        more = " or the engine 'surfel'" if self.other and self.engine != "surfel" else ""
        missed = f"none of {self.missed:,} samples of {self.engine!r} met it"
        if self.missed and not self.exact:
            # Rule of three: a share met in none of n tries is, with 95 % confidence, at most 3 / n.
            text = f"What the object adds to the picture is not known: {missed}, nor do more than "
            return Finding(WARNING, f"{text}{_rounded_up(3.0 / self.missed)} of all (95 %); take more")
        adds = f"The object adds {_share(self.share)} to the picture"
        if self.error:
            adds = f"The object adds {_uncertain(self.share, self.error)} to the picture (95 %)"
        if self.hidden:
            seen = "in no single pixel above" if abs(self.share) > self.error > 0.0 else "hidden by"
            return Finding(WARNING, f"{adds}, {seen} the noise of {self.engine!r}; more samples would tell")
        if self.missed:
            return Finding(WARNING, f"{adds}, but {missed}; take many more{more}")
        if not ENGINES[self.engine].noisy:
            return Finding(GOOD, f"{adds}; its difference is computed to {_share(1.0 / self.signal_to_noise)}")
        stands = f"its difference is {self.signal_to_noise:.3g} times the noise of {self.engine!r}"
        if self.signal_to_noise < 1.0:
            stands += ", below it"
        elif math.isnan(self.signal_to_noise):
            stands = f"its difference could not be compared with the noise of {self.engine!r}"
        if self.signal_to_noise >= 3.0:
            return Finding(GOOD, f"{adds}; {stands}")
        return Finding(WARNING, f"{adds}; {stands}; more samples{more} would mend that")


def probe(scene: bpy.types.Scene, sweep: Sweep) -> Probe:
    """Measure what a sweep's pictures will be like, with the target where it stands.

    Pairs of pictures with and without the target are rendered with few samples and independent noise. What their
    differences have in common is signal; what varies is noise, whose mean square falls with the samples. Pairs are
    added until the signal is significant, or for some seconds. If it stays insignificant, `surfel` measures the
    signal, if it can render the scene.

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
    samples = min(_PROBE_SAMPLES, sweep.samples)
    exact = not sweep.noisy
    surveyed = survey.survey(scene)
    other = exact or not (surveyed.reasons("surfel") or renderers.lacking(surveyed))
    with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)) as renderer:
        renderer.render(samples=samples, seed=0)  # warm-up: one-off work is not part of a picture's time
        if not exact:
            renderer.render(samples=samples, seed=0, target=False)
        differences, radiance, start = [], 0.0, time.perf_counter()
        for seed in itertools.count(1):
            picture = renderer.render(samples=samples, seed=seed).astype(np.float64)
            picture_end = time.perf_counter()
            differences.append((picture - renderer.render(samples=samples, seed=seed, target=False)).mean(axis=2))
            radiance += float(picture.mean())
            seconds = ((picture_end if exact else time.perf_counter()) - start) / seed
            signal, noise, significant = common_signal(np.array(differences))
            if exact or significant or (other and seed >= _PROBES) or time.perf_counter() - start > _PATIENCE:
                break
    (share, error), missed = added(differences, radiance / len(differences)), 0
    if not exact:
        noise *= samples / sweep.samples
        seconds *= sweep.samples / samples * (1.0 if sweep.paired else 0.5)
        missed = 0 if np.any(differences) else samples * picture[..., 0].size * len(differences)
    if not exact and not significant and other:
        share, signal = _exactly(scene, sweep.resolution)
    known_exactly = exact or (other and not significant)
    if exact:
        ratio = 1.0 / sweep.accuracy if signal else 0.0
    elif known_exactly and not signal:
        ratio = 0.0
    else:
        ratio = float(np.sqrt(signal / noise)) if noise > 0.0 else math.nan
    return Probe(
        engine=sweep.engine,
        share=share,
        signal_to_noise=ratio,
        seconds=seconds * pictures,
        bytes=_BYTES_PER_VALUE * 3.0 * sweep.resolution[0] * sweep.resolution[1] * pictures,
        error=0.0 if known_exactly else error,
        hidden=not known_exactly and not significant,
        missed=missed,
        exact=known_exactly,
        other=other,
        target=roles.find(scene, "target").name,
    )


def _exactly(scene: bpy.types.Scene, resolution: tuple[int, int]) -> tuple[float, float]:
    """Return the difference picture's mean, relative to the picture's, and its mean square, by `surfel`."""
    reduction = max(1.0, max(resolution) / _SMALL)
    size = (max(1, round(resolution[0] / reduction)), max(1, round(resolution[1] / reduction)))
    with renderers.opened(scene, "surfel", resolution=size, accuracy=_ROUGH) as renderer:
        picture = renderer.render(samples=0, seed=0).astype(np.float64).mean(axis=2)
        difference = picture - renderer.render(samples=0, seed=0, target=False).mean(axis=2)
    mean = float(picture.mean())
    return (float(difference.mean()) / mean if mean else 0.0), float((difference**2).mean())


def added(differences: Sequence[Array], radiance: float) -> tuple[float, float]:
    """Return the mean of n difference pictures relative to a picture's, and half its 95 % interval by Student's t.

    A single value x has an interval too: it holds the mean of a normal distribution in 95 % or more if it reaches
    from x by 9.68 times its distance from 0 to both sides (Blachman and Machol 1987); here by 12.7 times.
    """
    shares = np.array([difference.mean() for difference in differences]) / (radiance or 1.0)
    n, share = len(shares), float(shares.mean())
    spread = float(shares.std(ddof=1)) / math.sqrt(n) if n > 1 else abs(share)
    return share, student.quantile(max(1, n - 1)) * spread


def common_signal(pictures: Array) -> tuple[float, float, bool]:
    """Return mean squares of pictures' (n, height, width) common signal and noise, and if the signal is significant.

    The square of the mean of n pictures is too large by an n-th of one picture's noise, which is subtracted.
    """
    n = len(pictures)
    if n < 2:
        return float((pictures**2).mean()), 0.0, False
    noise = float(pictures.var(axis=0, ddof=1).mean())
    residual = noise / n
    signal = float((pictures.mean(axis=0) ** 2).mean()) - residual
    return max(signal, 0.0), noise, signal > 6.0 * residual * np.sqrt(2.0 / pictures[0].size)


def _rounded_up(share: float) -> str:
    """Return a bound with two significant digits, not below it."""
    step = 10.0 ** (math.floor(math.log10(share)) - 1)
    return f"{math.ceil(share / step - 1e-9) * step:.2g}"


def _uncertain(share: float, error: float) -> str:
    """Return a share and half its interval in per cent, both to the second digit of the latter."""
    digits = min(12, max(0, 1 - math.floor(math.log10(100.0 * error))))
    return f"{100.0 * share:.{digits}f} % ± {100.0 * error:.{digits}f} %"


def _share(share: float) -> str:
    """Return a share in per cent, with two significant digits if it is small."""
    return f"{share:.2%}" if abs(share) >= 1e-3 or share == 0.0 else f"{100.0 * share:.2g} %"
