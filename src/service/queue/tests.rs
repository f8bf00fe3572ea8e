//! The queue on a real database in a temporary folder.

use super::job::{Ending, JobError, JobProgress, Phase};
use super::recovery::{Recovered, recover};
use super::*;
use crate::service::store::Tenant;
use crate::service::store::sessions::{self, SessionSummary};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode};
use sqlx::{ConnectOptions, Connection};
use std::collections::BTreeMap;
use tempfile::TempDir;

struct Rig {
    folder: TempDir,
    queue: Queue,
}

impl Rig {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let queue = Queue::new(Store::open(folder.path()).await.unwrap());
        let summary = SessionSummary {
            name: "take".to_owned(),
            sha256: "00".to_owned(),
            cameras: 0,
            frames: 3,
            people_max: 1,
            keypoint_convention: "coco17".to_owned(),
            format: "native".to_owned(),
            warnings: Vec::new(),
            bytes: 5,
            camera_facts: Vec::new(),
        };
        std::fs::write(queue.store.folders.session("s"), b"bytes").unwrap();
        assert!(sessions::add(&queue.store, &tenant(), "s", &summary, i64::MAX).await.unwrap().is_new);
        Self { folder, queue }
    }

    /// The same data folder under the next service process.
    async fn restarted(self) -> Self {
        let Self { folder, queue } = self;
        queue.store.close().await;
        drop(queue);
        let queue = Queue::new(Store::open(folder.path()).await.unwrap());
        Self { folder, queue }
    }

    async fn enqueue(&self, priority: i64) -> String {
        self.queue.enqueue(&new_job(priority), None, ROOM).await.unwrap().id
    }

    async fn phase(&self, id: &str) -> Phase {
        self.queue.get(&tenant(), id).await.unwrap().unwrap().state.phase()
    }

    async fn finish(&self, claim: &Claim, ending: Ending<Published>) -> Finished {
        self.queue.finish(claim, &ending, 3).await.unwrap()
    }
}

const ROOM: Room = Room { everybody: 100, tenant: 100 };

fn tenant() -> Tenant {
    Tenant::default_tenant()
}

fn new_job(priority: i64) -> NewJob {
    let options = serde_json::json!({});
    NewJob { tenant: tenant(), session: "s".to_owned(), options, labels: BTreeMap::new(), priority, webhook: None }
}

fn died() -> Ending<Published> {
    Ending::ChildDied("signal 9".to_owned())
}

#[tokio::test]
async fn jobs_are_claimed_by_priority_then_age() {
    let rig = Rig::new().await;
    let (first, urgent, second) = (rig.enqueue(0).await, rig.enqueue(5).await, rig.enqueue(0).await);
    for expected in [urgent, first, second] {
        assert_eq!(rig.queue.claim(i64::MAX).await.unwrap().unwrap().job, expected);
    }
    assert!(rig.queue.claim(i64::MAX).await.unwrap().is_none());
}

#[tokio::test]
async fn tenants_take_turns_whatever_their_priorities_and_numbers() {
    let rig = Rig::new().await;
    for _ in 0..3 {
        rig.enqueue(1000).await;
    }
    let other = Tenant::parse("other").unwrap();
    let summary = sessions::get(&rig.queue.store, &tenant(), "s").await.unwrap().unwrap().summary;
    sessions::add(&rig.queue.store, &other, "t", &summary, i64::MAX).await.unwrap();
    let new = NewJob { tenant: other, session: "t".to_owned(), ..new_job(-5) };
    for _ in 0..2 {
        rig.queue.enqueue(&new, None, ROOM).await.unwrap();
    }
    let mut order = Vec::new();
    while let Some(claim) = rig.queue.claim(i64::MAX).await.unwrap() {
        order.push(claim.session);
    }
    assert_eq!(order, ["s", "t", "s", "t", "s"]);
}

#[tokio::test]
async fn a_tenant_with_enough_at_work_is_passed_over() {
    let rig = Rig::new().await;
    for _ in 0..2 {
        rig.enqueue(0).await;
    }
    let first = rig.queue.claim(1).await.unwrap().unwrap();
    assert!(rig.queue.claim(1).await.unwrap().is_none());
    rig.finish(&first, Ending::Failed(JobError::default())).await;
    assert!(rig.queue.claim(1).await.unwrap().is_some());
}

#[tokio::test]
async fn tenants_do_not_know_of_each_other() {
    let rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    let other = Tenant::parse("other").unwrap();
    assert!(rig.queue.get(&other, &id).await.unwrap().is_none());
    assert!(rig.queue.list(&other, &JobFilter::default(), 10).await.unwrap().is_empty());
    assert!(matches!(rig.queue.cancel(&other, &id).await.unwrap(), Cancel::Missing));
    assert!(!rig.queue.delete(&other, &id).await.unwrap());
    let stolen = NewJob { tenant: other.clone(), ..new_job(0) };
    assert!(matches!(rig.queue.enqueue(&stolen, None, ROOM).await, Err(EnqueueError::SessionMissing)));
    assert!(matches!(sessions::remove(&rig.queue.store, &other, "s").await, Err(sessions::RemoveError::Missing)));
    assert_eq!(rig.phase(&id).await, Phase::Queued);
}

#[tokio::test]
async fn a_stale_claim_writes_nothing() {
    let rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    let stale = rig.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(rig.finish(&stale, Ending::Released).await, Finished::Recorded(Phase::Queued));
    let fresh = rig.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(fresh.fence, stale.fence + 1);
    assert_eq!(rig.queue.standing(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(rig.finish(&stale, Ending::Failed(JobError::default())).await, Finished::Lost);
    assert_eq!(rig.phase(&id).await, Phase::Running);
}

#[tokio::test]
async fn three_deaths_of_the_own_child_are_the_end() {
    let rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    for expected in [Phase::Queued, Phase::Queued, Phase::Dead] {
        let claim = rig.queue.claim(i64::MAX).await.unwrap().unwrap();
        assert_eq!(rig.finish(&claim, died()).await, Finished::Recorded(expected));
    }
    let job = rig.queue.get(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.attempt, job.state.error().unwrap().code.as_str()), (3, "child_died"));
}

#[tokio::test]
async fn the_death_of_the_service_puts_jobs_back_and_counts_nothing() {
    let mut rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    let canceled = rig.enqueue(0).await;
    for _ in 0..5 {
        assert_eq!(rig.queue.claim(i64::MAX).await.unwrap().unwrap().job, id);
        rig = rig.restarted().await;
        assert_eq!(recover(&rig.queue).await.unwrap(), Recovered { requeued: 1, canceled: 0, removed: 0 });
    }
    rig.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(rig.queue.claim(i64::MAX).await.unwrap().unwrap().job, canceled);
    assert!(matches!(rig.queue.cancel(&tenant(), &canceled).await.unwrap(), Cancel::Accepted(_)));
    assert_eq!(rig.phase(&canceled).await, Phase::Canceling);
    rig = rig.restarted().await;
    assert_eq!(recover(&rig.queue).await.unwrap(), Recovered { requeued: 1, canceled: 1, removed: 0 });
    let job = rig.queue.get(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.state.phase(), job.attempt), (Phase::Queued, 1));
    assert_eq!(rig.phase(&canceled).await, Phase::Canceled);
}

#[tokio::test]
async fn recovery_removes_what_no_row_names() {
    let rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    let folders = &rig.queue.store.folders;
    std::fs::create_dir_all(folders.staging(&id, 1)).unwrap();
    std::fs::write(folders.session("orphan"), b"").unwrap();
    let upload = folders.temporary();
    std::fs::write(&upload.path, b"").unwrap();
    assert_eq!(recover(&rig.queue).await.unwrap().removed, 3);
    assert_eq!(folders.names("sessions").unwrap(), ["s"]);
    assert_eq!(recover(&rig.queue).await.unwrap().removed, 0);
}

#[tokio::test]
async fn a_cancel_outweighs_whatever_the_child_says_after_it() {
    for ending in [died(), Ending::Failed(JobError::default()), Ending::Released] {
        let rig = Rig::new().await;
        let id = rig.enqueue(0).await;
        let claim = rig.queue.claim(i64::MAX).await.unwrap().unwrap();
        rig.queue.cancel(&tenant(), &id).await.unwrap();
        assert_eq!(rig.queue.standing(&claim).await.unwrap(), Standing::Canceling);
        assert_eq!(rig.finish(&claim, ending).await, Finished::Recorded(Phase::Canceled));
        assert!(
            matches!(rig.queue.cancel(&tenant(), &id).await.unwrap(), Cancel::Accepted(_)),
            "a second cancel is no error"
        );
    }
}

#[tokio::test]
async fn the_shown_fraction_never_falls() {
    let rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    let mut shown = Vec::new();
    for fraction in [0.4, 0.1, 0.6] {
        let claim = rig.queue.claim(i64::MAX).await.unwrap().unwrap();
        let progress = JobProgress { fraction, ..JobProgress::default() };
        rig.queue.heartbeat(&claim, &progress, &BTreeMap::new()).await.unwrap();
        rig.finish(&claim, Ending::Released).await;
        shown.push(rig.queue.get(&tenant(), &id).await.unwrap().unwrap().progress.fraction);
    }
    assert_eq!(shown, [0.4, 0.4, 0.6]);
}

#[tokio::test]
async fn the_database_refuses_to_leave_a_final_state() {
    let rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    rig.queue.cancel(&tenant(), &id).await.unwrap();
    let mut transaction = rig.queue.store.write().await.unwrap();
    for phase in Phase::ALL {
        let forced = sqlx::query("UPDATE jobs SET state = ? WHERE id = ?").bind(phase.name()).bind(&id);
        assert_eq!(forced.execute(&mut *transaction).await.is_ok(), phase == Phase::Canceled, "{phase:?}");
    }
}

#[tokio::test]
async fn a_key_is_one_job_for_ever() {
    let rig = Rig::new().await;
    let key = |fingerprint: &str| IdempotencyKey { key: "k".to_owned(), fingerprint: fingerprint.to_owned() };
    let first = rig.queue.enqueue(&new_job(0), Some(&key("f")), ROOM).await.unwrap();
    let again = rig.queue.enqueue(&new_job(0), Some(&key("f")), ROOM).await.unwrap();
    assert_eq!(first.id, again.id);
    let other = rig.queue.enqueue(&new_job(0), Some(&key("g")), ROOM).await;
    assert!(matches!(other, Err(EnqueueError::KeyReused)));
    assert!(rig.queue.delete(&tenant(), &first.id).await.unwrap());
    let late = rig.queue.enqueue(&new_job(0), Some(&key("f")), ROOM).await;
    assert!(matches!(late, Err(EnqueueError::JobDeleted)));
}

#[tokio::test]
async fn a_session_in_use_stays() {
    let rig = Rig::new().await;
    let id = rig.enqueue(0).await;
    let refused = sessions::remove(&rig.queue.store, &tenant(), "s").await;
    assert!(matches!(refused, Err(sessions::RemoveError::InUse { job }) if job == id));
    rig.queue.cancel(&tenant(), &id).await.unwrap();
    sessions::remove(&rig.queue.store, &tenant(), "s").await.unwrap();
    let refused = rig.queue.enqueue(&new_job(0), None, ROOM).await;
    assert!(matches!(refused, Err(EnqueueError::SessionMissing)));
}

#[tokio::test]
async fn a_full_queue_refuses() {
    let rig = Rig::new().await;
    rig.enqueue(0).await;
    let refused = rig.queue.enqueue(&new_job(0), None, Room { everybody: 1, tenant: 100 }).await;
    assert!(matches!(refused, Err(EnqueueError::Full { waiting: 1 })));
    let refused = rig.queue.enqueue(&new_job(0), None, Room { everybody: 100, tenant: 1 }).await;
    assert!(matches!(refused, Err(EnqueueError::TenantFull { waiting: 1 })));
}

#[tokio::test]
async fn two_services_never_share_a_folder_and_a_lost_database_is_no_empty_one() {
    let rig = Rig::new().await;
    let second = Store::open(rig.folder.path()).await;
    assert!(matches!(second, Err(StoreError::InUse { .. })));
    let database = rig.queue.store.folders.database();
    rig.queue.store.close().await;
    let Rig { folder, queue } = rig;
    drop(queue);
    std::fs::remove_file(&database).unwrap();
    assert!(matches!(Store::open(folder.path()).await, Err(StoreError::DatabaseLost { .. })));
    assert!(!database.exists());
    // What is left of one whose write-ahead log is gone: a page without a table.
    let empty = SqliteConnectOptions::new().filename(&database).create_if_missing(true);
    empty.journal_mode(SqliteJournalMode::Wal).connect().await.unwrap().close().await.unwrap();
    assert!(std::fs::metadata(&database).unwrap().len() > 0);
    assert!(matches!(Store::open(folder.path()).await, Err(StoreError::DatabaseLost { .. })));
}
