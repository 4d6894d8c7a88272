"""numba where it is installed; inside Blender, which lacks it, the same functions run as plain Python and NumPy."""

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
"""Numbers 0 and 1 for calls: numba compiles a function anew for every literal that it is called with."""

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
    """Compile a function if numba is there."""
    return _compile(function)


def jit_in_place(function: Function) -> Function:
    """Compile a function that makes no arrays and returns none, nor calls one that does.

    Nothing in it counts references. That is done by atomic instructions, two for each array that a call is given: in
    functions as small as those that cut polygons it was two fifths of the time. numba refuses to compile one that
    makes an array; one that returned an array would free what others still use (tests/generator/transport/
    test_compiled.py).
    """
    return _compile(function, _nrt=False)


def jit_inlined(function: Function) -> Function:
    """As `jit_in_place`, for what is called in the innermost loops: a call copies its records, number by number."""
    return _compile(function, _nrt=False, forceinline=True)


def jit_released(function: Function) -> Function:
    """Compile a function that `in_parts` may call from several threads.

    For a deep function that is a third of the time that numba takes to compile a parallel loop around it.
    """
    return _compile(function, nogil=True)


def in_parts(function: Callable[..., None], n: int, *arguments: Any) -> None:
    """Call ``function(start, stop, *arguments)`` for parts of range(n), on the threads that `limit_threads` gave.

    What is already a part of something runs where it is.
    """
    threads = int(numba.get_num_threads()) if COMPILED and not _is_part.here else 1
    if threads == 1 or n == 1:
        function(0, n, *arguments)
        return
    step = max(1, n // (8 * threads))
    parts = [_pool(threads).submit(function, at, min(at + step, n), *arguments) for at in range(0, n, step)]
    for part in parts:
        part.result()


class _IsPart(threading.local):
    """Whether this thread is one of a pool."""

    here = False

    def enter(self) -> None:
        """Make it one."""
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
    before, kept = _config.CACHE_DIR, caching.folder()
    try:
        _config.CACHE_DIR = str(kept or "")
        return _njit(function, cache=kept is not None, **options)
    finally:
        _config.CACHE_DIR = before


def _njit(function: Function, **options: Any) -> Function:
    # "contract" lets a multiplication and an addition become one instruction, which rounds once instead of twice.
    # Nothing else of fastmath: reassociation would make the last bits depend on the compiler's mood.
    made: Function = numba.njit(function, error_model="numpy", fastmath={"contract"}, **options)
    return made


def limit_threads(threads: int) -> int:
    """Let parallel loops use that many threads (0: all cores); return how many they use."""
    if not COMPILED:
        return 1
    most = int(_config.NUMBA_NUM_THREADS)
    numba.set_num_threads(min(threads, most) if threads else most)
    return int(numba.get_num_threads())
