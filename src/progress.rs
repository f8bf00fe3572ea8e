//! Progress and cancellation: all that the core knows of its caller.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The work was asked to stop; nothing of it may be published.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("canceled")]
pub struct Canceled;

/// What a caller is told while the pipeline runs.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgressEvent {
    /// Name of the stage that runs now.
    pub stage: &'static str,
    /// Zero-based position of the stage.
    pub stage_index: usize,
    /// How many stages there are.
    pub stage_count: usize,
    /// Share of the whole work that is done, 0 to 1; never falls.
    pub fraction: f64,
    /// One short sentence for a person.
    pub message: String,
}

type Listener = dyn Fn(&ProgressEvent) + Send + Sync;

/// A cancel flag and a listener, handed down through the stages. Cloning shares both.
#[derive(Clone)]
pub struct Progress {
    canceled: Arc<AtomicBool>,
    listener: Arc<Listener>,
    /// The stage being run and its slice of the whole: name, index, count, start and width as fractions.
    stage: (&'static str, usize, usize, f64, f64),
}

impl Progress {
    /// Reports to `listener`; `canceled` may be set from any thread.
    pub fn new(listener: impl Fn(&ProgressEvent) + Send + Sync + 'static, canceled: Arc<AtomicBool>) -> Self {
        Self { canceled, listener: Arc::new(listener), stage: ("", 0, 1, 0.0, 1.0) }
    }

    /// Tells nobody and is never canceled.
    pub fn silent() -> Self {
        Self::new(|_| {}, Arc::default())
    }

    /// The same handle for stage `index` of `count`, which covers `start..start + width` of the whole work.
    pub fn stage(&self, name: &'static str, index: usize, count: usize, start: f64, width: f64) -> Self {
        let stage = Self { stage: (name, index, count, start, width), ..self.clone() };
        stage.report(0.0, "");
        stage
    }

    /// Says that `fraction` (0 to 1) of the current stage is done.
    pub fn report(&self, fraction: f64, message: impl Into<String>) {
        let (stage, stage_index, stage_count, start, width) = self.stage;
        let fraction = start + width * fraction.clamp(0.0, 1.0);
        (self.listener)(&ProgressEvent { stage, stage_index, stage_count, fraction, message: message.into() });
    }

    /// To be called between units of work of at most some 100 ms.
    ///
    /// # Errors
    /// [`Canceled`] once the caller has asked the work to stop.
    pub fn check(&self) -> Result<(), Canceled> {
        if self.canceled.load(Ordering::Relaxed) { Err(Canceled) } else { Ok(()) }
    }
}
