"""Operators: import of a result, submission of a session, end of a job."""

import json
import queue
import tempfile
import threading

import bpy

from . import build, service, take

POLL_S = 0.5

_work = None  # the submission that is followed


def import_result(folder, with_people=True, with_points=True):
    """Imports the result in a folder; raises `TakeError`."""
    found = take.read_take(folder)
    if with_people and found.people and found.scene is None:
        raise take.TakeError(
            f"{folder} has no scene.glb; write it with `wandless export {folder} --to glb`, or import without people"
        )
    return build.build(found, with_people, with_points)


class Submission:
    """A session on its way through the service, worked on by a thread that never touches Blender's data."""

    def __init__(self, client, session, options):
        self.client, self.session, self.options = client, session, options
        self.job, self.is_stopped, self.is_canceled = None, threading.Event(), threading.Event()
        self.news = queue.Queue()  # (kind, value): "progress", "done" or "failed"
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        try:
            self.news.put(("progress", (0.0, "uploading the session")))
            stored = self.client.upload(self.session)
            if self.is_canceled.is_set():
                return
            job = self.client.submit(stored["id"], self.options)
            self.job = job["id"]
            if self.is_canceled.is_set():
                self.cancel()
            while job["state"] not in service.FINAL and not self.is_stopped.is_set():
                progress = job["progress"]
                done = progress["fraction"]
                self.news.put(("progress", (done, progress["message"] or progress["stage"] or job["state"])))
                on_silence = lambda why: self.news.put(("progress", (done, why)))  # noqa: E731
                job = self.client.next_state(self.job, self.is_stopped, on_silence)
            if job["state"] == "succeeded":
                self.news.put(("progress", (1.0, "downloading the result")))
                self.news.put(("done", self.client.download(self.job, tempfile.mkdtemp(prefix="wandless-"))))
            else:
                error = job["error"] or {}
                reason = "; ".join(filter(None, [error.get("detail"), error.get("remedy")]))
                self.news.put(("failed", f"the job is {job['state']}" + (f": {reason}" if reason else "")))
        except Exception as error:  # every end of the thread is shown to the user
            self.news.put(("failed", str(error)))

    def cancel(self):
        """Cancels the job; one that is not submitted yet will not be, or is canceled by the thread that submits it."""
        self.is_canceled.set()
        if self.job:
            threading.Thread(target=ignoring_errors(lambda: self.client.cancel(self.job)), daemon=True).start()


def stop_following():
    global _work
    if _work is not None:
        _work.is_stopped.set()
        _work = None


def take_news(work, settings):
    """Shows what has happened; returns whether the submission has ended."""
    while True:
        try:
            kind, value = work.news.get_nowait()
        except queue.Empty:
            return False
        if kind == "progress":
            settings.progress, settings.status = value
            continue
        if kind == "done":
            try:
                settings.result = str(value)
                import_result(value, settings.with_people, settings.with_points)
                settings.status = "imported"
            except take.TakeError as error:
                settings.status = str(error)
        else:
            settings.status = value
        return True


class WANDLESS_OT_import(bpy.types.Operator):
    """Imports cameras, people and points of a result folder"""

    bl_idname = "wandless.import_result"
    bl_label = "Import Wandless Result"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(name="Result folder", subtype="DIR_PATH")
    with_people: bpy.props.BoolProperty(name="People", description="Armatures with skinned meshes", default=True)
    with_points: bpy.props.BoolProperty(name="Points", description="The detector's own points in space", default=True)

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        try:
            import_result(bpy.path.abspath(self.directory), self.with_people, self.with_points)
        except take.TakeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class WANDLESS_OT_submit(bpy.types.Operator):
    """Sends the session to the service, follows its job and imports the result"""

    bl_idname = "wandless.submit"
    bl_label = "Submit Session"

    def execute(self, context):
        global _work
        settings = context.scene.wandless
        try:
            options = json.loads(settings.options or "{}")
        except ValueError as error:
            self.report({"ERROR"}, f"the options are not JSON: {error}")
            return {"CANCELLED"}
        stop_following()
        client = service.Service(settings.server, settings.key)
        _work = work = Submission(client, bpy.path.abspath(settings.session), options)
        work.thread.start()
        if bpy.app.background:  # timers do not run: wait here
            work.thread.join()
            take_news(work, settings)
            _work = None
            return {"FINISHED"} if settings.status == "imported" else self.failed(settings)
        scene = context.scene.name

        def poll():
            global _work
            found = bpy.data.scenes.get(scene)
            if _work is not work or found is None:
                return None
            if take_news(work, found.wandless):
                _work = None
                return None
            for window in bpy.context.window_manager.windows:
                for area in window.screen.areas:
                    area.tag_redraw()
            return POLL_S

        bpy.app.timers.register(poll, first_interval=POLL_S)
        return {"FINISHED"}

    def failed(self, settings):
        self.report({"ERROR"}, settings.status)
        return {"CANCELLED"}


class WANDLESS_OT_cancel(bpy.types.Operator):
    """Cancels the job that is followed"""

    bl_idname = "wandless.cancel"
    bl_label = "Cancel Job"

    @classmethod
    def poll(cls, context):
        return _work is not None

    def execute(self, context):
        work = _work
        stop_following()
        context.scene.wandless.status = "canceled"
        if work is not None:
            work.cancel()
        return {"FINISHED"}


def ignoring_errors(call):
    """The call without its errors: a job that has ended meanwhile cannot be canceled."""

    def run():
        try:
            call()
        except service.ServiceError:
            pass

    return run


CLASSES = (WANDLESS_OT_import, WANDLESS_OT_submit, WANDLESS_OT_cancel)
