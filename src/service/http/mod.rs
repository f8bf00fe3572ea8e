//! The HTTP API. `routes` lists every route; each handler carries its own OpenAPI description.

mod access;
mod app;
mod body;
mod conditions;
mod connections;
mod cors;
mod deliveries;
mod descriptors;
mod error;
mod events;
mod extract;
mod health;
mod inspection;
mod inspections;
mod jobs;
mod multipart;
mod openapi;
mod options;
mod origin;
mod page;
mod range;
mod rate_limit;
mod results;
mod routes;
mod server;
mod sessions;
mod submission;
mod trace;
mod turns;
mod upload;
mod verified;
mod viewer;

pub use multipart::read_form;
pub use routes::openapi_json;
pub(super) use routes::serve;
