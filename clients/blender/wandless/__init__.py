"""Wandless in Blender: imports results (cameras, people, points), submits sessions and follows their jobs."""

import bpy

from . import operators, panel

bl_info = {
    "name": "Wandless",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "category": "Import-Export",
    "location": "View3D > Sidebar > Wandless",
    "description": "Imports moving people and their cameras, and submits sessions",
}

CLASSES = (*operators.CLASSES, *panel.CLASSES)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.wandless = bpy.props.PointerProperty(type=panel.WandlessSettings)


def unregister():
    operators.stop_following()
    del bpy.types.Scene.wandless
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
