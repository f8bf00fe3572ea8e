//! Tubes: stacks of rounded cross-sections, the parts of the default body.
//!
//! Uses sums, products and square roots only, which IEEE 754 defines to the last bit: every machine generates the same body.

use crate::body::anthropometry::BetaRow;
use crate::body::model::ShapeDirections;
use nalgebra::Vector3;

/// The direction of a tube; its cross-sections are perpendicular to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axis {
    /// To the left: sections span y and z.
    X,
    /// Up: sections span x and z.
    Y,
    /// To the front: sections span x and y.
    Z,
}

impl Axis {
    /// Index of the axis, then of the two that span the sections.
    fn indices(self) -> [usize; 3] {
        match self {
            Self::X => [0, 1, 2],
            Self::Y => [1, 0, 2],
            Self::Z => [2, 0, 1],
        }
    }
}

/// A cross-section in a population: its centre and its two half extents, with their change per beta.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Station {
    /// Centre at beta 0, m.
    pub centre: Vector3<f64>,
    /// Change of the centre per beta, m.
    pub centre_directions: ShapeDirections,
    /// Half extents along the section's two axes at beta 0, m.
    pub half: [f64; 2],
    /// Change of the half extents per beta, m.
    pub half_directions: [BetaRow; 2],
}

/// A stack of at least two stations along an axis, rounded off at both ends.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tube {
    /// Direction of the tube.
    pub axis: Axis,
    /// Cross-sections in ascending order along the axis.
    pub stations: Vec<Station>,
    /// Length of the round ends beyond the first and the last station, m.
    pub caps: [f64; 2],
    /// 0: elliptic sections, 1: rectangular ones, between: squircles.
    pub squareness: f64,
}

/// Weights of the stations in a section: cubic in the two neighbours on either side.
struct SectionBlend {
    first: usize,
    weights: Vec<f64>,
}

/// A point relative to a tube, in coordinates that do not depend on the tube's shape.
struct TubePoint {
    blend: SectionBlend,
    section: Section,
    /// Distance beyond the end station, m; 0 between the ends.
    overshoot: f64,
    cap: f64,
    /// Offset from the section's centre, in half extents.
    relative: [f64; 2],
}

struct Section {
    centre: Vector3<f64>,
    half: [f64; 2],
}

impl Tube {
    /// Signed distance to the surface to first order, m: negative inside.
    ///
    /// `(q - 1) / |grad q|` with the squircle norm of Fernandez Guasti, `q^2 = (h + sqrt(h^2 - 4 s^2 X Y)) / 2`,
    /// `h = X + Y`, where X and Y are the squared offsets in half extents (the cap's overshoot counts with Y and X).
    pub(super) fn distance(&self, point: &Vector3<f64>) -> f64 {
        let local = self.locate(point);
        let [u, w] = local.relative;
        let z = local.overshoot / local.cap;
        let (x2, y2, z2) = (u * u, w * w, z * z);
        let s2 = 4.0 * self.squareness * self.squareness;
        let (h, product) = (x2 + y2 + z2, x2 * y2 + x2 * z2 + y2 * z2);
        let root = (h * h - s2 * product).max(0.0).sqrt();
        let q2 = 0.5 * (h + root);
        let q = q2.sqrt();
        if q < 1e-3 {
            return -local.section.half[0].min(local.section.half[1]);
        }
        // d(q^2)/d(X) = (1 + (h - s2 (h - X) / 2) / root) / 2 and so on.
        let by = |own: f64| if root > 1e-12 { 0.5 * (1.0 + (h - 0.5 * s2 * (h - own)) / root) } else { 0.5 };
        let gradient = [by(x2) * u / local.section.half[0], by(y2) * w / local.section.half[1], by(z2) * z / local.cap];
        let norm = (gradient[0] * gradient[0] + gradient[1] * gradient[1] + gradient[2] * gradient[2]).sqrt() / q;
        (q - 1.0) / norm.max(1e-9)
    }

    /// Change per beta of a point fixed to the tube, m.
    pub(super) fn directions_at(&self, point: &Vector3<f64>) -> ShapeDirections {
        let local = self.locate(point);
        let [_, first, second] = self.axis.indices();
        let mut directions = ShapeDirections::zeros();
        for (station, weight) in self.stations[local.blend.first..].iter().zip(&local.blend.weights) {
            directions += station.centre_directions * *weight;
            for (axis, k) in [(first, 0), (second, 1)] {
                let change = station.half_directions[k].transpose() * (weight * local.relative[k]);
                let mut row = directions.row_mut(axis);
                row += change;
            }
        }
        directions
    }

    fn locate(&self, point: &Vector3<f64>) -> TubePoint {
        let [along, first, second] = self.axis.indices();
        let (start, end) = (self.stations[0].centre[along], self.stations[self.stations.len() - 1].centre[along]);
        let at = point[along].clamp(start, end);
        let blend = self.blend(at);
        let section = self.section(&blend);
        let relative = [
            (point[first] - section.centre[first]) / section.half[0],
            (point[second] - section.centre[second]) / section.half[1],
        ];
        let overshoot = point[along] - at;
        let cap = self.caps[usize::from(overshoot > 0.0)];
        TubePoint { blend, section, overshoot, cap, relative }
    }

    fn section(&self, blend: &SectionBlend) -> Section {
        let mut section = Section { centre: Vector3::zeros(), half: [0.0; 2] };
        for (station, weight) in self.stations[blend.first..].iter().zip(&blend.weights) {
            section.centre += station.centre * *weight;
            section.half[0] += station.half[0] * weight;
            section.half[1] += station.half[1] * weight;
        }
        section
    }

    /// Cubic Hermite weights with the slopes of the neighbouring chords: linear in the stations' values, hence the same for
    /// all betas.
    fn blend(&self, at: f64) -> SectionBlend {
        let [along, ..] = self.axis.indices();
        let n = self.stations.len();
        let place = |i: usize| self.stations[i].centre[along];
        let i = (1..n - 1).rev().find(|&i| place(i) <= at).unwrap_or(0);
        let width = place(i + 1) - place(i);
        let t = (at - place(i)) / width;
        let (t2, t3) = (t * t, t * t * t);
        let first = i.saturating_sub(1);
        let mut weights = vec![0.0; (i + 2).min(n - 1) - first + 1];
        weights[i - first] += 2.0 * t3 - 3.0 * t2 + 1.0;
        weights[i + 1 - first] += 3.0 * t2 - 2.0 * t3;
        for (station, share) in [(i, t3 - 2.0 * t2 + t), (i + 1, t3 - t2)] {
            let (before, after) = (station.saturating_sub(1), (station + 1).min(n - 1));
            let slope = share * width / (place(after) - place(before));
            weights[after - first] += slope;
            weights[before - first] -= slope;
        }
        SectionBlend { first, weights }
    }
}

/// The union of two tubes is rounded where their distances differ by less than this, m.
const ROUNDING: f64 = 0.03;

/// Signed distance to the rounded union of the tubes and their mirror images, m.
///
/// Polynomial smooth minimum, `min(a, b) - h^2 k / 4`, `h = max(k - |a - b|, 0) / k`.
pub(super) fn body_distance(tubes: &[Tube], point: &Vector3<f64>) -> f64 {
    let point = Vector3::new(point.x.abs(), point.y, point.z);
    let smooth_min = |a: f64, b: f64| {
        let h = (ROUNDING - (a - b).abs()).max(0.0) / ROUNDING;
        a.min(b) - h * h * ROUNDING / 4.0
    };
    tubes.iter().map(|tube| tube.distance(&point)).fold(1.0, smooth_min)
}

/// Outward gradient of [`body_distance`] by central differences.
pub(super) fn body_gradient(tubes: &[Tube], point: &Vector3<f64>) -> Vector3<f64> {
    const STEP: f64 = 1e-4;
    Vector3::from_fn(|axis, _| {
        let step = Vector3::ith(axis, STEP);
        (body_distance(tubes, &(point + step)) - body_distance(tubes, &(point - step))) / (2.0 * STEP)
    })
}

/// Two tubes both move a point if their distances to it differ by less than this, m.
const SHARING: f64 = 0.04;

/// Change of a surface point (x >= 0) per beta, the weighted mean over the tubes nearest to it, m.
pub(super) fn surface_directions(tubes: &[Tube], point: &Vector3<f64>) -> ShapeDirections {
    let distances: Vec<f64> = tubes.iter().map(|tube| tube.distance(point)).collect();
    let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
    let mut total = 0.0;
    let mut sum = ShapeDirections::zeros();
    for (tube, distance) in tubes.iter().zip(&distances) {
        let nearness = 1.0 - ((distance - nearest) / SHARING).min(1.0);
        if nearness > 0.0 {
            let weight = nearness * nearness * nearness;
            sum += tube.directions_at(point) * weight;
            total += weight;
        }
    }
    sum / total
}
