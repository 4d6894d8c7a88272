"""Blender's console kept quiet, and settings that are put back."""

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
    """Silence what Blender prints about its own doings: by C, to file descriptor 1, and by Python's sys.stdout."""
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
    """Set attributes of Blender's data and set them back on leaving, last first.

    Animation and drivers have their say when a render starts, and would overrule what is set; so those of just these
    attributes are muted for as long.
    """

    def __init__(self) -> None:
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Overrides:
        return self

    def set(self, owner: Any, name: str, value: Any) -> None:
        """Set an attribute until the block is left.

        Raises
        ------
        NlosError
            It is animated by an action that animates something else as well, which muting it would change.
        """
        for curve in animating(owner, name):
            self._undo.append(functools.partial(setattr, curve, "mute", False))
            curve.mute = True
        self._undo.append(functools.partial(setattr, owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    def keep(self, owner: Any, *first: str) -> None:
        """Set back whatever will have changed of an owner's settings, where setting one changes others.

        Parameters
        ----------
        owner : bpy.types.bpy_struct
            With the settings that it owns, theirs too.
        *first : str
            Names of those that decide what others may be, in the order in which they do.
        """
        with quiet():  # Blender complains of colour spaces that are not set
            every = list(_plain(owner))
        before = sorted(every, key=lambda one: first.index(one[1]) if one[1] in first else len(first))
        self._undo.append(functools.partial(_set_back, owner, before))

    def __exit__(self, *_: object) -> None:
        for undo in reversed(self._undo):
            with contextlib.suppress(TypeError):  # what only another Blender or add-on knows, such as its engine
                undo()


def _plain(owner: Any, way: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Every value that can be set of an owner, and of what it owns: the way to whose it is, its name, and which."""
    for about in owner.bl_rna.properties:
        if about.type == "COLLECTION" or about.identifier == "rna_type":
            continue
        value = getattr(owner, about.identifier)
        if about.type == "POINTER":
            if value is not None and not isinstance(value, bpy.types.ID):
                yield from _plain(value, (*way, about.identifier))
        elif not about.is_readonly:
            yield way, about.identifier, tuple(value) if getattr(about, "is_array", False) else value


@quiet()
def _set_back(root: Any, before: list[tuple[tuple[str, ...], str, Any]]) -> None:
    for way, name, value in before:
        # Looked up anew: a change of colour management frees the curves of the old one.
        owner = functools.reduce(lambda holder, step: getattr(holder, step, None), way, root)
        if owner is None:
            continue
        now = getattr(owner, name)
        if (tuple(now) if isinstance(value, tuple) else now) != value:
            with contextlib.suppress(TypeError):  # likewise
                setattr(owner, name, value)


def animating(owner: Any, name: str) -> list[Any]:
    """Return the F-curves, among them drivers, that set an attribute when a render starts.

    Parameters
    ----------
    owner : bpy.types.bpy_struct
    name : str

    Raises
    ------
    NlosError
        One is in an action that animates something else as well.
    """
    block: Any = getattr(owner, "id_data", None)
    animation = getattr(block, "animation_data", None)
    if animation is None:
        return []
    found = [curve for curve in animation.drivers if _sets(curve, owner, name)]
    for action, slot in _actions(animation):
        curves = [curve for curve in _curves(action, slot) if _sets(curve, owner, name)]
        # Another scene's settings are not rendered.
        if curves and not isinstance(block, bpy.types.Scene) and _shared(action, slot):
            raise NlosError(
                f"{file_name()}: {block.name!r} shares the action {action.name!r}, which animates its {name!r}, with "
                "something else; give it an action of its own"
            )
        found += curves
    return found


def _sets(curve: Any, owner: Any, name: str) -> bool:
    """Whether an F-curve that counts sets that attribute."""
    path = curve.data_path
    if curve.mute or not path.endswith((name, f'"{name}"]')):
        return False
    head = path.removesuffix(f'["{name}"]').removesuffix(name).removesuffix(".")
    if head in ("cycles", '["cycles"]'):  # Cycles' settings were custom properties until Blender 5
        return bool(owner == getattr(owner.id_data, "cycles", None))
    try:
        return bool((owner.id_data.path_resolve(head) if head else owner.id_data) == owner)
    except ValueError:  # it leads nowhere
        return False


def _actions(animation: Any) -> list[tuple[Any, Any]]:
    """Actions that animate a data-block, by itself or as strips, each with the handle of its slot, if any."""
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
