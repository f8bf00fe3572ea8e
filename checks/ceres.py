"""ceres.py WORK [--least 3] [--views 5 8 24] [--rounds 3] [--derivatives analytic]: bundle adjustment against the Ceres solver.

`cargo bench --bench adjustment` makes the problems and solves them by the pipeline's own bundle adjustment; `ceres/solve.cpp` solves
the same ones by Ceres with each of its Schur solvers. Both have one thread, the same start, robust kernel, initial damping and criterion
for stopping. An iteration is one linear solve, accepted or rejected; times are those of the iterations alone: Ceres's
`minimizer_time_in_seconds`, and ours without the set-up. The programs take turns, and the fastest run of each counts.

Exits with 1 where ours does fewer than LEAST times the observation-iterations a second of the fastest Schur solver, or ends at a
robust cost more than 1 % above the lowest of Ceres. Needs numpy, a C++ compiler and Ceres (`apt-get install g++ libceres-dev`).
"""

import argparse
import json
import pathlib
import subprocess
import sys

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
SOLVERS = ["DENSE_SCHUR", "SPARSE_SCHUR", "ITERATIVE_SCHUR"]
# Those of AdjustmentConfig: the step that lowers the cost by less than this share of it is the last.
RELATIVE_DECREASE = 1e-6
MAX_ITERATIONS = 50
# Runs of one call of a program; benches/adjustment.rs has as many.
RUNS = 5


def rotation_vector(rotation):
    """The rotation vector of a matrix; no camera of the ring turns by nearly 180 degrees about the axis that it looks along."""
    angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    axis = [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    return np.array(axis) * (angle / (2 * np.sin(angle)) if angle > 1e-9 else 0.5)


def rotation_matrix(vector):
    """The matrix of a rotation vector."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / max(angle, 1e-300)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def robust_cost(problem, poses, points):
    """Half the sum of Geman and McClure's rho over all observations; the same code for every solver."""
    pose = poses[problem["view"]]
    p = np.einsum("oij,oj->oi", pose[:, :, :3], points[problem["point"]]) + pose[:, :, 3]
    lens = problem["lenses"][problem["view"]]
    residual = (lens[:, :2] * p[:, :2] / p[:, 2:] + lens[:, 2:] - problem["pixel"]) / problem["sigma_px"][:, None]
    squared, scale2 = (residual**2).sum(1), problem["robust_scale"] ** 2
    return 0.5 * np.where(p[:, 2] > 1e-3, scale2 * squared / (scale2 + squared), scale2).sum()


def write_problem(problem, path):
    """The problem as `ceres/solve.cpp` reads it."""
    poses = problem["start_poses"]
    sizes = [len(poses), len(problem["start_points"]), len(problem["view"]), problem["robust_scale"], RELATIVE_DECREASE]
    vectors = np.array([[*rotation_vector(pose[:, :3]), *pose[:, 3]] for pose in poses])
    observations = np.column_stack([problem[name] for name in ["view", "point", "pixel", "sigma_px"]])
    parts = [sizes, problem["lenses"], vectors, problem["start_points"], observations]
    np.concatenate([np.ravel(part).astype(float) for part in parts]).tofile(path)


class Fastest:
    """The fastest run of a solver, and the cost that it ends at."""

    def __init__(self, name):
        self.name, self.seconds = name, float("inf")

    def add(self, seconds, iterations, cost):
        self.seconds, self.iterations, self.cost = min(self.seconds, seconds), iterations, cost

    def rate(self, n_observations):
        return n_observations * self.iterations / self.seconds


def solve_ours(work, views, ours):
    """Makes the problem, solves it and returns it."""
    command = ["cargo", "bench", "--quiet", "--locked", "--bench", "adjustment", "--", str(views), "--out", str(work)]
    subprocess.run(command, check=True, cwd=HERE.parent, stdout=subprocess.DEVNULL)
    with np.load(work / f"{views}.npz") as file:
        problem = dict(file)
    cost = robust_cost(problem, problem["poses"], problem["points"])
    ours.add(float(problem["wall_s"]), int(problem["iterations"]), cost)
    return problem


def solve_theirs(work, views, problem, solver, derivatives):
    """Solves the written problem by Ceres."""
    solution = work / f"{views}.{solver.name}"
    command = [work / "solve", work / f"{views}.problem", solution, solver.name, derivatives, str(MAX_ITERATIONS), str(RUNS)]
    said = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    values = np.fromfile(solution)
    poses, points = np.split(values, [6 * len(problem["lenses"])])
    poses = np.array([np.column_stack([rotation_matrix(pose[:3]), pose[3:]]) for pose in poses.reshape(-1, 6)])
    solver.add(said["seconds"], said["iterations"], robust_cost(problem, poses, points.reshape(-1, 3)))


def compared(work, views, args):
    """Prints the rows of one problem; returns whether ours is fast enough and as good."""
    ours, theirs = Fastest("ours"), [Fastest(name) for name in SOLVERS]
    for _ in range(args.rounds):
        problem = solve_ours(work, views, ours)
        write_problem(problem, work / f"{views}.problem")
        for solver in theirs:
            solve_theirs(work, views, problem, solver, args.derivatives)
    n = len(problem["view"])
    best = max(solver.rate(n) for solver in theirs)
    for solver in [ours, *theirs]:
        print(f"{views:5}  {n:12}  {solver.name:15}  {solver.iterations:10}  {solver.seconds:8.4f} s  {solver.rate(n) * 1e-6:7.3f} million/s  "
              f"{solver.rate(n) / best:5.2f}  {solver.cost:12.3f}", flush=True)
    return ours.rate(n) >= args.least * best and ours.cost <= 1.01 * min(solver.cost for solver in theirs)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--least", type=float, default=3.0)
    parser.add_argument("--views", type=int, nargs="+", default=[5, 8, 24])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--derivatives", choices=["analytic", "automatic"], default="analytic")
    args = parser.parse_args()
    work = args.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    source = HERE / "ceres" / "solve.cpp"
    subprocess.run(["g++", "-O3", "-DNDEBUG", "-std=c++17", "-I/usr/include/eigen3", source, "-o", work / "solve", "-lceres", "-lglog"], check=True)
    print("views  observations  solver           iterations  time        observation-iterations  ratio  robust cost")
    good = [compared(work, views, args) for views in args.views]
    sys.exit(0 if all(good) else 1)


main()
