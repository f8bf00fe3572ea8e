//! The figure: all tubes of the left half and the midline, their sections as functions of measures.
//!
//! Girths, breadths and lengths are those of ANSUR II: half extents are shares of a measured girth, chosen so that the
//! section's perimeter at beta 0 is the measured one at about the measured ratio of breadth to depth. Sections that the
//! survey does not measure (knee, elbow, face, thickness of hand and foot) are estimated to some 10 mm. The thighs are 22 mm
//! apart at every shape, since a surface that touches itself has no inside.

use super::places::{Place, arm, fixed, head, joint_place, leg, length, spine};
use super::tubes::{Axis, Station, Tube};
use crate::body::anthropometry::{Length, Measure, Measure::*, Population, VariedLength};
use crate::body::model::ShapeDirections;
use nalgebra::Vector3;

/// All tubes at x >= 0; those of the midline are complete.
pub(super) fn figure(population: &Population) -> Vec<Tube> {
    let tube = |axis, squareness, caps, sections: &[Section]| Tube {
        axis,
        squareness,
        caps,
        stations: sections.iter().map(|s| s.in_population(population)).collect(),
    };
    vec![
        tube(Axis::Y, 0.70, [0.042, 0.020], &trunk()),
        tube(Axis::Y, 0.0, [0.02, 0.02], &neck()),
        tube(Axis::Y, 0.30, [0.022, 0.062], &skull()),
        tube(Axis::Y, 0.0, [0.012, 0.014], &nose()),
        tube(Axis::X, 0.0, [0.03, 0.02], &arm_sections()),
        tube(Axis::X, 0.3, [0.02, 0.022], &hand()),
        tube(Axis::X, 0.0, [0.012, 0.012], &thumb()),
        tube(Axis::Y, 0.0, [0.03, 0.04], &leg_sections()),
        tube(Axis::Z, 0.75, [0.030, 0.026], &foot()),
    ]
}

/// A cross-section: centre and half extents as functions of measures.
struct Section {
    centre: Place,
    half: [Length; 2],
}

impl Section {
    fn in_population(&self, population: &Population) -> Station {
        let [x, y, z]: [VariedLength; 3] = std::array::from_fn(|i| self.centre[i].in_population(population));
        let [first, second] = [&self.half[0], &self.half[1]].map(|half| half.in_population(population));
        let rows = [x, y, z].map(|coordinate| coordinate.per_beta.transpose());
        Station {
            centre: Vector3::new(x.mean, y.mean, z.mean),
            centre_directions: ShapeDirections::from_rows(&rows),
            half: [first.mean, second.mean],
            half_directions: [first.per_beta, second.per_beta],
        }
    }
}

fn share(factor: f64, measure: Measure) -> Length {
    length(0.0, &[(factor, measure)])
}

fn section(centre: Place, first: Length, second: Length) -> Section {
    Section { centre, half: [first, second] }
}

/// A section whose half extents are shares of one measure.
fn of_girth(centre: Place, measure: Measure, first: f64, second: f64) -> Section {
    section(centre, share(first, measure), share(second, measure))
}

/// A point on the midline, `up` metres above a measured height.
fn midline(measure: Measure, up: f64, z: f64) -> Place {
    [fixed(0.0), length(up, &[(1.0, measure)]), fixed(z)]
}

/// Heights depend on hip and neck, as the spine's joints do, so that mesh and joints agree at every shape.
fn trunk() -> Vec<Section> {
    let at = |share: f64, z: f64| spine(share, z);
    let hips = length(0.0, &[(0.104, ButtockGirth), (0.250, BicristalBreadth)]);
    vec![
        of_girth(midline(CrotchHeight, 0.022, -0.012), ButtockGirth, 0.135, 0.100),
        of_girth(midline(CrotchHeight, 0.044, -0.014), ButtockGirth, 0.167, 0.123),
        section(midline(TrochanterHeight, 0.030, -0.012), hips, share(0.124, ButtockGirth)),
        of_girth(at(0.041, -0.006), WaistGirth, 0.180, 0.137),
        of_girth(at(0.181, 0.0), WaistGirth, 0.173, 0.129),
        of_girth(at(0.388, 0.004), ChestGirth, 0.162, 0.135),
        of_girth(at(0.568, 0.004), ChestGirth, 0.166, 0.138),
        of_girth(at(0.719, -0.006), ChestGirth, 0.160, 0.118),
        section(midline(AcromialHeight, -0.020, -0.020), share(0.345, BiacromialBreadth), share(0.080, ChestGirth)),
        section(at(0.903, -0.022), share(0.19, NeckGirth), share(0.16, NeckGirth)),
    ]
}

fn neck() -> Vec<Section> {
    vec![
        of_girth(spine(0.90, -0.020), NeckGirth, 0.172, 0.172),
        of_girth(spine(1.06, -0.010), NeckGirth, 0.157, 0.160),
        of_girth(head(0.0, &[], -0.150, 0.005), NeckGirth, 0.150, 0.157),
    ]
}

fn skull() -> Vec<Section> {
    let at = |below: f64, z: f64| head(0.0, &[], -below, z);
    let by_ears = |share: f64, up: f64, z: f64| head(0.0, &[(-share, TragionToTop)], up, z);
    let of = |centre: Place, breadth: f64, depth: f64| {
        section(centre, share(breadth, HeadBreadth), share(depth, HeadLength))
    };
    vec![
        of(at(0.198, 0.040), 0.28, 0.27),
        of(by_ears(1.0, -0.041, 0.022), 0.41, 0.385),
        of(by_ears(1.0, -0.001, 0.010), 0.475, 0.485),
        of(by_ears(0.6, -0.023, 0.007), 0.505, 0.52),
        of(at(0.062, 0.005), 0.50, 0.505),
    ]
}

fn nose() -> Vec<Section> {
    let at = |below: f64, z: f64| head(0.0, &[], -below, z);
    vec![section(at(0.149, 0.104), fixed(0.014), fixed(0.016)), section(at(0.128, 0.098), fixed(0.010), fixed(0.012))]
}

fn arm_sections() -> Vec<Section> {
    vec![
        of_girth(arm(0.0, 0.0, 0.0, -0.070), BicepsGirth, 0.160, 0.170),
        of_girth(arm(0.0, 0.0, 0.0, 0.0), BicepsGirth, 0.172, 0.178),
        of_girth(arm(0.18, 0.0, 0.0, 0.0), BicepsGirth, 0.157, 0.160),
        of_girth(arm(0.50, 0.0, 0.0, 0.0), BicepsGirth, 0.146, 0.146),
        of_girth(arm(0.853, 0.0, 0.0, 0.0), ForearmGirth, 0.142, 0.148),
        of_girth(arm(0.896, 0.20, 0.0, 0.0), ForearmGirth, 0.145, 0.152),
        of_girth(arm(0.896, 0.60, 0.0, 0.0), ForearmGirth, 0.112, 0.124),
        of_girth(arm(0.896, 0.93, 0.0, 0.0), WristGirth, 0.127, 0.160),
        of_girth(arm(0.896, 1.0, 0.05, 0.0), WristGirth, 0.114, 0.165),
    ]
}

fn hand() -> Vec<Section> {
    let of = |centre: Place, thick: f64, wide: f64| section(centre, fixed(thick), share(wide, HandBreadth));
    vec![
        of(arm(0.896, 1.0, 0.02, 0.0), 0.019, 0.36),
        of(arm(0.896, 1.0, 0.22, 0.0), 0.019, 0.48),
        of(arm(0.896, 1.0, 0.45, 0.0), 0.016, 0.51),
        of(arm(0.896, 1.0, 0.70, 0.0), 0.0145, 0.48),
        of(arm(0.896, 1.0, 0.85, 0.0), 0.0125, 0.36),
    ]
}

fn thumb() -> Vec<Section> {
    let at = |hand: f64, z: f64| {
        let [x, y, _] = arm(0.896, 1.0, hand, 0.0);
        [x, y, length(z, &[(0.3, HandBreadth)])]
    };
    vec![section(at(0.16, 0.004), fixed(0.014), fixed(0.016)), section(at(0.48, 0.034), fixed(0.011), fixed(0.012))]
}

/// A section of the thigh; its inner side is 11 mm from the midline at every shape, since the centre moves out as the
/// half breadth grows.
fn thigh(y: Length, z: f64, breadth: f64, depth: f64) -> Section {
    let half = share(breadth, ThighGirth);
    section([Length { constant: 0.011, ..half.clone() }, y, fixed(z)], half, share(depth, ThighGirth))
}

fn leg_sections() -> Vec<Section> {
    let at = |y: Length, z: f64| leg(y, 0.0, fixed(z));
    let shank = |share_up: f64| length(0.0, &[(share_up, KneeHeight), (1.0 - share_up, MalleolusHeight)]);
    vec![
        of_girth(at(length(-0.020, &[(1.0, MalleolusHeight)]), -0.004), AnkleGirth, 0.160, 0.185),
        of_girth(at(length(0.035, &[(1.0, MalleolusHeight)]), -0.006), AnkleGirth, 0.151, 0.167),
        of_girth(at(shank(0.35), -0.012), CalfGirth, 0.122, 0.133),
        of_girth(at(shank(0.66), -0.016), CalfGirth, 0.153, 0.166),
        of_girth(at(length(-0.010, &[(1.0, KneeHeight)]), -0.002), LowerThighGirth, 0.140, 0.150),
        of_girth(at(length(0.055, &[(1.0, KneeHeight)]), 0.0), LowerThighGirth, 0.154, 0.164),
        thigh(length(0.0, &[(0.5, KneeHeight), (0.5, CrotchHeight)]), -0.002, 0.122, 0.142),
        thigh(length(-0.040, &[(1.0, CrotchHeight)]), -0.008, 0.136, 0.181),
        thigh(length(-0.020, &[(1.0, TrochanterHeight)]), -0.013, 0.131, 0.186),
    ]
}

/// The foot is flat on the floor: the centre's height is the section's half height.
fn foot() -> Vec<Section> {
    let of = |x: f64, z: Length, half_width: Length, half_height: f64| {
        section(leg(fixed(half_height), x, z), half_width, fixed(half_height))
    };
    let [_, _, ball] = joint_place("foot");
    let behind = |offset: f64| length(offset, &[(-0.25, FootLength)]);
    vec![
        of(0.0, behind(0.030), share(0.46, HeelBreadth), 0.032),
        of(0.001, behind(0.070), share(0.49, HeelBreadth), 0.040),
        of(0.004, length(0.0, &[(0.24, FootLength)]), share(0.42, FootBreadth), 0.033),
        of(0.012, ball, share(0.50, FootBreadth), 0.0215),
        of(0.010, length(-0.026, &[(0.75, FootLength)]), share(0.42, FootBreadth), 0.0155),
    ]
}
