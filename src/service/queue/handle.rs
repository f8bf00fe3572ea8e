//! The queue handle: reads, cancels and deletes jobs, and announces changes.

use super::active::ActiveClaims;
use super::deferral::Deferrals;
use super::follow::{Followed, Following};
use super::job::Job;
use super::phase::Phase;
use super::rows::{JOB_COLUMNS, VERDICT_COLUMNS, job_from_row};
use super::scenes::{Scene, Scenes};
use crate::service::failpoint::failpoint;
use crate::service::store::database::Store;
use crate::service::store::error::StoreError;
use crate::service::store::listing::{Listed, read_page};
use crate::service::store::tenants::Tenant;
use sqlx::AssertSqlSafe;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{Notify, broadcast};

/// The queue of one service process. Cloning shares it.
#[derive(Debug, Clone)]
pub struct Queue {
    pub(super) store: Store,
    /// Wakes a worker when a job may be claimable.
    pub(super) work: Arc<Notify>,
    /// The largest class that the workers of this process claim; `None`: every class.
    pub(super) class: Option<i64>,
    /// Claims of the workers of this process.
    pub(super) active: Arc<ActiveClaims>,
    /// Jobs that wait after a fault of the machine.
    deferrals: Arc<Mutex<Deferrals>>,
    /// Whether the lack of disk space was logged.
    pub(super) lacks_space: Arc<AtomicBool>,
    /// Sends the id of each job whose row has changed.
    changes: broadcast::Sender<Arc<str>>,
    /// Jobs that requests of this process follow.
    pub(super) followed: Arc<Followed>,
    /// Log lines that were sent to other processes.
    #[cfg(feature = "scale")]
    pub(super) lines: Arc<super::lines::LineCount>,
    /// Sends the log lines of the jobs' child processes.
    log: broadcast::Sender<LogLine>,
    /// Cameras and people of the jobs that this process runs.
    scenes: Arc<Scenes>,
}

/// One log line of a job's child process.
#[derive(Debug, Clone)]
pub struct LogLine {
    /// Job id.
    pub job: Arc<str>,
    /// Text of the line.
    pub line: Arc<str>,
}

/// Filter of a job list.
#[derive(Debug, Clone, Default)]
pub struct JobFilter {
    /// Only jobs in this state.
    pub state: Option<Phase>,
    /// Only jobs with this label.
    pub label: Option<LabelFilter>,
    /// Only jobs older than this `seq`.
    pub before: Option<i64>,
}

/// Label filter: `key` or `key=value`.
#[derive(Debug, Clone)]
pub struct LabelFilter {
    /// Name of the label.
    pub key: String,
    /// Required value; `None` accepts any value.
    pub value: Option<String>,
}

/// Result of a cancel request.
#[derive(Debug)]
pub enum Cancel {
    /// The job is being canceled, or was canceled before.
    Accepted(Box<Job>),
    /// The job had already reached another final state.
    AlreadyFinal(Phase),
    /// The job does not exist.
    Missing,
}

/// Bytes of text of a job.
const ROW_BYTES: &str =
    "octet_length(options) + octet_length(labels) + octet_length(message) + octet_length(stage_seconds)
    + coalesce(octet_length(error), 0) + coalesce(octet_length(reasons), 0)
    + coalesce(octet_length(suspicions), 0)";

/// The statement of a list. `$1` to `$3` are tenant, `seq` and number of rows; the values of the filter follow in its order.
fn list_statement(filter: &JobFilter, is_shared: bool) -> String {
    // The table whose index has the order of the list comes first; SQLite keeps the order of a CROSS JOIN.
    let (table, tables) = match filter.label {
        Some(_) if is_shared => ("job_labels", "job_labels JOIN jobs ON jobs.seq = job_labels.seq"),
        Some(_) => ("job_labels", "job_labels CROSS JOIN jobs ON jobs.seq = job_labels.seq"),
        None => ("jobs", "jobs"),
    };
    let mut conditions = format!("{table}.tenant = $1 AND {table}.seq < $2");
    let mut n_values = 3;
    let mut require = |condition: &str| {
        n_values += 1;
        conditions.push_str(&format!(" AND {}", condition.replace('$', &format!("${n_values}"))));
    };
    if filter.state.is_some() {
        require("jobs.state = $");
    }
    if let Some(label) = &filter.label {
        require("job_labels.key = $");
        match label.value {
            // PostgreSQL's index holds digests: a value can be longer than its entries.
            Some(_) if is_shared => require("md5(job_labels.value) = md5($) AND job_labels.value = $"),
            Some(_) => require("job_labels.value = $"),
            None => {}
        }
    }
    format!(
        "SELECT {JOB_COLUMNS}, {VERDICT_COLUMNS}, {ROW_BYTES} AS row_bytes FROM {tables}
         LEFT JOIN verdicts ON verdicts.job_id = jobs.id WHERE {conditions} ORDER BY {table}.seq DESC LIMIT $3"
    )
}

impl Queue {
    /// Creates the queue of a store.
    pub fn new(store: Store) -> Self {
        Self {
            store,
            class: None,
            work: Arc::default(),
            active: Arc::default(),
            deferrals: Arc::default(),
            lacks_space: Arc::default(),
            changes: broadcast::channel(1024).0,
            followed: Arc::default(),
            #[cfg(feature = "scale")]
            lines: Arc::default(),
            log: broadcast::channel(256).0,
            scenes: Arc::default(),
        }
    }

    /// Jobs that wait after a fault of the machine.
    pub(super) fn deferrals(&self) -> MutexGuard<'_, Deferrals> {
        self.deferrals.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Follows the changes of a job from now on.
    pub fn follow(&self, job: &str) -> Following {
        Following::new(job, self.changes.subscribe(), self.followed.clone())
    }

    /// Subscribes to the log lines of all jobs' child processes.
    pub fn listen_to_logs(&self) -> broadcast::Receiver<LogLine> {
        self.log.subscribe()
    }

    /// Sends a log line to the subscribers of all processes.
    pub fn send_line(&self, job: &str, line: &str) {
        self.pass_line(job, line);
        #[cfg(feature = "scale")]
        if self.store.is_shared() {
            self.notify_line(job, line);
        }
    }

    /// Sends a log line to the subscribers of this process.
    pub(super) fn pass_line(&self, job: &str, line: &str) {
        let _ = self.log.send(LogLine { job: job.into(), line: line.into() }); // an error only means that there are no subscribers
    }

    /// Replaces the provisional scene of a running job and announces it to all followers of this process.
    pub fn show_scene(&self, job: &str, stage: String, document: String) {
        self.scenes.put(job, stage, document);
        self.announce(job);
    }

    /// The newest provisional scene of a job; `None` before the first one and after the end, and in processes that do not run it.
    pub fn scene(&self, job: &str) -> Option<Arc<Scene>> {
        self.scenes.get(job)
    }

    /// Removes the provisional scene of a job that this process no longer runs.
    pub fn remove_scene(&self, job: &str) {
        self.scenes.remove(job);
    }

    /// Sends the id of a changed job to all subscribers of this process.
    pub(super) fn announce(&self, job: &str) {
        let _ = self.changes.send(job.into()); // an error only means that there are no subscribers
    }

    /// Sends the id of a job that was accepted, canceled or deleted, or that has ended, to all processes. `is_work`: it may be
    /// claimable.
    pub(super) fn announce_to_all(&self, job: &str, is_work: bool) {
        if is_work {
            self.work.notify_one();
        }
        self.announce(job);
        #[cfg(feature = "scale")]
        if self.store.is_shared() {
            self.notify(job, is_work);
        }
    }

    /// Returns a tenant's job by id.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn get(&self, tenant: &Tenant, id: &str) -> Result<Option<Job>, StoreError> {
        let row = sqlx::query(AssertSqlSafe(format!(
            "SELECT {JOB_COLUMNS}, {VERDICT_COLUMNS} FROM jobs LEFT JOIN verdicts ON verdicts.job_id = jobs.id
             WHERE jobs.id = $1 AND tenant = $2"
        )))
        .bind(id)
        .bind(tenant.name())
        .fetch_optional(self.store.read())
        .await?;
        row.as_ref().map(job_from_row).transpose()
    }

    /// Lists a tenant's jobs, newest first, at most `max_rows`.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn list(&self, tenant: &Tenant, filter: &JobFilter, max_rows: i64) -> Result<Listed<Job>, StoreError> {
        let text = list_statement(filter, self.store.is_shared());
        let mut query = sqlx::query(AssertSqlSafe(text)); // its parts are our own, values are bound
        query = query.bind(tenant.name()).bind(filter.before.unwrap_or(i64::MAX)).bind(max_rows + 1);
        if let Some(state) = filter.state {
            query = query.bind(state.name());
        }
        if let Some(label) = &filter.label {
            query = query.bind(&label.key);
            if let Some(value) = &label.value {
                query = query.bind(value);
            }
        }
        read_page(query.fetch(self.store.read()), max_rows, job_from_row).await
    }

    /// Cancels a job: a queued job immediately, a running job through its worker.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn cancel(&self, tenant: &Tenant, id: &str) -> Result<Cancel, StoreError> {
        match self.try_to_cancel(tenant, id).await {
            Err(error) if error.is_disk_full() => {
                self.store.release_reserve().await;
                self.try_to_cancel(tenant, id).await
            }
            done => done,
        }
    }

    async fn try_to_cancel(&self, tenant: &Tenant, id: &str) -> Result<Cancel, StoreError> {
        let mut transaction = self.store.write().await?;
        // One statement for both states: between two, a worker could claim the job.
        let cancel = sqlx::query(
            "UPDATE jobs SET state = CASE state WHEN 'queued' THEN 'canceled' ELSE 'canceling' END, version = version + 1,
                             eta_s = CASE state WHEN 'queued' THEN NULL ELSE eta_s END,
                             finished_at = CASE state WHEN 'queued' THEN strftime('%Y-%m-%dT%H:%M:%fZ', 'now') END
             WHERE id = $1 AND tenant = $2 AND state IN ('queued', 'running')",
        );
        cancel.bind(id).bind(tenant.name()).execute(&mut *transaction).await?;
        failpoint("cancel.marked");
        let committed = self.store.commit(transaction).await;
        failpoint("cancel.committed");
        let Some(job) = self.get(tenant, id).await? else { return Ok(Cancel::Missing) };
        if let (Err(error), Phase::Queued | Phase::Running) = (committed, job.state.phase()) {
            return Err(error.into()); // otherwise only the answer to the commit was lost
        }
        self.deferrals().forget(id);
        self.announce_to_all(id, false);
        if job.state.phase() == Phase::Canceled {
            self.store.remove_files("checkpoints", id).await; // left by an attempt before a restart
        }
        Ok(match job.state.phase() {
            Phase::Canceling | Phase::Canceled => Cancel::Accepted(Box::new(job)),
            phase => Cancel::AlreadyFinal(phase),
        })
    }

    /// Deletes a job in any state and its files; the worker of a running job notices that the row is gone and kills the
    /// child process. Returns false if the job did not exist.
    ///
    /// # Errors
    /// When the store fails.
    pub async fn delete(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        match self.try_to_delete(tenant, id).await {
            Err(error) if error.is_disk_full() => {
                self.store.release_reserve().await;
                self.try_to_delete(tenant, id).await
            }
            done => done,
        }
    }

    async fn try_to_delete(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        let mut transaction = self.store.write().await?;
        let deleted = sqlx::query("DELETE FROM jobs WHERE id = $1 AND tenant = $2").bind(id).bind(tenant.name());
        let deleted = deleted.execute(&mut *transaction).await?;
        failpoint("delete.marked");
        if let Err(error) = self.store.commit(transaction).await
            && self.get(tenant, id).await?.is_some()
        {
            return Err(error.into()); // a job that is gone was deleted, and only the answer was lost
        }
        if deleted.rows_affected() == 0 {
            return Ok(false);
        }
        failpoint("delete.committed");
        self.deferrals().forget(id);
        self.announce_to_all(id, false);
        self.store.remove_files("results", id).await;
        self.store.remove_files("checkpoints", id).await;
        failpoint("delete.removed");
        self.store.create_reserve().await;
        Ok(true)
    }
}
