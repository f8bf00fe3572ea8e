"""amass.py RESULT EXPORTS: reads the npz files with numpy and poses them with a forward pass in numpy."""

import numpy as np
from result import Result, Worst

PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]


def rotation(vectors):
    """Rodrigues: axis-angle [..., 3] to matrices [..., 3, 3]."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors / np.maximum(angle[..., 0], 1e-300), -1, 0)
    o = np.zeros_like(x)
    k = np.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*x.shape, 3, 3)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def chain(poses):
    """World rotations [frames, 24, 3, 3]."""
    local = rotation(poses.reshape(len(poses), 24, 3))
    world = [local[:, 0]]
    for j in range(1, 24):
        world.append(world[PARENTS[j]] @ local[:, j])
    return np.stack(world, 1)


def forward(rest, poses, trans):
    world = chain(poses)
    joints = [rest[0] + trans]
    for j in range(1, 24):
        p = PARENTS[j]
        joints.append(joints[p] + world[:, p] @ (rest[j] - rest[p]))
    return np.stack(joints, 1)


def rest_joints(poses, trans, joints):
    """Rest joints from the first frame, since the npz has none; all other frames must agree with them."""
    world = chain(poses[:1])[0]
    rest = [joints[0, 0] - trans[0]]
    for j in range(1, 24):
        p = PARENTS[j]
        rest.append(rest[p] + world[p].T @ (joints[0, j] - joints[0, p]))
    return np.stack(rest)


def fingers(wrists, places, poses):
    """Finger joints of a hand by a forward pass; rest offsets are those of the first frame. [frames, 15, 3]"""
    local = rotation(poses.reshape(len(poses), 15, 3))
    world, joints = [], []
    for j in range(15):
        first = j % 3 == 0
        outer, at = (wrists, places[:, 0]) if first else (world[j - 1], joints[j - 1])
        offset = outer[0].T @ (places[0, 1 + j] - (places[0, 0] if first else places[0, j]))
        joints.append(at + outer @ offset)
        world.append(outer @ local[:, j])
    return np.stack(joints, 1)


result, worst = Result(), Worst("amass", joint_tolerance=1e-4)
for person in result.people:
    npz = np.load(f"{result.exports}/smpl/{person['id']}.npz", allow_pickle=False)
    wide = np.load(f"{result.exports}/smplh/{person['id']}.npz", allow_pickle=False)
    assert npz["poses"].shape[1] == 72 and wide["poses"].shape[1] == 156
    assert (npz["poses"][:, :66] == wide["poses"][:, :66]).all()
    assert person.get("hands") or not wide["poses"][:, 66:].any()
    assert str(npz["gender"]) == "neutral" and npz["gender"].dtype.kind == "U"
    assert float(npz["mocap_framerate"]) == float(npz["mocap_frame_rate"]) == result.fps
    assert str(npz["up_axis"]) == result.up and str(wide["surface_model_type"]) == "smplh"
    assert npz["frames"].tolist() == person["frames"] and npz["valid"].tolist() == person["valid"]
    if person.get("hands"):
        widest = np.load(f"{result.exports}/smplx/{person['id']}.npz", allow_pickle=False)
        assert str(widest["surface_model_type"]) == "smplx" and widest["poses"].shape[1] == 165
        assert (np.delete(widest["poses"], range(66, 75), axis=1) == wide["poses"]).all()
        assert not widest["poses"][:, 66:75].any() and widest["expression"].shape[1] == 10 and not widest["expression"].any()
    rest = rest_joints(npz["poses"], npz["trans"], person["joints"])
    worst.joints(person["joints"], forward(rest, npz["poses"], npz["trans"]))
    for i, hand in enumerate(("left", "right") if person.get("hands") else ()):
        wrists, columns = chain(npz["poses"])[:, 20 + i], slice(66 + 45 * i, 111 + 45 * i)
        first = 24 + 15 * i
        places = np.concatenate([person["joints"][:, 20 + i : 21 + i], person["bones"][:, first : first + 15]], 1)
        worst.joints(places[:, 1:], fingers(wrists, places, wide["poses"][:, columns]))
worst.end()
