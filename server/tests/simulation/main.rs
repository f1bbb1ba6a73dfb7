//! Simulation of a server's sessions under faults, in virtual time and from a seed: the loop of a
//! session with its WebSocket, the generation service with its thread, and the client's session
//! machine, over pipes that delay, stall, cut and fall silent.
//!
//! Checked: every chunk is paid by a credit, asked for, sent once, and equal to direct generation;
//! no session panics or is closed as a breach; after the faults every view is completed, every
//! request answered, and no other session is open. Every bug of `plant` must be found.
//!
//!     TOMBOLO_SIMULATION_SEEDS=1000 cargo test -p tombolo-server --test simulation
//!     TOMBOLO_SIMULATION_SEED=17 cargo test -p tombolo-server --test simulation
//!
//! A seed decides views, requests, delays and faults. Of several events of one moment tokio chooses
//! the first at random, so a failure may need some runs of its seed: a single seed runs up to 100
//! times. The simulation of the session
//! machines alone (`protocol/tests/simulation`), whose client is used here, has no such choice.
//!
//! | module | content |
//! | --- | --- |
//! | `simulation` | clients, faults, and what holds at the end |
//! | `connection` | the client's end of a connection |
//! | `link` | the network between both ends |
//! | `server` | a server without a listener |
//! | `gate` | the generation thread in virtual time |
//! | `plant` | bugs |
//! | `client`, `ledger`, `truth`, `seeds` | of the other simulation |

#![cfg(target_os = "linux")]

#[path = "../../../protocol/tests/simulation/client.rs"]
mod client;
mod connection;
mod gate;
#[path = "../../../protocol/tests/simulation/ledger.rs"]
mod ledger;
mod link;
mod plant;
#[path = "../../../protocol/tests/simulation/seeds.rs"]
mod seeds;
mod server;
mod simulation;
#[expect(dead_code, reason = "the server encodes its frames itself")]
#[path = "../../../protocol/tests/simulation/truth.rs"]
mod truth;

use plant::{PLANTS, Plant};
use seeds::seeds;
use simulation::run;

/// Seeds of a run in `cargo ci`.
const SEEDS: u64 = 20;

/// Runs of a seed that is given alone.
const RUNS: u64 = 100;

/// Seeds within which every bug must be found.
const SEEDS_OF_BUGS: u64 = 20;

#[test]
fn every_seed_keeps_the_invariants() {
    let seeds = seeds(SEEDS);
    let mut chunks = 0;
    let mut failed = Vec::new();
    let is_single = seeds.end - seeds.start == 1;
    for seed in seeds.clone() {
        let mut runs = (0..if is_single { RUNS } else { 1 }).map(|_| run(seed, Plant::Nothing));
        let first = runs.next().expect("at least one run");
        match runs.fold(first, Result::and) {
            Ok(received) => chunks += received,
            Err(error) => failed.push(format!(
                "seed {seed}: {error}; again: TOMBOLO_SIMULATION_SEED={seed} \
                 cargo test -p tombolo-server --test simulation every_seed"
            )),
        }
    }
    println!("{} seeds, {chunks} chunks, {} failed", seeds.end - seeds.start, failed.len());
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(chunks > 0, "the control: something was sent");
}

#[test]
fn every_planted_bug_is_found() {
    for plant in PLANTS {
        let found = (0..SEEDS_OF_BUGS).find_map(|seed| Some((seed, run(seed, plant).err()?)));
        let (seed, error) =
            found.unwrap_or_else(|| panic!("{plant:?} is not found in {SEEDS_OF_BUGS} seeds"));
        println!("{plant:?}: seed {seed}: {error}");
    }
}
