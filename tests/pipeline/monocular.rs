//! A single camera with known pose: people are found and face the right way.

use super::identity_shares;
use nalgebra::{Matrix3, Vector3};
use wandless::geometry::Rigid;
use wandless::pipeline::config::Extrinsics;
use wandless::pipeline::{Options, reconstruct};
use wandless::progress::Progress;
use wandless::session::Reconstruction;
use wandless::session::reconstruction::Verdict;
use wandless::simulation::config::Tracks;
use wandless::simulation::presets::Preset;
use wandless::simulation::{Simulated, SimulationConfig, simulate};

/// Limb joints, left and right hip and shoulder of SMPL's 24.
const LIMBS: [usize; 12] = [1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21];
const LEFT_HIP: usize = 1;
const RIGHT_HIP: usize = 2;
const LEFT_SHOULDER: usize = 16;
const RIGHT_SHOULDER: usize = 17;

/// Two people before one camera with a typical detector; the camera's pose is given in the turned world.
fn before_one_camera(turned_from_world: &Rigid) -> (Simulated, Reconstruction) {
    let preset = SimulationConfig::preset(Preset::Paper);
    let config = SimulationConfig { people: 2, views: 1, frames: 150, tracks: Tracks::None, ..preset };
    let mut simulated = simulate(&config).unwrap();
    simulated.session.views[0].camera_from_world = Some(simulated.truth.cameras[0] * turned_from_world.inverse());
    let options = Options { extrinsics: Extrinsics::Fixed, ..Options::default() };
    let found = reconstruct(&simulated.session, &options, &Progress::silent()).unwrap();
    (simulated, found)
}

/// Mean distance of limb joints after aligning the middles of the hips (m), and the share of poses that face less than a
/// right angle off, over all frames of all persons.
fn pose_statistics(simulated: &Simulated, found: &Reconstruction, turned_from_world: &Rigid) -> (f64, f64) {
    let (mut error, mut n_facing, mut n) = (0.0, 0usize, 0usize);
    for motion in &found.motions {
        let mut votes = [0usize; 2];
        for (truth, given) in simulated.truth.identities[0].iter().zip(&found.identities[0]) {
            truth
                .iter()
                .zip(given)
                .filter(|(_, g)| **g == Some(motion.person))
                .for_each(|(t, _)| votes[t.unwrap()] += 1);
        }
        let person = usize::from(votes[1] > votes[0]);
        for (t, frame) in motion.frames.iter().enumerate() {
            let truth = simulated.truth.joints[motion.first.0 + t][person].map(|x| turned_from_world.rotation * x);
            let middle = |joints: &[Vector3<f64>]| (joints[LEFT_HIP] + joints[RIGHT_HIP]) / 2.0;
            let across = |j: &[Vector3<f64>]| j[LEFT_HIP] - j[RIGHT_HIP] + j[LEFT_SHOULDER] - j[RIGHT_SHOULDER];
            let off = |j: usize| frame.joints[j] - middle(&frame.joints) - truth[j] + middle(&truth);
            error += LIMBS.iter().map(|j| off(*j).norm()).sum::<f64>() / LIMBS.len() as f64;
            n_facing += usize::from(across(&frame.joints).dot(&across(&truth)) > 0.0);
            n += 1;
        }
    }
    (error / n as f64, n_facing as f64 / n as f64)
}

/// The bound of 150 mm is the promised accuracy of a single view; 80 to 110 are usual.
#[test]
fn two_people_before_one_camera_face_the_right_way() {
    let world = Rigid::identity();
    let (simulated, found) = before_one_camera(&world);
    assert_eq!(found.motions.len(), 2);
    let (right, given) = identity_shares(&simulated, &found);
    assert!(right > 0.95 && given > 0.9, "{right} of {given}");
    let (error, facing) = pose_statistics(&simulated, &found, &world);
    assert!(error < 0.15 && facing > 0.9, "{error} m, {facing}");
    let quality = &found.report.quality;
    assert_eq!(quality.verdict, Verdict::Warn, "{:?}", quality.reasons);
    assert!(quality.reasons[0].contains("body size"));
    let scale = found.report.scale.as_ref().unwrap();
    assert!(scale.interval95[1] / scale.interval95[0] > 1.15);
    assert!(found.keypoints.iter().flat_map(|path| path.n_views.iter().flatten()).all(|n| *n <= 1));
}

#[test]
fn the_camera_shows_the_up_axis_of_an_unnamed_world() {
    // z up, as surveys have it; the default of the options is y.
    let rotation = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);
    let turned_from_world = Rigid { rotation, translation: Vector3::zeros() };
    let (simulated, found) = before_one_camera(&turned_from_world);
    let (error, facing) = pose_statistics(&simulated, &found, &turned_from_world);
    assert!(error < 0.15 && facing > 0.9, "{error} m, {facing}");
}
