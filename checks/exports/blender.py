"""Opens BVH, GLB, FBX, USD, the script and the .chan files in Blender: blender --background --python blender.py -- RESULT EXPORTS.

With Blender as a Python module: python blender.py -- RESULT EXPORTS.
"""

import json
import os
import sys

import bpy
import addon_utils  # of Blender's own folder, which exists once bpy is imported
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

RESULT, EXPORTS = sys.argv[sys.argv.index("--") + 1 :][:2]
JOINT_TOLERANCE = 0.5e-3  # m
VERTEX_TOLERANCE = 1e-3  # m
PIXEL_TOLERANCE = 0.1


def read(name):
    with open(f"{RESULT}/{name}") as file:
        return json.load(file)


PUBLISH, POSES, PEOPLE = read("manifest.json")["publish"], read("poses3d.json"), read("people.json")["people"]
CAMERAS = [camera for camera in read("cameras.json")["cameras"] if camera["status"] == "solved"]
FIRST, LAST = PUBLISH["frame_range"]
SKIN = read("vertices.json")  # of vertices.py


def z_up(point):
    x, y, z = point
    return Vector((x, -z, y)) if PUBLISH["up_axis"] == "y" else Vector((x, y, z))


def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = round(PUBLISH["fps"])
    bpy.context.scene.render.fps_base = round(PUBLISH["fps"]) / PUBLISH["fps"]


def show(frame, first_shown):
    """Shows a frame of the session; `first_shown`: the scene's frame at which the session's first is shown."""
    bpy.context.scene.frame_set(frame - FIRST + first_shown)


def worst_joint(person, armature, first_shown, namespace=""):
    """Largest distance of bone heads."""
    worst = 0.0
    for frame in person["frames"]:
        show(frame, first_shown)
        for name, joint in zip(POSES["joint_names"], POSES["frames"][str(frame)][str(person["id"])]):
            place = armature.matrix_world @ armature.pose.bones[namespace + name].head
            worst = max(worst, (place - z_up(joint)).length)
    return worst


def worst_vertex(person, mesh, first_shown):
    """Largest distance of vertices after all modifiers."""
    worst = 0.0
    for frame, expected in SKIN["people"][str(person["id"])].items():
        show(int(frame), first_shown)
        shown = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
        for vertex, place in zip(SKIN["vertices"], expected):
            worst = max(worst, (shown.matrix_world @ shown.data.vertices[vertex].co - z_up(place)).length)
    return worst


def worst_gap(armature):
    """Largest distance of a bone's tail from its only child's head: the skeleton looks connected."""
    bones = [bone for bone in armature.data.bones if len(bone.children) == 1]
    assert len(bones) >= 14
    return max((bone.tail_local - bone.children[0].head_local).length for bone in bones)


def keyed_frames(*objects):
    """First and last key of all actions."""
    ranges = [thing.animation_data.action.frame_range for thing in objects]
    return min(start for start, _ in ranges), max(end for _, end in ranges)


def worst_pixel(camera, thing, principal_point, pixel_aspect=True):
    """Largest distance of projections, without distortion and other parameters that the format does not support."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = camera["width"], camera["height"]
    k, pose = [list(row) for row in camera["K"]], Matrix(camera["R"])
    if not pixel_aspect:
        k[0][0] = k[1][1]
    # The pixel aspect belongs to the scene, not to the camera.
    scene.render.pixel_aspect_x = max(1.0, k[1][1] / k[0][0])
    scene.render.pixel_aspect_y = max(1.0, k[0][0] / k[1][1])
    centre = (k[0][2], k[1][2]) if principal_point else ((camera["width"] - 1) / 2, (camera["height"] - 1) / 2)
    worst = 0.0
    for people in POSES["frames"].values():
        for joint in (joint for joints in people.values() for joint in joints):
            p = pose @ Vector(joint) + Vector(camera["t"])
            if p.z < 0.1:
                continue
            ours = (k[0][0] * p.x / p.z + centre[0], k[1][1] * p.y / p.z + centre[1])
            seen = world_to_camera_view(scene, thing, z_up(joint))
            theirs = (seen.x * camera["width"] - 0.5, (1.0 - seen.y) * camera["height"] - 0.5)
            worst = max(worst, (Vector(ours) - Vector(theirs)).length)
    return worst


def report(name, joint, pixel=0.0, vertex=0.0, gap=0.0):
    good = max(joint, gap) <= JOINT_TOLERANCE and vertex <= VERTEX_TOLERANCE and pixel <= PIXEL_TOLERANCE
    lengths = f"joints {1e3 * joint:.5f} mm, vertices {1e3 * vertex:.5f} mm, bones' tails {1e3 * gap:.5f} mm"
    print(f"{'ok' if good else 'FAILED'} blender {name}: {lengths}, {pixel:.6f} px", flush=True)
    return good


def patch_readers():
    """Blender 3.4 opens BVH files with a mode that Python 3.11 removed, and uses a type that numpy removed."""
    for reader in ["io_anim_bvh", "io_scene_gltf2", "io_scene_fbx"]:
        addon_utils.enable(reader)
    import numpy
    from io_anim_bvh import import_bvh

    import_bvh.open = lambda path, mode="r": open(path, mode.replace("U", ""))
    if "bool" not in vars(numpy):
        numpy.bool = bool


def check_bvh():
    joint = 0.0
    for person in PEOPLE:
        empty_scene()
        bpy.ops.import_anim.bvh(filepath=f"{EXPORTS}/{person['id']}.bvh", global_scale=0.01, frame_start=1)
        armature = bpy.context.object
        assert keyed_frames(armature) == (1, LAST - FIRST + 1), keyed_frames(armature)
        joint = max(joint, worst_joint(person, armature, 1))
    return report("bvh", joint)


def check_glb():
    empty_scene()
    bpy.ops.import_scene.gltf(filepath=f"{EXPORTS}/scene.glb")
    objects = bpy.data.objects
    joint = vertex = gap = 0.0
    for person in PEOPLE:
        name = f"person_{person['id']}"
        start, end = keyed_frames(objects[name])
        assert abs(start) < 1e-3 and abs(end - (LAST - FIRST)) < 1e-3, (start, end)
        joint = max(joint, worst_joint(person, objects[name], 0))
        vertex = max(vertex, worst_vertex(person, objects[f"{name}_body"], 0))
        gap = max(gap, worst_gap(objects[name]))
    pixel = max(worst_pixel(camera, objects[camera["id"]], False) for camera in CAMERAS)
    return report("glb", joint, pixel, vertex, gap)


def check_fbx():
    """All people from one file; Blender puts time 0 at frame 1."""
    empty_scene()
    bpy.ops.import_scene.fbx(filepath=f"{EXPORTS}/scene.fbx")
    joint = vertex = gap = 0.0
    for person in PEOPLE:
        name = f"person_{person['id']}"
        armature, mesh = bpy.data.objects[name], bpy.data.objects[f"{name}_body"]
        start, end = keyed_frames(armature)
        assert abs(start - FIRST - 1) < 1e-3 and abs(end - LAST - 1) < 1e-3, (start, end)
        joint = max(joint, worst_joint(person, armature, FIRST + 1, f"{name}:"))
        vertex = max(vertex, worst_vertex(person, mesh, FIRST + 1))
        gap = max(gap, worst_gap(armature))
    return report("fbx", joint, 0.0, vertex, gap)


def check_fbx_names():
    """One person with the names that retargeting expects."""
    profiles = {"humanik": "LeftForeArm", "mixamo": "mixamorig:LeftForeArm", "unreal": "lowerarm_l"}
    for profile, elbow in profiles.items():
        empty_scene()
        bpy.ops.import_scene.fbx(filepath=f"{EXPORTS}/{PEOPLE[0]['id']}.{profile}.fbx")
        armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
        assert len(armatures) == 1 and elbow in armatures[0].pose.bones, profile
    return report("fbx names", 0.0)


def check_usd():
    """Blender shows USD's time codes at the frames of the same number."""
    if bpy.app.version < (4, 1):
        print("skipped: blender usd: this version reads no skeletons")
        return True
    empty_scene()
    bpy.ops.wm.usd_import(filepath=f"{EXPORTS}/scene.usda")
    joint = vertex = gap = 0.0
    for person in PEOPLE:
        name = f"person_{person['id']}"
        armature, mesh = bpy.data.objects[f"{name}_skeleton"], bpy.data.objects[f"{name}_body"]
        joint = max(joint, worst_joint(person, armature, FIRST))
        vertex = max(vertex, worst_vertex(person, mesh, FIRST))
        gap = max(gap, worst_gap(armature))
    return report("usd", joint, 0.0, vertex, gap)


def check_script():
    empty_scene()
    with open(f"{EXPORTS}/scene.py") as file:
        exec(compile(file.read(), "scene.py", "exec"), {})
    scene, objects = bpy.context.scene, bpy.data.objects
    assert [scene.frame_start, scene.frame_end] == PUBLISH["frame_range"]
    joint = max(worst_joint(person, objects[f"person_{person['id']}"], FIRST) for person in PEOPLE)
    for person in PEOPLE:
        scene.frame_set(person["frames"][-1])
        assert not objects[f"person_{person['id']}"].hide_viewport
        if person["frames"][-1] < PUBLISH["frame_range"][1]:
            scene.frame_set(person["frames"][-1] + 1)
            assert objects[f"person_{person['id']}"].hide_viewport
    scene.frame_set(FIRST)
    pixel = max(worst_pixel(camera, objects[camera["id"]], True) for camera in CAMERAS)
    return report("scene.py", joint, pixel)


def check_chan():
    if "io_anim_nuke_chan" not in {module.__name__ for module in addon_utils.modules()}:
        print("skipped: blender chan: its reader is not installed")
        return True
    pixel = 0.0
    for camera in CAMERAS:
        empty_scene()
        addon_utils.enable("io_anim_nuke_chan")
        thing = bpy.data.objects.new(camera["id"], bpy.data.cameras.new(camera["id"]))
        bpy.context.scene.collection.objects.link(thing)
        bpy.context.view_layer.objects.active = thing
        height = 36.0 * camera["height"] / camera["width"]
        path = f"{EXPORTS}/{camera['id']}.chan"
        options = {"z_up": True, "rotation_order": "ZXY", "sensor_width": 36.0, "sensor_height": height}
        bpy.ops.import_scene.import_chan(filepath=path, **options)
        pixel = max(pixel, worst_pixel(camera, thing, False, pixel_aspect=False))
    return report("chan", 0.0, pixel)


if __name__ == "__main__":
    patch_readers()
    checks = [check_bvh, check_glb, check_fbx, check_fbx_names, check_usd, check_script, check_chan]
    scenes = [check() for check in checks]
    sys.stdout.flush()
    os._exit(0 if all(scenes) else 1)  # Blender as a module can crash while Python ends it
