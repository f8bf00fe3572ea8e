//! How much a motion trembles: mean acceleration.

use super::camera_error::mean;
use super::person_matching::Frames;
use super::shelf14::Point;
use serde::Serialize;

/// Mean acceleration over people and joints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Jitter {
    /// Mean second difference, mm per frame squared.
    pub mm_per_frame2: Option<f64>,
    /// The same in m/s^2.
    pub m_per_s2: Option<f64>,
    /// Second differences taken.
    pub n: usize,
}

/// Mean of `|x(t+1) - 2 x(t) + x(t-1)|` over all joints known in three consecutive frames.
///
/// Needs names of people that persist. A lower figure than the truth's means a motion that was smoothed away.
pub fn jitter(frames: &Frames<Vec<Point>>, fps: f64) -> Jitter {
    let mut differences = Vec::new();
    for (frame, people) in frames {
        let (Some(before), Some(after)) = (frames.get(&(frame - 1)), frames.get(&(frame + 1))) else { continue };
        for (name, now) in people {
            let (Some(before), Some(after)) = (before.get(name), after.get(name)) else { continue };
            let joints = before.iter().zip(now).zip(after);
            differences.extend(joints.filter_map(|((b, n), a)| Some(((*a)? - (*n)? * 2.0 + (*b)?).norm())));
        }
    }
    let metres = mean(differences.iter().copied());
    Jitter { mm_per_frame2: metres.map(|m| 1e3 * m), m_per_s2: metres.map(|m| m * fps * fps), n: differences.len() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use std::collections::BTreeMap;

    #[test]
    fn a_falling_point_accelerates_by_g_and_gaps_do_not_count() {
        let at = |frame: i64| Some(Vector3::new(0.0, -0.5 * 9.81 * (frame as f64 / 50.0).powi(2), 0.0));
        let mut frames: Frames<Vec<Point>> = Frames::new();
        for frame in [0, 1, 2, 3, 7, 8] {
            frames.insert(frame, BTreeMap::from([("0".to_owned(), vec![at(frame), None])]));
        }
        let found = jitter(&frames, 50.0);
        assert_eq!(found.n, 2);
        assert!((found.m_per_s2.unwrap() - 9.81).abs() < 1e-9);
        assert_eq!(jitter(&Frames::new(), 50.0).m_per_s2, None);
    }
}
