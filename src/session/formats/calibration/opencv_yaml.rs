//! OpenCV's file storage as EasyMocap writes it: `K_<c>`, `dist_<c>`, `R_<c>` or `Rot_<c>`, `T_<c>`, `H_<c>`, `W_<c>`.

use super::values::{invalid, rows_of, rows_of_rotation, size};
use super::yaml::{Yaml, parse};
use crate::session::upload::error::UploadError;
use crate::session::upload::json::ShortList;
use crate::session::upload::raw::RawCamera;

/// Cameras of an `intri.yml` or `extri.yml`; values of the other file stay empty.
pub(super) fn read(text: &str) -> Result<Vec<RawCamera>, UploadError> {
    let yaml = parse(text)?;
    let names = names(&yaml);
    if names.is_empty() {
        return Err(invalid("the file has no camera: expected `names`, `K_<name>` or `T_<name>`"));
    }
    names.into_iter().map(|name| camera(&yaml, name)).collect()
}

fn names(yaml: &Yaml) -> Vec<String> {
    if let Some(Yaml::List(items)) = yaml.get("names") {
        return items.iter().filter_map(Yaml::text).map(str::to_owned).collect();
    }
    let Yaml::Map(entries) = yaml else { return Vec::new() };
    let mut names: Vec<String> = Vec::new();
    for (key, _) in entries {
        let name = ["K_", "T_"].iter().find_map(|prefix| key.strip_prefix(prefix));
        if let Some(name) = name.filter(|name| !names.iter().any(|own| own == name)) {
            names.push(name.to_owned());
        }
    }
    names
}

fn camera(yaml: &Yaml, id: String) -> Result<RawCamera, UploadError> {
    let matrix = |prefix: &str| -> Result<Option<Vec<f64>>, UploadError> {
        let Some(value) = yaml.get(&format!("{prefix}_{id}")) else { return Ok(None) };
        let data = value.get("data").and_then(Yaml::numbers);
        data.map(Some).ok_or_else(|| invalid(format!("{prefix}_{id} is not a matrix of numbers")))
    };
    let whole = |prefix: &str| yaml.get(&format!("{prefix}_{id}")).and_then(Yaml::number).and_then(size).unwrap_or(0);
    let nine = |name: &str, numbers: Option<Vec<f64>>| match numbers {
        None => Ok(None),
        Some(numbers) => match rows_of(&numbers) {
            Some(rows) => Ok(Some(rows)),
            None => Err(invalid(format!("{name}_{id} has {} entries, expected 9", numbers.len()))),
        },
    };
    let rotation = match nine("Rot", matrix("Rot")?)? {
        Some(rows) => Some(rows),
        None => matrix("R")?.map(|numbers| rows_of_rotation(&format!("R_{id}"), &numbers)).transpose()?,
    };
    let distortion = match matrix("dist")? {
        Some(numbers) => Some(numbers),
        None => matrix("D")?,
    };
    Ok(RawCamera {
        width: whole("W"),
        height: whole("H"),
        matrix: nine("K", matrix("K")?)?,
        distortion: distortion.map(ShortList),
        distortion_model: None,
        rotation,
        translation: matrix("T")?.map(ShortList),
        time_offset: None,
        id,
    })
}
