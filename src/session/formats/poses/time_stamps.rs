//! Frame rate and time offsets of cameras from the time stamps of their frames, as Caliscope writes them (`frame_time`).

use std::collections::BTreeMap;

/// Time stamps, s, of one clock by frame and camera.
#[derive(Debug, Default)]
pub(super) struct TimeStamps(BTreeMap<i64, BTreeMap<String, f64>>);

/// Smallest number of common frames from which an offset is taken: a median of fewer is one camera's jitter.
const MIN_COMMON_FRAMES: usize = 10;

impl TimeStamps {
    /// Adds the time of a frame; further points of the same frame change nothing.
    pub(super) fn add(&mut self, camera: &str, frame: i64, time: f64) {
        if time.is_finite() {
            self.0.entry(frame).or_default().entry(camera.to_owned()).or_insert(time);
        }
    }

    /// Frames per second: the reciprocal of the median time between consecutive frames of a camera.
    pub(super) fn fps(&self) -> Option<f64> {
        let mut steps = Vec::new();
        for (frame, times) in &self.0 {
            let Some(next) = self.0.get(&(frame + 1)) else { continue };
            steps.extend(times.iter().filter_map(|(camera, time)| Some(next.get(camera)? - time)));
        }
        median(&mut steps).map(f64::recip).filter(|rate| rate.is_finite() && *rate > 0.0)
    }

    /// Time offsets by camera, s: the median over the frames of a camera's time minus that of the reference, the camera with
    /// the most frames, which gets 0. Cameras with few frames in common with it get none.
    pub(super) fn offsets(&self) -> BTreeMap<String, f64> {
        let mut n_frames: BTreeMap<&String, usize> = BTreeMap::new();
        self.0.values().flat_map(BTreeMap::keys).for_each(|camera| *n_frames.entry(camera).or_default() += 1);
        let Some(most) = n_frames.values().max() else { return BTreeMap::new() };
        let Some(reference) = n_frames.iter().find(|(_, n)| *n == most).map(|(camera, _)| *camera) else {
            return BTreeMap::new();
        };
        let offset = |camera: &String| {
            let difference = |times: &BTreeMap<String, f64>| Some(times.get(camera)? - times.get(reference)?);
            let mut differences: Vec<f64> = self.0.values().filter_map(difference).collect();
            let is_enough = differences.len() >= MIN_COMMON_FRAMES;
            Some((camera.clone(), median(&mut differences).filter(|_| is_enough)?))
        };
        n_frames.keys().filter_map(|camera| offset(camera)).collect()
    }
}

/// Upper median; `None` without values.
fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_offsets_of_jittering_cameras() {
        let mut stamps = TimeStamps::default();
        for frame in 0..50i64 {
            let jitter = [0.0, 0.001, -0.001][frame as usize % 3];
            stamps.add("a", frame, 100.0 + frame as f64 / 25.0);
            if frame > 10 {
                stamps.add("b", frame, 100.012 + frame as f64 / 25.0 + jitter);
            }
        }
        stamps.add("c", 3, 100.0);
        assert!((stamps.fps().unwrap() - 25.0).abs() < 1e-6);
        let offsets = stamps.offsets();
        assert_eq!(offsets.keys().collect::<Vec<_>>(), ["a", "b"]);
        assert!(offsets["a"] == 0.0 && (offsets["b"] - 0.012).abs() < 1e-9, "{offsets:?}");
    }
}
