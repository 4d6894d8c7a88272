"""Named feature vectors of pictures: the paper's two feature sets, and one from physics.

Pictures are averaged in linear light first and tone-mapped afterwards. The constants of the tone mapping follow from
the scene (the radiance of the directly lit patch), never from the pictures: no information leaks from one fold into
another, and the same constants hold for every target of that scene.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import mahotas
import numpy as np
from numpy.typing import NDArray

from classify.pictures import physics
from classify.pictures.settings import FeatureSettings
from generator.files.pictures import Picture
from generator.model.errors import NlosError

Array = NDArray[np.float64]

HARALICK = (
    *("angular_second_moment", "contrast", "correlation", "variance", "inverse_difference_moment", "sum_average"),
    *("sum_variance", "sum_entropy", "entropy", "difference_variance", "difference_entropy"),
    *("information_1", "information_2"),
)

_SPATIAL = 16
_HOG_SIZE, _HOG_CELL, _HOG_BLOCK, _HOG_BINS = 32, 8, 16, 9
_HU_UNIT = 1e-12
_SMALLEST = 1e-300


def tone_map(light: Array, settings: FeatureSettings, reference: float) -> Array:
    """Map radiance to shades from -1 to 1; odd, monotone, clipped at the ceiling.

    Parameters
    ----------
    light : ndarray of any shape
        Radiance or difference of radiances, W/m^2/sr.
    settings : FeatureSettings
    reference : float
        The scene's reference radiance, W/m^2/sr.
    """
    with np.errstate(over="ignore"):  # without light in the scene the quotient may overflow; it is clipped below
        scaled = light / max(reference, _SMALLEST)
        if settings.tone == "linear":
            shades = scaled / settings.ceiling
        else:
            shades = np.arcsinh(scaled / settings.floor) / np.arcsinh(settings.ceiling / settings.floor)
    clipped: Array = np.clip(shades, -1.0, 1.0)
    return clipped


def feature_names(settings: FeatureSettings) -> list[str]:
    """Return the names of the features, in order."""
    return FEATURE_SETS[settings.set].names(settings)


def describe(
    picture: Picture,
    settings: FeatureSettings,
    *,
    reference: float,
    background: Picture | None = None,
    name: str = "picture",
) -> Array:
    """Return a picture's features.

    Parameters
    ----------
    picture : ndarray of shape (height, width, 3)
        Scene-linear radiance, W/m^2/sr.
    settings : FeatureSettings
    reference : float
        The scene's reference radiance, W/m^2/sr.
    background : ndarray of shape (height, width, 3), optional
        Background picture, needed if the settings ask for the difference.
    name : str
        Name of the picture, for messages.

    Returns
    -------
    ndarray of shape (n_features,)
        Finite for any picture.

    Raises
    ------
    NlosError
        If the picture holds NaN or infinite pixels, or its size is not that of the background.
    """
    light = np.asarray(picture, dtype=np.float64)
    _check_finite(light, name)
    if settings.input == "difference":
        if background is None:
            raise NlosError(f"{name}: the features need the background picture to subtract, and there is none")
        if background.shape != picture.shape:
            raise NlosError(
                f"{name}: has {picture.shape[1]} x {picture.shape[0]} pixels, but its background "
                f"{background.shape[1]} x {background.shape[0]}"
            )
        _check_finite(np.asarray(background), f"{name}: its background")
        light = light - background
    light = _average(light, settings.size)
    if settings.set == "physics" and settings.setup is None:
        raise NlosError(f"{name}: features of physics need to know the scene's setup, and there is none")
    return FEATURE_SETS[settings.set].describe(light, settings, reference)


def _check_finite(light: Array, name: str) -> None:
    bad = int((~np.isfinite(light)).sum())
    if bad:
        raise NlosError(f"{name}: holds {bad} NaN or infinite values; render it again")


def _average(light: Array, size: int) -> Array:
    """Average down to at most ``size`` pixels a side; smaller pictures stay as they are."""
    height, width = light.shape[:2]
    if max(height, width) <= size:
        return light
    target = (min(width, size), min(height, size))
    smaller = np.asarray(cv2.resize(light, target, interpolation=cv2.INTER_AREA), dtype=np.float64)
    return smaller.reshape(target[1], target[0], -1)


def _histogram(shades: Array, bins: int) -> Array:
    """Share of pixels per shade, channel by channel."""
    # OpenCV's upper limit is exclusive, but a clipped white pixel must count in the last bin.
    channels = [np.ascontiguousarray(shades[..., i], dtype=np.float32) for i in range(3)]
    counts = [cv2.calcHist([c], [0], None, [bins], [-1.0, 1.0 + 1e-6]).ravel() for c in channels]
    shares: Array = np.concatenate(counts).astype(np.float64) / shades[..., 0].size
    return shares


def _hu(grey: Array) -> Array:
    """Hu's seven invariants of the positive light, compressed by a signed logarithm (Hu 1962, eq. 57 ff.).

    They depend on shape alone: any common factor of the light drops out.
    """
    light = np.maximum(grey, 0.0)
    peak = light.max()
    if peak <= 0.0:
        return np.zeros(7)
    moments = cv2.HuMoments(cv2.moments((light / peak).astype(np.float32))).ravel().astype(np.float64)
    finite = np.nan_to_num(moments, nan=0.0, posinf=0.0, neginf=0.0)
    compressed: Array = np.sign(finite) * np.log10(1.0 + np.abs(finite) / _HU_UNIT)
    return compressed


def _haralick(shades: Array, levels: int) -> Array:
    """Haralick's thirteen texture measures, averaged over the four directions (Haralick et al. 1973)."""
    grey = np.round((shades + 1.0) / 2.0 * (levels - 1)).astype(np.uint8)
    if min(grey.shape) < 2:  # co-occurrence needs neighbours: repeat the single row or column
        grey = np.pad(grey, [(0, 1 if n < 2 else 0) for n in grey.shape], mode="edge")
    with np.errstate(all="ignore"):  # a constant picture has no correlation: 0/0, which counts as 0
        texture = mahotas.features.haralick(grey).mean(axis=0)
    finite: Array = np.nan_to_num(texture, nan=0.0, posinf=0.0, neginf=0.0)
    return finite


def _hog(grey: Array) -> Array:
    """Histogram of oriented gradients (Dalal and Triggs 2005) of the picture stretched to its own range.

    Its blocks are normalised, so the level drops out anyway; stretching keeps faint pictures visible in eight bits.
    """
    small = cv2.resize(grey, (_HOG_SIZE, _HOG_SIZE), interpolation=cv2.INTER_AREA)
    low, spread = small.min(), np.ptp(small)
    stretched = (small / 2 - low / 2) / (spread / 2) * 255.0 if spread > _SMALLEST else np.zeros_like(small)
    cell, block = (_HOG_CELL, _HOG_CELL), (_HOG_BLOCK, _HOG_BLOCK)
    descriptor = cv2.HOGDescriptor((_HOG_SIZE, _HOG_SIZE), block, cell, cell, _HOG_BINS)
    gradients: Array = np.asarray(descriptor.compute(np.round(stretched).astype(np.uint8)), dtype=np.float64).ravel()
    return gradients


def software() -> dict[str, Any]:
    """Return the versions of the libraries that compute the features."""
    return {"opencv": cv2.__version__, "mahotas": mahotas.__version__, "numpy": np.__version__}


def _histogram_names(settings: FeatureSettings) -> list[str]:
    return [f"histogram_{channel}_{i}" for channel in "rgb" for i in range(settings.bins)]


def _global_names(settings: FeatureSettings) -> list[str]:
    names = [*(f"hu_{i}" for i in range(1, 8)), *(f"haralick_{name}" for name in HARALICK)]
    return [*_histogram_names(settings), *names]


def _global(light: Array, settings: FeatureSettings, reference: float) -> Array:
    grey = light.mean(axis=2)
    histogram = _histogram(tone_map(light, settings, reference), settings.bins)
    return np.concatenate([histogram, _hu(grey), _haralick(tone_map(grey, settings, reference), settings.levels)])


def _spatial_names(settings: FeatureSettings) -> list[str]:
    steps = (_HOG_SIZE - _HOG_BLOCK) // _HOG_CELL + 1
    n_hog = steps**2 * (_HOG_BLOCK // _HOG_CELL) ** 2 * _HOG_BINS
    spatial = [f"spatial_{row}_{column}" for row in range(_SPATIAL) for column in range(_SPATIAL)]
    return [*spatial, *_histogram_names(settings), *(f"hog_{i}" for i in range(n_hog))]


def _spatial(light: Array, settings: FeatureSettings, reference: float) -> Array:
    grey = light.mean(axis=2)
    histogram = _histogram(tone_map(light, settings, reference), settings.bins)
    small = tone_map(cv2.resize(grey, (_SPATIAL, _SPATIAL), interpolation=cv2.INTER_AREA), settings, reference)
    return np.concatenate([small.ravel(), histogram, _hog(grey)])


def _physics(light: Array, settings: FeatureSettings, reference: float) -> Array:
    assert settings.setup is not None  # `describe` says so
    features = physics.PhysicsFeatures(settings.setup, reference, settings.floor).transform(light[None])
    return np.asarray(features[0], dtype=np.float64)


class FeatureSet(NamedTuple):
    """A set of features.

    Attributes
    ----------
    names : callable
        Returns the names of the features, given the settings.
    describe : callable
        Returns the features, (n_features,), given the light (height, width, 3), W/m^2/sr, the settings and the
        scene's reference radiance.
    """

    names: Callable[[FeatureSettings], list[str]]
    describe: Callable[[Array, FeatureSettings, float], Array]


FEATURE_SETS = {
    "global": FeatureSet(_global_names, _global),
    "spatial-hog": FeatureSet(_spatial_names, _spatial),
    "physics": FeatureSet(lambda _: physics.names(), _physics),
}
"""By the names that `FeatureSettings.set` takes."""
