"""What `generator` and `classify` offer to Python programs: it is there, documented, and its examples run."""

from __future__ import annotations

import doctest
import importlib
import inspect
import subprocess
import sys

import pytest

PACKAGES = ("generator", "classify")
WITH_EXAMPLES = ("generator", "classify", "generator.blender.render_poses", "generator.blender.scene.build")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_name_is_there_and_documented(package):
    module = importlib.import_module(package)
    assert sorted(module.__all__) == module.__all__
    assert set(module.__all__) == set(module._EXPORTS)
    for name in module.__all__:
        assert inspect.getdoc(getattr(module, name)), name
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_run(module):
    found = doctest.testmod(importlib.import_module(module))
    assert found.attempted > 0
    assert not found.failed


def test_drawing_stays_where_the_caller_has_it():
    """In a notebook, a changed backend of Matplotlib would hide every figure from then on."""
    script = "import classify, matplotlib\nmatplotlib.use('svg')\n"
    script += "for name in classify.__all__: getattr(classify, name)\nassert matplotlib.get_backend() == 'svg'\n"
    subprocess.run([sys.executable, "-c", script], check=True)
