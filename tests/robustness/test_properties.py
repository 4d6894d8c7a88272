"""A sample of the property sweep (docs/explanation/property-sweep.md): engines render what Cycles does or refuse."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from conftest import ROOT

sys.path.append(str(ROOT / "benchmarks"))
import properties

SAMPLE = (
    # By hand: one or more of each kind that once rendered another scene without a word.
    *(
        ("by hand", name, "")
        for name in (
            "target_keys_on_location",
            "target_nla_strip",
            "marker_bound_to_another_camera",
            "spot_power_keyed",
            "spot_tracks_target",
            "lamp_child_of_target",
            "texture_of_floor_follows_target",
            "texture_of_target_follows_target",
            "world_texture_follows_child_of_target",
            "cube_hidden_in_viewport",
            "target_array_in_renders_only",
            "target_is_viewport_node",
            "stamp_on_pictures",
            "compositor_doubles",
            "wall_material_set_by_geometry_nodes",
            "wall_second_output_for_cycles",
            "wall_invisible_to_diffuse",
            "absorbing_world",
            "wall_terminator_offset",
            "spot_emission_muted",
            "spot_output_for_eevee",
            "wall_link_muted",
            "target_mirror",
            "no_glossy_bounces",
            "point_lamp_in_an_instance",
            "world_of_emission",
            "target_faces_doubled",
            "target_sheared",
            "target_delta_location",
            "library_gone",
        )
    ),
    # Through bl_rna.
    ("object target", "scale", "[0.7, 1.0, 1.0]"),
    ("object target", "rotation_mode", '"ZYX"'),
    ("object target", "visible_shadow", "false"),
    ("object target", "hide_render", "true"),
    ("object wall", "visible_camera", "false"),
    ("object room", "is_holdout", "true"),
    ("object spot", "visible_diffuse", "false"),
    ("object camera", "hide_render", "true"),
    ("light spot", "energy", "300.0"),
    ("light spot", "color", "[1.0, 0.5, 0.2]"),
    ("light spot", "spot_blend", "0.3"),
    ("light spot", "use_shadow", "false"),
    ("light spot.cycles", "max_bounces", "0"),
    ("camera camera", "type", '"PANO"'),
    ("camera camera", "clip_end", "1.0"),
    ("camera camera.dof", "use_dof", "true"),
    ("mesh target", "use_auto_texspace", "false"),
    ("node wall diffuse [Roughness]", "default_value", "0.5"),
    ("node wall diffuse [Color]", "default_value", "[0.2, 0.4, 0.6, 1.0]"),
    ("node target output", "target", '"EEVEE"'),
    ("node spot emission [Strength]", "default_value", "2.0"),
    ("world bright.cycles_visibility", "diffuse", "false"),
    ("view layer", "use_solid", "false"),
    ("layer collection", "exclude", "true"),
    ("collection", "hide_render", "true"),
    ("slot room", "link", '"OBJECT"'),
    ("scene.render", "pixel_aspect_x", "2.0"),
    ("scene.render", "use_border", "true"),
    ("scene.cycles", "caustics_reflective", "false"),
    ("scene.cycles", "film_exposure", "2.0"),
    ("scene.cycles", "max_bounces", "1"),
    ("scene.cycles", "pixel_filter_type", '"GAUSSIAN"'),
    ("modifier target SOLIDIFY", "thickness", "0.05"),
)


QUICK = {
    *("spot_power_keyed", "texture_of_floor_follows_target", "cube_hidden_in_viewport"),
    *("compositor_doubles", "wall_second_output_for_cycles", "target_mirror", "library_gone"),
    *("scale", "visible_camera", "energy", "clip_end", "exclude", "film_exposure"),
}
"""Edits of each kind; the rest is for `make test-all`."""


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    """The base scene, rendered every way; that all agree there is asserted as it is made."""
    return properties.Judge(tmp_path_factory.mktemp("properties"))


@pytest.mark.parametrize(
    "edit",
    [pytest.param(e, id=f"{e[0]}-{e[1]}", marks=() if e[1] in QUICK else pytest.mark.slow) for e in SAMPLE],
)
def test_an_edit_is_followed_or_refused(judge, edit):
    row = judge.row(*edit)
    refused = all(getattr(row, engine) == "refused" for engine in properties.ENGINES)
    assert row.plain in ("changed", "unchanged", "fails") or (refused and not row.plain), row  # the edit was made
    for engine in properties.ENGINES:
        assert getattr(row, engine) in ("follows", "replaced", "refused"), (engine, row.reason)


def test_the_judge_sees_a_tenth_more_light(judge):
    """What it lets pass is no more than what docs/explanation/property-sweep.md says."""
    plain = judge.plain[1:]
    for factor, wrong in ((1.0, False), (1.1, True), (0.9, True)):
        brighter = [tuple(factor * np.asarray(p) for p in pair) for pair in judge.ours["patch"][1:]]
        assert bool(properties.differ(brighter, plain, properties.TOLERANCE["patch"])) == wrong


def test_the_judge_sees_a_difference_picture_of_half_the_light(judge):
    plain = judge.plain[1:]
    fainter = [(b + 0.5 * (p - b), b) for p, b in judge.ours["patch"][1:]]
    assert "difference" in properties.differ(fainter, plain, properties.TOLERANCE["patch"])


def test_a_setting_that_is_dropped_unsaid_is_wrong(judge, monkeypatch):
    """A product that knows nothing of a lamp's power renders the picture of before, and is found out."""
    base = judge.base
    true = properties.Product

    class Deaf(true):
        def __init__(self, file, engine):
            super().__init__(base, engine)

    monkeypatch.setattr(properties, "Product", Deaf)
    row = judge.row("light spot", "energy", "300.0")
    assert (row.path, row.patch, row.surfel) == ("wrong", "wrong", "wrong")
    assert "as without the edit" in row.reason["path"]
