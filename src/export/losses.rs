//! Losses: the parts of a take that a format cannot represent, as sentences for the manifest.

use super::take::{Take, TakeCamera};
use crate::geometry::{Distortion, Intrinsics};
use crate::session::BodyMotion;
use crate::session::reconstruction::ExportFormat as F;

/// Camera parameters that a format can represent.
struct CameraSupport {
    principal_point: bool,
    /// Number of leading coefficients of `k1 k2 p1 p2 k3`.
    n_distortions: usize,
    /// The rational distortion model.
    rational: bool,
    /// The fisheye distortion model.
    fisheye: bool,
    skew: bool,
    /// Pixels that are not square, `fx` other than `fy`.
    pixel_aspect: bool,
}

fn support(format: F) -> Option<CameraSupport> {
    let all = CameraSupport {
        principal_point: true,
        n_distortions: 5,
        rational: true,
        fisheye: true,
        skew: true,
        pixel_aspect: true,
    };
    let no_lens = CameraSupport { n_distortions: 0, rational: false, fisheye: false, ..all };
    match format {
        F::SmplNpz | F::Bvh | F::Fbx | F::Trc | F::C3d | F::JointAngles => None,
        F::AniposeToml => Some(all),
        F::Easymocap | F::OpencvYaml => Some(CameraSupport { fisheye: false, ..all }),
        F::CalibToml => Some(CameraSupport { n_distortions: 4, rational: false, ..all }),
        F::Colmap => Some(CameraSupport { skew: false, ..all }),
        F::Usd => Some(CameraSupport { skew: false, ..no_lens }),
        F::Blender => Some(CameraSupport { skew: false, pixel_aspect: false, ..no_lens }),
        F::Glb => Some(CameraSupport { principal_point: false, skew: false, ..no_lens }),
        F::Chan => Some(CameraSupport { principal_point: false, skew: false, pixel_aspect: false, ..no_lens }),
    }
}

/// How a scene with its own clock shows people in frames in which they are absent; `None`: its files end there.
fn absence(format: F) -> Option<&'static str> {
    match format {
        F::Bvh => Some("the nearest pose is held, since the format cannot hide a person"),
        F::Glb => Some("the person has the size 0, since the format cannot hide a person"),
        F::Fbx => Some("the nearest pose is held and hidden, which some programs ignore"),
        _ => None,
    }
}

/// One sentence for each person and camera that the format lacks or represents incompletely.
pub(super) fn losses(format: F, take: &Take) -> Vec<String> {
    let mut lost = lost_meshes(format, take);
    lost.extend(take.motions.iter().filter_map(|motion| lost_absence(format, take, motion)));
    lost.extend(lost_fingers(format, take));
    lost.extend(lost_cameras(format, take));
    lost
}

fn lost_fingers(format: F, take: &Take) -> Option<String> {
    take.motions.iter().find(|motion| motion.hands.is_some())?;
    let sentence = match format {
        F::Easymocap | F::Blender | F::Trc | F::C3d | F::JointAngles => {
            "people: fingers are left out; see people.json, or the formats smpl_npz, glb, usd, fbx and bvh"
        }
        F::Glb | F::Usd | F::Fbx => "people: fingers are bones; the hands of the mesh do not bend",
        _ => return None,
    };
    Some(sentence.to_owned())
}

fn lost_meshes(format: F, take: &Take) -> Vec<String> {
    let name = &take.body_model.name;
    match &take.body {
        _ if !matches!(format, F::Glb | F::Usd | F::Fbx) || take.motions.is_empty() => Vec::new(),
        None => vec![format!(
            "people: skeletons without mesh, since the body {name} may not be distributed with results; `wandless export --body \
             FILE` adds the mesh of a body that you hold"
        )],
        Some(body) if !body.surface.pose_directions.is_empty() => {
            vec![format!("people: the format does not support the pose directions of the body {name}")]
        }
        Some(_) => Vec::new(),
    }
}

fn lost_absence(format: F, take: &Take, motion: &BodyMotion) -> Option<String> {
    let ([start, end], [first, last]) = (take.frame_range(), take.presence(motion));
    let mut absent = Vec::new();
    if first > start {
        absent.push(format!("before frame {first}"));
    }
    if last < end {
        absent.push(format!("after frame {last}"));
    }
    let how = absence(format).filter(|_| !absent.is_empty())?;
    Some(format!("person {}: absent {}; {how}", motion.person.0, absent.join(" and ")))
}

fn lost_cameras(format: F, take: &Take) -> Vec<String> {
    if format == F::Fbx && !take.cameras.is_empty() {
        return vec!["cameras: left out; see cameras.json, or the formats glb and usd".to_owned()];
    }
    let Some(support) = support(format) else { return Vec::new() };
    let unsolved =
        take.unsolved.iter().map(|id| format!("camera {id}: its pose was not solved, and the camera is left out"));
    let partial = take.cameras.iter().filter_map(|camera| {
        let lost = lost(&support, &camera.intrinsics);
        (!lost.is_empty()).then(|| sentence(camera, &lost))
    });
    unsolved.chain(partial).collect()
}

/// Differences below this, px, are ignored: of the principal point from the centre, and of the two focal lengths.
const SAME_PX: f64 = 1e-6;

fn lost(support: &CameraSupport, lens: &Intrinsics) -> Vec<&'static str> {
    let middle = [f64::from(lens.width) - 1.0, f64::from(lens.height) - 1.0].map(|size| size / 2.0);
    let is_off_centre = (lens.cx - middle[0]).abs() > SAME_PX || (lens.cy - middle[1]).abs() > SAME_PX;
    let mut lost = Vec::new();
    if is_off_centre && !support.principal_point {
        lost.push("the principal point");
    }
    if (lens.fx - lens.fy).abs() > SAME_PX && !support.pixel_aspect {
        lost.push("different focal lengths");
    }
    if lens.skew != 0.0 && !support.skew {
        lost.push("skew");
    }
    lost.extend(match lens.dist {
        Distortion::OpenCv5(dist) if dist[support.n_distortions..].iter().any(|d| *d != 0.0) => {
            Some(if support.n_distortions == 4 { "k3" } else { "distortion" })
        }
        Distortion::Rational8(_) if !support.rational => Some("rational distortion"),
        Distortion::Fisheye4(_) if !support.fisheye => Some("fisheye distortion"),
        _ => None,
    });
    lost
}

fn sentence(camera: &TakeCamera, lost: &[&str]) -> String {
    format!("camera {}: the format does not support {}; see cameras.json", camera.id, lost.join(" and "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::default_body;
    use crate::geometry::Rigid;
    use crate::session::reconstruction::BodyModelId;
    use crate::session::recording::UpAxis;
    use crate::session::{FrameIndex, PersonId};

    fn take(lens: Intrinsics) -> Take {
        let camera = TakeCamera { id: "a".to_owned(), intrinsics: lens, camera_from_world: Rigid::identity() };
        Take {
            name: String::new(),
            fps: 25.0,
            first_frame: 0,
            n_frames: 1,
            up_axis: UpAxis::Y,
            cameras: vec![camera],
            unsolved: vec!["b".to_owned()],
            motions: Vec::new(),
            names: std::collections::BTreeMap::new(),
            keypoint_names: Vec::new(),
            keypoints: std::collections::BTreeMap::new(),
            body_model: BodyModelId { name: "studio".to_owned(), sha256: String::new() },
            body: None,
        }
    }

    fn plain() -> Intrinsics {
        Intrinsics { width: 101, height: 51, fx: 80.0, fy: 80.0, cx: 50.0, cy: 25.0, skew: 0.0, dist: Distortion::None }
    }

    #[test]
    fn reports_absent_people_and_bodies_that_are_not_free() {
        let mut take = Take { n_frames: 10, first_frame: 300, unsolved: Vec::new(), ..take(plain()) };
        let rest = crate::session::people::BodyPose {
            rotations: [nalgebra::Matrix3::identity(); 24],
            translation: nalgebra::Vector3::zeros(),
            joints: default_body().rest_joints,
            valid: true,
        };
        let motion = |first: usize, n: usize| BodyMotion {
            person: PersonId(first),
            first: FrameIndex(first),
            betas: [0.0; 10],
            frames: vec![rest.clone(); n],
            joint_sigmas: None,
            hands: None,
        };
        take.motions = vec![motion(0, 10), motion(2, 3)];
        let bvh = losses(F::Bvh, &take);
        assert_eq!(bvh.len(), 1);
        assert!(bvh[0].starts_with("person 2: absent before frame 302 and after frame 304; the nearest pose is held"));
        assert!(losses(F::Usd, &take)[0].contains("the body studio may not be distributed"));
        assert!(losses(F::Trc, &take).is_empty());
        take.body = Some(default_body());
        assert!(losses(F::Usd, &take).is_empty(), "the default body is free, and visibility hides people");
    }

    #[test]
    fn reports_fingers_where_they_are_lost() {
        let mut take = take(plain());
        take.motions = vec![crate::export::sample_motion::motion_with_fingers()];
        let lost = |format: F| losses(format, &take).iter().any(|loss| loss.contains("fingers"));
        assert!(lost(F::Trc) && lost(F::Glb) && !lost(F::Bvh) && !lost(F::SmplNpz));
    }

    #[test]
    fn reports_only_parameters_in_use() {
        let plain = plain();
        assert_eq!(losses(F::Chan, &take(plain)), ["camera b: its pose was not solved, and the camera is left out"]);
        assert!(losses(F::Bvh, &take(plain)).is_empty());
        let k3 = Intrinsics { dist: Distortion::OpenCv5([0.1, 0.0, 0.0, 0.0, 0.01]), ..plain };
        let pose2sim = losses(F::CalibToml, &take(k3));
        assert_eq!(pose2sim[1], "camera a: the format does not support k3; see cameras.json");
        assert_eq!(losses(F::AniposeToml, &take(k3)).len(), 1);
        let rational = Intrinsics { dist: Distortion::Rational8([0.1, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0]), ..plain };
        assert!(losses(F::CalibToml, &take(rational))[1].contains("rational distortion"));
        assert_eq!(losses(F::OpencvYaml, &take(rational)).len(), 1);
        let fisheye = Intrinsics { dist: Distortion::Fisheye4([0.1, 0.0, 0.0, 0.0]), ..plain };
        assert!(losses(F::OpencvYaml, &take(fisheye))[1].contains("fisheye distortion"));
        assert_eq!(losses(F::Colmap, &take(fisheye)).len(), 1);
        assert_eq!(losses(F::CalibToml, &take(fisheye)).len(), 1);
        let odd = Intrinsics { cx: 53.0, fy: 81.0, skew: 0.1, ..k3 };
        assert!(losses(F::Chan, &take(odd))[1].contains("the principal point and different focal lengths and skew"));
    }
}
