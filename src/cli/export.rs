//! `wandless export`: one more format from a finished result.

use super::BadInput;
use super::reconstruct::{require_free, staging_folder};
use crate::export::{self, ReadError};
use crate::session::reconstruction::ExportFormat;
use anyhow::Context;
use std::path::PathBuf;

/// Writes the cameras and people of a finished result in further formats.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Result folder, as `reconstruct` and a job leave it
    result: PathBuf,
    /// Format; several are separated by commas
    #[arg(long, value_delimiter = ',', required = true, value_parser = format_named)]
    to: Vec<ExportFormat>,
    /// Folder for the files; must not exist, or be empty
    #[arg(long)]
    out: PathBuf,
}

/// Runs the command. What a format cannot hold goes to standard error, the files' names to standard output.
///
/// # Errors
/// [`BadInput`] where the folder is no result; whatever writing fails with.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    require_free(&args.out)?;
    let take = export::read_take(&args.result).map_err(explain)?;
    let staging = staging_folder(&args.out)?;
    let written = export::write_formats(&staging, &take, &args.to);
    if written.is_err() {
        let _ = std::fs::remove_dir_all(&staging); // half an export helps nobody
    }
    let written = written.with_context(|| args.out.display().to_string())?;
    std::fs::rename(&staging, &args.out).with_context(|| args.out.display().to_string())?;
    for representation in written {
        for lost in representation.data.lost {
            eprintln!("{}: {lost}", representation.name);
        }
        for file in representation.files {
            println!("{}", args.out.join(file).display());
        }
    }
    Ok(())
}

/// A format by its name in `options.exports`; the message names them all.
fn format_named(name: &str) -> Result<ExportFormat, serde_json::Error> {
    serde_json::from_value(name.into())
}

fn explain(error: ReadError) -> anyhow::Error {
    BadInput(format!("{error}; name the folder of a finished result")).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn formats_have_the_names_of_the_options() {
        let line = Line::try_parse_from(["export", "result", "--to", "glb,opencv_yaml", "--out", "out"]).unwrap();
        assert_eq!(line.args.to, [ExportFormat::Glb, ExportFormat::OpencvYaml]);
        let error = Line::try_parse_from(["export", "result", "--to", "fbx", "--out", "out"]).err().unwrap();
        assert!(error.to_string().contains("expected one of `smpl_npz`"), "{error}");
    }

    #[test]
    fn a_folder_that_is_no_result_is_named() {
        let out = tempfile::tempdir().unwrap();
        let args = Args { result: "no/result".into(), to: vec![ExportFormat::Glb], out: out.path().join("out") };
        let error = run(args).unwrap_err();
        assert!(error.is::<BadInput>() && error.to_string().contains("no/result"), "{error}");
        assert!(!out.path().join("out").exists());
    }
}
