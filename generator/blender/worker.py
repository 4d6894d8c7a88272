"""One process, one Blender: plans a data set from a scene, and renders the poses it is told to.

Run as ``python -m generator.blender.worker`` by the coordinator (`generator.jobs.sweep`), which never imports bpy
itself. Commands come as JSON lines on standard input and answers leave as lines that start with ``nlos``, because
Blender writes to standard output as well. When the coordinator dies its end of the pipe closes, and the worker ends
too.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from generator.blender import trial_render
from generator.blender.check import check_scene
from generator.blender.engines.settings import settled
from generator.blender.measure import experiment
from generator.blender.scene import blend_file
from generator.blender.scene.description import read_scene
from generator.blender.sweep_worker import check_blender, doubted, open_scene, picture, plan, render
from generator.files.pictures import write_picture
from generator.jobs.protocol import FORCE, NO_PROBE, answer, commands
from generator.model.errors import NlosError
from generator.sets.dataset import Dataset


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
            scene, chosen = blend_file.open_file(source), json.loads(argv[3])
            options: dict[str, Any] = {
                "force": FORCE in argv[4:],
                "probe": NO_PROBE not in argv[4:],
                "reference": source,
            }
            plan(scene, source, Path(argv[2]), chosen, **options, tell=notes.append)
            answer(planned=True, notes=notes)
        elif argv[0] == "check":
            scene = blend_file.open_file(Path(argv[1]))
            answer(findings=[asdict(found) for found in check_scene(scene, json.loads(argv[2]))])
        elif argv[0] == "rehearse":
            scene = blend_file.open_file(Path(argv[1]))
            sweep, _ = settled(scene, read_scene(scene), json.loads(argv[2]))
            doubted(scene, sweep, force=FORCE in argv[5:])
            index, _, count = argv[4].partition("/")
            found = trial_render.rehearse(scene, sweep, share=(int(index), int(count)), threads=int(argv[3]))
            answer(**vars(found))
        elif argv[0] == "picture":
            picture(
                blend_file.open_file(Path(argv[1])), Path(argv[2]), json.loads(argv[3]), denoise=argv[4] == "denoise"
            )
            answer(rendered=True)
        elif argv[0] == "experiment":
            scene = blend_file.open_file(Path(argv[1]))
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
