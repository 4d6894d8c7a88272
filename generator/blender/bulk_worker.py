"""One process, one Blender: plans a bulk set from a scene, and makes the parts it is told to.

Run as ``python -m generator.blender.bulk_worker REQUEST`` by the coordinator (`generator.jobs.bulk`), as
`generator.blender.worker` is, which must do without what Blender lacks: HDF5. Blender is here for the scene, once,
and to tell whether a pose cuts a surface; the pictures need none.
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
from generator.files.toml import from_dict, to_dict
from generator.jobs.bulk import Engine
from generator.jobs.protocol import PlanBulk, RenderBulk, answer, batches
from generator.model import poses
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets import bulk_set, links
from generator.sets.bulk_set import Bulk
from generator.sets.bulk_settings import Settings
from generator.sets.manifest import SCENE, scene_hash
from generator.sets.unknown_objects import unknown_object
from generator.transport import Transport


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
        The file the scene was opened from; its hash is recorded.
    path : Path
        Of the set.
    chosen : mapping
        Fields of `Settings` that the user chose; ``resolution`` may be text. The rest follow from the scene.
    force : bool
        In spite of errors that the check finds; the set then remembers them.
    tell : callable
        Is told what the check finds short of that.
    probe : bool
        Whether the engine is held against plain Cycles first (`generator.blender.start_check`), with the target that
        the scene has.

    Raises
    ------
    NlosError
        The scene lacks a role, the engine cannot honour it, the target fits nowhere, or nothing can be written;
        or it refers to files elsewhere; or plain Cycles makes another picture of it.
    """
    bulk_set.check_free(path)
    linked = links.recorded(references.refuse(source), path)
    described = read_scene(scene)
    if chosen.get("unknown"):
        chosen = {"rotation": list(TURNS["mesh"]), **chosen}
    settings: Settings = from_dict(Settings, with_defaults(described, chosen), "")
    world, reasons = survey.world(scene, resolution=settings.resolution, ambient=True)
    if world is None:
        raise NlosError(
            f"{source}: a bulk set is made by the engine 'surfel', which cannot honour that "
            f"{', nor that '.join(reasons)}; use nlos-generate sweep"
        )
    found = misgivings.look(scene)
    if not force:
        misgivings.refuse(found)
    for words in found.notes:
        tell(words)
    draw = _poses(scene, settings)
    for voxel in range(min(described.grid.n_voxels, settings.pictures)):
        draw(voxel, 0)  # refuses now a target that fits nowhere
    background = Transport(world, accuracy=settings.accuracy).background().astype(np.float32)
    meta = {
        "reference_radiance": described.reference_radiance,
        "colour_space": sweep_worker.colour_space(),
        "scene": to_dict(described),
        **({"forced": found.errors} if found.errors else {}),
        **({"links": linked} if linked else {}),
        "software": {
            "nlos-lab": sweep_worker.version(),
            "blender": bpy.app.version_string,
            "numpy": np.__version__,
            "numba": sweep_worker.version("numba"),
        },
    }
    first = _first(scene, settings) if probe else None
    with start_check.withdrawn(path, SCENE):
        blend_file.save_file(path / SCENE)
        if first:
            sweep = replace(settings.sweep, engine="surfel", accuracy=settings.accuracy)
            likewise = {**meta, "sweep": {**to_dict(sweep), "scene_sha256": scene_hash(source)}}
            known = links.of_dataset(linked, path)
            meta["start_check"] = start_check.run(
                path / SCENE, source, known, likewise, first, settings.pictures, sweep_worker.render
            )
    return Bulk.create(path, settings, meta, world, background, scene_hash(source))


def _first(scene: bpy.types.Scene, settings: Settings) -> PoseRecord | None:
    """Return a pose of the scene's own target, as the start check wants it; None if the target fits nowhere."""
    try:
        place, turn = _poses(scene, replace(settings, unknown=False))(0, 0)
    except NlosError:  # which does not matter where unknown objects take its place
        return None
    return PoseRecord(0, 0, roles.read_grid(scene).labels[0], place, turn, seed=0, file="")


def _poses(scene: bpy.types.Scene, settings: Settings) -> Callable[[int, int], poses.Pose]:
    """What draws the pose of (voxel, index)."""
    described = read_scene(scene)
    if not settings.unknown:
        is_free = clearance(scene, described, engine="surfel")
        return poses.Sampler(described.grid, settings.sweep, geometry.hull(scene), is_free).draw
    around = Surroundings(scene, described, engine="surfel")
    sweep = replace(settings.sweep, rotation=(0.0, 0.0, 0.0))  # they come turned

    @lru_cache(maxsize=2)
    def sampler(index: int) -> poses.Sampler:
        corners = unknown_object(described.grid, settings.sweep, index).triangles.reshape(-1, 3)
        faces = np.arange(len(corners)).reshape(-1, 3).tolist()
        return poses.Sampler(described.grid, sweep, corners, around.free(corners, faces))

    return lambda voxel, index: sampler(index).draw(voxel, index)


def render(found: Bulk, parts: Iterable[int], *, threads: int = 0) -> None:
    """Make parts of a set, telling of each."""
    sweep_worker.check_blender(found)
    scene = sweep_worker.open_scene(found)
    draw = _poses(scene, found.plan)
    renderer = Engine(found, threads=threads)
    for number in parts:
        found.part(number).write(draw, renderer)
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
