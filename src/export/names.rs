//! Camera names as file names and identifiers.

use std::collections::BTreeSet;

/// Characters of a name before its number and its ending; file systems allow 255 bytes in all.
const MAX_CHARS: usize = 200;

/// File names of letters, digits, `_` and `-`, which are also valid keys in TOML and OpenCV's YAML.
pub(super) fn file_names<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    unique(ids, |c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}

/// USD prim names: `camera_` followed by letters, digits and `_`.
pub(super) fn identifiers<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    let names = unique(ids, |c| c.is_ascii_alphanumeric() || c == '_');
    names.into_iter().map(|name| format!("camera_{name}")).collect()
}

/// A quoted string with the escapes that JSON, TOML and YAML have in common.
pub(super) fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Replaces other characters by `_` and shortens long names; repeated names (compared without case, for file systems that
/// ignore it) get a number.
fn unique<'a>(ids: impl Iterator<Item = &'a str>, is_allowed: impl Fn(char) -> bool) -> Vec<String> {
    let mut taken = BTreeSet::new();
    let mut unique_name = |id: &str| {
        let plain: String = id.chars().take(MAX_CHARS).map(|c| if is_allowed(c) { c } else { '_' }).collect();
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

    #[test]
    fn long_names_fit_into_a_file_name() {
        let long = "x".repeat(1000);
        let names = file_names([format!("{long}1"), format!("{long}2")].iter().map(String::as_str));
        assert_eq!(names, ["x".repeat(200), format!("{}_2", "x".repeat(200))]);
    }
}
