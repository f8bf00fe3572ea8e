//! Problems of single persons: too few views, uncertain or contradicted joints, implausible bones and motion.

use super::geometry::RAY_ANGLE_DEG;
use super::input::{FollowedPerson, VerdictInput};
use super::reason::{Bounds, Reason};
use crate::session::reconstruction::{KeypointReport, PersonReport, UncertainFrames, Verdict};

/// Share of a person's frames in which two cameras see them; the rest depends on one ray and on smoothness.
const IN_TWO_VIEWS: Bounds = Bounds { warn: 0.6, reject: 0.2 };

/// Median standard deviation of a person's keypoints in space, mm. Four cameras all around and a detector of 20 mm give 22.
const SIGMA_MM: Bounds = Bounds { warn: UncertainFrames::BOUND_MM, reject: 250.0 };

/// Shortest time of a person without a body that is warned of beside others, s: passers-by may show a part of themselves for a moment.
const FOLLOWED_SECS: f64 = 1.0;

/// Shortest stretch of uncertain frames that is warned of, s; shorter ones do not put a whole recording in doubt, and are only listed.
const UNCERTAIN_SECS: f64 = 1.0;

/// Share of a keypoint's detections that contradict the result: outliers of detectors are 0.05, hidden keypoints 0.3.
const REJECTED_WARN: f64 = 0.4;

/// Detections of a keypoint in all views over the person's frames, below which its limb is a guess: one in twenty frames.
const SHOWN: f64 = 0.05;

/// Ends of the limbs' bones; no other keypoint shows where they are.
const LIMB_ENDS: [&str; 4] = ["elbow", "wrist", "knee", "ankle"];

/// Smallest number of detections for a judgement on a keypoint.
const MIN_OBSERVATIONS: usize = 100;

/// Mean relative standard deviation of a person's bone lengths: detectors give 0.01 to 0.08, exchanged limbs of two people more.
const BONE_SPREAD_WARN: f64 = 0.15;

/// Mean acceleration of a person's keypoints, m/s^2: walking and gesturing give 2 to 7, sport 15.
const JITTER_WARN: f64 = 25.0;

/// Overlap of two bodies, mm: clothes and flesh yield by some 20, and the capsules deviate from the skin by 10.
const PENETRATION_WARN_MM: f64 = 60.0;

pub(super) fn reasons(input: &VerdictInput) -> Vec<Reason> {
    let of_person = |person| {
        [
            hardly_seen(person),
            uncertain(person),
            uncertain_for_a_while(person, input.fps),
            uncertain_throughout(person, input.fps),
            never_shown(person),
            contradicted(person),
            stretching(person),
            shaking(person),
        ]
    };
    let mut of_each: Vec<Vec<Reason>> =
        input.people.iter().map(|person| of_person(person).into_iter().flatten().collect()).collect();
    let is_rejected = |reasons: &Vec<Reason>| reasons.iter().any(|reason| reason.verdict == Verdict::Reject);
    if !of_each.iter().all(is_rejected) {
        // An unusable person, such as a passer-by in front of one camera, does not affect the others.
        of_each.iter_mut().flatten().for_each(|reason| reason.verdict = Verdict::Warn);
    }
    of_each.into_iter().flatten().chain(penetration(input)).collect()
}

/// People that are missing from the result although they were followed.
pub(super) fn without_body(input: &VerdictInput) -> impl Iterator<Item = Reason> {
    let is_alone = input.people.is_empty();
    let secs = |person: &&FollowedPerson| (person.last_frame - person.first_frame + 1) as f64 / input.fps;
    let missing = input.without_body.iter().filter(move |person| is_alone || secs(person) >= FOLLOWED_SECS);
    missing.map(move |person| {
        let text = format!(
            "person {} was followed in frames {} to {} and is left out: hips and shoulders, to which a body is fitted first, are never \
             located together; aim the cameras so that they show both, or use a detector that gives them",
            person.id, person.first_frame, person.last_frame
        );
        if is_alone { Reason::reject(text) } else { Reason::warn(text) }
    })
}

fn hardly_seen(person: &PersonReport) -> Option<Reason> {
    let verdict = IN_TWO_VIEWS.on_low(person.share_in_two_views)?;
    let text = format!(
        "person {} was seen by two cameras in only {:.0} % of frames {} to {} (expected above {:.0} %); aim another camera \
         at this person",
        person.id,
        100.0 * person.share_in_two_views,
        person.first_frame,
        person.last_frame,
        100.0 * IN_TWO_VIEWS.warn
    );
    Some(Reason { verdict, text })
}

/// Uncertain joints; nearly parallel rays of all cameras are a problem of the whole recording.
fn uncertain(person: &PersonReport) -> Option<Reason> {
    let sigma = person.sigma_mm?.median;
    let verdict = SIGMA_MM.on_high(sigma)?;
    let known = person.keypoints.iter().filter_map(|k| Some((k.sigma_mm?.median, k.keypoint.as_str())));
    let worst =
        known.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(sigma, name)| format!(", worst {name} by {sigma:.0} mm"));
    let is_narrow = person.ray_angle_deg.is_some_and(|angle| RAY_ANGLE_DEG.on_low(angle).is_some());
    let remedy = if is_narrow {
        "add a camera that sees the person from the side"
    } else {
        "bring the cameras nearer, add one, or use a better detector"
    };
    let text = format!(
        "the keypoints of person {} are uncertain by {sigma:.0} mm{} (expected below {} mm); {remedy}",
        person.id,
        worst.unwrap_or_default(),
        SIGMA_MM.warn
    );
    Some(Reason { verdict, text })
}

/// The longest stretch of uncertain frames, with the number of the others; none where all are short, which the report lists.
fn uncertain_for_a_while(person: &PersonReport, fps: f64) -> Option<Reason> {
    let n_frames = |stretch: &&UncertainFrames| stretch.last_frame - stretch.first_frame + 1;
    let longest = person.uncertain_frames.iter().max_by_key(n_frames)?;
    if (n_frames(&longest) as f64) < UNCERTAIN_SECS * fps {
        return None;
    }
    let UncertainFrames { first_frame, last_frame, joint_sigma_mm, cameras } = longest;
    let shown_by = match cameras.as_slice() {
        [] => "no camera shows".to_owned(),
        [camera] => format!("camera {camera} alone shows"),
        cameras => format!("cameras {} show", cameras.join(", ")),
    };
    let others = match person.uncertain_frames.len() - 1 {
        0 => String::new(),
        1 => " (and in 1 other stretch)".to_owned(),
        n => format!(" (and in {n} other stretches)"),
    };
    Some(Reason::warn(format!(
        "the joints of person {} are uncertain by {joint_sigma_mm:.0} mm in frames {first_frame} to {last_frame}{others}, \
         where {shown_by} this person (expected below {} mm); do not use these frames unchecked, and aim another camera at \
         that place",
        person.id,
        UncertainFrames::BOUND_MM
    )))
}

/// A person seen for a moment, such as one made of half detections of others, where no other reason says so.
fn uncertain_throughout(person: &PersonReport, fps: f64) -> Option<Reason> {
    if uncertain(person).is_some() || uncertain_for_a_while(person, fps).is_some() {
        return None;
    }
    let sigma_mm = person.joint_sigma_mm?.median;
    let PersonReport { id, first_frame, last_frame, .. } = person;
    (sigma_mm > UncertainFrames::BOUND_MM).then(|| {
        Reason::warn(format!(
            "the joints of person {id}, in frames {first_frame} to {last_frame} alone, are uncertain by {sigma_mm:.0} mm (expected \
             below {} mm); leave the person out (correction exclude_person), or aim another camera at that place",
            UncertainFrames::BOUND_MM
        ))
    })
}

/// Limbs that no camera shows, as behind a table or below the images.
fn never_shown(person: &PersonReport) -> Option<Reason> {
    let n_frames = (person.last_frame - person.first_frame + 1) as f64;
    let is_unseen = |k: &&KeypointReport| {
        LIMB_ENDS.iter().any(|end| k.keypoint.ends_with(end)) && (k.n_observations as f64) < SHOWN * n_frames
    };
    let unseen: Vec<&str> = person.keypoints.iter().filter(is_unseen).map(|k| k.keypoint.as_str()).collect();
    (!unseen.is_empty()).then(|| {
        Reason::warn(format!(
            "hardly any image shows {} of person {}, so that the limbs there are a guess; do not use these joints, or aim a camera \
             at them",
            unseen.join(", "),
            person.id
        ))
    })
}

fn contradicted(person: &PersonReport) -> Option<Reason> {
    let is_bad = |k: &&KeypointReport| k.n_observations >= MIN_OBSERVATIONS && k.rejected > REJECTED_WARN;
    let bad: Vec<&KeypointReport> = person.keypoints.iter().filter(is_bad).collect();
    let worst = bad.iter().map(|k| k.rejected).reduce(f64::max)?;
    let names: Vec<&str> = bad.iter().map(|k| k.keypoint.as_str()).collect();
    Some(Reason::warn(format!(
        "{} of person {} contradict the other cameras in up to {:.0} % of their detections (expected below {:.0} %); check \
         keypoint_convention, and that no camera confuses this person with another one or with a mirror image",
        names.join(", "),
        person.id,
        100.0 * worst,
        100.0 * REJECTED_WARN
    )))
}

fn stretching(person: &PersonReport) -> Option<Reason> {
    let spread = person.bone_length_spread.filter(|spread| *spread > BONE_SPREAD_WARN)?;
    Some(Reason::warn(format!(
        "the bones of person {} change their lengths by {:.0} % (expected below {:.0} %), as with exchanged persons or \
         cameras that are not synchronised; check the identities in the viewer, and the synchronisation",
        person.id,
        100.0 * spread,
        100.0 * BONE_SPREAD_WARN
    )))
}

fn shaking(person: &PersonReport) -> Option<Reason> {
    let jitter = person.jitter_m_per_s2.filter(|jitter| *jitter > JITTER_WARN)?;
    Some(Reason::warn(format!(
        "person {} accelerates by {jitter:.0} m/s^2 on average (expected below {JITTER_WARN}), more than is plausible; check \
         fps and scale, or the detector's noise",
        person.id
    )))
}

fn penetration(input: &VerdictInput) -> Option<Reason> {
    let overlap = input.penetration.deepest.as_ref().filter(|o| o.depth_mm > PENETRATION_WARN_MM)?;
    let [a, b] = overlap.people;
    let [joint_a, joint_b] = &overlap.joints;
    let remedy = if input.resolves_collisions {
        "check that frame, and whether two cameras see both persons there"
    } else {
        "choose collision: true"
    };
    Some(Reason::warn(format!(
        "person {a} ({joint_a}) overlaps by {:.0} mm with person {b} ({joint_b}) at frame {} (expected below \
         {PENETRATION_WARN_MM} mm); {remedy}",
        overlap.depth_mm, overlap.frame
    )))
}
