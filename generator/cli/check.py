"""The verb ``check``: what is wrong with a scene, before anything is rendered."""

from __future__ import annotations

import argparse

from generator.cli.options import chosen_settings


def run_check(options: argparse.Namespace) -> int:
    from generator.blender import check
    from generator.blender.scene import blend_file

    chosen = chosen_settings(options)
    found = check.check_scene(blend_file.open_file(options.scene), chosen)
    for finding in found:
        print(f"{finding.level}: {finding.text}")
    return 1 if check.hopeless(found) else 0
