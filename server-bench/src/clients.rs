//! Clients of a benchmark: tasks that run at the same time, and closed loops of requests.

use crate::connection::{Connection, Received};
use anyhow::{Context, Result, ensure};
use rustc_hash::FxHashMap;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use tokio::runtime::{Builder, Runtime};

/// Nice value of the thread of other peers: a tenth of the weight of the measured clients' thread,
/// which shares its processor on a machine with few of them. The work that the other peers make for
/// the server counts, not the time that they take from the measured clients.
const OTHERS_NICE: i32 = 10;

/// Nice value of a server's generation threads.
const GENERATION_NICE: i32 = 3;

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

/// Most processors that are looked for.
const MOST_PROCESSORS: usize = 256;

/// Threads that work without a wait, one on each processor: other programs of the machine. They end
/// when this is dropped.
#[derive(Debug)]
pub struct BusyThreads {
    must_stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl BusyThreads {
    /// Starts them with the nice value of a server's generation threads.
    pub fn start() -> Self {
        let must_stop = Arc::new(AtomicBool::new(false));
        let work = |processor: usize| {
            let must_stop = Arc::clone(&must_stop);
            std::thread::spawn(move || {
                #[cfg(target_os = "linux")]
                let _ = rustix::process::nice(GENERATION_NICE);
                if !moves_to(processor) {
                    return;
                }
                while !must_stop.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            })
        };
        let threads = processors().into_iter().map(work).collect();
        Self { must_stop, threads }
    }
}

/// Processors that a thread may move to, whatever those of this process are: the client has other
/// ones than the server.
fn processors() -> Vec<usize> {
    let all = || (0..MOST_PROCESSORS).filter(|processor| moves_to(*processor)).collect();
    std::thread::spawn(all).join().unwrap_or_default()
}

/// Moves this thread to a processor. False if there is none of this number.
#[cfg(target_os = "linux")]
fn moves_to(processor: usize) -> bool {
    let mut one = rustix::thread::CpuSet::new();
    one.set(processor);
    rustix::thread::sched_setaffinity(None, &one).is_ok()
}

/// Elsewhere the system chooses the processor.
#[cfg(not(target_os = "linux"))]
fn moves_to(processor: usize) -> bool {
    processor < std::thread::available_parallelism().map_or(1, usize::from)
}

impl Drop for BusyThreads {
    fn drop(&mut self) {
        self.must_stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // It has no way to fail.
            let _ = thread.join();
        }
    }
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
    /// This many requests of a chunk each, when all of the last ones are answered, like wrk.
    Batches(usize),
    /// Half a window in one request, when half is answered, like a viewer.
    Halves(usize),
}

/// An event of a closed loop.
pub enum Event<'a> {
    /// A chunk is being requested.
    Sent(ChunkKey),
    /// The server sent something.
    Received(Received<'a>),
}

/// The totals that a client received.
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

/// A client of which waits are measured goes on so long after its end for chunks that it requested.
const GRACE: Duration = Duration::from_secs(2);

/// Keeps the window full until a time, whether or not the server answers; without one, until all
/// keys are answered.
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
    let mut end = pin!(async {
        match until {
            Some(until) => tokio::time::sleep_until(until.into()).await,
            None => std::future::pending().await,
        }
    });
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
        let receiving = connection.receive(|received| {
            outstanding = outstanding.saturating_sub(1);
            match received {
                Received::Chunk(frame) => {
                    totals.chunks += 1;
                    totals.bytes += frame.len() as u64;
                }
                Received::Message(_) => totals.refused += 1,
            }
            note(Event::Received(received));
        });
        tokio::select! {
            biased;
            received = receiving => received?,
            () = &mut end => break,
        }
    }
    Ok(totals)
}

/// The waits of a client of a closed loop, from a time on.
#[derive(Clone, Debug)]
pub struct Waits {
    from: Instant,
    open: FxHashMap<ChunkKey, Instant>,
    /// Time of each request; one without an answer counts with the time until the client gave up.
    pub latencies: Vec<Duration>,
    /// Chunks that arrived, until the end.
    pub chunks: usize,
    /// Requests that were refused.
    pub refused: usize,
}

impl Waits {
    const fn new(from: Instant) -> Self {
        let open = FxHashMap::with_hasher(rustc_hash::FxBuildHasher);
        Self { from, open, latencies: Vec::new(), chunks: 0, refused: 0 }
    }

    fn note(&mut self, event: &Event<'_>) {
        match event {
            Event::Sent(key) => _ = self.open.insert(*key, Instant::now()),
            Event::Received(received) => {
                let sent = received.answers().and_then(|key| self.open.remove(&key));
                if Instant::now() < self.from {
                    return;
                }
                match received {
                    Received::Chunk(_) => self.latencies.extend(sent.map(|sent| sent.elapsed())),
                    Received::Message(_) => self.refused += 1,
                }
            }
        }
    }

    /// Requests that are open now have waited until now.
    fn give_up(&mut self) {
        self.latencies.extend(self.open.drain().map(|(_, sent)| sent.elapsed()));
    }
}

/// A closed loop of one request a chunk until `end`: the wait for each chunk that arrived from
/// `from` on, and for those that had not come [`GRACE`] after the end.
pub async fn waits(
    connection: &mut Connection,
    keys: impl IntoIterator<Item = ChunkKey>,
    window: usize,
    from: Instant,
    end: Instant,
) -> Result<Waits> {
    let mut waits = Waits::new(from);
    closed_loop(connection, keys, Window::OneByOne(window), Some(end), |event| waits.note(&event)).await?;
    waits.chunks = waits.latencies.len();
    let late = tokio::time::Instant::from(end + GRACE);
    while !waits.open.is_empty() {
        let receiving = connection.receive(|received| waits.note(&Event::Received(received)));
        match tokio::time::timeout_at(late, receiving).await {
            Ok(received) => received?,
            Err(_) => break,
        }
    }
    waits.give_up();
    Ok(waits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::message::{RefusalReason, Refused, ServerMessage, Welcome};
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    #[test]
    fn clients_start_evenly_spread_over_all_keys() {
        let keys: Vec<_> = (0..8).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect();
        let first = |index| rotated(&keys, index, 4)[0].x();
        assert_eq!([0, 1, 2, 3].map(first), [0, 2, 4, 6]);
        assert_eq!(rotated(&keys, 3, 4).len(), 8);
    }

    /// A server that welcomes one client, answers its first request, refuses the second, and is
    /// silent.
    async fn silent_server(listener: TcpListener) {
        let (mut socket, _) = listener.accept().await.unwrap();
        let mut bytes = vec![0; 4096];
        // The upgrade, in one read: a client without TLS writes it at once.
        assert!(socket.read(&mut bytes).await.unwrap() > 0);
        let message = |message: &ServerMessage| {
            let payload = protocol::control::encode(message).unwrap();
            [vec![0x82, 126], (payload.len() as u16).to_be_bytes().to_vec(), payload.to_vec()].concat()
        };
        let welcome = ServerMessage::Welcome(Welcome {
            session: 1,
            world_seed: 1,
            generator_version: 1,
            digest: [0; 32],
            max_credits: 1,
            max_view_distance_m: 1,
            software: String::new(),
        });
        let refused = ServerMessage::Refused(Refused {
            id: 1,
            key: Some(key(1).into()),
            reason: RefusalReason::Overloaded,
            detail: "".into(),
        });
        let land = terrain::Land::new(1);
        let chunk = protocol::chunk_codec::encode(&land.chunk(key(0)), &land.digest());
        let chunk = [vec![0x82, 126], (chunk.len() as u16).to_be_bytes().to_vec(), chunk.to_vec()].concat();
        socket.write_all(b"HTTP/1.1 101 Switching Protocols\r\n\r\n").await.unwrap();
        // After Hello the Welcome, after the requests two answers.
        assert!(socket.read(&mut bytes).await.unwrap() > 0);
        socket.write_all(&message(&welcome)).await.unwrap();
        assert!(socket.read(&mut bytes).await.unwrap() > 0);
        socket.write_all(&[chunk, message(&refused)].concat()).await.unwrap();
        // Until the client goes.
        while socket.read(&mut bytes).await.is_ok_and(|count| count > 0) {}
    }

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 0).unwrap()
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_client_that_starves_ends_and_its_requests_count_with_their_waits() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(silent_server(listener));
        let mut connection = Connection::connect(address).await.unwrap();
        let start = Instant::now();
        // More than two answers take on a busy machine.
        let end = start + Duration::from_secs(3);
        let waits = waits(&mut connection, (0..).map(key), 4, start, end).await.unwrap();
        assert_eq!((waits.chunks, waits.refused), (1, 1));
        // One chunk came, one was refused, four are open.
        let longer = waits.latencies.iter().filter(|wait| **wait >= GRACE).count();
        assert_eq!((waits.latencies.len(), longer), (5, 4), "{:?}", waits.latencies);
    }

    #[test]
    fn a_refusal_is_an_error_where_none_may_be() {
        let totals = Totals { chunks: 3, bytes: 9, refused: 0 };
        assert_eq!(totals.without_refusals().unwrap().chunks, 3);
        let refused = Totals { refused: 1, ..totals }.without_refusals();
        assert!(refused.unwrap_err().to_string().contains("1 of 4"));
    }
}
