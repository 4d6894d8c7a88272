"""Plans and renders a sweep inside Blender."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from generator.blender.scene.copies import Copies
from generator.blender.scene.description import read_scene
from generator.blender.scene.quiet import Overrides
from generator.blender.scene.varying import Varying
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
"""Threads that write a batch: while one waits for the disk, the next packs, and the disk flushes several at once."""


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
        File that the scene was opened from; its hash is recorded.
    path : Path
        Folder of the data set.
    chosen : mapping
        Fields of `Sweep` that the user chose; ``resolution`` may be text. The rest follow from the scene.
    force : bool
        Create the set in spite of errors that the check finds; the set then records them.
    tell : callable
        Called with each warning of the check, and with each error that `force` overrules.
    probe : bool
        Whether the engine is first compared with plain Cycles (`generator.blender.start_check`).
    reference : Path, optional
        File that plain Cycles renders; without one, or if the sweep leaves something out, the set's own scene.

    Raises
    ------
    NlosError
        The scene lacks a role or refers to files elsewhere, the engine cannot render it, the check finds an error,
        the target fits nowhere, nothing can be written, or plain Cycles renders a different picture.
    """
    check_no_set(path)
    linked = links.recorded(references.refuse(source), path)
    references.require(scene, source)  # of a scene that was open before, as in `batch`
    described = read_scene(scene)
    roles.refuse_hidden(scene)
    sweep, reasons = settled(scene, described, chosen)
    # Refuse before any work what the engine cannot render, unless the sweep may be leaving out just that.
    survey.survey(scene, resolution=sweep.resolution).check("path" if sweep.leave_out else sweep.engine)
    described = read_scene(scene, sweep.resolution)
    if chosen.get("engine", AUTO) != AUTO:
        for name in Sweep.idle(sweep.engine):
            if name in chosen:
                raise NlosError(f"{name}: means nothing to the engine {sweep.engine!r}; leave it out")
    doubts = doubted(scene, sweep, force=force)
    for words in doubts.lines:
        tell(words)
    Varying(scene, sweep.variations)  # raises now, and not later, if a value cannot vary
    records = placed(scene, described, sweep)
    simplify.apply(scene, sweep.leave_out)
    with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)) as renderer:
        pass  # raises now, and not later, if the engine cannot render the scene
    meta = _described(scene, described, sweep, source)
    meta["engine_reasons"] = reasons
    meta |= {name: value for name, value in (("forced", doubts.errors), ("links", linked)) if value}
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
    if probe and sweep.engine == "surfel":
        meta |= _light_check(renderer, records)
    dataset = Dataset.create(path, meta, records)
    if not sweep.noisy:
        _background(renderer, dataset, sweep)  # needs no scene, and far less time than starting a process for it
    return dataset


def _light_check(renderer: Renderer, records: Sequence[PoseRecord]) -> dict[str, Any]:
    """Return the entry of a manifest that says how far light of many reflections is trusted, if there is one."""
    # Imported here, since it loads numba, for which Cycles need not wait.
    from generator.blender.engines.surfel import SurfelRenderer

    assert isinstance(renderer, SurfelRenderer)
    checked = renderer.light_check([(record.position, record.rotation) for record in records])
    return {"light_check": checked} if checked else {}


def _described(scene: bpy.types.Scene, described: Scene, sweep: Sweep, source: Path) -> dict[str, Any]:
    """Return the entries of a manifest about a scene and a sweep."""
    return {
        "sweep": {
            **{name: value for name, value in to_dict(sweep).items() if name not in sweep.unused},
            "scene_sha256": scene_hash(source),
        },
        "reference_radiance": described.reference_radiance,
        "colour_space": colour_space(),
        **described_scene(scene, described),
        "extra_objects": roles.others(scene),
        "replaced": [replaced.told(scene, setting) for setting in replaced.replaced(scene)],
        "software": {"nlos-lab": version(), "blender": bpy.app.version_string, "numpy": np.__version__},
    }


def described_scene(scene: bpy.types.Scene, described: Scene) -> dict[str, Any]:
    """Return the entries of a manifest about a scene: its figures, and how its target's file was read, if any."""
    plain, file = to_dict(described), roles.target_file(scene)
    if described.target.kind != "mesh":  # older versions, which know no such fields, read these sets too
        for name in ("unit", "up"):
            del plain["target"][name]
    return {"scene": plain, **({"target_file": file} if file else {})}


def doubted(scene: bpy.types.Scene, sweep: Sweep, *, force: bool) -> misgivings.Misgivings:
    """Return what the check finds in a scene without rendering; raise NlosError for errors unless `force`."""
    doubts = misgivings.look(scene)
    if doubts.errors and not force:
        with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)):
            pass  # what the engine itself refuses cannot be overruled, so that is reported first
        misgivings.refuse(doubts)
    return doubts


def placed(scene: bpy.types.Scene, described: Scene, sweep: Sweep) -> list[PoseRecord]:
    """Return the poses of a sweep, clear of all surfaces, also of those that are left out of the pictures."""
    with Overrides() as overrides:
        geometry.shape_pictures(scene, sweep.resolution, overrides)  # the camera's view depends on their shape
        is_free = clearance(scene, described, engine=sweep.engine)
    planner = poses.trajectory if sweep.frames else poses.plan
    return planner(described.grid, sweep, geometry.hull(scene), is_free)


def colour_space() -> str:
    """Return the linear colour space of the open file, in which Cycles renders; before Blender 5 there is one."""
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
    """Open the scene stored in a data set; it may refer only to the files that the set records."""
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
        Open scene of the data set.
    dataset : Dataset
    batches : iterable of mappings of int to int
        Indices into ``dataset.poses``, each with its number of samples, where 0 takes that of the data set. Which
        poses are rendered together changes the time, not the pixels.
    threads : int
        0 takes all cores.
    report : callable
        Called with the records of each finished batch.
    """
    sweep = dataset.sweep
    opened = functools.partial(renderers.opened, scene, sweep.engine, threads=threads, **renderers.settings(sweep))
    if sweep.varied:
        with opened() as renderer:
            background = _background(renderer, dataset, sweep)
        _render_varying(scene, dataset, opened, background, batches, report)
        return
    with opened() as renderer, ThreadPoolExecutor(_WRITERS) as writers:
        background = _background(renderer, dataset, sweep)
        for batch in batches:
            chosen = [dataset.poses[position] for position in batch]
            samples = [(n or sweep.samples) if sweep.noisy else 0 for n in batch.values()]
            start = time.perf_counter()
            shots = [
                Shot(pose.position, pose.rotation, n, pose.seed) for pose, n in zip(chosen, samples, strict=True)
            ]
            pictures = renderer.pictures(shots, background if sweep.paired else None)
            write = functools.partial(_write, dataset, (time.perf_counter() - start) / len(chosen))
            report(list(writers.map(write, chosen, pictures, samples)))


def _write(dataset: Dataset, seconds: float, pose: PoseRecord, pixels: Picture, samples: int) -> PoseRecord:
    return dataset.write_pose(pose, pixels, seconds=seconds, samples=samples)


def _render_varying(
    scene: bpy.types.Scene,
    dataset: Dataset,
    opened: Callable[[], contextlib.AbstractContextManager[Renderer]],
    background: Picture,
    batches: Iterable[Mapping[int, int]],
    report: Callable[[list[PoseRecord]], None],
) -> None:
    """Render poses in scenes that differ, each by an engine that is opened for it."""
    sweep = dataset.sweep
    copies, varying = Copies(scene, sweep.targets), Varying(scene, sweep.variations)
    for batch in batches:
        written = []
        for position, wanted in batch.items():
            pose, samples = dataset.poses[position], (wanted or sweep.samples) if sweep.noisy else 0
            start = time.perf_counter()
            varying.apply(pose.values)
            copies.place(pose)
            shot, own = Shot(pose.position, pose.rotation, samples, pose.seed), None
            with opened() as renderer:
                shared = background if sweep.paired and not sweep.own_backgrounds else None
                [pixels] = renderer.pictures([shot], shared)
                if sweep.own_backgrounds:  # with the pose's own noise, which then cancels
                    own = renderer.render(samples=samples, seed=pose.seed, target=False)
            seconds = time.perf_counter() - start
            written.append(dataset.write_pose(pose, pixels, seconds=seconds, samples=samples, background=own))
        report(written)


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
