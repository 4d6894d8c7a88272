"""Worker process with one Blender: plans a bulk set from a scene, and makes the parts that are requested.

Run as ``python -m generator.blender.bulk_worker REQUEST`` by the coordinator (`generator.jobs.bulk`). It is separate
from `generator.blender.worker`, which must run without HDF5, because Blender lacks it. Blender is needed to read the
scene once and to test whether a pose cuts a surface; the pictures need no Blender.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from generator.blender import misgivings, start_check, sweep_worker, worker
from generator.blender.engines import survey
from generator.blender.engines.settings import TURNS, with_defaults
from generator.blender.scene import blend_file, geometry, references, roles
from generator.blender.scene.clearance import Surroundings, clearance
from generator.blender.scene.description import read_scene
from generator.blender.scene.varying import Varying
from generator.files.toml import from_dict, to_dict
from generator.jobs.bulk import Engine
from generator.jobs.protocol import PlanBulk, RenderBulk, answer, batches
from generator.measure import light_check
from generator.model import poses
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.quantities import order_words
from generator.sets import bulk_set, links
from generator.sets.bulk_part import DrawOthers
from generator.sets.bulk_set import Bulk
from generator.sets.bulk_settings import Settings
from generator.sets.manifest import SCENE, scene_hash
from generator.sets.unknown_objects import unknown_object
from generator.transport import Transport, World
from generator.transport.parameters import with_parameters

_SLIGHT = 1e-6


def plan(
    scene: bpy.types.Scene,
    source: Path,
    path: Path,
    chosen: Mapping[str, Any],
    *,
    force: bool = False,
    probe: bool = True,
    tell: Callable[[str], None] = lambda words: None,
) -> Bulk:
    """Create a bulk set from the open scene: settings, scene, world and background; no part yet.

    Parameters
    ----------
    scene : bpy.types.Scene
    source : Path
        File that the scene was opened from; its hash is recorded.
    path : Path
        Folder of the bulk set.
    chosen : mapping
        Fields of `Settings` that the user chose; ``resolution`` may be text. The rest follow from the scene.
    force : bool
        Create the set in spite of errors that the check finds; the set then records them.
    tell : callable
        Called with each warning of the check, and with each error that `force` overrules.
    probe : bool
        Whether the engine is first compared with plain Cycles (`generator.blender.start_check`), with the scene's own
        target.

    Raises
    ------
    NlosError
        The scene lacks a role or refers to files elsewhere, the engine cannot render it, the target fits nowhere,
        nothing can be written, or plain Cycles renders a different picture.
    """
    bulk_set.check_free(path)
    linked = links.recorded(references.refuse(source), path)
    described = read_scene(scene)
    if chosen.get("unknown"):
        chosen = {"rotation": list(TURNS["mesh"]), **chosen}
    settings: Settings = from_dict(Settings, {"stream": "bulk", **with_defaults(described, chosen)}, "")
    world, reasons = survey.world(scene, resolution=settings.resolution)
    if world is None:
        raise NlosError(
            f"{source}: a bulk set is made by the engine 'surfel', which cannot honour that "
            f"{', nor that '.join(reasons)}; use nlos-generate sweep"
        )
    Varying(scene, settings.sweep.variations)  # raises now, and not later, if a value cannot vary
    _refuse_gains(scene, source, world, settings)
    if settings.uncertain:
        settings.uncertain.check(to_dict(described))
        with_parameters(world, dict.fromkeys(settings.uncertain.names, -_SLIGHT))  # raises now, and not later
    doubts = misgivings.look(scene)
    if not force:
        misgivings.refuse(doubts)
    for words in doubts.lines:
        tell(words)
    draw, draw_others = _poses(scene, settings), _others(scene, settings)
    drawn = []
    for voxel in range(min(described.grid.n_voxels, settings.pictures)):
        position, rotation = draw(voxel, 0)  # raises now if the target fits nowhere
        drawn.append((position, rotation))
        if draw_others:
            draw_others(voxel, 0, position)
    engine = Transport(world, accuracy=settings.accuracy)
    background = engine.background().astype(np.float32)
    meta = {
        "reference_radiance": described.reference_radiance,
        "colour_space": sweep_worker.colour_space(),
        **sweep_worker.described_scene(scene, described),
        **({"forced": doubts.errors} if doubts.errors else {}),
        **({"links": linked} if linked else {}),
        "software": {
            "nlos-lab": sweep_worker.version(),
            "blender": bpy.app.version_string,
            "numpy": np.__version__,
            "numba": sweep_worker.version("numba"),
        },
    }
    pose = _first(scene, settings) if probe else None
    with start_check.withdrawn(path, SCENE):
        blend_file.save_file(path / SCENE)
        if pose:
            sweep = replace(settings.sweep, engine="surfel", accuracy=settings.accuracy)
            check_meta = {**meta, "sweep": {**to_dict(sweep), "scene_sha256": scene_hash(source)}}
            linked_files = links.of_dataset(linked, path)
            meta["start_check"] = start_check.run(
                path / SCENE, source, linked_files, check_meta, pose, settings.pictures, sweep_worker.render
            )
    if probe and not settings.unknown and (checked := light_check.look(engine, drawn)):
        meta["light_check"] = checked
    return Bulk.create(path, settings, meta, world, background, scene_hash(source))


def _refuse_gains(scene: bpy.types.Scene, source: Path, world: World, settings: Settings) -> None:
    """Raise NlosError if pictures are not proportional to what varies (`generator.transport.Gains`)."""
    names = [variation.name for variation in settings.sweep.variations]
    if names and world.is_followed_on:
        other = "light of other lamps" if world.emitters is not None else order_words(world.order)
        light = "ambient light" if world.ambient is not None else other
        raise NlosError(
            f"{source}: a bulk set cannot honour that {names[0]} varies under {light}; use nlos-generate sweep"
        )
    if "room.albedo" in names:
        for name, mesh in zip(survey.room_names(scene), world.room, strict=True):
            if mesh.albedo.any() and scene.objects[name].get(roles.ROLE) != "room":
                raise NlosError(
                    f"{source}: a bulk set cannot honour that room.albedo varies and that of {name!r}, which is no "
                    "surface of the room, does not; use nlos-generate sweep"
                )


def _first(scene: bpy.types.Scene, settings: Settings) -> PoseRecord | None:
    """Return a pose of the scene's own target for the start check; None if the target fits nowhere."""
    try:
        position, rotation = _poses(scene, replace(settings, unknown=False))(0, 0)
    except NlosError:  # no fault where unknown objects replace the target
        return None
    return PoseRecord(0, 0, roles.read_grid(scene).labels[0], position, rotation, seed=0, file="")


def _poses(scene: bpy.types.Scene, settings: Settings) -> Callable[[int, int], poses.Pose]:
    """Return the function that draws the pose of (voxel, index)."""
    described = read_scene(scene)
    if not settings.unknown:
        is_free = clearance(scene, described, engine="surfel")
        hull, stream = geometry.hull(scene), settings.numbered_stream
        return poses.Sampler(described.grid, settings.sweep, hull, is_free, stream=stream).draw
    stream = settings.numbered_stream
    surroundings = Surroundings(scene, described, engine="surfel")
    sweep = replace(settings.sweep, rotation=(0.0, 0.0, 0.0))  # unknown objects are already rotated

    @lru_cache(maxsize=2)
    def sampler(index: int) -> poses.Sampler:
        corners = unknown_object(described.grid, settings.sweep, index, stream=stream).triangles.reshape(-1, 3)
        faces = np.arange(len(corners)).reshape(-1, 3).tolist()
        return poses.Sampler(described.grid, sweep, corners, surroundings.free(corners, faces), stream=stream)

    return lambda voxel, index: sampler(index).draw(voxel, index)


def _others(scene: bpy.types.Scene, settings: Settings) -> DrawOthers | None:
    """Return the function that draws the objects besides the first; None if there is one only."""
    if settings.targets == 1:
        return None
    described = read_scene(scene)
    is_free = clearance(scene, described, engine="surfel")
    hull, stream = geometry.hull(scene), settings.numbered_stream
    return poses.Crowd(described.grid, settings.sweep, hull, is_free, stream=stream).draw


def render(found: Bulk, parts: Iterable[int], *, threads: int = 0) -> None:
    """Make parts of a set, and send an answer after each."""
    sweep_worker.check_blender(found)
    scene = sweep_worker.open_scene(found)
    draw, draw_others = _poses(scene, found.plan), _others(scene, found.plan)
    renderer = Engine(found, threads=threads)
    for number in parts:
        found.part(number).write(draw, renderer, draw_others)
        answer(part=number)


def _plan(request: PlanBulk) -> None:
    notes: list[str] = []
    scene = blend_file.open_file(request.scene)
    plan(
        *(scene, request.scene, request.path, request.chosen),
        force=request.force,
        probe=request.probe,
        tell=notes.append,
    )
    answer(planned=True, notes=notes)


def _render(request: RenderBulk) -> None:
    parts = itertools.chain.from_iterable(batches())
    render(Bulk.open(request.path), parts, threads=request.threads)


COMMANDS: worker.Commands = {PlanBulk: _plan, RenderBulk: _render}


if __name__ == "__main__":
    sys.exit(worker.main(sys.argv[1:], COMMANDS))
