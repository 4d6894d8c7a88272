"""The process that answers about the live look: the newest picture wins, and what is wrong is said in a sentence."""

from __future__ import annotations

import base64
import subprocess
import sys
import threading
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from classify_helpers import make_bulk

from classify.inference import answerer, atlas_build, atlas_file
from classify.pictures.sensor import Sensor
from generator.files.toml import to_dict
from generator.jobs.protocol import AnswerPictures, PictureQuestion
from generator.jobs.workers import Worker
from generator.model.errors import NlosError
from generator.transport import Transport
from generator.transport.world_file import load_world

POSE = (0.9, 1.1, 0.1), (0.0, 0.0, 0.0)


def launch(arguments):
    return [sys.executable, "-m", *arguments]


@pytest.fixture(scope="module")
def atlas(tmp_path_factory):
    """An atlas, and the bulk set that it was made of."""
    folder = tmp_path_factory.mktemp("atlas")
    simulated = make_bulk(folder / "set", pictures=200)
    atlas_file.save(folder / "a.atlas", atlas_build.build(simulated, Sensor()))
    return folder / "a.atlas", simulated


@pytest.fixture(scope="module")
def question(atlas):
    """A question about the world of the set, and the picture in it."""
    _, simulated = atlas
    difference = Transport(simulated.world(), accuracy=1e-2).difference(*POSE).astype("<f4")
    return PictureQuestion(
        number=1,
        world=str(simulated.path / "world.npz"),
        shape=difference.shape,
        pixels=base64.b64encode(difference.tobytes()).decode("ascii"),
        grid=to_dict(simulated.grid),
        target="sphere",
        colour_space="Rec.709",
    ), difference


@contextmanager
def begun(path, how=launch):
    """A worker; ended, and with it the wait for its answers, if a test takes minutes."""
    with Worker(AnswerPictures(model=path), how) as started:
        late = threading.Timer(120.0, started.kill)
        late.start()
        yield started
        late.cancel()


def test_it_answers_as_in_one_process_refuses_and_goes_on(atlas, question, tmp_path):
    path, simulated = atlas
    asked, difference = question
    known = answerer.opened(path)
    world = load_world(simulated.path / "world.npz")
    background = Transport(world, accuracy=1e-2).background().astype(np.float32)
    known.look_at(answerer.Seen(background=background, grid=simulated.grid, target="sphere", colour_space="Rec.709"))
    expected = known.answer(difference)
    with begun(path) as worker:
        assert worker.answer() == {"ready": True, "words": known.words}
        worker.send(asked.line)
        found = worker.answer()
        assert found["number"] == 1
        assert found["doubts"] == []
        assert found["probability"] == expected.probability
        np.testing.assert_array_equal(found["position"], expected.place.position)
        for number, change, words in (
            (2, {"grid": {**asked.grid, "shape": [4, 1, 1]}}, "other voxels"),
            (3, {"world": str(tmp_path / "gone.npz")}, "no such file"),
        ):
            worker.send(replace(asked, number=number, **change).line)
            refused = worker.answer()
            assert refused["number"] == number
            assert words in refused["refused"]
        worker.send(replace(asked, number=4).line)
        assert worker.answer()["probability"] == expected.probability


def test_of_many_pictures_the_newest_is_answered(atlas, question):
    path, _ = atlas
    asked, _ = question
    with begun(path) as worker:
        worker.answer()
        for number in range(1, 41):
            worker.send(replace(asked, number=number).line)
        numbers = [0]
        while numbers[-1] < 40:
            numbers.append(worker.answer()["number"])
    assert numbers == sorted(set(numbers))
    assert len(numbers) < 41


def test_what_is_wrong_at_its_start_is_said_in_a_sentence(tmp_path, atlas):
    broken = tmp_path / "broken.skops"
    broken.write_bytes(b"PK")
    with begun(broken) as worker, pytest.raises(NlosError, match="is not a model file"):
        worker.answer()

    def poor(arguments):
        code = "import sys, runpy; sys.modules['sklearn'] = None; "
        code += f"sys.argv = ['', {arguments[1]!r}]; runpy.run_module({arguments[0]!r}, run_name='__main__')"
        return [sys.executable, "-c", code]

    with begun(atlas[0], poor) as worker, pytest.raises(NlosError, match="lacks sklearn"):
        worker.answer()


def test_it_ends_with_who_asks(atlas, question):
    process = subprocess.Popen(
        launch(AnswerPictures(model=atlas[0]).arguments),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    _, errors = process.communicate(question[0].line + "\n", timeout=60.0)
    assert process.returncode == 0, errors
