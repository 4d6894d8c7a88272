#!/bin/sh
# The same material in Blender 5.2 and 5.3: a diffuse surface with a roughness reflects other light.
# Expected before it was run: a file of 5.2 renders alike in 5.3, as it did from 5.0 to 5.2, for the Diffuse BSDF has the
# same inputs.
# Seen: a plane of albedo 0.5 under a sun at 60 degrees, watched from 45 degrees, with roughness 0, 0.25, 0.5 and 1:
# 5.2.0 and 5.3.0 agree at 0; at 1, 5.3.0 is 2.3 percent brighter. Who compares pictures of two versions, or goes on with
# half a data set after an update, mixes two materials. Lambertian surfaces are not touched.
# Needs Python 3.13. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/render.py" <<'PYTHON'
import math
import sys

import bpy
import numpy as np

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.render.resolution_x = scene.render.resolution_y = 4
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 16, False, False
material = bpy.data.materials.new("Rough")
if material.node_tree is None:
    material.use_nodes = True
nodes = material.node_tree.nodes
nodes.clear()
diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
diffuse.inputs["Color"].default_value = (0.5, 0.5, 0.5, 1.0)
material.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
mesh = bpy.data.meshes.new("Plane")
mesh.from_pydata([(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [], [(0, 1, 2, 3)])
mesh.materials.append(material)
sun = bpy.data.lights.new("Sun", "SUN")
sun.energy, sun.angle = 1.0, 0.0
camera = bpy.data.cameras.new("Camera")
camera.type, camera.ortho_scale = "ORTHO", 0.1
for data, tilt in ((mesh, 0.0), (sun, 60.0), (camera, 45.0)):
    obj = bpy.data.objects.new("Object", data)
    obj.rotation_euler = (math.radians(tilt), 0.0, 0.0)
    obj.location = (0.0, -5.0 * math.sin(math.radians(tilt)), 5.0 * math.cos(math.radians(tilt)))
    scene.collection.objects.link(obj)
    if data is mesh:
        obj.location = (0.0, 0.0, 0.0)
    if data is camera:
        scene.camera = obj
image = scene.render.image_settings
if hasattr(image, "media_type"):
    image.media_type = "IMAGE"
image.file_format, image.color_depth = "OPEN_EXR", "32"
scene.render.use_file_extension = False
scene.render.filepath = sys.argv[-1]
values = []
for roughness in (0.0, 0.25, 0.5, 1.0):
    diffuse.inputs["Roughness"].default_value = roughness
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    values.append(float(np.array(picture.pixels[:]).reshape(-1, 4)[:, :3].mean()))
    bpy.data.images.remove(picture)
print("RESULT", bpy.app.version_string.split()[0], *(f"{value:.4f}" for value in values))
PYTHON
for version in 5.2.0 5.3.0; do
  python3.13 -m venv "$folder/$version"
  "$folder/$version/bin/pip" install --quiet "bpy==$version"
  "$folder/$version/bin/python" "$folder/render.py" -- "$folder/picture.exr" | grep RESULT
done | tee "$folder/seen"
printf 'RESULT 5.2.0 0.0796 0.0912 0.1013 0.1180\nRESULT 5.3.0 0.0796 0.0920 0.1028 0.1207\n' | diff - "$folder/seen"
