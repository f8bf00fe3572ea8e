//! TOML with one table per camera: Pose2Sim's `Calib.toml`, anipose's and FreeMoCap's calibration, Caliscope's camera array.

use super::values::{invalid, rows_of, rows_of_rotation, size};
use crate::session::upload::error::{UploadError, shown};
use crate::session::upload::json::ShortList;
use crate::session::upload::raw::RawCamera;
use crate::session::upload::warnings::Warnings;
use toml::{Table, Value};

/// All tables with a `matrix`, at the top or below `cameras`; and `project.frame_rate`, where given.
pub(super) fn read(text: &str, fps: &mut Option<f64>, warnings: &mut Warnings) -> Result<Vec<RawCamera>, UploadError> {
    let document: Table = text.parse().map_err(|e: toml::de::Error| invalid(e.message()))?;
    let frame_rate = document.get("project").and_then(|project| project.get("frame_rate")).and_then(number);
    *fps = fps.or(frame_rate);
    let nested = document.get("cameras").and_then(Value::as_table);
    let tables = document.iter().chain(nested.into_iter().flatten());
    let is_camera = |(key, value): (&String, &Value)| {
        let table = value.as_table().filter(|table| table.contains_key("matrix"))?;
        Some((key.clone(), table.clone()))
    };
    let cameras: Vec<(String, Table)> = tables.filter_map(is_camera).collect();
    if cameras.is_empty() && frame_rate.is_none() {
        return Err(invalid("the file has no camera: no table has a `matrix`"));
    }
    let mut cameras: Vec<RawCamera> =
        cameras.iter().map(|(key, table)| camera(key, table, warnings)).collect::<Result<_, _>>()?;
    remove_unset_poses(&mut cameras, warnings);
    Ok(cameras)
}

fn camera(key: &str, table: &Table, warnings: &mut Warnings) -> Result<RawCamera, UploadError> {
    let in_camera = |error| UploadError { camera: Some(key.to_owned()), ..error };
    let list = |name: &str| match table.get(name) {
        Some(value @ Value::Array(_)) => {
            let mut numbers = Vec::new();
            flatten(value, &mut numbers)
                .ok_or_else(|| in_camera(invalid(format!("`{name}` is not a list of numbers"))))?;
            Ok(Some(numbers))
        }
        _ => Ok(None),
    };
    let id = table.get("name").and_then(text).or_else(|| table.get("cam_id").and_then(text)).unwrap_or(key.to_owned());
    let matrix = list("matrix")?.ok_or_else(|| in_camera(invalid("`matrix` is missing or not a list")))?;
    let distortion = list("distortions")?;
    let is_fisheye = table.get("fisheye").and_then(Value::as_bool) == Some(true);
    if !is_fisheye && distortion.as_ref().is_some_and(|d| d.len() == 4 && d.iter().any(|k| *k != 0.0)) {
        warnings.add("the calibration has 4 distortion coefficients: a k3 of the lens, if any, is missing".to_owned());
    }
    let turns = table.get("rotation_count").and_then(number).unwrap_or(0.0);
    if turns % 4.0 != 0.0 {
        warnings.add(format!(
            "camera {} has rotation_count {turns}: its video is rotated; keypoints must refer to the image that was \
             calibrated",
            shown(&id)
        ));
    }
    let image = list("size")?.unwrap_or_default();
    let whole = |i: usize| image.get(i).copied().and_then(size).unwrap_or(0);
    // An empty list is that of a camera without a pose.
    let rotation = list("rotation")?.filter(|numbers| !numbers.is_empty());
    let rotation = rotation.map(|numbers| rows_of_rotation("`rotation`", &numbers)).transpose().map_err(in_camera)?;
    let translation = list("translation")?.map(|t| in_metres(t, table, warnings));
    Ok(RawCamera {
        width: whole(0),
        height: whole(1),
        matrix: Some(rows_of(&matrix).ok_or_else(|| in_camera(invalid("`matrix` does not have 9 entries")))?),
        distortion: distortion.map(ShortList),
        distortion_model: is_fisheye.then(|| "fisheye".to_owned()),
        rotation,
        translation: translation.map(ShortList),
        time_offset: None,
        id,
    })
}

/// FreeMoCap calibrates in millimetres; it is the only tool that writes `world_position`.
fn in_metres(translation: Vec<f64>, table: &Table, warnings: &mut Warnings) -> Vec<f64> {
    if !table.contains_key("world_position") {
        return translation;
    }
    warnings.add("the calibration is FreeMoCap's: its translations are read as millimetres".to_owned());
    translation.into_iter().map(|t_mm| t_mm / 1000.0).collect()
}

/// Removes poses that are all at the origin: a calibration of intrinsics alone leaves every pose at zero.
fn remove_unset_poses(cameras: &mut [RawCamera], warnings: &mut Warnings) {
    let is_unset = |camera: &RawCamera| camera.translation.as_ref().is_some_and(|t| t.0.iter().all(|t| *t == 0.0));
    if cameras.len() < 2 || !cameras.iter().all(is_unset) {
        return;
    }
    for camera in cameras.iter_mut() {
        (camera.rotation, camera.translation) = (None, None);
    }
    warnings.add("all cameras of the calibration are at the origin: their poses are ignored".to_owned());
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|n| n as f64)).filter(|number| number.is_finite())
}

fn text(value: &Value) -> Option<String> {
    value.as_str().map(str::to_owned).or_else(|| value.as_integer().map(|n| n.to_string()))
}

/// Numbers of nested lists in order; `None` where they contain anything else.
fn flatten(value: &Value, numbers: &mut Vec<f64>) -> Option<()> {
    match value {
        Value::Array(items) => items.iter().try_for_each(|item| flatten(item, numbers)),
        _ => {
            numbers.push(number(value)?);
            Some(())
        }
    }
}
