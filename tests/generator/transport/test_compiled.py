"""Functions that are compiled to work in place, and the records that compiled functions take."""

import ast

import numpy as np
import pytest

from generator.transport import caching, compiled

IN_PLACE = ("jit_in_place", "jit_inlined")
SCALARS = {"None", "int", "float", "bool"}


def _in_place():
    """Functions that count no references: (file, name, what they return)."""
    for source in caching.sources():
        for node in ast.parse(source.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef):
                marks = {d.id for d in node.decorator_list if isinstance(d, ast.Name)}
                if marks & set(IN_PLACE):
                    yield f"{source.name}:{node.name}", ast.unparse(node.returns)


def test_what_works_in_place_returns_no_array():
    """It would hand out an array that nobody owns."""
    found = dict(_in_place())
    assert len(found) > 20
    for name, returns in found.items():
        parts = returns.removeprefix("tuple[").removesuffix("]").split(", ")
        assert set(parts) <= SCALARS, f"{name} returns {returns}"


@pytest.mark.skipif(not compiled.COMPILED, reason="numba is not installed")
def test_numba_refuses_one_that_makes_an_array():
    from numba.core.errors import NumbaError

    @compiled.jit_in_place
    def maker(n: int) -> float:
        return np.ones(n).sum()

    with pytest.raises(NumbaError):
        maker(3)


def test_few_parameters():
    """A compiled function takes records, not a dozen arrays."""
    for source in caching.sources():
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = [a.arg for a in node.args.args + node.args.kwonlyargs if a.arg not in ("self", "cls")]
                assert len(names) <= 8, f"{source.name}:{node.name} takes {len(names)}: {', '.join(names)}"
