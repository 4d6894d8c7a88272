#!/bin/sh
# A point lamp's "Soft Falloff", on by default, dims what is near: by D^2 / (D^2 + r^2), not only inside the lamp.
# Expected before it was run: as its tooltip says (it avoids sharp edges where the lamp meets other objects), no difference
# outside the lamp's ball; with it and without, the irradiance at the distance D from the middle is I / D^2.
# Seen (5.0.1): below a lamp of radius 0.5 m, at 1 m, a diffuse surface is as bright as I / D^2 says without soft falloff,
# and 0.8 of that with it: 1 / (1 + 0.25). A lamp near a ceiling lights it less than its power says.
# Needs Python 3.11. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/render.py" <<'PYTHON'
import math
import sys

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.render.resolution_x = scene.render.resolution_y = 1
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = 1 << 14, False, 0
scene.cycles.use_adaptive_sampling = False
scene.view_settings.view_transform = "Raw"
image = scene.render.image_settings
if hasattr(image, "media_type"):
    image.media_type = "IMAGE"
image.file_format, image.color_depth = "OPEN_EXR", "32"
scene.render.use_file_extension = False
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 0.01, (0.0, 0.0, 3.0)
lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
lamp.location, lamp.data.energy, lamp.data.shadow_soft_size = (0.0, 0.0, 1.0), 4.0 * math.pi, 0.5
mesh = bpy.data.meshes.new("Plane")
mesh.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
plane = bpy.data.objects.new("Plane", mesh)
material = bpy.data.materials.new("White")
if material.node_tree is None:
    material.use_nodes = True
tree = material.node_tree
tree.nodes.clear()
shader, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
tree.links.new(shader.outputs[0], output.inputs["Surface"])
mesh.materials.append(material)
for obj in (camera, lamp, plane):
    scene.collection.objects.link(obj)
scene.camera = camera
scene.render.filepath = sys.argv[-1]
for soft in (False, True):
    lamp.data.use_soft_falloff = soft
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(sys.argv[-1])
    # I = 1 W/sr at 1 m: the radiance of a white surface is 1 / pi.
    print("RESULT", bpy.app.version_string, "soft" if soft else "hard", round(math.pi * picture.pixels[0], 2))
    bpy.data.images.remove(picture)
PYTHON
python3.11 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet "bpy==5.0.1"
"$folder/env/bin/python" "$folder/render.py" -- "$folder/picture.exr" | grep RESULT | tee "$folder/seen"
printf 'RESULT 5.0.1 hard 1.0\nRESULT 5.0.1 soft 0.8\n' | diff - "$folder/seen"
