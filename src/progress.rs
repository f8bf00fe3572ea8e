//! Progress and cancellation: the only link from the core to its caller.
//!
//! The work is a tree of steps: stages with weights ([`Progress::stages`]), each divided into smaller steps
//! ([`Progress::steps`]), whose parts may be counted ([`Steps::begin_parts`]). A handle covers a slice of the whole, and the reported share of the whole never falls.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// The caller asked the work to stop; no partial result may be published.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("canceled")]
pub struct Canceled;

/// One progress report to the caller.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgressEvent {
    /// Name of the running stage.
    pub stage: &'static str,
    /// Zero-based position of the stage among those that this run has.
    pub stage_index: usize,
    /// Number of stages of this run.
    pub stage_count: usize,
    /// Finished share of the whole work, 0 to 1; never falls.
    pub fraction: f64,
    /// The running step in a few words ("comparing pairs of cameras"); may be empty.
    pub message: String,
}

type Listener = dyn Fn(&ProgressEvent) + Send + Sync;

/// What all handles of one piece of work share.
struct Work {
    canceled: Arc<AtomicBool>,
    listener: Box<Listener>,
    /// Largest fraction reported so far. Held while the listener runs, so that events arrive in order.
    furthest: Mutex<f64>,
}

/// A stage's name and position.
#[derive(Clone, Copy)]
struct Stage {
    name: &'static str,
    index: usize,
    count: usize,
}

/// Handle of one step: reports its progress and reads the cancel flag. Clones report the same step.
#[derive(Clone)]
pub struct Progress {
    work: Arc<Work>,
    stage: Stage,
    /// The step's slice of the whole work, as fractions.
    start: f64,
    end: f64,
    /// Parts of the step that are done in any order.
    parts: Option<Arc<Parts>>,
}

/// Parts of equal length.
struct Parts {
    n: usize,
    n_done: AtomicUsize,
    message: String,
}

impl Progress {
    /// Reports to `listener`; `canceled` may be set from any thread.
    pub fn new(listener: impl Fn(&ProgressEvent) + Send + Sync + 'static, canceled: Arc<AtomicBool>) -> Self {
        let work = Work { canceled, listener: Box::new(listener), furthest: Mutex::new(0.0) };
        let stage = Stage { name: "", index: 0, count: 1 };
        Self { work: Arc::new(work), stage, start: 0.0, end: 1.0, parts: None }
    }

    /// Reports nothing and is never canceled.
    pub fn silent() -> Self {
        Self::new(|_| {}, Arc::default())
    }

    /// Divides this step into named stages, given with their weights in the order in which they run.
    pub fn stages(&self, stages: Vec<(&'static str, f64)>) -> Stages {
        let steps = self.steps(stages.iter().map(|(_, weight)| *weight));
        Stages { names: stages.into_iter().map(|(name, _)| name).collect(), steps }
    }

    /// Divides this step into smaller ones with these weights.
    pub fn steps(&self, weights: impl IntoIterator<Item = f64>) -> Steps {
        let weights: Vec<f64> = weights.into_iter().collect();
        Steps { whole: self.clone(), weights, next: 0 }
    }

    /// Reports that one more part of this step is done; nothing where it has none.
    pub fn part_done(&self) {
        if let Some(parts) = &self.parts {
            let n_done = parts.n_done.fetch_add(1, Ordering::Relaxed) + 1;
            self.report(n_done as f64 / parts.n.max(1) as f64, parts.message.as_str());
        }
    }

    /// Reports that `fraction` (0 to 1) of this step is done.
    pub fn report(&self, fraction: f64, message: impl Into<String>) {
        let Stage { name: stage, index: stage_index, count: stage_count } = self.stage;
        let fraction = self.at(fraction);
        let mut furthest = self.work.furthest.lock().unwrap_or_else(PoisonError::into_inner);
        *furthest = furthest.max(fraction);
        let message = message.into();
        (self.work.listener)(&ProgressEvent { stage, stage_index, stage_count, fraction: *furthest, message });
    }

    /// The share of the whole work at `fraction` of this step; exact at its end.
    fn at(&self, fraction: f64) -> f64 {
        if fraction >= 1.0 { self.end } else { self.start + (self.end - self.start) * fraction.max(0.0) }
    }

    /// Call between units of work of at most some 100 ms.
    ///
    /// # Errors
    /// [`Canceled`] once the caller has asked the work to stop.
    pub fn check(&self) -> Result<(), Canceled> {
        if self.work.canceled.load(Ordering::Relaxed) { Err(Canceled) } else { Ok(()) }
    }
}

/// The stages of a piece of work, in order.
pub struct Stages {
    names: Vec<&'static str>,
    steps: Steps,
}

impl Stages {
    /// Starts the stage of this name and reports its start. A name that is not planned reports as the whole work.
    pub fn begin(&mut self, name: &'static str) -> Progress {
        let Some(index) = self.names.iter().position(|planned| *planned == name) else {
            return self.steps.whole.clone();
        };
        let slice = self.steps.slice(index);
        let stage = Progress { stage: Stage { name, index, count: self.names.len() }, ..slice };
        stage.report(0.0, "");
        stage
    }
}

/// Consecutive steps of one step.
pub struct Steps {
    whole: Progress,
    weights: Vec<f64>,
    next: usize,
}

impl Steps {
    /// Starts the next step and reports `message`. Steps beyond the planned ones have no width.
    pub fn begin(&mut self, message: impl Into<String>) -> Progress {
        let step = self.slice(self.next);
        self.next += 1;
        step.report(0.0, message);
        step
    }

    /// Starts the next step, which has `n` parts of equal length; [`Progress::part_done`] counts them in any order and from any thread.
    pub fn begin_parts(&mut self, n: usize, message: impl Into<String>) -> Progress {
        let message = message.into();
        let step = self.begin(message.as_str());
        Progress { parts: Some(Arc::new(Parts { n, n_done: AtomicUsize::new(0), message })), ..step }
    }

    fn slice(&self, index: usize) -> Progress {
        let total: f64 = self.weights.iter().sum();
        let n = self.weights.len();
        let at = |n_done: usize| {
            self.whole.at(self.weights[..n_done.min(n)].iter().sum::<f64>() / total.max(f64::MIN_POSITIVE))
        };
        Progress { start: at(index), end: at(index + 1), parts: None, ..self.whole.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_divide_their_stage_and_never_fall() {
        let events = Arc::new(Mutex::new(Vec::new()));
        let heard = events.clone();
        let progress = Progress::new(move |event| heard.lock().unwrap().push(event.clone()), Arc::default());
        let mut stages = progress.stages(vec![("cameras", 3.0), ("body_fit", 1.0)]);
        let cameras = stages.begin("cameras");
        let mut steps = cameras.steps([1.0, 1.0]);
        let first = steps.begin("a");
        steps.begin("b").report(0.5, "c");
        first.report(1.0, "late");
        stages.begin("body_fit").report(1.0, "d");
        let events = events.lock().unwrap();
        let row = |e: &ProgressEvent| (e.stage_index, e.fraction, e.message.clone());
        let expected = [
            (0, 0.0, ""),
            (0, 0.0, "a"),
            (0, 0.375, "b"),
            (0, 0.5625, "c"),
            (0, 0.5625, "late"),
            (1, 0.75, ""),
            (1, 1.0, "d"),
        ];
        assert_eq!(events.iter().map(row).collect::<Vec<_>>(), expected.map(|(i, f, m)| (i, f, m.to_owned())));
        assert!(events.iter().all(|event| event.stage_count == 2));
    }

    #[test]
    fn parts_count_in_any_order() {
        let fractions = Arc::new(Mutex::new(Vec::new()));
        let heard = fractions.clone();
        let progress = Progress::new(move |event| heard.lock().unwrap().push(event.fraction), Arc::default());
        let mut steps = progress.steps([1.0, 1.0]);
        let counted = steps.begin_parts(4, "a");
        let (one, other) = (counted.clone(), counted);
        [&other, &one, &other].into_iter().for_each(Progress::part_done);
        steps.begin("b").part_done(); // has no parts
        assert_eq!(*fractions.lock().unwrap(), [0.0, 0.125, 0.25, 0.375, 0.5]);
    }
}
