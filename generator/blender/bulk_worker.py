"""One process, one Blender: plans a bulk set from a scene, and makes the parts it is told to.

Run as ``python -m generator.blender.bulk_worker`` by the coordinator (`generator.sets.bulk`); the talk is
`generator.blender.worker`'s. Blender is here for the scene, once, and to tell whether a pose cuts a surface; the
pictures need none.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from generator.blender import misgivings, start_check, worker
from generator.blender.engines import extract
from generator.blender.scene import references, stage
from generator.blender.scene.clearance import Surroundings, clearance
from generator.jobs.sweep import FORCE, NO_PROBE
from generator.model import poses, spec
from generator.model.spec import NlosError
from generator.sets import bulk, links
from generator.sets.bulk import Bulk, Engine, Settings
from generator.sets.dataset import SCENE, PoseRecord, scene_hash
from generator.sets.unknown_objects import stranger
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
        Whether the engine is held against plain Cycles first (`startcheck`), with the target that the scene has.

    Raises
    ------
    NlosError
        The scene lacks a role, the engine cannot honour it, the target fits nowhere, or nothing can be written;
        or it refers to files elsewhere; or plain Cycles makes another picture of it.
    """
    bulk.check_free(path)
    linked = links.recorded(references.refuse(source), path)
    described = stage.read(scene)
    if chosen.get("unknown"):
        chosen = {"rotation": list(worker.TURNS["mesh"]), **chosen}
    settings: Settings = spec.from_dict(Settings, worker.with_defaults(described, chosen), "")
    world, reasons = extract.world(scene, resolution=settings.resolution, ambient=True)
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
        "colour_space": worker.colour_space(),
        "scene": spec.to_dict(described),
        **({"forced": found.errors} if found.errors else {}),
        **({"links": linked} if linked else {}),
        "software": {
            "nlos-lab": worker.version(),
            "blender": bpy.app.version_string,
            "numpy": np.__version__,
            "numba": worker.version("numba"),
        },
    }
    first = _first(scene, settings) if probe else None
    with start_check.withdrawn(path, SCENE):
        stage.save_file(path / SCENE)
        if first:
            sweep = replace(settings.sweep, engine="surfel", accuracy=settings.accuracy)
            likewise = {**meta, "sweep": {**spec.to_dict(sweep), "scene_sha256": scene_hash(source)}}
            known = links.of_dataset(linked, path)
            meta["start_check"] = start_check.run(
                path / SCENE, source, known, likewise, first, settings.pictures, worker.render
            )
    return Bulk.create(path, settings, meta, world, background, scene_hash(source))


def _first(scene: bpy.types.Scene, settings: Settings) -> PoseRecord | None:
    """Return a pose of the scene's own target, as the start check wants it; None if the target fits nowhere."""
    try:
        place, turn = _poses(scene, replace(settings, unknown=False))(0, 0)
    except NlosError:  # which does not matter where unknown objects take its place
        return None
    return PoseRecord(0, 0, stage.read_grid(scene).labels[0], place, turn, seed=0, file="")


def _poses(scene: bpy.types.Scene, settings: Settings) -> Callable[[int, int], poses.Pose]:
    """What draws the pose of (voxel, index)."""
    described = stage.read(scene)
    if not settings.unknown:
        is_free = clearance(scene, described, engine="surfel")
        return poses.Sampler(described.grid, settings.sweep, stage.hull(scene), is_free).draw
    around = Surroundings(scene, described, engine="surfel")
    sweep = replace(settings.sweep, rotation=(0.0, 0.0, 0.0))  # they come turned

    @lru_cache(maxsize=2)
    def sampler(index: int) -> poses.Sampler:
        corners = stranger(described.grid, settings.sweep, index).triangles.reshape(-1, 3)
        faces = np.arange(len(corners)).reshape(-1, 3).tolist()
        return poses.Sampler(described.grid, sweep, corners, around.free(corners, faces))

    return lambda voxel, index: sampler(index).draw(voxel, index)


def render(found: Bulk, parts: Iterable[int], *, threads: int = 0) -> None:
    """Make parts of a set, telling of each."""
    worker.check_blender(found)
    scene = worker.open_scene(found)
    draw = _poses(scene, found.plan)
    renderer = Engine(found, threads=threads)
    for number in parts:
        found.write_part(number, draw, renderer)
        worker.answer(part=number)


def main(argv: list[str]) -> int:
    """Do one of two things.

    ``plan SCENE SET SETTINGS [force]``; ``render SET THREADS``, which makes parts, their numbers on standard input.
    """
    try:
        if argv[0] == "plan":
            source, notes = Path(argv[1]), list[str]()
            scene, chosen = stage.open_file(source), json.loads(argv[3])
            options = {"force": FORCE in argv[4:], "probe": NO_PROBE not in argv[4:]}
            plan(scene, source, Path(argv[2]), chosen, **options, tell=notes.append)
            worker.answer(planned=True, notes=notes)
        else:
            parts = itertools.chain.from_iterable(worker.commands())
            render(Bulk.open(Path(argv[1])), parts, threads=int(argv[2]))
    except NlosError as error:
        worker.answer(error=str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
