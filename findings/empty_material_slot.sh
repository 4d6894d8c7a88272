#!/bin/sh
# An object's own material slot that is empty: Cycles took the mesh's material up to Blender 5.0, and takes its own since.
# Expected before it was run: black in both, for Python says that the object's slot holds no material; or, as the
# evaluated object says, the mesh's glowing material in both.
# Seen: 5.0.1 renders the mesh's material (0.25), 5.2.0 Cycles' own, which does not glow (0.0), while Python shows the
# same in both: no material on the object, the mesh's on the evaluated object. So a render engine that reads the
# evaluated object's slots is right in one and wrong in the other.
# Needs Python 3.11 and 3.13. Exit code 0 if that is still so.
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
plane = bpy.data.objects.new("Plane", mesh)
for obj in (camera, plane):
    scene.collection.objects.link(obj)
scene.camera = camera
image = scene.render.image_settings
if hasattr(image, "media_type"):
    image.media_type = "IMAGE"
image.file_format, image.color_depth = "OPEN_EXR", "32"
scene.render.use_file_extension = False
material = bpy.data.materials.new("Glowing")
if material.node_tree is None:
    material.use_nodes = True
tree = material.node_tree
tree.nodes.clear()
emission = tree.nodes.new("ShaderNodeEmission")
output = tree.nodes.new("ShaderNodeOutputMaterial")
emission.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
emission.inputs["Strength"].default_value = 0.25
tree.links.new(emission.outputs[0], output.inputs["Surface"])
mesh.materials.append(material)
plane.material_slots[0].link = "OBJECT"  # whose own slot stays empty
scene.render.filepath = sys.argv[-1]
bpy.ops.render.render(write_still=True)
picture = bpy.data.images.load(sys.argv[-1])
evaluated = plane.evaluated_get(bpy.context.evaluated_depsgraph_get())
told = [getattr(obj.material_slots[0].material, "name", None) for obj in (plane, evaluated)]
print("RESULT", bpy.app.version_string, round(picture.pixels[0], 4), *told)
PYTHON
for pair in 3.11:5.0.1 3.13:5.2.0; do
    version=${pair#*:}
    "python${pair%:*}" -m venv "$folder/$version"
    "$folder/$version/bin/pip" install --quiet "bpy==$version"
    "$folder/$version/bin/python" "$folder/render.py" -- "$folder/picture.exr" | grep RESULT | tee -a "$folder/seen"
done
printf 'RESULT 5.0.1 0.25 None Glowing\nRESULT 5.2.0 LTS 0.0 None Glowing\n' | diff - "$folder/seen"
