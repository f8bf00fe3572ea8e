//! The minimum of the cost over the cameras alone where focal lengths are among the unknowns.
//!
//! It is the cost of [`marginal_step`](super::marginal_step), `C(c, m(c)) + share * log |H_mm(c)| / 2`. A camera that is farther away
//! with a longer lens shows the same but for perspective, which is little where a lens is long; but motions then follow errors more
//! easily, and the cost `C` alone drew single cameras away: of 32 sessions of lenses of 0.9 to 2 image widths four had one that was
//! 15 to 40 % too long, stated to 4 %. So far apart, the two minima are not a step from each other: steps
//! `-S^-1 (dC/dc + share * g)` lead from where the cameras stand, without a visit to the minimum of `C`.

use super::super::pixel_residuals::DetectedPixels;
use super::super::session_state::SessionState;
use super::marginal_step::SHARE;
use super::{DAMPING, JointProblem, Member, Minimum, Reduced, Stopping, cameras_of, replace_all};
use crate::progress::Canceled;
use nalgebra::DVector;

/// Parts of a step that are tried, the first one first: far from the minimum a whole one leads out of where `C` is quadratic.
const PARTS: [f64; 4] = [1.0, 0.5, 0.25, 0.125];

/// Where the cost over the cameras alone leads next, by the free directions of the session.
struct Course {
    /// `share * g`.
    of_spread: DVector<f64>,
    to_minimum: DVector<f64>,
    /// How far the minimum is, in standard deviations, root mean square.
    sigmas: f64,
}

impl JointProblem<'_> {
    /// Minimises the cost over the cameras alone, from the states of `members`, which become those of the minimum.
    pub(in super::super) fn minimised_over_motions(
        &self,
        members: &mut [Member],
        stopping: &Stopping,
    ) -> Result<(), Canceled> {
        let pixels: Vec<DetectedPixels> = members.iter().map(|member| self.pixels(member)).collect();
        let session = SessionState { offsets: Vec::new(), cameras: cameras_of(members) };
        let mut minimum = Minimum { costs: self.costs(members, &pixels, &session), session };
        for _ in 0..stopping.max_iterations {
            self.context.progress.check()?;
            let reduced = self.reduced((members, &pixels), &minimum.session, self.systems(members), DAMPING);
            let Some(reduced) = reduced else { break };
            let course = self.course(&reduced, (members, &pixels));
            let next = course.as_ref().and_then(|course| self.gone((members, &pixels), &minimum, &reduced, course));
            self.context.systems.put_back(reduced.into_systems());
            let (Some(course), Some(next)) = (course, next) else { break };
            minimum = next;
            if course.sigmas < stopping.min_sigmas {
                break;
            }
        }
        Ok(())
    }

    /// `None` where the motions' spread is not finite.
    fn course(&self, reduced: &Reduced, (members, pixels): (&[Member], &[DetectedPixels])) -> Option<Course> {
        let following = self.following(reduced, (members, pixels))?;
        let of_spread = self.spread_gradient(reduced, (members, pixels), &following)? * SHARE;
        let downhill = reduced.downhill() - &of_spread;
        let (to_minimum, sigmas) = reduced.to_minimum(&downhill);
        Some(Course { of_spread, to_minimum, sigmas })
    }

    /// Takes the first part of a step under which the cost over the cameras alone falls; `None` where there is none.
    fn gone(
        &self,
        (members, pixels): (&mut [Member], &[DetectedPixels]),
        from: &Minimum,
        reduced: &Reduced,
        Course { of_spread, to_minimum, sigmas }: &Course,
    ) -> Option<Minimum> {
        for part in PARTS {
            let Some(step) = reduced.stepped(to_minimum * part) else { break };
            let (mut to, before) = self.stepped((members, pixels), &from.session, &step);
            let rise = |to: &Minimum| to.costs.total() - from.costs.total() + part * of_spread.dot(to_minimum);
            if rise(&to) >= 0.0 {
                self.shorten((members, pixels), (reduced, &step), (from, &before), &mut to);
            }
            tracing::trace!(part, rise = rise(&to), sigmas, "step over the motions");
            if rise(&to) < 0.0 {
                return Some(to);
            }
            replace_all(members, before, &from.session.cameras);
        }
        None
    }
}
