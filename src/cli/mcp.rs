//! `wandless mcp`: a server of the Model Context Protocol over stdio, so that agents use the job API of a service.
//!
//! A line of stdin is a JSON-RPC 2.0 message or a list of such (a batch), a line of stdout an answer or the list of
//! answers. One call is worked on at a time; logs go to stderr.

mod jobs;
mod messages;
mod tools;

use super::client::{Client, server_url};
use messages::{Answer, INVALID_PARAMS, METHOD_NOT_FOUND, PARSE_ERROR, Request};
use serde_json::{Value, json};
use std::io::{self, BufRead, Write};
use tools::{TOOLS, call};

/// Arguments of `mcp`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// URL of the service
    #[arg(long, default_value = "http://127.0.0.1:8700", value_parser = server_url)]
    server: String,
    /// API key; an environment variable is not shown in the list of processes, unlike an argument
    #[arg(long, env = "WANDLESS_KEY", hide_env_values = true)]
    key: Option<String>,
}

/// Versions of the protocol whose messages are understood, newest first.
const VERSIONS: [&str; 4] = ["2025-11-25", "2025-06-18", "2025-03-26", "2024-11-05"];

/// What an agent is to know before its first call.
const INSTRUCTIONS: &str = "Wandless reconstructs moving people and the cameras that filmed them from 2D poses. Submit a session with \
    submit_session, wait with follow_job until its state is final, read verdict and figures with read_report before a result is \
    used, and write files with download_result. A verdict `reject` means that the result is not to be used.";

/// Answers messages until stdin ends.
///
/// # Errors
/// When stdin or stdout fails.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let client = Client::new(&args.server, args.key.as_deref());
    serve(&client, io::stdin().lock(), io::stdout().lock())?;
    Ok(())
}

/// Lines are read as bytes: one that is not UTF-8 is answered like any other that is not JSON.
fn serve(client: &Client, lines: impl BufRead, mut out: impl Write) -> io::Result<()> {
    for line in lines.split(b'\n') {
        let line = line?;
        if line.trim_ascii().is_empty() {
            continue;
        }
        if let Some(answer) = answer_to_line(client, &line, &mut out)? {
            writeln!(out, "{answer}")?;
            out.flush()?;
        }
    }
    Ok(())
}

/// The answer to a message, or those to the messages of a batch; `None` where all are notifications.
fn answer_to_line(client: &Client, line: &[u8], out: &mut impl Write) -> io::Result<Option<Value>> {
    let mut answered = |message: Value| -> io::Result<Option<Value>> {
        let answer = match Request::read(message) {
            Ok(request) => answer(client, &request, out)?,
            Err(refused) => Some(refused),
        };
        Ok(answer.map(|answer| answer.0))
    };
    match serde_json::from_slice(line) {
        Ok(Value::Array(batch)) if !batch.is_empty() => {
            let answers = batch.into_iter().filter_map(|message| answered(message).transpose());
            let answers: Vec<Value> = answers.collect::<io::Result<_>>()?;
            Ok((!answers.is_empty()).then_some(Value::Array(answers)))
        }
        Ok(message) => answered(message),
        Err(error) => {
            let reason = format!("the line is not a message of JSON-RPC 2.0: {error}");
            Ok(Some(Answer::failure(&Value::Null, PARSE_ERROR, reason).0))
        }
    }
}

/// The answer to a message; `None` for a notification.
fn answer(client: &Client, request: &Request, out: &mut impl Write) -> io::Result<Option<Answer>> {
    let Some(id) = &request.id else { return Ok(None) };
    Ok(Some(match request.method.as_str() {
        "initialize" => Answer::success(id, initialized(&request.params)),
        "ping" => Answer::success(id, json!({})),
        "tools/list" => {
            Answer::success(id, json!({ "tools": TOOLS.iter().map(tools::Tool::document).collect::<Vec<_>>() }))
        }
        "tools/call" => match call(client, &request.params, out)? {
            Some(result) => Answer::success(id, result),
            None => {
                let name = &request.params["name"];
                Answer::failure(
                    id,
                    INVALID_PARAMS,
                    format!("the tool {name} does not exist; tools/list names all tools"),
                )
            }
        },
        other => Answer::failure(id, METHOD_NOT_FOUND, format!("the method {other:?} is not supported")),
    }))
}

fn initialized(params: &Value) -> Value {
    let wanted = params["protocolVersion"].as_str();
    let version = VERSIONS.into_iter().find(|version| Some(*version) == wanted).unwrap_or(VERSIONS[0]);
    json!({
        "protocolVersion": version,
        "capabilities": { "tools": {} },
        "serverInfo": { "name": "wandless", "version": env!("CARGO_PKG_VERSION") },
        "instructions": INSTRUCTIONS,
    })
}

#[cfg(test)]
mod tests {
    use super::messages::INVALID_REQUEST;
    use super::*;

    fn answered(message: &str) -> Option<Value> {
        let client = Client::new("http://127.0.0.1:9", None);
        answer_to_line(&client, message.as_bytes(), &mut Vec::new()).unwrap()
    }

    #[test]
    fn negotiates_the_version_of_the_protocol() {
        let version = |wanted: &str| {
            let message =
                json!({ "jsonrpc": "2.0", "id": 1, "method": "initialize", "params": { "protocolVersion": wanted } });
            answered(&message.to_string()).unwrap()["result"]["protocolVersion"].clone()
        };
        assert_eq!(version("2024-11-05"), "2024-11-05");
        assert_eq!(version("1999-01-01"), VERSIONS[0]);
    }

    #[test]
    fn notifications_have_no_answer_and_unknown_methods_an_error() {
        assert_eq!(answered(r#"{"jsonrpc": "2.0", "method": "notifications/initialized"}"#), None);
        let unknown = answered(r#"{"jsonrpc": "2.0", "id": "a", "method": "resources/list"}"#).unwrap();
        assert_eq!((&unknown["id"], &unknown["error"]["code"]), (&json!("a"), &json!(METHOD_NOT_FOUND)));
    }

    #[test]
    fn what_is_not_a_request_has_its_own_error() {
        let code = |message: &str| answered(message).unwrap()["error"]["code"].as_i64();
        assert_eq!(code("{"), Some(PARSE_ERROR));
        for message in ["[]", "7", r#"{"id": 1}"#, r#"{"id": 1, "method": 7}"#] {
            assert_eq!(code(message), Some(INVALID_REQUEST), "{message}");
        }
        let named = answered(r#"{"id": 1, "method": 7}"#).unwrap();
        assert_eq!(named["id"], 1);
        assert!(named["error"]["message"].as_str().unwrap().ends_with("expected a string"), "{named}");
    }

    /// The version of March 2025 allows them; they were taken for the fields of one request.
    #[test]
    fn batches_are_answered_together() {
        let ping = |id: u32| json!({ "jsonrpc": "2.0", "id": id, "method": "ping" });
        let notification = json!({ "jsonrpc": "2.0", "method": "notifications/initialized" });
        let answers = answered(&json!([ping(1), notification, ["ping"], ping(2)]).to_string()).unwrap();
        let ids: Vec<&Value> = answers.as_array().unwrap().iter().map(|answer| &answer["id"]).collect();
        assert_eq!(ids, [&json!(1), &Value::Null, &json!(2)]);
        assert_eq!(answers[1]["error"]["code"], INVALID_REQUEST);
        assert_eq!(answered(&json!([notification]).to_string()), None);
    }

    #[test]
    fn a_line_that_is_not_utf8_ended_the_server() {
        let mut out = Vec::new();
        let lines: &[u8] = b"\xff\xfe\n{\"jsonrpc\": \"2.0\", \"id\": 7, \"method\": \"ping\"}\n";
        serve(&Client::new("http://127.0.0.1:9", None), lines, &mut out).unwrap();
        let answers: Vec<Value> = out.lines().map(|line| serde_json::from_str(&line.unwrap()).unwrap()).collect();
        assert_eq!((&answers[0]["error"]["code"], &answers[1]["id"]), (&json!(PARSE_ERROR), &json!(7)));
    }

    #[test]
    fn every_tool_has_a_schema_of_its_arguments() {
        let list = answered(r#"{"jsonrpc": "2.0", "id": 1, "method": "tools/list"}"#).unwrap();
        let tools = list["result"]["tools"].as_array().unwrap();
        assert_eq!(tools.len(), TOOLS.len());
        for tool in tools {
            let schema = &tool["inputSchema"];
            assert_eq!(schema["type"], "object");
            let required = schema["required"].as_array().unwrap();
            assert!(required.iter().all(|name| schema["properties"][name.as_str().unwrap()].is_object()), "{tool}");
        }
    }

    #[test]
    fn wrong_arguments_are_reported_to_the_agent() {
        let message = json!({ "jsonrpc": "2.0", "id": 1, "method": "tools/call",
            "params": { "name": "submit_session", "arguments": { "session": "no/such/folder" } } });
        let result = answered(&message.to_string()).unwrap()["result"].clone();
        assert_eq!(result["isError"], true);
        assert!(result["content"][0]["text"].as_str().unwrap().contains("no/such/folder"), "{result}");
    }
}
