"""One process, one Blender: plans a data set from a scene, and renders the poses it is told to.

Run as ``python -m generator.blender.worker`` by the coordinator (`generator.jobs.sweep`), which never imports bpy
itself. Commands come as JSON lines on standard input and answers leave as lines that start with ``nlos``, because
Blender writes to standard output as well. When the coordinator dies its end of the pipe closes, and the worker ends
too.
"""

from __future__ import annotations

import functools
import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from generator.blender import check, misgivings, start_check, trial_render
from generator.blender.engines import engines, extract, simplify
from generator.blender.measure import experiment
from generator.blender.scene import references, replaced, stage
from generator.blender.scene.clearance import clearance
from generator.jobs.sweep import ANSWER, BACKGROUND_FACTOR, FORCE, NO_PROBE
from generator.model import poses, spec
from generator.model.spec import NlosError, Sweep
from generator.sets import links
from generator.sets.dataset import (
    BACKGROUND_AMBIENT,
    COLOUR_SPACE,
    SCENE,
    Dataset,
    Picture,
    PoseRecord,
    check_free,
    scene_hash,
    write_picture,
)

if TYPE_CHECKING:
    from generator.sets.bulk import Bulk

_WRITERS = 4
"""Threads that write a batch: while one waits for the disk the next packs, and the disk flushes several at once."""

_SMALLEST = 4
"""Pixels: Blender's own limit of a picture's sides."""

TURNS = {"sphere": (0.0, 0.0, 0.0), "sheet": (15.0, 15.0, 90.0), "mesh": (15.0, 15.0, 90.0)}
"""Largest rotations, degrees, where the user names none. About z, +-90 covers a two-sided sheet once."""


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
        Whether the engine is held against plain Cycles first (`startcheck`).
    reference : Path, optional
        The file that plain Cycles renders; if there is none, or the sweep leaves something out, the set's own scene.

    Raises
    ------
    NlosError
        The scene lacks a role, the engine cannot honour it, the check finds an error, the target fits nowhere, or
        nothing can be written; or it refers to files elsewhere; or plain Cycles makes another picture of it.
    """
    check_free(path)
    linked = links.recorded(references.refuse(source), path)
    references.require(scene, source)  # of a scene that is open already, in `batch`
    described = stage.read(scene)
    engines.refuse_hidden(scene)
    sweep, reasons = settled(scene, described, chosen)
    # What cannot be honoured is said before any work is done; what is left out may be just that, and is no matter.
    extract.survey(scene, resolution=sweep.resolution, ambient=True).check(
        "path" if sweep.leave_out else sweep.engine
    )
    described = stage.read(scene, sweep.resolution)
    idle = Sweep.idle(sweep.engine)
    if chosen.get("engine", spec.AUTO) != spec.AUTO and any(name in chosen for name in idle):
        name = next(name for name in idle if name in chosen)
        raise NlosError(f"{name}: means nothing to the engine {sweep.engine!r}; leave it out")
    found = doubted(scene, sweep, force=force)
    for words in found.notes:
        tell(words)
    records = placed(scene, described, sweep)
    simplify.apply(scene, sweep.leave_out)
    with engines.opened(scene, sweep.engine, **engines.settings(sweep)) as renderer:
        pass  # refuses now what it could not honour later
    meta = {
        "sweep": {
            **{name: value for name, value in spec.to_dict(sweep).items() if name not in sweep.unused},
            "scene_sha256": scene_hash(source),
        },
        "engine_reasons": reasons,
        "reference_radiance": described.reference_radiance,
        "colour_space": colour_space(),
        "scene": spec.to_dict(described),
        "extra_objects": stage.others(scene),
        "replaced": [replaced.told(scene, setting) for setting in replaced.replaced(scene)],
        **({"forced": found.errors} if found.errors else {}),
        **({"links": linked} if linked else {}),
        "software": {"nlos-lab": version(), "blender": bpy.app.version_string, "numpy": np.__version__},
    }
    with start_check.withdrawn(path, SCENE):
        stage.save_file(path / SCENE)
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
    if isinstance(renderer, engines.SurfelRenderer):
        _background(renderer, dataset, sweep)  # needs no scene, and far less time than a process of its own to start
    return dataset


def doubted(scene: bpy.types.Scene, sweep: Sweep, *, force: bool) -> misgivings.Misgivings:
    """Return what the check finds in a scene, without rendering; refuse its errors unless they are overruled."""
    found = misgivings.look(scene)
    if found.errors and not force:
        with engines.opened(scene, sweep.engine, **engines.settings(sweep)):
            pass  # what the engine itself refuses, nobody can overrule, so that comes first
        misgivings.refuse(found)
    return found


def placed(scene: bpy.types.Scene, described: spec.Scene, sweep: Sweep) -> list[PoseRecord]:
    """Return the poses of a sweep: where nothing is in the way, whether it is left out of the pictures or not."""
    with stage.Overrides() as overrides:
        stage.shape_pictures(scene, sweep.resolution, overrides)  # on which the camera's view depends
        is_free = clearance(scene, described, engine=sweep.engine)
    planned = poses.trajectory if sweep.frames else poses.plan
    return planned(described.grid, sweep, stage.hull(scene), is_free)


def settled(scene: bpy.types.Scene, described: spec.Scene, chosen: Mapping[str, Any]) -> tuple[Sweep, list[str]]:
    """Return the sweep that the user's settings mean in a scene, and why `auto` took no cheaper engine."""
    settings = {"engine": spec.AUTO, **with_defaults(described, chosen)}
    reasons: list[str] = []
    if settings["engine"] == spec.AUTO:
        settings["engine"], reasons = engines.choose(scene)
    sweep: Sweep = spec.from_dict(Sweep, settings, "")
    width, height = sweep.resolution
    if sweep.engine != "surfel" and min(width, height) < _SMALLEST:  # Blender would take the least that it knows
        raise NlosError(
            f"resolution: {width} x {height} is less than Blender renders, {_SMALLEST} pixels a side; ask for more, "
            "or take the engine 'surfel'"
        )
    return sweep, reasons


def with_defaults(described: spec.Scene, chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that the user chose, with those that follow from the scene where none was chosen."""
    width, height = described.resolution
    settings = {
        "resolution": [width, height],
        "rotation": list(TURNS[described.target.kind]),
        **chosen,
    }
    if isinstance(settings["resolution"], str):
        settings["resolution"] = list(spec.parse_resolution(settings["resolution"], width / height))
    return settings


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
    return stage.open_file(dataset.path / SCENE, links.of_dataset(dataset.meta.get("links", {}), dataset.path))


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
        engines.opened(scene, sweep.engine, threads=threads, **engines.settings(sweep)) as renderer,
        ThreadPoolExecutor(_WRITERS) as writers,
    ):
        background = _background(renderer, dataset, sweep)
        for batch in batches:
            chosen = [dataset.poses[position] for position in batch]
            samples = [own or sweep.samples for own in batch.values()]
            start = time.perf_counter()
            pictures: Iterable[Picture]
            if isinstance(renderer, engines.SurfelRenderer):
                samples = [0] * len(chosen)
                pictures = renderer.pictures([pose.position for pose in chosen], [pose.rotation for pose in chosen])
            else:
                pictures = [
                    _picture(scene, renderer, pose, replace(sweep, samples=own), background)
                    for pose, own in zip(chosen, samples, strict=True)
                ]
            write = functools.partial(_write, dataset, (time.perf_counter() - start) / len(chosen))
            report(list(writers.map(write, chosen, pictures, samples)))


def _write(dataset: Dataset, seconds: float, pose: PoseRecord, pixels: Picture, samples: int) -> PoseRecord:
    return dataset.write_pose(pose, pixels, seconds=seconds, samples=samples)


def _picture(
    scene: bpy.types.Scene, renderer: engines.Renderer, pose: PoseRecord, sweep: Sweep, background: Picture
) -> Picture:
    """Render a pose with Cycles."""
    stage.move_target(scene, pose.position, pose.rotation)
    pixels = renderer.render(samples=sweep.samples, seed=pose.seed)
    if sweep.paired and background.any():
        # A control variate of weight 1: rays that never meet the target are the same in both, and cancel.
        own = renderer.render(samples=sweep.samples, seed=pose.seed, target=False)
        pixels = pixels + (background - own)
    return pixels


def _background(renderer: engines.Renderer | engines.SurfelRenderer, dataset: Dataset, sweep: Sweep) -> Picture:
    seed = poses.noise_seed(sweep.seed, 0)
    samples = 0 if sweep.engine == "surfel" else BACKGROUND_FACTOR * sweep.samples
    for name in dataset.background_names:
        if not dataset.has_background(name):
            pixels = renderer.render(samples=samples, seed=seed, target=False, ambient=name == BACKGROUND_AMBIENT)
            dataset.write_background(name, pixels, seed=seed, samples=samples)
    return dataset.background()


def check_scene(scene: bpy.types.Scene, chosen: Mapping[str, Any]) -> list[check.Finding]:
    """Return what is to be said of a scene before a sweep with the settings that the user chose."""
    found = check.findings(scene, engine=chosen.get("engine", spec.AUTO))
    if check.hopeless(found):
        return found
    sweep, _ = settled(scene, stage.read(scene), chosen)
    found += check.places(scene, sweep)
    return found if check.hopeless(found) else [*found, *check.probe(scene, sweep).findings()]


def picture(scene: bpy.types.Scene, folder: Path, chosen: Mapping[str, Any], *, denoise: bool) -> None:
    """Render the scene as it stands, with and without the target, and write both pictures into a folder."""
    sweep, _ = settled(scene, stage.read(scene), chosen)
    sweep = replace(sweep, denoise=denoise)
    with engines.opened(scene, sweep.engine, **engines.settings(sweep)) as renderer:
        for name, target in (("wall", True), ("background", False)):
            pixels = renderer.render(samples=sweep.samples, seed=sweep.seed, target=target)
            write_picture(folder / f"{name}.exr", pixels, {})


def answer(**fields: Any) -> None:
    """Tell the coordinator something."""
    print(ANSWER + json.dumps(fields), flush=True)


def commands() -> Iterable[dict[int, int]]:
    """Say that this process is ready, and return the batches that are sent to it: numbers, each with its samples."""
    answer(ready=True)
    for line in sys.stdin:
        pairs = (word.partition(":") for word in line.split())
        yield {int(number): int(samples or 0) for number, _, samples in pairs}


def main(argv: list[str]) -> int:
    """Do one of six things.

    ``plan SCENE DATASET SETTINGS [force] [no-probe]``; ``render DATASET THREADS``, positions on standard input;
    ``check SCENE SETTINGS``, which answers what it found; ``rehearse SCENE SETTINGS THREADS I/N [force]``, which
    answers what a few pictures took; ``picture SCENE FOLDER SETTINGS denoise|plain``, which
    leaves ``wall.exr`` and ``background.exr`` in the folder; ``experiment SCENE FILE
    NUMBER``, which leaves its pictures in the file.
    """
    try:
        if argv[0] == "plan":
            source, notes = Path(argv[1]), list[str]()
            scene, chosen = stage.open_file(source), json.loads(argv[3])
            options: dict[str, Any] = {
                "force": FORCE in argv[4:],
                "probe": NO_PROBE not in argv[4:],
                "reference": source,
            }
            plan(scene, source, Path(argv[2]), chosen, **options, tell=notes.append)
            answer(planned=True, notes=notes)
        elif argv[0] == "check":
            scene = stage.open_file(Path(argv[1]))
            answer(findings=[asdict(found) for found in check_scene(scene, json.loads(argv[2]))])
        elif argv[0] == "rehearse":
            scene = stage.open_file(Path(argv[1]))
            sweep, _ = settled(scene, stage.read(scene), json.loads(argv[2]))
            doubted(scene, sweep, force=FORCE in argv[5:])
            index, _, count = argv[4].partition("/")
            found = trial_render.rehearse(scene, sweep, share=(int(index), int(count)), threads=int(argv[3]))
            answer(**vars(found))
        elif argv[0] == "picture":
            picture(stage.open_file(Path(argv[1])), Path(argv[2]), json.loads(argv[3]), denoise=argv[4] == "denoise")
            answer(rendered=True)
        elif argv[0] == "experiment":
            scene = stage.open_file(Path(argv[1]))
            write_picture(Path(argv[2]), experiment.draw(scene, int(argv[3])), {})
            answer(drawn=True)
        else:
            dataset = Dataset.open(Path(argv[1]))
            check_blender(dataset)
            scene = open_scene(dataset)
            render(
                scene,
                dataset,
                commands(),
                threads=int(argv[2]),
                report=lambda made: answer(files=[pose.file for pose in made]),
            )
    except NlosError as error:
        answer(error=str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
