//! Tests of what a worker does with the end of a job.

use super::super::queue::job::Submitter;
use super::super::queue::{NewJob, QueueLimits};
use super::super::settings::JobSettings;
use super::super::store::sessions;
use super::super::store::{Tenant, test_support};
use super::*;
use crate::service::store::artifacts::Artifact;
use std::collections::BTreeMap;
use std::time::Instant;

#[test]
fn a_crash_without_lack_of_memory_counts_as_a_crash() {
    for signal in [None, Some(6), Some(9)] {
        let crash = Crash { how: "how".to_owned(), signal };
        let outcome = crashed(crash, Some(1), Some(u64::MAX));
        assert!(matches!(outcome, ClaimOutcome::Crashed(how) if how == "how"), "{signal:?}");
    }
}

/// A queue with one claimed job.
struct Claimed {
    folder: tempfile::TempDir,
    store: Store,
    queue: Queue,
    claim: Claim,
}

impl Claimed {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = test_support::open(folder.path()).await;
        let queue = Queue::new(store.clone());
        let tenant = Tenant::default_tenant();
        let summary = test_support::summary();
        sessions::add(&store, &tenant, "s", &summary, i64::MAX).await.unwrap();
        let new = NewJob {
            tenant,
            session: "s".to_owned(),
            options: serde_json::json!({}),
            labels: BTreeMap::new(),
            priority: 0,
            webhook: None,
            submitter: Submitter::default(),
        };
        queue.enqueue(&new, None, QueueLimits { total: 9, tenant: 9, max_bytes: i64::MAX }).await.unwrap();
        let claim = queue.claim(9).await.unwrap().unwrap();
        Self { folder, store, queue, claim }
    }

    /// A published result whose files have these names.
    fn published(&self, names: &[String]) -> ClaimOutcome<Published> {
        let folder = self.store.folders.result(&self.claim.job, self.claim.fence);
        std::fs::create_dir_all(&folder).unwrap();
        let report = r#"{"stages": [], "cameras": [], "people": [], "heldout_px": null, "scale": null,
                         "rejected_detections": 0.0, "quality": {"verdict": "pass", "reasons": []}}"#;
        std::fs::write(folder.join("report.json"), report).unwrap();
        std::fs::write(folder.join("cameras.json"), r#"{"cameras": []}"#).unwrap();
        std::fs::write(folder.join("people.json"), r#"{"people": []}"#).unwrap();
        let artifact = |name: &String| Artifact {
            name: name.clone(),
            media_type: "text/plain".to_owned(),
            bytes: 1,
            sha256: "00".to_owned(),
        };
        let artifacts = names.iter().map(artifact).collect();
        ClaimOutcome::Succeeded(Published { artifacts, summary: Summary::read(&folder).unwrap() })
    }

    async fn record(&self, outcome: ClaimOutcome<Published>) -> &'static str {
        let draining = CancellationToken::new();
        record(&self.store, &self.queue, &Settings::default(), &self.claim, outcome, &draining).await
    }

    async fn job(&self) -> crate::service::queue::job::Job {
        self.queue.get(&Tenant::default_tenant(), &self.claim.job).await.unwrap().unwrap()
    }
}

#[tokio::test]
async fn a_result_whose_rows_do_not_fit_ends_the_job() {
    let claimed = Claimed::new().await;
    let twice = ["a".to_owned(), "a".to_owned()];
    assert_eq!(claimed.record(claimed.published(&twice)).await, "failed");
    let job = claimed.job().await;
    assert_eq!(job.state.error().unwrap().code, "result_unrecorded");
    assert!(!claimed.store.folders.job(&job.id).exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_end_on_a_full_database_is_recorded_later() {
    if test_support::is_of_sqlite_alone("a full database file") {
        return;
    }
    let claimed = Claimed::new().await;
    let limit_pages = async |limit: &'static str| {
        let mut transaction = claimed.store.write().await.unwrap();
        sqlx::query(limit).fetch_all(&mut *transaction).await.unwrap();
        transaction.rollback().await.unwrap();
    };
    limit_pages("PRAGMA max_page_count = 1").await; // the present size is the limit
    let names: Vec<String> = (0..300).map(|n| format!("{n:0500}")).collect();
    let outcome = claimed.published(&names);
    let start = Instant::now();
    let space_comes = async {
        tokio::time::sleep(RETRY_INTERVAL / 2).await;
        limit_pages("PRAGMA max_page_count = 4294967294").await;
    };
    let (end, ()) = tokio::join!(claimed.record(outcome), space_comes);
    assert_eq!(end, "succeeded");
    assert!(start.elapsed() >= RETRY_INTERVAL, "the first try failed");
    assert!(claimed.store.folders.result(&claimed.claim.job, 1).join("report.json").exists());
}

/// A child whose messages come every 0.1 s, for 3 s.
async fn talkative_child(folder: &Path) -> Child {
    use std::os::unix::fs::PermissionsExt;
    let script = folder.join("child.sh");
    let messages = r#"{"event":"alive"}
{"event":"progress","stage":"s","stage_index":0,"stage_count":1,"fraction":0.5,"message":"m"}"#;
    let text = format!(
        "#!/bin/sh\nfor n in $(seq 30); do\necho '{messages}'\nsleep 0.1\ndone\necho '{{\"event\":\"done\"}}'\n"
    );
    std::fs::write(&script, text).unwrap();
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o700)).unwrap();
    Child::start(&script, "run", &Order::new((), None), |_| ()).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_that_is_away_makes_no_child_silent() {
    let claimed = Claimed::new().await;
    let settings = JobSettings { silence_limit: Duration::from_secs(1), ..JobSettings::default() };
    let mut child = talkative_child(claimed.folder.path()).await;
    let mut locked = claimed.store.write().await.unwrap();
    let lock = sqlx::query("UPDATE jobs SET version = version WHERE id = $1").bind(&claimed.claim.job);
    lock.execute(&mut *locked).await.unwrap();
    let unlock = async {
        tokio::time::sleep(Duration::from_millis(2500)).await;
        locked.rollback().await.unwrap();
    };
    let metrics = Metrics::default();
    let supervised =
        supervise(&mut child, &claimed.queue, &settings, &metrics, &claimed.claim, CancellationToken::new());
    let (exit, ()) = tokio::join!(supervised, unlock);
    assert!(matches!(exit, ChildExit::Done), "{exit:?}");
    assert_eq!(claimed.job().await.progress.stage, "s");
}
