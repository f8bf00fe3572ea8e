"""usd.py RESULT EXPORTS: opens the stage with OpenUSD: skeletons with UsdSkel's queries, cameras as GfCamera's frusta."""

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel, UsdValidation
from result import Result, Worst, project

result, worst = Result(), Worst("usd")
stage = Usd.Stage.Open(f"{result.exports}/scene.usda")
assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
assert [stage.GetStartTimeCode(), stage.GetEndTimeCode()] == result.frame_range
assert stage.GetTimeCodesPerSecond() == result.fps
cache = UsdSkel.Cache()
for person in result.people:
    prim = stage.GetPrimAtPath(f"/World/person_{person['id']}")
    assert cache.Populate(UsdSkel.Root(prim), Usd.PrimDefaultPredicate)
    name = prim.GetName()
    query = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath(f"/World/{name}/{name}_skeleton")))
    assert [path.split("/")[-1] for path in query.GetJointOrder()] == result.bone_names(person)
    visibility = UsdGeom.Imageable(prim).GetVisibilityAttr()
    valid = prim.GetAttribute("userProperties:valid")
    for frame, is_valid, joints in zip(person["frames"], person["valid"], person["bones"]):
        posed = query.ComputeJointSkelTransforms(frame)
        worst.joints(result.turned("y", joints), [m.ExtractTranslation() for m in posed])
        assert visibility.Get(frame) == "inherited" and valid.Get(frame) == is_valid
    if person["frames"][0] > result.frame_range[0]:
        assert visibility.Get(person["frames"][0] - 1) == "invisible"
    if person["frames"][-1] < result.frame_range[1]:
        assert visibility.Get(person["frames"][-1] + 1) == "invisible"

# The package holds the same scene, complies with OpenUSD's rules, and its skin follows the skeleton.
package = Usd.Stage.Open(f"{result.exports}/scene.usdz")
rules = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
broken = [f"{error.GetName()}: {error.GetMessage()}" for error in rules.Validate(package)]
assert not broken, broken
for person in result.people:
    root = UsdSkel.Root(package.GetPrimAtPath(f"/World/person_{person['id']}"))
    mesh = UsdGeom.Mesh(root.GetPrim().GetChild(f"person_{person['id']}_body"))
    assert UsdSkel.BakeSkinning(root, Gf.Interval(person["frames"][0], person["frames"][-1]))
    for frame, vertices in result.skin["people"][str(person["id"])].items():
        points = np.array(mesh.GetPointsAttr().Get(int(frame)))[result.skin["vertices"]]
        worst.vertices(result.turned("y", vertices), points)

prims = {p.GetAttribute("userProperties:id").Get(): p for p in stage.Traverse() if p.IsA(UsdGeom.Camera)}
points = result.all_joints()
for camera in result.cameras:
    frustum = UsdGeom.Camera(prims[camera["id"]]).GetCamera(Usd.TimeCode(result.frame_range[0])).frustum
    to_screen = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())  # on row vectors
    ours, before = project(camera, points, n_distortions=0)
    p = np.concatenate([result.turned("y", points[before]), np.ones((before.sum(), 1))], 1) @ to_screen
    x, y = (p[:, :2] / p[:, 3:]).T
    theirs = np.stack([(x + 1) / 2 * camera["width"] - 0.5, (1 - y) / 2 * camera["height"] - 0.5], -1)
    worst.pixels(ours, theirs)
worst.end()
