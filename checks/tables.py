#!/usr/bin/env python3
"""Accuracy and stated uncertainty on captures with truth, one program against another.

    python3 checks/tables.py solve --program target/release/wandless --score SCORE.py --out RUN CAPTURE... [-j 2] [-- OPTIONS]
    python3 checks/tables.py compare BEFORE AFTER
    python3 checks/tables.py coverage RUN

CAPTURE is a session in the native layout with `gt/`; SCORE.py is an independent scoring program (numpy). `solve` keeps one line
a capture in RUN.jsonl and skips captures that are in it. A group is the name of a capture up to its last underscore. `compare`
prints ratios of means by group and how many captures became better; `coverage` compares errors with their stated sigmas:
root mean square of error over sigma, and the share inside the 95 % ellipsoid (as if isotropic).
"""
import argparse, concurrent.futures, importlib.util, json, os, pathlib, subprocess, sys, tempfile
import numpy as np

# The 95 % quantile of chi-squared with three degrees of freedom, per degree: sigmas are roots of summed variances of three axes.
INSIDE_95 = np.sqrt(7.815 / 3)
MEASURES = ("position_mm", "angle_deg", "root12", "pcp", "jitter", "cpu_s")


def judge(path):
    spec = importlib.util.spec_from_file_location("score", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def joint_ratios(result, poses, truth):
    """|error| over sigma of every joint against the nearest true person within 0.5 m."""
    ratios = []
    for person in json.loads((result / "people.json").read_text())["people"]:
        for frame, sigmas in zip(person["frames"], person.get("joint_sigma_mm") or []):
            joints = poses.get(frame, {}).get(str(person["id"]))
            distances = [np.linalg.norm(joints - p, axis=1) for p in truth.get(frame, {}).values()] if joints is not None else []
            nearest = min(distances, key=np.mean, default=[1.0])
            if np.mean(nearest) < 0.5:
                ratios += [1e3 * e / sigma for e, sigma in zip(nearest, sigmas) if sigma]
    return ratios


def errors(score, capture, result):
    session = json.loads((capture / "session.json").read_text())
    truth_cameras, cameras = score.load_cameras(capture / "gt/cameras.json"), score.load_cameras(result / "cameras.json")
    found = score.camera_errors(session, truth_cameras, cameras, "sim3")
    alignment = score.fit_alignment(cameras, truth_cameras, "sim3")
    stated = {c["id"]: c for c in json.loads((result / "cameras.json").read_text())["cameras"]}
    row = {k: found[k] for k in ("position_mm", "angle_deg", "scale")}
    row["cameras"] = {i: [e["position_mm"], stated[i].get("sigma_position_mm"), e["angle_deg"], stated[i].get("sigma_angle_deg")]
                      for i, e in found["per_camera"].items()}
    truth_names, truth = score.load_poses(capture / "gt/poses3d.json")
    truth = {f: people for f, people in truth.items() if people}
    has_bodies = len(truth_names) == 24
    _, poses = score.load_poses(result / "poses3d.json")
    aligned = score.transform_poses(poses, alignment)
    to14 = lambda frames: {f: {p: score.to_shelf14(x, "smpl24") for p, x in people.items()} for f, people in frames.items()}
    truth14, poses14 = to14(truth) if has_bodies else truth, to14(aligned)
    actors = sorted({p for people in truth.values() for p in people}) if has_bodies else ["0", "1", "2"]
    row["root12"] = score.mpjpe(truth14, poses14, actors=actors)["root12"]
    row["pcp"] = score.pcp(truth14, poses14, actors=actors)["average"]
    row["jitter"] = score.jitter(aligned, session["fps"])["m_per_s2"]
    ratios = np.array(joint_ratios(result, aligned, truth)) if has_bodies else []
    if len(ratios):
        row["joints"] = [float(np.mean(ratios**2)), float(np.mean(ratios <= INSIDE_95)), len(ratios)]
    return row


def solve_one(arguments, capture):
    score = judge(arguments.score)
    with tempfile.TemporaryDirectory() as folder:
        result = pathlib.Path(folder) / "result"
        process = subprocess.Popen([arguments.program, "reconstruct", str(capture), "--out", str(result), *arguments.options],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        message = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        row = {"capture": capture.name, "exit": os.waitstatus_to_exitcode(status), "cpu_s": usage.ru_utime}
        if not (result / "report.json").exists():
            return row | {"error": message[-600:]}
        report = json.loads((result / "report.json").read_text())
        row |= {"verdict": report["quality"]["verdict"], "reasons": [str(r) for r in report["quality"]["reasons"]],
                "suspicions": [[s["code"], s["cameras"]] for s in report.get("suspicions", [])],
                "bodies": [p["body"] for p in report["people"] if p.get("body")]}
        return row | errors(score, capture, result)


def read(run):
    path = pathlib.Path(f"{run}.jsonl")
    lines = path.read_text().splitlines() if path.exists() else []
    return {row["capture"]: row for row in map(json.loads, lines)}


def solve(arguments):
    done = read(arguments.out)
    wanted = [c for c in map(pathlib.Path, arguments.captures) if c.name not in done]
    with open(f"{arguments.out}.jsonl", "a") as out, concurrent.futures.ProcessPoolExecutor(arguments.j) as pool:
        waiting = {pool.submit(solve_one, arguments, c): c for c in wanted}
        for ready in concurrent.futures.as_completed(waiting):
            row = ready.result()
            print(json.dumps(row), file=out, flush=True)
            shown = "  ".join(f"{k} {row[k]:.4g}" for k in MEASURES if row.get(k) is not None)
            print(f"{row['capture']:20} {row.get('verdict', row.get('error'))}  {shown}", flush=True)


def groups(rows):
    found = {}
    for name in sorted(rows):
        found.setdefault(name.rpartition("_")[0] or name, []).append(name)
    return found


def compare(arguments):
    before, after = read(arguments.before), read(arguments.after)
    for group, names in groups(before.keys() & after.keys()).items():
        cells = []
        for measure in MEASURES:
            pairs = [(before[n][measure], after[n][measure]) for n in names if before[n].get(measure) and after[n].get(measure)]
            if pairs:
                x, y = np.array(pairs).T
                cells.append(f"{measure} {x.mean():.4g} -> {y.mean():.4g} ({y.mean() / x.mean():.3f}, lower in {np.sum(y < x)} of {len(x)})")
        print(f"{group}: " + "; ".join(cells))
        for n in names:
            if before[n].get("verdict") != after[n].get("verdict"):
                print(f"  {n}: verdict {before[n].get('verdict')} -> {after[n].get('verdict')} {after[n].get('reasons')}")


def coverage(arguments):
    rows = read(arguments.run)
    for group, names in [*groups(rows).items(), ("all", list(rows))]:
        cameras = np.array([c for n in names for c in rows[n].get("cameras", {}).values() if c[1] and c[3]], float)
        if not len(cameras):
            continue
        line = [f"{group} ({len(names)})"]
        for what, i in (("position", 0), ("orientation", 2)):
            ratio = cameras[:, i] / cameras[:, i + 1]
            line.append(f"{what} {np.sqrt(np.mean(ratio**2)):.2f} ({100 * np.mean(ratio <= INSIDE_95):.0f} %)")
        joints = np.array([rows[n]["joints"] for n in names if rows[n].get("joints")], float)
        if len(joints):
            weights = joints[:, 2] / joints[:, 2].sum()
            line.append(f"joints {np.sqrt(weights @ joints[:, 0]):.2f} ({100 * weights @ joints[:, 1]:.0f} %)")
        print("  ".join(line))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("solve")
    command.add_argument("--program", default="target/release/wandless")
    command.add_argument("--score", required=True)
    command.add_argument("--out", required=True)
    command.add_argument("-j", type=int, default=2)
    command.add_argument("captures", nargs="+")
    command.set_defaults(run_command=solve)
    command = commands.add_parser("compare")
    command.add_argument("before")
    command.add_argument("after")
    command.set_defaults(run_command=compare)
    command = commands.add_parser("coverage")
    command.add_argument("run")
    command.set_defaults(run_command=coverage)
    own, _, options = " ".join(sys.argv[1:]).partition(" -- ")
    arguments = parser.parse_args(own.split())
    arguments.options = options.split()
    arguments.run_command(arguments)


if __name__ == "__main__":
    main()
