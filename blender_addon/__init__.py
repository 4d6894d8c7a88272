"""The Blender extension: panels and operators. They set and show; `generator` builds, reads and renders.

`bpy` is imported only on registration, so that `packaging.build` runs without it.
"""

from typing import Any


def _modules() -> tuple[Any, ...]:
    from . import handlers
    from .operators import answer, assets, dataset, scene, timeline
    from .session import background
    from .ui import assets as assets_panel
    from .ui import live_answer_panel, menus, panels, properties, timeline_panel
    from .view import caption, differs, live, live_answer, overlay, path

    rest = (
        background,
        scene,
        dataset,
        answer,
        assets,
        timeline,
        menus,
        panels,
        assets_panel,
        live_answer_panel,
        timeline_panel,
        overlay,
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


def unregister() -> None:
    """Remove the settings, operators and panels from Blender."""
    for module in reversed(_modules()):
        module.unregister()
