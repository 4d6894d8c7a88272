"""The three-reflection integral on plain arrays: free of noise, and exact to the requested accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from generator.transport.world import AmbientLight, Emitters, Gloss, LitPatch, Mesh, Sphere, Watched, World

if TYPE_CHECKING:
    from generator.transport.render import Gains, Rendered, Transport

__all__ = [
    "AmbientLight",
    "Emitters",
    "Gains",
    "Gloss",
    "LitPatch",
    "Mesh",
    "Rendered",
    "Sphere",
    "Transport",
    "Watched",
    "World",
]


def __getattr__(name: str) -> Any:
    # Code that only reads worlds and data sets does not need the compiler, which takes a second to load.
    if name in ("Gains", "Rendered", "Transport"):
        from generator.transport import render

        return getattr(render, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
