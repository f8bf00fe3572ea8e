//! Cameras of several files: values of one camera that are spread over files are merged, contradicting ones are refused.

use super::values::invalid;
use crate::session::upload::error::{UploadError, shown};
use crate::session::upload::json::{Numbers, Rows};
use crate::session::upload::raw::RawCamera;

/// Largest difference of a value that two files state, as a share of the largest one beside it: tools write different numbers of
/// digits.
const TOLERANCE: f64 = 1e-3;

/// Cameras in the order of their first file.
#[derive(Debug, Default)]
pub(super) struct MergedCameras {
    cameras: Vec<RawCamera>,
    /// The file in which each camera was found first.
    files: Vec<String>,
}

impl MergedCameras {
    /// Adds a camera, or completes it with the values of a second file.
    ///
    /// # Errors
    /// Two files that state different lenses or poses, for these are two cameras.
    pub(super) fn add(&mut self, camera: RawCamera, file: &str) -> Result<(), UploadError> {
        let Some(index) = self.cameras.iter().position(|own| own.id == camera.id) else {
            self.cameras.push(camera);
            self.files.push(file.to_owned());
            return Ok(());
        };
        let own = &mut self.cameras[index];
        if let Some(value) = contradiction(own, &camera) {
            let detail = format!("{value} of the camera differs from that in file {}", shown(&self.files[index]));
            return Err(UploadError {
                file: Some(file.to_owned()),
                camera: Some(camera.id),
                remedy: "give the cameras different names, or remove one of the files".to_owned(),
                ..invalid(detail)
            });
        }
        if own.width == 0 || own.height == 0 {
            (own.width, own.height) = (camera.width, camera.height);
        }
        own.matrix = own.matrix.take().or(camera.matrix);
        own.distortion = own.distortion.take().or(camera.distortion);
        own.distortion_model = own.distortion_model.take().or(camera.distortion_model);
        own.rotation = own.rotation.take().or(camera.rotation);
        own.translation = own.translation.take().or(camera.translation);
        own.time_offset = own.time_offset.or(camera.time_offset);
        Ok(())
    }

    /// All cameras.
    pub(super) fn into_cameras(self) -> Vec<RawCamera> {
        self.cameras
    }
}

/// The first value that two files state differently.
fn contradiction(one: &RawCamera, other: &RawCamera) -> Option<&'static str> {
    // K grows with the images.
    let size = |camera: &RawCamera| if one.width > 0 && other.width > 0 { f64::from(camera.width) } else { 1.0 };
    let rows = |rows: [&Option<Rows>; 2], units: [f64; 2]| {
        let entries =
            |rows: &Rows, unit: f64| rows.0.iter().flat_map(|row| &row.0).map(|x| x / unit).collect::<Vec<_>>();
        let [one, other] = rows.map(Option::as_ref);
        one.zip(other).is_some_and(|(one, other)| differ(&entries(one, units[0]), &entries(other, units[1])))
    };
    let numbers = |one: &Option<Numbers>, other: &Option<Numbers>| {
        one.as_ref().zip(other.as_ref()).is_some_and(|(one, other)| differ(&one.0, &other.0))
    };
    let values = [
        ("K", rows([&one.matrix, &other.matrix], [one, other].map(size))),
        ("dist", numbers(&one.distortion, &other.distortion)),
        ("R", rows([&one.rotation, &other.rotation], [1.0; 2])),
        ("t", numbers(&one.translation, &other.translation)),
    ];
    values.into_iter().find(|(_, differs)| *differs).map(|(value, _)| value)
}

/// Whether numbers differ by more than rounding; coefficients that are left out are zeros.
fn differ(one: &[f64], other: &[f64]) -> bool {
    let largest = one.iter().chain(other).fold(0.0, |largest: f64, number| largest.max(number.abs()));
    let at = |numbers: &[f64], i: usize| numbers.get(i).copied().unwrap_or(0.0);
    (0..one.len().max(other.len())).any(|i| (at(one, i) - at(other, i)).abs() > TOLERANCE * largest)
}
