//! The verdict: what a user must know before trusting a result, in sentences that can be acted on.
//!
//! A reason says what was found, on whom, against what is expected, and after its last semicolon what to do. Why fixed
//! bounds and not comparisons alone: in a capture that is bad throughout nothing stands out.

mod cameras;
mod geometry;
mod people;
#[cfg(test)]
mod tests;

use crate::session::reconstruction::{CameraReport, GeometryReport, PenetrationReport, PersonReport, Quality, Verdict};

/// What the verdict is made from.
#[derive(Debug, Clone, Copy)]
pub struct Evidence<'a> {
    /// Frames per second.
    pub fps: f64,
    /// In the session's order.
    pub cameras: &'a [CameraReport],
    /// Everybody who was found.
    pub people: &'a [PersonReport],
    /// How well the views cover them.
    pub geometry: &'a GeometryReport,
    /// How far they reach into each other.
    pub penetration: &'a PenetrationReport,
    /// Whether people gave way to each other (`options.collision`).
    pub gave_way: bool,
    /// Share of confident keypoints explained.
    pub explained: f64,
    /// Largest standard deviation of a camera's orientation, degrees, where it is known.
    pub sigma_angle_deg: Option<f64>,
    /// Share of keypoints that the best truly different arrangement of the cameras explained; 0 without one.
    pub rival_explained: f64,
    /// Whether the cameras were estimated from nothing.
    pub estimated: bool,
}

impl Evidence<'_> {
    fn n_placed(&self) -> usize {
        self.cameras.iter().filter(|camera| camera.solved).count()
    }
}

/// One thing that speaks against a result.
struct Reason {
    verdict: Verdict,
    text: String,
}

impl Reason {
    fn warn(text: String) -> Self {
        Self { verdict: Verdict::Warn, text }
    }

    fn reject(text: String) -> Self {
        Self { verdict: Verdict::Reject, text }
    }
}

/// Up to where a figure is fine, and from where on the result is of no use; in between it needs a look.
struct Bounds {
    warn: f64,
    reject: f64,
}

impl Bounds {
    /// The verdict on a figure that should be small; `None` where it is.
    fn on_high(&self, figure: f64) -> Option<Verdict> {
        if figure > self.reject {
            Some(Verdict::Reject)
        } else if figure > self.warn {
            Some(Verdict::Warn)
        } else {
            None
        }
    }

    /// The verdict on a figure that should be large; `None` where it is.
    fn on_low(&self, figure: f64) -> Option<Verdict> {
        Self { warn: -self.warn, reject: -self.reject }.on_high(-figure)
    }
}

/// Judges a result.
pub fn quality(evidence: &Evidence) -> Quality {
    let mut reasons = Vec::new();
    if evidence.cameras.len() == 1 {
        reasons.push(one_view(evidence.n_placed() == 1));
    } else {
        reasons.extend(cameras::reasons(evidence));
        reasons.extend(geometry::reasons(evidence));
        reasons.extend(people::reasons(evidence));
    }
    reasons.extend(nobody(evidence));
    let verdict = reasons.iter().map(|reason| reason.verdict).max().unwrap_or(Verdict::Pass);
    Quality { verdict, reasons: reasons.into_iter().map(|reason| reason.text).collect() }
}

/// What a single camera leaves open.
fn one_view(is_placed: bool) -> Reason {
    if is_placed {
        let text = "one view: depth rests on body size, taken to be an average adult's, and which of two joints is nearer \
                    on how people move; add a second synchronised camera";
        Reason::warn(text.to_owned())
    } else {
        let text = "monocular: one camera alone tells neither where it stands nor depth; add a second synchronised camera, or \
                    give the camera's R and t and choose \"fixed\" extrinsics";
        Reason::reject(text.to_owned())
    }
}

fn nobody(evidence: &Evidence) -> Option<Reason> {
    let n_placed = evidence.n_placed();
    let text = match n_placed {
        1 => "nobody was seen for 0.3 s; check that the keypoint file is that of this take",
        _ => "nobody was seen by two cameras at once for 0.3 s; check that the cameras overlap and are synchronised",
    };
    let could_be_seen = n_placed >= evidence.cameras.len().min(2);
    (could_be_seen && evidence.people.is_empty()).then(|| Reason::reject(text.to_owned()))
}
