//! How one geometric thing is found robustly.
//!
//! Each module holds one question: a relative pose from point pairs ([`essential`]), a camera's pose from known points
//! ([`pnp`]), a point from several views ([`triangulation`]). They share one sampling loop ([`consensus`]) and one
//! descent ([`descent`]).

pub mod consensus;
pub mod descent;
pub mod essential;
pub mod pnp;
pub mod triangulation;

/// `rho(e) = s^2 e^2 / (e^2 + s^2)`, Geman and McClure's bounded loss: `e^2` near zero, at most `s^2`.
fn geman_mcclure(squared_error: f64, squared_scale: f64) -> f64 {
    squared_scale * squared_error / (squared_error + squared_scale)
}

/// The weight `(s^2 / (s^2 + e^2))^2` of an error in re-weighted least squares under [`geman_mcclure`].
fn geman_mcclure_weight(squared_error: f64, squared_scale: f64) -> f64 {
    let share = squared_scale / (squared_scale + squared_error);
    share * share
}
