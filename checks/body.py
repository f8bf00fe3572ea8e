#!/usr/bin/env python3
"""Compares the SMPL files of a result with its `poses3d.json`, using only numpy.

    wandless body export --out BODY.npz [--body FILE]
    python3 checks/body.py RESULT BODY.npz

The forward pass is written from its definition (Loper et al. 2015, Eqs. 2 to 4): rest joints `J = R (T + S beta)`, then
`p_j = p_parent + G_parent (J_j - J_parent)`, the root rotating about its rest position, and the translation added. Prints
one line per person; exit code 1 where a joint differs by more than 0.1 mm.
"""
import json
import pathlib
import sys

import numpy as np

BOUND_M = 1e-4


def rotations(vectors):
    """Rotation matrices of rotation vectors, by Rodrigues' formula: [..., 3] -> [..., 3, 3]."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    axis = vectors / np.maximum(angle[..., 0], 1e-300)
    x, y, z = np.moveaxis(axis, -1, 0)
    o = np.zeros_like(x)
    k = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def posed(body, betas, poses, trans):
    """Rest vertices [V, 3], rest joints [24, 3], and of every frame `world_from_joint` and joints [frames, 24, ...]."""
    shaped = body["v_template"].astype(float) + body["shapedirs"].astype(float)[..., : len(betas)] @ betas
    rest = body["J_regressor"].astype(float) @ shaped
    parents = body["kintree_table"][0]
    local = rotations(poses.reshape(len(poses), 24, 3))
    turn, place = [local[:, 0]], [np.broadcast_to(rest[0], (len(poses), 3))]
    for j in range(1, 24):
        p = int(parents[j])
        place.append(place[p] + turn[p] @ (rest[j] - rest[p]))
        turn.append(turn[p] @ local[:, j])
    return shaped, rest, np.stack(turn, 1), np.stack(place, 1) + trans[:, None]


def joints(body, betas, poses, trans):
    """Joints of every frame: [frames, 24, 3]."""
    return posed(body, betas, poses, trans)[3]


def vertices(body, betas, poses, trans):
    """Vertices of every frame by linear blend skinning, without pose directions: [frames, V, 3]."""
    shaped, rest, turn, place = posed(body, betas, poses, trans)
    weights = body["weights"].astype(float)
    offset = place - np.einsum("fjab,jb->fja", turn, rest)
    turned = np.einsum("fjab,vb->fvja", turn, shaped)
    return np.einsum("vj,fvja->fva", weights, turned + offset[:, None])


def main():
    result, body = pathlib.Path(sys.argv[1]), np.load(sys.argv[2], allow_pickle=False)
    frames = json.loads((result / "poses3d.json").read_text())["frames"]
    files = sorted((result / "smpl").glob("*.npz"), key=lambda path: int(path.stem))
    if not files:
        raise SystemExit("the result has no smpl/<person>.npz; ask for the export smpl_npz")
    worst = 0.0
    for path in files:
        motion = np.load(path, allow_pickle=False)
        found = joints(body, motion["betas"], motion["poses"], motion["trans"])
        expected = np.array([frames[str(frame)][path.stem] for frame in motion["frames"]])
        off = np.linalg.norm(found - expected, axis=-1).max()
        worst = max(worst, off)
        print(f"person {path.stem}: {len(expected)} frames, largest joint distance {off:.1e} m")
    print("ok" if worst <= BOUND_M else "FAIL", f"{worst:.1e} m, bound {BOUND_M:.0e}")
    return worst > BOUND_M


if __name__ == "__main__":
    sys.exit(main())
