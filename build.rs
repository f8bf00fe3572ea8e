//! Builds the web viewer and lists its files for `src/service/http/viewer.rs`.
//!
//! `web/` is copied to `OUT_DIR`, `npm ci` installs its packages there, and Vite builds the page. If Node.js is missing or
//! the packages cannot be installed, the list is empty, cargo prints a warning, and the service serves a plain page.
//! `WANDLESS_VIEWER=skip` leaves the viewer out. The script runs again only if a source in `web/` or that variable changes.

use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

/// Sources of the viewer.
const SOURCES: [&str; 7] =
    ["package.json", "package-lock.json", ".npmrc", "tsconfig.json", "vite.config.ts", "index.html", "src"];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=WANDLESS_VIEWER");
    let web = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("web");
    for source in SOURCES {
        println!("cargo:rerun-if-changed={}", web.join(source).display());
    }
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let is_wanted =
        env::var_os("CARGO_FEATURE_SERVICE").is_some() && env::var("WANDLESS_VIEWER").as_deref() != Ok("skip");
    let page = if is_wanted { built_page(&web, &out) } else { None };
    fs::write(out.join("viewer_assets.rs"), list_of_assets(page.as_deref())?)?;
    Ok(())
}

/// Builds the page and returns its folder; `None`, with a warning, if the build fails.
fn built_page(web: &Path, out: &Path) -> Option<PathBuf> {
    match build(web, &out.join("web")) {
        Ok(page) => Some(page),
        Err(error) => {
            println!("cargo:warning=the web viewer could not be built, a plain page is served instead: {error}");
            None
        }
    }
}

fn build(web: &Path, work: &Path) -> Result<PathBuf, Box<dyn Error>> {
    if Command::new("node").arg("--version").output().is_err() {
        return Err("Node.js is not installed".into());
    }
    let lock = "package-lock.json";
    let has_packages = fs::read(work.join("installed.json")).ok() == Some(fs::read(web.join(lock))?);
    for source in SOURCES {
        copy(&web.join(source), &work.join(source))?;
    }
    if !has_packages {
        run(work, "npm", &["ci", "--omit=dev", "--no-audit", "--no-fund", "--prefer-offline", "--fetch-retries=0"])?;
        fs::copy(web.join(lock), work.join("installed.json"))?;
    }
    run(work, "node", &["node_modules/vite/bin/vite.js", "build"])?;
    Ok(work.join("dist"))
}

/// Copies a file or a folder; an existing folder is replaced.
fn copy(from: &Path, to: &Path) -> std::io::Result<()> {
    if !from.is_dir() {
        fs::create_dir_all(to.parent().unwrap_or(to))?;
        fs::copy(from, to)?;
        return Ok(());
    }
    if to.exists() {
        fs::remove_dir_all(to)?;
    }
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        copy(&entry.path(), &to.join(entry.file_name()))?;
    }
    Ok(())
}

fn run(dir: &Path, program: &str, arguments: &[&str]) -> Result<(), Box<dyn Error>> {
    let output = Command::new(program).args(arguments).current_dir(dir).output()?;
    if output.status.success() {
        return Ok(());
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let reason = text.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("no error message").to_owned();
    Err(format!("`{program} {}` failed: {reason}", arguments.join(" ")).into())
}

/// Rust source of the slice of embedded files, sorted by name.
fn list_of_assets(page: Option<&Path>) -> Result<String, Box<dyn Error>> {
    let mut paths = Vec::new();
    if let Some(page) = page {
        collect_files(page, &mut paths)?;
        paths.sort();
    }
    let mut source = String::from("&[\n");
    for path in paths {
        let name = path.strip_prefix(page.unwrap_or(&path))?.to_str().ok_or("a file name is not UTF-8")?.to_owned();
        writeln!(source, "    Asset {{ name: {name:?}, bytes: include_bytes!({path:?}) }},")?;
    }
    source.push_str("]\n");
    Ok(source)
}

fn collect_files(dir: &Path, paths: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        if path.is_dir() { collect_files(&path, paths)? } else { paths.push(path) }
    }
    Ok(())
}
