//! COLMAP's text model: `cameras.txt` and, where there are poses, `images.txt`.
//!
//! COLMAP's first pixel has its centre at (0.5, 0.5), here at (0, 0): principal points are shifted by half a pixel.

use super::format::CalibrationFormat;
use super::values::{camera_of_image, finite, invalid, pinhole};
use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::{Numbers, Rows, ShortList};
use crate::session::upload::raw::{RawCamera, rows_of_matrix};
use crate::session::upload::warnings::Warnings;
use nalgebra::{Quaternion, UnitQuaternion};
use std::collections::BTreeMap;

/// Content of the two files read so far.
#[derive(Debug, Default)]
pub(super) struct Model {
    cameras: BTreeMap<u64, RawCamera>,
    images: Vec<Image>,
}

#[derive(Debug)]
struct Image {
    camera: u64,
    /// The camera's name, from the image's name.
    id: String,
    rotation: Rows,
    translation: Numbers,
}

const HALF_PIXEL: f64 = 0.5;

/// Recognises the two files by their first line of data.
pub(super) fn recognise(head: &str) -> Option<CalibrationFormat> {
    let line = head.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#'))?;
    let words: Vec<&str> = line.split_whitespace().collect();
    let is_number = |word: &&str| word.parse::<f64>().is_ok();
    let is_model = |word: &str| word.chars().all(|c| c.is_ascii_uppercase() || c == '_') && !word.is_empty();
    match words.as_slice() {
        [id, model, rest @ ..] if is_number(id) && is_model(model) && rest.len() >= 5 && rest.iter().all(is_number) => {
            Some(CalibrationFormat::ColmapCameras)
        }
        [numbers @ .., name] if numbers.len() == 9 && numbers.iter().all(is_number) && !is_number(name) => {
            Some(CalibrationFormat::ColmapImages)
        }
        _ => None,
    }
}

fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.starts_with('#'))
}

fn numbers(words: &[&str]) -> Result<Vec<f64>, UploadError> {
    words.iter().copied().map(finite).collect::<Option<_>>().ok_or_else(|| invalid("a value is not a number"))
}

impl Model {
    pub(super) fn add_cameras(&mut self, text: &str) -> Result<(), UploadError> {
        for line in lines(text).filter(|line| !line.trim().is_empty()) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let [id, model, width, height, parameters @ ..] = words.as_slice() else {
                return Err(invalid("a line of `cameras.txt` is too short"));
            };
            let whole = |word: &str| word.parse::<u32>().map_err(|_| invalid("an image size is not an integer"));
            let number = id.parse().map_err(|_| invalid("a CAMERA_ID is not an integer"))?;
            let lens = lens(model, &numbers(parameters)?)?;
            let camera = RawCamera { id: (*id).to_owned(), width: whole(width)?, height: whole(height)?, ..lens };
            self.cameras.insert(number, camera);
        }
        Ok(())
    }

    /// Every image has two lines; the second, its points, may be empty.
    pub(super) fn add_images(&mut self, text: &str) -> Result<(), UploadError> {
        let mut lines = lines(text).skip_while(|line| line.trim().is_empty());
        while let Some(line) = lines.next() {
            if line.trim().is_empty() {
                continue;
            }
            let words: Vec<&str> = line.split_whitespace().collect();
            let [_, pose @ .., camera, name] = words.as_slice() else {
                return Err(invalid("a line of `images.txt` is too short"));
            };
            let [w, x, y, z, tx, ty, tz] = numbers(pose)?[..] else {
                return Err(invalid("an image's pose is not QW QX QY QZ TX TY TZ"));
            };
            let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)
                .ok_or_else(|| invalid("an image's quaternion is zero"))?;
            self.images.push(Image {
                camera: camera.parse().map_err(|_| invalid("a CAMERA_ID is not an integer"))?,
                id: camera_of_image(name).to_owned(),
                rotation: rows_of_matrix(turn.to_rotation_matrix().matrix()),
                translation: ShortList(vec![tx, ty, tz]),
            });
            lines.next();
        }
        Ok(())
    }

    /// The cameras, one per image name; without images one per CAMERA_ID, without pose.
    pub(super) fn into_cameras(self, warnings: &mut Warnings) -> Result<Vec<RawCamera>, UploadError> {
        if self.images.is_empty() {
            return Ok(self.cameras.into_values().collect());
        }
        warnings.add("COLMAP's poses have no unit: they are read as metres".to_owned());
        let mut posed: Vec<RawCamera> = Vec::new();
        for image in self.images {
            let camera = self.cameras.get(&image.camera);
            let camera = camera.ok_or_else(|| {
                let detail = format!("image {} has the unknown CAMERA_ID {}", shown(&image.id), image.camera);
                Fault::CameraUnknown.with(detail)
            })?;
            match posed.iter().find(|own| own.id == image.id) {
                None => posed.push(RawCamera {
                    id: image.id,
                    rotation: Some(image.rotation),
                    translation: Some(image.translation),
                    ..camera.clone()
                }),
                Some(own) if own.translation.as_ref() != Some(&image.translation) => {
                    warnings.add(format!("camera {} has several poses: the first one is used", shown(&image.id)));
                }
                Some(_) => {}
            }
        }
        Ok(posed)
    }
}

/// K and distortion of a camera model of COLMAP.
fn lens(model: &str, parameters: &[f64]) -> Result<RawCamera, UploadError> {
    let lens = |[fx, fy, cx, cy]: [f64; 4], distortion: &[f64], fisheye: bool| RawCamera {
        matrix: pinhole(fx, fy, cx - HALF_PIXEL, cy - HALF_PIXEL, 0.0),
        distortion: Some(ShortList(distortion.to_vec())),
        distortion_model: fisheye.then(|| "fisheye".to_owned()),
        ..RawCamera::default()
    };
    Ok(match (model, parameters) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => lens([f, f, cx, cy], &[], false),
        ("PINHOLE", &[fx, fy, cx, cy]) => lens([fx, fy, cx, cy], &[], false),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => lens([f, f, cx, cy], &[k, 0.0, 0.0, 0.0], false),
        ("RADIAL", &[f, cx, cy, k1, k2]) => lens([f, f, cx, cy], &[k1, k2, 0.0, 0.0], false),
        ("OPENCV", &[fx, fy, cx, cy, ref k @ ..]) if k.len() == 4 => lens([fx, fy, cx, cy], k, false),
        ("FULL_OPENCV", &[fx, fy, cx, cy, ref k @ ..]) if k.len() == 8 => lens([fx, fy, cx, cy], k, false),
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, ref k @ ..]) if k.len() == 4 => lens([fx, fy, cx, cy], k, true),
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => lens([f, f, cx, cy], &[k, 0.0, 0.0, 0.0], true),
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => lens([f, f, cx, cy], &[k1, k2, 0.0, 0.0], true),
        _ => {
            let detail = format!(
                "the camera model {} of COLMAP with {} parameters is not supported",
                shown(model),
                parameters.len()
            );
            return Err(Fault::DistortionUnsupported.with(detail));
        }
    })
}
