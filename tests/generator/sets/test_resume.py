"""A set is gone on with by the same settings, however they are given."""

from types import SimpleNamespace

import pytest

from generator.model.errors import NlosError
from generator.sets import resume
from generator.sets.manifest import SCENE


@pytest.fixture
def begun(tmp_path):
    """A set's settings as its manifest gives them back, and its scene."""
    scene = tmp_path / SCENE
    scene.write_bytes(b"a scene")
    settings = {"engine": "surfel", "resolution": [64, 48], "rotation": [15.0, 15.0, 90.0], "seed": 3, "poses": 2}
    return SimpleNamespace(path=tmp_path, settings=settings, meta={}), scene


@pytest.mark.parametrize("resolution", ["64x48", (64, 48), [64, 48]])
@pytest.mark.parametrize("kind", [tuple, list])
def test_text_tuples_and_lists_are_one(begun, resolution, kind):
    resume.check_same(*begun, {"resolution": resolution, "rotation": kind((15.0, 15.0, 90.0)), "engine": "auto"})


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ({"resolution": (48, 64)}, r"resolution is \[64, 48\] there and \[48, 64\] here"),
        ({"seed": 4}, "seed is 3 there and 4 here"),
        ({"frames": 9}, "its poses lie in voxels"),
    ],
)
def test_what_differs_is_named(begun, chosen, words):
    with pytest.raises(NlosError, match=words):
        resume.check_same(*begun, chosen)
