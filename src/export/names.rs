//! Names of cameras as file names and identifiers.

use std::collections::BTreeSet;

/// Letters, digits, `_` and `-`: safe in file names, in TOML keys and in OpenCV's.
pub(super) fn file_names<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    unique(ids, |c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}

/// `camera_` and letters, digits and `_`: names of USD's prims.
pub(super) fn identifiers<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    let names = unique(ids, |c| c.is_ascii_alphanumeric() || c == '_');
    names.into_iter().map(|name| format!("camera_{name}")).collect()
}

/// A quoted string with escapes, as JSON, TOML and YAML have them in common.
pub(super) fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Other characters become `_`; what is then taken (also in other case, for file systems that see none) gets a number.
fn unique<'a>(ids: impl Iterator<Item = &'a str>, is_allowed: impl Fn(char) -> bool) -> Vec<String> {
    let mut taken = BTreeSet::new();
    let mut unique_name = |id: &str| {
        let plain: String = id.chars().map(|c| if is_allowed(c) { c } else { '_' }).collect();
        let mut name = plain.clone();
        let mut n = 2;
        while name.is_empty() || !taken.insert(name.to_ascii_lowercase()) {
            name = format!("{plain}_{n}");
            n += 1;
        }
        name
    };
    ids.map(&mut unique_name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_safe_and_distinct() {
        let ids = ["01", "a/b", "a b", "A_B", "", "../x", "cam-1"];
        let names = file_names(ids.into_iter());
        assert_eq!(names, ["01", "a_b", "a_b_2", "A_B_3", "_2", "___x", "cam-1"]);
        assert_eq!(identifiers(ids.into_iter())[6], "camera_cam_1");
    }
}
