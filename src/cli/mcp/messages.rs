//! Messages of JSON-RPC 2.0.

use crate::session::parser_errors::in_json_words;
use serde::Deserialize;
use serde_json::{Value, json};

/// The line is not JSON.
pub(super) const PARSE_ERROR: i64 = -32700;
/// The message is not a request.
pub(super) const INVALID_REQUEST: i64 = -32600;
/// No such method.
pub(super) const METHOD_NOT_FOUND: i64 = -32601;
/// The parameters name nothing that exists.
pub(super) const INVALID_PARAMS: i64 = -32602;

/// A request, or a notification if it has no id.
#[derive(Debug, Deserialize)]
pub(super) struct Request {
    pub(super) id: Option<Value>,
    pub(super) method: String,
    #[serde(default)]
    pub(super) params: Value,
}

impl Request {
    /// The request of a message, or what is wrong with it.
    pub(super) fn read(message: Value) -> Result<Self, Answer> {
        let id = message.get("id").cloned().unwrap_or_default();
        let refused = |why: &str| {
            let reason = format!("the message is not a request of JSON-RPC 2.0: {why}");
            Answer::failure(&id, INVALID_REQUEST, reason)
        };
        if !message.is_object() {
            return Err(refused("it is not an object"));
        }
        serde_json::from_value(message).map_err(|error| refused(&in_json_words(&error)))
    }
}

/// An answer.
pub(super) struct Answer(pub(super) Value);

impl Answer {
    pub(super) fn success(id: &Value, result: Value) -> Self {
        Self(json!({ "jsonrpc": "2.0", "id": id, "result": result }))
    }

    pub(super) fn failure(id: &Value, code: i64, message: String) -> Self {
        Self(json!({ "jsonrpc": "2.0", "id": id, "error": { "code": code, "message": message } }))
    }
}

/// Receives the completed share of a call, 0 to 1, and what is done.
pub(super) type Progress<'a> = &'a mut dyn FnMut(f64, &str);

/// A notification of the progress of a call that asked for it.
pub(super) fn progress(token: &Value, fraction: f64, message: &str) -> Value {
    let params = json!({ "progressToken": token, "progress": fraction, "total": 1.0, "message": message });
    json!({ "jsonrpc": "2.0", "method": "notifications/progress", "params": params })
}
