//! People whom one view alone holds: the other views' free detections that agree with it.
//!
//! One view keeps somebody in its image, but not in depth: after a second they may be a step away from where the others look
//! for them. What two views' rays say now then counts more than where the person was.

use super::birth::{agreement, essential, is_human};
use super::person::{detections_of, triangulated};
use super::{Scene, TrackerConfig, unclaimed};

/// A free detection that fits a person.
struct Offer {
    agreement: f64,
    person: usize,
    view: usize,
    detection: usize,
}

/// Gives free detections of a frame to people whom one view alone claims, best agreement first.
pub(super) fn rejoin(scene: &Scene, config: &TrackerConfig, frame: usize, claims: &mut [Vec<Option<usize>>]) {
    let is_alone = |claim: &[Option<usize>]| claim.iter().flatten().count() < scene.n_witnesses();
    if !claims.iter().any(|claim| is_alone(claim)) {
        return;
    }
    let free = unclaimed(scene, frame, claims);
    let mut offers = Vec::new();
    for (person, claim) in claims.iter().enumerate().filter(|(_, claim)| is_alone(claim)) {
        let [(holder, held)] = detections_of(scene, frame, claim)[..] else { continue };
        for view in (0..scene.views.len()).filter(|view| *view != holder) {
            let Some(essential) = essential(scene, holder, view) else { continue };
            for &detection in &free[view] {
                let seen = &scene.views[view].frames[frame][detection];
                let Some(agreement) = agreement(config, &essential, held, seen) else { continue };
                if is_human(scene, &triangulated(scene, &[(holder, held), (view, seen)])) {
                    offers.push(Offer { agreement, person, view, detection });
                }
            }
        }
    }
    offers.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
    for Offer { person, view, detection, .. } in offers {
        let is_taken = claims.iter().any(|claim| claim[view] == Some(detection));
        if !is_taken && claims[person][view].is_none() {
            claims[person][view] = Some(detection);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::bones::limb_bones;
    use crate::body::skeleton::KeypointConvention;
    use crate::geometry::Rigid;
    use crate::geometry::projection::project_normalized;
    use crate::matching::normalized::{NormalizedDetection, NormalizedView};
    use crate::matching::tracker::track;
    use crate::progress::Progress;
    use nalgebra::{Matrix3, Vector3};

    /// Somebody who hangs straight down from `(x, 0, 5)`.
    fn seen(camera: &Rigid, x: f64) -> NormalizedDetection {
        let mut heights = [0.0; 17];
        limb_bones(KeypointConvention::Coco17).iter().for_each(|b| heights[b.b] = heights[b.a] + b.length);
        let normalized =
            heights.iter().map(|y| project_normalized(camera, &Vector3::new(x, *y, 5.0)).unwrap().normalized).collect();
        NormalizedDetection { normalized, confidence: vec![0.9; 17], size: 0.2, track_id: None }
    }

    /// One view loses somebody for half a second in which they run towards the other, whose rays do not tell.
    #[test]
    fn who_ran_along_one_views_rays_is_not_lost_to_the_other() {
        let bones = limb_bones(KeypointConvention::Coco17);
        let aside = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0);
        let cameras =
            [Some(Rigid::identity()), Some(Rigid { rotation: aside, translation: Vector3::new(-5.0, 0.0, 5.0) })];
        let x = |frame: usize| -1.0 + 3.0 / 30.0 * (frame as f64 - 15.0).clamp(0.0, 15.0);
        let frames = |view: usize, is_blind: bool| -> Vec<Vec<NormalizedDetection>> {
            let at = |frame| match is_blind && (15..30).contains(&frame) {
                true => Vec::new(),
                false => vec![seen(cameras[view].as_ref().unwrap(), x(frame))],
            };
            (0..60).map(at).collect()
        };
        let views = [(0, true), (1, false)].map(|(v, b)| NormalizedView { focal: 1000.0, frames: frames(v, b) });
        let scene = Scene { views: &views, cameras: &cameras, bones: &bones, fps: 30.0, n_frames: 60 };
        let people = track(&scene, &TrackerConfig::default(), &Progress::silent()).unwrap();
        assert_eq!(people.len(), 1);
        let claims = &people[0].claims;
        assert!(claims.len() == 60 && claims[30..].iter().all(|(_, claim)| *claim == [Some(0), Some(0)]));
        let end = people[0].skeletons[59][0].unwrap();
        assert!((end.x - 0.5).abs() < 0.01, "{end}");
    }
}
