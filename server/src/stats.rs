//! Live statistics: positions of the clients and rates of the server. Sampled on request, about
//! once per second at most.
//!
//! A session publishes its view and counts in [`SessionStats`], which costs a few relaxed stores.
//! The statistics contain no addresses, names or tokens: a session is a number and a position.

use crate::generation::Generation;
use crate::latency::{self, BucketCounts, LatencyHistogram};
use crate::limits::networks::client_site;
use crate::metrics::Metrics;
use crate::site_index::SiteIndex;
use bytes::Bytes;
use protocol::view::View;
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use terrain::constants::UNITS_PER_METRE;
use tokio::sync::Notify;

/// Sessions that are listed, the oldest first; the others are only counted.
pub const MAX_LISTED: usize = 256;

/// Minimum age of a snapshot before it is replaced. Slightly below the polling interval of the
/// page, one second.
const REFRESH: Duration = Duration::from_millis(900);

/// Maximum age of the snapshot that rates are computed from: a mean over minutes is not a live
/// rate.
const MAX_SPAN: Duration = Duration::from_secs(10);

/// Least time between two sessions that are displaced.
const DISPLACEMENT_INTERVAL: Duration = Duration::from_millis(250);

/// Time in which no further session is displaced for a site that has not begun one since.
const DISPLACEMENT_WAIT: Duration = Duration::from_secs(30);

/// Sites in the table of those at most. While it is full no session is displaced for a further
/// site: clients that never take their places end no more sessions than this in 30 s.
const MAX_WAITING_SITES: usize = 64;

/// Public figures of one session.
#[derive(Debug, Default)]
pub struct SessionStats {
    /// Whether the session has a view.
    has_view: AtomicBool,
    /// Eye east and south in units, in one word so that a reader sees both of one view.
    position: AtomicU64,
    yaw_mdeg: AtomicI32,
    chunks: AtomicU64,
    bytes: AtomicU64,
    ending: AtomicU8,
    ends: Notify,
}

/// Why the server ends a session that has done nothing wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The server has too little memory.
    Memory = 1,
    /// A client of a site with fewer sessions has none.
    Displaced,
}

impl SessionStats {
    /// Waits until the session has to end.
    pub async fn ends(&self) -> Ending {
        self.ends.notified().await;
        match self.ending.load(Ordering::Relaxed) {
            ending if ending == Ending::Displaced as u8 => Ending::Displaced,
            _ => Ending::Memory,
        }
    }

    fn end(&self, ending: Ending) {
        self.ending.store(ending as u8, Ordering::Relaxed);
        self.ends.notify_one();
    }

    /// Publishes a new view.
    pub fn set_view(&self, view: &View) {
        let [x, _, z] = view.eye;
        let position = u64::from(x.cast_unsigned()) << 32 | u64::from(z.cast_unsigned());
        self.position.store(position, Ordering::Relaxed);
        self.yaw_mdeg.store(view.yaw_mdeg, Ordering::Relaxed);
        self.has_view.store(true, Ordering::Relaxed);
    }

    /// Publishes the totals sent since the session began.
    pub fn set_sent(&self, chunks: u64, bytes: u64) {
        self.chunks.store(chunks, Ordering::Relaxed);
        self.bytes.store(bytes, Ordering::Relaxed);
    }
}

/// Registration of a session; removed on drop.
#[derive(Debug)]
pub struct SessionStatsGuard {
    stats: Arc<SessionStats>,
    number: u64,
    live: LiveStats,
}

impl SessionStatsGuard {
    /// The number of the session.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// The site of its client.
    #[must_use]
    pub fn site(&self) -> Option<IpAddr> {
        lock(&self.live.shared.sessions).by_number.get(&self.number).and_then(|registered| registered.site)
    }
}

impl std::ops::Deref for SessionStatsGuard {
    type Target = SessionStats;

    fn deref(&self) -> &SessionStats {
        &self.stats
    }
}

impl Drop for SessionStatsGuard {
    fn drop(&mut self) {
        let mut sessions = lock(&self.live.shared.sessions);
        if let Some(session) = sessions.by_number.remove(&self.number) {
            sessions.sites.remove(session.site, self.number);
        }
    }
}

/// All registered sessions, and the last snapshot.
#[derive(Clone, Debug)]
pub struct LiveStats {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    started: Instant,
    /// A std mutex: held for map operations and for reading at most [`MAX_LISTED`] entries.
    sessions: Mutex<Sessions>,
    last: Mutex<Option<Snapshot>>,
    /// When a session was displaced for the last time.
    displaced: Mutex<Option<Instant>>,
    /// Sites for which a session was displaced, and when; until they begin one.
    waiting: Mutex<HashMap<Option<IpAddr>, Instant>>,
}

#[derive(Debug, Default)]
struct Sessions {
    by_number: BTreeMap<u64, Registered>,
    /// Those that were not chosen to end. None is busy.
    sites: SiteIndex<Option<IpAddr>>,
}

/// A registered session.
#[derive(Debug)]
struct Registered {
    stats: Arc<SessionStats>,
    /// Of its client, for IPv6 the /48 that a site has (RFC 6177): it decides which sessions end,
    /// and no report has it.
    site: Option<IpAddr>,
}

/// Values at one moment, and the report made of them.
#[derive(Debug)]
struct Snapshot {
    at: Instant,
    totals: Totals,
    /// Chunks and bytes sent, by session.
    sessions: BTreeMap<u64, (u64, u64)>,
    report: Bytes,
}

#[derive(Clone, Debug)]
struct Totals {
    chunks: u64,
    bytes: u64,
    generated: u64,
    latency: BucketCounts,
}

/// The body of `/v1/live`.
#[derive(Serialize)]
struct Report {
    uptime_s: f64,
    /// Interval of rates and quantiles; none without a recent snapshot.
    span_s: Option<f64>,
    sessions: SessionsReport,
    sent: Option<SentReport>,
    generation: GenerationReport,
    /// From the request of a chunk by a session to the end of its write.
    latency: Option<Quantiles>,
}

#[derive(Serialize)]
struct SessionsReport {
    open: u64,
    listed: Vec<SessionReport>,
}

#[derive(Serialize)]
struct SessionReport {
    session: u64,
    /// None before the first view.
    view: Option<ViewPosition>,
    chunks: u64,
    chunks_per_s: Option<f64>,
    bytes_per_s: Option<f64>,
}

#[derive(Serialize)]
struct ViewPosition {
    x_m: f64,
    z_m: f64,
    /// 0 is north, 90 is east; 0 to 360.
    heading_deg: f64,
}

#[derive(Serialize)]
struct SentReport {
    chunks_per_s: f64,
    bytes_per_s: f64,
}

#[derive(Serialize)]
struct GenerationReport {
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

impl Default for LiveStats {
    fn default() -> Self {
        let shared = Shared {
            started: Instant::now(),
            sessions: Mutex::default(),
            last: Mutex::default(),
            displaced: Mutex::default(),
            waiting: Mutex::default(),
        };
        Self { shared: Arc::new(shared) }
    }
}

impl LiveStats {
    /// Registers a session of a client; its number is unique.
    #[must_use]
    pub fn register(&self, number: u64, client: Option<IpAddr>) -> SessionStatsGuard {
        let stats = Arc::new(SessionStats::default());
        let registered = Registered { stats: Arc::clone(&stats), site: client.map(client_site) };
        lock(&self.shared.waiting).remove(&registered.site);
        let mut sessions = lock(&self.shared.sessions);
        sessions.sites.insert(registered.site, number);
        sessions.by_number.insert(number, registered);
        drop(sessions);
        SessionStatsGuard { stats, number, live: self.clone() }
    }

    /// Number of open sessions.
    #[must_use]
    pub fn count(&self) -> usize {
        lock(&self.shared.sessions).by_number.len()
    }

    /// Ends up to this many sessions ([`SessionStats::ends`]), first of the sites that have the
    /// most, among equals the newest. Returns how many end.
    pub fn shed(&self, count: usize) -> usize {
        if count == 0 {
            return 0;
        }
        let mut sessions = lock(&self.shared.sessions);
        let Sessions { by_number, sites } = &mut *sessions;
        // The session of a site with this many older ones.
        let mut older: HashMap<Option<IpAddr>, usize> = HashMap::new();
        let rank = |site| {
            let older = older.entry(site).or_default();
            *older += 1;
            *older - 1
        };
        let ranks = by_number.values().map(|session| session.site).map(rank);
        let mut ended: Vec<_> =
            ranks.zip(&*by_number).map(|(rank, (number, of))| (rank, *number, of)).collect();
        ended.sort_unstable_by_key(|(rank, number, _)| Reverse((*rank, *number)));
        ended.truncate(count);
        for (_, number, session) in &ended {
            session.stats.end(Ending::Memory);
            sites.remove(session.site, *number);
        }
        ended.len()
    }

    /// Ends the newest session of the site that has the most, for a client whose site has at least
    /// two fewer. False if there is none, too soon after the last one, or for a site that has not
    /// begun a session since: a client that never takes its place must not end many.
    pub fn displace_for(&self, client: Option<IpAddr>, now: Instant) -> bool {
        let mut displaced = lock(&self.shared.displaced);
        if displaced.is_some_and(|last| now.saturating_duration_since(last) < DISPLACEMENT_INTERVAL) {
            return false;
        }
        let own = client.map(client_site);
        let mut waiting = lock(&self.shared.waiting);
        let is_waiting = |since: &Instant| now.saturating_duration_since(*since) < DISPLACEMENT_WAIT;
        if waiting.get(&own).is_some_and(is_waiting) {
            return false;
        }
        let mut sessions = lock(&self.shared.sessions);
        let Sessions { by_number, sites } = &mut *sessions;
        let held = sites.count(own);
        let largest = sites.newest_of_largest().filter(|(_, count)| *count >= held + 2);
        let Some((number, _)) = largest else { return false };
        let Some(newest) = by_number.get(&number) else { return false };
        if waiting.len() >= MAX_WAITING_SITES {
            waiting.retain(|_, since| is_waiting(since));
            if waiting.len() >= MAX_WAITING_SITES {
                return false;
            }
        }
        newest.stats.end(Ending::Displaced);
        sites.remove(newest.site, number);
        *displaced = Some(now);
        waiting.insert(own, now);
        true
    }

    /// The report as JSON. A recent report is reused at any rate of requests.
    #[must_use]
    pub fn report(&self, now: Instant, metrics: &Metrics, generation: &Generation) -> Bytes {
        let mut last = lock(&self.shared.last);
        if let Some(snapshot) = last.as_ref().filter(|last| now.saturating_duration_since(last.at) < REFRESH)
        {
            return snapshot.report.clone();
        }
        let latency: &LatencyHistogram = &metrics.latency;
        let totals = Totals {
            chunks: metrics.chunks_sent.get(),
            bytes: metrics.sent_bytes.get(),
            generated: metrics.jobs_completed.get(),
            latency: latency.counts(),
        };
        let before = last.take().filter(|last| now.saturating_duration_since(last.at) < MAX_SPAN);
        let snapshot = self.snapshot(now, totals, before.as_ref(), metrics, generation);
        let report = snapshot.report.clone();
        *last = Some(snapshot);
        report
    }

    fn snapshot(
        &self,
        now: Instant,
        totals: Totals,
        before: Option<&Snapshot>,
        metrics: &Metrics,
        generation: &Generation,
    ) -> Snapshot {
        let span_s = before.map(|before| now.saturating_duration_since(before.at).as_secs_f64());
        let rate = |now: u64, before: u64| span_s.map(|span_s| now.saturating_sub(before) as f64 / span_s);
        let (mut listed, mut sessions) = (Vec::new(), BTreeMap::new());
        for (number, Registered { stats, .. }) in
            lock(&self.shared.sessions).by_number.iter().take(MAX_LISTED)
        {
            let (chunks, bytes) = (stats.chunks.load(Ordering::Relaxed), stats.bytes.load(Ordering::Relaxed));
            // A session opened since the last snapshot had sent nothing then.
            let (chunks_before, bytes_before) =
                before.and_then(|before| before.sessions.get(number)).copied().unwrap_or_default();
            listed.push(SessionReport {
                session: *number,
                view: stats.has_view.load(Ordering::Relaxed).then(|| position(stats)),
                chunks,
                chunks_per_s: rate(chunks, chunks_before),
                bytes_per_s: rate(bytes, bytes_before),
            });
            sessions.insert(*number, (chunks, bytes));
        }
        let report = Report {
            uptime_s: now.saturating_duration_since(self.shared.started).as_secs_f64(),
            span_s,
            sessions: SessionsReport { open: metrics.sessions.get().max(0).cast_unsigned(), listed },
            sent: before.zip(span_s).map(|(before, span_s)| SentReport {
                chunks_per_s: totals.chunks.saturating_sub(before.totals.chunks) as f64 / span_s,
                bytes_per_s: totals.bytes.saturating_sub(before.totals.bytes) as f64 / span_s,
            }),
            generation: GenerationReport {
                queue: metrics.pending_jobs.get(),
                load: generation.load(),
                chunks_per_s: before.and_then(|before| rate(totals.generated, before.totals.generated)),
            },
            latency: before.map(|before| {
                let (before, after) = (&before.totals.latency, &totals.latency);
                let at = |share| latency::quantile_ms(before, after, share);
                Quantiles {
                    chunks: latency::count(before, after),
                    p50_ms: at(0.5),
                    p90_ms: at(0.9),
                    p99_ms: at(0.99),
                }
            }),
        };
        // Serialising plain numbers and lists cannot fail.
        let report = serde_json::to_vec(&report).unwrap_or_default().into();
        Snapshot { at: now, totals, sessions, report }
    }
}

fn position(stats: &SessionStats) -> ViewPosition {
    let position = stats.position.load(Ordering::Relaxed);
    let metres = |units: u32| f64::from(units.cast_signed()) / f64::from(UNITS_PER_METRE);
    ViewPosition {
        x_m: metres((position >> 32) as u32),
        z_m: metres(position as u32),
        heading_deg: f64::from(stats.yaw_mdeg.load(Ordering::Relaxed).rem_euclid(360_000)) / 1000.0,
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing under these locks panics in the middle of a change.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::Limits;
    use crate::source::ProceduralSource;
    use futures_util::FutureExt;
    use serde_json::Value;
    use terrain::Land;

    struct Fixture {
        live: LiveStats,
        metrics: Arc<Metrics>,
        generation: Generation,
        start: Instant,
    }

    impl Fixture {
        fn new() -> Self {
            let metrics = Arc::new(Metrics::default());
            let limits = Limits {
                threads: 1,
                cache_bytes: 1 << 20,
                jobs: 10,
                deadline: Duration::from_secs(1),
                without: None,
            };
            let generation =
                Generation::new(ProceduralSource::new(Land::new(1)), limits, Arc::clone(&metrics)).unwrap();
            Self { live: LiveStats::default(), metrics, generation, start: Instant::now() }
        }

        fn at(&self, milliseconds: u64) -> Value {
            let now = self.start + Duration::from_millis(milliseconds);
            serde_json::from_slice(&self.live.report(now, &self.metrics, &self.generation)).unwrap()
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
    fn rates_and_quantiles_cover_the_time_between_two_snapshots() {
        let fixture = Fixture::new();
        let stats = fixture.live.register(7, None);
        let first = fixture.at(0);
        assert_eq!(
            (&first["span_s"], &first["sent"], &first["latency"]),
            (&Value::Null, &Value::Null, &Value::Null)
        );
        fixture.metrics.chunks_sent.inc_by(30);
        fixture.metrics.sent_bytes.inc_by(9000);
        fixture.metrics.latency.observe(Duration::from_millis(8), 30);
        stats.set_sent(30, 9000);
        let second = fixture.at(2000);
        assert_eq!(second["sent"]["chunks_per_s"], 15.0);
        assert_eq!(second["sessions"]["listed"][0]["bytes_per_s"], 4500.0);
        assert_eq!(second["latency"]["chunks"], 30);
        assert!((second["latency"]["p99_ms"].as_f64().unwrap() - 8.0).abs() < 0.6);
        let third = fixture.at(3000);
        assert_eq!(
            (&third["sent"]["chunks_per_s"], &third["latency"]["p50_ms"]),
            (&Value::from(0.0), &Value::Null)
        );
    }

    #[test]
    fn a_recent_snapshot_is_reused_and_an_old_one_is_not_compared() {
        let fixture = Fixture::new();
        let first = fixture.at(0);
        fixture.metrics.chunks_sent.inc_by(30);
        assert_eq!(fixture.at(500), first);
        assert_ne!(fixture.at(1000), first);
        assert_eq!(fixture.at(60_000)["sent"], Value::Null);
    }

    #[test]
    fn a_session_is_listed_with_its_position_until_it_ends() {
        let fixture = Fixture::new();
        let (near, far) = (fixture.live.register(1, None), fixture.live.register(2, None));
        far.set_view(&view(-4_000_000, 250, -90_000));
        let sessions = &fixture.at(0)["sessions"]["listed"];
        assert_eq!(sessions[0]["view"], Value::Null);
        let position = &sessions[1]["view"];
        assert_eq!(
            (&position["x_m"], &position["z_m"], &position["heading_deg"]),
            (&Value::from(-4_000_000.0), &Value::from(250.0), &Value::from(270.0))
        );
        drop(near);
        let left = fixture.at(1000);
        assert_eq!(left["sessions"]["listed"].as_array().unwrap().len(), 1);
        assert_eq!(left["sessions"]["listed"][0]["session"], 2);
    }

    #[tokio::test]
    async fn sessions_of_the_networks_that_have_the_most_end_first() {
        let fixture = Fixture::new();
        let client = |number: u64| Some(IpAddr::from([10, 0, 0, if number < 6 { 1 } else { number as u8 }]));
        let open: Vec<_> =
            (1..=8).map(|number| (number, fixture.live.register(number, client(number)))).collect();
        let ended = async |count| {
            let shed = fixture.live.shed(count);
            let mut ended = Vec::new();
            for (number, stats) in &open {
                if stats.ends().now_or_never().is_some() {
                    ended.push(*number);
                }
            }
            assert_eq!(shed, ended.len());
            ended
        };
        assert_eq!(ended(2).await, [4, 5]);
        assert_eq!(ended(5).await, [2, 3, 4, 5, 8]);
        assert_eq!(ended(0).await, [0; 0]);
    }

    #[tokio::test]
    async fn a_session_of_the_site_with_the_most_is_displaced_and_not_soon_another() {
        let fixture = Fixture::new();
        let client = |site: u8| Some(IpAddr::from([10, 0, 0, site]));
        let sites = [1, 1, 1, 2, 2];
        let open: Vec<_> = sites
            .iter()
            .zip(1..)
            .map(|(site, number)| fixture.live.register(number, client(*site)))
            .collect();
        let displaced = |site: u8, ms: u64| {
            let is_displaced =
                fixture.live.displace_for(client(site), fixture.start + Duration::from_millis(ms));
            let ended = open.iter().position(|stats| stats.ends().now_or_never() == Some(Ending::Displaced));
            assert_eq!(is_displaced, ended.is_some());
            ended
        };
        assert_eq!(displaced(2, 0), None, "it has one less");
        assert_eq!(displaced(3, 0), Some(2));
        assert_eq!(displaced(3, 249), None, "too soon");
        assert_eq!(displaced(3, 250), None, "it has not begun a session");
        assert!(displaced(4, 250).is_some());
        drop(fixture.live.register(9, client(3)));
        assert!(displaced(3, 500).is_some());
        assert_eq!(displaced(5, 750), None, "each site has one");
    }

    #[test]
    fn sessions_over_the_limit_are_counted_but_not_listed() {
        let fixture = Fixture::new();
        let guards: Vec<_> =
            (0..2 * MAX_LISTED as u64).map(|number| fixture.live.register(number, None)).collect();
        fixture.metrics.sessions.set(guards.len() as i64);
        let sessions = &fixture.at(0)["sessions"];
        assert_eq!(sessions["open"], 2 * MAX_LISTED);
        let listed = sessions["listed"].as_array().unwrap();
        assert_eq!(
            (listed.len(), &listed[MAX_LISTED - 1]["session"]),
            (MAX_LISTED, &Value::from(MAX_LISTED - 1))
        );
    }
}
