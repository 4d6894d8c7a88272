"""GPUs that Blender's preferences choose, which a request passes on to workers: these start without preferences."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import TypeAlias

Gpus: TypeAlias = Mapping[str, Sequence[str]]
"""Ids of devices by the kind that Cycles uses them as, such as ``OPTIX``; empty if none are chosen."""

_CHOSEN: ContextVar[Gpus] = ContextVar("chosen GPUs", default={})  # noqa: B039
"""Holds for this thread; a request passes it on to a worker (`generator.jobs.protocol.Request`)."""


def chosen() -> Gpus:
    """Return the GPUs that were chosen; empty if it is left to the Blender that renders."""
    return _CHOSEN.get()


@contextlib.contextmanager
def choosing(gpus: Gpus) -> Iterator[None]:
    """Render on these GPUs within this context, where a GPU is asked for, in this thread and in workers it starts."""
    token = _CHOSEN.set(gpus or _CHOSEN.get())
    try:
        yield
    finally:
        _CHOSEN.reset(token)
