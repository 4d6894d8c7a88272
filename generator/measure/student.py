"""Student's t without SciPy, which Blender lacks."""

from __future__ import annotations

_TABLE = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)


def quantile(freedom: int) -> float:
    """Return the 97.5 % quantile of Student's t (1908) for a number of degrees of freedom, 1 or more.

    Beyond the table's ten, the first terms of the expansion about the normal quantile (Fisher 1925).
    """
    if freedom <= len(_TABLE):
        return _TABLE[freedom - 1]
    z = 1.959964
    return z + (z**3 + z) / (4.0 * freedom) + (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * freedom**2)
