//! Notifications between the processes that share a PostgreSQL server. They are hints: workers look for jobs once a second or two, and
//! followed jobs are read once a second, whether or not a notification comes.

use super::handle::Queue;
use crate::service::store::error::StoreError;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// Channel of the notifications.
const CHANNEL: &str = "wandless";

/// First character of a notification about a job that may be claimable.
const WORK: char = '+';

/// First character of a notification with a log line of a job.
const LINE: char = '|';

/// Longest log line of a notification, bytes; the server takes less than 8000.
const MAX_LINE_BYTES: usize = 4000;

/// Wait before another try after the connection was lost; time between two reads of the followed jobs.
const INTERVAL: Duration = Duration::from_secs(1);

impl Queue {
    /// Notifies the other processes. It is not part of the transaction of the change: with it, commits would wait for each other.
    pub(super) fn notify(&self, job: &str, is_work: bool) {
        self.send(if is_work { format!("{WORK}{job}") } else { job.to_owned() });
    }

    /// Sends a log line to the other processes, unless they have received enough in this second.
    pub(super) fn notify_line(&self, job: &str, line: &str) {
        if self.lines.take(Instant::now()) {
            self.send(line_payload(&self.store.boot, job, line));
        }
    }

    /// Sends a notification without waiting for it: clients of this process are answered first.
    fn send(&self, payload: String) {
        let store = self.store.clone();
        tokio::spawn(async move {
            let notify = sqlx::query("SELECT pg_notify($1, $2)").bind(CHANNEL).bind(payload);
            if let Err(error) = notify.execute(store.read()).await {
                tracing::debug!(%error, "other processes were not notified; they look for changes themselves");
            }
        });
    }

    fn note(&self, payload: &str) {
        if let Some(line) = payload.strip_prefix(LINE) {
            self.note_line(line);
        } else if let Some(job) = payload.strip_prefix(WORK) {
            self.work.notify_one();
            self.announce(job);
        } else {
            self.announce(payload);
        }
    }

    fn note_line(&self, payload: &str) {
        let mut words = payload.splitn(3, ' ');
        if let (Some(boot), Some(job), Some(line)) = (words.next(), words.next(), words.next())
            && boot != self.store.boot
        {
            self.pass_line(job, line);
        }
    }
}

/// A line, its job, and the process that has sent it to its own clients.
fn line_payload(boot: &str, job: &str, line: &str) -> String {
    let line = &line[..line.floor_char_boundary(MAX_LINE_BYTES)];
    format!("{LINE}{boot} {job} {}", line.replace('\0', ""))
}

/// Passes on the notifications of other processes until the service stops.
pub(crate) async fn listen(queue: Queue, draining: CancellationToken) {
    tokio::select! {
        () = draining.cancelled() => {}
        () = async {
            loop {
                if let Err(error) = pass_on(&queue).await {
                    tracing::warn!(%error, "notifications of other processes are not received; trying again");
                }
                tokio::time::sleep(INTERVAL).await;
            }
        } => {}
    }
}

async fn pass_on(queue: &Queue) -> Result<(), StoreError> {
    let Some(mut listener) = queue.store.listener(CHANNEL).await? else { return Ok(()) };
    // `None`: the connection was lost, and with it perhaps notifications.
    while let Some(notification) = listener.try_recv().await? {
        queue.note(notification.payload());
    }
    Ok(())
}

/// Reads the followed jobs once a second and announces those that have changed, until the service stops.
pub(crate) async fn watch(queue: Queue, draining: CancellationToken) {
    let mut seen: BTreeMap<Arc<str>, i64> = BTreeMap::new();
    while !draining.is_cancelled() {
        tokio::select! {
            () = tokio::time::sleep(INTERVAL) => {}
            () = draining.cancelled() => return,
        }
        let ids = queue.followed.ids();
        seen.retain(|job, _| ids.contains(job));
        if ids.is_empty() {
            continue;
        }
        let list = serde_json::json!(ids.iter().map(|id| &**id).collect::<Vec<_>>()).to_string();
        let rows = sqlx::query_as("SELECT id, version FROM jobs WHERE id IN (SELECT value FROM json_each($1))");
        let rows: Result<Vec<(String, i64)>, _> = rows.bind(list).fetch_all(queue.store.read()).await;
        match rows {
            Ok(rows) => announce_changes(&queue, &ids, &mut seen, &rows.into_iter().collect()),
            Err(error) => tracing::warn!(%error, "the followed jobs cannot be read; trying again"),
        }
    }
}

/// Announces the jobs whose version differs from the one seen, and those that were deleted. A job is read by its follower first, so the
/// first version seen here is announced, too: it may be a later one.
fn announce_changes(queue: &Queue, ids: &[Arc<str>], seen: &mut BTreeMap<Arc<str>, i64>, now: &BTreeMap<String, i64>) {
    for id in ids {
        let version = now.get(&**id).copied().unwrap_or(-1);
        if seen.insert(id.clone(), version) != Some(version) {
            queue.announce(id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_is_cut_between_two_characters() {
        let payload = line_payload("boot", "job", &"ä".repeat(5000));
        assert!(payload.len() <= MAX_LINE_BYTES + 10 && payload.ends_with('ä'));
        assert_eq!(line_payload("boot", "job", "a\0b"), "|boot job ab");
    }
}
