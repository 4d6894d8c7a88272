"""Albedos of real surfaces, each with what it was taken from.

An albedo is the share of the light that a surface reflects, in all directions; all are taken as Lambertian and, but
for three, as neutral in colour.
"""

from __future__ import annotations

from dataclasses import dataclass

from generator.model.arrays import Range, Vector

_SPECTRALON = "Labsphere, Spectralon diffuse reflectance standards (SRS): nominal"
_GREY_CARD = "Kodak Gray Cards, R-27: nominal"
_CHART = (
    "McCamy, Marcus and Davidson, A color-rendition chart, J. Appl. Photogr. Eng. 2(3), 95 (1976): luminance factor"
)
_OKE = "Oke, Boundary Layer Climates, 2nd ed. (1987): range of solar albedo; its middle"
_ROOMS = "EN 12464-1:2011, Lighting of indoor work places: range that is recommended; its middle"
_CORNELL = "CornellBox-Original.mtl, McGuire Computer Graphics Archive: linear RGB"
TYPICAL = "typical"
"""Source of what was taken from no publication: the range is a rule of thumb, and its middle is taken."""


@dataclass(frozen=True)
class Albedo:
    """Albedo of a kind of surface.

    Attributes
    ----------
    name : str
    value : (float, float, float)
        Red, green and blue.
    source : str
        What it was taken from, or `TYPICAL`.
    range : (float, float), optional
        Range that the source gives, of which `value` is the middle; None if it gives a value.
    """

    name: str
    value: Vector
    source: str
    range: Range | None = None


def _grey(name: str, value: float, source: str) -> Albedo:
    return Albedo(name, (value, value, value), source)


def _between(name: str, low: float, high: float, source: str) -> Albedo:
    middle = round((low + high) / 2.0, 3)
    return Albedo(name, (middle, middle, middle), source, (low, high))


ALBEDOS = (
    *(_grey(f"Spectralon {percent} %", percent / 100.0, _SPECTRALON) for percent in (99, 50, 20, 2)),
    _grey("Grey card", 0.18, _GREY_CARD),
    _grey("Grey card, white side", 0.9, _GREY_CARD),
    _grey("ColorChecker white 9.5", 0.9, _CHART),
    _grey("ColorChecker neutral 8", 0.591, _CHART),
    _grey("ColorChecker neutral 6.5", 0.362, _CHART),
    _grey("ColorChecker neutral 5", 0.198, _CHART),
    _grey("ColorChecker neutral 3.5", 0.09, _CHART),
    _grey("ColorChecker black 2", 0.031, _CHART),
    Albedo("Cornell box white", (0.725, 0.71, 0.68), _CORNELL),
    Albedo("Cornell box red", (0.63, 0.065, 0.05), _CORNELL),
    Albedo("Cornell box green", (0.14, 0.45, 0.091), _CORNELL),
    _between("White paint, outdoors", 0.5, 0.9, _OKE),
    _between("Concrete", 0.1, 0.35, _OKE),
    _between("Brick", 0.2, 0.4, _OKE),
    _between("Stone", 0.2, 0.35, _OKE),
    _between("Asphalt", 0.05, 0.2, _OKE),
    _between("Ceiling of a work place", 0.7, 0.9, _ROOMS),
    _between("Wall of a work place", 0.5, 0.8, _ROOMS),
    _between("Floor of a work place", 0.2, 0.4, _ROOMS),
    _between("Furniture of a work place", 0.2, 0.7, _ROOMS),
    _between("White wall paint", 0.8, 0.9, TYPICAL),
    _between("Gypsum plaster", 0.7, 0.9, TYPICAL),
    _between("White paper", 0.7, 0.9, TYPICAL),
    _between("Light wood", 0.3, 0.5, TYPICAL),
    _between("Dark wood", 0.1, 0.2, TYPICAL),
    _between("Brown cardboard", 0.3, 0.5, TYPICAL),
    _between("Black paint", 0.03, 0.06, TYPICAL),
    _between("Black felt", 0.01, 0.05, TYPICAL),
)


def named(name: str) -> Albedo:
    """Return the albedo of a surface by its name, one of `ALBEDOS`."""
    return next(albedo for albedo in ALBEDOS if albedo.name == name)
