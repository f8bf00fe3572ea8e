//! Shorter steps of persons whose limbs turn further than the linearisation holds.
//!
//! Where a limb turns round (an elbow that bends the other way, an upper arm that twists by half a turn) the whole step overshoots
//! by a radian and more over some ten frames. Rejected as a whole, it held up the cameras and all others: three or four
//! eliminations with more damping each time, until the cameras hardly moved either. Such a person follows the session's step, and
//! takes a share of its own; the rest is left to later steps.

use super::reduced::{Reduced, Step};
use super::*;

/// Shares of a person's own step that are tried beside the whole of it. A joint that overshoots turns by one to two radians;
/// rotations are linear to some tenths.
const SHARES: [f64; 3] = [0.3, 0.1, 0.0];

impl JointProblem<'_> {
    /// Gives persons whose own cost rose in a step the share of their own step that costs least. `from`: where the step began, with
    /// what the members were there; `to`: where it has led.
    pub(super) fn shorten(
        &self,
        (members, pixels): (&mut [Member], &[DetectedPixels]),
        (reduced, step): (&Reduced, &Step),
        (from, before): (&Minimum, &[MotionAndBones]),
        to: &mut Minimum,
    ) {
        let model = self.model_with(&to.session.offsets);
        for (k, member) in members.iter_mut().enumerate() {
            if to.costs.of_people[k] <= from.costs.of_people[k] {
                continue;
            }
            let (state, bones) = &before[k];
            for share in SHARES {
                let Some(shorter) = reduced.motion_step(k, &step.session, share) else { continue };
                let moved = self.moved(member, &pixels[k], (state, bones), &shorter);
                let previous = member.replaced(moved, &to.session.cameras);
                let cost = self.cost_of(&model, member, &pixels[k]);
                if cost < to.costs.of_people[k] {
                    to.costs.of_people[k] = cost;
                } else {
                    member.replaced(previous, &to.session.cameras);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::observations::PixelObservation;
    use super::super::super::test_fixtures::{Surroundings, camera_in_front, seen};
    use super::*;
    use crate::body::kinematics::{Pose, landmark_position, posed};
    use crate::body::model::Betas;
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::rotation;

    const N_FRAMES: usize = 12;

    /// In front of the person and to both sides.
    fn cameras() -> Vec<PosedCamera> {
        [-1.0, 0.0, 1.0].map(camera_in_front).to_vec()
    }

    /// A person who stands with the left forearm ahead, seen without errors. `start`: where the fit begins.
    fn member(model: &BodyModel, start: Pose) -> Member {
        let body = model.shaped(&Betas::zeros());
        let skeleton = posed(&body, &standing());
        let landmarks = KeypointConvention::Coco17.names().iter().filter_map(|name| model.landmark_index(name));
        let pixels_of = |landmark: usize| {
            let position = landmark_position(model, &body, &skeleton, landmark);
            cameras().into_iter().enumerate().map(move |(camera, posed)| {
                let pixel = posed.intrinsics.pixel_from_camera(&posed.camera_from_world.transform(&position)).unwrap();
                PixelObservation { pixel, scale_px: 400.0, ..seen(landmark, camera) }
            })
        };
        let frame: Vec<PixelObservation> = landmarks.flat_map(pixels_of).collect();
        let observations =
            Observations { cameras: cameras(), points: vec![Vec::new(); N_FRAMES], pixels: vec![frame; N_FRAMES] };
        let state = MotionState { betas: Betas::zeros(), poses: vec![start; N_FRAMES] };
        Member { run: 0..N_FRAMES, stride: 1, observations, state, bones: BoneOffsets::default(), betas_alone: None }
    }

    fn standing() -> Pose {
        let mut pose = Pose::rest();
        pose.rotations[16] = rotation::exp(&(Vector3::z() * -1.0));
        pose.rotations[18] = rotation::exp(&(Vector3::y() * -1.3));
        pose
    }

    /// The left upper arm turned round about itself, its elbow bent to the other side.
    fn turned() -> Pose {
        let mut pose = standing();
        pose.rotations[16] *= rotation::exp(&(Vector3::x() * 1.5));
        pose.rotations[18] = rotation::exp(&(Vector3::y() * 0.5));
        pose
    }

    fn beside() -> Pose {
        Pose { translation: Vector3::new(0.02, 0.0, 0.0), ..standing() }
    }

    /// Two persons after a step that has turned an arm of the second one round: that one goes back as far as costs least, and the
    /// first one keeps the whole step.
    #[test]
    fn a_limb_that_turned_round_held_up_all_others() {
        let surroundings = Surroundings::new();
        let (context, model) = (surroundings.context(), &surroundings.model);
        let noise = PathNoise::white(model.landmarks.len(), 0.01);
        let problem = JointProblem {
            context: &context,
            table: None,
            noise: &noise,
            bone_prior: BoneLengthPrior { sigma: 0.01 },
            bias_prior: KeypointBiasPrior { sigmas: Vec::new() },
            cameras: None,
        };
        let session = || SessionState { offsets: Vec::new(), cameras: cameras() };
        let mut members = [member(model, beside()), member(model, beside())];
        let pixels = members.each_ref().map(|member| problem.pixels(member));
        let from = Minimum { session: session(), costs: problem.costs(&members, &pixels, &session()) };
        let reduced = problem.reduced((&members, &pixels), &session(), problem.systems(&members), DAMPING).unwrap();
        let step = reduced.solved(DAMPING).unwrap();
        let (_, before) = problem.stepped((&mut members, &pixels), &session(), &step);
        let whole = members.each_ref().map(|member| member.state.clone());
        members[1].state.poses.fill(turned());
        let mut to = Minimum { session: session(), costs: problem.costs(&members, &pixels, &session()) };
        assert!(to.costs.of_people[0] < from.costs.of_people[0] && to.costs.of_people[1] > from.costs.of_people[1]);
        problem.shorten((&mut members, &pixels), (&reduced, &step), (&from, &before), &mut to);
        let costs = problem.costs(&members, &pixels, &session());
        assert_eq!(costs.of_people, to.costs.of_people);
        assert!(members[0].state == whole[0] && costs.of_people[1] < from.costs.of_people[1]);
        // The largest share costs least of a step that does not overshoot; the person ends a third of the way from where it began.
        let moved =
            |state: &MotionState| state.poses[N_FRAMES / 2].translation - before[1].0.poses[N_FRAMES / 2].translation;
        let (part, all) = (moved(&members[1].state), moved(&whole[1]));
        assert!((part - all * SHARES[0]).norm() < 1e-9 && all.norm() > 0.01, "{part} {all}");
    }
}
