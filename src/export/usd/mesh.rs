//! The skinned mesh of a body as a UsdSkel-bound prim.

use super::text::{list, tuple};
use crate::body::surface::JointWeight;
use crate::export::skin::{MAX_JOINTS_PER_VERTEX, SkinMesh};
use crate::session::formats::rounded;
use nalgebra::Vector3;

/// The prim `<person>_body` below the person's SkelRoot, indented for it.
pub(super) fn prim(person: &str, mesh: &SkinMesh) -> String {
    let points = |points: &[Vector3<f64>]| list(points.iter().map(tuple));
    let shares = || mesh.skin.iter().flatten();
    let weights = |one: &JointWeight| format!("{:?}", rounded(one.weight, 7)); // single precision
    let bound = |pick: fn(f64, f64) -> f64| mesh.vertices.iter().copied().reduce(|a, b| a.zip_map(&b, pick));
    let extent = [bound(f64::min), bound(f64::max)].map(|corner| tuple(&corner.unwrap_or_default()));
    format!(
        r#"
        def Mesh "{person}_body" (
            prepend apiSchemas = ["SkelBindingAPI"]
        )
        {{
            uniform token subdivisionScheme = "none"
            uniform token orientation = "rightHanded"
            float3[] extent = [{extent}]
            int[] faceVertexCounts = {counts}
            int[] faceVertexIndices = {corners}
            point3f[] points = {points}
            normal3f[] normals = {normals} (
                interpolation = "vertex"
            )
            matrix4d primvars:skel:geomBindTransform = ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )
            int[] primvars:skel:jointIndices = {joints} (
                elementSize = {MAX_JOINTS_PER_VERTEX}
                interpolation = "vertex"
            )
            float[] primvars:skel:jointWeights = {weights} (
                elementSize = {MAX_JOINTS_PER_VERTEX}
                interpolation = "vertex"
            )
            rel skel:skeleton = </World/{person}/{person}_skeleton>
        }}
"#,
        extent = extent.join(", "),
        counts = list(mesh.faces.iter().map(|_| "3".to_owned())),
        corners = list(mesh.faces.iter().flatten().map(usize::to_string)),
        points = points(&mesh.vertices),
        normals = points(&mesh.normals),
        joints = list(shares().map(|one| one.joint.to_string())),
        weights = list(shares().map(weights)),
    )
}
