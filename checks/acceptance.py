#!/usr/bin/env python3
"""The acceptance of the main job, over HTTP alone, on captures with truth.

    cargo build --release
    python3 checks/acceptance.py --data CAPTURES --score SCORE.py [--rows 3,7,10] [--seeds 20]

CAPTURES holds `shelf` and `simulated/{easy,paper,hard}` in the native layout with `gt/`; SCORE.py is an independent scoring
program (numpy). Only the standard library is used here. Prints one line per figure and its bound; exit code 1 if any fails.
"""
import argparse, hashlib, io, json, os, pathlib, resource, shutil, signal, socket, sqlite3, subprocess, sys, tempfile, time
import urllib.error, urllib.request, zipfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
FAILED = []


def say(row, what, value, good):
    print(f"row {row:>2}  {'ok  ' if good else 'FAIL'}  {what}: {value}", flush=True)
    if not good:
        FAILED.append((row, what))


class Server:
    def __init__(self, binary, data):
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.port = s.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self.data = data
        log = open(str(data) + ".log", "ab")
        self.process = subprocess.Popen([binary, "serve", "--data", str(data), "--listen", f"127.0.0.1:{self.port}"], stdout=log, stderr=log)
        for _ in range(200):
            try:
                urllib.request.urlopen(self.url + "/readyz", timeout=1)
                return
            except (urllib.error.URLError, ConnectionError, TimeoutError):
                time.sleep(0.05)
        raise SystemExit("the service does not become ready")

    def call(self, method, path, body=None, kind="application/json"):
        if body is not None and not isinstance(body, bytes):
            body = json.dumps(body).encode()
        request = urllib.request.Request(self.url + path, data=body, method=method, headers={"Content-Type": kind} if body is not None else {})
        try:
            with urllib.request.urlopen(request, timeout=120) as r:
                return r.status, r.read()
        except urllib.error.HTTPError as e:
            return e.code, e.read()

    def start(self, zipped, options):
        status, body = self.call("POST", "/v1/sessions", zipped, "application/zip")
        assert status in (200, 201), body
        status, body = self.call("POST", "/v1/jobs", {"session": json.loads(body)["id"], "options": options})
        assert status == 202, body
        return json.loads(body)["id"]

    def wait(self, job):
        while True:
            state = json.loads(self.call("GET", f"/v1/jobs/{job}?wait=5")[1])
            if state["state"] in ("succeeded", "failed", "canceled", "dead"):
                return state

    def artifacts(self, job):
        manifest = json.loads(self.call("GET", f"/v1/jobs/{job}/result")[1])
        return {f["name"]: self.call("GET", f"/v1/jobs/{job}/artifacts/{f['name']}")[1] for f in manifest["files"]}

    def solve(self, zipped, options):
        job = self.start(zipped, options)
        state = self.wait(job)
        assert state["state"] == "succeeded", state
        return job, state, self.artifacts(job)

    def stop(self):
        self.process.terminate()
        self.process.wait(20)


def read_session(folder):
    session = json.loads((folder / "session.json").read_text())
    poses = {c["id"]: json.loads((folder / "poses" / f"{c['id']}.json").read_text()) for c in session["cameras"]}
    return session, poses


def without_ids(poses):
    for camera in poses.values():
        for frame in camera["frames"]:
            for person in frame["people"]:
                person["track_id"] = None
    return poses


def zipped(session, poses):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as z:
        z.writestr("session.json", json.dumps(session))
        for camera, frames in poses.items():
            z.writestr(f"poses/{camera}.json", json.dumps(frames))
    return out.getvalue()


def score(args, folder, files, poses, joints, identities=False):
    with tempfile.TemporaryDirectory() as t:
        for name in ("cameras.json", poses, "identities.json"):
            pathlib.Path(t, name).write_bytes(files[name])
        command = [sys.executable, args.score, "--data", str(folder), "--cameras", f"{t}/cameras.json", "--poses", f"{t}/{poses}", "--pred-joints", joints, "--align", "sim3"]
        if identities:
            command += ["--identities", f"{t}/identities.json"]
        return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)


def rows_3_to_5(args, server):
    folder = args.data / "shelf"
    session, poses = read_session(folder)
    z = zipped(session, without_ids(poses))
    worst = {"mm": 0, "deg": 0, "rigid": 0, "kp": 999, "body": 999}
    covered = 0
    for seed in range(args.seeds):
        _, state, files = server.solve(z, {"seed": seed})
        kp = score(args, folder, files, "keypoints3d.json", session["keypoint_convention"])
        body = score(args, folder, files, "poses3d.json", "smpl24")
        sim3, rigid = kp["cameras"]["sim3"], kp["cameras"]["rigid"]
        scale = json.loads(files["report.json"])["scale"]
        truth = scale["value"] * sim3["scale"]
        covered += scale["interval95"][0] <= truth <= scale["interval95"][1]
        complete = sim3["n_cameras"] == len(session["cameras"])
        worst = {
            "mm": max(worst["mm"], sim3["position_mm"] if complete else 9e9),
            "deg": max(worst["deg"], sim3["angle_deg"]),
            "rigid": max(worst["rigid"], rigid["position_mm"]),
            "kp": min(worst["kp"], kp["pcp"]["average"]),
            "body": min(worst["body"], body["pcp"]["average"]),
        }
        print(f"        seed {seed}: {sim3['position_mm']:.2f} mm {sim3['angle_deg']:.3f} deg, rigid {rigid['position_mm']:.1f} mm, scale {sim3['scale']:.4f}, "
              f"PCP keypoints {kp['pcp']['average']:.2f}, body {body['pcp']['average']:.2f}, {state['quality']['verdict']}", flush=True)
    say(3, f"worst of {args.seeds} seeds after Sim(3), all cameras", f"{worst['mm']:.2f} mm, {worst['deg']:.3f} deg", worst["mm"] <= 17 and worst["deg"] <= 0.29)
    say(4, "worst rigid position; intervals that hold the truth", f"{worst['rigid']:.1f} mm; {covered} of {args.seeds}", worst["rigid"] <= 110 and covered == args.seeds)
    say(5, "lowest PCP of keypoints3d, poses3d", f"{worst['kp']:.2f}, {worst['body']:.2f}", worst["kp"] >= 96.5 and worst["body"] >= 95)


def row_6(args, server):
    folder = args.data / "shelf"
    session, poses = read_session(folder)
    poses = without_ids(poses)
    free = json.loads(server.solve(zipped(session, poses), {})[2]["report.json"])["heldout_px"]
    truth = {c["id"]: c for c in json.loads((folder / "gt/cameras.json").read_text())}
    for c in session["cameras"]:
        c["R"], c["t"] = truth[c["id"]]["R"], truth[c["id"]]["t"]
    session["up_axis"] = "z"
    fixed = json.loads(server.solve(zipped(session, poses), {"extrinsics": "fixed"})[2]["report.json"])["heldout_px"]
    say(6, "held-out px, ours and the published cameras", f"{free:.3f}, {fixed:.3f}", free <= 1.05 * fixed)


def row_7(args, server):
    bounds = {"easy": (5, 0.10), "paper": (9, 0.18), "hard": (14, 0.20)}
    for name, (mm, deg) in bounds.items():
        folder = args.data / "simulated" / name
        session, poses = read_session(folder)
        files = server.solve(zipped(session, without_ids(poses)), {})[2]
        s = score(args, folder, files, "poses3d.json", "smpl24", identities=True)
        c, i = s["cameras"]["sim3"], s["identity"]
        good = c["position_mm"] <= mm and c["angle_deg"] <= deg and i["accuracy"] >= 0.99 and i["coverage"] >= 0.98
        say(7, name, f"{c['position_mm']:.2f} mm, {c['angle_deg']:.3f} deg, accuracy {i['accuracy']:.4f}, coverage {i['coverage']:.4f}, root12 {s['mpjpe']['root12']:.1f} mm", good)


def row_10(args, server):
    session, poses = read_session(args.data / "shelf")
    z = zipped(session, poses)
    times = []
    for seed in range(5):
        began = time.monotonic()
        job = server.start(z, {"seed": 100 + seed})
        while json.loads(server.call("GET", f"/v1/jobs/{job}?wait=30")[1])["state"] != "succeeded":
            pass
        server.call("GET", f"/v1/jobs/{job}/cameras")
        times.append(time.monotonic() - began)
    times.sort()
    say(10, "upload to result, median of 5 (all)", f"{times[2]:.2f} s ({', '.join(f'{t:.2f}' for t in times)})", times[2] <= 6)


def reconstruct(args, folder, out, threads=0):
    shutil.rmtree(out, ignore_errors=True)
    began = time.monotonic()
    process = subprocess.Popen([args.binary, "reconstruct", str(folder), "--out", str(out), "--threads", str(threads)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0, status
    return time.monotonic() - began, usage.ru_maxrss / 1024


def row_11(args, scratch):
    session, poses = read_session(args.data / "shelf")
    n, first = session["n_frames"], session.get("first_frame", 0)
    for times in (1, 10):
        folder = scratch / f"x{times}"
        (folder / "poses").mkdir(parents=True)
        (folder / "session.json").write_text(json.dumps({**session, "n_frames": n * times}))
        for camera, frames in poses.items():
            rows = [{**f, "frame": f["frame"] + k * n} for k in range(times) for f in frames["frames"]]
            assert rows[0]["frame"] >= first
            (folder / "poses" / f"{camera}.json").write_text(json.dumps({"frames": rows}))
    (t1, m1), (t10, m10) = (reconstruct(args, scratch / f"x{k}", scratch / f"r{k}") for k in (1, 10))
    say(11, "10 times longer: time, memory", f"{t10:.1f} s / {t1:.1f} s = {t10 / t1:.1f}; {m10:.0f} MiB / {m1:.0f} MiB = {m10 / m1:.1f}", t10 <= 12 * t1 and m10 <= 12 * m1 and m10 <= 2048)


def malformed(args):
    session, poses = read_session(args.data / "simulated/easy")
    good = zipped(session, poses)
    camera = session["cameras"][0]["id"]

    def changed(edit, raw=None):
        s, p = json.loads(json.dumps(session)), {c: {"frames": [dict(f) for f in v["frames"][:3]]} for c, v in poses.items()}
        s["n_frames"] = 3
        edit(s, p)
        text = zipped(s, p)
        return raw(text) if raw else text

    def member(name, data, kind=zipfile.ZIP_DEFLATED):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", kind) as z:
            z.writestr("session.json", json.dumps(session))
            if callable(data):
                with z.open(name, "w", force_zip64=True) as f:
                    data(f)
            else:
                z.writestr(name, data)
        return out.getvalue()

    def zeros(f):
        block = bytes(1 << 24)
        for _ in range(320):
            f.write(block)

    first = lambda p: p[camera]["frames"][0]["people"][0]["keypoints"]
    text = lambda old, new: lambda s: json.dumps({**s, "poses": {}}).replace(old, new).encode()
    cam = session["cameras"][0]
    return [
        ("truncated zip", good[: len(good) // 2], "application/zip"),
        ("names with ..", member("../evil.json", "{}"), "application/zip"),
        ("absolute name", member("/etc/evil.json", "{}"), "application/zip"),
        ("5 GiB of zeros", member(f"poses/{camera}.json", zeros), "application/zip"),
        ("NaN", json.dumps({**session, "fps": float("nan"), "poses": poses}).encode(), "application/json"),
        ("1e400", json.dumps({**session, "poses": poses}).replace('"fps": 30', '"fps": 1e400').encode(), "application/json"),
        ("deep JSON", b"[" * 100000, "application/json"),
        ("not JSON", b"hello", "application/json"),
        ("empty body", b"", "application/zip"),
        ("singular K", changed(lambda s, p: s["cameras"][0].update(K=[[0, 0, 0]] * 3)), "application/zip"),
        ("negative focal length", changed(lambda s, p: s["cameras"][0].update(K=[[-900, 0, 640], [0, 900, 360], [0, 0, 1]])), "application/zip"),
        ("duplicate camera ids", changed(lambda s, p: s["cameras"].append(s["cameras"][0])), "application/zip"),
        ("missing poses file", changed(lambda s, p: p.pop(camera)), "application/zip"),
        ("wrong keypoint count", changed(lambda s, p: first(p).pop()), "application/zip"),
        ("zero cameras", changed(lambda s, p: s.update(cameras=[])), "application/zip"),
        ("zero frames", changed(lambda s, p: [s.update(n_frames=0), [v.update(frames=[]) for v in p.values()]]), "application/zip"),
        ("frame out of range", changed(lambda s, p: p[camera]["frames"][0].update(frame=999)), "application/zip"),
        ("coordinate 1e308", changed(lambda s, p: first(p).__setitem__(0, [1e308, 1, 1])), "application/zip"),
        ("image size 0", changed(lambda s, p: s["cameras"][0].update(width=0)), "application/zip"),
        ("reflection as R", changed(lambda s, p: s["cameras"][0].update(R=[[1, 0, 0], [0, 1, 0], [0, 0, -1]], t=[0, 0, 4])), "application/zip"),
        ("negative confidence", changed(lambda s, p: first(p).__setitem__(0, [1, 1, -1])), "application/zip"),
        ("unknown convention", changed(lambda s, p: s.update(keypoint_convention="body99")), "application/zip"),
    ]


def rss(pid):
    for line in open(f"/proc/{pid}/status"):
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024


def row_12(args, server):
    cases = malformed(args)
    before = rss(server.process.pid)
    good, slowest = 0, 0
    for name, body, kind in cases:
        began = time.monotonic()
        status, answer = server.call("POST", "/v1/sessions", body, kind)
        seconds = time.monotonic() - began
        slowest = max(slowest, seconds)
        problem = json.loads(answer) if answer[:1] == b"{" else {}
        ok = 400 <= status < 500 and all(k in problem for k in ("code", "detail", "remedy")) and seconds <= 2
        good += ok
        if not ok:
            print(f"        {name}: {status} {answer[:300]} {seconds:.2f} s")
    alive = server.call("GET", "/healthz")[0] == 200
    say(12, "malformed sessions refused as problems", f"{good} of {len(cases)}, slowest {slowest:.2f} s, memory +{rss(server.process.pid) - before:.0f} MiB, alive {alive}",
        good == len(cases) and alive and rss(server.process.pid) - before <= 64)


def digest(files):
    return hashlib.sha256(b"".join(hashlib.sha256(n.encode() + b"\0" + files[n]).digest() for n in sorted(files))).hexdigest()


def row_13_14(args, scratch):
    session, poses = read_session(args.data / "shelf")
    z = zipped(session, poses)
    server = Server(args.binary, scratch / "calm")
    undisturbed = server.solve(z, {"seed": 3})[2]
    server.stop()
    server = Server(args.binary, scratch / "killed")
    job = server.start(z, {"seed": 3})
    while json.loads(server.call("GET", f"/v1/jobs/{job}")[1])["state"] == "queued":
        time.sleep(0.01)
    time.sleep(0.8)
    server.process.send_signal(signal.SIGKILL)
    server.process.wait()
    server = Server(args.binary, scratch / "killed")
    state = server.wait(job)
    files = server.artifacts(job)
    server.stop()
    say(13, "killed while running, restarted", f"{state['state']}, attempt {state['attempt']}, same bytes {digest(files) == digest(undisturbed)}", state["state"] == "succeeded" and digest(files) == digest(undisturbed))
    folder = scratch / "shelf"
    folder.mkdir()
    with zipfile.ZipFile(io.BytesIO(z)) as archive:
        archive.extractall(folder)
    digests = set()
    for run, threads in enumerate((1, 2, 1, 2)):
        reconstruct(args, folder, scratch / f"t{run}", threads)
        out = scratch / f"t{run}"
        digests.add(digest({str(f.relative_to(out)): f.read_bytes() for f in out.rglob("*") if f.is_file()}))
    solved = {n: b for n, b in undisturbed.items() if n not in ("manifest.json", "report.json")}
    again = {str(f.relative_to(out)): f.read_bytes() for f in out.rglob("*") if f.is_file() and f.name not in ("manifest.json", "report.json")}
    say(14, "1 and 2 threads, twice", f"{len(digests)} distinct results ({len(solved)} and {len(again)} files)", len(digests) == 1)


def row_15(args, server):
    session, poses = read_session(args.data / "simulated/paper")
    job, state, files = server.solve(zipped(session, poses), {"seed": 15})
    report, cameras, people = (json.loads(files[f"{n}.json"]) for n in ("report", "cameras", "people"))
    db = sqlite3.connect(f"file:{next(server.data.rglob('*.sqlite*')) if list(server.data.rglob('*.sqlite')) else next(server.data.rglob('*.db'))}?mode=ro", uri=True)
    db.row_factory = sqlite3.Row
    rows = lambda table: [dict(r) for r in db.execute(f"select * from {table} where job_id = ?", (job,))]
    stages = sorted(rows("stage_metrics"), key=lambda r: r["stage_index"])
    ok = [(r["stage"], r["iterations"], r["cost_before"], r["cost_after"], r["termination"]) for r in stages] == [
        (s["stage"], s["iterations"], s["cost_before"], s["cost_after"], s["termination"]) for s in report["stages"]]
    values = {(r["stage_index"], r["name"]): r["value"] for r in rows("stage_metric_values")}
    ok &= values == {(i, k): v for i, s in enumerate(report["stages"]) for k, v in s["metrics"].items()}
    found = {r["camera"]: r for r in rows("camera_results")}
    ok &= len(found) == len(cameras["cameras"]) and all(found[c["id"]]["status"] == c["status"] and found[c["id"]]["n_observations"] == c["n_observations"] for c in cameras["cameras"])
    found = rows("person_results")
    ok &= sorted(str(r["person"]) for r in found) == sorted(str(p["id"]) for p in people["people"])
    verdict = rows("verdicts")[0]
    ok &= verdict["verdict"] == report["quality"]["verdict"]
    say(15, "rows in SQLite equal the files", f"{len(stages)} stages, {len(values)} metrics, {len(cameras['cameras'])} cameras, {len(found)} people", bool(ok))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--score", required=True)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--rows", default="3,6,7,10,11,12,13,15")
    parser.add_argument("--binary", default=str(ROOT / "target/release/wandless"))
    args = parser.parse_args()
    rows = {int(r) for r in args.rows.split(",")}
    scratch = pathlib.Path(tempfile.mkdtemp(prefix="wandless-acceptance-"))
    server = Server(args.binary, scratch / "data")
    try:
        for row, check in ((3, rows_3_to_5), (6, row_6), (7, row_7), (10, row_10), (12, row_12), (15, row_15)):
            if row in rows:
                check(args, server)
    finally:
        server.stop()
    if 11 in rows:
        row_11(args, scratch)
    if 13 in rows:
        row_13_14(args, scratch)
    shutil.rmtree(scratch, ignore_errors=True)
    print("failed: " + ", ".join(f"{r} ({w})" for r, w in FAILED) if FAILED else "all hold")
    sys.exit(bool(FAILED))


if __name__ == "__main__":
    main()
