"""Compile with numba where installed; in Blender, which lacks it, the functions run as plain Python and NumPy."""

from __future__ import annotations

import functools
import gc
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from generator.transport import caching

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILED = False
try:
    import numba
except ImportError:
    pass
else:
    COMPILED = True
    _config: Any = numba.config

_plain: dict[str, Any] = {}
"""Options of functions whose loops are not compiled for SIMD."""


def jit_released(function: Function) -> Function:
    """Compile a function that is called from Python, by `in_parts` from several threads at once.

    For a function with many nested calls, this takes a third of the time of compiling a parallel loop around it.
    """
    return _compile(function)


def jit_parts(function: Function) -> Function:
    """As `jit_released`, for a function that neither creates nor returns arrays, and calls none that does.

    It is compiled without reference counting, which takes two atomic instructions for each array argument of a call:
    two fifths of the time in functions as small as those that cut polygons. numba refuses to compile such a function
    if it creates an array; if it returned one, it would free memory that is still in use (tests/generator/transport/
    test_compiled.py). Nor are its loops compiled for SIMD, in versions for short and long ones.
    """
    return _compile(function, _nrt=False, no_cfunc_wrapper=True, **_plain)


def jit_in_place(function: Function) -> Function:
    """As `jit_parts`, for a function that compiled ones call; a call from Python runs it as plain Python.

    It has no entry from Python, which for a record of arrays is longer than most functions, and is compiled once
    whether an argument is written as a number or not. numba would compile it for each number.
    """
    return _inner(function, **_plain)


def jit_inlined(function: Function) -> Function:
    """As `jit_in_place`, and inlined, for innermost loops: a call would copy its records, number by number."""
    return _inner(function, forceinline=True, **_plain)


def jit_within(function: Function) -> Function:
    """As `jit_in_place`, for a function with one caller, and compiled as part of it.

    A function is compiled once for itself and once with each function that calls it, calls one that does, and so on.
    """
    return _inner(function, inline="always", **_plain)


def jit_loops(function: Function) -> Function:
    """As `jit_in_place`, for long loops over arrays: with SIMD instructions."""
    return _inner(function)


def in_parts(function: Callable[..., None], n: int, *arguments: Any) -> None:
    """Call ``function(start, stop, *arguments)`` for parts of range(n), on as many threads as `limit_threads` allows.

    A call made from one of these threads is not divided again and runs on that thread.
    """
    if not COMPILED:
        with np.errstate(all="ignore"):  # as compiled code, which divides by zero without a word
            function(0, n, *arguments)
        return
    threads = 1 if _is_part.here else int(numba.get_num_threads())
    if threads == 1 or n == 1:
        function(0, n, *arguments)
        return
    step = max(1, n // (8 * threads))
    parts = [_pool(threads).submit(function, start, min(start + step, n), *arguments) for start in range(0, n, step)]
    for part in parts:
        part.result()


class _IsPart(threading.local):
    """Whether the current thread belongs to a pool."""

    here = False

    def enter(self) -> None:
        """Mark the current thread as one of a pool."""
        self.here = True


_is_part = _IsPart()


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="transport", initializer=_is_part.enter)


if hasattr(os, "register_at_fork"):
    # A forked process has none of its parent's threads.
    os.register_at_fork(after_in_child=_pool.cache_clear)


def _compile(function: Function, **options: Any) -> Function:
    if not COMPILED:
        return function
    previous, cache = _config.CACHE_DIR, caching.folder()
    try:
        _config.CACHE_DIR = str(cache or "")
        return _njit(function, cache=cache is not None, **options)
    finally:
        _config.CACHE_DIR = previous


def _inner(function: Function, **options: Any) -> Function:
    if not COMPILED:
        return function
    inside = {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    inner: Any = _Inner(function, _njit(function, **inside, **options))
    return inner  # type: ignore[no-any-return]


def _njit(function: Function, **options: Any) -> Function:
    # "contract" lets a multiplication and an addition become one instruction, which rounds once instead of twice.
    # The rest of fastmath stays off: reassociation would make the last bits depend on how the compiler optimises.
    compiled: Function = numba.njit(function, nogil=True, error_model="numpy", fastmath={"contract"}, **options)
    return compiled


class _Inner:
    """A function without an entry from Python: numba's own object would crash where Python calls it."""

    def __init__(self, function: Callable[..., Any], dispatcher: Any) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.dispatcher = function, dispatcher
        self.targetoptions = dispatcher.targetoptions

    def __call__(self, *arguments: Any) -> Any:
        return self.py_func(*arguments)


if COMPILED:
    from numba.core.compiler import Compiler
    from numba.extending import models, register_model, typeof_impl

    class _Plain(Compiler):  # type: ignore[misc]
        """numba's compiler without SIMD for loops, and without Python's garbage collector, a seventh of the time."""

        def compile_extra(self, function: Any) -> Any:
            """Compile a function."""
            collects, vectorises = gc.isenabled(), _config.LOOP_VECTORIZE
            gc.disable()
            _config.LOOP_VECTORIZE = 0
            try:
                return super().compile_extra(function)
            finally:
                _config.LOOP_VECTORIZE = vectorises
                if collects:
                    gc.enable()

    _plain["pipeline_class"] = _Plain

    class _InnerType(numba.types.Dispatcher):  # type: ignore[misc]
        """The type of `_Inner` in compiled code, called with the types of numbers, not with numbers as types."""

        def get_call_type(self, context: Any, arguments: Any, keywords: Any) -> Any:
            """Return the signature of a call, for which the function is compiled."""
            return super().get_call_type(context, tuple(map(numba.types.unliteral, arguments)), keywords)

    register_model(_InnerType)(models.OpaqueModel)

    @typeof_impl.register(_Inner)
    def _type_of_inner(value: _Inner, _context: Any) -> Any:
        return _InnerType(value.dispatcher)


def limit_threads(threads: int) -> int:
    """Set how many threads `in_parts` and parallel loops may use (0: all cores); return the number in use."""
    if not COMPILED:
        return 1
    available = int(_config.NUMBA_NUM_THREADS)
    numba.set_num_threads(min(threads, available) if threads else available)
    return int(numba.get_num_threads())
