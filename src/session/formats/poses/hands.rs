//! Hands that a source writes apart from the body: appended to it where they were detected, left hand first.

use super::points::missing;
use crate::body::hand::{N_HAND_POINTS, Side};
use crate::session::formats::joints::N_HANDS_POINTS;
use crate::session::recording::{Detection, Keypoint};
use crate::session::upload::error::{Fault, UploadError};
use crate::session::upload::json::Reading;

/// The points of a body, followed by those of left and right hand where any of them was detected.
///
/// # Errors
/// A hand of another number of points.
pub(super) fn with_hands(mut body: Vec<Keypoint>, hands: [Vec<Keypoint>; 2]) -> Result<Vec<Keypoint>, UploadError> {
    for (side, hand) in Side::BOTH.into_iter().zip(&hands) {
        Fault::KeypointCount.when(!hand.is_empty() && hand.len() != N_HAND_POINTS, || {
            format!("the {} hand has {} keypoints, expected {N_HAND_POINTS} or none", side.name(), hand.len())
        })?;
    }
    if !body.is_empty() && hands.iter().flatten().any(|keypoint| keypoint.is_present()) {
        for mut hand in hands {
            hand.resize(N_HAND_POINTS, missing());
            body.extend(hand);
        }
    }
    Ok(body)
}

/// Adds missing hands to people without hands where others of the same source have them.
///
/// # Errors
/// When the session then has too many keypoints.
pub(crate) fn level_hands<'d>(
    people: impl Iterator<Item = &'d mut Detection>,
    reading: &mut Reading<'_>,
) -> Result<(), UploadError> {
    let people: Vec<&mut Detection> = people.filter(|person| !person.keypoints.is_empty()).collect();
    let sizes = || people.iter().map(|person| person.keypoints.len());
    let (least, most) = (sizes().min().unwrap_or(0), sizes().max().unwrap_or(0));
    if most == least + N_HANDS_POINTS {
        for person in people.into_iter().filter(|person| person.keypoints.len() == least) {
            reading.spend(N_HANDS_POINTS)?;
            person.keypoints.resize(most, missing());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    fn seen(n: usize) -> Vec<Keypoint> {
        (0..n).map(|k| Keypoint::new(Vector2::new(10.0 + k as f64, 20.0), 0.5)).collect()
    }

    #[test]
    fn one_detected_hand_adds_points_of_both() {
        let keypoints = with_hands(seen(25), [Vec::new(), seen(21)]).unwrap();
        assert_eq!(keypoints.len(), 67);
        assert!(keypoints[25..46].iter().all(|keypoint| !keypoint.is_present()));
        assert_eq!(keypoints[46..], seen(21));
    }

    #[test]
    fn undetected_hands_are_not_added() {
        let zeros = vec![missing(); N_HAND_POINTS];
        assert_eq!(with_hands(seen(25), [zeros.clone(), zeros]).unwrap().len(), 25);
        assert_eq!(with_hands(Vec::new(), [seen(21), seen(21)]).unwrap().len(), 0);
        let error = with_hands(seen(25), [seen(20), Vec::new()]).unwrap_err();
        assert!(error.detail.contains("left hand has 20 keypoints, expected 21"), "{error}");
    }

    #[test]
    fn people_of_a_source_have_equally_many_points() {
        let person = |n: usize| Detection { track_id: None, keypoints: seen(n) };
        let sizes = |sizes: &[usize]| {
            let mut people: Vec<Detection> = sizes.iter().map(|n| person(*n)).collect();
            let (limits, mut warnings) = Default::default();
            level_hands(people.iter_mut(), &mut Reading::new(&limits, &mut warnings)).unwrap();
            people.iter().map(|person| person.keypoints.len()).collect::<Vec<_>>()
        };
        assert_eq!(sizes(&[25, 67, 0, 25]), [67, 67, 0, 67]);
        assert_eq!(sizes(&[25, 17]), [25, 17]);
        assert_eq!(sizes(&[25, 25]), [25, 25]);
    }
}
