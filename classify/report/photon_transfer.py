"""Figure of a camera's photon transfer, response and darkness."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from classify.pictures.photon_transfer import Measured
from generator.measure import figures


@figures.styled
def draw(measured: Measured) -> Figure:
    """Return the photon transfer curve, the deviation from linearity, the response, and darkness against time."""
    figure, axes = figures.subplots(2, 2, size=(figures.WIDTH, 6.2))
    _transfer(axes[0, 0], measured)
    known = bool(np.isfinite(measured.exposure).all())
    for axis, shown in zip(axes.flat[1:], (known, known, True), strict=True):
        axis.set_visible(shown)
    if known:
        _response(axes[0, 1], axes[1, 0], measured)
    _darkness(axes[1, 1], measured)
    return figure


def _transfer(axis: Axes, measured: Measured) -> None:
    zero, gain = measured.line
    variance = np.array([level.pixel for level in measured.light])
    used = np.array(measured.used)
    seen = measured.signal > 0.0
    axis.loglog(measured.signal[used], variance[used], "o", color=figures.BLUE, ms=4.5, label="used for the gain")
    rest = ~used & seen & (variance > 0.0)
    if rest.any():
        axis.loglog(
            measured.signal[rest], variance[rest], "o", mfc="none", color=figures.BLUE, ms=4.5, label="not used"
        )
    line = np.geomspace(measured.signal[seen].min(), measured.signal.max(), 100)
    axis.loglog(
        line, zero + gain * line, color=figures.VERMILION, lw=1.2, label=f"gain {gain:.4g} grey levels/electron"
    )
    axis.axhline(max(zero, 1e-3), color=figures.GREY, lw=1.0, ls=":", label="without light")
    axis.set_xlabel("signal, grey levels")
    axis.set_ylabel("temporal variance, grey levels squared")
    axis.set_title("Photon transfer")
    axis.legend(loc="best")


def _response(response: Axes, deviation: Axes, measured: Measured) -> None:
    linear = np.array(measured.linear)
    exposure, signal = measured.exposure, measured.signal
    slope, offset = (
        np.polyfit(exposure[linear], signal[linear], 1, w=1.0 / signal[linear]) if linear.sum() > 1 else (0, 0)
    )
    fitted = offset + slope * exposure
    response.plot(exposure, signal, "o", mfc="none", color=figures.BLUE, ms=4.5)
    response.plot(exposure[linear], signal[linear], "o", color=figures.BLUE, ms=4.5)
    ends = np.array([0.0, float(exposure.max())])
    response.plot(ends, offset + slope * ends, color=figures.VERMILION, lw=1.2)
    response.set_ylim(0.0, 1.15 * float(signal.max()))
    unit = (
        "exposure time, s"
        if np.isclose(exposure, [level.time for level in measured.light]).all()
        else "exposure, J/m²"
    )
    for axis in (response, deviation):
        axis.set_xlabel(unit)
    response.set_ylabel("signal, grey levels")
    response.set_title("Response")
    deviation.plot(
        exposure[linear], 100.0 * (signal / fitted - 1.0)[linear], "o-", color=figures.BLUE, ms=4.5, lw=1.0
    )
    deviation.axhline(0.0, color=figures.GREY, lw=1.0, ls=":")
    deviation.set_ylabel("off the line, %")
    deviation.set_title("Linearity, 5 to 95 % of saturation")


def _darkness(axis: Axes, measured: Measured) -> None:
    times = np.array([level.time for level in measured.dark])
    means = np.array([level.mean.mean() for level in measured.dark])
    known = np.isfinite(times)
    axis.set_title("Darkness")
    axis.set_ylabel("mean, grey levels")
    if not known.any():
        axis.plot(np.arange(len(means)), means, "o", color=figures.BLUE, ms=4.5)
        axis.set_xlabel("burst")
        return
    axis.plot(times[known], means[known], "o", color=figures.BLUE, ms=4.5)
    if "dark_current" in measured.intervals:
        ends = np.array([0.0, float(times[known].max())])
        rate = measured.intervals["dark_current"].value * measured.line[1]
        axis.plot(ends, measured.offset + rate * ends, color=figures.VERMILION, lw=1.2)
    axis.set_xlabel("exposure time, s")
