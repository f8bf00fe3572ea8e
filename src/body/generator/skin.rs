//! Skin weights from a point's distances to the bones.

use super::half_mesh::HalfMesh;
use super::relaxation::neighbours;
use crate::body::skeleton::{JOINT_COUNTERPARTS, JOINT_NAMES, N_JOINTS, PARENTS};
use crate::body::surface::JointWeight;
use nalgebra::Vector3;

/// Weights of all joints at one vertex.
type Row = [f64; N_JOINTS];

/// A bone farther away than the nearest one by this distance has no weight, m. At 60 degrees of flexion the groin's sharpest edge has 66
/// degrees, with 60 mm 83; with more, squats lose more volume.
const REACH: f64 = 0.080;
/// Smoothing rounds over the mesh.
const SMOOTHING: usize = 6;
/// Most joints of a vertex.
const MOST: usize = 4;
/// Vertices farther than this from the midplane have no weight on limbs of the other side, m.
const SIDE_MARGIN: f64 = 0.018;

/// The weights of every vertex of the left half: at most four, in descending order, summing to 1.
///
/// A joint's weight falls with the distance of its bone beyond that of the nearest bone, `(1 - excess / reach)^3`; only the
/// nearest bone's joint, its parent and its children have weights, so that an arm is not attached to a hip. The weights are
/// then smoothed over the mesh and its mirror image.
pub(super) fn skin_weights(mesh: &HalfMesh, joints: &[Vector3<f64>; N_JOINTS], tips: &Tips) -> Vec<Vec<JointWeight>> {
    let bones = bones(joints, tips);
    let near = neighbours(mesh);
    let mut rows: Vec<Row> = mesh.vertices.iter().map(|vertex| distance_shares(&bones, vertex)).collect();
    for (row, on_plane) in rows.iter_mut().zip(&mesh.on_plane) {
        if *on_plane {
            *row = mean(*row, mirrored(row));
        }
    }
    for _ in 0..SMOOTHING {
        rows = smoothed(&rows, &near, &mesh.on_plane);
    }
    rows.iter().zip(&mesh.vertices).map(|(row, vertex)| strongest(row, vertex)).collect()
}

/// Ends of the bones without a child joint, left side, m.
pub(super) struct Tips {
    pub crown: Vector3<f64>,
    pub finger: Vector3<f64>,
    pub toe: Vector3<f64>,
    pub heel: Vector3<f64>,
    /// Lower end of the pelvis, between the legs.
    pub crotch: Vector3<f64>,
}

/// The segment of one joint.
struct Bone {
    joint: usize,
    from: Vector3<f64>,
    to: Vector3<f64>,
}

/// The bones at x >= 0 and on the midline.
fn bones(joints: &[Vector3<f64>; N_JOINTS], tips: &Tips) -> Vec<Bone> {
    let is_right = |joint: usize| JOINT_NAMES[joint].starts_with("right_");
    let index = |name: &str| JOINT_NAMES.iter().position(|n| *n == name).expect("the names below are joints");
    let to_child = |child: usize| {
        let joint = PARENTS[child]?;
        (!is_right(child)).then(|| Bone { joint, from: joints[joint], to: joints[child] })
    };
    let to_tip = |name: &str, to: Vector3<f64>| Bone { joint: index(name), from: joints[index(name)], to };
    let ends = [
        to_tip("head", tips.crown),
        to_tip("left_hand", tips.finger),
        to_tip("left_foot", tips.toe),
        to_tip("left_ankle", tips.heel),
        to_tip("pelvis", tips.crotch),
    ];
    (1..N_JOINTS).filter_map(to_child).chain(ends).collect()
}

fn distance_to(bone: &Bone, point: &Vector3<f64>) -> f64 {
    let along = bone.to - bone.from;
    let t = ((point - bone.from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (point - bone.from - along * t).norm()
}

fn distance_shares(bones: &[Bone], point: &Vector3<f64>) -> Row {
    let mut distances = [f64::INFINITY; N_JOINTS];
    for bone in bones {
        distances[bone.joint] = distances[bone.joint].min(distance_to(bone, point));
    }
    let nearest = (0..N_JOINTS).fold(0, |best, j| if distances[j] < distances[best] { j } else { best });
    let takes_part = |j: usize| j == nearest || PARENTS[j] == Some(nearest) || PARENTS[nearest] == Some(j);
    normalised(std::array::from_fn(|j| {
        if !takes_part(j) {
            return 0.0;
        }
        let nearness = 1.0 - ((distances[j] - distances[nearest]) / REACH).min(1.0);
        nearness * nearness * nearness
    }))
}

fn smoothed(rows: &[Row], near: &[Vec<usize>], on_plane: &[bool]) -> Vec<Row> {
    let smooth = |i: usize| {
        let mut sum: Row = rows[i].map(|v| v * near[i].len() as f64);
        for &n in &near[i] {
            let twice = on_plane[i] && !on_plane[n];
            let row = if twice { mean(rows[n], mirrored(&rows[n])) } else { rows[n] };
            (0..N_JOINTS).for_each(|j| sum[j] += row[j]);
        }
        normalised(sum)
    };
    (0..rows.len()).map(smooth).collect()
}

fn mirrored(row: &Row) -> Row {
    JOINT_COUNTERPARTS.map(|joint| row[joint])
}

fn mean(a: Row, b: Row) -> Row {
    std::array::from_fn(|j| 0.5 * (a[j] + b[j]))
}

fn normalised(row: Row) -> Row {
    let total: f64 = row.iter().sum();
    row.map(|v| v / total)
}

/// The four largest weights; on the plane left and right joints come in pairs, so that the mirror image is the same.
fn strongest(row: &Row, vertex: &Vector3<f64>) -> Vec<JointWeight> {
    let is_far = vertex.x > SIDE_MARGIN;
    let allowed = |j: &usize| !(is_far && JOINT_NAMES[*j].starts_with("right_"));
    let share = |joint: usize| JointWeight { joint, weight: row[joint] };
    let mut shares: Vec<JointWeight> = (0..N_JOINTS).filter(allowed).map(share).filter(|s| s.weight > 2e-3).collect();
    shares.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.joint.cmp(&b.joint)));
    let splits_a_pair = |n: usize, shares: &[JointWeight]| {
        vertex.x == 0.0 && shares.len() > n && shares[n - 1].joint == JOINT_COUNTERPARTS[shares[n].joint]
    };
    let kept = if splits_a_pair(MOST, &shares) { MOST - 1 } else { MOST };
    shares.truncate(kept);
    let total: f64 = shares.iter().map(|s| s.weight).sum();
    shares.iter_mut().for_each(|s| s.weight /= total);
    shares
}
