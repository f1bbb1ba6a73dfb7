//! A store that fails under load: what a replica sends then, and how long its chunks take.

use super::chunks::{self, Asked, Truth};
use super::http::metric;
use super::objects::{self, Objects};
use crate::server::Server;
use anyhow::Result;
use bars::Bar;
use bars::figures::median;
use std::time::{Duration, Instant};

/// Levels of the chunks that are asked for; a store has level 2 and coarser.
const LEVELS: [u8; 3] = [2, 3, 4];

/// Chunks of one level, per axis.
const SIDE: i32 = 20;

/// Turns in which all faults are tried, each beside a replica without a store.
const ROUNDS: usize = 5;

/// How much later a slow store answers: beyond every wait, and within that of the compose file.
pub const SLOW: Duration = Duration::from_secs(2);
const SLOW_WITHIN_WAIT: Duration = Duration::from_millis(50);

/// Time in which a fault must show: more than the timeout of a write.
const SHOWN_WITHIN: Duration = Duration::from_secs(10);

/// The option of the least wait for an answer.
const WAIT: &str = "TOMBOLO_STORE_WAIT_MS";

/// A least wait that makes a replica wait for every answer, milliseconds.
const PATIENT_MS: u32 = 2000;

/// The least wait of `docker-compose.yml` and the Kubernetes manifests, in which a healthy store on
/// this machine answers, milliseconds. Without one a replica makes nearly all of these chunks
/// sooner than it would read them, and does not notice the fault.
const SHORT_MS: u32 = 100;

/// The setting of a replica that waits for every answer.
pub fn patient_wait() -> (&'static str, String) {
    (WAIT, PATIENT_MS.to_string())
}

/// The setting of `docker-compose.yml`.
pub fn compose_wait() -> (&'static str, String) {
    (WAIT, SHORT_MS.to_string())
}

/// Generated chunks of a replica.
const GENERATED: &str = "tombolo_generation_jobs_total{outcome=\"completed\"}";

/// Reads that an absent store does not answer in time.
pub const LATE_OR_FAILED: &[&str] =
    &["tombolo_store_reads_total{outcome=\"late\"}", "tombolo_store_reads_total{outcome=\"failed\"}"];

/// Reads of damaged objects.
pub const INVALID: &str = "tombolo_store_reads_total{outcome=\"invalid\"}";

/// Fault of a store under load.
struct Fault {
    name: &'static str,
    /// Whether it holds all chunks at first.
    is_filled: bool,
    happens: fn(&mut Objects) -> Result<()>,
    /// Least wait of the replica, milliseconds; none is the default. With [`PATIENT_MS`] only its
    /// chunks count, not their times.
    wait_ms: Option<u32>,
    /// The metrics that show that it happened; none where a replica may do without the store.
    shows: &'static [&'static str],
}

const FAULTS: [Fault; 9] = [
    Fault { name: "empty", is_filled: false, happens: |_| Ok(()), wait_ms: None, shows: &[] },
    Fault {
        name: "stopped",
        is_filled: true,
        happens: |objects| {
            objects.kill();
            Ok(())
        },
        wait_ms: Some(SHORT_MS),
        shows: LATE_OR_FAILED,
    },
    Fault {
        name: "hanging",
        is_filled: true,
        happens: |objects| objects.hang(),
        wait_ms: Some(SHORT_MS),
        shows: LATE_OR_FAILED,
    },
    Fault {
        name: "slowed to 2 s",
        is_filled: true,
        happens: |objects| {
            objects.slow_down(SLOW);
            Ok(())
        },
        wait_ms: Some(SHORT_MS),
        shows: LATE_OR_FAILED,
    },
    Fault {
        name: SLOWED,
        is_filled: true,
        happens: |objects| {
            objects.slow_down(SLOW_WITHIN_WAIT);
            Ok(())
        },
        wait_ms: Some(SHORT_MS),
        // It may make every chunk sooner than it would read it.
        shows: &[],
    },
    Fault {
        name: "full",
        is_filled: false,
        happens: |objects| objects.fill_up(),
        wait_ms: Some(SHORT_MS),
        shows: &["tombolo_store_writes_total{outcome=\"failed\"}"],
    },
    Fault {
        name: "damaged",
        is_filled: true,
        happens: |objects| objects.damage().map(drop),
        wait_ms: Some(SHORT_MS),
        shows: &[INVALID],
    },
    Fault {
        name: "damaged, and waited for",
        is_filled: true,
        happens: |objects| objects.damage().map(drop),
        wait_ms: Some(PATIENT_MS),
        shows: &[INVALID],
    },
    Fault {
        name: "full, and waited for",
        is_filled: false,
        happens: |objects| objects.fill_up(),
        wait_ms: Some(PATIENT_MS),
        shows: &["tombolo_store_writes_total{outcome=\"failed\"}"],
    },
];

/// A store that answers within the wait, and later than a chunk takes to make: the wait prefers
/// reads to generation, so its time has no bar.
const SLOWED: &str = "slowed to 50 ms, within the wait of 100 ms";

impl Fault {
    /// Whether the replica waits for every answer.
    fn is_patient(&self) -> bool {
        self.wait_ms == Some(PATIENT_MS)
    }
}

/// Results of one fault in all rounds.
#[derive(Default)]
struct Shown {
    /// 99th percentile over that without a store, by round.
    ratios: Vec<f64>,
    /// Wrong answers, and requests without one.
    bad: usize,
    /// How often the fault showed in the round in which it showed least.
    shown: Option<f64>,
}

/// The rows.
///
/// # Errors
/// A process does not start or does not answer.
pub fn rows() -> Result<Vec<Bar>> {
    if let Some(reason) = objects::lacks() {
        let name = "a store that fails under load: wrong chunks, and p99 over that without a store";
        return Ok(vec![Bar::reported(name, None, "").not_measured_if(true, &reason)]);
    }
    let paths = chunks::shuffled(LEVELS.iter().flat_map(|level| chunks::square(*level, SIDE)).collect());
    let mut truth = Truth::new();
    let filled = Objects::start("filled", None)?;
    let mut rows = shared(&filled, &paths, &mut truth)?;
    let mut bad_alone = 0;
    let mut shown: [Shown; FAULTS.len()] = Default::default();
    let mut alone_ms = Vec::new();
    for round in 0..ROUNDS {
        let alone = chunks::ask(Server::start(super::WORLD_SEED)?.address(), &paths, &mut truth, || Ok(()))?;
        bad_alone += alone.wrong + alone.failed;
        let p99_ms = alone.p99_ms().unwrap_or(f64::NAN);
        alone_ms.push(p99_ms);
        // Those without times once.
        let tried_now = FAULTS.iter().zip(&mut shown).filter(|(fault, _)| round == 0 || !fault.is_patient());
        for (fault, shown) in tried_now {
            let (asked, count) = try_fault(fault, &filled, &paths, &mut truth)?;
            shown.ratios.extend(asked.p99_ms().map(|with| with / p99_ms));
            shown.bad += asked.wrong + asked.failed;
            shown.shown = Some(shown.shown.map_or(count, |least| least.min(count)));
        }
    }
    rows.push(Bar::reported(
        "p99 of chunks without a store, median of 5 rounds",
        median(alone_ms.into_iter().map(Some)),
        "ms",
    ));
    rows.push(Bar::none("without a store: wrong chunks or none, of all rounds", Some(bad_alone as f64)));
    for (fault, shown) in FAULTS.iter().zip(shown) {
        let name = fault.name;
        rows.push(Bar::none(
            format!("store {name}: wrong chunks or none, of all rounds"),
            Some(shown.bad as f64),
        ));
        if !fault.is_patient() {
            let ratio = median(shown.ratios.into_iter().map(Some));
            let what = format!("store {name}: p99 of chunks over that without a store");
            rows.push(match name {
                SLOWED => Bar::reported(what, ratio, ""),
                _ => Bar::at_most(what, ratio, "", 1.5),
            });
        }
        if !fault.shows.is_empty() {
            let what = format!("control: store {name}: reads or writes that showed it, least of a round");
            rows.push(Bar::some(what, shown.shown));
        }
    }
    Ok(rows)
}

/// One load on a replica whose store fails, and how often the fault showed.
fn try_fault(fault: &Fault, filled: &Objects, paths: &[String], truth: &mut Truth) -> Result<(Asked, f64)> {
    let mut objects = Objects::start("failing", fault.is_filled.then_some(filled))?;
    let mut settings = objects.settings().to_vec();
    settings.extend(fault.wait_ms.map(|ms| (WAIT, ms.to_string())));
    let replica = Server::start_with(super::WORLD_SEED, &settings)?;
    let count = || fault.shows.iter().map(|name| metric(replica.address(), name)).sum::<Result<f64>>();
    let mut before = 0.0;
    let asked = chunks::ask(replica.address(), paths, truth, || {
        before = count()?;
        (fault.happens)(&mut objects)
    })?;
    // Requests to a store may fail long after the chunks were sent.
    let deadline = Instant::now() + SHOWN_WITHIN;
    while !fault.shows.is_empty() && count()? == before && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(100));
    }
    Ok((asked, count()? - before))
}

/// Two replicas that share a store, one after the other: what the second one makes.
fn shared(objects: &Objects, paths: &[String], truth: &mut Truth) -> Result<Vec<Bar>> {
    let patient = [objects.settings().as_slice(), &[(WAIT, PATIENT_MS.to_string())]].concat();
    let first = Server::start_with(super::WORLD_SEED, &patient)?;
    let asked = chunks::ask(first.address(), paths, truth, || Ok(()))?;
    chunks::settled(|| metric(first.address(), "tombolo_store_writes_total{outcome=\"written\"}"))?;
    let made = metric(first.address(), GENERATED)?;
    let second = Server::start_with(super::WORLD_SEED, &patient)?;
    let again = chunks::ask(second.address(), paths, truth, || Ok(()))?;
    let made_again = metric(second.address(), GENERATED)?;
    let bad = asked.failed + again.wrong + again.failed;
    let keys = paths.len() as f64;
    Ok(vec![
        Bar::none("two replicas with a store: wrong chunks or none", Some(bad as f64)),
        Bar::at_most(
            "two replicas with a store: chunks generated, over both, per chunk named",
            Some((made + made_again) / keys),
            "",
            1.0,
        ),
        Bar::some("control: chunks that the first of them generated", Some(made)),
    ])
}
