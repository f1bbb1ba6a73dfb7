//! The open sessions: their public figures, and which of them end when memory or places run short.
//!
//! A session publishes its view and counts in [`SessionStats`], which costs a few relaxed stores.

use crate::limits::networks::client_site;
use crate::site_index::SiteIndex;
use protocol::view::View;
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Least time between two sessions that are displaced.
const DISPLACEMENT_INTERVAL: Duration = Duration::from_millis(250);

/// Time in which no further session is displaced for a site without a handshake since.
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
    eviction: AtomicU8,
    evicted: Notify,
    /// Whether its handshake is done.
    is_welcomed: AtomicBool,
}

/// Figures of a session at one moment.
#[derive(Clone, Copy, Debug)]
pub struct SessionFigures {
    /// None before the first view.
    pub eye: Option<EyePosition>,
    /// Sent since the session began.
    pub chunks: u64,
    /// Likewise.
    pub bytes: u64,
}

/// Where the eye of a view is.
#[derive(Clone, Copy, Debug)]
pub struct EyePosition {
    /// East, units.
    pub x: i32,
    /// South, units.
    pub z: i32,
    /// Heading, thousandths of a degree: 0 is north, 90,000 is east.
    pub yaw_mdeg: i32,
}

/// Why the server evicts a session, which has broken no rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eviction {
    /// The server has too little memory.
    Memory = 1,
    /// A client of a site with fewer sessions has none.
    Displaced,
}

impl SessionStats {
    /// Waits until the server evicts the session.
    pub async fn evicted(&self) -> Eviction {
        self.evicted.notified().await;
        // There is one: it is stored before the notice.
        self.eviction().unwrap_or(Eviction::Memory)
    }

    /// Why the server evicts the session, the first cause; none if it does not.
    #[must_use]
    pub fn eviction(&self) -> Option<Eviction> {
        let eviction = self.eviction.load(Ordering::Relaxed);
        [Eviction::Memory, Eviction::Displaced].into_iter().find(|known| *known as u8 == eviction)
    }

    fn figures(&self) -> SessionFigures {
        let position = self.position.load(Ordering::Relaxed);
        let eye = || EyePosition {
            x: ((position >> 32) as u32).cast_signed(),
            z: (position as u32).cast_signed(),
            yaw_mdeg: self.yaw_mdeg.load(Ordering::Relaxed),
        };
        SessionFigures {
            eye: self.has_view.load(Ordering::Relaxed).then(eye),
            chunks: self.chunks.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
        }
    }

    fn evict(&self, eviction: Eviction) {
        // The first cause stays: the end of the session states it.
        let _ = self.eviction.compare_exchange(0, eviction as u8, Ordering::Relaxed, Ordering::Relaxed);
        self.evicted.notify_one();
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
pub struct OpenSession {
    stats: Arc<SessionStats>,
    number: u64,
    client: Option<IpAddr>,
    sessions: OpenSessions,
}

impl OpenSession {
    /// The number of the session.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// The address of its client.
    #[must_use]
    pub const fn client(&self) -> Option<IpAddr> {
        self.client
    }

    /// The site of its client.
    #[must_use]
    pub fn site(&self) -> Option<IpAddr> {
        self.client.map(client_site)
    }

    /// Notes that the handshake is done: the client has taken its place, and another session may be
    /// displaced for its site at once.
    pub fn set_welcomed(&self) {
        if !self.stats.is_welcomed.swap(true, Ordering::Relaxed) {
            lock(&self.sessions.shared.waiting).remove(&self.site());
        }
    }
}

impl std::ops::Deref for OpenSession {
    type Target = SessionStats;

    fn deref(&self) -> &SessionStats {
        &self.stats
    }
}

impl Drop for OpenSession {
    fn drop(&mut self) {
        let mut sessions = lock(&self.sessions.shared.sessions);
        if let Some(session) = sessions.by_number.remove(&self.number) {
            sessions.sites.remove(session.site, self.number);
        }
    }
}

/// How many sessions end for lack of memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shed {
    /// At most so many.
    pub count: usize,
    /// Whether the limit is close: then so many end, whatever their sites have.
    pub is_critical: bool,
}

/// All open sessions.
#[derive(Clone, Debug, Default)]
pub struct OpenSessions {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    /// A std mutex: held for map operations, and for reading the figures that a page lists.
    sessions: Mutex<Sessions>,
    /// When a session was displaced for the last time.
    displaced: Mutex<Option<Instant>>,
    /// Sites for which a session was displaced, and when; until one of theirs has its handshake.
    waiting: Mutex<HashMap<Option<IpAddr>, Waiting>>,
}

/// A site for which a session was displaced.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    since: Instant,
    /// Whether it has taken the place.
    has_begun: bool,
}

impl Waiting {
    fn is_recent(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.since) < DISPLACEMENT_WAIT
    }
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

impl OpenSessions {
    /// Registers a session of a client; its number is unique.
    #[must_use]
    pub fn register(&self, number: u64, client: Option<IpAddr>) -> OpenSession {
        let stats = Arc::new(SessionStats::default());
        let site = client.map(client_site);
        let registered = Registered { stats: Arc::clone(&stats), site };
        let mut sessions = lock(&self.shared.sessions);
        sessions.sites.insert(site, number);
        sessions.by_number.insert(number, registered);
        drop(sessions);
        OpenSession { stats, number, client, sessions: self.clone() }
    }

    /// Sessions of the site of a client that were not chosen to end.
    #[must_use]
    pub fn held(&self, client: Option<IpAddr>) -> usize {
        lock(&self.shared.sessions).sites.count(client.map(client_site))
    }

    /// Number of open sessions.
    #[must_use]
    pub fn count(&self) -> usize {
        lock(&self.shared.sessions).by_number.len()
    }

    /// Ends sessions ([`SessionStats::evicted`]), first of the sites that have the most, among
    /// equals the newest. The only one of its site ends where all are, or memory is critical.
    /// Returns how many end.
    pub fn shed(&self, Shed { count, is_critical }: Shed) -> usize {
        if count == 0 {
            return 0;
        }
        let mut sessions = lock(&self.shared.sessions);
        let Sessions { by_number, sites } = &mut *sessions;
        // The session of a site with this many older ones.
        let mut older: HashMap<Option<IpAddr>, usize> = HashMap::new();
        let mut rank = |site| {
            let older = older.entry(site).or_default();
            *older += 1;
            *older - 1
        };
        // Those that end already hold little.
        let open = by_number.iter().filter(|(_, session)| session.stats.eviction().is_none());
        let ranked = open.map(|(number, session)| (rank(session.site), *number, session));
        let mut ended: Vec<_> = ranked.collect();
        ended.sort_unstable_by_key(|(rank, number, _)| Reverse((*rank, *number)));
        ended.truncate(count);
        if !is_critical && ended.first().is_some_and(|(rank, ..)| *rank > 0) {
            ended.retain(|(rank, ..)| *rank > 0);
        }
        for (_, number, session) in &ended {
            session.stats.evict(Eviction::Memory);
            sites.remove(session.site, *number);
        }
        ended.len()
    }

    /// Ends the newest session of the site that has the most, for a client whose site has at least
    /// two fewer. False if there is none, too soon after the last one, or for a site that has not
    /// had a session with a handshake since: a client that never takes its place must not end many.
    pub fn displace_for(&self, client: Option<IpAddr>, now: Instant) -> bool {
        let mut displaced = lock(&self.shared.displaced);
        if displaced.is_some_and(|last| now.saturating_duration_since(last) < DISPLACEMENT_INTERVAL) {
            return false;
        }
        let own = client.map(client_site);
        let mut waiting = lock(&self.shared.waiting);
        if waiting.get(&own).is_some_and(|waiting| waiting.is_recent(now)) {
            return false;
        }
        let mut sessions = lock(&self.shared.sessions);
        let Sessions { by_number, sites } = &mut *sessions;
        let held = sites.count(own);
        let largest = sites.newest_of_largest().filter(|(_, count)| *count >= held + 2);
        let Some((number, _)) = largest else { return false };
        let Some(newest) = by_number.get(&number) else { return false };
        if waiting.len() >= MAX_WAITING_SITES {
            waiting.retain(|_, waiting| waiting.is_recent(now));
            if waiting.len() >= MAX_WAITING_SITES {
                return false;
            }
        }
        newest.stats.evict(Eviction::Displaced);
        sites.remove(newest.site, number);
        *displaced = Some(now);
        waiting.insert(own, Waiting { since: now, has_begun: false });
        true
    }

    /// Takes the place of a session that was displaced for the site of a client; false if there is
    /// none.
    pub fn take_place(&self, client: Option<IpAddr>, now: Instant) -> bool {
        let mut waiting = lock(&self.shared.waiting);
        let place = waiting.get_mut(&client.map(client_site)).filter(|waiting| waiting.is_recent(now));
        place.is_some_and(|waiting| !std::mem::replace(&mut waiting.has_begun, true))
    }

    /// The oldest sessions, at most so many: their numbers and figures.
    #[must_use]
    pub fn oldest(&self, count: usize) -> Vec<(u64, SessionFigures)> {
        let sessions = lock(&self.shared.sessions);
        let figures = sessions.by_number.iter().map(|(number, of)| (*number, of.stats.figures()));
        figures.take(count).collect()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing under these locks panics in the middle of a change.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::FutureExt;

    #[tokio::test]
    async fn sessions_of_the_networks_that_have_the_most_end_first() {
        let sessions = OpenSessions::default();
        let client = |number: u64| Some(IpAddr::from([10, 0, 0, if number < 6 { 1 } else { number as u8 }]));
        let open: Vec<_> =
            (1..=8).map(|number| (number, sessions.register(number, client(number)))).collect();
        let ended = async |count, is_critical| {
            let shed = sessions.shed(Shed { count, is_critical });
            let mut ended = Vec::new();
            for (number, stats) in &open {
                if stats.evicted().now_or_never().is_some() {
                    ended.push(*number);
                }
            }
            assert_eq!(shed, ended.len());
            ended
        };
        assert_eq!(ended(2, false).await, [4, 5]);
        assert_eq!(ended(8, false).await, [2, 3], "none that is the only one of its site");
        assert_eq!(ended(1, true).await, [8]);
        assert_eq!(ended(8, false).await, [1, 6, 7], "each is");
        assert_eq!(ended(0, true).await, [0; 0]);
    }

    #[tokio::test]
    async fn a_session_of_the_site_with_the_most_is_displaced_and_not_soon_another() {
        let (sessions, start) = (OpenSessions::default(), Instant::now());
        let client = |site: u8| Some(IpAddr::from([10, 0, 0, site]));
        let sites = [1, 1, 1, 2, 2];
        let open: Vec<_> =
            sites.iter().zip(1..).map(|(site, number)| sessions.register(number, client(*site))).collect();
        let displaced = |site: u8, ms: u64| {
            let is_displaced = sessions.displace_for(client(site), start + Duration::from_millis(ms));
            let ended =
                open.iter().position(|stats| stats.evicted().now_or_never() == Some(Eviction::Displaced));
            assert_eq!(is_displaced, ended.is_some());
            ended
        };
        assert_eq!(displaced(2, 0), None, "it has one less");
        assert!(!sessions.take_place(client(3), start));
        assert_eq!(displaced(3, 0), Some(2));
        assert!(sessions.take_place(client(3), start));
        assert!(!sessions.take_place(client(3), start), "once");
        assert_eq!(displaced(3, 249), None, "too soon");
        assert_eq!(displaced(3, 250), None, "it has not begun a session");
        assert!(displaced(4, 250).is_some());
        let ninth = sessions.register(9, client(3));
        assert_eq!(displaced(3, 500), None, "it has no handshake");
        ninth.set_welcomed();
        drop(ninth);
        assert!(displaced(3, 500).is_some());
        assert_eq!(displaced(5, 750), None, "each site has one");
    }
}
