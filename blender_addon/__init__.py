"""The Blender extension: panels and operators. They set and show; `generator` builds, reads and renders.

`bpy` is imported only on registration, so that `packaging.build` runs without it.
"""

from typing import Any


def _modules() -> tuple[Any, ...]:
    from . import handlers
    from .operators import answer, browser, dataset, environment, grid, scene, train
    from .session import background
    from .ui import browser_panel, menus, panels, properties, training, translations
    from .view import caption, differs, handles, live, overlay, thumbnails

    rest = (
        background,
        environment,
        scene,
        dataset,
        answer,
        train,
        browser,
        grid,
        thumbnails,
        menus,
        panels,
        training,
        browser_panel,
        overlay,
        handles,
        live,
        differs,
        caption,
        handlers,
        translations,
    )
    return (properties, *rest)


def register() -> None:
    """Add the settings, operators and panels to Blender."""
    for module in _modules():
        module.register()


def unregister() -> None:
    """Remove the settings, operators and panels from Blender."""
    for module in reversed(_modules()):
        module.unregister()
