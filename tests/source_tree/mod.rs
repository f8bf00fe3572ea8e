//! Reads the Rust files below `src/` and the imports between them.

#![allow(dead_code, unreachable_pub)] // each test binary uses its own part, and exports nothing

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// One source file of the library.
pub struct Source {
    /// Path below `src/`, with slashes.
    pub path: String,
    /// The text as it is.
    pub text: String,
    /// Code without comments and without the test module at its end.
    pub code: String,
}

/// One path that a file names, from the crate's root on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Import {
    pub path: Vec<String>,
    /// The name under which a `pub use` offers it again.
    pub reexported_as: Option<String>,
}

impl Source {
    /// `code` is what `code_of` leaves of `text`.
    pub fn new(path: &str, text: &str) -> Self {
        Self { path: path.to_owned(), text: text.to_owned(), code: code_of(text) }
    }

    /// `geometry` for `geometry/camera.rs`, `progress` for `progress.rs`.
    pub fn folder(&self) -> &str {
        let first = self.path.split('/').next().unwrap_or_default();
        first.strip_suffix(".rs").unwrap_or(first)
    }

    /// The module path: `["session", "upload"]` for `session/upload.rs` and `session/upload/mod.rs`.
    pub fn module(&self) -> Vec<String> {
        let path = self.path.trim_end_matches(".rs");
        path.split('/').filter(|part| !["mod", "lib", "main"].contains(part)).map(str::to_owned).collect()
    }

    /// Every path of this crate that the file names, with the groups of `use` written out.
    pub fn imports(&self) -> Vec<Import> {
        let mut imports = Vec::new();
        let mut rest = self.code.as_str();
        let mut expressions = String::new();
        while let Some((before, statement, after)) = next_use(rest) {
            expressions += before;
            let is_public = before.trim_end().rsplit([';', '}', '{']).next().is_some_and(|head| head.contains("pub"));
            for (path, alias) in use_tree(statement) {
                if let Some(path) = self.rooted(&path) {
                    let name = alias.or_else(|| path.last().cloned());
                    imports.push(Import { path, reexported_as: name.filter(|_| is_public) });
                }
            }
            rest = after;
        }
        expressions += rest;
        for path in inline_paths(&expressions) {
            if let Some(path) = self.rooted(&path) {
                imports.push(Import { path, reexported_as: None });
            }
        }
        imports
    }

    /// Names of the modules that the file declares.
    fn children(&self) -> BTreeSet<&str> {
        self.code
            .split(';')
            .filter_map(|s| s.split_whitespace().rev().take(2).collect::<Vec<_>>().try_into().ok())
            .filter_map(|[name, keyword]: [&str; 2]| (keyword == "mod").then_some(name))
            .collect()
    }

    /// A written path as a path from the crate's root; `None` for paths into other crates.
    fn rooted(&self, written: &[String]) -> Option<Vec<String>> {
        let mut module = self.module();
        let first = written.first()?.as_str();
        let rest = match first {
            "crate" => return Some(written[1..].to_vec()),
            "wandless" if self.path == "main.rs" => return Some(written[1..].to_vec()),
            "self" => &written[1..],
            "super" => {
                let n = written.iter().take_while(|word| *word == "super").count();
                module.truncate(module.len().saturating_sub(n));
                &written[n..]
            }
            child if self.children().contains(child) => written,
            _ => return None,
        };
        module.extend(rest.iter().cloned());
        Some(module)
    }
}

/// The library's files and what they import of each other.
pub struct Tree {
    pub sources: Vec<Source>,
    imports: Vec<Vec<Import>>,
    file_of_module: BTreeMap<Vec<String>, usize>,
}

impl Tree {
    /// Reads `src/`.
    pub fn read() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let paths = files_below(&root, "rs");
        assert!(paths.len() > 10, "no sources found below {}", root.display());
        let is_test = |path: &Path| path.iter().any(|part| part.to_string_lossy().starts_with("tests"));
        let read = |path: &PathBuf| {
            let parts: Vec<_> = path.strip_prefix(&root).unwrap().iter().map(|part| part.to_string_lossy()).collect();
            Source::new(&parts.join("/"), &fs::read_to_string(path).unwrap())
        };
        Self::of(paths.iter().filter(|path| !is_test(path)).map(read).collect())
    }

    pub fn of(sources: Vec<Source>) -> Self {
        let file_of_module = sources.iter().enumerate().map(|(i, source)| (source.module(), i)).collect();
        let imports = sources.iter().map(Source::imports).collect();
        Self { sources, imports, file_of_module }
    }

    /// The file that defines what `path` names: the longest module in it, followed through re-exports.
    pub fn file_of(&self, path: &[String]) -> Option<usize> {
        self.resolve(path, 8)
    }

    fn resolve(&self, path: &[String], depth: usize) -> Option<usize> {
        let n = (1..=path.len()).rev().find(|n| self.file_of_module.contains_key(&path[..*n]))?;
        let file = self.file_of_module[&path[..n]];
        let Some(name) = path.get(n).filter(|_| depth > 0) else { return Some(file) };
        let behind = self.imports[file].iter().find(|import| import.reexported_as.as_ref() == Some(name));
        behind.and_then(|import| self.resolve(&import.path, depth - 1)).or(Some(file))
    }

    /// By file, the other files that it imports from.
    pub fn edges(&self) -> Vec<BTreeSet<usize>> {
        let targets = |(i, imports): (usize, &Vec<Import>)| {
            imports
                .iter()
                .filter(|import| import.reexported_as.is_none())
                .filter_map(|import| self.file_of(&import.path))
                .filter(|j| *j != i)
                .collect()
        };
        self.imports.iter().enumerate().map(targets).collect()
    }
}

/// Files below `dir` whose names end with `.extension`, sorted.
pub fn files_below(dir: &Path, extension: &str) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(files_below(&path, extension));
        } else if path.extension().is_some_and(|e| e == extension) {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// The text without line comments, up to a test module.
fn code_of(text: &str) -> String {
    let mut code = String::new();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let opens_tests = |next: &&str| next.trim_start().starts_with("mod ") && next.contains('{');
        if line.trim() == "#[cfg(test)]" {
            if lines.peek().is_some_and(opens_tests) {
                break;
            }
            lines.next(); // a test module in a file of its own, or an item for tests
            continue;
        }
        let line = line.split("//").next().unwrap_or_default();
        // The path in `pub(in crate::a)` limits a name's visibility and imports nothing.
        let (before, after) = line
            .split_once("pub(in ")
            .map_or((line, ""), |(before, rest)| (before, rest.split_once(')').map_or("", |(_, after)| after)));
        code += before;
        code += after;
        code.push('\n');
    }
    code
}

/// What stands before the next `use` statement, the statement's tree, and what follows.
fn next_use(code: &str) -> Option<(&str, &str, &str)> {
    let starts = |at: &usize| {
        let before = code[..*at].trim_end_matches([' ', '\t']);
        before.is_empty() || before.ends_with(['\n', '{', '}', ';', ')']) || before.ends_with("pub")
    };
    let at = code.match_indices("use ").map(|(at, _)| at).find(starts)?;
    let end = at + code[at..].find(';')?;
    Some((&code[..at], &code[at + 4..end], &code[end + 1..]))
}

/// `a::{b, c::d as e}` as `a::b` and `a::c::d` with its alias.
fn use_tree(text: &str) -> Vec<(Vec<String>, Option<String>)> {
    let text = text.trim();
    let head = text.find('{').unwrap_or(text.len());
    let words = |text: &str| -> Vec<String> {
        text.split("::").map(str::trim).filter(|word| !word.is_empty()).map(str::to_owned).collect()
    };
    if head == text.len() {
        let (path, alias) = match text.split_once(" as ") {
            Some((path, alias)) => (path, Some(alias.trim().to_owned())),
            None => (text, None),
        };
        let mut path = words(path);
        if path.last().is_some_and(|word| word == "self" || word == "*") {
            path.pop();
        }
        return vec![(path, alias)];
    }
    let prefix = words(&text[..head]);
    // Text that only looks like a statement, in a string for instance, has no closing brace.
    let Some(inner) = text.rfind('}').and_then(|end| text.get(head + 1..end)) else { return Vec::new() };
    let (mut depth, mut start, mut parts) = (0, 0, Vec::new());
    for (i, c) in inner.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&inner[start..i]);
                start = i + 1;
            }
            _ => {}
        }
    }
    parts.push(&inner[start..]);
    let joined = |(path, alias): (Vec<String>, Option<String>)| ([prefix.clone(), path].concat(), alias);
    parts.iter().filter(|part| !part.trim().is_empty()).flat_map(|part| use_tree(part)).map(joined).collect()
}

/// Paths with `::` inside expressions and types.
fn inline_paths(code: &str) -> Vec<Vec<String>> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut paths = Vec::new();
    let mut rest = code;
    while let Some(at) = rest.find(is_word) {
        let mut path = Vec::new();
        let mut tail = &rest[at..];
        loop {
            let end = tail.find(|c| !is_word(c)).unwrap_or(tail.len());
            path.push(tail[..end].to_owned());
            tail = &tail[end..];
            match tail.strip_prefix("::") {
                Some(next) if next.starts_with(is_word) => tail = next,
                _ => break,
            }
        }
        if path.len() > 1 {
            paths.push(path);
        }
        rest = tail;
    }
    paths
}
