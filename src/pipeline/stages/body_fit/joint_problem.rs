//! Cameras and motions of all persons as one least-squares problem.
//!
//! Each person's motion and shape are eliminated; what remains on the cameras is added up (an arrow of arrows) and solved in
//! a free network: the seven directions of a similarity, which no detection determines, stay as they are.

use super::context::FitContext;
use super::motion_problem::MotionProblem;
use super::objective::Objective;
use super::observations::{Observations, PosedCamera};
use super::person_fit::StartedMotion;
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::terms::data::DataSource;
use super::terms::term::BorderTerm;
use super::terms::noise_process::{LagSums, NoiseProcess, PathNoise, sigma_of};
use super::terms::unknowns::{Border, MotionState, Shape};
use super::terms::whitened_pixels::WhitenedPixels;
use crate::body::BodyModel;
use crate::body::bone_offsets::{BoneOffsets, with_bones};
use crate::body::detector_offsets::OffsetTable;
use crate::body::skeleton::KeypointConvention;
use crate::geometry::Rigid;
use crate::geometry::rotation::skew;
use crate::optim::block_banded::{BandedStep, Corner, Eliminated, damped};
use crate::progress::Canceled;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;

/// One person's part.
struct Member {
    observations: Observations,
    state: MotionState,
    bones: BoneOffsets,
}

/// Accepted steps, and the decrease of the cost below which one is the last.
const MAX_ITERATIONS: usize = 8;
const MIN_DECREASE: f64 = 0.5;

fn env(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// Adjusts the cameras together with the first fits of all persons; both are replaced by what is found.
pub(super) fn joint_cameras(
    context: &FitContext,
    convention: KeypointConvention,
    started: &mut [Option<(Observations, StartedMotion)>],
) -> Result<Option<(Vec<Rigid>, PathNoise)>, Canceled> {
    let total = env("WJ_FRAMES", 1600.0) as usize;
    let n_people = started.iter().flatten().count();
    if n_people == 0 {
        return Ok(None);
    }
    let mut runs = Vec::new();
    let mut members: Vec<Member> = Vec::new();
    for (observations, started) in started.iter().flatten() {
        let run = observations.most_seen(started.window.clone(), total / n_people);
        let own = run.start - started.window.start..run.end - started.window.start;
        let fitted = &started.fitted.state;
        members.push(Member {
            observations: observations.slice(run.clone()),
            state: MotionState { betas: fitted.betas, poses: fitted.poses[own].to_vec() },
            bones: BoneOffsets::default(),
        });
        runs.push(run);
    }
    let n_cameras = members[0].observations.cameras.len();
    if n_cameras < 2 {
        return Ok(None);
    }
    let mut cameras = members[0].observations.cameras.clone();
    let table = OffsetTable::new(context.model, convention);
    let mut offsets = vec![Vector3::zeros(); table.kinds.len()];
    for _ in 0..env("WJ_ROUNDS", 2.0) as usize {
        let noise = measured(context, &table, &offsets, &members);
        let sigmas = table.kinds.iter().map(|kind| kind.prior_sigma * env("WJ_BIAS", 1.0)).collect();
        let solver = Solver {
            context,
            table: &table,
            n_cameras,
            data: DataSource::Paths(&noise),
            bone_prior: BoneLengthPrior { sigma: env("WJ_BONE", 0.01), correlated_frames: 1.0 },
            bias_prior: KeypointBiasPrior { sigmas, correlated_frames: 1.0 },
        };
        cameras = solver.solved(&mut members, cameras, &mut offsets)?;
        if std::env::var("WJ_VERBOSE").is_ok() {
            for (kind, o) in table.kinds.iter().zip(&offsets) {
                eprintln!("{} {:.1} {:.1} {:.1}", kind.name, o.x * 1e3, o.y * 1e3, o.z * 1e3);
            }
            members.iter().for_each(|m| eprintln!("bones {:?}", m.bones.map(|b| (b.norm() * 1e3).round())));
        }
    }
    let noise = measured(context, &table, &offsets, &members);
    let poses: Vec<Rigid> = cameras.iter().map(|camera| camera.camera_from_world).collect();
    for (((observations, started), member), run) in started.iter_mut().flatten().zip(members).zip(runs) {
        observations.cameras.clone_from(&cameras);
        started.start.betas = member.state.betas;
        started.fitted.state.betas = member.state.betas;
        let own = run.start - started.window.start..run.end - started.window.start;
        started.fitted.state.poses[own].clone_from_slice(&member.state.poses);
        started.start.poses[run].clone_from_slice(&member.state.poses);
    }
    Ok(Some((poses, noise)))
}

/// The detector's errors, from the residuals of all members.
fn measured(
    context: &FitContext,
    table: &OffsetTable,
    offsets: &[Vector3<f64>],
    members: &[Member],
) -> PathNoise {
    let model = table.applied(context.model, offsets);
    let n_landmarks = context.model.landmarks.len();
    let own = env("WJ_OWN", 1.0) > 0.0;
    let unit = PathNoise::white(n_landmarks, 1.0);
    let paths = |noise: &PathNoise, member: &Member| -> (Vec<_>, Vec<_>) {
        let own = with_bones(&model, &member.bones);
        let problem = problem(context, &own, DataSource::Paths(noise), None, 0, member);
        let paths = WhitenedPixels::new(&member.observations, noise, context.config.robust_scale);
        let positions = problem.path_positions(&member.state);
        (paths.residuals(&positions), paths.innovations(&positions))
    };
    let residuals: Vec<_> = members.iter().flat_map(|member| paths(&unit, member).0).collect();
    let lengths = residuals.iter().map(|(l, run)| (*l, run.iter().map(|(_, r)| r.norm()).collect()));
    let level = levels(n_landmarks, lengths, own);
    let mut sums = vec![LagSums::default(); n_landmarks];
    let mut all = LagSums::default();
    for (landmark, mut run) in residuals {
        run.iter_mut().for_each(|(_, r)| *r /= level[landmark]);
        sums[landmark].add(&run);
        all.add(&run);
    }
    let processes = sums
        .iter()
        .map(|sums| NoiseProcess::of(&if own { sums.pooled(&all, POOLED) } else { all }))
        .collect();
    let noise = PathNoise { processes, shares: level };
    // Innovations get unit variance.
    let innovations = members.iter().flat_map(|member| paths(&noise, member).1);
    let factors = levels(n_landmarks, innovations, own);
    if std::env::var("WJ_VERBOSE").is_ok() {
        for l in 0..n_landmarks {
            eprintln!("{} level {:.4} factor {:.3} ar {:?}", context.model.landmarks[l].name, noise.shares[l], factors[l], noise.processes[l].autocorrelation);
        }
    }
    let names = std::env::var("WJ_OUT").unwrap_or_default();
    let out = |l: usize| if names.split(',').any(|n| !n.is_empty() && context.model.landmarks[l].name.ends_with(n)) { env("WJ_OUTF", 10.0) } else { 1.0 };
    let shares = noise.shares.iter().zip(factors).enumerate().map(|(l, (share, factor))| share * factor * out(l)).collect();
    let lam = env("WJ_LAM", 1.0);
    let noise = PathNoise { processes: noise.processes.iter().map(|p| NoiseProcess { autocorrelation: p.autocorrelation.map(|a| a * lam) }).collect(), ..noise };
    PathNoise { shares, ..noise }
}

/// Standard deviations by landmark of lengths in the plane, drawn towards that of all together where there are few.
fn levels(n_landmarks: usize, lengths: impl Iterator<Item = (usize, Vec<f64>)>, own: bool) -> Vec<f64> {
    let mut by_landmark = vec![Vec::new(); n_landmarks];
    lengths.for_each(|(landmark, lengths)| by_landmark[landmark].extend(lengths));
    let all = sigma_of(&mut by_landmark.concat()).unwrap_or(1.0);
    let level = |mut lengths: Vec<f64>| {
        let n = lengths.len() as f64;
        let sigma = sigma_of(&mut lengths).unwrap_or(all);
        if own { ((n * sigma.ln() + POOLED * all.ln()) / (n + POOLED)).exp() } else { all }
    };
    by_landmark.into_iter().map(level).collect()
}

/// Residuals of all landmarks that count as much as one landmark's own.
const POOLED: f64 = 100.0;

fn problem<'a>(
    context: &FitContext<'a>,
    model: &'a BodyModel,
    data: DataSource<'a>,
    bias: Option<&'a OffsetTable>,
    n_cameras: usize,
    member: &'a Member,
) -> MotionProblem<'a> {
    let context = &FitContext { model, ..*context };
    let config = if env("WJ_PRIOR", 1.0) > 0.0 { context.config } else { context.first_config };
    let config = Box::leak(Box::new(super::config::BodyFitConfig { robust_scale: env("WJ_ROB", 4.0), ..config.clone() }));
    Objective { n_cameras, bias, ..Objective::new(context, config, &member.observations, data, Shape::Free) }.problem()
}

struct Solver<'a> {
    context: &'a FitContext<'a>,
    table: &'a OffsetTable,
    bone_prior: BoneLengthPrior,
    bias_prior: KeypointBiasPrior,
    n_cameras: usize,
    data: DataSource<'a>,
}

impl Solver<'_> {
    fn border(&self) -> Border<'_> {
        Border { shape: Shape::Free, bias: Some(self.table), n_cameras: self.n_cameras }
    }

    fn solved(
        &self,
        members: &mut [Member],
        mut cameras: Vec<PosedCamera>,
        offsets: &mut Vec<Vector3<f64>>,
    ) -> Result<Vec<PosedCamera>, Canceled> {
        let mut cost = self.cost(members, offsets);
        let mut damping = 1e-5;
        let (mut accepted, mut trials) = (0, 0);
        while accepted < MAX_ITERATIONS && trials < 2 * MAX_ITERATIONS {
            self.context.progress.check()?;
            trials += 1;
            let Some((session_step, motions)) = self.step(members, offsets, &cameras, damping) else { break };
            let n_bias = 3 * offsets.len();
            let camera_step = session_step.rows(n_bias, session_step.len() - n_bias).into_owned();
            let moved_cameras = moved(&cameras, &camera_step);
            let moved_offsets: Vec<Vector3<f64>> = offsets.iter().enumerate().map(|(k, o)| o + session_step.fixed_rows::<3>(3 * k)).collect();
            let states: Vec<(MotionState, BoneOffsets)> = members
                .par_iter()
                .zip(&motions)
                .map(|(member, step)| {
                    let first = self.border().bones().start;
                    let bone = |k: usize| member.bones[k] + step.border.fixed_rows::<3>(first + 3 * k);
                    let state = self.problem(self.context.model, member).moved(&member.state, step);
                    (state, std::array::from_fn(bone))
                })
                .collect();
            let before: Vec<(MotionState, BoneOffsets)> = members
                .iter_mut()
                .zip(states)
                .map(|(member, (state, bones))| {
                    member.observations.cameras.clone_from(&moved_cameras);
                    (std::mem::replace(&mut member.state, state), std::mem::replace(&mut member.bones, bones))
                })
                .collect();
            let moved_cost = self.cost(members, &moved_offsets);
            if std::env::var("WJ_VERBOSE").is_ok() {
                eprintln!("cost {cost:.1} -> {moved_cost:.1} damping {damping:e} step {:.5}", camera_step.norm());
            }
            if moved_cost < cost {
                let is_done = cost - moved_cost < MIN_DECREASE;
                (cost, cameras, damping) = (moved_cost, moved_cameras, damping * 0.1);
                *offsets = moved_offsets;
                accepted += 1;
                if is_done {
                    break;
                }
            } else {
                for (member, before) in members.iter_mut().zip(before) {
                    (member.state, member.bones) = before;
                    member.observations.cameras.clone_from(&cameras);
                }
                damping = (damping * 20.0).max(1e-6);
            }
        }
        Ok(cameras)
    }

    fn problem<'b>(&'b self, model: &'b BodyModel, member: &'b Member) -> MotionProblem<'b> {
        problem(self.context, model, self.data, Some(self.table), self.n_cameras, member)
    }

    fn cost(&self, members: &[Member], offsets: &[Vector3<f64>]) -> f64 {
        let model = self.table.applied(self.context.model, offsets);
        let cost = |member: &Member| {
            let own = with_bones(&model, &member.bones);
            self.problem(&own, member).cost(&member.state) + self.bone_prior.cost(&flat(&member.bones))
        };
        let costs: Vec<f64> = members.par_iter().map(cost).collect();
        costs.iter().sum::<f64>() + self.bias_prior.cost(&flat(offsets))
    }

    /// Step of the session's unknowns and of all motions.
    fn step(
        &self,
        members: &[Member],
        offsets: &[Vector3<f64>],
        cameras: &[PosedCamera],
        damping: f64,
    ) -> Option<(DVector<f64>, Vec<BandedStep>)> {
        let model = self.table.applied(self.context.model, offsets);
        let eliminated = |member: &Member| {
            let own = with_bones(&model, &member.bones);
            let mut system = self.problem(&own, member).linearised(&member.state);
            self.bone_prior.add_to(&flat(&member.bones), self.border().bones().start, &mut system.corner);
            system.eliminated(damping)
        };
        let people: Vec<Eliminated> = members.par_iter().map(eliminated).collect::<Option<_>>()?;
        let (n_own, n) = (self.border().person().len(), self.border().session().len());
        let mut session = Corner::zeros(n);
        self.bias_prior.add_to(&flat(offsets), 0, &mut session);
        let Corner { mut hessian, gradient } = session;
        let mut right = -gradient;
        let mut own_parts = Vec::with_capacity(people.len());
        for person in &people {
            let (own, across) =
                (person.corner.view((0, 0), (n_own, n_own)), person.corner.view((0, n_own), (n_own, n)));
            let own = damped(&own.into_owned(), damping).cholesky()?;
            let (by_cameras, rest) = (own.solve(&across), own.solve(&person.right.rows(0, n_own)));
            hessian += person.corner.view((n_own, n_own), (n, n)) - across.tr_mul(&by_cameras);
            right += person.right.rows(n_own, n) - across.tr_mul(&rest);
            own_parts.push((by_cameras, rest));
        }
        let basis = session_basis(3 * offsets.len(), cameras);
        let reduced = damped(&basis.tr_mul(&(&hessian * &basis)), damping);
        let camera_step = &basis * reduced.cholesky()?.solve(&basis.tr_mul(&right));
        let motion = |(person, (by_cameras, rest)): (&Eliminated, &(DMatrix<f64>, DVector<f64>))| {
            let own = rest - by_cameras * &camera_step;
            let border = own.iter().chain(camera_step.iter()).copied();
            person.step(DVector::from_iterator(own.len() + camera_step.len(), border))
        };
        let motions = people.iter().zip(&own_parts).map(motion).collect::<Option<_>>()?;
        Some((camera_step, motions))
    }
}

fn moved(cameras: &[PosedCamera], step: &DVector<f64>) -> Vec<PosedCamera> {
    let moved = |(i, camera): (usize, &PosedCamera)| {
        let (rho, phi) = (step.fixed_rows::<3>(6 * i).into_owned(), step.fixed_rows::<3>(6 * i + 3).into_owned());
        PosedCamera { camera_from_world: camera.camera_from_world.perturbed_left(&rho, &phi), ..*camera }
    };
    cameras.iter().enumerate().map(moved).collect()
}

fn flat(offsets: &[Vector3<f64>]) -> Vec<f64> {
    offsets.iter().flat_map(|offset| offset.iter().copied()).collect()
}

/// All directions of `n_others` unknowns, and those of [`free_network_basis`].
fn session_basis(n_others: usize, cameras: &[PosedCamera]) -> DMatrix<f64> {
    let of_cameras = free_network_basis(cameras);
    let (n, n_free) = of_cameras.shape();
    let mut basis = DMatrix::zeros(n_others + n, n_others + n_free);
    basis.view_mut((0, 0), (n_others, n_others)).fill_with_identity();
    basis.view_mut((n_others, n_others), (n, n_free)).copy_from(&of_cameras);
    basis
}

/// Orthonormal directions of all camera poses across those of a similarity. [6 cameras, 6 cameras - 7]
fn free_network_basis(cameras: &[PosedCamera]) -> DMatrix<f64> {
    let n = 6 * cameras.len();
    let poses = || cameras.iter().map(|camera| camera.camera_from_world);
    let centroid = poses().map(|p| p.center()).sum::<Vector3<f64>>() / cameras.len() as f64;
    let mut directions = DMatrix::zeros(n, 7);
    for (k, pose) in poses().enumerate() {
        let (arm, rotation) = (pose.center() - centroid, pose.rotation);
        directions.fixed_view_mut::<3, 3>(6 * k, 0).copy_from(&-rotation);
        directions.fixed_view_mut::<3, 3>(6 * k, 3).copy_from(&(rotation * skew(&arm)));
        directions.fixed_view_mut::<3, 1>(6 * k, 6).copy_from(&(-(rotation * arm)));
        directions.fixed_view_mut::<3, 3>(6 * k + 3, 3).copy_from(&Matrix3::from(-rotation));
    }
    let eigen = (&directions * directions.transpose()).symmetric_eigen();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    DMatrix::from_columns(&order[..n - 7].iter().map(|&i| eigen.eigenvectors.column(i)).collect::<Vec<_>>())
}
