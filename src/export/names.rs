//! Names of cameras and people as file names and identifiers.

use super::take::Take;
use crate::session::{BodyMotion, PersonId};
use std::collections::{BTreeMap, BTreeSet};

/// Characters of a name before its number and its ending; file systems allow 255 bytes in all.
const MAX_CHARS: usize = 200;

/// File names of letters, digits, `_` and `-`, which are also valid keys in TOML and OpenCV's YAML.
pub(super) fn file_names<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    let ids: Vec<String> = ids.map(|id| if is_device(id) { format!("{id}_") } else { id.to_owned() }).collect();
    unique(ids.iter().map(String::as_str), |c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}

/// Whether Windows takes a file of this name, with any ending, for a device.
fn is_device(name: &str) -> bool {
    let name = name.to_ascii_uppercase();
    let numbered = name.strip_prefix("COM").or_else(|| name.strip_prefix("LPT"));
    ["CON", "PRN", "AUX", "NUL"].contains(&name.as_str())
        || numbered.is_some_and(|n| matches!(n.as_bytes(), [b'0'..=b'9']))
}

/// USD prim names: `camera_` followed by letters, digits and `_`.
pub(super) fn identifiers<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    let names = unique(ids, |c| c.is_ascii_alphanumeric() || c == '_');
    names.into_iter().map(|name| format!("camera_{name}")).collect()
}

/// Name of a person in scenes, of ASCII letters, digits and `_`: the person's own where a correction gives one. No other person
/// and no camera has it.
pub(super) fn person_name(take: &Take, motion: &BodyMotion) -> String {
    let people: Vec<PersonId> = take.motions.iter().map(|motion| motion.person).collect();
    let cameras = identifiers(take.cameras.iter().map(|camera| camera.id.as_str()));
    people_identifiers(&people, &take.names, cameras).remove(&motion.person).unwrap_or_default()
}

/// Identifiers of people that differ from each other and from those in `taken`. `person_1` is person 1 unless that one has a name
/// of its own; a name that is taken gets the person's number.
fn people_identifiers(
    people: &[PersonId],
    names: &BTreeMap<PersonId, String>,
    taken: Vec<String>,
) -> BTreeMap<PersonId, String> {
    let plain =
        |name: &String| -> String { name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect() };
    let own = |person: &PersonId| {
        names.get(person).map(plain).filter(|own| own.starts_with(|c: char| c.is_ascii_alphabetic()))
    };
    let (named, unnamed): (Vec<PersonId>, Vec<PersonId>) = people.iter().partition(|person| own(person).is_some());
    let numbered = unnamed.into_iter().map(|person| (person, format!("person_{}", person.0)));
    let mut identifiers: BTreeMap<PersonId, String> = numbered.collect();
    let mut taken: BTreeSet<String> = taken.into_iter().chain(identifiers.values().cloned()).collect();
    for person in named {
        let own = own(&person).unwrap_or_default();
        let is_shared = names.iter().any(|(other, name)| *other != person && plain(name) == own);
        let mut name = if is_shared { format!("{own}_{}", person.0) } else { own.clone() };
        for n in 2.. {
            if taken.insert(name.clone()) {
                break;
            }
            name = if n == 2 { format!("{own}_{}", person.0) } else { format!("{own}_{}_{n}", person.0) };
        }
        identifiers.insert(person, name);
    }
    identifiers
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
    fn cameras_named_like_devices_gave_files_windows_refuses() {
        let names = file_names(["CON", "nul", "lpt1", "COM1", "con_", "COM10", "console"].into_iter());
        assert_eq!(names, ["CON_", "nul_", "lpt1_", "COM1_", "con__2", "COM10", "console"]);
    }

    #[test]
    fn a_person_named_like_a_camera_or_another_gets_another_name() {
        let people = [0, 1, 2, 3, 4, 5].map(PersonId);
        let given = ["person_1", "", "camera_cam00", "Ada", "Ada", "person_1_0"];
        let names = people.into_iter().zip(given.map(str::to_owned)).filter(|(_, name)| !name.is_empty()).collect();
        let found = people_identifiers(&people, &names, identifiers(["cam00"].into_iter()));
        let expected = ["person_1_0", "person_1", "camera_cam00_2", "Ada_3", "Ada_4", "person_1_0_5"];
        assert_eq!(found.into_values().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn long_names_fit_into_a_file_name() {
        let long = "x".repeat(1000);
        let names = file_names([format!("{long}1"), format!("{long}2")].iter().map(String::as_str));
        assert_eq!(names, ["x".repeat(200), format!("{}_2", "x".repeat(200))]);
    }
}
