"""Objects of a take in Blender's scene: cameras, people, points. Frames have the session's numbers."""

import math

import bpy
from mathutils import Matrix, Vector

SENSOR_WIDTH_MM = 36.0
POINT_SIZE = 0.02  # m


def build(take, with_people=True, with_points=True):
    """Adds a take to the scene, in a collection of its own; returns the collection."""
    set_scene(take)
    collection = bpy.data.collections.new(take.name)
    bpy.context.scene.collection.children.link(collection)
    cameras = add_cameras(take, child(collection, "cameras"))
    if with_people and take.people:
        add_people(take, child(collection, "people"))
    if with_points:
        add_points(take, child(collection, "points"))
    if cameras:
        bpy.context.scene.camera = cameras[0]
    bpy.context.scene.frame_set(take.frame_range[0])
    return collection


def child(collection, name):
    """A collection below another one."""
    made = bpy.data.collections.new(name)
    collection.children.link(made)
    return made


def set_scene(take):
    scene = bpy.context.scene
    scene.render.fps = max(round(take.fps), 1)
    scene.render.fps_base = scene.render.fps / take.fps
    scene.frame_start, scene.frame_end = take.frame_range
    if take.frame_range[0] < 0:  # Blender renders from frame 0 on and would play from there, too
        scene.use_preview_range = True
        scene.frame_preview_start, scene.frame_preview_end = take.frame_range
    if take.cameras:
        first = take.cameras[0]
        scene.render.resolution_x, scene.render.resolution_y = first["width"], first["height"]
        aspect = first["K"][0][0] / first["K"][1][1]
        # Only the ratio matters; Blender requires both to be at least 1.
        scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1.0, 1.0 / aspect), max(1.0, aspect)


def blender_from_take(take):
    """Blender's world has z up."""
    return Matrix.Rotation(math.pi / 2.0, 4, "X") if take.up_axis == "y" else Matrix.Identity(4)


def add_cameras(take, collection):
    turn = blender_from_take(take)
    return [add_camera(camera, turn, collection) for camera in take.cameras]


def add_camera(camera, turn, collection):
    """A camera with the principal point as its shift; the distortion is a custom property, since Blender's lens has none."""
    (fx, _, cx), (_, fy, cy), _ = camera["K"]
    width, height = camera["width"], camera["height"]
    lens = bpy.data.cameras.new(camera["id"])
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", SENSOR_WIDTH_MM
    lens.lens = fx * SENSOR_WIDTH_MM / width
    # The centre of the image is ((w - 1) / 2, (h - 1) / 2); both shifts are in widths of the sensor.
    lens.shift_x = ((width - 1.0) / 2.0 - cx) / width
    lens.shift_y = (cy - (height - 1.0) / 2.0) / width * (fx / fy)
    lens.clip_start = 0.01
    camera_from_world = Matrix(camera["R"]).to_4x4()
    camera_from_world.translation = Vector(camera["t"])
    camera_from_film = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
    placed = bpy.data.objects.new(camera["id"], lens)
    collection.objects.link(placed)
    placed.matrix_world = turn @ camera_from_world.inverted() @ camera_from_film
    placed["K"] = [value for row in camera["K"] for value in row]
    placed["dist"], placed["width"], placed["height"] = camera["dist"], width, height
    return placed


def add_people(take, collection):
    """Armatures with skinned meshes, from the result's glTF scene."""
    before = {kind: set(getattr(bpy.data, kind)) for kind in ("objects", "actions", "cameras")}
    frames_per_key = import_people(take)
    new = {kind: [thing for thing in getattr(bpy.data, kind) if thing not in known] for kind, known in before.items()}
    # glTF cameras have no principal point: those of the take replace them.
    roots = [thing for thing in new["objects"] if thing.type == "CAMERA" or is_empty_parent(thing)]
    for thing in roots:
        bpy.data.objects.remove(thing)
    for lens in new["cameras"]:
        bpy.data.cameras.remove(lens)
    for action in new["actions"]:
        to_frames(action, frames_per_key, take.frame_range[0])
    for thing in bpy.data.objects:
        if thing not in before["objects"]:
            move_to(thing, collection)


def import_people(take):
    """Imports the scene; returns the frames of the take per frame of its keys.

    Blender multiplies the times of keys by `fps * fps_base`, not by the rate `fps / fps_base`: at 29.97 frames per second, keys
    would be two frames late after a thousand.
    """
    render = bpy.context.scene.render
    fps, base = render.fps, render.fps_base
    render.fps_base = 1.0
    try:
        bpy.ops.import_scene.gltf(filepath=str(take.scene))
    finally:
        render.fps, render.fps_base = fps, base
    return take.fps / fps


def is_empty_parent(thing):
    """Whether an object only held a camera."""
    return thing.type == "EMPTY" and bool(thing.children) and all(below.type == "CAMERA" for below in thing.children)


def move_to(thing, collection):
    for other in list(thing.users_collection):
        other.objects.unlink(thing)
    collection.objects.link(thing)


def curves(action):
    """All curves of an action; since Blender 4.4 they lie in its layers."""
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    strips = [strip for layer in action.layers for strip in layer.strips]
    return [curve for strip in strips for bag in strip.channelbags for curve in bag.fcurves]


def to_frames(action, frames_per_key, first):
    """Puts the keys of an action, which begins at 0, on the frames of the take, which begins at `first`."""
    for curve in curves(action):
        for key in curve.keyframe_points:
            before = key.co.x
            after = round(before * frames_per_key) + first  # times in the file have single precision
            left, right = key.handle_left.x, key.handle_right.x
            key.co.x = after
            key.handle_left.x = after + (left - before) * frames_per_key
            key.handle_right.x = after + (right - before) * frames_per_key
        curve.update()


def add_points(take, collection):
    """An animated empty per keypoint of each person: the detector's own points in space."""
    turn = blender_from_take(take)
    frames = sorted(take.keypoints, key=int)
    for person in sorted({number for people in take.keypoints.values() for number in people}, key=int):
        name = next((one.get("name") for one in take.people if str(one["id"]) == person), None) or f"person_{person}"
        for k, keypoint in enumerate(take.keypoint_names):
            places = [(int(frame), take.keypoints[frame].get(person)) for frame in frames]
            known = [(frame, points[k]) for frame, points in places if points and points[k]]
            if known:
                add_point(f"{name}_{keypoint}", [(frame, turn @ Vector(place)) for frame, place in known], collection)


def add_point(name, places, collection):
    point = bpy.data.objects.new(name, None)
    point.empty_display_type, point.empty_display_size = "SPHERE", POINT_SIZE
    collection.objects.link(point)
    point.location = places[0][1]
    point.keyframe_insert("location", frame=places[0][0])  # makes the action with its three curves
    for axis, curve in enumerate(curves(point.animation_data.action)):
        curve.keyframe_points.add(len(places) - 1)
        flat = [value for frame, place in places for value in (frame, place[axis])]
        curve.keyframe_points.foreach_set("co", flat)
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
        curve.update()
