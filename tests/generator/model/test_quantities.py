"""Quantities as text."""

import pytest

from generator.model.quantities import radiance


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (4.369e-4, 3, "437 µW/m²/sr"),
        (-1.2e-3, 2, "-1.2 mW/m²/sr"),
        (2e-5, 1, "20 µW/m²/sr"),
        (9.996e-4, 3, "1 mW/m²/sr"),
        (1.5, 3, "1.5 W/m²/sr"),
        (3e-14, 1, "0.03 pW/m²/sr"),
        (0.0, 3, "0 W/m²/sr"),
    ],
)
def test_a_radiance_has_the_prefix_that_reads_best(value, digits, text):
    assert radiance(value, digits) == text
