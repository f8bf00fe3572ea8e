//! The queue is the `jobs` table: every accepted job reaches exactly one final state, whichever process crashes.
//!
//! A job may be executed more than once, but its result is published exactly once: each claim increments the job's
//! `fence`, and every later write of that claim has the condition `AND fence = ?`. If no row matches, the worker discards
//! its work. No transaction outlasts one group of statements, and none is open while a job runs.
//!
//! Why not a queue library: the guarantee needs a fence per attempt, crashes counted per job, and orphans recognised by
//! their boot id instead of a clock. That takes a few statements on a table that the service needs anyway.

mod active;
mod claim;
pub mod class;
mod continuation;
mod deferral;
mod enqueue;
mod exports;
mod fingerprint;
mod finish;
mod follow;
mod handle;
pub mod job;
#[cfg(feature = "scale")]
pub(crate) mod lease;
#[cfg(feature = "scale")]
mod lines;
pub mod outcome;
mod phase;
pub mod recovery;
mod rows;
mod scenes;
#[cfg(feature = "scale")]
mod shared_claim;
pub mod statistics;
#[cfg(feature = "scale")]
pub(crate) mod wake;

#[cfg(test)]
mod tests;

pub use claim::{Claim, ClaimStatus};
pub use enqueue::{EnqueueError, IdempotencyKey, NewJob, QueueLimits};
pub use exports::Extension;
pub use fingerprint::fingerprint_as_sent;
pub use finish::{Finished, Published};
pub use follow::Following;
pub use handle::{Cancel, JobFilter, LabelFilter, LogLine, Queue};
pub use phase::Phase;
pub use scenes::Scene;
