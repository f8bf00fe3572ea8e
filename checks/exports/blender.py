"""Opens BVH, GLB, the script and the .chan files in Blender: blender --background --python blender.py -- RESULT EXPORTS."""

import json
import sys

import addon_utils
import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

RESULT, EXPORTS = sys.argv[sys.argv.index("--") + 1 :][:2]
JOINT_TOLERANCE = 0.5e-3  # m
PIXEL_TOLERANCE = 0.1


def read(name):
    with open(f"{RESULT}/{name}") as file:
        return json.load(file)


PUBLISH, POSES, PEOPLE = read("manifest.json")["publish"], read("poses3d.json"), read("people.json")["people"]
CAMERAS = [camera for camera in read("cameras.json")["cameras"] if camera["status"] == "solved"]
FIRST = PUBLISH["frame_range"][0]


def z_up(point):
    x, y, z = point
    return Vector((x, -z, y)) if PUBLISH["up_axis"] == "y" else Vector((x, y, z))


def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = round(PUBLISH["fps"])
    bpy.context.scene.render.fps_base = round(PUBLISH["fps"]) / PUBLISH["fps"]


def worst_joint(person, armature, first_shown):
    """Largest distance of bone heads; `first_shown`: the scene's frame at which the session's first is shown."""
    worst = 0.0
    for frame in person["frames"]:
        bpy.context.scene.frame_set(frame - FIRST + first_shown)
        for name, joint in zip(POSES["joint_names"], POSES["frames"][str(frame)][str(person["id"])]):
            place = armature.matrix_world @ armature.pose.bones[name].head
            worst = max(worst, (place - z_up(joint)).length)
    return worst


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


def report(name, joint, pixel=0.0):
    good = joint <= JOINT_TOLERANCE and pixel <= PIXEL_TOLERANCE
    print(f"{'ok' if good else 'FAILED'} blender {name}: {1e3 * joint:.5f} mm, {pixel:.6f} px", flush=True)
    return good


def patch_readers():
    """Blender 3.4 opens BVH files with a mode that Python 3.11 removed, and uses a type that numpy removed."""
    import numpy
    from io_anim_bvh import import_bvh

    import_bvh.open = lambda path, mode="r": open(path, mode.replace("U", ""))
    if "bool" not in vars(numpy):
        numpy.bool = bool


def check_bvh():
    joint = 0.0
    for person in PEOPLE:
        empty_scene()
        start = person["frames"][0] - FIRST + 1  # Blender starts no BVH before frame 1
        bpy.ops.import_anim.bvh(filepath=f"{EXPORTS}/{person['id']}.bvh", global_scale=0.01, frame_start=start)
        joint = max(joint, worst_joint(person, bpy.context.object, 1))
    return report("bvh", joint)


def check_glb():
    empty_scene()
    bpy.ops.import_scene.gltf(filepath=f"{EXPORTS}/scene.glb")
    objects = bpy.data.objects
    joint = max(worst_joint(person, objects[f"person_{person['id']}"], 0) for person in PEOPLE)
    pixel = max(worst_pixel(camera, objects[camera["id"]], False) for camera in CAMERAS)
    return report("glb", joint, pixel)


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


patch_readers()
if not all([check_bvh(), check_glb(), check_script(), check_chan()]):
    sys.exit(1)
