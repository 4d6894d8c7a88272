"""Files of cameras: the same values whatever the format, and one sentence for what is none of a camera's."""

from __future__ import annotations

import math
import struct
import zlib

import cv2
import numpy as np
import pytest

from classify.pictures import frames
from generator.files import exr
from generator.model.errors import NlosError

GREY = (np.arange(12 * 10, dtype=np.uint16) * 371 % 4000).reshape(12, 10)
COLOUR = np.stack([GREY, GREY // 2, GREY // 3], axis=-1)


def chunk(name, body=b""):
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png(pixels, *more, bits=16, kind=0, size=None):
    """A PNG file, with more chunks."""
    height, width = pixels.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2" if bits == 16 else "u1").tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", *(size or (width, height)), bits, kind, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        [chunk(b"IHDR", head), *more, chunk(b"IDAT", zlib.compress(rows)), chunk(b"IEND")]
    )


def tiff(pixels, *, tags=(), order="<", photometric=1, cfa=False):
    """A TIFF file of one uncompressed strip; ``tags`` are (number, type, count, packed value)."""
    height, width = pixels.shape
    bits = 8 * pixels.itemsize
    numbers = [(256, width), (257, height), (258, bits), (259, 1), (262, photometric), (273, 8), (277, 1)]
    numbers += [(278, height), (279, pixels.nbytes)]
    entries = [
        (tag, 4, 1, struct.pack(f"{order}I", value)) for tag, value in numbers if tag not in (258, 259, 262, 277)
    ]
    entries += [
        (tag, 3, 1, struct.pack(f"{order}HH", value, 0)) for tag, value in numbers if tag in (258, 259, 262, 277)
    ]
    entries = sorted([*entries, *tags])
    body = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8 + pixels.nbytes)
    body += pixels.astype(pixels.dtype.newbyteorder(order)).tobytes() + struct.pack(f"{order}H", len(entries))
    start, extra = len(body) + 12 * len(entries) + 4, b""
    for tag, kind, count, value in entries:
        if len(value) > 4:
            extra, value = extra + value, struct.pack(f"{order}I", start + len(extra))
        body += struct.pack(f"{order}HHI", tag, kind, count) + value.ljust(4, b"\0")
    return body + struct.pack(f"{order}I", 0) + extra


def read(tmp_path, name, data):
    path = tmp_path / name
    path.write_bytes(data)
    return list(frames.read(path))


def test_the_same_values_from_every_format(tmp_path):
    np.save(tmp_path / "a.npy", GREY)
    cv2.imwrite(str(tmp_path / "a.tiff"), GREY)
    cv2.imwrite(str(tmp_path / "a.png"), GREY)
    (tmp_path / "b.tif").write_bytes(tiff(GREY, order=">"))
    for name in ("a.npy", "a.tiff", "a.png", "b.tif"):
        [frame] = frames.read(tmp_path / name)
        assert np.array_equal(frame.values[..., 0], GREY), name
        assert frame.white == 65535.0
    cv2.imwrite(str(tmp_path / "c.png"), COLOUR[..., ::-1])
    [frame] = frames.read(tmp_path / "c.png")
    assert np.array_equal(frame.values, COLOUR)
    exr.write(tmp_path / "d.exr", {f"View.Combined.{c}": GREY.astype(np.float32) for c in "RGBA"}, {})
    [frame] = frames.read(tmp_path / "d.exr")
    assert np.array_equal(frame.values[..., 1], GREY)
    assert frame.white == math.inf


def test_bursts_in_one_file(tmp_path):
    np.save(tmp_path / "a.npy", np.stack([GREY, GREY + 1]))
    cv2.imwritemulti(str(tmp_path / "a.tiff"), [GREY, GREY + 1])
    for name in ("a.npy", "a.tiff"):
        one, two = frames.read(tmp_path / name)
        assert np.array_equal(two.values, one.values + 1)
        assert one.name != two.name


def test_a_video(tmp_path):
    path, pixels = tmp_path / "a.avi", (COLOUR // 16).astype(np.uint8)
    big = np.kron(pixels, np.ones((8, 8, 1), dtype=np.uint8))
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 10.0, (80, 96))
    for _ in range(3):
        video.write(np.ascontiguousarray(big[..., ::-1]))
    video.release()
    seen = list(frames.read(path))
    assert len(seen) == 3
    assert seen[0].lossy
    assert np.abs(seen[0].values.astype(int) - big).max() <= 2


def test_a_raw_file(tmp_path):
    """A DNG of a Bayer mosaic: what it holds comes out, of red, green and blue pixels apart."""
    pytest.importorskip("rawpy")
    mosaic = np.zeros((48, 64), dtype=np.uint16)
    mosaic[0::2, 0::2], mosaic[0::2, 1::2], mosaic[1::2, 0::2], mosaic[1::2, 1::2] = 1000, 600, 620, 300
    tags = [
        (254, 4, 1, struct.pack("<I", 0)),
        (33421, 3, 2, struct.pack("<HH", 2, 2)),
        (33422, 1, 4, bytes([0, 1, 1, 2])),
        (50706, 1, 4, bytes([1, 4, 0, 0])),
        (50708, 2, 5, b"Test\0"),
        (50714, 3, 1, struct.pack("<HH", 64, 0)),
        (50717, 4, 1, struct.pack("<I", 4095)),
        (50721, 10, 9, struct.pack("<18i", *(v for k in range(9) for v in (int(k % 4 == 0), 1)))),
        (33434, 5, 1, struct.pack("<II", 1, 50)),
    ]
    [frame] = read(tmp_path, "a.dng", tiff(mosaic, tags=tags, photometric=32803))
    assert frame.values.shape == (24, 32, 3)
    assert np.allclose(frame.values[2:-2, 2:-2], [1000.0, 610.0, 300.0])
    assert (frame.black, frame.white, frame.exposure) == (64.0, 4095.0, 0.02)


def test_what_a_file_states_is_told(tmp_path):
    [plain] = read(tmp_path, "a.png", png(GREY))
    assert plain.gamma == ""
    assert read(tmp_path, "b.png", png(GREY, chunk(b"sRGB", b"\0")))[0].gamma == "srgb"
    assert read(tmp_path, "c.png", png(GREY, chunk(b"gAMA", struct.pack(">I", 45455))))[0].gamma == "2.2"
    assert read(tmp_path, "d.png", png(GREY, chunk(b"gAMA", struct.pack(">I", 100000))))[0].gamma == ""
    told = tiff(GREY, tags=[(33434, 5, 1, struct.pack("<II", 1, 200)), (34855, 3, 1, struct.pack("<HH", 400, 0))])
    assert read(tmp_path, "e.tif", told)[0].exposure == pytest.approx(0.02)
    assert read(tmp_path, "f.png", png(GREY, chunk(b"eXIf", told)))[0].exposure == pytest.approx(0.02)


TURNED = [(274, 3, 1, struct.pack("<HH", 3, 0))]
HOSTILE = {
    "claims gigapixels": ("a.png", png(GREY, size=(100_000, 100_000)), "claims 100000 x 100000 pixels"),
    "claims more than it holds": ("a.png", png(GREY, size=(10_000, 10_000)), "pixels in"),
    "no pixels": ("a.png", png(GREY, size=(0, 12)), "claims 0 x 12"),
    "a palette": ("a.png", png(GREY // 256, bits=8, kind=3), "has a palette"),
    "an animation": ("a.png", png(GREY, chunk(b"acTL", bytes(8))), "is an animation"),
    "half a PNG": ("a.png", png(GREY)[:-30], "is truncated or broken"),
    "no PNG": ("a.png", b"GIF89a", "does not start like a PNG file"),
    "white is zero": ("a.tif", tiff(GREY, photometric=0), "its zero is white"),
    "turned": ("a.tif", tiff(GREY, tags=TURNED), "is turned"),
    "half a TIFF": ("a.tif", tiff(GREY)[:100], "is truncated or broken"),
    "no TIFF": ("a.tif", b"II+\0" + bytes(20), "does not start like a TIFF file"),
    "a TIFF of 32-bit numbers": ("a.tif", tiff(GREY.astype(np.uint32)), "32 bits"),
    "a loop of directories": ("a.tif", b"II*\0\x08\0\0\0\0\0\x08\0\0\0", "does not tell its size"),
    "a pickle": ("a.npy", b"\x93NUMPY\x01\0v\0{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n", "broken"),
    "an array of a terabyte": (
        "a.npy",
        b"\x93NUMPY\x01\0v\0"
        + b"{'descr': '<u2', 'fortran_order': False, 'shape': (1000000, 500000), }".ljust(117)
        + b"\n",
        "a.npy",
    ),
    "half an EXR": ("a.exr", b"\x76\x2f\x31\x01" + bytes(20), "is not a whole EXR"),
    "no raw file": ("a.dng", tiff(GREY)[:60], "a.dng"),
    "no video": ("a.mp4", b"ftypmp42" * 4, "is no video"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_are_refused_in_a_sentence(case, tmp_path):
    name, data, words = HOSTILE[case]
    with pytest.raises(NlosError, match=words) as refused:
        read(tmp_path, name, data)
    assert "\n" not in str(refused.value)


def test_what_is_lossy_or_not_there_is_refused(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"")
    for path, words in ((tmp_path / "a.jpg", "compressed with loss"), (tmp_path / "no.png", "no such file")):
        with pytest.raises(NlosError, match=words):
            frames.expand([path])
    with pytest.raises(NlosError, match="must end in"):
        frames.expand([tmp_path / "a.txt"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(NlosError, match="holds no picture"):
        frames.expand([tmp_path / "empty"])


def test_files_of_a_folder_come_in_natural_order(tmp_path):
    for name in ("10.png", "9.png", "b/2.npy"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in frames.expand([tmp_path])] == ["9.png", "10.png", "2.npy"]
