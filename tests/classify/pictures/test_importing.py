"""How frames are treated, step by step, on frames made for each."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from classify.pictures import importing
from classify.pictures.importing import Geometry, Sources, Treatment
from generator.files.toml import to_dict
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.sets.description import Description

SHAPE, RESOLUTION = (48, 60), (5, 4)
SCENE = preset("room", "sphere")
PLACE = Geometry(x=SCENE.camera.x, z=SCENE.camera.z, resolution=RESOLUTION)
V, U = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
LIGHT = 1000.0 + 10.0 * U + 5.0 * V


def blocks(light):
    """Means over the pixels of a picture that shows exactly the rectangle."""
    columns, rows = RESOLUTION
    return light.reshape(rows, SHAPE[0] // rows, columns, SHAPE[1] // columns).mean(axis=(1, 3))


def save(folder, name, values):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.rint(values).astype(np.uint16))
    return path


def known(background=None):
    made = None if background is None else np.repeat(background[..., None], 3, axis=2).astype(np.float32)
    return Description(to_dict(SCENE), SCENE.reference_radiance, background=made)


def taken(tmp_path, sources, *, description=None, geometry=PLACE, **treatment):
    given = {"black": 0.0, "level": 1.0, **treatment}
    return importing.run(sources, Treatment(**given), geometry, description, tmp_path / "set")


def picture(made, number=0):
    return made.dataset.picture(made.dataset.records[number])[..., 0]


def test_black_flat_and_level(tmp_path):
    fall = 1.0 - 0.3 * (U / SHAPE[1]) ** 2
    shot = save(tmp_path, "a.png", 200.0 + LIGHT * fall)
    flat = save(tmp_path, "flat.png", 200.0 + 20_000.0 * fall)
    dark = save(tmp_path, "dark.png", np.full(SHAPE, 200.0))
    empty = save(tmp_path, "empty.png", 200.0 + 2.0 * LIGHT * fall)
    sources = Sources(pictures=[shot], background=[empty], dark=[dark], flat=[flat])
    wanted = 3e-6 * blocks(LIGHT)
    made = taken(tmp_path, sources, description=known(wanted), black=None, level=None)
    assert np.allclose(picture(made), 0.5 * wanted, rtol=1e-3)
    assert np.allclose(made.dataset.background()[..., 0], wanted, rtol=1e-3)
    table = made.dataset.meta["measured"]
    assert (table["black"], table["dark_frames"], table["flat_frames"]) == (200.0, 1, 1)
    assert table["mismatch"] < 1e-3


def test_colours_are_weighted(tmp_path):
    path = tmp_path / "a.png"
    colour = np.stack([LIGHT, 2.0 * LIGHT, 3.0 * LIGHT], axis=-1)
    assert cv2.imwrite(str(path), np.rint(colour[..., ::-1]).astype(np.uint16))
    made = taken(tmp_path, Sources(pictures=[path]), weights=(1.0, 2.0, 1.0))
    assert np.allclose(picture(made), 2.0 * blocks(LIGHT), rtol=1e-3)


def test_hot_pixels_are_left_out(tmp_path):
    rng = np.random.default_rng(0)
    dark, shot = rng.normal(100.0, 2.0, SHAPE), LIGHT + 100.0
    for values in (dark, shot):
        values[20, 30] += 30_000.0
    made = taken(
        tmp_path,
        Sources(pictures=[save(tmp_path, "a.png", shot)], dark=[save(tmp_path, "dark.png", dark)]),
        black=None,
    )
    assert made.dataset.meta["measured"]["hot_pixels"] == 1
    assert np.allclose(picture(made), blocks(LIGHT), rtol=2e-3)


def test_saturated_pixels_are_refused_or_left_out_everywhere(tmp_path):
    burnt = LIGHT.copy()
    burnt[10:12, 10:12] = 65535.0
    shots = [save(tmp_path, "a.png", LIGHT), save(tmp_path, "b.png", burnt)]
    with pytest.raises(NlosError, match=r"b\.png: 4 of its values on the patch are saturated"):
        taken(tmp_path, Sources(pictures=shots))
    made = taken(tmp_path, Sources(pictures=shots), saturated="mask")
    assert np.allclose(picture(made, 0), picture(made, 1))
    assert "4 saturated pixels" in made.notes[0]
    burnt[:20] = 65535.0
    with pytest.raises(NlosError, match="half of it must be left"):
        importing.run(
            Sources(pictures=[save(tmp_path, "c.png", burnt)]),
            Treatment(black=0.0, saturated="mask"),
            PLACE,
            None,
            tmp_path / "no",
        )


def test_clipping_below_the_largest_value_is_found(tmp_path):
    shot = save(tmp_path, "a.png", np.minimum(LIGHT + 2900.0, 4095.0))
    with pytest.raises(NlosError, match="are exactly 4095, as if the camera clipped there"):
        taken(tmp_path, Sources(pictures=[shot]))


def test_bursts_and_exposures(tmp_path):
    for k in range(4):
        save(tmp_path, f"shots/{k}.png", LIGHT * (1.0 if k < 2 else 2.0) + k % 2)
    (tmp_path / "labels.csv").write_text("file,label,exposure\n0.png,A,1\n1.png,A,1\n2.png,B,2\n3.png,B,2\n")
    sources = Sources(pictures=[tmp_path / "shots"], labels=tmp_path / "labels.csv")
    made = taken(tmp_path, sources, burst=2, description=known())
    assert [record.label for record in made.dataset.records] == ["A", "B"]
    assert np.allclose(picture(made, 1), picture(made, 0), rtol=1e-3)
    with pytest.raises(NlosError, match="1 are left over"):
        importing.run(sources, Treatment(black=0.0, burst=3), PLACE, known(), tmp_path / "no")
    (tmp_path / "labels.csv").write_text("file,label\n0.png,A\n1.png,B\n2.png,B\n3.png,B\n")
    with pytest.raises(NlosError, match="files with different labels"):
        importing.run(sources, Treatment(black=0.0, burst=2), PLACE, known(), tmp_path / "no")


def test_labels_are_the_names_of_folders(tmp_path):
    for name in ("A/1.png", "C/1.png"):
        save(tmp_path, f"shots/{name}", LIGHT)
    made = taken(tmp_path, Sources(pictures=[tmp_path / "shots"]), description=known())
    assert [(r.label, r.voxel, r.placed) for r in made.dataset.records] == [("A", 0, False), ("C", 2, False)]
    assert made.dataset.records[0].file == "A/00000.exr"


LABELS = {
    "a file that is none": ("file,label\na.png,A\nb.png,B\n", "names b.png, which is none of the pictures"),
    "a file too few": ("file,label\n", "has no row for"),
    "twice": ("file,label\na.png,A\na.png,B\n", "a second time"),
    "another column": ("file,voxel\na.png,A\n", "its columns must be"),
    "no such voxel": ("file,label\na.png,Q\n", "there is no such voxel"),
    "an exposure of nothing": ("file,exposure\na.png,0\n", "exposure '0' must be a positive number"),
}


@pytest.mark.parametrize("fault", LABELS)
def test_wrong_labels_are_told(fault, tmp_path):
    text, words = LABELS[fault]
    (tmp_path / "labels.csv").write_text(text)
    sources = Sources(pictures=[save(tmp_path, "a.png", LIGHT)], labels=tmp_path / "labels.csv")
    with pytest.raises(NlosError, match=words):
        taken(tmp_path, sources, description=known())
    assert not (tmp_path / "set").exists()


def test_a_stated_gamma_is_refused_or_undone(tmp_path):
    path = save(tmp_path, "a.png", 65535.0 * (LIGHT / 4000.0) ** (1.0 / 2.2))
    data = path.read_bytes()
    stated = data[:33] + bytes.fromhex("0000000467414d410000b18f0bfc6105") + data[33:]  # gAMA 45455
    path.write_bytes(stated)
    with pytest.raises(NlosError, match=r"went through a gamma \(2\.2\)"):
        taken(tmp_path, Sources(pictures=[path]))
    made = taken(tmp_path, Sources(pictures=[path]), gamma="2.2")
    assert np.allclose(picture(made) / 65535.0, blocks(LIGHT) / 4000.0, rtol=2e-3)


def test_noise_that_falls_with_light_is_that_of_a_gamma(tmp_path):
    """Photon noise through a gamma of 2.2 has a variance that falls with light; without, it is the camera's."""
    rng, steep = np.random.default_rng(0), 500.0 + 400.0 * U
    for k in range(12):
        electrons = rng.poisson(steep)
        save(tmp_path, f"linear/{k}.png", electrons / 0.8)
        save(tmp_path, f"bent/{k}.png", 65535.0 * (electrons / 30_000.0) ** (1.0 / 2.2))
    fine = Geometry(x=PLACE.x, z=PLACE.z, resolution=(20, 16))
    made = taken(tmp_path, Sources(pictures=[tmp_path / "linear"]), burst=12, geometry=fine)
    assert made.dataset.meta["sensor"]["exposure"] == pytest.approx(0.8 * 9, rel=0.1)
    with pytest.raises(NlosError, match="noise falls where there is more light"):
        importing.run(
            Sources(pictures=[tmp_path / "bent"]), Treatment(black=0.0, burst=12), fine, None, tmp_path / "no"
        )


@pytest.mark.parametrize(
    "wrong",
    [
        {"white": 0.0},
        {"electrons": -1.0},
        {"burst": 0},
        {"weights": (0.0, 0.0, 0.0)},
        {"gamma": "7"},
        {"black": math.nan},
        {"read_noise": -1.0},
    ],
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(NlosError):
        Treatment(**wrong)
