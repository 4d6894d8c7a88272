"""The Blender extension: what one clicks. It sets and shows; `generator` builds, reads and renders.

`bpy` is imported on registration only, so that `build` runs without it.
"""

from typing import Any


def _modules() -> tuple[Any, ...]:
    from . import handlers
    from .operators import answer, dataset, scene
    from .session import background
    from .ui import menus, panels, properties, translations
    from .view import caption, live, overlay

    rest = (background, scene, dataset, answer, menus, panels, overlay, live, caption, handlers, translations)
    return (properties, *rest)


def register() -> None:
    """Add the settings, operators and panels to Blender."""
    for module in _modules():
        module.register()


def unregister() -> None:
    """Take them out again."""
    for module in reversed(_modules()):
        module.unregister()
