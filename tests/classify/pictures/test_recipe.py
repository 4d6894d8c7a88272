"""From frames to a picture."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix, random

from classify.pictures.frames import Frame
from classify.pictures.recipe import Recipe, check_gamma, linear, without
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError


def recipe(**changes):
    matrix = csr_matrix(random(6, 20, density=0.2, random_state=1) + csr_matrix(np.eye(6, 20)))
    made = {"shape": (4, 5, 1), "resolution": (3, 2), "matrix": matrix, "offset": np.arange(6.0), "gamma": ""}
    return Recipe(**{**made, "white": 255.0, "exposure": 0.0, "sensor": Sensor(exposure=2.0), **changes})


def frame(values, **more):
    return Frame("a.png", np.asarray(values, dtype=np.uint8).reshape(4, 5, 1), 255.0, **more)


def test_the_srgb_curve_is_that_of_the_standard():
    """IEC 61966-2-1: some values of its table, and both pieces meet."""
    shares = np.array([0.0, 0.04045, 0.5, 0.735357, 1.0])
    light = [0.0, 0.0031308, 0.2140411, 0.5, 1.0]
    assert np.allclose(linear(255.0 * shares, "srgb", 255.0) / 255.0, light, atol=1e-6)
    assert np.allclose(linear(np.array([128.0]), "2.0", 256.0), 64.0)
    for name in ("0.1", "gamma", "nan"):
        with pytest.raises(NlosError, match="--gamma"):
            check_gamma(name)


def test_frames_are_averaged_and_exposures_brought_to_one():
    one, two = frame(np.arange(20)), frame(np.arange(20) + 2)
    made = recipe()
    wanted = made.matrix @ (np.arange(20) + 1.0) - np.arange(6.0)
    assert np.allclose(made([one, two])[..., 0].ravel(), wanted)
    timed = recipe(exposure=0.02)
    with pytest.raises(NlosError, match="states no exposure, and the first picture one"):
        timed([one])
    assert np.allclose(timed.light(frame(np.arange(20), exposure=0.01)), 2.0 * made.light(one))


def test_a_saturated_pixel_is_refused_only_where_it_counts():
    values = np.zeros(20)
    made = recipe()
    idle = next(k for k in range(20) if k not in made.used)
    values[idle] = 255
    made.check(frame(values))
    values[made.used[0]] = 255
    with pytest.raises(NlosError, match="1 of its values on the patch are saturated"):
        made([frame(values)])


def test_it_is_kept(tmp_path):
    path, made = tmp_path / "recipe.npz", recipe(gamma="srgb")
    made.save(path)
    again, one = Recipe.load(path), frame(np.arange(20))
    assert np.allclose(again.light(one), made.light(one), rtol=1e-6)
    assert (again.sensor, again.white, again.shape) == (made.sensor, made.white, made.shape)
    data = path.read_bytes()
    for broken in (b"", data[: len(data) // 2], b"PK" + bytes(50)):
        path.write_bytes(broken)
        with pytest.raises(NlosError, match="is no recipe"):
            Recipe.load(path)
    matrix = made.matrix
    wrong = {"data": matrix.data, "indices": matrix.indices + 1000, "indptr": matrix.indptr, "offset": made.offset}
    with np.load(_saved(made, tmp_path / "whole.npz")) as whole:
        np.savez(path, **wrong, about=whole["about"])
    with pytest.raises(NlosError, match="is no recipe"):
        Recipe.load(path)


def _saved(made, path):
    made.save(path)
    return path


def test_masked_pixels_are_left_out():
    weights = csr_matrix(np.array([[0.25, 0.25, 0.25, 0.25, 0, 0], [0, 0, 0, 0, 0.5, 0.5]]))
    masked = np.array([[True, False, False], [False, False, False]])
    assert np.allclose(without(weights, masked, (2, 1)).toarray()[0], [0, 1 / 3, 1 / 3, 1 / 3, 0, 0])
    masked[1, 1:] = True
    with pytest.raises(NlosError, match="column 1, row 0"):
        without(weights, masked, (2, 1))
