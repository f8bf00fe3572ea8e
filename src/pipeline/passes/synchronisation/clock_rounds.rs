//! Rounds of bundle adjustment with delays of the cameras, and with drifts of their clocks where these show.

use crate::geometry::Rigid;
use crate::pipeline::calibration::{AdjustedCamera, Calibration};
use crate::pipeline::camera_clock::{CameraClock, rate_of_drift};
use crate::pipeline::capture::Capture;
use crate::pipeline::config::{IntrinsicsMode, Options};
use crate::pipeline::focal_lengths::FocalLengths;
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, adjusted};
use crate::pipeline::passes::cameras::{FinalAdjustment, roughly_calibrated};
use crate::pipeline::stages::time_offsets::retiming;
use crate::progress::{Canceled, Progress};
use crate::session::Session;
use crate::session::reconstruction::{ClockDrift, TimeOffset};

/// Largest number of rounds: each leaves a tenth of the error, from a frame or two.
const MAX_ROUNDS: usize = 6;

/// Round after which drifts are looked for although offsets have not settled: with large ones they do not.
const DRIFT_ROUND: usize = 2;

/// Remaining delays below this are noise, frames.
const CONVERGED: f64 = 0.01;

/// Largest correction of one round, frames: the path of a keypoint is not straight for longer.
const MAX_STEP: f64 = 2.5;

/// A clock drifts where the ends of the take are this far off, frames, and by so many standard errors: offsets are known to a tenth
/// of a frame, and a wrong drift harms the ends.
const MIN_DRIFT: f64 = 0.2;
const CERTAIN: f64 = 4.0;

/// Shortest take whose clocks may drift, s: clocks of usual cameras differ by 0.1 % at most (29.97 for 30 frames a second), a third
/// of a frame at either end of 20 s.
const MIN_DRIFT_SECS: f64 = 10.0;

/// Rounds of bundle adjustment with delays, each on the recording as moved by the clocks so far.
pub(super) struct Rounds<'a> {
    session: &'a Session,
    options: &'a Options,
    effort: Effort,
    clocks: Vec<CameraClock>,
    /// Of the last round.
    delays: Vec<Option<Delay>>,
    has_drifts: bool,
    lengths: FocalLengths,
    cameras: Option<Vec<Option<Rigid>>>,
    /// Rounds so far.
    pub(super) count: usize,
    /// Of the last round, frames.
    pub(super) largest_step: f64,
    /// Of the adjustments: before the first and after the last one.
    pub(super) cost: [Option<f64>; 2],
}

impl<'a> Rounds<'a> {
    pub(super) fn new(session: &'a Session, options: &'a Options, clocks: Vec<CameraClock>) -> Self {
        Self {
            session,
            options,
            effort: Effort::delays(options.intrinsics_of(session)),
            delays: vec![None; clocks.len()],
            clocks,
            has_drifts: false,
            lengths: FocalLengths::given(session),
            cameras: None,
            count: 0,
            largest_step: f64::INFINITY,
            cost: [None; 2],
        }
    }

    /// Whether the clocks have settled.
    pub(super) fn is_converged(&self) -> bool {
        self.largest_step <= CONVERGED
    }

    /// Until the clocks stay; with drifts from the round on that shows any.
    pub(super) fn run(&mut self, last: FinalAdjustment, progress: &Progress) -> Result<(), Canceled> {
        let may_drift = self.session.n_frames as f64 >= MIN_DRIFT_SECS * self.session.fps;
        let mut steps = progress.steps([3.0, 1.0].repeat(2 * MAX_ROUNDS));
        let mut limit = MAX_ROUNDS;
        while self.count < limit && !self.is_converged() {
            let retimed = retiming::retimed(self.session, &self.clocks);
            let scaled = self.lengths.applied_to(&retimed);
            let capture = Capture::new(&scaled, self.options);
            let step = steps.begin("estimating cameras at the current time offsets");
            let before = roughly_calibrated(&capture, self.cameras.take(), last, &step)?;
            let step = steps.begin("adjusting cameras and time offsets");
            let mut after = adjusted(&capture, &before, self.effort, ALL_FRAMES, &step)?;
            self.count += 1;
            let is_tested = largest_step(&delays(&after)) <= CONVERGED || self.count == DRIFT_ROUND;
            if may_drift && !self.has_drifts && is_tested {
                let drifting = adjusted(&capture, &after, self.effort.testing_drifts(), ALL_FRAMES, &step)?;
                if delays(&drifting).iter().flatten().any(Delay::has_drift) {
                    limit = self.count + MAX_ROUNDS;
                    (after, self.effort, self.has_drifts) = (drifting, self.effort.with_drifts(), true);
                }
            }
            self.take_over(&after);
            self.cameras = Some(after.cameras);
        }
        Ok(())
    }

    /// Moves the clocks by the delays that an adjustment has left.
    fn take_over(&mut self, after: &Calibration) {
        if self.options.intrinsics_of(self.session) != IntrinsicsMode::Fixed {
            self.lengths.take_over(after);
        }
        self.delays = delays(after);
        tracing::debug!(round = self.count, ?self.clocks, ?self.delays, "clocks and remaining delays");
        self.largest_step = largest_step(&self.delays);
        for (clock, delay) in self.clocks.iter_mut().zip(&self.delays) {
            if let Some(Delay { frames, drift, .. }) = delay {
                clock.offset += frames.clamp(-MAX_STEP, MAX_STEP);
                clock.drift += drift.clamp(-MAX_STEP, MAX_STEP);
            }
        }
        if let Some(report) = after.stages.last() {
            self.cost = [self.cost[0].or(report.cost_before), report.cost_after];
        }
    }

    /// `common`: what was subtracted from all offsets at the start, frames.
    pub(super) fn time_offsets(&self, common: f64) -> Vec<TimeOffset> {
        let Session { fps, n_frames, .. } = *self.session;
        let rate = |drift: f64| rate_of_drift(drift, n_frames);
        // Rounds that ended before the clocks stayed leave about as much as they last moved.
        let unsettled = |delay: Delay| if self.is_converged() { 0.0 } else { delay.frames };
        let of_view = |(clock, delay): (&CameraClock, &Option<Delay>)| TimeOffset {
            secs: (clock.offset + common) / fps,
            sigma_secs: delay.and_then(|delay| Some(delay.sigma?.hypot(unsettled(delay)) / fps)),
            drift: delay
                .filter(|_| self.has_drifts)
                .map(|delay| ClockDrift { rate: rate(clock.drift), sigma: delay.sigma_drift.map(rate) }),
        };
        self.clocks.iter().zip(&self.delays).map(of_view).collect()
    }
}

/// An estimated delay of one camera.
#[derive(Debug, Clone, Copy)]
struct Delay {
    /// In the middle of the take.
    frames: f64,
    sigma: Option<f64>,
    /// Frames at the end of the take.
    drift: f64,
    sigma_drift: Option<f64>,
}

impl Delay {
    fn has_drift(&self) -> bool {
        self.sigma_drift.is_some_and(|sigma| self.drift.abs() > MIN_DRIFT.max(CERTAIN * sigma))
    }
}

/// Largest delay or drift, frames.
fn largest_step(delays: &[Option<Delay>]) -> f64 {
    delays.iter().flatten().map(|delay| delay.frames.abs().max(delay.drift.abs())).fold(0.0, f64::max)
}

/// Delays against the first adjusted view; `None` for views that were not adjusted.
fn delays(calibration: &Calibration) -> Vec<Option<Delay>> {
    let Some(adjusted) = &calibration.adjusted else { return vec![None; calibration.cameras.len()] };
    let moved = adjusted.cameras.iter().map(|c| c.is_observed.then_some(c));
    let reference = moved.clone().flatten().next().map_or([0.0; 2], |c| [c.delay, c.drift]);
    let of_camera = |c: &AdjustedCamera| Delay {
        frames: c.delay - reference[0],
        sigma: c.uncertainty.and_then(|u| u.sigma_delay),
        drift: c.drift - reference[1],
        sigma_drift: c.uncertainty.and_then(|u| u.sigma_drift),
    };
    moved.map(|c| c.map(of_camera)).collect()
}
