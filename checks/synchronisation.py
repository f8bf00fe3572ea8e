"""synchronisation.py WANDLESS WORK [--sessions N] [--preset P] [--views V] [--frames F]: estimation of time offsets.

Simulates sessions with time offsets of whole frames (-15 to 15) and of 0.3 frame, estimates the offsets, and compares them
with the truth after removing their common part, which is arbitrary: whole frames must be exact, fractions within 0.05 frame.
The cameras' errors may be at most 10 % larger than those of the same scenes without offsets.
"""

import argparse
import json
import random
import statistics
import subprocess
import sys

parser = argparse.ArgumentParser()
parser.add_argument("wandless")
parser.add_argument("work")
parser.add_argument("--sessions", type=int, default=20)
parser.add_argument("--first", type=int, default=1)
parser.add_argument("--preset", default="paper")
parser.add_argument("--views", type=int, default=5)
parser.add_argument("--frames", type=int, default=300)
args = parser.parse_args()


def run(*arguments):
    return subprocess.run([args.wandless, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


def solved(name, seed, offsets, options):
    """Errors of the cameras (mm, degrees), of the offsets (frames), and their reported standard deviations."""
    session, result = f"{args.work}/{name}_{seed}", f"{args.work}/{name}_{seed}_result"
    size = ["--preset", args.preset, "--views", args.views, "--frames", args.frames]
    run("simulate", "--procedural", "--out", session, "--seed", seed, *size, *(["--offset", *offsets] if offsets else []))
    with open(f"{session}_options.json", "w") as file:
        json.dump({**options, "exports": []}, file)
    run("reconstruct", session, "--out", result, "--options", f"{session}_options.json")
    evaluated = json.loads(run("evaluate", result, "--truth", f"{session}/gt", "--align", "sim3", "--json"))
    with open(f"{result}/cameras.json") as file:
        cameras = json.load(file)["cameras"]
    errors, sigmas = [], []
    if offsets:
        found = [30 * camera.get("time_offset_s", 0.0) for camera in cameras]
        errors = [a - b for a, b in zip(found, offsets)]
        shared = statistics.mean(errors)
        errors = [error - shared for error in errors]
        sigmas = [30 * camera["sigma_time_offset_s"] for camera in cameras if camera.get("sigma_time_offset_s")]
    return [evaluated["cameras"]["sim3"][key] for key in ["position_mm", "angle_deg"]], errors, sigmas


estimate = {"sync": "estimate"}
n_whole, whole, fractions, sigmas, errors = 0, [], [], [], {"given": [], "whole": [], "fraction": []}
for seed in range(args.first, args.first + args.sessions):
    rng = random.Random(seed)
    offsets = [rng.randint(-15, 15) for _ in range(args.views)]
    cameras, off, _ = solved("whole", seed, offsets, estimate)
    n_whole += all(abs(error) < 0.5 for error in off)
    whole += off
    errors["whole"].append(cameras)
    parts = [0.3 * (view % 2) for view in range(args.views)]
    cameras, off, reported = solved("fraction", seed, parts, estimate)
    fractions += off
    sigmas += reported
    errors["fraction"].append(cameras)
    errors["given"].append(solved("given", seed, [], {})[0])
    print(seed, offsets, [f"{error:+.3f}" for error in whole[-args.views :]], [f"{error:+.3f}" for error in off],
          {kind: [f"{error:.3f}" for error in tables[-1]] for kind, tables in errors.items()}, flush=True)
rms = lambda values: (sum(v * v for v in values) / len(values)) ** 0.5
print(f"whole frames exact in {n_whole} of {args.sessions}; rms {rms(whole):.3f}, worst {max(map(abs, whole)):.3f} frames")
print(f"0.3 frame: rms {rms(fractions):.3f}, worst {max(map(abs, fractions)):.3f}, within 0.05 "
      f"{sum(abs(f) <= 0.05 for f in fractions)} of {len(fractions)}; reported sigma {statistics.median(sigmas):.3f}")
good = n_whole == args.sessions and rms(fractions) <= 0.05
for i, unit in enumerate(["mm", "degrees"]):
    given, *others = [statistics.mean(table[i] for table in errors[kind]) for kind in ["given", "whole", "fraction"]]
    print(f"cameras, {unit}: {given:.3f} synchronous; whole {others[0] / given:.3f}, fraction {others[1] / given:.3f} of that")
    good = good and max(others) <= 1.1 * given
sys.exit(0 if good else 1)
