//! The load test: many sessions on flight paths, every chunk verified.
//!
//! [`run`] is the whole of it: a checked [`LoadConfig`] goes in, a [`Report`] comes out, and [`Report::verdict`] says
//! whether the server passed. Reading order: [`config`], [`path`] (where a client flies), [`interest`] (what it may be
//! sent), [`verify`] (what a chunk must satisfy), [`regeneration`] (where samples are compared), [`session`] (one client),
//! [`tally`] (what all clients count), [`report`]. Apart from all that, [`mod@bench`] measures a server's promises one by one.
//!
//! What it refuses: drawing (no GPU crate is in its dependency tree), keeping chunks (a verified chunk is dropped), and
//! deciding for itself what the wire looks like (the `protocol` crate's client machine does).

#![forbid(unsafe_code)]

pub mod bench;
pub mod config;
pub mod interest;
pub mod path;
pub mod regeneration;
pub mod report;
pub mod session;
pub mod tally;
pub mod verify;

pub use config::{Args, LoadConfig};
pub use path::PathKind;
pub use report::Report;
pub use tally::Tally;

use regeneration::Regeneration;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::Instant;

/// Name and version, as told to servers.
pub const SOFTWARE: &str = concat!("tombolo-load ", env!("CARGO_PKG_VERSION"));

/// Time between two clients' first connections, unless the run is too short for it.
const RAMP_STEP: Duration = Duration::from_millis(10);

/// Runs a load test to its end. Never fails: whatever goes wrong is counted, and the report's verdict says so.
pub async fn run(config: LoadConfig) -> Report {
    run_counting(config, Arc::new(Tally::default())).await
}

/// As [`run`], counting into a tally that the caller can watch meanwhile.
pub async fn run_counting(config: LoadConfig, tally: Arc<Tally>) -> Report {
    let (n_clients, duration) = (config.clients, Duration::from_secs(config.seconds));
    let ramp_step = ramp_step(n_clients, duration);
    let delivery = config.delivery;
    let config = Arc::new(config);
    let (regeneration, comparing) = Regeneration::start(Arc::clone(&tally));
    let started = Instant::now();
    let end = started + duration;
    let mut clients = JoinSet::new();
    for index in 0..n_clients {
        let (config, tally, regeneration) = (Arc::clone(&config), Arc::clone(&tally), regeneration.clone());
        clients.spawn(async move {
            // All at once would measure the accept queue, not the streaming.
            tokio::time::sleep(ramp_step * index).await;
            session::fly(index, &config, &tally, &regeneration, end).await;
        });
    }
    while let Some(joined) = clients.join_next().await {
        if let Err(error) = joined {
            // A panic in one client is a fault of this program; it must not pass for a good session.
            tally.dropped(&format!("a client task failed: {error}"));
        }
    }
    // Good-byes and late comparisons are not load.
    let seconds = started.elapsed().min(duration).as_secs_f64();
    drop(regeneration);
    if let Err(error) = comparing.await {
        tally.mismatch(&format!("comparing with local generation failed: {error}"));
    }
    tally.report(n_clients, seconds, delivery)
}

/// The ramp takes at most a fifth of the run.
fn ramp_step(n_clients: u32, duration: Duration) -> Duration {
    RAMP_STEP.min(duration / 5 / n_clients.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_takes_at_most_a_fifth_of_the_run() {
        assert_eq!(ramp_step(200, Duration::from_secs(30)), RAMP_STEP);
        assert_eq!(ramp_step(1000, Duration::from_secs(5)), Duration::from_millis(1));
        assert_eq!(ramp_step(1, Duration::from_secs(1)), RAMP_STEP);
    }
}
