"""The device that Cycles renders on. No test needs a GPU: preferences are made up, and this machine's are refused."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import TINY

from generator.blender.engines import devices
from generator.blender.scene.quiet import Overrides
from generator.jobs import gpus
from generator.jobs.protocol import RenderSweep, read_request
from generator.model.errors import NlosError
from generator.sets.dataset import Dataset

FOUND = (("OPTIX", "o0"), ("OPTIX", "o1"), ("CUDA", "c0"), ("CUDA", "c1"), ("CPU", "CPU"))


class Preferences(SimpleNamespace):
    """Cycles' preferences, as far as they are read: with new devices once they have been refreshed, as in Blender."""

    def __init__(self, kind="NONE", used=None, found=FOUND):
        known = [] if used is None else [*FOUND, ("CUDA", "gone")]
        devices = [SimpleNamespace(id=name, name=name, type=of, use=name in used) for of, name in known]
        super().__init__(compute_device_type=kind, devices=devices, found=found)

    def refresh_devices(self):
        known = [(device.type, device.id) for device in self.devices]
        new = [device for device in self.found if device not in known]
        self.devices += [SimpleNamespace(id=name, name=name, type=of, use=of != "CPU") for of, name in new]

    def get_devices_for_type(self, kind):
        present = [device for device in self.devices if (device.type, device.id) in self.found]
        of_kind = [device for device in present if device.type == kind]
        return [*of_kind, *(device for device in present if of_kind and device.type == "CPU")]

    def get_device_types(self, _):
        return [("NONE", "None"), ("CUDA", "CUDA"), ("OPTIX", "OptiX")]

    @property
    def used(self):
        return [device.id for device in self.devices if device.use]


@pytest.mark.parametrize(
    ("kind", "used", "chosen"),
    [
        ("NONE", ["c0"], {}),
        ("CUDA", ["c1"], {"CUDA": ["c1"]}),
        ("CUDA", ["c1", "o0"], {"CUDA": ["c1"]}),
        ("CUDA", ["CPU"], {}),  # Blender renders on the CPU then
        ("CUDA", ["c0", "CPU"], {"CUDA": ["c0", "CPU"]}),
    ],
)
def test_preferences_choose_devices(kind, used, chosen):
    assert devices.preferred(Preferences(kind, used)) == chosen


def test_no_cycles_chooses_no_gpu():
    assert devices.preferred(None) == {}


@pytest.mark.parametrize(
    ("kind", "used", "asked", "kind_then", "rendering"),
    [
        ("NONE", None, {}, "OPTIX", ["o0", "o1"]),
        ("CUDA", ["c1", "gone"], {}, "CUDA", ["c1"]),
        ("NONE", None, {"CUDA": ["c0", "CPU"]}, "CUDA", ["c0", "CPU"]),
        ("OPTIX", ["o0"], {"CUDA": ["c0"]}, "CUDA", ["c0"]),
        ("NONE", None, {"CUDA": ["gone", "c1"]}, "CUDA", ["c1"]),
    ],
)
def test_chosen_devices_render_and_no_others(monkeypatch, kind, used, asked, kind_then, rendering):
    preferences = Preferences(kind, used)
    monkeypatch.setattr(devices, "preferences", lambda: preferences)
    preferences.refresh_devices()
    before = preferences.used
    with gpus.choosing(asked), Overrides() as overrides:
        assert devices.use_gpu(overrides) == rendering
        assert (preferences.compute_device_type, preferences.used) == (kind_then, rendering)
    assert (preferences.compute_device_type, preferences.used) == (kind, before)


@pytest.mark.parametrize(
    ("asked", "found", "words"),
    [
        ({}, FOUND[-1:], r"device gpu: Cycles finds no GPU on this .* can use CUDA, OPTIX, and finds none;"),
        ({"CUDA": ["gone"]}, FOUND, r"none of the GPUs that the preferences choose \(CUDA\) .*, c1 \(CUDA\), o0 "),
        ({"HIP": ["h0"]}, FOUND, r"none of the GPUs that the preferences choose \(HIP\)"),
        ({"CUDA": ["gone", "CPU"]}, FOUND, r"none of the GPUs that the preferences choose \(CUDA\)"),
    ],
)
def test_missing_gpus_are_refused(monkeypatch, asked, found, words):
    preferences = Preferences(found=found)
    monkeypatch.setattr(devices, "preferences", lambda: preferences)
    with gpus.choosing(asked), pytest.raises(NlosError, match=words):
        devices.require_gpu()
    assert preferences.compute_device_type == "NONE"


def test_a_preferred_gpu_that_is_gone_is_refused(monkeypatch):
    """Blender keeps it among its devices, and would render on the CPU without a word."""
    monkeypatch.setattr(devices, "preferences", lambda: Preferences("CUDA", ["gone"]))
    with pytest.raises(NlosError, match=r"none of the GPUs that the preferences choose \(CUDA\)"):
        devices.require_gpu()


def test_a_request_carries_the_chosen_devices():
    request = RenderSweep(path="set", threads=1, trust_links=False, gpus={"OPTIX": ["o1"]})
    assert read_request(request.arguments[1]).gpus == {"OPTIX": ["o1"]}


def without_gpu():
    try:
        devices.require_gpu()
    except NlosError:
        return True
    return False


@pytest.mark.parametrize(
    "verb",
    [
        ["sweep", "{scene}", "-o", "{folder}", "--engine", "patch", "--poses", "1", "--samples", "4"],
        ["check", "{scene}", "--engine", "path", "--samples", "4"],
        ["plan", "{scene}", "-o", "{folder}"],
        ["tradeoff", "{scene}", "-o", "{folder}"],
        ["experiment", "1", "-o", "{folder}"],
    ],
)
def test_commands_refuse_a_gpu_that_is_not_there(tmp_path, scene_file, command, verb):
    if not without_gpu():
        pytest.skip("there is a GPU")
    folder = tmp_path / "out"
    arguments = [word.format(scene=scene_file, folder=folder) for word in verb]
    result = command("generator", *arguments, "--device", "gpu", process=True)
    assert result.returncode == 2, result.stdout + result.stderr
    assert result.stderr.count("\n") == 1, result.stderr
    assert result.stderr.startswith("error: device gpu: Cycles finds no GPU on this machine; Blender ")
    assert not folder.exists()


def test_the_cpu_by_name_renders_the_same_pixels_and_a_set_keeps_its_device(
    tmp_path, scene_file, tiny_dataset, command
):
    named = tmp_path / "named"
    result = command("generator", "sweep", scene_file, "-o", named, *TINY, "--device", "cpu")
    assert result.returncode == 0, result.stderr
    one, other = Dataset.open(tiny_dataset), Dataset.open(named)
    assert one.settings["device"] == other.settings["device"] == "cpu"
    assert "gpus" not in other.meta
    np.testing.assert_array_equal(one.background(), other.background())
    for pose, twin in zip(one.poses, other.poses, strict=True):
        np.testing.assert_array_equal(one.picture(pose), other.picture(twin))
    result = command("generator", "sweep", scene_file, "-o", named, *TINY, "--device", "gpu")
    assert result.returncode == 2
    assert "device is cpu there and gpu here" in result.stderr
