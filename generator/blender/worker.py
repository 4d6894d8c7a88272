"""Worker process with one Blender: carries out a request, and answers.

Run as ``python -m generator.blender.worker REQUEST`` by a coordinator, which never imports bpy itself; the protocol
is `generator.jobs.protocol`. When the coordinator dies, its end of the pipe closes, and the worker ends too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from generator.blender import assets, corrected, trial_render
from generator.blender.check import check_scene
from generator.blender.engines.settings import settled
from generator.blender.measure import experiment
from generator.blender.scene import blend_file, mesh_file
from generator.blender.scene.description import read_scene
from generator.blender.sweep_worker import check_blender, doubted, open_scene, picture, plan, render
from generator.files.pictures import write_picture
from generator.jobs import gpus
from generator.jobs.protocol import (
    CheckScene,
    CorrectScene,
    DrawExperiment,
    PlanSweep,
    ReadMesh,
    ReadWorld,
    RenderSweep,
    RenderWall,
    Request,
    TrialRender,
    WriteAssets,
    answer,
    batches,
    read_request,
)
from generator.model.errors import NlosError
from generator.model.scene import Target
from generator.sets import links
from generator.sets.dataset import Dataset


def _plan(request: PlanSweep) -> None:
    notes: list[str] = []
    scene = blend_file.open_file(request.scene)
    plan(
        *(scene, request.scene, request.path, request.chosen),
        force=request.force,
        probe=request.probe,
        reference=request.scene,
        tell=notes.append,
    )
    answer(planned=True, notes=notes)


def _render(request: RenderSweep) -> None:
    dataset = Dataset.open(request.path)
    check_blender(dataset)
    scene = open_scene(dataset)
    render(
        *(scene, dataset, batches()),
        threads=request.threads,
        report=lambda done: answer(files=[pose.file for pose in done]),
    )


def _check(request: CheckScene) -> None:
    findings = check_scene(blend_file.open_file(request.scene), request.chosen)
    answer(findings=[asdict(finding) for finding in findings])


def _try(request: TrialRender) -> None:
    scene = blend_file.open_file(request.scene)
    sweep, _ = settled(scene, read_scene(scene), request.chosen)
    doubted(scene, sweep, force=request.force)
    share = (request.share, request.shares)
    answer(**vars(trial_render.trial_render(scene, sweep, share=share, threads=request.threads)))


def _picture(request: RenderWall) -> None:
    picture(blend_file.open_file(request.scene), request.folder, request.chosen, denoise=request.denoise)
    answer(rendered=True)


def _draw(request: DrawExperiment) -> None:
    scene = blend_file.open_file(request.scene)
    write_picture(request.file, experiment.draw(scene, request.number, device=request.device), {})
    answer(drawn=True)


def _read_mesh(request: ReadMesh) -> None:
    found = mesh_file.read(Target(**request.target))
    found.save(request.file)
    answer(read=mesh_file.described(found), left_out=found.left_out)


def _write_assets(request: WriteAssets) -> None:
    answer(assets=assets.write(request.folder))


def _read_world(request: ReadWorld) -> None:
    answer(described=corrected.read(request.scene, request.file, request.resolution))


def _correct(request: CorrectScene) -> None:
    corrected.write(request.scene, request.file, request.offsets)
    answer(corrected=True)


Commands = Mapping[type[Request], Callable[[Any], None]]
COMMANDS: Commands = {
    PlanSweep: _plan,
    RenderSweep: _render,
    CheckScene: _check,
    TrialRender: _try,
    RenderWall: _picture,
    DrawExperiment: _draw,
    ReadMesh: _read_mesh,
    WriteAssets: _write_assets,
    ReadWorld: _read_world,
    CorrectScene: _correct,
}


def main(argv: list[str], commands: Commands = COMMANDS) -> int:
    """Carry out a request; return 0, or 2 after the answer ``error`` if its input is bad."""
    request = read_request(argv[0])
    try:
        with links.trusting(request.trust_links), gpus.choosing(request.gpus):
            commands[type(request)](request)
    except NlosError as error:
        answer(error=str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
