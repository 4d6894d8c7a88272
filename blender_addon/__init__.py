"""The Blender extension: panels and operators. They set and show; `generator` builds, reads and renders.

`bpy` is imported only on registration, so that `packaging.build` runs without it.
"""

import gc
from typing import Any


def _modules() -> tuple[Any, ...]:
    from . import handlers
    from .operators import answer, assets, browser, dataset, environment, grid, scene, timeline, train
    from .session import background
    from .ui import assets as assets_panel
    from .ui import browser_panel, live_answer_panel, menus, panels, properties, timeline_panel, training
    from .view import caption, differs, handles, live, live_answer, overlay, path, thumbnails

    rest = (
        background,
        environment,
        scene,
        dataset,
        answer,
        assets,
        train,
        browser,
        grid,
        thumbnails,
        timeline,
        menus,
        panels,
        assets_panel,
        training,
        browser_panel,
        live_answer_panel,
        timeline_panel,
        overlay,
        handles,
        live,
        live_answer,
        path,
        differs,
        caption,
        handlers,
    )
    return (properties, *rest)


def register() -> None:
    """Add the settings, operators and panels to Blender."""
    for module in _modules():
        module.register()
    # What is loaded stays. Python would go through all of it again with each full collection, and the window waits.
    gc.collect()
    gc.freeze()


def unregister() -> None:
    """Remove the settings, operators and panels from Blender."""
    gc.unfreeze()
    for module in reversed(_modules()):
        module.unregister()
