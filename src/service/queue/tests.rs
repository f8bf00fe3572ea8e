//! Tests of the queue on a real database in a temporary folder.

mod depth;
mod ends;
#[cfg(feature = "scale")]
mod shared;

use super::job::{JobError, JobProgress, Submitter};
use super::outcome::ClaimOutcome;
use super::recovery::{Recovered, recover};
use super::*;
use crate::service::store::sessions;
use crate::service::store::{Store, StoreError, Tenant, tenants, test_support};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode};
use sqlx::{ConnectOptions, Connection};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use tempfile::TempDir;

struct TestQueue {
    folder: TempDir,
    queue: Queue,
}

impl TestQueue {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let queue = Queue::new(test_support::open(folder.path()).await);
        let summary = test_support::summary();
        std::fs::write(queue.store.folders.session("s"), b"bytes").unwrap();
        assert!(sessions::add(&queue.store, &tenant(), "s", &summary, i64::MAX).await.unwrap().is_new);
        Self { folder, queue }
    }

    /// Opens the same data folder as the next service process.
    async fn restarted(self) -> Self {
        let Self { folder, queue } = self;
        queue.store.close().await;
        drop(queue);
        let queue = Queue::new(test_support::open(folder.path()).await);
        Self { folder, queue }
    }

    async fn enqueue(&self, priority: i64) -> String {
        self.queue.enqueue(&new_job(priority), None, LIMITS).await.unwrap().id
    }

    async fn phase(&self, id: &str) -> Phase {
        self.queue.get(&tenant(), id).await.unwrap().unwrap().state.phase()
    }

    async fn finish(&self, claim: &Claim, outcome: ClaimOutcome<Published>) -> Finished {
        self.queue.finish(claim, &outcome, 3).await.unwrap()
    }
}

const LIMITS: QueueLimits = QueueLimits { total: 100, tenant: 100, max_bytes: i64::MAX };

fn tenant() -> Tenant {
    Tenant::default_tenant()
}

fn new_job(priority: i64) -> NewJob {
    let options = serde_json::json!({});
    let submitter = Submitter { request: Some("r".to_owned()), key: Some("k".to_owned()) };
    let session = "s".to_owned();
    NewJob { tenant: tenant(), session, options, labels: BTreeMap::new(), priority, webhook: None, submitter }
}

fn crashed() -> ClaimOutcome<Published> {
    ClaimOutcome::Crashed("signal 9".to_owned())
}

#[tokio::test]
async fn claims_jobs_by_priority_then_age() {
    let test = TestQueue::new().await;
    let (first, urgent, second) = (test.enqueue(0).await, test.enqueue(5).await, test.enqueue(0).await);
    for expected in [urgent, first, second] {
        assert_eq!(test.queue.claim(i64::MAX).await.unwrap().unwrap().job, expected);
    }
    assert!(test.queue.claim(i64::MAX).await.unwrap().is_none());
}

#[tokio::test]
async fn a_claim_names_its_tenant_and_its_request() {
    let test = TestQueue::new().await;
    test.enqueue(0).await;
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!((claim.tenant.as_str(), &claim.submitter), (tenant().name(), &new_job(0).submitter));
}

#[tokio::test]
async fn tenants_take_turns_regardless_of_priority() {
    let test = TestQueue::new().await;
    for _ in 0..3 {
        test.enqueue(1000).await;
    }
    let other = Tenant::parse("other").unwrap();
    let summary = sessions::get(&test.queue.store, &tenant(), "s").await.unwrap().unwrap().summary;
    sessions::add(&test.queue.store, &other, "t", &summary, i64::MAX).await.unwrap();
    let new = NewJob { tenant: other, session: "t".to_owned(), ..new_job(-5) };
    for _ in 0..2 {
        test.queue.enqueue(&new, None, LIMITS).await.unwrap();
    }
    let mut order = Vec::new();
    while let Some(claim) = test.queue.claim(i64::MAX).await.unwrap() {
        order.push(claim.session);
    }
    assert_eq!(order, ["s", "t", "s", "t", "s"]);
}

#[tokio::test]
async fn skips_tenants_at_their_running_limit() {
    let test = TestQueue::new().await;
    for _ in 0..2 {
        test.enqueue(0).await;
    }
    let first = test.queue.claim(1).await.unwrap().unwrap();
    assert!(test.queue.claim(1).await.unwrap().is_none());
    test.finish(&first, ClaimOutcome::Failed(JobError::default())).await;
    assert!(test.queue.claim(1).await.unwrap().is_some());
}

#[tokio::test]
async fn tenants_cannot_access_each_others_jobs() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let other = Tenant::parse("other").unwrap();
    assert!(test.queue.get(&other, &id).await.unwrap().is_none());
    assert!(test.queue.list(&other, &JobFilter::default(), 10).await.unwrap().items.is_empty());
    assert!(matches!(test.queue.cancel(&other, &id).await.unwrap(), Cancel::Missing));
    assert!(!test.queue.delete(&other, &id).await.unwrap());
    let foreign = NewJob { tenant: other.clone(), ..new_job(0) };
    assert!(matches!(test.queue.enqueue(&foreign, None, LIMITS).await, Err(EnqueueError::SessionMissing)));
    assert!(matches!(sessions::remove(&test.queue.store, &other, "s").await, Err(sessions::RemoveError::Missing)));
    assert_eq!(test.phase(&id).await, Phase::Queued);
}

#[tokio::test]
async fn a_stale_claim_writes_nothing() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let stale = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(test.finish(&stale, ClaimOutcome::Released).await, Finished::Recorded(Phase::Queued));
    let fresh = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(fresh.fence, stale.fence + 1);
    assert_eq!(test.queue.claim_status(&stale).await.unwrap(), ClaimStatus::Lost);
    assert_eq!(test.finish(&stale, ClaimOutcome::Failed(JobError::default())).await, Finished::Lost);
    assert_eq!(test.phase(&id).await, Phase::Running);
}

#[tokio::test]
async fn three_crashes_make_a_job_dead() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    for expected in [Phase::Queued, Phase::Queued, Phase::Dead] {
        let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
        assert_eq!(test.finish(&claim, crashed()).await, Finished::Recorded(expected));
    }
    let job = test.queue.get(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.attempt, job.state.error().unwrap().code.as_str()), (3, "child_died"));
}

#[tokio::test]
async fn service_crash_requeues_jobs_without_counting() {
    if test_support::is_of_sqlite_alone("the next start puts jobs back; there the leader does") {
        return;
    }
    let mut test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let canceled = test.enqueue(0).await;
    for _ in 0..5 {
        assert_eq!(test.queue.claim(i64::MAX).await.unwrap().unwrap().job, id);
        test = test.restarted().await;
        assert_eq!(recover(&test.queue).await.unwrap(), Recovered { requeued: 1, canceled: 0, removed: 0 });
    }
    test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(test.queue.claim(i64::MAX).await.unwrap().unwrap().job, canceled);
    assert!(matches!(test.queue.cancel(&tenant(), &canceled).await.unwrap(), Cancel::Accepted(_)));
    assert_eq!(test.phase(&canceled).await, Phase::Canceling);
    test = test.restarted().await;
    assert_eq!(recover(&test.queue).await.unwrap(), Recovered { requeued: 1, canceled: 1, removed: 0 });
    let job = test.queue.get(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.state.phase(), job.attempt), (Phase::Queued, 1));
    assert_eq!(test.phase(&canceled).await, Phase::Canceled);
}

#[tokio::test]
async fn recovery_removes_files_without_a_row() {
    if test_support::is_of_sqlite_alone("results in the data folder") {
        return;
    }
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let folders = &test.queue.store.folders;
    std::fs::create_dir_all(folders.staging(&id, 1)).unwrap();
    std::fs::write(folders.session("orphan"), b"").unwrap();
    let upload = folders.temporary();
    std::fs::write(&upload.path, b"").unwrap();
    assert_eq!(recover(&test.queue).await.unwrap().removed, 3);
    assert_eq!(folders.names("sessions").unwrap(), ["s"]);
    assert_eq!(recover(&test.queue).await.unwrap().removed, 0);
}

#[tokio::test]
async fn a_cancel_takes_precedence_over_later_outcomes() {
    for outcome in [crashed(), ClaimOutcome::Failed(JobError::default()), ClaimOutcome::Released] {
        let test = TestQueue::new().await;
        let id = test.enqueue(0).await;
        let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
        test.queue.cancel(&tenant(), &id).await.unwrap();
        assert_eq!(test.queue.claim_status(&claim).await.unwrap(), ClaimStatus::Canceling);
        assert_eq!(test.finish(&claim, outcome).await, Finished::Recorded(Phase::Canceled));
        assert!(
            matches!(test.queue.cancel(&tenant(), &id).await.unwrap(), Cancel::Accepted(_)),
            "a second cancel is accepted"
        );
    }
}

#[tokio::test]
async fn stored_fraction_never_decreases() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let mut shown = Vec::new();
    for fraction in [0.4, 0.1, 0.6] {
        let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
        let progress = JobProgress { fraction, ..JobProgress::default() };
        test.queue.heartbeat(&claim, &progress, &BTreeMap::new()).await.unwrap();
        test.finish(&claim, ClaimOutcome::Released).await;
        shown.push(test.queue.get(&tenant(), &id).await.unwrap().unwrap().progress.fraction);
    }
    assert_eq!(shown, [0.4, 0.4, 0.6]);
}

#[tokio::test]
async fn a_resumed_job_lost_the_times_of_its_first_stages() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    for (stage, seconds) in [("cameras", 2.0), ("body_fit", 3.0), ("body_fit", 4.0)] {
        let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
        let seconds = BTreeMap::from([(stage.to_owned(), seconds)]);
        for _ in 0..2 {
            test.queue.heartbeat(&claim, &JobProgress::default(), &seconds).await.unwrap();
        }
        test.finish(&claim, ClaimOutcome::Released).await;
    }
    let job = test.queue.get(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!(job.stage_seconds, BTreeMap::from([("body_fit".to_owned(), 7.0), ("cameras".to_owned(), 2.0)]));
}

#[tokio::test]
async fn database_rejects_leaving_a_final_state() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    test.queue.cancel(&tenant(), &id).await.unwrap();
    for phase in Phase::ALL {
        let mut transaction = test.queue.store.write().await.unwrap(); // PostgreSQL ends a transaction at the first error
        let forced = sqlx::query("UPDATE jobs SET state = $1 WHERE id = $2").bind(phase.name()).bind(&id);
        assert_eq!(forced.execute(&mut *transaction).await.is_ok(), phase == Phase::Canceled, "{phase:?}");
    }
}

#[tokio::test]
async fn an_idempotency_key_is_one_job_forever() {
    let test = TestQueue::new().await;
    let key =
        |fingerprint: &str| IdempotencyKey { key: "k".to_owned(), fingerprint: fingerprint.to_owned(), as_sent: None };
    let first = test.queue.enqueue(&new_job(0), Some(&key("f")), LIMITS).await.unwrap();
    let again = test.queue.enqueue(&new_job(0), Some(&key("f")), LIMITS).await.unwrap();
    assert_eq!(first.id, again.id);
    let other = test.queue.enqueue(&new_job(0), Some(&key("g")), LIMITS).await;
    assert!(matches!(other, Err(EnqueueError::KeyReused)));
    assert!(test.queue.delete(&tenant(), &first.id).await.unwrap());
    let late = test.queue.enqueue(&new_job(0), Some(&key("f")), LIMITS).await;
    assert!(matches!(late, Err(EnqueueError::JobDeleted)));
}

#[tokio::test]
async fn a_key_of_an_older_release_knows_its_request() {
    let test = TestQueue::new().await;
    let older =
        IdempotencyKey { key: "k".to_owned(), fingerprint: "of all options of that release".to_owned(), as_sent: None };
    let job = test.queue.enqueue(&new_job(0), Some(&older), LIMITS).await.unwrap();
    let key = |new: &NewJob| IdempotencyKey { key: "k".to_owned(), fingerprint: new.fingerprint("00"), as_sent: None };
    let same = new_job(0);
    assert_eq!(test.queue.enqueue(&same, Some(&key(&same)), LIMITS).await.unwrap().id, job.id);
    let options = serde_json::json!({ "people": 3 });
    for other in [new_job(1), NewJob { options, ..new_job(0) }] {
        let refused = test.queue.enqueue(&other, Some(&key(&other)), LIMITS).await;
        assert!(matches!(refused, Err(EnqueueError::KeyReused)));
    }
}

#[tokio::test]
async fn rejects_removing_a_session_in_use() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let rejected = sessions::remove(&test.queue.store, &tenant(), "s").await;
    assert!(matches!(rejected, Err(sessions::RemoveError::InUse { job }) if job == id));
    test.queue.cancel(&tenant(), &id).await.unwrap();
    sessions::remove(&test.queue.store, &tenant(), "s").await.unwrap();
    let rejected = test.queue.enqueue(&new_job(0), None, LIMITS).await;
    assert!(matches!(rejected, Err(EnqueueError::SessionMissing)));
}

fn disk_full() -> ClaimOutcome<Published> {
    ClaimOutcome::Failed(JobError {
        code: "disk_full".to_owned(),
        detail: "no space left".to_owned(),
        ..JobError::default()
    })
}

#[tokio::test]
async fn a_full_disk_puts_the_job_back_and_others_run() {
    let test = TestQueue::new().await;
    let (first, second) = (test.enqueue(5).await, test.enqueue(0).await);
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(test.finish(&claim, disk_full()).await, Finished::Recorded(Phase::Queued));
    let job = test.queue.get(&tenant(), &first).await.unwrap().unwrap();
    assert_eq!((job.progress.message.as_str(), job.attempt), ("waiting 5 s for the next try: no space left", 1));
    let next = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(next.job, second, "the job that waits is skipped although its priority is higher");
    assert!(test.queue.claim(i64::MAX).await.unwrap().is_none());
    test.queue.cancel(&tenant(), &next.job).await.unwrap();
    assert_eq!(test.finish(&next, disk_full()).await, Finished::Recorded(Phase::Canceled));
    let test = test.restarted().await;
    assert_eq!(test.queue.claim(i64::MAX).await.unwrap().unwrap().job, first, "a restart tries the job at once");
}

#[tokio::test]
async fn a_job_fails_after_too_many_full_disks() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    for _ in 0..100 {
        assert!(test.queue.deferrals().next_wait(&id).is_some());
        test.queue.deferrals().defer(&id, Instant::now(), Duration::ZERO);
    }
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(test.finish(&claim, disk_full()).await, Finished::Recorded(Phase::Failed));
}

#[tokio::test]
async fn a_nearly_full_disk_stops_claims_and_submissions() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let full = Queue::new(test.queue.store.clone().with_min_free_bytes(u64::MAX));
    assert!(full.claim(i64::MAX).await.unwrap().is_none());
    let refused = full.enqueue(&new_job(0), None, LIMITS).await;
    assert!(matches!(refused, Err(EnqueueError::Store(error)) if error.is_disk_full()));
    assert_eq!(test.queue.claim(i64::MAX).await.unwrap().unwrap().job, id);
}

#[tokio::test]
async fn a_used_up_quota_rejects_jobs_but_not_repetitions() {
    let test = TestQueue::new().await;
    let key = IdempotencyKey { key: "k".to_owned(), fingerprint: "f".to_owned(), as_sent: None };
    let accepted = test.queue.enqueue(&new_job(0), Some(&key), LIMITS).await.unwrap();
    let used_up = QueueLimits { max_bytes: 5, ..LIMITS };
    let refused = test.queue.enqueue(&new_job(0), None, used_up).await;
    assert!(matches!(refused, Err(EnqueueError::QuotaExceeded { stored: 5, max: 5 })));
    let again = test.queue.enqueue(&new_job(0), Some(&key), used_up).await.unwrap();
    assert_eq!(again.id, accepted.id);
    test.queue.enqueue(&new_job(0), None, QueueLimits { max_bytes: 6, ..LIMITS }).await.unwrap();
}

#[tokio::test]
async fn a_key_remembers_its_session_until_it_is_forgotten() {
    let test = TestQueue::new().await;
    let key = IdempotencyKey { key: "k".to_owned(), fingerprint: "f".to_owned(), as_sent: None };
    let id = test.queue.enqueue(&new_job(0), Some(&key), LIMITS).await.unwrap().id;
    test.queue.cancel(&tenant(), &id).await.unwrap();
    sessions::remove(&test.queue.store, &tenant(), "s").await.unwrap();
    let known = |session: &'static str| async { test.queue.session_of_key(&tenant(), "k", session).await.unwrap() };
    assert_eq!((known("s").await.as_deref(), known("other").await), (Some("00"), None));
    let again = test.queue.enqueue(&new_job(0), Some(&key), LIMITS).await.unwrap();
    assert_eq!(again.id, id);
    assert_eq!(test.queue.forget_keys(-1.0).await.unwrap(), 0, "the job exists");
    assert!(test.queue.delete(&tenant(), &id).await.unwrap());
    assert_eq!(test.queue.forget_keys(30.0).await.unwrap(), 0, "the key is new");
    assert_eq!(test.queue.forget_keys(-1.0).await.unwrap(), 1);
    assert_eq!(known("s").await, None);
}

#[tokio::test]
async fn lists_by_label_and_state_through_indices() {
    let test = TestQueue::new().await;
    let mut ids = Vec::new();
    for (scene, n) in [("a", 1), ("b", 2), ("a", 3)] {
        let labels = [("scene", scene.to_owned()), ("n", n.to_string())].map(|(key, value)| (key.to_owned(), value));
        let new = NewJob { labels: labels.into(), ..new_job(0) };
        ids.push(test.queue.enqueue(&new, None, LIMITS).await.unwrap().id);
    }
    test.queue.cancel(&tenant(), &ids[0]).await.unwrap();
    let listed = async |state: Option<Phase>, key: &str, value: Option<&str>| -> Vec<String> {
        let label = Some(LabelFilter { key: key.to_owned(), value: value.map(str::to_owned) });
        let label = label.filter(|label| !label.key.is_empty());
        let filter = JobFilter { state, label, before: None };
        let page = test.queue.list(&tenant(), &filter, 10).await.unwrap();
        assert!(!page.has_more);
        page.items.into_iter().map(|job| job.id).collect()
    };
    assert_eq!(listed(None, "scene", Some("a")).await, [&*ids[2], &*ids[0]]);
    assert_eq!(listed(None, "scene", None).await, [&*ids[2], &*ids[1], &*ids[0]]);
    assert_eq!(listed(Some(Phase::Canceled), "scene", Some("a")).await, [&*ids[0]]);
    assert_eq!(listed(Some(Phase::Queued), "", None).await, [&*ids[2], &*ids[1]]);
    assert!(test.queue.delete(&tenant(), &ids[2]).await.unwrap());
    assert_eq!(listed(None, "scene", Some("a")).await, [&*ids[0]]);
}

#[tokio::test]
async fn pages_of_long_labels_end_early() {
    let test = TestQueue::new().await;
    let labels = BTreeMap::from([("note".to_owned(), "x".repeat(400_000))]);
    for _ in 0..5 {
        let new = NewJob { labels: labels.clone(), ..new_job(0) };
        test.queue.enqueue(&new, None, LIMITS).await.unwrap();
    }
    let (mut before, mut lengths) = (None, Vec::new());
    loop {
        let filter = JobFilter { before, ..JobFilter::default() };
        let page = test.queue.list(&tenant(), &filter, 10).await.unwrap();
        before = page.items.last().map(|job| job.seq);
        lengths.push(page.items.len());
        if !page.has_more {
            break;
        }
    }
    assert_eq!(lengths, [2, 2, 1]);
}

#[tokio::test]
async fn running_totals_equal_the_rows() {
    let test = TestQueue::new().await;
    let mut ids = Vec::new();
    for _ in 0..4 {
        ids.push(test.enqueue(0).await);
    }
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    test.queue.cancel(&tenant(), &ids[1]).await.unwrap();
    assert!(test.queue.delete(&tenant(), &ids[2]).await.unwrap());
    let mut transaction = test.queue.store.write().await.unwrap();
    sqlx::query("UPDATE jobs SET result_bytes = 70 WHERE id = $1")
        .bind(&claim.job)
        .execute(&mut *transaction)
        .await
        .unwrap();
    transaction.commit().await.unwrap();
    let statistics = test.queue.statistics().await.unwrap();
    let by_state = [("canceled", 1), ("queued", 1), ("running", 1)].map(|(state, n)| (state.to_owned(), n));
    assert_eq!(statistics.by_state, by_state);
    assert!(statistics.oldest_queued_s >= 0.0);
    let stored = async || tenants::stored_bytes(&test.queue.store, &tenant()).await.unwrap();
    assert_eq!(stored().await, 75);
    assert!(test.queue.delete(&tenant(), &claim.job).await.unwrap());
    assert_eq!(stored().await, 5);
    for id in [&ids[1], &ids[3]] {
        assert!(test.queue.delete(&tenant(), id).await.unwrap());
    }
    sessions::remove(&test.queue.store, &tenant(), "s").await.unwrap();
    assert_eq!((stored().await, test.queue.statistics().await.unwrap().by_state), (0, Vec::new()));
}

#[tokio::test]
async fn a_full_queue_rejects_jobs() {
    let test = TestQueue::new().await;
    test.enqueue(0).await;
    let rejected = test.queue.enqueue(&new_job(0), None, QueueLimits { total: 1, ..LIMITS }).await;
    assert!(matches!(rejected, Err(EnqueueError::Full { waiting: 1 })));
    let rejected = test.queue.enqueue(&new_job(0), None, QueueLimits { tenant: 1, ..LIMITS }).await;
    assert!(matches!(rejected, Err(EnqueueError::TenantFull { waiting: 1 })));
}

#[tokio::test]
async fn rejects_a_second_service_and_a_lost_database() {
    if test_support::is_of_sqlite_alone("a lost database file") {
        return;
    }
    let test = TestQueue::new().await;
    let second = Store::open(test.folder.path()).await;
    assert!(matches!(second, Err(StoreError::InUse { .. })));
    let database = test.queue.store.folders.database();
    test.queue.store.close().await;
    let TestQueue { folder, queue } = test;
    drop(queue);
    std::fs::remove_file(&database).unwrap();
    assert!(matches!(Store::open(folder.path()).await, Err(StoreError::DatabaseLost { .. })));
    assert!(!database.exists());
    // A database whose write-ahead log is gone: one page without a table.
    let empty = SqliteConnectOptions::new().filename(&database).create_if_missing(true);
    empty.journal_mode(SqliteJournalMode::Wal).connect().await.unwrap().close().await.unwrap();
    assert!(std::fs::metadata(&database).unwrap().len() > 0);
    assert!(matches!(Store::open(folder.path()).await, Err(StoreError::DatabaseLost { .. })));
}
