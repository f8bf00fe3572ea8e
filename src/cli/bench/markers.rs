//! `wandless bench markers`: distances between virtual markers on the true and on the fitted skin of two dancing people, by
//! the number of cameras.
//!
//! The true bodies differ from the fitted body model: random shapes, individual joint positions inside the skin, a biased
//! keypoint detector ([`Bodies::Individual`]). Twelve cameras stand in a ring; smaller rigs are subsets of them.

use super::solved_cameras::solved_and_true;
use super::table::{Column, Statistics, Table, statistics};
use crate::body::kinematics::{Pose, posed};
use crate::body::skeleton::KeypointConvention;
use crate::body::skinning::skinned;
use crate::body::{Betas, BodyModel, default_body};
use crate::cli::output_folder::make_free;
use crate::cli::solve::use_threads;
use crate::evaluation::alignment::{Alignment, truth_from_solved};
use crate::evaluation::marker_error::{MarkedPose, first_matches, marker_error, nearest_vertices};
use crate::evaluation::markers::markers;
use crate::evaluation::person_matching::Frames;
use crate::geometry::Similarity;
use crate::pipeline::config::Extrinsics;
use crate::pipeline::{Options, PipelineError, reconstruct};
use crate::progress::Progress;
use crate::session::{BodyMotion, Reconstruction, Session};
use crate::simulation::skeleton::SimulatedPerson;
use crate::simulation::{Bodies, MotionSource, Preset, Simulated, SimulationConfig, Tracks, simulate};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of `bench markers`.
#[derive(Debug, clap::Args)]
pub(super) struct MarkersArgs {
    /// Number of simulated dances
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// Seed of the first dance; the others follow
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Length of each dance in frames, at 30 frames per second
    #[arg(long, default_value_t = 150)]
    frames: usize,
    /// Output folder for markers.md and markers.json; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// Number of solver threads; 0 uses all cores
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

/// Number of cameras in the ring.
const N_VIEWS: usize = 12;

/// Camera subsets, each contained in the next. The pair is 90 degrees apart because opposite cameras do not measure depth.
const SUBSETS: [&[usize]; 5] =
    [&[0], &[0, 3], &[0, 3, 6, 9], &[0, 1, 3, 4, 6, 7, 9, 10], &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]];

const MEAN: &str = "mean mm";
const SPREAD: &str = "spread mm";
const SPREAD_OF_POSES: &str = "spread of poses mm";
const RECALL: &str = "recall";
/// Mean error when a marker is paired with the same vertex instead of the nearest vertex of the first frame.
const SAME_VERTEX: &str = "same vertex mean mm";
const COLUMNS: [Column; 5] = [(MEAN, 1), (SPREAD, 1), (SPREAD_OF_POSES, 1), (SAME_VERTEX, 1), (RECALL, 3)];

pub(super) fn run(args: &MarkersArgs) -> anyhow::Result<()> {
    use_threads(args.threads);
    make_free(&args.out)?;
    let mut table = Table::new(&COLUMNS, None);
    for seed in args.seed..args.seed + args.seeds {
        let dance = Dance::new(seed, args.frames)?;
        for (cameras, extrinsics) in [("given", Extrinsics::Fixed), ("free", Extrinsics::Estimate)] {
            for views in SUBSETS {
                let started = Instant::now();
                let statistics = dance.evaluate(views, extrinsics)?;
                let (mean, took) = (statistics[MEAN].unwrap_or(f64::NAN), started.elapsed().as_secs_f64());
                eprintln!("dance {seed} {cameras} {} views: {mean:.1} mm, {took:.1} s", views.len());
                table.add(cameras, &format!("{} views", views.len()), statistics);
            }
        }
    }
    table.publish(&args.out, "markers")
}

/// A simulated dance with its true markers.
struct Dance {
    simulated: Simulated,
    /// Body model of the fit.
    model: BodyModel,
    /// Vertex of each marker.
    vertices: Vec<usize>,
    truth: Frames<MarkedPose>,
}

impl Dance {
    fn new(seed: u64, frames: usize) -> anyhow::Result<Self> {
        let simulated = simulate(&SimulationConfig {
            seed,
            frames,
            views: N_VIEWS,
            convention: KeypointConvention::Halpe26,
            tracks: Tracks::PerView,
            bodies: Bodies::Individual,
            motion: MotionSource::Dance,
            ..SimulationConfig::preset(Preset::Paper)
        })?;
        let model = default_body();
        let vertices: Vec<usize> = markers(&model).iter().map(|marker| marker.vertex).collect();
        let mut truth = Frames::new();
        for (index, person) in simulated.truth.people.iter().enumerate() {
            add_true_person(&mut truth, index, person, &vertices);
        }
        Ok(Self { simulated, model, vertices, truth })
    }

    /// Solves with a subset of the cameras. Statistics are empty for one camera with unknown pose, which cannot be solved.
    fn evaluate(&self, views: &[usize], extrinsics: Extrinsics) -> anyhow::Result<Statistics> {
        if views.len() < 2 && extrinsics == Extrinsics::Estimate {
            return Ok(statistics(&COLUMNS, [None; COLUMNS.len()]));
        }
        let options = Options { extrinsics, ..Options::default() };
        let result = match reconstruct(&self.session(views, extrinsics), &options, &Progress::silent()) {
            Ok(result) => result,
            Err(PipelineError::Unsolvable { .. }) => {
                return Ok(statistics(&COLUMNS, [None, None, None, None, Some(0.0)]));
            }
            Err(error) => return Err(error.into()),
        };
        let truth_from_result = self.truth_from_result(&result, views, extrinsics);
        let same_vertex = self.fitted(&result, &truth_from_result, &|_| &self.vertices);
        let nearest = self.nearest(&result, &truth_from_result, &same_vertex);
        let paired = self.fitted(&result, &truth_from_result, &|person| nearest.get(person).unwrap_or(&self.vertices));
        let (error, same_vertex) = (marker_error(&self.truth, &paired), marker_error(&self.truth, &same_vertex));
        let values =
            [error.mean_mm, error.spread_mm, error.spread_of_poses_mm, same_vertex.mean_mm, Some(error.recall)];
        Ok(statistics(&COLUMNS, values))
    }

    /// For each fitted person the vertices nearest to the true markers in the first frame in which both exist.
    fn nearest(
        &self,
        result: &Reconstruction,
        truth_from_result: &Similarity,
        fitted: &Frames<MarkedPose>,
    ) -> BTreeMap<usize, Vec<usize>> {
        let first_frames = first_matches(&self.truth, fitted);
        let paired = |motion: &BodyMotion| {
            let (frame, actor) = first_frames.get(&motion.person.0.to_string())?;
            let pose = &motion.frames[*frame as usize - motion.first.0];
            let pose = Pose { rotations: pose.rotations, translation: pose.translation };
            let mesh = skinned(&self.model, &Betas::from(motion.betas), &pose);
            let mesh: Vec<_> = mesh.iter().map(|vertex| truth_from_result.transform(vertex)).collect();
            Some((motion.person.0, nearest_vertices(&self.truth[frame][actor].markers, &mesh)))
        };
        result.motions.iter().filter_map(paired).collect()
    }

    /// The session of a subset of the cameras, with their true poses unless these are to be estimated.
    fn session(&self, views: &[usize], extrinsics: Extrinsics) -> Session {
        let all = &self.simulated.session;
        let mut session = Session { views: views.iter().map(|view| all.views[*view].clone()).collect(), ..all.clone() };
        if extrinsics != Extrinsics::Estimate {
            for (view, index) in session.views.iter_mut().zip(views) {
                view.camera_from_world = Some(self.simulated.truth.cameras[*index]);
            }
        }
        session
    }

    /// Similarity that aligns estimated cameras with the true ones; with two cameras the orientations determine its rotation.
    fn truth_from_result(&self, result: &Reconstruction, views: &[usize], extrinsics: Extrinsics) -> Similarity {
        let truth: Vec<_> = views.iter().map(|view| self.simulated.truth.cameras[*view]).collect();
        let (solved, truth) = solved_and_true(result, &truth);
        let alignment = match (extrinsics, solved.len()) {
            (Extrinsics::Fixed, _) => Alignment::None,
            (_, 0..=2) => Alignment::Sim3Pose,
            _ => Alignment::Sim3,
        };
        truth_from_solved(&solved, &truth, alignment)
    }

    /// Fitted people of all frames in the true world, with markers at the given vertices of each person.
    fn fitted<'a>(
        &self,
        result: &Reconstruction,
        truth_from_result: &Similarity,
        vertices: &dyn Fn(&usize) -> &'a Vec<usize>,
    ) -> Frames<MarkedPose> {
        let mut frames = Frames::<MarkedPose>::new();
        for motion in &result.motions {
            let betas = Betas::from(motion.betas);
            for (t, pose) in motion.frames.iter().enumerate() {
                let pose = Pose { rotations: pose.rotations, translation: pose.translation };
                let mut marked = marked(&self.model, &betas, &pose, vertices(&motion.person.0));
                let points = marked.joints.iter_mut().chain(&mut marked.markers);
                points.for_each(|point| *point = truth_from_result.transform(point));
                let frame = (motion.first.0 + t) as i64;
                frames.entry(frame).or_default().insert(motion.person.0.to_string(), marked);
            }
        }
        frames
    }
}

/// Adds the joints and markers of a simulated person in all frames.
fn add_true_person(frames: &mut Frames<MarkedPose>, index: usize, person: &SimulatedPerson, vertices: &[usize]) {
    let Some((model, betas)) = person.model().zip(person.betas) else { return };
    let pelvis: Vector3<f64> = model.shaped(&betas).rest_joints[0];
    for (frame, pose) in person.poses.iter().enumerate() {
        let pose = Pose { rotations: pose.rotations, translation: pose.pelvis - pelvis };
        frames.entry(frame as i64).or_default().insert(index.to_string(), marked(&model, &betas, &pose, vertices));
    }
}

/// Joints and markers of a posed body.
fn marked(model: &BodyModel, betas: &Betas, pose: &Pose, vertices: &[usize]) -> MarkedPose {
    let mesh = skinned(model, betas, pose);
    MarkedPose {
        joints: posed(&model.shaped(betas), pose).joints,
        markers: vertices.iter().map(|vertex| mesh[*vertex]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs the benchmark; the returned function gives the mean over seeds by cameras, row and column.
    fn table(seeds: u64, frames: usize) -> impl Fn(&str, &str, &str) -> Option<f64> {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        run(&MarkersArgs { seeds, seed: 0, frames, out: out.clone(), threads: 0 }).unwrap();
        let rows: Vec<serde_json::Value> =
            serde_json::from_slice(&std::fs::read(out.join("markers.json")).unwrap()).unwrap();
        assert_eq!(rows.len(), 2 * SUBSETS.len());
        move |cameras, arm, column| {
            let row = rows.iter().find(|row| row["cameras"] == cameras && row["arm"] == arm).unwrap();
            let sessions = row["sessions"].as_array().unwrap();
            let sum: Option<f64> = sessions.iter().map(|statistics| statistics[column].as_f64()).sum();
            sum.map(|sum| sum / sessions.len() as f64)
        }
    }

    #[test]
    fn short_dance_fills_rows_and_more_cameras_help() {
        let table = table(1, 40);
        assert_eq!(table("free", "1 views", MEAN), None);
        for cameras in ["given", "free"] {
            let [few, many] = ["2 views", "12 views"].map(|arm| table(cameras, arm, MEAN).unwrap());
            // One dance of 1.3 s: errors that do not depend on the number of cameras dominate.
            assert!(many < few + 5.0 && many < 40.0, "{cameras}: {few} mm, {many} mm");
        }
        assert!(table("given", "1 views", MEAN) > table("given", "12 views", MEAN));
    }

    #[test]
    #[ignore = "many minutes"]
    fn marker_errors_stay_within_bounds() {
        let table = table(3, 150);
        for (cameras, limit_mm) in [("given", 30.0), ("free", 34.0)] {
            let arms = SUBSETS.map(|views| format!("{} views", views.len()));
            let means: Vec<f64> = arms.iter().filter_map(|arm| table(cameras, arm, MEAN)).collect();
            assert!(means.is_sorted_by(|few, many| *many < few + 1.0), "{cameras}: {means:?}");
            assert!(means.last().unwrap() <= &limit_mm, "{cameras}: {means:?}");
            let spread = table(cameras, "12 views", SPREAD).unwrap();
            assert!(spread <= 10.0, "{cameras}: {spread} mm");
            assert_eq!(table(cameras, "12 views", RECALL), Some(1.0));
        }
    }

    #[test]
    fn true_skin_has_no_error_against_itself() {
        let dance = Dance::new(0, 2).unwrap();
        let error = marker_error(&dance.truth, &dance.truth);
        assert_eq!((error.mean_mm, error.recall), (Some(0.0), 1.0));
        // Without the shifts of the individual joints the same pose gives another skin.
        let person = &dance.simulated.truth.people[0];
        let mut known = Frames::new();
        add_true_person(
            &mut known,
            0,
            &SimulatedPerson { joint_shifts: [Vector3::zeros(); 24], ..person.clone() },
            &dance.vertices,
        );
        let truth = Frames::from([(0, [("0".to_owned(), dance.truth[&0]["0"].clone())].into())]);
        let off = marker_error(&truth, &known).mean_mm.unwrap();
        assert!((5.0..60.0).contains(&off), "{off} mm");
    }
}
