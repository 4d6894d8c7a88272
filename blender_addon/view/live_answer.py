"""Answers about the live look while the object is moved: which voxel would the model name, by this picture?

Another process answers (`session.resident`), by the Python of the preferences. Each whole picture that the look shows
is passed on to it as it is; a timer shows what it answers, in the panel and in the overlay.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import bpy

from generator.blender import sweep_worker
from generator.files.toml import to_dict
from generator.jobs.protocol import AnswerPictures, PictureQuestion
from generator.model.errors import NlosError

from ..session import environment, state
from ..session.resident import Resident, answering
from . import live, overlay

_NAME = "Live Answer"
_OFTEN, _SELDOM = 0.02, 0.3
"""Seconds between two looks for an answer, and where none is awaited: the process may start, or die."""
_MOST_STALLS = 100_000


@dataclass
class _Live:
    """State that is kept from answer to answer."""

    resident: Resident | None = None
    words: list[str] = field(default_factory=list)
    asked: int = 0
    answered: int = 0
    count: int = 0
    at: float = 0.0
    begun: float = field(default_factory=time.monotonic)
    told: int = 0
    stalls: list[float] = field(default_factory=list)


_live = _Live()


def words() -> list[str]:
    """Return the sentences for the panel: what answers and by which picture, and what speaks against it."""
    resident = _live.resident
    if resident is None:
        return _live.words
    if resident.ended:
        return [resident.words]
    since = _seconds()
    if not resident.about:
        return [f"The Python of the preferences starts and reads the model: {since} s. The first time takes longest"]
    if not _live.asked and not _live.words:
        return [resident.about, "Waiting for the first whole picture of the look"]
    if _live.answered < _live.asked and since >= 1:
        return [resident.about, f"Waiting for the answer: {since} s", *_live.words]
    return [resident.about, *_live.words]


def _seconds() -> int:
    """Return for how many whole seconds what comes next has been waited for."""
    resident = _live.resident
    started = resident is None or not resident.about or not _live.asked
    return int(time.monotonic() - (_live.begun if started else _live.at))


def waits() -> bool:
    """Return whether an answer is on its way."""
    resident = _live.resident
    return resident is not None and not resident.ended and (not resident.about or _live.answered < _live.asked)


def answers() -> int:
    """Return how many answers were shown since it was switched on."""
    return _live.count


def stalls() -> list[float]:
    """Return the seconds that steps of it have kept Blender's window."""
    return list(_live.stalls)


def switch(on: bool) -> None:
    """Start or stop answering."""
    global _live
    running = _follow in live.followers
    if on and not running:
        live.followers.append(_follow)
        _live = _Live()
        try:
            launch = answering(environment.python())
            model = environment.chosen(bpy.context.scene.nlos.model, f"{environment.MODEL}, or an atlas")
            request = AnswerPictures(model=model)
            _live.resident = Resident([launch], request, name=_NAME, starting="The model is read ...")
            state.once(_show, _SELDOM)
        except NlosError as error:
            _live.words = [str(error)]
        _follow(live.last())
    elif not on and running:
        live.followers.remove(_follow)
        if bpy.app.timers.is_registered(_show):
            bpy.app.timers.unregister(_show)
        if _live.resident is not None:
            _live.resident.stop()
        _live = _Live()
        _forget()


def restart() -> None:
    """Start again, since another model was chosen."""
    if _follow in live.followers:
        switch(False)
        switch(True)


def _forget() -> None:
    if state.answer or state.answer_words:
        state.answer.clear()
        state.answer_words = ""
        overlay.changed()


def _follow(shown: live.Whole | None) -> None:
    """Ask about a picture; None if there is none any more."""
    start = time.perf_counter()
    if shown is None:
        _forget()
    elif _live.resident is not None and not _live.resident.ended:
        fields = shown.fields
        if not fields["shadows"]:
            _live.words = ["The look is without the object's shadows, which a picture has: switch Shadows on"]
            _forget()
            return
        if not waits() or not _live.asked:
            _live.at = time.monotonic()
        _live.asked = shown.number
        _live.resident.ask(
            PictureQuestion(
                number=shown.number,
                world=shown.world,
                shape=fields["shape"],
                pixels=fields["pixels"],
                grid=to_dict(shown.scene.grid),
                target=shown.scene.target.kind,
                colour_space=sweep_worker.colour_space(),
            )
        )
        if bpy.app.timers.is_registered(_show):  # for later
            bpy.app.timers.unregister(_show)
        state.once(_show, _OFTEN)
    _live.stalls.append(time.perf_counter() - start)


def _show() -> float | None:
    """Show an answer that has come; return the seconds to the next call, None if the process has ended."""
    resident = _live.resident
    if resident is None:
        return None
    start = time.perf_counter()
    fields = resident.take()
    if fields is not None and fields["number"] >= max(live.first(), _live.answered + 1):
        _take(fields)
        _live.stalls.append(time.perf_counter() - start)
        del _live.stalls[:-_MOST_STALLS]
    if resident.ended:
        _forget()
        state.redraw("VIEW_3D")
        return None
    if waits() and _live.told != _seconds():
        _live.told = _seconds()
        state.redraw("VIEW_3D")
    return _OFTEN if waits() and resident.about else _SELDOM


def _take(fields: dict[str, Any]) -> None:
    _live.answered = fields["number"]
    state.of.pop("answer", None)  # it follows the scene
    if "refused" in fields:
        _live.words = [fields["refused"]]
        _forget()
    else:
        _live.words, _live.count = list(fields["doubts"]), _live.count + 1
        state.answer.clear()
        state.answer.update(fields["probability"])
        label = max(state.answer, key=lambda v: state.answer[v])
        state.answer_words = f"Voxel {label}, with a probability of {state.answer[label]:.0%}"
        if "position" in fields:
            place = ", ".join(
                f"{p:.2f} ± {d:.2f}" for p, d in zip(fields["position"], fields["deviation"], strict=True)
            )
            state.answer_words += f"; at {place} m"
    overlay.changed()


def register() -> None:
    """Do nothing: it answers only once it is switched on."""


def unregister() -> None:
    """Switch it off."""
    switch(False)
