"""Operators of the scene: each calls `generator` and reports the result."""

# mypy: disable-error-code="misc"

from collections.abc import Callable
from typing import Any, cast

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty

from generator.blender import check
from generator.blender.finding import ERROR, FIXES, Finding
from generator.blender.scene import adopt, build, roles
from generator.blender.scene.description import lamp_power, read_scene
from generator.blender.scene.mesh_file import MeshFile
from generator.files.pictures import read_picture
from generator.jobs.protocol import CheckScene, DrawExperiment, RenderWall
from generator.model.errors import NlosError
from generator.model.quantities import radiance
from generator.model.scene import Scene

from ..draft import device_of, fill, follow, grid_of, spec_of, sweep_of
from ..session import background, state, wording
from ..view import differs, images, live, target_file, views
from . import base

_ROLE_WORDS = {
    "relay_wall": ("Relay Wall", "What lamp and camera look at"),
    "target": ("Target", "What hides; its children move with it"),
    "spot": ("Spot", "The lamp"),
    "camera": ("Camera", "Which of the cameras watches the wall"),
    "room": ("Room", "A surface that reflects. Only a name: whatever is rendered reflects"),
    "partition": ("Partition", "What hides the target. Only a name: whatever is rendered hides what is behind it"),
    "": ("No Role", "Take the role away"),
}


class _Task:
    """Base of the operators: reports what ``work`` returns, or bad input in one sentence."""

    bl_options = frozenset({"REGISTER", "UNDO"})

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether to enable: in Object Mode, since Edit Mode locks the meshes, and not during a render."""
        if state.rendering_now():
            cls.poll_message_set("Wait for the render to end")
            return False
        cls.poll_message_set("Go to Object Mode first")
        return bool(context.mode == "OBJECT")

    def execute(self: Any, context: Any) -> set[str]:
        """Do the work; on bad input, report the reason and cancel."""
        try:
            kind, message = self.work(context.scene)
        except NlosError as error:
            return base.refused(self, error)
        self.report({kind}, wording.shown(message))
        live.changed()
        return {"FINISHED"}


class NLOS_OT_build_scene(_Task, bpy.types.Operator):
    """Build the preset with the figures below, in place of an earlier one. Objects of your own stay"""

    bl_idname = "nlos.build_scene"
    bl_label = "Build Scene"

    def invoke(self, context: Any, event: Any) -> set[str]:
        """Ask first where that would throw away what was edited by hand."""
        if not differs.edited(context.scene):
            return set(self.execute(context))
        confirmed: set[str] = context.window_manager.invoke_confirm(
            self,
            event,
            title="Build Scene",
            message="What was built has been edited since. Building it anew discards these edits.",
            confirm_text="Build Anew",
        )
        return confirmed

    def work(self, scene: Any) -> tuple[str, str]:
        """Build the scene; return the kind and the text of the report."""
        spec = spec_of(scene.nlos)
        if spec.target.kind != "mesh":
            return _built(scene, spec)
        name, is_later, reports = scene.name, False, list[tuple[str, str]]()

        def then(found: MeshFile) -> None:
            there = bpy.data.scenes.get(name)
            if there is None or bpy.context.mode != "OBJECT" or state.rendering_now():
                raise NlosError("The file is read; go to Object Mode, let renders end, and build again")
            reports.append(_built(there, spec, found))
            if is_later:
                state.remember("Build Scene")
                live.changed()

        if waits := target_file.read(spec.target, then):
            is_later = True
            return "INFO", waits
        return reports[0]


def _built(scene: Any, spec: Scene, found: MeshFile | None = None) -> tuple[str, str]:
    """Build a scene; return the kind and the text of the report."""
    build.build(scene, spec, found)
    differs.mark(scene)
    message = f"Built the {spec.preset} with {spec.grid.n_voxels} voxels"
    extra_objects = roles.others(scene)
    if extra_objects:  # such as the cube and the lamp that Blender starts with
        return "WARNING", f"{message}. Also rendered: {', '.join(extra_objects)}; delete what is not meant"
    if found is not None and (warning := found.warning(spec.grid)):
        return "WARNING", f"{message}. {warning}"
    return "INFO", message


class NLOS_OT_apply(_Task, bpy.types.Operator):
    """Write light, voxels, reflections and resolution into the scene as it stands. Nothing is built or removed: target, ambient light and preset change with Build Scene"""  # noqa: E501

    bl_idname = "nlos.apply"
    bl_label = "Apply to Scene"

    def work(self, scene: Any) -> tuple[str, str]:
        """Write the settings into the scene; return the kind and the text of the report."""
        settings = scene.nlos
        grid, lamp = grid_of(settings), roles.find(scene, "spot")
        if lamp.type != "LIGHT" or lamp.data.type != "SPOT":
            raise NlosError(f"the spot {lamp.name!r} must be a spot lamp")
        was_edited = differs.edited(scene)
        roles.write_grid(scene, grid)
        roles.limit_reflections(scene, settings.reflection_order)
        scene.render.resolution_x, scene.render.resolution_y = settings.resolution
        scene.render.resolution_percentage = 100
        # The power in watts includes any colour and exposure that the lamp has.
        lamp.data.energy = 1.0
        lamp.data.energy = settings.light_power / (lamp_power(lamp.data) or 1.0)
        lamp.data.spot_size = 2.0 * settings.light_half_angle
        if not was_edited:
            differs.mark(scene)
        return "INFO", f"Applied; light is followed over {settings.reflection_order} reflections"


class NLOS_OT_read_scene(_Task, bpy.types.Operator):
    """Set the figures below to those of the scene, as edited by hand"""

    bl_idname = "nlos.read_scene"
    bl_label = "Read from Scene"

    def work(self, scene: Any) -> tuple[str, str]:
        """Read the scene; return the kind and the text of the report."""
        described = read_scene(scene)
        fill(scene.nlos, described)
        if described.target.albedo is None:
            return "WARNING", "The target's material is not plainly diffuse, so its albedo was not read"
        return "INFO", "Read the scene"


class NLOS_OT_adopt(_Task, bpy.types.Operator):
    """Give the selected objects a part in the experiment: your own wall, target, lamp or camera"""

    bl_idname = "nlos.adopt"
    bl_label = "Use Selected As"

    role: EnumProperty(  # type: ignore[valid-type]
        name="Role", items=[(role or "none", *words) for role, words in _ROLE_WORDS.items()], default="target"
    )

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        """Return the tooltip of one role."""
        return _ROLE_WORDS["" if properties.role == "none" else properties.role][1]

    def work(self, scene: Any) -> tuple[str, str]:
        """Assign the role; return the kind and the text of the report."""
        role = "" if self.role == "none" else self.role
        objects = bpy.context.selected_objects
        active = bpy.context.active_object
        if role in roles.SINGLE_ROLES and active in objects:
            objects = [active]  # as elsewhere in Blender, the active object is the one that is meant
        adopt.assign(scene, role, objects)
        message = f"{', '.join(o.name for o in objects)}: {_ROLE_WORDS[role][0].lower()}"
        complete = all(roles.players(scene, single) for single in roles.SINGLE_ROLES)
        if complete and roles.GRID_SHAPE not in scene:
            if adopt.is_aligned(scene):
                grid = adopt.fit_grid(scene)
                message += f". Voxels {grid.labels[0]} to {grid.labels[-1]} were laid around the target"
                follow(scene)
            else:
                message += ". Check Scene aligns the scene to the wall now, and lays voxels around the target"
        return "INFO", message


class NLOS_OT_check(_Task, bpy.types.Operator):
    """Look for what would spoil a sweep, and measure signal, noise, time and disk by a few quick renders beside"""

    bl_idname = "nlos.check"
    bl_label = "Check Scene"

    def work(self, scene: Any) -> tuple[str, str]:
        """Start the checks without rendering, then those that render; return the kind and the text of the report."""
        _check(scene, _measure)
        if errors := [f for f in state.findings if f.level == ERROR]:
            return "WARNING", errors[0].text
        return "INFO", "The scene is being checked"


def _check(scene: Any, then: Callable[[], None]) -> None:
    """Look for what needs no rendering, step by step; then call a function, unless there is an error."""
    background.drop("check")  # its results would describe an earlier scene
    state.findings.clear()
    state.checking = True
    differs.note("check")

    def done(found: list[list[Finding]]) -> None:
        state.checking = False
        state.findings[:] = check.ordered(found)
        if not check.hopeless(state.findings):
            then()

    background.stepwise(check.parts(scene, engine=scene.nlos.engine), done, "check")


def _measure() -> None:
    """Have signal and noise measured by another Blender."""
    state.checking = True
    request = CheckScene(
        scene=background.snapshot("check.blend"), chosen=sweep_of(bpy.context.scene.nlos), trust_links=True
    )  # Blender has already followed the links of the open file
    background.ask(request, _checked, "check").settle()


def _checked(task: background.Task) -> None:
    state.checking = False
    if task.error:
        state.findings.insert(0, Finding(ERROR, task.error))
    else:
        state.findings[:] = [Finding(**fields) for fields in task.result["findings"]]


class NLOS_OT_fix(_Task, bpy.types.Operator):
    """Mend what the check has found"""

    bl_idname = "nlos.fix"
    bl_label = "Fix"

    fix: StringProperty(options={"SKIP_SAVE"})  # type: ignore[valid-type]
    choice: StringProperty(options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def work(self, scene: Any) -> tuple[str, str]:
        """Apply the fix, and repeat the checks without rendering."""
        background.drop("check")
        check.mend(scene, self.fix, self.choice)
        follow(scene)
        _check(scene, lambda: None)
        return "INFO", f"{FIXES[self.fix]}: {self.choice or 'done'}"


class NLOS_OT_select(_Task, bpy.types.Operator):
    """Select the object that is meant, and make it the active one"""

    bl_idname = "nlos.select"
    bl_label = "Select"

    name: StringProperty(options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def work(self, scene: Any) -> tuple[str, str]:
        """Select the object; return the kind and the text of the report."""
        obj = roles.named(scene, self.name)
        layer = bpy.context.view_layer
        if obj is None or obj.name not in layer.objects:
            raise NlosError(f"there is no object {self.name!r} in this view layer; check again")
        for selected in bpy.context.selected_objects:
            selected.select_set(False)
        obj.hide_set(False)
        obj.select_set(True)
        layer.objects.active = obj
        return "INFO", f"{obj.name} is selected"


class NLOS_OT_render_wall(_Task, bpy.types.Operator):
    """Render what the camera sees on the relay wall, as float radiance, into the image 'NLOS wall'. Another Blender does it, without a window"""  # noqa: E501

    bl_idname = "nlos.render_wall"
    bl_label = "Render Wall"

    def work(self, scene: Any) -> tuple[str, str]:
        """Start the render; return the kind and the text of the report."""
        settings = scene.nlos
        described = read_scene(scene)  # reports bad input now, not later from the other Blender
        roles.refuse_hidden(scene)
        chosen = {name: value for name, value in sweep_of(settings).items() if name not in ("poses", "inside")}
        difference, reference = settings.difference, described.reference_radiance
        width = described.camera.x[1] - described.camera.x[0]
        folder = background.folder()
        request = RenderWall(
            scene=background.snapshot("picture.blend"),
            folder=folder,
            chosen=chosen,
            denoise=settings.denoise,
            trust_links=True,
        )

        def then(task: background.Task) -> None:
            state.rendering = ""
            if task.error:
                state.rendering = task.error
                return
            wall, empty = (read_picture(folder / f"{name}.exr")[0] for name in ("wall", "background"))
            state.shown = state.Shown(wall, empty)
            images.store(images.WALL, wall)
            state.rendering = f"Mean radiance {radiance(float(wall.mean()))}"
            if difference:
                change = wall - empty
                images.store(images.DIFFERENCE, change)
                images.show(images.coloured(images.PREVIEW, change, reference, width))
                if wall.any():
                    state.rendering += f", of which the object adds {change.mean() / wall.mean():.2%}"
            else:
                images.show(images.preview(wall))
            state.remember("Render Wall")  # otherwise the next undo would remove the pictures

        state.rendering = "Rendering ..."
        differs.note("picture")
        task = background.ask(request, then, "picture").settle()
        if task.error:
            raise NlosError(task.error)
        return "INFO", state.rendering


class NLOS_OT_experiment(_Task, bpy.types.Operator):
    """Difference pictures of the paper's experiment, from the object's place: what a movement along each axis, or a turn about it, changes"""  # noqa: E501

    bl_idname = "nlos.experiment"
    bl_label = "Experiment"

    number: IntProperty(name="Number", min=1, max=3, default=1)  # type: ignore[valid-type]

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        """Return the tooltip of one experiment."""
        moves = ("A sphere is moved along x, y and z", "A square sheet is moved along x, y and z")
        turned = "The sheet is turned about x, y and z"
        return f"{(*moves, turned)[properties.number - 1]}: a row of difference pictures for each axis"

    def work(self, scene: Any) -> tuple[str, str]:
        """Start the experiment; return the kind and the text of the report."""
        reference, number = read_scene(scene).reference_radiance, self.number
        file = background.folder() / "experiment.exr"
        source = background.snapshot("experiment.blend")

        def then(task: background.Task) -> None:
            state.experiment = task.error
            if not task.error:
                image = images.coloured(images.EXPERIMENT.format(number), read_picture(file)[0], reference, 0.0)
                images.show(image)
                state.remember("Experiment")

        state.experiment = "Drawing the pictures ..."
        differs.note("experiment")
        device = device_of(scene.nlos)
        request = DrawExperiment(scene=source, file=file, number=number, device=device, trust_links=True)
        task = background.ask(request, then, "experiment").settle()
        if task.error:
            raise NlosError(task.error)
        turned = "turned about" if number == 3 else "moved along"
        return "INFO", f"{images.EXPERIMENT.format(number)}: {turned} x, y and z, a row each"


class NLOS_OT_open_image_editor(bpy.types.Operator):
    """Show the live look, or the last picture, in an Image Editor; if none is open, cut one off the 3D view"""

    bl_idname = "nlos.open_image_editor"
    bl_label = "Open Image Editor"

    image: StringProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether an Image Editor is open, or the area is a 3D view that does not fill the window."""
        cls.poll_message_set("Needs a 3D view that is not maximised")
        inside = context.area is not None and context.area.type == "VIEW_3D"
        return images.is_editor_open() or bool(inside and bpy.ops.screen.area_split.poll())

    def execute(self: Any, context: Any) -> set[str]:
        """Show the image; split the area if need be."""
        looks = context.window_manager.nlos.look and not self.image
        image = None if looks else bpy.data.images.get(self.image or images.PREVIEW)
        image = image or images.look_image()
        if images.show(image):
            return {"FINISHED"}
        old_areas = set(context.screen.areas)
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.4)
        [area] = set(context.screen.areas) - old_areas or [None]
        if area is None:
            return base.refused(self, "The 3D view is too small to be split")
        area.type = "IMAGE_EDITOR"
        area.spaces.active.image = image
        name = image.name
        # The editor has its size only once it has been drawn.
        state.after_drawing(lambda: images.show(bpy.data.images.get(name)))
        return {"FINISHED"}


class NLOS_OT_new_room(bpy.types.Operator):
    """Start a new file with a ready room: wall, partition, lamp, camera, a hidden sheet"""

    bl_idname = "nlos.new_room"
    bl_label = "NLOS Room"

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether to enable: not during a render or without Cycles, as the open file would be lost in vain."""
        cls.poll_message_set("Wait for the render to end, and enable Cycles")
        return hasattr(context.scene, "cycles") and not state.rendering_now()

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Ask for confirmation if there are unsaved changes."""
        if bpy.data.is_dirty:
            answer: set[str] = context.window_manager.invoke_confirm(
                self, event, title="Start a new room?", message="What is not saved is lost.", confirm_text="New Room"
            )
            return answer
        return cast("set[str]", self.execute(context))

    def execute(self: Any, context: Any) -> set[str]:
        """Open Blender's own start-up file, empty it and build the room."""
        bpy.ops.wm.read_homefile(app_template="")
        scene = bpy.context.scene
        for obj in list(scene.objects):
            bpy.data.objects.remove(obj)
        bpy.ops.outliner.orphans_purge(do_recursive=True)
        try:
            build.build(scene, spec_of(scene.nlos))
        except NlosError as error:
            return base.refused(self, error)
        differs.mark(scene)
        target = roles.find(scene, "target")
        target.select_set(True)
        bpy.context.view_layer.objects.active = target
        state.remember("New Room")
        if not bpy.app.background:
            bpy.context.window_manager.nlos.overlay = True
            state.after_drawing(views.enter)
        return {"FINISHED"}


_CLASSES = (
    NLOS_OT_build_scene,
    NLOS_OT_apply,
    NLOS_OT_read_scene,
    NLOS_OT_adopt,
    NLOS_OT_check,
    NLOS_OT_fix,
    NLOS_OT_select,
    NLOS_OT_render_wall,
    NLOS_OT_experiment,
    NLOS_OT_open_image_editor,
    NLOS_OT_new_room,
)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
