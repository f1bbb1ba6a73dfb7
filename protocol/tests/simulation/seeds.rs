//! The seeds of a run, from its environment.

use std::ops::Range;

fn number(name: &str) -> Option<u64> {
    std::env::var(name)
        .ok()
        .map(|text| text.parse().unwrap_or_else(|_| panic!("{name} is no number: {text}")))
}

/// The one of `TOMBOLO_SIMULATION_SEED`, or else from 0 as many as `TOMBOLO_SIMULATION_SEEDS` or
/// the default.
pub fn seeds(default: u64) -> Range<u64> {
    match number("TOMBOLO_SIMULATION_SEED") {
        Some(seed) => seed..seed + 1,
        None => 0..number("TOMBOLO_SIMULATION_SEEDS").unwrap_or(default),
    }
}
