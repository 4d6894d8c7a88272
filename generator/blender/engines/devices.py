"""The devices that Cycles renders on, as Blender's preferences (System > Cycles Render Devices) have them."""

from __future__ import annotations

from typing import Any

import bpy

from generator.blender.scene.quiet import Overrides, quiet
from generator.jobs import gpus
from generator.jobs.gpus import Gpus
from generator.model.errors import NlosError

GPU_KINDS = ("OPTIX", "CUDA", "HIP", "METAL", "ONEAPI")
"""Cycles' names of its GPU backends, the fastest first."""


def preferences() -> Any:
    """Return the preferences of Cycles; None if it is switched off."""
    addon = bpy.context.preferences.addons.get("cycles")
    return None if addon is None else addon.preferences


def preferred(preferences: Any) -> Gpus:
    """Return the devices that preferences of Cycles choose; empty if that is the CPU alone.

    Parameters
    ----------
    preferences : CyclesPreferences, optional
    """
    kind = preferences.compute_device_type if preferences is not None else "NONE"
    used = [device for device in preferences.devices if device.use] if kind not in ("", "NONE") else []
    if not any(device.type == kind for device in used):
        return {}
    return {kind: [device.id for device in used if device.type in (kind, "CPU")]}


def use_gpu(overrides: Overrides) -> list[str]:
    """Let Cycles render on the GPUs that were chosen, or that the preferences name, or else on all that it finds.

    Returns
    -------
    list of str
        Names of the devices.

    Raises
    ------
    NlosError
        Cycles finds no GPU, or none of the chosen ones.
    """
    found = preferences()
    wanted = gpus.chosen() or preferred(found)  # before what Blender has not seen yet is added, and chosen
    with quiet():
        found.refresh_devices()
    for kind in wanted or GPU_KINDS:
        # Not `found.devices`, which keeps devices that this machine no longer has.
        present = found.get_devices_for_type(kind)
        devices = [d for d in present if (d.id in wanted[kind] if wanted else d.type == kind)]
        if not any(device.type == kind for device in devices):
            continue
        overrides.set(found, "compute_device_type", kind)
        for device in found.devices:
            overrides.set(device, "use", device in devices)
        return [device.name for device in devices]
    missing = f"none of the GPUs that the preferences choose ({', '.join(wanted)})" if wanted else "no GPU"
    raise NlosError(
        f"device gpu: Cycles finds {missing} on this machine; Blender {bpy.app.version_string} can use "
        f"{_offered(found)}; check the GPU's driver, or render on the device cpu"
    )


def require_gpu() -> list[str]:
    """Return the names of the devices that `use_gpu` would render on; raise NlosError as it does."""
    with Overrides() as overrides:
        return use_gpu(overrides)


def _offered(found: Any) -> str:
    """Return the kinds of GPU that a Blender can use, and the devices that it finds, as a phrase."""
    kinds = [kind for kind, *_ in found.get_device_types(bpy.context) if kind != "NONE"]
    present = [device for kind in GPU_KINDS for device in found.get_devices_for_type(kind)]
    devices = sorted({f"{device.name} ({device.type})" for device in present})
    return f"{', '.join(kinds) or 'no kind of GPU'}, and finds {', '.join(devices) or 'none'}"
