//! Simulated track numbers of a view.

use super::config::{SimulationConfig, Tracks};
use super::random::{Purpose, stream};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Numbers people, and sometimes swaps two of them.
pub(super) struct SimulatedTracker {
    rng: ChaCha8Rng,
    people: usize,
    swap_rate: f64,
    swapped: Option<(usize, usize)>,
    frames_left: usize,
    names: Vec<Option<i64>>,
}

impl SimulatedTracker {
    pub(super) fn new(view: usize, config: &SimulationConfig) -> Self {
        let mut pool: Vec<i64> = (0..config.people.max(100) as i64).collect();
        let names = match config.tracks {
            Tracks::Consistent => pool.into_iter().map(Some).collect(),
            Tracks::None => vec![None; config.people],
            Tracks::PerView => {
                pool.shuffle(&mut stream(config.seed, Purpose::TrackNames, view, 0));
                pool.into_iter().map(Some).collect()
            }
        };
        Self {
            rng: stream(config.seed, Purpose::Tracker, view, 0),
            people: config.people,
            swap_rate: if config.people > 1 { config.noise.swaps_per_minute / (60.0 * config.fps) } else { 0.0 },
            swapped: None,
            frames_left: 0,
            names,
        }
    }

    /// The random stream of this view.
    pub(super) fn rng(&mut self) -> &mut ChaCha8Rng {
        &mut self.rng
    }

    /// Advances by one frame; true if a swap of two people starts.
    pub(super) fn step(&mut self) -> bool {
        if self.frames_left > 0 {
            self.frames_left -= 1;
            if self.frames_left == 0 {
                self.swapped = None;
            }
        } else if self.rng.random::<f64>() < self.swap_rate {
            let first = self.rng.random_range(0..self.people);
            let second = (first + self.rng.random_range(1..self.people)) % self.people;
            self.swapped = Some((first, second));
            self.frames_left = self.rng.random_range(5..=60);
            return true;
        }
        false
    }

    /// Track number of a person in this frame.
    pub(super) fn track_id(&self, person: usize) -> Option<i64> {
        let named = match self.swapped {
            Some((a, b)) if a == person => b,
            Some((a, b)) if b == person => a,
            _ => person,
        };
        self.names[named]
    }

    /// Track number of a ghost: the numbers of ghosts follow those of people.
    pub(super) fn ghost_id(&self, ghost: usize) -> Option<i64> {
        self.names[0].map(|_| (self.names.len() + ghost) as i64)
    }
}
