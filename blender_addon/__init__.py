"""The Blender extension: what one clicks. It sets and shows; `generator` builds, reads and renders.

`bpy` is imported on registration only, so that `build` runs without it.
"""


def register() -> None:
    """Add the settings, operators and panels to Blender."""
    from . import operators, panels, properties

    properties.register()
    operators.register()
    panels.register()


def unregister() -> None:
    """Take them out again."""
    from . import operators, panels, properties

    panels.unregister()
    operators.unregister()
    properties.unregister()
