//! How likely a session's errors are under the sizes and shapes that its pixels are given.

use super::{Channel, PosedCamera, Positions, Seen, WhitenedPixels};

/// Innovations of many channels with what their whitening has stretched.
#[derive(Debug, Default)]
pub(crate) struct Innovations {
    /// Squared lengths, in squared standard deviations.
    squared: Vec<f64>,
    /// Sum of the logarithms of the determinants of the maps from pixels to innovations.
    log_determinants: f64,
}

/// Degrees of freedom of the distribution of errors: a detector's have heavy tails (4 after Lange, Little and Taylor, JASA 1989).
const FREEDOM: f64 = 4.0;

/// Steps to the likeliest scale; each takes half of what is left or more.
const SCALE_STEPS: usize = 20;

impl WhitenedPixels {
    /// Adds the innovations of all channels.
    pub(crate) fn collect(&self, cameras: &[PosedCamera], positions: &Positions, into: &mut Innovations) {
        let of_channels = self.for_channels(cameras, positions, |channel: &Channel, residuals| {
            let innovation = |seen: &Seen| {
                let own = seen.parts.own();
                let squared = seen.parts.combined(|i| residuals[i])?.norm_squared();
                (own > 0.0).then(|| (squared, 2.0 * (own / seen.sigma_px).ln()))
            };
            channel.seen.iter().filter_map(innovation).collect::<Vec<_>>()
        });
        for (squared, log_determinant) in of_channels.into_iter().flat_map(|(_, innovations)| innovations) {
            into.squared.push(squared);
            into.log_determinants += log_determinant;
        }
    }
}

impl Innovations {
    /// Logarithm of the likelihood under Student's distribution in the plane, at the likeliest common scale $s$, up to a constant:
    /// $\sum [\log\lvert W \rvert - \log s^2 - (\nu + 2) / 2 \log(1 + e^2 / (\nu s^2))]$.
    pub(crate) fn log_likelihood(&self) -> f64 {
        let n = self.squared.len() as f64;
        if n == 0.0 {
            return 0.0;
        }
        let mut variance = 1.0;
        for _ in 0..SCALE_STEPS {
            let weighted = |e2: &f64| (FREEDOM + 2.0) / (FREEDOM + e2 / variance) * e2;
            variance = (self.squared.iter().map(weighted).sum::<f64>() / (2.0 * n)).max(f64::MIN_POSITIVE);
        }
        let tails: f64 = self.squared.iter().map(|e2| (e2 / (FREEDOM * variance)).ln_1p()).sum();
        self.log_determinants - n * variance.ln() - 0.5 * (FREEDOM + 2.0) * tails
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A change of units changes nothing: errors twice as long with maps that stretch twice as much.
    #[test]
    fn the_likelihood_does_not_depend_on_the_unit() {
        let squared: Vec<f64> = (1..200).map(|i| 0.02 * f64::from(i)).collect();
        let doubled = squared.iter().map(|e2| 4.0 * e2).collect();
        let log_determinants = squared.len() as f64 * 4f64.ln();
        let one = Innovations { squared, log_determinants: 0.0 }.log_likelihood();
        let other = Innovations { squared: doubled, log_determinants }.log_likelihood();
        assert!((one - other).abs() < 1e-6 * one.abs(), "{one} {other}");
    }
}
