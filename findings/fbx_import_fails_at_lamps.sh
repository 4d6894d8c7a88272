#!/bin/sh
# Blender 5.0's importer of FBX that is written in Python cannot read a lamp that its own exporter wrote.
# Expected before it was run: import_scene.fbx reads what export_scene.fbx writes, as it did in 4.2.
# Seen: 4.2.23 reads the cube and the lamp; 5.0.1 raises an AttributeError, for lamps have no "cast_shadow" in Cycles'
# settings any more. wm.fbx_import, which is new, reads both.
# Needs Python 3.11. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/read.py" <<'PYTHON'
import sys

import bpy


def kinds(read):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        read(filepath=sys.argv[-1])
    except Exception as error:
        return "cast_shadow" if "cast_shadow" in str(error) else type(error).__name__
    return "+".join(sorted(obj.type for obj in bpy.context.scene.objects))


bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_cube_add()
bpy.ops.object.light_add(type="POINT")
bpy.ops.export_scene.fbx(filepath=sys.argv[-1])
words = [kinds(bpy.ops.import_scene.fbx)]
try:
    bpy.ops.wm.fbx_import.get_rna_type()
    words.append(kinds(bpy.ops.wm.fbx_import))
except KeyError:
    words.append("none")
print("RESULT", bpy.app.version_string.split()[0], *words)
PYTHON
for version in 4.2.23 5.0.1; do
    python3.11 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install --quiet "bpy==$version" "numpy<2"
    "$folder/$version/bin/python" "$folder/read.py" -- "$folder/cube.fbx" | grep RESULT | tee -a "$folder/seen"
done
printf 'RESULT 4.2.23 LIGHT+MESH none\nRESULT 5.0.1 cast_shadow LIGHT+MESH\n' | diff - "$folder/seen"
