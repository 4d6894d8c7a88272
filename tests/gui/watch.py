"""Times every step of the extension that runs in Blender's main thread: handlers, timers, operators, panels."""

from __future__ import annotations

import sys
import threading
import time
from types import CodeType, FrameType
from typing import Any

import numpy as np

TOOL = 4


class Watch:
    """Notes how long each outermost call into a package takes; what other code does costs next to nothing.

    Parameters
    ----------
    part : str
        A part of the path of the package's files.

    Attributes
    ----------
    steps : list of (float, str)
        Seconds, and name of the function that was called from outside.
    """

    def __init__(self, part: str) -> None:
        self.steps: list[tuple[float, str]] = []
        self._part, self._since, self._name = part, 0.0, ""
        self._frame: FrameType | None = None  # of the call from outside that is going on
        self._main = threading.main_thread().ident

    def __enter__(self) -> Watch:
        watching, events = sys.monitoring, sys.monitoring.events
        watching.use_tool_id(TOOL, "nlos stalls")
        begins, ends = (events.PY_START, events.PY_RESUME), (events.PY_RETURN, events.PY_YIELD)
        for callback, several in ((self._begin, begins), (self._end, ends), (self._raised, (events.PY_UNWIND,))):
            for event in several:
                watching.register_callback(TOOL, event, callback)
        watching.set_events(TOOL, sum(begins + ends) + events.PY_UNWIND)
        return self

    def __exit__(self, *_: object) -> None:
        sys.monitoring.set_events(TOOL, 0)
        sys.monitoring.free_tool_id(TOOL)

    def _begin(self, code: CodeType, *_: Any) -> Any:
        if self._part not in code.co_filename:
            return sys.monitoring.DISABLE
        if self._frame is None and threading.get_ident() == self._main:
            self._frame = sys._getframe(1)
            self._name = f"{code.co_filename.rpartition('/')[2]} {code.co_qualname}"
            self._since = time.perf_counter()
        return None

    def _end(self, code: CodeType, *_: Any) -> Any:
        if self._part not in code.co_filename:
            return sys.monitoring.DISABLE
        if sys._getframe(1) is self._frame:
            self._end_of_frame()
        return None

    def _raised(self, code: CodeType, *_: Any) -> None:
        if sys._getframe(1) is self._frame:
            self._end_of_frame()  # this event cannot be disabled for a function

    def _end_of_frame(self) -> None:
        self._frame = None
        self.steps.append((time.perf_counter() - self._since, self._name))

    def told(self) -> list[str]:
        """Return what was found, in lines: all steps, then the slowest of each kind."""
        seconds = np.array([step[0] for step in self.steps])
        lines = [
            f"{len(seconds)} steps, 99th percentile {1e3 * np.quantile(seconds, 0.99):.1f} ms, "
            f"longest {1e3 * seconds.max():.0f} ms"
        ]
        for name in sorted({step[1] for step in self.steps}):
            own = np.array([step[0] for step in self.steps if step[1] == name])
            if own.max() > 0.005:
                lines.append(f"  {name}: {len(own)} times, longest {1e3 * own.max():.0f} ms")
        return lines
