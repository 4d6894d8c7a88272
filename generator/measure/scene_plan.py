"""A plan of what has to be modelled in a scene: as a table and in sentences."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from generator.model.quantities import clock

POSES = 10
"""Poses per voxel that `surfel` renders for a plan; five missed an effect of few poses in 1 of 24 random rooms."""

MOST = 300.0
"""Time limit of a plan unless another is given, seconds."""

NEEDED, LEFT_OUT, KEPT = "needed", "left out", "kept to be safe"
UNKNOWN = (math.nan, 0.0, math.inf)
"""Share of what could not be measured, and its interval."""


@dataclass(frozen=True)
class Effect:
    """Error of a picture that lacks an effect.

    Attributes
    ----------
    name : str
    share : (float, float, float)
        Error of a difference picture without it, relative to the difference with it, root mean square over pixels and
        poses, with its 95 % interval; NaN where it could not be measured.
    gain : float
        Factor of pictures per second without it; NaN where that was not measured.
    note : str
        Verdict on it; empty where `Plan.dropped` decides.
    """

    name: str
    share: tuple[float, float, float]
    gain: float = math.nan
    note: str = ""

    def rank(self) -> float:
        """Return a key that sorts the largest effect first, and what was not measured before all others."""
        return -math.inf if math.isnan(self.share[0]) else -self.share[0]

    def percent(self) -> str:
        """Return the share as text."""
        value, low, high = (100.0 * s for s in self.share)
        if math.isnan(value):
            return "not measured"
        return f"{value:.3g} % ({low:.3g} to {'any' if math.isinf(high) else format(high, '.3g')})"


@dataclass(frozen=True)
class Plan:
    """What a tolerance allows to leave out, and the cost of a sweep that does so.

    Attributes
    ----------
    effects : list of Effect
        The largest first.
    dropped : list of str
        Names of the effects that are left out together.
    together : Effect
        Measured error with all of these left out together, at the settings below.
    settings : dict
        Settings of the sweep: its engine, and its accuracy or samples.
    tolerance : float
    words : list of str
        Further sentences for the reader.
    predicted : dict
        ``seconds`` of a sweep of this number of ``pictures``, ``bytes`` on disk, and the seconds of a sweep that
        leaves nothing out (``seconds_full``), as far as there was time to measure them.
    unmeasured : list of str
        What there was no time to measure, by name.
    """

    effects: list[Effect]
    dropped: list[str]
    together: Effect
    settings: dict[str, Any] = field(default_factory=dict)
    tolerance: float = 0.01
    words: list[str] = field(default_factory=list)
    predicted: dict[str, float] = field(default_factory=dict)
    unmeasured: list[str] = field(default_factory=list)

    def verdict(self, effect: Effect) -> str:
        """Return whether an effect is left out, or certainly needed: its whole interval lies above the tolerance."""
        if effect.name in self.dropped:
            return LEFT_OUT
        return effect.note or (NEEDED if effect.share[1] > self.tolerance else KEPT)


HEADINGS = ("left out", "error of a difference picture", "pictures a second", "")


def rows(plan: Plan) -> list[tuple[str, ...]]:
    """Return a table: a row for each effect, the largest first."""
    return [
        (
            effect.name,
            effect.percent(),
            "" if math.isnan(effect.gain) else f"x {effect.gain:.2g}",
            plan.verdict(effect),
        )
        for effect in plan.effects
    ]


def words(plan: Plan) -> list[str]:
    """Return the plan in sentences: what is left out, the error of that, and the cost of a sweep."""
    sentences = list(plan.words)
    percent = f"{100.0 * plan.tolerance:g} %"
    if plan.dropped:
        sentences.append(f"within {percent} one may leave out {' and '.join(plan.dropped)}")
    else:
        sentences.append(f"within {percent} nothing may be left out")
    engine, settings = plan.settings["engine"], plan.settings
    how, noise = "samples not known", ""
    if "accuracy" in settings:
        how = f"accuracy {settings['accuracy']:g}"
    elif "samples" in settings:
        how, noise = f"{settings['samples']} samples", f", and noise of {percent} in the median pose"
    sentences.append(f"plan: {engine}, {how}; error {plan.together.percent()}{noise}")
    cost = plan.predicted
    if "seconds" in cost:
        sentences.append(
            f"{cost['pictures']} pictures take about {clock(cost['seconds'])} and {cost['bytes'] / 1e6:.3g} MB"
        )
    if "seconds_full" in cost:
        gain = cost["seconds_full"] / max(cost["seconds"], 1e-9)
        sentences[-1] += (
            f"; with nothing left out, as exactly, {clock(cost['seconds_full'])}: {gain:.3g} times as long"
        )
    if plan.unmeasured:
        sentences.append(
            f"not measured, for the time was over: {', '.join(plan.unmeasured)}; more time (--time-limit) would tell"
        )
    return sentences
