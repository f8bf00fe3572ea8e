"""Writes the fuzz seeds of body files: a body of 12 vertices in every supported layout. Argument: the corpus folder."""

import pickle
import sys
import types

import numpy as np

corpus = sys.argv[1]
rng = np.random.default_rng(0)
V = 12
parents = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
body = {
    "v_template": np.stack([rng.uniform(-0.3, 0.3, V), np.linspace(-0.9, 0.8, V), rng.uniform(-0.2, 0.2, V)], axis=1),
    "shapedirs": rng.normal(0, 0.01, (V, 3, 2)),
    "weights": np.eye(24)[rng.integers(0, 24, V)],
    "J_regressor": np.eye(V)[np.arange(24) % V],
    "kintree_table": np.array([parents, range(24)], dtype=np.int64),
    "f": rng.integers(0, V, (8, 3)).astype(np.uint32),
}


def chumpy(module, name):
    cls = type(name, (), {"__module__": module})
    for part in ("chumpy", module):
        sys.modules.setdefault(part, types.ModuleType(part))
    setattr(sys.modules[module], name, cls)
    return cls


Ch = chumpy("chumpy.ch", "Ch")
node = Ch()
node.__dict__.update(x=body["v_template"], _dirty_vars=set(), dterms=["x"])
np.savez_compressed(f"{corpus}/npz/deflated.npz", **{k: v.astype(np.float32) if v.dtype == float else v for k, v in body.items()})
np.savez(f"{corpus}/npz/stored.npz", **{k: np.asfortranarray(v) for k, v in body.items()})
for protocol in range(5):
    with open(f"{corpus}/pickle/plain{protocol}.pkl", "wb") as file:
        pickle.dump({k: v.astype(np.float32) if v.dtype == float else v for k, v in body.items()}, file, protocol=protocol)
with open(f"{corpus}/pickle/chumpy.pkl", "wb") as file:
    pickle.dump(dict(body, v_template=node, bs_type="lrotmin"), file, protocol=2)
