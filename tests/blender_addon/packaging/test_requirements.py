from __future__ import annotations

from importlib.metadata import PackageNotFoundError, requires

import pytest

from blender_addon.packaging import requirements
from blender_addon.session import making


def test_the_extension_asks_for_what_constraints_pin() -> None:
    try:
        requires("skops")
    except PackageNotFoundError:
        pytest.skip("the project's dependencies are not installed")
    there = (making.ADDON / making.REQUIREMENTS).read_text(encoding="utf-8")
    assert there == requirements.text(), "run: python -m blender_addon.packaging.requirements"
    for needed in ("numba==", "scikit-learn==", "skops==", "numpy==", "llvmlite=="):
        assert needed in there
    assert "bpy" not in there
    assert "pytest" not in there
