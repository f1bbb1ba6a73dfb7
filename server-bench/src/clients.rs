//! Clients of a benchmark: tasks that run at the same time, and closed loops of requests.

use crate::connection::{Connection, Received};
use anyhow::{Context, Result, ensure};
use rustc_hash::FxHashMap;
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use tokio::runtime::{Builder, Runtime};

/// Nice value of the thread of other peers: a tenth of the weight of the measured clients' thread,
/// which shares its processor on a machine with few of them. What the other peers make the server do
/// counts, not the time that they take from the measured clients.
const OTHERS_NICE: i32 = 10;

/// A runtime on a thread of its own, for peers that must not delay the measured clients.
pub fn other_thread() -> Result<Runtime> {
    Builder::new_multi_thread()
        .worker_threads(1)
        .on_thread_start(|| {
            #[cfg(target_os = "linux")]
            let _ = rustix::process::nice(OTHERS_NICE);
        })
        .enable_all()
        .build()
        .context("cannot start a thread")
}

/// Runs a client on each connection, all at the same time. The first that fails fails the
/// benchmark.
pub async fn run_all<T: Send + 'static, F: Future<Output = Result<T>> + Send + 'static>(
    connections: Vec<Connection>,
    client: impl Fn(usize, Connection) -> F,
) -> Result<Vec<T>> {
    let clients = connections.into_iter().enumerate();
    let clients: Vec<_> =
        clients.map(|(index, connection)| tokio::spawn(client(index, connection))).collect();
    let mut results = Vec::with_capacity(clients.len());
    for client in clients {
        results.push(client.await.context("a client failed")??);
    }
    Ok(results)
}

/// The keys in the order of client `index` of `count`: each starts far from the others, so that
/// together they cover the whole list and none finds chunks of another in the cache.
pub fn rotated(keys: &[ChunkKey], index: usize, count: usize) -> Vec<ChunkKey> {
    let mut own = keys.to_vec();
    own.rotate_left(index * keys.len() / count);
    own
}

/// Requests outstanding of a closed loop.
#[derive(Clone, Copy, Debug)]
pub enum Window {
    /// One request a chunk, as soon as another is answered.
    OneByOne(usize),
    /// So many requests of a chunk each, when all of the last ones are answered, like wrk.
    Batches(usize),
    /// Half a window in one request, when half is answered, like a viewer.
    Halves(usize),
}

/// What happens in a closed loop.
pub enum Event<'a> {
    /// A chunk is being requested.
    Sent(ChunkKey),
    /// The server sent something.
    Received(Received<'a>),
}

/// What a client received.
#[derive(Clone, Copy, Debug, Default)]
pub struct Totals {
    pub chunks: u64,
    /// Of the chunk frames.
    pub bytes: u64,
    /// Everything that is no chunk.
    pub refused: u64,
}

impl std::ops::AddAssign for Totals {
    fn add_assign(&mut self, other: Self) {
        self.chunks += other.chunks;
        self.bytes += other.bytes;
        self.refused += other.refused;
    }
}

impl Totals {
    /// The totals of a client that must not be refused anything.
    pub fn without_refusals(self) -> Result<Self> {
        ensure!(
            self.refused == 0,
            "the server refused {} of {} chunks",
            self.refused,
            self.chunks + self.refused
        );
        Ok(self)
    }
}

/// Keeps the window full until a time; without one, until all keys are answered.
pub async fn closed_loop(
    connection: &mut Connection,
    keys: impl IntoIterator<Item = ChunkKey>,
    window: Window,
    until: Option<Instant>,
    mut note: impl FnMut(Event<'_>),
) -> Result<Totals> {
    let (mut keys, mut totals) = (keys.into_iter(), Totals::default());
    // Requests outstanding at most, how many are sent at once, and whether in one message.
    let (size, at_once, are_together) = match window {
        Window::OneByOne(size) => (size, 1, false),
        Window::Batches(size) => (size, size, false),
        Window::Halves(size) => (size, size / 2, true),
    };
    let mut outstanding = 0;
    while until.is_none_or(|until| Instant::now() < until) {
        while size - outstanding >= at_once {
            let count = if at_once == 1 { size - outstanding } else { at_once };
            let more: Vec<_> = keys.by_ref().take(count).collect();
            if more.is_empty() {
                break;
            }
            outstanding += more.len();
            more.iter().for_each(|key| note(Event::Sent(*key)));
            connection.request(more, are_together).await?;
        }
        if outstanding == 0 {
            break;
        }
        connection
            .receive(|received| {
                outstanding = outstanding.saturating_sub(1);
                match received {
                    Received::Chunk(frame) => {
                        totals.chunks += 1;
                        totals.bytes += frame.len() as u64;
                    }
                    Received::Message(_) => totals.refused += 1,
                }
                note(Event::Received(received));
            })
            .await?;
    }
    Ok(totals)
}

/// A closed loop of one request a chunk until `end`: the wait for each chunk that arrived from
/// `from` on, and how many requests were refused in that time.
pub async fn waits(
    connection: &mut Connection,
    keys: impl IntoIterator<Item = ChunkKey>,
    window: usize,
    from: Instant,
    end: Instant,
) -> Result<(Vec<Duration>, usize)> {
    let (mut waits, mut refused) = (Vec::new(), 0);
    let mut open: FxHashMap<ChunkKey, Instant> = FxHashMap::default();
    let note = |event: Event<'_>| match event {
        Event::Sent(key) => _ = open.insert(key, Instant::now()),
        Event::Received(received) => {
            let sent = received.key().and_then(|key| open.remove(&key));
            if Instant::now() >= from {
                refused += usize::from(received.key().is_none());
                waits.extend(sent.map(|sent| sent.elapsed()));
            }
        }
    };
    closed_loop(connection, keys, Window::OneByOne(window), Some(end), note).await?;
    Ok((waits, refused))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clients_start_evenly_spread_over_all_keys() {
        let keys: Vec<_> = (0..8).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect();
        let first = |index| rotated(&keys, index, 4)[0].x();
        assert_eq!([0, 1, 2, 3].map(first), [0, 2, 4, 6]);
        assert_eq!(rotated(&keys, 3, 4).len(), 8);
    }

    #[test]
    fn a_refusal_is_an_error_where_none_may_be() {
        let totals = Totals { chunks: 3, bytes: 9, refused: 0 };
        assert_eq!(totals.without_refusals().unwrap().chunks, 3);
        let refused = Totals { refused: 1, ..totals }.without_refusals();
        assert!(refused.unwrap_err().to_string().contains("1 of 4"));
    }
}
