"""The client of the add-on without Blender: python test_service.py"""

import http.server
import importlib.util
import json
import threading
from pathlib import Path

place = Path(__file__).resolve().parent.parent / "wandless" / "service.py"
spec = importlib.util.spec_from_file_location("service", place)
service = importlib.util.module_from_spec(spec)
spec.loader.exec_module(service)


class Failing(http.server.BaseHTTPRequestHandler):
    """Answers as the plan says; `close` ends the connection without an answer, `half` within it."""

    plan = []

    def do_GET(self):
        step = self.plan.pop(0) if self.plan else 200
        text = json.dumps({"id": "job_1"} if step == 200 else {"detail": "busy", "remedy": "wait"}).encode()
        if step != "close":
            self.send_response(step if isinstance(step, int) else 200)
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text[:4] if step == "half" else text)
        self.close_connection = True

    def log_message(self, *_):
        pass


def check_restart_does_not_end_the_follow_loop(client):
    Failing.plan, said = [503, "close", "half", 502], []
    service.RETRY_S = 0.01
    assert client.next_state("job_1", threading.Event(), said.append) == {"id": "job_1"}
    assert len(said) == 4 and all("trying again" in text for text in said), said


def check_patience_ends_and_refusals_are_final(client):
    service.PATIENCE_S, Failing.plan = 0.1, [503] * 1000
    for plan, expected in (([503] * 1000, "goes on in the service"), ([404], "busy")):
        Failing.plan = plan
        try:
            client.next_state("job_1", threading.Event(), lambda _: None)
            raise SystemExit("an answer was expected to be an error")
        except service.ServiceError as error:
            assert expected in str(error), error


listener = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Failing)
threading.Thread(target=listener.serve_forever, daemon=True).start()
client = service.Service(f"http://127.0.0.1:{listener.server_port}")
check_restart_does_not_end_the_follow_loop(client)
check_patience_ends_and_refusals_are_final(client)
listener.shutdown()
print("ok service")
