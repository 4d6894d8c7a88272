"""The paper's experiments as a report: tables, pictures, and its claims tested."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from generator.blender.measure import experiment
from generator.blender.measure.experiment import Experiment
from generator.blender.scene import blend_file, build
from generator.files.pictures import write_picture
from generator.files.toml import from_dict, to_dict
from generator.files.writing import csv_text, write_text
from generator.measure import figures
from generator.model.presets import preset
from generator.model.scene import Scene

Open = Callable[[float], bpy.types.Scene]
"""What makes a scene under uniform ambient light of a radiance, W/m^2/sr."""

_COLUMNS = ["target", "place", "engine", "axis", "unit", "change_percent", "half_interval_percent"]


def presets() -> dict[str, Open]:
    """Return two places: an object in front of the wall that it lights, as the paper has it, and one aside of it."""
    return {name: partial(_preset, name) for name in ("tabletop", "room")}


def _preset(name: str, ambient: float) -> bpy.types.Scene:
    """Build a preset; a room has no ceiling, dark or not, so that light alone makes the difference."""
    scene = blend_file.new_file()
    open_above = to_dict(preset(name).with_ambient(1.0))
    build.build(scene, from_dict(Scene, {**open_above, "ambient": ambient}))
    return scene


def run(
    number: int,
    folder: Path,
    places: Mapping[str, Open],
    settings: Mapping[str, Any],
    *,
    ambient: float = 0.0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[str]:
    """Do an experiment everywhere, dark and lit, write ``changes.csv``, figures and pictures, and say what was found.

    Parameters
    ----------
    number : {1, 2, 3}
    folder : Path
        Files of other names in it are left alone.
    places : mapping
    settings : mapping
        ``pixels``, ``samples`` and ``repeats`` of `experiment.run`.
    ambient : float
        Light that the sky alone would give the wall, in units of the mean signal with the object at rest; 0 is dark.
    progress : callable
        Is told how many pictures are taken, and of how many.

    Yields
    ------
    str
        A line for the reader.
    """
    rows: list[list[str]] = []
    for target in {1: ("sphere",), 2: ("sheet",), 3: ("sphere", "sheet")}[number]:
        done: dict[str, Experiment] = {}
        for name, opened in places.items():
            dark = experiment.run(opened(0.0), number, target, progress=progress, **settings)
            done[name] = dark
            if ambient:
                sky = ambient * abs(float(dark.rest.mean()))
                lit = f"{name} under ambient light"
                done[lit] = experiment.run(opened(sky), number, target, progress=progress, **settings)
        for name, found in done.items():
            rows += [[target, name, found.engine, *cells] for cells in _cells(found)]
            yield _sentence(found, name)
            for axis, letter in enumerate("xyz"):
                row = np.concatenate(found.differences[axis], axis=1).astype(np.float32)
                write_picture(folder / f"{target}-{name.replace(' ', '-')}-{letter}.exr", row, {"units": "W/m^2/sr"})
        path = folder / f"experiment-{number}-{target}.png"
        _draw(path, done)
        yield f"{path}"
    write_text(folder / "changes.csv", csv_text(_COLUMNS, rows))
    yield f"{folder / 'changes.csv'}"


def _cells(found: Experiment) -> list[list[str]]:
    unit, factor = _unit(found)
    return [
        [axis, unit, f"{100.0 * factor * value:.5g}", f"{100.0 * factor * half:.3g}"]
        for axis, (value, half) in zip("xyz", found.changes(), strict=True)
    ]


def _unit(found: Experiment) -> tuple[str, float]:
    """What changes are counted per, and how much of a metre or degree that is."""
    return ("degree", 1.0) if found.number == 3 else ("cm", 0.01)


def _sentence(found: Experiment, place: str) -> str:
    """What moves the signal, strongest first, and whether the paper's claim holds."""
    unit, factor = _unit(found)
    changes = found.changes()
    order = sorted(range(3), key=lambda axis: -changes[axis][0])
    told = ", ".join(
        f"{'xyz'[axis]} {100.0 * factor * changes[axis][0]:.3g}"
        + (f" ± {100.0 * factor * changes[axis][1]:.2g}" if changes[axis][1] else "")
        for axis in order
    )
    how = "turned about" if found.number == 3 else "moved along"
    if not np.isfinite(changes).all():
        return (
            f"{found.target}, {place} ({found.engine}): noise drowns the signal; ask for more --samples or --repeats"
        )
    return f"{found.target}, {place} ({found.engine}): {how} {told} % of the signal per {unit}; {_claim(found)}"


def _claim(found: Experiment) -> str:
    """The paper's claim (end of section 5.1) against what was found; nothing is claimed within the intervals."""
    (x, dx), (y, dy), (z, dz) = found.changes()
    if found.number == 3:
        if found.target == "sphere":
            return "a ball looks the same however it is turned"
        other, spread = min((x, dx), (z, dz))
        if abs(other - y) <= dx + dy + dz:
            return "which axis matters is within the noise"
        return "the paper's x and z matter most: " + ("so it is" if other > y else "not here")
    strongest, spread = max((x, dx), (z, dz))
    if abs(y - strongest) <= dy + spread:
        return "which axis is the strongest is within the noise"
    return "the paper's strongest is y: " + ("so it is" if y > strongest else "not here")


def _draw(path: Path, done: Mapping[str, Experiment]) -> None:
    first = next(iter(done.values()))
    steps = np.arange(len(first.poses[0])) - len(first.poses[0]) // 2
    moved = [k for k in range(len(steps)) if steps[k]]
    blocks = [(place, found.differences[:, moved].mean(axis=-1)) for place, found in done.items()]
    signal = [float(np.quantile(np.abs(found.rest.mean(axis=-1)), 0.995)) for found in done.values()]
    how = "turned" if first.number == 3 else "moved"
    title = f"Experiment {first.number}: a {first.target} is {how}; × is how far a difference is amplified to be as "
    figures.experiment(
        path,
        title + "bright as the signal at rest",
        blocks,
        [_shift(first.number, int(s)) for s in steps[moved]],
        signal,
    )


def _shift(number: int, steps: int) -> str:
    """What stands over a column; a step is an eighth of the voxel."""
    return f"{steps * experiment.TURN:+.3g}°" if number == 3 else f"{steps:+d}/8 voxel"
