"""Uses every method of the Python client; arguments: server, session, result folder."""

import http.server
import os
import sys
import threading

import wandless

server, session, result = sys.argv[1:]
client = wandless.Client(server)
received = []


class Receiver(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        received.append((dict(self.headers), self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass


listener = http.server.HTTPServer(("127.0.0.1", 0), Receiver)
threading.Thread(target=listener.serve_forever, daemon=True).start()
hook = f"http://127.0.0.1:{listener.server_port}/hook"

stored = client.upload(session)
assert client.upload(session)["id"] == stored["id"]
assert client.inspect(stored["id"])["groups"]
job = client.submit(stored["id"], options={"extrinsics": "fixed"}, labels={"take": "7"}, webhook=hook, key="once")
assert client.submit(stored["id"], options={"extrinsics": "fixed"}, labels={"take": "7"}, webhook=hook, key="once")["id"] == job["id"]
events = list(client.events(job["id"]))
assert events[-1][0] == "state" and events[-1][1]["state"] == "succeeded", events[-1]
job = client.wait(job["id"])
names = client.download(job["id"], result)
assert "cameras.json" in names and os.path.exists(os.path.join(result, "manifest.json"))
assert [found["id"] for found in client.jobs(label="take=7")] == [job["id"]]
for _ in range(100):
    if received:
        break
    threading.Event().wait(0.1)
headers, body = received[0]
assert wandless.check_webhook(client.webhook_secret(), headers, body)
assert not wandless.check_webhook(client.webhook_secret(), headers, body + b" ")
secrets = [client.webhook_secret(), client.rotate_webhook_secret()]
while client.deliveries(job["id"])[0]["state"] != "delivered":
    threading.Event().wait(0.1)
client.redeliver(job["id"], client.deliveries(job["id"])[0]["id"])
for _ in range(100):
    if len(received) > 1:
        break
    threading.Event().wait(0.1)
assert secrets[0] != secrets[1] and all(wandless.check_webhook(secret, *received[1]) for secret in secrets)
try:
    client.submit("session_" + 32 * "0")
    raise SystemExit("a job without a session was accepted")
except wandless.Problem as problem:
    assert problem.status == 404 and problem.code == "session_not_found" and problem.remedy
client.delete_job(job["id"])
client.delete_session(stored["id"])
assert list(client.sessions()) == []
