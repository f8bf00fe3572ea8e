//! Ranges of the fingers' hinges, and how hands are held.

use super::geometry::{Hinge, N_HINGES, hinges};

/// Range, rest and spread of a hinge, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HingeRange {
    /// Smallest angle.
    pub min: f64,
    /// Largest angle.
    pub max: f64,
    /// Of a relaxed hand.
    pub rest: f64,
    /// Standard deviation about the rest.
    pub spread: f64,
}

/// Min, max, rest, spread of a hinge, degrees.
///
/// Ranges of motion of the American Academy of Orthopaedic Surgeons (Joint Motion, 1965), active hyperextension included,
/// widened by 5 to 10 degrees. Rests are those of a relaxed hand; spreads a quarter of the range, so that a hand may be flat
/// or a fist.
fn degrees(hinge: &Hinge) -> [f64; 4] {
    match (hinge.finger == 4, hinge.place, hinge.is_flexion) {
        (false, 0, true) => [-35.0, 100.0, 25.0, 30.0],
        (false, 0, false) => [-25.0, 25.0, 0.0, 8.0],
        (false, 1, true) => [-10.0, 115.0, 35.0, 30.0],
        (false, ..) => [-15.0, 90.0, 20.0, 22.0],
        (true, 0, true) => [-25.0, 50.0, 8.0, 15.0],
        (true, 0, false) => [-35.0, 45.0, 0.0, 15.0],
        (true, 1, true) => [-15.0, 65.0, 12.0, 18.0],
        (true, 1, false) => [-12.0, 12.0, 0.0, 5.0],
        (true, ..) => [-25.0, 90.0, 20.0, 25.0],
    }
}

/// Of all hinges.
pub fn hinge_ranges() -> [HingeRange; N_HINGES] {
    hinges().map(|hinge| {
        let [min, max, rest, spread] = degrees(&hinge).map(f64::to_radians);
        HingeRange { min, max, rest, spread }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rests_lie_within_their_ranges() {
        for range in hinge_ranges() {
            assert!(range.min < range.rest && range.rest < range.max && range.spread < range.max - range.min);
        }
    }
}
