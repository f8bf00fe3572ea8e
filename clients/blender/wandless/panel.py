"""The panel in the sidebar of the 3D view, and its settings."""

import bpy


class WandlessSettings(bpy.types.PropertyGroup):
    server: bpy.props.StringProperty(name="Service", default="http://127.0.0.1:8700")
    # The key is not written into .blend files, which people share.
    key: bpy.props.StringProperty(name="Key", subtype="PASSWORD", options={"SKIP_SAVE"})
    session: bpy.props.StringProperty(name="Session", description="Folder, zip file or document of 2D poses", subtype="FILE_PATH")
    options: bpy.props.StringProperty(name="Options", description="Options of the job as a JSON object", default="{}")
    with_people: bpy.props.BoolProperty(name="People", default=True)
    with_points: bpy.props.BoolProperty(name="Points", default=True)
    progress: bpy.props.FloatProperty(min=0.0, max=1.0, options={"SKIP_SAVE"})
    status: bpy.props.StringProperty(options={"SKIP_SAVE"})
    result: bpy.props.StringProperty(options={"SKIP_SAVE"})


class WANDLESS_PT_panel(bpy.types.Panel):
    bl_idname = "WANDLESS_PT_panel"
    bl_label = "Wandless"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Wandless"

    def draw(self, context):
        settings, layout = context.scene.wandless, self.layout
        layout.operator("wandless.import_result", text="Import Result", icon="IMPORT")
        column = layout.column()
        for name in ("server", "key", "session", "options"):
            column.prop(settings, name)
        row = layout.row()
        row.prop(settings, "with_people")
        row.prop(settings, "with_points")
        layout.operator("wandless.submit", icon="EXPORT")
        layout.operator("wandless.cancel", icon="CANCEL")
        if settings.status:
            layout.progress(factor=settings.progress, text=settings.status)
            layout.label(text=settings.status)


CLASSES = (WandlessSettings, WANDLESS_PT_panel)
