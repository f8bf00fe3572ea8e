//! Agisoft Metashape's camera XML: sensors with their calibration, cameras with their transform into the chunk.
//!
//! Principal points are offsets from the image's centre, the centre of the first pixel is (0.5, 0.5), `p1` and `p2` are in
//! the opposite order, `fx = f + b1`, the skew is `b2` (Metashape's manual, appendix on camera models).

use super::values::{finite, invalid, pinhole};
use crate::geometry::Rigid;
use crate::session::formats::entries;
use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::json::ShortList;
use crate::session::upload::raw::{RawCamera, rows_of_matrix};
use crate::session::upload::warnings::Warnings;
use nalgebra::{Matrix3, Vector3};
use roxmltree::{Document, Node};

/// All cameras with a calibrated sensor, or all sensors where there are no cameras.
pub(super) fn read(text: &str, warnings: &mut Warnings) -> Result<Vec<RawCamera>, UploadError> {
    let document = Document::parse(text).map_err(|e| invalid(e.to_string()))?;
    let named = |name: &'static str| document.descendants().filter(move |node| node.has_tag_name(name));
    let mut sensors = Vec::new();
    for sensor in named("sensor") {
        if let (Some(id), Some(lens)) = (sensor.attribute("id"), lens_of(sensor)?) {
            sensors.push((id, sensor.attribute("label").unwrap_or(id), lens));
        }
    }
    let mut cameras = Vec::new();
    for camera in named("camera") {
        let sensor = sensors.iter().find(|(id, ..)| Some(*id) == camera.attribute("sensor_id"));
        if let (Some((.., lens)), Some(label)) = (sensor, camera.attribute("label")) {
            cameras.push(posed(camera, label, lens)?);
        }
    }
    if cameras.is_empty() {
        cameras = sensors.into_iter().map(|(_, label, lens)| RawCamera { id: label.to_owned(), ..lens }).collect();
    }
    if cameras.is_empty() {
        return Err(invalid("the file has no sensor with a calibration"));
    }
    if cameras.iter().any(|camera| camera.rotation.is_some()) {
        warnings.add("the poses of an Agisoft file are in the unit of its chunk: they are read as metres".to_owned());
    }
    Ok(cameras)
}

/// The adjusted calibration of a sensor, or the only one it has.
fn lens_of(sensor: Node<'_, '_>) -> Result<Option<RawCamera>, UploadError> {
    let calibrations = || sensor.children().filter(|node| node.has_tag_name("calibration"));
    let adjusted = calibrations().find(|node| node.attribute("class") == Some("adjusted"));
    let Some(calibration) = adjusted.or_else(|| calibrations().next()) else { return Ok(None) };
    let child = |name: &str| calibration.children().find(|node| node.has_tag_name(name));
    let number = |name: &str| match child(name) {
        None => Ok(0.0),
        Some(node) => {
            let number = node.text().and_then(|text| finite(text.trim()));
            number.ok_or_else(|| invalid(format!("<{name}> is not a number")))
        }
    };
    let resolution = child("resolution").or_else(|| sensor.children().find(|node| node.has_tag_name("resolution")));
    let side = |name: &str| resolution.and_then(|node| node.attribute(name)).and_then(|text| text.parse::<u32>().ok());
    let (Some(width), Some(height)) = (side("width"), side("height")) else {
        return Err(invalid("a sensor has no resolution"));
    };
    let kind = calibration.attribute("type").or(sensor.attribute("type")).unwrap_or("frame");
    Fault::DistortionUnsupported.when(!["frame", "fisheye", "equidistant_fisheye"].contains(&kind), || {
        format!("the sensor type of Agisoft is {}, expected frame, fisheye or equidistant_fisheye", shown(kind))
    })?;
    let (is_fisheye, f) = (kind != "frame", number("f")?);
    let [k1, k2, k3, k4] = [number("k1")?, number("k2")?, number("k3")?, number("k4")?];
    let (own_p1, own_p2) = (number("p1")?, number("p2")?);
    let is_supported = if is_fisheye { own_p1 == 0.0 && own_p2 == 0.0 } else { k4 == 0.0 };
    if !is_supported {
        let terms = if is_fisheye { "p1 and p2 of a fisheye" } else { "k4 of a frame camera" };
        return Err(Fault::DistortionUnsupported
            .with(format!("the calibration of Agisoft uses {terms}, which are not supported")));
    }
    let distortion = if is_fisheye { vec![k1, k2, k3, k4] } else { vec![k1, k2, own_p2, own_p1, k3] };
    let centre = |size: u32, offset: f64| 0.5 * f64::from(size) + offset - 0.5;
    Ok(Some(RawCamera {
        width,
        height,
        matrix: pinhole(
            f + number("b1")?,
            f,
            centre(width, number("cx")?),
            centre(height, number("cy")?),
            number("b2")?,
        ),
        distortion: Some(ShortList(distortion)),
        distortion_model: is_fisheye.then(|| "fisheye".to_owned()),
        ..RawCamera::default()
    }))
}

/// A camera with its pose, where the file has one: `transform` is `chunk_from_camera`, 4x4 row by row.
fn posed(camera: Node<'_, '_>, label: &str, lens: &RawCamera) -> Result<RawCamera, UploadError> {
    let id = label.rsplit_once('.').map_or(label, |(stem, _)| stem).to_owned();
    let Some(transform) = camera.children().find(|node| node.has_tag_name("transform")) else {
        return Ok(RawCamera { id, ..lens.clone() });
    };
    let numbers: Option<Vec<f64>> = transform.text().unwrap_or_default().split_whitespace().map(finite).collect();
    let m = numbers.filter(|m| m.len() == 16).ok_or_else(|| invalid("a transform does not have 16 numbers"))?;
    let chunk_from_camera = Rigid {
        rotation: Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]),
        translation: Vector3::new(m[3], m[7], m[11]),
    };
    let camera_from_chunk = chunk_from_camera.inverse();
    Ok(RawCamera {
        id,
        rotation: Some(rows_of_matrix(&camera_from_chunk.rotation)),
        translation: Some(ShortList(entries(&camera_from_chunk.translation).to_vec())),
        ..lens.clone()
    })
}
