//! Frame cache on disk. It survives restarts, and holds the levels whose generation takes longer
//! than a read.
//!
//! A chunk never changes, so every file can be lost: a missing, corrupt or foreign frame is
//! generated again. One thread reads for the generation threads (`reader`), one writes behind them
//! (`writer`). Neither fails or delays a client: a slow read times out, a full queue drops the
//! write, an unavailable folder is retried later. Files are not synced; a partial write after a
//! crash fails the digest check, as does every other file that is not a frame of this server.
//!
//! The measured alternatives are crates: cacache 13 verifies, but has no budget and no eviction by
//! age; foyer 0.22 has both, but keeps one store of fixed blocks with its own index in memory, its
//! own runtime threads and a memory tier. They add 84 and 69 crates, and the frames carry their own
//! digests already.

mod names;
mod reader;
mod writer;

pub use writer::DiskConfig;

use crate::chunk_id::ChunkId;
use crate::metrics::Metrics;
use bytes::Bytes;
use names::FrameNames;
use protocol::Delivery;
use reader::Reader;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use terrain::WorldDigest;
use tokio::sync::{mpsc, oneshot};
use writer::{DiskWriter, WriterCommand};

/// The finest cached level. A file of 4 KiB is read and verified in 10 us from the page cache, and
/// in 0.1 to 0.2 ms from flash. A chunk of level 0 is generated and encoded in less than 0.1 ms,
/// one of level 1 in about 0.2 ms, and coarser ones in 0.6 ms (level 2) to 7 ms (level 4), since
/// their error is measured over the levels below.
pub const FINEST_LEVEL: u8 = 2;

/// Capacity of the write queue, frames: about 1 MiB, 6 MiB with frames of maximum length. One more
/// is dropped.
const WRITE_QUEUE: usize = 256;

/// Longest wait for the pending writes on shutdown.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// The disk cache of one world.
#[derive(Debug)]
pub struct Disk {
    folder: PathBuf,
    names: FrameNames,
    reader: Reader,
    commands: mpsc::Sender<WriterCommand>,
    metrics: Arc<Metrics>,
}

impl Disk {
    /// A cache in a folder. The writer thread opens the folder, so that a slow disk does not delay
    /// the start.
    ///
    /// # Errors
    /// The system cannot start threads.
    pub fn new(config: DiskConfig, world: &WorldDigest, metrics: Arc<Metrics>) -> io::Result<Self> {
        let (commands, receiver) = mpsc::channel(WRITE_QUEUE);
        let writer = DiskWriter::new(config.clone(), Arc::clone(&metrics));
        // Ends after the last sender is dropped.
        std::thread::Builder::new().name("disk-write".into()).spawn(move || writer.run(receiver))?;
        let reader = Reader::new(Arc::clone(&metrics))?;
        Ok(Self { folder: config.folder, names: FrameNames::new(world), reader, commands, metrics })
    }

    /// The frame of a chunk for a delivery, if it is cached and `is_valid` accepts it. An invalid
    /// file is deleted. Blocks: not for async threads.
    #[must_use]
    pub fn read(
        &self,
        id: ChunkId,
        delivery: Delivery,
        is_valid: impl FnOnce(&[u8]) -> bool,
    ) -> Option<Bytes> {
        let path = self.path(id, delivery)?;
        let found = self.load(&path, is_valid);
        let counter =
            if found.is_some() { &self.metrics.disk_cache.hits } else { &self.metrics.disk_cache.misses };
        counter.inc();
        found
    }

    /// As [`Disk::read`], without counting a hit or a miss: for frames that are not served.
    #[must_use]
    pub fn peek(
        &self,
        id: ChunkId,
        delivery: Delivery,
        is_valid: impl FnOnce(&[u8]) -> bool,
    ) -> Option<Bytes> {
        self.load(&self.path(id, delivery)?, is_valid)
    }

    /// The path of a chunk's file. None for a level that is not cached.
    fn path(&self, id: ChunkId, delivery: Delivery) -> Option<PathBuf> {
        (id.key.level() >= FINEST_LEVEL).then(|| self.folder.join(self.names.path(id, delivery)))
    }

    /// A file's frame if `is_valid` accepts it.
    fn load(&self, path: &Path, is_valid: impl FnOnce(&[u8]) -> bool) -> Option<Bytes> {
        match self.reader.read(path.to_owned()) {
            Ok(frame) if is_valid(&frame) => Some(frame.into()),
            Ok(_) => self.discard(path),
            Err(error) if error.kind() == io::ErrorKind::InvalidData => self.discard(path),
            Err(error) => {
                if !matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::TimedOut) {
                    self.metrics.disk_cache.io_errors.inc();
                }
                None
            }
        }
    }

    /// Has an invalid file deleted. If the queue is full it stays; it is rejected again or
    /// replaced.
    fn discard(&self, path: &Path) -> Option<Bytes> {
        self.metrics.disk_cache.corrupt.inc();
        tracing::debug!(path = %path.display(), "corrupt or foreign file");
        if let Ok(path) = path.strip_prefix(&self.folder) {
            let _ = self.commands.try_send(WriterCommand::Discard { path: path.to_owned() });
        }
        None
    }

    /// Queues a frame for writing if its level is cached and the queue has room.
    pub fn write(&self, id: ChunkId, delivery: Delivery, frame: Bytes) {
        if id.key.level() < FINEST_LEVEL {
            return;
        }
        let path = self.names.path(id, delivery);
        if self.commands.try_send(WriterCommand::Write { path, frame }).is_err() {
            self.metrics.disk_cache.dropped.inc();
        }
    }

    /// Waits for the pending writes, 2 s at most, and releases the folder. Later writes are
    /// dropped.
    pub async fn close(&self) {
        let (done, is_done) = oneshot::channel();
        let closed = async {
            if self.commands.send(WriterCommand::Close(done)).await.is_ok() {
                // An error means that the thread has ended.
                let _ = is_done.await;
            }
        };
        if tokio::time::timeout(CLOSE_TIMEOUT, closed).await.is_err() {
            tracing::warn!(
                "the disk cache did not finish its writes in time; the missing chunks will be generated again"
            );
        }
    }
}

#[cfg(test)]
mod tests;
