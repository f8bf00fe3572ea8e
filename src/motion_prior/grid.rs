//! Motions of any frame rate on the 30 Hz grid of the denoiser, and back.

use super::chart::LocalRotations;
use super::dataset::GRID_FPS;
use super::interpolation::{GridPlace, grid_place, interpolate, resampled_len};
use super::observed::{DESCRIBED_JOINTS, N_DESCRIBED, ObservedMotion};
use super::prior::Completion;

/// What `complete` states of a motion at `fps`, at the motion's own frames: [`completed`](super::MotionPrior::completed) or
/// [`bridged`](super::MotionPrior::bridged).
pub fn at_rate(motion: &ObservedMotion, fps: f64, complete: impl FnOnce(&ObservedMotion) -> Completion) -> Completion {
    at_frames_of(&motion.rotations, fps, &complete(&on_grid(motion, fps)))
}

/// What is stated on the grid, at the frames of the motion that it is stated of.
fn at_frames_of(rotations: &[LocalRotations], fps: f64, on_grid: &Completion) -> Completion {
    let n_grid = on_grid.rotations.len();
    let mut found = Completion::default();
    for (frame, given) in rotations.iter().enumerate() {
        let place = grid_place(frame as f64 * GRID_FPS / fps, n_grid);
        let nearest = place.samples[if place.share < 0.5 { 1 } else { 2 }];
        found.rotations.push(std::array::from_fn(|joint| match DESCRIBED_JOINTS.contains(&joint) {
            true => interpolate(&place.samples.map(|s| on_grid.rotations[s][joint]), place.share),
            false => given[joint],
        }));
        found.precision.push(on_grid.precision[nearest]);
    }
    found
}

/// A motion at `fps` on the 30 Hz grid. A joint is seen where it is seen in both neighbouring frames; an unseen one of the
/// cubic's outer frames is replaced by its neighbour. The grid ends at or after the last frame, which it repeats there.
fn on_grid(motion: &ObservedMotion, fps: f64) -> ObservedMotion {
    let ObservedMotion { rotations, pelvis, sigma } = motion;
    let n_frames = rotations.len();
    let n_samples = resampled_len(n_frames, fps, GRID_FPS);
    let ends_before = (n_samples as f64 - 1.0) * fps / GRID_FPS < n_frames as f64 - 1.0 - 1e-6;
    let mut grid = ObservedMotion { rotations: vec![], pelvis: vec![], sigma: vec![] };
    for sample in 0..n_samples + usize::from(ends_before) {
        let place = grid_place(sample as f64 * fps / GRID_FPS, n_frames);
        let [_, first, second, _] = place.samples;
        let mut row = rotations[if place.share < 0.5 { first } else { second }];
        let mut sigmas = [0.0; N_DESCRIBED];
        for (described, &joint) in DESCRIBED_JOINTS.iter().enumerate() {
            let samples = seen_samples(&place, |frame| sigma[frame][described].is_finite());
            row[joint] = interpolate(&samples.map(|frame| rotations[frame][joint]), place.share);
            sigmas[described] = match place.share {
                share if share < 1e-3 => sigma[first][described],
                share if share > 1.0 - 1e-3 => sigma[second][described],
                _ => sigma[first][described].max(sigma[second][described]),
            };
        }
        grid.rotations.push(row);
        grid.sigma.push(sigmas);
        grid.pelvis.push(pelvis[first].lerp(&pelvis[second], place.share));
    }
    grid
}

/// The four samples of the cubic; unseen outer ones are replaced by their inner neighbours.
fn seen_samples(place: &GridPlace, is_seen: impl Fn(usize) -> bool) -> [usize; 4] {
    let [before, first, second, after] = place.samples;
    [if is_seen(before) { before } else { first }, first, second, if is_seen(after) { after } else { second }]
}

#[cfg(test)]
mod tests {
    use super::super::MotionPrior;
    use super::super::observed::N_DESCRIBED;
    use super::*;
    use crate::geometry::rotation::{angle_between, exp};
    use nalgebra::{Matrix3, Vector3};

    fn waving(n_frames: usize, fps: f64) -> ObservedMotion {
        let frame = |t: usize| {
            let mut rotations = [Matrix3::identity(); 24];
            rotations[16] = exp(&Vector3::new(0.0, (2.0 * t as f64 / fps).sin(), -0.8));
            rotations
        };
        let pelvis = vec![Vector3::new(0.0, 0.9, 0.0); n_frames];
        ObservedMotion::exact((0..n_frames).map(frame).collect(), pelvis)
    }

    #[test]
    fn the_grid_has_the_motion_at_its_own_times() {
        let mut motion = waving(51, 25.0);
        motion.sigma[20..30].iter_mut().for_each(|row| row[14] = f64::INFINITY);
        let grid = on_grid(&motion, 25.0);
        assert_eq!(grid.n_frames(), 61);
        let thirty = waving(61, 30.0).rotations;
        for t in (0..61).filter(|&t| grid.is_seen(t, 14)) {
            assert!(angle_between(&grid.rotations[t][16], &thirty[t][16]) < 2e-3, "{t}");
        }
        // Frames 20 to 29 at 25 Hz are 0.76 (after frame 19) to 1.2 s.
        let hidden: Vec<usize> = (0..61).filter(|&t| !grid.is_seen(t, 14)).collect();
        assert_eq!((hidden[0], hidden[hidden.len() - 1]), (23, 35));
    }

    #[test]
    fn completions_have_the_frames_of_their_motion() {
        for (n_frames, fps) in [(0, 30.0), (1, 25.0), (2, 60.0), (77, 25.0), (130, 59.94)] {
            let mut motion = waving(n_frames, fps);
            motion.sigma.fill([0.02; N_DESCRIBED]);
            let found = at_rate(&motion, fps, |grid| MotionPrior::embedded().completed(grid));
            assert_eq!((found.rotations.len(), found.precision.len()), (n_frames, n_frames));
            assert!(found.precision.iter().flatten().all(|p| p.iter().all(|x| x.is_finite())));
        }
    }
}
