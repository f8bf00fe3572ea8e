//! Several processes on one PostgreSQL server; left out where `WANDLESS_TEST_POSTGRES` names none.

use super::super::lease::SeenBeats;
use super::*;
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

/// Looks as the leader does, for longer than a lease.
async fn look(test: &TestQueue, leader: &mut PgConnection) {
    let mut seen = SeenBeats::default();
    let end = Instant::now() + 2 * LEASE;
    while Instant::now() < end {
        test.queue.put_back_silent(leader, &mut seen, LEASE).await.unwrap();
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
