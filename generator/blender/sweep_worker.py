"""Plans and renders a sweep inside Blender."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from generator.blender import misgivings, start_check
from generator.blender.engines import renderers, simplify, survey
from generator.blender.engines.renderer import Renderer, Shot
from generator.blender.engines.settings import settled
from generator.blender.scene import blend_file, geometry, references, replaced, roles
from generator.blender.scene.clearance import clearance
from generator.blender.scene.description import read_scene
from generator.blender.scene.quiet import Overrides
from generator.files.pictures import COLOUR_SPACE, Picture, write_picture
from generator.files.toml import to_dict
from generator.model import poses
from generator.model.engines import AUTO
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.scene import Scene
from generator.model.settings import BACKGROUND_FACTOR, Sweep
from generator.sets import links
from generator.sets.dataset import Dataset
from generator.sets.manifest import BACKGROUND_AMBIENT, SCENE, check_no_set, scene_hash

if TYPE_CHECKING:
    from generator.sets.bulk_set import Bulk


_WRITERS = 4
"""Threads that write a batch: while one waits for the disk the next packs, and the disk flushes several at once."""


def plan(
    scene: bpy.types.Scene,
    source: Path,
    path: Path,
    chosen: Mapping[str, Any],
    *,
    force: bool = False,
    tell: Callable[[str], None] = lambda words: None,
    probe: bool = True,
    reference: Path | None = None,
) -> Dataset:
    """Create a data set from the open scene: settings, a copy of the scene, every pose; no picture of them yet.

    Parameters
    ----------
    scene : bpy.types.Scene
    source : Path
        The file the scene was opened from; its hash is recorded.
    path : Path
        Of the data set.
    chosen : mapping
        Fields of `Sweep` that the user chose; ``resolution`` may be text. The rest follow from the scene.
    force : bool
        In spite of errors that the check finds; the set then remembers them.
    tell : callable
        Is told what the check finds short of that.
    probe : bool
        Whether the engine is held against plain Cycles first (`generator.blender.start_check`).
    reference : Path, optional
        The file that plain Cycles renders; if there is none, or the sweep leaves something out, the set's own scene.

    Raises
    ------
    NlosError
        The scene lacks a role, the engine cannot honour it, the check finds an error, the target fits nowhere, or
        nothing can be written; or it refers to files elsewhere; or plain Cycles makes another picture of it.
    """
    check_no_set(path)
    linked = links.recorded(references.refuse(source), path)
    references.require(scene, source)  # of a scene that is open already, in `batch`
    described = read_scene(scene)
    roles.refuse_hidden(scene)
    sweep, reasons = settled(scene, described, chosen)
    # What cannot be honoured is said before any work is done; what is left out may be just that, and is no matter.
    survey.survey(scene, resolution=sweep.resolution, ambient=True).check("path" if sweep.leave_out else sweep.engine)
    described = read_scene(scene, sweep.resolution)
    if chosen.get("engine", AUTO) != AUTO:
        for name in Sweep.idle(sweep.engine):
            if name in chosen:
                raise NlosError(f"{name}: means nothing to the engine {sweep.engine!r}; leave it out")
    found = doubted(scene, sweep, force=force)
    for words in found.notes:
        tell(words)
    records = placed(scene, described, sweep)
    simplify.apply(scene, sweep.leave_out)
    with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)) as renderer:
        pass  # refuses now what it could not honour later
    meta = _described(scene, described, sweep, source)
    meta["engine_reasons"] = reasons
    meta |= {name: value for name, value in (("forced", found.errors), ("links", linked)) if value}
    with start_check.withdrawn(path, SCENE):
        blend_file.save_file(path / SCENE)
        if probe:
            meta["start_check"] = start_check.run(
                path / SCENE,
                path / SCENE if sweep.leave_out or reference is None else reference,
                links.of_dataset(linked, path),
                meta,
                records[0],
                len(records),
                render,
            )
    dataset = Dataset.create(path, meta, records)
    if not sweep.noisy:
        _background(renderer, dataset, sweep)  # needs no scene, and far less time than a process of its own to start
    return dataset


def _described(scene: bpy.types.Scene, described: Scene, sweep: Sweep, source: Path) -> dict[str, Any]:
    """Return what a manifest says of a scene and a sweep."""
    return {
        "sweep": {
            **{name: value for name, value in to_dict(sweep).items() if name not in sweep.unused},
            "scene_sha256": scene_hash(source),
        },
        "reference_radiance": described.reference_radiance,
        "colour_space": colour_space(),
        "scene": to_dict(described),
        "extra_objects": roles.others(scene),
        "replaced": [replaced.told(scene, setting) for setting in replaced.replaced(scene)],
        "software": {"nlos-lab": version(), "blender": bpy.app.version_string, "numpy": np.__version__},
    }


def doubted(scene: bpy.types.Scene, sweep: Sweep, *, force: bool) -> misgivings.Misgivings:
    """Return what the check finds in a scene, without rendering; refuse its errors unless they are overruled."""
    found = misgivings.look(scene)
    if found.errors and not force:
        with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)):
            pass  # what the engine itself refuses, nobody can overrule, so that comes first
        misgivings.refuse(found)
    return found


def placed(scene: bpy.types.Scene, described: Scene, sweep: Sweep) -> list[PoseRecord]:
    """Return the poses of a sweep: where nothing is in the way, whether it is left out of the pictures or not."""
    with Overrides() as overrides:
        geometry.shape_pictures(scene, sweep.resolution, overrides)  # on which the camera's view depends
        is_free = clearance(scene, described, engine=sweep.engine)
    planned = poses.trajectory if sweep.frames else poses.plan
    return planned(described.grid, sweep, geometry.hull(scene), is_free)


def colour_space() -> str:
    """Return the linear space that the open file's colours are of, and what Cycles renders; before Blender 5 one."""
    working = getattr(getattr(bpy.data, "colorspace", None), "working_space", "")
    return str(working).removeprefix("Linear ") or COLOUR_SPACE


def version(package: str = "nlos-lab") -> str:
    """Return the version of an installed package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # run from a checkout, inside Blender
        return "unknown"


def check_blender(dataset: Dataset | Bulk) -> None:
    """Raise NlosError unless this Blender is the one that the data set was planned with."""
    planned = str(dataset.meta.get("software", {}).get("blender"))
    if planned != bpy.app.version_string:
        raise NlosError(
            f"{dataset.path}: was begun with Blender {planned}, and this is {bpy.app.version_string}, which may "
            "render other pixels; go on with the same version"
        )


def open_scene(dataset: Dataset | Bulk) -> bpy.types.Scene:
    """Open the scene that a data set keeps; it may refer to the files that the set remembers, and to no others."""
    return blend_file.open_file(dataset.path / SCENE, links.of_dataset(dataset.meta.get("links", {}), dataset.path))


def render(
    scene: bpy.types.Scene,
    dataset: Dataset,
    batches: Iterable[Mapping[int, int]],
    *,
    threads: int = 0,
    report: Callable[[list[PoseRecord]], None] = lambda _: None,
) -> None:
    """Render the background, if it is missing, and then poses.

    Parameters
    ----------
    scene : bpy.types.Scene
        The data set's own scene, open.
    dataset : Dataset
    batches : iterable of mappings of int to int
        Which of ``dataset.poses``, and with how many samples each, where 0 is as many as the data set says. The
        pixels do not depend on what is rendered together, only the time does.
    threads : int
        0 takes all cores.
    report : callable
        Is told of each finished batch.
    """
    sweep = dataset.sweep
    with (
        renderers.opened(scene, sweep.engine, threads=threads, **renderers.settings(sweep)) as renderer,
        ThreadPoolExecutor(_WRITERS) as writers,
    ):
        background = _background(renderer, dataset, sweep)
        for batch in batches:
            chosen = [dataset.poses[position] for position in batch]
            samples = [(own or sweep.samples) if sweep.noisy else 0 for own in batch.values()]
            start = time.perf_counter()
            shots = [
                Shot(pose.position, pose.rotation, own, pose.seed) for pose, own in zip(chosen, samples, strict=True)
            ]
            pictures = renderer.pictures(shots, background if sweep.paired else None)
            write = functools.partial(_write, dataset, (time.perf_counter() - start) / len(chosen))
            report(list(writers.map(write, chosen, pictures, samples)))


def _write(dataset: Dataset, seconds: float, pose: PoseRecord, pixels: Picture, samples: int) -> PoseRecord:
    return dataset.write_pose(pose, pixels, seconds=seconds, samples=samples)


def _background(renderer: Renderer, dataset: Dataset, sweep: Sweep) -> Picture:
    seed = poses.noise_seed(sweep.seed, 0)
    samples = BACKGROUND_FACTOR * sweep.samples if sweep.noisy else 0
    for name in dataset.background_names:
        if not dataset.has_background(name):
            pixels = renderer.render(samples=samples, seed=seed, target=False, ambient=name == BACKGROUND_AMBIENT)
            dataset.write_background(name, pixels, seed=seed, samples=samples)
    return dataset.background()


def picture(scene: bpy.types.Scene, folder: Path, chosen: Mapping[str, Any], *, denoise: bool) -> None:
    """Render the scene as it stands, with and without the target, and write both pictures into a folder."""
    sweep, _ = settled(scene, read_scene(scene), chosen)
    sweep = replace(sweep, denoise=denoise)
    with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)) as renderer:
        for name, target in (("wall", True), ("background", False)):
            pixels = renderer.render(samples=sweep.samples, seed=sweep.seed, target=target)
            write_picture(folder / f"{name}.exr", pixels, {})
