"""``sensor.toml``: a camera's figures, as ``nlos-classify sensor`` measures them or a person writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from classify.pictures.sensor import Sensor
from generator.files.toml import dump_toml, from_dict, read_toml
from generator.files.writing import write_text
from generator.model.errors import NlosError, instead

if TYPE_CHECKING:
    from classify.pictures.photon_transfer import Measured

_TABLES = ("sensor", "interval", "measured")


def read(path: Path) -> Sensor:
    """Return the sensor of a file: its keys are those of `Sensor`, in a table ``[sensor]`` or without one.

    Raises
    ------
    NlosError
        If the file is missing, is not TOML, or holds something else.
    """
    given = read_toml(path)
    if isinstance(given.get("sensor"), Mapping):
        if other := sorted(set(given) - set(_TABLES)):
            raise NlosError(f"{path}: {other[0]}: stands outside the table [sensor]; {instead(other[0], _TABLES)}")
        given = given["sensor"]
    try:
        sensor: Sensor = from_dict(Sensor, given)
    except NlosError as error:
        raise NlosError(f"{path}: {error}") from None
    return sensor


def write(path: Path, measured: Measured) -> None:
    """Write a camera's figures: its sensor, the ends of their 95 % intervals, and what else was found."""
    plain = asdict(Sensor())
    own = {name: value for name, value in asdict(measured.sensor).items() if value != plain[name]}
    fields = {"bits": measured.sensor.bits, **own}
    ends = {name: [one.low, one.high] for name, one in measured.intervals.items() if name in plain}
    height, width = measured.light[0].mean.shape
    further: dict[str, Any] = {
        "by": "nlos-classify sensor, photon transfer of EMVA 1288",
        "light": [one.name for one in measured.light],
        "dark": [one.name for one in measured.dark],
        "frames": [one.frames for one in (*measured.light, *measured.dark)],
        "pixels": [width, height],
        "doubts": measured.doubts,
    }
    further |= {
        name: {"value": one.value, "low": one.low, "high": one.high}
        for name, one in measured.intervals.items()
        if name not in plain and math.isfinite(one.value)
    }
    write_text(path, dump_toml({"sensor": fields, "interval": ends, "measured": further}))
