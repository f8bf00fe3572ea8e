//! Ends of claims whose answers are lost, strays, and requests that meet.

use super::*;
use crate::service::store::artifacts::Artifact;
use crate::service::store::summary::Summary;
use std::path::Path;

/// A small result in its published folder.
fn published(folder: &Path, n_artifacts: usize) -> Published {
    std::fs::create_dir_all(folder).unwrap();
    let report = r#"{"stages": [], "cameras": [], "people": [], "heldout_px": null, "scale": null,
                     "rejected_detections": 0.0, "quality": {"verdict": "pass", "reasons": []}}"#;
    for (name, text) in
        [("report.json", report), ("cameras.json", r#"{"cameras": []}"#), ("people.json", r#"{"people": []}"#)]
    {
        std::fs::write(folder.join(name), text).unwrap();
    }
    let artifact = |n: usize| Artifact {
        name: format!("{n:0200}"),
        media_type: "application/json".to_owned(),
        bytes: 10,
        sha256: "00".to_owned(),
    };
    let artifacts = (0..n_artifacts).map(artifact).collect();
    Published { artifacts, summary: Summary::read(folder).unwrap() }
}

#[tokio::test]
async fn a_result_survives_a_lost_answer_to_its_commit() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    let folder = test.queue.store.folders.result(&id, claim.fence);
    let outcome = ClaimOutcome::Succeeded(published(&folder, 1));
    for _ in 0..3 {
        let finished = test.queue.finish(&claim, &outcome, 3).await.unwrap();
        assert_eq!(finished, Finished::Recorded(Phase::Succeeded));
        assert!(folder.join("report.json").exists());
    }
    let job = test.queue.get(&tenant(), &id).await.unwrap().unwrap();
    assert!(matches!(job.state, super::super::job::JobState::Succeeded { result_fence: 1, .. }));
    let stored = tenants::stored_bytes(&test.queue.store, &tenant()).await.unwrap();
    assert_eq!(stored, 15, "the result counts once");
}

/// A succeeded job with its claim and outcome.
async fn succeeded(test: &TestQueue) -> (String, super::super::claim::Claim, ClaimOutcome<Published>) {
    let id = test.enqueue(0).await;
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    let outcome = ClaimOutcome::Succeeded(published(&test.queue.store.folders.result(&id, claim.fence), 1));
    let finished = test.queue.finish(&claim, &outcome, 3).await.unwrap();
    assert_eq!(finished, Finished::Recorded(Phase::Succeeded));
    (id, claim, outcome)
}

#[tokio::test]
async fn two_processes_that_add_formats_never_share_a_folder() {
    let test = TestQueue::new().await;
    let (id, ..) = succeeded(&test).await;
    let begin = || async { test.queue.begin_extension(&tenant(), &id).await.unwrap().unwrap() };
    let (first, second) = (begin().await, begin().await);
    assert_eq!((first.published, second.published), (1, 1));
    assert_eq!((first.fence, second.fence, second.files.len()), (2, 3, 1), "a failed attempt is not in the way");
    let folders = &test.queue.store.folders;
    for extension in [&first, &second] {
        std::fs::create_dir_all(folders.result(&id, extension.fence)).unwrap();
    }
    assert!(test.queue.replace_result(&tenant(), &id, &second, &second.files).await.unwrap());
    assert!(!test.queue.replace_result(&tenant(), &id, &first, &first.files).await.unwrap());
    test.queue.store.remove_claim(&id, first.fence).await;
    assert_eq!([2, 3].map(|fence| folders.result(&id, fence).exists()), [false, true]);
    assert_eq!(begin().await.published, second.fence);
}

#[tokio::test]
async fn a_report_repeated_while_formats_are_added_is_not_lost() {
    let test = TestQueue::new().await;
    let (id, claim, outcome) = succeeded(&test).await;
    test.queue.begin_extension(&tenant(), &id).await.unwrap().unwrap();
    let again = test.queue.finish(&claim, &outcome, 3).await.unwrap();
    assert_eq!(again, Finished::Recorded(Phase::Succeeded), "a lost claim removes its files");
}

#[tokio::test]
async fn a_repeated_report_gives_the_recorded_state() {
    let outcomes = [ClaimOutcome::Failed(JobError::default()), ClaimOutcome::Released, crashed(), disk_full()];
    for (outcome, expected) in outcomes.into_iter().zip([Phase::Failed, Phase::Queued, Phase::Queued, Phase::Queued]) {
        let test = TestQueue::new().await;
        let id = test.enqueue(0).await;
        let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
        let first = test.queue.finish(&claim, &outcome, 3).await.unwrap();
        let version = test.queue.get(&tenant(), &id).await.unwrap().unwrap().version;
        let again = test.queue.finish(&claim, &outcome, 3).await.unwrap();
        assert_eq!((first, again), (Finished::Recorded(expected), Finished::Recorded(expected)), "{outcome:?}");
        assert_eq!(test.queue.get(&tenant(), &id).await.unwrap().unwrap().version, version);
    }
}

#[tokio::test]
async fn a_requeued_job_keeps_the_files_of_its_next_claim() {
    let test = TestQueue::new().await;
    let id = test.enqueue(0).await;
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    let folders = &test.queue.store.folders;
    // Another worker can claim the job between the commit of this end and the removal of its files.
    let (own, next) = (folders.staging(&id, claim.fence), folders.staging(&id, claim.fence + 1));
    for folder in [&own, &next] {
        std::fs::create_dir_all(folder).unwrap();
    }
    assert_eq!(test.finish(&claim, crashed()).await, Finished::Recorded(Phase::Queued));
    assert_eq!((own.exists(), next.exists()), (false, true));
}

#[tokio::test]
async fn a_late_report_leaves_the_next_claim_held() {
    if test_support::is_of_sqlite_alone("strays are found by the boot id; there by their beats") {
        return;
    }
    let test = TestQueue::new().await;
    test.enqueue(0).await;
    let first = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    test.finish(&first, crashed()).await;
    let second = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(test.finish(&first, crashed()).await, Finished::Lost);
    test.queue.active.note_strays();
    assert!(test.queue.claim(i64::MAX).await.unwrap().is_none());
    assert_eq!(test.queue.claim_status(&second).await.unwrap(), ClaimStatus::Active);
}

/// Claims a job as a process does that never hears of its COMMIT.
async fn claim_without_answer(test: &TestQueue, id: &str) {
    let mut transaction = test.queue.store.write().await.unwrap();
    let claim = sqlx::query("UPDATE jobs SET state = 'running', fence = fence + 1, boot = $1 WHERE id = $2");
    claim.bind(&test.queue.store.boot).bind(id).execute(&mut *transaction).await.unwrap();
    transaction.commit().await.unwrap();
    test.queue.active.note_strays();
}

#[tokio::test]
async fn a_claim_without_an_answer_heals_without_a_restart() {
    if test_support::is_of_sqlite_alone("strays are found by the boot id; there by their beats") {
        return;
    }
    let test = TestQueue::new().await;
    let (held, stray, canceled) = (test.enqueue(0).await, test.enqueue(0).await, test.enqueue(0).await);
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(claim.job, held);
    claim_without_answer(&test, &stray).await;
    claim_without_answer(&test, &canceled).await;
    test.queue.cancel(&tenant(), &canceled).await.unwrap();
    assert_eq!(test.phase(&canceled).await, Phase::Canceling);
    let next = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!((next.job, next.fence), (stray, 2));
    assert_eq!(test.phase(&canceled).await, Phase::Canceled);
    assert_eq!(test.queue.claim_status(&claim).await.unwrap(), ClaimStatus::Active, "a held claim stays");
}

#[tokio::test(flavor = "multi_thread")]
async fn simultaneous_requests_with_one_key_are_one_job() {
    let test = TestQueue::new().await;
    let key = IdempotencyKey { key: "k".to_owned(), fingerprint: "f".to_owned(), as_sent: None };
    let new = new_job(0);
    let requests = (0..8).map(|_| test.queue.enqueue(&new, Some(&key), LIMITS));
    let jobs = futures_util::future::join_all(requests).await;
    let ids: Vec<String> = jobs.into_iter().map(|job| job.unwrap().id).collect();
    assert!(ids.iter().all(|id| *id == ids[0]), "{ids:?}");
    let page = test.queue.list(&tenant(), &JobFilter::default(), 10).await.unwrap();
    assert_eq!(page.items.len(), 1);
}

#[tokio::test]
async fn a_refused_request_does_not_use_up_its_key() {
    let test = TestQueue::new().await;
    let key = IdempotencyKey { key: "k".to_owned(), fingerprint: "f".to_owned(), as_sent: None };
    let full = test.queue.enqueue(&new_job(0), Some(&key), QueueLimits { total: 0, ..LIMITS }).await;
    assert!(matches!(full, Err(EnqueueError::Full { waiting: 0 })));
    test.queue.enqueue(&new_job(0), Some(&key), LIMITS).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_bytes_at_the_same_time_are_one_session() {
    let test = TestQueue::new().await;
    let known = sessions::get(&test.queue.store, &tenant(), "s").await.unwrap().unwrap().summary;
    let summary = sessions::SessionSummary { sha256: "01".to_owned(), ..known };
    let ids: Vec<String> = (0..8).map(|n| format!("t{n}")).collect();
    let store = &test.queue.store;
    let tenant = tenant();
    let uploads = ids.iter().map(|id| sessions::add(store, &tenant, id, &summary, i64::MAX));
    let added: Vec<_> = futures_util::future::join_all(uploads).await.into_iter().map(Result::unwrap).collect();
    assert_eq!(added.iter().filter(|added| added.is_new).count(), 1);
    assert!(added.iter().all(|other| other.session.id == added[0].session.id));
    assert_eq!(tenants::stored_bytes(store, &tenant).await.unwrap(), 10);
    let full = sessions::SessionSummary { sha256: "02".to_owned(), ..summary.clone() };
    let refused = sessions::add(store, &tenant, "u", &full, 14).await;
    assert!(matches!(refused, Err(sessions::AddError::QuotaExceeded { stored: 10, max: 14 })));
    assert!(sessions::get(store, &tenant, "u").await.unwrap().is_none());
}

/// The counters of all tenants and of all jobs, and the same counted from the jobs.
async fn counters(store: &Store) -> [Vec<(String, String, i64)>; 2] {
    let all = tenants::counters_of_all(store);
    let union = Phase::ALL.map(|phase| {
        let state = phase.name();
        format!(
            "SELECT name, '{state}' AS state, n_{state} AS n FROM tenants WHERE n_{state} <> 0 UNION ALL
             SELECT '' AS name, '{state}' AS state, CAST(coalesce(sum(n_{state}), 0) AS BIGINT) AS n FROM {all} HAVING sum(n_{state}) <> 0"
        )
    });
    let kept = sqlx::AssertSqlSafe(format!("{} ORDER BY name, state", union.join(" UNION ALL ")));
    let counted =
        "SELECT tenant, state, count(*) FROM jobs GROUP BY tenant, state UNION ALL SELECT '', state, count(*) FROM jobs GROUP BY state
         ORDER BY 1, 2";
    [
        sqlx::query_as(kept).fetch_all(store.read()).await.unwrap(),
        sqlx::query_as(counted).fetch_all(store.read()).await.unwrap(),
    ]
}

#[tokio::test]
async fn counters_equal_the_jobs_after_any_change() {
    use rand::{RngExt, SeedableRng};
    let test = TestQueue::new().await;
    let other = Tenant::parse("other").unwrap();
    let summary = sessions::get(&test.queue.store, &tenant(), "s").await.unwrap().unwrap().summary;
    sessions::add(&test.queue.store, &other, "t", &summary, i64::MAX).await.unwrap();
    let mut dice = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let (mut jobs, mut claims) = (Vec::new(), Vec::new());
    for _ in 0..300 {
        match dice.random_range(0..6) {
            0 | 1 => {
                let (tenant, session) = if dice.random_bool(0.5) { (tenant(), "s") } else { (other.clone(), "t") };
                let new = NewJob { tenant: tenant.clone(), session: session.to_owned(), ..new_job(0) };
                jobs.push((tenant, test.queue.enqueue(&new, None, LIMITS).await.unwrap().id));
            }
            2 => claims.extend(test.queue.claim(3).await.unwrap()),
            3 if !claims.is_empty() => {
                let claim = claims.swap_remove(dice.random_range(0..claims.len()));
                let outcome = if dice.random_bool(0.5) { crashed() } else { ClaimOutcome::Failed(JobError::default()) };
                test.finish(&claim, outcome).await;
            }
            4 if !jobs.is_empty() => {
                let (tenant, id) = &jobs[dice.random_range(0..jobs.len())];
                test.queue.cancel(tenant, id).await.unwrap();
            }
            5 if !jobs.is_empty() && dice.random_bool(0.3) => {
                let (tenant, id) = jobs.swap_remove(dice.random_range(0..jobs.len()));
                assert!(test.queue.delete(&tenant, &id).await.unwrap());
            }
            _ => {}
        }
    }
    let [kept, counted] = counters(&test.queue.store).await;
    assert!(counted.len() > 6, "{counted:?}");
    assert_eq!(kept, counted);
    if test.queue.store.is_shared() {
        // What the migration does with the jobs that it finds, and a move with the rows that it has copied.
        for change in ["UPDATE job_totals SET n_queued = 7", "SELECT 1 FROM add_up_totals()"] {
            sqlx::query(change).execute(test.queue.store.read()).await.unwrap();
        }
        assert_eq!(counters(&test.queue.store).await[0], counted);
    }
}
