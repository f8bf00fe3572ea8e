//! Stature and mass of a shaped body, how betas change them, and how sure they are.

use super::anthropometry::N_BETAS;
use super::shape::Betas;
use super::surface::Surface;
use nalgebra::SMatrix;
use serde::{Deserialize, Serialize};

/// Density of a person with air in the lungs, kg/m^3. Published values are 985 to 1,010: 1.5 % of the mass is open.
const DENSITY: f64 = 1000.0;

/// Share of the mass that the density leaves open.
const DENSITY_SIGMA: f64 = 0.015;

/// Covariance of betas.
pub type BetaCovariance = SMatrix<f64, N_BETAS, N_BETAS>;

/// Measures of one person's body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyMeasures {
    /// Height from soles to crown, m.
    pub stature_m: f64,
    /// Volume enclosed by the skin at rest times a density of 1 kg/l, kg.
    pub mass_kg: f64,
    /// `None` where the session does not show them.
    pub sigmas: Option<MeasureSigmas>,
}

/// Standard deviations of [`BodyMeasures`] and betas.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasureSigmas {
    /// Of the stature, m.
    pub stature_m: f64,
    /// Of the mass, kg.
    pub mass_kg: f64,
    /// Of the betas.
    pub betas: [f64; N_BETAS],
}

impl BodyMeasures {
    /// Measures of a body; `covariance` of its betas at a known scale of the scene, `sigma_log_scale` the standard deviation of the
    /// scale's logarithm.
    ///
    /// An error s of the scale lengthens the body by the factor 1 + s, which betas follow along the gradient g of the stature h:
    /// `C + sigma^2 b b^T`, `b = h g / |g|^2`. First order: `sigma_h^2 = g^T C g`, the mass likewise, with what the density leaves open.
    pub fn new(surface: &Surface, betas: &Betas, covariance: Option<&BetaCovariance>, sigma_log_scale: f64) -> Self {
        let (stature, volume) = (surface.stature(betas), surface.volume(&surface.shaped(betas)));
        let [of_stature, of_volume] = gradients(surface, betas);
        let mass = DENSITY * volume;
        let sigmas = covariance.map(|covariance| {
            let by_scale = of_stature * (stature / of_stature.norm_squared().max(f64::MIN_POSITIVE));
            let covariance = covariance + by_scale * by_scale.transpose() * sigma_log_scale.powi(2);
            let sigma = |gradient: &Betas| gradient.dot(&(covariance * gradient)).max(0.0).sqrt();
            MeasureSigmas {
                stature_m: sigma(&of_stature),
                mass_kg: (DENSITY * sigma(&of_volume)).hypot(DENSITY_SIGMA * mass),
                betas: covariance.diagonal().map(|variance| variance.max(0.0).sqrt()).into(),
            }
        });
        Self { stature_m: stature, mass_kg: mass, sigmas }
    }
}

/// The direction of the betas, unit length, along which the volume of the mean body grows fastest while its stature stays: girths.
/// Zero for a body whose betas change nothing else than its size.
pub(super) fn girth_direction(surface: &Surface) -> Betas {
    let [of_stature, of_volume] = gradients(surface, &Betas::zeros());
    let along = of_stature.try_normalize(1e-9).unwrap_or_else(Betas::zeros);
    (of_volume - along * along.dot(&of_volume)).try_normalize(1e-9).unwrap_or_else(Betas::zeros)
}

/// Derivatives of stature (m) and volume (m^3) by the betas: half of the difference between +1 and -1, since the stature is linear
/// except where the highest vertex changes.
fn gradients(surface: &Surface, betas: &Betas) -> [Betas; 2] {
    let difference = |measure: &dyn Fn(&Betas) -> f64| {
        Betas::from_fn(|k, _| 0.5 * (measure(&(betas + Betas::ith(k, 1.0))) - measure(&(betas - Betas::ith(k, 1.0)))))
    };
    [difference(&|betas| surface.stature(betas)), difference(&|betas| surface.volume(&surface.shaped(betas)))]
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::*;

    /// Beta 1 of the default body is weight at a given stature (ANSUR II).
    #[test]
    fn girths_of_the_default_body_are_its_second_beta() {
        let direction = girth_direction(&default_body().surface);
        assert!(direction[1] > 0.98 && direction[0].abs() < 0.02, "{direction}");
    }

    /// Adults whose betas are unknown: the survey's standard deviations, 92 mm and 15.5 kg (the mesh has 10 % more).
    #[test]
    fn unknown_betas_are_as_uncertain_as_the_population() {
        let surface = &default_body().surface;
        let measures = |covariance: &BetaCovariance, scale: f64| {
            BodyMeasures::new(surface, &Betas::zeros(), Some(covariance), scale)
        };
        let adults = measures(&BetaCovariance::identity(), 0.0);
        let sigmas = adults.sigmas.unwrap();
        assert!((adults.stature_m - 1.692).abs() < 5e-3 && (adults.mass_kg - 76.6).abs() < 4.0, "{}", adults.mass_kg);
        assert!((sigmas.stature_m - 0.092).abs() < 2e-3 && (13.0..19.0).contains(&sigmas.mass_kg), "{sigmas:?}");
        let of_scale = measures(&BetaCovariance::zeros(), 0.03).sigmas.unwrap();
        assert!((of_scale.stature_m / adults.stature_m - 0.03).abs() < 1e-3, "{of_scale:?}");
    }
}
