#!/bin/sh
# A muted material output, and a muted node with nothing linked into it, mean other light in Cycles from Blender 5.0 on.
# Expected before it was run: a muted output gives no light in any version; the muted node passes on its own value.
# Seen: 4.2.0 renders 0 for both. 5.0.1 renders the emission of the muted output (0.25), and takes the muted node for
# unlinked, so that the strength is the shader's own (0.25). A file that somebody lit in one is another in the other.
# Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/render.py" <<'PYTHON'
import sys

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.render.resolution_x = scene.render.resolution_y = 1
scene.cycles.samples, scene.cycles.use_denoising = 1, False
scene.view_settings.view_transform = "Raw"
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
camera.location = (0.0, 0.0, 1.0)
mesh = bpy.data.meshes.new("Plane")
mesh.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
for obj in (camera, bpy.data.objects.new("Plane", mesh)):
    scene.collection.objects.link(obj)
scene.camera = camera
image = scene.render.image_settings
if hasattr(image, "media_type"):
    image.media_type = "IMAGE"
image.file_format, image.color_depth = "OPEN_EXR", "32"
scene.render.use_file_extension = False
found = []
for case in ("output", "number"):
    material = bpy.data.materials.new(case)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    emission.inputs["Strength"].default_value = 0.25
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    if case == "output":
        output.mute = True
    else:
        number = tree.nodes.new("ShaderNodeMath")  # its own inputs are 0.5
        tree.links.new(number.outputs[0], emission.inputs["Strength"])
        number.mute = True
    mesh.materials.clear()
    mesh.materials.append(material)
    scene.render.filepath = sys.argv[-1]
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(sys.argv[-1])
    found.append(round(picture.pixels[0], 4))
    bpy.data.images.remove(picture)
print("RESULT", bpy.app.version_string, *found)
PYTHON
for version in 4.2.0 5.0.1; do
    python3.11 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install --quiet "bpy==$version" "numpy<2"
    "$folder/$version/bin/python" "$folder/render.py" -- "$folder/picture.exr" | grep RESULT | tee -a "$folder/seen"
done
printf 'RESULT 4.2.0 0.0 0.0\nRESULT 5.0.1 0.25 0.25\n' | diff - "$folder/seen"
