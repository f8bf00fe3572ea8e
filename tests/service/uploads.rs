//! Sessions: every form of upload, repeated uploads, lists, deletion.

use crate::http::{FORM, JSON, ZIP, form};
use crate::server::Server;
use crate::store::is_of_sqlite_alone;
use crate::take::{LONG, take, zipped};

#[test]
fn accepts_every_form_and_deduplicates_bytes() {
    let server = Server::start();
    let zip = zipped(&take(10, 1));
    let new = server.post("/v1/sessions", &[ZIP], &zip).expect(201);
    let session = new.json();
    assert_eq!(new.header("location"), format!("/v1/sessions/{}", session["id"].as_str().unwrap()));
    assert_eq!(session["cameras"], 4);
    assert_eq!(session["frames"], 10);
    assert_eq!(session["people_max"], 2);
    assert_eq!(session["keypoint_convention"], "coco17");
    assert_eq!(session["name"], "take 1");
    assert_eq!(session["sha256"].as_str().unwrap().len(), 64);
    assert!(session["warnings"].is_array() && session["format"].is_string());

    let again = server.post("/v1/sessions", &[FORM], &form(&[("session", &zip)])).expect(200);
    assert_eq!(again.json()["id"], session["id"]);
    let document = take(10, 1).to_string();
    let other_bytes = server.post("/v1/sessions", &[JSON], document.as_bytes()).expect(201);
    assert_ne!(other_bytes.json()["id"], session["id"]);
    assert_eq!(server.files("sessions").len(), 2);
    assert_eq!(server.files("tmp").len(), 0);
}

/// The client's file is whole: what is wrong is on the service's disk, and the same upload repairs it.
#[test]
fn same_upload_repairs_a_session_on_a_bad_disk() {
    if is_of_sqlite_alone("an object is not changed in place") {
        return;
    }
    let server = Server::start();
    let zip = zipped(&take(10, 1));
    let id = server.post("/v1/sessions", &[ZIP], &zip).expect(201).json()["id"].as_str().unwrap().to_owned();
    let stored = server.files("sessions").remove(0);
    let mut damaged = zip.clone();
    damaged[zip.len() / 2] ^= 1;
    for bytes in [Some(damaged.as_slice()), Some(&zip[..100]), None] {
        match bytes {
            Some(bytes) => std::fs::write(&stored, bytes).unwrap(),
            None => std::fs::remove_file(&stored).unwrap(),
        }
        server.get(&format!("/v1/sessions/{id}/inspection")).expect_problem(500, "corrupt");
        let job = server.wait_for_state(&server.submit(&id), "failed");
        assert_eq!(job["error"]["code"], "session_changed", "{job}");
        let again = server.post("/v1/sessions", &[ZIP], &zip).expect(200).json();
        assert_eq!(again["id"], id.as_str());
        assert_eq!(std::fs::read(&stored).unwrap(), zip);
    }
    server.wait_for_state(&server.submit(&id), "succeeded");
    server.get(&format!("/v1/sessions/{id}/inspection")).expect(200);
}

#[test]
fn concurrent_identical_uploads_give_one_session() {
    let server = Server::start();
    let zip = zipped(&take(10, 1));
    let mut ids: Vec<String> = std::thread::scope(|scope| {
        let uploads: Vec<_> =
            (0..8).map(|_| scope.spawn(|| server.post("/v1/sessions", &[ZIP], &zip).json())).collect();
        uploads.into_iter().map(|upload| upload.join().unwrap()["id"].as_str().unwrap().to_owned()).collect()
    });
    ids.dedup();
    assert_eq!(ids.len(), 1);
    assert_eq!(server.n_files_left("sessions", 1), 1);
}

#[test]
fn lists_sessions_in_pages_and_deletes_unused_ones() {
    let server = Server::start();
    let ids: Vec<String> = (0..3).map(|seed| server.upload(10, seed)).collect();
    let first = server.get("/v1/sessions?page_size=2").expect(200).json();
    let token = first["next_page_token"].as_str().unwrap();
    let second = server.get(&format!("/v1/sessions?page_size=2&page_token={token}")).expect(200).json();
    let pages = [&first, &second].map(|page| page["sessions"].as_array().unwrap().clone()).concat();
    let listed: Vec<&str> = pages.iter().map(|session| session["id"].as_str().unwrap()).collect();
    assert_eq!(listed, [&ids[2], &ids[1], &ids[0]]);
    assert!(second["next_page_token"].is_null());

    let long = server.upload(LONG, 9);
    let job = server.submit(&long);
    server.delete(&format!("/v1/sessions/{long}")).expect_problem(409, "session_in_use");
    server.post_json(&format!("/v1/jobs/{job}/cancel"), &serde_json::Value::Null).expect(202);
    server.wait_for_state(&job, "canceled");
    server.delete(&format!("/v1/sessions/{long}")).expect(204);
    server.get(&format!("/v1/sessions/{long}")).expect_problem(404, "not_found");
    server.delete(&format!("/v1/sessions/{long}")).expect_problem(404, "not_found");
    assert_eq!(server.files("sessions").len(), 3);
}
