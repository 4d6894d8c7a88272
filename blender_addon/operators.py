"""Operators: each calls `generator` and says what came of it."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy

from generator import engines, spec, stage

from . import images, properties


class _Task:
    """What the operators have in common: work that reports itself, or tells bad input in one sentence."""

    bl_options = frozenset({"REGISTER", "UNDO"})

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Only in Object Mode: in Edit Mode the meshes are out of reach."""
        cls.poll_message_set("Go to Object Mode first")
        return bool(context.mode == "OBJECT")

    def execute(self: Any, context: Any) -> set[str]:
        """Do the work, or report why not and cancel."""
        try:
            kind, message = self.work(context.scene)
        except spec.NlosError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({kind}, message)
        return {"FINISHED"}


class NLOS_OT_build_scene(_Task, bpy.types.Operator):
    """Build the preset with the figures below, in place of an earlier one. Objects of your own stay"""

    bl_idname = "nlos.build_scene"
    bl_label = "Build Scene"

    def work(self, scene: Any) -> tuple[str, str]:
        """Build; return what to report."""
        wanted = properties.spec_of(scene.nlos)
        stage.build(scene, wanted)
        done = f"Built the {wanted.preset} with {wanted.grid.n_voxels} voxels"
        others = stage.others(scene)
        if others:  # such as the cube and the lamp that Blender starts with
            return (
                "WARNING",
                f"{done}. Also rendered: {', '.join(others)}; delete what is not meant",
            )
        return "INFO", done


class NLOS_OT_apply(_Task, bpy.types.Operator):
    """Write light, voxels, reflections and resolution into the scene as it stands. Nothing is built or removed: target, ambient light and preset change with Build Scene"""  # noqa: E501

    bl_idname = "nlos.apply"
    bl_label = "Apply to Scene"

    def work(self, scene: Any) -> tuple[str, str]:
        """Apply; return what to report."""
        settings = scene.nlos
        grid, lamp = properties.grid(settings), stage.find(scene, "spot")
        if lamp.type != "LIGHT" or lamp.data.type != "SPOT":
            raise spec.NlosError(f"the spot {lamp.name!r} must be a spot lamp")
        stage.write_grid(scene, grid)
        stage.limit_reflections(scene, settings.reflection_order)
        scene.render.resolution_x, scene.render.resolution_y = settings.resolution
        scene.render.resolution_percentage = 100
        # The lamp may have a colour or an exposure of its own, which the power in watts includes.
        lamp.data.energy = 1.0
        lamp.data.energy = settings.light_power / (stage.lamp_power(lamp.data) or 1.0)
        lamp.data.spot_size = 2.0 * settings.light_half_angle
        return "INFO", f"Applied; light is followed over {settings.reflection_order} reflections"


class NLOS_OT_read_scene(_Task, bpy.types.Operator):
    """Set the figures below to those of the scene, as edited by hand"""

    bl_idname = "nlos.read_scene"
    bl_label = "Read from Scene"

    def work(self, scene: Any) -> tuple[str, str]:
        """Read; return what to report."""
        found = stage.read(scene)
        properties.fill(scene.nlos, found)
        if found.target.albedo is None:
            return "WARNING", "The target's material is not plainly diffuse, so its albedo was not read"
        return "INFO", "Read the scene"


class NLOS_OT_render_wall(_Task, bpy.types.Operator):
    """Render what the camera sees on the relay wall, as float radiance, into the image 'NLOS wall'"""

    bl_idname = "nlos.render_wall"
    bl_label = "Render Wall"

    def work(self, scene: Any) -> tuple[str, str]:
        """Render; return what to report."""
        settings, chosen = scene.nlos, ""
        engine = settings.engine
        if engine == engines.AUTO:
            engine, reasons = engines.choose(scene)
            chosen = f" (engine {engine}{', since ' + reasons[0] if reasons else ''})"
        size = tuple(settings.resolution)
        with engines.opened(scene, engine, resolution=size, accuracy=settings.accuracy) as renderer:
            wall = renderer.render(samples=settings.samples, seed=settings.seed)
            shown, share = wall, ""
            images.store(images.WALL, wall)
            if settings.difference:
                # The same noise in both, so that it cancels wherever the object changes nothing.
                shown = wall - renderer.render(samples=settings.samples, seed=settings.seed, target=False)
                images.store(images.DIFFERENCE, shown)
                if wall.any():
                    share = f", of which the object adds {shown.mean() / wall.mean():.2%}"
        images.show(images.preview(shown))
        return "INFO", f"Mean radiance {wall.mean():.4g} W/m²/sr{share}; shown brightened{chosen}"


_CLASSES = (NLOS_OT_build_scene, NLOS_OT_apply, NLOS_OT_read_scene, NLOS_OT_render_wall)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
