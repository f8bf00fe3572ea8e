//! Why cameras cannot be placed: the first stage that found nothing, what it measured, and the remedy.

use super::camera_clock::MAX_OFFSET_SECS;
use super::capture::Capture;
use super::error::PipelineError;
use crate::matching::pair_hypotheses::HypothesisConfig;
use crate::matching::tracklets::Tracklet;
use crate::session::suspicion::Suspicion;

/// What the stages of camera initialisation found.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraEvidence {
    /// Frames in which each camera detects a person.
    pub seen: Vec<usize>,
    /// Frames of the longest tracklet of each camera.
    pub followed: Vec<usize>,
    /// Camera pairs, and those in which two tracklets share enough frames.
    pub pairs: usize,
    /// See [`Self::pairs`].
    pub overlapping: usize,
    /// Frames that tracklets must share.
    pub needed: usize,
    /// Cameras that have a pose.
    pub placed: usize,
}

impl CameraEvidence {
    /// Counts what there is; `placed`: cameras with a pose.
    pub fn of(capture: &Capture, placed: usize) -> Self {
        let needed = HypothesisConfig::default().min_overlap;
        let tracklets = capture.tracklets();
        let longest = |of_view: &Vec<Tracklet>| of_view.iter().map(|t| t.detections.len()).max().unwrap_or(0);
        let overlap =
            |a: &Tracklet, b: &Tracklet| (a.first()..=a.last()).filter(|&f| a.at(f).and(b.at(f)).is_some()).count();
        let overlaps =
            |a: usize, b: usize| tracklets[a].iter().any(|s| tracklets[b].iter().any(|t| overlap(s, t) >= needed));
        let n = tracklets.len();
        Self {
            seen: capture.views.iter().map(|v| v.frames.iter().filter(|f| !f.is_empty()).count()).collect(),
            followed: tracklets.iter().map(longest).collect(),
            pairs: n * n.saturating_sub(1) / 2,
            overlapping: (0..n).flat_map(|b| (0..b).map(move |a| (a, b))).filter(|&(a, b)| overlaps(a, b)).count(),
            needed,
            placed,
        }
    }

    /// The error of a session without cameras, in which `suspicions` are probable.
    pub fn error(&self, suspicions: Vec<Suspicion>) -> PipelineError {
        PipelineError::unsolvable("cameras_unsolvable", &self.reason(), suspicions)
    }

    fn reason(&self) -> String {
        let Self { seen, followed, pairs, overlapping, needed, placed } = self;
        let watching = seen.iter().filter(|n| **n >= *needed).count();
        let following = followed.iter().filter(|n| **n >= *needed).count();
        let n = seen.len();
        if watching < 2 {
            return format!(
                "detections: {watching} of {n} cameras see a person in {needed} frames or more ({}), two must; check that the \
                 keypoint files belong to this recording",
                list(seen)
            );
        }
        if following < 2 {
            return format!(
                "following people within a camera: in {following} of {n} cameras a person is followed for {needed} frames or more \
                 (longest: {}; frames with a person: {}), two must; check that frames are in the order of time and the frame \
                 rate is right",
                list(followed),
                list(seen)
            );
        }
        if *overlapping == 0 {
            return format!(
                "comparing pairs of cameras: in none of {pairs} camera pairs do both see a person in the same {needed} frames; check \
                 that frame numbers of all cameras count the same time (option sync: estimate finds offsets up to {MAX_OFFSET_SECS} s)"
            );
        }
        format!(
            "comparing pairs of cameras: {overlapping} of {pairs} camera pairs see a person in the same {needed} frames, but \
             {placed} cameras fit together; check that the cameras overlap, that frames are synchronised (option sync: estimate \
             finds offsets up to {MAX_OFFSET_SECS} s) and that the intrinsics belong to these images (option intrinsics: refine_focal)"
        )
    }
}

fn list(counts: &[usize]) -> String {
    counts.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stage_that_found_nothing_is_named_with_its_counts() {
        let evidence = |seen: &[usize], followed: &[usize], overlapping: usize| CameraEvidence {
            seen: seen.to_vec(),
            followed: followed.to_vec(),
            pairs: 3,
            overlapping,
            needed: 5,
            placed: 0,
        };
        let cases = [
            (evidence(&[40, 0, 3], &[40, 0, 3], 0), "detections: 1 of 3 cameras", "40, 0, 3"),
            (evidence(&[40, 40, 40], &[2, 1, 2], 0), "following people", "longest: 2, 1, 2"),
            (evidence(&[40, 40, 40], &[40, 40, 39], 0), "in none of 3 camera pairs", "sync: estimate"),
            (evidence(&[40, 40, 40], &[40, 40, 39], 2), "2 of 3 camera pairs", "intrinsics"),
        ];
        for (evidence, stage, measured) in cases {
            let reason = evidence.reason();
            assert!(reason.contains(stage) && reason.contains(measured), "{reason}");
        }
    }
}
