//! `wandless export`: exports a finished result to further formats.

use super::bad_input::BadInput;
use super::body::read_body;
use super::output_folder::{publish, require_free, staging_folder};
use crate::export::{self, ReadError};
use crate::session::reconstruction::ExportFormat;
use anyhow::Context;
use std::path::PathBuf;

/// Exports the cameras and people of a finished result to further formats.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Result folder of `reconstruct` or of a job
    result: PathBuf,
    /// Formats, separated by commas; `wandless options` lists them under `exports`
    #[arg(long, value_delimiter = ',', required = true, value_parser = format_named)]
    to: Vec<ExportFormat>,
    /// Output folder; must be empty or not exist
    #[arg(long)]
    out: PathBuf,
    /// File of the body model that the result was solved with, whose mesh glb, fbx and usd then show [default: the mesh of the
    /// embedded body, where the result was solved with it]
    #[arg(long)]
    body: Option<PathBuf>,
    /// JSON file that maps face and foot keypoints to vertices of the body model of --body
    #[arg(long, requires = "body")]
    landmarks: Option<PathBuf>,
}

/// Runs the command. Prints file names to standard output and what a format cannot represent to standard error.
///
/// # Errors
/// [`BadInput`] if the folder does not hold a result; otherwise the error of writing.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    require_free(&args.out)?;
    let not_a_result = |error: ReadError| BadInput(format!("{error}; pass the folder of a finished result"));
    let mut take = export::read_take(&args.result).map_err(not_a_result)?;
    if let Some(file) = &args.body {
        let body = read_body(Some(file), args.landmarks.as_deref())?;
        take = take.with_body(body).map_err(|error| BadInput(format!("{}: {error}", file.display())))?;
    }
    let staging = staging_folder(&args.out)?;
    let written = export::write_formats(&staging, &take, &args.to).with_context(|| args.out.display().to_string());
    for representation in publish(&staging, &args.out, written)? {
        for lost in representation.data.lost {
            eprintln!("{}: {lost}", representation.name);
        }
        for file in representation.files {
            println!("{}", args.out.join(file).display());
        }
    }
    Ok(())
}

/// Parses a format name of `options.exports`; the error message lists all names.
fn format_named(name: &str) -> Result<ExportFormat, serde_json::Error> {
    serde_json::from_value(name.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::arguments::arguments_of;

    #[test]
    fn format_names_match_the_export_option() {
        let args: Args = arguments_of(["export", "result", "--to", "glb,opencv_yaml", "--out", "out"]).unwrap();
        assert_eq!(args.to, [ExportFormat::Glb, ExportFormat::OpencvYaml]);
        let error = arguments_of::<Args>(["export", "result", "--to", "mp3", "--out", "out"]).err().unwrap();
        assert!(error.to_string().contains("expected one of `smpl_npz`"), "{error}");
    }

    #[test]
    fn rejects_folder_without_result() {
        let out = tempfile::tempdir().unwrap();
        let (to, out_folder) = (vec![ExportFormat::Glb], out.path().join("out"));
        let args = Args { result: "no/result".into(), to, out: out_folder, body: None, landmarks: None };
        let error = run(args).unwrap_err();
        assert!(error.is::<BadInput>() && error.to_string().contains("no/result"), "{error}");
        assert!(!out.path().join("out").exists());
    }
}
