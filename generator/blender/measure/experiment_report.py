"""Reports the paper's experiments: tables, pictures, and tests of its claims."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
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
from generator.measure import difference_panels
from generator.model.engines import traits_of
from generator.model.presets import preset
from generator.model.scene import Scene

Open = Callable[[float], bpy.types.Scene]
"""Returns a scene under uniform ambient light of a radiance, W/m^2/sr."""

_COLUMNS = [
    *("target", "place", "engine", "axis", "unit", "change_percent", "half_interval_percent", "step", "step_unit"),
    *("step_voxels", "pictures", "below_noise"),
]


@dataclass(frozen=True)
class Reported:
    """A part of a report, as soon as it is there.

    Attributes
    ----------
    words : str
        A line for the reader.
    place : str
        Name of the scene that was measured, and how it was lit.
    result : Experiment, optional
        What was measured there.
    file : Path, optional
        File that was written.
    """

    words: str
    place: str = ""
    result: Experiment | None = None
    file: Path | None = None


def presets() -> dict[str, Open]:
    """Return two places: the object in front of the wall that it lights, as in the paper, and to the side of it."""
    return {name: partial(_preset, name) for name in ("tabletop", "room")}


def _preset(name: str, ambient: float) -> bpy.types.Scene:
    """Build a preset; a room has no ceiling, even if dark, so that lit and dark differ by the light alone."""
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
) -> Iterator[Reported]:
    """Run an experiment in all places, dark and lit; write ``changes.csv``, figures and pictures; yield the results.

    Parameters
    ----------
    number : {1, 2, 3}
    folder : Path
        Output folder; files of other names in it are left alone.
    places : mapping
        Scenes by name.
    settings : mapping
        Arguments ``pixels``, ``samples``, ``repeats`` and ``device`` of `experiment.run`.
    ambient : float
        Light that the sky alone would give the wall, in units of the mean signal with the object at rest; 0 is dark.
    progress : callable
        Called with the number of pictures rendered, and with their total.

    Yields
    ------
    Reported
        Each result, and each table and figure.
    """
    rows: list[list[str]] = []
    for target in {1: ("sphere",), 2: ("sheet",), 3: ("sphere", "sheet")}[number]:
        done: dict[str, Experiment] = {}
        for name, open_scene in places.items():
            dark = experiment.run(open_scene(0.0), number, target, progress=progress, **settings)
            done[name] = dark
            if ambient:
                sky = ambient * abs(float(dark.rest.mean()))
                lit_name = f"{name} under ambient light"
                done[lit_name] = experiment.run(open_scene(sky), number, target, progress=progress, **settings)
        for name, result in done.items():
            rows += [[target, name, result.engine, *cells] for cells in _cells(result)]
            yield Reported(_sentence(result, name), name, result)
            for axis, letter in enumerate("xyz"):
                row = np.concatenate(result.differences[axis], axis=1).astype(np.float32)
                write_picture(folder / f"{target}-{name.replace(' ', '-')}-{letter}.exr", row, {"units": "W/m^2/sr"})
        path = folder / f"experiment-{number}-{target}.png"
        yield from (Reported(f"{figure}", file=figure) for figure in _draw(path, done))
    table = folder / "changes.csv"
    write_text(table, csv_text(_COLUMNS, rows))
    yield Reported(f"{table}", file=table)


def _cells(found: Experiment) -> list[list[str]]:
    unit, factor = _unit(found)
    turned, (_, drowned) = found.number == 3, found.noise()
    moved = drowned[:, _moved(found)]
    return [
        [
            *(axis, unit, f"{100.0 * factor * value:.5g}", f"{100.0 * factor * half:.3g}"),
            *(f"{found.step:.4g}", "degree" if turned else "m", "" if turned else f"{found.step / voxel:.4g}"),
            *(str(len(lost)), str(int(lost.sum()))),
        ]
        for axis, (value, half), voxel, lost in zip("xyz", found.changes(), found.voxel, moved, strict=True)
    ]


def _moved(found: Experiment) -> list[int]:
    """Return the columns of the poses in which the object is not at rest."""
    middle = len(found.poses[0]) // 2
    return [k for k in range(len(found.poses[0])) if k != middle]


def _unit(found: Experiment) -> tuple[str, float]:
    """Return the unit per which changes are given, and its size in metres or degrees."""
    return ("degree", 1.0) if found.number == 3 else ("cm", 0.01)


def _sentence(found: Experiment, place: str) -> str:
    """Return a sentence: the change along each axis, strongest first, and whether the paper's claim holds."""
    unit, factor = _unit(found)
    changes = found.changes()
    # Without noise, what rounding alone may bring about.
    floor = 0.0 if traits_of(found.engine).noisy else found.rounding / (2.0 * found.step)
    order = sorted(range(3), key=lambda axis: -changes[axis][0])
    listed = ", ".join(
        f"{'xyz'[axis]} {_number(100.0 * factor * changes[axis][0], 100.0 * factor * floor)}"
        + (f" ± {100.0 * factor * changes[axis][1]:.2g}" if changes[axis][1] else "")
        for axis in order
    )
    how = "turned about" if found.number == 3 else "moved along"
    if not np.isfinite(changes).all():
        return (
            f"{found.target}, {place} ({found.engine}): noise drowns the signal; ask for more --samples or --repeats"
        )
    return f"{found.target}, {place} ({found.engine}): {how} {listed} % of the signal per {unit}; {_claim(found)}"


def _number(value: float, floor: float) -> str:
    """Return a value as text, or that it is less than what rounding errors amount to."""
    return f"{value:.3g}" if value > floor or not floor else f"less than {floor:.1g} (rounding)"


def _claim(found: Experiment) -> str:
    """Return whether the paper's claim (end of section 5.1) holds; within the intervals nothing is claimed."""
    x, y, z = range(3)
    if found.number == 3:
        if found.target == "sphere":
            return "a ball looks the same however it is turned"
        stronger = found.stronger(x, y), found.stronger(z, y)
        claim, unsure = "the paper's x and z matter most", "which axis matters is within the noise"
    else:
        stronger = found.stronger(y, x), found.stronger(y, z)
        claim, unsure = "the paper's strongest is y", "which axis is the strongest is within the noise"
    if False in stronger:
        return f"{claim}: not here"
    return unsure if None in stronger else f"{claim}: so it is"


def _draw(path: Path, done: Mapping[str, Experiment]) -> list[Path]:
    first = next(iter(done.values()))
    how = "turned" if first.number == 3 else "moved"
    title = (
        f"Experiment {first.number}: a {first.target} is {how}; × is how far a row is amplified to be as bright as "
        "the signal at rest"
    )
    return difference_panels.draw(path, title, [_block(place, result) for place, result in done.items()])


def _block(place: str, found: Experiment) -> difference_panels.Block:
    columns, middle, turned = _moved(found), len(found.poses[0]) // 2, found.number == 3
    noise, drowned = found.noise()
    threshold = f"rounding of float32, {found.rounding:.1e} of the signal"
    if traits_of(found.engine).noisy:
        count = len(found.signals)
        threshold = f"standard error of {count} repeats" if count > 1 else "not known from one repeat"
    steps = [(k - middle) * found.step for k in columns]
    return difference_panels.Block(
        name=f"{place} ({found.engine})",
        rows=found.differences[:, columns].mean(axis=-1),
        noise=noise[:, columns],
        drowned=drowned[:, columns],
        full_scale=float(np.quantile(np.abs(found.rest.mean(axis=-1)), 0.995)),
        corners=found.corners,
        threshold=threshold,
        columns=[f"{step:+.3g}°" if turned else f"{100.0 * step:+.3g} cm" for step in steps],
        axes=[
            f"about {axis}" if turned else f"along {axis}, voxel {100.0 * size:.3g} cm"
            for axis, size in zip("xyz", found.voxel, strict=True)
        ],
    )
