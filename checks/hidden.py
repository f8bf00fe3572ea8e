#!/usr/bin/env python3
"""Joints that no camera shows for a while, on captures with truth.

    python3 checks/hidden.py make --out FOLDER SESSION...
    python3 checks/hidden.py solve --program target/release/wandless --score SCORE.py --out RUN FOLDER/* [-j 2] [-- OPTIONS]
    python3 checks/hidden.py table RUN RUN...

SESSION is a session of two people and 17 COCO keypoints with `gt/` as `simulate.py` writes it. `make` takes the keypoints of one arm,
one leg or both legs of a person out of every view for 15, 30, 60 or 90 frames (two gaps a person; SESSION_a and SESSION_b), and in
SESSION_w one person out of all views for 60 frames and another out of all views but one for 90. `solve` keeps one line a gap in
RUN.jsonl. `table` prints for every kind of gap the mean error of the hidden joints after the root alignment of SCORE.py (the middle of
the hips, which keypoints show; the joint "pelvis" is a point inside the body that models place differently), beside that of the better
of a spherical and a cubic interpolation of the TRUE local rotations over the gap, and the share of errors inside the stated 95 %
ellipsoid. Needs numpy, scipy.
"""
import argparse, concurrent.futures, copy, json, pathlib, random, shutil, subprocess, sys, tempfile
import numpy as np
from scipy.spatial.transform import Rotation
from tables import INSIDE_95, judge, read

PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
HIPS = [1, 2]
#: Keypoints, joints whose rotation is unseen without them, and joints that those move and keypoints show; left and right.
ARM = [([7, 9], [16, 18, 20], [18, 20]), ([8, 10], [17, 19, 21], [19, 21])]
LEG = [([13, 15], [1, 4, 7], [4, 7]), ([14, 16], [2, 5, 8], [5, 8])]
BOTH = [tuple(a + b for a, b in zip(*LEG))] * 2
CELLS = [(kind, n) for n in (15, 30, 60, 90) for kind in ("arm", "leg", "legs")]
PARTS = {"arm": ARM, "leg": LEG, "legs": BOTH}
MARGIN = 20  # frames that are seen beside a gap
LEAST_FRAMES = 2 * 90 + 3 * MARGIN


def take_out(poses, identities, camera, person, frames, keypoints):
    """Removes keypoints of a person, or with None the whole detection, from a camera."""
    for f in range(*frames):
        people, who = poses[camera]["frames"][f]["people"], identities[camera][f]
        for n in [n for n, p in enumerate(who) if p == person][::-1]:
            if keypoints is None:
                del people[n], who[n]
                continue
            for k in keypoints:
                people[n]["keypoints"][k] = [0.0, 0.0, 0.0]


def gaps_of_limbs(dice, n_frames, n_people, cell):
    """Two gaps a person, in the order of the cells."""
    found = []
    for person in range(n_people):
        lengths = [CELLS[(cell + 2 * person + i) % len(CELLS)] for i in range(2)]
        free = n_frames - sum(n for _, n in lengths) - 3 * MARGIN
        cuts = sorted(dice.randint(0, free) for _ in range(2))
        for i, (kind, n) in enumerate(lengths):
            start = MARGIN * (i + 1) + cuts[i] + sum(m for _, m in lengths[:i])
            keypoints, turned, moved = PARTS[kind][dice.randint(0, 1)]
            found.append({"kind": kind, "length": n, "person": person, "frames": [start, start + n],
                          "keypoints": keypoints, "turned": turned, "moved": moved})
    return found


def gaps_of_people(dice, n_frames):
    start = lambda n: dice.randint(MARGIN, n_frames - n - MARGIN)
    a, b = start(60), start(90)
    return [{"kind": "person", "length": 60, "person": 0, "frames": [a, a + 60]},
            {"kind": "single view", "length": 90, "person": 1, "frames": [b, b + 90]}]


def make(arguments):
    for number, session in enumerate(map(pathlib.Path, arguments.captures)):
        document = json.loads((session / "session.json").read_text())
        cameras, n_frames = [c["id"] for c in document["cameras"]], document["n_frames"]
        if n_frames < LEAST_FRAMES:
            sys.exit(f"{session}: {n_frames} frames; two gaps of up to 90 frames and what is seen beside them take {LEAST_FRAMES}")
        identities = json.loads((session / "gt/identities.json").read_text())
        n_people = len(np.load(session / "gt/motion.npz")["poses"])
        original = {c: json.loads((session / f"poses/{c}.json").read_text()) for c in cameras}
        for part in "abw":
            dice = random.Random(f"{session.name}{part}")
            cell = (2 * n_people * (2 * number + (part == "b"))) % len(CELLS)
            gaps = gaps_of_people(dice, n_frames) if part == "w" else gaps_of_limbs(dice, n_frames, n_people, cell)
            poses, who = copy.deepcopy(original), copy.deepcopy(identities)
            for gap in gaps:
                kept = dice.choice(cameras) if gap["kind"] == "single view" else None
                for camera in set(cameras) - {kept}:
                    take_out(poses, who, camera, gap["person"], gap["frames"], gap.get("keypoints"))
            out = pathlib.Path(arguments.out) / f"{session.name}_{part}"
            shutil.copytree(session, out)
            for camera in cameras:
                (out / f"poses/{camera}.json").write_text(json.dumps(poses[camera]))
            (out / "gt/identities.json").write_text(json.dumps(who))
            (out / "gt/gaps.json").write_text(json.dumps(gaps))


def joints_of(rotations, translation, rest):
    """Forward kinematics of one frame."""
    turned, places = [rotations[0]], [rest[0] + translation]
    for j in range(1, 24):
        turned.append(turned[PARENTS[j]] * rotations[j])
        places.append(places[PARENTS[j]] + turned[PARENTS[j]].apply(rest[j] - rest[PARENTS[j]]))
    return np.array(places)


#: Increments from a gap's first edge at the share s of the gap, by that to the other edge and the velocities at both, a gap's length.
PATHS = {"spherical": lambda s, off, start, end: off * s,
         "cubic": lambda s, off, start, end: start * (s**3 - 2 * s**2 + s) + off * (3 * s**2 - 2 * s**3) + end * (s**3 - s**2)}


def interpolation_mm(motion, gap):
    """Mean error of the better interpolation of the true local rotations, mm."""
    p, (start, end) = gap["person"], gap["frames"]
    poses, trans, rest = motion["poses"][p].reshape(-1, 24, 3).astype(float), motion["trans"][p].astype(float), motion["rest_joints"][p]
    at = lambda f, j: Rotation.from_rotvec(poses[f, j])
    step = lambda a, b, j: (at(a, j).inv() * at(b, j)).as_rotvec()
    before, after, n = start - 1, end, end - start + 1
    edges = {j: (at(before, j), step(before, after, j), n * step(before - 1, before, j), n * step(after, after + 1, j))
             for j in gap["turned"]}
    errors = {path: [] for path in PATHS}
    for f in range(start, end):
        true = [at(f, j) for j in range(24)]
        truth = joints_of(true, trans[f], rest)
        for path, increment in PATHS.items():
            rotations = list(true)
            for j, (first, *course) in edges.items():
                rotations[j] = first * Rotation.from_rotvec(increment((f - before) / n, *course))
            errors[path] += list(np.linalg.norm((joints_of(rotations, trans[f], rest) - truth)[gap["moved"]], axis=1))
    return 1e3 * min(map(np.mean, errors.values()))


def nearest(people, truth):
    return min(people, key=lambda p: np.mean(np.linalg.norm(people[p] - truth, axis=1)), default=None)


def rows_of(score, capture, result):
    """One row a gap: errors in mm, stated shares, and whether the person keeps its name."""
    cameras = score.load_cameras(result / "cameras.json")
    alignment = score.fit_alignment(cameras, score.load_cameras(capture / "gt/cameras.json"), "sim3")
    poses = score.transform_poses(score.load_poses(result / "poses3d.json")[1], alignment)
    truth, motion = score.load_poses(capture / "gt/poses3d.json")[1], np.load(capture / "gt/motion.npz")
    sigmas = {(str(p["id"]), f): s for p in json.loads((result / "people.json").read_text())["people"]
              for f, s in zip(p["frames"], p.get("joint_sigma_mm") or [])}
    for number, gap in enumerate(json.loads((capture / "gt/gaps.json").read_text())):
        person, (start, end) = str(gap["person"]), gap["frames"]
        own = lambda f: truth[f][person]
        before, after = (nearest(poses.get(f, {}), own(f)) for f in (start - 1, end))
        moved = gap.get("moved") or list(range(24))
        root = lambda joints: joints[HIPS].mean(axis=0)
        relative, absolute, inside = [], [], []
        for f in range(start, end):
            found = poses.get(f, {}).get(before)
            if found is None:
                continue
            off = found - own(f)
            relative += list(np.linalg.norm(off - root(off), axis=1)[moved])
            absolute.append(float(np.linalg.norm(root(off))))
            stated = sigmas.get((before, f))
            if stated:
                inside += [1e3 * np.linalg.norm(off[j]) <= INSIDE_95 * stated[j] for j in moved if stated[j]]
        yield {"capture": f"{capture.name}#{number}", "kind": gap["kind"], "length": gap["length"], "same": before == after,
               "share": len(absolute) / (end - start), "relative_mm": 1e3 * float(np.mean(relative or [np.nan])),
               "root_mm": 1e3 * float(np.mean(absolute or [np.nan])), "inside": float(np.mean(inside or [np.nan])),
               "baseline_mm": interpolation_mm(motion, gap) if "turned" in gap else None}


def solve_one(arguments, capture):
    with tempfile.TemporaryDirectory() as folder:
        result = pathlib.Path(folder) / "result"
        done = subprocess.run([arguments.program, "reconstruct", str(capture), "--out", str(result), *arguments.options],
                              capture_output=True, text=True)
        if not (result / "report.json").exists():
            return [{"capture": f"{capture.name}#0", "kind": "failed", "length": 0, "error": done.stderr[-400:]}]
        return list(rows_of(judge(arguments.score), capture, result))


def solve(arguments):
    done = {name.partition("#")[0] for name in read(arguments.out)}
    wanted = [c for c in map(pathlib.Path, arguments.captures) if c.name not in done]
    with open(f"{arguments.out}.jsonl", "a") as out, concurrent.futures.ProcessPoolExecutor(arguments.j) as pool:
        for rows in pool.map(solve_one, [arguments] * len(wanted), wanted):
            for row in rows:
                print(json.dumps(row), file=out, flush=True)


def table(arguments):
    runs = [read(run) for run in arguments.captures]
    kinds = sorted({(row["kind"], row["length"]) for run in runs for row in run.values()})
    print("hidden | frames | gaps | interpolation |", " | ".join(f"{run}: mm, of it, inside 95 %" for run in arguments.captures))
    pooled = [[] for _ in runs]
    for kind, length in kinds:
        names = [n for n, row in runs[0].items() if (row["kind"], row["length"]) == (kind, length) and all(n in run for run in runs)]
        of = lambda run, key: float(np.nanmean([run[n][key] if run[n].get(key) is not None else np.nan for n in names] or [np.nan]))
        baseline = of(runs[0], "baseline_mm") if kind in PARTS else None
        cells = []
        for run, all_of_run in zip(runs, pooled):
            found = of(run, "relative_mm")
            if baseline:
                all_of_run += [(run[n]["relative_mm"], run[n]["baseline_mm"], run[n]["inside"]) for n in names]
                cells.append(f"{found:.1f}, {found / baseline:.2f}, {100 * of(run, 'inside'):.0f}")
            else:
                same = sum(bool(run[n].get("same")) for n in names)
                inside, there = (100 * of(run, key) for key in ("inside", "share"))
                cells.append(f"{found:.1f}, root {of(run, 'root_mm'):.1f}, {inside:.0f}, same {same}, there {there:.0f}")
        print(f"{kind} | {length} | {len(names)} | {baseline and round(baseline, 1)} |", " | ".join(cells))
    for run, values in zip(arguments.captures, pooled):
        if not values:
            continue
        found, baseline, inside = np.nanmean(np.array(values), axis=0)
        print(f"pooled {run}: {found:.1f} of {baseline:.1f} mm, {found / baseline:.3f}; inside {100 * inside:.0f} %")


def main():
    words, options = (sys.argv[1:], []) if "--" not in sys.argv else (sys.argv[1:sys.argv.index("--")], sys.argv[sys.argv.index("--") + 1:])
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", choices=["make", "solve", "table"])
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--program", default="target/release/wandless")
    parser.add_argument("--score", help="the scoring program")
    parser.add_argument("--out")
    parser.add_argument("-j", type=int, default=2)
    arguments = parser.parse_args(words)
    arguments.options = options
    {"make": make, "solve": solve, "table": table}[arguments.task](arguments)


if __name__ == "__main__":
    main()
