//! How exact the detector is here and now: its noise over time, landmark by landmark and camera by camera.
//!
//! Detectors err by several times as much while a limb is hidden or blurred, and their confidences do not always tell it. On real
//! detections the innovations of a landmark in a camera change by a factor of 1.6 over half a second (standard deviation of the
//! logarithm 0.47 at the same confidence), so that one size for all of them follows bad stretches and wastes good ones.
//!
//! The logarithm of an innovation's length is that of the noise and an error of known variance (normal errors in the plane). The
//! noise's logarithm is taken as an autoregressive process about the channel's mean, its variance and autocorrelation from the
//! covariances after one and two frames, which the error leaves alone; its course follows by smoothing (Kalman 1960; Rauch
//! et al. 1965). What all cameras of a landmark share is left out: fast motions, which the fit does not follow, look the same.
//!
//! It counts in the last fit alone. Cameras hang on errors that last, whose sizes have little to do with it: on real detections
//! their angles came 30 % worse.

use super::context::FitContext;
use super::joint_problem::Member;
use super::noise_measurement::{measured_noise, positions};
use super::observations::Observations;
use super::person_fit::StartedMotion;
use super::terms::whitened_pixels::{ChannelInnovations, WhitenedPixels};
use super::thinned_motion::rough_stride;
use rayon::prelude::*;

/// Variance of the logarithm of the length of a standard normal vector in the plane.
const LOG_VARIANCE: f64 = std::f64::consts::PI * std::f64::consts::PI / 24.0;

/// Least length of an innovation, standard deviations: one of 900 is shorter, and the logarithm of none is finite.
const MIN_LENGTH: f64 = 0.05;

/// Least variance of the logarithm of the noise: a standard deviation of 22 %. Where confidences tell the noise, residuals show 0.02 to
/// 0.04, most of which is the fit's own leaning to single cameras; joints then came 0.2 % worse.
const MIN_VARIANCE: f64 = 0.05;

/// Fewest cameras that show a landmark in a frame: two rays do not show which of them errs.
const MIN_CAMERAS: usize = 3;

/// The logarithm of the noise over time, about a mean of zero.
#[derive(Debug, Clone, Copy, PartialEq)]
struct LevelProcess {
    variance: f64,
    /// From one frame to the next.
    autocorrelation: f64,
}

/// One landmark in one camera.
struct Channel {
    landmark: usize,
    camera: usize,
    /// By frame: logarithms of the innovations' lengths less their mean, later the noise's.
    logs: Vec<Option<f64>>,
}

/// The detector's noise over time for all persons.
pub(super) struct LocalNoise {
    process: LevelProcess,
    /// By person with a fit.
    people: Vec<Levels>,
}

/// Logarithms of one person's noise over that of the channel.
struct Levels {
    n_cameras: usize,
    /// Frames from one level to the next.
    stride: usize,
    /// `[landmark * n_cameras + camera][frame / stride]`; empty for what is not seen.
    by_channel: Vec<Vec<f64>>,
}

/// Measures the noise over time on the first fits; `None` where it hardly changes, and with few cameras.
///
/// Fits that were adjusted together with the cameras have followed the errors, so that their residuals are small in cameras that they
/// lean on: with the noise measured there joints came 1.7 % worse where it does not change.
pub(super) fn local_noise(
    context: &FitContext,
    started: &[Option<(Observations, StartedMotion)>],
) -> Option<LocalNoise> {
    let n_cameras = started.iter().flatten().next()?.0.cameras.len();
    if n_cameras < MIN_CAMERAS {
        return None;
    }
    let stride = rough_stride(context.frame_interval);
    let member = |(observations, fit): &(Observations, StartedMotion)| {
        Member::of(observations, fit, 0..observations.pixels.len(), stride)
    };
    let members: Vec<Member> = started.iter().flatten().map(member).collect();
    let context = context.thinned(stride);
    let channels = channels(&context, &members);
    let process = LevelProcess::of(channels.iter().flatten());
    let levels = |channels: Vec<Channel>| Levels::new(&process, channels, n_cameras, stride);
    (process.variance >= MIN_VARIANCE)
        .then(|| LocalNoise { process, people: channels.into_par_iter().map(levels).collect() })
}

impl LocalNoise {
    /// Gives all pixels the noise of their time.
    pub(super) fn weigh(&self, started: &mut [Option<(Observations, StartedMotion)>]) {
        let people: Vec<_> = started.iter_mut().flatten().zip(&self.people).collect();
        people.into_par_iter().for_each(|((observations, _), levels)| {
            for (frame, pixels) in observations.pixels.iter_mut().enumerate() {
                pixels.iter_mut().for_each(|p| p.scale_px *= levels.at(p.landmark, p.camera, frame).exp());
            }
        });
    }

    /// For the report: the standard deviation of the logarithm of the noise over time.
    pub(super) fn metric(&self) -> (String, f64) {
        ("noise_log_sigma".to_owned(), self.process.variance.sqrt())
    }
}

/// The channels of each member.
fn channels(context: &FitContext, members: &[Member]) -> Vec<Vec<Channel>> {
    let noise = measured_noise(context, members);
    let of_member = |member: &Member| {
        let paths = WhitenedPixels::new(&member.observations, &noise, context.config.robust_scale);
        let positions = positions(context.model, member, &paths.landmarks);
        let mut innovations = paths.innovations_by_channel(&member.observations.cameras, &positions);
        let n_frames = member.observations.pixels.len();
        keep_judged(&mut innovations, n_frames);
        innovations.into_iter().map(|(at, lengths)| Channel::new(at, &lengths, n_frames)).collect()
    };
    members.par_iter().map(of_member).collect()
}

/// Leaves the innovations of frames in which enough cameras show the landmark; those of a landmark follow each other.
fn keep_judged(innovations: &mut [ChannelInnovations], n_frames: usize) {
    for of_landmark in innovations.chunk_by_mut(|a, b| a.0[0] == b.0[0]) {
        let mut n_cameras = vec![0; n_frames];
        of_landmark.iter().flat_map(|(_, lengths)| lengths).for_each(|(frame, _)| n_cameras[*frame] += 1);
        of_landmark.iter_mut().for_each(|(_, lengths)| lengths.retain(|(frame, _)| n_cameras[*frame] >= MIN_CAMERAS));
    }
}

impl Channel {
    /// `lengths`: frames and lengths of innovations.
    fn new([landmark, camera]: [usize; 2], lengths: &[(usize, f64)], n_frames: usize) -> Self {
        let log = |length: f64| length.max(MIN_LENGTH).ln();
        let mean = lengths.iter().map(|(_, length)| log(*length)).sum::<f64>() / lengths.len().max(1) as f64;
        let mut logs = vec![None; n_frames];
        lengths.iter().for_each(|(frame, length)| logs[*frame] = Some(log(*length) - mean));
        Self { landmark, camera, logs }
    }
}

impl LevelProcess {
    /// From covariances after one and two frames: the errors of single logarithms are independent and add nothing to them.
    fn of<'a>(channels: impl Iterator<Item = &'a Channel>) -> Self {
        let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
        for channel in channels {
            for (lag, (sum, count)) in (1..).zip(sums.iter_mut().zip(&mut counts)) {
                for (before, now) in channel.logs.iter().zip(channel.logs.iter().skip(lag)) {
                    if let (Some(before), Some(now)) = (before, now) {
                        *sum += before * now;
                        *count += 1.0;
                    }
                }
            }
        }
        let [one, two]: [f64; 2] = std::array::from_fn(|lag| sums[lag] / f64::max(counts[lag], 1.0));
        if one <= 0.0 {
            return Self { variance: 0.0, autocorrelation: 0.0 };
        }
        // A process that changes within a frame, or never, is not one that could be followed.
        let autocorrelation = (two / one).clamp(0.3, 0.98);
        Self { variance: one / autocorrelation, autocorrelation }
    }

    /// The likeliest course of the process under what was measured of it.
    fn smoothed(&self, logs: &[Option<f64>]) -> Vec<f64> {
        let Self { variance, autocorrelation } = *self;
        let drift = variance * (1.0 - autocorrelation * autocorrelation);
        let ahead = |(mean, spread): (f64, f64)| (autocorrelation * mean, autocorrelation.powi(2) * spread + drift);
        let mut state = (0.0, variance);
        let filter = |log: &Option<f64>| {
            let (mean, spread) = ahead(state);
            let gain = log.map_or(0.0, |_| spread / (spread + LOG_VARIANCE));
            state = (mean + gain * (log.unwrap_or(mean) - mean), (1.0 - gain) * spread);
            state
        };
        let mut course: Vec<(f64, f64)> = logs.iter().map(filter).collect();
        for t in (1..course.len()).rev() {
            let (expected, spread) = ahead(course[t - 1]);
            course[t - 1].0 += course[t - 1].1 * autocorrelation / spread * (course[t].0 - expected);
        }
        course.into_iter().map(|(mean, _)| mean).collect()
    }
}

impl Levels {
    fn new(process: &LevelProcess, channels: Vec<Channel>, n_cameras: usize, stride: usize) -> Self {
        let n_landmarks = channels.iter().map(|channel| channel.landmark + 1).max().unwrap_or(0);
        let mut by_channel = vec![Vec::new(); n_landmarks * n_cameras];
        for channel in channels {
            by_channel[channel.landmark * n_cameras + channel.camera] = process.smoothed(&channel.logs);
        }
        by_channel.chunks_mut(n_cameras).for_each(leave_out_common);
        Self { n_cameras, stride, by_channel }
    }

    fn at(&self, landmark: usize, camera: usize, frame: usize) -> f64 {
        let levels = self.by_channel.get(landmark * self.n_cameras + camera).map_or(&[][..], Vec::as_slice);
        let Some(last) = levels.len().checked_sub(1) else { return 0.0 };
        let (k, share) = (frame / self.stride, (frame % self.stride) as f64 / self.stride as f64);
        levels[k.min(last)] * (1.0 - share) + levels[(k + 1).min(last)] * share
    }
}

/// Takes the mean over the cameras that see a landmark from its levels.
fn leave_out_common(of_landmark: &mut [Vec<f64>]) {
    let n_seen = of_landmark.iter().filter(|levels| !levels.is_empty()).count();
    for t in 0..of_landmark.iter().map(Vec::len).max().unwrap_or(0) {
        let mean = of_landmark.iter().filter_map(|levels| levels.get(t)).sum::<f64>() / n_seen as f64;
        of_landmark.iter_mut().filter_map(|levels| levels.get_mut(t)).for_each(|level| *level -= mean);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Innovations of a channel whose noise is `noise(frame)`.
    fn channel(seed: u64, n_frames: usize, mut noise: impl FnMut(usize, f64) -> f64) -> Channel {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let lengths: Vec<(usize, f64)> =
            (0..n_frames).map(|t| (t, noise(t, normal()) * normal().hypot(normal()))).collect();
        Channel::new([0, 0], &lengths, n_frames)
    }

    /// 20,000 frames whose levels last for ten know the variance to 5 %.
    #[test]
    fn noise_that_changes_is_measured() {
        let mut level = 0.0;
        let changing = channel(3, 20_000, |_, drawn| {
            level = 0.9 * level + drawn * (0.3 * (1.0f64 - 0.9 * 0.9)).sqrt();
            level.exp()
        });
        let found = LevelProcess::of([changing].iter());
        assert!((found.variance - 0.3).abs() < 0.05 && (found.autocorrelation - 0.9).abs() < 0.03, "{found:?}");
        let steady = LevelProcess::of([channel(4, 20_000, |_, _| 1.0)].iter());
        assert!(steady.variance < MIN_VARIANCE, "{steady:?}");
    }

    /// Three times the noise for 2 s, at ten frames a second.
    #[test]
    fn stretches_of_noise_are_followed() {
        let noisy = 40..60;
        let process = LevelProcess { variance: 0.3, autocorrelation: 0.8 };
        let course = process.smoothed(&channel(5, 100, |t, _| if noisy.contains(&t) { 3.0 } else { 1.0 }).logs);
        let mean = |frames: std::ops::Range<usize>| course[frames.clone()].iter().sum::<f64>() / frames.len() as f64;
        let risen = mean(43..57) - 0.5 * (mean(5..35) + mean(65..95));
        assert!((0.6 * 3f64.ln()..1.2 * 3f64.ln()).contains(&risen), "{risen}");
        assert_eq!(process.smoothed(&[None; 5]), [0.0; 5]);
    }

    /// A fast motion raises the innovations of all cameras.
    #[test]
    fn what_all_cameras_share_does_not_count() {
        let process = LevelProcess { variance: 0.3, autocorrelation: 0.8 };
        let of_camera = |camera: usize, log: f64| Channel { landmark: 0, camera, logs: vec![Some(log); 30] };
        let fast = Levels::new(&process, (0..3).map(|camera| of_camera(camera, 1.0)).collect(), 3, 3);
        assert!((0..90).all(|frame| fast.at(0, 1, frame).abs() < 1e-12));
        let hidden =
            Levels::new(&process, (0..3).map(|c| of_camera(c, if c == 1 { 1.0 } else { 0.0 })).collect(), 3, 3);
        assert!(hidden.at(0, 1, 45) > 0.5 && hidden.at(0, 0, 45) < -0.25);
        assert_eq!(hidden.at(7, 1, 45), 0.0, "a landmark that was never seen");
    }
}
