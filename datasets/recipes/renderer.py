"""Cycles as a function from (camera, light, seed) to passes. CPU, no denoiser, no clamping, one-pixel box filter."""

import tempfile
from pathlib import Path

import bpy
import numpy as np
from cameras import FIELD_OF_VIEW
from exr import read_planes
from numpy.typing import NDArray
from passes import Passes

# isort: split
from mathutils import Matrix  # can be imported only once bpy is

BOUNCES = 4
AOVS = {"albedo": "COLOR", "normal": "COLOR", "roughness": "VALUE", "metallic": "VALUE", "depth": "VALUE"}


class Renderer:
    """Renders views of what is in the Blender scene; geometry, textures and light stay loaded between views."""

    def __init__(self, size: int, threads: int = 0) -> None:
        """Set up Cycles for square images of `size` pixels on `threads` CPU threads (0: all)."""
        self._scratch = tempfile.TemporaryDirectory(prefix="render-")
        self._file = Path(self._scratch.name) / "passes.exr"
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.cycles.device = "CPU"
        self._integrator(scene.cycles)
        if threads:
            scene.render.threads_mode, scene.render.threads = "FIXED", threads
        self._film(scene, size)
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        camera.data.sensor_fit, camera.data.angle = "HORIZONTAL", FIELD_OF_VIEW
        scene.collection.objects.link(camera)
        scene.camera = camera
        self._environment = self._world(scene)

    @staticmethod
    def _integrator(cycles: bpy.types.PropertyGroup) -> None:
        cycles.transmission_bounces = cycles.volume_bounces = cycles.transparent_max_bounces = 0
        cycles.caustics_reflective = cycles.caustics_refractive = True
        cycles.blur_glossy = 0.0
        cycles.sampling_pattern = "TABULATED_SOBOL"  # a third less noise than the default at some hundred samples
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
        cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_guiding = False
        cycles.use_light_tree = False
        cycles.light_sampling_threshold = 0.0

    def _film(self, scene: bpy.types.Scene, size: int) -> None:
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
        scene.render.film_transparent = True
        scene.render.resolution_x = scene.render.resolution_y = size
        scene.render.resolution_percentage = 100
        scene.render.use_persistent_data = True
        scene.render.use_compositing = scene.render.use_sequencer = False
        scene.render.filepath = str(self._file)
        settings = scene.render.image_settings
        settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
        layer = scene.view_layers[0]
        layer.use_pass_z = False
        layer.use_pass_glossy_direct = layer.use_pass_glossy_color = True
        for name, kind in AOVS.items():
            aov = layer.aovs.add()
            aov.name, aov.type = name, kind

    @staticmethod
    def _world(scene: bpy.types.Scene) -> bpy.types.ShaderNode:
        world = scene.world = bpy.data.worlds.new("light")
        world.use_nodes = True
        world.cycles.sampling_method = "MANUAL"
        environment = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
        environment.interpolation, environment.projection = "Closest", "EQUIRECTANGULAR"
        world.node_tree.links.new(environment.outputs["Color"], world.node_tree.nodes["Background"].inputs["Color"])
        return environment

    def set_light(self, path: Path) -> None:
        """Light the scene by a lat-long EXR file, importance sampled at its own resolution."""
        image = bpy.data.images.load(str(path.resolve()), check_existing=True)  # each file is read once
        image.colorspace_settings.name = "Non-Color"
        self._environment.image = image
        bpy.context.scene.world.cycles.sample_map_resolution = image.size[0]

    def render(self, pose: NDArray[np.float64], samples: int, seed: int = 0, *, direct_only: bool = False) -> Passes:
        """Render from an OpenGL camera-to-world pose (4, 4) with `samples` paths a pixel.

        `direct_only` keeps only light that arrives at the object unreflected.
        """
        scene = bpy.context.scene
        bounces = 0 if direct_only else BOUNCES
        scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = bounces
        scene.camera.matrix_world = Matrix(pose.tolist())
        scene.cycles.samples, scene.cycles.seed = samples, seed
        scene.update_tag()  # with persistent data, Cycles would not see the new sample count and seed otherwise
        bpy.ops.render.render(write_still=True)
        planes = {name.split(".", 1)[1]: plane for name, plane in read_planes(self._file).items()}

        def stack(name: str, channels: str) -> NDArray[np.float32]:
            return np.stack([planes[f"{name}.{channel}"] for channel in channels], axis=-1)

        return Passes(
            rgba=stack("Combined", "RGBA"),
            specular=stack("GlossDir", "RGB") * stack("GlossCol", "RGB"),
            albedo=stack("albedo", "RGB"),
            normal=stack("normal", "RGB"),
            roughness=planes["roughness.X"],
            metallic=planes["metallic.X"],
            depth=planes["depth.X"],
        )
