"""What is not known exactly of a scene: joint deviations of its values, and furniture that nobody measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from generator.model.arrays import Array, Range
from generator.model.described import check_ranges, described, documented
from generator.model.errors import NlosError, instead, require
from generator.model.variation import Values

RELATIVE = ("spot.power", "target.size", "ambient")
"""Names whose values are factors on those of the scene."""

_LARGEST = 85.0
_PHYSICAL: dict[str, Range] = {
    **{f"{part}.location.{axis}": (-math.inf, math.inf) for part in ("spot", "camera") for axis in "xyz"},
    **{f"{part}.location.y": (1e-3, math.inf) for part in ("spot", "camera")},
    **{f"{name}.{axis}": (-math.inf, math.inf) for name in ("spot.aim", "camera.view") for axis in "xz"},
    "spot.half_angle": (0.1, _LARGEST),
    **{f"{part}.albedo": (0.0, 1.0) for part in ("wall", "room", "target")},
    "spot.power": (0.05, math.inf),
    "target.size": (0.05, math.inf),
    "ambient": (0.0, math.inf),
}
"""Values that each name may have, others are drawn again."""

NAMES = tuple(_PHYSICAL)
"""What of a scene may be uncertain. Lengths are metres, absolute (``spot.location.x``, ``spot.aim.x``,
``camera.view.x``: the middle of the watched rectangle), ``spot.half_angle`` is in degrees, albedos are absolute; of
`RELATIVE` values are factors."""

SALT = 2000
"""Distinguishes the stream of these draws from those of `generator.model.variation` and of the poses."""
ATTEMPTS = 100
"""Most draws of a pose's scene until one has room for the target there, and lets lamp and camera see the wall."""
_TRIES = 10_000
_ROUNDING = 1e-6


@documented
@dataclass(frozen=True, kw_only=True)
class Furniture:
    """Boxes on the floor that nobody knows: number, edges, places and albedos are drawn at random."""

    boxes: tuple[int, int] = described(
        "least and largest number of boxes; each number is as likely", (0, 2), lo=0, hi=20
    )
    width: Range = described("least and largest horizontal edge, metres; log-uniform", (0.2, 1.0), lo=0.01, hi=100.0)
    height: Range = described("least and largest height, metres; log-uniform", (0.2, 1.2), lo=0.01, hi=100.0)
    albedo: Range = described("least and largest albedo; uniform", (0.2, 0.9), lo=0.0, hi=1.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        for name in ("boxes", "width", "height", "albedo"):
            low, high = getattr(self, name)
            require(low <= high, f"furniture.{name}: {[low, high]} must run from low to high")


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """What is not known exactly of a scene, as ``uncertainty.toml`` holds it; the mean is the scene itself.

    Attributes
    ----------
    version : int
        Version of the file's format.
    names : tuple of str
        What is uncertain, of `NAMES`.
    deviation : tuple of float
        Standard deviation of each, in its unit; of `RELATIVE`, relative to the scene's value.
    correlation : tuple of tuple of float
        Correlation of each with each; empty if they are independent.
    furniture : Furniture, optional
    """

    version: Literal[1] = 1
    names: tuple[str, ...] = ()
    deviation: tuple[float, ...] = ()
    correlation: tuple[tuple[float, ...], ...] = ()
    furniture: Furniture | None = field(default=None)

    def __post_init__(self) -> None:
        for k, name in enumerate(self.names):
            if name not in NAMES:
                raise NlosError(f"names: {name!r} is nothing that can be uncertain; {instead(name, NAMES)}")
            require(name not in self.names[:k], f"names: {name} is given twice; give one deviation for it")
        n = len(self.names)
        require(
            len(self.deviation) == n, f"deviation: has {len(self.deviation)} values for {n} names; give one for each"
        )
        for name, value in zip(self.names, self.deviation, strict=True):
            require(0.0 < value < math.inf, f"deviation: that of {name} is {value:g}; it must be above 0")
        require(bool(n or self.furniture), "names: nothing is uncertain; name something, or give [furniture]")
        if self.correlation:
            square = len(self.correlation) == n and all(len(row) == n for row in self.correlation)
            require(square, f"correlation: must be {n} rows of {n} values, in the order of names")
            matrix = np.array(self.correlation)
            require(bool(np.isfinite(matrix).all()), "correlation: a value is not finite")
            unit = np.abs(np.diag(matrix) - 1.0).max() < _ROUNDING and np.abs(matrix - matrix.T).max() < _ROUNDING
            require(bool(unit), "correlation: must be symmetric, with 1 on its diagonal")
            least = float(np.linalg.eigvalsh(matrix).min())
            require(
                least > -_ROUNDING * n,
                f"correlation: is of no joint distribution (its least eigenvalue is {least:.3g})",
            )

    @classmethod
    def of_covariance(cls, names: Sequence[str], covariance: Array) -> Uncertainty:
        """Return the uncertainty of values with a joint covariance (n, n), in the names' units."""
        deviation = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(deviation, deviation)
        np.fill_diagonal(correlation, 1.0)
        rows = (0.5 * (correlation + correlation.T)).tolist()
        return cls(names=tuple(names), deviation=tuple(deviation.tolist()), correlation=tuple(map(tuple, rows)))

    @property
    def covariance(self) -> Array:
        """Joint covariance (n, n) of the named values, before what is not physical is drawn again."""
        matrix = np.array(self.correlation) if self.correlation else np.eye(len(self.names))
        covariance: Array = matrix * np.outer(self.deviation, self.deviation)
        return covariance

    def check(self, scene: Mapping[str, Any]) -> None:
        """Raise NlosError if a scene, as plain tables, lacks a value that is uncertain."""
        for name in self.names:
            mean_of(scene, name)

    def draw(
        self, scene: Mapping[str, Any], seed: int, voxel: int, index: int, *, stream: int = 0, attempt: int = 0
    ) -> Values:
        """Return the values of a pose's scene; they follow from the set's seed, the voxel and the index in it.

        They are jointly normal about those of the scene; while one is not physical, all are drawn again.

        Parameters
        ----------
        scene : mapping
            The scene as plain tables.
        seed, voxel, index : int
            The set's seed, the number of the voxel, and the index of the pose within it.
        stream : int
            As `generator.model.poses.Sampler` takes it.
        attempt : int
            Number of earlier draws for this pose that the scene had no room for.

        Raises
        ------
        NlosError
            The scene lacks a value, or hardly any draw is physical.
        """
        means = [mean_of(scene, name) for name in self.names]
        rng = np.random.default_rng([seed, voxel, index, SALT, stream, attempt])
        factor = _factor(self.covariance.tolist())
        for _ in range(_TRIES):
            normal = rng.standard_normal(len(means)).tolist()
            values = [
                mean + math.fsum(a * b for a, b in zip(row, normal, strict=True))
                for mean, row in zip(means, factor, strict=True)
            ]
            bounds = (_PHYSICAL[name] for name in self.names)
            if all(low <= value <= high for value, (low, high) in zip(values, bounds, strict=True)):
                return tuple(zip(self.names, values, strict=True))
        raise NlosError(
            f"uncertain: {_TRIES} draws of {', '.join(self.names)} gave none that is physical; state less"
        )


def _factor(covariance: list[list[float]]) -> list[list[float]]:
    """Return Cholesky's factor of a covariance, which may be singular: in plain numbers, alike on every machine."""
    n = len(covariance)
    factor = [[0.0] * n for _ in range(n)]
    for j in range(n):
        pivot = covariance[j][j] - math.fsum(x * x for x in factor[j][:j])
        if pivot <= 1e-12 * covariance[j][j]:
            continue
        factor[j][j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            done = math.fsum(a * b for a, b in zip(factor[i][:j], factor[j][:j], strict=True))
            factor[i][j] = (covariance[i][j] - done) / factor[j][j]
    return factor


def mean_of(scene: Mapping[str, Any], name: str) -> float:
    """Return the value that a scene, as plain tables, has for one of `NAMES`: 1 for those of `RELATIVE`.

    Raises
    ------
    NlosError
        The scene has no such value, or none that is one number.
    """
    if name in RELATIVE:
        return 1.0
    part, _, rest = name.partition(".")
    quantity, _, axis = rest.partition(".")
    table = scene.get(part, {})
    if quantity == "view":
        return 0.5 * math.fsum(table[axis])
    value = table.get(quantity)
    if value is None:
        raise NlosError(f"uncertain: {name} has no single value in this scene; leave it out")
    return float(value["xyz".index(axis)] if axis else value)


def offsets(scene: Mapping[str, Any], values: Values) -> dict[str, float]:
    """Return by how much drawn values differ from those of a scene: relative for `RELATIVE`, else in their units."""
    return {name: value - mean_of(scene, name) for name, value in values}
