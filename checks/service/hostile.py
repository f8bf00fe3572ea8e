"""Catalogue D1 to D10 over HTTP: hostile uploads. Each is refused with 4xx, a code and a remedy within 2 s and 64 MiB, or is
accepted, and its job ends with a result or a typed error; every number of a result is finite.

    python3 checks/service/hostile.py
"""

import copy
import io
import json
import math
import os
import random
import shutil
import struct
import tempfile
import time
import zipfile

from harness import Faults, Service, arguments, take, wandless


def zip_of(files, method=zipfile.ZIP_DEFLATED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, content in files:
            archive.writestr(name, content)
    return out.getvalue()


def native(session):
    head = {key: value for key, value in session.items() if key != "poses"}
    return [("session.json", json.dumps(head))] + [(f"poses/{name}.json", json.dumps(poses)) for name, poses in session["poses"].items()]


def filled(gib, byte):
    """A deflated member that repeats one byte, written in blocks."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("session.json", "w", force_zip64=True) as member:
            block = byte * (1 << 20)
            for _ in range(gib << 10):
                member.write(block)
    return out.getvalue()


def empty_entries(n):
    """A zip of n empty members, written directly: the library would take minutes."""
    local, central = io.BytesIO(), io.BytesIO()
    for i in range(n):
        name = b"%07x" % i
        at = len(local.getbuffer())
        local.write(struct.pack("<4sHHHHHIIIHH", b"PK\3\4", 20, 0, 0, 0, 0, 0, 0, 0, len(name), 0) + name)
        central.write(struct.pack("<4sHHHHHHIIIHHHHHII", b"PK\1\2", 20, 20, 0, 0, 0, 0, 0, 0, 0, len(name), 0, 0, 0, 0, 0, at) + name)
    start, size = len(local.getbuffer()), len(central.getbuffer())
    end64 = struct.pack("<4sQHHIIQQQQ", b"PK\6\6", 44, 45, 45, 0, 0, n, n, size, start)
    tail = struct.pack("<4sIQI", b"PK\6\7", 0, start + size, 1) + struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 65535, 65535, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return local.getvalue() + central.getvalue() + end64 + tail


def patched(data, signature, offset, value):
    at = data.rfind(signature) + offset
    return data[:at] + value + data[at + len(value):]


def containers(good):
    """D1, D2 (a sample), D3."""
    whole = zip_of(good)
    yield "5 GiB of zeros", filled(5, b"\0")
    yield "2 GiB of spaces", filled(2, b" ")  # JSON allows spaces: only the limits stop it
    yield "a million empty members", empty_entries(1_000_000)
    yield "nested zip", zip_of([("session.zip", whole)])
    for name, offset, value in (("directory size 0", 12, b"\0" * 4), ("wrong directory size", 12, b"\xff" * 4), ("wrong directory offset", 16, b"\xff" * 4),
                                ("wrong member count", 10, b"\xff\x7f"), ("wrong comment length", 20, b"\xff\xff")):
        yield name, patched(whole, b"PK\5\6", offset, value)
    yield "trailing bytes", whole + b"x" * 100
    yield "prepended bytes", b"PK\3\4junk" + whole
    yield "member method 99", patched(whole, b"PK\1\2", 10, b"\x63\0")
    yield "member encrypted", patched(whole, b"PK\1\2", 8, b"\1\0")
    yield "wrong member size", patched(whole, b"PK\1\2", 24, b"\xff\xff\xff\x7f")
    yield "wrong local header offset", patched(whole, b"PK\1\2", 42, b"\1\0\0\0")
    yield "overlapping members", patched(whole, b"PK\1\2", 42, b"\0\0\0\0")
    twice = zip_of(good + [("poses/camX.json", b"{}")])
    yield "duplicate name", twice.replace(b"poses/camX.json", b"poses/cam0.json")
    for n in range(0, len(whole), max(1, len(whole) // 200)):
        yield f"cut at {n}", whole[:n]
    names = ["../x", "/etc/passwd", "C:\\x", "..\\x", "a\0b", "a/../../b", "CON", "x" * 4096, "caf\u00e9", "cafe\u0301", "\u202ejson.x", "./x", "a//b"]
    for name in names:
        yield f"name {name[:12]!r}", zip_of(good + [(name, b"x")])
    link = io.BytesIO()
    with zipfile.ZipFile(link, "w") as archive:
        for name, content in good:
            archive.writestr(name, content)
        info = zipfile.ZipInfo("poses/link.json")
        info.external_attr = 0o120777 << 16
        archive.writestr(info, "/etc/passwd")
    yield "symbolic link", link.getvalue()


def documents(good):
    """D5 to D9."""
    text = json.dumps(good)

    def changed(**changes):
        return json.dumps({**good, **changes}).encode()

    point = json.dumps(good["poses"]["cam0"]["frames"][0]["people"][0]["keypoints"][0])
    for value in ("NaN", "-Infinity", "1e400", "1e308", "-0", "9" * 10000, "9007199254740993", "null", '"x"', "[]"):
        yield f"coordinate {value[:12]}", text.replace(point, f"[{value}, 1, 0.5]", 1).encode()
    yield "depth 129", (text[:-1] + ', "x": ' + "[" * 129 + "]" * 129 + "}").encode()
    yield "depth 100,000", (text[:-1] + ', "x": ' + "[" * 100_000 + "}").encode()
    yield "duplicate keys", (text[:-1] + ', "fps": 1}').encode()
    yield "string of 100 MB", (text[:-1] + ', "x": "' + "a" * 100_000_000 + '"}').encode()
    yield "lone surrogate", (text[:-1] + ', "name": "\\ud800"}').encode()
    yield "byte order mark", b"\xef\xbb\xbf" + text.encode()
    yield "UTF-16", text.encode("utf-16")
    yield "trailing garbage", text.encode() + b"{}"
    yield "invalid UTF-8", text.encode().replace(b"take", b"ta\xff\xfe")
    cameras = good["cameras"]
    yield "no camera", changed(cameras=[], poses={})
    yield "one camera", changed(cameras=cameras[:1], poses={"cam0": good["poses"]["cam0"]})
    yield "65 cameras", changed(cameras=[{**cameras[0], "id": f"c{i}"} for i in range(65)], poses={f"c{i}": {"frames": []} for i in range(65)})
    yield "no people", changed(poses={name: {"frames": [{"frame": 0, "people": []}]} for name in good["poses"]})
    for n in (0, -1, 1, 1_000_000, 1_000_001, 10**18, 1.5):
        yield f"{n} frames", changed(n_frames=n)
    for fps in (0, -1, 1e-300, 1e300):
        yield f"{fps} fps", changed(fps=fps)
    k = cameras[0]["K"]
    bad_k = {"singular": [[0, 0, 0]] * 3, "negative focal": [[-900, 0, 640], *k[1:]], "zero focal": [[0, 0, 640], *k[1:]], "skew": [[900, 1e5, 640], *k[1:]],
             "3x4": [[*row, 0] for row in k], "transposed": [list(row) for row in zip(*k)], "centre outside": [[900, 0, 1e6], *k[1:]], "tiny": [[1e-13, 0, 640], *k[1:]]}
    for name, matrix in bad_k.items():
        yield f"K {name}", changed(cameras=[{**cameras[0], "K": matrix}, *cameras[1:]])
    rotation = cameras[0]["R"]
    for name, fields in {"R not a rotation": {"R": [[2 * x for x in row] for row in rotation]}, "R mirrored": {"R": [[-x for x in row] for row in rotation]},
                         "no size": {"width": 0}, "huge distortion": {"dist": [1e9, 0, 0, 0, 0]}, "t far": {"t": [1e300, 0, 0]}}.items():
        yield name, changed(cameras=[{**cameras[0], **fields}, *cameras[1:]])
    for name in ("", "..", "\U0001f3a5", "x" * 1000, "x" * 1001, "con", "CAM1", "a/b", "a\nb", "\u202ex"):
        poses = dict(good["poses"])
        poses[name] = poses.pop("cam0")
        yield f"camera {name[:8]!r}", changed(cameras=[{**cameras[0], "id": name}, *cameras[1:]], poses=poses)
    yield "duplicate camera", changed(cameras=[cameras[0], cameras[0], *cameras[1:]])
    frames = good["poses"]["cam0"]["frames"]

    def posed(frames):
        return changed(poses={**good["poses"], "cam0": {"frames": frames}})

    def each(change):
        changed_frames = copy.deepcopy(frames)
        for i, frame in enumerate(changed_frames):
            change(i, frame)
        return posed(changed_frames)

    people = lambda frame: frame["people"]
    yield "unordered frames", posed(frames[::-1])
    yield "duplicate frame", posed(frames + frames[:1])
    yield "gaps", posed(frames[::5])
    yield "an empty camera", posed([])
    yield "no confidence", each(lambda i, frame: [point.__setitem__(2, 0) for person in people(frame) for point in person["keypoints"]])
    yield "one point", each(lambda i, frame: [person.update(keypoints=[[5, 5, 1]] * 17) for person in people(frame)])
    yield "outside the image", each(lambda i, frame: [point.__setitem__(0, 1e5) for person in people(frame) for point in person["keypoints"]])
    yield "track ids swapped", each(lambda i, frame: [person.update(track_id=(i + j) % 2) for j, person in enumerate(people(frame))])
    yield "200 people", each(lambda i, frame: frame.update(people=people(frame) * 200))
    yield "201 people", each(lambda i, frame: frame.update(people=people(frame) * 201))
    for n in (17, 25, 26, 133):
        yield f"{n} keypoints", each(lambda i, frame, n=n: [person.update(keypoints=[[5, 5, 1]] * n) for person in people(frame)])


def degenerate():
    """D10: identical cameras, collinear cameras, a motionless subject, mirrored sides; cameras estimated and given."""
    good = take(25, 3, seed=9)
    same = copy.deepcopy(good)
    for camera in same["cameras"]:
        camera.update({key: good["cameras"][0][key] for key in ("R", "t")})
    same["poses"] = {camera["id"]: good["poses"]["cam0"] for camera in same["cameras"]}
    yield "identical cameras", same
    still = copy.deepcopy(good)
    for poses in still["poses"].values():
        for frame in poses["frames"]:
            frame["people"] = poses["frames"][0]["people"]
    yield "still subject", still
    line = copy.deepcopy(good)
    for i, camera in enumerate(line["cameras"]):
        camera.update({"R": good["cameras"][0]["R"], "t": [float(i), *good["cameras"][0]["t"][1:]]})
    yield "cameras on one line", line
    mirrored = copy.deepcopy(good)
    for frame in mirrored["poses"]["cam1"]["frames"]:
        for person in frame["people"]:
            points = person["keypoints"]
            person["keypoints"] = [points[0]] + [points[i + 1 if i % 2 else i - 1] for i in range(1, 17)]
    yield "mirrored sides", mirrored


def forms(whole):
    """D4."""
    head = b'--AaB\r\nContent-Disposition: form-data; name="session"; filename="%s"\r\n\r\n'
    yield "no boundary", "multipart/form-data", head % b"x" + whole + b"\r\n--AaB--\r\n"
    kind = "multipart/form-data; boundary=AaB"
    yield "100,000 parts", kind, b'--AaB\r\nContent-Disposition: form-data; name="x"\r\n\r\n\r\n' * 100_000 + b"--AaB--\r\n"
    yield "part without name", kind, b"--AaB\r\nContent-Disposition: form-data\r\n\r\nx\r\n--AaB--\r\n"
    yield "long preamble", kind, b"x" * (100 << 20) + head % b"x" + whole + b"\r\n--AaB--\r\n"
    yield "endless part head", kind, b"--AaB\r\nX: " + b"y" * (10 << 20)
    yield "never closed", kind, head % b"x" + whole
    yield "session twice", kind, (head % b"x" + whole + b"\r\n") * 2 + b"--AaB--\r\n"
    yield "long boundary", "multipart/form-data; boundary=" + "b" * 5000, b"x"


class Hostile:
    def __init__(self, service, faults):
        self.service, self.faults, self.client = service, faults, service.client(patience_s=0.0, timeout_s=120)
        self.refused, self.accepted, self.codes, self.slowest, self.grown = 0, [], {}, 0.0, 0.0

    def try_upload(self, name, body, media_type):
        """Returns the session if it was accepted; checks a refusal."""
        before = self.peak(reset=True)
        start = time.monotonic()
        session, problem = None, None
        try:
            session = json.loads(self.client.request("POST", "/v1/sessions", body=body, media_type=media_type).body)
        except wandless.Problem as refusal:
            problem = refusal
        except OSError as error:
            # The service reads at most 16 MiB of a body that it refuses at its start.
            self.faults.require(len(body) > 64 << 20, f"{name}: no answer but {error}")
            return None
        seconds, grown = time.monotonic() - start, self.peak() - before
        if problem is None:
            self.accepted.append((name, session["id"]))
            return session
        self.refused += 1
        self.codes[problem.code] = self.codes.get(problem.code, 0) + 1
        self.slowest, self.grown = max(self.slowest, seconds), max(self.grown, grown)
        self.faults.require(400 <= problem.status < 500, f"{name}: {problem}")
        self.faults.require(problem.document.get("remedy") and problem.code, f"{name}: no code or no remedy: {problem}")
        # The time to send a hundred megabytes is the client's.
        self.faults.require(seconds <= 2 + len(body) / 50e6, f"{name}: refused after {seconds:.1f} s")
        self.faults.require(grown <= 64, f"{name}: the refusal took {grown:.0f} MiB")
        return None

    def peak(self, reset=False):
        pid = self.service.process.pid
        if reset:
            with open(f"/proc/{pid}/clear_refs", "w") as file:
                file.write("5")
        with open(f"/proc/{pid}/status") as status:
            wanted = "VmRSS" if reset else "VmHWM"
            return next(int(line.split()[1]) / 1024 for line in status if line.startswith(wanted))

    def solve(self, name, session, options):
        """Runs a job on an accepted session; it must succeed or fail with a typed error."""
        try:
            job = self.client.submit(session, options=options)["id"]
        except wandless.Problem as problem:
            self.faults.require(problem.status == 422, f"{name}: {problem}")
            return "422"
        now = self.client.job(job)
        deadline = time.monotonic() + 120
        while now["state"] not in wandless.FINAL and time.monotonic() < deadline:
            now = self.client.job(job, wait_s=10)
        self.faults.require(now["state"] in ("succeeded", "failed"), f"{name}: {now['state']} {now['error']}")
        if now["state"] == "failed":
            self.faults.require(now["error"]["code"] and now["error"]["detail"], f"{name}: {now['error']}")
            return now["error"]["code"]
        for file in self.client.manifest(job)["files"]:
            if file["name"].endswith(".json"):
                document = json.loads(self.client.artifact(job, file["name"]), parse_constant=lambda word: math.nan)
                self.faults.require(is_finite(document), f"{name}: {file['name']} contains a number that is not finite")
        return now["quality"]["verdict"]


def is_finite(value):
    if isinstance(value, dict):
        return all(map(is_finite, value.values()))
    if isinstance(value, list):
        return all(map(is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def tree(folder):
    return sorted(os.path.join(base, name) for base, _, names in os.walk(folder) for name in names)


def main():
    args = arguments(__doc__, flips=1)
    faults = Faults()
    place = tempfile.mkdtemp(prefix="wandless-hostile-")  # a folder of its own: all that appears beside the data is a fault
    service = Service(args.program, data=os.path.join(place, "data"), words=["--set", "limits.max_queued=100000"])
    service.start()
    hostile = Hostile(service, faults)
    good = take(25, 2, seed=3)
    whole = zip_of(native(good))
    known = set(os.listdir(service.data)) | {"bodies", "wandless.db.pages"}
    for name, body in containers(native(good)):
        hostile.try_upload(name, body, "application/zip")
    for name, body in documents(good):
        hostile.try_upload(name, body, "application/json")
    for name, kind, body in forms(whole):
        hostile.try_upload(name, body, kind)
    print(f"{hostile.refused} refused with {len(hostile.codes)} codes, slowest {hostile.slowest:.2f} s, memory +{hostile.grown:.0f} MiB; {len(hostile.accepted)} accepted", flush=True)
    small = zip_of(native(take(1, 2, seed=4)))
    rng = random.Random(args.seed)
    n_refused, n_same = 0, 0
    for at in range(0, len(small), args.flips):  # D2: every byte, one bit of it
        body = bytearray(small)
        body[at] ^= 1 << rng.randrange(8)
        session = hostile.try_upload(f"flip at {at}", bytes(body), "application/zip")
        n_refused, n_same = n_refused + (session is None), n_same + (session is not None)
    print(f"D2: {n_refused} of {n_refused + n_same} flips refused, {n_same} harmless", flush=True)
    hostile.accepted = [(name, session) for name, session in hostile.accepted if not name.startswith("flip")]
    ends = {name: hostile.solve(name, session, {"extrinsics": "fixed", "exports": []}) for name, session in hostile.accepted}
    for name, session in degenerate():
        session = hostile.try_upload(name, json.dumps(session).encode(), "application/json")
        for extrinsics in ("fixed", "estimate"):
            end = hostile.solve(name, session["id"], {"extrinsics": extrinsics, "exports": []}) if session else "refused"
            ends[f"{name}, {extrinsics}"] = end
            if extrinsics == "estimate":
                faults.require(end != "pass", f"D10: {name}: passed without a warning")
    print("accepted:", ends, flush=True)
    stored = tree(service.data)
    faults.require(all(os.path.realpath(path).startswith(os.path.realpath(service.data)) for path in stored), "D3: a file is outside of the data folder")
    made = [name for name in os.listdir(place) if name != "data"] + [name for name in os.listdir(service.data) if name not in known]
    faults.require(not made, f"D3: created outside of the data folder, or directly in it: {made[:5]}")
    faults.require(not any(word in path for path in stored for word in ("passwd", "CON", "caf\u00e9", "cafe\u0301", "..")), "D3: a name from the client is on the disk")
    faults.require(not os.listdir(os.path.join(service.data, "tmp")), "files remain in tmp")
    faults.require(service.client().request("GET", "/healthz").status == 200, "the service does not answer")
    service.kill()
    if not (faults.found or args.keep):
        shutil.rmtree(place)
    faults.end(service, args.keep)


if __name__ == "__main__":
    main()
