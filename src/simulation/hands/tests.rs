//! Detected hands against their truth.

use super::{HandNoise, has_details};
use crate::body::hand::{N_FACE_POINTS, N_HAND_POINTS, Side, hand_keypoints};
use crate::body::skeleton::KeypointConvention;
use crate::simulation::{NoiseConfig, Preset, SimulationConfig, simulate};

fn config(convention: KeypointConvention, swap_rate: f64) -> SimulationConfig {
    let hands =
        HandNoise { jitter_of_size: 0.0, outlier_rate: 0.0, missed_point_rate: 0.0, missed_rate: 0.0, swap_rate };
    SimulationConfig {
        frames: 40,
        views: 3,
        convention,
        noise: NoiseConfig::NONE,
        hands: Some(hands),
        ..SimulationConfig::preset(Preset::Paper)
    }
}

/// Every reported point of a hand is the projection of that of the person and side that the truth names.
fn assert_hands_are_those_of_the_truth(convention: KeypointConvention) {
    let simulated = simulate(&config(convention, 0.3)).unwrap();
    let (session, truth) = (&simulated.session, &simulated.truth);
    let (mut n_points, mut n_swapped) = (0, 0);
    for (v, view) in session.views.iter().enumerate() {
        for (frame, detections) in view.frames.iter().enumerate() {
            for (d, detection) in detections.iter().enumerate() {
                for side in Side::BOTH {
                    let (person, own) = truth.hands[v][frame][d][side as usize].unwrap();
                    n_swapped += usize::from((Some(person), own) != (truth.identities[v][frame][d], side));
                    let first = N_FACE_POINTS + N_HAND_POINTS * own as usize;
                    let keypoints = &detection.keypoints[hand_keypoints(session.convention, side).unwrap()];
                    for (k, keypoint) in keypoints.iter().enumerate().filter(|(_, keypoint)| keypoint.is_present()) {
                        let place = truth.cameras[v].transform(&truth.details[frame][person][first + k]);
                        let pixel = view.intrinsics.pixel_from_camera(&place).unwrap();
                        assert!((pixel - keypoint.pixel).norm() < 0.01, "view {v}, frame {frame}, {side:?} {k}");
                        n_points += 1;
                    }
                }
            }
        }
    }
    // Two hands in three tenths of 120 frames; the rate's standard error is a seventh of it.
    assert!(n_points > 5000 && (40..110).contains(&n_swapped), "{n_points} points, {n_swapped} swapped");
}

#[test]
fn hands_are_those_that_the_truth_names() {
    assert_hands_are_those_of_the_truth(KeypointConvention::CocoWholebody133);
    assert_hands_are_those_of_the_truth(KeypointConvention::Halpe136);
}

#[test]
fn hands_without_a_face_are_those_that_the_truth_names() {
    assert_hands_are_those_of_the_truth(KeypointConvention::Body25Hands);
    assert_hands_are_those_of_the_truth(KeypointConvention::Blazepose75);
}

#[test]
fn other_conventions_have_no_details() {
    let config = config(KeypointConvention::Coco17, 0.3);
    assert!(!has_details(config.convention));
    let truth = simulate(&config).unwrap().truth;
    assert!(truth.hands.iter().all(Vec::is_empty) && truth.details.iter().flatten().all(Vec::is_empty));
}
