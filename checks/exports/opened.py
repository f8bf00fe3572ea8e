"""Runs a scene's script in Blender and requires its people, cameras and motion: opened.py -- SCENE.py"""

import os
import sys

import bpy

path = sys.argv[sys.argv.index("--") + 1]
bpy.ops.wm.read_factory_settings(use_empty=True)
with open(path) as file:
    exec(compile(file.read(), path, "exec"), {"__file__": path, "__name__": "__main__"})
scene = bpy.context.scene
people = [thing for thing in scene.objects if thing.type == "ARMATURE"]
cameras = [thing for thing in scene.objects if thing.type == "CAMERA"]
places = []
for frame in (scene.frame_start, scene.frame_end):
    scene.frame_set(frame)
    places.append([(thing.matrix_world @ bone.head).copy() for thing in people for bone in thing.pose.bones])
moved = max((a - b).length for a, b in zip(*places))
print(f"{len(people)} people, {len(cameras)} cameras, frames {scene.frame_start} to {scene.frame_end}, {moved:.2f} m of motion", flush=True)
os._exit(0 if people and len(cameras) >= 2 and moved > 0.05 else 1)  # Blender as a module can crash while Python ends it
