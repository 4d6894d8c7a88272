"""How sure a figure of many is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from generator.spec import Array

_RESAMPLES = 2000


def bootstrap(values: Array, what: Callable[..., Any] = np.mean) -> tuple[float, float, float]:
    """Return a figure of values (n,), and its 95 % percentile interval of a bootstrap (Efron 1979)."""
    drawn = np.random.default_rng(0).choice(values, size=(_RESAMPLES, len(values)))
    low, high = np.percentile(what(drawn, axis=1), [2.5, 97.5])
    return float(what(values)), float(low), float(high)
