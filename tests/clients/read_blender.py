"""Run by an environment that has bpy: a BVH, glTF, USD or FBX file, imported as Blender does it; places of bones in
every frame, and pixels of points through every camera, as JSON. Arguments: the file, a JSON file with a list of points
for each frame, the frame rate, width and height of the pictures."""

import json
import sys
from pathlib import Path

import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

path, points, rate, width, height = (
    Path(sys.argv[1]),
    json.loads(Path(sys.argv[2]).read_text()),
    *map(float, sys.argv[3:]),
)
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
scene.render.fps, scene.render.fps_base = round(rate), round(rate) / rate
importers = {
    ".bvh": lambda: bpy.ops.import_anim.bvh(filepath=str(path), global_scale=0.01, update_scene_fps=True),
    ".glb": lambda: bpy.ops.import_scene.gltf(filepath=str(path)),
    ".usda": lambda: bpy.ops.wm.usd_import(filepath=str(path)),
    ".fbx": lambda: bpy.ops.import_scene.fbx(filepath=str(path), ignore_leaf_bones=False),
}
importers[path.suffix]()
first = {".bvh": 1, ".glb": 0, ".usda": 0, ".fbx": 1}[path.suffix]
rig = next((thing for thing in scene.objects if thing.type == "ARMATURE"), None)
skin = next((thing for thing in scene.objects if thing.type == "MESH"), None)
bones, pixels, meshes = [], [], []
for frame, row in enumerate(points):
    scene.frame_set(first + frame)
    if rig is not None:
        bones.append({bone.name: list(rig.matrix_world @ bone.head) for bone in rig.pose.bones})
    if skin is not None:
        posed = skin.evaluated_get(bpy.context.evaluated_depsgraph_get())
        meshes.append([list(posed.matrix_world @ vertex.co) for vertex in list(posed.data.vertices)[::40]])
    seen = {}
    for thing in scene.objects:
        if thing.type == "CAMERA":
            views = [world_to_camera_view(scene, thing, Vector(point)) for point in row]
            seen[thing.name] = [[view.x * width, (1 - view.y) * height] for view in views]
    pixels.append(seen)
rates = scene.render.fps / scene.render.fps_base
print("\n" + json.dumps({"bones": bones, "pixels": pixels, "skin": meshes, "rate": rates}))
