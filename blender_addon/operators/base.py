"""What operators share: bad input is told in a sentence, and of long work of one kind there is one at a time."""

from __future__ import annotations

from typing import Any

from generator.model.errors import NlosError

from ..session import background, state, wording


def refused(operator: Any, error: NlosError | str) -> set[str]:
    """Report what is wrong, in the panels' words, and return that the operator did nothing."""
    operator.report({"ERROR"}, wording.shown(str(error)))
    return {"CANCELLED"}


class Told:
    """An operator whose ``act`` raises NlosError on bad input, which is reported."""

    def execute(self: Any, context: Any) -> set[str]:
        """Act, or report why that cannot be."""
        try:
            self.act(context)
        except NlosError as error:
            return refused(self, error)
        state.redraw("VIEW_3D", "PREFERENCES")
        return {"FINISHED"}


class Job:
    """Long work in the background.

    Attributes
    ----------
    words : str
        What is being done, or how it ended.
    share : float
        How much is done, 0 to 1.
    running : bool
        Whether it goes on.
    """

    _task: background.Task

    def __init__(self, words: str) -> None:
        self.words, self.share, self.running = words, 0.0, True

    def cancel(self) -> None:
        """Ask for the end."""
        self._task.stop.set()


class _Of:
    """An operator of the work that a module's ``job`` is.

    Attributes
    ----------
    busy, idle : str
        That it goes on, and that it does not, for tooltips.
    """

    busy, idle = "", ""

    @classmethod
    def job(cls) -> Any:
        """Return the work that goes on, or the last one; None if there was none."""
        raise NotImplementedError

    @classmethod
    def is_busy(cls) -> bool:
        """Return whether it goes on."""
        job = cls.job()
        return job is not None and bool(job.running)


class Alone(_Of):
    """An operator that is not to be had while the work goes on, such as the one that begins it."""

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether the work does not go on."""
        cls.poll_message_set(cls.busy)
        return not cls.is_busy()


class Cancels(_Of):
    """An operator that ends the work."""

    bl_label = "Cancel"
    said = ""
    """What is reported."""

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether the work goes on."""
        cls.poll_message_set(cls.idle)
        return bool(cls.is_busy())

    def execute(self: Any, context: Any) -> set[str]:
        """Ask for the end."""
        self.job().cancel()
        if self.said:
            self.report({"INFO"}, self.said)
        state.redraw("VIEW_3D", "PREFERENCES")
        return {"FINISHED"}
