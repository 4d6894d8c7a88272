"""The engine where numba is missing, as in Blender: as accurate as asked for, in shadows too, and in seconds."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT
from worlds import HIGH, room

from generator.transport import Transport

POSES = (
    ((0.8, 1.1, 0.3), (0.0, 0.0, 30.0)),
    ((0.9, 0.4, -0.6), (20.0, 0.0, -40.0)),
    ((0.75, 0.55, 0.302 - HIGH), (0.0, 0.0, 20.0)),
)
"""The last touches the floor."""
ACCURACY = 1e-2
SCRIPT = """
import pickle, sys
sys.modules["numba"] = None
from generator.transport import Transport
from generator.transport.compiled import COMPILED
assert not COMPILED
world, poses, accuracy = pickle.load(sys.stdin.buffer)
engine = Transport(world, accuracy=accuracy)
draft = Transport(world, accuracy=3.0 * accuracy, like=engine, draft=True)
found = [engine.background(), *([one.difference(*pose) for pose in poses] for one in (engine, draft))]
sys.stdout.buffer.write(pickle.dumps(found))
"""


@pytest.fixture(scope="module")
def plain():
    """Background, whole pictures and drafts, from a process that cannot import numba."""
    asked = pickle.dumps((room(order=3), POSES, ACCURACY))
    done = subprocess.run([sys.executable, "-c", SCRIPT], input=asked, capture_output=True, check=True, cwd=ROOT)
    assert not done.stderr, done.stderr
    return pickle.loads(done.stdout)


def test_pictures_are_as_accurate_as_asked_for(plain):
    """Against the compiled engine, ten times finer. Before, sums over rays took minutes at some poses."""
    background, pictures, drafts = plain
    engine = Transport(room(order=3), accuracy=ACCURACY / 10.0)
    assert np.sqrt(((background - engine.background()) ** 2).mean()) < ACCURACY * engine.background().mean()
    for pose, picture, draft in zip(POSES, pictures, drafts, strict=True):
        made = engine.render(*pose)
        level = np.sqrt((made.added**2).mean())
        errors = [np.sqrt(((one - made.added + made.hidden) ** 2).mean()) / level for one in (picture, draft)]
        assert errors[0] < ACCURACY
        assert errors[1] < 0.15
