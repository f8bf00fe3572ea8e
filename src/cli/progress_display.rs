//! Progress on stderr: a bar on a terminal, plain lines elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};

/// Shows the progress of a job; usable from any thread.
pub(super) enum ProgressDisplay {
    /// A progress bar.
    Bar(ProgressBar),
    /// One line per stage and per tenth of the whole work.
    Lines(Mutex<LastLine>),
}

/// Content of the last plain line.
#[derive(Default)]
pub(super) struct LastLine {
    stage: String,
    /// Tenths of the whole work that were done.
    tenth: u32,
}

impl ProgressDisplay {
    /// A bar when stderr is a terminal, otherwise lines.
    pub(super) fn new() -> Self {
        if !std::io::stderr().is_terminal() {
            return Self::Lines(Mutex::default());
        }
        let bar = ProgressBar::new(1000);
        let style = ProgressStyle::with_template("{bar:30} {percent:>3} %  {elapsed}  {msg}");
        bar.set_style(style.expect("the template is a constant that parses"));
        Self::Bar(bar)
    }

    /// Shows the current stage, the finished share of the whole work (0 to 1) and a message, which may be empty.
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
                    *line = LastLine { stage: stage.to_owned(), tenth };
                    eprintln!("{:3.0} %  {text}", 100.0 * fraction);
                }
            }
        }
    }

    /// Removes the bar.
    pub(super) fn finish(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}
