//! Scaling: the same chunks by one thread and by two, in turns.
//!
//! Two threads need two free cores. Rounds in which other programs took one are run again, for a
//! while.

use crate::disturbance;
use crate::land;
use crate::rounds::{Corner, Spread, Times};
use anyhow::Result;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use terrain::constants::VERTEX_COUNT;
use terrain::simd::Kernel;

/// Chunks of one run: 10 to 20 ms, against which starting a thread does not count.
const CHUNKS: usize = 1000;

/// Chunks that a thread takes at once: few, so that threads end together; enough that the counter
/// is not contended.
const BATCH: usize = 8;

/// Time limit for undisturbed rounds.
const TIME_LIMIT: Duration = Duration::from_secs(60);

const ONE: &str = "1 thread";
const TWO: &str = "2 threads";

/// The result.
pub struct Scaling {
    /// Chunks per second on two threads, of those on one; not a number if too few rounds were
    /// undisturbed.
    pub ratio: Spread,
    /// Chunks per second on one thread, median.
    pub per_second: f64,
    /// Rounds that count.
    pub rounds: usize,
    /// Rounds that other programs disturbed.
    pub disturbed: usize,
}

/// Measures until enough rounds were undisturbed or the time limit is reached.
///
/// # Errors
/// This CPU has not the kernel that the bars are for.
pub fn scaling(rounds: usize) -> Result<Scaling> {
    let kernel = land::avx2()?;
    produce(2, kernel);
    let (mut kept, mut disturbed) = (Vec::new(), 0);
    let began = Instant::now();
    while kept.len() < rounds && began.elapsed() < TIME_LIMIT {
        // Alternates which one is first.
        let order = if (kept.len() + disturbed) % 2 == 0 { [1, 2] } else { [2, 1] };
        let runs = order.map(|threads| produce(threads, kernel));
        if runs.iter().any(|run| run.is_disturbed) {
            disturbed += 1;
        } else {
            kept.push(if order[0] == 1 { runs } else { [runs[1], runs[0]] });
        }
    }
    // The median of a few rounds means nothing.
    let enough = kept.len() >= rounds.min(9);
    let mut times = Times::of_rounds(if enough { kept.len() } else { 0 });
    for [one, two] in &kept {
        times.add(ONE, one.seconds);
        times.add(TWO, two.seconds);
    }
    let per_second = times.spread(|of| CHUNKS as f64 / of(ONE)).median;
    Ok(Scaling { ratio: times.ratio(ONE, TWO), per_second, rounds: kept.len(), disturbed })
}

#[derive(Clone, Copy)]
struct Run {
    seconds: f64,
    is_disturbed: bool,
}

fn produce(threads: usize, kernel: Kernel) -> Run {
    let next = AtomicUsize::new(0);
    let before = disturbance::ready_time();
    let began = Instant::now();
    let waited: Duration = std::thread::scope(|scope| {
        let worker = || {
            scope.spawn(|| {
                let mut heights = Box::new([0; VERTEX_COUNT]);
                loop {
                    let first = next.fetch_add(BATCH, Ordering::Relaxed);
                    if first >= CHUNKS {
                        // Since its start, so that a thread that got its first core late counts as
                        // disturbed.
                        return disturbance::ready_time();
                    }
                    (first..first + BATCH).for_each(|n| land::produce(kernel, Corner::of(n), &mut heights));
                }
            })
        };
        // All are started before the first is waited for.
        let workers: Vec<_> = (0..threads).map(|_| worker()).collect();
        workers.into_iter().map(|worker| worker.join().expect("the land does not panic")).sum()
    });
    let seconds = began.elapsed().as_secs_f64();
    let waited = waited + disturbance::ready_time().saturating_sub(before);
    Run { seconds, is_disturbed: disturbance::is_disturbed(waited, seconds * threads as f64) }
}
