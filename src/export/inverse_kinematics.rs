//! `<person>.ik.xml`: a set-up of OpenSim's inverse kinematics for `<person>.trc` (`InverseKinematicsTool`, OpenSim 4).
//!
//! The marker names are those of the 24 joints. `model_file` is left to the user: a scaled model needs markers of these names
//! at its joint centres. Weights are inversely proportional to the joints' mean variances, 1 for the best joint; all 1 where
//! the result has no standard deviations.

use super::take::Take;
use crate::body::skeleton::{JOINT_NAMES, N_JOINTS};
use crate::session::BodyMotion;

/// The file.
pub(super) fn set_up(take: &Take, motion: &BodyMotion) -> String {
    let person = motion.person.0;
    let first = motion.first.0;
    let [start, end] = [first, first + motion.frames.len().saturating_sub(1)].map(|index| index as f64 / take.fps);
    let tasks: String = JOINT_NAMES.iter().zip(weights(motion)).map(|(name, weight)| task(name, weight)).collect();
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40000">
    <InverseKinematicsTool name="person_{person}">
        <model_file>Unassigned</model_file>
        <marker_file>{person}.trc</marker_file>
        <coordinate_file>Unassigned</coordinate_file>
        <time_range>{start:.6} {end:.6}</time_range>
        <report_errors>true</report_errors>
        <output_motion_file>{person}.ik.mot</output_motion_file>
        <IKTaskSet>
            <objects>
{tasks}            </objects>
        </IKTaskSet>
    </InverseKinematicsTool>
</OpenSimDocument>
"#
    )
}

fn task(name: &str, weight: f64) -> String {
    format!(
        r#"                <IKMarkerTask name="{name}">
                    <apply>true</apply>
                    <weight>{weight:.3}</weight>
                </IKMarkerTask>
"#
    )
}

fn weights(motion: &BodyMotion) -> [f64; N_JOINTS] {
    let Some(sigmas) = motion.joint_sigmas.as_ref().filter(|sigmas| !sigmas.is_empty()) else { return [1.0; N_JOINTS] };
    let variances: [f64; N_JOINTS] =
        std::array::from_fn(|joint| sigmas.iter().map(|frame| frame[joint].powi(2)).sum::<f64>() / sigmas.len() as f64);
    let best = variances.iter().copied().fold(f64::INFINITY, f64::min);
    if !(best > 0.0 && variances.iter().all(|variance| variance.is_finite())) {
        return [1.0; N_JOINTS];
    }
    variances.map(|variance| best / variance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::sample_motion::motion;

    #[test]
    fn weights_are_inverse_variances() {
        let mut frame = [0.02; N_JOINTS];
        frame[4] = 0.01;
        let motion = BodyMotion { joint_sigmas: Some(vec![frame; 3]), ..motion() };
        let weights = weights(&motion);
        assert!((weights[4] - 1.0).abs() < 1e-12 && (weights[5] - 0.25).abs() < 1e-12);
        let unknown = BodyMotion { joint_sigmas: Some(vec![[f64::NAN; N_JOINTS]]), ..motion };
        assert_eq!(super::weights(&unknown), [1.0; N_JOINTS]);
    }
}
