"""The figure of a camera: its texts fit, and it shows what is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cameras import Bench, Camera
from figure_texts import misplaced

from classify.pictures import photon_transfer
from classify.report.photon_transfer import draw
from generator.measure import figures


@pytest.mark.parametrize("timed", [True, False])
def test_curves_are_drawn_and_texts_fit(timed):
    bench = Bench(Camera(), np.random.default_rng(0), shape=(48, 48))
    light, dark = bench.light(4), bench.dark(4)
    if not timed:
        light, dark = ([replace(burst, time=np.nan) for burst in bursts] for bursts in (light, dark[:1]))
    measured = photon_transfer.measure(light, dark)
    figure = draw(measured)
    figures.fit(figure)
    assert misplaced(figure) == []
    transfer = figure.axes[0].lines[0]
    assert np.allclose(transfer.get_xdata(), measured.signal[np.array(measured.used)])
    shown = [axis.get_title() for axis in figure.axes if axis.get_visible()]
    assert ("Response" in shown) == timed
