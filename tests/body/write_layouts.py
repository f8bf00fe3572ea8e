"""Writes a body (an .npz of ours) in every layout that body files are found in. Arguments: the .npz, a folder."""

import pickle
import sys
import types

import numpy as np
import scipy.sparse

source, folder = sys.argv[1:]
with np.load(source, allow_pickle=False) as file:
    body = {name: file[name].astype(np.float64) for name in ("v_template", "shapedirs", "weights", "J_regressor")}
    body["f"] = file["f"]
    own = {name: file[name] for name in file.files if name.startswith("landmark")}
    parents = file["kintree_table"]
body["kintree_table"] = parents.astype(np.uint32)  # the root's parent becomes 4294967295


def chumpy(module, name):
    """A class that pickles as chumpy's of that name."""
    cls = type(name, (), {"__module__": module})
    for part in ("chumpy", module):
        sys.modules.setdefault(part, types.ModuleType(part))
    setattr(sys.modules[module], name, cls)
    return cls


Ch, Select = chumpy("chumpy.ch", "Ch"), chumpy("chumpy.reordering", "Select")


def ch(array):
    node = Ch()
    node.__dict__.update(x=array, _dirty_vars=set(), dterms=["x"])
    return node


def first_ten(array):
    """The first ten components of 300, as chumpy's slice of a Ch."""
    wide = np.concatenate([array, np.random.default_rng(1).normal(size=array.shape[:2] + (290,))], axis=2)
    node = Select()
    node.__dict__.update(a=ch(wide), idxs=np.arange(wide.size).reshape(wide.shape)[:, :, :10].ravel(),
                         preferred_shape=array.shape)
    return node


wide = np.concatenate([body["shapedirs"], np.random.default_rng(2).normal(size=body["shapedirs"].shape[:2] + (290,))], axis=2)
plain = dict(body, **own)
official = dict(body, v_template=ch(body["v_template"]), shapedirs=first_ten(body["shapedirs"]),
                weights=ch(body["weights"]), J_regressor=scipy.sparse.csc_matrix(body["J_regressor"]),
                bs_type="lrotmin", bs_style="lbs", **own)
fortran = {name: np.asfortranarray(value) for name, value in plain.items()}
big_endian = {name: value.astype(value.dtype.newbyteorder(">")) for name, value in plain.items()}


def write(name, value, protocol):
    with open(f"{folder}/{name}.pkl", "wb") as file:
        pickle.dump(value, file, protocol=protocol)


for protocol in range(5):
    write(f"official_protocol{protocol}", official, protocol)
write("fortran", fortran, 2)
write("big_endian", big_endian, 2)
write("csr", dict(plain, J_regressor=scipy.sparse.csr_matrix(body["J_regressor"])), 2)
write("wide", dict(plain, shapedirs=wide), 4)
np.savez(f"{folder}/stored.npz", **plain)
np.savez_compressed(f"{folder}/deflated.npz", **plain)
np.savez(f"{folder}/fortran.npz", **fortran)
np.savez(f"{folder}/posedirs.npz", posedirs=np.zeros(body["v_template"].shape + (207,), np.float32), **plain)
np.savez(f"{folder}/extra_objects.npz", pose_training_info=np.array([{"a": 1}], dtype=object), **plain)
