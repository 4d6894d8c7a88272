#!/bin/sh
# TIFF pictures whose zero is white, and pictures stored turned: what OpenCV 4.11 gives for them.
# Expected before it was run: with IMREAD_UNCHANGED, values as they are in the file, whatever its depth and orientation.
# Seen: of 8 bits, WhiteIsZero values come inverted, so that more is lighter; of 16 bits, as they are in the file, so that
# more is darker. Both come turned by the tag Orientation, although nothing was to be changed. So dark and bright change
# sides with the depth alone, and positions that were measured in the stored rows mean others.
# Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "numpy==1.26.4" "opencv-contrib-python-headless==4.11.0.86"
cat > "$folder/read.py" <<'PYTHON'
import struct

import cv2
import numpy as np


def tiff(pixels, photometric, orientation):
    height, width = pixels.shape
    tags = [(256, width), (257, height), (258, 8 * pixels.itemsize), (259, 1), (262, photometric), (273, 8)]
    tags += [(274, orientation), (277, 1), (278, height), (279, pixels.nbytes)]
    entries = b"".join(struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in tags)
    head = b"II*\0" + struct.pack("<I", 8 + pixels.nbytes) + pixels.tobytes()
    return head + struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0)


for kind in (np.uint8, np.uint16):
    pixels = np.array([[1, 2, 3], [4, 5, 6]], dtype=kind)
    for photometric, orientation in ((1, 1), (0, 1), (1, 3)):
        data = np.frombuffer(tiff(pixels, photometric, orientation), np.uint8)
        print(kind.__name__, photometric, orientation, cv2.imdecode(data, cv2.IMREAD_UNCHANGED).ravel().tolist())
PYTHON
"$folder/venv/bin/python" "$folder/read.py" | tee "$folder/seen"
diff - "$folder/seen" <<'SEEN'
uint8 1 1 [1, 2, 3, 4, 5, 6]
uint8 0 1 [254, 253, 252, 251, 250, 249]
uint8 1 3 [6, 5, 4, 3, 2, 1]
uint16 1 1 [1, 2, 3, 4, 5, 6]
uint16 0 1 [1, 2, 3, 4, 5, 6]
uint16 1 3 [6, 5, 4, 3, 2, 1]
SEEN
