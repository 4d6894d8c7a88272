#!/bin/sh
# Mitsuba's film adds up samples in float32: from some 100,000 samples of a pixel on, means are wrong by up to 0.3 %.
# Expected before it was run: more samples only reduce noise. A scene without any, a sky of radiance 0.1 and nothing
# else, shows 0.1 at 1,024 and at 262,144 samples per pixel.
# Seen (3.9.1, scalar_rgb, box filter, component_format float32): 1.0000, and 0.9975 of it. The log says nothing. A
# render of few samples a pixel, repeated with other seeds and averaged in float64, is right.
# Needs Python 3.11. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/render.py" <<'PYTHON'
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}, "component_format": "float32"}
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "path"},
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.1, 0.1]}},
    "sensor": {"type": "perspective", "film": film, "sampler": {"type": "independent"}},
})
for samples in (1 << 10, 1 << 18):
    picture = np.array(mi.render(scene, spp=samples), dtype=np.float64)
    print("RESULT", mi.__version__, samples, round(picture.mean() / 0.1, 4))
PYTHON
python3.11 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet "mitsuba==3.9.1" "numpy==2.3.1"
"$folder/env/bin/python" "$folder/render.py" | grep RESULT | tee "$folder/seen"
printf 'RESULT 3.9.1 1024 1.0\nRESULT 3.9.1 262144 0.9975\n' | diff - "$folder/seen"
