//! The import rules of `src/`: lower folders never import higher ones, no two files import each other in a ring, and no
//! stage of the pipeline imports another stage.
//!
//! Code above a file's `#[cfg(test)]` module counts; tests may import from anywhere. A change that adds an import between
//! folders edits the table here and in ARCHITECTURE.md, and states the reason.

#![allow(clippy::unwrap_used)] // a test may

mod source_tree;

use source_tree::{Source, Tree};
use std::collections::BTreeSet;

/// Folder (or file) of `src/` and the others that it may import.
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
    ("export", &["formats", "session", "body", "geometry"]),
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
            "service", "pipeline", "simulation", "evaluation", "export", "matching", "estimation", "residuals",
            "motion_prior", "session", "geometry", "optim", "body", "progress",
        ],
    ),
    ("main", &["cli"]),
    // Re-exports what most programs need.
    ("prelude", &["pipeline", "export", "session", "body", "geometry", "progress"]),
    // The crate's root declares every folder and imports none.
    ("lib", &[]),
];

/// A longer file holds more than one noun.
const MAX_LINES: usize = 500;
/// Crates that speak HTTP or SQL.
const SERVICE_CRATES: [&str; 4] = ["axum", "tokio", "sqlx", "ureq"];

#[test]
fn lower_folders_import_no_higher_ones() {
    let mut faults = Vec::new();
    for source in Tree::read().sources {
        let Some((_, allowed)) = TABLE.iter().find(|(folder, _)| *folder == source.folder()) else {
            faults.push(format!("`src/{}` belongs to no folder of the table", source.path));
            continue;
        };
        let folders: BTreeSet<String> =
            source.imports().into_iter().filter_map(|import| import.path.into_iter().next()).collect();
        for target in folders.iter().map(String::as_str) {
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
    let tree = Tree::read();
    let stage_of = |module: &[String]| match module {
        [pipeline, stages, stage, ..] if pipeline == "pipeline" && stages == "stages" => Some(stage.clone()),
        _ => None,
    };
    let stages: BTreeSet<String> = tree.sources.iter().filter_map(|source| stage_of(&source.module())).collect();
    assert!(stages.len() > 3, "the stages were not found");
    let mut faults = Vec::new();
    for (source, targets) in tree.sources.iter().zip(tree.edges()) {
        let Some(own) = stage_of(&source.module()) else { continue };
        for target in targets.into_iter().map(|target| &tree.sources[target]) {
            if stage_of(&target.module()).is_some_and(|other| other != own) {
                faults.push(format!("`src/{}` of the stage `{own}` imports `src/{}`", source.path, target.path));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn no_files_import_each_other_in_a_ring() {
    let tree = Tree::read();
    let rings = rings(&tree.edges());
    let named =
        |ring: &Vec<usize>| ring.iter().map(|file| tree.sources[*file].path.as_str()).collect::<Vec<_>>().join(", ");
    assert!(rings.is_empty(), "{} rings\n{}", rings.len(), rings.iter().map(named).collect::<Vec<_>>().join("\n"));
}

#[test]
fn only_service_and_command_line_use_http_and_sql() {
    let mut faults = Vec::new();
    for source in Tree::read().sources.iter().filter(|source| !["service", "cli"].contains(&source.folder())) {
        for name in SERVICE_CRATES {
            if source
                .code
                .split(|c: char| !c.is_alphanumeric() && c != '_' && c != ':')
                .any(|w| w.starts_with(&format!("{name}::")))
            {
                faults.push(format!("`src/{}` uses `{name}`; only `service` and `cli` may", source.path));
            }
        }
    }
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn no_file_is_too_long() {
    let faults: Vec<String> = Tree::read()
        .sources
        .iter()
        .map(|source| (&source.path, source.text.lines().count()))
        .filter(|(_, n_lines)| *n_lines > MAX_LINES)
        .map(|(path, n_lines)| format!("`src/{path}` has {n_lines} lines, at most {MAX_LINES}: split it by noun"))
        .collect();
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn reads_every_form_of_import() {
    let paths = |path: &str, text: &str| {
        Source::new(path, text).imports().iter().map(|import| import.path.join("::")).collect::<Vec<_>>()
    };
    let text = "use crate::{body::skeleton, session::{Session, view::View as V}};\nlet x = crate::geometry::exp(w);";
    assert_eq!(
        paths("optim/a.rs", text),
        ["body::skeleton", "session::Session", "session::view::View", "geometry::exp"]
    );
    assert_eq!(paths("pipeline/a/b.rs", "use super::super::config;"), ["pipeline::config"]);
    assert_eq!(paths("pipeline/a.rs", "use super::{config, c::x};"), ["pipeline::config", "pipeline::c::x"]);
    assert_eq!(paths("optim/mod.rs", "mod arrow;\npub use arrow::Arrow;"), ["optim::arrow::Arrow"]);
    assert_eq!(paths("optim/mod.rs", "// crate::body\n#[cfg(test)]\nmod tests { use crate::body; }"), [""; 0]);
    assert_eq!(paths("main.rs", "fn main() { wandless::cli::run() }"), ["cli::run"]);
}

#[test]
fn follows_re_exports_and_finds_rings() {
    let tree = Tree::of(vec![
        Source::new("a/mod.rs", "mod b;\nmod c;\npub use b::B;\npub struct A;"),
        Source::new("a/b.rs", "use crate::a::c::C;"),
        Source::new("a/c.rs", "use super::B;"),
        Source::new("d.rs", "use crate::a::B;"),
    ]);
    assert_eq!(rings(&tree.edges()), [vec![1, 2]]);
    assert_eq!(tree.edges()[3], BTreeSet::from([1]));
}

/// Groups of files that reach each other (strongly connected components of two or more).
fn rings(edges: &[BTreeSet<usize>]) -> Vec<Vec<usize>> {
    let reach = |start: usize| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![start]);
        while let Some(file) = open.pop() {
            open.extend(edges[file].iter().filter(|next| seen.insert(**next)));
        }
        seen
    };
    let reached: Vec<BTreeSet<usize>> = (0..edges.len()).map(reach).collect();
    let ring_of = |i: usize| (0..edges.len()).filter(|j| reached[i].contains(j) && reached[*j].contains(&i)).collect();
    let all: BTreeSet<Vec<usize>> =
        (0..edges.len()).map(ring_of).filter(|ring: &Vec<usize>| !ring.is_empty()).collect();
    all.into_iter().collect()
}

fn quoted(names: &[&str]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(" ")
}
