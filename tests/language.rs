//! The language rules of `docs/glossary.md` that a program can check, over every text that readers or users meet.

#![allow(clippy::unwrap_used)] // a test may

mod source_tree;

use source_tree::files_below;
use std::fs;
use std::path::{Path, PathBuf};

/// Folders and the endings of their files. This file and the glossary name the banned words and are left out; migrations
/// that were applied never change.
const TEXTS: &[(&str, &str)] = &[
    ("src", "rs"),
    ("src", "py"),
    ("tests", "rs"),
    ("benches", "rs"),
    ("examples", "rs"),
    ("web/src", "ts"),
    ("web/src", "css"),
    ("checks", "py"),
    ("checks", "mjs"),
    ("clients", "py"),
    ("docs", "md"),
    ("docker", "yaml"),
    ("openapi", "json"),
    ("assets", "md"),
];
const FILES: &[&str] = &["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "build.rs", "Cargo.toml", ".ci/run"];
const LEFT_OUT: &[&str] = &["tests/language.rs", "docs/glossary.md"];

/// Words (as parts of identifiers, too) that the glossary replaces.
const BANNED_WORDS: &[&str] = &[
    "ballot", "ballots", "bearings", "deed", "deeds", "habit", "habits", "keeper", "likeness", "mended", "mover",
    "movers", "nobody", "pace", "paces", "paced", "rejoin", "rejoins", "sighting", "sightings", "somebody", "surprise",
    "tells", "told", "trusts", "whisper", "whispers", "whoever", "whom", "witness", "witnesses", "deaths",
];
/// Sequences of words.
const BANNED_PHRASES: &[&[&str]] = &[
    &["is", "no"],
    &["one", "view"],
    &["place", "cost"],
    &["steady", "place"],
    &["steady", "places"],
    &["set", "in", "motion"],
    &["captured", "skeleton"],
    &["captured", "skeletons"],
    &["who", "is", "who"],
    &["on", "ray"],
];
/// Names of earlier releases that are still read.
const EARLIER_NAMES: &[&str] = &["max_deaths", "state, deaths, created_at"];
/// "Who" refers to people alone: it stands behind one of these words.
const PEOPLE: &[&str] = &[
    "person", "people", "persons", "someone", "anyone", "everyone", "those", "user", "users", "subject", "subjects",
    "adult", "adults", "operator", "operators", "reader", "readers", "dancer", "dancers", "walker", "walkers", "man",
    "men", "woman", "women", "child", "children", "actor", "actors", "tenant", "tenants", "developer", "developers",
    "client", "clients", "runner", "runners",
];

/// One place that breaks a rule.
struct Fault {
    place: String,
    rule: String,
}

#[test]
fn texts_use_plain_words() {
    let faults: Vec<String> =
        texts().iter().flat_map(|path| faults_of(path)).map(|f| format!("{}: {}", f.place, f.rule)).collect();
    assert!(faults.is_empty(), "{} places\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn test_names_have_at_most_60_characters() {
    let mut faults = Vec::new();
    for path in texts().iter().filter(|path| path.extension().is_some_and(|e| e == "rs")) {
        let text = fs::read_to_string(path).unwrap();
        let mut lines = text.lines().map(str::trim).filter(|line| !line.starts_with("//"));
        while let Some(line) = lines.next() {
            if !line.ends_with("test]") || !line.starts_with("#[") {
                continue;
            }
            let Some(head) = lines.find(|line| line.contains("fn ")) else { break };
            let name = head.split("fn ").nth(1).and_then(|rest| rest.split('(').next()).unwrap_or_default();
            if name.len() > 60 {
                faults.push(format!("{}: {name} has {} characters", shown(path), name.len()));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn sees_banned_words_and_phrases() {
    let rules = |line: &str| rules_broken_by(line).len();
    assert_eq!(rules("/// There is no camera that sees anybody."), 1);
    assert_eq!(rules("let steady_places = told(nobody);"), 3);
    assert_eq!(rules("fn one_view() {}"), 1);
    assert_eq!(rules("/// The camera who sees the person who walks."), 1);
    assert_eq!(rules("// plain words about spaces, pacemakers and a paper"), 0);
    assert_eq!(rules("struct DetectorHabits;"), 1);
}

fn texts() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let below = TEXTS.iter().filter(|(folder, _)| root.join(folder).is_dir());
    let mut paths: Vec<PathBuf> = below.flat_map(|(folder, ending)| files_below(&root.join(folder), ending)).collect();
    paths.extend(FILES.iter().map(|name| root.join(name)).filter(|path| path.is_file()));
    paths.retain(|path| !LEFT_OUT.contains(&shown(path).as_str()) && !path.iter().any(|part| part == "node_modules"));
    assert!(paths.len() > 100, "the texts were not found");
    paths
}

/// The path from the repository's root on, with slashes.
fn shown(path: &Path) -> String {
    let below = path.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap_or(path);
    below.iter().map(|part| part.to_string_lossy()).collect::<Vec<_>>().join("/")
}

fn faults_of(path: &Path) -> Vec<Fault> {
    let text = fs::read_to_string(path).unwrap();
    let fault = |(number, rule): (usize, String)| Fault { place: format!("{}:{}", shown(path), number + 1), rule };
    text.lines()
        .enumerate()
        .flat_map(|(i, line)| rules_broken_by(line).into_iter().map(move |rule| (i, rule)))
        .map(fault)
        .collect()
}

fn rules_broken_by(line: &str) -> Vec<String> {
    let line = &EARLIER_NAMES.iter().fold(line.to_owned(), |line, name| line.replace(name, ""));
    let words = words_of(line);
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let mut rules: Vec<String> =
        words.iter().filter(|word| BANNED_WORDS.contains(word)).map(|word| format!("\"{word}\"")).collect();
    for phrase in BANNED_PHRASES {
        let n = words.windows(phrase.len()).filter(|window| window == phrase).count();
        rules.extend((0..n).map(|_| format!("\"{}\"", phrase.join(" "))));
    }
    // A line that begins with "who" continues a sentence whose last word is on the line before; `who` as a name in code is
    // not followed by a word.
    for (at, who) in line.match_indices(" who ") {
        let before = words_of(&line[..at]).pop();
        let is_prose = line[at + who.len()..].starts_with(char::is_alphabetic);
        if let Some(word) = before.filter(|word| is_prose && !PEOPLE.contains(&word.as_str())) {
            rules.push(format!("\"{word} who\": not a person"));
        }
    }
    rules
}

/// Words in lower case; identifiers are split at underscores and capitals.
fn words_of(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut was_lower = false;
    for c in line.chars() {
        if !c.is_alphabetic() || (c.is_uppercase() && was_lower) {
            words.push(String::new());
        }
        if c.is_alphabetic() {
            words.last_mut().unwrap().extend(c.to_lowercase());
        }
        was_lower = c.is_lowercase();
    }
    words.retain(|word| !word.is_empty());
    words
}
