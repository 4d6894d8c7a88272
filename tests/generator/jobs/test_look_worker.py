"""The process that draws the live look: the newest question wins, and what is dropped leaves nothing wrong behind."""

from __future__ import annotations

import base64
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import worlds

from generator.jobs.protocol import DrawLook, Question
from generator.jobs.workers import Worker
from generator.transport import Transport
from generator.transport.compiled import COMPILED
from generator.transport.world_file import save_world

ACCURACY = 3e-2


def launch(arguments):
    """As `workers.python`, which needs bpy; this worker does not."""
    return [sys.executable, "-m", *arguments]


def question(path, number=1, position=(0.8, 1.1, 0.3), *, shadows=True):
    return Question(
        number=number,
        world=str(path),
        accuracy=ACCURACY,
        position=position,
        rotation=(0.0, 0.0, 30.0),
        shadows=shadows,
    )


def pixels(fields):
    return np.frombuffer(base64.b64decode(fields["pixels"]), dtype="<f4").reshape(fields["shape"])


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A room, and its file."""
    path = tmp_path_factory.mktemp("look") / "room.npz"
    made = worlds.room(order=3)
    save_world(path, made)
    return path, made


@contextmanager
def begun(how):
    """A worker; ended, and with it the wait for its answers, if a test takes minutes."""
    with Worker(DrawLook(), how) as started:
        late = threading.Timer(120.0, started.kill)
        late.start()
        yield started
        late.cancel()


@pytest.fixture
def worker():
    with begun(launch) as started:
        ready = started.answer()
        assert ready["ready"]
        assert ready["compiled"] == COMPILED
        yield started


def test_a_coarse_picture_comes_first_and_both_are_the_engines(world, worker):
    path, room = world
    engine = Transport(room, accuracy=ACCURACY)
    asked = question(path)
    worker.send(asked.line)
    coarse, whole = worker.answer(), worker.answer()
    assert [coarse["whole"], whole["whole"], coarse["number"], whole["number"]] == [False, True, 1, 1]
    for fields, shadows in ((coarse, False), (whole, True)):
        expected = engine.difference(asked.position, asked.rotation, shadows=shadows)
        np.testing.assert_allclose(pixels(fields), expected, rtol=1e-6, atol=1e-12 * np.abs(expected).max())
    assert 0.0 < coarse["seconds"] < whole["seconds"]
    worker.send(replace(asked, number=2, shadows=False).line)
    alone = worker.answer()
    assert (alone["number"], alone["whole"]) == (2, True)
    np.testing.assert_array_equal(pixels(alone), pixels(coarse))


def test_without_a_compiler_a_draft_with_shadows_comes_second(world):
    """Then comes what was asked for."""
    path, room = world

    def plain(arguments):
        code = "import sys, runpy; sys.modules['numba'] = None; sys.argv = ['look', '{}']; "
        return [sys.executable, "-c", code + f"runpy.run_module({arguments[0]!r}, run_name='__main__')"]

    with begun(plain) as worker:
        assert not worker.answer()["compiled"]
        asked = question(path)
        worker.send(asked.line)
        answers = [worker.answer() for _ in range(3)]
        assert [(f["shadows"], f["whole"]) for f in answers] == [(False, False), (True, False), (True, True)]
        made = Transport(room, accuracy=1e-3).render(asked.position, asked.rotation)
        off = [pixels(fields) - (made.added - made.hidden) for fields in answers]
        errors = np.sqrt([(one**2).mean() / (made.added**2).mean() for one in off])
        assert errors[2] < ACCURACY
        assert errors[2] < errors[1] < 0.1 < errors[0]


def test_the_newest_question_wins_and_what_was_dropped_leaves_no_trace(world, worker):
    """Asked at forty moments of its work, it answers few questions, the last one wholly, and as one at rest does."""
    path, room = world
    rng = np.random.default_rng(0)
    places = np.array([0.8, 1.1, 0.3]) + rng.uniform(-0.1, 0.1, (40, 3))
    for number, place in enumerate(places, start=1):
        worker.send(question(path, number, tuple(place)).line)
        time.sleep(float(rng.uniform(0.0, 0.02)))
    answers = []
    while not answers or answers[-1]["number"] < 40 or not answers[-1]["whole"]:
        answers.append(worker.answer())
    numbers = [fields["number"] for fields in answers]
    assert numbers == sorted(numbers)
    assert sum(fields["whole"] for fields in answers) < 40
    expected = Transport(room, accuracy=ACCURACY).difference(places[-1], (0.0, 0.0, 30.0))
    np.testing.assert_allclose(pixels(answers[-1]), expected, rtol=1e-6, atol=1e-12 * np.abs(expected).max())


def test_what_cannot_be_drawn_is_refused_in_a_sentence_and_the_next_is_drawn(world, worker, tmp_path):
    path, _ = world
    worker.send(question(path, 1, (0.8, 0.0, 0.3)).line)
    assert "relay wall" in worker.answer()["refused"]
    worker.send(question(tmp_path / "gone.npz", 2).line)
    assert "no such file" in worker.answer()["refused"]
    worker.send(question(path, 3, shadows=False).line)
    assert worker.answer()["whole"]


def test_it_ends_with_who_asks(world):
    path, _ = world
    process = subprocess.Popen(
        launch(DrawLook().arguments), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    _, errors = process.communicate(question(path).line + "\n", timeout=60.0)
    assert process.returncode == 0, errors
