//! Progress on stderr: a bar on a terminal, plain lines elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};

/// Shows how far a job is; may be told from any thread.
pub(super) enum Meter {
    /// One bar.
    Bar(ProgressBar),
    /// A line for each stage and each tenth of the whole.
    Lines(Mutex<Line>),
}

/// What the last plain line said.
#[derive(Default)]
pub(super) struct Line {
    stage: String,
    tenth: u32,
}

impl Meter {
    /// On a terminal a bar, else lines.
    pub(super) fn new() -> Self {
        if !std::io::stderr().is_terminal() {
            return Self::Lines(Mutex::default());
        }
        let bar = ProgressBar::new(1000);
        let style = ProgressStyle::with_template("{bar:30} {percent:>3} %  {elapsed}  {msg}");
        bar.set_style(style.expect("the template is a constant that parses"));
        Self::Bar(bar)
    }

    /// Shows a stage and the share of the whole that is done.
    pub(super) fn show(&self, stage: &str, fraction: f64, message: &str) {
        let text = if message.is_empty() { stage.to_owned() } else { format!("{stage}: {message}") };
        match self {
            Self::Bar(bar) => {
                bar.set_position((fraction * 1000.0) as u64);
                bar.set_message(text);
            }
            Self::Lines(line) => {
                let mut line = line.lock().unwrap_or_else(PoisonError::into_inner);
                let tenth = (fraction * 10.0) as u32;
                if line.stage != stage || line.tenth < tenth {
                    *line = Line { stage: stage.to_owned(), tenth };
                    eprintln!("{:3.0} %  {text}", 100.0 * fraction);
                }
            }
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}
