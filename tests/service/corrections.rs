//! Jobs that correct an earlier job.

use crate::http::JSON;
use crate::server::Server;
use serde_json::{Value, json};

fn corrected(server: &Server, corrects: &str, corrections: &Value) -> crate::http::Answer {
    let body = json!({ "corrects": corrects, "options": { "corrections": corrections } });
    server.post_json("/v1/jobs", &body)
}

/// A solved take of two people, and its job.
fn solved(server: &Server) -> Value {
    let session = server.upload(20, 1);
    let body = json!({ "session": session, "options": { "extrinsics": "fixed", "up_axis": "z" } });
    let id = server.post_json("/v1/jobs", &body).expect(202).json()["id"].as_str().unwrap().to_owned();
    server.wait_for_state(&id, "succeeded")
}

#[test]
fn corrected_job_continues_with_the_options_of_the_earlier_one() {
    let server = Server::start();
    let earlier = solved(&server);
    let id = earlier["id"].as_str().unwrap();
    let rename = json!([{ "action": "rename", "person": 0, "name": "Ada" }]);
    let job = corrected(&server, id, &rename).expect(202).json();
    assert_eq!((&job["session"], &job["options"]["up_axis"]), (&earlier["session"], &json!("z")));
    assert_eq!(job["options"]["corrections"], rename);
    let done = server.wait_for_state(job["id"].as_str().unwrap(), "succeeded");
    let stages = done["stage_seconds"].as_object().unwrap();
    assert!(stages.contains_key("corrected_body_fit") && !stages.contains_key("cameras"), "{stages:?}");
    let people = server.get(&format!("/v1/jobs/{}/people", done["id"].as_str().unwrap())).json();
    assert_eq!(people["people"][0]["name"], "Ada");

    // Without any earlier result the session is solved from the start, with the same outcome.
    server.delete(&format!("/v1/jobs/{id}")).expect(204);
    let first = done["id"].as_str().unwrap();
    let artifact = |job: &str, name: &str| server.get(&format!("/v1/jobs/{job}/artifacts/{name}")).body;
    let poses = artifact(first, "poses3d.json");
    server.delete(&format!("/v1/jobs/{first}")).expect(204);
    let body = json!({ "session": earlier["session"], "options": done["options"] });
    let fresh = server.post_json("/v1/jobs", &body).expect(202).json();
    let fresh = server.wait_for_state(fresh["id"].as_str().unwrap(), "succeeded");
    assert!(fresh["stage_seconds"].as_object().unwrap().contains_key("cameras"));
    assert_eq!(artifact(fresh["id"].as_str().unwrap(), "poses3d.json"), poses);
}

#[test]
fn a_correction_is_repeated_after_its_original_was_deleted() {
    let server = Server::start();
    let earlier = solved(&server);
    let id = earlier["id"].as_str().unwrap();
    let ask = |name: &str| {
        let corrections = json!([{ "action": "rename", "person": 0, "name": name }]);
        let body = json!({ "corrects": id, "options": { "corrections": corrections } }).to_string();
        server.post("/v1/jobs", &[JSON, ("idempotency-key", "once")], body.as_bytes())
    };
    let job = ask("Ada").expect(202).json();
    // The contract's names for the same request.
    let named = json!({ "from_job": id, "corrections": [{ "action": "rename", "person": 0, "name": "Ada" }] });
    let named = server.post("/v1/jobs", &[JSON, ("idempotency-key", "once")], named.to_string().as_bytes());
    assert_eq!(named.expect(202).json()["id"], job["id"]);
    assert_eq!(ask("Ada").expect(202).json()["id"], job["id"]);
    ask("Bo").expect_problem(422, "idempotency_key_reused");
    server.delete(&format!("/v1/jobs/{id}")).expect(204);
    assert_eq!(ask("Ada").expect(202).json()["id"], job["id"]);
    ask("Bo").expect_problem(404, "not_found");
    server.delete(&format!("/v1/jobs/{}", job["id"].as_str().unwrap())).expect(204);
    ask("Ada").expect_problem(409, "job_deleted");
}

#[test]
fn corrections_that_cannot_be_applied_are_explained() {
    let server = Server::start();
    let earlier = solved(&server);
    let id = earlier["id"].as_str().unwrap();
    let nowhere = corrected(&server, id, &json!([{ "action": "exclude_camera", "camera": "nowhere" }]));
    nowhere.expect_problem(422, "option_impossible");
    let height = corrected(&server, id, &json!([{ "action": "set_height", "person": 0, "metres": 1.7 }]));
    height.expect_problem(422, "option_impossible");
    corrected(&server, id, &json!([{ "action": "join" }])).expect_problem(400, "option_malformed");
    corrected(&server, "job_0", &json!([])).expect_problem(404, "not_found");
    let other = json!({ "corrects": id, "options": { "people": 1 } });
    server.post_json("/v1/jobs", &other).expect_problem(422, "option_impossible");
    server.post_json("/v1/jobs", &json!({ "options": {} })).expect_problem(400, "malformed");
    let twice = json!({ "from_job": id, "corrections": [], "options": { "corrections": [] } });
    let problem = server.post_json("/v1/jobs", &twice).expect_problem(400, "malformed");
    assert_eq!(problem["pointer"], "/corrections");
    let unknown = corrected(&server, id, &json!([{ "action": "exclude_person", "person": 9 }])).expect(202).json();
    let failed = server.wait_for_state(unknown["id"].as_str().unwrap(), "failed");
    assert_eq!(failed["error"]["code"], "option_impossible");
    assert!(failed["error"]["detail"].as_str().unwrap().contains("person 9 does not exist"), "{failed}");
    let unfinished = corrected(&server, unknown["id"].as_str().unwrap(), &json!([]));
    unfinished.expect_problem(409, "job_not_succeeded");
}
