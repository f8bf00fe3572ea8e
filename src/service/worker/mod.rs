//! One claimed job -> one child process of this binary, supervised -> one recorded end.

mod child;
mod supervision;

use super::Shared;
use super::failpoint::{failpoint, fault};
use super::memory::child_limit;
use super::metrics::Metrics;
use super::protocol::Order;
use super::queue::job::{Ending, JobError};
use super::queue::{Claim, Finished, Published, Queue};
use super::settings::Settings;
use super::store::folders::publish;
use super::store::summary::Summary;
use super::store::{Store, artifacts};
use crate::pipeline::Options;
use anyhow::Context;
use child::Child;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Between two tries where the system or the disk refuses.
const RETRY: Duration = Duration::from_secs(2);

/// Claims and runs jobs one after the other until `draining` says stop; the job at work then goes back to the queue.
pub(super) async fn run(shared: Shared) {
    let Shared { store, queue, settings, metrics, draining } = shared;
    while !draining.is_cancelled() {
        match queue.claim(settings.tenants.max_running).await {
            Ok(Some(claim)) => {
                metrics.note_pulse(&claim.job);
                let ending = work_on(&store, &queue, &settings, &metrics, &claim, draining.clone()).await;
                let state = record(&store, &queue, &settings, &claim, ending).await;
                metrics.note_end(&claim.job, state);
            }
            Ok(None) => tokio::select! {
                () = queue.work() => {}
                () = draining.cancelled() => {}
            },
            Err(error) => {
                tracing::error!(%error, "no job could be claimed");
                tokio::time::sleep(RETRY).await;
            }
        }
    }
    queue.wake_next(); // the wake-up this worker may have swallowed
}

async fn work_on(
    store: &Store,
    queue: &Queue,
    settings: &Settings,
    metrics: &Metrics,
    claim: &Claim,
    draining: CancellationToken,
) -> Ending<Published> {
    let order = match order(store, settings, claim) {
        Ok(order) => order,
        Err(error) => return Ending::Failed(error),
    };
    let mut child = match start(settings, queue, claim, &order).await {
        Ok(child) => child,
        Err(error) => {
            tracing::error!(job.id = %claim.job, error = format!("{error:#}"), "the job's process could not be started");
            tokio::time::sleep(RETRY).await;
            return Ending::Released;
        }
    };
    tracing::info!(job.id = %claim.job, fence = claim.fence, pid = child.pid(), "job started");
    failpoint("child.started");
    let outcome = supervision::supervise(&mut child, queue, &settings.jobs, metrics, claim, draining).await;
    failpoint("child.ended");
    match outcome {
        supervision::Outcome::Died(_) if child.ran_out_of_memory() => Ending::Failed(out_of_memory(&order)),
        supervision::Outcome::Done => publish_result(store, claim).await,
        supervision::Outcome::Failed(error) => Ending::Failed(error),
        supervision::Outcome::Died(how) => Ending::ChildDied(how),
        supervision::Outcome::Stopped => Ending::Released,
    }
}

fn order(store: &Store, settings: &Settings, claim: &Claim) -> Result<Order, JobError> {
    let options: Options = serde_json::from_value(claim.options.clone()).map_err(|error| JobError {
        code: "option_unknown".to_owned(),
        detail: format!("this release does not know the job's options: {error}"),
        remedy: "submit the job again".to_owned(),
        ..JobError::default()
    })?;
    Ok(Order {
        session: store.folders.session(&claim.session),
        session_sha256: claim.session_sha256.clone(),
        options,
        bodies: store.folders.bodies(),
        out: store.folders.staging(&claim.job, claim.fence),
        checkpoints: store.folders.checkpoints(&claim.job),
        threads: settings.jobs.threads,
        memory_bytes: child_limit(&settings.jobs),
        parent: rustix::process::getpid().as_raw_nonzero().get(),
    })
}

fn out_of_memory(order: &Order) -> JobError {
    let limit = order.memory_bytes.map_or("the machine has".to_owned(), |bytes| format!("{} MiB", bytes >> 20));
    JobError {
        code: "out_of_memory".to_owned(),
        detail: format!("the job needs more memory than {limit}"),
        remedy: "submit a shorter take or fewer cameras, or ask the operator to raise jobs.memory_bytes".to_owned(),
        ..JobError::default()
    }
}

async fn start(settings: &Settings, queue: &Queue, claim: &Claim, order: &Order) -> anyhow::Result<Child> {
    let (out, checkpoints) = (order.out.clone(), order.checkpoints.clone());
    let made = move || std::fs::create_dir_all(out).and_then(|()| std::fs::create_dir_all(checkpoints));
    tokio::task::spawn_blocking(made).await?.context("result folder")?;
    let (queue, job) = (queue.clone(), claim.job.clone());
    Child::start(&settings.program, order, move |line| {
        tracing::warn!(job.id = job, "{line}");
        queue.tell_line(&job, line);
    })
    .await
}

/// Hash and sync every file, rename the folder, sync its parent; the rows follow in `Queue::finish`.
async fn publish_result(store: &Store, claim: &Claim) -> Ending<Published> {
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
    match published.map_err(anyhow::Error::from).and_then(std::convert::identity) {
        Ok(published) => Ending::Succeeded(published),
        Err(error) => Ending::Failed(JobError {
            code: "result_unpublished".to_owned(),
            detail: format!("the result could not be published: {error:#}"),
            remedy: "free disk space if the disk is full, then submit the job again".to_owned(),
            ..JobError::default()
        }),
    }
}

/// Writes the end down and gives the name of the state it led to, however often the disk refuses: an end not recorded would run the job again.
async fn record(
    store: &Store,
    queue: &Queue,
    settings: &Settings,
    claim: &Claim,
    ending: Ending<Published>,
) -> &'static str {
    let mut tries = 0;
    loop {
        match queue.finish(claim, &ending, settings.jobs.max_deaths).await {
            Ok(Finished::Recorded(phase)) => {
                tracing::info!(job.id = %claim.job, fence = claim.fence, state = phase.name(), "job ended");
                return phase.name();
            }
            Ok(Finished::Lost) => {
                tracing::info!(job.id = %claim.job, fence = claim.fence, "the claim was lost; its work is thrown away");
                store.folders.remove_claim(&claim.job, claim.fence);
                return "lost";
            }
            Err(error) if tries < 30 => {
                if error.is_disk_full() {
                    store.give_reserve_up().await; // an end that was reached must be told
                }
                tracing::error!(job.id = %claim.job, %error, "the job's end could not be recorded; trying again");
                tries += 1;
                tokio::time::sleep(RETRY).await;
            }
            Err(error) => {
                // The row stays `running` under this boot; the next start puts the job back.
                tracing::error!(job.id = %claim.job, %error, "the job's end could not be recorded; given up");
                return "unrecorded";
            }
        }
    }
}
