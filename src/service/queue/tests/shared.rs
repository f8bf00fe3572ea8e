//! Several processes on one PostgreSQL server; left out where `WANDLESS_TEST_POSTGRES` names none.

use super::super::lease::SeenBeats;
use super::*;
use crate::service::store::{artifacts, keys};
use crate::service::webhooks;
use sqlx::postgres::PgConnection;

/// A queue on a server, and a connection as the leader has it; `None` without a server.
async fn shared() -> Option<(TestQueue, PgConnection)> {
    let test = TestQueue::new().await;
    let Some(leader) = test.queue.store.own_connection().await.unwrap() else {
        eprintln!("SKIPPED on SQLite: a test of several processes");
        return None;
    };
    Some((test, leader))
}

const LEASE: Duration = Duration::from_millis(300);
const MAX_LOSSES: i64 = 3;

/// Changes rows as no code of the service does.
async fn execute(leader: &mut PgConnection, statement: &'static str) {
    sqlx::query(statement).execute(leader).await.unwrap();
}

/// Looks as the leader does, for longer than a lease.
async fn look(test: &TestQueue, leader: &mut PgConnection) {
    let mut seen = SeenBeats::default();
    let end = Instant::now() + 2 * LEASE;
    while Instant::now() < end {
        test.queue.put_back_silent(leader, &mut seen, LEASE, MAX_LOSSES).await.unwrap();
        tokio::time::sleep(LEASE / 10).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_claim_is_put_back_and_reports_in_vain() {
    let Some((test, mut leader)) = shared().await else { return };
    let (alive, silent, canceled) = (test.enqueue(0).await, test.enqueue(0).await, test.enqueue(0).await);
    let mut claims = Vec::new();
    for _ in 0..3 {
        claims.push(test.queue.claim(i64::MAX).await.unwrap().unwrap());
    }
    test.queue.cancel(&tenant(), &canceled).await.unwrap();
    let (queue, claim) = (test.queue.clone(), claims[0].clone());
    assert_eq!(claim.job, alive);
    let beating = tokio::spawn(async move {
        loop {
            assert_eq!(queue.beat(&claim).await.unwrap(), ClaimStatus::Active);
            tokio::time::sleep(LEASE / 6).await;
        }
    });
    look(&test, &mut leader).await;
    beating.abort();
    let phases = [test.phase(&alive).await, test.phase(&silent).await, test.phase(&canceled).await];
    assert_eq!(phases, [Phase::Running, Phase::Queued, Phase::Canceled]);
    let job = test.queue.get(&tenant(), &silent).await.unwrap().unwrap();
    assert_eq!(job.attempt, 1, "no crash is counted");
    let late = claims[1].clone();
    assert_eq!(test.queue.beat(&late).await.unwrap(), ClaimStatus::Lost);
    let failed = || ClaimOutcome::Failed(JobError::default());
    assert_eq!(test.finish(&late, failed()).await, Finished::Lost);
    let again = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(again.job, silent);
    assert_eq!(test.finish(&late, failed()).await, Finished::Lost);
    assert_eq!(test.finish(&again, failed()).await, Finished::Recorded(Phase::Failed));
}

#[tokio::test(flavor = "multi_thread")]
async fn simultaneous_claims_take_each_job_once_within_the_limit() {
    let Some((test, _)) = shared().await else { return };
    for _ in 0..60 {
        test.enqueue(0).await;
    }
    let claim = |limit: i64| {
        let queue = test.queue.clone();
        tokio::spawn(async move {
            let mut claims = Vec::new();
            while let Some(claim) = queue.claim(limit).await.unwrap() {
                claims.push(claim.job);
            }
            claims
        })
    };
    let gather = async |tasks: Vec<tokio::task::JoinHandle<Vec<String>>>| -> Vec<String> {
        futures_util::future::join_all(tasks).await.into_iter().flat_map(Result::unwrap).collect()
    };
    let first = gather((0..8).map(|_| claim(3)).collect()).await;
    assert_eq!(first.len(), 3, "never more than three at once");
    let mut all = gather((0..8).map(|_| claim(i64::MAX)).collect()).await;
    all.extend(first);
    all.sort();
    all.dedup();
    assert_eq!(all.len(), 60, "each job once, none left out");
}

/// Claims that waited for the tenant of the first one took its next jobs, and the other tenant came last; and a claim that began before
/// another one ended, and locked the tenant after it, took that tenant's next job.
#[tokio::test(flavor = "multi_thread")]
async fn simultaneous_claims_take_tenants_in_turn() {
    let Some((test, _)) = shared().await else { return };
    let other = Tenant::parse("other").unwrap();
    let summary = sessions::get(&test.queue.store, &tenant(), "s").await.unwrap().unwrap().summary;
    sessions::add(&test.queue.store, &other, "t", &summary, i64::MAX).await.unwrap();
    const ROUNDS: usize = 45; // two jobs each: the queue takes 100
    for _ in 0..ROUNDS {
        test.enqueue(0).await;
        let new = NewJob { tenant: other.clone(), session: "t".to_owned(), ..new_job(0) };
        test.queue.enqueue(&new, None, LIMITS).await.unwrap();
    }
    for round in 0..ROUNDS {
        let claim = || async { test.queue.claim(i64::MAX).await.unwrap().unwrap().session };
        let (first, second) = tokio::join!(claim(), claim());
        assert_ne!(first, second, "round {round}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn another_process_notices_a_change() {
    let Some((test, _)) = shared().await else { return };
    let other = Queue::new(test.queue.store.clone());
    let draining = tokio_util::sync::CancellationToken::new();
    let listening = tokio::spawn(super::super::wake::listen(other.clone(), draining.clone()));
    tokio::time::sleep(Duration::from_millis(500)).await;
    let id = test.enqueue(0).await;
    let mut following = other.follow(&id);
    let start = Instant::now();
    test.queue.cancel(&tenant(), &id).await.unwrap();
    assert!(tokio::time::timeout(Duration::from_secs(2), following.changed()).await.unwrap());
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
    draining.cancel();
    listening.await.unwrap();
    // Without notifications the followed jobs are read.
    let draining = tokio_util::sync::CancellationToken::new();
    let watching = tokio::spawn(super::super::wake::watch(other.clone(), draining.clone()));
    let id = test.enqueue(0).await;
    let mut following = other.follow(&id);
    assert!(tokio::time::timeout(Duration::from_secs(3), following.changed()).await.unwrap(), "the first read");
    test.queue.cancel(&tenant(), &id).await.unwrap();
    assert!(tokio::time::timeout(Duration::from_secs(3), following.changed()).await.unwrap());
    draining.cancel();
    watching.await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_takes_down_its_workers_fails() {
    let Some((test, mut leader)) = shared().await else { return };
    let id = test.enqueue(0).await;
    for losses in 1..=MAX_LOSSES {
        assert_eq!(test.queue.claim(i64::MAX).await.unwrap().unwrap().job, id);
        look(&test, &mut leader).await;
        let expected = if losses < MAX_LOSSES { Phase::Queued } else { Phase::Failed };
        assert_eq!(test.phase(&id).await, expected, "{losses} lost workers");
    }
    let job = test.queue.get(&tenant(), &id).await.unwrap().unwrap();
    let error = job.state.error().unwrap();
    assert_eq!((error.code.as_str(), job.attempt), ("worker_lost", 1), "no crash is counted");
    assert!(error.detail.starts_with("3 workers"), "{}", error.detail);
}

#[tokio::test(flavor = "multi_thread")]
async fn losses_of_a_job_that_gets_on_are_counted_anew() {
    let Some((test, mut leader)) = shared().await else { return };
    let id = test.enqueue(0).await;
    for stage in 0..=MAX_LOSSES {
        let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
        let progress = JobProgress { stage_index: stage, ..JobProgress::default() };
        test.queue.heartbeat(&claim, &progress, &BTreeMap::new()).await.unwrap();
        look(&test, &mut leader).await;
        assert_eq!(test.phase(&id).await, Phase::Queued, "stage {stage}");
    }
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    let earlier = JobProgress { stage_index: 1, ..JobProgress::default() };
    test.queue.heartbeat(&claim, &earlier, &BTreeMap::new()).await.unwrap();
    look(&test, &mut leader).await;
    let losses: i64 = sqlx::query_scalar("SELECT losses FROM jobs").fetch_one(&mut leader).await.unwrap();
    assert_eq!(losses, 2, "a loss in an earlier stage is one more");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_claims_what_it_has_memory_for_the_larger_job_first() {
    let Some((test, mut leader)) = shared().await else { return };
    let (small, large, urgent) = (test.enqueue(0).await, test.enqueue(0).await, test.enqueue(5).await);
    sqlx::query("UPDATE jobs SET class = 2 WHERE id = $1").bind(&large).execute(&mut leader).await.unwrap();
    let claim = |class| {
        let queue = test.queue.clone().with_class(class);
        async move { queue.claim(i64::MAX).await.unwrap().map(|claim| claim.job) }
    };
    assert_eq!(claim(Some(2)).await.as_ref(), Some(&urgent), "priority before size");
    assert_eq!(claim(Some(2)).await.as_ref(), Some(&large));
    let second = test.enqueue(0).await;
    sqlx::query("UPDATE jobs SET class = 1 WHERE id = $1").bind(&second).execute(&mut leader).await.unwrap();
    assert_eq!(claim(Some(0)).await.as_ref(), Some(&small));
    assert_eq!(claim(Some(0)).await, None, "a job of class 1 does not fit");
    assert_eq!(claim(None).await.as_ref(), Some(&second), "a worker without a class takes every job");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_without_enough_memory_goes_to_a_larger_worker() {
    let Some((test, mut leader)) = shared().await else { return };
    let id = test.enqueue(0).await;
    let out_of_memory = || {
        let code = class::OUT_OF_MEMORY.to_owned();
        ClaimOutcome::Failed(JobError { code, ..JobError::default() })
    };
    for worker in [1, 2] {
        let queue = test.queue.clone().with_class(Some(worker));
        let claim = queue.claim(i64::MAX).await.unwrap().unwrap();
        assert_eq!(queue.finish(&claim, &out_of_memory(), 3).await.unwrap(), Finished::Recorded(Phase::Queued));
        assert!(queue.claim(i64::MAX).await.unwrap().is_none(), "the same worker does not try again");
    }
    let statistics = test.queue.statistics().await.unwrap();
    assert_eq!(statistics.server.work_wanted, [0, 0, 0, 1]);
    let queue = test.queue.clone().with_class(Some(3));
    let claim = queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!(queue.finish(&claim, &out_of_memory(), 3).await.unwrap(), Finished::Recorded(Phase::Failed));
    assert_eq!(test.queue.statistics().await.unwrap().server.work_wanted, [0, 0, 0, 0]);
    let plain = test.enqueue(0).await;
    let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
    assert_eq!((&claim.job, test.finish(&claim, out_of_memory()).await), (&plain, Finished::Recorded(Phase::Failed)));
    test.queue.delete(&tenant(), &id).await.unwrap();
    let left: i64 = sqlx::query_scalar("SELECT count(*) FROM jobs").fetch_one(&mut leader).await.unwrap();
    assert_eq!(left, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_passes_over_the_jobs_of_a_newer_release() {
    let Some((test, mut leader)) = shared().await else { return };
    let (newer, known) = (test.enqueue(9).await, test.enqueue(0).await);
    let raise = sqlx::query("UPDATE jobs SET needs = needs + 1 WHERE id = $1").bind(&newer);
    raise.execute(&mut leader).await.unwrap();
    assert_eq!(test.queue.claim(i64::MAX).await.unwrap().unwrap().job, known);
    assert!(test.queue.claim(i64::MAX).await.unwrap().is_none());
    assert_eq!(test.phase(&newer).await, Phase::Queued);
}

/// A prepared statement whose columns have changed is refused by the server: "cached plan must not change result type".
#[tokio::test(flavor = "multi_thread")]
async fn a_newer_release_adds_columns_while_this_one_serves() {
    let Some((test, mut leader)) = shared().await else { return };
    let everything = async || {
        let id = test.enqueue(0).await;
        test.queue.get(&tenant(), &id).await.unwrap().unwrap();
        test.queue.list(&tenant(), &JobFilter::default(), 10).await.unwrap();
        let session = sessions::get(&test.queue.store, &tenant(), "s").await.unwrap().unwrap();
        sessions::list(&test.queue.store, &tenant(), i64::MAX, 10).await.unwrap();
        sessions::get_by_sha256(&test.queue.store, &tenant(), &session.summary.sha256).await.unwrap().unwrap();
        assert!(
            !sessions::add(&test.queue.store, &tenant(), "again", &session.summary, i64::MAX).await.unwrap().is_new
        );
        keys::create(&test.queue.store, &tenant(), "", &keys::Scope::ALL).await.unwrap();
        keys::list(&test.queue.store).await.unwrap();
        artifacts::list(&test.queue.store, &id).await.unwrap();
        webhooks::deliveries_of(&test.queue.store, &tenant(), &id).await.unwrap();
        let claim = test.queue.claim(i64::MAX).await.unwrap().unwrap();
        test.queue.beat(&claim).await.unwrap();
        test.queue.statistics().await.unwrap();
        assert_eq!(test.finish(&claim, crashed()).await, Finished::Recorded(Phase::Queued));
        test.queue.delete(&tenant(), &id).await.unwrap();
    };
    for _ in 0..20 {
        everything().await; // on every connection of the pool
    }
    for add in [
        "ALTER TABLE jobs ADD COLUMN of_the_next_release TEXT",
        "ALTER TABLE sessions ADD COLUMN of_the_next_release TEXT",
        "ALTER TABLE api_keys ADD COLUMN of_the_next_release TEXT",
        "ALTER TABLE artifacts ADD COLUMN of_the_next_release TEXT",
        "ALTER TABLE tenants ADD COLUMN of_the_next_release TEXT",
        "ALTER TABLE webhook_deliveries ADD COLUMN of_the_next_release TEXT",
    ] {
        execute(&mut leader, add).await;
    }
    for _ in 0..20 {
        everything().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_gate_decides_which_releases_may_use_the_database() {
    let Some((test, mut leader)) = shared().await else { return };
    execute(
        &mut leader,
        "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) VALUES (9000, 'newer', true, '', 0)",
    )
    .await;
    let folder = test.folder.path().to_owned();
    test_support::open_again(&folder).await.unwrap().unwrap().close().await;
    execute(&mut leader, "UPDATE gate SET oldest_release = '99.0.0'").await;
    let error = test_support::open_again(&folder).await.unwrap().unwrap_err().to_string();
    assert!(error.contains("needs wandless 99.0.0 or newer"), "{error}");
}
