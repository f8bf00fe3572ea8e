//! Robust estimators of single geometric quantities from data with outliers.
//!
//! - [`essential`]: the relative pose of two views from point pairs
//! - [`pnp`]: a camera's pose from known points
//! - [`triangulation`]: a point from several views, and its covariance
//! - [`consensus`]: the sampling loop that `essential` and `pnp` share

pub mod consensus;
pub mod essential;
pub mod pnp;
pub mod triangulation;
