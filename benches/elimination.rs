//! Elimination of a motion's frames on one thread: microseconds a frame, and how fast that is for what the textbook counts.
//!
//! `cargo bench --bench elimination`. Frames of 51 and 69 unknowns (16 and 22 joints that rotate), borders of a fit with held
//! shape, with free betas, and of the joint problem. Couplings are those of smooth motions (each group with itself), or full
//! (pixels whose errors are correlated in time).

use nalgebra::{DVector, Matrix1x3, Matrix3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::time::{Duration, Instant};
use wandless::optim::block_banded::BlockBanded;

const N_FRAMES: usize = 60;
/// Runs, of which the fastest counts: others share the machine.
const SAMPLES: usize = 50;

fn main() {
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    println!("unknowns  border  couplings  elimination  rate        substitution");
    for n_groups in [17, 23] {
        for (n_border, is_full) in [(0, false), (10, false), (100, false), (10, true), (100, true)] {
            print_times(n_groups, n_border, is_full);
        }
    }
}

fn print_times(n_groups: usize, n_border: usize, is_full: bool) {
    let (mut eliminating, mut substituting) = (Duration::MAX, Duration::MAX);
    let system = system(n_groups, n_border, is_full);
    for _ in 0..SAMPLES {
        let system = system.clone();
        let start = Instant::now();
        let eliminated = system.eliminated(1e-4).expect("the system is positive definite");
        eliminating = eliminating.min(start.elapsed());
        let start = Instant::now();
        black_box(eliminated.step(DVector::zeros(n_border), 1.0));
        substituting = substituting.min(start.elapsed());
    }
    let micros = |time: Duration| time.as_secs_f64() / N_FRAMES as f64 * 1e6;
    let couplings = if is_full { "full" } else { "groups" };
    println!(
        "{:8}  {n_border:6}  {couplings:9}  {:8.1} us  {:4.1} GFLOP/s  {:9.1} us",
        3 * n_groups,
        micros(eliminating),
        flops(3 * n_groups, n_border) / micros(eliminating) * 1e-3,
        micros(substituting),
    );
}

/// Multiplications and additions a frame with dense blocks: the factor of the diagonal block (n^3 / 3), two triangular solves (n^3
/// each), products of earlier frames (4 n^3, symmetric ones by half), the border's rows (5 n^2 each) and its square.
fn flops(n: usize, n_border: usize) -> f64 {
    let (n, rows) = (n as f64, n_border as f64 + 1.0);
    n.powi(3) * (1.0 / 3.0 + 2.0 + 4.0) + 5.0 * n * n * rows + n * rows * rows
}

/// Random blocks under a heavy diagonal.
fn system(n_groups: usize, n_border: usize, is_full: bool) -> BlockBanded {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut uniform = || rng.random_range(-1.0..1.0);
    let mut system = BlockBanded::zeros(N_FRAMES, n_groups, n_border);
    for t in 0..N_FRAMES {
        for (row, column) in (0..n_groups).flat_map(|row| (0..n_groups).map(move |column| (row, column))) {
            if row >= column {
                let diagonal = if row == column { 100.0 } else { 0.0 };
                let block = Matrix3::from_fn(|_, _| uniform()) + Matrix3::from_diagonal_element(diagonal);
                system.add_block([t, t], [row, column], &block);
            }
            for later in [t + 1, t + 2].into_iter().filter(|later| *later < N_FRAMES) {
                if is_full || row == column {
                    system.add_block([later, t], [row, column], &Matrix3::from_fn(|_, _| uniform()));
                }
            }
        }
        let mut frame = system.frame(t);
        for (row, group) in (0..n_border).flat_map(|row| (0..n_groups).map(move |group| (row, group))) {
            frame.add_border(row, 3 * group, &Matrix1x3::from_fn(|_, _| uniform()));
        }
    }
    system.corner.hessian.fill_diagonal(1e4);
    system
}
