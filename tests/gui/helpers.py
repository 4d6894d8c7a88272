"""What a step can use. It runs inside Blender, where nothing of the repository but the extension's zip is at hand.

A step is a function, or a generator function whose every ``yield seconds`` gives Blender's event loop time. The
helpers that wait are generators too: call them by ``yield from``.
"""

from __future__ import annotations

import ctypes
import functools
import importlib
import itertools
import os
import shlex
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

GUI = Path(__file__).resolve().parent
WORK = Path(os.environ["NLOS_GUI_WORK"])  # for files that steps write; gone afterwards
PACKAGE = next(GUI.glob("*.zip"))
MODULE = "bl_ext.user_default.nlos_lab"

# What steps leave for later ones. Nothing of bpy belongs in here: undo and opening a file make it invalid.
memory: dict[str, Any] = {}

failures: list[str] = []  # checks of the current step that failed
waiting: list[str] = []  # helpers that were called without `yield from`

Wait = Generator[float, None, Any]


def say(words: str) -> None:
    """Print for the harness, which passes on what is marked."""
    # What Blender has printed itself would come later, or never: `os._exit` drops it.
    ctypes.CDLL(None).fflush(None)
    for line in words.splitlines():
        print(f"@@ {line}", flush=True)


def check(condition: object, words: str) -> bool:
    """Count a failure unless the condition holds; the step goes on."""
    if not condition:
        failures.append(words)
        say(f"FAILED check: {words}")
    return bool(condition)


def _waits(function: Callable[..., Wait]) -> Callable[..., Wait]:
    """Note calls whose generator is never run."""

    @functools.wraps(function)
    def noted(*arguments: Any, **options: Any) -> Wait:
        waiting.append(function.__name__)

        def begun() -> Wait:
            waiting.remove(function.__name__)
            return (yield from function(*arguments, **options))

        return begun()

    return noted


@_waits
def until(condition: Callable[[], object], words: str, limit: float = 30.0) -> Wait:
    """Wait for a condition; return whether it came to hold in time, a failed check if not."""
    end = time.monotonic() + limit
    while not condition():
        if time.monotonic() > end:
            return check(False, f"{words} (waited {limit:g} s)")
        yield 0.02
    return True


@_waits
def screenshot(name: str) -> Wait:
    """Have a picture of the screen taken, as ``gui-VERSION-name.png`` in the harness's output folder."""
    redraw()
    yield 0.3
    _ask(f"{name}.request", "")
    made = GUI / "shots" / f"{name}.png"
    yield from until(made.exists, f"the picture {name} is taken")


@_waits
def xdotool(*arguments: object) -> Wait:
    """Have keys pressed or the mouse moved: ``yield from xdotool("key", "Escape")``.

    Blender is told by then, and handles it when the step yields next.
    """
    name = f"{next(_numbers):04}"
    done = GUI / "shots" / f"{name}.done"
    _ask(f"{name}.xdotool", shlex.join(map(str, arguments)))
    if (yield from until(done.exists, f"xdotool {arguments} is answered")):
        told = done.read_text(encoding="utf-8")
        done.unlink()
        check(not told, f"xdotool {arguments}: {told}")
    yield 0.1


@_waits
def point(x: float, y: float) -> Wait:
    """Move the mouse to a place in the window, in Blender's own pixels: y grows upwards."""
    bpy.context.window_manager.windows[0].cursor_warp(round(x), round(y))
    for _ in range(3):  # a button is left at one turn of the event loop, the next one entered at another
        yield 0.01


@_waits
def click(x: float, y: float) -> Wait:
    """Click on a place in the window."""
    yield from point(x, y)
    yield 0.1
    yield from xdotool("click", 1)
    yield 0.2


@_waits
def tab(name: str) -> Wait:
    """Open the sidebar and bring a tab of it to the front; return whether it came."""
    with view3d() as (area, region):
        area.spaces.active.show_region_ui = True
        empty = (region.x + region.width / 3, region.y + region.height / 4)
    yield from point(*empty)  # or the tooltip of what it rests on would cover the sidebar
    redraw()
    # Until it has been drawn, there are no tabs to choose from.
    yield from until(lambda: _sidebar().active_panel_category != "UNSUPPORTED", "the sidebar is drawn")
    try:
        _sidebar().active_panel_category = name
    except TypeError as error:  # it says which there are
        return check(False, f"the sidebar has the tab {name}: {error}")
    redraw()
    yield 0.5
    return check(_sidebar().active_panel_category == name, f"the sidebar shows the tab {name}")


@_waits
def panel_picture(panel: str, name: str) -> Wait:
    """Have a picture taken in which a panel, closed or below others else, stands open in a tab of its own."""
    kind = getattr(bpy.types, panel)
    kept = {key: value for key, value in vars(kind).items() if key in ("bl_label", "draw", "draw_header")}
    where = {"bl_space_type": "VIEW_3D", "bl_region_type": "UI", "bl_category": "Picture"}
    copy = type(f"{panel}_picture", (bpy.types.Panel,), {**kept, **where})
    bpy.utils.register_class(copy)
    try:
        redraw()
        yield 0.3
        yield from tab("Picture")
        yield from screenshot(name)
    finally:
        bpy.utils.unregister_class(copy)
    redraw()
    yield 0.3
    yield from tab("NLOS")


@_waits
def press(operator: str, across: float = 0.0) -> Wait:
    """Find an operator's button in the sidebar by mouse, scrolling if need be, and click on it.

    ``yield from press("nlos.build_scene")``, or with arguments that tell its buttons apart, written as Blender does:
    ``yield from press("nlos.experiment(number=2")``. Every movement redraws the sidebar, so this takes five to forty
    seconds; ``across``, where to look in the sidebar's width, 0 to 1, saves most of that for small buttons. A message
    that an earlier click raised takes the mouse: close it by ``xdotool("key", "Escape")`` before.
    """
    wanted = f"bpy.ops.{operator}" if "(" in operator else f"bpy.ops.{operator}("
    sidebar = _sidebar()
    rows = range(sidebar.y + sidebar.height - 8, sidebar.y, -16)
    # Nearly all are as wide as the sidebar or half of it; then what stands in threes or at the end of a row.
    for columns in ((across,),) if across else ((0.3, 0.65), (0.12, 0.48, 0.84)):
        above = None
        yield from scroll(-100)
        while above != (above := _scrolled()):
            for y, share in itertools.product(rows, columns):
                yield from point(sidebar.x + share * sidebar.width, y)
                if _under_mouse().startswith(wanted):
                    yield 0.2  # it may still have been the one before
                    if _under_mouse().startswith(wanted):
                        yield from xdotool("click", 1)
                        yield 0.3
                        return True
            yield from scroll(15)
    return check(False, f"the sidebar's tab has a button of {operator}")


@_waits
def looked() -> Wait:
    """Wait until the check has found all that it finds without rendering, which it does step by step."""
    is_stepping = module("session.background").is_stepping
    return (yield from until(lambda: not is_stepping(), "the check has looked"))


@_waits
def scroll(notches: int) -> Wait:
    """Turn the mouse wheel over the sidebar, down if positive; about 40 pixels a notch."""
    sidebar = _sidebar()
    yield from point(sidebar.x + sidebar.width / 2, sidebar.y + sidebar.height / 2)
    yield 0.1
    yield from xdotool("click", "--repeat", abs(notches), "--delay", 5, 5 if notches > 0 else 4)
    yield 0.3


@contextmanager
def view3d(region: str = "WINDOW") -> Iterator[tuple[Any, Any]]:
    """Act as if the mouse were in the 3D viewport; gives its area and region. Do not yield inside."""
    window = bpy.context.window_manager.windows[0]
    area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
    inside = next(r for r in area.regions if r.type == region)
    with bpy.context.temp_override(window=window, area=area, region=inside):
        yield area, inside


def call(operator: Any, **arguments: Any) -> Any:
    """Run an operator in the 3D viewport, with its undo step; return its result, or its error as text."""
    return _run(operator, "EXEC_DEFAULT", arguments)


def invoke(operator: Any, **arguments: Any) -> Any:
    """Run an operator as its button does: one that is modal goes on when the step yields."""
    return _run(operator, "INVOKE_DEFAULT", arguments)


def redraw() -> None:
    """Have everything drawn anew when the step yields next."""
    for area in bpy.context.window_manager.windows[0].screen.areas:
        area.tag_redraw()


def module(name: str) -> Any:
    """Return a module of the installed extension, such as ``"generator.blender.scene.build"``."""
    return importlib.import_module(f"{MODULE}.{name}")


def roles() -> dict[str, list[str]]:
    """Return the names of the scene's objects for each ``nlos_role``."""
    found: dict[str, list[str]] = {}
    for obj in bpy.context.scene.objects:
        if "nlos_role" in obj:
            found.setdefault(obj["nlos_role"], []).append(obj.name)
    return found


_numbers = itertools.count()


def _ask(name: str, text: str) -> None:
    request = GUI / "shots" / name
    begun = request.with_suffix(".begun")
    begun.write_text(text, encoding="utf-8")
    begun.rename(request)


def _run(operator: Any, how: str, arguments: dict[str, Any]) -> Any:
    with view3d():
        try:
            return operator(how, True, **arguments)
        except RuntimeError as error:
            return str(error).strip()


def _sidebar() -> Any:
    with view3d("UI") as (_, region):
        return region


def _scrolled() -> float:
    return _sidebar().view2d.region_to_view(0, 0)[1]


def _under_mouse() -> str:
    """Return the Python command of the button that the mouse points at."""
    manager = bpy.context.window_manager
    manager.clipboard = ""
    with view3d("UI"):
        try:
            bpy.ops.ui.copy_python_command_button()
        except RuntimeError:  # no button, or one of a property
            return ""
    return manager.clipboard
