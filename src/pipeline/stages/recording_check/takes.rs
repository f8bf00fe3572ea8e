//! Cameras that show other people than the rest: no person is seen from both groups at one time.

use crate::pipeline::calibration::TrackedPeople;
use nalgebra::Vector3;

/// Two cameras see the same people where this share of the people of one, standing in the image of the other, are seen there too:
/// right recordings have 0.6 and more, chance alignments of people of two takes 0.05 to 0.1.
const SHARED: f64 = 0.25;
/// Fewer people in the images of both show nothing.
const MIN_PEOPLE: usize = 20;

/// Groups of placed cameras that are not connected by common people, largest first; one group in a right recording.
pub fn groups(people: &TrackedPeople) -> Vec<Vec<usize>> {
    let cameras = people.cameras;
    let placed: Vec<usize> = (0..cameras.len()).filter(|&v| cameras[v].is_some()).collect();
    let mut groups: Vec<Vec<usize>> = placed.iter().map(|&v| vec![v]).collect();
    for (i, &a) in placed.iter().enumerate() {
        for &b in &placed[..i] {
            if !are_connected(people, a, b) {
                continue;
            }
            let position = |v: usize, groups: &[Vec<usize>]| groups.iter().position(|group| group.contains(&v));
            let (Some(of_a), Some(of_b)) = (position(a, &groups), position(b, &groups)) else { continue };
            if of_a != of_b {
                let joined = groups.swap_remove(of_a.max(of_b));
                groups[of_a.min(of_b)].extend(joined);
            }
        }
    }
    groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
    groups
}

fn are_connected(people: &TrackedPeople, a: usize, b: usize) -> bool {
    let (mut n_shared, mut n_expected) = (0, 0);
    for (track, person) in people.tracks.iter().zip(people.points) {
        for (assigned, points) in track.detections.iter().zip(&person.points) {
            let (in_a, in_b) = (assigned[a].is_some(), assigned[b].is_some());
            let is_expected = (in_a && stands_in(people, b, points)) || (in_b && stands_in(people, a, points));
            n_shared += usize::from(in_a && in_b);
            n_expected += usize::from(is_expected || (in_a && in_b));
        }
    }
    tracing::debug!(a, b, n_shared, n_expected, "people in the images of two cameras");
    n_expected >= MIN_PEOPLE && n_shared as f64 > SHARED * n_expected as f64
}

/// Whether a person's middle lies in the image of a camera.
fn stands_in(people: &TrackedPeople, view: usize, points: &[Option<Vector3<f64>>]) -> bool {
    let known = || points.iter().flatten();
    let Some(camera) = people.cameras[view].as_ref().filter(|_| known().count() > 0) else { return false };
    let middle = known().sum::<Vector3<f64>>() / known().count() as f64;
    let lens = &people.session.views[view].intrinsics;
    let is_inside = |c: f64, size: u32| (0.0..f64::from(size)).contains(&c);
    lens.pixel_from_camera(&camera.transform(&middle))
        .is_some_and(|pixel| is_inside(pixel.x, lens.width) && is_inside(pixel.y, lens.height))
}
