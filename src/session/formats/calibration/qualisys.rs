//! Qualisys Track Manager's `.qca.txt`, an XML file: the video cameras of a calibrated system.
//!
//! Lengths on the sensor are in parts of 1/64 of a pixel and counted from 0, as `sensorMinU` and `sensorMaxU` show (122,879 for 1,920
//! pixels), so the centre of the first pixel is at 31.5. `fov_video` is the part of the sensor that is recorded, in pixels;
//! `video_resolution` states a smaller image of it by its height, full is 1080p. `transform` is `camera_from_world` row by
//! row with the camera's y axis up and its z axis backwards, and the camera's centre in millimetres of a world with z up.

use super::values::{finite, invalid, pinhole};
use crate::geometry::Rigid;
use crate::session::formats::entries;
use crate::session::upload::error::{UploadError, shown};
use crate::session::upload::json::ShortList;
use crate::session::upload::raw::{RawCamera, rows_of_matrix};
use crate::session::upload::warnings::Warnings;
use nalgebra::{Matrix3, Vector3};
use roxmltree::{Document, Node};

/// Parts of a pixel in lengths on the sensor.
const PARTS: f64 = 64.0;

/// Height of a video of full resolution.
const FULL_HEIGHT: f64 = 1080.0;

/// Whether an XML file that begins so is a calibration of Qualisys.
pub(super) fn recognise(head: &str) -> bool {
    head.contains("<calibration") && (head.contains("qtm-version") || head.contains("<fov_video"))
}

/// All video cameras; all cameras where no model is named as one.
pub(super) fn read(text: &str, warnings: &mut Warnings) -> Result<Vec<RawCamera>, UploadError> {
    let document = Document::parse(text).map_err(|e| invalid(e.to_string()))?;
    let nodes =
        document.descendants().filter(|node| node.has_tag_name("camera") && node.attribute("active") != Some("0"));
    let nodes: Vec<Node> = nodes.collect();
    let films = |node: &&Node| node.attribute("model").is_some_and(|model| model.to_lowercase().contains("video"));
    let has_video = nodes.iter().any(|node| films(&node));
    let cameras: Result<Vec<RawCamera>, UploadError> =
        nodes.iter().filter(|node| !has_video || films(node)).map(|node| camera(*node, warnings)).collect();
    let cameras = cameras?;
    if cameras.is_empty() {
        return Err(invalid("the file has no active camera"));
    }
    Ok(cameras)
}

fn camera(node: Node<'_, '_>, warnings: &mut Warnings) -> Result<RawCamera, UploadError> {
    let id = node.attribute("serial").ok_or_else(|| invalid("a camera has no serial"))?;
    let child = |name: &str| {
        let found = node.children().find(|child| child.has_tag_name(name));
        found.ok_or_else(|| invalid(format!("camera {} has no <{name}>", shown(id))))
    };
    let (film, lens, pose) = (child("fov_video")?, child("intrinsic")?, child("transform")?);
    let number = |node: Node<'_, '_>, name: &str| {
        let value = node.attribute(name).and_then(finite);
        value.ok_or_else(|| invalid(format!("camera {}: `{name}` is not a number", shown(id))))
    };
    if node.attribute("viewrotation").is_some_and(|angle| angle != "0") {
        warnings.add(format!(
            "camera {}: Track Manager shows its video turned; the calibration is that of the video as it was recorded",
            shown(id)
        ));
    }
    let scale = scale(node.attribute("video_resolution"))
        .ok_or_else(|| invalid(format!("camera {}: `video_resolution` is not a height such as 1080p", shown(id))))?;
    let [left, right, top, bottom] = ["left", "right", "top", "bottom"].map(|side| number(film, side));
    let (left, right, top, bottom) = (left?, right?, top?, bottom?);
    let side = |first: f64, last: f64| {
        let pixels = ((last - first + 1.0) * scale).round();
        (1.0..=1e6)
            .contains(&pixels)
            .then_some(pixels as u32)
            .ok_or_else(|| invalid(format!("camera {}: the sides of <fov_video> leave no image", shown(id))))
    };
    // From the edge of the recorded part, whose first pixel has its centre half a pixel inside.
    let centre = |on_sensor: f64, first: f64| ((on_sensor + 0.5) / PARTS - first) * scale - 0.5;
    let focal = |on_sensor: f64| on_sensor / PARTS * scale;
    let [k1, k2, k3, p1, p2] =
        ["radialDistortion1", "radialDistortion2", "radialDistortion3", "tangentalDistortion1", "tangentalDistortion2"]
            .map(|name| number(lens, name));
    let camera_from_world = camera_from_world(|name| number(pose, name))?;
    Ok(RawCamera {
        id: id.to_owned(),
        width: side(left, right)?,
        height: side(top, bottom)?,
        matrix: pinhole(
            focal(number(lens, "focalLengthU")?),
            focal(number(lens, "focalLengthV")?),
            centre(number(lens, "centerPointU")?, left),
            centre(number(lens, "centerPointV")?, top),
            focal(number(lens, "skew").unwrap_or(0.0)),
        ),
        distortion: Some(ShortList(vec![k1?, k2?, p1?, p2?, k3?])),
        rotation: Some(rows_of_matrix(&camera_from_world.rotation)),
        translation: Some(ShortList(entries(&camera_from_world.translation).to_vec())),
        ..RawCamera::default()
    })
}

/// Pixels of the video per pixel of the sensor.
fn scale(resolution: Option<&str>) -> Option<f64> {
    let Some(resolution) = resolution else { return Some(1.0) };
    let height = finite(resolution.trim_end_matches(|c: char| !c.is_ascii_digit()))?;
    (height > 0.0).then_some(height / FULL_HEIGHT)
}

/// With OpenCV's axes of the camera, metres.
fn camera_from_world(number: impl Fn(&str) -> Result<f64, UploadError>) -> Result<Rigid, UploadError> {
    let rows = ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"].map(&number);
    let rows: Result<Vec<f64>, UploadError> = rows.into_iter().collect();
    let backwards_from_world = Matrix3::from_row_slice(&rows?);
    let rotation = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) * backwards_from_world;
    let centre = Vector3::new(number("x")?, number("y")?, number("z")?) * 1e-3;
    Ok(Rigid { rotation, translation: -(rotation * centre) })
}
