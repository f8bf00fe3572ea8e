//! Workers: each claims a job, runs it in a supervised child process of this program, and records the outcome.

mod heart;
mod supervision;

use super::child::Child;
use super::failpoint::{OPTION_OF_NEXT_RELEASE, failpoint, fault, is_next_release};
use super::memory;
use super::metrics::Metrics;
use super::protocol::{JobTask, Order, RUN_JOB};
use super::queue::class::OUT_OF_MEMORY;
use super::queue::job::JobError;
use super::queue::outcome::ClaimOutcome;
use super::queue::{Claim, Finished, Phase, Published, Queue};
use super::settings::Settings;
use super::shared::Shared;
use super::store::blobs::local::LocalResult;
use super::store::folders::publish;
use super::store::summary::Summary;
use super::store::{Store, StoreError, artifacts};
use crate::export::CONTINUATION;
use crate::pipeline::Options;
use anyhow::Context;
use rustix::process::Signal;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;
use supervision::{ChildExit, Crash, supervise};
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

/// Wait before another try after a failure of the system or the disk.
const RETRY_INTERVAL: Duration = Duration::from_secs(2);

/// Wait before another claim where the database was busy, with a row that another process holds, for example.
const BUSY_INTERVAL: Duration = Duration::from_millis(300);

/// Tries to record an outcome while the service stops.
const MAX_TRIES_WHILE_STOPPING: usize = 3;

/// Claims and runs jobs one after the other until `draining` is canceled; the running job then returns to the queue.
pub(super) async fn run(shared: Shared) {
    let Shared { store, queue, settings, metrics, draining, .. } = shared;
    while !draining.is_cancelled() {
        match queue.claim(settings.tenants.max_running).await {
            Ok(Some(claim)) => {
                metrics.note_heartbeat(&claim.job);
                let span = span(&claim);
                let _heart = heart::beating(&store, &queue, &claim, settings.worker.beat);
                let run = async {
                    let outcome = run_claim(&store, &queue, &settings, &metrics, &claim, draining.clone()).await;
                    record(&store, &queue, &settings, &claim, outcome, &draining).await
                };
                metrics.note_end(&claim.job, run.instrument(span).await);
                if store.blobs.are_remote() {
                    store.folders.remove("checkpoints", &claim.job); // another worker may end the job: nothing is missed here
                }
            }
            Ok(None) => tokio::select! {
                () = queue.work() => {}
                () = draining.cancelled() => {}
            },
            Err(error) => {
                tracing::error!(%error, "cannot claim a job; trying again");
                tokio::time::sleep(if error.is_busy() { BUSY_INTERVAL } else { RETRY_INTERVAL }).await;
            }
        }
    }
    queue.wake_next(); // this worker may have consumed a wake-up
}

/// Span of all log lines of a claim, those of its child process included: whose job it is, and the request that submitted
/// it. Its level keeps it at every setting of `WANDLESS_LOG`.
fn span(claim: &Claim) -> tracing::Span {
    tracing::error_span!(
        "job",
        job.id = claim.job,
        fence = claim.fence,
        tenant = claim.tenant,
        key.id = claim.submitter.key,
        request.id = claim.submitter.request,
    )
}

/// Runs the child process of a claim and publishes its result.
async fn run_claim(
    store: &Store,
    queue: &Queue,
    settings: &Settings,
    metrics: &Metrics,
    claim: &Claim,
    draining: CancellationToken,
) -> ClaimOutcome<Published> {
    let session = match store.blobs.session(&claim.session, &claim.session_sha256).await {
        Ok(session) => session,
        Err(error) => return ClaimOutcome::Failed(unreadable(&error)),
    };
    let mut order = match order(store, settings, claim, &session.path) {
        Ok(order) => order,
        Err(error) => return ClaimOutcome::Failed(error),
    };
    // The folders exist as long as this list does: to the end of the claim.
    let earlier = match order.task.options.corrections.is_empty() {
        true => Vec::new(),
        false => earlier_results(store, queue, claim).await,
    };
    order.task.earlier = earlier.iter().map(|result| result.path.clone()).collect();
    store.blobs.fetch_checkpoints(&claim.job).await;
    let kills = memory::group_kills();
    let mut child = match start(settings, queue, claim, &order).await {
        Ok(child) => child,
        Err(error) => {
            tracing::error!(error = format!("{error:#}"), "cannot start the job's process; trying again");
            tokio::time::sleep(RETRY_INTERVAL).await;
            return ClaimOutcome::Released;
        }
    };
    tracing::info!(pid = child.pid(), "job started");
    failpoint("child.started");
    let keeping = heart::keeping_checkpoints(store, claim, settings.worker.beat);
    let exit = supervise(&mut child, queue, &settings.jobs, metrics, claim, draining.clone()).await;
    drop(keeping);
    failpoint("child.ended");
    match exit {
        ChildExit::Crashed(_) if child.ran_out_of_memory() => ClaimOutcome::Failed(out_of_memory(order.memory_bytes)),
        ChildExit::Done => publish_result(store, claim).await,
        ChildExit::Failed(error) => ClaimOutcome::Failed(error),
        ChildExit::Crashed(crash) => crashed(crash, order.memory_bytes, kills),
        ChildExit::Stopped => {
            if draining.is_cancelled() {
                // Another machine goes on after the last finished stage.
                store.blobs.keep_checkpoints(&claim.job, &mut BTreeSet::new()).await;
            }
            ClaimOutcome::Released
        }
    }
}

/// Outcome of a crash. `limit`: of the job's process; `kills`: how often the kernel had ended a process of the control
/// group before the job, because memory ran out.
fn crashed(crash: Crash, limit: Option<u64>, kills: Option<u64>) -> ClaimOutcome<Published> {
    let is_killed = crash.signal == Some(Signal::KILL.as_raw());
    if !is_killed || memory::group_kills() <= kills {
        return ClaimOutcome::Crashed(crash.how);
    }
    match memory::group_limit() {
        // The job alone could fill the group: another attempt would end in the same way.
        Some(group) if limit.is_none_or(|limit| limit >= group) => ClaimOutcome::Failed(out_of_memory(Some(group))),
        _ => ClaimOutcome::Crashed(format!("{}: the memory of the service ran out", crash.how)),
    }
}

fn order(store: &Store, settings: &Settings, claim: &Claim, session: &Path) -> Result<Order<JobTask>, JobError> {
    let mut options = claim.options.clone();
    if let (true, Some(all)) = (is_next_release(), options.as_object_mut()) {
        all.remove(OPTION_OF_NEXT_RELEASE);
    }
    let options: Options = serde_json::from_value(options).map_err(|error| JobError {
        code: "option_unknown".to_owned(),
        detail: format!("this release cannot read the job's options: {error}"),
        remedy: "submit the job again".to_owned(),
        ..JobError::default()
    })?;
    let task = JobTask {
        session: session.to_owned(),
        session_sha256: claim.session_sha256.clone(),
        options,
        earlier: Vec::new(),
        bodies: store.folders.bodies(),
        out: store.folders.staging(&claim.job, claim.fence),
        checkpoints: store.folders.checkpoints(&claim.job),
        threads: settings.jobs.threads,
    };
    Ok(Order::new(task, memory::job_limit(&settings.jobs)))
}

/// Folders of results from which a job with corrections may continue; without one it solves the session from the start.
async fn earlier_results(store: &Store, queue: &Queue, claim: &Claim) -> Vec<LocalResult> {
    let found = async {
        let mut results = Vec::new();
        for (job, fence) in queue.results_of_session(&claim.tenant, &claim.session).await? {
            let mut files = artifacts::list(store, &job).await?;
            files.retain(|file| file.name == CONTINUATION);
            results.push(store.blobs.result(&job, fence, &files).await?);
        }
        Ok::<_, StoreError>(results)
    };
    found.await.unwrap_or_else(|error| {
        tracing::warn!(%error, "cannot look for earlier results; the job solves the session from the start");
        Vec::new()
    })
}

fn out_of_memory(limit: Option<u64>) -> JobError {
    let limit = limit.map_or("the machine has".to_owned(), |bytes| format!("{} MiB", bytes >> 20));
    JobError {
        code: OUT_OF_MEMORY.to_owned(),
        detail: format!("the job needs more memory than {limit}"),
        remedy: "submit a shorter take or fewer cameras, or ask the operator to raise jobs.memory_bytes".to_owned(),
        ..JobError::default()
    }
}

async fn start(settings: &Settings, queue: &Queue, claim: &Claim, order: &Order<JobTask>) -> anyhow::Result<Child> {
    let (out, checkpoints) = (order.task.out.clone(), order.task.checkpoints.clone());
    let create = move || std::fs::create_dir_all(out).and_then(|()| std::fs::create_dir_all(checkpoints));
    tokio::task::spawn_blocking(create).await?.context("result folder")?;
    let (queue, job) = (queue.clone(), claim.job.clone());
    Child::start(&settings.program, RUN_JOB, order, move |line| queue.send_line(&job, line)).await
}

/// Hashes and syncs all files, renames the folder and syncs its parent; `Queue::finish` then writes the rows.
async fn publish_result(store: &Store, claim: &Claim) -> ClaimOutcome<Published> {
    let staging = store.folders.staging(&claim.job, claim.fence);
    let result = store.folders.result(&claim.job, claim.fence);
    let published = tokio::task::spawn_blocking(move || -> anyhow::Result<Published> {
        let artifacts = artifacts::scan(&staging)?;
        let summary = Summary::read(&staging)?;
        failpoint("result.hashed");
        if fault("publish.late") {
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(300));
                publish(&staging, &result)
            });
            return Ok(Published { artifacts, summary });
        }
        publish(&staging, &result)?;
        failpoint("result.published");
        Ok(Published { artifacts, summary })
    })
    .await;
    let published = match published.map_err(anyhow::Error::from).and_then(std::convert::identity) {
        Ok(published) => published,
        Err(error) => return ClaimOutcome::Failed(unpublished(&error)),
    };
    match store.blobs.take_result(&claim.job, claim.fence, &published.artifacts).await {
        Ok(()) => ClaimOutcome::Succeeded(published),
        Err(error @ StoreError::Blobs { .. }) => ClaimOutcome::Failed(JobError::of_object_store(&error.to_string())),
        Err(error) => ClaimOutcome::Failed(unpublished(&error.into())),
    }
}

/// Why the upload of a job cannot be read from its store.
fn unreadable(error: &StoreError) -> JobError {
    let detail = format!("the upload cannot be read: {error}");
    let disk = match error {
        StoreError::Blobs { .. } => return JobError::of_object_store(&detail),
        StoreError::Folder { source, .. } => JobError::of_machine(source, &detail),
        _ => None,
    };
    disk.unwrap_or_else(|| JobError {
        code: "session_damaged".to_owned(),
        detail,
        remedy: "upload the session again".to_owned(),
        ..JobError::default()
    })
}

fn unpublished(error: &anyhow::Error) -> JobError {
    let detail = format!("the result could not be published: {error:#}");
    let cause = error.chain().find_map(|cause| cause.downcast_ref::<std::io::Error>());
    cause.and_then(|cause| JobError::of_machine(cause, &detail)).unwrap_or_else(|| JobError {
        code: "result_unpublished".to_owned(),
        detail,
        remedy: "check the log of the service, then submit the job again".to_owned(),
        ..JobError::default()
    })
}

/// Records the outcome and returns the name of the new state. Tries again until the database accepts it: meanwhile no
/// other job could be claimed, and a restart would run this one again. An outcome whose rows do not fit the tables is
/// recorded as a failure of the job.
async fn record(
    store: &Store,
    queue: &Queue,
    settings: &Settings,
    claim: &Claim,
    mut outcome: ClaimOutcome<Published>,
    draining: &CancellationToken,
) -> &'static str {
    let mut tries_while_stopping = 0;
    loop {
        let error = match queue.finish(claim, &outcome, settings.jobs.max_crashes).await {
            Ok(Finished::Recorded(phase)) => {
                log_end(phase, &outcome);
                return phase.name();
            }
            Ok(Finished::Lost) => {
                tracing::info!("the claim has expired; its result is discarded");
                store.remove_claim(&claim.job, claim.fence).await;
                return "lost";
            }
            Err(error) => error,
        };
        if error.is_of_values() && matches!(outcome, ClaimOutcome::Succeeded(_)) {
            tracing::error!(%error, "the rows of the result cannot be stored");
            outcome = ClaimOutcome::Failed(unrecorded(&error));
            continue;
        }
        if error.is_disk_full() {
            store.release_reserve().await; // the outcome must be recorded even on a full disk
        }
        tries_while_stopping += usize::from(draining.is_cancelled());
        if tries_while_stopping == MAX_TRIES_WHILE_STOPPING {
            // The row stays `running` with this boot id; the next start requeues the job.
            tracing::error!(%error, "cannot record the job's outcome; the next start runs the job again");
            return "unrecorded";
        }
        tracing::error!(%error, "cannot record the job's outcome; trying again");
        tokio::time::sleep(RETRY_INTERVAL).await;
    }
}

fn unrecorded(error: &StoreError) -> JobError {
    JobError {
        code: "result_unrecorded".to_owned(),
        detail: format!("the rows of the result could not be stored: {error}"),
        remedy: "report this error with the log of the service".to_owned(),
        ..JobError::default()
    }
}

/// Logs the new state of the job with its reason.
fn log_end(phase: Phase, outcome: &ClaimOutcome<Published>) {
    let state = phase.name();
    let what = if phase.is_final() { "job ended" } else { "job is queued again" };
    match outcome {
        ClaimOutcome::Failed(_) if !phase.is_final() => {} // `finish` has logged the fault and the wait
        ClaimOutcome::Failed(JobError { code, detail, camera, frame, .. }) => {
            tracing::warn!(state, code, detail, camera, frame, "{what}");
        }
        ClaimOutcome::Crashed(detail) => tracing::warn!(state, code = "child_died", detail, "{what}"),
        ClaimOutcome::Succeeded(_) | ClaimOutcome::Released => tracing::info!(state, "{what}"),
    }
}

#[cfg(test)]
mod tests;
