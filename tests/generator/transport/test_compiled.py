"""Functions that are compiled to work in place, and the records that compiled functions take."""

import ast

import numpy as np
import pytest

from generator.transport import caching, compiled

IN_PLACE = ("jit_parts", "jit_in_place", "jit_inlined", "jit_within", "jit_loops")
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
    """It would hand out an array that nobody owns. `elements.Between` holds numbers only."""
    found = dict(_in_place())
    assert len(found) > 20
    for name, returns in found.items():
        parts = returns.removeprefix("tuple[").removesuffix("]").split(", ")
        assert set(parts) <= SCALARS | {"Between"}, f"{name} returns {returns}"


@pytest.mark.skipif(not compiled.COMPILED, reason="numba is not installed")
def test_numba_refuses_one_that_makes_an_array():
    from numba.core.errors import NumbaError

    @compiled.jit_parts
    def maker(n: int) -> float:
        return np.ones(n).sum()

    with pytest.raises(NumbaError):
        maker(3)


@pytest.mark.skipif(not compiled.COMPILED, reason="numba is not installed")
def test_one_entry_serves_numbers_and_variables():
    """numba compiles a function for each number that it is called with, and crashes where it has no entry."""

    @compiled.jit_in_place
    def power(x, n):
        value = 1.0
        for _ in range(n):
            value *= x
        return value

    @compiled.jit_parts
    def powers(x, n):
        return power(x, 2) + power(x, 3) + power(x, n)

    assert powers(2.0, 4) == 4.0 + 8.0 + 16.0
    assert len(power.dispatcher.signatures) == 1
    assert power(2.0, 5) == 32.0, "from Python"


@pytest.mark.skipif(not compiled.COMPILED, reason="numba is not installed")
def test_a_function_within_its_caller_is_not_compiled_for_itself():
    @compiled.jit_within
    def halves(x):
        if x > 10.0:
            return 10.0
        return x / 2.0

    @compiled.jit_parts
    def sums(x, y):
        return halves(x) + halves(y)

    assert sums(20.0, 4.0) == 12.0
    assert not halves.dispatcher.signatures


def test_few_parameters():
    """A compiled function takes records, not a dozen arrays."""
    for source in caching.sources():
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = [a.arg for a in node.args.args + node.args.kwonlyargs if a.arg not in ("self", "cls")]
                assert len(names) <= 8, f"{source.name}:{node.name} takes {len(names)}: {', '.join(names)}"
