#!/bin/sh
# A scene in a folder with a project of Blender 5.3 that names an OpenColorIO configuration, and the same file elsewhere.
# Expected before it was run: a .blend renders the same radiance wherever it lies, if all that it refers to is packed.
# Seen: the folder .blender_project, in the scene's folder or in any above, is read with the scene, in background mode
# too; its configuration may lie anywhere, and decides on what textures reflect. With an sRGB space that is all but
# linear, a packed picture of grey 0.5 emits 0.50 in the project, and 0.22 elsewhere; the working space has the same name
# in both. Who renders a copy of the file on a farm, or keeps one beside the pictures, renders other light.
# Needs Python 3.13. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.13 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet bpy==5.3.0
mkdir -p "$folder/elsewhere" "$folder/project/.blender_project"
cat > "$folder/render.py" <<'PYTHON'
import pathlib
import shutil
import sys

import bpy

folder = pathlib.Path(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.render.resolution_x = scene.render.resolution_y = 4
scene.cycles.samples, scene.cycles.use_denoising = 1, False
image = bpy.data.images.new("Grey", 4, 4)
image.pixels = [0.5, 0.5, 0.5, 1.0] * 16
image.pack()
material = bpy.data.materials.new("Glow")
nodes, links = material.node_tree.nodes, material.node_tree.links
nodes.clear()
texture, glow, output = (nodes.new(f"ShaderNode{name}") for name in ("TexImage", "Emission", "OutputMaterial"))
texture.image = image
links.new(texture.outputs["Color"], glow.inputs["Color"])
links.new(glow.outputs[0], output.inputs["Surface"])
mesh = bpy.data.meshes.new("Plane")
mesh.from_pydata([(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [], [(0, 1, 2, 3)])
mesh.materials.append(material)
camera = bpy.data.cameras.new("Camera")
camera.type, camera.ortho_scale = "ORTHO", 0.1
for data in (mesh, camera):
    obj = bpy.data.objects.new("Object", data)
    scene.collection.objects.link(obj)
    obj.location.z = 5.0 if data is camera else 0.0
scene.camera = obj
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
scene.render.use_file_extension = False
scene.render.filepath = str(folder / "picture.exr")
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "elsewhere" / "a.blend"))
shutil.copy(folder / "elsewhere" / "a.blend", folder / "project" / "a.blend")
own = pathlib.Path(bpy.utils.system_resource("DATAFILES")) / "colormanagement"
shutil.copytree(own, folder / "ocio")
text = (folder / "ocio" / "config.ocio").read_text()
start = text.index("    name: sRGB\n")
before, after = text[:start], text[start:].replace("gamma: 2.4, offset: 0.055", "gamma: 1.0001, offset: 0.0001", 1)
(folder / "ocio" / "config.ocio").write_text(before + after)
settings = f'schema_version = 1\nname = "lab"\nocio_config = "{folder}/ocio/config.ocio"\n'
(folder / "project" / ".blender_project" / "project.toml").write_text(settings)
for place in ("elsewhere", "project"):
    bpy.ops.wm.open_mainfile(filepath=str(folder / place / "a.blend"))
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(str(folder / "picture.exr"))
    print("RESULT", place, bpy.data.colorspace.working_space, f"{picture.pixels[0]:.2f}")
PYTHON
"$folder/venv/bin/python" "$folder/render.py" "$folder" | grep RESULT | tee "$folder/seen"
printf 'RESULT elsewhere Linear Rec.709 0.22\nRESULT project Linear Rec.709 0.50\n' | diff - "$folder/seen"
