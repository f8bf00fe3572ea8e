import math

import bpy
from mathutils import Quaternion, Vector

LEAF_LENGTH = 0.08  # m: bones without a child are drawn this long


def quaternion(xyzw):
    x, y, z, w = xyzw
    return Quaternion((w, x, y, z))


def add_object(name, data, parent):
    """Adds an object to the scene's collection, with the axes of its parent."""
    obj = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(obj)
    obj.parent = parent
    return obj


def set_scene(take):
    scene = bpy.context.scene
    fps = round(take["fps"])
    scene.render.fps = max(fps, 1)
    scene.render.fps_base = scene.render.fps / take["fps"]
    scene.frame_start, scene.frame_end = take["frame_range"]
    if take["frame_range"][0] < 0:  # Blender renders from frame 0 on and would play from there, too
        scene.use_preview_range = True
        scene.frame_preview_start, scene.frame_preview_end = take["frame_range"]
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = 1.0
    if take["cameras"]:
        first = take["cameras"][0]
        scene.render.resolution_x, scene.render.resolution_y = first["width"], first["height"]
        scene.render.resolution_percentage = 100
        # Only the ratio matters; Blender requires both to be at least 1.
        scene.render.pixel_aspect_x = max(1.0, 1.0 / first["pixel_aspect"])
        scene.render.pixel_aspect_y = max(1.0, first["pixel_aspect"])


def add_camera(take_camera, world):
    lens = bpy.data.cameras.new(take_camera["id"])
    lens.sensor_fit = "HORIZONTAL"
    lens.sensor_width = take_camera["sensor_width_mm"]
    lens.lens = take_camera["focal_length_mm"]
    lens.shift_x, lens.shift_y = take_camera["shift"]
    lens.clip_start = 0.01
    camera = add_object(take_camera["id"], lens, world)
    camera.location = take_camera["location"]
    camera.rotation_mode = "QUATERNION"
    camera.rotation_quaternion = quaternion(take_camera["rotation_xyzw"])
    camera["width"], camera["height"] = take_camera["width"], take_camera["height"]
    camera["K"] = [value for row in take_camera["K"] for value in row]
    camera["distortion_model"], camera["dist"] = take_camera["distortion_model"], take_camera["dist"]
    return camera


def add_bones(armature, person, names, parents):
    """Adds bones from every joint to its first child; the rest pose is the T-pose."""
    rest = [Vector(joint) for joint in person["rest_joints"]]
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bones = []
    for joint, name in enumerate(names):
        bone = armature.data.edit_bones.new(name)
        child = next((c for c, parent in enumerate(parents) if parent == joint), None)
        bone.head = rest[joint]
        bone.tail = rest[child] if child is not None else rest[joint] + leaf(rest, joint, parents)
        if (bone.tail - bone.head).length < 1e-4:
            bone.tail = bone.head + Vector((0.0, LEAF_LENGTH, 0.0))
        if parents[joint] is not None:
            bone.parent = bones[parents[joint]]
        bones.append(bone)
    bpy.ops.object.mode_set(mode="OBJECT")


def leaf(rest, joint, parents):
    return (rest[joint] - rest[parents[joint]]).normalized() * LEAF_LENGTH


def animate(armature, person, names):
    """Keyframes of the local rotations, converted from axes parallel to the world to each bone's own axes."""
    first = person["first_frame"]
    for joint, name in enumerate(names):
        bone = armature.pose.bones[name]
        bone.rotation_mode = "QUATERNION"
        axes = bone.bone.matrix_local.to_quaternion()
        before = None
        for i, xyzw in enumerate(person["rotations_xyzw"][joint]):
            turn = axes.inverted() @ quaternion(xyzw) @ axes
            if before is not None and before.dot(turn) < 0.0:
                turn.negate()
            before = turn
            bone.rotation_quaternion = turn
            bone.keyframe_insert("rotation_quaternion", frame=first + i)
        if joint == 0:
            for i, place in enumerate(person["pelvis"]):
                bone.location = axes.inverted() @ (Vector(place) - bone.bone.head_local)
                bone.keyframe_insert("location", frame=first + i)


def show_while_present(armature, person, frame_range):
    first = person["first_frame"]
    last = first + len(person["pelvis"]) - 1
    spans = [(frame_range[0], True)] if first > frame_range[0] else []
    spans.append((first, False))
    spans += [(last + 1, True)] if last < frame_range[1] else []
    for frame, hidden in spans:
        armature.hide_viewport = armature.hide_render = hidden
        armature.keyframe_insert("hide_viewport", frame=frame)
        armature.keyframe_insert("hide_render", frame=frame)
    armature.hide_viewport = armature.hide_render = False


def add_person(person, take, world):
    name = person["name"]
    armature = add_object(name, bpy.data.armatures.new(name), world)
    add_bones(armature, person, take["joint_names"], take["parents"])
    animate(armature, person, take["joint_names"])
    armature["carried"] = person["carried"]
    show_while_present(armature, person, take["frame_range"])


def build(take):
    set_scene(take)
    world = add_object(take["name"] or "take", None, None)
    world.rotation_euler = (math.pi / 2.0, 0.0, 0.0)  # y up to z up
    cameras = [add_camera(camera, world) for camera in take["cameras"]]
    for person in take["people"]:
        add_person(person, take, world)
    if cameras:
        bpy.context.scene.camera = cameras[0]
    bpy.context.scene.frame_set(take["frame_range"][0])


build(TAKE)
