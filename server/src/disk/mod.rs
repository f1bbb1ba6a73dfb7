//! Frames on disk: what outlives memory and the process, where making it again would be dearer than
//! reading a file.
//!
//! A chunk has one content for ever, so the folder holds nothing that cannot be lost: a frame that
//! is missing, damaged or foreign is made again. From that follows the rest. One thread reads for
//! the generation threads (`reader`), one writes behind them (`keeper`), and neither ever fails or
//! holds up a client: a slow read is given up, a full queue drops the write, a folder that cannot
//! be used is left alone and tried again later. Files are not synced; what a crash leaves
//! half-written is refused by its digest, as is everything else that is not what this server would
//! send.
//!
//! An own few hundred lines rather than a crate, because nothing that exists does this little:
//! cacache 13 verifies, but has no budget and deletes nothing by age; foyer 0.22 has both, but
//! keeps one store of fixed blocks with its own index in memory, its own runtime threads and a
//! memory tier that would take the place of ours. They bring 84 and 69 crates, and what they are
//! best at, checking content, the frames do themselves.

mod keeper;
mod names;
mod reader;

use crate::metrics::Metrics;
use bytes::Bytes;
use keeper::{Keeper, Order};
use names::Names;
use protocol::Delivery;
use reader::Reader;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};
use tokio::sync::{mpsc, oneshot};

/// The finest level that is kept. A file of 4 KiB is read and checked in 10 us when the system has
/// it in memory, and in 0.1 to 0.2 ms from flash. A chunk of level 0 is made and encoded in less
/// than 0.1 ms and one of level 1 in about 0.2 ms; from level 2 on it takes 0.4 to 3 ms, since its
/// error is measured over the levels below it.
pub const FINEST_LEVEL: u8 = 2;

/// Frames that wait to be written. About 1 MiB of them, 6 MiB if they were all as long as frames
/// can be; one more is dropped.
const WAITING: usize = 256;

/// Longest wait for the last writes when the server stops.
const LAST_WRITES: Duration = Duration::from_secs(2);

/// Where frames are kept and how much of it they may take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DiskConfig {
    /// The folder. Created if it does not exist; for one server at a time.
    pub folder: PathBuf,
    /// Budget in bytes, counted in blocks of 4 KiB.
    pub bytes: u64,
}

/// The disk tier of one world.
#[derive(Debug)]
pub struct Disk {
    folder: PathBuf,
    names: Names,
    reader: Reader,
    orders: mpsc::Sender<Order>,
    metrics: Arc<Metrics>,
}

impl Disk {
    /// A tier over a folder. Touches nothing yet: the thread that writes opens the folder, so that
    /// a slow disk delays no start.
    ///
    /// # Errors
    /// The system refuses to start threads.
    pub fn new(config: DiskConfig, world: &WorldDigest, metrics: Arc<Metrics>) -> io::Result<Self> {
        let (orders, ordered) = mpsc::channel(WAITING);
        let keeper = Keeper::new(config.clone(), Arc::clone(&metrics));
        // Ends when the last sender is gone.
        std::thread::Builder::new().name("disk".into()).spawn(move || keeper.run(ordered))?;
        let reader = Reader::new(Arc::clone(&metrics))?;
        Ok(Self { folder: config.folder, names: Names::new(world), reader, orders, metrics })
    }

    /// The frame of a chunk for a delivery, if it is kept and `is_genuine` says that it is what
    /// this server would send. What is not is deleted. Reads a file: not for a thread that has
    /// sockets to serve.
    #[must_use]
    pub fn read(
        &self,
        key: ChunkKey,
        delivery: Delivery,
        is_genuine: impl FnOnce(&[u8]) -> bool,
    ) -> Option<Bytes> {
        if key.level() < FINEST_LEVEL {
            return None;
        }
        let found = self.peek(key, delivery, is_genuine);
        let counter = if found.is_some() { &self.metrics.disk_hits } else { &self.metrics.disk_misses };
        counter.inc();
        found
    }

    /// As [`Disk::read`], but neither a hit nor a miss: for what is not going to be served.
    #[must_use]
    pub fn peek(
        &self,
        key: ChunkKey,
        delivery: Delivery,
        is_genuine: impl FnOnce(&[u8]) -> bool,
    ) -> Option<Bytes> {
        if key.level() < FINEST_LEVEL {
            return None;
        }
        let path = self.folder.join(self.names.path(key, delivery));
        match self.reader.read(path.clone()) {
            Ok(frame) if is_genuine(&frame) => Some(frame.into()),
            Ok(_) => self.throw_away(&path),
            Err(error) if error.kind() == io::ErrorKind::InvalidData => self.throw_away(&path),
            Err(error) => {
                if !matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::TimedOut) {
                    self.metrics.disk_faults.inc();
                }
                None
            }
        }
    }

    /// Deletes what is no frame of this server's. Finds nothing.
    fn throw_away(&self, path: &Path) -> Option<Bytes> {
        self.metrics.disk_damaged.inc();
        tracing::debug!(path = %path.display(), "damaged or foreign on disk, deleted");
        // Gone already, or not ours to delete: it will be replaced by a rename, or refused again. A
        // folder goes only if it is empty.
        let _ = fs::remove_file(path).or_else(|_| fs::remove_dir(path));
        None
    }

    /// Has a frame written, soon, if there is room in the queue and making it was dear.
    pub fn write(&self, key: ChunkKey, delivery: Delivery, frame: Bytes) {
        if key.level() < FINEST_LEVEL {
            return;
        }
        if self.orders.try_send(Order::Write { path: self.names.path(key, delivery), frame }).is_err() {
            self.metrics.disk_dropped.inc();
        }
    }

    /// Waits until everything is written that was to be written, 2 s at most, and leaves the folder
    /// to others. What comes after is dropped.
    pub async fn close(&self) {
        let (done, is_done) = oneshot::channel();
        let closed = async {
            if self.orders.send(Order::Close(done)).await.is_ok() {
                // An error would mean that the thread has ended, and then nothing is left to wait
                // for.
                let _ = is_done.await;
            }
        };
        if tokio::time::timeout(LAST_WRITES, closed).await.is_err() {
            tracing::warn!("the disk cache did not finish its writes in time; what is missing is made again");
        }
    }
}

#[cfg(test)]
mod tests;
