"""The table of albedos is the one in the documentation, and says where each is from."""

from __future__ import annotations

from conftest import ROOT

from generator.model.albedos import ALBEDOS, TYPICAL, named


def rows():
    """The table as the page has it."""
    for albedo in ALBEDOS:
        value = ", ".join(f"{v:g}" for v in dict.fromkeys(albedo.value))
        span = f"{albedo.range[0]:g} to {albedo.range[1]:g}" if albedo.range else ""
        yield f"| {albedo.name} | {value} | {span} | {albedo.source} |"


def test_the_page_has_the_same_table():
    page = (ROOT / "docs" / "reference" / "albedos.md").read_text(encoding="utf-8")
    table = [line for line in page.splitlines() if line.startswith("| ") and not line.startswith("| surface")]
    assert table == list(rows())


def test_albedos_are_shares_in_the_middle_of_their_range():
    assert len({albedo.name for albedo in ALBEDOS}) == len(ALBEDOS)
    for albedo in ALBEDOS:
        assert all(0.0 < value < 1.0 for value in albedo.value)
        assert named(albedo.name) == albedo
        if albedo.range:
            low, high = albedo.range
            assert all(low < value < high for value in albedo.value)
            assert abs(2.0 * albedo.value[0] - low - high) < 1e-6
        assert albedo.range or albedo.source != TYPICAL, "what has no source has a range"
