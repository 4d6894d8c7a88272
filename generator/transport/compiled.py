"""Compile with numba where installed; in Blender, which lacks it, the functions run as plain Python and NumPy."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from generator.transport import caching

NONE, ONE = np.zeros(2, dtype=np.int64), np.ones(2, dtype=np.int64)
"""Sources of 0 and 1 as arguments (`NONE[0]`, `ONE[0]`): numba compiles a function anew for each literal argument."""

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILED = False
try:
    import numba
except ImportError:
    pass
else:
    COMPILED = True
    _config: Any = numba.config


def jit(function: Function) -> Function:
    """Compile a function if numba is installed."""
    return _compile(function)


def jit_in_place(function: Function) -> Function:
    """Compile a function that neither creates nor returns arrays, and calls none that does.

    It is compiled without reference counting, which takes two atomic instructions for each array argument of a call:
    two fifths of the time in functions as small as those that cut polygons. numba refuses to compile such a function
    if it creates an array; if it returned one, it would free memory that is still in use (tests/generator/transport/
    test_compiled.py).
    """
    return _compile(function, _nrt=False)


def jit_inlined(function: Function) -> Function:
    """As `jit_in_place`, and inlined, for innermost loops: a call would copy its records, number by number."""
    return _compile(function, _nrt=False, forceinline=True)


def jit_released(function: Function) -> Function:
    """Compile a function that `in_parts` may call from several threads.

    For a function with many nested calls, this takes a third of the time of compiling a parallel loop around it.
    """
    return _compile(function, nogil=True)


def in_parts(function: Callable[..., None], n: int, *arguments: Any) -> None:
    """Call ``function(start, stop, *arguments)`` for parts of range(n), on as many threads as `limit_threads` allows.

    A call made from one of these threads is not divided again and runs on that thread.
    """
    threads = int(numba.get_num_threads()) if COMPILED and not _is_part.here else 1
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


def _njit(function: Function, **options: Any) -> Function:
    # "contract" lets a multiplication and an addition become one instruction, which rounds once instead of twice.
    # The rest of fastmath stays off: reassociation would make the last bits depend on how the compiler optimises.
    compiled: Function = numba.njit(function, error_model="numpy", fastmath={"contract"}, **options)
    return compiled


def limit_threads(threads: int) -> int:
    """Set how many threads `in_parts` and parallel loops may use (0: all cores); return the number in use."""
    if not COMPILED:
        return 1
    available = int(_config.NUMBA_NUM_THREADS)
    numba.set_num_threads(min(threads, available) if threads else available)
    return int(numba.get_num_threads())
