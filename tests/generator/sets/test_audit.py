"""What a set says of itself is true, or named: where it is, by `verify`, and by all that would use the set."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from classify_helpers import make_bulk, make_dataset, plain_atlas

from classify.cli import main as classify_cli
from classify.inference import atlas_build, atlas_file
from classify.pictures import feature_table
from classify.pictures.settings import FeatureSettings
from generator.cli import main as cli
from generator.cli.rendered import report
from generator.files.pictures import read_picture, write_picture
from generator.files.toml import dump_toml, merge, read_toml
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.sets import audit, bulk_part, bulk_set, seal, simulated
from generator.sets.dataset import Dataset
from generator.sets.manifest import BACKGROUND, MANIFEST, POSES, SCENE


@pytest.fixture
def path(tmp_path, tiny_dataset):
    return shutil.copytree(tiny_dataset, tmp_path / "set")


@pytest.fixture(scope="module")
def any_atlas(tmp_path_factory):
    """An atlas that can be opened; sets are refused before it is looked at."""
    path = tmp_path_factory.mktemp("atlas") / "a.atlas"
    grid = preset("room").grid
    middles = [np.mean(grid.bounds(voxel), axis=0) for voxel in range(9)]
    atlas_file.save(path, plain_atlas(np.eye(9), middles, np.arange(9), grid))
    return path


def verified(path, capsys):
    """What the command says, line by line, and its exit code."""
    capsys.readouterr()
    code = cli.main(["verify", str(path)])
    told = capsys.readouterr()
    return (told.out + told.err).splitlines(), code


def rows_of(path):
    with (path / POSES).open(newline="") as file:
        return list(csv.reader(file))


def cell(path, row, column, value):
    """Change a cell of poses.csv; row 1 is the first pose."""
    rows = rows_of(path)
    rows[row][rows[0].index(column)] = value
    write_rows(path, rows)


def write_rows(path, rows):
    with (path / POSES).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def field(path, change):
    """Change fields of dataset.toml, and nothing of the seal."""
    (path / MANIFEST).write_text(dump_toml(merge(read_toml(path / MANIFEST), change)))


def swapped(path, first, second):
    a, b = (path / first).read_bytes(), (path / second).read_bytes()
    (path / first).write_bytes(b)
    (path / second).write_bytes(a)


def brighter(path, name):
    """Brighten a picture, and leave its header as an editor would that keeps what it does not know."""
    pixels, header = read_picture(path / name)
    write_picture(path / name, pixels * np.float32(2.0), header)


def edited(path, name):
    """Change pixels below the header that vouches for them."""
    pixels, header = read_picture(path / name)
    from generator.files import exr

    planes = {c: pixels[..., i] * np.float32(2.0) for i, c in enumerate("RGB")}
    exr.write(path / name, planes, {f"nlos:{key}": value for key, value in header.items()})


def swap_rows(path):
    rows = rows_of(path)
    rows[2], rows[3] = rows[3], rows[2]
    write_rows(path, rows)


def lose_row(path):
    write_rows(path, rows_of(path)[:-1])


def note_in_the_margin(path):
    write_rows(path, [[*row, "note"] for row in rows_of(path)])


def another_size(path):
    _, header = read_picture(path / BACKGROUND)
    write_picture(path / BACKGROUND, np.ones((4, 4, 3), np.float32), header)


CASES = {
    # as the issue has them
    "x by a metre": (lambda p: cell(p, 5, "x", repr(float(rows_of(p)[5][3]) + 1.0)), POSES, "line 6"),
    "background overwritten": (lambda p: shutil.copy(p / "E/0000.exr", p / BACKGROUND), BACKGROUND, "of voxel E"),
    "power": (lambda p: field(p, {"scene": {"spot": {"power": 7.0}}}), MANIFEST, "scene.spot.power"),
    "seed": (lambda p: field(p, {"sweep": {"seed": 7}}), MANIFEST, "sweep.seed"),
    "foreign file": (lambda p: (p / "notes.txt").write_text("x"), "notes.txt", "is no file of this set"),
    "label": (lambda p: cell(p, 2, "label", "C"), POSES, "line 3: label is C in place of B"),
    # more of the kind
    "scene": (lambda p: (p / SCENE).write_bytes(b"BLENDER" + bytes(99)), SCENE, "not the scene that this set"),
    "no scene": (lambda p: (p / SCENE).unlink(), SCENE, "the scene is missing"),
    "rotation": (lambda p: cell(p, 4, "rz", "1.25"), POSES, "line 5"),
    "pose seed": (lambda p: cell(p, 4, "seed", "5"), POSES, "line 5: seed is 5"),
    "voxel": (lambda p: cell(p, 4, "voxel", "0"), POSES, "line 5: voxel is 0 in place of 3"),
    "file": (lambda p: cell(p, 4, "file", "A/0000.exr"), POSES, "line 5: file is A/0000.exr"),
    "rows swapped": (swap_rows, POSES, "line 3"),
    "row lost": (lose_row, POSES, "holds 8 poses where the sweep has 9"),
    "column": (note_in_the_margin, POSES, "line 2"),
    "foreign picture": (lambda p: shutil.copy(p / "A/0000.exr", p / "A/0001.exr"), "A/0001.exr", "is no file"),
    "foreign folder": (lambda p: (p / "J").mkdir(), "J", "is no file of this set"),
    "second background": (
        lambda p: shutil.copy(p / BACKGROUND, p / "background-ambient.exr"),
        "background-ambient.exr",
        "is no file of this set",
    ),
    "background edited": (lambda p: edited(p, BACKGROUND), BACKGROUND, "pixels were changed"),
    "background of another size": (another_size, BACKGROUND, "has 4 x 4 pixels, not 8 x 8"),
    "reference": (lambda p: field(p, {"reference_radiance": 2.0}), MANIFEST, "reference_radiance"),
    "grid": (lambda p: field(p, {"scene": {"grid": {"hi": [2.4, 1.9, 2.2]}}}), MANIFEST, "scene.grid.hi"),
    "older": (lambda p: field(p, {"format": 1}), MANIFEST, "format"),
    "another field": (lambda p: field(p, {"remark": "good"}), MANIFEST, "remark"),
    "seal": (lambda p: field(p, {"seal": {"scene": "0" * 64}}), MANIFEST, "seal"),
}


@pytest.mark.parametrize("name", CASES)
def test_each_change_is_named_where_it_is_and_refused(name, path, tmp_path, scene_file, any_atlas, capsys):
    change, file, words = CASES[name]
    change(path)
    lines, code = verified(path, capsys)
    assert code in (1, 2)
    found = [line for line in lines if f"{path / file}" in line]
    assert any(words in line for line in found), lines
    # The good is not blamed: whatever else is told follows from the same change of the same file.
    others = [line for line in lines if str(path / file) not in line and not line.startswith(f"{path}: ")]
    assert not others, lines
    before = {p: p.read_bytes() for p in path.rglob("*") if p.is_file()}
    for run in (
        lambda: classify_cli.main(["features", str(path), "-o", str(tmp_path / "f.h5")]),
        lambda: classify_cli.main(["locate", str(any_atlas), str(path)]),
        lambda: cli.main(["sweep", str(scene_file), "-o", str(path)]),
        lambda: cli.main(["sweep", str(path / SCENE), "-o", str(path)]),
    ):
        assert run() == 2
        told = capsys.readouterr().err
        assert str(path / file) in told, told
        assert told.count("\n") == 1
    assert not (tmp_path / "f.h5").exists()
    assert {p: p.read_bytes() for p in path.rglob("*") if p.is_file()} == before, "nothing was touched"


PICTURES = {
    "of another pose": (lambda p: shutil.copy(p / "D/0000.exr", p / "E/0000.exr"), "is a picture of label D, not E"),
    "the background": (lambda p: shutil.copy(p / BACKGROUND, p / "E/0000.exr"), "is the background background.exr"),
    "edited": (lambda p: edited(p, "E/0000.exr"), "its pixels were changed"),
    "from elsewhere": (
        lambda p: write_picture(p / "E/0000.exr", np.ones((8, 8, 3), np.float32), {}),
        "is a picture of sweep None",
    ),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_of_something_else_is_named_and_not_overwritten(name, path, tmp_path, scene_file, capsys):
    """Somebody put it there; only what is missing or torn is rendered again."""
    change, words = PICTURES[name]
    change(path)
    lines, code = verified(path, capsys)
    assert code == 1
    assert any(str(path / "E/0000.exr") in line and words in line for line in lines), lines
    assert len(lines) == 2, lines
    before = (path / "E/0000.exr").read_bytes()
    for run in (
        lambda: classify_cli.main(["features", str(path), "-o", str(tmp_path / "f.h5")]),
        lambda: cli.main(["sweep", str(scene_file), "-o", str(path)]),
    ):
        assert run() == 2
        assert "E/0000.exr" in capsys.readouterr().err
    assert (path / "E/0000.exr").read_bytes() == before


def test_two_pictures_swapped_with_their_hashes_are_told_by_their_headers(path, capsys):
    swapped(path, "D/0000.exr", "E/0000.exr")
    rows = rows_of(path)
    rows[4][11:], rows[5][11:] = rows[5][11:], rows[4][11:]
    write_rows(path, rows)
    lines, _ = verified(path, capsys)
    assert [line.partition(": ")[0] for line in lines[:-1]] == [str(path / f"{v}/0000.exr") for v in "DE"]


@pytest.mark.parametrize("column", ["pixel_hash", "seconds", "samples"])
def test_what_rendering_added_is_the_manifests_own_fault(path, column, capsys):
    cell(path, 3, column, "77")
    lines, code = verified(path, capsys)
    assert code == 1
    assert lines[0].startswith(f"{path / POSES}, line 4: ")
    assert len(lines) == 2


def other(value):
    """Another value of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return value + "x"
    if isinstance(value, list):
        return [other(value[0]), *value[1:]] if value else ["x"]
    return {**value, "x": 1}


def leaves(table, where=()):
    for name, value in table.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, (*where, name))
        else:
            yield (*where, name)


@pytest.mark.parametrize("how", ["changed", "taken out"])
def test_every_field_of_the_manifest_is_held(path, how, capsys):
    whole = read_toml(path / MANIFEST)
    every = list(leaves(whole))
    assert len(every) > 40
    for where in every:
        meta = json.loads(json.dumps(whole))
        table = meta
        for name in where[:-1]:
            table = table[name]
        if how == "changed":
            table[where[-1]] = other(table[where[-1]])
        else:
            del table[where[-1]]
        (path / MANIFEST).write_text(dump_toml(meta))
        with pytest.raises(NlosError):
            Dataset.open(path)
        lines, code = verified(path, capsys)
        assert code in (1, 2), where
        assert str(path) in lines[0], lines
        assert MANIFEST in lines[0] or where == ("format",), lines


def test_a_sound_set_and_its_copy_have_no_fault(path, capsys):
    """Runs' own files, and those that file managers leave, are no foreign ones."""
    (path / ".DS_Store").touch()
    (path / "A" / "Thumbs.db").touch()
    assert verified(path, capsys) == ([f"{path}: 9 poses, 0 faults"], 0)
    (path / MANIFEST).write_text("# a remark\n" + (path / MANIFEST).read_text())
    assert not Dataset.open(path).verify(), "what is said counts, not how"


def unsealed(path):
    """Make a set what an older version wrote."""
    meta = read_toml(path / MANIFEST)
    meta = {name: value for name, value in meta.items() if name not in ("seal", "colour_space")}
    (path / MANIFEST).write_text(dump_toml({**meta, "format": 1}))
    for file in (BACKGROUND, *(f"{v}/0000.exr" for v in "ABCDEFGHI")):
        pixels, header = read_picture(path / file)
        write_picture(
            path / file, pixels, {k: v for k, v in header.items() if k not in ("background", "colour_space")}
        )


def test_older_sets_open_and_are_checked_as_far_as_they_tell(path, scene_file, capsys):
    unsealed(path)
    lines, code = verified(path, capsys)
    assert code == 0
    assert lines[0].startswith("note: ")
    assert "kept no hashes of scene and plan" in lines[0]
    assert Dataset.open(path).colour_space == "Rec.709"
    assert cli.main(["sweep", str(scene_file), "-o", str(path)]) == 0
    capsys.readouterr()
    for change, file in (
        (lambda p: cell(p, 5, "x", "3.0"), POSES),
        (lambda p: cell(p, 2, "label", "C"), POSES),
        (lambda p: cell(p, 2, "seed", "3"), POSES),
        (lambda p: field(p, {"sweep": {"seed": 7}}), MANIFEST),
        (lambda p: shutil.copy(p / "E/0000.exr", p / BACKGROUND), BACKGROUND),
        (lambda p: shutil.copy(p / BACKGROUND, p / "E/0000.exr"), "E/0000.exr"),
    ):
        spoilt = shutil.copytree(path, path.with_name("spoilt"))
        change(spoilt)
        lines, code = verified(spoilt, capsys)
        assert code == 1
        told = [line for line in lines[:-1] if not line.startswith("note: ")]
        assert told
        assert all(str(spoilt / file) in line for line in told), lines
        shutil.rmtree(spoilt)


# Pictures that show nothing, or the same


def alike_set(path, *, engine="patch"):
    """A set whose pictures in voxel A are the background, and two of voxel C each other."""
    made = make_dataset(path, n=3, engine=engine)
    background = made.background()
    same = made.picture(made.poses[2])
    for pose in made.poses:
        if pose.label == "A" and pose.index < 2:
            made.write_pose(pose, background, seconds=0.1, samples=1)
        if pose.label == "C" and pose.index == 2:
            made.write_pose(pose, same, seconds=0.1, samples=1)
    made.gather()
    return made


def test_pictures_of_nothing_are_a_fault_with_count_and_voxel(tmp_path, capsys):
    made = alike_set(tmp_path / "set")
    faults = audit.alike(made)
    assert len(faults) == 2
    assert faults[0].startswith(
        f"{made.path / 'A/0000.exr'}: equals the background to the bit, as 2 of 3 pictures of voxel A"
    )
    assert "no path met it in 512 samples" in faults[0]
    assert faults[1] == f"{made.path / 'C/0000.exr'}: equals C/0002.exr to the bit, though the poses differ"
    assert set(faults) <= set(made.verify())
    assert report(made, 1, 0, []).code == 0
    told = capsys.readouterr()
    assert told.err == f"warning: {faults[0]} (nlos-generate verify lists 2 such faults)\n"
    assert "in full shadow or hidden" in audit.alike(alike_set(tmp_path / "surfel", engine="surfel"))[0]


@pytest.mark.parametrize(("engine", "count"), [("surfel", 1), ("patch", 2)])
def test_the_same_pose_twice_may_look_the_same_without_noise(tmp_path, engine, count):
    """Noise differs from pose to pose."""
    made = alike_set(tmp_path / "set", engine=engine)
    at = {pose.file: pose for pose in made.poses}
    twin = replace(at["C/0002.exr"], position=at["C/0000.exr"].position, rotation=at["C/0000.exr"].rotation)
    made.poses = [twin if pose.file == twin.file else pose for pose in made.poses]
    assert len(audit.alike(made)) == count


def test_a_sweep_says_so_at_its_end(tmp_path, scene_file, command):
    """One ray a pixel, of which none meets the object in some picture."""
    some = ("--engine", "patch", "--poses", "2", "--samples", "1", "--resolution", "4", "--workers", "1")
    result = command("generator", "sweep", scene_file, "-o", tmp_path / "s", *some)
    assert result.returncode == 0, result.stderr
    assert "equals the background to the bit" in result.stderr
    assert "no path met it in 1 samples a pixel" in result.stderr


def test_fewer_pixels_than_blender_renders_are_refused(tmp_path, scene_file, command):
    """Its least is 4 a side: 2 x 2 was planned, and 4 x 4 rendered."""
    some = ("--poses", "1", "--resolution", "2", "--workers", "1")
    result = command("generator", "sweep", scene_file, "-o", tmp_path / "s", *some, "--engine", "patch")
    assert result.returncode == 2
    assert "resolution: 2 x 2 is less than Blender renders, 4 pixels a side" in result.stderr
    assert not (tmp_path / "s").exists()
    result = command("generator", "sweep", scene_file, "-o", tmp_path / "s", *some, "--engine", "surfel")
    assert result.returncode == 0, result.stderr
    assert Dataset.open(tmp_path / "s").background().shape == (2, 2, 3)


# Simulated sets


@pytest.fixture(scope="module")
def simulated_set(tmp_path_factory):
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", pictures=40, resolution=(8, 8)).path


def attribute(path, name, value, file="part"):
    target = next(path.glob("part-*.h5")) if file == "part" else path / file
    with h5py.File(target, "r+") as opened:
        opened.attrs[name] = value


def pixel(path):
    with h5py.File(next(path.glob("part-*.h5")), "r+") as opened:
        opened["pictures"][3, 2, 1] *= 2.0


def moved(path):
    with h5py.File(next(path.glob("part-*.h5")), "r+") as opened:
        opened["position"][3, 0] += 1.0


def bulk_field(path, change):
    (path / bulk_set.MANIFEST).write_text(dump_toml(merge(read_toml(path / bulk_set.MANIFEST), change)))


BULK = {
    "seed": (lambda p: bulk_field(p, {"sweep": {"seed": 9}}), "bulk.toml"),
    "accuracy": (lambda p: bulk_field(p, {"sweep": {"accuracy": 0.1}}), "bulk.toml"),
    "power": (lambda p: bulk_field(p, {"scene": {"spot": {"power": 9.0}}}), "bulk.toml"),
    "software": (lambda p: bulk_field(p, {"software": {"blender": "9"}}), "bulk.toml"),
    "background": (
        lambda p: write_picture(p / BACKGROUND, np.ones((8, 8, 3), np.float32), read_picture(p / BACKGROUND)[1]),
        BACKGROUND,
    ),
    "world": (lambda p: (p / "world.npz").unlink(), "world.npz"),
    "foreign": (lambda p: (p / "part-00000000-000000.h5").touch(), "part-00000000-000000.h5"),
    "pixel": (pixel, "part-"),
    "position": (moved, "part-"),
}


@pytest.mark.parametrize("name", BULK)
def test_simulated_sets_make_the_same_claims(name, simulated_set, tmp_path, any_atlas, capsys):
    path = shutil.copytree(simulated_set, tmp_path / "set")
    change, file = BULK[name]
    change(path)
    lines, code = verified(path, capsys)
    assert code in (1, 2)
    assert file in lines[0], lines
    for run in (
        lambda: classify_cli.main(["features", str(path), "-o", str(tmp_path / "f.h5")]),
        lambda: classify_cli.main(["locate", str(any_atlas), str(path)]),
        lambda: classify_cli.main(["atlas", str(path), "-o", str(tmp_path / "a.atlas")]),
    ):
        assert run() == 2
        assert file in capsys.readouterr().err


@pytest.mark.parametrize("what", ["radiance", "label", "grid", "order"])
def test_the_file_that_shows_all_parts_is_compared_and_made_anew(what, simulated_set, tmp_path, capsys):
    path = shutil.copytree(simulated_set, tmp_path / "set")
    with h5py.File(path / "set.h5", "r+") as file:
        if what == "radiance":
            file.attrs["reference_radiance"] = 2.0
        elif what == "grid":
            file.attrs["grid_hi"] = (2.0, 2.0, 2.0)
        elif what == "label":
            file["label"][0] = "B"
        else:
            file["voxel"].attrs["about"] = "nothing"
    lines, code = verified(path, capsys)
    assert (code, "set.h5: missing, broken or changed" in lines[0]) == (1, True)
    bulk_set.Bulk.open(path).finish()
    assert verified(path, capsys)[1] == 0


def test_parts_are_read_once_and_again_after_a_change(simulated_set, tmp_path, monkeypatch):
    """A million pictures are not read whole whenever a set is opened."""
    path = shutil.copytree(simulated_set, tmp_path / "set")
    looked = []
    fault = bulk_part.Part.fault
    monkeypatch.setattr(
        bulk_part.Part, "fault", lambda self, *more: looked.append(self._number) or fault(self, *more)
    )
    found = simulated.open_set(path)
    assert looked == list(range(bulk_set.Bulk.open(path).parts))
    looked.clear()
    again = simulated.open_set(path)
    assert looked == []
    np.testing.assert_array_equal(found.picture(found.records[5]), again.picture(again.records[5]))
    for reader in (found, again):
        reader._bulk.close()
    pixel(path)
    with pytest.raises(NlosError, match="contents differ from their hash"):
        simulated.open_set(path)


def test_simulated_pictures_of_nothing_are_a_fault(tmp_path):
    """A black ball before a bare wall that it takes no light from changes nothing; the same picture twice is told."""
    made = make_bulk(tmp_path / "set", pictures=8, resolution=(8, 8))
    background = made.background
    look = bulk_part.Alike(made.layout, made.background)
    pictures = np.array([made.pictures[i] for i in range(8)])
    pictures[3] = background[..., 0]
    pictures[6] = pictures[5]
    look.look(np.arange(8), pictures)
    first, second = look.faults()
    assert "picture 3 equals the background to the bit, as 1 of 2 pictures of voxel D do" in first
    assert "picture 6 equals picture 5 to the bit" in second


# What the three channels mean


def test_sets_of_different_spaces_are_not_mixed(tmp_path, capsys):
    """Rec.709 and ACEScg: features, models, pictures and atlases."""
    plain, wide = make_dataset(tmp_path / "plain", n=3), make_dataset(tmp_path / "wide", n=3, colour_space="ACEScg")
    assert (plain.colour_space, wide.colour_space) == ("Rec.709", "ACEScg")
    assert not [fault for fault in wide.verify() if "the scene is missing" not in fault]
    one, two = (feature_table.extract(made, FeatureSettings()) for made in (plain, wide))
    with pytest.raises(NlosError, match=r"linear Rec\.709, and those of b linear ACEScg"):
        feature_table.check_comparable(one, two, ("a", "b"))
    for name, features in (("a.h5", one), ("b.h5", two)):
        feature_table.write(tmp_path / name, features)
    assert (
        classify_cli.main(["compare", *(str(tmp_path / f) for f in ("a.h5", "b.h5")), "-o", str(tmp_path / "r")]) == 2
    )
    assert "mean other light" in capsys.readouterr().err
    model, picture = tmp_path / "m.skops", wide.path / wide.poses[0].file
    assert classify_cli.main(["train", str(tmp_path / "b.h5"), "-o", str(model), "--classifier", "LDA"]) == 0
    assert classify_cli.main(["predict", str(model), str(picture)]) == 0
    capsys.readouterr()
    assert classify_cli.main(["predict", str(model), str(plain.path / plain.poses[0].file)]) == 2
    assert "linear Rec.709, and those of" in capsys.readouterr().err
    field(plain.path, {"colour_space": "ACEScg"})
    with pytest.raises(NlosError, match="colour_space was changed"):
        Dataset.open(plain.path)


def test_an_atlas_is_of_one_space(tmp_path):
    from classify.inference import evaluation
    from classify.pictures.sensor import Sensor

    simulated_set = make_bulk(tmp_path / "bulk", pictures=60, resolution=(12, 12))
    atlas = atlas_build.build(simulated_set, Sensor(full_well=300.0, bits=10))
    assert atlas.colour_space == "Rec.709"
    atlas_file.save(tmp_path / "a", atlas)
    assert atlas_file.load(tmp_path / "a").colour_space == "Rec.709"
    wide = make_dataset(tmp_path / "wide", n=1, grid=simulated_set.grid, colour_space="Rec.2020")
    with pytest.raises(NlosError, match=r"linear Rec\.2020, and those of the atlas linear Rec\.709"):
        evaluation.run(atlas, wide)


def test_a_blend_files_working_space_is_recorded(tmp_path, scene_file):
    """Blender 5 renders in the working space of the file: a red world in ACEScg has other numbers, and says so."""
    import bpy

    from generator.blender import sweep_worker
    from generator.blender.scene import blend_file

    if not hasattr(bpy.data, "colorspace"):
        pytest.skip(f"Blender {bpy.app.version_string} knows one working space")
    scene = blend_file.open_file(scene_file)
    assert sweep_worker.colour_space() == "Rec.709"
    bpy.ops.wm.set_working_color_space(working_space="ACEScg", convert_colors=True)
    wide = tmp_path / "wide.blend"
    blend_file.save_file(wide)
    scene = blend_file.open_file(wide)
    made = sweep_worker.plan(
        scene, wide, tmp_path / "set", {"poses": 1, "samples": 1, "resolution": [4, 4]}, probe=False
    )
    assert made.colour_space == "ACEScg"
    sweep_worker.render(scene, made, [])
    _, header = read_picture(made.path / BACKGROUND)
    assert header["colour_space"] == "ACEScg"
    blend_file.open_file(scene_file)
    assert sweep_worker.colour_space() == "Rec.709"


# The seal itself


def test_a_seal_names_what_was_changed():
    meta = {"a": 1, "b": {"c": [1.0, 2.0], "d": {}}, "e": "x"}
    whole = seal.sealed(meta, poses="12")
    assert seal.broken(whole) == ""
    assert seal.broken(meta) == ""
    assert seal.sealed(whole, poses="12") == whole
    for change, words in (
        ({"a": 2}, "a was changed"),
        ({"a": 1.0}, "a was changed"),
        ({"b": {"c": [1.0, 2.5]}}, "b.c was changed"),
        ({"b": {"d": {"x": 1}}}, "b.d.x was changed"),
        ({"new": 1}, "new was changed"),
        ({"seal": {"poses": "13"}}, "'seal' was changed"),
        ({"seal": {"more": "13"}}, "'seal' was changed"),
    ):
        assert words in seal.broken(merge(json.loads(json.dumps(whole)), change))
    del whole["e"]
    assert "a field was taken out" in seal.broken(whole)
