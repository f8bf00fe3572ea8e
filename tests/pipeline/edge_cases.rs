//! Edge cases: two cameras, one person, a camera without detections, one camera, no person.

use super::{solved, worst_pair_deg};
use nalgebra::Vector3;
use wandless::geometry::Rigid;
use wandless::pipeline::config::Extrinsics;
use wandless::pipeline::{Options, PipelineError, reconstruct};
use wandless::progress::Progress;
use wandless::session::BodyMotion;
use wandless::session::reconstruction::Verdict;
use wandless::simulation::{Arrangement, Bodies, NoiseConfig, Preset, SimulationConfig, Tracks, simulate};

fn paper(people: usize, views: usize, frames: usize) -> SimulationConfig {
    SimulationConfig { people, views, frames, tracks: Tracks::None, ..SimulationConfig::preset(Preset::Paper) }
}

#[test]
fn solves_two_cameras_and_two_people() {
    let mut config = paper(2, 2, 200);
    config.rig.arrangement = Arrangement::Arc { span_deg: 90.0 };
    let (simulated, found) = solved(&config);
    assert!(worst_pair_deg(&simulated, &found) < 2.0);
    assert_eq!(found.motions.len(), 2);
}

#[test]
fn solves_one_person_in_four_cameras() {
    let (simulated, found) = solved(&paper(1, 4, 200));
    assert!(worst_pair_deg(&simulated, &found) < 2.0);
    assert_eq!(found.motions.len(), 1);
}

/// Errors of thousandths of a pixel made outliers of all pixels that the first fit missed, and wrists and ankles ended 200 mm off.
#[test]
fn exact_pixels_lost_the_limbs() {
    let (simulated, found) =
        solved(&SimulationConfig { noise: NoiseConfig::NONE, bodies: Bodies::Default, ..paper(2, 5, 60) });
    for joint in [7, 8, 20, 21] {
        // In pixels, since the scale of the world is the adults' guess.
        let in_view = |v: usize, joints: &[Vector3<f64>], camera: Option<&Rigid>| {
            simulated.session.views[v].intrinsics.pixel_from_camera(&camera?.transform(&joints[joint]))
        };
        let error = |v: usize, t: usize, motion: &BodyMotion| {
            let pixel = in_view(v, &motion.frames[t].joints, found.cameras[v].camera_from_world.as_ref())?;
            let of_people = simulated.truth.joints[t].iter();
            let truth = of_people.filter_map(|joints| in_view(v, joints, Some(&simulated.truth.cameras[v])));
            truth.map(|truth| (truth - pixel).norm()).min_by(f64::total_cmp)
        };
        let of_motion = |motion| (0..5).flat_map(move |v| (0..60).filter_map(move |t| error(v, t, motion)));
        let errors: Vec<f64> = found.motions.iter().flat_map(of_motion).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(mean < 1.0, "joint {joint}: {mean} px");
    }
}

/// Tolerances of a sixth of people's height let wrong poses of cameras pass for right ones.
#[test]
fn solves_long_lenses_from_far_away() {
    for seed in 1..=3 {
        let mut config = SimulationConfig { seed, ..paper(2, 5, 200) };
        config.rig.arrangement = Arrangement::Arc { span_deg: 120.0 };
        (config.rig.radius, config.rig.height, config.rig.fov_deg) = (18.0, 3.0, 18.0);
        (config.rig.image_width, config.rig.image_height) = (1920, 1080);
        let (simulated, found) = solved(&config);
        let worst = worst_pair_deg(&simulated, &found);
        assert!(worst < 1.5 && found.motions.len() == 2, "seed {seed}: {worst} degrees");
    }
}

#[test]
fn a_camera_without_detections_stays_unsolved() {
    let mut simulated = simulate(&paper(2, 5, 150)).unwrap();
    simulated.session.views[2].frames.iter_mut().for_each(Vec::clear);
    let found = reconstruct(&simulated.session, &Options::default(), &Progress::silent()).unwrap();
    assert!(found.cameras[2].camera_from_world.is_none());
    assert_eq!(found.cameras.iter().filter(|c| c.camera_from_world.is_some()).count(), 4);
    assert!(worst_pair_deg(&simulated, &found) < 1.0);
    let id = &simulated.session.views[2].id;
    assert!(found.report.quality.reasons.iter().any(|r| r.contains(id.as_str())));
    assert_eq!(found.report.quality.verdict, Verdict::Warn);
}

#[test]
fn a_single_camera_is_rejected_as_monocular() {
    let (_, found) = solved(&paper(2, 1, 60));
    assert_eq!(found.report.quality.verdict, Verdict::Reject);
    assert!(found.report.quality.reasons[0].contains("monocular"));
    assert!(found.cameras[0].camera_from_world.is_none() && found.motions.is_empty());
}

#[test]
fn refuses_a_session_without_detections() {
    let mut simulated = simulate(&paper(1, 3, 30)).unwrap();
    simulated.session.views.iter_mut().flat_map(|v| &mut v.frames).for_each(Vec::clear);
    let error = reconstruct(&simulated.session, &Options::default(), &Progress::silent()).unwrap_err();
    assert!(matches!(error, PipelineError::Unsolvable { code: "no_person_detected", .. }));
}

#[test]
fn given_cameras_are_kept_exactly() {
    let mut simulated = simulate(&paper(2, 4, 80)).unwrap();
    for (view, truth) in simulated.session.views.iter_mut().zip(&simulated.truth.cameras) {
        view.camera_from_world = Some(*truth);
    }
    let options = Options { extrinsics: Extrinsics::Fixed, ..Options::default() };
    let found = reconstruct(&simulated.session, &options, &Progress::silent()).unwrap();
    let kept = found.cameras.iter().zip(&simulated.truth.cameras).all(|(c, t)| c.camera_from_world == Some(*t));
    assert!(kept);
    assert_eq!(found.motions.len(), 2);
}

#[test]
fn very_short_and_very_sparse_sessions_end_cleanly() {
    for (frames, stride) in [(10, 1), (300, 30)] {
        let mut simulated = simulate(&paper(2, 4, frames)).unwrap();
        for view in &mut simulated.session.views {
            view.frames = view.frames.iter().step_by(stride).cloned().collect();
            view.delivered.truncate(view.frames.len());
        }
        simulated.session.n_frames = simulated.session.views[0].frames.len();
        simulated.session.fps /= stride as f64;
        match reconstruct(&simulated.session, &Options::default(), &Progress::silent()) {
            Ok(found) => {
                let good = worst_pair_deg(&simulated, &found) < 5.0;
                assert!(
                    good || found.report.quality.verdict != Verdict::Pass,
                    "{frames} frames: wrong without a warning"
                );
            }
            Err(error) => assert!(matches!(error, PipelineError::Unsolvable { .. })),
        }
    }
}
