//! The gauge: seven degrees of freedom that no observation fixes, held exactly.
//!
//! Columns are dropped instead of constraints added: the anchor camera loses all six, its partner the one along the
//! baseline. The reduced system stays positive definite and needs no prior. A step moves the partner's centre off its sphere
//! about the anchor by second order only; it is moved back.

use super::variables::{CameraState, Layout, State, Variables};
use crate::geometry::Rigid;
use nalgebra::{DMatrix, DVector, Vector3};

/// The cameras that fix the gauge. Both are `None` where cameras are held, the partner where there is one camera only.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gauge {
    /// The view that keeps its pose.
    pub(super) anchor: Option<usize>,
    partner: Option<Partner>,
}

/// The view whose centre keeps its distance from that of the anchor.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Partner {
    view: usize,
    distance: f64,
}

/// The directions in which the border may move. [border, free]
pub(super) struct Basis(pub(super) DMatrix<f64>);

impl Basis {
    /// The border's Newton step within the basis; `None` where the system is not positive definite.
    pub(super) fn solve(&self, hessian: &DMatrix<f64>, gradient: &DVector<f64>) -> Option<DVector<f64>> {
        if self.0.ncols() == 0 {
            return Some(DVector::zeros(self.0.nrows()));
        }
        let mut free = self.project(hessian);
        hold_idle(&mut free);
        Some(&self.0 * free.cholesky()?.solve(&-self.0.tr_mul(gradient)))
    }

    /// A matrix over the border as one over the free directions.
    pub(super) fn project(&self, hessian: &DMatrix<f64>) -> DMatrix<f64> {
        self.0.tr_mul(&(hessian * &self.0))
    }
}

/// Unknowns that nothing depends on (a bone never seen whole) get a one on the diagonal and do not move.
pub(super) fn hold_idle(hessian: &mut DMatrix<f64>) {
    for k in 0..hessian.nrows() {
        if hessian[(k, k)] == 0.0 {
            hessian[(k, k)] = 1.0;
        }
    }
}

impl Gauge {
    /// The anchor is the view that shares most points with others; the partner the one that shares most with the anchor,
    /// weighted by their distance, so that their centres do not coincide.
    pub(super) fn choose(layout: &Layout, variables: &[Variables], cameras: &[Option<CameraState>]) -> Self {
        let shared = shared_points(variables, cameras.len());
        let moves = |&view: &usize| layout.camera_columns[view].is_some();
        // `max_by` keeps the last of equals; reversed, that is the first view.
        let anchor = (0..cameras.len()).rev().filter(moves).max_by_key(|&view| shared.row(view).sum() as usize);
        let center = |view: usize| cameras[view].as_ref().map(|c| c.camera_from_world.center());
        let partner = anchor.and_then(|anchor| {
            let candidate = |view: usize| {
                let distance = (center(view)? - center(anchor)?).norm();
                (view != anchor && distance > 0.0).then_some(Partner { view, distance })
            };
            let score = |p: &Partner| (1.0 + shared[(anchor, p.view)]) * p.distance;
            let partners = (0..cameras.len()).rev().filter(moves).filter_map(candidate);
            partners.max_by(|a, b| score(a).total_cmp(&score(b)))
        });
        Self { anchor, partner }
    }

    /// The free directions at `state`.
    pub(super) fn basis(&self, layout: &Layout, state: &State) -> Basis {
        let mut directions = Vec::with_capacity(layout.n_border);
        let unit = |k: usize| DVector::from_fn(layout.n_border, |row, _| f64::from(u8::from(row == k)));
        for (view, first) in layout.camera_columns.iter().enumerate() {
            let Some(first) = *first else { continue };
            let is_partner = self.partner.is_some_and(|p| p.view == view);
            if is_partner {
                for rho in self.across_baseline(state) {
                    let mut direction = DVector::zeros(layout.n_border);
                    direction.fixed_rows_mut::<3>(first).copy_from(&rho);
                    directions.push(direction);
                }
            }
            let pose = if self.anchor == Some(view) { 6..6 } else { if is_partner { 3..6 } else { 0..6 } };
            directions.extend(pose.chain(6..layout.per_camera).map(|k| unit(first + k)));
        }
        directions.extend((layout.first_length..layout.n_border).map(unit));
        Basis(if directions.is_empty() {
            DMatrix::zeros(layout.n_border, 0)
        } else {
            DMatrix::from_columns(&directions)
        })
    }

    /// Two directions of the partner's increment rho that keep its distance: as its centre moves by `-R^T rho`, those
    /// across the baseline in the partner's frame.
    fn across_baseline(&self, state: &State) -> [Vector3<f64>; 2] {
        let baseline = self
            .ends(&state.cameras)
            .map_or(Vector3::z(), |(anchor, partner)| partner.rotation * (partner.center() - anchor.center()));
        let first = baseline.cross(&Vector3::ith(baseline.iamin(), 1.0)).normalize();
        [first, first.cross(&baseline).normalize()]
    }

    /// Moves the partner back to its distance.
    pub(super) fn restore(&self, cameras: &mut [Option<CameraState>]) {
        let (Some((anchor, pose)), Some(partner)) = (self.ends(cameras), self.partner) else { return };
        let direction = (pose.center() - anchor.center()).normalize();
        let center = anchor.center() + direction * partner.distance;
        if let Some(camera) = &mut cameras[partner.view] {
            camera.camera_from_world.translation = -(pose.rotation * center);
        }
    }

    /// Poses of the anchor and its partner.
    fn ends(&self, cameras: &[Option<CameraState>]) -> Option<(Rigid, Rigid)> {
        let pose = |view: usize| cameras[view].as_ref().map(|c| c.camera_from_world);
        Some((pose(self.anchor?)?, pose(self.partner?.view)?))
    }
}

/// Number of points that each pair of views has in common; the diagonal is zero. [view, view]
fn shared_points(variables: &[Variables], n_views: usize) -> DMatrix<f64> {
    let mut shared = DMatrix::zeros(n_views, n_views);
    for variables in variables {
        let mut views = vec![Vec::new(); variables.keypoints.len()];
        variables.observations.iter().for_each(|s| views[s.slot].push(s.observation.view));
        for views in views {
            for &a in &views {
                views.iter().filter(|&&b| a != b).for_each(|&b| shared[(a, b)] += 1.0);
            }
        }
    }
    shared
}
