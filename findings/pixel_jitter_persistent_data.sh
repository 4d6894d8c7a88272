#!/bin/sh
# Cycles' pixel jitter, new in Blender 5.2, with persistent data: a picture depends on what was rendered before it.
# Expected before it was run: the same scene, samples and seed give the same pixels, with persistent data or without.
# Seen: 5.2.0 gives the same pixels again without jitter, and with jitter where each render starts afresh; with both, a
# first picture and the same one after another differ. The option is off by default, and shown with debug options only,
# but a file keeps it, so that a batch of pictures is not what each would be alone.
# Needs Python 3.13. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/render.py" <<'PYTHON'
import sys

import bpy
import numpy as np

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.render.resolution_x = scene.render.resolution_y = 8
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 64, False, False
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
camera.location = (0.0, 0.0, 3.0)
lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
lamp.location = (0.5, 0.2, 1.0)
mesh = bpy.data.meshes.new("Plane")
mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
plane = bpy.data.objects.new("Plane", mesh)
for obj in (camera, lamp, plane):
    scene.collection.objects.link(obj)
scene.camera = camera
image = scene.render.image_settings
if hasattr(image, "media_type"):
    image.media_type = "IMAGE"
image.file_format, image.color_depth = "OPEN_EXR", "32"
scene.render.use_file_extension = False
scene.render.filepath = sys.argv[-1]


def shot(power):
    lamp.data.energy = power
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(picture.pixels[:])
    bpy.data.images.remove(picture)
    return pixels


found = []
for jitter in (False, True):
    scene.cycles.use_pixel_jitter = jitter
    for persistent in (False, True):
        scene.render.use_persistent_data = False  # forgets what was kept
        scene.render.use_persistent_data = persistent
        first = shot(10.0)
        shot(20.0)
        found.append("same" if np.array_equal(first, shot(10.0)) else "another")
print("RESULT", bpy.app.version_string, *found)
PYTHON
python3.13 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "bpy==5.2.0"
"$folder/venv/bin/python" "$folder/render.py" -- "$folder/picture.exr" | grep RESULT | tee "$folder/seen"
printf 'RESULT 5.2.0 LTS same same same another\n' | diff - "$folder/seen"
