//! Results: the manifest, all its files, ranges, damaged files, and the summary rows.

use crate::http::Answer;
use crate::server::Server;
use crate::store::is_of_sqlite_alone;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use sqlx::Row;

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn succeeded() -> (Server, String) {
    let server = Server::start();
    let id = server.submit(&server.upload(20, 1));
    server.wait_for_state(&id, "succeeded");
    (server, id)
}

#[test]
fn serves_every_file_of_the_manifest() {
    let (server, id) = succeeded();
    let manifest = server.get(&format!("/v1/jobs/{id}/result")).expect(200).json();
    let files = manifest["files"].as_array().unwrap();
    assert!(files.len() >= 3);
    for file in files {
        let name = file["name"].as_str().unwrap();
        let answer = server.get(&format!("/v1/jobs/{id}/artifacts/{name}")).expect(200);
        assert_eq!(sha256(&answer.body), file["sha256"].as_str().unwrap(), "{name}");
        assert_eq!(answer.header("etag"), format!("\"{}\"", file["sha256"].as_str().unwrap()));
        assert_eq!(answer.body.len() as u64, file["bytes"].as_u64().unwrap());
    }
    for name in ["cameras", "people", "report"] {
        let short = server.get(&format!("/v1/jobs/{id}/{name}")).expect(200);
        let long = server.get(&format!("/v1/jobs/{id}/artifacts/{name}.json")).expect(200);
        assert_eq!(short.body, long.body);
        assert_eq!(short.header("content-type"), "application/json");
    }
    server.get(&format!("/v1/jobs/{id}/artifacts/../../wandless.db")).expect_problem(404, "not_found");
    server.get(&format!("/v1/jobs/{id}/artifacts/%2e%2e%2fwandless.db")).expect_problem(404, "not_found");
}

#[test]
fn honours_ranges_and_conditions() {
    let (server, id) = succeeded();
    let path = format!("/v1/jobs/{id}/cameras");
    let whole = server.get(&path).expect(200);
    let (bytes, tag) = (&whole.body, whole.header("etag"));
    let ranged = |range: &str| -> Answer { server.get_with(&path, &[("range", range)]) };
    let n = bytes.len();
    for (range, start, end) in
        [("bytes=0-9", 0, 10), ("bytes=5-", 5, n), ("bytes=-7", n - 7, n), ("bytes=0-99999999", 0, n)]
    {
        let part = ranged(range).expect(206);
        assert_eq!(part.body, bytes[start..end], "{range}");
        assert_eq!(part.header("content-range"), format!("bytes {start}-{}/{n}", end - 1));
    }
    let behind = ranged(&format!("bytes={n}-"));
    assert_eq!(behind.header("content-range"), format!("bytes */{n}"));
    behind.expect_problem(416, "range_not_satisfiable");
    server.get_with(&path, &[("range", "bytes=0-1"), ("if-range", tag)]).expect(206);
    server.get_with(&path, &[("range", "bytes=0-1"), ("if-range", "\"other\"")]).expect(200);
    server.get_with(&path, &[("if-none-match", tag)]).expect(304);
    let head = crate::http::send("HEAD", &server.url(&path), &[], None).expect(200);
    assert_eq!(head.header("content-length"), n.to_string());
}

#[test]
fn damaged_file_is_an_error() {
    if is_of_sqlite_alone("a damaged copy is fetched again") {
        return;
    }
    let (server, id) = succeeded();
    let path = server.files("results").into_iter().find(|path| path.ends_with("report.json")).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[3] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    server.get(&format!("/v1/jobs/{id}/report")).expect_problem(500, "corrupt");
    std::fs::remove_file(&path).unwrap();
    server.get(&format!("/v1/jobs/{id}/report")).expect_problem(500, "corrupt");
    server.get(&format!("/v1/jobs/{id}/cameras")).expect(200);
}

#[test]
fn summary_rows_match_the_files() {
    if is_of_sqlite_alone("reads the rows from the database file") {
        return;
    }
    let (server, id) = succeeded();
    let report = server.get(&format!("/v1/jobs/{id}/report")).json();
    let cameras = server.get(&format!("/v1/jobs/{id}/cameras")).json();
    let people = server.get(&format!("/v1/jobs/{id}/people")).json();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(server.data().join("wandless.db"));
        let database = sqlx::SqlitePool::connect_with(options.read_only(true)).await.unwrap();
        let verdict =
            sqlx::query("SELECT * FROM verdicts WHERE job_id = ?").bind(&id).fetch_one(&database).await.unwrap();
        assert_eq!(report["quality"]["verdict"], verdict.get::<String, _>("verdict"));
        let reasons: Value = serde_json::from_str(verdict.get("reasons")).unwrap();
        assert_eq!(report["quality"]["reasons"], reasons);
        assert_eq!(report["heldout_px"].as_f64(), verdict.get::<Option<f64>, _>("heldout_px"));

        let rows = sqlx::query("SELECT * FROM stage_metrics WHERE job_id = ? ORDER BY stage_index");
        let rows = rows.bind(&id).fetch_all(&database).await.unwrap();
        assert_eq!(rows.len(), report["stages"].as_array().unwrap().len());
        for (row, stage) in rows.iter().zip(report["stages"].as_array().unwrap()) {
            assert_eq!(stage["stage"], row.get::<String, _>("stage"));
            assert_eq!(stage["iterations"], row.get::<i64, _>("iterations"));
            assert_eq!(stage["cost_after"].as_f64(), row.get::<Option<f64>, _>("cost_after"));
        }
        let figures: i64 = sqlx::query_scalar("SELECT count(*) FROM stage_metric_values WHERE job_id = ?")
            .bind(&id)
            .fetch_one(&database)
            .await
            .unwrap();
        let expected =
            report["stages"].as_array().unwrap().iter().map(|stage| stage["metrics"].as_object().unwrap().len());
        assert_eq!(figures as usize, expected.sum::<usize>());

        let rows = sqlx::query("SELECT * FROM camera_results WHERE job_id = ? ORDER BY camera_index");
        let rows = rows.bind(&id).fetch_all(&database).await.unwrap();
        assert_eq!(rows.len(), cameras["cameras"].as_array().unwrap().len());
        for (row, camera) in rows.iter().zip(cameras["cameras"].as_array().unwrap()) {
            assert_eq!(camera["id"], row.get::<String, _>("camera"));
            assert_eq!(camera["status"], row.get::<String, _>("status"));
            assert_eq!(camera["position"][1].as_f64(), row.get::<Option<f64>, _>("position_y"));
        }
        let rows = sqlx::query("SELECT * FROM person_results WHERE job_id = ? ORDER BY person");
        let rows = rows.bind(&id).fetch_all(&database).await.unwrap();
        assert_eq!(rows.len(), people["people"].as_array().unwrap().len());
        for (row, person) in rows.iter().zip(people["people"].as_array().unwrap()) {
            assert_eq!(person["id"], row.get::<i64, _>("person"));
            assert_eq!(person["frames"].as_array().unwrap().len() as i64, row.get::<i64, _>("n_frames"));
        }
    });
}

#[test]
fn exports_are_added_once_and_survive_a_restart() {
    let (server, id) = succeeded();
    let names = |manifest: &Value| -> Vec<String> {
        manifest["files"].as_array().unwrap().iter().map(|file| file["name"].as_str().unwrap().to_owned()).collect()
    };
    let before = server.get(&format!("/v1/jobs/{id}/result")).expect(200).json();
    let path = format!("/v1/jobs/{id}/exports");
    let added = server.post_json(&path, &json!({ "exports": ["glb", "bvh", "mot", "angles_csv", "glb"] })).expect(200);
    let after = added.json();
    assert!(names(&before).iter().all(|name| names(&after).contains(name)));
    assert_eq!(names(&after).iter().filter(|name| *name == "scene.glb").count(), 1);
    assert!(
        ["0.angles.csv", "0.mot"].iter().all(|file| names(&after).contains(&(*file).to_owned())),
        "the contract's names"
    );
    let again = server.post_json(&path, &json!({ "exports": ["bvh"] })).expect(200);
    assert_eq!(added.header("etag"), again.header("etag"));
    let scene = server.get(&format!("/v1/jobs/{id}/artifacts/scene.glb")).expect(200).body;
    assert!(scene.starts_with(b"glTF"));

    let server = server.killed_and_restarted();
    assert_eq!(server.get(&format!("/v1/jobs/{id}/artifacts/scene.glb")).expect(200).body, scene);
    let archive = server.get(&format!("/v1/jobs/{id}/archive")).expect(200);
    assert_eq!(archive.header("content-type"), "application/zip");
    let archive = zip::ZipArchive::new(std::io::Cursor::new(archive.body)).unwrap();
    assert_eq!(archive.len(), names(&after).len() + 1);
    if is_of_sqlite_alone("verify") {
        return;
    }
    let verified = std::process::Command::new(env!("CARGO_BIN_EXE_wandless")).arg("verify").arg(server.data()).output();
    let verified = verified.unwrap();
    assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stdout));
    assert!(String::from_utf8_lossy(&verified.stdout).contains("0 damaged, 0 strays"));
}

#[test]
fn exports_of_other_jobs_and_formats_are_refused() {
    let (server, id) = succeeded();
    let path = format!("/v1/jobs/{id}/exports");
    server.post_json(&path, &json!({ "exports": ["mp3"] })).expect_problem(400, "malformed");
    server.post_json(&path, &json!({ "exports": [] })).expect_problem(400, "malformed");
    server.post_json(&path, &json!([["glb"]])).expect_problem(400, "malformed");
    let other = format!("/v1/jobs/job_{}/exports", "0".repeat(32));
    server.post_json(&other, &json!({ "exports": ["glb"] })).expect_problem(404, "not_found");
    server.get(&format!("/v1/jobs/job_{}/archive", "0".repeat(32))).expect_problem(404, "not_found");
    if is_of_sqlite_alone("a damaged copy is fetched again") {
        return;
    }
    let damaged = server.files("results").into_iter().find(|path| path.ends_with("people.json")).unwrap();
    std::fs::write(&damaged, b"{}").unwrap();
    server.post_json(&path, &json!({ "exports": ["glb"] })).expect_problem(500, "corrupt");
}
