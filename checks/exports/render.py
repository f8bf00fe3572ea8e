"""Renders GLB, FBX, USD, BVH and the script for Blender from one place, with meshes where a format has them.

render.py -- RESULT EXPORTS PREFIX writes PREFIX_FORMAT.png. All pictures show the same frame from the same place, so that they can be compared by eye; the
check compares them with each other: the people of every format must cover the same part of the picture.
"""

import json
import os
import sys

import bpy
import numpy as np
from mathutils import Vector

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import blender as scenes

PREFIX = sys.argv[sys.argv.index("--") + 3]
WIDTH, HEIGHT = 480, 360
#: Least common part of the silhouettes of two formats with the same body, intersection over union.
MIN_OVERLAP = 0.97
#: The middle one of the frames with the most people.
COUNTS = {frame: sum(frame in person["frames"] for person in scenes.PEOPLE) for frame in map(int, scenes.POSES["frames"])}
FULL = sorted(frame for frame, count in COUNTS.items() if count == max(COUNTS.values()))
FRAME = FULL[len(FULL) // 2]
#: Formats differ in how they show a person that is absent: here none is drawn.
ABSENT = [f"person_{person['id']}" for person in scenes.PEOPLE if FRAME not in person["frames"]]


def people_now():
    joints = scenes.POSES["frames"][str(FRAME)].values()
    return [scenes.z_up(joint) for person in joints for joint in person]


def sticks(armature):
    """Bones have no surface: a thin mesh at every bone of the shown pose."""
    for bone in armature.pose.bones:
        head, tail = (armature.matrix_world @ end for end in (bone.head, bone.tail))
        axis = tail - head
        if axis.length < 1e-6:
            continue
        bpy.ops.mesh.primitive_cylinder_add(radius=0.02, depth=axis.length, location=(head + tail) / 2)
        stick = bpy.context.object
        stick.rotation_mode = "QUATERNION"
        stick.rotation_quaternion = axis.to_track_quat("Z", "Y")


def picture(name, has_bodies):
    """Renders the scene and returns the mask of the people."""
    scene = bpy.context.scene
    points = people_now()
    centre = sum(points, Vector()) / len(points)
    reach = max((point - centre).length for point in points)
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    eye.location = centre + Vector((0.6, -1.0, 0.35)).normalized() * (3.0 * reach + 1.2)
    eye.rotation_euler = (centre - eye.location).to_track_quat("-Z", "Y").to_euler()
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.rotation_euler, sun.data.energy = (0.7, 0.2, 0.4), 3.0
    for thing in (eye, sun):
        scene.collection.objects.link(thing)
    scene.camera, scene.world = eye, bpy.data.worlds.new("grey")
    scene.world.color = (0.2, 0.2, 0.22)
    for thing in scene.objects:
        thing.hide_render = any(thing.name == name or thing.name.startswith(f"{name}_") for name in ABSENT)
    for thing in [t for t in scene.objects if t.type == "ARMATURE" and not t.hide_render]:
        if not has_bodies:
            sticks(thing)
        thing.hide_render = True
    for thing in scene.objects:
        # Cameras and floors of the scene are no people.
        thing.hide_render = thing.hide_render or (thing.type == "MESH" and has_bodies and "body" not in thing.name.lower())
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 12, "CPU"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0
    scene.render.film_transparent = True
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.render.filepath = f"{PREFIX}_{name}.png"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    return np.array(image.pixels[:]).reshape(HEIGHT, WIDTH, 4)[..., 3] > 0.5


def rendered(name, has_bodies, load, first_shown):
    scenes.empty_scene()
    load()
    scenes.show(FRAME, first_shown)
    return picture(name, has_bodies)


def bvh():
    for person in [person for person in scenes.PEOPLE if FRAME in person["frames"]]:
        bpy.ops.import_anim.bvh(filepath=f"{scenes.EXPORTS}/{person['id']}.bvh", global_scale=0.01, frame_start=1)


def script():
    with open(f"{scenes.EXPORTS}/scene.py") as file:
        exec(compile(file.read(), "scene.py", "exec"), {})


scenes.patch_readers()
masks = {
    "glb": rendered("glb", True, lambda: bpy.ops.import_scene.gltf(filepath=f"{scenes.EXPORTS}/scene.glb"), 0),
    "fbx": rendered("fbx", True, lambda: bpy.ops.import_scene.fbx(filepath=f"{scenes.EXPORTS}/scene.fbx"), scenes.FIRST + 1),
}
if bpy.app.version >= (4, 1):
    masks["usd"] = rendered("usd", True, lambda: bpy.ops.wm.usd_import(filepath=f"{scenes.EXPORTS}/scene.usda"), scenes.FIRST)
bones = {
    "bvh": rendered("bvh", False, bvh, 1),
    "script": rendered("script", False, script, scenes.FIRST),
}
good = True
for name, mask in masks.items():
    overlap = (mask & masks["glb"]).sum() / max((mask | masks["glb"]).sum(), 1)
    holds = overlap >= MIN_OVERLAP and mask.mean() > 0.005
    good &= holds
    print(f"{'ok' if holds else 'FAILED'} render {name}: {100 * mask.mean():.2f} % of the picture, overlap with glb {overlap:.4f}", flush=True)
body = masks["glb"]
for name, mask in bones.items():
    inside = (mask & body).sum() / max(mask.sum(), 1)
    holds = inside >= 0.8 and mask.sum() > 100
    good &= holds
    print(f"{'ok' if holds else 'FAILED'} render {name}: {100 * inside:.1f} % of the bones inside the bodies", flush=True)
sys.stdout.flush()
os._exit(0 if good else 1)  # Blender as a module can crash while Python ends it
