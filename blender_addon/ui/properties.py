"""Settings that the panels show: a draft of a scene's values, saved with the Blender scene.

The draft has no effect by itself: `spec_of` turns it into a spec that an operator writes into the scene, and `fill`
sets it to the values of a spec that was read from the scene.
"""

# Blender reads the calls below, which stand in place of type annotations, as definitions of the properties.
# mypy: disable-error-code="valid-type,misc"

import math
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)

from generator.model.described import range_of, sentence, sentence_for
from generator.model.engines import AUTO, AUTO_HELP, ENGINES
from generator.model.grid import VoxelGrid
from generator.model.presets import PRESETS, preset
from generator.model.scene import Scene, Spot, Target
from generator.model.settings import Sweep

from ..draft import PREFERENCES, ROOM, fill
from ..view import live, live_answer, overlay

_READ = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()
_WRITTEN = _READ and {*_READ, "OUTPUT_PATH"}
"""Options of paths: without them, Blender draws red what starts with // or is not there yet. Older ones lack them."""


def _range(kind: type, name: str) -> dict[str, Any]:
    low, high = range_of(kind, name)
    return {"min": low, "max": high}


_KINDS = (
    ("sheet", "Sheet", "A square sheet, two-sided; unrotated it faces the wall"),
    ("sphere", "Sphere", "A sphere"),
    ("mesh", "Mesh File", "A mesh from an OBJ, PLY, STL, glTF, USD, FBX or .blend file"),
)
_UNITS = (
    ("auto", "As the File Says", "What the file states; metres for OBJ, PLY and STL, which state nothing"),
    ("m", "Metres", "A length of 1 in the file is a metre"),
    ("cm", "Centimetres", "A length of 1 in the file is a centimetre"),
    ("mm", "Millimetres", "A length of 1 in the file is a millimetre, as usual for CAD"),
    ("inch", "Inches", "A length of 1 in the file is an inch"),
)
_UP = (
    ("auto", "As the File Says", "What the file states; Y for OBJ, and Z for PLY and STL, which state nothing"),
    *((axis, axis, f"The file's {axis} axis points up") for axis in "XYZ"),
)
# Files store an item's number, so a number is never reused.
_ENGINES = (
    *((n, n, sentence(ENGINES[n].help), i) for i, n in enumerate(("patch", "path", "surfel"))),
    (AUTO, AUTO, sentence(AUTO_HELP), 3),
)


def _preset_changed(settings: Any, _: Any) -> None:
    kind = settings.target_kind
    fill(settings, preset(settings.preset, "sheet" if kind == "mesh" else kind), target=kind != "mesh")


def _kind_changed(settings: Any, _: Any) -> None:
    if settings.target_kind == "mesh":
        settings.target_size = 0.0
    else:
        target = preset(settings.preset, settings.target_kind).target
        settings.target_size, settings.target_albedo = target.size, target.albedo


def _redraw(_: Any, context: Any) -> None:
    overlay.changed()


class NlosSettings(bpy.types.PropertyGroup):
    """The draft: settings of the panels, saved with the scene."""

    preset: EnumProperty(
        name="Preset",
        description="Scene to start from. Choosing one sets all figures below to its own",
        items=[(name, of.title, sentence(of.words)) for name, of in PRESETS.items()],
        update=_preset_changed,
    )
    target_kind: EnumProperty(
        name="Kind", description="What hides around the corner", items=_KINDS, update=_kind_changed
    )
    target_size: FloatProperty(
        name="Size",
        description=sentence_for(Target, "size"),
        default=ROOM.target.size,
        min=0.0,
        soft_max=10.0,
        step=1,
        precision=3,
        subtype="DISTANCE",
        unit="LENGTH",
    )
    target_albedo: FloatProperty(
        name="Albedo",
        description=sentence_for(Target, "albedo"),
        default=ROOM.target.albedo,
        min=0.0,
        max=1.0,
        precision=3,
        subtype="FACTOR",
    )
    target_mesh: StringProperty(
        name="File",
        description="Mesh file: OBJ, PLY, STL, glTF, USD, FBX or .blend; only its meshes are taken",
        subtype="FILE_PATH",
        options=_READ,
    )
    target_unit: EnumProperty(name="Unit", description=sentence_for(Target, "unit"), items=_UNITS)
    target_up: EnumProperty(name="Up", description=sentence_for(Target, "up"), items=_UP)
    light_power: FloatProperty(
        name="Power",
        description=sentence_for(Spot, "power"),
        default=ROOM.spot.power,
        min=0.0,
        soft_max=1e5,
        subtype="POWER",
        unit="POWER",
    )
    light_half_angle: FloatProperty(
        name="Half Angle",
        description=sentence_for(Spot, "half_angle"),
        default=math.radians(ROOM.spot.half_angle),
        min=math.radians(0.001),
        max=math.radians(89.0),
        soft_min=math.radians(0.1),
        soft_max=math.radians(30.0),
        step=10,
        precision=3,
        subtype="ANGLE",
        unit="ROTATION",
    )
    use_ambient: BoolProperty(
        name="Ambient Light", description="Light the scene uniformly from all around; a closed room loses its ceiling"
    )
    ambient_radiance: FloatProperty(
        name="Radiance",
        description=sentence_for(Scene, "ambient"),
        default=0.01,
        min=0.0,
        soft_max=10.0,
        step=0.1,
        precision=5,
    )
    grid_counts: IntVectorProperty(
        name="Voxels",
        description=sentence_for(VoxelGrid, "shape"),
        size=3,
        default=ROOM.grid.shape,
        min=1,
        soft_max=10,
        subtype="XYZ",
    )
    grid_lo: FloatVectorProperty(
        name="From",
        description=sentence_for(VoxelGrid, "lo"),
        size=3,
        default=ROOM.grid.lo,
        step=1,
        precision=3,
        subtype="XYZ_LENGTH",
        unit="LENGTH",
    )
    grid_hi: FloatVectorProperty(
        name="To",
        description=sentence_for(VoxelGrid, "hi"),
        size=3,
        default=ROOM.grid.hi,
        step=1,
        precision=3,
        subtype="XYZ_LENGTH",
        unit="LENGTH",
    )
    reflection_order: IntProperty(
        name="Reflections",
        description=sentence_for(Scene, "reflection_order"),
        default=ROOM.reflection_order,
        soft_max=8,
        **_range(Scene, "reflection_order"),
    )
    engine: EnumProperty(name="Engine", description="How the light is followed", items=_ENGINES, default=AUTO)
    samples: IntProperty(
        name="Samples",
        description=sentence_for(Sweep, "samples"),
        default=Sweep().samples,
        soft_max=8192,
        **_range(Sweep, "samples"),
    )
    accuracy: FloatProperty(
        name="Accuracy",
        description=sentence_for(Sweep, "accuracy"),
        default=1e-2,
        soft_min=1e-4,
        precision=4,
        **_range(Sweep, "accuracy"),
    )
    quality: EnumProperty(
        name="Data Set",
        description="What decides how many samples a data set takes, or how exact the integral is",
        items=(
            ("figures", "As Above", "The samples and the accuracy above"),
            ("time", "In a Time", "As many as there is time for: a few pictures are rendered first to find out"),
            ("error", "At an Error", "As many as that takes: a few pictures are rendered first to find out"),
        ),
    )
    minutes: FloatProperty(
        name="Minutes",
        description="In which the data set is to be rendered",
        default=10.0,
        min=0.1,
        soft_max=1440.0,
        precision=1,
    )
    error: FloatProperty(
        name="Error",
        description="Of what the object changes, in the middling pose; noise and all",
        default=50.0,
        min=0.01,
        max=99.0,
        subtype="PERCENTAGE",
        precision=1,
    )
    resolution: IntVectorProperty(
        name="Resolution",
        description=sentence_for(Scene, "resolution"),
        size=2,
        default=ROOM.resolution,
        soft_max=512,
        **_range(Scene, "resolution"),
    )
    seed: IntProperty(
        name="Seed",
        description=sentence_for(Sweep, "seed"),
        default=0,
        min=0,
    )
    device: EnumProperty(
        name="Device",
        description="Where Cycles renders: this picture, checks, experiments and data sets",
        items=(
            (PREFERENCES, "As in Preferences", "What Preferences > System > Cycles Render Devices says"),
            ("cpu", "CPU", "The processor"),
            ("gpu", "GPU", "Those of the preferences, or else all that Cycles finds. Without one it is an error"),
        ),
        default=PREFERENCES,
    )
    denoise: BoolProperty(
        name="Denoise",
        description="Clean this picture with Open Image Denoise: smooth to look at, biased by about half a percent. "
        "Data sets are never denoised",
    )
    difference: BoolProperty(
        name="Difference",
        description="Also render the scene without the hidden object, and subtract: the object's own doing is left",
        default=True,
    )
    look_resolution: EnumProperty(
        name="Pixels",
        description="Width of the live picture; more pixels take longer",
        items=[(str(n), f"{n} x {n}", "") for n in (32, 64, 128, 256)],
        default="64",
        update=lambda settings, context: live.changed(),
    )
    look_shadows: BoolProperty(
        name="Shadows",
        description="Subtract the light of the room that the object keeps from the wall. Where that takes long, a "
        "picture without it comes first",
        default=True,
        update=lambda settings, context: live.changed(),
    )
    dataset: StringProperty(
        name="Folder",
        description="Where the data set goes: a new or empty folder, or the one of a set to go on with",
        subtype="DIR_PATH",
        default="//dataset",
        options=_WRITTEN,
    )
    poses: IntProperty(
        name="Poses",
        description=sentence_for(Sweep, "poses"),
        default=Sweep().poses,
        soft_max=1000,
        **_range(Sweep, "poses"),
    )
    inside: EnumProperty(
        name="Inside",
        description=sentence_for(Sweep, "inside"),
        items=(
            ("whole", "Whole Object", "Every point of it"),
            ("centre", "Its Centre", "Its origin only: it may reach into the next voxel"),
        ),
    )
    workers: IntProperty(
        name="Processes",
        description="Blenders that render side by side, without windows; 0 is one per core",
        default=0,
        min=0,
        soft_max=64,
    )
    train_set: StringProperty(
        name="Set",
        description="Folder of the data set to learn from; empty for that of the Data Set panel",
        subtype="DIR_PATH",
        options=_READ,
    )
    train_features: EnumProperty(
        name="Features",
        description="Numbers by which a picture is described to the classifier",
        items=(
            ("global", "Global", "Colour histogram, Hu moments and Haralick texture: the best for the presets"),
            ("spatial-hog", "Spatial", "A smaller copy of the picture, its colour histogram and its gradients"),
            ("physics", "Physics", "Level, shape without level, and the fit of an unknown target"),
        ),
    )
    train_classifier: EnumProperty(
        name="Classifier",
        description="How the voxel is learnt from the numbers",
        items=(
            ("SVM", "Support Vectors", "Support vector machine: as good as any with the global features"),
            ("RF", "Random Forest", "The best with spatial features; no settings have to fit"),
            ("LR", "Logistic", "Logistic regression: simple and quick"),
            ("LDA", "Linear", "Linear discriminant analysis: the quickest"),
        ),
    )
    model: StringProperty(
        name="Model",
        description="What Train made (.skops). Live Answer takes an atlas too (nlos-classify atlas, in a shell)",
        subtype="FILE_PATH",
        default="",
        options=_READ,
        update=lambda settings, context: live_answer.restart(),
    )
    timeline_folder: StringProperty(
        name="Folder",
        description="Where the pictures of the timeline go: a new or empty folder",
        subtype="DIR_PATH",
        default="//timeline",
        options=_WRITTEN,
    )
    timeline_atlas: StringProperty(
        name="Atlas",
        description="Made by nlos-classify atlas in a shell, of a set with Data Set > Inside > Its Centre",
        subtype="FILE_PATH",
        default="",
        options=_READ,
    )
    timeline_step: FloatProperty(
        name="Process Noise",
        description="How far the object may move from frame to frame, a standard deviation: about twice its pace",
        default=0.06,
        min=1e-4,
        soft_max=0.5,
        precision=3,
        unit="LENGTH",
    )


def _look_switched(session: Any) -> None:
    live.switch(session.look)
    if not session.look and session.live_answer:
        session.live_answer = False


def _live_answer_switched(session: Any) -> None:
    live_answer.switch(session.live_answer)
    if session.live_answer and not session.look:
        session.look = True


def _handles_switched(session: Any) -> None:
    if session.show_handles:
        session.overlay = session.show_voxels = True  # which they belong to
    overlay.changed()


class NlosSession(bpy.types.PropertyGroup):
    """Switches of this window manager. They are not saved with the file: opening a file starts nothing."""

    look: BoolProperty(
        name="Live Look",
        description="Show what the hidden object does to the wall, and follow it as it is moved",
        options={"SKIP_SAVE"},
        update=lambda session, context: _look_switched(session),
    )
    live_answer: BoolProperty(
        name="Live Answer",
        description="Ask the model about every whole picture of the live look, and show in the overlay how probable "
        "each voxel is",
        options={"SKIP_SAVE"},
        update=lambda session, context: _live_answer_switched(session),
    )
    overlay: BoolProperty(
        name="Overlay",
        description="Show in the 3D views what belongs to the experiment but is no object",
        options={"SKIP_SAVE"},
        update=lambda session, context: overlay.switch(session.overlay),
    )
    show_voxels: BoolProperty(
        name="Voxels", description="The hidden volume, with its letters", default=True, update=_redraw
    )
    show_handles: BoolProperty(
        name="Drag Faces",
        description="Arrows on the faces of the voxel grid, to drag them by. Off, clicks select what is behind",
        update=lambda session, context: _handles_switched(session),
    )
    show_patches: BoolProperty(
        name="Patches", description="What the lamp lights and what the camera watches", default=True, update=_redraw
    )
    show_legs: BoolProperty(
        name="Light Legs",
        description="Lamp to wall, wall to object, object to wall, wall to camera",
        default=True,
        update=_redraw,
    )
    show_poses: BoolProperty(
        name="Poses", description="Where the object will stand in the first pictures of a sweep", update=_redraw
    )


def register() -> None:
    """Add the draft to every scene, and the switches to the window manager."""
    bpy.utils.register_class(NlosSettings)
    bpy.utils.register_class(NlosSession)
    bpy.types.Scene.nlos = PointerProperty(type=NlosSettings, name="NLOS")
    bpy.types.WindowManager.nlos = PointerProperty(type=NlosSession, name="NLOS")


def unregister() -> None:
    """Remove the draft and the switches."""
    del bpy.types.WindowManager.nlos
    del bpy.types.Scene.nlos
    bpy.utils.unregister_class(NlosSession)
    bpy.utils.unregister_class(NlosSettings)
