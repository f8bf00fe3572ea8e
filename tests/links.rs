//! Links between the pages: every relative link of a Markdown file leads to a file, and to a heading of it where it names one;
//! the book lists every page.

#![allow(clippy::unwrap_used)] // a test may

mod source_tree;

use source_tree::files_below;
use std::fs;
use std::path::{Path, PathBuf};

/// Files and folders with pages.
const PAGES: &[&str] = &["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "docs", "checks", "clients", "assets"];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn pages() -> Vec<PathBuf> {
    let all = PAGES.iter().flat_map(|name| match root().join(name) {
        path if path.is_file() => vec![path],
        path => files_below(&path, "md"),
    });
    all.filter(|path| !path.components().any(|part| part.as_os_str() == "node_modules")).collect()
}

/// Targets of the links of a page, without those inside blocks of code.
fn links(text: &str) -> Vec<&str> {
    let outside = text.split("```").step_by(2);
    let starts = outside.flat_map(|part| part.split("](").skip(1));
    starts
        .filter_map(|rest| rest.split_once(')').map(|(target, _)| target))
        .filter(|target| !target.contains(' '))
        .collect()
}

/// The name by which links address a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.to_lowercase().chars().filter(|c| c.is_alphanumeric() || "-_ ".contains(*c)).collect::<String>();
    kept.trim().replace(' ', "-")
}

fn has_heading(page: &Path, name: &str) -> bool {
    let text = fs::read_to_string(page).unwrap();
    text.lines().filter(|line| line.starts_with('#')).any(|line| anchor(line.trim_start_matches('#')) == name)
}

/// What is wrong with a link of a page; `None` for links to other sites.
fn fault(page: &Path, link: &str) -> Option<String> {
    if link.starts_with("http") || link.starts_with("mailto:") {
        return None;
    }
    let (path, heading) = link.split_once('#').unwrap_or((link, ""));
    let target = if path.is_empty() { page.to_owned() } else { page.parent().unwrap().join(path) };
    let is_page = target.extension().is_some_and(|ending| ending == "md");
    let problem = if !target.exists() {
        "leads nowhere"
    } else if !heading.is_empty() && is_page && !has_heading(&target, heading) {
        "names a heading that does not exist"
    } else {
        return None;
    };
    Some(format!("{}: {link} {problem}", page.display()))
}

#[test]
fn links_between_pages_lead_somewhere() {
    let pages = pages();
    assert!(pages.len() > 20, "the pages were not found");
    let faults: Vec<String> = pages
        .iter()
        .flat_map(|page| {
            let text = fs::read_to_string(page).unwrap();
            links(&text).into_iter().filter_map(|link| fault(page, link)).collect::<Vec<_>>()
        })
        .collect();
    assert!(faults.is_empty(), "\n{}", faults.join("\n"));
}

#[test]
fn the_book_lists_every_page() {
    let summary = fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    let listed = links(&summary);
    let missing: Vec<String> = files_below(&root().join("docs"), "md")
        .iter()
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .filter(|name| name != "SUMMARY.md" && !listed.contains(&name.as_str()))
        .collect();
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn sees_links_that_lead_nowhere() {
    let page = root().join("README.md");
    for (link, is_wrong) in [
        ("docs/videos.md", false),
        ("docs/nothing.md", true),
        ("docs/options.md#nothing", true),
        ("#quickstart", false),
        ("#nothing", true),
        ("https://example.org", false),
    ] {
        assert_eq!(fault(&page, link).is_some(), is_wrong, "{link}");
    }
    assert_eq!(links("[a](b.md) ```[c](d.md)``` [e](f g) ![h](i.png)"), ["b.md", "i.png"]);
    assert_eq!(anchor(" Actions of `corrections`"), "actions-of-corrections");
}
