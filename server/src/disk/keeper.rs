//! The one thread that writes, counts and deletes.
//!
//! Each of the shards has an equal share of the budget; names spread frames over them evenly, so no
//! shard has to know of another. One over its share loses its oldest files, by their time, until an
//! eighth of it is free. That is nearly the oldest of all, because every shard holds a fair sample,
//! and it needs neither an index in memory nor a look at more than one folder at a time.
//!
//! Shards are counted one by one while nothing is to be written, and before the first write into
//! them; reading does not wait for it.
//!
//! When the folder cannot be used (full, read-only, gone, another server's) this thread says so
//! once, lets writes go, and tries again every minute.

use super::DiskConfig;
use super::names::{SHARDS, shard_name, shard_of};
use crate::metrics::Metrics;
use bytes::Bytes;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::mpsc::Receiver;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::oneshot;

/// What a file takes: whole blocks of the usual file systems.
const BLOCK: u64 = 4096;

/// Until a folder that could not be used is tried again.
const REST: Duration = Duration::from_secs(60);

/// Held while the folder is in use.
const LOCK: &str = "lock";

/// What is being written. There is one writer, so what a crash leaves is written over.
const UNFINISHED: &str = "unfinished";

/// What the thread is told.
#[derive(Debug)]
pub enum Order {
    /// Keep a frame.
    Write {
        /// Relative to the folder.
        path: PathBuf,
        /// All of the file.
        frame: Bytes,
    },
    /// Let the folder go once everything before this is done, say so, and end.
    Close(oneshot::Sender<()>),
}

/// See the module.
pub struct Keeper {
    config: DiskConfig,
    metrics: Arc<Metrics>,
    /// Bytes by shard; none while it is not counted. Deletions by readers are noticed when the
    /// shard is next looked through.
    counts: Vec<Option<u64>>,
    /// Shards below this are counted or were when the folder was opened.
    next_to_count: usize,
    state: State,
    /// Whether the folder was opened before: then it is not created again, since a folder that
    /// vanishes is most often a disk that is no longer there, and what would be filled is the one
    /// that it was mounted on.
    was_open: bool,
    /// Whether the log says that the folder cannot be used.
    has_complained: bool,
}

enum State {
    /// With the lock.
    Working(#[expect(dead_code, reason = "held for its lock")] File),
    /// Not to be tried before then, if that is said.
    Resting(Option<Instant>),
}

impl Keeper {
    /// A keeper that has not opened its folder.
    pub fn new(config: DiskConfig, metrics: Arc<Metrics>) -> Self {
        Self {
            config,
            metrics,
            counts: vec![None; SHARDS],
            next_to_count: 0,
            state: State::Resting(None),
            was_open: false,
            has_complained: false,
        }
    }

    /// Obeys until nobody can give orders any more.
    pub fn run(mut self, mut orders: Receiver<Order>) {
        self.wake(Instant::now());
        loop {
            let order = if self.has_uncounted() {
                match orders.try_recv() {
                    Ok(order) => Some(order),
                    Err(TryRecvError::Empty) => {
                        self.count_next();
                        continue;
                    }
                    Err(TryRecvError::Disconnected) => None,
                }
            } else {
                orders.blocking_recv()
            };
            match order {
                Some(Order::Write { path, frame }) => self.write(&path, &frame, Instant::now()),
                Some(Order::Close(done)) => {
                    // The next server may have the folder from here on, so nothing more is taken
                    // either.
                    drop((self, orders));
                    // Whoever asked may have stopped waiting.
                    let _ = done.send(());
                    return;
                }
                None => return,
            }
        }
    }

    /// Writes one frame, or lets it go.
    pub fn write(&mut self, path: &Path, frame: &[u8], now: Instant) {
        self.wake(now);
        if !self.is_working() {
            self.metrics.disk_dropped.inc();
        } else if let Err(error) = self.store(path, frame) {
            self.metrics.disk_dropped.inc();
            match error.kind() {
                // A folder that somebody put in the place of a file: one frame that cannot be kept
                // is no reason to keep none.
                io::ErrorKind::IsADirectory | io::ErrorKind::DirectoryNotEmpty => {
                    self.metrics.disk_faults.inc();
                }
                _ => self.rest(&error, now),
            }
        } else {
            self.metrics.disk_writes.inc();
        }
        self.tell_bytes();
    }

    /// Counts one further shard.
    pub fn count_next(&mut self) {
        let shard = self.next_to_count;
        self.next_to_count += 1;
        if self.counts[shard].is_none()
            && let Err(error) = self.count(shard)
        {
            self.rest(&error, Instant::now());
        }
        self.tell_bytes();
    }

    /// Whether there is something to count.
    pub fn has_uncounted(&self) -> bool {
        self.is_working() && self.next_to_count < SHARDS
    }

    fn is_working(&self) -> bool {
        matches!(self.state, State::Working(_))
    }

    fn store(&mut self, path: &Path, frame: &[u8]) -> io::Result<()> {
        let (folder, shard) = (&self.config.folder, shard_of(path));
        let (unfinished, path) = (folder.join(UNFINISHED), folder.join(path));
        fs::write(&unfinished, frame).inspect_err(|_| {
            // On a full disk it would take some of the last room.
            let _ = fs::remove_file(&unfinished);
        })?;
        if let Err(error) = fs::rename(&unfinished, &path) {
            if error.kind() != io::ErrorKind::NotFound {
                return Err(error);
            }
            fs::create_dir(folder.join(shard_name(shard)))?;
            fs::rename(&unfinished, &path)?;
        }
        match &mut self.counts[shard] {
            // A frame that takes the place of its like is counted twice until the shard is looked
            // through.
            Some(bytes) => *bytes += size(frame.len() as u64),
            None => return self.count(shard),
        }
        self.keep_to_share(shard)
    }

    /// Looks through a shard for what it takes.
    fn count(&mut self, shard: usize) -> io::Result<()> {
        let mut bytes = 0;
        self.for_each_file(shard, |_, about| bytes += size(about.len()))?;
        self.counts[shard] = Some(bytes);
        self.keep_to_share(shard)
    }

    /// Deletes the oldest files of a shard that is over its share.
    fn keep_to_share(&mut self, shard: usize) -> io::Result<()> {
        let share = self.config.bytes / SHARDS as u64;
        if self.counts[shard].is_none_or(|bytes| bytes <= share) {
            return Ok(());
        }
        let (mut files, mut bytes) = (Vec::new(), 0);
        self.for_each_file(shard, |path, about| {
            bytes += size(about.len());
            files.push((about.modified().unwrap_or(SystemTime::UNIX_EPOCH), size(about.len()), path));
        })?;
        files.sort_unstable();
        for (_, size, path) in files {
            if bytes <= share - share / 8 {
                break;
            }
            match fs::remove_file(path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {
                    bytes -= size;
                    self.metrics.disk_evicted.inc();
                }
            }
        }
        self.counts[shard] = Some(bytes);
        Ok(())
    }

    fn for_each_file(&self, shard: usize, mut each: impl FnMut(PathBuf, &fs::Metadata)) -> io::Result<()> {
        let entries = match fs::read_dir(self.config.folder.join(shard_name(shard))) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(error),
        };
        for entry in entries {
            let entry = entry?;
            match entry.metadata() {
                Ok(about) if about.is_file() => each(entry.path(), &about),
                // Not ours, or deleted by a reader in this moment.
                _ => {}
            }
        }
        Ok(())
    }

    /// Opens the folder if that is to be tried now.
    pub fn wake(&mut self, now: Instant) {
        let State::Resting(until) = self.state else { return };
        if until.is_some_and(|until| now < until) {
            return;
        }
        match self.open() {
            Ok(lock) => {
                self.state = State::Working(lock);
                (self.was_open, self.next_to_count) = (true, 0);
                self.counts.fill(None);
                self.metrics.disk_working.set(1);
                if self.has_complained {
                    tracing::info!(folder = %self.config.folder.display(), "the disk cache works again");
                }
                self.has_complained = false;
            }
            Err(error) => self.rest(&error, now),
        }
    }

    fn open(&self) -> io::Result<File> {
        let folder = &self.config.folder;
        if !self.was_open {
            fs::create_dir_all(folder)?;
        }
        let lock = OpenOptions::new().create(true).truncate(false).write(true).open(folder.join(LOCK))?;
        match lock.try_lock() {
            Ok(()) => Ok(lock),
            Err(TryLockError::WouldBlock) => Err(io::Error::other("another server uses it")),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }

    fn rest(&mut self, error: &io::Error, now: Instant) {
        self.state = State::Resting(Some(now + REST));
        self.metrics.disk_working.set(0);
        self.metrics.disk_faults.inc();
        if !self.has_complained {
            let folder = self.config.folder.display();
            tracing::warn!(%folder, %error, "the disk cache cannot be used; the server goes on without and tries again every minute");
        }
        self.has_complained = true;
    }

    fn tell_bytes(&self) {
        let bytes: u64 = self.counts.iter().flatten().sum();
        self.metrics.disk_bytes.set(bytes as i64);
    }
}

/// What a file of so many bytes takes.
const fn size(bytes: u64) -> u64 {
    bytes.next_multiple_of(BLOCK)
}
