//! `wandless bench hands`: fingers, wrists, cameras and bodies of sessions with 133 points, against the same with 17.

use super::solved_cameras::solved_and_true;
use crate::body::hand::HandPoint;
use crate::body::hand::{N_FACE_POINTS, N_FINGER_JOINTS, N_HAND_POINTS, Side, hand_keypoints, hand_points};
use crate::body::kinematics::PosedSkeleton;
use crate::body::skeleton::{KeypointConvention, chain_to_root};
use crate::cli::solve::use_threads;
use crate::evaluation::alignment::{Alignment, truth_from_solved};
use crate::geometry::Similarity;
use crate::geometry::rotation::angle_between;
use crate::pipeline::{Options, reconstruct};
use crate::progress::Progress;
use crate::session::people::BodyPose;
use crate::session::{BodyMotion, PersonId, Reconstruction, Session};
use crate::simulation::{HandNoise, Preset, Simulated, SimulationConfig, simulate};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use std::time::Instant;

/// Arguments of `bench hands`.
#[derive(Debug, clap::Args)]
pub(super) struct HandsArgs {
    /// Number of sessions
    #[arg(long, default_value_t = 10)]
    count: u64,
    /// Seed of the first session; the others follow
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Length of the sessions in frames
    #[arg(long, default_value_t = 300)]
    frames: usize,
    /// Print one JSON object instead of lines
    #[arg(long)]
    json: bool,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Share of the frames of a view in which two hands are exchanged.
const SWAP_RATE: f64 = 0.05;

/// The 12 limb joints: hips, knees, ankles, shoulders, elbows, wrists.
const LIMBS: [usize; 12] = [1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21];

/// Errors of one session, or their means.
#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Errors {
    /// Finger joints relative to the wrist, where two views see the joint, mm.
    finger_mm: f64,
    /// Angle between fitted and true orientation of the wrist, where two views see the hand.
    wrist_deg: f64,
    /// The same with 17 points.
    wrist17_deg: f64,
    /// Cameras' angle over that with 17 points.
    camera_angle_ratio: f64,
    /// Limb joints after alignment of the hips over those with 17 points.
    root12_ratio: f64,
    /// Seconds over those with 17 points.
    time_ratio: f64,
    /// Share of swapped hands that are given to their person and side.
    swaps_repaired: f64,
    /// Share of hands as detected that are taken from them.
    kept_lost: f64,
    camera_angle_deg: f64,
    camera_angle17_deg: f64,
    root12_mm: f64,
    root12_17_mm: f64,
    secs: f64,
    secs17: f64,
}

pub(super) fn run(args: &HandsArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    let mut all = Vec::new();
    for seed in args.seed..args.seed + args.count {
        let errors = session_errors(seed, args.frames)?;
        if !args.json {
            println!("session {seed:3}: {}", serde_json::to_string(&errors)?);
        }
        all.push(errors);
    }
    let means = means(&all);
    println!(
        "{}",
        if args.json { serde_json::to_string(&means)? } else { format!("means: {}", serde_json::to_string(&means)?) }
    );
    Ok(())
}

fn session_errors(seed: u64, frames: usize) -> anyhow::Result<Errors> {
    let preset = SimulationConfig::preset(Preset::Paper);
    let hands = Some(HandNoise { swap_rate: SWAP_RATE, ..HandNoise::default() });
    let convention = KeypointConvention::CocoWholebody133;
    let simulated = simulate(&SimulationConfig { seed, frames, convention, hands, ..preset })?;
    let (with, secs) = solved(&simulated.session)?;
    let (without, secs17) = solved(&body_points(&simulated.session))?;
    let [with, without] = [with, without].map(|result| Compared::new(&simulated, result));
    let (repaired, lost) = with.repaired_swaps();
    Ok(Errors {
        finger_mm: with.finger_mm(),
        wrist_deg: with.wrist_deg(),
        wrist17_deg: without.wrist_deg(),
        camera_angle_ratio: with.camera_deg() / without.camera_deg(),
        root12_ratio: with.root12_mm() / without.root12_mm(),
        time_ratio: secs / secs17,
        swaps_repaired: repaired,
        kept_lost: lost,
        camera_angle_deg: with.camera_deg(),
        camera_angle17_deg: without.camera_deg(),
        root12_mm: with.root12_mm(),
        root12_17_mm: without.root12_mm(),
        secs,
        secs17,
    })
}

fn solved(session: &Session) -> anyhow::Result<(Reconstruction, f64)> {
    let start = Instant::now();
    let result = reconstruct(session, &Options::default(), &Progress::silent())?;
    Ok((result, start.elapsed().as_secs_f64()))
}

/// The same detections without feet, face and hands.
fn body_points(session: &Session) -> Session {
    let mut body = Session { convention: KeypointConvention::Coco17, ..session.clone() };
    let detections = body.views.iter_mut().flat_map(|view| view.frames.iter_mut().flatten());
    detections.for_each(|detection| detection.keypoints.truncate(KeypointConvention::Coco17.n_keypoints()));
    body
}

/// A result in the world of the truth.
struct Compared<'a> {
    simulated: &'a Simulated,
    result: Reconstruction,
    truth_from_solved: Similarity,
    /// True person of each motion.
    people: Vec<usize>,
}

impl<'a> Compared<'a> {
    fn new(simulated: &'a Simulated, result: Reconstruction) -> Self {
        let (solved, truth) = solved_and_true(&result, &simulated.truth.cameras);
        let truth_from_solved = truth_from_solved(&solved, &truth, Alignment::Sim3);
        let nearest = |motion: &BodyMotion| {
            let off = |person: &usize| -> f64 {
                let frames = motion.frames.iter().zip(&simulated.truth.joints[motion.first.0..]);
                frames
                    .map(|(pose, truth)| (truth_from_solved.transform(&pose.joints[0]) - truth[*person][0]).norm())
                    .sum()
            };
            (0..simulated.truth.people.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
        };
        let people = result.motions.iter().map(nearest).collect();
        Self { simulated, result, truth_from_solved, people }
    }

    /// Poses with the frame and the true person.
    fn poses(&self) -> impl Iterator<Item = (&BodyMotion, usize, &BodyPose, usize)> {
        self.result.motions.iter().zip(&self.people).flat_map(|(motion, &person)| {
            let frames = motion.frames.iter().enumerate();
            frames.map(move |(t, pose)| (motion, t, pose, person))
        })
    }

    fn camera_deg(&self) -> f64 {
        let (solved, truth) = solved_and_true(&self.result, &self.simulated.truth.cameras);
        let angle = |(solved, truth): (&_, &crate::geometry::Rigid)| {
            angle_between(&self.truth_from_solved.move_camera(solved).rotation, &truth.rotation).to_degrees()
        };
        mean(&solved.iter().zip(&truth).map(angle).collect::<Vec<_>>())
    }

    fn root12_mm(&self) -> f64 {
        let hips = |joints: &[Vector3<f64>]| (joints[1] + joints[2]) / 2.0;
        let mut errors = Vec::new();
        for (motion, t, pose, person) in self.poses() {
            let truth = &self.simulated.truth.joints[motion.first.0 + t][person];
            let found: Vec<Vector3<f64>> =
                pose.joints.iter().map(|joint| self.truth_from_solved.transform(joint)).collect();
            let shift = hips(truth) - hips(&found);
            errors.extend(LIMBS.iter().map(|&j| 1e3 * (found[j] + shift - truth[j]).norm()));
        }
        mean(&errors)
    }

    /// The true posed skeleton.
    fn true_skeleton(&self, frame: usize, person: usize) -> PosedSkeleton {
        let person = &self.simulated.truth.people[person];
        person.skeleton.pose(&person.poses[frame])
    }

    /// Number of views that reported a point of a person's hand, at any place.
    fn n_views(&self, frame: usize, person: usize, side: Side, point: usize) -> usize {
        let Simulated { session, truth, .. } = self.simulated;
        let sees = |view: usize| {
            let of_view = session.views[view].frames[frame].iter().zip(&truth.hands[view][frame]);
            of_view.flat_map(|(detection, hands)| Side::BOTH.map(|s| (detection, s, hands[s as usize]))).any(
                |(detection, shown_as, source)| {
                    let keypoints = hand_keypoints(session.convention, shown_as);
                    let seen = keypoints.is_some_and(|range| detection.keypoints[range.start + point].is_present());
                    seen && source == Some((person, side))
                },
            )
        };
        (0..session.views.len()).filter(|view| sees(*view)).count()
    }

    fn wrist_deg(&self) -> f64 {
        let mut errors = Vec::new();
        for (motion, t, pose, person) in self.poses() {
            let truth = self.true_skeleton(motion.first.0 + t, person);
            for side in Side::BOTH.into_iter().filter(|side| self.n_views(motion.first.0 + t, person, *side, 9) >= 2) {
                let found = self.truth_from_solved.rotation * world_rotation(pose, side.wrist());
                errors.push(angle_between(&found, &truth.rotations[side.wrist()]).to_degrees());
            }
        }
        mean(&errors)
    }

    fn finger_mm(&self) -> f64 {
        let Similarity { rotation, scale, .. } = self.truth_from_solved;
        let mut errors = Vec::new();
        for (motion, t, pose, person) in self.poses() {
            let Some(hands) = &motion.hands else { continue };
            let frame = motion.first.0 + t;
            for side in Side::BOTH {
                let first = N_FACE_POINTS + N_HAND_POINTS * side as usize;
                let truth = &self.simulated.truth.details[frame][person][first..first + N_HAND_POINTS];
                let found = &hands[side as usize].frames[t].joints;
                for (point, place) in hand_points().iter().enumerate() {
                    let HandPoint::Joint { finger, place: place @ 0..3 } = *place else { continue };
                    let joint = 3 * finger + place;
                    debug_assert!(joint < N_FINGER_JOINTS);
                    if self.n_views(frame, person, side, point) >= 2 {
                        let relative = rotation * (found[joint] - pose.joints[side.wrist()]) * scale;
                        errors.push(1e3 * (relative - (truth[point] - truth[0])).norm());
                    }
                }
            }
        }
        mean(&errors)
    }

    /// Shares of the exchanged hands that are back at their place, and of the others that are not.
    fn repaired_swaps(&self) -> (f64, f64) {
        let Some(sources) = &self.result.hand_sources else { return (0.0, 1.0) };
        let truth = &self.simulated.truth;
        let (mut swapped, mut repaired, mut kept, mut lost) = (0, 0, 0, 0);
        for (view, frames) in sources.iter().enumerate() {
            for (frame, detections) in frames.iter().enumerate() {
                let is_assigned = |d: usize| -> Option<PersonId> { self.result.identities[view][frame][d] };
                let seen = &truth.hands[view][frame];
                for (d, taken) in detections.iter().enumerate().filter(|(d, _)| is_assigned(*d).is_some()) {
                    let Some(person) = truth.identities[view][frame][d] else { continue };
                    for side in Side::BOTH {
                        let own = Some((person, side));
                        // The place where this hand was detected, as far as anything was.
                        let place = seen.iter().enumerate().find_map(|(d, hands)| {
                            Side::BOTH.into_iter().find(|s| hands[*s as usize] == own).map(|s| (d, s))
                        });
                        let Some((at, shown_as)) = place.filter(|place| self.is_detected(view, frame, *place)) else {
                            continue;
                        };
                        if is_assigned(at).is_none() {
                            continue;
                        }
                        let (from, from_side) = taken[side as usize];
                        let is_right = seen[from][from_side as usize] == own;
                        if (at, shown_as) == (d, side) {
                            kept += 1;
                            lost += usize::from(!is_right);
                        } else {
                            swapped += 1;
                            repaired += usize::from(is_right);
                        }
                    }
                }
            }
        }
        (repaired as f64 / swapped.max(1) as f64, lost as f64 / kept.max(1) as f64)
    }

    fn is_detected(&self, view: usize, frame: usize, (detection, side): (usize, Side)) -> bool {
        let session = &self.simulated.session;
        let keypoints = hand_keypoints(session.convention, side).into_iter().flatten();
        let detection = &session.views[view].frames[frame][detection];
        keypoints.filter(|k| detection.keypoints[*k].is_present()).count() > 0
    }
}

/// `world_from_joint` of a pose.
fn world_rotation(pose: &BodyPose, joint: usize) -> Matrix3<f64> {
    let chain: Vec<usize> = chain_to_root(joint).collect();
    chain.iter().rev().fold(Matrix3::identity(), |world, &joint| world * pose.rotations[joint])
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Means over sessions; ratios are those of the means.
fn means(all: &[Errors]) -> Errors {
    let of = |value: fn(&Errors) -> f64| mean(&all.iter().map(value).collect::<Vec<_>>());
    let ratio = |value: fn(&Errors) -> f64, other: fn(&Errors) -> f64| of(value) / of(other);
    Errors {
        finger_mm: of(|e| e.finger_mm),
        wrist_deg: of(|e| e.wrist_deg),
        wrist17_deg: of(|e| e.wrist17_deg),
        camera_angle_ratio: ratio(|e| e.camera_angle_deg, |e| e.camera_angle17_deg),
        root12_ratio: ratio(|e| e.root12_mm, |e| e.root12_17_mm),
        time_ratio: ratio(|e| e.secs, |e| e.secs17),
        swaps_repaired: of(|e| e.swaps_repaired),
        kept_lost: of(|e| e.kept_lost),
        camera_angle_deg: of(|e| e.camera_angle_deg),
        camera_angle17_deg: of(|e| e.camera_angle17_deg),
        root12_mm: of(|e| e.root12_mm),
        root12_17_mm: of(|e| e.root12_17_mm),
        secs: of(|e| e.secs),
        secs17: of(|e| e.secs17),
    }
}
