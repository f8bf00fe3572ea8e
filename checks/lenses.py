"""lenses.py WANDLESS WORK [--sessions N]: accuracy of cameras with distorting lenses.

Simulates the same scenes with a pinhole, a wide-angle lens (OpenCV's five numbers) and a fisheye of 100 degrees, and
compares the cameras' mean errors after a similarity alignment: those of distorting lenses may be at most 20 % larger.
"""

import argparse
import json
import statistics
import subprocess
import sys

parser = argparse.ArgumentParser()
parser.add_argument("wandless")
parser.add_argument("work")
parser.add_argument("--sessions", type=int, default=12)
args = parser.parse_args()


def run(*arguments):
    return subprocess.run([args.wandless, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


def errors(lens, seed):
    session = f"{args.work}/{lens}_{seed}"
    rig = ["--preset", "paper", "--fov", 100, "--radius", 3.2, "--lens", lens]
    run("simulate", "--procedural", "--out", session, "--seed", seed, *rig)
    run("reconstruct", session, "--out", f"{session}_result")
    evaluated = json.loads(run("evaluate", f"{session}_result", "--truth", f"{session}/gt", "--align", "sim3", "--json"))
    return [evaluated["cameras"]["sim3"][key] for key in ["position_mm", "angle_deg"]]


lenses = ["pinhole", "wide-angle", "fisheye"]
found = {lens: [errors(lens, seed) for seed in range(1, args.sessions + 1)] for lens in lenses}
means = {lens: [statistics.mean(column) for column in zip(*found[lens])] for lens in lenses}
good = True
for lens in lenses:
    ratios = [own / pinhole for own, pinhole in zip(means[lens], means["pinhole"])]
    good = good and max(ratios) <= 1.2
    print(f"{lens}: {means[lens][0]:.2f} mm, {means[lens][1]:.4f} degrees; {ratios[0]:.3f} and {ratios[1]:.3f} of pinhole")
sys.exit(0 if good else 1)
