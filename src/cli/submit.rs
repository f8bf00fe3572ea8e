//! `wandless submit`: uploads a session, follows its job and downloads the result.

use super::bad_input::BadInput;
use super::client::{Client, JobAnswer, WAIT_S, server_url};
use super::option_flags::OptionArgs;
use super::output_folder::{publish, require_free, staging_folder};
use super::progress_display::ProgressDisplay;
use super::solve::ignored_poses;
use super::summary::Summary;
use crate::pipeline::Options;
use anyhow::{Context, bail};
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Component, Path, PathBuf};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// Arguments of `submit`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Session: a folder, a zip file or a JSON document
    session: PathBuf,
    /// URL of the service
    #[arg(long, default_value = "http://127.0.0.1:8700", value_parser = server_url)]
    server: String,
    /// API key; an environment variable is not shown in the list of processes, unlike an argument
    #[arg(long, env = "WANDLESS_KEY", hide_env_values = true)]
    key: Option<String>,
    /// Result folder; must be empty or not exist. Without it the result is not downloaded
    #[arg(long)]
    out: Option<PathBuf>,
    #[command(flatten)]
    options: OptionArgs,
}

/// Runs the command.
///
/// # Errors
/// [`BadInput`] for an unusable session or option; [`RejectedResult`](super::summary::RejectedResult) after the download, if
/// the verdict is `reject`.
pub(super) fn run(args: Args) -> anyhow::Result<()> {
    let options = args.options.read()?;
    if let Some(out) = &args.out {
        require_free(out)?;
    }
    let client = Client::new(&args.server, args.key.as_deref());
    let job = submit(&client, &args.session, &options)?;
    if let Some(out) = &args.out {
        download(&client, &job.id, out)?;
    }
    let summary =
        Summary::of_documents(&client.result_file(&job.id, "report")?, &client.result_file(&job.id, "cameras")?)?;
    print!("{summary}");
    println!("job: {0}/v1/jobs/{1}; to look at it: {0}/#/jobs/{1}", client.server(), job.id);
    if let Some(out) = &args.out {
        println!("result: {}", out.display());
    }
    summary.accepted()
}

/// Uploads a session, creates its job and waits until the job has succeeded.
pub(super) fn submit(client: &Client, session: &Path, options: &Options) -> anyhow::Result<JobAnswer> {
    follow(client, submit_job(client, session, options)?)
}

/// Uploads a session and creates its job.
pub(super) fn submit_job(client: &Client, session: &Path, options: &Options) -> anyhow::Result<JobAnswer> {
    let remedy = "give a session folder, a zip of it, or a JSON document";
    let unreadable = |error: anyhow::Error| BadInput(format!("{}: {error:#}; {remedy}", session.display()));
    let upload = open(session).map_err(unreadable)?;
    let stored = client.upload(&upload.file, upload.media_type)?;
    for warning in stored.warnings.iter().cloned().chain(ignored_poses(options, &stored.camera_facts)) {
        eprintln!("warning: {warning}");
    }
    client.create_job(&stored.id, &serde_json::to_value(options)?)
}

/// Shows the progress of the job until it ends.
fn follow(client: &Client, mut job: JobAnswer) -> anyhow::Result<JobAnswer> {
    let display = ProgressDisplay::new();
    while !job.is_final() {
        let stage = match job.progress.stage.as_str() {
            "" => &job.state, // the job has not reported a stage yet
            stage => stage,
        };
        display.show(stage, job.progress.fraction, &job.progress.message);
        job = client.wait_for_job(&job.id, WAIT_S)?;
    }
    display.finish();
    match (job.state.as_str(), &job.error) {
        ("succeeded", _) => Ok(job),
        (state, Some(error)) => bail!("job {} {state}: {error}", job.id),
        (state, None) => bail!("job {} {state}", job.id),
    }
}

/// Downloads every file of a result and checks its digest. `out` is created only when it is complete.
pub(super) fn download(client: &Client, job: &str, out: &Path) -> anyhow::Result<()> {
    let staging = staging_folder(out)?;
    let fetch = |name: &str, sha256: Option<&str>| -> anyhow::Result<()> {
        if !Path::new(name).components().all(|part| matches!(part, Component::Normal(_))) {
            bail!("{name:?}: the service names a file outside the result folder");
        }
        let path = staging.join(name);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        client.download(job, name, sha256, &path)
    };
    let fetch_all = || {
        for file in client.manifest(job)?.files {
            fetch(&file.name, Some(&file.sha256))?;
        }
        fetch("manifest.json", None)
    };
    publish(&staging, out, fetch_all())
}

/// A session in the form in which it is uploaded.
struct Upload {
    file: File,
    media_type: &'static str,
}

fn open(session: &Path) -> anyhow::Result<Upload> {
    if session.is_dir() {
        return Ok(Upload { file: zipped(session)?, media_type: "application/zip" });
    }
    let mut file = File::open(session)?;
    let mut start = [0; 2];
    let is_zip = file.read(&mut start)? == 2 && &start == b"PK";
    file.rewind()?;
    let media_type = if is_zip { "application/zip" } else { "application/json" };
    Ok(Upload { file, media_type })
}

/// Packs a session folder into a zip in an unnamed temporary file. Ground truth (`gt/`) is not included. Members have a
/// fixed order and time, so that the same folder always gives the same bytes.
fn zipped(folder: &Path) -> anyhow::Result<File> {
    let name = std::env::temp_dir().join(format!("wandless-{}.zip", uuid::Uuid::new_v4()));
    let file = File::options().read(true).write(true).create_new(true).open(&name)?;
    std::fs::remove_file(&name)?; // the file exists until its handle is closed
    let mut members = Vec::new();
    collect(folder, "", &mut members)?;
    members.sort();
    let mut zip = ZipWriter::new(file);
    let options = SimpleFileOptions::default().last_modified_time(zip::DateTime::default()).large_file(true);
    for member in members {
        zip.start_file(member.as_str(), options)?;
        std::io::copy(&mut File::open(folder.join(&member))?, &mut zip)?;
    }
    let mut file = zip.finish()?;
    file.rewind()?;
    Ok(file)
}

/// Lists the files of `folder` below `prefix`, without hidden files and ground truth.
fn collect(folder: &Path, prefix: &str, members: &mut Vec<String>) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(folder.join(prefix))? {
        let entry = entry?;
        let file_name = entry.file_name();
        let name = file_name.to_str().with_context(|| format!("{}: the name is not UTF-8", entry.path().display()))?;
        let is_truth = prefix.is_empty() && name == "gt";
        if is_truth || name.starts_with('.') {
            continue;
        }
        let name = format!("{prefix}{name}");
        if entry.path().is_dir() {
            collect(folder, &format!("{name}/"), members)?;
        } else {
            members.push(name);
        }
    }
    Ok(())
}
