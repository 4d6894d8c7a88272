"""Suppression of Blender's console output, and temporary changes of its settings."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

import bpy

from generator.blender.scene.words import file_name
from generator.model.errors import NlosError


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress what Blender prints: from C to file descriptor 1, and from Python to sys.stdout."""
    if sys.stdout is not None:
        sys.stdout.flush()
    try:
        saved = os.dup(1)
    except OSError:  # a windowed Blender may have no standard output at all
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)


class Overrides:
    """Set attributes of Blender's data, and restore them in reverse order when the context is left.

    Animation and drivers are applied when a render starts and would overwrite the values, so those of exactly these
    attributes are muted for that time.
    """

    def __init__(self) -> None:
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Overrides:
        return self

    def set(self, owner: Any, name: str, value: Any) -> None:
        """Set an attribute until the context is left.

        Raises
        ------
        NlosError
            The attribute is animated by an action that also animates something else, which muting would change.
        """
        for curve in animating(owner, name):
            self._undo.append(functools.partial(setattr, curve, "mute", False))
            curve.mute = True
        self._undo.append(functools.partial(setattr, owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    def keep(self, owner: Any, *first: str) -> None:
        """Restore all of an owner's settings when the context is left, where setting one changes others.

        Parameters
        ----------
        owner : bpy.types.bpy_struct
            The settings of what it owns are restored too.
        *first : str
            Names of settings that decide which values others may have; they are restored first, in this order.
        """
        with quiet():  # Blender prints complaints about colour spaces that are not set
            values = list(_plain(owner))
        before = sorted(values, key=lambda entry: first.index(entry[1]) if entry[1] in first else len(first))
        self._undo.append(functools.partial(_set_back, owner, before))

    def __exit__(self, *_: object) -> None:
        for undo in reversed(self._undo):
            with contextlib.suppress(TypeError):  # a value of another Blender or add-on, such as its engine
                undo()


def _plain(owner: Any, way: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Yield every settable value of an owner and of what it owns: path to its holder, attribute's name, value."""
    for prop in owner.bl_rna.properties:
        if prop.type == "COLLECTION" or prop.identifier == "rna_type":
            continue
        value = getattr(owner, prop.identifier)
        if prop.type == "POINTER":
            if value is not None and not isinstance(value, bpy.types.ID):
                yield from _plain(value, (*way, prop.identifier))
        elif not prop.is_readonly:
            yield way, prop.identifier, tuple(value) if getattr(prop, "is_array", False) else value


@quiet()
def _set_back(root: Any, before: list[tuple[tuple[str, ...], str, Any]]) -> None:
    for path, name, value in before:
        # Looked up again, because a change of colour management frees the curves of the old one.
        owner = functools.reduce(lambda holder, step: getattr(holder, step, None), path, root)
        if owner is None:
            continue
        current = getattr(owner, name)
        if (tuple(current) if isinstance(value, tuple) else current) != value:
            with contextlib.suppress(TypeError):  # as in `Overrides.__exit__`
                setattr(owner, name, value)


def animating(owner: Any, name: str) -> list[Any]:
    """Return the F-curves, including drivers, that set an attribute when a render starts.

    Parameters
    ----------
    owner : bpy.types.bpy_struct
    name : str

    Raises
    ------
    NlosError
        An F-curve belongs to an action that also animates something else.
    """
    block: Any = getattr(owner, "id_data", None)
    animation = getattr(block, "animation_data", None)
    if animation is None:
        return []
    matching = [curve for curve in animation.drivers if _sets(curve, owner, name)]
    for action, slot in _actions(animation):
        curves = [curve for curve in _curves(action, slot) if _sets(curve, owner, name)]
        # A scene may share its action with another scene, whose settings are not rendered.
        if curves and not isinstance(block, bpy.types.Scene) and _shared(action, slot):
            raise NlosError(
                f"{file_name()}: {block.name!r} shares the action {action.name!r}, which animates its {name!r}, with "
                "something else; give it an action of its own"
            )
        matching += curves
    return matching


def moving_paths(block: Any) -> list[str]:
    """Return the paths of a data-block's attributes that animation or drivers set, each once."""
    animation = getattr(block, "animation_data", None)
    if animation is None:
        return []
    curves = [*animation.drivers, *(c for action, slot in _actions(animation) for c in _curves(action, slot))]
    return list(dict.fromkeys(curve.data_path for curve in curves if not curve.mute))


def _sets(curve: Any, owner: Any, name: str) -> bool:
    """Whether an unmuted F-curve sets an attribute."""
    path = curve.data_path
    if curve.mute or not path.endswith((name, f'"{name}"]')):
        return False
    head = path.removesuffix(f'["{name}"]').removesuffix(name).removesuffix(".")
    if head in ("cycles", '["cycles"]'):  # Cycles' settings were custom properties until Blender 5
        return bool(owner == getattr(owner.id_data, "cycles", None))
    try:
        return bool((owner.id_data.path_resolve(head) if head else owner.id_data) == owner)
    except ValueError:  # the path leads nowhere
        return False


def _actions(animation: Any) -> list[tuple[Any, Any]]:
    """Actions that animate a data-block, directly or as NLA strips, each with the handle of its slot, if any."""
    users, strips = [animation], [strip for track in animation.nla_tracks for strip in track.strips]
    while strips:
        strip = strips.pop()
        users.append(strip)
        strips += strip.strips  # of a meta-strip
    return [(user.action, getattr(user, "action_slot_handle", None)) for user in users if user.action is not None]


def _curves(action: Any, slot: Any) -> list[Any]:
    if not hasattr(action, "layers"):  # until Blender 4.3
        return list(action.fcurves)
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for bag in bags if bag.slot_handle == slot for curve in bag.fcurves]


def _shared(action: Any, slot: Any) -> bool:
    slots = [s for s in getattr(action, "slots", ()) if s.handle == slot]
    return len(slots[0].users()) > 1 if slots else action.users - action.use_fake_user > 1
