"""Our EXR files against the format's own library, both ways, and against every way to cut one short."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from generator.files import exr, limits
from generator.files.pictures import pixel_hash, read_picture, write_picture
from generator.model.errors import NlosError


def random_picture(height, width, seed=0):
    rng = np.random.default_rng(seed)
    picture = rng.normal(size=(height, width, 3)) * 10.0 ** rng.integers(-20, 20, size=(height, width, 1))
    return picture.astype(np.float32)


@pytest.mark.parametrize("shape", [(1, 1), (17, 3), (16, 64), (33, 20)])
def test_library_reads_what_we_write(tmp_path, shape):
    picture = random_picture(*shape)
    write_picture(tmp_path / "p.exr", picture, {"label": "A", "name": "Würfel"})
    with OpenEXR.File(str(tmp_path / "p.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, picture)
        assert file.header()["nlos:label"] == "A"
    pixels, header = read_picture(tmp_path / "p.exr")
    np.testing.assert_array_equal(pixels, picture)
    assert header == {"label": "A", "name": "Würfel", "pixel_hash": pixel_hash(picture)}


@pytest.mark.parametrize("compression", ["NO", "ZIPS", "ZIP", "PIZ", "RLE"])
@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_we_read_what_the_library_writes(tmp_path, compression, kind):
    picture = random_picture(33, 20).clip(-6e4, 6e4).astype(kind)
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": picture}).write(str(tmp_path / "p.exr"))
    np.testing.assert_array_equal(read_picture(tmp_path / "p.exr")[0], picture.astype(np.float32))


def test_one_channel_stands_for_three(tmp_path):
    picture = np.ascontiguousarray(random_picture(5, 4)[..., 0])
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": picture}).write(str(tmp_path / "p.exr"))
    np.testing.assert_array_equal(read_picture(tmp_path / "p.exr")[0], np.repeat(picture[..., None], 3, axis=2))


def test_every_truncation_is_refused(tmp_path):
    write_picture(tmp_path / "p.exr", random_picture(20, 6), {})
    data = (tmp_path / "p.exr").read_bytes()
    for size in range(len(data)):
        (tmp_path / "cut.exr").write_bytes(data[:size])
        with pytest.raises(NlosError, match=r"cut\.exr: is not a whole EXR picture"):
            read_picture(tmp_path / "cut.exr")


@given(st.integers(0, 10_000), st.integers(0, 255))
@example(434, 128)  # a block beyond what a C integer counts
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_changed_byte_gives_a_picture_or_a_sentence(tmp_path, where, value):
    write_picture(tmp_path / "p.exr", random_picture(20, 6), {"label": "A"})
    data = bytearray((tmp_path / "p.exr").read_bytes())
    data[where % len(data)] = value
    (tmp_path / "broken.exr").write_bytes(data)
    try:
        pixels, _ = read_picture(tmp_path / "broken.exr")
    except NlosError:
        return
    assert pixels.ndim == 3


def test_nan_is_never_written(tmp_path):
    picture = random_picture(4, 4)
    picture[1, 2, 0] = np.nan
    with pytest.raises(NlosError, match="NaN"):
        write_picture(tmp_path / "p.exr", picture, {})
    assert not list(tmp_path.iterdir())


def test_a_claim_of_too_many_pixels_is_refused(tmp_path, monkeypatch):
    write_picture(tmp_path / "p.exr", random_picture(4, 4), {})
    monkeypatch.setattr(exr, "MAX_PIXELS", 16)
    assert read_picture(tmp_path / "p.exr")[0].shape == (4, 4, 3)
    monkeypatch.setattr(exr, "MAX_PIXELS", 15)
    with pytest.raises(NlosError, match="it claims 4 x 4 pixels"):
        read_picture(tmp_path / "p.exr")


@pytest.mark.parametrize("kind", ["scanlines", "tiled", "parts", "channels", "packed"])
def test_what_a_header_claims_is_held_against_the_files_size(tmp_path, monkeypatch, kind):
    """By limits so low that sound files of the format's own library, or of ours, exceed them."""
    path = tmp_path / "p.exr"
    zeros = np.zeros((64, 64), np.float32)
    if kind == "tiled":
        header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
        header["tiles"].xSize = header["tiles"].ySize = 32
        OpenEXR.File(header, {"RGB": np.repeat(zeros[..., None], 3, axis=2)}).write(str(path))
    elif kind == "parts":
        picture = np.repeat(zeros[..., None], 3, axis=2)
        headers = [{"type": OpenEXR.scanlineimage, "name": name} for name in ("one", "two")]
        OpenEXR.File([OpenEXR.Part(header, {"RGB": picture}) for header in headers]).write(str(path))
    elif kind == "packed":
        header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": np.repeat(zeros[..., None], 3, axis=2)}).write(str(path))
    else:
        exr.write(path, dict.fromkeys("RGB" if kind == "scanlines" else "RGBCDEFG", zeros), {})
    read_picture(path)
    monkeypatch.setattr(limits, "MUCH", 2**10)
    monkeypatch.setattr(limits, "MOST", 2)
    with pytest.raises(NlosError, match="it claims 64 x 64 pixels in"):
        read_picture(path)


def test_pictures_of_many_values_a_pixel_are_none(tmp_path):
    """The flag alone counts: the library, too, refuses this file, for the rest of it is no deep picture."""
    write_picture(tmp_path / "p.exr", random_picture(4, 4), {})
    data = bytearray((tmp_path / "p.exr").read_bytes())
    data[5] |= 0x08
    (tmp_path / "p.exr").write_bytes(data)
    with pytest.raises(NlosError, match="it is deep"):
        read_picture(tmp_path / "p.exr")


def library_file(path, channels, **header):
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels).write(str(path))
    return path


def window(x0, y0, x1, y1):
    return np.array([x0, y0], np.int32), np.array([x1, y1], np.int32)


GREY = np.ascontiguousarray(random_picture(4, 4)[..., 0])


@pytest.mark.parametrize("compression", ["ZIP", "PIZ"])
@pytest.mark.parametrize("display", [window(0, 0, 9, 9), window(2, 1, 5, 5), window(3, 1, 4, 4)])
def test_a_picture_that_is_not_all_of_its_window_is_refused(tmp_path, display, compression):
    """Cropped, or with more around it: its pixels are not those of the watched rectangle."""
    header = {"dataWindow": window(2, 1, 5, 4), "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    path = library_file(tmp_path / "p.exr", {"RGB": random_picture(4, 4)}, **header, displayWindow=display)
    with pytest.raises(
        NlosError, match=r"it is cropped: its pixels are those of x 2 to 5, y 1 to 4, and the picture"
    ):
        read_picture(path)


def test_a_picture_may_begin_anywhere(tmp_path):
    place = {"dataWindow": window(2, 1, 5, 4), "displayWindow": window(2, 1, 5, 4)}
    picture = random_picture(4, 4)
    path = library_file(tmp_path / "p.exr", {"RGB": picture}, **place)
    np.testing.assert_array_equal(read_picture(path)[0], picture)


@pytest.mark.parametrize(
    "names", [["Z"], ["A"], ["R"], ["depth.Z"], ["U", "V2"], ["A", "Z"], ["RY", "BY", "Y"], ["Y", "V"]]
)
def test_what_is_no_radiance_is_refused_by_name(tmp_path, names):
    path = library_file(tmp_path / "p.exr", dict.fromkeys(names, GREY))
    with pytest.raises(NlosError, match="is no picture of radiance") as caught:
        read_picture(path)
    assert all(name in str(caught.value) for name in names)


@pytest.mark.parametrize("names", [["Y"], ["V"], ["Y", "A"], ["Y", "Z", "A"]])
def test_grey_by_its_two_names_with_or_without_what_is_beside_it(tmp_path, names):
    """Y is OpenEXR's, V Blender's."""
    planes = {name: GREY + np.float32(number) for number, name in enumerate(names)}
    picture, _ = read_picture(library_file(tmp_path / "p.exr", planes))
    np.testing.assert_array_equal(picture, np.repeat(GREY[..., None], 3, axis=2))


@pytest.mark.parametrize("compression", ["ZIP", "PIZ"])
def test_whole_numbers_are_no_radiance(tmp_path, compression):
    planes = dict.fromkeys("RGB", np.arange(16, dtype=np.uint32).reshape(4, 4))
    compressed = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    with pytest.raises(NlosError, match="its channel B holds whole numbers"):
        read_picture(library_file(tmp_path / "p.exr", planes, **compressed))


@pytest.mark.parametrize("compression", ["ZIP", "PIZ"])
@pytest.mark.parametrize(
    ("primaries", "name"),
    [
        ((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329), None),
        ((0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329), "Rec.2020"),
        ((0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767), "ACEScg"),
        ((0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767), "primaries 0.7347"),
    ],
)
def test_the_space_of_the_channels_is_read_from_their_primaries(tmp_path, primaries, name, compression):
    header = {"chromaticities": primaries, "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    found = read_picture(library_file(tmp_path / "p.exr", {"RGB": random_picture(4, 4)}, **header))[1]
    assert found.get("colour_space", "").startswith(name or "")
    assert ("colour_space" in found) == (name is not None)


def test_other_software_reads_the_space_of_ours(tmp_path):
    """By the attribute that Blender 5 writes too."""
    write_picture(tmp_path / "p.exr", random_picture(4, 4), {"colour_space": "ACEScg"})
    with OpenEXR.File(str(tmp_path / "p.exr")) as file:
        assert file.header()["colorInteropID"] == "lin_ap1_scene"
    assert read_picture(tmp_path / "p.exr")[1]["colour_space"] == "ACEScg"
