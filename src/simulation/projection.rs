//! The true keypoints of a person in the image of a camera.

use super::occlusion::is_hidden;
use super::rig::RigCamera;
use super::scene::SimulatedScene;
use crate::body::skeleton::{KeypointConvention, N_JOINTS};
use nalgebra::{Vector2, Vector3};

/// A point in the image before noise is added.
#[derive(Debug, Clone, Copy)]
pub(super) struct Projected {
    pub(super) pixel: Vector2<f64>,
    pub(super) in_view: bool,
    /// Whether a body blocks the line of sight.
    pub(super) hidden: bool,
    /// Whether the point is on a side of the head that the camera does not see.
    pub(super) turned_away: bool,
}

/// Smallest apparent size for the noise, px.
const MIN_SIZE_PX: f64 = 20.0;
/// Points nearer to the camera plane than this are not seen, m.
const MIN_DEPTH: f64 = 0.2;
/// The face is turned away where the cosine between its direction and the direction to the camera is below this (107
/// degrees: a profile shows nose and one eye). Chosen.
const FACE_AWAY: f64 = -0.3;
/// An ear is turned away where the cosine between its side and the direction to the camera is below this (120 degrees: the
/// ear behind the hair of a head in half profile is still reported). Chosen.
const EAR_AWAY: f64 = -0.5;

/// Projects the keypoints of a convention.
pub(super) struct Projector {
    /// Side of the head that each keypoint lies on.
    sides: Vec<Option<HeadSide>>,
    /// Indices of nose, left and right ear, if the convention has them.
    head: Option<[usize; 3]>,
}

/// Side of the head.
#[derive(Debug, Clone, Copy, PartialEq)]
enum HeadSide {
    Face,
    Left,
    Right,
}

impl Projector {
    pub(super) fn new(convention: KeypointConvention) -> Self {
        let [nose, left, right] = ["nose", "left_ear", "right_ear"].map(|name| convention.index_of(name));
        Self {
            sides: convention.names().iter().map(|name| HeadSide::of(name)).collect(),
            head: nose.zip(left).zip(right).map(|((nose, left), right)| [nose, left, right]),
        }
    }

    /// The keypoints of `person` in a frame.
    pub(super) fn project(
        &self,
        scene: &SimulatedScene,
        frame: usize,
        person: usize,
        camera: &RigCamera,
    ) -> Vec<Projected> {
        let center = camera.camera_from_world.center();
        let people: Vec<&[Vector3<f64>; N_JOINTS]> = scene.joints[frame].iter().collect();
        let points = &scene.keypoints[frame][person];
        let head = self.head.and_then(|head| HeadDirections::new(head.map(|k| points[k]), &center));
        let point = |(point, side): (&Vector3<f64>, &Option<HeadSide>)| {
            let (pixel, in_view) = pixel_of(camera, point);
            let hidden = is_hidden(&center, point, person, &people);
            let turned_away = head.zip(*side).is_some_and(|(head, side)| head.is_turned_away(side));
            Projected { pixel, in_view, hidden, turned_away }
        };
        points.iter().zip(self.sides.iter().chain(std::iter::repeat(&None))).map(point).collect()
    }
}

impl HeadSide {
    fn of(keypoint: &str) -> Option<Self> {
        match keypoint {
            "left_ear" => Some(Self::Left),
            "right_ear" => Some(Self::Right),
            _ => ["nose", "eye", "mouth"].iter().any(|part| keypoint.contains(part)).then_some(Self::Face),
        }
    }
}

/// Cosines of the head's directions with the direction to the camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeadDirections {
    forward: f64,
    left: f64,
}

impl HeadDirections {
    /// From nose, left and right ear in the world; `None` where points coincide.
    pub(super) fn new([nose, left_ear, right_ear]: [Vector3<f64>; 3], camera: &Vector3<f64>) -> Option<Self> {
        let middle = (left_ear + right_ear) / 2.0;
        let left = (left_ear - right_ear).try_normalize(1e-9)?;
        let to_nose = nose - middle;
        let forward = (to_nose - left * to_nose.dot(&left)).try_normalize(1e-9)?;
        let to_camera = (camera - middle).try_normalize(1e-9)?;
        Some(Self { forward: forward.dot(&to_camera), left: left.dot(&to_camera) })
    }

    /// Whether the camera does not see the face.
    pub(super) fn is_averted(self) -> bool {
        self.is_turned_away(HeadSide::Face)
    }

    fn is_turned_away(self, side: HeadSide) -> bool {
        match side {
            HeadSide::Face => self.forward < FACE_AWAY,
            HeadSide::Left => self.left < EAR_AWAY,
            HeadSide::Right => -self.left < EAR_AWAY,
        }
    }
}

/// Pixel of a point in the world, and whether it lies in the image.
pub(super) fn pixel_of(camera: &RigCamera, point: &Vector3<f64>) -> (Vector2<f64>, bool) {
    let (width, height) = (f64::from(camera.intrinsics.width), f64::from(camera.intrinsics.height));
    let in_camera = camera.camera_from_world.transform(point);
    let pixel = camera.intrinsics.pixel_from_camera(&in_camera).unwrap_or_else(Vector2::zeros);
    let on_sensor = pixel.x > 0.0 && pixel.x < width && pixel.y > 0.0 && pixel.y < height;
    (pixel, in_camera.z > MIN_DEPTH && on_sensor)
}

/// The longer side of the bounding box of the points in the image, px.
pub(super) fn apparent_size(points: &[Projected]) -> f64 {
    size_of(points.iter().filter(|p| p.in_view).map(|p| p.pixel))
}

/// The longer side of the bounding box of pixels, px; at least [`MIN_SIZE_PX`].
pub(super) fn size_of(pixels: impl Iterator<Item = Vector2<f64>>) -> f64 {
    let none = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    let (low, high) = pixels.fold(none, |(low, high), pixel| (low.inf(&pixel), high.sup(&pixel)));
    (high - low).max().max(MIN_SIZE_PX)
}
