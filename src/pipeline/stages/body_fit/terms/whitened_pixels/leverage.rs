//! How much of the detector's errors the unknowns absorb, as the session's see it.

use super::scores::Movements;
use super::{Channel, PosedCamera, Positions, WhitenedPixels};
use rayon::prelude::*;

/// Sums over channels.
#[derive(Clone, Copy, Default)]
struct Leverage {
    errors: f64,
    absorbed: f64,
}

impl WhitenedPixels {
    /// Variance of the channels' scores from residuals over that from the errors, which are taken as independent innovations:
    ///
    /// `1 - sum_c |A_c^T W X_c|^2 / (S sum_c tr(A_c^T W A_c))`
    ///
    /// with a channel's innovations and their weights W: `A_c` how they change by the `directions` in which scores count, `X_c` by what
    /// the errors move all unknowns by, S draws of it. A residual is `e - x`, and the covariance of x is that of the errors that remain,
    /// `H^-1` (the leverage of clusters; Bell and McCaffrey 2002, Survey Methodology 28:169; here one number for a person).
    pub(crate) fn unabsorbed(
        &self,
        at: (&[PosedCamera], &Positions),
        directions: &Movements,
        draws: &Movements,
    ) -> f64 {
        let of_landmark = |landmark: usize| {
            let of_channel = |channel: &Channel| self.leverage(channel, landmark, at, directions, draws);
            self.channels[landmark].iter().map(of_channel).fold(Leverage::default(), Leverage::and)
        };
        let of_landmarks: Vec<Leverage> = (0..self.landmarks.len()).into_par_iter().map(of_landmark).collect();
        let Leverage { errors, absorbed } = of_landmarks.into_iter().fold(Leverage::default(), Leverage::and);
        if errors > 0.0 { 1.0 - absorbed / errors } else { 1.0 }
    }

    fn leverage(
        &self,
        channel: &Channel,
        landmark: usize,
        (cameras, positions): (&[PosedCamera], &Positions),
        directions: &Movements,
        draws: &Movements,
    ) -> Leverage {
        let linear = channel.linearised(landmark, cameras, positions);
        let moved = |movements: &Movements| self.moved_innovations(channel, (landmark, &linear), movements);
        let (by_directions, by_draws) = (moved(directions), moved(draws));
        let n_draws = draws.cameras.ncols().max(1) as f64;
        let of_axes = by_directions.iter().zip(&by_draws).map(|(by_directions, by_draws)| Leverage {
            errors: by_directions.norm_squared(),
            absorbed: (by_directions * by_draws.transpose()).norm_squared() / n_draws,
        });
        of_axes.fold(Leverage::default(), Leverage::and)
    }
}

impl Leverage {
    fn and(self, other: Self) -> Self {
        Self { errors: self.errors + other.errors, absorbed: self.absorbed + other.absorbed }
    }
}
