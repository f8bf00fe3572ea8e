//! Who may import whom: nouns below, verbs above, and nothing looks up.
//!
//! Reads `crate::…` and `super::…` paths in `src/` (code above a file's `#[cfg(test)] mod`, for tests may look up) and
//! compares them with the table. A change that adds an arrow edits the table and says why.

#![allow(clippy::unwrap_used)] // a test may

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Folder (or file) of `src/` and what it may import besides itself.
const TABLE: &[(&str, &[&str])] = &[
    ("geometry", &[]),
    ("formats", &[]),
    ("progress", &[]),
    ("optim", &["progress"]),
    ("body", &["formats", "geometry", "optim"]),
    ("motion_prior", &["formats", "geometry", "body", "progress"]),
    ("session", &["formats", "geometry", "body"]),
    ("residuals", &["geometry", "body", "optim", "motion_prior"]),
    ("estimation", &["geometry", "optim"]),
    ("evaluation", &["session", "body", "geometry"]),
    ("export", &["session", "body", "formats", "geometry"]),
    ("simulation", &["session", "motion_prior", "body", "geometry"]),
    ("matching", &["estimation", "residuals", "session", "geometry", "optim", "body", "progress"]),
    (
        "pipeline",
        &["matching", "estimation", "residuals", "motion_prior", "session", "geometry", "optim", "body", "progress"],
    ),
    ("service", &["pipeline", "evaluation", "export", "session", "body", "motion_prior", "progress"]),
    (
        "cli",
        &[
            "service",
            "pipeline",
            "simulation",
            "evaluation",
            "export",
            "matching",
            "estimation",
            "residuals",
            "motion_prior",
            "session",
            "geometry",
            "optim",
            "body",
            "progress",
        ],
    ),
    ("main", &["cli"]),
    ("prelude", &["pipeline", "export", "session", "body", "geometry", "progress"]),
    // The map declares every folder and imports none.
    ("lib", &[]),
];

/// A longer file holds more than one noun.
const MAX_LINES: usize = 500;
/// Crates that speak HTTP or SQL.
const SERVICE_CRATES: [&str; 4] = ["axum", "tokio", "sqlx", "ureq"];

/// One source file.
struct Source {
    /// Path below `src/`, with slashes.
    path: String,
    /// Code without comments and without the tests at its end.
    code: String,
    n_lines: usize,
}

impl Source {
    /// `geometry` for `geometry/camera.rs`, `progress` for `progress.rs`.
    fn folder(&self) -> &str {
        let first = self.path.split('/').next().unwrap_or_default();
        first.strip_suffix(".rs").unwrap_or(first)
    }

    /// The module path: `["session", "upload"]` for `session/upload.rs` and `session/upload/mod.rs`.
    fn module(&self) -> Vec<&str> {
        let path = self.path.trim_end_matches(".rs");
        path.split('/').filter(|part| !["mod", "lib", "main"].contains(part)).collect()
    }
}

#[test]
fn nothing_looks_up() {
    let mut faults = Vec::new();
    for source in sources() {
        let Some((_, allowed)) = TABLE.iter().find(|(folder, _)| *folder == source.folder()) else {
            faults.push(format!("`src/{}` belongs to no folder of the table", source.path));
            continue;
        };
        for path in imported_paths(&source) {
            let target = path[0].as_str();
            let is_folder = TABLE.iter().any(|(folder, _)| *folder == target);
            if is_folder && target != source.folder() && !allowed.contains(&target) {
                let may = if allowed.is_empty() { "nothing of ours".to_owned() } else { quoted(allowed) };
                let (path, folder) = (&source.path, source.folder());
                faults.push(format!("`src/{path}` imports `crate::{target}`; `{folder}` may import {may}"));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn no_stage_imports_another_stage() {
    let sources = sources();
    let stage_of = |module: &[&str]| match module {
        ["pipeline", "stages", stage, ..] => Some((*stage).to_owned()),
        _ => None,
    };
    let stages: BTreeSet<String> = sources.iter().filter_map(|source| stage_of(&source.module())).collect();
    let mut faults = Vec::new();
    for source in &sources {
        let Some(own) = stage_of(&source.module()) else { continue };
        for path in imported_paths(source) {
            if path[0] == "pipeline"
                && path.get(1).is_some_and(|folder| folder == "stages")
                && path.get(2).is_some_and(|other| stages.contains(other) && *other != own)
            {
                faults.push(format!(
                    "`src/{}` imports the stage `{}`; stages never know each other",
                    source.path, path[2]
                ));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn http_and_sql_live_in_the_service_and_the_command_line() {
    let mut faults = Vec::new();
    for source in sources().iter().filter(|source| !["service", "cli"].contains(&source.folder())) {
        for name in SERVICE_CRATES {
            if words_before(&source.code, "::").any(|word| word == name) {
                faults.push(format!("`src/{}` uses `{name}`; only `service` and `cli` may", source.path));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn no_file_is_too_long() {
    let faults: Vec<String> = sources()
        .iter()
        .filter(|source| source.n_lines > MAX_LINES)
        .map(|source| {
            format!("`src/{}` has {} lines, at most {MAX_LINES}: split it by noun", source.path, source.n_lines)
        })
        .collect();
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn the_reader_of_imports_sees_what_it_should() {
    let source = |path: &str, text: &str| Source { path: path.to_owned(), code: code_of(text), n_lines: 0 };
    let heads = |source: Source| imported_paths(&source).iter().map(|path| path.join("::")).collect::<Vec<_>>();
    let text = "use crate::{body::skeleton, session::{Session, View}};\nlet x = crate::geometry::rotation::exp(w);";
    assert_eq!(heads(source("optim/a.rs", text)), ["body::skeleton", "session", "geometry::rotation::exp"]);
    assert_eq!(
        heads(source("pipeline/stages/body_fit/a.rs", "use super::super::denoising;")),
        ["pipeline::stages::denoising"]
    );
    assert_eq!(
        heads(source("pipeline/fit.rs", "use super::{config, denoising::x};")),
        ["pipeline::config", "pipeline::denoising::x"]
    );
    assert_eq!(heads(source("optim/mod.rs", "// crate::body\n#[cfg(test)]\nmod tests { use crate::body; }")), [""; 0]);
    assert_eq!(heads(source("main.rs", "fn main() { wandless::cli::run() }")), ["cli::run"]);
}

fn quoted(names: &[&str]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(" ")
}

fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    gather(&root, &mut paths);
    paths.sort();
    assert!(paths.len() > 10, "the sources were not found");
    let read = |path: &PathBuf| {
        let text = fs::read_to_string(path).unwrap();
        let parts: Vec<_> = path.strip_prefix(&root).unwrap().iter().map(|part| part.to_string_lossy()).collect();
        Source { path: parts.join("/"), code: code_of(&text), n_lines: text.lines().count() }
    };
    paths.iter().map(read).collect()
}

fn gather(dir: &Path, paths: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        // A folder's tests may look up, as the tests at the end of a file may.
        if path.is_dir() && !path.ends_with("tests") {
            gather(&path, paths);
        } else if path.extension().is_some_and(|e| e == "rs") && !path.ends_with("tests.rs") {
            paths.push(path);
        }
    }
}

/// The text without line comments, up to a test module.
fn code_of(text: &str) -> String {
    let mut code = String::new();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let opens_tests = |next: &&str| next.trim_start().starts_with("mod ") && next.contains('{');
        if line.trim() == "#[cfg(test)]" && lines.peek().is_some_and(opens_tests) {
            break;
        }
        code += line.split("//").next().unwrap_or_default();
        code.push('\n');
    }
    code
}

/// Every path from the root that the file names, as far as it is written out without braces.
fn imported_paths(source: &Source) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    let root = if source.folder() == "main" { "wandless::" } else { "crate::" };
    for (at, _) in source.code.match_indices(root).filter(|(at, _)| starts_word(&source.code, *at)) {
        follow(&source.code[at + root.len()..], Vec::new(), &mut paths);
    }
    for (at, _) in source.code.match_indices("super::").filter(|(at, _)| starts_chain(&source.code, *at)) {
        let mut rest = &source.code[at..];
        let mut module: Vec<String> = source.module().into_iter().map(str::to_owned).collect();
        while let Some(inner) = rest.strip_prefix("super::") {
            module.pop();
            rest = inner;
        }
        follow(rest, module, &mut paths);
    }
    paths
}

/// Follows `a::b::{c, d::e}` behind `prefix`. A group deeper than the first is cut off at its brace.
fn follow(text: &str, prefix: Vec<String>, paths: &mut Vec<Vec<String>>) {
    let Some(group) = text.strip_prefix('{') else {
        let mut path = prefix;
        let mut rest = text;
        loop {
            let word: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            if word.is_empty() {
                break;
            }
            rest = rest[word.len()..].strip_prefix("::").unwrap_or("");
            path.push(word);
        }
        if !path.is_empty() {
            paths.push(path);
        }
        return;
    };
    let mut depth = 0;
    let mut start = 0;
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                follow(group[start..i].trim(), prefix.clone(), paths);
                start = i + 1;
                if c == '}' {
                    return;
                }
            }
            _ => {}
        }
    }
}

fn starts_word(code: &str, at: usize) -> bool {
    !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_')
}

fn starts_chain(code: &str, at: usize) -> bool {
    starts_word(code, at) && !code[..at].ends_with("super::") && !code[..at].ends_with("self::")
}

/// Words directly before `mark`.
fn words_before<'a>(code: &'a str, mark: &'a str) -> impl Iterator<Item = &'a str> {
    code.match_indices(mark).map(|(at, _)| {
        let start = code[..at].rfind(|c: char| !c.is_alphanumeric() && c != '_').map_or(0, |i| i + 1);
        &code[start..at]
    })
}
