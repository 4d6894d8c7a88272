"""Pictures of a simulated camera, imported and answered."""

from __future__ import annotations

import json
import shutil
import threading
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import wall_camera
import worlds
from classify_helpers import make_bulk

from classify.inference import atlas_build, atlas_file
from classify.inference.posterior import holds, locate
from classify.pictures.sensor import Sensor
from classify.pictures.taken import Taken
from generator.sets.simulated import open_set

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
CORNERS = np.array([(31.3, 22.1), (170.2, 30.4), (176.8, 158.3), (22.5, 149.7)])
PICTURES = 24
CAMERAS = {
    "16 bits": {"top": 65535, "electrons": 0.5, "black": 512.0},
    "8 bits": {"top": 255, "electrons": 12.0, "black": 9.0},
}


deep = pytest.mark.parametrize("shots", ["16 bits"], indirect=True)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A simulated set and its atlas, and other pictures of the same scene."""
    folder = tmp_path_factory.mktemp("lab")
    bulk = make_bulk(folder / "bulk", pictures=1600, room=(FLOOR,), radius=0.15)
    seen = make_bulk(folder / "seen", pictures=PICTURES, room=(FLOOR,), radius=0.15, seed=3)
    atlas = atlas_build.build(bulk, Sensor(full_well=2e5, bits=0, read_noise=20.0))
    atlas_file.save(folder / "lab.atlas", atlas)
    return SimpleNamespace(folder=folder, bulk=bulk, seen=seen, atlas=atlas)


def camera_of(lab, kind):
    brightest = lab.seen.pictures[:].max()
    camera = wall_camera.Camera(CORNERS, **CAMERAS[kind])
    camera.exposure = 0.8 * min(4000.0, (camera.top - camera.black) * camera.electrons) / brightest
    return camera


@pytest.fixture(scope="module", params=list(CAMERAS))
def shots(request, lab):
    """Frames of all pictures, of the empty scene, of the dark and of an even wall."""
    camera, rng = camera_of(lab, request.param), np.random.default_rng(1)
    folder = lab.folder / request.param.replace(" ", "")
    empty = lab.bulk.background[..., 0].astype(float)
    camera.take(folder / "empty", camera.light(empty), rng, 16)
    camera.take(folder / "dark", np.zeros(camera.shape), rng, 16)
    camera.take(folder / "flat", camera.light(np.full_like(empty, empty.max())), rng, 16)
    lines = ["file,x,y,z"]
    for k, picture in enumerate(lab.seen.pictures[:]):
        [path] = camera.take(folder / "one", camera.light(picture.astype(float)), rng)
        (folder / "shots").mkdir(exist_ok=True)
        path.rename(folder / "shots" / f"{k}.png")
        lines.append(f"{k}.png,{','.join(map(str, lab.seen.positions[k]))}")
    (folder / "labels.csv").write_text("\n".join(lines))
    return SimpleNamespace(folder=folder, camera=camera)


def arguments(lab, shots, *more):
    folder = shots.folder
    given = [folder / "shots", "--background", folder / "empty", "--dark", folder / "dark", "--flat", folder / "flat"]
    return ["import", *given, "--like", lab.bulk.path, "--corners", *CORNERS.ravel().tolist(), *more]


@pytest.fixture(scope="module")
def imported(lab, shots, command):
    path = shots.folder / "set"
    stated = ["--electrons", shots.camera.electrons, "--read-noise", shots.camera.read_noise]
    more = ["--labels", shots.folder / "labels.csv", *stated, "-o", path]
    done = command("classify", *arguments(lab, shots, *more))
    assert done.returncode == 0, done.stderr
    return open_set(path)


def test_a_round_trip_errs_by_no_more_than_the_noise(lab, imported):
    sensor = Sensor(**imported.meta["sensor"])
    spread = np.sqrt(sensor.variance(imported.background()))
    errors = [imported.picture(r)[..., 0] - lab.seen.pictures[k] for k, r in enumerate(imported.records)]
    assert 0.9 < (np.array(errors) / spread).std() < 1.3
    # What is left when noise is averaged away: the flat field's own noise and pixels that two pixels share.
    assert (np.mean(errors, axis=0) / spread).std() < 0.6


def test_answers_are_those_to_the_clean_pictures(lab, imported):
    taken = Taken(imported, lab.atlas.background)
    atlas = lab.atlas.seen_by(taken.sensor)
    inside = apart = 0
    for k, record in enumerate(imported.records):
        place = locate(atlas, atlas.code(taken.picture(record), taken.background()))
        clean = np.repeat(lab.seen.pictures[k][..., None], 3, axis=2)
        wanted = locate(atlas, atlas.code(clean, lab.bulk.background))
        inside += holds(place, record.position)
        offset = place.position - wanted.position
        apart += offset @ np.linalg.pinv(place.covariance + wanted.covariance) @ offset < 7.81
    assert inside >= 0.75 * PICTURES
    assert apart >= 0.9 * PICTURES


def test_the_noise_follows_from_frames_of_the_empty_scene(lab, shots, command, tmp_path):
    done = command("classify", *arguments(lab, shots, "-o", tmp_path / "set", "--json"))
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    stated = [note for note in answer["notes"] if "electrons a unit" in note]
    electrons = float(stated[0].split("that of ")[1].split()[0])
    assert electrons == pytest.approx(shots.camera.electrons, rel=0.12)
    assert answer["labelled"] == 0
    assert answer["mismatch"] < 0.01


@deep
def test_a_set_without_truth_is_answered(lab, imported, command, tmp_path):
    path = tmp_path / "set"
    shutil.copytree(imported.path, path)
    rows = (path / "poses.csv").read_text().splitlines()
    (path / "poses.csv").write_text("\n".join(["file", *(row.split(",")[0] for row in rows[1:])]))
    refused = command("classify", "locate", lab.folder / "lab.atlas", path)
    assert refused.returncode == 2
    assert "was changed after the set was written" in refused.stderr
    manifest = (path / "dataset.toml").read_text()
    (path / "dataset.toml").write_text(manifest.partition("[seal]")[0])
    done = command("classify", "locate", lab.folder / "lab.atlas", path, "-o", tmp_path / "answers", "--json")
    assert done.returncode == 0, done.stdout
    answer = json.loads(done.stdout)
    assert answer["accuracy"] is None
    assert all(one["truth"] is None and one["true_position"] is None for one in answer["answers"])
    right = [
        one["label"] == lab.seen.grid.labels[v] for one, v in zip(answer["answers"], lab.seen.voxels, strict=True)
    ]
    assert np.mean(right) > 0.9
    assert (tmp_path / "answers" / "answers.csv").read_text().count("\n") == 1 + PICTURES


@pytest.mark.slow
@deep
def test_pictures_are_tracked(lab, imported, command, tmp_path):
    filled = make_bulk(tmp_path / "filled", pictures=1200, room=(FLOOR,), inside="centre", seed=1)
    atlas_file.save(tmp_path / "filled.atlas", atlas_build.build(filled, Sensor(full_well=2e5, bits=0)))
    done = command("classify", "track", tmp_path / "filled.atlas", imported.path, "-o", tmp_path / "track")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("presence") == PICTURES
    assert (tmp_path / "track" / "track.csv").read_text().count("\n") == 1 + PICTURES


@deep
def test_truth_is_counted_where_it_is_known(lab, imported, command):
    done = command("classify", "locate", lab.folder / "lab.atlas", imported.path)
    assert done.returncode == 0, done.stdout
    assert "right voxel in 100.0 %" in done.stdout


@pytest.mark.slow
@deep
def test_features_and_predict_take_it(lab, imported, command, tmp_path):
    sensor = tmp_path / "sensor.toml"
    sensor.write_text("full_well = 200000.0\nbits = 0\nread_noise = 20.0\n")
    table, model = tmp_path / "learnt.h5", tmp_path / "learnt.skops"
    learnt = ["features", lab.bulk.path, "-o", table, "--features", "global", "--sensor", sensor]
    assert command("classify", *learnt).returncode == 0
    assert command("classify", "train", table, "-o", model, "--classifier", "LDA").returncode == 0
    done = command("classify", "predict", model, imported.path, "--json")
    labels = [answer["label"] for answer in json.loads(done.stdout)["answers"]]
    assert np.mean([a == r.label for a, r in zip(labels, imported.records, strict=True)]) > 0.8
    assert command("classify", "features", imported.path, "-o", tmp_path / "own.h5").returncode == 0
    refused = command("classify", "features", imported.path, "-o", tmp_path / "no.h5", "--sensor", "default")
    assert "have noise of their own" in refused.stderr


@deep
def test_a_set_is_verified(imported, command, tmp_path):
    assert "0 faults" in command("generator", "verify", imported.path).stdout
    path = tmp_path / "set"
    shutil.copytree(imported.path, path)
    record = imported.records[0]
    shutil.copy(path / imported.records[1].file, path / record.file)
    (path / "more.txt").write_text("")
    done = command("generator", "verify", path)
    assert done.returncode == 1
    assert "its pixels were changed" in done.stdout
    assert "more.txt: is no file of this set" in done.stdout


@deep
def test_pictures_are_answered_as_they_come(lab, imported, shots, command, tmp_path):
    folder = tmp_path / "camera"
    folder.mkdir()
    files = sorted((shots.folder / "shots").glob("*.png"), key=lambda p: int(p.stem))

    def take():
        for k, file in enumerate(files[:6]):
            data = file.read_bytes()
            with (folder / f"{k}.png").open("wb") as half:  # seen while it is being written
                half.write(data[:1000])
                half.flush()
                time.sleep(0.03)
                half.write(data[1000:])

    (folder / "0_broken.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    writer = threading.Thread(target=take)
    writer.start()
    watch = ["locate", lab.folder / "lab.atlas", imported.path, "--watch", folder, "--patience", "1"]
    done = command("classify", *watch)
    writer.join()
    assert done.returncode == 0, done.stderr
    told = [line.split(": ") for line in done.stdout.splitlines()[:6]]
    assert [name for name, _ in told] == [f"{k}.png" for k in range(6)]
    assert all(words.startswith(f"in {r.label} ") for (_, words), r in zip(told, imported.records, strict=False))
    assert "0_broken.png: does not start like a PNG file" in done.stderr


@deep
def test_another_scene_is_doubted(lab, imported, command, tmp_path):
    floor = worlds.quad((-2.0, 0.0, -0.6), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    other = make_bulk(tmp_path / "other", pictures=400, room=(floor,), radius=0.15)
    atlas_file.save(tmp_path / "other.atlas", atlas_build.build(other, Sensor(full_well=2e5, bits=0)))
    done = command("classify", "locate", tmp_path / "other.atlas", imported.path)
    assert done.returncode == 1
    assert "do not rely on these answers" in done.stdout


def test_a_gamma_is_found_by_the_empty_scene_and_undone(lab, command, tmp_path):
    camera, rng = camera_of(lab, "16 bits"), np.random.default_rng(2)
    camera.fall, camera.black = 0.0, 0.0

    def bent(name, picture, count=1):
        for path in camera.take(tmp_path / name, camera.light(picture.astype(float)), rng, count):
            levels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / 65535.0
            assert cv2.imwrite(str(path), np.rint(65535.0 * levels ** (1.0 / 2.2)).astype(np.uint16))

    bent("empty", lab.bulk.background[..., 0], 4)
    bent("shots", lab.seen.pictures[0])
    given = ["import", tmp_path / "shots", "--background", tmp_path / "empty", "--like", lab.bulk.path]
    given += ["--corners", *CORNERS.ravel().tolist(), "-o", tmp_path / "set", "--black", 0]
    refused = command("classify", *given)
    assert refused.returncode == 2
    assert "if a gamma of" in refused.stderr
    found = float(refused.stderr.split("if a gamma of ")[1].split()[0])
    assert found == pytest.approx(2.2, rel=0.1)
    assert not (tmp_path / "set").exists()
    done = command("classify", *given, "--gamma", "2.2", "--electrons", camera.electrons)
    assert done.returncode == 0, done.stderr
    made = open_set(tmp_path / "set")
    error = made.picture(made.records[0])[..., 0] / lab.seen.pictures[0] - 1.0
    assert np.abs(error).mean() < 0.005
