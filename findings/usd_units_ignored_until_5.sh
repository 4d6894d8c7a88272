#!/bin/sh
# A USD that says metersPerUnit = 0.01 and upAxis = "Y": Blender 4.2 turns it upright, but does not scale it.
# Expected before it was run: both importers honour both, so that a box of 30 x 20 x 50 centimetres is 0.3 x 0.2 x 0.5 m.
# Seen: 4.2.23 makes it 30 x 20 x 50 m, with no word and no option for it; 5.0.1 makes it 0.3 x 0.2 x 0.5 m.
# So a box from the same file is a hundred times as large in one as in the other.
# Needs Python 3.11. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/box.usda" <<'USD'
#usda 1.0
(
    defaultPrim = "Box"
    metersPerUnit = 0.01
    upAxis = "Y"
)

def Mesh "Box"
{
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
    point3f[] points = [(0, 0, 0), (30, 0, 0), (0, 50, 0), (30, 50, 0), (0, 0, 20), (30, 0, 20), (0, 50, 20), (30, 50, 20)]
}
USD
cat > "$folder/read.py" <<'PYTHON'
import sys

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=sys.argv[-1])
bpy.context.view_layer.update()
[box] = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
corners = [box.matrix_world @ vertex.co for vertex in box.data.vertices]
size = [max(c[i] for c in corners) - min(c[i] for c in corners) for i in range(3)]
option = any("unit" in name for name in bpy.ops.wm.usd_import.get_rna_type().properties.keys())
print("RESULT", bpy.app.version_string.split()[0], *(f"{edge:.3g}" for edge in size), "option" if option else "no option")
PYTHON
for version in 4.2.23 5.0.1; do
    python3.11 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install --quiet "bpy==$version" "numpy<2"
    "$folder/$version/bin/python" "$folder/read.py" -- "$folder/box.usda" | grep RESULT | tee -a "$folder/seen"
done
printf 'RESULT 4.2.23 30 20 50 no option\nRESULT 5.0.1 0.3 0.2 0.5 option\n' | diff - "$folder/seen"
