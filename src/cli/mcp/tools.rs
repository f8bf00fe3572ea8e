//! The tools that agents can call, with the schemas of their arguments.

use super::jobs;
use super::messages::{Progress, progress};
use crate::cli::client::Client;
use serde_json::{Map, Value, json};
use std::io::{self, Write};

/// A tool.
pub(super) struct Tool {
    name: &'static str,
    description: &'static str,
    arguments: &'static [Argument],
    run: fn(&Client, &Map<String, Value>, Progress) -> anyhow::Result<Value>,
}

/// An argument of a tool.
struct Argument {
    name: &'static str,
    /// Its type in JSON schema.
    kind: &'static str,
    is_required: bool,
    description: &'static str,
}

const fn required(name: &'static str, kind: &'static str, description: &'static str) -> Argument {
    Argument { name, kind, is_required: true, description }
}

const fn optional(name: &'static str, kind: &'static str, description: &'static str) -> Argument {
    Argument { name, kind, is_required: false, description }
}

const JOB: Argument = required("job", "string", "id of the job");

/// Every tool.
pub(super) const TOOLS: &[Tool] = &[
    Tool {
        name: "submit_session",
        description: "Uploads a session (a folder, a zip file or a JSON document of 2D poses on the disk of this program) and submits \
                      its job. Returns the job.",
        arguments: &[
            required("session", "string", "path of the session"),
            optional(
                "options",
                "object",
                "options of the job that differ from their defaults; list_options describes them",
            ),
        ],
        run: jobs::submit,
    },
    Tool {
        name: "correct_job",
        description: "Submits a job that corrects the people of a succeeded job: merge, split, exchange, rename or leave out people, \
                      leave out cameras or frames, state heights. The list replaces the corrections of that job. Returns the new job.",
        arguments: &[
            JOB,
            required("corrections", "array", "corrections in their order; list_options describes the actions"),
        ],
        run: jobs::correct,
    },
    Tool {
        name: "list_options",
        description: "Describes every option of a job with type, default, range and effect.",
        arguments: &[],
        run: jobs::options,
    },
    Tool {
        name: "list_jobs",
        description: "Lists the newest jobs.",
        arguments: &[optional("state", "string", "only jobs in this state, such as succeeded")],
        run: jobs::list,
    },
    Tool {
        name: "follow_job",
        description: "Returns a job once it has ended, or as it is after wait_s seconds: state, progress, error. Call it again while \
                      the state is queued, running or canceling.",
        arguments: &[JOB, optional("wait_s", "number", "longest time until the answer, 0 to 600 seconds; default 60")],
        run: jobs::follow,
    },
    Tool {
        name: "cancel_job",
        description: "Cancels a job; the work stops within 2 seconds.",
        arguments: &[JOB],
        run: jobs::cancel,
    },
    Tool {
        name: "read_report",
        description: "Returns the verdict on the result of a succeeded job with its reasons, and the figures of cameras, people and \
                      scale.",
        arguments: &[JOB],
        run: jobs::report,
    },
    Tool {
        name: "export_result",
        description: "Adds export formats to the result of a succeeded job. Returns the names of its files.",
        arguments: &[JOB, required("formats", "array", "names of formats such as glb, fbx, usd or bvh")],
        run: jobs::export,
    },
    Tool {
        name: "download_result",
        description: "Writes all files of a result into a folder on the disk of this program and checks their digests.",
        arguments: &[JOB, required("folder", "string", "path of a folder that is empty or does not exist")],
        run: jobs::download,
    },
];

impl Tool {
    /// The tool as `tools/list` states it.
    pub(super) fn document(&self) -> Value {
        let property = |argument: &Argument| {
            let schema = json!({ "type": argument.kind, "description": argument.description });
            (argument.name.to_owned(), schema)
        };
        let properties: Map<String, Value> = self.arguments.iter().map(property).collect();
        let names = self.arguments.iter().filter(|argument| argument.is_required).map(|argument| argument.name);
        json!({
            "name": self.name,
            "description": self.description,
            "inputSchema": {
                "type": "object",
                "properties": properties,
                "required": names.collect::<Vec<_>>(),
                "additionalProperties": false,
            },
        })
    }

    /// What is wrong with the arguments.
    fn fault(&self, given: &Map<String, Value>) -> Option<String> {
        let missing = self.arguments.iter().find(|argument| argument.is_required && !given.contains_key(argument.name));
        let unknown = given.keys().find(|name| self.arguments.iter().all(|argument| argument.name != *name));
        let mistyped = self.arguments.iter().find(|argument| {
            given.get(argument.name).is_some_and(|value| match argument.kind {
                "string" => !value.is_string(),
                "number" => !value.is_number(),
                "array" => !value.is_array(),
                _ => !value.is_object(),
            })
        });
        match (missing, unknown, mistyped) {
            (Some(missing), _, _) => Some(format!("the argument {} is missing: {}", missing.name, missing.description)),
            (_, Some(unknown), _) => Some(format!("{} has no argument {unknown:?}", self.name)),
            (_, _, Some(wrong)) => Some(format!("the argument {} must be of type {}", wrong.name, wrong.kind)),
            _ => None,
        }
    }
}

/// The result of a call; `None` for an unknown tool. A failed call is a result, too, which the agent reads.
pub(super) fn call(client: &Client, params: &Value, out: &mut impl Write) -> io::Result<Option<Value>> {
    let Some(tool) = TOOLS.iter().find(|tool| params["name"] == tool.name) else { return Ok(None) };
    let arguments = params["arguments"].as_object().cloned().unwrap_or_default();
    if let Some(fault) = tool.fault(&arguments) {
        return Ok(Some(failed(&fault)));
    }
    let token = params["_meta"].get("progressToken").cloned();
    let mut broken = None;
    let mut report = |fraction: f64, message: &str| {
        let Some(token) = &token else { return };
        let sent = writeln!(out, "{}", progress(token, fraction, message)).and_then(|()| out.flush());
        broken = sent.err();
    };
    let done = (tool.run)(client, &arguments, &mut report);
    if let Some(error) = broken {
        return Err(error);
    }
    Ok(Some(match done {
        Ok(result) => {
            let text = serde_json::to_string(&result)?;
            json!({ "content": [{ "type": "text", "text": text }], "structuredContent": result, "isError": false })
        }
        Err(error) => failed(&format!("{error:#}")),
    }))
}

fn failed(text: &str) -> Value {
    json!({ "content": [{ "type": "text", "text": text }], "isError": true })
}
