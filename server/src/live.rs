//! What happens at the moment: who is where, and how fast chunks flow. Sampled when somebody asks,
//! at most once a second.
//!
//! Sessions leave their place and counts in a [`Seat`], which costs them a few relaxed stores;
//! nothing else happens until somebody looks. What it refuses: addresses, names, tokens. A session
//! is its number and where it looks from, which all clients may know of each other.

use crate::generation::Generation;
use crate::latency::{self, Counts, Latency};
use crate::metrics::Metrics;
use bytes::Bytes;
use protocol::view::View;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use terrain::constants::UNITS_PER_METRE;

/// Sessions told one by one, the longest open first; the others are counted.
pub const MAX_LISTED: usize = 256;

/// Youngest age of a sample that is replaced when somebody asks. A little under the second at which
/// pages ask.
const REFRESH: Duration = Duration::from_millis(900);

/// A look longer ago is none to compare with: a mean over minutes is not what happens at the
/// moment.
const MAX_SPAN: Duration = Duration::from_secs(10);

/// One session as others see it.
#[derive(Debug, Default)]
pub struct Seat {
    /// Whether a view was ever said.
    has_view: AtomicBool,
    /// Eye east and south in units, in one word so that no reader sees half a move.
    place: AtomicU64,
    yaw_mdeg: AtomicI32,
    chunks: AtomicU64,
    bytes: AtomicU64,
}

impl Seat {
    /// The session looks from elsewhere.
    pub fn moved(&self, view: &View) {
        let [x, _, z] = view.eye;
        let place = u64::from(x.cast_unsigned()) << 32 | u64::from(z.cast_unsigned());
        self.place.store(place, Ordering::Relaxed);
        self.yaw_mdeg.store(view.yaw_mdeg, Ordering::Relaxed);
        self.has_view.store(true, Ordering::Relaxed);
    }

    /// So much was sent since the session began.
    pub fn sent(&self, chunks: u64, bytes: u64) {
        self.chunks.store(chunks, Ordering::Relaxed);
        self.bytes.store(bytes, Ordering::Relaxed);
    }
}

/// A seat for as long as its session lasts.
#[derive(Debug)]
pub struct Seated {
    seat: Arc<Seat>,
    number: u64,
    of: Live,
}

impl std::ops::Deref for Seated {
    type Target = Seat;

    fn deref(&self) -> &Seat {
        &self.seat
    }
}

impl Drop for Seated {
    fn drop(&mut self) {
        lock(&self.of.shared.seats).remove(&self.number);
    }
}

/// All seats, and the last sample.
#[derive(Clone, Debug)]
pub struct Live {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    started: Instant,
    /// A std mutex: held for map operations and for reading at most [`MAX_LISTED`] seats.
    seats: Mutex<BTreeMap<u64, Arc<Seat>>>,
    last: Mutex<Option<Look>>,
}

/// What was read at one moment, and what was said of it.
#[derive(Debug)]
struct Look {
    at: Instant,
    totals: Totals,
    seats: BTreeMap<u64, (u64, u64)>,
    answer: Bytes,
}

#[derive(Clone, Debug)]
struct Totals {
    chunks: u64,
    bytes: u64,
    generated: u64,
    latency: Counts,
}

/// The answer of `/v1/live`.
#[derive(Serialize)]
struct Answer {
    uptime_s: f64,
    /// Time that rates and quantiles cover; none on the first look for a while.
    span_s: Option<f64>,
    sessions: Sessions,
    sent: Option<Sent>,
    generation: Generating,
    /// From the moment that a session takes a chunk up to the moment that it is written.
    latency: Option<Quantiles>,
}

#[derive(Serialize)]
struct Sessions {
    open: u64,
    listed: Vec<Listed>,
}

#[derive(Serialize)]
struct Listed {
    session: u64,
    /// None until the session says where it looks from.
    view: Option<Place>,
    chunks: u64,
    chunks_per_s: Option<f64>,
    bytes_per_s: Option<f64>,
}

#[derive(Serialize)]
struct Place {
    x_m: f64,
    z_m: f64,
    /// 0 is north, 90 is east; 0 to 360.
    heading_deg: f64,
}

#[derive(Serialize)]
struct Sent {
    chunks_per_s: f64,
    bytes_per_s: f64,
}

#[derive(Serialize)]
struct Generating {
    queue: i64,
    load: f64,
    chunks_per_s: Option<f64>,
}

#[derive(Serialize)]
struct Quantiles {
    chunks: u64,
    p50_ms: Option<f64>,
    p90_ms: Option<f64>,
    p99_ms: Option<f64>,
}

impl Default for Live {
    fn default() -> Self {
        let shared = Shared { started: Instant::now(), seats: Mutex::default(), last: Mutex::default() };
        Self { shared: Arc::new(shared) }
    }
}

impl Live {
    /// A seat for a session; no two sessions have the same number.
    #[must_use]
    pub fn sit(&self, number: u64) -> Seated {
        let seat = Arc::new(Seat::default());
        lock(&self.shared.seats).insert(number, Arc::clone(&seat));
        Seated { seat, number, of: self.clone() }
    }

    /// What happens, as JSON. However many ask, the server is looked over about once a second.
    #[must_use]
    pub fn sample(&self, now: Instant, metrics: &Metrics, generation: &Generation) -> Bytes {
        let mut last = lock(&self.shared.last);
        if let Some(look) = last.as_ref().filter(|look| now.saturating_duration_since(look.at) < REFRESH) {
            return look.answer.clone();
        }
        let latency: &Latency = &metrics.latency;
        let totals = Totals {
            chunks: metrics.chunks_sent.get(),
            bytes: metrics.bytes_sent.get(),
            generated: metrics.generated.get(),
            latency: latency.counts(),
        };
        let before = last.take().filter(|look| now.saturating_duration_since(look.at) < MAX_SPAN);
        let look = self.look(now, totals, before.as_ref(), metrics, generation);
        let answer = look.answer.clone();
        *last = Some(look);
        answer
    }

    fn look(
        &self,
        now: Instant,
        totals: Totals,
        before: Option<&Look>,
        metrics: &Metrics,
        generation: &Generation,
    ) -> Look {
        let span_s = before.map(|look| now.saturating_duration_since(look.at).as_secs_f64());
        let rate = |now: u64, before: u64| span_s.map(|span_s| now.saturating_sub(before) as f64 / span_s);
        let (mut listed, mut seats) = (Vec::new(), BTreeMap::new());
        for (number, seat) in lock(&self.shared.seats).iter().take(MAX_LISTED) {
            let (chunks, bytes) = (seat.chunks.load(Ordering::Relaxed), seat.bytes.load(Ordering::Relaxed));
            // A session that opened since the last look had sent nothing then.
            let (chunks_before, bytes_before) =
                before.and_then(|look| look.seats.get(number)).copied().unwrap_or_default();
            listed.push(Listed {
                session: *number,
                view: seat.has_view.load(Ordering::Relaxed).then(|| place(seat)),
                chunks,
                chunks_per_s: rate(chunks, chunks_before),
                bytes_per_s: rate(bytes, bytes_before),
            });
            seats.insert(*number, (chunks, bytes));
        }
        let answer = Answer {
            uptime_s: now.saturating_duration_since(self.shared.started).as_secs_f64(),
            span_s,
            sessions: Sessions { open: metrics.sessions.get().max(0).cast_unsigned(), listed },
            sent: before.zip(span_s).map(|(look, span_s)| Sent {
                chunks_per_s: totals.chunks.saturating_sub(look.totals.chunks) as f64 / span_s,
                bytes_per_s: totals.bytes.saturating_sub(look.totals.bytes) as f64 / span_s,
            }),
            generation: Generating {
                queue: metrics.queue.get(),
                load: generation.load(),
                chunks_per_s: before.and_then(|look| rate(totals.generated, look.totals.generated)),
            },
            latency: before.map(|look| {
                let (before, after) = (&look.totals.latency, &totals.latency);
                let at = |share| latency::quantile_ms(before, after, share);
                Quantiles {
                    chunks: latency::count(before, after),
                    p50_ms: at(0.5),
                    p90_ms: at(0.9),
                    p99_ms: at(0.99),
                }
            }),
        };
        // Plain numbers and lists: writing them cannot fail.
        let answer = serde_json::to_vec(&answer).unwrap_or_default().into();
        Look { at: now, totals, seats, answer }
    }
}

fn place(seat: &Seat) -> Place {
    let place = seat.place.load(Ordering::Relaxed);
    let metres = |units: u32| f64::from(units.cast_signed()) / f64::from(UNITS_PER_METRE);
    Place {
        x_m: metres((place >> 32) as u32),
        z_m: metres(place as u32),
        heading_deg: f64::from(seat.yaw_mdeg.load(Ordering::Relaxed).rem_euclid(360_000)) / 1000.0,
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing under these locks panics half-way through a change.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::Limits;
    use crate::source::Procedural;
    use serde_json::Value;
    use terrain::Land;

    struct Bench {
        live: Live,
        metrics: Arc<Metrics>,
        generation: Generation,
        start: Instant,
    }

    impl Bench {
        fn new() -> Self {
            let metrics = Arc::new(Metrics::default());
            let limits =
                Limits { threads: 1, cache_bytes: 1 << 20, jobs: 10, deadline: Duration::from_secs(1) };
            let generation =
                Generation::new(Procedural::new(Land::new(1)), limits, Arc::clone(&metrics)).unwrap();
            Self { live: Live::default(), metrics, generation, start: Instant::now() }
        }

        fn at(&self, milliseconds: u64) -> Value {
            let now = self.start + Duration::from_millis(milliseconds);
            serde_json::from_slice(&self.live.sample(now, &self.metrics, &self.generation)).unwrap()
        }
    }

    fn view(x_m: i32, z_m: i32, yaw_mdeg: i32) -> View {
        View {
            id: 1,
            eye: [x_m * 256, 0, z_m * 256],
            velocity: [0; 3],
            yaw_mdeg,
            pitch_mdeg: 0,
            fov_mdeg: 60_000,
            viewport: [640, 360],
            tolerance_q4: 16,
            distance_m: 100,
        }
    }

    #[test]
    fn rates_and_quantiles_are_those_between_two_looks() {
        let bench = Bench::new();
        let seat = bench.live.sit(7);
        let first = bench.at(0);
        assert_eq!(
            (&first["span_s"], &first["sent"], &first["latency"]),
            (&Value::Null, &Value::Null, &Value::Null)
        );
        bench.metrics.chunks_sent.inc_by(30);
        bench.metrics.bytes_sent.inc_by(9000);
        bench.metrics.latency.observe(Duration::from_millis(8), 30);
        seat.sent(30, 9000);
        let second = bench.at(2000);
        assert_eq!(second["sent"]["chunks_per_s"], 15.0);
        assert_eq!(second["sessions"]["listed"][0]["bytes_per_s"], 4500.0);
        assert_eq!(second["latency"]["chunks"], 30);
        assert!((second["latency"]["p99_ms"].as_f64().unwrap() - 8.0).abs() < 0.6);
        let third = bench.at(3000);
        assert_eq!(
            (&third["sent"]["chunks_per_s"], &third["latency"]["p50_ms"]),
            (&Value::from(0.0), &Value::Null)
        );
    }

    #[test]
    fn many_who_look_at_once_cost_one_look_and_a_look_long_ago_is_not_compared_with() {
        let bench = Bench::new();
        let first = bench.at(0);
        bench.metrics.chunks_sent.inc_by(30);
        assert_eq!(bench.at(500), first);
        assert_ne!(bench.at(1000), first);
        assert_eq!(bench.at(60_000)["sent"], Value::Null);
    }

    #[test]
    fn a_session_is_told_by_number_and_place_until_it_ends() {
        let bench = Bench::new();
        let (near, far) = (bench.live.sit(1), bench.live.sit(2));
        far.moved(&view(-4_000_000, 250, -90_000));
        let sessions = &bench.at(0)["sessions"]["listed"];
        assert_eq!(sessions[0]["view"], Value::Null);
        let place = &sessions[1]["view"];
        assert_eq!(
            (&place["x_m"], &place["z_m"], &place["heading_deg"]),
            (&Value::from(-4_000_000.0), &Value::from(250.0), &Value::from(270.0))
        );
        drop(near);
        let left = bench.at(1000);
        assert_eq!(left["sessions"]["listed"].as_array().unwrap().len(), 1);
        assert_eq!(left["sessions"]["listed"][0]["session"], 2);
    }

    #[test]
    fn a_crowd_is_counted_but_not_listed_beyond_the_bound() {
        let bench = Bench::new();
        let seats: Vec<_> = (0..2 * MAX_LISTED as u64).map(|number| bench.live.sit(number)).collect();
        bench.metrics.sessions.set(seats.len() as i64);
        let sessions = &bench.at(0)["sessions"];
        assert_eq!(sessions["open"], 2 * MAX_LISTED);
        let listed = sessions["listed"].as_array().unwrap();
        assert_eq!(
            (listed.len(), &listed[MAX_LISTED - 1]["session"]),
            (MAX_LISTED, &Value::from(MAX_LISTED - 1))
        );
    }
}
